//! View-independent diffuse illumination: atlas, density estimation, cache.

pub mod atlas;
pub mod bake;
#[cfg(test)]
mod bake_tests;
pub mod bins;
pub mod cache;
pub mod clusters;
mod cut_outs;
pub mod density;
pub mod direct;
mod direct_rounds;
mod emission;
pub mod error_map;
mod estimate;
pub mod from_radiosity;
mod gathering;
pub mod neighbourhood;
mod open_sides;
pub mod quick;
mod raster;
pub mod seen;
mod shadow_edges;
pub mod simplify;
mod smooth_direct;
mod smoothing;
mod sources;
pub mod statement;
pub mod stored;
#[cfg(test)]
pub(crate) mod test_scenes;
#[cfg(test)]
pub(crate) mod test_transport;
pub mod truth;
mod validation;

use glam::Vec3;

/// Irradiance known everywhere on the surfaces: what the display multiplies with albedo / π, and
/// what rays read where they end on a diffuse surface.
pub trait Irradiance: Sync + Send {
    /// Irradiance in W/m² per band at barycentrics (1 − `b1` − `b2`, `b1`, `b2`) of a triangle, on its
    /// front side or, if `back`, on its back side. Finite and not negative.
    fn irradiance(&self, triangle: u32, b1: f32, b2: f32, back: bool) -> Vec3;

    /// The stored values behind it, where there are some: for displays that interpolate themselves.
    fn stored(&self) -> Option<&stored::Illumination> {
        None
    }
}

/// The same irradiance everywhere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Uniform(pub Vec3);

impl Irradiance for Uniform {
    fn irradiance(&self, _triangle: u32, _b1: f32, _b2: f32, _back: bool) -> Vec3 {
        self.0
    }
}
