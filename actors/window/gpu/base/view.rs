//! What the shaders know of a view: camera, sizes, the environment.

use bytemuck::{Pod, Zeroable};
use foveal::scene::Environment;
use foveal::scene::camera::CameraFrame;
use glam::{Vec3, Vec4};

use super::BaseScene;

/// The `View` of `base.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(super) struct ViewRecord {
    clip_from_world: [[f32; 4]; 4],
    eye: [f32; 4],
    forward: [f32; 4],
    right: [f32; 4],
    up: [f32; 4],
    sizes: [u32; 4],
    flags: [u32; 4],
    environment_radiance: [f32; 4],
    environment_rows: [[f32; 4]; 3],
    pixel: [f32; 4],
}

impl ViewRecord {
    /// A view of `base`, in so many columns and rows.
    pub(super) fn new(base: &BaseScene, size: [u32; 2], frame: &CameraFrame) -> Self {
        let wide = |v: Vec3| v.extend(0.0).to_array();
        // Inverse depth: near / depth keeps its relative precision at any distance, so near can be tiny.
        let near = base.scene.diagonal() * 1e-5;
        let mut clip_from_world = frame.clip_from_world(near);
        for column in 0..4 {
            clip_from_world.col_mut(column).z = 0.0;
        }
        clip_from_world.w_axis.z = near;
        let environment = base.scene.environment.as_ref();
        Self {
            clip_from_world: clip_from_world.to_cols_array_2d(),
            eye: wide(frame.eye),
            forward: wide(frame.forward),
            right: wide(frame.right),
            up: wide(frame.up),
            sizes: [size[0], size[1], base.lightmap[0], base.lightmap[1]],
            flags: [u32::from(base.back_is_lit) | (u32::from(base.has_map) << 1), base.elements, 0, 0],
            environment_radiance: environment
                .map_or(Vec4::ZERO, |e| e.radiance.extend(e.rotate_up / std::f32::consts::TAU))
                .to_array(),
            environment_rows: environment.map_or([Vec3::ZERO; 3], environment_axes).map(wide),
            pixel: [frame.pixel_angle(), base.light_unit, 0.0, 0.0],
        }
    }
}

/// The axes of the environment's frame, in which +y is up, in the world.
fn environment_axes(environment: &Environment) -> [Vec3; 3] {
    let unturned = Environment { rotate_up: 0.0, ..Environment::constant(Vec3::ONE) };
    let unturned = Environment { up: environment.up, ..unturned };
    [unturned.direction([0.25, 0.5]), unturned.direction([0.0, 0.0]), -unturned.direction([0.0, 0.5])]
}
