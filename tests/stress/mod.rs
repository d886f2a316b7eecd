//! Scenes at the limits of what numbers hold: nothing shown is NaN or infinite, no light appears from nowhere, and all ends.
//!
//! Scenes are written as the files a user would have, loaded, baked with few particles and looked at in every way that
//! the program has: display, first approximation, corrections, paths.

mod cameras;
mod geometry;
mod scale;
mod surfaces;
mod walks;
mod watertight;

use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::Arc;

use foveal::display::FrameBuffers;
use foveal::display::cpu_pass::{self, Passes};
use foveal::display::environment_map::{capture, texel_count};
use foveal::display::first_approximation::{FirstApproximation, Probes};
use foveal::display::tone::{Encoder, ToneMap};
use foveal::geometry::Accel;
use foveal::illumination::bake::{BakeSettings, bake};
use foveal::image::Map2d;
use foveal::perception::importance::{ObjectScan, SALIENCY_WEIGHT, priorities};
use foveal::perception::saliency::SaliencyModel;
use foveal::scene::Scene;
use foveal::splatting::trace::pixel_stream;
use foveal::transport::Indexed;
use foveal::transport::light::Lights;
use foveal::world::World;
use foveal_files::load::load;
use glam::Vec3;

use crate::support::folder;

/// A scene as text. Everything is placed in the unit of a room of two units' side around the origin.
#[derive(Clone, Default)]
struct Files {
    faces: Vec<(String, Vec<Vec3>, Option<Vec<Vec3>>)>,
    mtl: String,
    sidecar: String,
}

impl Files {
    /// A material by the lines of its MTL.
    fn material(mut self, name: &str, lines: &str) -> Self {
        let _ = writeln!(self.mtl, "newmtl {name}\n{lines}");
        self
    }

    /// A diffuse grey of every band alike.
    fn grey(self, name: &str, albedo: f32) -> Self {
        self.material(name, &format!("Kd {albedo} {albedo} {albedo}"))
    }

    /// A light of this radiance, else black.
    fn lamp(self, name: &str, radiance: f32) -> Self {
        self.material(name, &format!("Kd 0 0 0\nKe {radiance:e} {radiance:e} {radiance:e}"))
    }

    /// A material by the lines of its table in the sidecar.
    fn model(mut self, name: &str, lines: &str) -> Self {
        let _ = writeln!(self.sidecar, "[material.\"{name}\"]\n{lines}");
        self.grey(name, 0.5)
    }

    /// More of the sidecar.
    fn sidecar(mut self, text: &str) -> Self {
        self.sidecar += text;
        self.sidecar.push('\n');
        self
    }

    /// A polygon, its front counter-clockwise.
    fn face(mut self, material: &str, corners: &[Vec3]) -> Self {
        self.faces.push((material.to_owned(), corners.to_vec(), None));
        self
    }

    /// A polygon with normals at its corners.
    fn smooth(mut self, material: &str, corners: &[Vec3], normals: &[Vec3]) -> Self {
        self.faces.push((material.to_owned(), corners.to_vec(), Some(normals.to_vec())));
        self
    }

    /// A box; `out`: its faces look outwards.
    fn block(mut self, material: &str, low: Vec3, high: Vec3, out: bool) -> Self {
        const FACES: [[usize; 4]; 6] =
            [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        let corner = |i: usize| {
            let pick = |axis: usize| if i >> axis & 1 == 0 { low[axis] } else { high[axis] };
            Vec3::new(pick(0), pick(1), pick(2))
        };
        for face in FACES {
            let mut corners = face.map(corner);
            if !out {
                corners.reverse();
            }
            self = self.face(material, &corners);
        }
        self
    }

    /// A sphere with smooth normals.
    fn ball(mut self, material: &str, centre: Vec3, radius: f32, rings: usize) -> Self {
        let point = |i: usize, j: usize| {
            let theta = std::f32::consts::PI * i as f32 / rings as f32;
            let phi = std::f32::consts::TAU * (j % (2 * rings)) as f32 / (2 * rings) as f32;
            let s = if i == 0 || i == rings { 0.0 } else { theta.sin() };
            Vec3::new(s * phi.cos(), s * phi.sin(), theta.cos())
        };
        for i in 0..rings {
            for j in 0..2 * rings {
                let n = [point(i, j), point(i + 1, j), point(i + 1, j + 1), point(i, j + 1)];
                for [a, b, c] in [[0, 1, 2], [0, 2, 3]] {
                    if n[a] != n[b] && n[b] != n[c] && n[c] != n[a] {
                        let normals = [n[a], n[b], n[c]];
                        self = self.smooth(material, &normals.map(|v| centre + v * radius), &normals);
                    }
                }
            }
        }
        self
    }

    /// A closed grey room from −1 to 1 with a lamp below its ceiling.
    fn room() -> Self {
        let lamp = [(-0.4, -0.4), (0.4, -0.4), (0.4, 0.4), (-0.4, 0.4)];
        Self::default()
            .grey("wall", 0.6)
            .lamp("lamp", 5.0)
            .block("wall", Vec3::NEG_ONE, Vec3::ONE, false)
            .face("lamp", &lamp.map(|(x, z)| Vec3::new(x, 0.98, z)))
    }

    /// The room with one object of each kind.
    fn furnished() -> Self {
        Self::room()
            .model("mirror", "model = \"mirror\"")
            .model("glass", "model = \"dielectric\"\nior = 1.5")
            .model("metal", "model = \"conductor\"\nspecular = [0.9, 0.7, 0.4]\nalpha = 0.15")
            .model("varnish", "model = \"plastic\"\nalbedo = [0.6, 0.2, 0.2]\nior = 1.5\nalpha = 0.1")
            .ball("glass", Vec3::new(0.4, -0.6, 0.3), 0.35, 6)
            .block("mirror", Vec3::new(-0.8, -1.0, -0.8), Vec3::new(-0.2, 0.1, -0.3), true)
            .ball("metal", Vec3::new(0.3, -0.2, -0.5), 0.3, 6)
            .block("varnish", Vec3::new(-0.7, -1.0, 0.1), Vec3::new(-0.3, -0.5, 0.5), true)
    }

    /// Writes the scene with every point moved by `place`, and says where.
    fn write_with(
        &self,
        name: &str,
        eye: Vec3,
        target: Vec3,
        fov_y: f32,
        place: impl Fn(Vec3) -> Vec3,
    ) -> PathBuf {
        let number = |p: Vec3| format!("{:e} {:e} {:e}", p.x, p.y, p.z);
        let mut obj = String::from("mtllib scene.mtl\n");
        for (material, corners, normals) in &self.faces {
            for (i, &corner) in corners.iter().enumerate() {
                let _ = writeln!(obj, "v {}", number(place(corner)));
                let normal = normals.as_ref().map_or(Vec3::ZERO, |n| n[i]);
                let _ = writeln!(obj, "vn {}", number(normal));
            }
            let count = corners.len() as i32;
            let _ = write!(obj, "usemtl {material}\nf");
            for i in -count..0 {
                let _ = if normals.is_some() { write!(obj, " {i}//{i}") } else { write!(obj, " {i}") };
            }
            obj.push('\n');
        }
        let vector = |p: Vec3| format!("[{:?}, {:?}, {:?}]", f64::from(p.x), f64::from(p.y), f64::from(p.z));
        let sidecar = format!(
            "format = 1\n[geometry]\nfiles = [\"scene.obj\"]\n[[camera]]\nname = \"main\"\neye = {}\ntarget = {}\n\
             up = [0.0, 1.0, 0.0]\nfov_y = {fov_y:?}\n{}",
            vector(place(eye)),
            vector(place(target)),
            self.sidecar
        );
        let folder = folder("stress");
        let file = folder.join(format!("{name}.toml"));
        for (name, text) in [
            (folder.join("scene.obj"), &obj),
            (folder.join("scene.mtl"), &self.mtl),
            (file.clone(), &sidecar),
        ] {
            std::fs::write(&name, text).unwrap_or_else(|e| panic!("{}: {e}", name.display()));
        }
        file
    }

    /// Writes the scene as it is, seen from the room's front.
    fn write(&self, name: &str) -> PathBuf {
        self.write_with(name, Vec3::new(0.0, 0.0, 0.95), Vec3::ZERO, 70.0, |p| p)
    }
}

/// Loads a scene and bakes it with few particles.
fn world(file: &std::path::Path) -> World {
    baked(load(file).unwrap_or_else(|e| panic!("{e}")).scene)
}

/// A scene baked with few particles.
fn baked(scene: Scene) -> World {
    let scene = Arc::new(scene);
    let (accel, lights) = (Arc::new(Accel::build(&scene)), Arc::new(Lights::build(&scene)));
    let settings =
        BakeSettings { texels: 512, particles: Some(1 << 12), error: None, ..BakeSettings::default() };
    let baked = bake(Indexed { scene: &scene, accel: &accel, lights: &lights }, &settings, &|_| true);
    assert!(baked.illumination.is_sound(), "{}: irradiance is not finite", scene.name);
    World::of(scene, accel, lights, Arc::new(baked.illumination))
}

/// What was seen of a scene.
struct Seen {
    buffers: FrameBuffers,
    traced: Map2d<Vec3>,
    paths: Map2d<Vec3>,
}

impl Seen {
    /// The triangle at each pixel.
    fn triangles(&self) -> Vec<Option<u32>> {
        self.buffers.hit.data().iter().map(|h| h.hit().map(|h| h.triangle)).collect()
    }

    /// Mean of all bands and pixels.
    fn mean(picture: &Map2d<Vec3>) -> f64 {
        let sum: f64 = picture.data().iter().map(|c| f64::from(c.element_sum())).sum();
        sum / (3 * picture.data().len()) as f64
    }
}

fn assert_sound(picture: &Map2d<Vec3>, what: &str) {
    let bad = picture.data().iter().position(|c| !(c.is_finite() && c.min_element() >= 0.0));
    if let Some(i) = bad {
        let (x, y) = (i % picture.width(), i / picture.width());
        panic!("{what}: {} at ({x}, {y})", picture.data()[i]);
    }
}

/// Looks at a world from its first camera in every way; fails where something is not a picture.
fn look(world: &World, size: [u32; 2], what: &str) -> Seen {
    let frame = world.scene.cameras[0].camera.frame(size[0], size[1]);
    let [width, height] = size.map(|s| s as usize);
    let mut buffers = FrameBuffers::new(width, height);
    cpu_pass::draw(world, &frame, Passes { texture_ids: false }, &mut buffers);
    assert_sound(&buffers.color, &format!("{what}: display"));
    assert!(buffers.depth.data().iter().all(|d| *d >= 0.0), "{what}: depth");
    let mut layer = Map2d::new(width, height, Vec3::ZERO);
    let probes = Arc::new(Probes::of_world(world));
    for (id, object) in world.scene.objects.iter().enumerate().skip(1) {
        let centre = probes.probes[id].centre;
        let map = capture(world, &probes.split_sum, id as u32, centre, 4, 0..texel_count(4));
        // Where nothing is seen, that is infinitely far.
        let sound = map.iter().all(|seen| seen.radiance.is_finite() && seen.distance >= 0.0);
        assert!(sound, "{what}: surroundings of {}", object.name);
    }
    FirstApproximation::new(probes).draw(world, &frame, &buffers, &mut layer);
    assert!(layer.data().iter().all(|c| c.is_finite()), "{what}: first approximation");
    attend(world, &buffers, what);
    let tracer = world.tracer();
    let (mut traced, mut paths) = (buffers.color.clone(), Map2d::new(width, height, Vec3::ZERO));
    for y in 0..height {
        for x in 0..width {
            let ray = cpu_pass::primary_ray(&frame, x as u32, y as u32);
            let stream = pixel_stream(1, x as u32, y as u32, 0);
            *paths.at_mut(x, y) = world.path_radiance(&ray, stream);
            if let (Some(hit), true) = (buffers.hit.at(x, y).hit(), buffers.object.at(x, y) != 0) {
                let at = cpu_pass::primary_interaction(world, &frame, &ray, &hit);
                let change = tracer.view_dependent(&at, buffers.color.at(x, y), stream);
                assert!(change.is_finite(), "{what}: correction {change} at ({x}, {y})");
                // What a coat takes from the base is at most the base, but for rounding.
                *traced.at_mut(x, y) += change;
                let sum = traced.at(x, y);
                let slack = 1e-4 * buffers.color.at(x, y).max_element();
                assert!(sum.min_element() >= -slack, "{what}: sum {sum} at ({x}, {y})");
            }
        }
    }
    assert_eq!(tracer.broken_count(), 0, "{what}: results that were not finite");
    assert_sound(&paths, &format!("{what}: paths"));
    Seen { buffers, traced, paths }
}

/// What the model of attention makes of a picture: numbers, and every visible object's priority among them.
fn attend(world: &World, buffers: &FrameBuffers, what: &str) {
    let (width, height) = (buffers.width(), buffers.height());
    let mut bytes = Vec::new();
    Encoder::default().encode(&ToneMap::from(&world.scene.display), &buffers.color, &mut bytes);
    let mut model = SaliencyModel::default();
    let map = &model.compute_rgb8(&bytes, width, height).map;
    assert!(map.data().iter().all(|s| s.is_finite()), "{what}: saliency");
    let (mut statistics, mut found) = (Vec::new(), Vec::new());
    ObjectScan::default().gather(&buffers.object, Some(map), world.scene.objects.len(), &mut statistics);
    priorities(&statistics, width, height, SALIENCY_WEIGHT, &mut found);
    assert!(found.iter().all(|p| (0.0..=1.0).contains(p)), "{what}: priorities {found:?}");
}

/// Writes, loads, bakes and looks.
fn check(files: &Files, what: &str) -> Seen {
    look(&world(&files.write(what)), [40, 30], what)
}
