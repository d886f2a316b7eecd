//! Reflectance at a point: a view-independent diffuse part and a view-dependent rest.
//!
//! The split carries the whole program: the display shows `diffuse_albedo / π × irradiance`, the
//! tracer adds the rest. For plastic the base's light has to cross the coat, more of it straight on than
//! at grazing angles; the mean over directions is the diffuse part, and what a given direction shows
//! more or less than that ([`Bsdf::coat_factor`] − 1) belongs to the view-dependent rest.
//!
//! Directions are world space, unit, and point away from the surface. Absent on purpose: subsurface
//! scattering, layers beyond one coat.

mod at;
pub mod bands;
mod layers;
pub mod peaks;

use std::f32::consts::{FRAC_1_PI, PI};

use glam::Vec3;

use crate::image::luminance;
use crate::math;
use crate::scene::coating::Coated;
pub use crate::scene::fresnel;
use crate::scene::metal_rough::Over;
use crate::scene::microfacet::Microfacet;
use crate::scene::{Distribution, LobeAlbedo, Material, Model, Sheen};

/// One sampled direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BsdfSample {
    /// Direction that light comes from.
    pub wi: Vec3,
    /// f · |cos| / pdf, per band.
    pub weight: Vec3,
    /// Density over solid angle; the lobe's probability for a delta lobe.
    pub pdf: f32,
    /// The direction has no neighbours that light sampling could find.
    pub delta: bool,
    /// Light comes through the surface.
    pub transmitted: bool,
    /// (n_i / n_t)² of a refraction: radiance is multiplied by it, particles' flux is not.
    pub radiance_scale: f32,
}

/// Fresnel reflectance of a facet.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Facet {
    Conductor {
        eta: Vec3,
        k: Vec3,
    },
    /// From the reflectance `f0` at normal incidence, but never above `most`: what a diffuse part beside it leaves.
    /// F depends on ⟨o, h⟩ = ⟨i, h⟩ alone, so the limit keeps f reciprocal.
    Schlick {
        f0: Vec3,
        most: Vec3,
    },
    Dielectric {
        eta: f32,
    },
    /// Schlick's, between the reflectances at normal and at grazing incidence.
    Between {
        f0: Vec3,
        f90: Vec3,
    },
}

impl Facet {
    fn reflectance(&self, cosine: f32) -> Vec3 {
        match *self {
            Self::Conductor { eta, k } => Vec3::new(
                fresnel::conductor(cosine, eta.x, k.x),
                fresnel::conductor(cosine, eta.y, k.y),
                fresnel::conductor(cosine, eta.z, k.z),
            ),
            Self::Schlick { f0, most } => fresnel::schlick(cosine, f0).min(most),
            Self::Dielectric { eta } => Vec3::splat(fresnel::dielectric(cosine, eta)),
            Self::Between { f0, f90 } => fresnel::schlick_between(cosine, f0, f90),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Lobe {
    None,
    Mirror {
        reflectance: Vec3,
    },
    Smooth {
        facet: Facet,
    },
    Glossy {
        facet: Facet,
        microfacet: Microfacet,
    },
    Ward {
        specular: Vec3,
        microfacet: Microfacet,
    },
    /// `eta` = n_t / n_i seen from the viewer's side. Rough where there is a microfacet; `tint` of what crosses.
    /// `spread` is how far `eta`'s index lies from those of the outer bands, on the inside.
    Glass {
        eta: f32,
        microfacet: Option<Microfacet>,
        tint: Vec3,
        spread: f32,
    },
    Pane {
        eta: f32,
        transmittance: Vec3,
    },
    /// Straight through.
    Straight {
        weight: Vec3,
    },
    /// Through, blurred as by rough glass without thickness; it counts as a lobe of single directions, as that does.
    Blurred {
        weight: Vec3,
        microfacet: Microfacet,
    },
    /// Fibres.
    Fibres {
        color: Vec3,
        alpha: f32,
    },
}

/// What lies over the diffuse part.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Coat {
    None,
    /// A plastic's.
    Dielectric(crate::scene::Coat),
    /// A layer ([`crate::scene::metal_rough::Layer`]) of these reflectances at normal and grazing incidence; light
    /// crosses it to `kept` on average.
    Layer {
        f0: f32,
        f90: f32,
        alpha: f32,
        kept: f32,
        over: Option<Over>,
    },
    /// On glass, below which nothing is diffuse.
    OnGlass(Coated),
}

impl Coat {
    /// [`Bsdf::coat_factor`] at a cosine with its normal.
    #[inline]
    fn factor(&self, cosine: f32) -> f32 {
        match self {
            Self::None | Self::OnGlass(_) => 1.0,
            Self::Dielectric(coat) => coat.factor(cosine),
            Self::Layer { f0, f90, alpha, kept, over } => {
                let over = over.map_or(1.0, |over| over.kept(cosine) / over.kept_mean());
                over * (1.0 - LobeAlbedo::table().layer(*f0, *f90, cosine, *alpha)) / kept
            }
        }
    }
}

/// What lies over the diffuse part at a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoatAt {
    normal: Vec3,
    coat: Coat,
}

impl CoatAt {
    /// [`Bsdf::coat_factor`].
    #[inline]
    pub fn factor(&self, wo: Vec3) -> f32 {
        self.coat.factor(wo.dot(self.normal).max(0.0))
    }
}

/// The reflectance at one point, for one side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bsdf {
    normal: Vec3,
    tangent: Vec3,
    bitangent: Vec3,
    geometric: Vec3,
    diffuse: Vec3,
    /// Of light that falls on the other side and leaves diffusely on this one.
    passed: Vec3,
    coat: Coat,
    lobe: Lobe,
    /// Of a coat, where that is not `normal`; of the coat alone: the normal that is `normal` of what lies below.
    apart: Vec3,
    is_apart: bool,
    /// Lobes beside that one, as many as `layers` says.
    more: [Lobe; layers::MORE],
    layers: u8,
}

impl Bsdf {
    /// Albedo of the view-independent part, per band.
    pub fn diffuse_albedo(&self) -> Vec3 {
        self.diffuse
    }

    /// Albedo of light that falls on the other side and leaves diffusely on this one, per band.
    pub fn passed_albedo(&self) -> Vec3 {
        self.passed
    }

    /// How much more or less of the diffuse light leaves towards `wo` than on average: T(wo) / T̄ under a coat that lets
    /// T of the light cross, 1 otherwise.
    pub fn coat_factor(&self, wo: Vec3) -> f32 {
        self.coat.factor(wo.dot(self.normal).max(0.0))
    }

    /// Whether [`Self::coat_factor`] may be other than 1 on a surface of this material.
    fn may_have_coat(material: &Material) -> bool {
        match &material.model {
            Model::Plastic { .. } => true,
            Model::MetalRough(m) => !m.is_diffuse,
            _ => false,
        }
    }

    /// Whether anything depends on the view.
    pub fn has_view_dependent(&self) -> bool {
        self.lobe != Lobe::None || self.coat != Coat::None || self.layers > 0
    }

    /// Whether the view-dependent lobes have single directions only, so that sampling lights is in vain.
    pub fn is_delta(&self) -> bool {
        let wide =
            |lobe: &Lobe| matches!(lobe, Lobe::Glossy { .. } | Lobe::Ward { .. } | Lobe::Fibres { .. });
        !wide(&self.lobe) && !self.beside().iter().any(wide)
    }

    /// α beyond which a lobe counts as diffuse where paths are told apart (Heckbert's D and S).
    pub const WIDE: f32 = 0.08;

    /// Whether the view-dependent lobes are as good as diffuse. Never those that have single directions only.
    pub fn is_wide(&self) -> bool {
        if self.is_layered() {
            return self.parts().all(|part| part.is_wide());
        }
        match self.lobe {
            Lobe::Glossy { microfacet, .. } | Lobe::Ward { microfacet, .. } => {
                microfacet.ax.max(microfacet.ay) > Self::WIDE
            }
            Lobe::Fibres { .. } => true,
            Lobe::None
            | Lobe::Mirror { .. }
            | Lobe::Smooth { .. }
            | Lobe::Glass { .. }
            | Lobe::Straight { .. }
            | Lobe::Blurred { .. }
            | Lobe::Pane { .. } => false,
        }
    }

    /// Whether light from any direction is scattered in many, so that points on a surface can be connected.
    pub fn is_connectible(&self) -> bool {
        self.diffuse != Vec3::ZERO || self.passed != Vec3::ZERO || !self.is_delta()
    }

    /// Whether light that comes back along a sample of a Dirac lobe goes back to `wo`: not where the mirrored direction
    /// was turned out of the surface.
    pub fn is_reversible(&self, wo: Vec3, sample: &BsdfSample) -> bool {
        /// Difference of cosines that are one but for rounding.
        const ROUNDING: f32 = 1e-4;
        let is_rough = matches!(self.lobe, Lobe::Glass { microfacet: Some(_), .. });
        let difference = sample.wi.dot(self.normal) - wo.dot(self.normal);
        is_rough || sample.transmitted || difference.abs() < ROUNDING
    }

    fn local(&self, w: Vec3) -> Vec3 {
        Vec3::new(w.dot(self.tangent), w.dot(self.bitangent), w.dot(self.normal))
    }

    fn world(&self, w: Vec3) -> Vec3 {
        self.tangent * w.x + self.bitangent * w.y + self.normal * w.z
    }

    /// The mirrored direction. Where the shading normal would send it into the surface it is mirrored at the
    /// surface itself, so that silhouettes of coarse meshes do not go black.
    fn reflected(&self, wo: Vec3) -> Vec3 {
        let wi = self.normal * (2.0 * wo.dot(self.normal)) - wo;
        let below = wi.dot(self.geometric).min(0.0);
        let wi = if below < 0.0 { wi - self.geometric * (2.0 * below) } else { wi };
        wi.normalize_or(self.normal)
    }

    fn refracted(&self, wo: Vec3, eta: f32) -> Option<Vec3> {
        refract(wo, self.normal, eta)
    }

    /// All directions of delta lobes (of the first one where there are several beside each other), each with its full
    /// weight (not divided by a probability): a caller that branches follows all of them.
    pub fn delta_lobes(&self, wo: Vec3) -> [Option<BsdfSample>; 2] {
        let reflection = |weight: Vec3| {
            let wi = self.reflected(wo);
            (wi.dot(self.geometric) > 0.0 && weight.max_element() > 0.0).then_some(BsdfSample {
                wi,
                weight,
                pdf: 1.0,
                delta: true,
                transmitted: false,
                radiance_scale: 1.0,
            })
        };
        let cosine = wo.dot(self.normal).max(0.0);
        match self.lobe {
            Lobe::Mirror { reflectance } => [reflection(reflectance), None],
            Lobe::Smooth { facet } => [reflection(facet.reflectance(cosine)), None],
            Lobe::Glass { eta, microfacet: None, tint, .. } => {
                let f = self.glass_reflectance(cosine, eta);
                let crosses = f.min_element() < 1.0;
                let through = self.refracted(wo, eta).filter(|wi| crosses && wi.dot(self.geometric) < 0.0);
                let refraction = through.map(|wi| BsdfSample {
                    wi,
                    weight: tint * (Vec3::ONE - f),
                    pdf: 1.0,
                    delta: true,
                    transmitted: true,
                    radiance_scale: 1.0 / (eta * eta),
                });
                [reflection(f), refraction]
            }
            Lobe::Pane { eta, transmittance } => {
                let (r, t) = fresnel::pane(cosine, eta, transmittance);
                let through = BsdfSample {
                    wi: -wo,
                    weight: t,
                    pdf: 1.0,
                    delta: true,
                    transmitted: true,
                    radiance_scale: 1.0,
                };
                [reflection(r), Some(through)]
            }
            Lobe::Straight { weight } => {
                let through = BsdfSample {
                    wi: -wo,
                    weight,
                    pdf: 1.0,
                    delta: true,
                    transmitted: true,
                    radiance_scale: 1.0,
                };
                [None, Some(through)]
            }
            Lobe::None
            | Lobe::Glossy { .. }
            | Lobe::Ward { .. }
            | Lobe::Glass { .. }
            | Lobe::Blurred { .. }
            | Lobe::Fibres { .. } => [None, None],
        }
    }

    /// One of [`Self::delta_lobes`] by chance, as [`Self::sample`] chooses.
    pub fn chosen_of([a, b]: &[Option<BsdfSample>; 2], u_lobe: f32) -> Option<BsdfSample> {
        let p = |s: &Option<BsdfSample>| s.map_or(0.0, |s| luminance(s.weight));
        let (pa, pb) = (p(a), p(b));
        let share = pa / (pa + pb);
        // Also refuses 0 / 0.
        if !share.is_finite() {
            return None;
        }
        let (chosen, probability) = if u_lobe < share { (a, share) } else { (b, 1.0 - share) };
        chosen.map(|s| BsdfSample { weight: s.weight / probability, pdf: probability, ..s })
    }

    /// A direction of the view-dependent lobes; `None` where it falls below the horizon (weight 0; do not
    /// draw again).
    pub fn sample(&self, wo: Vec3, u: [f32; 2], u_lobe: f32) -> Option<BsdfSample> {
        if self.is_layered() {
            return self.sample_layered(wo, u, u_lobe);
        }
        match self.lobe {
            Lobe::None => None,
            Lobe::Mirror { .. }
            | Lobe::Straight { .. }
            | Lobe::Smooth { .. }
            | Lobe::Pane { .. }
            | Lobe::Glass { microfacet: None, .. } => Self::chosen_of(&self.delta_lobes(wo), u_lobe),
            Lobe::Glossy { microfacet, .. } | Lobe::Ward { microfacet, .. } => {
                let o = self.local(wo);
                let h = microfacet.sample(o, u);
                let i = h * (2.0 * o.dot(h)) - o;
                let wi = self.world(i).normalize_or_zero();
                if i.z <= 0.0 || wi.dot(self.geometric) <= 0.0 || o.dot(h) <= 0.0 {
                    return None;
                }
                let (f, pdf) = self.glossy(o, i);
                let weight = f * (i.z / pdf);
                (pdf > 0.0 && weight.is_finite()).then_some(BsdfSample {
                    wi,
                    weight,
                    pdf,
                    delta: false,
                    transmitted: false,
                    radiance_scale: 1.0,
                })
            }
            Lobe::Glass { eta, microfacet: Some(microfacet), tint, .. } => {
                let sample = self.sample_rough_glass(wo, u, u_lobe, eta, &microfacet)?;
                let weight = if sample.transmitted { sample.weight * tint } else { sample.weight };
                Some(BsdfSample { weight, ..sample })
            }
            Lobe::Blurred { weight, microfacet } => self.sample_blurred(wo, u, weight, &microfacet),
            Lobe::Fibres { .. } => self.sample_fibres(wo, u),
        }
    }

    /// What glass and the coating on it reflect towards `cosine`, per band.
    #[inline]
    fn glass_reflectance(&self, cosine: f32, eta: f32) -> Vec3 {
        match &self.coat {
            Coat::OnGlass(coating) => coating.reflectance(cosine, eta),
            _ => Vec3::splat(fresnel::dielectric(cosine, eta)),
        }
    }

    /// Rough glass: a visible facet reflects or refracts; the weight of either is G₂ / G₁ (Walter et al. 2007). It
    /// is treated as a delta lobe: light sampling leaves it alone.
    fn sample_rough_glass(
        &self,
        wo: Vec3,
        u: [f32; 2],
        u_lobe: f32,
        eta: f32,
        m: &Microfacet,
    ) -> Option<BsdfSample> {
        let ggx = Microfacet { distribution: Distribution::Ggx, ..*m };
        let o = self.local(wo);
        if o.z <= 0.0 {
            return None;
        }
        let h = ggx.sample(o, u);
        let f = self.glass_reflectance(o.dot(h), eta);
        // Without a film all bands reflect the same.
        let (chance, is_white) = match f.x == f.y && f.y == f.z {
            true => (f.x, true),
            false => (luminance(f), false),
        };
        let transmitted = u_lobe >= chance;
        let i = if transmitted { refract(o, h, eta)? } else { h * (2.0 * o.dot(h)) - o };
        if (i.z < 0.0) != transmitted {
            return None;
        }
        let wi = self.world(i).normalize_or_zero();
        if (wi.dot(self.geometric) < 0.0) != transmitted {
            return None;
        }
        let shadowing = ggx.g1(Vec3::new(i.x, i.y, i.z.abs()));
        let (went, pdf) = if transmitted { (Vec3::ONE - f, 1.0 - chance) } else { (f, chance) };
        let color = if is_white { Vec3::ONE } else { went / pdf };
        Some(BsdfSample {
            wi,
            weight: color * shadowing,
            pdf,
            delta: true,
            transmitted,
            radiance_scale: if transmitted { 1.0 / (eta * eta) } else { 1.0 },
        })
    }

    /// f of the glossy view-dependent lobes (delta lobes are 0), without cosine.
    pub fn evaluate(&self, wo: Vec3, wi: Vec3) -> Vec3 {
        self.evaluate_and_pdf(wo, wi).0
    }

    /// Density with which `sample` gives `wi`; 0 for delta lobes.
    pub fn pdf(&self, wo: Vec3, wi: Vec3) -> f32 {
        self.evaluate_and_pdf(wo, wi).1
    }

    /// Both at once, which costs little more than one.
    pub fn evaluate_and_pdf(&self, wo: Vec3, wi: Vec3) -> (Vec3, f32) {
        if self.is_delta() || wi.dot(self.geometric) <= 0.0 {
            return (Vec3::ZERO, 0.0);
        }
        if self.is_layered() {
            return self.evaluate_layered(wo, wi);
        }
        let (f, pdf) = self.glossy(self.local(wo), self.local(wi));
        if self.is_apart {
            // Whoever asks multiplies by the cosine of the surface below.
            let cosine = wi.dot(self.apart);
            let ratio = if cosine > 0.0 { wi.dot(self.normal) / cosine } else { 0.0 };
            return (f * ratio, pdf);
        }
        (f, pdf)
    }

    /// f and the sampled density in the local frame.
    #[inline]
    fn glossy(&self, o: Vec3, i: Vec3) -> (Vec3, f32) {
        if o.z <= 0.0 || i.z <= 0.0 {
            return (Vec3::ZERO, 0.0);
        }
        let (value, pdf) = match self.lobe {
            Lobe::Glossy { facet, microfacet } => {
                let r = microfacet.reflection(o, i);
                (facet.reflectance(r.oh) * r.value, r.pdf)
            }
            Lobe::Ward { specular, microfacet } => {
                let h = o + i;
                let z2 = h.z * h.z;
                let e = ((h.x / microfacet.ax).powi(2) + (h.y / microfacet.ay).powi(2)) / z2;
                let f = h.length_squared() * math::exp(-e) / (PI * microfacet.ax * microfacet.ay * z2 * z2);
                let value = if h.z < 1e-6 { Vec3::ZERO } else { specular * f };
                (value, microfacet.reflection(o, i).pdf)
            }
            Lobe::Fibres { color, alpha } => (color * Sheen::value(alpha, o, i), i.z * FRAC_1_PI),
            Lobe::None
            | Lobe::Mirror { .. }
            | Lobe::Smooth { .. }
            | Lobe::Glass { .. }
            | Lobe::Straight { .. }
            | Lobe::Blurred { .. }
            | Lobe::Pane { .. } => (Vec3::ZERO, 0.0),
        };
        (if value.is_finite() { value } else { Vec3::ZERO }, pdf)
    }

    /// About the share of light that the view-dependent lobes return towards `wo`.
    pub fn view_dependent_albedo(&self, wo: Vec3) -> Vec3 {
        if self.is_layered() {
            return self.parts().map(|part| part.view_dependent_albedo(wo)).sum();
        }
        let cosine = wo.dot(self.normal).max(0.0);
        match self.lobe {
            Lobe::None => Vec3::ZERO,
            Lobe::Straight { weight } | Lobe::Blurred { weight, .. } => weight,
            Lobe::Fibres { color, alpha } => color * Sheen::albedo(cosine, alpha),
            Lobe::Mirror { reflectance } => reflectance,
            Lobe::Smooth { facet } | Lobe::Glossy { facet, .. } => facet.reflectance(cosine),
            Lobe::Ward { specular, .. } => specular,
            Lobe::Glass { .. } | Lobe::Pane { .. } => Vec3::ONE,
        }
    }

    /// Probability of choosing the view-dependent lobes where one part is chosen: about their share of what is reflected.
    pub fn lobe_share(&self, wo: Vec3) -> f32 {
        let specular = luminance(self.view_dependent_albedo(wo));
        let diffuse = luminance(self.diffuse + self.passed);
        match (specular > 0.0, diffuse > 0.0) {
            (false, _) => 0.0,
            (true, false) => 1.0,
            (true, true) => (specular / (specular + diffuse)).clamp(0.1, 0.9),
        }
    }

    /// Probability of choosing the other side where the diffuse part is chosen.
    #[inline]
    pub fn passed_share(&self) -> f32 {
        if self.passed == Vec3::ZERO {
            return 0.0;
        }
        luminance(self.passed) / luminance(self.passed + self.diffuse)
    }

    /// A direction of light that leaves diffusely on the other side. No light sampling finds it.
    fn sample_passed(&self, wo: Vec3, u: [f32; 2], probability: f32) -> Option<BsdfSample> {
        let wi = -self.world(cosine_hemisphere(u)).normalize_or_zero();
        (wi.dot(self.geometric) < 0.0).then_some(BsdfSample {
            wi,
            weight: self.passed * (self.coat_factor(wo) * self.coat_factor(-wi) / probability),
            pdf: probability,
            delta: true,
            transmitted: true,
            radiance_scale: 1.0,
        })
    }

    /// f of the diffuse part as paths see it: reciprocal, with the coat crossed on both sides.
    pub fn diffuse_f(&self, wo: Vec3, wi: Vec3) -> Vec3 {
        self.diffuse * (FRAC_1_PI * self.coat_factor(wo) * self.coat_factor(wi))
    }

    /// f of everything but delta lobes, without cosine.
    pub fn evaluate_all(&self, wo: Vec3, wi: Vec3) -> Vec3 {
        if wi.dot(self.geometric) <= 0.0 || wi.dot(self.normal) <= 0.0 || wo.dot(self.normal) <= 0.0 {
            return Vec3::ZERO;
        }
        self.evaluate(wo, wi) + self.diffuse_f(wo, wi)
    }

    /// Density with which `sample_all` gives a non-delta `wi`.
    pub fn pdf_all(&self, wo: Vec3, wi: Vec3) -> f32 {
        let share = self.lobe_share(wo);
        let cosine = wi.dot(self.normal);
        let diffuse = if cosine > 0.0 && wi.dot(self.geometric) > 0.0 { cosine * FRAC_1_PI } else { 0.0 };
        share * self.pdf(wo, wi) + (1.0 - share) * (1.0 - self.passed_share()) * diffuse
    }

    /// A direction of any lobe.
    pub fn sample_all(&self, wo: Vec3, u: [f32; 2], u_lobe: f32) -> Option<BsdfSample> {
        let share = self.lobe_share(wo);
        let wi = if u_lobe < share {
            let s = self.sample(wo, u, u_lobe / share)?;
            if s.delta {
                return Some(BsdfSample { weight: s.weight / share, pdf: s.pdf * share, ..s });
            }
            s.wi
        } else {
            let passes = self.passed_share();
            // What is left of the number chooses the side.
            if passes > 0.0 && (u_lobe - share) / (1.0 - share) < passes {
                return self.sample_passed(wo, u, (1.0 - share) * passes);
            }
            if self.diffuse == Vec3::ZERO {
                return None;
            }
            self.world(cosine_hemisphere(u)).normalize_or_zero()
        };
        let (f, pdf) = (self.evaluate_all(wo, wi), self.pdf_all(wo, wi));
        let weight = f * (wi.dot(self.normal) / pdf);
        (pdf > 0.0 && weight.is_finite() && weight.max_element() > 0.0).then_some(BsdfSample {
            wi,
            weight,
            pdf,
            delta: false,
            transmitted: false,
            radiance_scale: 1.0,
        })
    }
}

/// Refraction of `wo` at normal `n` (on its side), `eta` = n_t / n_i; `None` in total reflection.
fn refract(wo: Vec3, n: Vec3, eta: f32) -> Option<Vec3> {
    let c = wo.dot(n);
    let sine_t2 = (1.0 - c * c).max(0.0) / (eta * eta);
    if sine_t2 >= 1.0 {
        return None;
    }
    let t = (1.0 - sine_t2).sqrt();
    (n * (c / eta - t) - wo / eta).try_normalize()
}

/// A cosine-distributed direction about +z.
pub fn cosine_hemisphere(u: [f32; 2]) -> Vec3 {
    let r = u[0].sqrt();
    let (s, c) = math::sin_cos(std::f32::consts::TAU * u[1]);
    Vec3::new(r * c, r * s, (1.0 - u[0]).max(0.0).sqrt())
}

#[cfg(test)]
mod tests;
