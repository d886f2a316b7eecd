//! A walk at work.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use foveal::allocation::policy::{Policy, RayPolicy};
use foveal::splatting::supersampling::Supersampling;
use foveal_actors::renderer::Renderer;
use foveal_engine::foveal::display::tone::ToneMap;
use foveal_engine::light::{BakeOptions, Reading};
use foveal_engine::recording::TRACERS_MAX;
use foveal_engine::{Engine, Failure, Light, Options, Recording, Settings};
use numpy::PyArray3;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::beside::{Beside, Wanted};
use crate::camera::{Camera, Path};
use crate::failure::existing;
use crate::frame::{Frame, Known};
use crate::pictures::radiance;

/// Time that actors have to come to rest at the end.
const END: Duration = Duration::from_secs(20);
/// Frames of a view that is waited for.
const WAITING: Duration = Duration::from_millis(100);

/// A walk; `None` once it is closed.
#[pyclass(frozen, module = "foveal")]
pub struct Walk {
    engine: Beside<Option<Engine>>,
    title: String,
    cameras: Vec<(String, Camera)>,
    paths: Vec<Path>,
    objects: Vec<String>,
    size: [u32; 2],
}

/// Opens a scene and starts its actors.
#[pyfunction]
#[pyo3(signature = (
    scene, *, size = (512, 512), tracers = None, policy = "utility", seed = 0, fps = None, baked = false, quick = false,
    bake = None, cache = None, variant = None, texture_budget = None, refine = None, refine_samples = 256, record = None
))]
#[expect(clippy::too_many_arguments, reason = "keywords of Python")]
pub fn open(
    py: Python<'_>,
    scene: PathBuf,
    size: (u32, u32),
    tracers: Option<u32>,
    policy: &str,
    seed: u64,
    fps: Option<f32>,
    baked: bool,
    quick: bool,
    bake: Option<PathBuf>,
    cache: Option<PathBuf>,
    variant: Option<String>,
    texture_budget: Option<u64>,
    refine: Option<f32>,
    refine_samples: u32,
    record: Option<PathBuf>,
) -> PyResult<Walk> {
    existing(&scene)?;
    let [width, height] = crate::pictures::size(size)?;
    let policy: Policy = policy.parse().map_err(PyValueError::new_err)?;
    let wrong = |what: &str| Err(PyValueError::new_err(what.to_owned()));
    if fps.is_some_and(|fps| !(fps > 0.0 && fps < 1e6)) {
        return wrong("fps: a number above 0 and below 1000000 is needed");
    }
    if refine.is_some_and(|noise| !(0.0..=1.0).contains(&noise)) || !(1..=1 << 16).contains(&refine_samples) {
        return wrong("refine: a noise from 0 to 1, with 1 to 65536 samples");
    }
    let cores = std::thread::available_parallelism().map_or(1, usize::from) as u32;
    let tracers = tracers.unwrap_or(cores.min(TRACERS_MAX));
    if !(1..=TRACERS_MAX).contains(&tracers) {
        return Err(PyValueError::new_err(format!("tracers: 1 to {TRACERS_MAX}")));
    }
    let settings = Settings {
        policy: RayPolicy::new(policy, seed),
        seed,
        supersampling: refine.map(|noise| Supersampling { noise, max_samples: refine_samples }),
        ..Settings::new(width, height, tracers)
    };
    let reading = Reading { variant, ..Reading::default() };
    let light =
        Light { bake, quick, baked, cache, settings: BakeOptions::default(), reading, ..Light::default() };
    let recording = record.map(|file| Recording::file(file, "python"));
    let engine = Beside::spawn(py, move |_| {
        let options =
            Options { light, fps, texture_bytes: texture_budget, recording, ..Options::new(settings) };
        Engine::open(&scene, options, &()).map(Some)
    })?;
    let (title, cameras, paths, objects) = engine.ask(py, |engine, _| {
        let scene = &at_work(engine)?.opened().world.scene;
        let cameras: Vec<_> = scene.cameras.iter().map(|c| (c.name.clone(), Camera(c.camera))).collect();
        let Some(like) = scene.cameras.first().map(|c| c.camera) else {
            return Err(Failure::Input("the scene has no camera".into()));
        };
        let paths = scene.paths.iter().map(|path| Path { path: path.clone(), like }).collect();
        Ok((scene.title.clone(), cameras, paths, scene.objects.iter().map(|o| o.name.clone()).collect()))
    })?;
    Ok(Walk { engine, title, cameras, paths, objects, size: [width, height] })
}

fn at_work(engine: &mut Option<Engine>) -> Result<&mut Engine, Failure> {
    engine.as_mut().ok_or_else(|| Failure::Usage("the walk is closed".into()))
}

/// A frame, and what is known of it.
fn frame(
    engine: &mut Engine,
    camera: Camera,
    time: Duration,
    enough: impl FnMut(&Renderer) -> bool,
) -> Result<Frame, Failure> {
    let began = Instant::now();
    let shown = engine.frame_until(&camera.0, time, None, enough)?;
    let seconds = began.elapsed().as_secs_f64();
    let tone = ToneMap::from(&engine.opened().world.scene.display);
    let insight = engine.insight().cloned();
    let known = engine.look(|r| Known::new(Some(r), insight.as_ref(), &tone)).unwrap_or_default();
    Ok(Frame::shown(&shown, camera, seconds, known))
}

fn duration(seconds: f64) -> PyResult<Duration> {
    match Duration::try_from_secs_f64(seconds) {
        Ok(time) if seconds <= 1e6 => Ok(time),
        _ => Err(PyValueError::new_err(format!("{seconds}: seconds from 0 to 1000000 are needed"))),
    }
}

#[pymethods]
impl Walk {
    #[getter]
    fn title(&self) -> &str {
        &self.title
    }

    #[getter]
    fn size(&self) -> (u32, u32) {
        self.size.into()
    }

    #[getter]
    fn cameras<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let cameras = PyDict::new(py);
        for (name, camera) in &self.cameras {
            cameras.set_item(name, *camera)?;
        }
        Ok(cameras)
    }

    #[getter]
    fn paths<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let paths = PyDict::new(py);
        for path in &self.paths {
            paths.set_item(&path.path.name, path.clone())?;
        }
        Ok(paths)
    }

    #[getter]
    fn objects(&self) -> Vec<String> {
        self.objects.clone()
    }

    #[getter]
    fn warnings(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        self.engine.ask(py, |engine, _| Ok(at_work(engine)?.warnings()))
    }

    #[pyo3(signature = (camera, deadline = 0.1))]
    fn frame(&self, py: Python<'_>, camera: Camera, deadline: f64) -> PyResult<Frame> {
        let time = duration(deadline)?;
        self.engine.ask(py, move |engine, wanted| frame(at_work(engine)?, camera, time, |_| !wanted.is()))
    }

    #[pyo3(signature = (camera, timeout = 600.0))]
    fn converge(&self, py: Python<'_>, camera: Camera, timeout: f64) -> PyResult<Frame> {
        let end = duration(timeout)?;
        self.engine.ask(py, move |engine, wanted| converged(at_work(engine)?, camera, end, wanted))
    }

    fn radiance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let picture = self.engine.ask(py, |engine, _| {
            let picture = at_work(engine)?.look(Renderer::picture).flatten();
            picture.ok_or_else(|| Failure::Usage("no frame was shown yet".into()))
        })?;
        radiance(py, &picture)
    }

    fn close(&self, py: Python<'_>) -> PyResult<()> {
        self.engine.ask(py, |engine, _| match engine.take() {
            // What was not brought to rest is dropped, and its recording has what came until then.
            Some(mut engine) => {
                engine.finish(END);
                Ok(())
            }
            None => Ok(()),
        })
    }

    fn __enter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    #[pyo3(signature = (*_why))]
    fn __exit__(&self, py: Python<'_>, _why: &Bound<'_, pyo3::types::PyTuple>) -> PyResult<()> {
        self.close(py)
    }

    fn __repr__(&self) -> String {
        format!("<foveal.Walk {:?}, {} × {}>", self.title, self.size[0], self.size[1])
    }
}

/// Frames until the view has all that it gets.
fn converged(engine: &mut Engine, camera: Camera, end: Duration, wanted: &Wanted) -> Result<Frame, Failure> {
    let began = Instant::now();
    loop {
        let shown = frame(engine, camera, WAITING, |r| r.is_refined() || !wanted.is())?;
        if engine.look(|r| r.is_refined() && r.is_shown()) == Some(true) {
            return Ok(shown);
        }
        if !wanted.is() {
            return Err(Failure::Interrupted("interrupted".into()));
        }
        if began.elapsed() >= end {
            return Err(Failure::Limit(format!("the view has not converged within {} s", end.as_secs_f64())));
        }
    }
}
