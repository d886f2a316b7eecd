//! `foveal bench error --what light`: how far still views are from the truth, by what was done for them.
//!
//! Each view is held against a picture of it that knows of no map ([`foveal::transport::bidirectional`], or one that lies in
//! the folder of judges, from whatever program): as it converges after a bake of a given time, and refined by numbers of
//! samples. Time is processor time over the cores, so that what else a machine does counts little. A judge has noise of its
//! own, which is told beside what was found and, where its batches say how much, taken off (in squares: both are differences of
//! the same kind).

use std::cell::Cell;
use std::f64::consts::FRAC_2_PI;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use clap::Args;
use foveal::display::FrameBuffers;
use foveal::display::cpu_pass::{self, Passes};
use foveal::geometry::Accel;
use foveal::illumination::bake::{Baked, Baker, Progress as Baking, Stage};
use foveal::image::{Map2d, luminance};
use foveal::metrics::{self, Batches, BlockErrors};
use foveal::scene::camera::CameraFrame;
use foveal::splatting::light_tracing::{LightSums, runs_for, trace_run};
use foveal::splatting::settled::{Interval, intervals, settled};
use foveal::splatting::supersampling::{Tiles, supersample};
use foveal::splatting::tile_sums::TileSums;
use foveal::transport::Indexed;
use foveal::transport::light::Lights;
use foveal::world::World;
use glam::Vec3;
use rayon::prelude::*;

use super::error::ErrorArguments;
use super::made::Subject;
use foveal_engine::failure::Failure;
use foveal_engine::files::{
    exr_bytes, make_folder, png_bytes, read_batches, read_picture, write_atomic, write_batches,
};
use foveal_engine::interrupt::{interrupted, uninterrupted};
use foveal_engine::light::BakeOptions;
use foveal_engine::opened::{camera, load_scene};
use foveal_engine::process::cpu_ns;
use foveal_engine::reference::{Enough, sampled_bidirectional, traced_picture};
use foveal_terminal::arguments::{duration, share};
use foveal_terminal::progress::Progress;
use foveal_terminal::table::{Aim, Row, finish};

/// Pixels along an edge of the blocks whose means are compared.
const BLOCK: usize = 8;
/// Relative error that a picture of errors shows in full colour.
const FULL: f32 = 0.3;
/// Standard errors of a judge at 95 % confidence, two-sided.
const Z_95_TWO_SIDED: f64 = 1.96;
/// Seed of all random numbers but the judges'.
const SEED: u64 = 0;
/// Seed of the judges.
const JUDGE_SEED: u64 = 77;
/// Share of a bake's time that its last map is smoothed in, before it is known what that takes.
const RESERVE: f64 = 1.0 / 6.0;

/// What only `--what light` asks for.
#[derive(Args, Debug)]
pub(super) struct LightArguments {
    /// With --what light: samples per pixel at which refined pictures are compared with the reference; 0 for none
    #[arg(long, value_name = "NUMBERS", value_delimiter = ',', default_value = "64")]
    refined: Vec<u32>,
    /// With --what light: also refine for this time
    #[arg(long, value_name = "TIME", value_parser = duration)]
    refine_time: Option<Duration>,
    /// With --what light: folder of reference pictures, SCENE-CAMERA.exr; missing ones are rendered and kept there
    #[arg(long, value_name = "DIR")]
    judges: Option<PathBuf>,
    /// With --what light: relative standard error of block means at which a reference is good enough
    #[arg(long, value_name = "SHARE", default_value = "1%", value_parser = share)]
    judge_error: f32,
    /// With --what light: limit on the time for each reference
    #[arg(long, value_name = "TIME", default_value = "60s", value_parser = duration)]
    judge_time: Duration,
    /// With --what light: use all cameras of each scene, not only the first
    #[arg(long)]
    all_cameras: bool,
}

/// Processor seconds of this program so far, over the cores.
fn seconds() -> f64 {
    cpu_ns() * 1e-9 / std::thread::available_parallelism().map_or(1, usize::from) as f64
}

/// A picture that a view should be, and how unsure its blocks are.
struct ReferencePicture {
    picture: Map2d<Vec3>,
    noise: f64,
    batches: Option<Batches>,
}

impl ReferencePicture {
    /// The one that is kept, or a new one, which is kept.
    fn of(a: &ErrorArguments, world: &World, frame: &CameraFrame, name: &str) -> Result<Self, Failure> {
        let file = a.light.judges.as_ref().map(|folder| folder.join(format!("{name}.exr")));
        if let Some(file) = file.as_deref().filter(|file| file.exists()) {
            let (picture, batches) = (read_picture(file)?, read_batches(file)?);
            if [picture.width() as u32, picture.height() as u32] != frame.size {
                let [w, h] = frame.size;
                let message = format!("{}: {w}×{h} pixels are asked for", file.display());
                return Err(Failure::Input(message));
            }
            return Ok(Self {
                picture,
                noise: batches.as_ref().map_or(0.0, Batches::relative_error),
                batches,
            });
        }
        let enough = Enough {
            samples: 16,
            error: Some(f64::from(a.light.judge_error)),
            time: Some(a.light.judge_time),
        };
        let sampled = sampled_bidirectional(world, frame, JUDGE_SEED, &enough, &|| !interrupted());
        uninterrupted()?;
        if let Some(file) = file {
            make_folder(file.parent().unwrap_or(Path::new(".")))?;
            write_atomic(&file, &exr_bytes(&sampled.picture)?)?;
            if let Some(batches) = &sampled.batches {
                write_batches(&file, batches)?;
            }
        }
        let noise = sampled.batches.as_ref().map_or(0.0, Batches::relative_error);
        Ok(Self { picture: sampled.picture, noise, batches: sampled.batches })
    }

    /// How far a picture is from it: mean relative error of blocks without its own noise, share off by more than 10 %, FLIP.
    fn of_picture(&self, world: &World, picture: &Map2d<Vec3>) -> Result<Off, Failure> {
        let tone = foveal::display::tone::ToneMap::from(&world.scene.display);
        let compared = metrics::compare(picture, &self.picture, &tone);
        let Some(blocks) = metrics::block_errors(picture, &self.picture, BLOCK) else {
            return Err(Failure::Usage(format!("--size: not one block of {BLOCK} × {BLOCK} pixels fits")));
        };
        let flip = compared.map_err(|e| Failure::Input(e.to_string()))?.flip;
        // The mean absolute value of what has that deviation.
        let noise = self.noise * FRAC_2_PI.sqrt();
        let mean = (blocks.mean.powi(2) - noise.powi(2)).max(0.0).sqrt();
        Ok(Off { mean, flip, blocks, root: self.root(picture) })
    }

    /// Root mean square error of blocks beside their mean, without the judge's noise: what a picture's own statement is about.
    fn root(&self, picture: &Map2d<Vec3>) -> f64 {
        let shown = Batches::exact(picture, BLOCK);
        let kept = Batches::exact(&self.picture, BLOCK);
        let noise = self.batches.as_ref().map_or(0.0, |b| b.statistics().map(|s| s.1 * s.1).sum::<f64>());
        let pairs = || shown.statistics().zip(kept.statistics()).map(|(a, b)| (a.0, b.0));
        let (count, total) = (shown.means.len().max(1) as f64, pairs().map(|p| p.1).sum::<f64>());
        let squares = pairs().map(|(a, b)| (a - b).powi(2)).sum::<f64>() - noise;
        (squares.max(0.0) / count).sqrt() / (total / count).max(f64::MIN_POSITIVE)
    }

    /// Share of blocks whose truth lies in their interval, which is as much wider as the judge is unsure. `None` where nothing
    /// says how unsure it is.
    fn covered(&self, intervals: &[Interval]) -> Option<f64> {
        let batches =
            self.batches.as_ref().filter(|b| b.size == BLOCK && b.means.len() == intervals.len())?;
        let within = |(interval, (mean, error)): (&Interval, (f64, f64))| {
            let reach = f64::from(interval.reach).hypot(Z_95_TWO_SIDED * error);
            (f64::from(interval.mean) - mean).abs() <= reach
        };
        let count = intervals.iter().zip(batches.statistics()).filter(|pair| within(*pair)).count();
        Some(count as f64 / intervals.len().max(1) as f64)
    }
}

/// How far a picture is from the truth.
struct Off {
    mean: f64,
    root: f64,
    flip: f64,
    blocks: BlockErrors,
}

/// A bake of so many seconds of all cores, the last map's smoothing among them.
fn baked(indexed: Indexed<'_>, time: f64) -> Baked {
    let settings = BakeOptions::default().settings(indexed.scene);
    let settings = foveal::illumination::bake::BakeSettings { error: None, particles: None, ..settings };
    let start = seconds();
    // Seconds as bits: when smoothing began, and what it took last.
    let (began, reserve) = (AtomicU64::new(f64::NAN.to_bits()), AtomicU64::new((RESERVE * time).to_bits()));
    let of = |a: &AtomicU64| f64::from_bits(a.load(Ordering::Relaxed));
    let keep_going = |p: &Baking| {
        let now = seconds() - start;
        let since = of(&began);
        match (p.stage == Stage::Smooth, since.is_nan()) {
            (true, true) => began.store(now.to_bits(), Ordering::Relaxed),
            (false, false) => {
                reserve.store((now - since).to_bits(), Ordering::Relaxed);
                began.store(f64::NAN.to_bits(), Ordering::Relaxed);
            }
            _ => {}
        }
        !interrupted() && now + of(&reserve) < time
    };
    Baker::new(indexed, &settings).run(indexed, &keep_going, &mut |_| {})
}

/// A view that is refined by more and more samples of each pixel.
struct Refining<'w> {
    world: &'w World,
    frame: CameraFrame,
    buffers: FrameBuffers,
    converged: Map2d<Vec3>,
    tiles: Vec<Option<Arc<TileSums>>>,
    traced: Option<LightSums>,
    runs: u32,
    samples: u32,
    seed: u64,
}

impl<'w> Refining<'w> {
    fn new(world: &'w World, frame: CameraFrame, converged: Map2d<Vec3>, seed: u64) -> Self {
        let [width, height] = frame.size;
        let mut buffers = FrameBuffers::new(width as usize, height as usize);
        cpu_pass::draw(world, &frame, Passes { texture_ids: false }, &mut buffers);
        let pixels = (width * height) as usize;
        let traced = world.caustics().is_possible().then(|| LightSums::new(world, pixels));
        let tiles = vec![None; Tiles::of_size(width, height).len()];
        Self { world, frame, buffers, converged, tiles, traced, runs: 0, samples: 0, seed }
    }

    /// Takes samples until there are so many of each pixel.
    fn refine(&mut self, samples: u32) {
        /// Runs of particles that are held at once.
        const TOGETHER: u32 = 64;
        let count = samples.saturating_sub(self.samples);
        let (world, frame, seed) = (self.world, &self.frame, self.seed);
        self.tiles.par_iter_mut().enumerate().for_each(|(tile, sums)| {
            let on = sums.take();
            *sums = Some(Arc::new(supersample(world, frame, tile as u32, on.as_deref(), count, seed)));
        });
        self.samples += count;
        if let Some(traced) = &mut self.traced {
            let pixels = frame.size.iter().map(|s| *s as usize).product();
            let runs = runs_for(self.samples, pixels);
            for first in (self.runs..runs).step_by(TOGETHER as usize) {
                let some = first..runs.min(first + TOGETHER);
                let found: Vec<_> =
                    some.into_par_iter().map(|run| trace_run(world, frame, run, seed, &|| true)).collect();
                found.iter().flatten().for_each(|splats| traced.add(splats));
            }
            self.runs = runs;
        }
    }

    /// Where its blocks are by samples alone.
    fn intervals(&self) -> Vec<Interval> {
        intervals(self.frame.size, &self.tiles, self.traced.as_ref())
    }

    /// What it shows now, and what that is said to be off by at most.
    fn picture(&self) -> (Map2d<Vec3>, f32) {
        let traced = self.traced.as_ref();
        let made = settled(self.world, &self.frame, &self.buffers, &self.tiles, traced, &|| true);
        let Some(settled) = made else { return (self.converged.clone(), f32::INFINITY) };
        let pixel = |x, y| settled.pixel(x, y, self.buffers.color.at(x, y), self.converged.at(x, y));
        let [width, height] = self.frame.size.map(|s| s as usize);
        (Map2d::from_fn(width, height, pixel), settled.stated)
    }
}

/// Rows of one view, and what counts in the means of all.
struct Report<'a> {
    a: &'a ErrorArguments,
    rows: Vec<Row>,
    /// By stage: its name and each view's error.
    stages: Vec<(String, Vec<f64>)>,
}

impl Report<'_> {
    /// Holds a picture against its judge.
    fn add(
        &mut self,
        (view, stage): (&str, &str),
        (world, judge): (&World, &ReferencePicture),
        picture: &Map2d<Vec3>,
        took: f64,
        stated: f32,
    ) -> Result<(), Failure> {
        let off = judge.of_picture(world, picture)?;
        self.rows.push(Row::new(format!("{view}, {stage}: blocks"), "", &[off.mean]));
        let mut root = Row::new(format!("{view}, {stage}: root mean square"), "", &[off.root]);
        // A bake that is stopped by its time has not said anything yet.
        if stated.is_finite() && stated > 0.0 {
            root = root.against("stated at most", Some(f64::from(stated)));
        }
        self.rows.push(root);
        let more = [
            (off.blocks.over_10_percent, "share off by more than 10 %", ""),
            (off.blocks.bias, "all light together", ""),
            (off.flip, "FLIP", ""),
            (took, "seconds of all cores", "s"),
        ];
        for (value, what, unit) in more {
            self.rows.push(Row::new(format!("{view}, {stage}: {what}"), unit, &[value]));
        }
        match self.stages.iter_mut().find(|s| s.0 == stage) {
            Some(s) => s.1.push(off.mean),
            None => self.stages.push((stage.to_owned(), vec![off.mean])),
        }
        if let Some(out) = &self.a.common.out {
            make_folder(out)?;
            let file = out.join(format!("{view}-{}.png", stage.replace(' ', "-")));
            let size = (3 * picture.width() as u32, picture.height() as u32);
            write_atomic(&file, &png_bytes(size.0, size.1, &beside(world, picture, &judge.picture))?)?;
            // For other judges.
            write_atomic(&file.with_extension("exr"), &exr_bytes(picture)?)?;
        }
        Ok(())
    }
}

/// Shown, reference, and the relative error of blocks side by side, red where too dark, blue where too bright.
fn beside(world: &World, shown: &Map2d<Vec3>, reference: &Map2d<Vec3>) -> Vec<u8> {
    let tone = foveal::display::tone::ToneMap::from(&world.scene.display);
    let (width, height) = (shown.width(), shown.height());
    let mean = |of: &Map2d<Vec3>, x: usize, y: usize| {
        let (x0, y0) = (x / BLOCK * BLOCK, y / BLOCK * BLOCK);
        let pixels =
            (y0..(y0 + BLOCK).min(height)).flat_map(|y| (x0..(x0 + BLOCK).min(width)).map(move |x| (x, y)));
        pixels.map(|(x, y)| luminance(of.at(x, y))).sum::<f32>()
    };
    let mut bytes = Vec::with_capacity(9 * width * height);
    for y in 0..height {
        for of in [shown, reference] {
            bytes.extend((0..width).flat_map(|x| tone.to_rgb8(of.at(x, y))));
        }
        for x in 0..width {
            let (s, r) = (mean(shown, x, y), mean(reference, x, y));
            let off = ((s - r) / r.max(1e-9) / FULL).clamp(-1.0, 1.0);
            let byte = |v: f32| (255.0 * v) as u8;
            bytes.extend(if off < 0.0 { [byte(-off), 0, 0] } else { [0, byte(0.3 * off), byte(off)] });
        }
    }
    bytes
}

/// Runs the benchmark.
pub(super) fn run(a: &ErrorArguments, scenes: &[String], progress: Progress) -> Result<(), Failure> {
    let bar = progress.bar(scenes.len() as u64, "scenes");
    let mut report = Report { a, rows: Vec::new(), stages: Vec::new() };
    for word in scenes {
        let subject = Subject::of(word)?;
        let (scene, _) = load_scene(subject.path())?;
        let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
        let start = seconds();
        let light = baked(Indexed { scene: &scene, accel: &accel, lights: &lights }, a.time.as_secs_f64());
        let took = seconds() - start;
        uninterrupted()?;
        let said = light.illumination.summary.relative_error;
        let world = World::new(scene.clone(), Arc::new(light.illumination));
        let cameras: Vec<_> = match a.light.all_cameras {
            true => scene.cameras.iter().collect(),
            false => vec![camera(&scene, None)?],
        };
        for view in cameras {
            let name = format!("{}-{}", Subject::name(word), view.name);
            let frame = view.camera.frame(a.size.width, a.size.height);
            let judge = ReferencePicture::of(a, &world, &frame, &name)?;
            report.rows.push(Row::new(format!("{name}: noise of the judge"), "", &[judge.noise]));
            let converged = traced_picture(&world, &frame, SEED, 1, &|| !interrupted()).picture;
            let with = (&world, &judge);
            report.add((&name, "converged"), with, &converged, took, said)?;
            refined(a, &mut report, &name, with, (&frame, converged))?;
        }
        bar.inc(1);
        uninterrupted()?;
    }
    bar.finish_and_clear();
    let mut rows = std::mem::take(&mut report.rows);
    for (stage, errors) in &report.stages {
        let mean = errors.iter().sum::<f64>() / errors.len().max(1) as f64;
        let worst = errors.iter().copied().fold(0.0, f64::max);
        rows.push(Row::new(format!("mean of all views, {stage}: blocks"), "", &[mean]));
        let aim = if stage == "converged" { 0.06 } else { 0.02 };
        rows.push(Row::new(format!("worst view, {stage}: blocks"), "", &[worst]).aim(Aim::AtMost(aim)));
    }
    let notes = vec![format!(
        "mean relative error of the means of blocks of {BLOCK} × {BLOCK} pixels; bakes of {:.1} s of all cores, {} × {} pixels",
        a.time.as_secs_f64(),
        a.size.width,
        a.size.height
    )];
    finish("error-light", &rows, &notes, &a.common)
}

/// The stages of refinement that are asked for.
fn refined(
    a: &ErrorArguments,
    report: &mut Report<'_>,
    name: &str,
    with: (&World, &ReferencePicture),
    (frame, converged): (&CameraFrame, Map2d<Vec3>),
) -> Result<(), Failure> {
    let mut view = Refining::new(with.0, *frame, converged, SEED);
    let spent = Cell::new(0.0);
    let timed = |view: &mut Refining<'_>, samples: u32| {
        let start = seconds();
        view.refine(samples);
        spent.set(spent.get() + seconds() - start);
    };
    let mut numbers = a.light.refined.clone();
    numbers.sort_unstable();
    for samples in numbers.into_iter().filter(|n| *n > 0) {
        timed(&mut view, samples);
        uninterrupted()?;
        let (picture, stated) = view.picture();
        let stage = format!("{samples} samples");
        report.add((name, &stage), with, &picture, spent.get(), stated)?;
        if let Some(covered) = with.1.covered(&view.intervals()) {
            let what = format!("{name}, {stage}: share of blocks within their intervals of 95 %");
            report.rows.push(Row::new(what, "", &[covered]));
        }
    }
    if let Some(time) = a.light.refine_time.map(|t| t.as_secs_f64()) {
        while spent.get() < time && !interrupted() {
            // As many as there is time for, by what the former ones took; fours fill all batches alike.
            let each = spent.get() / f64::from(view.samples.max(1));
            let left = if each > 0.0 { ((time - spent.get()) / each) as u32 } else { 8 };
            if left < 2 {
                break;
            }
            let more = left.min(view.samples.max(8)).next_multiple_of(4);
            let samples = view.samples + more;
            timed(&mut view, samples);
        }
        uninterrupted()?;
        let (picture, stated) = view.picture();
        report.add((name, "refined by time"), with, &picture, spent.get(), stated)?;
        let reached = [f64::from(view.samples)];
        report.rows.push(Row::new(format!("{name}, refined by time: samples per pixel"), "", &reached));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use foveal::illumination::first::first_picture;
    use foveal::metrics::BATCHES;

    /// What is stated of the pictures of these rooms, under their first light and refined, held against a reference of so
    /// many samples in each batch: how many statements there were, how many of these hold, and the share of blocks in their
    /// intervals.
    fn stated(
        rooms: &[&str],
        size: [u32; 2],
        reference: u32,
        (samples, seeds): (&[u32], u64),
    ) -> (u32, u32, f64) {
        let (mut all, mut hold, mut covered, mut pictures) = (0, 0, 0.0, 0.0);
        for room in rooms {
            let (scene, _) = load_scene(Subject::of(room).expect("a room").path()).expect("a scene");
            let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
            let first = first_picture(Indexed { scene: &scene, accel: &accel, lights: &lights }, 1);
            let world = World::new(scene.clone(), Arc::new(first));
            let frame = camera(&scene, None).expect("a camera").camera.frame(size[0], size[1]);
            let enough = Enough::samples(reference * BATCHES as u32);
            let sampled = sampled_bidirectional(&world, &frame, JUDGE_SEED, &enough, &|| true);
            let judge = ReferencePicture { noise: 0.0, picture: sampled.picture, batches: sampled.batches };
            for seed in 0..seeds {
                let converged = traced_picture(&world, &frame, seed, 1, &|| true).picture;
                let mut view = Refining::new(&world, frame, converged, seed);
                for &n in samples {
                    view.refine(n);
                    let (picture, limit) = view.picture();
                    let off = judge.root(&picture);
                    let within = judge.covered(&view.intervals()).expect("batches");
                    println!(
                        "{room}, seed {seed}, {n} samples: {off:.4}, at most {limit:.4}; {within:.3} within"
                    );
                    (all, hold) = (all + 1, hold + u32::from(f64::from(limit) >= off));
                    (covered, pictures) = (covered + within, pictures + 1.0);
                }
            }
        }
        (all, hold, covered / pictures)
    }

    #[test]
    fn rooms_of_all_kinds_are_read_as_they_are_meant() {
        for (name, _) in foveal_scenes::KINDS {
            let (scene, warnings) = load_scene(Subject::of(name).expect("a room").path()).expect("a scene");
            assert!(warnings.is_empty(), "{name}: {warnings:?}");
            assert!(scene.mesh.triangles.len() > 50 && !Lights::build(&scene).is_empty(), "{name}");
        }
    }

    /// Few pictures of two rooms, for every day.
    #[test]
    fn what_is_stated_of_rooms_holds() {
        let (all, hold, covered) = stated(&["checks", "shade"], [32, 24], 12, (&[16], 2));
        assert!(hold + 1 >= all, "{hold} of {all}");
        assert!(covered > 0.8, "{covered}");
    }

    /// Rooms of eight kinds, five seeds and three numbers of samples each: minutes.
    #[test]
    #[ignore = "takes minutes"]
    fn what_is_stated_of_rooms_of_all_kinds_holds() {
        let rooms = ["panes", "blinds", "shade", "uplight", "slits", "mirrors", "checks", "sheets"];
        let (all, hold, covered) = stated(&rooms, [64, 48], 64, (&[16, 64, 256], 5));
        assert!(20 * hold >= 19 * all, "{hold} of {all}");
        assert!((0.92..=0.98).contains(&covered), "{covered}");
    }
}
