//! Every pass against the CPU pass.

use std::sync::Arc;

use foveal::display::tone::{ToneCurve, ToneMap};
use foveal::display::{FrameBuffers, TextureLevel, cpu_pass};
use foveal::illumination::{Irradiance, Uniform};
use foveal::image::Map2d;
use foveal::rng::Stream;
use foveal::sampling::{Lattice, Rect};
use foveal::scene::camera::CameraFrame;
use foveal::scene::texture::MipChain;
use foveal::scene::{Camera, Scene};
use foveal::splatting::{Footprint, Guides, Reconstruction, Sample, SampleBatch, SplatLayer, WarpedSample};
use foveal::world::World;
use foveal_files::load::load;
use glam::{Vec2, Vec3};

use super::adapter::Gpu;
use super::display::{GpuDisplay, Passes};
use super::{readback, test_scene};
use foveal_actors::renderer::overlay::{Overlay, Sources, paint};

/// The adapter, or `None` after saying that and why the test is skipped.
#[expect(clippy::print_stderr, reason = "a skipped test says so")]
fn gpu(test: &str) -> Option<Gpu> {
    Gpu::headless().inspect_err(|e| eprintln!("{test}: skipped, {e}")).ok()
}

fn passes(gpu: Gpu) -> Arc<Passes> {
    Arc::new(Passes::new(gpu))
}

/// Irradiance that varies smoothly over a triangle and differs on the back.
struct Waves;

impl Irradiance for Waves {
    fn irradiance(&self, triangle: u32, b1: f32, b2: f32, back: bool) -> Vec3 {
        let t = triangle as f32;
        let side = if back { 0.3 } else { 1.0 };
        side * (Vec3::new(1.0 + (t * 0.01).sin(), 1.2, 0.8) + Vec3::new(b1, b2, b1) * 0.5)
    }
}

fn words(bytes: &[u8]) -> Vec<u32> {
    bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    words(bytes).into_iter().map(f32::from_bits).collect()
}

fn halves(bytes: &[u8]) -> Vec<f32> {
    bytes.chunks_exact(2).map(|b| half::f16::from_le_bytes([b[0], b[1]]).to_f32()).collect()
}

/// The base layer on the processor.
fn draw(world: &World, frame: &CameraFrame) -> FrameBuffers {
    let [width, height] = frame.size.map(|s| s as usize);
    let mut buffers = FrameBuffers::new(width, height);
    cpu_pass::draw(world, frame, cpu_pass::Passes { texture_ids: true }, &mut buffers);
    buffers
}

/// Whether all pixels around show the same material, so that nothing but rounding may differ.
fn is_inner(scene: &Scene, buffers: &FrameBuffers, x: usize, y: usize) -> bool {
    let material = |x: isize, y: isize| {
        let hit = buffers.hit.clamped(x, y);
        (!hit.is_miss()).then(|| scene.mesh.materials[hit.triangle as usize])
    };
    let own = material(x as isize, y as isize);
    (-1..=1).all(|dy| (-1..=1).all(|dx| material(x as isize + dx, y as isize + dy) == own))
}

/// The least and the most of `color`, the base layer of a pixel, that an adapter may show: hardware finds the place of a
/// look-up in a texture to 1/256 of a texel and of a level, as Vulkan asks of it. Software is exact.
fn as_filtered(world: &World, frame: &CameraFrame, [x, y]: [usize; 2], color: Vec3) -> [Vec3; 2] {
    let ray = cpu_pass::primary_ray(frame, x as u32, y as u32);
    let Some(hit) = world.accel.intersect(&world.scene, &ray) else { return [color; 2] };
    let at = cpu_pass::primary_interaction(world, frame, &ray, &hit);
    let Some(map) = at.material(&world.scene).picture() else { return [color; 2] };
    let texture = &world.scene.textures[map.0 as usize];
    let level = at.point().texture_level(texture);
    let rgb = |uv, level| Vec3::from_slice(&texture.sample(uv, level)[..3]);
    let [mut least, mut most] = [rgb(at.uv, level); 2];
    let texel = Vec2::from(texture.size(level.ceil() as usize).map(|s| 1.0 / s as f32));
    for i in 0..27 {
        let [u, v, l] = [i % 3, i / 3 % 3, i / 9].map(|i| (i as f32 - 1.0) / 256.0);
        let shifted = rgb(at.uv + Vec2::new(u, v) * texel, (level + l).max(0.0));
        (least, most) = (least.min(shifted), most.max(shifted));
    }
    let albedo = rgb(at.uv, level).max(Vec3::splat(1e-6));
    [color * (least / albedo), color * (most / albedo)]
}

fn views() -> [Camera; 3] {
    let camera = test_scene::room(1).cameras[0].camera;
    [
        camera,
        Camera { eye: Vec3::new(0.6, 0.5, 0.9), target: Vec3::new(0.1, -0.6, -0.2), ..camera },
        // From behind: back sides and sky.
        Camera { eye: Vec3::new(-1.6, 1.4, -2.0), target: Vec3::ZERO, fov_y: 1.2, ..camera },
    ]
}

/// Both base layers of a view: ids equal on 99.9 % of the pixels, and where no edge is colours to 1/255 on as many. Hardware
/// rounds corners to 1/256 of a pixel, so that on edges between triangles it may show the other one: on 1 % at most.
fn assert_base_layers_equal(
    display: &mut GpuDisplay,
    scene: &Arc<Scene>,
    light: Arc<dyn Irradiance>,
    camera: &Camera,
) {
    let size = display.size();
    let frame = camera.frame(size[0], size[1]);
    let world = World::new(Arc::clone(scene), light);
    let expected = draw(&world, &frame);
    let tone = ToneMap::from(&scene.display);
    display.begin_view(&frame);
    let drawn = display.draw(&tone, Overlay::None);
    assert!(drawn.triangles > 0);
    let gpu = display.gpu();
    let objects = words(&readback::read(gpu, &display.targets().object).unwrap());
    let visible = words(&readback::read(gpu, &display.targets().visible).unwrap());
    let depths = floats(&readback::read(gpu, &display.targets().depth).unwrap());
    let textures = words(&readback::read(gpu, &display.targets().texture).unwrap());
    let picture = display.read_picture().unwrap();
    let (mut ids, mut inner, mut beside, mut wrong) = (0, 0, 0, Vec::new());
    for (i, object) in objects.iter().enumerate() {
        let (x, y) = (i % size[0] as usize, i / size[0] as usize);
        ids += usize::from(*object != expected.object.at(x, y));
        let hit = expected.hit.at(x, y);
        if !is_inner(scene, &expected, x, y) {
            continue;
        }
        inner += 1;
        let is_same = !hit.is_miss() && display.triangle(visible[i]) == Some(hit.triangle);
        if !gpu.info.software && !hit.is_miss() && !is_same {
            beside += 1;
            continue;
        }
        let color = expected.color.at(x, y);
        let shades = if gpu.info.software { [color; 2] } else { as_filtered(&world, &frame, [x, y], color) };
        let [least, most] = shades.map(|c| tone.to_rgb8(c));
        let found = [picture[4 * i], picture[4 * i + 1], picture[4 * i + 2]];
        if (0..3).any(|c| found[c] < least[c].saturating_sub(1) || found[c] > most[c].saturating_add(1)) {
            wrong.push((x, y, tone.to_rgb8(color), found));
        }
        if !is_same {
            continue;
        }
        let depth = expected.depth.at(x, y);
        assert!((depths[i] - depth).abs() < 1e-3 * depth, "depth {} for {depth} at {x}, {y}", depths[i]);
        let (a, b) = (textures[i], expected.texture.at(x, y));
        match b.texture() {
            None => assert_eq!(a, u32::MAX),
            Some(id) => {
                let level = (a & 0xff) as f32 / 8.0;
                assert!(a >> 8 == id.0 && (level - b.level()).abs() <= 0.25, "{level} {b:?}");
            }
        }
    }
    let name = &scene.name;
    assert!(ids * 1000 <= objects.len(), "{name}: {ids} object ids of {} differ", objects.len());
    assert!(inner * 2 > objects.len(), "{name}: {inner}");
    assert!(beside * 100 <= inner, "{name}: other triangles on {beside} of {inner}");
    let some = &wrong[..5.min(wrong.len())];
    assert!(wrong.len() * 1000 <= inner, "{name}: {} of {inner} colours differ: {some:?}", wrong.len());
}

#[test]
fn base_layer_matches_the_cpu_pass() {
    let Some(gpu) = gpu("base_layer_matches_the_cpu_pass") else { return };
    let scene = Arc::new(test_scene::room(20));
    let mut display =
        GpuDisplay::new(passes(gpu), Arc::clone(&scene), &Waves, [160, 120], 4, Footprint::Tile);
    for camera in views() {
        assert_base_layers_equal(&mut display, &scene, Arc::new(Waves), &camera);
    }
}

#[test]
fn base_layers_of_the_bundled_scenes_match_the_cpu_pass() {
    let Some(gpu) = gpu("base_layers_of_the_bundled_scenes_match_the_cpu_pass") else { return };
    let passes = passes(gpu);
    let scenes = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes");
    for name in ["box", "chess", "diffuse", "duck", "furnace", "gallery", "table"] {
        let file = scenes.join(name).join(format!("{name}.toml"));
        let scene = Arc::new(load(&file).expect("a bundled scene").scene);
        // As bright as the scene's own light, about: what is white hides differences.
        let light: Arc<dyn Irradiance> = Arc::new(Uniform(Vec3::splat(1.0 / scene.display.exposure)));
        let mut display =
            GpuDisplay::new(Arc::clone(&passes), Arc::clone(&scene), &*light, [320, 200], 4, Footprint::Tile);
        for camera in scene.cameras.iter().take(2) {
            assert_base_layers_equal(&mut display, &scene, Arc::clone(&light), &camera.camera);
        }
    }
}

#[test]
fn new_light_replaces_the_old() {
    let Some(gpu) = gpu("new_light_replaces_the_old") else { return };
    let scene = Arc::new(test_scene::room(4));
    let frame = views()[0].frame(40, 30);
    let light = Uniform(Vec3::splat(0.5));
    let mut display = GpuDisplay::new(passes(gpu), scene, &light, [40, 30], 3, Footprint::Tile);
    let mean = |display: &mut GpuDisplay, light: f32| {
        display.set_illumination(&Uniform(Vec3::splat(light)));
        display.begin_view(&frame);
        display.draw(&ToneMap::default(), Overlay::None);
        let colors = halves(&readback::read(display.gpu(), &display.targets().color).unwrap());
        // The floor in front is lit by nothing else.
        colors[4 * (40 * 28 + 20)]
    };
    let (dim, bright) = (mean(&mut display, 0.5), mean(&mut display, 1.5));
    assert!(dim > 0.0 && (bright / dim - 3.0).abs() < 0.01, "{dim} {bright}");
}

/// The room's checker at this size, with the levels from `finest` on.
fn with_checker(scene: &Scene, [width, height]: [usize; 2], finest: usize) -> Arc<Scene> {
    let texel = |i: usize| {
        if (i % width / 32 + i / width / 32).is_multiple_of(2) {
            [230, 200, 40, 255]
        } else {
            [30, 60, 190, 255]
        }
    };
    let texels = (0..width * height).map(texel).collect();
    let chain = MipChain::from_rgba8(width, height, texels, true).without_finer(finest);
    let mut textures = scene.textures.clone();
    textures[0].mips = Arc::new(chain);
    Arc::new(scene.with_resident(textures))
}

#[test]
fn textures_take_what_the_table_of_residency_says() {
    let Some(gpu) = gpu("textures_take_what_the_table_of_residency_says") else { return };
    let room = test_scene::room(4);
    let light: Arc<dyn Irradiance> = Arc::new(Uniform(Vec3::ONE));
    let frame = views()[0].frame(80, 60);
    let scene = with_checker(&room, [256, 128], 0);
    let mut display = GpuDisplay::new(passes(gpu), scene, &*light, [80, 60], 3, Footprint::Tile);
    let mut pictures = Vec::new();
    for finest in [0, 5, 2, 7, 3, 0] {
        let scene = with_checker(&room, [256, 128], finest);
        display.set_textures(&scene);
        let resident: usize = scene.textures.iter().map(|t| t.mips.resident_bytes()).sum();
        assert_eq!(display.texture_bytes(), resident as u64, "finest {finest}");
        assert!(Arc::ptr_eq(display.scene(), &scene), "the dropped levels are let go");
        let expected = draw(&World::new(scene.clone(), Arc::clone(&light)), &frame);
        display.begin_view(&frame);
        display.draw(&ToneMap::default(), Overlay::None);
        let picture = display.read_picture().unwrap();
        let shown = expected.color.data().iter().map(|c| ToneMap::default().to_rgb8(*c));
        let is_off = |(rgb, rgba): &([u8; 3], &[u8])| (0..3).any(|c| rgb[c].abs_diff(rgba[c]) > 2);
        let off = shown.zip(picture.chunks_exact(4)).filter(is_off).count();
        assert!(off * 100 < 80 * 60, "finest {finest}: {off} pixels differ");
        pictures.push(picture);
    }
    assert!(pictures[0] == pictures[5], "what comes back is what it was");
    assert!(pictures[0] != pictures[3], "what is not there is not shown");
    assert!(!display.gpu().is_lost());
}

#[test]
fn a_texture_beyond_the_limit_begins_at_a_smaller_level() {
    let Some(gpu) = gpu("a_texture_beyond_the_limit_begins_at_a_smaller_level") else { return };
    let limit = gpu.device.limits().max_texture_dimension_2d as usize;
    let scene = with_checker(&test_scene::room(2), [2 * limit + 2, 2], 0);
    let all: usize = scene.textures.iter().map(|t| t.mips.bytes()).sum();
    let cut: usize = (0..2).map(|level| scene.textures[0].mips.level_bytes(level)).sum();
    let light = Uniform(Vec3::ONE);
    let mut display = GpuDisplay::new(passes(gpu), scene, &light, [40, 30], 3, Footprint::Tile);
    assert_eq!(display.texture_bytes(), (all - cut) as u64);
    display.begin_view(&views()[0].frame(40, 30));
    display.draw(&ToneMap::default(), Overlay::None);
    assert!(display.read_picture().unwrap().iter().any(|b| *b > 50));
    assert!(!display.gpu().is_lost());
}

/// Object ids and depths of a view, on both sides.
fn splat_view(gpu: Gpu, footprint: Footprint) -> (GpuDisplay, FrameBuffers) {
    let scene = Arc::new(test_scene::room(6));
    let size = [120, 90];
    let frame = views()[0].frame(size[0], size[1]);
    let mut display = GpuDisplay::new(passes(gpu), Arc::clone(&scene), &Waves, size, 4, footprint);
    display.begin_view(&frame);
    display.draw(&ToneMap::default(), Overlay::None);
    // The ids and depths as the adapter has them: rasterisation is another test's subject.
    let mut buffers = draw(&World::new(Arc::clone(&scene), Arc::new(Waves)), &frame);
    let objects = words(&readback::read(display.gpu(), &display.targets().object).unwrap());
    let depths = floats(&readback::read(display.gpu(), &display.targets().depth).unwrap());
    buffers.object = Map2d::from_vec(120, 90, objects);
    buffers.depth = Map2d::from_vec(120, 90, depths);
    (display, buffers)
}

fn warped(buffers: &FrameBuffers, count: usize, seed: u64) -> Vec<WarpedSample> {
    let mut stream = Stream::new(seed, 1, 1);
    let mut samples: Vec<WarpedSample> = (0..count)
        .map(|_| {
            let mut up_to = |n: u64| stream.next_u64() % n;
            let (x, y) = (up_to(120) as u16, up_to(90) as u16);
            // Some are of an object that is near, some hidden.
            let near = [up_to(5) as usize, up_to(5) as usize];
            let at = |v: u16, d: usize, n: usize| (v as usize + d).saturating_sub(2).min(n - 1);
            let (sx, sy) = (at(x, near[0], 120), at(y, near[1], 90));
            let depth = buffers.depth.at(sx, sy).min(1e6);
            WarpedSample {
                x,
                y,
                depth: depth * if up_to(8) == 0 { 1.1 } else { 1.0 },
                depth_tolerance: 0.01 * depth,
                color: Vec3::new(up_to(100) as f32 / 100.0, up_to(100) as f32 / 100.0, 0.5),
                guide: if buffers.object.at(sx, sy) == 1 {
                    Vec3::new(up_to(50) as f32 / 100.0, 0.1, 0.3)
                } else {
                    Vec3::NAN
                },
                object: buffers.object.at(sx, sy),
                age: 1 + up_to(40) as u16,
                half_side: up_to(6) as u8,
                k: up_to(5) as u8,
            }
        })
        .collect();
    samples.sort_by_key(|s| std::cmp::Reverse(s.k));
    samples
}

fn fresh(lattice: &Lattice, level: u32, object: u32, buffers: &FrameBuffers, seed: u64) -> SampleBatch {
    let mut batch = SampleBatch::new(1, object, lattice.k_of(level), 0);
    let mut stream = Stream::new(seed, u64::from(level), u64::from(object));
    for (x, y) in lattice.all_samples(level, Rect::of_size(120, 90)) {
        let keep = !stream.next_u64().is_multiple_of(3);
        if keep && buffers.object.at(x as usize, y as usize) == object {
            batch.push(Sample {
                pixel: [x as u16, y as u16],
                position: Vec3::ZERO,
                normal: Vec3::Z,
                view: Vec3::Z,
                color: Vec3::new(stream.next_f32(), stream.next_f32(), level as f32 * 0.1),
                pixel_width: 1.0,
            });
            if object == 1 {
                batch.guides.push(Vec3::new(stream.next_f32(), 0.2, 0.1));
            }
        }
    }
    batch
}

/// Guides of some pixels of object 1.
fn guides(buffers: &FrameBuffers, seed: u64) -> Guides {
    let mut stream = Stream::new(seed, 2, 1);
    let mut guides = Guides { view: 1, ..Guides::default() };
    for (i, object) in buffers.object.data().iter().enumerate() {
        let color = Vec3::new(stream.next_f32(), stream.next_f32(), 0.4);
        if *object == 1 && !stream.next_u64().is_multiple_of(4) {
            guides.pixels.push([(i % 120) as u16, (i / 120) as u16]);
            guides.colors.push(color);
        }
    }
    guides
}

/// Both layers pixel by pixel.
fn assert_layers_equal(display: &GpuDisplay, layer: &SplatLayer) {
    let colors = halves(&readback::read_buffer(display.gpu(), &display.splats().colors).unwrap());
    let ranks = words(&readback::read_buffer(display.gpu(), &display.splats().ranks).unwrap());
    assert_eq!(ranks, layer.maps().1.data());
    let mut covered = 0;
    for (i, expected) in layer.colors().data().iter().enumerate() {
        let (x, y) = (i % 120, i / 120);
        let found = Vec3::from_slice(&colors[4 * i..4 * i + 3]);
        let is_covered = colors[4 * i + 3] > 0.5;
        assert_eq!(is_covered, layer.is_covered(x, y), "coverage at {x}, {y}");
        assert!((found - *expected).abs().max_element() < 1e-3, "{found} for {expected} at {x}, {y}");
        covered += usize::from(is_covered);
    }
    assert!(covered > 500, "{covered}");
}

#[test]
fn splat_layer_matches_the_cpu_pass() {
    for footprint in [Footprint::Smooth, Footprint::Linear, Footprint::Tile, Footprint::Square] {
        let Some(gpu) = gpu("splat_layer_matches_the_cpu_pass") else { return };
        let (mut display, buffers) = splat_view(gpu, footprint);
        let lattice = Lattice::new(4, [60, 45]);
        let mut layer = SplatLayer::new(120, 90, 4, footprint);
        let old = warped(&buffers, 3000, 7);
        layer.splat_warped(&old, &buffers.object, &buffers.depth);
        display.splat_warped(&old);
        assert_eq!(display.draw(&ToneMap::default(), Overlay::None).samples, 3000);
        assert_layers_equal(&display, &layer);
        assert_reconstructions_equal(&display, &layer, &buffers);
        // Levels arrive in any order and in several frames; nothing of before is sent again.
        for (step, level) in [3, 1, 5, 2, 4].into_iter().enumerate() {
            for object in [1, 2] {
                let batch = fresh(&lattice, level, object, &buffers, step as u64);
                layer.splat_fresh(&batch, &buffers.object, object as u8);
                display.splat_fresh(&batch, object as u8);
            }
            display.draw(&ToneMap::default(), Overlay::None);
            assert_layers_equal(&display, &layer);
            assert_reconstructions_equal(&display, &layer, &buffers);
            if step == 1 {
                let guides = guides(&buffers, 5);
                assert!(guides.pixels.len() > 500, "{}", guides.pixels.len());
                layer.guide(&guides);
                display.guide(&guides);
                display.draw(&ToneMap::default(), Overlay::None);
                assert_reconstructions_equal(&display, &layer, &buffers);
            }
        }
        assert_eq!(display.draw(&ToneMap::default(), Overlay::None).samples, 0);
        assert_layers_equal(&display, &layer);
    }
}

fn white(display: &GpuDisplay) -> f32 {
    ToneMap::from(&display.scene().display).white()
}

/// What lies between samples, pixel by pixel.
fn assert_reconstructions_equal(display: &GpuDisplay, layer: &SplatLayer, buffers: &FrameBuffers) {
    let shown = halves(&readback::read_buffer(display.gpu(), display.between()).unwrap());
    let frame = views()[0].frame(120, 90);
    let mut between = Map2d::new(120, 90, Vec3::ZERO);
    Reconstruction::new(layer, buffers, &frame, white(display)).fill(&mut between, |_, _, light| light);
    let (mut interpolated, mut wrong) = (0, 0);
    for (i, found) in shown.chunks_exact(4).enumerate() {
        let (x, y) = (i % 120, i / 120);
        let expected = between.at(x, y);
        // A depth at the very limit of a surface may fall to either side of it.
        wrong += usize::from((Vec3::from_slice(found) - expected).abs().max_element() > 2e-3);
        interpolated += usize::from(expected != layer.color(x, y));
    }
    assert!(wrong * 1000 <= 120 * 90, "{wrong} pixels differ");
    let interpolates = layer.footprint().interpolates();
    let is_converged = (0..120 * 90).all(|i| {
        let (x, y) = (i % 120, i / 120);
        !layer.is_covered(x, y) || layer.shown_level(x, y) == Some((0, true))
    });
    assert_eq!(interpolated > 200, interpolates && !is_converged, "{interpolated}");
}

#[test]
fn composition_and_overlays_match_the_cpu_pass() {
    let Some(gpu) = gpu("composition_and_overlays_match_the_cpu_pass") else { return };
    let (mut display, mut buffers) = splat_view(gpu, Footprint::Smooth);
    let colors = halves(&readback::read(display.gpu(), &display.targets().color).unwrap());
    let textures = words(&readback::read(display.gpu(), &display.targets().texture).unwrap());
    for (i, pixel) in colors.chunks_exact(4).enumerate() {
        let (x, y) = (i % 120, i / 120);
        *buffers.color.at_mut(x, y) = Vec3::from_slice(&pixel[..3]);
        *buffers.texture.at_mut(x, y) = match textures[i] {
            u32::MAX => TextureLevel::NONE,
            word => TextureLevel::new(foveal::scene::TextureId(word >> 8), (word & 0xff) as f32 / 8.0),
        };
    }
    let lattice = Lattice::new(4, [60, 45]);
    let mut layer = SplatLayer::new(120, 90, 4, Footprint::Smooth);
    let old = warped(&buffers, 500, 3);
    layer.splat_warped(&old, &buffers.object, &buffers.depth);
    display.splat_warped(&old);
    let batch = fresh(&lattice, 4, 1, &buffers, 5);
    layer.splat_fresh(&batch, &buffers.object, 3);
    display.splat_fresh(&batch, 3);
    let values = [0.1, 0.9, 0.4];
    let frame = views()[0].frame(120, 90);
    display.set_values(&values);
    for curve in [ToneCurve::Clamp, ToneCurve::Reinhard { white: 2.0 }] {
        let tone = ToneMap { exposure: 1.3, curve };
        let between = Reconstruction::new(&layer, &buffers, &frame, white(&display));
        let mut rgb8 = Map2d::new(120, 90, [0; 3]);
        between.fill(&mut rgb8, |x, y, splats| tone.to_rgb8(buffers.color.at(x, y) + splats));
        for overlay in Overlay::ALL {
            display.draw(&tone, overlay);
            let picture = display.read_picture().unwrap();
            let sources =
                Sources { buffers: &buffers, splats: &layer, k_max: 4, values: &values, tile_errors: &[] };
            let expected = paint(overlay, &sources, &rgb8);
            for (i, rgb) in expected.data().iter().enumerate() {
                for c in 0..3 {
                    let off = rgb[c].abs_diff(picture[4 * i + c]);
                    assert!(
                        off <= 2,
                        "{} at {}: {rgb:?}, {:?}",
                        overlay.name(),
                        i,
                        &picture[4 * i..4 * i + 3]
                    );
                }
            }
        }
    }
}

#[test]
fn pictures_come_back_in_order_without_waiting() {
    let Some(gpu) = gpu("pictures_come_back_in_order_without_waiting") else { return };
    let (mut display, _) = splat_view(gpu, Footprint::Tile);
    let shown = display.read_picture().unwrap();
    assert!((0..5).map(|tag| display.request_picture(tag)).filter(|asked| *asked).count() == 3);
    display.gpu().device.poll(wgpu::PollType::wait_indefinitely()).unwrap();
    for tag in 0..3 {
        let (found, bytes) = display.poll_picture().unwrap();
        assert_eq!(found, tag);
        assert_eq!(bytes, shown);
    }
    assert!(display.poll_picture().is_none());
    assert!(display.request_picture(9));
}

#[test]
fn any_size_can_be_drawn() {
    let Some(gpu) = gpu("any_size_can_be_drawn") else { return };
    let scene = Arc::new(test_scene::room(2));
    let mut display = GpuDisplay::new(passes(gpu), scene, &Uniform(Vec3::ONE), [1, 1], 3, Footprint::Tile);
    for size in [[1, 1], [333, 7], [5, 1000]] {
        display.resize(size);
        display.begin_view(&views()[0].frame(size[0], size[1]));
        display.draw(&ToneMap::default(), Overlay::None);
        assert_eq!(display.read_picture().unwrap().len() as u32, 4 * size[0] * size[1]);
    }
    assert!(!display.gpu().is_lost());
}
