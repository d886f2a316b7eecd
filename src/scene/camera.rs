//! Cameras and camera paths.

use glam::{Mat4, Vec3};

use crate::math;

/// A pinhole camera. `eye ≠ target`, `up` not parallel to the view, `fov_y` in (0, π).
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Camera {
    /// Position.
    pub eye: Vec3,
    /// A point in the middle of the picture.
    pub target: Vec3,
    /// Up; need not be perpendicular to the view.
    pub up: Vec3,
    /// Vertical field of view, radians.
    pub fov_y: f32,
}

/// The camera's orthonormal frame with the image plane at distance 1.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct CameraFrame {
    /// Position.
    pub eye: Vec3,
    /// Unit vector into the scene.
    pub forward: Vec3,
    /// Half of the image plane's width, along +x of the picture.
    pub right: Vec3,
    /// Half of the image plane's height, towards the *top* of the picture.
    pub up: Vec3,
    /// Picture size in pixels.
    pub size: [u32; 2],
}

impl Camera {
    /// The frame for a picture of `width × height` pixels.
    pub fn frame(&self, width: u32, height: u32) -> CameraFrame {
        let forward = (self.target - self.eye).normalize();
        let mut right = forward.cross(self.up);
        if right.length_squared() < 1e-12 * self.up.length_squared().max(1e-30) {
            right = forward.any_orthonormal_vector();
        }
        let right = right.normalize();
        let up = right.cross(forward);
        let half = math::tan(self.fov_y * 0.5);
        let aspect = width as f32 / height as f32;
        CameraFrame {
            eye: self.eye,
            forward,
            right: right * (half * aspect),
            up: up * half,
            size: [width, height],
        }
    }
}

impl CameraFrame {
    /// Unit direction through picture position (`x`, `y`) in pixels; pixel centres are at + 0.5.
    #[inline]
    pub fn direction(&self, x: f32, y: f32) -> Vec3 {
        let sx = 2.0 * x / self.size[0] as f32 - 1.0;
        let sy = 1.0 - 2.0 * y / self.size[1] as f32;
        (self.forward + self.right * sx + self.up * sy).normalize()
    }

    /// Picture position in pixels and depth along `forward` of a world point; `None` behind the eye.
    #[inline]
    pub fn project(&self, point: Vec3) -> Option<(f32, f32, f32)> {
        let d = point - self.eye;
        let z = d.dot(self.forward);
        if z <= 0.0 || z.is_nan() {
            return None;
        }
        let x = d.dot(self.right) / (z * self.right.length_squared());
        let y = d.dot(self.up) / (z * self.up.length_squared());
        Some(((x + 1.0) * 0.5 * self.size[0] as f32, (1.0 - y) * 0.5 * self.size[1] as f32, z))
    }

    /// Density per solid angle of a unit direction through its pixel: 1 over the pixel's solid angle.
    pub fn density(&self, direction: Vec3) -> f32 {
        let [width, height] = self.size;
        let area = 4.0 * self.right.length() * self.up.length() / (width as f32 * height as f32);
        let cosine = self.forward.dot(direction);
        1.0 / (area * cosine * cosine * cosine)
    }

    /// Angle of one pixel at the picture's centre, radians.
    pub fn pixel_angle(&self) -> f32 {
        2.0 * self.up.length() / self.size[1] as f32
    }

    /// Clip-from-world matrix (wgpu conventions: z in [0, 1]) with the given near plane and infinite far.
    pub fn clip_from_world(&self, near: f32) -> Mat4 {
        let x = self.right / self.right.length_squared();
        let y = self.up / self.up.length_squared();
        let z = self.forward;
        // w is the depth along `forward`; z / w = 1 − near / depth.
        Mat4::from_cols(
            glam::Vec4::new(x.x, y.x, z.x, z.x),
            glam::Vec4::new(x.y, y.y, z.y, z.y),
            glam::Vec4::new(x.z, y.z, z.z, z.z),
            glam::Vec4::new(-x.dot(self.eye), -y.dot(self.eye), -z.dot(self.eye) - near, -z.dot(self.eye)),
        )
    }
}

/// A camera with its name in the sidecar.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct NamedCamera {
    /// Unique name.
    pub name: String,
    /// The camera.
    pub camera: Camera,
}

/// One key of a path.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PathKey {
    /// Seconds.
    pub t: f32,
    /// Position.
    pub eye: Vec3,
    /// View target.
    pub target: Vec3,
}

/// A camera path: Catmull–Rom through its keys, by time. At least one key, times ascending.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct CameraPath {
    /// Unique name.
    pub name: String,
    /// Keys.
    pub keys: Vec<PathKey>,
}
