//! A path on its way from surface to surface, and its random numbers.

use glam::Vec3;

use super::aimed::Aimed;
use crate::geometry::Ray;
use crate::rng::Stream;
use crate::transport::interaction::Interaction;
use crate::transport::light::Receiver;
use crate::transport::medium::Media;

/// What a vertex needs random numbers for, in the order of its dimensions.
#[derive(Clone, Copy)]
pub(super) enum Dimension {
    LightChoice,
    Light,
    Part,
    Direction,
    Roulette,
    Aim,
    Lobe,
    Band,
}

/// Dimensions of a vertex.
const DIMENSIONS: u32 = 8;
/// Vertices whose numbers are stratified over the samples of a pixel; of later ones none matters much.
const STRATIFIED: u32 = 4;
/// How a direction was found along which a light may lie.
#[derive(Clone, Copy)]
pub(super) struct Found {
    pub(super) from: Receiver,
    pub(super) pdf: f32,
}

/// A path on its way.
#[derive(Clone, Copy)]
pub(super) struct Path {
    pub(super) ray: Ray,
    /// What radiance found from here on counts.
    pub(super) throughput: Vec3,
    /// Its part since the last D vertex.
    pub(super) since: Vec3,
    /// Squares of refractive indices crossed; kept apart, so that roulette does not end paths inside of glass.
    pub(super) index_scale: f32,
    pub(super) media: Media,
    /// How the direction was found, where light samples were taken beside it.
    pub(super) found: Option<Found>,
    /// How it was found where bright surfaces are looked for, until it ends somewhere.
    pub(super) aimed: Option<Aimed>,
    /// Vertices behind it, and the D ones among them.
    pub(super) vertices: u32,
    pub(super) diffuse: u32,
    /// S surfaces in a row behind it.
    pub(super) specular: u32,
    /// Whether none of these has a wide lobe.
    pub(super) narrow: bool,
    /// Whether no S vertex lies between it and its beginning.
    pub(super) straight: bool,
    /// Whether an eye looks over a lobe of a single direction first, so that no particle can be joined with it.
    pub(super) is_hidden: bool,
    /// Width of its cone here, and what a unit of length adds; for textures.
    pub(super) width: f32,
    pub(super) spread: f32,
}

impl Path {
    /// That begins at a surface.
    pub(super) fn at(at: &Interaction, throughput: Vec3) -> Self {
        Self {
            ray: Ray::new(at.position, at.wo),
            throughput,
            since: Vec3::ONE,
            index_scale: 1.0,
            media: Media::EMPTY,
            found: None,
            aimed: None,
            vertices: 0,
            diffuse: 0,
            specular: 0,
            narrow: true,
            straight: true,
            is_hidden: false,
            width: 0.0,
            spread: 0.0,
        }
    }

    pub(super) fn weigh(&mut self, by: Vec3) {
        self.throughput *= by;
        self.since *= by;
    }

    /// The random numbers of one use at the vertex that it is at.
    pub(super) fn numbers(&self, stream: Stream, of: Dimension) -> Stream {
        let stream = if self.vertices < STRATIFIED { stream } else { stream.independent() };
        stream.at(DIMENSIONS * self.vertices + of as u32)
    }
}
