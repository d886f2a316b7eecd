//! `foveal view`: a window on the walk.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::builder::PossibleValue;
use clap::{Args, ValueEnum};
use foveal::image::Map2d;
use foveal::splatting::supersampling::Supersampling;
use foveal_actors::renderer::overlay::Overlay;
use foveal_engine::files::write_atomic;
use foveal_engine::interrupt::interrupted;
use foveal_engine::source::{Controls, FrameSource};
use foveal_engine::walk::{Next, Walk};
use foveal_engine::{Failure, Light, Recipe, Stalled, screenshot};
use foveal_terminal::print::{print_json, print_line};
use foveal_terminal::progress::{Progress, end_on_interrupt};
use foveal_window::{Backend, DrawnBy, WindowError};
use serde_json::json;

use super::interactive::InteractiveArguments;

/// Arguments of `foveal view`.
#[derive(Args, Clone, Debug)]
#[command(after_long_help = foveal_engine::controls::help())]
pub struct ViewArguments {
    #[command(flatten)]
    walk: InteractiveArguments,
    /// What paints the window
    #[arg(long, value_enum, default_value_t = BackendName::Auto)]
    backend: BackendName,
    /// What draws the picture
    #[arg(long, value_enum, default_value_t = DisplayName::Auto)]
    display: DisplayName,
    /// Lose the adapter after this many seconds, to test that the walk continues
    #[arg(long, value_name = "SECONDS", hide = true)]
    lose_adapter: Option<f64>,
    /// Lose the window's surface after this many seconds, to test the same
    #[arg(long, value_name = "SECONDS", hide = true)]
    lose_surface: Option<f64>,
    /// Stall a part from the start, to test that the walk continues
    #[arg(long, value_enum, default_value = "nobody", hide = true)]
    stall: StalledName,
    /// Folder for screenshots (F12)
    #[arg(long, value_name = "DIR", default_value = ".")]
    screenshots: PathBuf,
    /// No window: correct the start view until it has converged, and write it to --out
    #[arg(long, requires = "out")]
    headless: bool,
    /// PNG file for the picture of --headless
    #[arg(long, value_name = "FILE", requires = "headless")]
    out: Option<PathBuf>,
    /// Overlay on the picture of --headless
    #[arg(long, value_enum, requires = "headless")]
    overlay: Option<OverlayName>,
    /// With --headless: include the panel, as in the window
    #[arg(long, requires = "headless")]
    panel: bool,
    /// With --headless: stop after this many frames, converged or not
    #[arg(long, value_name = "N", requires = "headless", value_parser = clap::value_parser!(u32).range(1..))]
    frames: Option<u32>,
    /// With --headless: print one JSON document
    #[arg(long, requires = "headless")]
    json: bool,
}

impl ViewArguments {
    fn recipe(&self) -> Recipe {
        // Without a window nobody sees the light grow, so it is final at once.
        let illumination = &self.walk.illumination;
        let baked = illumination.baked || self.headless && !illumination.quick;
        let light = Light { baked, ..illumination.light() };
        let noise = if self.headless { 0.0 } else { Supersampling::default().noise };
        Recipe { stalled: self.stall.0, ..self.walk.recipe("view", light, noise) }
    }
}

/// Names of backends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum BackendName {
    /// A graphics adapter if there is one, else the processor
    Auto,
    /// A graphics adapter, with an error if there is none
    Gpu,
    /// The processor
    Cpu,
}

/// Names of who draws.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum DisplayName {
    /// A hardware graphics adapter if there is one, else the processor
    Auto,
    /// A graphics adapter, with an error if there is none
    Gpu,
    /// The processor
    Cpu,
}

impl From<DisplayName> for DrawnBy {
    fn from(name: DisplayName) -> Self {
        match name {
            DisplayName::Auto => Self::Auto,
            DisplayName::Gpu => Self::Adapter,
            DisplayName::Cpu => Self::Processor,
        }
    }
}

impl From<BackendName> for Backend {
    fn from(name: BackendName) -> Self {
        match name {
            BackendName::Auto => Self::Auto,
            BackendName::Gpu => Self::Gpu,
            BackendName::Cpu => Self::Cpu,
        }
    }
}

/// [`Stalled`] on a command line.
#[derive(Clone, Copy, Debug)]
struct StalledName(Stalled);

impl ValueEnum for StalledName {
    fn value_variants<'a>() -> &'a [Self] {
        const EACH: [StalledName; Stalled::EACH.len()] = {
            let mut each = [StalledName(Stalled::Nobody); Stalled::EACH.len()];
            let mut i = 0;
            while i < each.len() {
                each[i] = StalledName(Stalled::EACH[i]);
                i += 1;
            }
            each
        };
        &EACH
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.0.name()))
    }
}

/// An overlay on a command line; `None` is all of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct OverlayName(Option<Overlay>);

impl ValueEnum for OverlayName {
    fn value_variants<'a>() -> &'a [Self] {
        const EACH: [OverlayName; Overlay::ALL.len() + 1] = {
            let mut each = [OverlayName(None); Overlay::ALL.len() + 1];
            let mut i = 0;
            while i < Overlay::ALL.len() {
                each[i] = OverlayName(Some(Overlay::ALL[i]));
                i += 1;
            }
            each
        };
        &EACH
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let (name, help) = match self.0 {
            None => ("all", "All of them, three in a row, in the order of the window's panel"),
            Some(overlay) => {
                let name = match overlay {
                    Overlay::None => "none",
                    Overlay::Saliency => "saliency",
                    Overlay::Objects => "objects",
                    Overlay::Level => "level",
                    Overlay::Age => "age",
                    Overlay::Tracer => "tracer",
                    Overlay::Mip => "mip",
                    Overlay::Importance => "importance",
                    Overlay::Priority => "priority",
                    Overlay::Error => "error",
                    Overlay::MipGiven => "mip-given",
                };
                (name, overlay.help())
            }
        };
        Some(PossibleValue::new(name).help(help))
    }
}

/// Runs the command.
pub fn run(a: ViewArguments, progress: Progress) -> Result<(), Failure> {
    if a.headless {
        return headless(&a, progress);
    }
    if (a.display, a.backend) == (DisplayName::Gpu, BackendName::Cpu) {
        return Err(Failure::Usage("--display gpu draws into a window that --backend gpu shows".into()));
    }
    foveal_window::run(options(a)).map(drop).map_err(|e| match e {
        WindowError::Environment(m) => Failure::Environment(m),
        WindowError::Scene(m) => Failure::Input(m),
        WindowError::Ended(m) => Failure::ended(&m),
    })
}

/// What the window is opened with.
fn options(a: ViewArguments) -> foveal_window::Options {
    foveal_window::Options {
        backend: if a.display == DisplayName::Gpu { Backend::Gpu } else { a.backend.into() },
        drawn_by: a.display.into(),
        lose_adapter: a.lose_adapter,
        lose_surface: a.lose_surface,
        screenshots: a.screenshots.clone(),
        ..if a.walk.follows() {
            foveal_window::Options::following(a.recipe())
        } else {
            foveal_window::Options::new(a.recipe())
        }
    }
}

/// The start view, converged, into a file: what the window would show after a while.
fn headless(a: &ViewArguments, progress: Progress) -> Result<(), Failure> {
    end_on_interrupt();
    let mut source = a.recipe().walk(&progress.baking())?;
    if let Some(OverlayName(Some(overlay))) = a.overlay {
        source.set(&Controls { overlay, ..source.controls() })?;
    }
    let begin = Instant::now();
    let mut walk = Walk::new(Box::new(source), 0.0);
    let mut frames = 0u32;
    loop {
        if interrupted() {
            break;
        }
        let now = begin.elapsed().as_secs_f64();
        let (shown, next) = walk.tick(now);
        if let Some(why) = walk.ended() {
            return Err(Failure::ended(&why));
        }
        frames += u32::from(shown);
        if a.frames.is_some_and(|most| frames >= most) {
            break;
        }
        match next {
            Next::Now => {}
            Next::At(t) => std::thread::sleep(Duration::from_secs_f64((t - now).clamp(0.0, 0.1))),
            Next::Input => break,
        }
    }
    let (Some(picture), Some(out)) = (walk.picture().cloned(), &a.out) else {
        return Err(Failure::Interrupted("interrupted before there was a picture".into()));
    };
    let picture = if a.panel {
        let [width, height] = [picture.width() + foveal_window::panel::WIDTH as usize + 20, picture.height()];
        foveal_window::interface::paint(&walk, [width, height])
    } else if a.overlay == Some(OverlayName(None)) {
        sheet(&mut walk)
    } else {
        picture
    };
    let bytes =
        screenshot::png(&picture, &walk.facts(begin.elapsed().as_secs_f64())).map_err(Failure::Input)?;
    write_atomic(out, &bytes)?;
    let converged = walk.status().converged;
    if a.json {
        print_json(&json!({
            "schema": "foveal.view/1",
            "scene": walk.place().title,
            "size": [picture.width(), picture.height()],
            "frames": frames,
            "seconds": begin.elapsed().as_secs_f64(),
            "converged": converged,
            "file": out.display().to_string(),
        }));
    } else {
        let state = if converged { "converged" } else { "still growing" };
        print_line(&format!("{}: {frames} frames, {state}", out.display()));
    }
    if interrupted() {
        return Err(Failure::Interrupted("interrupted; what was done is kept".into()));
    }
    Ok(())
}

/// The picture and all overlays, three in a row, each beneath what its colours mean.
fn sheet(walk: &mut Walk) -> Map2d<[u8; 3]> {
    let mut pictures = Vec::new();
    for overlay in Overlay::ALL {
        walk.set_controls(Controls { overlay, ..*walk.controls() });
        pictures.extend(walk.picture().map(|picture| (overlay, picture.clone())));
    }
    foveal_window::legend::sheet(&pictures, 3)
}
