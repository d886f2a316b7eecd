//! The reference: an unbiased path tracer that knows of no stored illumination.
//!
//! Light sampling and BSDF sampling joined by multiple importance sampling (Veach 1997), lights chosen by what they
//! bring, Russian roulette after a few surfaces. Light of point, spot and directional lights through refracting glass is not found by
//! any path and stays dark; light of areas and of the surrounding is.

use glam::Vec3;

use super::bsdf::Bsdf;
use super::direct::{Found, arriving, is_pane, mis_weight};
use super::interaction::Interaction;
use super::light::{Lights, Receiver};
use super::medium::Media;
use crate::geometry::{Accel, Ray};
use crate::rng::Stream;
use crate::scene::Scene;

/// Surfaces that every path meets before roulette begins.
pub(super) const CERTAIN: u32 = 4;
/// No path is longer; roulette ends nearly all long before.
pub(super) const BOUNCES_MAX: u32 = 1000;

/// One sample of the radiance that arrives at the ray's origin against its direction. Finite.
pub fn path_radiance(scene: &Scene, accel: &Accel, lights: &Lights, ray: &Ray, mut stream: Stream) -> Vec3 {
    let Some(direction) = ray.direction.try_normalize() else { return Vec3::ZERO };
    let scale = ray.direction.length();
    let mut ray = Ray { direction, t_min: ray.t_min * scale, t_max: ray.t_max * scale, ..*ray };
    let (mut sum, mut throughput) = (Vec3::ZERO, Vec3::ONE);
    // Square of refractive indices crossed; kept apart, so that roulette does not end paths inside of glass.
    let mut index_scale = 1.0;
    let mut media = Media::default();
    let mut found: Option<Found> = None;
    for bounce in 0..BOUNCES_MAX {
        let hit = accel.intersect(scene, &ray);
        let share = |light: Vec3| {
            let Some(found) = found.filter(|_| light != Vec3::ZERO) else { return light };
            light * found.weight(scene, lights, ray.direction, hit.as_ref())
        };
        let Some(hit) = &hit else {
            sum += throughput * share(lights.escaped(scene, ray.direction)) * index_scale;
            break;
        };
        let at = Interaction::at(scene, &ray, hit);
        throughput *= media.transmittance_to(scene, &at, hit.t);
        let bsdf = Bsdf::at(scene, &at);
        sum += throughput * share(at.point().emission(scene)) * index_scale;
        // The density of light samples is needed for the next surface's weights too, so they are drawn
        // wherever something other than a delta lobe reflects.
        let m = u32::from(!lights.is_empty());
        let from = Receiver::from(&at);
        if let Some(light) = lights.sample_towards(scene, &from, stream.next_f64(), stream.next_2d()) {
            let f = bsdf.evaluate_all(at.wo, light.wi) * light.wi.dot(at.facing_shading()).max(0.0);
            if f.max_element() > 0.0
                && let Some(arriving) = arriving(scene, accel, &at, &media, &light)
            {
                let weight = if light.delta {
                    1.0
                } else {
                    mis_weight(m, light.pdf, 1, bsdf.pdf_all(at.wo, light.wi))
                };
                sum += throughput * f * arriving * (index_scale * weight / light.pdf);
            }
        }
        let Some(sample) = bsdf.sample_all(at.wo, stream.next_2d(), stream.next_f32()) else { break };
        throughput *= sample.weight;
        if sample.transmitted {
            index_scale *= sample.radiance_scale;
            media = media.crossed(scene, &at);
        }
        if !(sample.transmitted && is_pane(scene, &at)) {
            found = (!sample.delta).then_some(Found { from, pdf: sample.pdf, n: 1, m });
        }
        if bounce >= CERTAIN {
            let survival = throughput.max_element().min(0.95);
            // Also ends what is black or not a number.
            if survival.is_nan() || stream.next_f32() >= survival {
                break;
            }
            throughput /= survival;
        }
        ray = at.spawn(sample.wi);
    }
    if sum.is_finite() { sum } else { Vec3::ZERO }
}

#[cfg(test)]
mod tests;
