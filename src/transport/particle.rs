//! Particles: packets of flux from the lights through the scene (REFERENCE §6.1; Walter, Hubbard, Shirley
//! & Greenberg 1997), and the light transport that a bake needs.

use std::ops::Deref;
use std::sync::Arc;

use glam::Vec3;

use super::bsdf::{Bsdf, BsdfSample, cosine_hemisphere};
use super::direct::{is_pane, visibility};
use super::interaction::Interaction;
use super::light::{LightSample, Lights};
use super::lit::{LitSurfaces, Start};
use super::medium::Media;
use crate::geometry::{Accel, Hit, Ray};
use crate::image::luminance;
use crate::rng::Stream;
use crate::scene::{Material, Model, Scene};

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
    /// Surfaces met before, but for panes that it passed: 0 straight from a light.
    pub bounce: u32,
}

/// A point of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// The triangle.
    pub triangle: u32,
    /// Barycentric coordinate at its second corner.
    pub b1: f32,
    /// Barycentric coordinate at its third corner.
    pub b2: f32,
}

/// A sample of the irradiance that comes straight from a light.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Arriving {
    /// Irradiance, W/m² per band.
    pub irradiance: Vec3,
    /// Whether the surrounding or a directional light brings it.
    pub from_afar: bool,
}

impl From<Vec3> for Arriving {
    /// From a light inside of the scene.
    fn from(irradiance: Vec3) -> Self {
        Self { irradiance, from_afar: false }
    }
}

/// A particle that a small piece of surface reflects diffusely.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reflected {
    /// Middle of the piece.
    pub at: SurfacePoint,
    /// Whether the back reflects it.
    pub back: bool,
    /// Width of the piece, scene units.
    pub width: f32,
    /// Flux before the reflection, as if it were the only particle, W per band.
    pub flux: Vec3,
}

/// What a bake needs to know of a scene.
pub trait LightTransport: Sync {
    /// Emits particle `index` and follows it; every arrival on a diffuse part goes to `deposit`. Returns the
    /// number of surfaces it met.
    fn trace(&self, seed: u64, index: u64, deposit: &mut dyn FnMut(Deposit)) -> u32;

    /// Where light from afar falls on surfaces that do not only reflect it diffusely, by `pieces` samples; a triangle
    /// counts `weight`. Nowhere, unless transport knows better.
    fn lit(&self, _pieces: usize, _seed: u64, _weight: &(dyn Fn(u32) -> f64 + Sync)) -> LitSurfaces {
        LitSurfaces::default()
    }

    /// As [`Self::trace`], but of what arrives straight from lights nothing is told, nor anything of what light from
    /// afar becomes by a diffuse reflection first: that is [`Self::reflect`]'s. `choice` in [0, 1) decides where it begins.
    fn trace_reflected(
        &self,
        lit: &LitSurfaces,
        choice: f64,
        seed: u64,
        index: u64,
        deposit: &mut dyn FnMut(Deposit),
    ) -> u32;

    /// Follows a particle from a diffuse reflection on. Returns the number of surfaces it met, the first included.
    fn reflect(&self, _: &Reflected, _seed: u64, _index: u64, _deposit: &mut dyn FnMut(Deposit)) -> u32 {
        0
    }

    /// Irradiance that comes straight from those lights to one side of a point that no chance is needed for, W/m².
    fn certain(&self, _triangle: u32, _b1: f32, _b2: f32, _back: bool) -> Vec3 {
        Vec3::ZERO
    }

    /// The part of [`Self::certain`] that lights inside of the scene bring, W/m².
    fn certain_from_near(&self, _triangle: u32, _b1: f32, _b2: f32, _back: bool) -> Vec3 {
        Vec3::ZERO
    }

    /// One sample of the irradiance that comes straight from all other lights, W/m², for three numbers in [0, 1): the
    /// first chooses the light, the others the point on it.
    fn direct(&self, triangle: u32, b1: f32, b2: f32, back: bool, u: [f32; 3]) -> Arriving;

    /// Whether a random ray from a side of a point ends on anything within `near`, or from the front on the back of a
    /// triangle.
    fn sees_inside(&self, at: SurfacePoint, back: bool, near: f32, stream: &mut Stream) -> bool;

    /// Whether nothing stands between two points at `height` over one side of their surfaces.
    fn is_open_between(&self, _a: SurfacePoint, _b: SurfacePoint, _back: bool, _height: f32) -> bool {
        true
    }

    /// The first surface on a ray.
    fn sees(&self, ray: &Ray) -> Option<Hit>;

    /// Whether a triangle reflects diffusely, so that irradiance on it matters.
    fn is_diffuse(&self, triangle: u32) -> bool;

    /// A typical flux of a particle, W in its strongest band; 0 where there is no light.
    fn power(&self) -> f32;
}

impl<T: LightTransport + ?Sized> LightTransport for &T {
    fn trace(&self, seed: u64, index: u64, deposit: &mut dyn FnMut(Deposit)) -> u32 {
        (**self).trace(seed, index, deposit)
    }

    fn lit(&self, pieces: usize, seed: u64, weight: &(dyn Fn(u32) -> f64 + Sync)) -> LitSurfaces {
        (**self).lit(pieces, seed, weight)
    }

    fn trace_reflected(
        &self,
        lit: &LitSurfaces,
        choice: f64,
        seed: u64,
        index: u64,
        deposit: &mut dyn FnMut(Deposit),
    ) -> u32 {
        (**self).trace_reflected(lit, choice, seed, index, deposit)
    }

    fn reflect(&self, from: &Reflected, seed: u64, index: u64, deposit: &mut dyn FnMut(Deposit)) -> u32 {
        (**self).reflect(from, seed, index, deposit)
    }

    fn certain(&self, triangle: u32, b1: f32, b2: f32, back: bool) -> Vec3 {
        (**self).certain(triangle, b1, b2, back)
    }

    fn certain_from_near(&self, triangle: u32, b1: f32, b2: f32, back: bool) -> Vec3 {
        (**self).certain_from_near(triangle, b1, b2, back)
    }

    fn direct(&self, triangle: u32, b1: f32, b2: f32, back: bool, u: [f32; 3]) -> Arriving {
        (**self).direct(triangle, b1, b2, back, u)
    }

    fn sees_inside(&self, at: SurfacePoint, back: bool, near: f32, stream: &mut Stream) -> bool {
        (**self).sees_inside(at, back, near, stream)
    }

    fn is_open_between(&self, a: SurfacePoint, b: SurfacePoint, back: bool, height: f32) -> bool {
        (**self).is_open_between(a, b, back, height)
    }

    fn sees(&self, ray: &Ray) -> Option<Hit> {
        (**self).sees(ray)
    }

    fn is_diffuse(&self, triangle: u32) -> bool {
        (**self).is_diffuse(triangle)
    }

    fn power(&self) -> f32 {
        (**self).power()
    }
}

/// The light transport of a scene: all its materials and lights, borrowed or shared.
#[derive(Clone, Copy, Debug)]
pub struct TransportOf<S, A, L> {
    scene: S,
    accel: A,
    lights: L,
    /// There is glass that light passes in a straight line.
    panes: bool,
}

/// That of a scene in sight.
pub type SceneTransport<'a> = TransportOf<&'a Scene, &'a Accel, &'a Lights>;

/// The same for bakes that outlive their caller.
pub type SharedTransport = TransportOf<Arc<Scene>, Arc<Accel>, Arc<Lights>>;

/// Largest share of particles that survive a surface.
const SURVIVAL_MAX: f32 = 0.99;
/// Largest factor of the corrections for shading normals: beyond it, single particles would shine.
const CORRECTION_MAX: f32 = 8.0;

/// Interpolated vertex normal on the front side, without bumps: those are finer than stored illumination.
fn smooth_normal(scene: &Scene, triangle: u32, b1: f32, b2: f32, geometric: Vec3) -> Vec3 {
    let [a, b, c] = scene.mesh.triangles[triangle as usize].map(|v| scene.mesh.normals[v as usize]);
    let normal = (a * (1.0 - b1 - b2) + b * b1 + c * b2).try_normalize().unwrap_or(geometric);
    if normal.dot(geometric) < 0.0 { -normal } else { normal }
}

/// a / b, bounded; 0 where they differ in sign: the direction is before one of two normals and behind the other.
fn ratio(a: f32, b: f32) -> f32 {
    let r = a / b;
    if r.is_finite() { r.clamp(0.0, CORRECTION_MAX) } else { 1.0 }
}

/// A particle under way.
struct Flight {
    ray: Ray,
    flux: Vec3,
    media: Media,
    /// Surfaces met, but for panes that it passed.
    met: u32,
}

impl Flight {
    /// In the air.
    fn new((ray, flux): (Ray, Vec3), met: u32) -> Self {
        Self { ray, flux, media: Media::EMPTY, met }
    }
}

impl<S, A, L> TransportOf<S, A, L>
where
    S: Deref<Target = Scene> + Sync,
    A: Deref<Target = Accel> + Sync,
    L: Deref<Target = Lights> + Sync,
{
    /// The transport of `scene` with its acceleration structure and its lights.
    pub fn new(scene: S, accel: A, lights: L) -> Self {
        let is_pane = |m: &Material| matches!(m.model, Model::Dielectric { thin: true, .. });
        let panes = scene.materials.iter().any(is_pane);
        Self { scene, accel, lights, panes }
    }

    /// A point as seen from straight in front of one of its sides.
    fn seen_from(&self, triangle: u32, b1: f32, b2: f32, back: bool) -> Interaction {
        let [a, b, c] = self.scene.mesh.corners(triangle);
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let out = if back { -normal } else { normal };
        let p = a * (1.0 - b1 - b2) + b * b1 + c * b2;
        let hit = Hit { t: 1.0, triangle, b1, b2 };
        Interaction::at(&self.scene, &Ray::new(p + out, -out), &hit)
    }

    /// A surface under a sample of light from afar: the point as this light sees it, and the irradiance on the surface's
    /// geometric normal. `None` where something hides it.
    fn arriving_from_afar(&self, start: &Start, stream: &mut Stream) -> Option<(Interaction, Vec3)> {
        let (scene, Start { triangle, b1, b2, back, .. }) = (&*self.scene, *start);
        let at = self.seen_from(triangle, b1, b2, back);
        let facing = at.facing_geometric();
        let light =
            self.lights.sample_distant(scene, at.position, facing, stream.next_f32(), stream.next_2d())?;
        let irradiance = light.radiance * (facing.dot(light.wi).max(0.0) / light.pdf);
        let shines = |irradiance: Vec3| irradiance.is_finite() && irradiance.max_element() > 0.0;
        if !shines(irradiance) || !scene.is_opaque_at(triangle, b1, b2) {
            return None;
        }
        let irradiance = irradiance * self.passing(&at.spawn(light.wi));
        if !shines(irradiance) {
            return None;
        }
        let hit = Hit { t: 1.0, triangle, b1, b2 };
        Some((Interaction::at(scene, &Ray::new(at.position + light.wi, -light.wi), &hit), irradiance))
    }

    /// The share of light that passes along a ray: all, none, or what panes leave of it.
    fn passing(&self, ray: &Ray) -> Vec3 {
        if self.panes {
            visibility(&self.scene, &self.accel, ray)
        } else if self.accel.occluded(&self.scene, ray) {
            Vec3::ZERO
        } else {
            Vec3::ONE
        }
    }

    /// Follows a particle. Returns how many surfaces it has met in the end.
    fn follow(&self, mut flight: Flight, stream: &mut Stream, deposit: &mut dyn FnMut(Deposit)) -> u32 {
        let scene = &*self.scene;
        for surfaces in flight.met..BOUNCES_MAX {
            let Some(hit) = self.accel.intersect(scene, &flight.ray) else { return surfaces };
            let at = Interaction::at(scene, &flight.ray, &hit);
            let length = hit.t * flight.ray.direction.length();
            flight.flux *= flight.media.transmittance_to(scene, &at, length);
            // Whatever its colour there: a black texel is lit as its neighbours are.
            if self.is_diffuse(hit.triangle) {
                let bsdf = Bsdf::at(scene, &at);
                // Irradiance is that of the shading normal, under a coat that of the base.
                let smooth = smooth_normal(scene, hit.triangle, hit.b1, hit.b2, at.geometric_normal);
                let geometric_in = at.wo.dot(at.geometric_normal);
                let share = ratio(at.wo.dot(smooth), geometric_in) * bsdf.coat_factor(at.wo);
                let (triangle, b1, b2) = (hit.triangle, hit.b1, hit.b2);
                let (flux, bounce) = (flight.flux * share, flight.met);
                deposit(Deposit { triangle, b1, b2, back: at.back, flux, bounce });
            }
            let (u, u_lobe) = (stream.next_2d(), stream.next_f32());
            let sample = Bsdf::at(scene, &at).sample_all(at.wo, u, u_lobe);
            if !sample.is_some_and(|sample| self.onwards(&at, &sample, &mut flight, stream)) {
                return surfaces + 1;
            }
        }
        BOUNCES_MAX
    }

    /// A particle goes on from a surface in a direction that was drawn; false where it ends.
    fn onwards(
        &self,
        at: &Interaction,
        sample: &BsdfSample,
        flight: &mut Flight,
        stream: &mut Stream,
    ) -> bool {
        let geometric_in = at.wo.dot(at.geometric_normal);
        // Particles see shading normals from the other end than paths (Veach 1997, eq 5.19).
        let asymmetry = ratio(at.wo.dot(at.shading_normal), geometric_in)
            * ratio(sample.wi.dot(at.geometric_normal), sample.wi.dot(at.shading_normal));
        let weight = sample.weight * asymmetry;
        let survival = weight.max_element().min(SURVIVAL_MAX);
        if stream.next_f32() >= survival {
            return false;
        }
        if sample.transmitted {
            flight.media = flight.media.crossed(&self.scene, at);
        }
        flight.met += u32::from(!is_passed(&self.scene, at, sample));
        flight.flux *= weight / survival;
        flight.ray = at.spawn(sample.wi);
        flight.flux.is_finite()
    }

    fn material(&self, triangle: u32) -> &Material {
        &self.scene.materials[self.scene.mesh.materials[triangle as usize].0 as usize]
    }

    /// A point of the same triangle within a square of this width around one; the point itself near the triangle's edge.
    fn beside(&self, at: SurfacePoint, width: f32, [u, v]: [f32; 2]) -> SurfacePoint {
        let [a, b, c] = self.scene.mesh.corners(at.triangle);
        let (e1, e2) = (b - a, c - a);
        let normal = e1.cross(e2);
        let (x, y) = normal.normalize_or(Vec3::Z).any_orthonormal_pair();
        let shift = (x * (u - 0.5) + y * (v - 0.5)) * width;
        let b1 = at.b1 + shift.cross(e2).dot(normal) / normal.length_squared();
        let b2 = at.b2 + e1.cross(shift).dot(normal) / normal.length_squared();
        if b1 >= 0.0 && b2 >= 0.0 && b1 + b2 <= 1.0 { SurfacePoint { b1, b2, ..at } } else { at }
    }

    /// Irradiance by a light sample, unless something hides the light.
    fn arriving(&self, facing: &Facing, light: &LightSample) -> Vec3 {
        let (scene, at) = (&*self.scene, &facing.at);
        let cosine = light.wi.dot(facing.normal);
        if cosine <= 0.0 || light.wi.dot(at.facing_geometric()) <= 0.0 {
            return Vec3::ZERO;
        }
        if !self.is_diffuse(at.triangle) {
            return Vec3::ZERO;
        }
        let bsdf = Bsdf::at(scene, at);
        let irradiance = light.radiance * (cosine * bsdf.coat_factor(light.wi) / light.pdf);
        let ray = if light.distance.is_finite() {
            at.spawn_to(at.position + light.wi * light.distance)
        } else {
            at.spawn(light.wi)
        };
        if !irradiance.is_finite() {
            return Vec3::ZERO;
        }
        irradiance * self.passing(&ray)
    }
}

/// A side of a point with the normal that irradiance is for.
struct Facing {
    at: Interaction,
    /// Smooth, on this side.
    normal: Vec3,
}

impl Facing {
    fn new(scene: &Scene, at: Interaction) -> Self {
        let smooth = smooth_normal(scene, at.triangle, at.b1, at.b2, at.geometric_normal);
        Self { normal: if at.back { -smooth } else { smooth }, at }
    }
}

/// Whether light goes on through a pane as if there was none: samples of lights see through it as well.
fn is_passed(scene: &Scene, at: &Interaction, sample: &BsdfSample) -> bool {
    sample.transmitted && is_pane(scene, at)
}

impl<S, A, L> LightTransport for TransportOf<S, A, L>
where
    S: Deref<Target = Scene> + Sync,
    A: Deref<Target = Accel> + Sync,
    L: Deref<Target = Lights> + Sync,
{
    fn trace(&self, seed: u64, index: u64, deposit: &mut dyn FnMut(Deposit)) -> u32 {
        let mut stream = Stream::new(seed, index, 0);
        match self.lights.sample_emission(&self.scene, &mut stream) {
            Some(start) => self.follow(Flight::new(start, 0), &mut stream, deposit),
            None => 0,
        }
    }

    fn lit(&self, pieces: usize, seed: u64, weight: &(dyn Fn(u32) -> f64 + Sync)) -> LitSurfaces {
        let areas = (0..self.scene.mesh.triangles.len() as u32).map(|t| {
            let [a, b, c] = self.scene.mesh.corners(t);
            if self.material(t).is_diffuse() { 0.0 } else { 0.5 * (b - a).cross(c - a).length() }
        });
        let pieces = if self.lights.has_distant() { pieces } else { 0 };
        LitSurfaces::new(areas, pieces, seed, self.lights.near_power(), weight, &|start, stream| {
            self.arriving_from_afar(start, stream).map_or(0.0, |(_, e)| luminance(e))
        })
    }

    fn trace_reflected(
        &self,
        lit: &LitSurfaces,
        choice: f64,
        seed: u64,
        index: u64,
        deposit: &mut dyn FnMut(Deposit),
    ) -> u32 {
        let mut stream = Stream::new(seed, index, 0);
        let near_share = lit.near_share();
        if choice < near_share {
            let Some((ray, flux)) = self.lights.sample_near_emission(&self.scene, &mut stream) else {
                return 0;
            };
            let flux = flux / near_share as f32;
            return self.follow(Flight::new((ray, flux), 0), &mut stream, &mut |d| {
                if d.bounce > 0 {
                    deposit(d);
                }
            });
        }
        let choice = (choice - near_share) / (1.0 - near_share);
        let Some(start) = lit.start(choice, stream.next_2d()) else { return 0 };
        let Some((at, irradiance)) = self.arriving_from_afar(&start, &mut stream) else { return 0 };
        let flux = irradiance / (start.density * (1.0 - near_share)) as f32;
        let (u, u_lobe) = (stream.next_2d(), stream.next_f32());
        let Some(sample) = Bsdf::at(&self.scene, &at).sample(at.wo, u, u_lobe) else { return 1 };
        // What only passes a pane falls on the surfaces behind it, and begins there.
        let mut flight = Flight::new((at.spawn(sample.wi), flux), 0);
        if is_passed(&self.scene, &at, &sample) || !self.onwards(&at, &sample, &mut flight, &mut stream) {
            return 1;
        }
        self.follow(flight, &mut stream, deposit)
    }

    fn reflect(&self, from: &Reflected, seed: u64, index: u64, deposit: &mut dyn FnMut(Deposit)) -> u32 {
        let mut stream = Stream::new(seed, index, 0);
        let SurfacePoint { triangle, b1, b2 } = self.beside(from.at, from.width, stream.next_2d());
        if !self.scene.is_opaque_at(triangle, b1, b2) {
            return 1;
        }
        let at = self.seen_from(triangle, b1, b2, from.back);
        let out = at.facing_geometric();
        let (x, y) = out.any_orthonormal_pair();
        let local = cosine_hemisphere(stream.next_2d());
        let wi = x * local.x + y * local.y + out * local.z;
        let bsdf = Bsdf::at(&self.scene, &at);
        let weight = bsdf.diffuse_albedo() * bsdf.coat_factor(wi);
        let survival = weight.max_element().min(SURVIVAL_MAX);
        // Also refuses NaN.
        if !(stream.next_f32() < survival) {
            return 1;
        }
        let start = (at.spawn(wi), from.flux * weight / survival);
        self.follow(Flight::new(start, 1), &mut stream, deposit)
    }

    fn certain(&self, triangle: u32, b1: f32, b2: f32, back: bool) -> Vec3 {
        let facing = Facing::new(&self.scene, self.seen_from(triangle, b1, b2, back));
        self.lights.certain(&self.scene, facing.at.position).map(|l| self.arriving(&facing, &l)).sum()
    }

    fn certain_from_near(&self, triangle: u32, b1: f32, b2: f32, back: bool) -> Vec3 {
        if !self.lights.has_near_points() {
            return Vec3::ZERO;
        }
        let facing = Facing::new(&self.scene, self.seen_from(triangle, b1, b2, back));
        let near = self.lights.certain(&self.scene, facing.at.position).filter(|l| !l.is_from_afar());
        near.map(|l| self.arriving(&facing, &l)).sum()
    }

    fn direct(&self, triangle: u32, b1: f32, b2: f32, back: bool, [choice, u, v]: [f32; 3]) -> Arriving {
        let facing = Facing::new(&self.scene, self.seen_from(triangle, b1, b2, back));
        let (point, normal) = (facing.at.position, facing.normal);
        self.lights.sample_irradiance(&self.scene, point, normal, choice, [u, v]).map_or(
            Arriving::default(),
            |light| Arriving { irradiance: self.arriving(&facing, &light), from_afar: light.is_from_afar() },
        )
    }

    fn is_open_between(&self, a: SurfacePoint, b: SurfacePoint, back: bool, height: f32) -> bool {
        let over = |p: SurfacePoint| {
            let at = self.seen_from(p.triangle, p.b1, p.b2, back);
            at.position + height * at.facing_geometric()
        };
        let (from, to) = (over(a), over(b));
        let ray = Ray { t_max: 1.0, ..Ray::new(from, to - from) };
        from == to || !self.accel.occluded(&self.scene, &ray)
    }

    fn sees(&self, ray: &Ray) -> Option<Hit> {
        self.accel.intersect(&self.scene, ray)
    }

    fn sees_inside(&self, at: SurfacePoint, back: bool, near: f32, stream: &mut Stream) -> bool {
        let at = self.seen_from(at.triangle, at.b1, at.b2, back);
        let out = at.facing_geometric();
        let (x, y) = out.any_orthonormal_pair();
        let local = cosine_hemisphere(stream.next_2d());
        let ray = at.spawn(x * local.x + y * local.y + out * local.z);
        let Some(hit) = self.accel.intersect(&self.scene, &ray) else { return false };
        let [a, b, c] = self.scene.mesh.corners(hit.triangle);
        let closed = hit.t < near || !back && (b - a).cross(c - a).dot(ray.direction) > 0.0;
        closed && !self.material(hit.triangle).is_transparent()
    }

    fn is_diffuse(&self, triangle: u32) -> bool {
        self.material(triangle).has_diffuse()
    }

    fn power(&self) -> f32 {
        self.lights.total_power().max_element()
    }
}

#[cfg(test)]
mod tests;
