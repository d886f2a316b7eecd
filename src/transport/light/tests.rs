use super::*;
use crate::geometry::{Accel, Ray};
use crate::illumination::test_scenes::{join, lambert, quad, scene};
use crate::image::Map2d;
use crate::math;
use crate::rng::Stream;
use crate::scene::{Environment, Mesh, Texture, TextureId, texture::MipChain};

/// A 1 × 1 light at height 1 that looks down, over a large floor.
fn square_light() -> Scene {
    let mut mesh = Mesh::default();
    join(&mut mesh, &quad(Vec3::new(-5.0, 0.0, 5.0), Vec3::X * 10.0, Vec3::Z * -10.0), 0);
    join(&mut mesh, &quad(Vec3::new(-0.5, 1.0, -0.5), Vec3::X, Vec3::Z), 1);
    scene(mesh, vec![lambert(0.5, 0.0), lambert(0.0, 1.0)], vec![])
}

/// Mean and standard error of the irradiance at `point` with normal +y, by light samples or by uniform directions
/// weighted with the balance heuristic.
fn irradiance(s: &Scene, point: Vec3, n: u64, both: bool) -> (f64, f64) {
    let lights = Lights::build(s);
    let accel = Accel::build(s);
    let at = Receiver { point, normal: Vec3::Y };
    let (mut sum, mut square) = (0.0, 0.0);
    for i in 0..n {
        let mut stream = Stream::new(3, i, 0);
        let mut x = 0.0;
        if let Some(l) = lights.sample_towards(s, &at, (stream.next_f64(), stream.next_2d()), None) {
            let weight = if both && !l.delta { l.pdf / (l.pdf + 1.0 / TAU) } else { 1.0 };
            x += f64::from(luminance(l.radiance) * l.wi.y.max(0.0) / l.pdf * weight);
        }
        if both {
            let [u, v] = stream.next_2d();
            let (r, (sin, cos)) = ((1.0 - u * u).sqrt(), math::sin_cos(TAU * v));
            let wi = Vec3::new(r * cos, u, r * sin);
            let ray = Ray { t_min: 1e-4, ..Ray::new(point, wi) };
            let hit = accel.intersect(s, &ray);
            let pdf = lights.pdf_towards(s, &at, (wi, hit.as_ref()), None);
            let radiance = match hit {
                None => lights.escaped(s, wi),
                Some(h) => {
                    let front = normal_and_area(s.mesh.corners(h.triangle)).0.dot(wi) < 0.0;
                    let l = s.materials[s.mesh.materials[h.triangle as usize].0 as usize].emission.color;
                    if front { l } else { Vec3::ZERO }
                }
            };
            x += f64::from(luminance(radiance) * u / (1.0 / TAU + pdf));
        }
        sum += x / n as f64;
        square += x * x / n as f64;
    }
    (sum, ((square - sum * sum).max(0.0) / n as f64).sqrt())
}

#[test]
fn irradiance_under_a_square_light() {
    let s = square_light();
    for (x, form_factor) in
        [(0.0, 0.239456), (0.25, 0.222966), (0.5, 0.180369), (1.0, 0.084354), (2.0, 0.013924)]
    {
        let expected = std::f64::consts::PI * form_factor;
        let point = Vec3::new(x, 0.0, 0.0);
        for both in [false, true] {
            let (e, error) = irradiance(&s, point, 20_000, both);
            assert!((e - expected).abs() < 3.0 * error + 1e-5, "{x} {both}: {e} ± {error}, {expected}");
            assert!(error < 0.01 * expected.max(0.2));
        }
    }
    // From behind and from the side there is nothing.
    assert_eq!(irradiance(&s, Vec3::Y * 2.0, 100, false).0, 0.0);
    assert_eq!(irradiance(&s, Vec3::new(3.0, 1.0, 0.0), 100, false).0, 0.0);
}

/// Far away the triangle is a point (area sampling), close up it fills half the sphere.
#[test]
fn irradiance_far_from_and_close_to_a_light() {
    let s = square_light();
    let (e, _) = irradiance(&s, Vec3::Y * -99.0, 1000, false);
    assert!((e - 1e-4).abs() < 1e-7, "{e}");
    let (e, error) = irradiance(&s, Vec3::Y * 0.9995, 40_000, false);
    assert!((e - std::f64::consts::PI).abs() < 4.0 * error + 0.002, "{e} ± {error}");
}

#[test]
fn irradiance_of_lights_without_area() {
    let mut s = square_light();
    s.materials[1].emission.color = Vec3::ZERO;
    let white = Vec3::ONE;
    let position = Vec3::new(0.0, 2.0, 0.0);
    s.lights = vec![
        Light::Point { position, intensity: white * 4.0, range: f32::INFINITY },
        Light::Spot {
            position,
            direction: Vec3::NEG_Y,
            intensity: white * 8.0,
            inner: 0.2,
            outer: 0.3,
            range: f32::INFINITY,
        },
        Light::Directional { direction: Vec3::new(0.0, -0.6, 0.8), irradiance: white * 5.0 },
        Light::Point { position: Vec3::NAN, intensity: white, range: f32::INFINITY },
        Light::Point { position, intensity: Vec3::INFINITY, range: f32::INFINITY },
        Light::Directional { direction: Vec3::ZERO, irradiance: white },
    ];
    assert_eq!(Lights::build(&s).emitters.len(), 3);
    let (e, error) = irradiance(&s, Vec3::ZERO, 40_000, true);
    assert!((e - (1.0 + 2.0 + 3.0)).abs() < 4.0 * error, "{e} ± {error}");
    let beside = Vec3::new(2.0, 0.0, 0.0);
    let (e, error) = irradiance(&s, beside, 40_000, true);
    let point = 4.0 / 8.0 * 0.5f64.sqrt();
    assert!((e - (point + 3.0)).abs() < 4.0 * error, "{e} ± {error}");
}

#[test]
fn irradiance_of_the_environment() {
    let mut s = square_light();
    s.environment = Some(Environment::constant(Vec3::splat(2.0)));
    // The light hides a part of the environment and adds its own.
    let (e, error) = irradiance(&s, Vec3::new(0.0, 5.0, 0.0), 20_000, true);
    assert!((e - 2.0 * std::f64::consts::PI).abs() < 4.0 * error, "{e} ± {error}");
    let map = Map2d::from_fn(32, 16, |_, y| Vec3::splat(if y < 8 { 1.0 } else { 0.0 }));
    s.environment = Some(Environment { map: Some(map), ..Environment::constant(Vec3::ONE) });
    let (e, error) = irradiance(&s, Vec3::new(0.0, 5.0, 0.0), 20_000, true);
    // Interpolation darkens the row over the horizon, where the cosine is small.
    assert!((e - std::f64::consts::PI).abs() < 4.0 * error + 0.02, "{e} ± {error}");
}

/// A scene with every kind of light.
fn mixed() -> Scene {
    let mut s = square_light();
    let position = Vec3::new(0.0, 2.0, 0.0);
    s.lights = vec![
        Light::Point { position, intensity: Vec3::X, range: f32::INFINITY },
        Light::Spot {
            position,
            direction: Vec3::NEG_Y,
            intensity: Vec3::Y,
            inner: 0.1,
            outer: 0.8,
            range: f32::INFINITY,
        },
        Light::Directional { direction: Vec3::NEG_Y, irradiance: Vec3::splat(0.02) },
    ];
    s.environment = Some(Environment::constant(Vec3::new(0.01, 0.01, 0.03)));
    s
}

#[test]
fn mean_flux_of_particles_is_the_power() {
    let s = mixed();
    let lights = Lights::build(&s);
    let n = 20_000;
    let (mut sum, mut square) = (glam::DVec3::ZERO, glam::DVec3::ZERO);
    for i in 0..n {
        let mut stream = Stream::new(11, i, 0);
        if let Some((_, ray, flux)) = lights.begin(&s, &mut stream) {
            assert!((ray.direction.length() - 1.0).abs() < 1e-4);
            sum += flux.as_dvec3() / n as f64;
            square += flux.as_dvec3() * flux.as_dvec3() / n as f64;
        }
    }
    // Square, point, spot, sun, environment: in closed form.
    let pi = std::f64::consts::PI;
    let radius = f64::from(lights.radius);
    let disk = pi * radius * radius;
    let distant = |radiance: f64| disk * (0.02 + radiance * 4.0 * pi);
    let spot = pi * (2.0 - math::cos(0.1_f64) - math::cos(0.8_f64));
    let power = [pi + 4.0 * pi + distant(0.01), pi + spot + distant(0.01), pi + distant(0.03)];
    for (band, power) in power.into_iter().enumerate() {
        let error = ((square[band] - sum[band] * sum[band]) / n as f64).sqrt();
        assert!((sum[band] - power).abs() < 4.0 * error, "{band}: {} ± {error}, {power}", sum[band]);
        assert!(error < 0.05 * power, "{band}: ± {error} proves nothing");
    }
}

/// Particles carry the irradiance that next-event estimation finds.
#[test]
fn particles_and_light_samples_agree() {
    let s = mixed();
    let (lights, accel) = (Lights::build(&s), Accel::build(&s));
    let n = 200_000;
    let (mut sum, mut square) = (0.0, 0.0);
    for i in 0..n {
        let mut stream = Stream::new(12, i, 0);
        let Some((_, ray, flux)) = lights.begin(&s, &mut stream) else { continue };
        let Some(hit) = accel.intersect(&s, &ray) else { continue };
        let p = ray.at(hit.t);
        if p.y.abs() < 1e-3 && p.x.abs() < 1.0 && p.z.abs() < 1.0 && ray.direction.y < 0.0 {
            let e = f64::from(luminance(flux)) / 4.0;
            sum += e / n as f64;
            square += e * e / n as f64;
        }
    }
    let error = ((square - sum * sum) / n as f64).sqrt();
    let (mut expected, m) = (0.0, 64);
    for i in 0..m {
        let [u, v] = [(i % 8) as f32 + 0.5, (i / 8) as f32 + 0.5].map(|x| x / 4.0 - 1.0);
        // Everything but the light's own shadow on the rest, which is traced.
        expected += shadowed_irradiance(&s, &lights, &accel, Vec3::new(u, 0.0, v)) / m as f64;
    }
    assert!((sum - expected).abs() < 4.0 * error + 0.01 * expected, "{sum} ± {error}, {expected}");
}

fn shadowed_irradiance(s: &Scene, lights: &Lights, accel: &Accel, point: Vec3) -> f64 {
    let n = 2000;
    let (at, mut sum) = (Receiver { point, normal: Vec3::Y }, 0.0);
    for i in 0..n {
        let mut stream =
            Stream::new(13, i, u64::from(point.x.to_bits()) << 32 | u64::from(point.z.to_bits()));
        let Some(l) = lights.sample_towards(s, &at, (stream.next_f64(), stream.next_2d()), None) else {
            continue;
        };
        let ray = Ray { t_min: 1e-4, t_max: l.distance * (1.0 - 1e-4), ..Ray::new(point, l.wi) };
        if l.wi.y > 0.0 && !accel.occluded(s, &ray) {
            sum += f64::from(luminance(l.radiance) * l.wi.y / l.pdf) / n as f64;
        }
    }
    sum
}

#[test]
fn textured_light_is_exact_where_it_is_read() {
    let mut s = square_light();
    s.mesh.uvs = s.mesh.positions.iter().map(|p| glam::Vec2::new(p.x + 0.5, p.z + 0.5)).collect();
    // Left half dark, right half bright.
    let texels = (0..64).map(|i| if i % 8 < 4 { [0.0; 4] } else { [1.0; 4] }).collect();
    let mut texture = Texture::new("half", MipChain::from_linear(8, 8, texels));
    texture.placement = crate::scene::Placement::clamped(true);
    s.textures.push(texture);
    s.materials[1].emission.map = Some(TextureId(0));
    let lights = Lights::build(&s);
    let n = 20_000u64;
    let mean = (0..n)
        .filter_map(|i| lights.begin(&s, &mut Stream::new(4, i, 0)))
        .inspect(|(_, ray, _)| assert!(ray.origin.x > -0.0626))
        .map(|(.., flux)| f64::from(flux.x))
        .sum::<f64>()
        / n as f64;
    assert!((mean - 0.5 * std::f64::consts::PI).abs() < 0.05, "{mean}");
    let (e, error) = irradiance(&s, Vec3::ZERO, 20_000, false);
    assert!((e - 0.5 * 0.752275).abs() < 4.0 * error, "{e} ± {error}");
}

#[test]
fn nothing_shines_in_the_dark() {
    let mut s = square_light();
    s.materials[1].emission.color = Vec3::ZERO;
    let lights = Lights::build(&s);
    assert!(lights.is_empty());
    let at = Receiver { point: Vec3::ZERO, normal: Vec3::Y };
    assert_eq!(lights.sample_towards(&s, &at, (0.5, [0.5, 0.5]), None), None);
    assert!(lights.begin(&s, &mut Stream::new(0, 0, 0)).is_none());
    assert_eq!(lights.pdf_towards(&s, &at, (Vec3::Y, None), None), 0.0);
    assert_eq!(lights.escaped(&s, Vec3::Y), Vec3::ZERO);
}

#[test]
fn broken_triangles_are_no_lights() {
    let mut mesh = quad(Vec3::ZERO, Vec3::X, Vec3::Y);
    let flat = quad(Vec3::ZERO, Vec3::X, Vec3::X * 2.0);
    let broken = quad(Vec3::NAN, Vec3::X, Vec3::Y);
    join(&mut mesh, &flat, 0);
    join(&mut mesh, &broken, 0);
    let s = scene(mesh, vec![lambert(0.5, 1.0)], vec![]);
    assert_eq!(Lights::build(&s).emitters, [Emitter::Triangle(0), Emitter::Triangle(1)]);
}
