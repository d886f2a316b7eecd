//! `foveal bench error --what illumination`: how fast the error of the baked illumination falls, by particles and by
//! hierarchical radiosity, against irradiance from unbiased paths.
//!
//! Time is the processor time of the whole program divided by the cores, so that what else the machine does counts
//! little; each point of a curve is the time to gather what it is made from and to make one map of it.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use foveal::geometry::Accel;
use foveal::illumination::bake::{BakeSettings, Baker, Step};
use foveal::illumination::error_map::ErrorMap;
use foveal::illumination::reference::{ReferencePoint, reference_points, relative_error};
use foveal::illumination::seen::{in_sight, seen};
use foveal::illumination::stored::Illumination;
use foveal::radiosity::of_scene::SceneRadiosity;
use foveal::scene::{Model, Reflectance, Scene};
use foveal::transport::Indexed;
use foveal::transport::light::Lights;
use glam::Vec3;
use plotters::prelude::*;

use super::made::{MadeScene, Subject};
use foveal_engine::failure::Failure;
use foveal_engine::files::{make_folder, png_bytes, write_atomic};
use foveal_engine::interrupt::interrupted;
use foveal_engine::light::BakeOptions;
use foveal_engine::opened::load_scene;
use foveal_engine::process::cpu_ns;
use foveal_terminal::progress::Progress;
use foveal_terminal::table::{Aim, CommonArguments, Row, finish, write_csv};

/// Points at which the truth is known.
const POINTS: usize = 160;
/// Samples at each of them.
const SAMPLES: u32 = 4096;
/// Pixels of the picture of errors, samples of each, and the side of the squares whose error is told.
const VIEW: [u32; 2] = [240, 180];
const VIEW_SAMPLES: u32 = 128;
const SQUARE: u32 = 6;
/// Triangles of the hall in which bounces are counted.
const HALL: usize = 300_000;
/// Paths sampled there.
const HALL_PATHS: u64 = 1 << 19;

/// Radiosity knows no reflections; without them both methods have the same truth.
const DIFFUSE_BOX: &str = "box, its balls black";

/// The scene with black surfaces in place of all that are not diffuse.
fn without_reflections(scene: &Scene) -> Scene {
    let mut scene = scene.clone();
    for material in &mut scene.materials {
        if !matches!(material.model, Model::Lambert { .. }) {
            material.model = Model::Lambert { albedo: Reflectance::constant(Vec3::ZERO) };
        }
    }
    scene
}

/// How the error fell.
struct ConvergenceCurve {
    name: String,
    /// Seconds of all cores, relative root mean square error against the truth, and the error claimed.
    points: Vec<(f64, f64, f64)>,
}

impl ConvergenceCurve {
    /// The first time at or below `error`.
    fn time_to(&self, error: f64) -> Option<f64> {
        self.points.iter().find(|p| p.1 <= error).map(|p| p.0)
    }

    /// The last error at or before `time`.
    fn error_at(&self, time: f64) -> Option<f64> {
        self.points.iter().take_while(|p| p.0 <= time).last().map(|p| p.1)
    }
}

/// Processor seconds of this program so far, over the cores; seconds on the wall where the system does not say.
fn seconds(since: Instant) -> f64 {
    let cores = std::thread::available_parallelism().map_or(1, usize::from) as f64;
    let busy = cpu_ns() * 1e-9 / cores;
    if busy.is_nan() { since.elapsed().as_secs_f64() } else { busy }
}

/// Runs the benchmark: `time` seconds for each scene and method.
pub fn run(scenes: &[String], time: f64, a: &CommonArguments, progress: Progress) -> Result<(), Failure> {
    let bar = progress.bar(scenes.len() as u64 + 1, "scenes");
    let (mut rows, mut curves) = (Vec::new(), Vec::new());
    let mut studies = Vec::new();
    for word in scenes {
        let (scene, _) = load_scene(Subject::of(word)?.path())?;
        if word == "box" {
            studies.push((DIFFUSE_BOX.to_owned(), Arc::new(without_reflections(&scene))));
        }
        studies.push((Subject::name(word).to_owned(), scene));
    }
    for (name, scene) in &studies {
        let (accel, lights) = (Accel::build(scene), Lights::build(scene));
        let indexed = Indexed { scene, accel: &accel, lights: &lights };
        let settings =
            BakeSettings { error: None, particles: None, ..BakeOptions::default().settings(scene) };
        let watched = seen(scene, &accel, 1 << 16);
        let atlas = Baker::new(indexed, &settings);
        let atlas = atlas.atlas();
        // Behind a lamp or under a ball nobody looks, and nobody's kernels may.
        let counts = |e: u32| {
            let element = &atlas.elements[e as usize];
            watched[element.triangle as usize] && in_sight(scene, &accel, element.position, element.normal)
        };
        let known = reference_points((scene, &accel, &lights), atlas, &counts, POINTS, SAMPLES, 1);
        let noise = known.iter().map(|t| f64::from(t.variance)).sum::<f64>().sqrt()
            / known.iter().map(|t| f64::from(t.irradiance.y).powi(2)).sum::<f64>().sqrt().max(1e-30);
        rows.push(Row::new(format!("{name}: noise of the truth itself"), "", &[noise]));
        let (curve, map) = by_gathering(name, indexed, &settings, &known, time);
        let mut found = vec![curve];
        if let (Some(out), Some(camera)) = (&a.out, scene.cameras.first()) {
            let parts = (&**scene, &accel, &lights);
            let view = ErrorMap::new(parts, &map, &camera.camera, VIEW, VIEW_SAMPLES);
            make_folder(out)?;
            let file = format!("illumination-{}.png", name.replace([',', ' '], "-"));
            write_atomic(&out.join(file), &png_bytes(3 * VIEW[0], VIEW[1], &view.picture())?)?;
            let what = format!("{name}: error of what a view shows, squares of {SQUARE} pixels");
            rows.push(Row::new(what, "", &[view.relative_error(SQUARE)]));
        }
        found.extend(by_radiosity(name, scene, &accel, &known, time));
        for curve in &found {
            if let Some(last) = curve.points.last() {
                let what = format!("{}: error after {:.1} s", curve.name, last.0);
                rows.push(Row::new(what, "", &[last.1]).against("claimed", Some(last.2)));
            }
        }
        if name == "box" {
            for (at, aim) in [(10.0, 0.02), (40.0, 0.01)] {
                if let Some(error) = found[0].error_at(at).filter(|_| time >= at) {
                    rows.push(Row::new(format!("box: error in {at} s"), "", &[error]).aim(Aim::AtMost(aim)));
                }
            }
        }
        if let Some(radiosity) = found.get(1).filter(|_| name == DIFFUSE_BOX) {
            let reached: Vec<f64> = radiosity.time_to(0.03).into_iter().collect();
            rows.push(
                Row::new(format!("{name} by radiosity: 3 % error after"), "s", &reached)
                    .aim(Aim::AtMost(5.0)),
            );
        }
        curves.extend(found);
        bar.inc(1);
        if interrupted() {
            break;
        }
    }
    rows.push(paths()?);
    bar.finish_and_clear();
    let notes = vec![format!(
        "relative root mean square error of irradiance at {POINTS} points against {SAMPLES} paths each; seconds of all \
         cores"
    )];
    if let Some(out) = &a.out {
        write(out, &curves)?;
    }
    finish("error-illumination", &rows, &notes, a)
}

fn by_gathering(
    name: &str,
    indexed: Indexed<'_>,
    settings: &BakeSettings,
    known: &[ReferencePoint],
    time: f64,
) -> (ConvergenceCurve, Illumination) {
    let start = Instant::now();
    let (mut apart, mut points) = (seconds(start), Vec::new());
    let mut baker = Baker::new(indexed, settings);
    loop {
        let map = match baker.step(indexed) {
            Step::Going => continue,
            Step::Better(map) | Step::Done(map) => map,
        };
        let now = seconds(start);
        let taken = now - apart;
        points.push((taken, relative_error(&*map, known), f64::from(map.summary.relative_error)));
        apart += seconds(start) - now;
        if taken >= time || interrupted() {
            return (
                ConvergenceCurve { name: format!("{name} by gathering"), points },
                Illumination::clone(&map),
            );
        }
    }
}

/// `None` where radiosity cannot light the scene.
fn by_radiosity(
    name: &str,
    scene: &Scene,
    accel: &Accel,
    known: &[ReferencePoint],
    time: f64,
) -> Option<ConvergenceCurve> {
    let start = Instant::now();
    let mut before = seconds(start);
    let mut solution = SceneRadiosity::new(scene, accel).ok()?;
    let (mut gathered, mut points) = (0.0, Vec::new());
    while gathered < time && !solution.is_exhausted() && !interrupted() {
        let claimed = solution.refine(scene, accel);
        gathered += seconds(start) - before;
        points.push((gathered, relative_error(&solution.mesh(scene), known), f64::from(claimed)));
        before = seconds(start);
    }
    Some(ConvergenceCurve { name: format!("{name} by radiosity"), points })
}

/// Paths per second in a large interior.
fn paths() -> Result<Row, Failure> {
    let hall = MadeScene::hall(HALL)?;
    let (scene, _) = load_scene(hall.path())?;
    let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
    let indexed = Indexed { scene: &scene, accel: &accel, lights: &lights };
    let settings = BakeSettings { particles: None, ..BakeOptions::default().settings(&scene) };
    let mut baker = Baker::new(indexed, &settings);
    // Not the first picture, which is over soon.
    baker.step(indexed);
    let start = Instant::now();
    let before = seconds(start);
    while baker.paths() < HALL_PATHS {
        baker.step(indexed);
    }
    let rate = baker.paths() as f64 / (seconds(start) - before).max(1e-3) / 1e6;
    let what = format!("paths in a hall of {} triangles", hall.triangles);
    Ok(Row::new(what, "million/s", &[rate]))
}

/// The curves as CSV and as a plot with logarithmic axes.
fn write(out: &Path, curves: &[ConvergenceCurve]) -> Result<(), Failure> {
    let points = curves.iter().flat_map(|c| c.points.iter().map(|p| (&c.name, p)));
    write_csv(&out.join("illumination-error.csv"), "what,seconds,error,claimed", points)?;
    if let Some(svg) = plot(curves) {
        write_atomic(&out.join("illumination-error.svg"), svg.as_bytes())?;
    }
    Ok(())
}

fn plot(curves: &[ConvergenceCurve]) -> Option<String> {
    let all = || curves.iter().flat_map(|c| &c.points).filter(|p| p.0 > 0.0 && p.1 > 0.0);
    let range = |of: fn(&(f64, f64, f64)) -> f64| {
        let (low, high) =
            all().map(of).fold((f64::INFINITY, 0.0f64), |(low, high), v| (low.min(v), high.max(v)));
        (low < high).then_some(0.8 * low..1.25 * high)
    };
    let (times, errors) = (range(|p| p.0)?, range(|p| p.1)?);
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (860, 480)).into_drawing_area();
        let mut chart = ChartBuilder::on(&root)
            .margin(8)
            .x_label_area_size(34)
            .y_label_area_size(56)
            .build_cartesian_2d(times.log_scale(), errors.log_scale())
            .ok()?;
        // Ticks are sums of steps: what rounding left of them is cut off.
        let rounded = |v: f64| (1e5 * v).round() / 1e5;
        chart
            .configure_mesh()
            .x_desc("seconds of all cores")
            .y_desc("error of irradiance")
            .x_label_formatter(&|t| rounded(*t).to_string())
            .y_label_formatter(&|e| format!("{} %", rounded(100.0 * e)))
            .light_line_style(TRANSPARENT)
            .draw()
            .ok()?;
        for (i, curve) in curves.iter().enumerate() {
            let color = Palette99::pick(i).to_rgba();
            let points = curve.points.iter().filter(|p| p.0 > 0.0 && p.1 > 0.0).map(|p| (p.0, p.1));
            chart
                .draw_series(LineSeries::new(points, color.stroke_width(2)).point_size(3))
                .ok()?
                .label(&curve.name)
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], color.stroke_width(2)));
        }
        // Errors fall from the upper left, and none is small at once.
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::LowerLeft)
            .background_style(WHITE)
            .border_style(BLACK)
            .draw()
            .ok()?;
        root.present().ok()?;
    }
    Some(svg)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plot_names_its_curves_and_has_short_ticks() {
        let curve = |name: &str, scale: f64| {
            let points = (0..9).map(|i| 3f64.powi(i - 5)).map(|t| (t, scale / t.cbrt(), 0.0)).collect();
            ConvergenceCurve { name: name.to_owned(), points }
        };
        let svg = plot(&[curve("one by particles", 0.02), curve("two by radiosity", 0.1)]).expect("a plot");
        for said in ["one by particles", "two by radiosity", "10 %", "seconds of all cores"] {
            assert!(svg.contains(said), "{said}");
        }
        assert!(!svg.contains("0000000") && !svg.contains("9999999"));
        assert!(plot(&[]).is_none());
    }
}
