//! Light that is made once and kept.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use foveal::geometry::Accel;
use foveal::illumination::bake::{Baker, cache_key};
use foveal::illumination::statement::statement;
use foveal::transport::Indexed;
use foveal::transport::light::Lights;
use foveal_engine::Failure;
use foveal_engine::bake_clock::BakeClock;
use foveal_engine::files::make_folder;
use foveal_engine::light::BakeOptions;
use foveal_engine::opened::{cache_file, load_scene};
use foveal_files::bakes::{load_illumination, save};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::beside::wait_for;
use crate::failure::existing;

/// Light that was made, and where it is kept.
#[pyclass(frozen, get_all, module = "foveal")]
pub struct Bake {
    file: PathBuf,
    error: f32,
    complete: bool,
    cached: bool,
    texels: usize,
    seconds: f64,
    warnings: Vec<String>,
}

#[pymethods]
impl Bake {
    fn __repr__(&self) -> String {
        format!("<foveal.Bake {}, error {:.2} %>", self.file.display(), 100.0 * self.error)
    }
}

/// Makes the light that diffuse surfaces receive, or finds it where it is kept.
#[pyfunction]
#[pyo3(signature = (scene, *, error = 0.02, time = None, texels = None, seed = 1, out = None, cache = None, again = false))]
#[expect(clippy::too_many_arguments, reason = "keywords of Python")]
pub fn bake(
    py: Python<'_>,
    scene: PathBuf,
    error: f32,
    time: Option<f64>,
    texels: Option<u32>,
    seed: u64,
    out: Option<PathBuf>,
    cache: Option<PathBuf>,
    again: bool,
) -> PyResult<Bake> {
    existing(&scene)?;
    let wrong = |what: String| Err(PyValueError::new_err(what));
    if !(error > 0.0 && error.is_finite()) {
        return wrong(format!("error: {error} is not a share above 0, as 0.02"));
    }
    if texels.is_some_and(|texels| !(1..=1 << 26).contains(&texels)) {
        return wrong("texels: 1 to 67108864".into());
    }
    let time = match time.map(Duration::try_from_secs_f64).transpose() {
        Ok(time) => time,
        Err(e) => return wrong(format!("time: {e}")),
    };
    wait_for(py, move |wanted| {
        let start = Instant::now();
        let (scene, mut warnings) = load_scene(&scene)?;
        let settings =
            BakeOptions { error, texels, bake_seed: seed, ..BakeOptions::default() }.settings(&scene);
        let key = cache_key(&scene, &settings);
        let kept = cache_file(cache.as_deref(), &scene, &settings);
        let Some(file) = out.or_else(|| kept.clone()) else {
            return Err(Failure::Usage(
                "no place to keep the bake: give `out` or `cache`, or set FOVEAL_CACHE".into(),
            ));
        };
        let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
        let indexed = Indexed { scene: &scene, accel: &accel, lights: &lights };
        let found = kept.filter(|kept| !again && kept.exists());
        let found = found.and_then(|kept| load_illumination(&kept, &key, scene.mesh.triangles.len()).ok());
        let cached = found.is_some();
        let (map, complete) = match found {
            Some(map) => (map, true),
            None => {
                let clock = BakeClock::new(start, &(), time, (error, settings.particles.unwrap_or(0)));
                let baked = Baker::new(indexed, &settings).run(
                    indexed,
                    &|p| {
                        clock.at(p);
                        wanted.is() && !clock.is_over()
                    },
                    &mut |_| {},
                );
                clock.finish();
                (baked.illumination, baked.complete)
            }
        };
        if !wanted.is() {
            return Err(Failure::Interrupted("interrupted".into()));
        }
        // A bake that was cut short lies where no walk takes it for a whole one, unless a place was named for it.
        let file = match complete || Some(&file) != cache_file(cache.as_deref(), &scene, &settings).as_ref() {
            true => file,
            false => file.with_extension("partial.fvbake"),
        };
        if let Some(folder) = file.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            make_folder(folder)?;
        }
        save(&file, &key, &map).map_err(|e| Failure::file(&file, e))?;
        warnings.extend(map.summary.notes.iter().cloned());
        let measured = statement(indexed, &map, settings.seed).map_or(0.0, |m| m.at_least());
        Ok(Bake {
            error: map.summary.relative_error.max(measured),
            complete: complete && map.summary.relative_error <= error,
            cached,
            texels: map.element_count(),
            seconds: start.elapsed().as_secs_f64(),
            file,
            warnings,
        })
    })
}
