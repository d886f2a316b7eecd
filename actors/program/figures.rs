//! The figures of a walk's report, in the manner of the first paper's figures 3 to 6.

use std::sync::Arc;

use rayon::prelude::*;
use serde_json::Value;

use foveal::display::FrameBuffers;
use foveal::display::cpu_pass::{self, Passes};
use foveal::display::tone::ToneMap;
use foveal::image::Map2d;
use foveal::perception::pyramid::upsample;
use foveal::perception::saliency::CELL;
use foveal::sampling::{Lattice, Rect};
use foveal::scene::Camera;
use foveal::splatting::trace::{Owner, trace_samples};
use foveal::splatting::{Reconstruction, SampleBatch, SampleCache, SplatLayer, warp};
use foveal::world::World;

use super::walk_report::{Walked, percentiles};
use foveal_actors::analyzer::Analyzer;
use foveal_actors::renderer::Renderer;
use foveal_actors::settings::Settings;
use foveal_actors::stages::Stage;
use foveal_engine::files::png_bytes;
use foveal_engine::{Engine, Failure};
use foveal_terminal::plots::Plot;
use foveal_terminal::report::{Figure, Page, Table};

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
            if shown.drawn.buffers.object.at(x as usize, y as usize) == 0 {
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
        Map2d::from_fn(self.buffers.width(), self.buffers.height(), |x, y| {
            tone.to_rgb8(self.buffers.color.at(x, y) + between.pixel(x, y))
        })
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
    let mut figures =
        vec![figure("Corrected", "Every non-diffuse pixel shows its own ray.", &from.shown(&layer))?];
    let nearer = Camera { eye: camera.eye.lerp(camera.target, 0.12), ..*camera };
    let to = Still::new(world, &nearer, w, h, settings.k_max, settings.seed);
    layer.clear();
    layer.splat_warped(&warp(&cache, 2, &to.frame), &to.buffers.object, &to.buffers.depth);
    figures.push(figure("Warped", "A step nearer: the samples of before, none new.", &to.shown(&layer))?);
    let steps = [
        (1..=4u32, "Levels 1 to 4 fresh over the warped ones."),
        (5..=to.lattice.levels(), "All levels: converged again."),
    ];
    for (levels, caption) in steps {
        for level in levels.filter(|&l| l <= to.lattice.levels()) {
            for batch in to.level(2, level) {
                layer.splat_fresh(&batch, &to.buffers.object, 1);
            }
        }
        figures.push(figure("Refined", caption, &to.shown(&layer))?);
    }
    Ok(figures)
}

/// The whole page.
pub fn page(engine: &Engine, document: &Value, walked: &Walked, fps: f32) -> Result<Page, Failure> {
    let (world, settings) = (&engine.opened().world, engine.settings());
    let mut figures = Vec::new();
    let camera = engine.look(Renderer::camera).flatten();
    let renderer_figures = engine.look(|r| {
        let last = r.shown().map(|s| figure("Last frame", "As shown.", &s.rgb8));
        let traced = who_traced_what(r).map(|p| {
            figure(
                "Who traced what",
                "Corrected pixels coloured by tracer; white: a warped sample of an earlier view.",
                &p,
            )
        });
        let pattern = sampling_pattern(r, &settings.lattice(), 5).map(|p| {
            figure(
                "Sampling pattern",
                "Sample positions of levels 1 (red), 2 (blue), 3 (green), 4 (yellow), 5 (violet).",
                &p,
            )
        });
        [last, traced, pattern].into_iter().flatten().collect::<Result<Vec<_>, _>>()
    });
    figures.extend(renderer_figures.transpose()?.unwrap_or_default());
    if let Some(correction) = engine.actors().correction {
        let (w, h) = (settings.width as usize, settings.height as usize);
        let map = engine.runtime().inspect(correction.analyzer, |a| saliency_picture(a, w, h)).flatten();
        if let Some(map) = map {
            figures.push(figure(
                "Saliency",
                "Bright: draws the eye (square root of the map, scaled).",
                &map,
            )?);
        }
        // A walk of one frame has nothing to warp, and its process is to end with it.
        if let Some(camera) = camera.filter(|_| walked.frame_ms.len() > 1) {
            figures.extend(warp_figures(world, &camera, settings)?);
        }
    }
    let of = |stage| walked.stages.iter().filter(|s| s.0 == stage).map(|s| s.1).collect::<Vec<f32>>();
    let stages = Table {
        title: "Stages, ms per frame in which they ran".into(),
        header: ["stage", "median", "95 %", "99 %", "frames", "the paper, 8 processors of 2001"]
            .map(String::from)
            .to_vec(),
        rows: Stage::ALL
            .into_iter()
            .map(|stage| {
                let values = of(stage);
                let [median, p95, p99] = percentiles(&values).map(|v| format!("{v:.3}"));
                vec![stage.key().into(), median, p95, p99, values.len().to_string(), paper(stage).into()]
            })
            .collect(),
    };
    let mut levels = Table {
        title: "Cached samples by level".into(),
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
        header: ["actor", "messages", "turns", "busy ms"].map(String::from).to_vec(),
        rows: engine
            .runtime()
            .counters()
            .iter()
            .map(|c| {
                vec![
                    c.name.clone(),
                    c.delivered.to_string(),
                    c.turns.to_string(),
                    format!("{:.1}", c.busy_ns as f64 * 1e-6),
                ]
            })
            .collect(),
    };
    let plan = Table {
        title: "What the scene needs".into(),
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
    for warning in document["warnings"].as_array().into_iter().flatten().filter_map(Value::as_str) {
        summary.push(format!("Warning: {warning}"));
    }
    let frames = Plot {
        title: "Frames".into(),
        caption: "Blue: from a frame's beginning until it was shown. Orange: drawing of the base layer. Red: the deadline."
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
        summary,
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
