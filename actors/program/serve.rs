//! `foveal serve`: a walk in the browser of whoever has the address.

use std::fs;
use std::io::Write;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use clap::{Args, ValueEnum};
use foveal::splatting::supersampling::Supersampling;
use foveal_engine::interrupt::interrupted;
use foveal_engine::recipe::Loaded;
use foveal_engine::recording::TRACERS_MAX;
use foveal_engine::source::FrameSource;
use foveal_engine::{Failure, Recipe, Settings};
use foveal_serve::gate::Token;
use foveal_serve::hub::Limits;
use foveal_serve::server::{self, Make, Server};
use foveal_terminal::arguments::{Size, bytes, duration, positive};
use foveal_terminal::hashes::Hashes;
use foveal_terminal::light::IlluminationArguments;
use foveal_terminal::mode::ModeArguments;
use foveal_terminal::print::{print_json, print_line};
use foveal_terminal::progress::{Progress, end_on_interrupt};
use serde_json::json;

/// Viewers at once.
const VIEWERS: usize = 16;
/// Longest side of a picture.
const SIDE_MAX: u32 = 4096;

/// Arguments of `foveal serve`.
#[derive(Args, Clone, Debug)]
pub struct ServeArguments {
    /// An OBJ or glTF file or a sidecar
    scene: PathBuf,
    /// Where to listen; port 0 takes any that is free
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8080")]
    listen: SocketAddr,
    /// Whether all share one walk, or each who may drive has one
    #[arg(long, value_enum, default_value_t = Share::One)]
    share: Share,
    /// With --share each: most walks at once; each has its part of the tracers
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=16))]
    walks: u32,
    /// With --share each: a walk that nobody looks at ends after this time
    #[arg(long, value_name = "TIME", value_parser = duration, default_value = "10min")]
    idle: Duration,
    /// Picture size, each side at most 4096
    #[arg(long, value_name = "WxH", default_value = "512x512")]
    size: Size,
    /// Frames per second to aim at (default: the scene's, else 10)
    #[arg(long, value_parser = positive)]
    fps: Option<f32>,
    #[command(flatten)]
    mode: ModeArguments,
    /// Number of tracers (default: one per core)
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=i64::from(TRACERS_MAX)))]
    workers: Option<u32>,
    /// Refine what has converged until the standard error of displayed values, 0 to 1, is below this; 0 leaves it
    #[arg(long, value_name = "NOISE", default_value_t = Supersampling::default().noise, value_parser = clap::value_parser!(f32))]
    refine: f32,
    /// Most samples of a pixel in that
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=1 << 16))]
    refine_samples: u32,
    /// Most bytes of textures in memory, e.g. 64MiB (default: the scene's, else no limit)
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
    texture_budget: Option<u64>,
    /// Record the walk, so that `foveal replay` can run it again; with --share each the next ones go to FILE-2, FILE-3, ...
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// How densely hashes are recorded
    #[arg(long, value_name = "WHICH", value_enum, default_value_t = Hashes::Each, requires = "record")]
    hashes: Hashes,
    /// Keep the token in this file, so that the address stays the same; made where it is not there
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Print a second address, for those who may look and not drive
    #[arg(long)]
    watch_token: bool,
    /// A name by which browsers may ask for the server, beside its address; may be given again
    #[arg(long = "host", value_name = "NAME")]
    hosts: Vec<String>,
    /// A proxy with TLS stands before it: other addresses than this machine's own may be listened at, and whom the proxy
    /// speaks for is believed
    #[arg(long)]
    behind_proxy: bool,
    /// Most bytes of pictures a second to one viewer, e.g. 500kB
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
    limit: Option<u64>,
    #[command(flatten)]
    illumination: IlluminationArguments,
    /// The address as one JSON document
    #[arg(long)]
    json: bool,
}

/// Who shares a walk.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Share {
    /// One walk: one drives, the others watch
    One,
    /// A walk for each
    Each,
}

impl ServeArguments {
    fn check(&self) -> Result<(), Failure> {
        if !self.listen.ip().is_loopback() && !self.behind_proxy {
            return Err(Failure::Usage(format!(
                "{} can be reached from elsewhere, and what is said there is not encrypted; put a proxy with TLS before it \
                 and say --behind-proxy, or listen at 127.0.0.1 and come by `ssh -L`",
                self.listen
            )));
        }
        if self.size.width.max(self.size.height) > SIDE_MAX {
            return Err(Failure::Usage(format!("--size: each side at most {SIDE_MAX}")));
        }
        if self.share == Share::Each && self.watch_token {
            return Err(Failure::Usage("--watch-token: with --share each there is nobody to watch".into()));
        }
        if self.limit.is_some_and(|limit| limit < 1000) {
            return Err(Failure::Usage("--limit: at least 1kB a second".into()));
        }
        Ok(())
    }

    fn recipe(&self) -> Recipe {
        let cores = std::thread::available_parallelism().map_or(1, usize::from) as u32;
        let all = self.workers.unwrap_or(cores.min(TRACERS_MAX));
        let tracers = if self.share == Share::Each { (all / self.walks).max(1) } else { all };
        let rules = Supersampling { noise: self.refine, max_samples: self.refine_samples };
        let settings = Settings {
            supersampling: (self.refine > 0.0).then_some(rules),
            ..Settings::new(self.size.width, self.size.height, tracers)
        };
        Recipe {
            light: self.illumination.light(),
            fps: self.fps,
            quality: self.mode.least_quality(),
            texture_bytes: self.texture_budget,
            record: self.record.clone(),
            command: "serve",
            hashing: self.hashes.into(),
            ..Recipe::new(&self.scene, settings)
        }
    }

    /// Makes walks: each with the scene as it was read.
    fn maker(&self, recipe: Recipe, loaded: Loaded) -> Make {
        Arc::new(move |number| {
            let loaded = Loaded { opened: loaded.opened.clone(), probes: Arc::clone(&loaded.probes) };
            Ok(Box::new(recipe.start(loaded, number)?) as Box<dyn FrameSource>)
        })
    }

    fn server(&self) -> Result<server::Options, Failure> {
        let random = || Token::random().map_err(Failure::Environment);
        let token = match &self.token_file {
            Some(file) => kept_token(file)?,
            None => random()?,
        };
        let limits = Limits {
            walks: (self.share == Share::Each).then_some(self.walks as usize),
            viewers: VIEWERS,
            bytes: self.limit.map(|bytes| bytes as f64),
            idle: self.idle.as_secs_f64(),
        };
        Ok(server::Options {
            listen: self.listen,
            hosts: self.hosts.clone(),
            behind_proxy: self.behind_proxy,
            token,
            watch_token: self.watch_token.then(random).transpose()?,
            limits,
            recorded: self.record.is_some(),
        })
    }
}

/// The token of a file; where there is none, a new one in it, for nobody else to read.
fn kept_token(file: &Path) -> Result<Token, Failure> {
    match fs::read_to_string(file) {
        Ok(text) => Token::kept(&text)
            .ok_or_else(|| Failure::file(file, "holds no token: 20 to 128 letters, digits, - and _")),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            let token = Token::random().map_err(Failure::Environment)?;
            let mut options = fs::OpenOptions::new();
            options.write(true).create_new(true);
            #[cfg(unix)]
            std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
            let written = options.open(file).and_then(|mut file| writeln!(file, "{}", token.as_str()));
            written.map_err(|e| Failure::file(file, e))?;
            Ok(token)
        }
        Err(e) => Err(Failure::file(file, e)),
    }
}

/// Serves until Ctrl-C, and says where once that is so.
fn serve(server: Server, make: Make, told: &Told) -> Result<(), Failure> {
    let base = told.base.clone().unwrap_or_else(|| format!("http://{}/", server.address()));
    let address = |token: &Token| format!("{base}#t={}", token.as_str());
    let say = || {
        if told.json {
            print_json(&json!({
                "schema": "foveal.serve/1",
                "address": address(&told.token),
                "watch_address": told.watch_token.as_ref().map(address),
                "token_file": told.token_file.as_ref().map(|file| file.display().to_string()),
            }));
        } else {
            print_line(&address(&told.token));
            if let Some(watch) = &told.watch_token {
                print_line(&format!("to watch: {}", address(watch)));
            }
        }
    };
    server.run(make, interrupted, say)?;
    if interrupted() {
        return Err(Failure::Interrupted("interrupted; what was recorded is kept".into()));
    }
    Ok(())
}

/// What is said of an address.
struct Told {
    /// What it begins with, where a proxy has another.
    base: Option<String>,
    token: Token,
    watch_token: Option<Token>,
    token_file: Option<PathBuf>,
    json: bool,
}

/// Serves a recording at an address of this machine's own.
pub fn recording(listen: SocketAddr, make: Make, json: bool) -> Result<(), Failure> {
    if !listen.ip().is_loopback() {
        return Err(Failure::Usage(format!(
            "{listen} can be reached from elsewhere; recordings are served at 127.0.0.1, come by `ssh -L`"
        )));
    }
    let token = Token::random().map_err(Failure::Environment)?;
    let limits = Limits { walks: None, viewers: VIEWERS, bytes: None, idle: 600.0 };
    let server = Server::bind(server::Options {
        listen,
        hosts: Vec::new(),
        behind_proxy: false,
        token: token.clone(),
        watch_token: None,
        limits,
        recorded: false,
    })?;
    serve(server, make, &Told { base: None, token, watch_token: None, token_file: None, json })
}

/// Runs the command.
pub fn run(a: &ServeArguments, progress: Progress) -> Result<(), Failure> {
    a.check()?;
    end_on_interrupt();
    let options = a.server()?;
    let told = Told {
        base: a.hosts.first().filter(|_| a.behind_proxy).map(|name| format!("https://{name}/")),
        token: options.token.clone(),
        watch_token: options.watch_token.clone(),
        token_file: a.token_file.clone(),
        json: a.json,
    };
    // Before minutes are spent on the scene.
    let server = Server::bind(options)?;
    let recipe = a.recipe();
    let loaded = recipe.load(&a.scene, &progress.baking())?;
    for warning in &loaded.opened.warnings {
        tracing::warn!("{warning}");
    }
    serve(server, a.maker(recipe, loaded), &told)
}
