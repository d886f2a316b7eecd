//! How the ways to sample one path share it: weights by recursion along subpaths (Georgiev 2012, "Implementing vertex
//! connection and merging", without its merging).
//!
//! A path of k vertices could have been found by any split into a subpath from the light and one from the eye. The power
//! heuristic wants the sum of the squared densities of all splits over the squared density of the one that did. Each
//! subpath carries two partial sums, of which a connection makes its half with what it knows itself.
//!
//! Densities here need not be those of the samples, only the same function of the path whoever found it: roulette,
//! panes that are passed and the choice among Dirac lobes are left out.

/// Power heuristic with β = 2.
#[inline]
pub fn squared(x: f64) -> f64 {
    x * x
}

/// The partial sums at the end of a subpath, over squared densities per area.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Odds {
    /// What is multiplied by the density with which the other end finds the last vertex: dVCM.
    pub vcm: f64,
    /// What is also multiplied by the density with which it finds the vertex before: dVC.
    pub vc: f64,
}

impl Odds {
    /// After a flight of `distance` to a surface that is met under the `cosine` of its geometric normal.
    pub fn arrived(self, distance: f32, cosine: f32) -> Self {
        let (d, c) = (f64::from(distance), f64::from(cosine));
        Self { vcm: self.vcm * squared(d * d / c), vc: self.vc / squared(c) }
    }

    /// After scattering under the geometric `cosine` with density `pdf` per solid angle, where the other direction would
    /// have been found with density `reverse`.
    pub fn scattered(self, cosine: f32, pdf: f32, reverse: f32) -> Self {
        let (c, p) = (f64::from(cosine), f64::from(pdf));
        Self { vcm: squared(1.0 / p), vc: squared(c / p) * self.behind(reverse) }
    }

    /// After a Dirac lobe; where the other way is not `reversible`, nobody finds what lies behind from there.
    pub fn mirrored(self, cosine: f32, reversible: bool) -> Self {
        Self { vcm: 0.0, vc: if reversible { self.vc * squared(f64::from(cosine)) } else { 0.0 } }
    }

    /// Sum over all splits before the last vertex, from which the vertex before is found with density `reverse`.
    pub fn behind(&self, reverse: f32) -> f64 {
        self.vcm + self.vc * squared(f64::from(reverse))
    }
}

/// The weight of the split that has found a path, by the sums over those on either side of it.
pub fn weight(a: f64, b: f64) -> f32 {
    let weight = 1.0 / (1.0 + a + b);
    // Also refuses what is no number.
    if weight > 0.0 { weight as f32 } else { 0.0 }
}
