//! The figures of a walk's report, in the manner of the first paper's figures 3 to 6.

use std::sync::Arc;
use std::time::{Duration, Instant};

use glam::Vec3;
use rayon::prelude::*;
use serde_json::Value;

use foveal::display::FrameBuffers;
use foveal::display::cpu_pass::{self, Passes};
use foveal::display::tone::{ToneCurve, ToneMap};
use foveal::image::{Map2d, linear_from_srgb};
use foveal::metrics::heat::heat_map;
use foveal::metrics::{self, quantile};
use foveal::perception::pyramid::upsample;
use foveal::perception::saliency::CELL;
use foveal::sampling::{Lattice, Rect};
use foveal::scene::Camera;
use foveal::splatting::trace::{Owner, trace_samples};
use foveal::splatting::{Reconstruction, SampleBatch, SampleCache, SplatLayer, warp};
use foveal::world::World;

use super::walk_report::{Walked, percentiles};
use foveal_actors::analyzer::Analyzer;
use foveal_actors::message::FrameSnapshot;
use foveal_actors::renderer::Renderer;
use foveal_actors::settings::Settings;
use foveal_actors::stages::Stage;
use foveal_engine::files::png_bytes;
use foveal_engine::interrupt::interrupted;
use foveal_engine::reference::traced_picture;
use foveal_engine::{Engine, Failure};
use foveal_terminal::bars::{Bar, Bars};
use foveal_terminal::known::{Known, SURE};
use foveal_terminal::machine::made_on;
use foveal_terminal::plots::Plot;
use foveal_terminal::report::{Compared, Comparison, Figure, Page, Table};
use foveal_terminal::table::figure as figure_of;

type Rgb8 = Map2d<[u8; 3]>;

/// What the paper measured on eight processors of 2001 (§5), where it gives a figure.
fn paper(stage: Stage) -> &'static str {
    match stage {
        Stage::Age => "5–10 ms (50,000 samples)",
        Stage::Display => "40–50 ms (90,000 triangles)",
        Stage::WarpSplat => "20–30 ms (50,000 samples)",
        Stage::Attention => "< 300 ms",
        Stage::Correct | Stage::Allocate | Stage::Compose => "–",
    }
}

fn figure(title: &str, caption: &str, picture: &Rgb8) -> Result<Figure, Failure> {
    let (w, h) = (picture.width() as u32, picture.height() as u32);
    let png = png_bytes(w, h, picture.data().as_flattened())?;
    Ok(Figure { title: title.into(), caption: caption.into(), png })
}

/// Distinct colours for small numbers.
fn color_of(n: u32) -> [u8; 3] {
    const COLORS: [[u8; 3]; 8] = [
        [228, 26, 28],
        [55, 126, 184],
        [77, 175, 74],
        [255, 191, 0],
        [152, 78, 163],
        [255, 127, 0],
        [0, 190, 190],
        [247, 129, 191],
    ];
    COLORS[n as usize % COLORS.len()]
}

fn dimmed([r, g, b]: [u8; 3]) -> [u8; 3] {
    let grey = ((u16::from(r) + u16::from(g) + u16::from(b)) / 6) as u8;
    [grey, grey, grey]
}

/// Colours every corrected pixel by the tracer of its sample (the paper's figure 3).
fn who_traced_what(renderer: &Renderer) -> Option<Rgb8> {
    let shown = renderer.shown()?;
    let layer = renderer.layer();
    Some(Map2d::from_fn(shown.rgb8.width(), shown.rgb8.height(), |x, y| {
        match (layer.is_covered(x, y), layer.source(x, y)) {
            (true, 0) => [255, 255, 255],
            (true, source) => color_of(u32::from(source) - 1),
            (false, _) => dimmed(shown.rgb8.at(x, y)),
        }
    }))
}

/// Colours the samples of each level on the objects (the paper's figure 5).
fn sampling_pattern(renderer: &Renderer, lattice: &Lattice, levels: u32) -> Option<Rgb8> {
    let shown = renderer.shown()?;
    let mut picture = shown.rgb8.map(dimmed);
    let (w, h) = (picture.width(), picture.height());
    for level in (1..=levels.min(lattice.levels())).rev() {
        let radius = (levels - level) as i32;
        for (x, y) in lattice.all_samples(level, Rect::of_size(w as u32, h as u32)) {
            if shown.drawn.buffers().object.at(x as usize, y as usize) == 0 {
                continue;
            }
            for (dx, dy) in (-radius..=radius).flat_map(|dy| (-radius..=radius).map(move |dx| (dx, dy))) {
                let (px, py) = (x + dx, y + dy);
                if px >= 0 && py >= 0 && (px as usize) < w && (py as usize) < h {
                    *picture.at_mut(px as usize, py as usize) = color_of(level - 1);
                }
            }
        }
    }
    Some(picture)
}

fn saliency_picture(analyzer: &Analyzer, width: usize, height: usize) -> Option<Rgb8> {
    let map = analyzer.saliency();
    if map.width() == 0 || analyzer.analyzed() == 0 {
        return None;
    }
    let full = upsample(map, width, height, CELL);
    let top = full.data().iter().copied().fold(1e-9, f32::max);
    Some(full.map(|s| [(255.0 * (s / top).sqrt()) as u8; 3]))
}

/// A view drawn, for the figure of warping.
struct Still<'w> {
    world: &'w World,
    frame: foveal::scene::camera::CameraFrame,
    buffers: FrameBuffers,
    lattice: Lattice,
    seed: u64,
}

impl<'w> Still<'w> {
    fn new(world: &'w World, camera: &Camera, width: u32, height: u32, k_max: u32, seed: u64) -> Self {
        let frame = camera.frame(width, height);
        let mut buffers = FrameBuffers::new(width as usize, height as usize);
        cpu_pass::draw(world, &frame, Passes { texture_ids: false }, &mut buffers);
        let lattice = Lattice::new(k_max, [width as i32 / 2, height as i32 / 2]);
        Self { world, frame, buffers, lattice, seed }
    }

    /// All samples of one level, by object.
    fn level(&self, view: u32, level: u32) -> Vec<SampleBatch> {
        const JOB: usize = 512;
        let rect = Rect::of_size(self.frame.size[0], self.frame.size[1]);
        let id = |&(x, y): &(i32, i32)| self.buffers.object.at(x as usize, y as usize);
        let mut pixels: Vec<(i32, i32)> =
            self.lattice.all_samples(level, rect).filter(|pixel| id(pixel) != 0).collect();
        pixels.sort_by_key(id);
        let jobs: Vec<&[(i32, i32)]> =
            pixels.chunk_by(|a, b| id(a) == id(b)).flat_map(|of_object| of_object.chunks(JOB)).collect();
        let trace = |job: &&[(i32, i32)]| {
            let owner = Owner { view, object: id(&job[0]), k: self.lattice.k_of(level) };
            trace_samples(self.world, &self.frame, &self.buffers, owner, job.iter().copied(), self.seed)
        };
        jobs.par_iter().map(trace).collect()
    }

    fn shown(&self, layer: &SplatLayer) -> Rgb8 {
        let tone = ToneMap::from(&self.world.scene.display);
        let between = Reconstruction::new(layer, &self.buffers, &self.frame, tone.white());
        let mut picture = Map2d::new(self.buffers.width(), self.buffers.height(), [0; 3]);
        between.fill(&mut picture, |x, y, splats| tone.to_rgb8(self.buffers.color.at(x, y) + splats));
        picture
    }
}

/// The paper's figure 6: a corrected view; its samples warped into a nearer one; fresh samples of the first
/// levels over them.
fn warp_figures(world: &World, camera: &Camera, settings: &Settings) -> Result<Vec<Figure>, Failure> {
    let scale = (320.0 / settings.width as f32).min(1.0);
    let (w, h) =
        (((settings.width as f32 * scale) as u32).max(1), ((settings.height as f32 * scale) as u32).max(1));
    let from = Still::new(world, camera, w, h, settings.k_max, settings.seed);
    let mut layer = SplatLayer::new(w as usize, h as usize, settings.k_max, settings.footprint);
    let mut cache = SampleCache::new(usize::MAX);
    for level in 1..=from.lattice.levels() {
        for batch in from.level(1, level) {
            layer.splat_fresh(&batch, &from.buffers.object, 1);
            cache.insert(Arc::new(batch));
        }
    }
    let mut figures = vec![figure(
        "Warping, 1: a corrected view",
        "Every non-diffuse pixel shows its own ray. The next three pictures show what becomes of it after a step.",
        &from.shown(&layer),
    )?];
    let nearer = Camera { eye: camera.eye.lerp(camera.target, 0.12), ..*camera };
    let to = Still::new(world, &nearer, w, h, settings.k_max, settings.seed);
    layer.clear();
    layer.splat_warped(&warp(&cache, 2, &to.frame), &to.buffers.object, &to.buffers.depth);
    figures.push(figure(
        "Warping, 2: reprojected samples",
        "After a step forward, with the samples of the first view reprojected and none new: reflections lag behind, and \
         there are gaps at edges.",
        &to.shown(&layer),
    )?);
    let steps = [
        (
            1..=4u32,
            "Warping, 3: levels 1 to 4 traced anew",
            "New samples of the four coarsest levels over the reprojected ones: large shapes in reflections are right again.",
        ),
        (
            5..=to.lattice.levels(),
            "Warping, 4: all levels traced anew",
            "Every non-diffuse pixel shows its own ray again: lagging reflections and gaps are gone.",
        ),
    ];
    for (levels, title, caption) in steps {
        for level in levels.filter(|&l| l <= to.lattice.levels()) {
            for batch in to.level(2, level) {
                layer.splat_fresh(&batch, &to.buffers.object, 1);
            }
        }
        figures.push(figure(title, caption, &to.shown(&layer))?);
    }
    Ok(figures)
}

/// Longest time for the picture that the last frame would have become.
const REFERENCE: Duration = Duration::from_secs(4);

/// The last frame beside what its view converges to; `None` where that takes too long.
fn beside_reference(world: &World, shown: &FrameSnapshot, seed: u64) -> Result<Option<Comparison>, Failure> {
    let start = Instant::now();
    let in_time = || start.elapsed() < REFERENCE && !interrupted();
    let traced = traced_picture(world, &shown.drawn.frame, seed, 1, &in_time).picture;
    if !in_time() {
        return Ok(None);
    }
    let tone = ToneMap::from(&world.scene.display);
    let reference = traced.map(|c| tone.to_rgb8(c));
    // Both as they are displayed: what a screen cannot show is no difference.
    let linear = |rgb8: &Rgb8| rgb8.map(|b| Vec3::from(b.map(|b| linear_from_srgb(f32::from(b) / 255.0))));
    let as_shown = ToneMap { exposure: 1.0, curve: ToneCurve::Clamp };
    let Ok(compared) = metrics::compare(&linear(&shown.rgb8), &linear(&reference), &as_shown) else {
        return Ok(None);
    };
    let caption = format!(
        "Mean FLIP {}: 0 where no difference is seen, 1 at most. In the difference, look for bright edges of reflections.",
        figure_of(compared.flip)
    );
    let flip = figure("FLIP", "", &heat_map(&compared.flip_map))?;
    Ok(Some(Comparison {
        title: "The last frame compared with its converged view".into(),
        caption: "Left of the line is what was shown at the deadline, right of it what the same view converges to. Look at \
                  mirrors, glass and gloss: diffuse surfaces are the same in both. The difference (FLIP) is bright \
                  where a viewer who flips between the two would notice it."
            .into(),
        size: [shown.rgb8.width() as u32, shown.rgb8.height() as u32],
        reference: figure("Converged", "", &reference)?,
        shown: vec![Compared { figure: figure("Shown", &caption, &shown.rgb8)?, flip: flip.png }],
    }))
}

/// Stages of a frame, as bars and as a table.
fn stages(walked: &Walked) -> (Bars, Table) {
    let of = |stage| walked.stages.iter().filter(move |s| s.0 == stage).map(|s| f64::from(s.1));
    let known = |stage| Some((stage, Known::of(of(stage))?));
    let known: Vec<(Stage, Known)> = Stage::ALL.into_iter().filter_map(known).collect();
    let bar = |(stage, known): &(Stage, Known)| Bar {
        name: stage.key().into(),
        text: known.text("ms", "frames"),
        median: known.median,
        bounds: known.bounds,
        reach: [0.05, 0.95].map(|share| quantile(of(*stage), share)),
        target: None,
        peer: None,
        is_missed: false,
    };
    let bars = Bars {
        title: "Where the time of a frame goes".into(),
        caption: format!(
            "Milliseconds in the frames in which a stage ran, on a scale from 0. Dot: the median. Thin line: the 95 % \
             confidence interval of the median, or the range of all frames where there are fewer than {SURE}. Wide line: \
             the 5th to the 95th percentile of the frames. The dot furthest to the right is the stage to shorten first; \
             a long line is a stage that is much slower in some frames than in others."
        ),
        unit: "ms".into(),
        bars: known.iter().map(bar).collect(),
        ..Bars::default()
    };
    let table = Table {
        title: "Stages compared with the paper".into(),
        caption: "Medians and percentiles over the frames in which a stage ran; of few frames there are no percentiles. In \
                  the last column is what Haber et al. measured in 2001 on eight processors, for the sizes given there."
            .into(),
        header: ["stage", "median, ms", "95th percentile", "99th percentile", "frames", "eight processors of 2001"]
            .map(String::from)
            .to_vec(),
        rows: known
            .iter()
            .map(|(stage, known)| {
                let count = of(*stage).count();
                // Of few frames the last hundredth is no more than the slowest.
                let late = |share: f64, least: usize| match count >= least {
                    true => figure_of(quantile(of(*stage), share)),
                    false => "–".into(),
                };
                let stage = *stage;
                vec![
                    stage.key().into(),
                    known.text("", "frames"),
                    late(0.95, 20),
                    late(0.99, 100),
                    count.to_string(),
                    paper(stage).into(),
                ]
            })
            .collect(),
    };
    (bars, table)
}

/// The whole page.
pub fn page(engine: &Engine, document: &Value, walked: &Walked, fps: f32) -> Result<Page, Failure> {
    let (world, settings) = (&engine.opened().world, engine.settings());
    let mut figures = Vec::new();
    let camera = engine.look(Renderer::camera).flatten();
    let shown = engine.look(|r| r.shown().cloned()).flatten();
    let corrects = engine.actors().correction.is_some();
    // A walk of one frame has shown what it was asked for, and its process is to end with it.
    let (comparison, why_not) = match &shown {
        Some(_) if !corrects => {
            (None, "Nothing in the scene needs correction, so there is nothing to compare it with.")
        }
        Some(_) if document["converged"] == true => {
            (None, "It has converged, so there is nothing to compare it with.")
        }
        Some(_) if walked.frame_ms.len() <= 1 => {
            (None, "A walk of one frame is not compared with its converged view.")
        }
        // Under the light that it was shown in.
        Some(shown) => match beside_reference(&shown.drawn.world, shown, settings.seed)? {
            None => {
                (None, "It is not compared with its converged view, which could not be traced within 4 s.")
            }
            found => (found, ""),
        },
        None => (None, ""),
    };
    if let (None, Some(shown)) = (&comparison, &shown) {
        figures.push(figure(
            "Last frame",
            &format!("As it was shown at its deadline. {why_not}"),
            &shown.rgb8,
        )?);
    }
    let renderer_figures = engine.look(|r| {
        let traced = who_traced_what(r).map(|p| {
            figure(
                "Who traced what",
                "Each tracer has a colour, on the pixels that show its samples; white pixels show a reprojected sample of \
                 an earlier view. Where colours alternate in small patches, all tracers were busy.",
                &p,
            )
        });
        let pattern = sampling_pattern(r, &settings.lattice(), 5).map(|p| {
            figure(
                "Sampling pattern",
                "Where the √5 lattice has its samples: level 1 red, 2 blue, 3 green, 4 yellow, 5 violet. Each level has \
                 five times as many as the one before, turned by 27°, so no row or column of pixels stands out.",
                &p,
            )
        });
        [traced, pattern].into_iter().flatten().collect::<Result<Vec<_>, _>>()
    });
    figures.extend(renderer_figures.transpose()?.unwrap_or_default());
    if let Some(correction) = engine.actors().correction {
        let (w, h) = (settings.width as usize, settings.height as usize);
        let map = engine.runtime().inspect(correction.analyzer, |a| saliency_picture(a, w, h)).flatten();
        if let Some(map) = map {
            figures.push(figure(
                "Saliency",
                "Bright is what draws the eye of someone without a task (Itti et al. 1998): objects there get their samples \
                 first. Shown is the square root, with the highest value white.",
                &map,
            )?);
        }
        // Nor is there anything to warp.
        if let Some(camera) = camera.filter(|_| walked.frame_ms.len() > 1) {
            figures.extend(warp_figures(world, &camera, settings)?);
        }
    }
    let (bars, stages) = stages(walked);
    let mut levels = Table {
        title: "Cached samples by level".into(),
        caption: "What the cache holds at the end. Level 1 is the coarsest; a converged view has about five times as many \
                  samples at each level as at the one before it."
            .into(),
        header: ["level", "samples"].map(String::from).to_vec(),
        rows: Vec::new(),
    };
    if let Some(correction) = engine.actors().correction {
        let per_level =
            engine.runtime().inspect(correction.cache_ager, |c| c.len_per_level()).unwrap_or_default();
        levels.rows = per_level
            .iter()
            .enumerate()
            .rev()
            .map(|(k, n)| vec![(settings.k_max + 1 - k as u32).to_string(), n.to_string()])
            .collect();
    }
    let counters = Table {
        title: "Actors".into(),
        caption: "Messages delivered to each actor, in how many turns, and how long those took altogether. An actor that is \
                  busy for nearly as long as the walk lasts is the one that holds the others up."
            .into(),
        header: ["actor", "messages", "turns", "busy, ms"].map(String::from).to_vec(),
        rows: engine
            .runtime()
            .counters()
            .iter()
            .map(|c| {
                vec![
                    c.name.clone(),
                    c.delivered.to_string(),
                    c.turns.to_string(),
                    figure_of(c.busy_ns as f64 * 1e-6),
                ]
            })
            .collect(),
    };
    let plan = Table {
        title: "What the scene needs".into(),
        caption:
            "Parts of the machine that a walk through this scene needs, those that are left out, and why."
                .into(),
        header: ["part", "", "why"].map(String::from).to_vec(),
        rows: document["plan"]
            .as_array()
            .into_iter()
            .flatten()
            .map(|p| {
                let text = |key: &str| p[key].as_str().unwrap_or_default().to_owned();
                vec![text("part"), if p["needed"] == true { "needed" } else { "skipped" }.into(), text("why")]
            })
            .collect(),
    };
    let samples = &document["samples"];
    let mut summary = vec![format!(
        "{} frames of {} × {} pixels at {fps} frames per second with {} tracers, policy {}.",
        document["frames"],
        settings.width,
        settings.height,
        settings.tracers,
        settings.policy.policy.name()
    )];
    summary.push(format!(
        "{} samples traced, {} warped samples reused, {} expired. {}",
        samples["traced"],
        samples["reused"],
        samples["expired"],
        if document["converged"] == true {
            "The last picture has converged."
        } else {
            "The last picture is still growing."
        }
    ));
    if let Some(known) = Known::of(walked.frame_ms.iter().copied().map(f64::from)) {
        let p99 = match walked.frame_ms.len() {
            100.. => format!(", 99th percentile {} ms", figure_of(percentiles(&walked.frame_ms)[2])),
            _ => String::new(),
        };
        let deadline = figure_of(1e3 / f64::from(fps));
        summary.push(format!(
            "Frames were shown after a median of {}{p99}; the deadline is at {deadline} ms.",
            known.text("ms", "frames")
        ));
    }
    let warnings = document["warnings"].as_array().into_iter().flatten().filter_map(Value::as_str);
    let warnings = warnings.map(str::to_owned).collect();
    let frames = Plot {
        title: "Frame times".into(),
        caption: "Blue: the time from a frame's beginning until it was shown. Orange: drawing the base layer, which samples \
                  have to wait for. Red: the deadline. Blue should lie just below red; a frame above it came late."
            .into(),
        unit: "ms",
        lines: vec![
            ("shown after".into(), walked.frame_ms.clone()),
            ("drawing".into(), walked.display_ms.clone()),
        ],
        limit: Some(1e3 / fps),
    };
    let decisions = [super::texture_page::rate_and_quality(document), super::texture_page::plots(document)];
    Ok(Page {
        title: world.scene.title.clone(),
        made: Some(made_on(document)),
        summary,
        warnings,
        comparison,
        bars: vec![bars],
        figures,
        tables: super::texture_page::bill(document)
            .into_iter()
            .chain(super::texture_page::map_bill(document))
            .chain([stages, levels, counters, plan])
            .collect(),
        plots: std::iter::once(frames).chain(decisions.into_iter().flatten()).collect(),
        sections: Vec::new(),
    })
}
