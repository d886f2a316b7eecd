//! `foveal bench error`: how fast the error of the corrected pixels falls under each policy, standing still and walking.

use std::time::Duration;

use clap::Args;
use foveal::allocation::policy::Policy;
use foveal::metrics::curve::ErrorCurve;

use super::error_curves::{Against, CSV_HEAD, Judge, Point, ReferenceKind, Way, csv};
use super::error_light::LightArguments;
use super::error_page::{Axes, Panel, sections_of, write_page};
use super::made::Subject;
use super::stages::quick_world;
use super::study::{Entrant, FRAMES_PER_SECOND, Study, policies};
use foveal_engine::Opened;
use foveal_engine::failure::Failure;
use foveal_engine::interrupt::{interrupted, uninterrupted};
use foveal_terminal::arguments::Size;
use foveal_terminal::progress::Progress;
use foveal_terminal::progress::end_on_interrupt;
use foveal_terminal::table::{Aim, CommonArguments, Row, finish, median};

/// Arguments of `foveal bench error`.
#[derive(Args, Debug)]
pub struct ErrorArguments {
    /// Which error to measure
    #[arg(long, value_enum, default_value_t = What::Corrections)]
    what: What,
    /// With --what illumination: time on all cores for each scene and method; with --what light: time of a bake
    #[arg(long, value_name = "TIME", default_value = "10s", value_parser = foveal_terminal::arguments::duration)]
    pub(super) time: Duration,
    /// Picture size (default with --plain 128x96, since path-traced references take long, with --what light 256x192)
    #[arg(long, value_name = "WxH", default_value = "400x300",
        default_value_ifs([("plain", "true", "128x96"), ("what", "light", "256x192")]))]
    pub(super) size: Size,
    /// Scene files or names of bundled scenes (default: box duck table gallery chess; with --what illumination: box
    /// diffuse table; with --what light: most of these and many small rooms)
    #[arg(value_name = "SCENE")]
    subjects: Vec<String>,
    /// The same, separated by commas
    #[arg(long, value_name = "SCENES", value_delimiter = ',')]
    scenes: Vec<String>,
    /// Policies to compare; all: Haber 2001 as published (uncorrected mirrors are black), its attention over
    /// environment maps, and attention, uniform and utility as in this program
    #[arg(long, value_name = "NAMES", value_delimiter = ',', default_value = "all")]
    pub(super) policies: Vec<String>,
    /// Frames of the walk, a tenth of a second apart
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(2..=1000))]
    pub(super) frames: u32,
    /// Share of a view's samples that one frame of the walk has time for
    #[arg(long, value_name = "SHARE", default_value = "0.1", value_parser = foveal_terminal::arguments::unit)]
    pub(super) share: f32,
    /// With --what walks: processor time per frame, for everything; 200 ms are two cores at ten frames per second
    #[arg(long, value_name = "TIMES", value_delimiter = ',', default_value = "50ms,200ms", value_parser = foveal_terminal::arguments::duration)]
    pub(super) frame_time: Vec<Duration>,
    /// Show only the coarsest environment maps
    #[arg(long)]
    coarse_maps: bool,
    /// Compare with plain alternatives in this program (scan order, √5 order, and path tracing of full frames), still
    /// and walking, against `traced` references and against `path` references, which ignore the bake. A scene takes
    /// one to four minutes on two cores, more with larger --size, --frames, --reference-spp and --walk-spp
    #[arg(long)]
    pub(super) plain: bool,
    /// With --plain: samples per pixel of the still view's `traced` reference; 1 is what the view converges to, more
    /// use other random numbers
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    pub(super) traced_spp: u32,
    /// With --plain: samples per pixel of the still view's `path` reference
    #[arg(long, value_name = "N", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    pub(super) reference_spp: u32,
    /// With --plain: samples per pixel of the `path` reference for each frame of the walk
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    pub(super) walk_spp: u32,
    /// With --plain: limit on samples per pixel when path tracing the still view
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    pub(super) path_spp: u32,
    /// With --plain: use the first estimate of the light instead of a bake
    #[arg(long)]
    pub(super) quick: bool,
    #[command(flatten)]
    pub(super) light: LightArguments,
    #[command(flatten)]
    pub(super) common: CommonArguments,
}

/// What views converge to, as they are held against it.
pub(super) const CONVERGED: Against = Against { kind: ReferenceKind::Traced, spp: 1 };

/// Whose error is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum What {
    /// Pixels that need correction
    Corrections,
    /// Baked irradiance, by both methods
    Illumination,
    /// Walks with a given processor time per frame, with interpolation between samples and with tiles
    Walks,
    /// Still views compared with a reference: after a bake of a given time, and refined
    Light,
}

/// Scenes of `--what light`: the bundled ones in which light is not the same everywhere, and rooms of each kind.
const LIT: &str =
    "box table gallery chess diffuse panes blinds shade uplight slits mirrors bodies bumps checks sheets";

/// Steps of the still view's curve.
const STEPS: u32 = 16;
/// Share of the time of all samples after which pictures of still views are shown.
const SHOWN_AT: f64 = 0.1;

/// What one policy came to in one run in one scene.
struct Outcome {
    /// Mean FLIP of the corrected pixels over the time of all samples.
    still: f64,
    /// Mean over the frames of the walk.
    walking: f64,
    /// The walk beside its traced pictures, in just objectionable differences.
    jod: f64,
    curves: [Vec<Point>; 2],
    /// Share of time spent deciding.
    deciding: f64,
}

/// Runs the benchmark.
pub fn run(a: &ErrorArguments, progress: Progress) -> Result<(), Failure> {
    let named: Vec<String> = a.subjects.iter().chain(&a.scenes).cloned().collect();
    let or = |default: &str| match named.is_empty() {
        true => default.split(' ').map(str::to_owned).collect(),
        false => named.clone(),
    };
    if a.what == What::Illumination {
        return super::illumination::run(&or("box diffuse table"), a.time.as_secs_f64(), &a.common, progress);
    }
    end_on_interrupt();
    if a.what == What::Light {
        return super::error_light::run(a, &or(LIT), progress);
    }
    let scenes: Vec<String> = or("box duck table gallery chess");
    if a.what == What::Walks {
        return super::error_walks::run(a, &scenes, progress);
    }
    if a.plain {
        return super::error_plain::run(a, &scenes, progress);
    }
    let entrants = policies(&a.policies)?;
    let runs = a.common.runs as usize;
    let bar = progress.bar((scenes.len() * runs) as u64, "scenes");
    let (mut rows, mut sections, mut table) = (Vec::new(), Vec::new(), String::from(CSV_HEAD));
    // By entrant and run, over scenes and motions.
    let mut sums = vec![vec![0.0f64; runs]; entrants.len()];
    let (mut deciding, mut notes, mut corrected) = (Vec::new(), Vec::new(), 0);
    for word in &scenes {
        let name = Subject::name(word);
        let world = quick_world(Subject::of(word)?.path())?;
        let mut study = match Study::new(Opened::of_world(world), a.size, a.frames, a.coarse_maps) {
            Err(Failure::Interrupted(_)) => break,
            study => study?,
        };
        if study.still().seconds() <= 0.0 {
            notes.push(format!("{name}: nothing that its first camera sees is corrected"));
            bar.inc(runs as u64);
            continue;
        }
        // By entrant, then by run.
        let mut outcomes: Vec<Vec<Outcome>> = entrants.iter().map(|_| Vec::new()).collect();
        for run in 0..runs {
            if run > 0 {
                study.retrace();
            }
            // One after another: the clock of each goes by this thread's time.
            let keeps = run == 0 && a.common.out.is_some();
            let found = entrants.iter().map(|e| outcome(&study, a, e, keeps));
            let found = found.collect::<Result<Vec<Outcome>, Failure>>()?;
            // A run that Ctrl-C fell into does not count.
            if interrupted() {
                break;
            }
            outcomes.iter_mut().zip(found).for_each(|(all, one)| all.push(one));
            bar.inc(1);
        }
        if outcomes.iter().any(Vec::is_empty) {
            break;
        }
        corrected += 1;
        rows.extend(rows_of(name, &entrants, &outcomes));
        for (sums, outcomes) in sums.iter_mut().zip(&outcomes) {
            sums.truncate(outcomes.len());
            sums.iter_mut().zip(outcomes).for_each(|(sum, o)| *sum += o.still + o.walking);
        }
        let ours = entrants.iter().position(|e| e.policy.policy == Policy::Utility);
        deciding.extend(ours.iter().flat_map(|i| outcomes[*i].iter().map(|o| o.deciding)));
        let [still, walking] = ways(&entrants, outcomes);
        table += &csv(name, "still", &still);
        table += &csv(name, "walking", &walking);
        if let Some(out) = &a.common.out {
            let end = f64::from(a.frames - 1) / f64::from(FRAMES_PER_SECOND);
            let soon = SHOWN_AT * study.still().seconds();
            let parts = [
                ("still", &still, Axes::Still, soon, study.views.first()),
                ("walking", &walking, Axes::Walking, end, study.views.last()),
            ];
            let panels = parts.map(|(motion, ways, axes, at, view)| Panel {
                title: format!("{name}, {motion}"),
                file: format!("error-{name}-{motion}"),
                against: CONVERGED.to_string(),
                ways: ways.iter().collect(),
                axes,
                at,
                references: view.iter().map(|v| (format!("reference: {CONVERGED}"), &v.reference)).collect(),
            });
            sections.extend(sections_of(out, &panels, &study.tone)?);
        }
    }
    let worst = rows.iter().filter_map(Row::ratio).fold(f64::NAN, f64::max);
    rows.extend(totals(&entrants, &sums, &deciding, corrected));
    if worst.is_finite() {
        let what = "worst of all scenes, still or walking: utility beside the best other";
        rows.push(Row::new(what, "×", &[worst]).aim(Aim::AtMost(1.05)));
    }
    bar.finish_and_clear();
    notes.push(format!(
        "Errors are the mean FLIP of the non-diffuse pixels over time, {}; a frame of the walk has time for {} of its samples.",
        if a.coarse_maps { "without environment maps" } else { "environment maps are captured on the way" },
        a.share
    ));
    notes.push(
        "Each order walks by itself, on a clock that moves by the processor time its tracer spends on samples and maps."
            .into(),
    );
    notes.push(format!(
        "The reference is what the views converge to, {CONVERGED}; with `--plain`, path-traced pictures are another."
    ));
    if interrupted() {
        notes.push("Interrupted: there are fewer scenes or runs than were asked for.".into());
    }
    if let Some(out) = &a.common.out {
        write_page(out, "error-curves.csv", &table, &rows, &notes, sections)?;
    }
    finish("error", &rows, &notes, &a.common)?;
    uninterrupted()
}

fn outcome(study: &Study, a: &ErrorArguments, entrant: &Entrant, keeps: bool) -> Result<Outcome, Failure> {
    let judged = |i: usize, seconds: f64, picture| {
        let view = &study.views[i];
        let judge = Judge { objects: &view.buffers.object, tone: &study.tone, keeps };
        judge.point(&view.reference, seconds, &picture)
    };
    let mut still = Vec::new();
    let shares = (1..=STEPS).map(|step| f64::from(step) / f64::from(STEPS));
    let stood = study.stand(entrant, shares, |seconds, picture| still.push(judged(0, seconds, picture)))?;
    let mut curve = ErrorCurve::new(still.first().map_or(0.0, |p| p.corrected.flip));
    still.iter().for_each(|p| curve.push(p.seconds, p.corrected.flip));
    let (walked, shown) = study.walk(entrant, f64::from(a.share))?;
    let jod = study.jod(&shown, &study.converged())?;
    let at = |i: usize| i as f64 / f64::from(FRAMES_PER_SECOND);
    let walking: Vec<Point> =
        shown.into_iter().enumerate().map(|(i, picture)| judged(i, at(i), picture)).collect();
    let deciding = stood.deciding + walked.deciding;
    Ok(Outcome {
        still: curve.area(study.still().seconds()) * curve.points()[0].1,
        walking: walking.iter().map(|p| p.corrected.flip).sum::<f64>() / walking.len().max(1) as f64,
        jod,
        curves: [still, walking],
        deciding: deciding / (deciding + stood.tracing + walked.tracing),
    })
}

/// A scene's medians.
fn rows_of(name: &str, entrants: &[Entrant], outcomes: &[Vec<Outcome>]) -> Vec<Row> {
    let mut rows = Vec::new();
    let values = |of: fn(&Outcome) -> f64| -> Vec<Vec<f64>> {
        outcomes.iter().map(|runs| runs.iter().map(of).collect()).collect()
    };
    for (motion, of) in
        [("still", (|o| o.still) as fn(&Outcome) -> f64), ("walking", |o: &Outcome| o.walking)]
    {
        let values = values(of);
        let others = entrants.iter().zip(&values).filter(|(e, _)| e.policy.policy != Policy::Utility);
        let best = others.filter_map(|(_, v)| median(v)).fold(f64::INFINITY, f64::min);
        for (entrant, values) in entrants.iter().zip(&values) {
            let what = format!("{name}, {motion}: {}", entrant.name);
            let row = Row::new(what, "mean FLIP", values).held_against(CONVERGED);
            rows.push(match entrant.policy.policy {
                Policy::Utility if best.is_finite() => {
                    row.against("best other", Some(best)).aim(Aim::RatioAtMost(1.05))
                }
                _ => row,
            });
        }
    }
    for (entrant, values) in entrants.iter().zip(values(|o| o.jod)) {
        let row = Row::new(format!("{name}, walking: {}", entrant.name), "JOD", &values);
        rows.push(row.held_against(CONVERGED));
    }
    rows
}

/// Our order beside the others over all scenes.
fn totals(entrants: &[Entrant], sums: &[Vec<f64>], deciding: &[f64], scenes: usize) -> Vec<Row> {
    let total = |name: &str| -> Option<Vec<f64>> {
        let i = entrants.iter().position(|e| e.name == name)?;
        Some(sums[i].iter().map(|sum| sum / (2 * scenes.max(1)) as f64).collect())
    };
    let mut rows = Vec::new();
    let Some(utility) = total("utility").filter(|_| scenes > 0) else { return rows };
    for (peer, aim) in [("as published in 2001", 0.7), ("attention of 2001", 0.7), ("uniform", 0.8)] {
        if let Some(theirs) = total(peer) {
            let row = Row::new("all scenes, still and walking: utility", "mean FLIP", &utility);
            rows.push(row.against(peer, median(&theirs)).aim(Aim::RatioAtMost(aim)));
        }
    }
    rows.push(Row::new("share of time spent deciding: utility", "", deciding).aim(Aim::AtMost(0.02)));
    rows
}

/// Curves by entrant and run: standing still and walking.
fn ways(entrants: &[Entrant], outcomes: Vec<Vec<Outcome>>) -> [Vec<Way>; 2] {
    let mut ways = [Vec::new(), Vec::new()];
    for (entrant, outcomes) in entrants.iter().zip(outcomes) {
        let (still, walking) = outcomes.into_iter().map(|o| o.curves.into()).unzip();
        for (ways, runs) in ways.iter_mut().zip([still, walking]) {
            ways.push(Way { runs, ..Way::new(entrant.name.clone(), CONVERGED) });
        }
    }
    ways
}
