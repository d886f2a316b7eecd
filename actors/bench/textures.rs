//! `foveal bench textures`: what a limit on texture memory costs the picture and the frame, beside what others do about it.

use std::sync::Arc;

use clap::Args;
use rayon::prelude::*;

use foveal::allocation::decision::{Constraint, Decision, decide};
use foveal::allocation::environment::{MapCandidate, MapChoices};
use foveal::allocation::spatial_error::{SpatialErrors, SpatialSettings};
use foveal::allocation::texture_baselines::{Baseline, LeastRecentlyUsed, choose};
use foveal::allocation::texture_demand::{TextureChoices, TextureUse, predicted_uses};
use foveal::display::FrameBuffers;
use foveal::display::cpu_pass::{self, Passes};
use foveal::display::tone::ToneMap;
use foveal::image::Map2d;
use foveal::metrics::flip;
use foveal::rng;
use foveal::scene::{Camera, Texture};
use foveal::world::World;
use glam::Vec3;

use super::made::MadeScene;
use super::stages::quick_world;
use super::texture_walks::walks;
use super::timed;
use foveal_actors::allocator::decisions::WORK_AT_ONCE;
use foveal_actors::textures::decisive;
use foveal_engine::failure::Failure;
use foveal_engine::files::make_folder;
use foveal_terminal::arguments::Size;
use foveal_terminal::progress::Progress;
use foveal_terminal::table::{Aim, CommonArguments, Row, finish, write_csv};

/// Arguments of `foveal bench textures`.
#[derive(Args, Debug)]
pub struct TexturesArguments {
    /// Picture size
    #[arg(long, value_name = "WxH", default_value = "512x384")]
    size: Size,
    /// Views along the gallery's path
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(2..=1000))]
    views: u32,
    #[command(flatten)]
    common: CommonArguments,
}

/// How many times larger than the limit the textures are.
const OVERSUBSCRIPTIONS: [u64; 4] = [2, 4, 8, 16];

/// Runs the benchmark.
pub fn run(a: &TexturesArguments, progress: Progress) -> Result<(), Failure> {
    let bar = progress.bar(4, "textures");
    let mut rows = Vec::new();
    let gallery = MadeScene::bundled("gallery")?;
    rows.extend(walks(&gallery, a.size, &a.common)?);
    bar.inc(1);
    let study = TextureStudy::new(quick_world(gallery.path())?);
    let (under_limit, points) = under_limits(&study, a);
    rows.extend(under_limit);
    bar.inc(1);
    rows.extend(decisions(a));
    bar.inc(1);
    rows.push(agreement(a)?);
    bar.finish_and_clear();
    if let Some(out) = &a.common.out {
        make_folder(out)?;
        let head = "textures/limit,method,mean FLIP,visible error";
        write_csv(&out.join("textures-quality.csv"), head, points)?;
    }
    let notes = vec![
        "FLIP is against the same pictures with all textures, the mean over the views of the gallery's tour. The paper's \
         3 → 40 frames per second are those of its graphics card."
            .into(),
    ];
    finish("textures", &rows, &notes, &a.common)
}

/// A world with all textures, and what its metric needs.
struct TextureStudy {
    world: World,
    bytes: Vec<Vec<u64>>,
    spatial: Vec<SpatialErrors>,
    means: Vec<f32>,
    tone: ToneMap,
}

impl TextureStudy {
    fn new(world: World) -> Self {
        let display = world.scene.display;
        let settings = SpatialSettings::new(10.8, display.white_cd_m2);
        let spatial: Vec<_> =
            world.scene.textures.par_iter().map(|t| SpatialErrors::of_texture(t, &settings)).collect();
        let pinned = decisive(&world.scene);
        let bytes_of = |(i, t): (usize, &Texture)| match pinned[i] {
            true => vec![t.mips.bytes() as u64],
            false => (0..t.level_count()).map(|l| t.mips.level_bytes(l) as u64).collect(),
        };
        Self {
            // What decides geometry is there in full, whoever decides.
            bytes: world.scene.textures.iter().enumerate().map(bytes_of).collect(),
            means: spatial.iter().map(SpatialErrors::mean_luminance).collect(),
            tone: ToneMap::from(&display),
            spatial,
            world,
        }
    }

    fn all(&self) -> u64 {
        self.bytes.iter().flatten().sum()
    }

    fn picture(&self, world: &World, camera: &Camera, size: Size) -> Map2d<Vec3> {
        let mut buffers = FrameBuffers::new(size.width as usize, size.height as usize);
        let frame = camera.frame(size.width, size.height);
        cpu_pass::draw(world, &frame, Passes { texture_ids: false }, &mut buffers);
        buffers.color
    }

    /// The world with these finest levels.
    fn limited(&self, states: &[usize]) -> World {
        let scene = &self.world.scene;
        let reduced = |(t, &finest): (&Texture, &usize)| Texture {
            mips: Arc::new(t.mips.without_finer(finest)),
            ..t.clone()
        };
        self.world.with_resident(scene.textures.iter().zip(states).map(reduced).collect())
    }

    fn uses(&self, camera: &Camera, size: Size) -> Vec<TextureUse> {
        predicted_uses(&self.world, &camera.frame(size.width, size.height), &self.means)
    }

    fn decided(&self, uses: &[TextureUse], limit: u64, now: Option<&[usize]>) -> Option<Vec<usize>> {
        let choices = TextureChoices { bytes: &self.bytes, uses, spatial: &self.spatial };
        Some(decide(&choices, Constraint::Bytes(limit), now).ok()?.states)
    }
}

/// The cameras of a path.
fn cameras(world: &World, count: u32) -> Vec<Camera> {
    let still = world.scene.cameras[0].camera;
    let Some(path) = world.scene.paths.first() else { return vec![still] };
    let at = |i: u32| path.at(path.duration() * i as f32 / count as f32, still.up, still.fov_y);
    (0..count).map(at).collect()
}

/// Textures over their limit, method, mean FLIP and visible error.
type Quality = (u64, &'static str, f64, f64);

/// Pictures under several limits, ours and the baselines'.
fn under_limits(study: &TextureStudy, a: &TexturesArguments) -> (Vec<Row>, Vec<Quality>) {
    let cameras = cameras(&study.world, a.views);
    let full: Vec<Map2d<Vec3>> = cameras.iter().map(|c| study.picture(&study.world, c, a.size)).collect();
    let uses: Vec<Vec<TextureUse>> = cameras.iter().map(|c| study.uses(c, a.size)).collect();
    let loss = |i: usize, states: &[usize]| {
        let shown = study.picture(&study.limited(states), &cameras[i], a.size);
        flip::mean(&flip::flip(&full[i], &shown, &study.tone))
    };
    let mut rows = Vec::new();
    let mut points = Vec::new();
    for over in OVERSUBSCRIPTIONS {
        let limit = study.all() / over;
        let mean_of = |states: &[Option<Vec<usize>>]| {
            let sum: Option<Vec<f64>> =
                states.iter().enumerate().map(|(i, s)| s.as_ref().map(|s| loss(i, s))).collect();
            sum.map(|sum| sum.iter().sum::<f64>() / sum.len() as f64)
        };
        let error_of = |states: &[Option<Vec<usize>>]| {
            let of_view = |(i, states): (usize, &Option<Vec<usize>>)| -> f64 {
                let Some(states) = states else { return f64::NAN };
                states.iter().enumerate().map(|(t, &s)| uses[i][t].error(&study.spatial[t], s)).sum()
            };
            states.iter().enumerate().map(of_view).sum::<f64>() / states.len() as f64
        };
        let mut now: Option<Vec<usize>> = None;
        let ours: Vec<Option<Vec<usize>>> = uses
            .iter()
            .map(|uses| {
                now = study.decided(uses, limit, now.as_deref());
                now.clone()
            })
            .collect();
        let mut best: Option<(&str, f64)> = None;
        for baseline in Baseline::ALL {
            let mut cache = LeastRecentlyUsed::default();
            let states: Vec<Option<Vec<usize>>> = uses
                .iter()
                .map(|uses| match baseline {
                    Baseline::LeastRecentlyUsed => {
                        cache.update(&study.bytes, uses, limit).map(<[usize]>::to_vec)
                    }
                    _ => choose(baseline, &study.bytes, uses, limit),
                })
                .collect();
            if let Some(mean) = mean_of(&states) {
                rows.push(Row::new(
                    format!("1/{over} of the memory: {}", baseline.name()),
                    "mean FLIP",
                    &[mean],
                ));
                points.push((over, baseline.name(), mean, error_of(&states)));
                if best.is_none_or(|(_, least)| mean < least) {
                    best = Some((baseline.name(), mean));
                }
            }
        }
        if let (Some(mean), Some((name, least))) = (mean_of(&ours), best) {
            let what = format!("1/{over} of the memory: decision theory");
            let row = || Row::new(what.clone(), "mean FLIP", &[mean]);
            let beside = row().against(name, Some(least));
            // The aims are those of textures four times as large as the limit.
            if over == 4 {
                rows.push(beside.aim(Aim::RatioAtMost(0.5)));
                rows.push(row().aim(Aim::AtMost(0.02)));
            } else {
                rows.push(beside);
            }
            points.push((over, "decision theory", mean, error_of(&ours)));
        }
    }
    (rows, points)
}

/// The decision for many textures and maps.
fn decisions(a: &TexturesArguments) -> Vec<Row> {
    const TEXTURES: u64 = 1000;
    const LEVELS: usize = 12;
    let settings = SpatialSettings::new(10.8, 100.0);
    let noise = |seed: u64| {
        let texels = (0..64 * 64u64).map(|i| {
            let v = rng::unit_f32(rng::hash(i, seed, 1)) * rng::unit_f32(rng::hash(seed, 3, 1));
            [v, v, v, 1.0]
        });
        let chain = foveal::scene::texture::MipChain::from_linear(64, 64, texels.collect());
        SpatialErrors::of_texture(&Texture::new("noise", chain), &settings)
    };
    let kinds: Vec<SpatialErrors> = (0..16).map(noise).collect();
    let spatial: Vec<SpatialErrors> =
        (0..TEXTURES).map(|i| kinds[i as usize % kinds.len()].clone()).collect();
    let bytes: Vec<Vec<u64>> =
        (0..TEXTURES).map(|_| (0..LEVELS).map(|l| 4u64 << (2 * (LEVELS - 1 - l))).collect()).collect();
    let seen = |i: u64| {
        let mut shown = TextureUse::default();
        if rng::unit_f32(rng::hash(i, 5, 1)) < 0.4 {
            let level = (6.0 * rng::unit_f32(rng::hash(i, 6, 1))) as usize;
            shown.pixels[level] = 3000.0 * rng::unit_f32(rng::hash(i, 7, 1));
            shown.visibility[level] = 10.0 * shown.pixels[level];
        }
        shown
    };
    let uses: Vec<TextureUse> = (0..TEXTURES).map(seen).collect();
    let limit = bytes.iter().flatten().sum::<u64>() / 4;
    let maps: Vec<MapCandidate> = (0..500u64)
        .map(|i| MapCandidate {
            pixels: 5000.0 * rng::unit_f32(rng::hash(i, 8, 1)),
            coverage: 0.01,
            diffuse_cd_m2: 20.0,
            reflection_cd_m2: 20.0,
            relative_difference: rng::unit_f32(rng::hash(i, 9, 1)),
            mean_elevation: 1.0,
            saliency: 1.0,
            cost: 1 << 16,
        })
        .collect();
    let mut now: Option<Vec<usize>> = None;
    let (mut total, mut longest, mut count) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..a.common.runs.max(5) {
        let choices = TextureChoices { bytes: &bytes, uses: &uses, spatial: &spatial };
        let mut of_textures = Decision::new(Constraint::Bytes(limit));
        let mut of_maps = Decision::new(Constraint::Bytes(8 << 20));
        let (mut maps_decided, mut chosen, mut portions) = (false, None, Vec::new());
        // As the allocator does it: a portion of counted work in each frame.
        while chosen.is_none() {
            let (ms, ()) = timed(|| {
                let mut work = WORK_AT_ONCE;
                maps_decided = maps_decided || of_maps.go_on(&MapChoices(&maps), None, &mut work).is_some();
                if maps_decided && work > 0 {
                    chosen = of_textures.go_on(&choices, now.as_deref(), &mut work);
                }
            });
            portions.push(ms);
        }
        now = chosen.and_then(|c| c.ok()).map(|c| c.states);
        total.push(portions.iter().sum());
        longest.push(portions.iter().copied().fold(0.0, f64::max));
        count.push(portions.len() as f64);
    }
    let what = "decision for 1,000 textures × 12 levels and 500 maps";
    vec![
        Row::new(what, "ms", &total).aim(Aim::AtMost(1.0)),
        Row::new("  spread over frames", "frames", &count),
        Row::new("  most in any frame", "ms", &longest).aim(Aim::AtMost(0.1)),
    ]
}

/// Rank agreement of the predicted with the measured loss, over all textures and levels of three scenes.
fn agreement(a: &TexturesArguments) -> Result<Row, Failure> {
    let size = Size { width: a.size.width / 2, height: a.size.height / 2 };
    let (mut predicted, mut measured) = (Vec::new(), Vec::new());
    for name in ["gallery", "duck", "table"] {
        let study = TextureStudy::new(quick_world(MadeScene::bundled(name)?.path())?);
        for camera in study.world.scene.cameras.iter().map(|c| c.camera).take(2) {
            let full = study.picture(&study.world, &camera, size);
            let uses = study.uses(&camera, size);
            let none = vec![0; study.bytes.len()];
            for (t, used) in uses.iter().enumerate().filter(|(_, used)| used.total_pixels() > 20.0) {
                for level in 1..study.bytes[t].len() {
                    let mut states = none.clone();
                    states[t] = level;
                    let shown = study.picture(&study.limited(&states), &camera, size);
                    predicted.push(used.error(&study.spatial[t], level));
                    measured.push(flip::mean(&flip::flip(&full, &shown, &study.tone)));
                }
            }
        }
    }
    let rho = spearman(&predicted, &measured);
    let what =
        format!("rank agreement of the metric with FLIP, {} textures and levels (Spearman)", predicted.len());
    Ok(Row::new(what, "", &[rho]).aim(Aim::AtLeast(0.9)))
}

/// Spearman's rank correlation; equal values share the mean of their ranks.
pub fn spearman(a: &[f64], b: &[f64]) -> f64 {
    let (a, b) = (ranks(a), ranks(b));
    let n = a.len().max(1) as f64;
    let mean = (n - 1.0) / 2.0;
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (x, y) in a.iter().zip(&b) {
        ab += (x - mean) * (y - mean);
        aa += (x - mean) * (x - mean);
        bb += (y - mean) * (y - mean);
    }
    ab / (aa * bb).sqrt()
}

fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&i, &j| values[i].total_cmp(&values[j]));
    let mut ranks = vec![0.0; values.len()];
    let mut first = 0;
    while first < order.len() {
        let equal = order[first..].iter().take_while(|&&i| values[i] == values[order[first]]).count();
        for &i in &order[first..first + equal] {
            ranks[i] = first as f64 + (equal - 1) as f64 / 2.0;
        }
        first += equal;
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_agree_or_not() {
        assert_eq!(spearman(&[1.0, 2.0, 3.0, 9.0], &[10.0, 20.0, 21.0, 22.0]), 1.0);
        assert_eq!(spearman(&[1.0, 2.0, 3.0], &[3.0, 2.0, 1.0]), -1.0);
        assert!((spearman(&[1.0, 2.0, 2.0, 3.0], &[1.0, 2.0, 3.0, 4.0]) - 0.948_683).abs() < 1e-5);
    }
}
