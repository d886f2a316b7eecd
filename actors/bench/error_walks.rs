//! `foveal bench error --what walks`: how far the pictures of a walk are from what each of its views converges to, by the
//! processor time of a frame, with what lies between samples and, beside it, in tiles.

use foveal::image::Map2d;
use foveal::splatting::Footprint;
use glam::Vec3;

use super::error::{CONVERGED, ErrorArguments};
use super::error_curves::{CSV_HEAD, Judge, Point, Way, csv};
use super::error_page::{Axes, Panel, sections_of, write_page};
use super::made::Subject;
use super::stages::quick_world;
use super::study::{Entrant, FRAMES_PER_SECOND, Study, Traced, policies};
use foveal_engine::Opened;
use foveal_engine::failure::Failure;
use foveal_engine::interrupt::{interrupted, uninterrupted};
use foveal_terminal::progress::Progress;
use foveal_terminal::table::{Aim, Row, finish, median};

/// Footprints that are compared, the usual one first.
const FOOTPRINTS: [(Footprint, &str); 2] = [(Footprint::Smooth, "smooth"), (Footprint::Tile, "tiles")];

/// What walks with one footprint at one frame time came to, by run.
#[derive(Default)]
struct FootprintResults {
    /// Mean FLIP of the corrected pixels over the frames.
    flip: Vec<f64>,
    /// Just objectionable differences of the whole walk: 10 is the same.
    jod: Vec<f64>,
    curves: Vec<Vec<Point>>,
}

impl FootprintResults {
    fn add(
        &mut self,
        study: &Study,
        entrant: &Entrant,
        footprint: Footprint,
        seconds: f64,
    ) -> Result<(), Failure> {
        let shown = study.walk_in_time(entrant, footprint, seconds)?;
        self.jod.push(study.jod(&shown, &study.converged())?);
        let judged = |(i, picture): (usize, Map2d<Vec3>)| {
            let view = &study.views[i];
            let judge =
                Judge { objects: &view.buffers.object, tone: &study.tone, keeps: self.curves.is_empty() };
            judge.point(&view.reference, i as f64 / f64::from(FRAMES_PER_SECOND), &picture)
        };
        let curve: Vec<Point> = shown.into_iter().enumerate().map(judged).collect();
        self.flip.push(curve.iter().map(|p| p.corrected.flip).sum::<f64>() / curve.len().max(1) as f64);
        self.curves.push(curve);
        Ok(())
    }
}

/// Mean FLIP of the corrected pixels of the views, and JOD of all of them, beside the same with other random numbers.
fn noise_of(study: &Study) -> Result<(f64, f64), Failure> {
    let others = study.converged_otherwise()?;
    let jod = study.jod(&others, &study.converged())?;
    let flip = |(view, other): (&Traced, &Map2d<Vec3>)| {
        let judge = Judge { objects: &view.buffers.object, tone: &study.tone, keeps: false };
        judge.point(&view.reference, 0.0, other).corrected.flip
    };
    let sum: f64 = study.views.iter().zip(&others).map(flip).sum();
    Ok((sum / others.len().max(1) as f64, jod))
}

/// Runs the benchmark.
pub(super) fn run(a: &ErrorArguments, scenes: &[String], progress: Progress) -> Result<(), Failure> {
    let entrant = policies(&["utility".to_owned()])?.remove(0);
    let runs = a.common.runs as usize;
    let bar = progress.bar((scenes.len() * runs) as u64, "scenes");
    let (mut rows, mut sections, mut table) = (Vec::new(), Vec::new(), String::from(CSV_HEAD));
    // By frame time and footprint: the median of each scene.
    let mut flips = vec![[(); 2].map(|()| Vec::new()); a.frame_time.len()];
    let mut noises = Vec::new();
    'scenes: for word in scenes {
        let name = Subject::name(word);
        let opened = Opened::of_world(quick_world(Subject::of(word)?.path())?);
        let study = match Study::new(opened, a.size, a.frames, false) {
            Err(Failure::Interrupted(_)) => break,
            study => study?,
        };
        let mut walked: Vec<[FootprintResults; 2]> =
            a.frame_time.iter().map(|_| Default::default()).collect();
        let noise = match noise_of(&study) {
            Err(Failure::Interrupted(_)) => break,
            noise => noise?,
        };
        for _ in 0..runs {
            for (time, walked) in a.frame_time.iter().zip(&mut walked) {
                for ((footprint, _), walked) in FOOTPRINTS.into_iter().zip(walked) {
                    walked.add(&study, &entrant, footprint, time.as_secs_f64())?;
                }
            }
            // A run that Ctrl-C fell into does not count.
            if interrupted() {
                break 'scenes;
            }
            bar.inc(1);
        }
        for (unit, value) in [("mean FLIP", noise.0), ("JOD", noise.1)] {
            let what = format!("{name}, converged with other random numbers");
            rows.push(Row::new(what, unit, &[value]).held_against(CONVERGED));
        }
        noises.push(noise.0);
        let mut ways = Vec::new();
        for ((time, walked), flips) in a.frame_time.iter().zip(walked).zip(&mut flips) {
            let what = format!("{name}, {time:?} a frame");
            let [ours, tiles] = &walked;
            let of_tiles = |values: &[f64]| ("tiles".to_owned(), median(values));
            let row = |unit, ours: &[f64], tiles: &[f64]| {
                let (peer, value) = of_tiles(tiles);
                Row::new(what.clone(), unit, ours).against(peer, value).held_against(CONVERGED)
            };
            rows.push(row("mean FLIP", &ours.flip, &tiles.flip));
            rows.push(row("JOD", &ours.jod, &tiles.jod).aim(Aim::AtLeast(7.5)));
            for (((_, footprint), walked), flips) in FOOTPRINTS.into_iter().zip(walked).zip(flips) {
                flips.extend(median(&walked.flip));
                let way = Way::new(format!("{footprint}, {time:?}"), CONVERGED);
                ways.push(Way { runs: walked.curves, ..way });
            }
        }
        table += &csv(name, "walking", &ways);
        if let (Some(out), Some(last)) = (&a.common.out, study.views.last()) {
            let panel = Panel {
                title: format!("{name}, walking"),
                file: format!("walks-{name}"),
                against: CONVERGED.to_string(),
                ways: ways.iter().collect(),
                axes: Axes::Walking,
                at: f64::from(a.frames - 1) / f64::from(FRAMES_PER_SECOND),
                references: vec![(format!("reference: {CONVERGED}"), &last.reference)],
            };
            sections.extend(sections_of(out, &[panel], &study.tone)?);
        }
    }
    for (time, [ours, tiles]) in a.frame_time.iter().zip(&flips).filter(|(_, [ours, _])| !ours.is_empty()) {
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let row = Row::new(format!("all scenes, {time:?} a frame"), "mean FLIP", &[mean(ours)]);
        rows.push(row.against("tiles", Some(mean(tiles))).aim(Aim::RatioAtMost(0.5)));
    }
    if !noises.is_empty() {
        let mean = noises.iter().sum::<f64>() / noises.len() as f64;
        let row = Row::new("all scenes, converged with other random numbers", "mean FLIP", &[mean]);
        rows.push(row.held_against(CONVERGED));
    }
    bar.finish_and_clear();
    let mut notes = vec![
        "mean FLIP of the corrected pixels of a walk's frames, and JOD of the whole walk (10: the same as what its views \
         converge to)"
            .into(),
        "converged with other random numbers: what the noise of single samples makes of the same views, which no walk can \
         predict"
            .into(),
        "each walk goes by itself, on a clock that moves by the processor time of all its actors".into(),
    ];
    if interrupted() {
        notes.push("interrupted: fewer scenes or runs than asked for".into());
    }
    if let Some(out) = &a.common.out {
        write_page(out, "walks.csv", &table, &rows, &notes, sections)?;
    }
    finish("error", &rows, &notes, &a.common)?;
    uninterrupted()
}
