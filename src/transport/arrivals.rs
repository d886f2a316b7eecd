//! Which light brings what to a point, straight: for whoever asks why a surface looks as it does.

use std::collections::BTreeMap;

use glam::Vec3;

use super::Indexed;
use super::direct::visibility;
use super::interaction::Interaction;
use super::light::{Emitter, LightSample, Receiver};
use crate::image::luminance;
use crate::rng::Stream;
use crate::scene::edit::Lamp;

/// What one lamp brings straight to a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrival {
    /// Which lamp.
    pub lamp: Lamp,
    /// Irradiance, W/m² per band.
    pub irradiance: Vec3,
    /// Standard error of its luminance; 0 for a light that is asked and not chosen by chance.
    pub noise: f32,
}

/// What each lamp brings straight to the side of `at` that it is seen from, the most first; lamps that bring nothing are
/// left out. `samples` are shared out among the lamps that are chosen by chance.
pub fn arrivals(indexed: Indexed<'_>, at: &Interaction, samples: u32, seed: u64) -> Vec<Arrival> {
    let Indexed { scene, accel, lights } = indexed;
    let normal = at.facing_shading();
    let arriving = |sample: &LightSample| {
        let cosine = normal.dot(sample.wi);
        if cosine <= 0.0 || at.facing_geometric().dot(sample.wi) <= 0.0 {
            return Vec3::ZERO;
        }
        let ray = match sample.is_distant() {
            true => at.spawn(sample.wi),
            false => at.spawn_to(at.position + sample.wi * sample.distance),
        };
        visibility(scene, accel, &ray) * sample.radiance * cosine
    };
    let asks = lights.has_any_named();
    let mut sums: BTreeMap<Lamp, (Vec3, f64)> = BTreeMap::new();
    for number in 0..samples {
        let mut stream = Stream::new(seed, u64::from(number), 0);
        let choice = f64::from((number as f32 + stream.next_f32()) / samples as f32);
        let drawn = lights.draw_towards(scene, &Receiver::from(at), (choice, stream.next_2d()), None);
        let Some((emitter, sample)) = drawn else { continue };
        let lamp = match emitter {
            Emitter::Triangle(t) => Lamp::Material(scene.mesh.materials[t as usize].0),
            Emitter::Analytic(_) if asks => continue,
            Emitter::Analytic(light) => Lamp::Light(light),
            Emitter::Environment => Lamp::Environment,
        };
        let brought = arriving(&sample) / sample.pdf;
        if brought.is_finite() {
            let (sum, squares) = sums.entry(lamp).or_default();
            *sum += brought;
            *squares += f64::from(luminance(brought)).powi(2);
        }
    }
    let count = f64::from(samples.max(1));
    let mut arrivals: Vec<Arrival> = sums
        .into_iter()
        .map(|(lamp, (sum, squares))| {
            let irradiance = sum / count as f32;
            let variance = squares / count - f64::from(luminance(irradiance)).powi(2);
            Arrival { lamp, irradiance, noise: (variance.max(0.0) / count).sqrt() as f32 }
        })
        .collect();
    arrivals.extend(lights.named_by_number(scene, at.position).map(|(light, sample)| Arrival {
        lamp: Lamp::Light(light),
        irradiance: arriving(&sample),
        noise: 0.0,
    }));
    arrivals.retain(|arrival| arrival.irradiance.max_element() > 0.0);
    arrivals.sort_by(|a, b| luminance(b.irradiance).total_cmp(&luminance(a.irradiance)));
    arrivals
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Accel, Ray};
    use crate::illumination::test_scenes::{join, lambert, quad, scene};
    use crate::scene::{Light, Mesh};
    use crate::transport::light::Lights;
    use std::f32::consts::PI;

    /// A square lamp and a point light above a floor, the point light behind a wall for one half of it.
    #[test]
    fn each_lamp_brings_what_it_would_bring_alone() {
        let mut mesh = Mesh::default();
        join(&mut mesh, &quad(Vec3::new(-5.0, 0.0, 5.0), Vec3::X * 10.0, Vec3::Z * -10.0), 0);
        join(&mut mesh, &quad(Vec3::new(-0.5, 1.0, -0.5), Vec3::X, Vec3::Z), 1);
        // Stands on the floor at x = 2, as high as 4.
        join(&mut mesh, &quad(Vec3::new(2.0, 0.0, -5.0), Vec3::Z * 10.0, Vec3::Y * 4.0), 0);
        let bulb = Light::Point {
            position: Vec3::new(1.8, 1.5, 0.0),
            intensity: Vec3::splat(9.0),
            range: f32::INFINITY,
        };
        let materials = vec![lambert(0.5, 0.0), lambert(0.0, 1.0)];
        let scene = scene(mesh, materials, vec![bulb]);
        let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
        let indexed = Indexed { scene: &scene, accel: &accel, lights: &lights };
        let at = |x: f32| {
            let ray = Ray::new(Vec3::new(x, 0.5, 0.01), Vec3::NEG_Y);
            Interaction::at(&scene, &ray, &accel.intersect(&scene, &ray).expect("the floor"))
        };
        let found = arrivals(indexed, &at(0.0), 4096, 1);
        let of = |lamp| found.iter().find(|arrival| arrival.lamp == lamp).copied();
        let square = of(Lamp::Material(1)).expect("the lamp");
        assert!((square.irradiance.x - PI * 0.239_456).abs() < 4.0 * square.noise + 1e-3, "{square:?}");
        let bulb = of(Lamp::Light(0)).expect("the light");
        // E = I h / d³.
        let expected = 9.0 * 1.5 / (1.8_f32 * 1.8 + 1.5 * 1.5).sqrt().powi(3);
        assert!((bulb.irradiance.x - expected).abs() < 1e-3 && bulb.noise == 0.0, "{bulb:?}");
        assert_eq!(found[0].lamp, Lamp::Light(0), "the most first");
        let hidden = arrivals(indexed, &at(4.0), 4096, 1);
        assert!(hidden.iter().all(|arrival| arrival.lamp != Lamp::Light(0)), "{hidden:?}");
    }
}
