//! `foveal bench error --plain`: the time until a still view looks right, beside what the same program does without any of
//! its ideas: all non-diffuse pixels in scan order, in √5 order, and path tracing of the full frame.
//!
//! Time is processor time, from the first ray of the view on; what only the order differs in shares its samples. Every
//! picture is held against a reference of its own kind: corrections against what the view converges to (or against many
//! samples per pixel with other random numbers), paths against many paths with other random numbers.

use std::fmt::Write as _;

use base64::Engine as _;
use foveal::allocation::policy::Policy;
use foveal::display::FrameBuffers;
use foveal::display::tone::ToneMap;
use foveal::display::twin::{self, Passes};
use foveal::image::Map2d;
use foveal::metrics::flip;
use foveal::metrics::pixels::{linear_errors, mse, psnr};
use glam::Vec3;

use super::error::{Entrant, ErrorArguments, Study, Walk, policies};
use super::made::MadeScene;
use super::messages::load::quantile;
use super::stages::quick_world;
use super::table::{Aim, Row, finish, median};
use crate::cli::Progress;
use crate::cli::failure::Failure;
use crate::cli::output::{make_folder, png_bytes, write_atomic};
use crate::cli::reference::{path_picture, traced_picture};
use crate::processor_time::cpu_ns;

/// Mean FLIP of the non-diffuse pixels from which on a picture counts as right.
const RIGHT: f64 = 0.05;
/// Points of a curve.
const STEPS: u32 = 24;
/// Seed of references: not that of the pictures.
const SEED: u64 = 0x5eed;

/// What one way came to at one time.
#[derive(Clone)]
struct Point {
    seconds: f64,
    /// Mean FLIP of the non-diffuse pixels.
    flip: f64,
    /// Of all pixels.
    flip_all: f64,
    psnr: Option<f64>,
    relmse: f64,
    picture: Map2d<Vec3>,
}

/// One way and its curves, one of each run.
struct Way {
    name: String,
    runs: Vec<Vec<Point>>,
}

/// When a curve first is right, between its points; infinite where it never is.
fn time_to_right(points: &[Point]) -> f64 {
    let mut before: Option<&Point> = None;
    for p in points {
        if p.flip <= RIGHT {
            return match before {
                // Errors fall like powers of time, so on straight lines of logarithms.
                Some(b) if b.flip > p.flip && b.seconds > 0.0 => {
                    let share = (b.flip / RIGHT).ln() / (b.flip / p.flip.max(1e-9)).ln();
                    b.seconds * (p.seconds / b.seconds).powf(share)
                }
                _ => p.seconds,
            };
        }
        before = Some(p);
    }
    f64::INFINITY
}

/// A view with the references that pictures of it are held against.
struct Judge {
    objects: Map2d<u32>,
    tone: ToneMap,
}

impl Judge {
    fn point(&self, seconds: f64, picture: Map2d<Vec3>, reference: &Map2d<Vec3>) -> Point {
        let map = flip::flip(reference, &picture, &self.tone);
        let pairs = || map.data().iter().zip(self.objects.data());
        let corrected = || pairs().filter(|(_, id)| **id != 0);
        let sum: f64 = corrected().map(|(e, _)| f64::from(*e)).sum();
        let shown = |p: &Map2d<Vec3>| p.map(|c| self.tone.to_linear(c));
        Point {
            seconds,
            flip: sum / corrected().count().max(1) as f64,
            flip_all: flip::mean(&map),
            psnr: psnr(mse(&shown(&picture), &shown(reference))),
            relmse: linear_errors(&picture, reference).relmse,
            picture,
        }
    }
}

/// Runs the benchmark.
pub fn run(a: &ErrorArguments, scenes: &[String], progress: Progress) -> Result<(), Failure> {
    let bar = progress.bar(scenes.len() as u64 * u64::from(a.common.runs), "scenes");
    let (mut rows, mut csv) =
        (Vec::new(), String::from("scene,way,run,seconds,flip of non-diffuse pixels,flip,psnr,relmse\n"));
    let mut page = String::from(
        "<!doctype html><meta charset=\"utf-8\"><title>Error against time</title><style>body{font:14px sans-serif;\
         margin:2em}figure{display:inline-block;margin:4px}img{width:256px;image-rendering:pixelated}</style>\
         <h1>Error against time</h1>\n",
    );
    let mut quotients: [Vec<f64>; 2] = Default::default();
    for name in scenes {
        let ways = study(a, name, || bar.inc(1))?;
        let time_of = |way: &Way| -> Vec<f64> { way.runs.iter().map(|r| time_to_right(r)).collect() };
        let Some(ours) = ways.first().map(&time_of) else { continue };
        for way in &ways {
            let mut times = time_of(way);
            let reached = times.iter().filter(|t| t.is_finite()).count();
            let row = Row::new(format!("{name}: {}, time to FLIP ≤ {RIGHT}", way.name), "CPU s", &times);
            let (low, high) = (quantile(&mut times, 0.1), quantile(&mut times, 0.9));
            rows.push(row);
            rows.push(Row::new("  10–90 %, low", "CPU s", &[low]));
            rows.push(Row::new("  10–90 %, high", "CPU s", &[high]));
            if reached < way.runs.len() {
                let last = |r: &Vec<Point>| r.last().map_or(f64::NAN, |p| p.flip);
                rows.push(Row::new(
                    format!("  not reached in {} runs; error at the end", way.runs.len() - reached),
                    "mean FLIP",
                    &way.runs.iter().map(last).collect::<Vec<_>>(),
                ));
            }
            for (run, points) in way.runs.iter().enumerate() {
                for p in points {
                    let psnr = p.psnr.map_or(String::new(), |v| v.to_string());
                    let _ = writeln!(
                        csv,
                        "{name},{},{run},{},{},{},{psnr},{}",
                        way.name, p.seconds, p.flip, p.flip_all, p.relmse
                    );
                }
            }
        }
        for (i, (peer, aim)) in [("scan order", 3.0), ("path tracing", 10.0)].into_iter().enumerate() {
            let Some(theirs) = ways.iter().find(|w| w.name.starts_with(peer)).map(&time_of) else { continue };
            // Where it never was right, its last time is a lower bound.
            let last =
                |w: &Way| w.runs.iter().filter_map(|r| r.last()).map(|p| p.seconds).collect::<Vec<_>>();
            let bound = ways.iter().find(|w| w.name.starts_with(peer)).map(last).unwrap_or_default();
            let least: Vec<f64> =
                theirs.iter().zip(&bound).map(|(t, b)| if t.is_finite() { *t } else { *b }).collect();
            if let (Some(mine), Some(theirs)) = (median(&ours), median(&least)) {
                quotients[i].push(theirs / mine);
                rows.push(
                    Row::new(
                        format!("{name}: {peer} takes at least this many times as long"),
                        "×",
                        &[theirs / mine],
                    )
                    .aim(Aim::AtLeast(aim)),
                );
            }
        }
        section(&mut page, a, name, &ways)?;
    }
    for (i, (peer, aim)) in [("scan order", 3.0), ("path tracing", 10.0)].into_iter().enumerate() {
        if !quotients[i].is_empty() {
            let what = format!("median over scenes: {peer} takes at least this many times as long");
            rows.push(Row::new(what, "×", &quotients[i]).aim(Aim::AtLeast(aim)));
        }
    }
    bar.finish_and_clear();
    if let Some(out) = &a.common.out {
        make_folder(out)?;
        write_atomic(&out.join("error-plain.csv"), csv.as_bytes())?;
        write_atomic(&out.join("report.html"), page.as_bytes())?;
    }
    let notes = vec![format!(
        "still views of {} × {}; corrections held against {} samples per pixel, paths against {}",
        a.size.width, a.size.height, a.traced_spp, a.reference_spp
    )];
    finish("error", &rows, &notes, &a.common)
}

fn study(a: &ErrorArguments, name: &str, done: impl Fn()) -> Result<Vec<Way>, Failure> {
    let world = quick_world(MadeScene::bundled(name)?.path())?;
    let frame = world.scene.cameras[0].camera.frame(a.size.width, a.size.height);
    let mut buffers = FrameBuffers::new(a.size.width as usize, a.size.height as usize);
    twin::draw(&world, &frame, Passes { texture_ids: false }, &mut buffers);
    let judge = Judge { objects: buffers.object.clone(), tone: ToneMap::from(&world.scene.display) };
    let seed = if a.traced_spp == 1 { 0 } else { SEED };
    let traced = traced_picture(&world, &frame, seed, a.traced_spp, &|| true);
    let paths = path_picture(&world, &frame, SEED, a.reference_spp, &|| true);
    let entrants = policies(&a.policies)?;
    let ours = |e: &Entrant| matches!(e.policy.policy, Policy::Utility);
    let (mut first, mut rest): (Vec<Entrant>, Vec<Entrant>) = entrants.into_iter().partition(ours);
    first.append(&mut rest);
    let mut ways: Vec<Way> = first.iter().map(|e| Way { name: e.name.clone(), runs: Vec::new() }).collect();
    for plain in ["√5 order, nothing before", "scan order, nothing before", "path tracing, full frame"] {
        ways.push(Way { name: plain.into(), runs: Vec::new() });
    }
    let plain_order = Entrant::plain_lattice();
    for run in 0..a.common.runs {
        let start = cpu_ns();
        twin::draw(&world, &frame, Passes { texture_ids: false }, &mut buffers);
        let drawing = (cpu_ns() - start) * 1e-9;
        // Samples are traced anew, so that each run has its own times.
        let study = Study::of_view(a, world.clone());
        let view = study.first_view();
        let total = view.seconds();
        for (i, entrant) in first.iter().chain([&plain_order]).enumerate() {
            let mut walk = Walk::new(&study, entrant);
            walk.begin(1, view);
            let mut points = vec![judge.point(drawing, walk.picture(view), &traced)];
            for step in 1..=STEPS {
                let until = total * (f64::from(step) / f64::from(STEPS)).powi(2);
                walk.attend(view);
                walk.correct(view, until);
                points.push(judge.point(drawing + until, walk.picture(view), &traced));
            }
            ways[i].runs.push(points);
        }
        let scan = ways.len() - 2;
        ways[scan].runs.push(scan_order(view, &judge, drawing, &traced));
        ways[scan + 1].runs.push(full_frames(&world, a, &frame, &judge, &paths, u64::from(run)));
        done();
    }
    Ok(ways)
}

/// All non-diffuse pixels, row by row.
fn scan_order(
    view: &super::error::Traced,
    judge: &Judge,
    drawing: f64,
    reference: &Map2d<Vec3>,
) -> Vec<Point> {
    let mut picture = view.buffers.color.clone();
    let (width, height) = (picture.width(), picture.height());
    let mut seconds = drawing;
    let total = view.seconds();
    let mut points = vec![judge.point(seconds, picture.clone(), reference)];
    let mut next = 1;
    for y in 0..height {
        for x in 0..width {
            let object = view.buffers.object.at(x, y) as usize;
            if object != 0 {
                *picture.at_mut(x, y) = view.reference.at(x, y);
                seconds += view.cost[object];
            }
        }
        if seconds - drawing >= total * f64::from(next) / f64::from(STEPS) || y + 1 == height {
            points.push(judge.point(seconds, picture.clone(), reference));
            next += 1;
        }
    }
    points
}

/// Paths through every pixel, twice as many each time.
fn full_frames(
    world: &foveal::world::World,
    a: &ErrorArguments,
    frame: &foveal::scene::camera::CameraFrame,
    judge: &Judge,
    reference: &Map2d<Vec3>,
    seed: u64,
) -> Vec<Point> {
    let (mut points, mut seconds) = (Vec::new(), 0.0);
    let (mut sum, mut count) = (Map2d::new(reference.width(), reference.height(), Vec3::ZERO), 0u32);
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
        points.push(judge.point(seconds, sum.map(|c| c / count as f32), reference));
        // It is right: what more samples add nobody asks for.
        if points.last().is_some_and(|p| p.flip <= 0.5 * RIGHT) {
            break;
        }
    }
    points
}

const COLOURS: [&str; 9] =
    ["#c0392b", "#2980b9", "#27ae60", "#8e44ad", "#d35400", "#16a085", "#7f8c8d", "#2c3e50", "#f39c12"];

/// A scene's curves and its pictures at equal time.
fn section(page: &mut String, a: &ErrorArguments, name: &str, ways: &[Way]) -> Result<(), Failure> {
    let svg = plot(ways);
    if let Some(out) = &a.common.out {
        make_folder(out)?;
        write_atomic(&out.join(format!("error-{name}.svg")), svg.as_bytes())?;
    }
    let _ = writeln!(page, "<h2>{name}</h2>\n{svg}");
    let ours = ways.first().and_then(|w| w.runs.first()).map_or(f64::INFINITY, |r| time_to_right(r));
    let last = ways.first().and_then(|w| w.runs.first()).and_then(|r| r.last()).map_or(0.0, |p| p.seconds);
    let equal = if ours.is_finite() { ours } else { last };
    let _ = writeln!(page, "<p>After {:.1} ms of processor time:</p>", equal * 1e3);
    for way in ways {
        let Some(points) = way.runs.first() else { continue };
        // The last picture that was there by then, or the first there ever was.
        let Some(p) = points.iter().rev().find(|p| p.seconds <= equal * 1.001).or(points.first()) else {
            continue;
        };
        let tone = ToneMap::default();
        let rgb8 = p.picture.map(|c| tone.to_rgb8(c));
        let png = png_bytes(p.picture.width() as u32, p.picture.height() as u32, rgb8.data().as_flattened())?;
        let data = base64::engine::general_purpose::STANDARD.encode(png);
        let _ = writeln!(
            page,
            "<figure><img src=\"data:image/png;base64,{data}\"><figcaption>{}<br>{:.1} ms, FLIP {:.3}</figcaption></figure>",
            way.name,
            p.seconds * 1e3,
            p.flip
        );
    }
    Ok(())
}

/// Medians over the runs with bands of 10 to 90 %, both axes logarithmic.
fn plot(ways: &[Way]) -> String {
    const SIZE: [f64; 2] = [640.0, 360.0];
    let all = || ways.iter().flat_map(|w| w.runs.iter().flatten());
    let bounds = |of: &dyn Fn(&Point) -> f64, floor: f64| {
        let (mut low, mut high) = (f64::INFINITY, floor);
        for p in all() {
            let v = of(p).max(floor);
            (low, high) = (low.min(v), high.max(v));
        }
        (low.ln(), high.ln().max(low.ln() + 1e-9))
    };
    let (t0, t1) = bounds(&|p| p.seconds, 1e-6);
    let (e0, e1) = bounds(&|p| p.flip, 1e-3);
    let at = |t: f64, e: f64| {
        let x = 50.0 + (SIZE[0] - 60.0) * (t.max(1e-6).ln() - t0) / (t1 - t0);
        let y = 10.0 + (SIZE[1] - 40.0) * (e1 - e.max(1e-3).ln()) / (e1 - e0);
        format!("{x:.1},{y:.1}")
    };
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {}\" width=\"{}\" font-family=\"sans-serif\" \
         font-size=\"11\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n",
        SIZE[0] + 220.0,
        SIZE[1],
        SIZE[0] + 220.0
    );
    let right = [at(t0.exp(), RIGHT), at(t1.exp(), RIGHT)].join(" ");
    let _ =
        writeln!(svg, "<polyline points=\"{right}\" stroke=\"#bbb\" stroke-dasharray=\"4\" fill=\"none\"/>");
    for (exponent, label) in (-6..4).map(|e| (10f64.powi(e), e)) {
        if (t0..=t1).contains(&exponent.ln()) {
            let p = at(exponent, e0.exp());
            let (x, _) = p.split_once(',').unwrap_or(("0", "0"));
            let _ = writeln!(svg, "<text x=\"{x}\" y=\"{}\">10^{label} s</text>", SIZE[1] - 8.0);
        }
        if (e0..=e1).contains(&exponent.ln()) {
            let p = at(t0.exp(), exponent);
            let (_, y) = p.split_once(',').unwrap_or(("0", "0"));
            let _ = writeln!(svg, "<text x=\"2\" y=\"{y}\">{exponent}</text>");
        }
    }
    for (i, way) in ways.iter().enumerate() {
        let colour = COLOURS[i % COLOURS.len()];
        let steps = way.runs.iter().map(Vec::len).min().unwrap_or(0);
        let (mut line, mut low, mut high) = (Vec::new(), Vec::new(), Vec::new());
        for step in 0..steps {
            let mut flips: Vec<f64> = way.runs.iter().map(|r| r[step].flip).collect();
            let seconds: Vec<f64> = way.runs.iter().map(|r| r[step].seconds).collect();
            let (Some(t), Some(e)) = (median(&seconds), median(&flips)) else { continue };
            line.push(at(t, e));
            low.push(at(t, quantile(&mut flips, 0.1)));
            high.push(at(t, quantile(&mut flips, 0.9)));
        }
        high.reverse();
        let band = [low, high].concat().join(" ");
        let _ = writeln!(svg, "<polygon points=\"{band}\" fill=\"{colour}\" opacity=\"0.2\"/>");
        let _ = writeln!(
            svg,
            "<polyline points=\"{}\" stroke=\"{colour}\" fill=\"none\" stroke-width=\"1.5\"/>",
            line.join(" ")
        );
        let y = 24.0 + 16.0 * i as f64;
        let _ =
            writeln!(svg, "<text x=\"{}\" y=\"{y}\" fill=\"{colour}\">{}</text>", SIZE[0] + 4.0, way.name);
    }
    svg + "</svg>"
}
