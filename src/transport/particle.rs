//! Particles: packets of flux from the lights through the scene (REFERENCE §6.1; Walter, Hubbard, Shirley
//! & Greenberg 1997), and the light transport that a bake needs.

use glam::Vec3;

use crate::rng::Stream;

/// A particle never meets more surfaces than this; roulette ends it long before.
pub const BOUNCES_MAX: u32 = 1000;

/// A particle arriving on a surface with a diffuse part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deposit {
    /// The triangle.
    pub triangle: u32,
    /// Barycentric coordinate at its second corner.
    pub b1: f32,
    /// Barycentric coordinate at its third corner.
    pub b2: f32,
    /// Whether it arrives from behind.
    pub back: bool,
    /// Incoming flux before reflection, as if it were the only particle emitted, W per band.
    pub flux: Vec3,
    /// Surfaces met before, of any kind: 0 straight from a light.
    pub bounce: u32,
}

/// What a bake needs to know of a scene.
pub trait LightTransport: Sync {
    /// Emits particle `index` and follows it; every arrival on a diffuse part goes to `deposit`. Returns the
    /// number of surfaces it met.
    fn trace(&self, seed: u64, index: u64, deposit: &mut dyn FnMut(Deposit)) -> u32;

    /// One sample of the irradiance that comes straight from the lights to one side of a point, W/m², for three
    /// numbers in [0, 1): the first chooses the light, the others the point on it.
    fn direct(&self, triangle: u32, b1: f32, b2: f32, back: bool, u: [f32; 3]) -> Vec3;

    /// Whether a random ray from one side of a point ends on the back of a triangle.
    fn sees_inside(&self, triangle: u32, b1: f32, b2: f32, back: bool, stream: &mut Stream) -> bool;

    /// Whether a triangle reflects diffusely, so that irradiance on it matters.
    fn is_diffuse(&self, triangle: u32) -> bool;

    /// A typical flux of a particle, W in its strongest band; 0 where there is no light.
    fn power(&self) -> f32;
}
