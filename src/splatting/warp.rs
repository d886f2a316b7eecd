//! Cached samples moved to where the new camera sees them (REFERENCE §11).

use glam::Vec3;

use super::{SampleBatch, SampleCache};
use crate::sampling::Lattice;
use crate::scene::camera::CameraFrame;

/// A cached sample in the picture of the new camera.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct WarpedSample {
    /// Column of its pixel.
    pub x: u16,
    /// Row of its pixel.
    pub y: u16,
    /// Depth along the view axis.
    pub depth: f32,
    /// How far the depth buffer may differ where the sample still counts as visible.
    pub depth_tolerance: f32,
    /// View-dependent radiance.
    pub color: Vec3,
    /// What its guide showed in the view it was traced for; not a number where it has none.
    pub guide: Vec3,
    /// Object id.
    pub object: u32,
    /// Views since it was traced, ≥ 1.
    pub age: u16,
    /// Pixels on each side of the centre that it paints.
    pub half_side: u8,
    /// Level set it was traced in.
    pub k: u8,
}

/// All samples of the cache that were traced for earlier views and fall into the picture, coarse
/// before fine, old before new within a level.
///
/// The footprint is the square of side Lₖ scaled by how much larger a pixel of then appears now,
/// rounded up to odd and at most twice as large (zooming in); under zooming out it shrinks.
pub fn warp(cache: &SampleCache, view: u32, frame: &CameraFrame) -> Vec<WarpedSample> {
    let mut warped = Vec::with_capacity(cache.len());
    for batch in cache.coarse_to_fine() {
        if batch.view != view {
            warp_batch(batch, view, frame, &mut warped);
        }
    }
    warped
}

fn warp_batch(batch: &SampleBatch, view: u32, frame: &CameraFrame, warped: &mut Vec<WarpedSample>) {
    let [width, height] = frame.size;
    let right = frame.right / frame.right.length_squared();
    let up = frame.up / frame.up.length_squared();
    let (half_width, half_height) = (width as f32 * 0.5, height as f32 * 0.5);
    let pixel_angle = frame.pixel_angle();
    let per_angle = 1.0 / pixel_angle;
    let side = Lattice::square_side(batch.k) as f32;
    let age = view.wrapping_sub(batch.view).clamp(1, u32::from(u16::MAX)) as u16;
    let seen = batch.positions.iter().zip(&batch.colors).zip(batch.pixel_widths.iter().zip(&batch.normals));
    for (i, ((&position, &color), (&pixel_width, &normal))) in seen.enumerate() {
        let d = position - frame.eye;
        let depth = d.dot(frame.forward);
        // Also refuses NaN.
        if !(depth > pixel_width * 1e-3) {
            continue;
        }
        let inverse = 1.0 / depth;
        let x = (d.dot(right) * inverse + 1.0) * half_width;
        let y = (1.0 - d.dot(up) * inverse) * half_height;
        if !(x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32) {
            continue;
        }
        let zoom = (pixel_width * inverse * per_angle).min(2.0);
        // A twentieth of a pixel of slack: an unmoved camera must not grow footprints by rounding.
        let half_side = ((side * zoom - 1.0) * 0.5 - 0.05).ceil().clamp(0.0, 255.0) as u8;
        // Two pixel slopes: how much depth changes across two pixels of the surface. `min` also drops NaN.
        let per_cosine = (d.length() / normal.dot(d).abs()).min(20.0);
        warped.push(WarpedSample {
            x: x as u16,
            y: y as u16,
            depth,
            depth_tolerance: depth * (2.0 * pixel_angle * per_cosine).max(0.01),
            color,
            guide: batch.guide(i),
            object: batch.object,
            age,
            half_side,
            k: batch.k as u8,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Camera;
    use crate::splatting::Sample;
    use std::sync::Arc;

    fn camera(eye: Vec3) -> CameraFrame {
        Camera { eye, target: Vec3::ZERO, up: Vec3::Y, fov_y: 0.8 }.frame(101, 101)
    }

    fn sample_at(frame: &CameraFrame, x: u16, y: u16) -> Sample {
        let d = frame.direction(f32::from(x) + 0.5, f32::from(y) + 0.5);
        // On the plane z = 0.
        let t = -frame.eye.z / d.z;
        let depth = (d * t).dot(frame.forward);
        Sample {
            pixel: [x, y],
            position: frame.eye + d * t,
            normal: Vec3::Z,
            view: -d,
            color: Vec3::ONE,
            pixel_width: depth * frame.pixel_angle(),
        }
    }

    #[test]
    fn samples_warped_into_their_own_view_land_on_their_pixel() {
        let frame = camera(Vec3::new(0.3, 0.2, 3.0));
        let mut cache = SampleCache::new(20_000);
        let mut batch = SampleBatch::new(1, 1, 0, 0);
        for y in 0..101 {
            for x in 0..101 {
                batch.push(sample_at(&frame, x, y));
            }
        }
        let pixels = batch.pixels.clone();
        cache.insert(Arc::new(batch));
        let warped = warp(&cache, 2, &frame);
        assert_eq!(warped.len(), pixels.len());
        for (w, p) in warped.iter().zip(&pixels) {
            assert_eq!(([w.x, w.y], w.half_side, w.age), (*p, 0, 1));
        }
    }

    #[test]
    fn footprints_grow_with_zoom_up_to_twice() {
        let far = camera(Vec3::new(0.0, 0.0, 4.0));
        let mut cache = SampleCache::new(100);
        let mut batch = SampleBatch::new(1, 1, 2, 0);
        batch.push(sample_at(&far, 50, 50));
        cache.insert(Arc::new(batch));
        let half = |z: f32| warp(&cache, 2, &camera(Vec3::new(0.0, 0.0, z)))[0].half_side;
        assert_eq!(half(4.0), 3);
        assert_eq!(half(2.0), 7);
        assert_eq!(half(0.5), 7);
        assert_eq!(half(8.0), 2);
    }

    #[test]
    fn samples_behind_the_eye_or_outside_are_left_out() {
        let mut cache = SampleCache::new(100);
        let mut batch = SampleBatch::new(1, 1, 2, 0);
        batch.push(sample_at(&camera(Vec3::new(0.0, 0.0, 4.0)), 50, 50));
        cache.insert(Arc::new(batch));
        let away = Camera {
            eye: Vec3::new(0.0, 0.0, 4.0),
            target: Vec3::new(0.0, 0.0, 8.0),
            up: Vec3::Y,
            fov_y: 0.8,
        };
        assert!(warp(&cache, 2, &away.frame(101, 101)).is_empty());
        assert!(
            warp(&cache, 1, &camera(Vec3::new(0.0, 0.0, 4.0))).is_empty(),
            "its own view splats it fresh"
        );
    }
}
