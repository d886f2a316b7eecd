//! `foveal replay --view`: a recording in the window, with a timeline to scrub, step and play, stories of pixels, and a
//! walk that branches off.

use std::path::PathBuf;
use std::sync::Arc;

use foveal_engine::Failure;
use foveal_engine::recording::{RecordedRun, open_trace};
use foveal_engine::replay::{Beside, Source};
use foveal_engine::source::{Build, FrameSource, Loader};
use foveal_window::{Options, WindowError};

use super::ReplayArguments;

/// Opens the window.
pub fn run(a: &ReplayArguments, file: PathBuf, workers: usize) -> Result<(), Failure> {
    let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let size = open_trace(&file)
        .and_then(|trace| RecordedRun::of(&trace, &file))
        .map(|run| [run.settings.width, run.settings.height + foveal_window::timeline::HEIGHT as u32])?;
    let elsewhere = a.elsewhere.files();
    let loader: Loader = Arc::new(move |dropped| {
        let file = dropped.unwrap_or(&file).to_path_buf();
        let source = Source::open(&file, &elsewhere, false, &()).map_err(|e| e.to_string())?;
        // On a thread of its own: the window never waits for it.
        let player = Beside::new(source, workers).map_err(|e| e.to_string())?;
        let build: Build = Box::new(move || Ok(Box::new(player) as Box<dyn FrameSource>));
        Ok(build)
    });
    let options = Options { name, size, screenshots: a.screenshots.clone(), ..Options::of(loader) };
    foveal_window::run(options).map(drop).map_err(|e| match e {
        WindowError::Environment(m) => Failure::Environment(m),
        WindowError::Scene(m) => Failure::Input(m),
        WindowError::Ended(m) => Failure::ended(&m),
    })
}
