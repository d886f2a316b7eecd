//! Surfaces with several lobes beside each other: glTF's, whose reflecting layer may be half there, let light through, and
//! lie below fibres and a clear coat.
//!
//! From above: coat, fibres, layer, base. What each reflects is not there for what is below it; all factors are those towards
//! the viewer, so that a lobe needs no second evaluation. What of a surface is not there passes in a straight line.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;

use super::{Bsdf, BsdfSample, Coat, Facet, Lobe, cosine_hemisphere};
use crate::image::luminance;
use crate::math;
use crate::scene::metal_rough;
use crate::scene::metal_rough::{Grain, Over};
use crate::scene::microfacet::Microfacet;
use crate::scene::recipe::{Made, Recipe};
use crate::scene::{Distribution, LobeAlbedo, MetalRough, Roughness, Scene, TextureId};
use crate::transport::interaction::Interaction;
use crate::transport::surface::SurfacePoint;

/// Lobes beside the first: through, coat, fibres.
pub(super) const MORE: usize = 3;

/// What lies over a layer and beside it.
struct Around {
    /// The share of the surface that is there.
    there: f32,
    over: Option<Over>,
    /// What passes below the layer in a line.
    through: Vec3,
    /// f₀ and f₉₀ of the layer.
    layer: [f32; 2],
}

#[inline]
fn isotropic(alpha: f32) -> Roughness {
    Roughness { alpha_x: alpha, alpha_y: alpha, distribution: Distribution::Ggx }
}

/// What reflects so much, so rough.
#[inline]
fn reflecting(facet: Facet, rough: &Roughness) -> Lobe {
    match Microfacet::of(rough) {
        None => Lobe::Smooth { facet },
        Some(microfacet) => Lobe::Glossy { facet, microfacet },
    }
}

/// What a lobe gains that may be rougher along than across: as much as the mean of both loses.
fn gain_along(rough: &Roughness, cosine: f32) -> f32 {
    if rough.is_smooth() {
        0.0
    } else {
        LobeAlbedo::gain(cosine, (rough.alpha_x * rough.alpha_y).sqrt().sqrt())
    }
}

/// f₀ and f₉₀ with what single scattering loses, for metal and dielectric apart, so that a mix is their mean. `layer` has
/// those of the dielectric.
// A call would hand its two colours over in memory.
#[inline(always)]
fn regained([layer_f0, layer_f90]: [f32; 2], f0: Vec3, metallic: Option<f32>, gain: f32) -> [Vec3; 2] {
    match metallic {
        Some(metallic) if metallic > 0.0 && metallic < 1.0 => {
            // f₀ = (1 − m) f_d + m b; bands of f_d differ only where somebody tinted it.
            let dielectric = f0.min(Vec3::splat(layer_f0));
            let metal = ((f0 - dielectric * (1.0 - metallic)) / metallic).clamp(Vec3::ZERO, Vec3::ONE);
            let (of_dielectric, of_metal) = (Vec3::ONE + dielectric * gain, Vec3::ONE + metal * gain);
            let (d, m_share) = (of_dielectric * (1.0 - metallic), of_metal * metallic);
            [dielectric * d + metal * m_share, d * layer_f90 + m_share]
        }
        _ => {
            let gain = Vec3::ONE + f0 * gain;
            let f90 = if metallic.is_some_and(|m| m >= 1.0) { 1.0 } else { layer_f90 };
            [f0 * gain, gain * f90]
        }
    }
}

/// What the maps of a layer and of its base hold at a point, as far as they have been read.
pub(super) struct Read {
    pub diffuse: Option<[f32; 4]>,
    specular: Option<[f32; 4]>,
}

impl Read {
    /// Reads those that are wanted and that there are, and both in one look where they lie on each other.
    #[inline]
    pub fn of(m: &MetalRough, scene: &Scene, point: &SurfacePoint, base: bool, layer: bool) -> Self {
        match (m.diffuse.map.filter(|_| base), m.specular.map.filter(|_| layer)) {
            (Some(diffuse), Some(specular)) if m.maps_agree => {
                let [diffuse, specular] = point.texels(scene, [diffuse, specular]);
                Self { diffuse: Some(diffuse), specular: Some(specular) }
            }
            maps => {
                let read = |map: TextureId| point.texel(scene, map);
                Self { diffuse: maps.0.map(read), specular: maps.1.map(read) }
            }
        }
    }
}

/// What the maps of a surface between metal and dielectric say at a point.
struct Looks {
    f0: Vec3,
    r: f32,
    metallic: Option<f32>,
    /// The alpha of the diffuse map, where it says anything.
    said: Option<f32>,
}

impl Looks {
    #[inline]
    fn of(m: &MetalRough, read: &Read) -> Self {
        let (f0, r) = match read.specular {
            None => (m.specular.color, m.roughness),
            Some([red, green, blue, alpha]) => {
                let r = if m.roughness_in_alpha { alpha } else { m.roughness };
                (m.specular.color * Vec3::new(red, green, blue), r)
            }
        };
        let said = read.diffuse.filter(|_| m.coverage_in_alpha || m.metallic_in_alpha).map(|texel| texel[3]);
        let metallic = if m.metallic_in_alpha { said } else { m.metallic };
        Self { f0: f0.clamp(Vec3::ZERO, Vec3::ONE), r: r.clamp(0.0, 1.0), metallic, said }
    }
}

/// The lobe of a surface that has nothing but its layer, and what its base, if it has one, lies under.
#[inline]
pub(super) fn only_layer(m: &MetalRough, read: &Read, cosine: f32, has_base: bool) -> (Lobe, Coat) {
    let Looks { f0, r, metallic, .. } = Looks::of(m, read);
    let alpha = MetalRough::alpha(r);
    let rough = isotropic(alpha);
    let gain = if rough.is_smooth() { 0.0 } else { LobeAlbedo::gain(cosine, r) };
    let [f0, f90] = regained([m.layer.f0, m.layer.f90], f0, metallic, gain);
    let coat = match has_base {
        false => Coat::None,
        true => {
            let (f0, f90) = (m.layer.f0, m.layer.f90);
            Coat::Layer { f0, f90, alpha, kept: 1.0 - m.layer.mean(r), over: None }
        }
    };
    (reflecting(Facet::Between { f0, f90 }, &rough), coat)
}

impl Bsdf {
    /// Sets the lobes of a surface between metal and dielectric that has more than its layer.
    #[cold]
    pub(super) fn set_metal_rough(&mut self, scene: &Scene, m: &MetalRough, at: &Interaction, read: &Read) {
        let Looks { f0, r, metallic, said } = Looks::of(m, read);
        let alpha = MetalRough::alpha(r);
        let cosine = at.wo.dot(self.normal).max(0.0);
        let there = m.coverage * said.filter(|_| m.coverage_in_alpha).unwrap_or(1.0);
        let through = match m.through.color.max_element() > 0.0 {
            true => at.point().reflectance(scene, &m.through),
            false => Vec3::ZERO,
        };
        let layer = [m.layer.f0, m.layer.f90];
        let kept = self.set_around(&Around { there, over: m.over, through, layer }, cosine, r);
        self.set_coat_normal(scene, m.over.as_ref(), None, at);
        let rough = self.grained(m.grain, r, alpha);
        let [f0, f90] = regained(layer, f0, metallic, gain_along(&rough, cosine));
        self.lobe = reflecting(Facet::Between { f0: f0 * kept, f90: f90 * kept }, &rough);
        if self.diffuse != Vec3::ZERO {
            let [f0, f90] = layer;
            self.coat = Coat::Layer { f0, f90, alpha, kept: 1.0 - m.layer.mean(r), over: m.over };
        }
    }

    /// What a recipe made of the surface.
    #[cold]
    pub(super) fn set_made(&mut self, scene: &Scene, recipe: &Recipe, made: &Made, at: &Interaction) {
        let r = made.roughness;
        let alpha = MetalRough::alpha(r);
        let cosine = at.wo.dot(self.normal).max(0.0);
        let [layer_f0, layer_f90, mean] = made.layer;
        let rough = self.grained(made.grain, r, alpha);
        let gain = gain_along(&rough, cosine);
        let [mut f0, f90] = regained([layer_f0, layer_f90], made.f0, Some(made.metallic), gain);
        let mut layer = [layer_f0, layer_f90];
        if let Some(film) = made.film.filter(|f| f.strength > 0.0) {
            f0 = film.normal_reflectance(cosine, f0, f90);
            let plain = Vec3::splat(layer_f0);
            layer[0] = film.normal_reflectance(cosine, plain, Vec3::splat(layer_f90)).max_element();
        }
        let around = Around { there: made.coverage, over: made.over, through: made.through, layer };
        let kept = self.set_around(&around, cosine, r);
        self.set_coat_normal(scene, made.over.as_ref(), recipe.coat_normal, at);
        self.lobe = reflecting(Facet::Between { f0: f0 * kept, f90: f90 * kept }, &rough);
        self.passed = made.passed;
        if self.diffuse != Vec3::ZERO || self.passed != Vec3::ZERO {
            let [f0, f90] = layer;
            self.coat = Coat::Layer { f0, f90, alpha, kept: 1.0 - mean, over: made.over };
        }
    }

    /// Turns the frame along the grooves, if there are any; returns how rough the surface is along it and across.
    fn grained(&mut self, grain: Option<Grain>, r: f32, alpha: f32) -> Roughness {
        let [alpha_x, alpha_y] = grain.map_or([alpha; 2], |g| g.alphas(r));
        if let Some(grain) = grain {
            let (s, c) = math::sin_cos(grain.rotation);
            let tangent = self.tangent * c + self.bitangent * s;
            self.bitangent = self.bitangent * c - self.tangent * s;
            self.tangent = tangent;
        }
        Roughness { alpha_x, alpha_y, distribution: Distribution::Ggx }
    }

    /// Gives a coat the normal of its own: that of its map, else the one without bumps.
    fn set_coat_normal(
        &mut self,
        scene: &Scene,
        over: Option<&Over>,
        map: Option<TextureId>,
        at: &Interaction,
    ) {
        if over.is_none_or(|o| o.coat.is_none()) || map.is_none() && at.smooth_normal == at.shading_normal {
            return;
        }
        self.apart = at.coat_normal(scene, map);
        self.is_apart = true;
    }

    /// Sets what lies beside the layer; returns the share of light that is left for it.
    fn set_around(&mut self, around: &Around, cosine: f32, r: f32) -> f32 {
        let there = around.there.clamp(0.0, 1.0);
        let mut kept = there;
        let mut push = |lobe: Lobe| {
            self.more[usize::from(self.layers)] = lobe;
            self.layers += 1;
        };
        if let Some(over) = around.over {
            if let Some(coat) = over.coat {
                let gain = coat.strength * there;
                let f0 = Vec3::splat(metal_rough::Clearcoat::F0 * gain);
                let facet = Facet::Between { f0, f90: Vec3::splat(gain) };
                push(reflecting(facet, &isotropic(MetalRough::alpha(coat.roughness))));
            }
            if let Some(sheen) = over.sheen {
                let color = sheen.color * (there * over.below_coat(cosine));
                push(Lobe::Fibres { color, alpha: sheen.alpha() });
            }
            kept *= over.kept(cosine);
        }
        let mut straight = Vec3::splat(1.0 - there);
        if around.through.max_element() > 0.0 {
            let alpha = MetalRough::alpha(r);
            let [f0, f90] = around.layer;
            let reflected = LobeAlbedo::table().layer(f0, f90, cosine, alpha);
            let weight = around.through * (kept * (1.0 - reflected));
            match Microfacet::of(&isotropic(alpha)) {
                None => straight += weight,
                // One of both: the blurred one where it is more.
                Some(microfacet) if luminance(weight) > luminance(straight) => {
                    push(Lobe::Blurred { weight: weight + straight, microfacet });
                    straight = Vec3::ZERO;
                }
                Some(_) => straight += weight,
            }
        }
        if straight.max_element() > 0.0 {
            push(Lobe::Straight { weight: straight });
        }
        kept
    }

    /// Whether there are several lobes beside each other.
    pub fn is_layered(&self) -> bool {
        self.layers > 0
    }

    pub(super) fn beside(&self) -> &[Lobe] {
        &self.more[..usize::from(self.layers)]
    }

    /// Each lobe as if it were alone, the first one first.
    pub fn parts(&self) -> impl Iterator<Item = Self> + '_ {
        let alone = |(k, lobe): (usize, Lobe)| {
            let part = Self { lobe, layers: 0, is_apart: false, ..*self };
            // The coat is the first of those beside.
            if self.is_apart && k == 1 { part.with_normal_apart() } else { part }
        };
        std::iter::once(self.lobe).chain(self.beside().iter().copied()).enumerate().map(alone)
    }

    /// The same about the coat's own normal.
    #[cold]
    fn with_normal_apart(&self) -> Self {
        let normal = self.apart;
        let (tangent, bitangent) = normal.any_orthonormal_pair();
        Self { normal, tangent, bitangent, apart: self.normal, is_apart: true, ..*self }
    }

    /// What passes in a straight line.
    pub fn straight(&self) -> Vec3 {
        let weight = |lobe: &Lobe| if let Lobe::Straight { weight } = lobe { *weight } else { Vec3::ZERO };
        self.beside().iter().map(weight).sum()
    }

    /// The lobe that a number in [0, 1) chooses by what each reflects: which one, how probable that was, and a number for
    /// what it has to choose itself.
    pub fn chosen(&self, wo: Vec3, u: f32) -> Option<(Self, f32, f32)> {
        let mut shares = [0.0; MORE + 1];
        for (share, part) in shares.iter_mut().zip(self.parts()) {
            *share = luminance(part.view_dependent_albedo(wo)).max(0.0);
        }
        let sum: f32 = shares.iter().sum();
        if !(sum > 0.0 && sum.is_finite()) {
            return None;
        }
        let mut before = 0.0;
        let last = shares.iter().rposition(|s| *s > 0.0)?;
        for (k, part) in self.parts().enumerate() {
            let p = shares[k] / sum;
            if p > 0.0 && (u < before + p || k == last) {
                return Some((part, p, ((u - before) / p).clamp(0.0, 1.0 - f32::EPSILON)));
            }
            before += p;
        }
        None
    }

    pub(super) fn sample_layered(&self, wo: Vec3, u: [f32; 2], u_lobe: f32) -> Option<BsdfSample> {
        let (part, p, u_lobe) = self.chosen(wo, u_lobe)?;
        let sample = part.sample(wo, u, u_lobe)?;
        if sample.delta {
            return Some(BsdfSample { weight: sample.weight / p, pdf: sample.pdf * p, ..sample });
        }
        let (f, pdf) = self.evaluate_layered(wo, sample.wi);
        let weight = f * (sample.wi.dot(self.normal) / pdf);
        (pdf > 0.0 && weight.is_finite()).then_some(BsdfSample { weight, pdf, ..sample })
    }

    pub(super) fn evaluate_layered(&self, wo: Vec3, wi: Vec3) -> (Vec3, f32) {
        let (mut value, mut density, mut all) = (Vec3::ZERO, 0.0, 0.0);
        for part in self.parts() {
            let share = luminance(part.view_dependent_albedo(wo)).max(0.0);
            all += share;
            if !part.is_delta() {
                let (f, pdf) = part.evaluate_and_pdf(wo, wi);
                value += f;
                density += share * pdf;
            }
        }
        if all > 0.0 { (value, density / all) } else { (Vec3::ZERO, 0.0) }
    }

    /// What passes a rough surface without thickness: mirrored at a facet, then at the surface.
    pub(super) fn sample_blurred(
        &self,
        wo: Vec3,
        u: [f32; 2],
        weight: Vec3,
        m: &Microfacet,
    ) -> Option<BsdfSample> {
        let o = self.local(wo);
        if o.z <= 0.0 {
            return None;
        }
        let h = m.sample(o, u);
        let i = h * (2.0 * o.dot(h)) - o;
        let wi = self.world(Vec3::new(i.x, i.y, -i.z)).normalize_or_zero();
        (i.z > 0.0 && wi.dot(self.geometric) < 0.0).then_some(BsdfSample {
            wi,
            // What single scattering loses is not lost here.
            weight,
            pdf: 1.0,
            delta: true,
            transmitted: true,
            radiance_scale: 1.0,
        })
    }

    pub(super) fn sample_fibres(&self, wo: Vec3, u: [f32; 2]) -> Option<BsdfSample> {
        let wi = self.world(cosine_hemisphere(u)).normalize_or_zero();
        let (f, pdf) = self.evaluate_and_pdf(wo, wi);
        let weight = f * (wi.dot(self.normal) / pdf);
        (pdf > 0.0 && weight.is_finite()).then_some(BsdfSample {
            wi,
            weight,
            pdf: pdf.min(FRAC_1_PI),
            delta: false,
            transmitted: false,
            radiance_scale: 1.0,
        })
    }
}
