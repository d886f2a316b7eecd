//! Microfacet distributions in the local frame, n = (0, 0, 1) (REFERENCE §4.1, §4.2).

use glam::{Vec2, Vec3};

use super::{Distribution, Roughness};
use crate::math;

/// A distribution of facet normals with slopes along two axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Microfacet {
    /// α along x.
    pub ax: f32,
    /// α along y.
    pub ay: f32,
    /// Shape.
    pub distribution: Distribution,
    /// V-groove shadowing (Cook–Torrance 1982) instead of Smith's.
    pub v_groove: bool,
}

/// What a distribution says of one pair of directions, see [`Microfacet::reflection`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reflection {
    /// D G / (4 co ci), 1/sr.
    pub value: f32,
    /// Density of the sampled direction, 1/sr.
    pub pdf: f32,
    /// Cosine between either direction and the facet's normal.
    pub oh: f32,
}

impl Microfacet {
    /// The facets of a surface with Smith's shadowing; none where it is smooth.
    pub fn of(roughness: &Roughness) -> Option<Self> {
        (!roughness.is_smooth()).then(|| Self {
            ax: roughness.alpha_x.clamp(Roughness::SMOOTH, 1.0),
            ay: roughness.alpha_y.clamp(Roughness::SMOOTH, 1.0),
            distribution: roughness.distribution,
            v_groove: false,
        })
    }

    /// D(h): ∫ D h_z dω = 1.
    pub fn d(&self, h: Vec3) -> f32 {
        let z2 = h.z * h.z;
        if h.z.is_nan() || h.z <= 1e-4 {
            return 0.0;
        }
        let e = ((h.x / self.ax).powi(2) + (h.y / self.ay).powi(2)) / z2;
        let norm = std::f32::consts::PI * self.ax * self.ay * z2 * z2;
        match self.distribution {
            Distribution::Ggx => 1.0 / (norm * (1.0 + e) * (1.0 + e)),
            Distribution::Beckmann => math::exp(-e) / norm,
        }
    }

    /// Smith's Λ.
    fn lambda(&self, w: Vec3) -> f32 {
        let z2 = w.z * w.z;
        let a2tan2 = ((w.x * self.ax).powi(2) + (w.y * self.ay).powi(2)) / z2;
        if !a2tan2.is_finite() {
            return f32::INFINITY;
        }
        match self.distribution {
            Distribution::Ggx => 0.5 * ((1.0 + a2tan2).sqrt() - 1.0),
            Distribution::Beckmann => {
                let x = 1.0 / a2tan2.sqrt();
                if x >= 1.6 { 0.0 } else { (1.0 - 1.259 * x + 0.396 * x * x) / (3.535 * x + 2.181 * x * x) }
            }
        }
    }

    /// Smith's G₁.
    pub fn g1(&self, w: Vec3) -> f32 {
        1.0 / (1.0 + self.lambda(w))
    }

    /// D G / (4 co ci), never dividing by the small cosine alone, and the density of `wi` over solid angle when the
    /// facet normal comes from [`Self::sample`]; with them ⟨wo, h⟩. That is half the length of wo + wi: where both
    /// graze, the scalar product loses its sign to rounding.
    pub fn reflection(&self, wo: Vec3, wi: Vec3) -> Reflection {
        let (co, ci) = (wo.z, wi.z);
        let sum = wo + wi;
        let oh = 0.5 * sum.length();
        if !(co > 0.0 && ci > 0.0 && oh > 0.0) {
            return Reflection { value: 0.0, pdf: 0.0, oh: 0.0 };
        }
        let h = sum * (0.5 / oh);
        let (d, lambda) = (self.d(h), self.lambda(wo));
        let value = if self.v_groove {
            d * (0.25 / (co * ci)).min(0.5 * h.z / (oh * ci)).min(0.5 * h.z / (oh * co))
        } else {
            d / (4.0 * co * ci * (1.0 + lambda + self.lambda(wi)))
        };
        let pdf = match self.distribution {
            Distribution::Ggx => d / ((1.0 + lambda) * 4.0 * co),
            Distribution::Beckmann => d * h.z / (4.0 * oh),
        };
        let finite = |v: f32| if v.is_finite() { v } else { 0.0 };
        Reflection { value: finite(value), pdf: finite(pdf), oh }
    }

    /// What the lobe reflects of the light from a direction of this cosine, in the plane of x, for as many Fresnel terms as
    /// `fresnel` tells of ⟨wo, h⟩: the mean of `samples` visible facets, shared out evenly.
    pub fn albedo<const N: usize>(
        &self,
        cosine: f32,
        samples: u32,
        fresnel: impl Fn(f32) -> [f32; N],
    ) -> [f32; N] {
        // Visible normals of GGX are there wherever those of any distribution are.
        let source = Self { distribution: Distribution::Ggx, ..*self };
        let o = Vec3::new((1.0 - cosine * cosine).max(0.0).sqrt(), 0.0, cosine);
        let mut sums = [0.0; N];
        for i in 0..samples {
            let radical = i.reverse_bits() as f32 / 4_294_967_296.0;
            let h = source.sample(o, [(i as f32 + 0.5) / samples as f32, radical]);
            let l = h * (2.0 * o.dot(h)) - o;
            let (found, pdf) = (self.reflection(o, l), source.reflection(o, l).pdf);
            for (sum, f) in sums.iter_mut().zip(fresnel(found.oh)) {
                let value = found.value * f * l.z / pdf;
                *sum += if l.z > 0.0 && value.is_finite() { value } else { 0.0 };
            }
        }
        sums.map(|sum| sum / samples as f32)
    }

    /// A facet normal and nothing else, distributed as visible from `wo` for GGX (Heitz 2018), as D h_z for
    /// Beckmann.
    pub fn sample(&self, wo: Vec3, u: [f32; 2]) -> Vec3 {
        match self.distribution {
            Distribution::Ggx => {
                let v = Vec3::new(self.ax * wo.x, self.ay * wo.y, wo.z).normalize();
                let length2 = v.x * v.x + v.y * v.y;
                let t1 = if length2 > 0.0 { Vec3::new(-v.y, v.x, 0.0) / length2.sqrt() } else { Vec3::X };
                let t2 = v.cross(t1);
                let r = u[0].sqrt();
                let (sine, cosine) = math::sin_cos(std::f32::consts::TAU * u[1]);
                let p = Vec2::new(r * cosine, r * sine);
                let s = 0.5 * (1.0 + v.z);
                let y = (1.0 - s) * (1.0 - p.x * p.x).max(0.0).sqrt() + s * p.y;
                let n = t1 * p.x + t2 * y + v * (1.0 - p.x * p.x - y * y).max(0.0).sqrt();
                Vec3::new(self.ax * n.x, self.ay * n.y, n.z.max(1e-6)).normalize()
            }
            Distribution::Beckmann => {
                let phi = math::atan2(
                    self.ay * math::sin(std::f32::consts::TAU * u[1]),
                    self.ax * math::cos(std::f32::consts::TAU * u[1]),
                );
                let (s, c) = math::sin_cos(phi);
                let slope = (c / self.ax).powi(2) + (s / self.ay).powi(2);
                let tan2 = -math::ln((1.0 - u[0]).max(f32::MIN_POSITIVE)) / slope;
                let z = 1.0 / (1.0 + tan2).sqrt();
                let r = (1.0 - z * z).max(0.0).sqrt();
                Vec3::new(r * c, r * s, z)
            }
        }
    }
}
