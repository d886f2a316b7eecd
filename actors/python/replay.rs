//! A recorded walk, frame by frame.

use std::path::PathBuf;
use std::rc::Rc;

use foveal_actors::renderer::Renderer;
use foveal_actors::wiring::Actors;
use foveal_engine::foveal::display::tone::ToneMap;
use foveal_engine::recording::Elsewhere;
use foveal_engine::replay::{How, Source};
use foveal_engine::{Failure, Standing};
use foveal_runtime::{Exit, Limit, Runtime};
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;

use crate::beside::{Beside, Wanted};
use crate::camera::Camera;
use crate::failure::existing;
use crate::frame::{Frame, Known};

/// A recording, and a replay of it on its way.
struct Held {
    source: Rc<Source>,
    threads: usize,
    going: Option<(Runtime, Actors)>,
}

/// A recorded walk.
#[pyclass(frozen, module = "foveal")]
pub struct Replay {
    held: Beside<Held>,
    frames: u32,
    size: [u32; 2],
    objects: Vec<String>,
}

/// Opens a recording.
#[pyfunction]
#[pyo3(signature = (recording, *, threads = None, scene = None, bake = None, cache = None))]
pub fn replay(
    py: Python<'_>,
    recording: PathBuf,
    threads: Option<usize>,
    scene: Option<PathBuf>,
    bake: Option<PathBuf>,
    cache: Option<PathBuf>,
) -> PyResult<Replay> {
    existing(&recording)?;
    let threads = threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from));
    if threads > 256 {
        return Err(PyValueError::new_err("threads: 0 to 256"));
    }
    let held = Beside::spawn(py, move |_| {
        let elsewhere = Elsewhere { scene, bake, cache };
        let source = Rc::new(Source::open(&recording, &elsewhere, false, &())?);
        Ok(Held { source, threads, going: None })
    })?;
    let (frames, size, objects) = held.ask(py, |held, _| {
        let (source, settings) = (&held.source, &held.source.recorded.settings);
        let objects = source.world().scene.objects.iter().map(|o| o.name.clone()).collect();
        Ok((source.shown_in.len() as u32, [settings.width, settings.height], objects))
    })?;
    Ok(Replay { held, frames, size, objects })
}

impl Held {
    /// The frame that is shown.
    fn frame(&self, runtime: &Runtime, actors: &Actors) -> Option<Frame> {
        let tone = ToneMap::from(&self.source.world().scene.display);
        let allocator = actors.correction.as_ref().map(|c| c.allocator);
        let insight = allocator.and_then(|a| runtime.inspect(a, |a| a.insight()));
        let of = |r: &Renderer| {
            let snapshot = r.shown()?.clone();
            let standing = match (r.is_shown(), r.is_converged(), r.is_refined()) {
                (true, true, true) if r.is_supersampled() => Standing::Refined,
                (true, true, _) => Standing::Converged,
                _ => Standing::Growing,
            };
            let known = Known::new(Some(r), insight.as_ref(), &tone);
            Some(Frame::replayed(snapshot, r.camera().map(Camera), standing, known))
        };
        runtime.inspect(actors.renderer, of).flatten()
    }

    /// Replays to the end, or to the next frame that `is` it.
    fn go_on(&mut self, wanted: &Wanted, is: impl Fn(Option<u32>) -> bool) -> Result<Option<Frame>, Failure> {
        let (mut runtime, actors) = match self.going.take() {
            Some(going) => going,
            // The renderer's turns have one message each, so that each frame can be looked at.
            None => self.source.system(How { threads: self.threads, turn: Some(1), ..How::default() })?,
        };
        let shown =
            |runtime: &Runtime| runtime.inspect(actors.renderer, |r| r.shown().map(|s| s.index.0)).flatten();
        let is_there = is(shown(&runtime));
        let exit = if is_there {
            Exit::Until
        } else {
            runtime.pump_until(Limit::IDLE, |runtime| !wanted.is() || is(shown(runtime)))
        };
        // Whoever was stopped on the way waits for what comes, which is no stall.
        if (exit != Exit::Until || runtime.diverged())
            && let Some(divergence) = runtime.replay_report().divergence
        {
            return Err(Failure::Check(format!("the replay diverges: {divergence}")));
        }
        if !wanted.is() {
            return Err(Failure::Interrupted("interrupted while replaying".into()));
        }
        if exit != Exit::Until && !is(shown(&runtime)) {
            return Ok(None);
        }
        let frame = self.frame(&runtime, &actors);
        self.going = Some((runtime, actors));
        Ok(frame)
    }
}

#[pymethods]
impl Replay {
    #[getter]
    fn size(&self) -> (u32, u32) {
        self.size.into()
    }

    #[getter]
    fn objects(&self) -> Vec<String> {
        self.objects.clone()
    }

    fn __len__(&self) -> usize {
        self.frames as usize
    }

    fn __iter__(slf: Py<Self>, py: Python<'_>) -> PyResult<Py<Frames>> {
        Py::new(py, Frames { replay: slf, next: std::sync::atomic::AtomicU32::new(0) })
    }

    fn __getitem__(&self, py: Python<'_>, index: isize) -> PyResult<Frame> {
        let counted = if index < 0 { index + self.frames as isize } else { index };
        match u32::try_from(counted) {
            Ok(frame) if frame < self.frames => self.frame(py, frame),
            _ => Err(PyIndexError::new_err(format!("no frame {index}; the recording shows {}", self.frames))),
        }
    }

    fn __repr__(&self) -> String {
        format!("<foveal.Replay of {} frames, {} × {}>", self.frames, self.size[0], self.size[1])
    }
}

impl Replay {
    /// A frame: replayed to from where the last one was, or from the start.
    fn frame(&self, py: Python<'_>, frame: u32) -> PyResult<Frame> {
        let found = self.held.ask(py, move |held, wanted| {
            let behind = held.going.as_ref().and_then(|(runtime, actors)| {
                runtime.inspect(actors.renderer, |r| r.shown().map(|s| s.index.0)).flatten()
            });
            if behind.is_some_and(|behind| behind > frame) {
                held.going = None;
            }
            held.go_on(wanted, |shown| shown == Some(frame))
        })?;
        found
            .ok_or_else(|| crate::failure::Error::new_err(format!("the recording ends before frame {frame}")))
    }
}

/// The frames of a recorded walk, one after the other.
#[pyclass(frozen, module = "foveal")]
pub struct Frames {
    replay: Py<Replay>,
    next: std::sync::atomic::AtomicU32,
}

#[pymethods]
impl Frames {
    fn __iter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    fn __next__(&self, py: Python<'_>) -> PyResult<Option<Frame>> {
        let replay = self.replay.get();
        let next = self.next.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        if next >= replay.frames {
            return Ok(None);
        }
        replay.frame(py, next).map(Some)
    }
}
