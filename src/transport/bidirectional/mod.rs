//! The reference: bidirectional path tracing, which finds light that [`super::gather`] finds rarely or never.
//!
//! One pass traces for each pixel a subpath from the eye and one from a light, and joins them in every way: lights that
//! are met, lights that are sampled, all pairs of vertices, and each vertex from the light with the pinhole (Veach 1997;
//! weights by the recursion of Georgiev 2012). Nothing is cut and no stored illumination is known. What no joining
//! finds, a lamp's caustic seen in a mirror or glass, is merged from photons in a layer of its own; only
//! that layer is biased, by as much as it tells.
//!
//! It finds the radiance that [`super::gather`] defines: f with the shading normal as the eye sees it, black backs,
//! panes that attenuate, media that absorb. Two exceptions: it knows which media lie around eye and lamps, and where
//! the shading normal of a mirror or of glass is bent by the view, light from lamps without area that goes by there is
//! not found.

mod connect;
mod odds;
mod photons;
mod subpath;
mod vertex;

use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::geometry::{Accel, Ray};
use crate::image::Map2d;
use crate::math;
use crate::rng::{Stream, hash};
use crate::scene::camera::CameraFrame;
use crate::scene::{Model, Scene};

use super::light::{Lights, VisibleSky};
use super::medium::Media;
use photons::Photon;
pub use photons::Photons;
use subpath::Seen;
use vertex::Vertex;
pub(crate) use vertex::geometric_cosine;
pub(super) use vertex::{End, scattering};

/// Radius of the first pass's disks, widths of a pixel where they lie.
const FIRST_RADIUS: f32 = 2.0;
/// Power of the pass's number by which radii shrink: squares by α = 2/3 (Knaus & Zwicker 2011; Kaplanyan & Dachsbacher
/// 2013).
const SHRINKS: f64 = -1.0 / 6.0;

/// Bidirectional paths of one picture.
#[derive(Clone, Debug)]
pub struct Bidirectional<'a> {
    scene: &'a Scene,
    accel: &'a Accel,
    lights: &'a Lights,
    /// What of the sky is seen from where.
    sky: Option<&'a VisibleSky>,
    frame: &'a CameraFrame,
    around_eye: Media,
    /// Whether what lies around a lamp matters.
    absorbs: bool,
    /// Whether there are lights that only merging may find.
    merges: bool,
}

/// One sample of each pixel.
#[derive(Clone, Debug)]
pub struct Pass {
    /// Radiance by all ways that connect.
    pub connected: Map2d<Vec3>,
    /// Radiance of merged photons: within the pass's radius, and of those within 1/√2 of it. `None` where there are none.
    pub merged: Option<Map2d<[Vec3; 2]>>,
}

/// What the subpaths find that belong to some pixels in a row of all pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Part {
    seen: Vec<Seen>,
    /// Of light traced to the eye: pixels and what is added to them.
    splats: Vec<(u32, Vec3)>,
}

impl Part {
    /// Whether it can be one of so many pixels of a picture: what came from elsewhere must.
    pub fn fits(&self, pixels: usize, of: usize) -> bool {
        self.seen.len() == pixels && self.splats.iter().all(|(pixel, _)| (*pixel as usize) < of)
    }
}

impl<'a> Bidirectional<'a> {
    /// Of the view of `frame`.
    pub fn new(scene: &'a Scene, accel: &'a Accel, lights: &'a Lights, frame: &'a CameraFrame) -> Self {
        let absorbs = scene.materials.iter().any(|m| match m.model {
            Model::Dielectric { transmittance, thin: false, .. } => transmittance.min_element() < 1.0,
            _ => false,
        });
        let around_eye = if absorbs {
            Media::around(scene, accel, &Ray::new(frame.eye, frame.forward))
        } else {
            Media::EMPTY
        };
        let sky = lights.visible_sky(scene, accel);
        Self { scene, accel, lights, sky, frame, around_eye, absorbs, merges: lights.has_dirac() }
    }

    /// Subpaths from lights in one pass.
    fn light_paths(&self) -> f64 {
        f64::from(self.frame.size[0]) * f64::from(self.frame.size[1])
    }

    fn light_stream(&self, seed: u64, pass: u64, pixel: usize) -> Stream {
        const LIGHT: u64 = 0x11;
        Stream::new(hash(seed, LIGHT, 0), pixel as u64, pass)
    }

    /// Pass number `pass`: the same for the same numbers, on any number of threads.
    pub fn pass(&self, seed: u64, pass: u64) -> Pass {
        let [width, height] = self.frame.size;
        let photons = self.photons(seed, pass);
        let rows: Vec<Part> = (0..height)
            .into_par_iter()
            .map(|y| self.part(seed, pass, y * width..(y + 1) * width, &photons))
            .collect();
        self.joined(&rows, &photons)
    }

    /// What pass number `pass` finds for some pixels, counted row by row, with the photons of that pass.
    pub fn part(&self, seed: u64, pass: u64, pixels: Range<u32>, photons: &Photons) -> Part {
        let width = self.frame.size[0];
        let shrunk = math::powf((pass + 1) as f64, SHRINKS) as f32;
        let radius = FIRST_RADIUS * self.frame.pixel_angle() * shrunk;
        let merged = (!photons.is_empty()).then_some((photons, radius));
        let (mut splats, mut light): (_, Vec<Vertex>) = (Vec::new(), Vec::new());
        let seen = pixels.map(|pixel| {
            light.clear();
            self.light_path(self.light_stream(seed, pass, pixel as usize), false, |vertex, _| {
                splats.extend(self.shown(vertex));
                light.push(*vertex);
            });
            let (x, y) = (pixel % width, pixel / width);
            let mut stream = Stream::of_pixel(seed, x, y, pass);
            let [dx, dy] = stream.next_2d();
            let direction = self.frame.direction(x as f32 + dx, y as f32 + dy);
            self.eye_path(direction, stream, &light, merged)
        });
        Part { seen: seen.collect(), splats }
    }

    /// The pass whose parts, in order, and photons these are.
    pub fn joined(&self, parts: &[Part], photons: &Photons) -> Pass {
        let [width, height] = self.frame.size.map(|s| s as usize);
        let finite = |v: Vec3| if v.is_finite() { v } else { Vec3::ZERO };
        let seen = || parts.iter().flat_map(|part| &part.seen);
        let mut connected = Map2d::from_vec(width, height, seen().map(|s| finite(s.connected)).collect());
        for (pixel, value) in parts.iter().flat_map(|part| &part.splats) {
            connected.data_mut()[*pixel as usize] += *value;
        }
        let merged =
            (!photons.is_empty()).then(|| Map2d::from_vec(width, height, seen().map(|s| s.merged).collect()));
        Pass { connected, merged }
    }

    /// Photons of the subpaths of a pass that no connection would have found so far; none where every light is found.
    pub fn photons(&self, seed: u64, pass: u64) -> Photons {
        if !self.merges {
            return Photons::default();
        }
        let [width, height] = self.frame.size.map(|s| s as usize);
        let rows: Vec<Vec<Photon>> = (0..height)
            .into_par_iter()
            .map(|y| {
                let mut row = Vec::new();
                for x in 0..width {
                    self.light_path(self.light_stream(seed, pass, y * width + x), true, |vertex, alone| {
                        row.extend(alone.then(|| Photon::at(vertex)));
                    });
                }
                row
            })
            .collect();
        Photons::new(rows.into_iter().flatten())
    }
}

#[cfg(test)]
mod tests;
