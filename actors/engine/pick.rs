//! What is at a pixel: the thing that files have a name for, what it is made of, and where.

use foveal::display::cpu_pass::primary_ray;
use foveal::geometry::{Accel, Hit};
use foveal::scene::camera::CameraFrame;
use foveal::scene::{Scene, Thing, ThingId};
use glam::Vec3;
use serde_json::{Value, json};

/// What a pixel shows a point of.
#[derive(Clone, Debug, PartialEq)]
pub struct Picked {
    /// Which thing it is a part of; nothing where the scene was not read from files.
    pub thing: Option<(ThingId, Thing)>,
    /// Name of its material.
    pub material: String,
    /// Index into the scene's objects: 0 for what is diffuse.
    pub object: u32,
    /// Scene units.
    pub position: Vec3,
    /// From the eye, scene units.
    pub distance: f32,
}

impl Picked {
    /// What is met at `hit`, seen from `eye` towards `direction`.
    pub fn at(scene: &Scene, frame: &CameraFrame, (x, y): (u32, u32), hit: &Hit) -> Self {
        let ray = primary_ray(frame, x, y);
        let thing = scene.things.of(hit.triangle).and_then(|id| Some((id, scene.things.get(id)?.clone())));
        Self {
            thing,
            material: scene.material_of(hit.triangle).name.clone(),
            object: scene.mesh.objects[hit.triangle as usize],
            position: ray.at(hit.t),
            distance: hit.t,
        }
    }

    /// What is seen in the middle of a pixel; `None` where that is the environment.
    pub fn seen(scene: &Scene, accel: &Accel, frame: &CameraFrame, (x, y): (u32, u32)) -> Option<Self> {
        let hit = accel.intersect_seen(scene, &primary_ray(frame, x, y))?;
        Some(Self::at(scene, frame, (x, y), &hit))
    }

    /// As a document.
    pub fn document(&self) -> Value {
        json!({
            "thing": self.thing.as_ref().map(|(id, thing)| named(*id, thing)),
            "material": self.material,
            "object": self.object,
            "position": self.position.to_array(),
            "distance": self.distance,
        })
    }

    /// In a line.
    pub fn told(&self) -> String {
        let [x, y, z] = self.position.to_array();
        let thing = self.thing.as_ref().map_or_else(String::new, |(_, t)| format!("\"{}\", ", t.path));
        format!("{thing}material \"{}\", {:.3} away, at {x:.4} {y:.4} {z:.4}", self.material, self.distance)
    }
}

/// A thing, as documents name it.
pub fn named(id: ThingId, thing: &Thing) -> Value {
    json!({
        "id": id.0,
        "name": thing.name,
        "path": thing.path,
        "parent": thing.parent.map(|parent| parent.0),
        "triangles": thing.triangles,
        "bounds": thing.bounds.map(|corner| corner.to_array()),
    })
}
