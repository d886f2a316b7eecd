//! `foveal bench error --plain`: how pictures come near to what they should be, beside what the same program does without
//! any of its ideas: all non-diffuse pixels in scan order, in √5 order, and path tracing of the full frame.
//!
//! Time is processor time, from the first ray of the view on.
//! Corrections are held against two references: what the view converges to (or many samples per pixel with other random
//! numbers), and paths, beside which the base light leaves them an error that no time takes away, the *floor*. Path
//! tracing is held against paths with other random numbers. While walking, each frame has the same time in every way: a
//! share of what all of its samples take, and paths what drawing the base layer takes besides.

use foveal::allocation::policy::Policy;
use foveal::image::Map2d;
use foveal::rng::hash;
use glam::Vec3;

use super::error::ErrorArguments;
use super::error_curves::{Against, CSV_HEAD, Judge, Point, ReferenceKind, Way, csv, time_to};
use super::error_page::{Axes, Panel, sections_of, write_page};
use super::error_paths;
use super::error_plain_rows::{overall, rows_of};
use super::error_references::References;
use super::made::Subject;
use super::study::{Entrant, FRAMES_PER_SECOND, Study, Traced, policies};
use foveal_engine::failure::Failure;
use foveal_engine::interrupt::{interrupted, uninterrupted};
use foveal_engine::light::Light;
use foveal_engine::opened;
use foveal_terminal::progress::Progress;
use foveal_terminal::report::Section;
use foveal_terminal::table::finish;

/// Mean FLIP of the non-diffuse pixels from which on a picture counts as right.
pub(super) const RIGHT: f64 = 0.05;
/// How much more than the floor counts as being as near to paths as the base light allows.
pub(super) const NEAR: f64 = 1.1;
/// Points of a curve.
const STEPS: u32 = 24;

/// Everything that was measured in one scene; our order is the first of the ways.
pub(super) struct Measured {
    /// Each correction against both references, then paths, then the floor.
    pub still: Vec<Way>,
    /// The same of walks: a run's points are its frames.
    pub walking: Vec<Way>,
    /// Of each way of walking, by run: just objectionable differences.
    pub jod: Vec<Vec<f64>>,
    /// Paths per pixel that a frame of the walk has time for: by run, means over its frames.
    pub paths_per_frame: Vec<f64>,
    /// The still view refined.
    pub refined: Point,
    /// One half of the reference's paths against the other.
    pub halves: Option<Halves>,
}

/// The noise of a reference, about twice.
pub(super) struct Halves {
    pub still: Point,
    /// A point for each frame.
    pub walking: Vec<Point>,
    pub jod: f64,
    /// Each half, of still views and of walks.
    pub against: [Against; 2],
}

impl Measured {
    /// The error of the converged still view beside paths.
    pub(super) fn floor(&self) -> f64 {
        let floor = self.still.iter().find(|w| w.is_floor).and_then(|w| w.runs.first()?.first());
        floor.map_or(f64::NAN, |p| p.corrected.flip)
    }
}

/// Runs the benchmark.
pub fn run(a: &ErrorArguments, scenes: &[String], progress: Progress) -> Result<(), Failure> {
    let steps = References::steps(a) + u64::from(a.common.runs);
    let bar = progress.bar(scenes.len() as u64 * steps, "error");
    let (mut sections, mut table) = (Vec::new(), String::from(CSV_HEAD));
    let (mut told, mut notes) = (Vec::new(), Vec::new());
    for (i, word) in scenes.iter().enumerate() {
        let name = Subject::name(word);
        bar.set_message(name.to_owned());
        let measured = scene(a, word, progress, &mut notes, || bar.inc(1));
        bar.set_position((i as u64 + 1) * steps);
        let (study, references, measured) = match measured {
            Ok(Some(all)) => all,
            Ok(None) => continue,
            Err(Failure::Interrupted(_)) => break,
            Err(e) => return Err(e),
        };
        table += &csv(name, "still", &measured.still);
        table += &csv(name, "walking", &measured.walking);
        if let Some(out) = &a.common.out {
            sections.extend(panels(out, name, a, &study, &references, &measured)?);
        }
        told.push((name.to_owned(), measured));
    }
    bar.finish_and_clear();
    let mut rows: Vec<_> = told.iter().flat_map(|(name, measured)| rows_of(name, a, measured)).collect();
    rows.extend(overall(&told));
    if interrupted() {
        notes.push("interrupted: fewer scenes or runs than asked for".into());
    }
    notes.extend(conditions(a));
    if let Some(out) = &a.common.out {
        write_page(out, "error-plain.csv", &table, &rows, &notes, sections)?;
    }
    finish("error", &rows, &notes, &a.common)?;
    uninterrupted()
}

/// What all figures are of.
fn conditions(a: &ErrorArguments) -> [String; 3] {
    [
        format!(
            "views of {} × {}, walks of {} frames at {FRAMES_PER_SECOND} a second, each with time for {} of its samples; \
             paths have the time of drawing the base layer besides",
            a.size.width, a.size.height, a.frames, a.share
        ),
        format!(
            "base light: {}",
            if a.quick { "the first estimate, as walk --quick" } else { "baked, as walk --baked" }
        ),
        format!(
            "references: traced, what a view converges to, still {} and walking 1 sample per pixel; path, unbiased, \
             still {} and walking {} samples per pixel. The floor is what a converged view has against path: the error \
             of its base light, the noise of its one sample, and that of the reference, of which the halves of the \
             reference differ by twice as much",
            a.traced_spp, a.reference_spp, a.walk_spp
        ),
    ]
}

/// Measures one scene; `None` where nothing is corrected.
fn scene(
    a: &ErrorArguments,
    word: &str,
    progress: Progress,
    notes: &mut Vec<String>,
    done: impl Fn(),
) -> Result<Option<(Study, References, Measured)>, Failure> {
    uninterrupted()?;
    let light = Light { quick: a.quick, baked: !a.quick, ..Light::default() };
    let subject = Subject::of(word)?;
    let opened = opened::open(subject.path(), &light, &progress.baking())?;
    let mut study = Study::new(opened, a.size, a.frames, true)?;
    if study.still().seconds() <= 0.0 {
        notes.push(format!("{}: nothing that its first camera sees is corrected", Subject::name(word)));
        return Ok(None);
    }
    let references = References::new(a, &study, &done)?;
    let measured = measure(a, &mut study, &references, done)?;
    Ok(Some((study, references, measured)))
}

/// The parts of the page about one scene: still and walking, each against its own kind of reference, and all against
/// paths.
fn panels(
    out: &std::path::Path,
    name: &str,
    a: &ErrorArguments,
    study: &Study,
    references: &References,
    measured: &Measured,
) -> Result<Vec<Section>, Failure> {
    let points = measured.still.first().and_then(|way| way.runs.first());
    let right = points.map_or(f64::INFINITY, |points| time_to(points, RIGHT));
    let last = points.and_then(|points| points.last()).map_or(0.0, |p| p.seconds);
    let right = if right.is_finite() { right } else { last };
    let end = f64::from(a.frames - 1) / f64::from(FRAMES_PER_SECOND);
    let of = |ways: &'static str, kind: Option<ReferenceKind>| {
        let all = if ways == "still" { &measured.still } else { &measured.walking };
        // Of its own kind is what a correction has been held against first.
        let corrects = |w: &&Way| w.against.kind == ReferenceKind::Traced || w.name == PATHS;
        let own = |w: &&Way| corrects(w) && (ways == "still" || w.name != PATHS);
        all.iter().filter(|w| kind.map_or(own(w), |k| w.against.kind == k)).collect::<Vec<_>>()
    };
    let picture = |against: Against, picture| (format!("reference: {against}"), picture);
    let (traced, path) = (references.traced_still(), references.still.against());
    let of_still = picture(path, &references.still.pictures[0]);
    let mut all = vec![
        Panel {
            title: format!("{name}, standing still: corrections against traced, path tracing against path"),
            file: format!("error-{name}-still"),
            against: "traced (path tracing: path)".into(),
            ways: of("still", None),
            axes: Axes::Until(RIGHT),
            at: right,
            references: vec![picture(traced, &references.traced), of_still.clone()],
        },
        Panel {
            title: format!("{name}, standing still: everything against path"),
            file: format!("error-{name}-still-path"),
            against: path.to_string(),
            ways: of("still", Some(ReferenceKind::Path)),
            axes: Axes::Until(NEAR * measured.floor()),
            at: right,
            references: vec![of_still],
        },
    ];
    if let ([.., converged], [.., by_paths]) = (&references.converged[..], &references.walking.pictures[..]) {
        let (traced, path) = (references.traced_walking(), references.walking.against());
        all.push(Panel {
            title: format!("{name}, walking: corrections against traced"),
            file: format!("error-{name}-walking"),
            against: traced.to_string(),
            ways: of("walking", None),
            axes: Axes::Walking,
            at: end,
            references: vec![picture(traced, converged)],
        });
        all.push(Panel {
            title: format!("{name}, walking: everything against path"),
            file: format!("error-{name}-walking-path"),
            against: path.to_string(),
            ways: of("walking", Some(ReferenceKind::Path)),
            axes: Axes::Walking,
            at: end,
            references: vec![picture(path, by_paths)],
        });
    }
    sections_of(out, &all, &study.tone)
}

/// Names of ways that are no orders.
pub(super) const SCAN: &str = "scan order";
pub(super) const PATHS: &str = "path tracing, full frame";
pub(super) const FLOOR: &str = "converged view (floor)";
pub(super) const HALVES: &str = "one half of the reference's samples against the other";

/// The orders, ours first.
fn orders(a: &ErrorArguments) -> Result<Vec<Entrant>, Failure> {
    let ours = |e: &Entrant| matches!(e.policy.policy, Policy::Utility);
    let (mut orders, rest): (Vec<Entrant>, Vec<Entrant>) = policies(&a.policies)?.into_iter().partition(ours);
    orders.extend(rest);
    orders.push(Entrant::plain_lattice());
    Ok(orders)
}

/// One run after another, until Ctrl-C; a run that it fell into does not count.
fn measure(
    a: &ErrorArguments,
    study: &mut Study,
    references: &References,
    done: impl Fn(),
) -> Result<Measured, Failure> {
    let orders = orders(a)?;
    let names: Vec<&str> = orders.iter().map(|e| e.name.as_str()).chain([SCAN]).collect();
    let ways = |traced: Against, path: Against| -> Vec<Way> {
        let corrections = [traced, path].into_iter().flat_map(|r| names.iter().map(move |n| Way::new(*n, r)));
        let floor = Way { is_floor: true, ..Way::new(FLOOR, path) };
        corrections.chain([Way::new(PATHS, path), floor]).collect()
    };
    let (still, walking) = (&references.still, &references.walking);
    let halves = match (&still.halves, &walking.halves) {
        (Some([a, b]), Some([c, d])) => {
            let (seen, jod) = judged(study, c, d, false);
            let against = [still.against_half(), walking.against_half()];
            let still = judge(study.still(), study, false).point(&a[0], 0.0, &b[0]);
            Some(Halves { still, walking: seen, jod: jod?, against })
        }
        _ => None,
    };
    let refined = judge(study.still(), study, false).point(&still.pictures[0], 0.0, &references.refined);
    let still = ways(references.traced_still(), still.against());
    let walking = ways(references.traced_walking(), walking.against());
    let jod = vec![Vec::new(); walking.len()];
    let mut measured = Measured { still, walking, jod, paths_per_frame: Vec::new(), refined, halves };
    for run in 0..a.common.runs {
        // Samples are traced anew, so that each run has its own times.
        if run > 0 {
            study.retrace();
        }
        let study = &*study;
        let keeps = run == 0 && a.common.out.is_some();
        let still = stood(a, study, references, &orders, u64::from(run), keeps)?;
        let walked = walked(a, study, references, &orders, u64::from(run), keeps)?;
        if interrupted() {
            break;
        }
        measured.still.iter_mut().zip(still).for_each(|(way, run)| way.runs.push(run));
        measured.walking.iter_mut().zip(walked.runs).for_each(|(way, run)| way.runs.push(run));
        measured.jod.iter_mut().zip(walked.jod).for_each(|(all, one)| all.push(one));
        measured.paths_per_frame.push(walked.paths_per_frame);
        done();
    }
    let measured_once = measured.still.iter().all(|way| !way.runs.is_empty());
    if measured_once { Ok(measured) } else { uninterrupted().map(|()| measured) }
}

/// Curves of the still view, in the order of the ways.
fn stood(
    a: &ErrorArguments,
    study: &Study,
    references: &References,
    orders: &[Entrant],
    run: u64,
    keeps: bool,
) -> Result<Vec<Vec<Point>>, Failure> {
    let view = study.still();
    let judge = judge(view, study, keeps);
    let path = &references.still.pictures[0];
    let (mut traced, mut beside_paths) = (Vec::new(), Vec::new());
    let shares = || (0..=STEPS).map(|step| (f64::from(step) / f64::from(STEPS)).powi(2));
    let mut corrected = |pictures: Vec<(f64, Map2d<Vec3>)>| {
        let points = |reference| pictures.iter().map(|(s, p)| judge.point(reference, *s, p)).collect();
        traced.push(points(&references.traced));
        beside_paths.push(points(path));
    };
    for order in orders {
        let mut pictures = Vec::new();
        study.stand(order, shares().skip(1), |s, picture| pictures.push((view.drawing + s, picture)))?;
        corrected(pictures);
    }
    let seconds = view.seconds();
    corrected(
        (0..=STEPS)
            .map(|s| f64::from(s) / f64::from(STEPS))
            .map(|share| (view.drawing + share * seconds, scanned(view, share)))
            .collect(),
    );
    let floor = judge.point(path, view.drawing + seconds, &view.reference);
    let enough = 0.5 * RIGHT.min(floor.corrected.flip);
    let mut paths: Vec<Point> = Vec::new();
    error_paths::still(study.world(), &view.frame, run, a.path_spp, |seconds, picture| {
        paths.push(judge.point(path, seconds, picture));
        // It is right: what more samples add nobody asks for.
        paths.last().is_some_and(|p| p.corrected.flip <= enough)
    });
    // As far as the longest curve goes.
    let end = paths.last().map_or(floor.seconds, |p| p.seconds.max(floor.seconds));
    let floor = vec![Point { seconds: view.drawing, ..floor.clone() }, Point { seconds: end, ..floor }];
    Ok(traced.into_iter().chain(beside_paths).chain([paths, floor]).collect())
}

/// A walk in every way.
struct WalkResults {
    runs: Vec<Vec<Point>>,
    jod: Vec<f64>,
    paths_per_frame: f64,
}

fn walked(
    a: &ErrorArguments,
    study: &Study,
    references: &References,
    orders: &[Entrant],
    run: u64,
    keeps: bool,
) -> Result<WalkResults, Failure> {
    let (share, by_paths) = (f64::from(a.share), &references.walking.pictures);
    let (mut traced, mut beside_paths) = (Vec::new(), Vec::new());
    for order in orders.iter().map(Some).chain([None]) {
        let shown = match order {
            Some(order) => study.walk(order, share)?.1,
            None => study.views.iter().map(|view| scanned(view, share)).collect(),
        };
        traced.push(judged(study, &references.converged, &shown, keeps));
        beside_paths.push(judged(study, by_paths, &shown, keeps));
    }
    let frames: Vec<_> = study
        .views
        .iter()
        .enumerate()
        .map(|(i, view)| {
            let seconds = view.drawing + share * view.seconds();
            error_paths::frame_in(study.world(), &view.frame, hash(run, i as u64, 1), seconds)
        })
        .collect();
    let paths_per_frame = frames.iter().map(|f| f.spp).sum::<f64>() / frames.len().max(1) as f64;
    let paths: Vec<_> = frames.into_iter().map(|f| f.picture).collect();
    beside_paths.push(judged(study, by_paths, &paths, keeps));
    beside_paths.push(judged(study, by_paths, &references.converged, keeps));
    let (runs, jod): (Vec<_>, Vec<_>) = traced.into_iter().chain(beside_paths).unzip();
    Ok(WalkResults { runs, jod: jod.into_iter().collect::<Result<_, _>>()?, paths_per_frame })
}

fn judge<'s>(view: &'s Traced, study: &'s Study, keeps: bool) -> Judge<'s> {
    Judge { objects: &view.buffers.object, tone: &study.tone, keeps }
}

/// Errors of each frame of a walk, and those of the whole in just objectionable differences.
fn judged(
    study: &Study,
    references: &[Map2d<Vec3>],
    shown: &[Map2d<Vec3>],
    keeps: bool,
) -> (Vec<Point>, Result<f64, Failure>) {
    let frames = study.views.iter().zip(references).zip(shown).enumerate();
    let points = frames.map(|(i, ((view, reference), picture))| {
        let seconds = i as f64 / f64::from(FRAMES_PER_SECOND);
        judge(view, study, keeps).point(reference, seconds, picture)
    });
    (points.collect(), study.jod(shown, references))
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
