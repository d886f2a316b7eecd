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
        match &self.material(triangle).model {
            Model::Lambert { albedo } | Model::Plastic { albedo, .. } => albedo.color.max_element() > 0.0,
            Model::CookTorrance { diffuse, .. } | Model::Ward { diffuse, .. } => {
                diffuse.color.max_element() > 0.0
            }
            Model::MetalRough(m) => m.diffuse.color.max_element() > 0.0,
            Model::Mirror { .. }
            | Model::Conductor { .. }
            | Model::Metal { .. }
            | Model::Dielectric { .. } => false,
        }
    }

    fn power(&self) -> f32 {
        self.lights.total_power().max_element()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illumination::bake::{BakeSettings, bake};
    use crate::illumination::test_scenes::{cube, join, lambert, quad, scene};
    use crate::illumination::test_transport::Lambertian;
    use crate::math;
    use crate::scene::texture::{MipChain, Texture};
    use crate::scene::{Light, Reflectance, TextureId};

    fn of_model(model: Model) -> Material {
        Material { model, ..lambert(0.0, 0.0) }
    }

    /// Irradiance by particles on the whole triangle `t`, and the number of deposits on it.
    fn mean_on(transport: &dyn LightTransport, t: u32, area: f32, from_bounce: u32) -> Vec3 {
        let n = 200_000;
        let mut sum = glam::DVec3::ZERO;
        for i in 0..n {
            transport.trace(3, i, &mut |d| {
                if d.triangle == t && d.bounce >= from_bounce {
                    sum += d.flux.as_dvec3();
                }
            });
        }
        (sum / (n as f64 * f64::from(area))).as_vec3()
    }

    #[test]
    fn agrees_with_transport_written_from_the_definitions() {
        let mut mesh = cube(Vec3::ZERO, 2.0, false);
        join(&mut mesh, &cube(Vec3::new(0.4, 0.01, 0.5), 0.6, true), 0);
        join(&mut mesh, &quad(Vec3::new(0.3, 1.9, 0.7), Vec3::X * 0.8, Vec3::Z * 0.5), 1);
        let room = scene(mesh, vec![lambert(0.5, 0.0), lambert(0.2, 3.0)], Vec::new());
        let (accel, lights) = (Accel::build(&room), Lights::build(&room));
        let real = SceneTransport::new(&room, &accel, &lights);
        let plain = Lambertian::new(&room);
        assert!((real.power() / plain.power() - 1.0).abs() < 1e-4);
        let settings =
            BakeSettings { texels: 1500, particles: Some(200_000), error: None, ..BakeSettings::default() };
        let a = bake(&room, &real, &settings, &|_| true).illumination;
        let b = bake(&room, &plain, &settings, &|_| true).illumination;
        let (mut difference, mut energy) = (0.0f64, 0.0f64);
        for (x, y) in a.front_values().iter().zip(b.front_values()) {
            difference += f64::from(x[1] - y[1]).powi(2);
            energy += f64::from(y[1]).powi(2);
        }
        let relative = (difference / energy).sqrt();
        let expected = f64::from(math::hypot(a.summary.relative_error, b.summary.relative_error));
        assert!(relative < 1.3 * expected + 0.004, "{relative} {expected}");
        assert!((a.summary.mean[1] / b.summary.mean[1] - 1.0).abs() < 0.01);
    }

    #[test]
    fn a_mirror_sends_a_caustic_that_direct_light_does_not_have() {
        // A point light at height 1 over a mirror floor; a ceiling at height 2 that faces down.
        let mut mesh = quad(Vec3::new(-20.0, 0.0, 20.0), Vec3::X * 40.0, Vec3::NEG_Z * 40.0);
        join(&mut mesh, &quad(Vec3::new(-0.1, 2.0, -0.1), Vec3::X * 0.2, Vec3::Z * 0.2), 1);
        let mirror = of_model(Model::Mirror { specular: Reflectance::constant(Vec3::splat(0.8)) });
        let light = Light::Point { position: Vec3::Y, intensity: Vec3::ONE };
        let hall = scene(mesh, vec![mirror, lambert(0.5, 0.0)], vec![light]);
        let (accel, lights) = (Accel::build(&hall), Lights::build(&hall));
        let transport = SceneTransport::new(&hall, &accel, &lights);
        // Straight: 1/1². By the mirror from the light's image: 0.8/3².
        let direct = transport.certain(2, 0.33, 0.33, false).x;
        assert!((direct - 1.0).abs() < 0.02, "{direct}");
        let narrow = 2_000_000;
        let mut caustic = 0.0f64;
        for i in 0..narrow {
            transport.trace(1, i, &mut |d| {
                if d.triangle >= 2 && d.bounce == 1 {
                    caustic += f64::from(d.flux.x);
                }
            });
        }
        let caustic = caustic / narrow as f64 / 0.04;
        assert!((caustic / (0.8 / 9.0) - 1.0).abs() < 0.12, "{caustic}");
        assert!(!transport.is_diffuse(0) && transport.is_diffuse(2));
    }

    #[test]
    fn light_through_a_pane_arrives_as_from_the_light_itself() {
        let mut mesh = quad(Vec3::new(-0.5, 0.0, 0.5), Vec3::X, Vec3::NEG_Z);
        join(&mut mesh, &quad(Vec3::new(-3.0, 0.5, 3.0), Vec3::X * 6.0, Vec3::NEG_Z * 6.0), 1);
        let pane = of_model(Model::Dielectric {
            ior: 1.5,
            transmittance: Vec3::ONE,
            thin: true,
            roughness: crate::scene::Roughness {
                alpha_x: 0.0,
                alpha_y: 0.0,
                distribution: Default::default(),
            },
        });
        let sun = Light::Directional { direction: Vec3::NEG_Y, irradiance: Vec3::ONE };
        let window = scene(mesh, vec![lambert(0.5, 0.0), pane], vec![sun]);
        let (accel, lights) = (Accel::build(&window), Lights::build(&window));
        let transport = SceneTransport::new(&window, &accel, &lights);
        // 2R/(1 + R) with R = .04 is reflected.
        let through = 1.0 - 0.08 / 1.04;
        assert!((transport.certain(0, 0.3, 0.3, false).x / through - 1.0).abs() < 1e-4);
        let straight = [0, 1].map(|t| mean_on(&transport, t, 0.5, 0).x - mean_on(&transport, t, 0.5, 1).x);
        assert!((0.5 * (straight[0] + straight[1]) / through - 1.0).abs() < 0.05, "{straight:?} {through}");
        // Neither lamp nor sun lights the floor twice: what particles bring is the floor's own light, sent back.
        let lit = transport.lit(1000, 1, &|_| 1.0);
        let (n, mut again) = (100_000, 0.0);
        for i in 0..n {
            let choice = (i as f64 + 0.5) / n as f64;
            transport.trace_reflected(&lit, choice, 3, i, &mut |d| again += f64::from(d.flux.x) / n as f64);
        }
        assert!(again < 0.01, "{again}");
    }

    #[test]
    fn a_black_texel_is_lit_as_a_white_one() {
        let mut mesh = quad(Vec3::new(-0.5, 0.0, 0.5), Vec3::X, Vec3::NEG_Z);
        mesh.uvs = mesh.positions.iter().map(|p| glam::Vec2::new(p.x, p.z)).collect();
        let texels = [[0, 0, 0, 255], [255; 4], [255; 4], [0, 0, 0, 255]];
        let checker = MipChain::from_rgba8(2, 2, texels.to_vec(), true);
        let albedo = Reflectance { color: Vec3::ONE, map: Some(TextureId(0)) };
        let sun = Light::Directional { direction: Vec3::NEG_Y, irradiance: Vec3::ONE };
        let floor = scene(mesh, vec![of_model(Model::Lambert { albedo })], vec![sun])
            .with_resident(vec![Texture::new("checker", checker)]);
        let (accel, lights) = (Accel::build(&floor), Lights::build(&floor));
        let transport = SceneTransport::new(&floor, &accel, &lights);
        for (b1, b2) in [(0.1, 0.1), (0.3, 0.1), (0.1, 0.3), (0.6, 0.1)] {
            assert_eq!(transport.certain(0, b1, b2, false), Vec3::ONE);
        }
        let particles = mean_on(&transport, 0, 0.5, 0).x;
        assert!((particles - 1.0).abs() < 0.01, "{particles}");
    }

    #[test]
    fn glass_absorbs_on_the_way_to_what_lies_in_it() {
        let mut mesh = cube(Vec3::new(-1.0, -0.5, -1.0), 2.0, true);
        join(&mut mesh, &quad(Vec3::new(-0.5, 0.0, 0.5), Vec3::X, Vec3::NEG_Z), 1);
        let roughness =
            crate::scene::Roughness { alpha_x: 0.0, alpha_y: 0.0, distribution: Default::default() };
        let transmittance = Vec3::new(0.5, 0.8, 1.0);
        let glass = of_model(Model::Dielectric { ior: 1.0, transmittance, thin: false, roughness });
        let sun = Light::Directional { direction: Vec3::NEG_Y, irradiance: Vec3::ONE };
        let block = scene(mesh, vec![glass, lambert(1e-6, 0.0)], vec![sun]);
        let (accel, lights) = (Accel::build(&block), Lights::build(&block));
        let transport = SceneTransport::new(&block, &accel, &lights);
        let found = mean_on(&transport, 12, 0.5, 0);
        // A plate 1.5 below the surface of the block.
        let exact = transmittance.map(|t| math::powf(t, 1.5));
        assert!(((found / exact) - 1.0).abs().max_element() < 0.05, "{found} {exact}");
    }

    #[test]
    fn smooth_normals_brighten_and_darken_alike_for_direct_light_and_particles() {
        let mut mesh = quad(Vec3::new(-0.5, 0.0, 0.5), Vec3::X, Vec3::NEG_Z);
        let tilted = Vec3::new(0.5, 1.0, 0.0).normalize();
        mesh.normals.fill(tilted);
        let direction = Vec3::new(-1.0, -1.0, 0.0).normalize();
        let sun = Light::Directional { direction, irradiance: Vec3::ONE };
        let floor = scene(mesh, vec![lambert(0.5, 0.0)], vec![sun]);
        let (accel, lights) = (Accel::build(&floor), Lights::build(&floor));
        let transport = SceneTransport::new(&floor, &accel, &lights);
        let exact = -direction.dot(tilted);
        let direct = transport.certain(0, 0.3, 0.3, false).x;
        assert!((direct - exact).abs() < 1e-4, "{direct} {exact}");
        let particles = mean_on(&transport, 0, 0.5, 0).x;
        assert!((particles / exact - 1.0).abs() < 0.02, "{particles} {exact}");
    }

    #[test]
    fn glass_absorbs_along_the_way_inside() {
        let mut mesh = cube(Vec3::new(-1.0, 0.5, -1.0), 2.0, true);
        join(&mut mesh, &quad(Vec3::new(-0.5, 0.0, 0.5), Vec3::X, Vec3::NEG_Z), 1);
        let glass = of_model(Model::Dielectric {
            ior: 1.0,
            transmittance: Vec3::new(0.5, 0.8, 1.0),
            thin: false,
            roughness: crate::scene::Roughness {
                alpha_x: 0.0,
                alpha_y: 0.0,
                distribution: Default::default(),
            },
        });
        let sun = Light::Directional { direction: Vec3::NEG_Y, irradiance: Vec3::ONE };
        let block = scene(mesh, vec![glass, lambert(1e-6, 0.0)], vec![sun]);
        let (accel, lights) = (Accel::build(&block), Lights::build(&block));
        let transport = SceneTransport::new(&block, &accel, &lights);
        let found = mean_on(&transport, 12, 0.5, 0);
        let exact = Vec3::new(0.25, 0.64, 1.0);
        assert!(((found / exact) - 1.0).abs().max_element() < 0.05, "{found}");
    }
}
