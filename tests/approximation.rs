//! What is shown before any sample: no mirror, glass or gloss is black, and environment maps bring it near.

use std::sync::Arc;

use foveal::display::FrameBuffers;
use foveal::display::cpu_pass::{Passes, draw};
use foveal::display::environment_map::{EnvironmentMap, capture, phong_exponent, texel_count};
use foveal::display::first_approximation::{FirstApproximation, Probes};
use foveal::display::tone::ToneMap;
use foveal::geometry::Accel;
use foveal::illumination::first::first_picture;
use foveal::image::{Map2d, luminance};
use foveal::metrics::flip;
use foveal::transport::Indexed;
use foveal::transport::light::Lights;
use foveal::world::World;
use foveal_engine::reference::traced_picture;
use foveal_files::load::load;
use glam::Vec3;

use crate::support::scene;

fn world(name: &str) -> World {
    let scene = Arc::new(load(&scene(name)).expect("a bundled scene").scene);
    let (accel, lights) = (Arc::new(Accel::build(&scene)), Arc::new(Lights::build(&scene)));
    let illumination = Arc::new(first_picture(Indexed { scene: &scene, accel: &accel, lights: &lights }, 1));
    World::of(scene, accel, lights, illumination)
}

fn check(name: &str, share: f64) {
    let world = world(name);
    let (width, height) = (160, 120);
    let frame = world.scene.cameras[0].camera.frame(width as u32, height as u32);
    let mut buffers = FrameBuffers::new(width, height);
    draw(&world, &frame, Passes { texture_ids: false }, &mut buffers);
    let reference = traced_picture(&world, &frame, 0, 1, &|| true).picture;
    let probes = Arc::new(Probes::of_world(&world));
    let mut first = FirstApproximation::new(probes.clone());
    let shown = |first: &FirstApproximation| {
        let mut layer = Map2d::new(width, height, Vec3::ZERO);
        first.draw(&world, &frame, &buffers, &mut layer);
        Map2d::from_fn(width, height, |x, y| buffers.color.at(x, y) + layer.at(x, y))
    };
    let tone = ToneMap::from(&world.scene.display);
    let error = |picture: &Map2d<Vec3>| {
        let map = flip::flip(&reference, picture, &tone);
        let (mut sum, mut count) = (0.0, 0.0);
        for (error, _) in map.data().iter().zip(buffers.object.data()).filter(|(_, id)| **id != 0) {
            (sum, count) = (sum + f64::from(*error), count + 1.0);
        }
        sum / count
    };
    let coarse = shown(&first);
    for (id, object) in world.scene.objects.iter().enumerate().skip(1) {
        let side = 64;
        let exponent = phong_exponent(world.scene.materials[object.material.0 as usize].model.lobe_alpha());
        let centre = probes.probes[id].centre;
        let seen = capture(&world, &probes.split_sum, id as u32, centre, side, 0..texel_count(side));
        first.set(id as u32, Some(Arc::new(EnvironmentMap::of_capture(centre, side, &seen, exponent))));
    }
    let fine = shown(&first);
    for picture in [&coarse, &fine] {
        let dark = |x: usize, y: usize| luminance(tone.to_linear(picture.at(x, y))) < 2e-3;
        let black = (0..width * height)
            .map(|i| (i % width, i / width))
            .filter(|&(x, y)| buffers.object.at(x, y) != 0 && dark(x, y))
            .filter(|&(x, y)| luminance(tone.to_linear(reference.at(x, y))) > 0.02)
            .count();
        assert_eq!(black, 0, "{name}: pixels that should show something are black");
    }
    let (nothing, coarse, fine) = (error(&buffers.color), error(&coarse), error(&fine));
    println!(
        "{name}: FLIP of the corrected pixels {nothing:.3} without, {coarse:.3} with coarse, {fine:.3} with fine maps"
    );
    assert!(coarse < nothing && fine < share * nothing, "{name}: {nothing} {coarse} {fine}");
}

#[test]
fn of_box() {
    check("box", 0.25);
}

#[test]
fn of_table() {
    check("table", 0.7);
}

#[test]
fn of_gallery() {
    check("gallery", 0.7);
}

#[test]
fn of_chess() {
    check("chess", 0.5);
}
