use super::*;
use crate::display::cpu_pass::{self, Passes};
use crate::illumination::Uniform;
use crate::rng::Stream;
use crate::scene::material::{Distribution, Roughness};
use crate::scene::test_scenes::{add_box, grey, material, scene};
use crate::scene::{Camera, Mesh, Model, Reflectance};
use crate::splatting::tile_sums::PixelSample;

const SIZE: (u32, u32) = (96, 64);

/// The inside of a box.
fn view() -> (World, CameraFrame, FrameBuffers) {
    let mut mesh = Mesh::default();
    add_box(&mut mesh, Vec3::splat(-1.0), Vec3::splat(1.0), 0, true);
    let world = World::new(Arc::new(scene(mesh, vec![grey()])), Arc::new(Uniform(Vec3::ONE)));
    let camera = Camera { eye: Vec3::new(0.1, 0.0, 0.9), target: Vec3::ZERO, up: Vec3::Y, fov_y: 1.0 };
    let frame = camera.frame(SIZE.0, SIZE.1);
    let mut buffers = FrameBuffers::new(SIZE.0 as usize, SIZE.1 as usize);
    cpu_pass::draw(&world, &frame, Passes { texture_ids: false }, &mut buffers);
    (world, frame, buffers)
}

/// A map that says 1 everywhere, off by `residual`, with samples of this deviation.
fn of(residual: f32, deviation: f32, samples: u32, seed: u64) -> Settled {
    of_reaches([(residual, deviation), (0.0, 0.0)], samples, seed)
}

/// The same of what lies near and of what lies beyond.
fn of_reaches(reaches: [(f32, f32); 2], samples: u32, seed: u64) -> Settled {
    let (world, frame, buffers) = view();
    let grid = Tiles::of_size(SIZE.0, SIZE.1);
    let tile = |tile: u32| {
        let mut sums = TileSums::new(tile, grid.rect(tile).area() as usize);
        let mut stream = Stream::new(seed, u64::from(tile), 0);
        for _ in 0..samples {
            let mut sample = |_| {
                let [near, deep] = reaches.map(|(residual, deviation)| {
                    Vec3::splat(residual + 12f32.sqrt() * (stream.next_f32() - 0.5) * deviation)
                });
                let parts = [Vec3::ZERO, near, deep];
                PixelSample { shown: Vec3::ONE, albedo: Vec3::splat(0.5), parts }
            };
            let all: Vec<PixelSample> = (0..sums.len()).map(&mut sample).collect();
            sums.add(&all);
        }
        Some(Arc::new(sums))
    };
    let tiles: Vec<_> = (0..grid.len() as u32).map(tile).collect();
    settled(&world, &frame, &buffers, &tiles, None, &|| true).expect("it goes on")
}

fn error(shown: &Settled, exact: f32) -> f32 {
    let values = shown.diffuse.data();
    (values.iter().map(|v| (v.x - exact).powi(2)).sum::<f32>() / values.len() as f32).sqrt()
}

/// Samples three times as bright or dark as the mean: what a map is off by 20 % is shown, to a fraction of it; a map
/// that is right stays to the bit.
#[test]
fn the_map_gives_way_only_where_samples_certainly_know_better() {
    for seed in 0..3 {
        let off = of(0.2, 3.0, 64, seed);
        assert!(off.corrects.is_some() && error(&off, 1.2) < 0.06, "{seed}: {}", error(&off, 1.2));
        let right = of(0.0, 3.0, 16, seed);
        assert!(right.corrects.is_none() && error(&right, 1.0) == 0.0, "{seed}");
    }
}

/// Nearly all noise lies beyond the next D point: what lies near is shown long before that is known, and all of it then.
#[test]
fn what_is_near_does_not_wait_for_what_lies_beyond() {
    for seed in 0..3 {
        let few = of_reaches([(0.2, 0.5), (0.0, 8.0)], 16, seed);
        assert_eq!(few.corrects, Some(Reach::Near), "{seed}");
        assert!(error(&few, 1.2) < 0.05, "{seed}: {}", error(&few, 1.2));
        let many = of_reaches([(0.2, 0.5), (0.1, 4.0)], 256, seed);
        assert_eq!(many.corrects, Some(Reach::Deep), "{seed}");
        assert!(error(&many, 1.3) < 0.05, "{seed}: {}", error(&many, 1.3));
        let wrong = of_reaches([(0.0, 1.0), (0.0, 8.0)], 16, seed);
        assert!(wrong.corrects.is_none() && error(&wrong, 1.0) == 0.0, "{seed}");
    }
}

/// What is stated is above the true error, and not far above it once samples are many.
#[test]
fn what_is_stated_holds() {
    for (residual, deviation, samples) in [(0.2, 3.0, 16), (0.2, 3.0, 256), (0.02, 1.0, 64), (0.0, 1.0, 64)] {
        let shown = of(residual, deviation, samples, 7);
        let off = error(&shown, 1.0 + residual) / (1.0 + residual);
        assert!(shown.stated >= off, "{residual}: {off} stated below {}", shown.stated);
        let noise = deviation / (samples as f32).sqrt() / 8.0;
        assert!(shown.stated < 3.0 * off + 2.0 * noise, "{residual}: {off}, {}", shown.stated);
    }
}

#[test]
fn pixels_without_samples_show_what_they_showed() {
    let (world, frame, buffers) = view();
    let none = vec![None; Tiles::of_size(SIZE.0, SIZE.1).len()];
    let none = settled(&world, &frame, &buffers, &none, None, &|| true).expect("it goes on");
    let (base, first) = (Vec3::splat(0.1), Vec3::splat(0.3));
    assert_eq!(none.pixel(3, 4, base, first), first);
    assert!(none.stated.is_infinite() && none.fits(SIZE.0, SIZE.1) && !none.fits(SIZE.1, SIZE.0));
    // One whose samples are few believes the first one, which branches, more than them, as far as it can be one of them.
    let shows = |samples: u32, variance: f32| {
        let mut few = of(0.0, 0.0, samples, 1);
        few.variance = few.variance.map(|_| variance);
        few.pixel(3, 4, base, first).x - 1.0
    };
    let (near, far) = (shows(4, 1.0), shows(4, 0.02));
    assert!((near - 0.8 * 0.2).abs() < 1e-5, "{near}");
    // Its square is 16 × 0.04 / (2 × 0.02) = 16 times what it would be: it is worth one path.
    assert!((far - 0.2 * 0.2).abs() < 1e-5, "{far}");
    assert_eq!([shows(4, 0.0), shows(64, 1.0)], [0.0, 0.0]);
}

/// The first sample of a pixel on rough ground speaks for one point of it: after a few paths the picture is nearer to
/// the mean with it than without where it is as good as it is said to be, and as good as without where it is not.
#[test]
fn a_first_sample_that_paths_deny_counts_little() {
    let mut settled = of(0.0, 0.0, 16, 1);
    // Single samples of deviation 1 around 1, filtered to next to nothing.
    settled.lobes = settled.lobes.map(|_| Vec3::ONE);
    settled.variance = settled.variance.map(|_| 1.0);
    let mut errors = [0.0; 2];
    let mut stream = Stream::new(3, 0, 0);
    for i in 0..4096 {
        let (x, y) = (i % SIZE.0 as usize, i / SIZE.0 as usize);
        let off = 12f32.sqrt() * (stream.next_f32() - 0.5);
        for (error, deviation) in errors.iter_mut().zip([0.25, 1.0]) {
            let first = Vec3::splat(1.0 + deviation * off);
            let shown = settled.pixel(x, y, Vec3::ZERO, first) - Vec3::splat(2.0);
            *error += shown.x * shown.x / 4096.0;
        }
    }
    let [good, bad] = errors.map(f32::sqrt);
    // Half of 0.25 where it counts as much as 16 paths; a ninth of 1 where as two of them.
    assert!((0.08..0.125).contains(&good) && bad < 0.12, "{good} {bad}");
}

/// Sums of `samples` of all pixels of lobes that show 0.2 and, in a pixel now and then, `rare` with its probability.
fn of_lobes(
    samples: u32,
    seed: u64,
    rare: impl Fn(usize, usize) -> (f32, f32),
) -> Vec<Option<Arc<TileSums>>> {
    let grid = Tiles::of_size(SIZE.0, SIZE.1);
    let mut stream = Stream::new(seed, 0, 0);
    let tile = |tile: u32| {
        let mut sums = TileSums::new(tile, grid.rect(tile).area() as usize);
        for _ in 0..samples {
            let mut sample = |(x, y): (usize, usize)| {
                let (bright, chance) = rare(x, y);
                let found = if stream.next_f32() < chance { bright } else { 0.0 };
                let parts = [Vec3::splat(0.2 + found), Vec3::ZERO, Vec3::ZERO];
                PixelSample { shown: Vec3::ZERO, albedo: Vec3::splat(0.5), parts }
            };
            let all: Vec<PixelSample> = grid.pixels(tile).map(&mut sample).collect();
            sums.add(&all);
        }
        Some(Arc::new(sums))
    };
    (0..grid.len() as u32).map(tile).collect()
}

/// What lobes find rarely and very bright is cut where it would be a firefly, and shown around: no light is lost.
#[test]
fn what_is_cut_off_lobes_is_shown_around() {
    let (world, frame, buffers) = view();
    let tiles = of_lobes(16, 5, |_, _| (100.0, 1.0 / 512.0));
    let (width, height) = (SIZE.0 as usize, SIZE.1 as usize);
    let pixels = Pixels::new(width, height, &tiles, None, vec![Vec3::ZERO; width * height]);
    let mean = |values: &[Vec3]| values.iter().map(|v| v.x).sum::<f32>() / values.len() as f32;
    let all = &[0, 1, 2, 3][..];
    let kept = mean(&pixels.of(|p| p.lobes(all)));
    let found = kept + mean(&pixels.of(|p| p.lobes_excess(all)));
    assert!(kept < 0.8 * found, "something is cut: {kept} of {found}");
    let shown = settled(&world, &frame, &buffers, &tiles, None, &|| true).expect("it goes on");
    let shown = mean(shown.lobes.data());
    assert!((shown / found - 1.0).abs() < 0.05, "{shown} of {found}, {kept} without");
}

/// Where it is found in one place only, around is where it is not: more than noise, and stated.
#[test]
fn what_lobes_show_elsewhere_is_stated() {
    /// Of each 19 in 20 are to hold.
    const RUNS: u64 = 20;
    let (world, frame, buffers) = view();
    let (bright, chance) = (60.0, 1.0 / 128.0);
    let is_there = |x: usize, y: usize| (16..48).contains(&x) && (16..48).contains(&y);
    let mut held = 0;
    for seed in 0..RUNS {
        let tiles = of_lobes(32, seed, |x, y| (bright, if is_there(x, y) { chance } else { 0.0 }));
        let shown = settled(&world, &frame, &buffers, &tiles, None, &|| true).expect("it goes on");
        let (width, height) = (SIZE.0 as usize, SIZE.1 as usize);
        let exact = blocks(width, height, |i| {
            0.2 + if is_there(i % width, i / width) { bright * chance } else { 0.0 }
        });
        let is = blocks(width, height, |i| luminance(shown.lobes.data()[i]));
        let squared = exact.iter().zip(&is).map(|(exact, is)| (exact - is).powi(2)).sum::<f64>();
        let (blocks, light) = (exact.len() as f64, is.iter().sum::<f64>());
        let off = (squared / blocks).sqrt() * blocks / light;
        held += u32::from(f64::from(shown.stated) >= off);
    }
    assert!(held >= RUNS as u32 * 9 / 10, "{held} of {RUNS} hold");
}

#[test]
fn what_nobody_wants_is_not_made() {
    let (world, frame, buffers) = view();
    let tiles = vec![None; Tiles::of_size(SIZE.0, SIZE.1).len()];
    assert!(settled(&world, &frame, &buffers, &tiles, None, &|| false).is_none());
}

/// A map that is off in one block only, as under a caustic, gives way too.
#[test]
fn one_block_is_enough_where_there_is_no_doubt() {
    let gain = |noise: f64| Gain {
        errors: (0..192).map(|i| if i == 77 { -2.0 } else { -1e-5 }).collect(),
        doubts: vec![noise * noise; 192],
    };
    assert!(gain(0.01).is_significant() && !gain(0.1).is_significant() && !gain(0.1).is_refuted());
}

/// Stripes behind glass, in noise that leaves nothing of them in single pixels: a filter over the glass blurs them, and what
/// guides show of them stays sharp, also where these know but a part of it.
#[test]
fn what_is_seen_through_glass_stays_sharp() {
    let mut mesh = Mesh::default();
    for i in 0..16u32 {
        let left = 0.25 * i as f32 - 2.0;
        let (low, high) = (Vec3::new(left, -2.0, -1.1), Vec3::new(left + 0.25, 2.0, -1.0));
        add_box(&mut mesh, low, high, i % 2, false);
    }
    add_box(&mut mesh, Vec3::new(-2.0, -2.0, 0.0), Vec3::new(2.0, 2.0, 0.1), 2, false);
    let stripe = |albedo: f32| Model::Lambert { albedo: Reflectance::constant(Vec3::splat(albedo)) };
    let roughness = Roughness { alpha_x: 0.0, alpha_y: 0.0, distribution: Distribution::default() };
    let glass = Model::Dielectric { ior: 1.5, transmittance: Vec3::ONE, thin: false, roughness };
    let materials = [stripe(0.1), stripe(0.9), glass].map(|model| material("", model)).to_vec();
    let world = World::new(Arc::new(scene(mesh, materials)), Arc::new(Uniform(Vec3::ONE)));
    let camera = Camera { eye: Vec3::new(0.1, 0.0, 2.0), target: Vec3::ZERO, up: Vec3::Y, fov_y: 1.0 };
    let frame = camera.frame(SIZE.0, SIZE.1);
    let (width, height) = (SIZE.0 as usize, SIZE.1 as usize);
    let mut buffers = FrameBuffers::new(width, height);
    cpu_pass::draw(&world, &frame, Passes { texture_ids: false }, &mut buffers);
    let guides = mean_guides(&world, &frame, &buffers, |_| true, &|| true).expect("it goes on");
    let exact = |i: usize| 0.8 * guides[i] + Vec3::splat(0.1);
    // One sample in eight finds all of the light.
    let grid = Tiles::of_size(SIZE.0, SIZE.1);
    let mut stream = Stream::new(11, 0, 0);
    let tile = |tile: u32| {
        let mut sums = TileSums::new(tile, grid.rect(tile).area() as usize);
        for _ in 0..16 {
            let mut sample = |(x, y): (usize, usize)| {
                let found = if stream.next_f32() < 0.125 { 8.0 } else { 0.0 };
                let parts = [exact(y * width + x) * found, Vec3::ZERO, Vec3::ZERO];
                PixelSample { shown: Vec3::ZERO, albedo: Vec3::splat(0.5), parts }
            };
            let all: Vec<PixelSample> = grid.pixels(tile).map(&mut sample).collect();
            sums.add(&all);
        }
        Some(Arc::new(sums))
    };
    let tiles: Vec<_> = (0..grid.len() as u32).map(tile).collect();
    let surfaces = Surfaces::of_view(&world, &frame, &buffers, &|| true).expect("it goes on");
    let off = |guides: Vec<Vec3>| {
        let pixels = Pixels::new(width, height, &tiles, None, guides);
        let shown = pixels.lobes(&surfaces, [&HALVES[0], &HALVES[1]], &|| true).expect("it goes on");
        let squared = shown.iter().enumerate().map(|(i, shown)| (shown.y - exact(i).y).powi(2));
        (squared.sum::<f32>() / shown.len() as f32).sqrt()
    };
    let (without, with) = (off(vec![Vec3::ZERO; width * height]), off(guides.clone()));
    assert!(with < 0.5 * without, "{with} with guides, {without} without");
}
