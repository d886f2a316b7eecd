//! `foveal serve`: a walk in the browser of whoever has the address.

use std::fs;
use std::io::Write;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use clap::{Args, ValueEnum};
use foveal::splatting::supersampling::Supersampling;
use foveal_engine::change::Begun;
use foveal_engine::interrupt::interrupted;
use foveal_engine::recipe::Loaded;
use foveal_engine::source::FrameSource;
use foveal_engine::{Failure, Recipe};
use foveal_serve::gate::Token;
use foveal_serve::hub::{Limits, SIDE_MAX};
use foveal_serve::server::{self, Make, Server, Tls};
use foveal_terminal::arguments::{bytes, duration};
use foveal_terminal::print::{print_json, print_line};
use foveal_terminal::progress::{Progress, end_on_interrupt};
use serde_json::json;

use super::interactive::InteractiveArguments;

/// Viewers at once.
const VIEWERS: usize = 16;

/// Arguments of `foveal serve`.
#[derive(Args, Clone, Debug)]
#[command(after_long_help = foveal_engine::controls::help())]
pub struct ServeArguments {
    #[command(flatten)]
    walk: InteractiveArguments,
    /// Address to listen on; port 0 picks a free port
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8080")]
    listen: SocketAddr,
    /// Whether visitors share one walk or each have their own
    #[arg(long, value_enum, default_value_t = Share::One)]
    share: Share,
    /// With --share each: limit on the number of walks, which divide the tracers among them
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=16))]
    walks: u32,
    /// With --share each: end a walk after this time without viewers
    #[arg(long, value_name = "TIME", value_parser = duration, default_value = "10min")]
    idle: Duration,
    /// Keep the token in this file, so that the address stays the same; created if missing
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Print a second address, for visitors who may only watch
    #[arg(long)]
    watch_token: bool,
    /// Additional host name by which browsers may reach the server; may be repeated
    #[arg(long = "host", value_name = "NAME")]
    hosts: Vec<String>,
    /// The server is behind a TLS proxy: allow addresses other than loopback, and trust the proxy's X-Forwarded-For
    #[arg(long)]
    behind_proxy: bool,
    /// The server's certificate chain, PEM; browsers then connect by HTTPS, also from other machines
    #[arg(long, value_name = "FILE", requires = "tls_key", conflicts_with = "behind_proxy")]
    tls_cert: Option<PathBuf>,
    /// The certificate's private key, PEM
    #[arg(long, value_name = "FILE", requires = "tls_cert")]
    tls_key: Option<PathBuf>,
    /// Limit on picture data per second to each viewer, e.g. 500kB
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
    limit: Option<u64>,
    /// Open the address in this machine's browser; for a moment other users of the machine can read it on the
    /// browser's command line
    #[arg(long)]
    open: bool,
    /// Print the address as one JSON document
    #[arg(long)]
    json: bool,
}

/// Who shares a walk.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Share {
    /// One walk: one visitor drives, the others watch
    One,
    /// A walk for each visitor
    Each,
}

impl ServeArguments {
    fn check(&self) -> Result<(), Failure> {
        if !self.listen.ip().is_loopback() && !self.behind_proxy && self.tls_cert.is_none() {
            return Err(Failure::Usage(format!(
                "{} can be reached from elsewhere, and what is said there is not encrypted; give --tls-cert and --tls-key, put \
                 a proxy with TLS before it and say --behind-proxy, or listen at 127.0.0.1 and come by `ssh -L`",
                self.listen
            )));
        }
        if self.listen.ip().is_unspecified() && self.tls_cert.is_some() && self.hosts.is_empty() {
            return Err(Failure::Usage(format!(
                "{} is no address that a browser could ask for; give --host NAME, as the certificate has it",
                self.listen
            )));
        }
        let size = self.walk.size();
        if size.width.max(size.height) > SIDE_MAX {
            return Err(Failure::Usage(format!("--size: each side at most {SIDE_MAX}")));
        }
        if self.share == Share::Each && self.watch_token {
            return Err(Failure::Usage("--watch-token: with --share each there is nobody to watch".into()));
        }
        if self.share == Share::Each && self.walk.tracers.is_asked_for() {
            return Err(Failure::Usage(
                "--tracers: other machines trace for one walk, with --share one".into(),
            ));
        }
        if self.limit.is_some_and(|limit| limit < 1000) {
            return Err(Failure::Usage("--limit: at least 1kB a second".into()));
        }
        Ok(())
    }

    fn recipe(&self) -> Recipe {
        let noise = Supersampling::default().noise;
        let mut recipe = self.walk.recipe("serve", self.walk.illumination.light(), noise);
        if self.share == Share::Each {
            recipe.settings.tracers = (recipe.settings.tracers / self.walks).max(1);
        }
        recipe
    }

    /// Makes walks: each with the scene as it was read.
    fn maker(&self, recipe: Recipe, loaded: Loaded) -> Make {
        let walks = Arc::new(AtomicU32::new(0));
        let changer = recipe.clone().changer(Arc::clone(&walks));
        Arc::new(move |_| {
            let loaded = Loaded { opened: loaded.opened.clone(), probes: Arc::clone(&loaded.probes) };
            let number = walks.fetch_add(1, Ordering::Relaxed) + 1;
            let source: Box<dyn FrameSource> = Box::new(recipe.start(loaded, number)?);
            Ok(Begun { source, changer: Some(Arc::clone(&changer)) })
        })
    }

    fn tls(&self) -> Result<Option<Tls>, Failure> {
        let (Some(certificate), Some(key)) = (&self.tls_cert, &self.tls_key) else { return Ok(None) };
        Tls::read(certificate, key).map(Some)
    }

    /// What addresses begin with, where that is not where the server listens.
    fn base(&self, listens: SocketAddr) -> Option<String> {
        let name = self.hosts.first();
        match (self.behind_proxy, &self.tls_cert) {
            (true, _) => name.map(|name| format!("https://{name}/")),
            (false, Some(_)) => {
                let host = name.map_or_else(
                    || listens.to_string(),
                    |name| {
                        if listens.port() == 443 {
                            name.clone()
                        } else {
                            format!("{name}:{}", listens.port())
                        }
                    },
                );
                Some(format!("https://{host}/"))
            }
            (false, None) => None,
        }
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
            recorded: self.walk.record.is_some(),
            tls: self.tls()?,
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
        if told.opens
            && let Err(e) = open::that_detached(address(&told.token))
        {
            tracing::warn!("no browser can be opened ({e}); open the address by hand");
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
    /// A browser is opened.
    opens: bool,
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
        tls: None,
    })?;
    serve(server, make, &Told { base: None, token, watch_token: None, token_file: None, json, opens: false })
}

/// Runs the command.
pub fn run(a: &ServeArguments, progress: Progress) -> Result<(), Failure> {
    a.check()?;
    end_on_interrupt();
    let options = a.server()?;
    let (token, watch_token) = (options.token.clone(), options.watch_token.clone());
    // Before minutes are spent on the scene.
    let server = Server::bind(options)?;
    let (base, token_file) = (a.base(server.address()), a.token_file.clone());
    let told = Told { base, token, watch_token, token_file, json: a.json, opens: a.open };
    let recipe = a.recipe();
    let loaded = recipe.load(&recipe.scene, &progress.baking())?;
    for warning in &loaded.opened.warnings {
        tracing::warn!("{warning}");
    }
    serve(server, a.maker(recipe, loaded), &told)
}
