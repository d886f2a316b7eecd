//! Light from named lights on sixteen neighbouring points at once: the same bits as on each of them, from shadow rays that go
//! together.

use arrayvec::ArrayVec;
use glam::Vec3;

use super::{cosine_above, finite};
use crate::geometry::packet::LANES;
use crate::geometry::shadow::LastShadow;
use crate::geometry::{Accel, Ray};
use crate::scene::Scene;
use crate::transport::bsdf::Bsdf;
use crate::transport::direct::{towards, visibilities};
use crate::transport::interaction::Interaction;
use crate::transport::light::Lights;
use crate::transport::light::named::{NAMED_MAX, named_sample};

/// What threw the last shadows of each named light.
#[derive(Clone, Copy, Debug, Default)]
pub struct LastShadows([LastShadow; NAMED_MAX]);

/// The light that one of the lights sends to the points, if nothing is in the way.
struct Asked {
    /// Its number among the scene's lights.
    name: u32,
    /// A bit for each point that it reaches.
    lanes: u32,
    rays: [Ray; LANES],
    /// Irradiance of each point.
    open: [(f32, Vec3); LANES],
}

/// Points of which the light from named lights is asked ([`super::Gather::named`]), in the open.
pub struct Together<'a> {
    scene: &'a Scene,
    accel: &'a Accel,
    lights: ArrayVec<Asked, NAMED_MAX>,
}

impl<'a> Together<'a> {
    /// No point so far.
    #[inline]
    pub fn new(scene: &'a Scene, accel: &'a Accel, lights: &Lights) -> Self {
        let mut asked = ArrayVec::new();
        for name in lights.names() {
            let none = Ray::new(Vec3::ZERO, Vec3::Z);
            asked.push(Asked { name, lanes: 0, rays: [none; LANES], open: [(0.0, Vec3::ZERO); LANES] });
        }
        Self { scene, accel, lights: asked }
    }

    /// Point number `lane`, whose diffuse part has this albedo.
    #[inline]
    pub fn ask(&mut self, lane: usize, at: &Interaction, diffuse: Vec3) {
        let coat = Bsdf::coat_over(self.scene, at, diffuse);
        for Asked { name, lanes, rays, open } in &mut self.lights {
            let Some(sample) = named_sample(self.scene, *name, at.position) else { continue };
            let cosine = cosine_above(at, sample.wi);
            let value = match &coat {
                Some(coat) if cosine > 0.0 => cosine * coat.factor(sample.wi),
                _ => cosine,
            };
            if value > 0.0 {
                *lanes |= 1 << lane;
                rays[lane] = towards(at, &sample);
                open[lane] = (value, sample.radiance);
            }
        }
    }

    /// Irradiance of each of them; finite, 0 where nobody asked. `last`: what threw the last shadows.
    #[inline]
    pub fn irradiance(&self, last: &mut LastShadows) -> [Vec3; LANES] {
        let mut sums = [Vec3::ZERO; LANES];
        for (Asked { name: _, lanes, rays, open }, last) in self.lights.iter().zip(&mut last.0) {
            let passed = visibilities(self.scene, self.accel, rays, *lanes, last);
            for lane in (0..LANES).filter(|lane| lanes >> lane & 1 != 0) {
                if passed[lane].max_element() > 0.0 {
                    let (value, radiance) = open[lane];
                    sums[lane] += value * (radiance * passed[lane]);
                }
            }
        }
        sums.map(finite)
    }
}
