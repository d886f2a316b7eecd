//! Directions from D points to bright surfaces, beside those by the cosine.
//!
//! One of the two ways is chosen by chance, and what is found counts as if both had been: cosine over the mean of their
//! densities (balance heuristic, one sample; Veach 1997, §9.2.4). A direction to a surface that something hides finds nothing; there the
//! other way is the only one.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;

use super::{Gather, Path, Receiver};
use crate::geometry::Hit;
use crate::scene::TriangleIndex;
use crate::transport::interaction::Interaction;
use crate::transport::light::bright::BrightSurfaces;
use crate::transport::surface::area_normal;

/// D points of a path, from its beginning, that look for bright surfaces: of later ones little is seen.
const AIMS: u32 = 2;

/// A direction that was chosen.
#[derive(Clone, Copy)]
pub(super) struct Aimed {
    from: Receiver,
    /// The side of a triangle that it was to end at; `None` by the cosine.
    target: Option<(TriangleIndex, bool)>,
}

impl<'a> Gather<'a> {
    /// What a path looks for from the D point that it is at.
    pub(super) fn aims(&self, path: &Path) -> Option<&'a BrightSurfaces> {
        self.bright.filter(|_| path.diffuse <= AIMS)
    }

    /// A direction by either way. Where nothing can be aimed at it is one that counts for nothing.
    pub(super) fn aim(
        &self,
        bright: &BrightSurfaces,
        at: &Interaction,
        choice: f64,
        u: [f32; 2],
        by_cosine: impl Fn() -> Vec3,
    ) -> (Vec3, Aimed) {
        /// No triangle: what was found is not what was aimed at.
        const NOWHERE: (TriangleIndex, bool) = (TriangleIndex::MAX, false);
        let (from, share) = (Receiver::from(at), f64::from(bright.share()));
        if choice >= share {
            return (by_cosine(), Aimed { from, target: None });
        }
        match bright.aim(self.scene, &from, choice / share, u) {
            Some(aim) => (aim.wi, Aimed { from, target: Some((aim.triangle, aim.back)) }),
            None => (from.normal, Aimed { from, target: Some(NOWHERE) }),
        }
    }

    /// What a direction counts, now that it ended at `hit` or nowhere: cosine / density.
    pub(super) fn weight_of(&self, aimed: &Aimed, wi: Vec3, hit: Option<&Hit>) -> f32 {
        let Some(bright) = self.bright else { return 0.0 };
        let side = hit.map(|hit| {
            let [a, b, c] = self.scene.mesh.corners(hit.triangle);
            (hit.triangle, area_normal(b - a, c - a).dot(wi) > 0.0)
        });
        if aimed.target.is_some() && aimed.target != side {
            return 0.0;
        }
        let cosine = aimed.from.normal.dot(wi).max(0.0);
        let pdf = match (hit, side) {
            (Some(hit), Some((_, back))) => bright.pdf(self.scene, &aimed.from, wi, hit, back),
            _ => 0.0,
        };
        let share = bright.share();
        let weight = cosine / (share * pdf + (1.0 - share) * cosine * FRAC_1_PI);
        if weight.is_finite() { weight } else { 0.0 }
    }
}
