//! `foveal bench error --plain`: the time until a still view looks right, beside what the same program does without any of
//! its ideas: all non-diffuse pixels in scan order, in √5 order, and path tracing of the full frame.
//!
//! Time is processor time, from the first ray of the view on; what only the order differs in shares its samples. Every
//! picture is held against a reference of its own kind: corrections against what the view converges to (or against many
//! samples per pixel with other random numbers), paths against many paths with other random numbers. While walking, each
//! frame has the same share of its samples' time in every order; of paths no walk is made, since its references would take
//! hours.

use foveal::allocation::policy::Policy;
use foveal::display::FrameBuffers;
use foveal::display::twin::{self, Passes};
use foveal::image::Map2d;
use foveal::scene::camera::CameraFrame;
use foveal::world::World;
use glam::Vec3;

use super::error::ErrorArguments;
use super::error_curves::{CSV_HEAD, Judge, Point, Way, csv, sections_of, write_page};
use super::made::Subject;
use super::stages::quick_world;
use super::study::{Entrant, FRAMES_PER_SECOND, Study, Traced, policies};
use super::table::{Aim, Row, finish, median};
use crate::cli::Progress;
use crate::cli::failure::Failure;
use crate::cli::reference::{path_picture, traced_picture};
use crate::processor_time::cpu_ns;

/// Mean FLIP of the non-diffuse pixels from which on a picture counts as right.
const RIGHT: f64 = 0.05;
/// Points of a curve.
const STEPS: u32 = 24;
/// Seed of references: not that of the pictures.
const SEED: u64 = 0x5eed;
/// What our order is held against, and how many times as long it should take at least.
const PEERS: [(&str, f64); 2] = [("scan order", 3.0), ("path tracing", 10.0)];

/// When a curve first is right, between its points; infinite where it never is.
fn time_to_right(points: &[Point]) -> f64 {
    let mut before: Option<&Point> = None;
    for p in points {
        if p.corrected.flip <= RIGHT {
            return match before {
                // Errors fall like powers of time, so on straight lines of logarithms.
                Some(b) if b.corrected.flip > p.corrected.flip && b.seconds > 0.0 => {
                    let gain = (b.corrected.flip / p.corrected.flip.max(1e-9)).ln();
                    let share = (b.corrected.flip / RIGHT).ln() / gain;
                    b.seconds * (p.seconds / b.seconds).powf(share)
                }
                _ => p.seconds,
            };
        }
        before = Some(p);
    }
    f64::INFINITY
}

/// When each run was right.
fn times_to_right(way: &Way) -> Vec<f64> {
    way.runs.iter().map(|r| time_to_right(r)).collect()
}

/// Everything that was measured in one scene; our order is the first of the ways.
struct Measured {
    still: Vec<Way>,
    walking: Vec<Way>,
    /// Of each way of walking, by run: just objectionable differences.
    jod: Vec<Vec<f64>>,
}

/// Runs the benchmark.
pub fn run(a: &ErrorArguments, scenes: &[String], progress: Progress) -> Result<(), Failure> {
    let bar = progress.bar(scenes.len() as u64 * u64::from(a.common.runs), "scenes");
    let (mut rows, mut sections, mut table) = (Vec::new(), Vec::new(), String::from(CSV_HEAD));
    let mut quotients: [Vec<f64>; 2] = Default::default();
    let mut notes = Vec::new();
    for word in scenes {
        let name = Subject::name(word);
        let world = quick_world(Subject::of(word)?.path())?;
        let mut study = Study::new(world, a.size, a.frames, true)?;
        if study.still().seconds() <= 0.0 {
            notes.push(format!("{name}: nothing that its first camera sees is corrected"));
            bar.inc(u64::from(a.common.runs));
            continue;
        }
        let measured = measure(a, &mut study, || bar.inc(1))?;
        rows.extend(rows_of(name, &measured));
        for ((peer, aim), quotients) in PEERS.into_iter().zip(&mut quotients) {
            if let Some(quotient) = quotient(&measured.still, peer) {
                let what = format!("{name}: {peer} takes at least this many times as long");
                rows.push(Row::new(what, "×", &[quotient]).aim(Aim::AtLeast(aim)));
                quotients.push(quotient);
            }
        }
        table += &csv(name, "still", &measured.still);
        table += &csv(name, "walking", &measured.walking);
        if let Some(out) = &a.common.out {
            let points = measured.still.first().and_then(|way| way.runs.first());
            let right = points.map_or(f64::INFINITY, |points| time_to_right(points));
            let last = points.and_then(|points| points.last()).map_or(0.0, |p| p.seconds);
            let end = f64::from(a.frames - 1) / f64::from(FRAMES_PER_SECOND);
            let shown = [if right.is_finite() { right } else { last }, end];
            let ways: [&[Way]; 2] = [&measured.still, &measured.walking];
            sections.extend(sections_of(out, name, ways, Some(RIGHT), shown, &study.tone)?);
        }
    }
    for ((peer, aim), quotients) in PEERS.into_iter().zip(&quotients).filter(|(_, q)| !q.is_empty()) {
        let what = format!("median over scenes: {peer} takes at least this many times as long");
        rows.push(Row::new(what, "×", quotients).aim(Aim::AtLeast(aim)));
    }
    bar.finish_and_clear();
    notes.push(format!(
        "still views of {} × {}; samples per pixel: corrections are held against {}, paths against {}; frames of walks \
         have time for {} of their samples and are held against all of these",
        a.size.width, a.size.height, a.traced_spp, a.reference_spp, a.share
    ));
    if let Some(out) = &a.common.out {
        write_page(out, "error-plain.csv", &table, &rows, &notes, sections)?;
    }
    finish("error", &rows, &notes, &a.common)
}

/// A scene's medians.
fn rows_of(name: &str, measured: &Measured) -> Vec<Row> {
    let mut rows = Vec::new();
    for way in &measured.still {
        let times = times_to_right(way);
        let what = format!("{name}: {}, time to FLIP ≤ {RIGHT}", way.name);
        rows.push(Row::new(what, "CPU s", &times).with_band(&times));
        let missed = times.iter().filter(|t| !t.is_finite()).count();
        if missed > 0 {
            let last = |r: &Vec<Point>| r.last().map_or(f64::NAN, |p| p.corrected.flip);
            let what = format!("  not reached in {missed} runs; error at the end");
            rows.push(Row::new(what, "mean FLIP", &way.runs.iter().map(last).collect::<Vec<_>>()));
        }
    }
    for (way, jod) in measured.walking.iter().zip(&measured.jod) {
        let mean = |r: &Vec<Point>| r.iter().map(|p| p.corrected.flip).sum::<f64>() / r.len().max(1) as f64;
        let flips: Vec<f64> = way.runs.iter().map(mean).collect();
        let what = format!("{name}, walking: {}", way.name);
        rows.push(Row::new(what.clone(), "mean FLIP", &flips).with_band(&flips));
        rows.push(Row::new(what, "JOD", jod).with_band(jod));
    }
    rows
}

/// How many times as long as our order, the first, another way takes at least.
fn quotient(ways: &[Way], peer: &str) -> Option<f64> {
    let theirs = ways.iter().find(|w| w.name.starts_with(peer))?;
    // Where it never was right, its last time is a lower bound.
    let last = |r: &Vec<Point>| r.last().map_or(0.0, |p| p.seconds);
    let bounds = theirs.runs.iter().map(last);
    let least =
        times_to_right(theirs).into_iter().zip(bounds).map(|(t, b)| if t.is_finite() { t } else { b });
    Some(median(&least.collect::<Vec<_>>())? / median(&times_to_right(ways.first()?))?)
}

fn measure(a: &ErrorArguments, study: &mut Study, done: impl Fn()) -> Result<Measured, Failure> {
    let frame = study.still().frame;
    let mut buffers = FrameBuffers::new(a.size.width as usize, a.size.height as usize);
    let seed = if a.traced_spp == 1 { 0 } else { SEED };
    let traced = traced_picture(&study.world, &frame, seed, a.traced_spp, &|| true);
    let paths = path_picture(&study.world, &frame, SEED, a.reference_spp, &|| true);
    let ours = |e: &Entrant| matches!(e.policy.policy, Policy::Utility);
    let (mut orders, rest): (Vec<Entrant>, Vec<Entrant>) = policies(&a.policies)?.into_iter().partition(ours);
    orders.extend(rest);
    orders.push(Entrant::plain_lattice());
    let way = |name: &str| Way { name: name.to_owned(), runs: Vec::new() };
    let mut still: Vec<Way> = orders.iter().map(|e| way(&e.name)).collect();
    still.extend([way("scan order, nothing before"), way("path tracing, full frame")]);
    let mut walking = still[..still.len() - 1].to_vec();
    let mut jod: Vec<Vec<f64>> = walking.iter().map(|_| Vec::new()).collect();
    for run in 0..a.common.runs {
        let start = cpu_ns();
        twin::draw(&study.world, &frame, Passes { texture_ids: false }, &mut buffers);
        let drawing = (cpu_ns() - start) * 1e-9;
        // Samples are traced anew, so that each run has its own times.
        if run > 0 {
            study.retrace();
        }
        let study = &*study;
        let keeps = run == 0 && a.common.out.is_some();
        let judge = |reference| {
            let objects = &study.still().buffers.object;
            Judge { objects, tone: &study.tone, reference, keeps }
        };
        for (order, way) in orders.iter().zip(&mut still) {
            let shares = (1..=STEPS).map(|step| (f64::from(step) / f64::from(STEPS)).powi(2));
            let mut points = Vec::new();
            study.stand(order, shares, |seconds, picture| {
                points.push(judge(&traced).point(drawing + seconds, picture));
            });
            way.runs.push(points);
        }
        let n = orders.len();
        still[n].runs.push(scan_order(study.still(), &judge(&traced), drawing));
        still[n + 1].runs.push(full_frames(&study.world, a, &frame, &judge(&paths), u64::from(run)));
        for (i, way) in walking.iter_mut().enumerate() {
            let share = f64::from(a.share);
            let shown = match orders.get(i) {
                Some(order) => study.walk(order, share).1,
                None => study.views.iter().map(|view| scanned(view, share)).collect(),
            };
            jod[i].push(study.jod(&shown)?);
            let points = shown.into_iter().zip(&study.views).enumerate().map(|(frame, (picture, view))| {
                let reference = &view.reference;
                let judge = Judge { objects: &view.buffers.object, tone: &study.tone, reference, keeps };
                judge.point(frame as f64 / f64::from(FRAMES_PER_SECOND), picture)
            });
            way.runs.push(points.collect());
        }
        done();
    }
    Ok(Measured { still, walking, jod })
}

/// All non-diffuse pixels, row by row, with time for this share of them.
fn scanned(view: &Traced, share: f64) -> Map2d<Vec3> {
    let mut picture = view.buffers.color.clone();
    let mut left = share * view.seconds();
    for (pixel, &object) in view.buffers.object.data().iter().enumerate() {
        if left <= 0.0 {
            break;
        }
        if object != 0 {
            picture.data_mut()[pixel] = view.reference.data()[pixel];
            left -= view.cost[object as usize];
        }
    }
    picture
}

/// All non-diffuse pixels, row by row.
fn scan_order(view: &Traced, judge: &Judge<'_>, drawing: f64) -> Vec<Point> {
    let at = |step: u32| f64::from(step) / f64::from(STEPS);
    (0..=STEPS).map(|s| judge.point(drawing + at(s) * view.seconds(), scanned(view, at(s)))).collect()
}

/// Paths through every pixel, twice as many each time.
fn full_frames(
    world: &World,
    a: &ErrorArguments,
    frame: &CameraFrame,
    judge: &Judge<'_>,
    seed: u64,
) -> Vec<Point> {
    let (mut points, mut seconds) = (Vec::new(), 0.0);
    let [width, height] = [judge.reference.width(), judge.reference.height()];
    let (mut sum, mut count) = (Map2d::new(width, height, Vec3::ZERO), 0u32);
    let mut more = 1;
    while count < a.path_spp {
        let start = cpu_ns();
        let new = path_picture(world, frame, seed ^ u64::from(count) << 32, more, &|| true);
        seconds += (cpu_ns() - start) * 1e-9;
        for (sum, new) in sum.data_mut().iter_mut().zip(new.data()) {
            *sum += *new * more as f32;
        }
        count += more;
        more = count;
        points.push(judge.point(seconds, sum.map(|c| c / count as f32)));
        // It is right: what more samples add nobody asks for.
        if points.last().is_some_and(|p| p.corrected.flip <= 0.5 * RIGHT) {
            break;
        }
    }
    points
}
