//! View-independent diffuse illumination: the elements it is stored at, the bake that gathers it, its error, its files.

mod ahead;
pub mod atlas;
pub mod bake;
#[cfg(test)]
mod bake_tests;
mod cut_outs;
pub mod error_map;
pub mod filter;
pub mod first;
pub mod gathered;
pub mod packed;
mod places;
pub mod points;
mod raster;
pub mod reference;
pub mod seen;
pub mod sites;
mod smoothing;
pub mod statement;
pub mod stored;
#[cfg(test)]
pub(crate) mod test_scenes;

use std::any::Any;

use glam::Vec3;

/// Irradiance known everywhere on the surfaces: what the display multiplies with albedo / π, and
/// what rays read where they end on a diffuse surface.
pub trait Irradiance: Any + Sync + Send {
    /// Irradiance in W/m² per band at barycentrics (1 − `b1` − `b2`, `b1`, `b2`) of a triangle, on its
    /// front side or, if `back`, on its back side. Finite and not negative.
    fn irradiance(&self, triangle: u32, b1: f32, b2: f32, back: bool) -> Vec3;

    /// What of it does not come straight from named lights
    /// ([`Lights::named`](crate::transport::light::Lights::named)), where the two are known apart: then shadow rays say
    /// exactly what these bring, and shadows are sharp. All of it elsewhere.
    fn unnamed(&self, triangle: u32, b1: f32, b2: f32, back: bool) -> Unnamed {
        Unnamed { rest: self.irradiance(triangle, b1, b2, back), named: None }
    }

    /// What of it no path from a surface finds ([`Class::Unfound`](crate::transport::caustic::Class)): light of lamps
    /// without area that came over mirrors or clear glass, where that is known apart.
    fn unfound(&self, _triangle: u32, _b1: f32, _b2: f32, _back: bool) -> Vec3 {
        Vec3::ZERO
    }

    /// The stored values behind it, where there are some: for displays that interpolate themselves.
    fn stored(&self) -> Option<&stored::Illumination> {
        None
    }
}

/// Irradiance without what comes straight from named lights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unnamed {
    /// W/m² per band.
    pub rest: Vec3,
    /// What is stored of named lights, W/m² per band, where they are to be asked: any of them was seen from the elements
    /// around, and is not in `rest`.
    pub named: Option<Vec3>,
}

/// The same irradiance everywhere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Uniform(pub Vec3);

impl Irradiance for Uniform {
    fn irradiance(&self, _triangle: u32, _b1: f32, _b2: f32, _back: bool) -> Vec3 {
        self.0
    }
}
