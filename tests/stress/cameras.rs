//! Views from where nobody stands, and pictures that nobody asks for.

use std::sync::Arc;

use foveal::world::World;
use foveal_files::load::load;
use glam::Vec3;

use super::{Files, look, world};

/// A world of which only the camera changes.
fn furnished() -> World {
    world(&Files::furnished().write("furnished"))
}

fn seen_from(world: &World, eye: Vec3, target: Vec3, fov_degrees: f32, size: [u32; 2], what: &str) {
    let mut scene = (*world.scene).clone();
    let camera = &mut scene.cameras[0].camera;
    (camera.eye, camera.target, camera.fov_y) = (eye, target, fov_degrees.to_radians());
    look(&world.with_scene(Arc::new(scene)), size, what);
}

#[test]
fn cameras_on_and_in_things() {
    let world = furnished();
    let eyes = [
        ("on a wall", Vec3::new(0.0, 0.0, 1.0)),
        ("in a corner", Vec3::ONE),
        ("on an edge", Vec3::new(1.0, -1.0, 0.0)),
        ("behind a wall", Vec3::new(0.0, 0.0, 1.0f32.next_up())),
        ("outside", Vec3::new(0.0, 0.0, 1e6)),
        ("on the lamp", Vec3::new(0.0, 0.98, 0.0)),
        ("inside glass", Vec3::new(0.4, -0.6, 0.3)),
        ("on glass", Vec3::new(0.4, -0.25, 0.3)),
        ("inside a mirror", Vec3::new(-0.5, -0.5, -0.5)),
        ("on a mirror", Vec3::new(-0.2, -0.5, -0.5)),
        ("inside metal", Vec3::new(0.3, -0.2, -0.5)),
        ("inside plastic", Vec3::new(-0.5, -0.7, 0.3)),
    ];
    for (what, eye) in eyes {
        for target in [Vec3::new(0.1, -0.1, 0.0), Vec3::new(0.0, 10.0, 0.0), eye] {
            seen_from(&world, eye, target, 70.0, [32, 24], what);
        }
    }
}

#[test]
fn fields_of_view_from_1_to_170_degrees() {
    let world = furnished();
    let eye = Vec3::new(0.0, 0.0, 0.95);
    for fov in [1.0, 90.0, 170.0] {
        for size in [[32, 24], [1, 24], [64, 2]] {
            seen_from(&world, eye, Vec3::ZERO, fov, size, &format!("{fov} degrees, {size:?}"));
        }
    }
}

#[test]
fn pictures_of_one_pixel_and_of_one_column() {
    let world = furnished();
    let eye = Vec3::new(0.0, 0.0, 0.95);
    for size in [[1, 1], [1, 4096], [4096, 1], [2, 3], [17, 9]] {
        seen_from(&world, eye, Vec3::ZERO, 70.0, size, &format!("{size:?}"));
    }
}

/// What a sidecar says of a camera is a camera or an error, never a broken picture.
#[test]
fn cameras_of_files() {
    for (fov, eye, target) in [
        ("1.0", "[0.0, 0.0, 0.9]", "[0.0, 0.0, 0.9]"),
        ("170.0", "[0.0, 0.0, 0.9]", "[0.0, 5.0, 0.9]"),
        ("1e-9", "[0.0, 0.0, 0.9]", "[0.0, 0.0, 0.0]"),
        ("180.0", "[0.0, 0.0, 0.9]", "[0.0, 0.0, 0.0]"),
        ("nan", "[0.0, 0.0, 0.9]", "[0.0, 0.0, 0.0]"),
        ("45.0", "[inf, 0.0, 0.9]", "[0.0, 0.0, 0.0]"),
        ("45.0", "[1e30, 0.0, 0.9]", "[-1e30, 0.0, 0.0]"),
        ("45.0", "[1e-40, 0.0, 0.0]", "[0.0, 0.0, 0.0]"),
    ] {
        let file = Files::furnished().write("camera");
        let text = std::fs::read_to_string(&file).expect("the sidecar");
        let from = text.find("eye = ").expect("a camera");
        let to = text[from..].find("[material").map(|i| from + i).expect("materials");
        let camera = format!("eye = {eye}\ntarget = {target}\nup = [0.0, 1.0, 0.0]\nfov_y = {fov}\n");
        std::fs::write(&file, [&text[..from], &camera, &text[to..]].concat()).expect("the sidecar");
        if load(&file).is_ok() {
            look(&world(&file), [16, 12], &camera);
        }
    }
}
