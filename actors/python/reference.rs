//! Pictures without a budget.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use foveal::display::tone::ToneMap;
use foveal::illumination::Uniform;
use foveal::image::Map2d;
use foveal::metrics::Batches;
use foveal::world::World;
use foveal_engine::opened::{self, camera};
use foveal_engine::reference::{Enough, Sampled, sampled_bidirectional, sampled_paths, traced_picture};
use foveal_engine::{Failure, Light};
use glam::Vec3;
use numpy::PyArray3;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::beside::wait_for;
use crate::camera::Camera;
use crate::failure::existing;
use crate::pictures::{array3, radiance, size};

/// A picture without a budget.
#[pyclass(frozen, module = "foveal")]
pub struct Reference {
    picture: Map2d<Vec3>,
    tone: ToneMap,
    /// Samples of each pixel.
    #[pyo3(get)]
    samples: u32,
    #[pyo3(get)]
    error: Option<f64>,
    #[pyo3(get)]
    seconds: f64,
    #[pyo3(get)]
    kind: &'static str,
}

#[pymethods]
impl Reference {
    #[getter]
    fn radiance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        radiance(py, &self.picture)
    }

    #[getter]
    fn picture<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let shown = self.picture.map(|c| self.tone.to_rgb8(c));
        array3(py, shown.width(), shown.height(), shown.data().as_flattened().to_vec())
    }

    fn __repr__(&self) -> String {
        let (width, height) = (self.picture.width(), self.picture.height());
        format!("<foveal.Reference {}, {width} × {height}, {} samples>", self.kind, self.samples)
    }
}

/// Where it is seen from.
#[derive(FromPyObject)]
pub enum From {
    /// A camera of the scene.
    Named(String),
    /// Any.
    Camera(Camera),
}

/// Which gold standard.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Traced,
    Path,
    Truth,
}

/// Makes it.
#[pyfunction]
#[pyo3(signature = (
    scene, camera = None, *, kind = "traced", samples = 1, size = (512, 512), seed = 0, until_error = None, time = None,
    quick = false, bake = None, cache = None
))]
#[expect(clippy::too_many_arguments, reason = "keywords of Python")]
pub fn reference(
    py: Python<'_>,
    scene: PathBuf,
    camera: Option<From>,
    kind: &str,
    samples: u32,
    size: (u32, u32),
    seed: u64,
    until_error: Option<f64>,
    time: Option<f64>,
    quick: bool,
    bake: Option<PathBuf>,
    cache: Option<PathBuf>,
) -> PyResult<Reference> {
    existing(&scene)?;
    let [width, height] = self::size(size)?;
    let wrong = |what: String| Err(PyValueError::new_err(what));
    let (kind, name) = match kind {
        "traced" => (Kind::Traced, "traced"),
        "path" => (Kind::Path, "path"),
        "truth" => (Kind::Truth, "truth"),
        other => return wrong(format!("no reference is called \"{other}\": traced, path or truth")),
    };
    if !(1..=1 << 16).contains(&samples) {
        return wrong(format!("samples: {samples} is not from 1 to 65536"));
    }
    if until_error.is_some_and(|e| !(e > 0.0 && e.is_finite())) {
        return wrong("until_error: a share above 0 is needed, as 0.01".into());
    }
    if kind == Kind::Traced && (until_error.is_some() || time.is_some()) {
        return wrong("until_error and time are for path and truth".into());
    }
    let time = match time.map(Duration::try_from_secs_f64).transpose() {
        Ok(time) => time,
        Err(e) => return wrong(format!("time: {e}")),
    };
    wait_for(py, move |wanted| {
        let world = match kind {
            Kind::Traced => {
                let light = Light { baked: !quick, quick, bake, cache, ..Light::default() };
                opened::open(&scene, &light, &())?.world
            }
            Kind::Path | Kind::Truth => {
                World::new(opened::load_scene(&scene)?.0, Arc::new(Uniform(Vec3::ZERO)))
            }
        };
        let view = match camera {
            Some(From::Camera(camera)) => camera.0,
            Some(From::Named(name)) => self::camera(&world.scene, Some(&name))?.camera,
            None => self::camera(&world.scene, None)?.camera,
        };
        let frame = view.frame(width, height);
        let goes_on = || wanted.is();
        let enough = Enough { samples, error: until_error, time };
        let start = Instant::now();
        let (picture, samples, error) = match kind {
            Kind::Traced => {
                let refined = traced_picture(&world, &frame, seed, samples, &goes_on);
                (refined.picture, samples, Some(f64::from(refined.stated)).filter(|e| e.is_finite()))
            }
            Kind::Path => parted(sampled_paths(&world, &frame, seed, &enough, &goes_on)),
            Kind::Truth => parted(sampled_bidirectional(&world, &frame, seed, &enough, &goes_on)),
        };
        if !wanted.is() {
            return Err(Failure::Interrupted("interrupted".into()));
        }
        let (seconds, tone) = (start.elapsed().as_secs_f64(), ToneMap::from(&world.scene.display));
        Ok(Reference { picture, tone, samples, error, seconds, kind: name })
    })
}

fn parted(sampled: Sampled) -> (Map2d<Vec3>, u32, Option<f64>) {
    let error = sampled.batches.as_ref().map(Batches::relative_error);
    (sampled.picture, sampled.samples, error)
}
