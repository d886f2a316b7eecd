//! `foveal replay --view`: a recording in the window, with a timeline to scrub, step and play, stories of pixels, and a
//! walk that branches off.

use std::path::PathBuf;
use std::sync::Arc;

use foveal_engine::Failure;
use foveal_engine::recording::{RecordedRun, open_trace};
use foveal_engine::replay::{Beside, Pair, Source, first_other_frame};
use foveal_engine::source::{Build, FrameSource, Loader};
use foveal_window::{Options, WindowError};

use super::ReplayArguments;

/// Opens the window.
pub fn run(a: &ReplayArguments, file: PathBuf, workers: usize) -> Result<(), Failure> {
    let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let size = open_trace(&file)
        .and_then(|trace| RecordedRun::of(&trace, &file))
        .map(|run| [run.settings.width, run.settings.height + foveal_window::timeline::HEIGHT as u32])?;
    let other = a.beside.clone();
    let size = match &other {
        // As wide as both.
        Some(other) => {
            let run = open_trace(other).and_then(|trace| RecordedRun::of(&trace, other))?;
            [size[0] + run.settings.width, size[1]]
        }
        None => size,
    };
    let records_into = a.record.clone();
    let elsewhere = a.elsewhere.files();
    let loader: Loader = Arc::new(move |dropped| {
        let file = dropped.unwrap_or(&file).to_path_buf();
        let source = Source::open(&file, &elsewhere, false, &()).map_err(|e| e.to_string())?;
        // On a thread of its own: the window never waits for it.
        let trace = Arc::clone(&source.trace);
        let player =
            Beside::recorded_into(source, workers, records_into.clone()).map_err(|e| e.to_string())?;
        let build: Build = match &other {
            None => Box::new(move || Ok(Box::new(player) as Box<dyn FrameSource>)),
            Some(other) => {
                let source = Source::open(other, &elsewhere, false, &()).map_err(|e| e.to_string())?;
                let parted = first_other_frame(&trace, &source.trace);
                let right = Beside::new(source, workers).map_err(|e| e.to_string())?;
                Box::new(move || Ok(Box::new(Pair::new(player, right, parted)) as Box<dyn FrameSource>))
            }
        };
        Ok(build)
    });
    let options = Options { name, size, screenshots: a.screenshots.clone(), ..Options::of(loader) };
    foveal_window::run(options).map(drop).map_err(|e| match e {
        WindowError::Environment(m) => Failure::Environment(m),
        WindowError::Scene(m) => Failure::Input(m),
        WindowError::Ended(m) => Failure::ended(&m),
    })
}
