use super::*;
use crate::math;
use crate::rng::Stream;
use crate::scene::test_scenes::white_metal_rough;
use crate::scene::{Reflectance, Roughness};
use crate::transport::interaction::Interaction;

fn bsdf(diffuse: Vec3, coat: Coat, lobe: Lobe) -> Bsdf {
    Bsdf {
        normal: Vec3::Z,
        tangent: Vec3::X,
        bitangent: Vec3::Y,
        geometric: Vec3::Z,
        diffuse,
        passed: Vec3::ZERO,
        coat,
        lobe,
        apart: Vec3::ZERO,
        is_apart: false,
        more: [Lobe::None; layers::MORE],
        layers: 0,
    }
}

fn rough(ax: f32, ay: f32, distribution: Distribution, v_groove: bool) -> Microfacet {
    Microfacet { ax, ay, distribution, v_groove }
}

fn white(microfacet: Microfacet) -> Bsdf {
    bsdf(
        Vec3::ZERO,
        Coat::None,
        Lobe::Glossy { facet: Facet::Schlick { f0: Vec3::ONE, most: Vec3::ONE }, microfacet },
    )
}

fn direction(theta: f32, phi: f32) -> Vec3 {
    let (s, c) = math::sin_cos(theta.to_radians());
    Vec3::new(s * math::cos(phi), s * math::sin(phi), c)
}

/// Albedo by importance sampling: mean weight and its standard error.
fn albedo(b: &Bsdf, wo: Vec3, n: u64) -> (f64, f64) {
    let (mut sum, mut squares) = (0.0f64, 0.0f64);
    for i in 0..n {
        let mut s = Stream::new(17, i, 0);
        let w = b.sample(wo, s.next_2d(), s.next_f32()).map_or(0.0, |s| f64::from(s.weight.x));
        assert!(w.is_finite() && w >= 0.0);
        sum += w;
        squares += w * w;
    }
    let mean = sum / n as f64;
    (mean, ((squares / n as f64 - mean * mean).max(0.0) / n as f64).sqrt())
}

/// Albedo by uniform quadrature of `evaluate` over the hemisphere.
fn albedo_by_quadrature(b: &Bsdf, wo: Vec3) -> f64 {
    let (rings, sectors) = (600, 600);
    let mut sum = 0.0f64;
    for i in 0..rings {
        for j in 0..sectors {
            let z = (i as f32 + 0.5) / rings as f32;
            let phi = std::f32::consts::TAU * (j as f32 + 0.5) / sectors as f32;
            let r = (1.0 - z * z).sqrt();
            let wi = Vec3::new(r * math::cos(phi), r * math::sin(phi), z);
            sum += f64::from(b.evaluate(wo, wi).x * z);
        }
    }
    sum * std::f64::consts::TAU / f64::from(rings * sectors)
}

/// Directional albedos of REFERENCE §4.1 and §4.2.
#[test]
fn white_furnace_tables() {
    let angles = [0.0, 30.0, 60.0, 75.0, 85.0];
    let b = Distribution::Beckmann;
    let g = Distribution::Ggx;
    let ward = |a: f32| {
        bsdf(Vec3::ZERO, Coat::None, Lobe::Ward { specular: Vec3::ONE, microfacet: rough(a, a, b, false) })
    };
    let rows: [(Bsdf, [f64; 5]); 11] = [
        (white(rough(0.1, 0.1, b, true)), [1.0, 1.0, 0.9991, 0.9699, 0.9375]),
        (white(rough(0.3, 0.3, b, true)), [0.9956, 0.9812, 0.9248, 0.9273, 0.9702]),
        (white(rough(0.5, 0.5, b, true)), [0.8924, 0.8751, 0.8869, 0.9344, 0.9772]),
        (white(rough(0.1, 0.1, b, false)), [1.0, 1.0, 0.9999, 0.9753, 0.9134]),
        (white(rough(0.3, 0.3, b, false)), [0.9998, 0.9916, 0.9239, 0.9028, 0.9478]),
        (white(rough(0.5, 0.5, b, false)), [0.9434, 0.9031, 0.8718, 0.9030, 0.9628]),
        (white(rough(0.1, 0.1, g, false)), [0.9883, 0.9861, 0.9692, 0.9241, 0.8871]),
        (white(rough(0.3, 0.3, g, false)), [0.8774, 0.8639, 0.8217, 0.8238, 0.8980]),
        (white(rough(0.5, 0.5, g, false)), [0.6878, 0.6831, 0.6983, 0.7614, 0.8720]),
        (ward(0.1), [0.9900, 0.9883, 0.9740, 0.9175, 0.8128]),
        (ward(0.5), [0.7546, 0.7340, 0.7083, 0.7349, 0.8251]),
    ];
    for (row, (b, expected)) in rows.iter().enumerate() {
        for (angle, e) in angles.into_iter().zip(expected) {
            let (mean, se) = albedo(b, direction(angle, 0.4), 40_000);
            assert!((mean - e).abs() < 5.0 * se + 0.004, "row {row}, {angle}°: {mean} ± {se}, expected {e}");
        }
    }
}

/// Anisotropic Ward of REFERENCE §4.2: mean weight .834, never above 4/3.
#[test]
fn anisotropic_ward_is_bounded() {
    let b = bsdf(
        Vec3::ZERO,
        Coat::None,
        Lobe::Ward { specular: Vec3::ONE, microfacet: rough(0.15, 0.4, Distribution::Beckmann, false) },
    );
    let wo = direction(60.0, math::atan2(0.6f32, 0.8));
    let (mean, se) = albedo(&b, wo, 100_000);
    assert!((mean - 0.834).abs() < 5.0 * se + 0.003, "{mean}");
    for i in 0..10_000 {
        let mut s = Stream::new(1, i, 0);
        let w = b.sample(wo, s.next_2d(), 0.5).map_or(0.0, |s| s.weight.x);
        assert!(w < 2.0);
    }
}

/// Sampling and evaluation are two ways to the same albedo, f is reciprocal, and the density integrates to the
/// share of samples above the horizon.
#[test]
fn sampling_agrees_with_evaluation() {
    for m in [
        rough(0.4, 0.4, Distribution::Ggx, false),
        rough(0.2, 0.6, Distribution::Ggx, false),
        rough(0.3, 0.5, Distribution::Beckmann, false),
    ] {
        for b in [white(m), bsdf(Vec3::ZERO, Coat::None, Lobe::Ward { specular: Vec3::ONE, microfacet: m })] {
            for theta in [10.0, 50.0, 80.0] {
                let wo = direction(theta, 1.0);
                let (mean, se) = albedo(&b, wo, 60_000);
                let quadrature = albedo_by_quadrature(&b, wo);
                assert!((mean - quadrature).abs() < 5.0 * se + 0.01, "{b:?} {theta}: {mean} {quadrature}");
                let wi = direction(35.0, 2.0);
                let (f, back) = (b.evaluate(wo, wi).x, b.evaluate(wi, wo).x);
                assert!((f - back).abs() <= 1e-4 * f.max(1e-3), "{f} {back}");
            }
        }
    }
}

#[test]
fn glass_conserves_energy_and_obeys_snell() {
    for eta in [1.5f32, 1.0 / 1.5, 3.0, 1.0] {
        let b =
            bsdf(Vec3::ZERO, Coat::None, Lobe::Glass { eta, microfacet: None, tint: Vec3::ONE, spread: 0.0 });
        for theta in [0.0, 30.0, 60.0, 89.0] {
            let wo = direction(theta, 0.3);
            let lobes = b.delta_lobes(wo);
            let total: f32 = lobes.iter().flatten().map(|s| s.weight.x).sum();
            assert!((total - 1.0).abs() < 1e-5, "eta {eta}, {theta}°: {total}");
            for s in lobes.iter().flatten().filter(|s| s.transmitted) {
                let sine = |w: Vec3| w.truncate().length();
                assert!((sine(wo) - eta * sine(s.wi)).abs() < 1e-5);
                assert!(s.wi.z < 0.0 && s.wi.truncate().dot(wo.truncate()) <= 1e-6);
            }
        }
    }
    let pane = bsdf(Vec3::ZERO, Coat::None, Lobe::Pane { eta: 1.5, transmittance: Vec3::ONE });
    let lobes = pane.delta_lobes(Vec3::Z);
    assert!((lobes[0].map_or(0.0, |s| s.weight.x) - 2.0 * 0.04 / 1.04).abs() < 1e-5);
    assert!((lobes.iter().flatten().map(|s| s.weight.x).sum::<f32>() - 1.0).abs() < 1e-5);
}

/// A white base under a coat: base and coat together give back what arrives, at any angle and however rough; a darker
/// one less.
#[test]
fn coats_conserve_energy() {
    for ior in [1.0f32, 1.3, 1.5, 2.0, 3.0] {
        for alpha in [0.0, 0.05, 0.3, 0.7] {
            let roughness = Roughness { alpha_x: alpha, alpha_y: alpha, distribution: Distribution::Ggx };
            let coat = crate::scene::Coat::new(ior, roughness);
            let facet = Facet::Dielectric { eta: ior };
            let lobe = match Microfacet::of(&roughness) {
                _ if coat.is_none() => Lobe::None,
                None => Lobe::Smooth { facet },
                Some(microfacet) => Lobe::Glossy { facet, microfacet },
            };
            for rho in [0.2f32, 0.8, 1.0] {
                let b = Bsdf {
                    coat: Coat::Dielectric(coat),
                    ..bsdf(coat.albedo(Vec3::splat(rho)), Coat::None, lobe)
                };
                for theta in [0.0, 45.0, 75.0, 84.0, 89.0] {
                    let wo = direction(theta, 0.0);
                    let (reflected, error) = match lobe {
                        Lobe::None => (0.0, 0.0),
                        Lobe::Glossy { .. } => albedo(&b, wo, 20_000),
                        _ => (f64::from(fresnel::dielectric(wo.z, ior)), 0.0),
                    };
                    // Diffuse light towards wo under uniform irradiance, cos-weighted mean of the factor being 1.
                    let total = reflected + f64::from(b.coat_factor(wo) * b.diffuse_albedo().x);
                    let name = format!("ior {ior}, α {alpha}, ρ {rho}, {theta}°: {total} ± {error}");
                    assert!(total <= 1.01 + 4.0 * error, "{name}");
                    assert!(
                        (total > 0.99 - 4.0 * error) == (rho == 1.0) || coat.is_none() || reflected > 0.9,
                        "{name}"
                    );
                }
            }
        }
    }
}

/// No weight is NaN or negative for any roughness, index and angle.
#[test]
fn extremes_stay_finite() {
    for alpha in [Roughness::SMOOTH, 0.01, 0.3, 1.0] {
        for distribution in [Distribution::Ggx, Distribution::Beckmann] {
            let m = rough(alpha, alpha, distribution, distribution == Distribution::Beckmann);
            for lobe in [
                Lobe::Glossy { facet: Facet::Dielectric { eta: 3.0 }, microfacet: m },
                Lobe::Glossy {
                    facet: Facet::Conductor { eta: Vec3::splat(0.01), k: Vec3::splat(9.0) },
                    microfacet: m,
                },
                Lobe::Ward {
                    specular: Vec3::ONE,
                    microfacet: Microfacet { distribution: Distribution::Beckmann, ..m },
                },
                Lobe::Glass { eta: 1.0, microfacet: Some(m), tint: Vec3::ONE, spread: 0.0 },
                Lobe::Glass { eta: 1.0 / 3.0, microfacet: Some(m), tint: Vec3::ONE, spread: 0.0 },
            ] {
                let b = bsdf(Vec3::splat(0.3), Coat::None, lobe);
                for i in 0..2000u64 {
                    let mut s = Stream::new(3, i, 1);
                    let wo =
                        direction(if i % 5 == 0 { 89.999 } else { 89.0 * s.next_f32() }, 6.0 * s.next_f32());
                    for sample in
                        [b.sample(wo, s.next_2d(), s.next_f32()), b.sample_all(wo, s.next_2d(), s.next_f32())]
                            .into_iter()
                            .flatten()
                    {
                        assert!(
                            sample.weight.is_finite()
                                && sample.weight.min_element() >= 0.0
                                && sample.weight.max_element() < 50.0,
                            "{b:?} {sample:?}"
                        );
                        assert!((sample.wi.length() - 1.0).abs() < 1e-3);
                    }
                }
            }
        }
    }
}

/// Over a diffuse part, Schlick's rise at grazing angles takes no more than that part leaves.
#[test]
fn diffuse_and_glossy_parts_share_the_light() {
    let half = Vec3::splat(0.5);
    for m in [rough(0.1, 0.1, Distribution::Beckmann, true), rough(0.3, 0.3, Distribution::Ggx, false)] {
        let b = bsdf(
            half,
            Coat::None,
            Lobe::Glossy { facet: Facet::Schlick { f0: Vec3::splat(0.04), most: half }, microfacet: m },
        );
        for theta in [0.0, 60.0, 80.0, 86.0, 89.0] {
            let wo = direction(theta, 0.2);
            let (glossy, error) = albedo(&b, wo, 20_000);
            assert!(glossy <= 0.5 + 4.0 * error, "{theta}°: {glossy}");
            let wi = direction(88.0, 3.0);
            let (f, back) = (b.evaluate(wo, wi).x, b.evaluate(wi, wo).x);
            assert!((f - back).abs() <= 1e-3 * f.max(1e-3), "{f} {back}");
        }
    }
}

/// A surface seen at an angle.
fn seen(m: crate::scene::MetalRough, angle: f32) -> (Bsdf, Vec3) {
    use crate::geometry::{Hit, Ray};
    let corners = [Vec3::new(-1.0, -1.0, 0.0), Vec3::new(3.0, -1.0, 0.0), Vec3::new(-1.0, 3.0, 0.0)];
    let mut scene = crate::scene::test_scenes::of_triangles(&[corners]);
    scene.materials[0].model = Model::MetalRough(Box::new(m));
    let wo = direction(angle, 0.4);
    let hit = Hit { t: 1.0, triangle: 0, b1: 0.3, b2: 0.3 };
    (Bsdf::at(&scene, &Interaction::at(&scene, &Ray::new(wo, -wo), &hit)), wo)
}

/// What a surface returns and passes of white light from everywhere, and its standard error.
fn returned(m: crate::scene::MetalRough, angle: f32) -> (f64, f64) {
    let (b, wo) = seen(m, angle);
    let (lobe, error) = albedo(&b, wo, 20_000);
    (lobe + f64::from(b.diffuse_albedo().x * b.coat_factor(wo)), error)
}

#[test]
fn metal_and_rough_dielectric_return_all_light_and_no_more() {
    for metal in [0.0, 0.5, 1.0] {
        for r in [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0] {
            for angle in [0.0, 30.0, 60.0, 75.0, 85.0] {
                let (sum, error) = returned(white_metal_rough(metal, r), angle);
                assert!(
                    (sum - 1.0).abs() < 0.01 + 4.0 * error,
                    "m {metal}, r {r}, {angle}°: {sum} ± {error}"
                );
            }
        }
    }
    let (polished, wo) = seen(white_metal_rough(1.0, 0.0), 40.0);
    let [Some(mirrored), None] = polished.delta_lobes(wo) else { panic!("no mirror") };
    assert!((mirrored.weight - Vec3::ONE).abs().max_element() < 1e-6);
}

#[test]
fn half_a_metal_is_the_mean_of_metal_and_dielectric() {
    for (r, theta) in [(0.2, 10.0), (0.5, 40.0), (0.9, 70.0)] {
        let f = |metal: f32| {
            let (b, wo) = seen(white_metal_rough(metal, r), 30.0);
            let wi = direction(theta, 2.0);
            b.evaluate(wo, wi) + b.diffuse_albedo() * (b.coat_factor(wo) * FRAC_1_PI)
        };
        let (mean, half) = (0.5 * (f(0.0) + f(1.0)), f(0.5));
        assert!((mean - half).abs().max_element() <= 1e-6 * mean.x.max(1.0), "{r}: {mean} {half}");
    }
}

#[test]
fn coat_fibres_veils_and_what_passes_keep_the_light_there_is() {
    use crate::scene::metal_rough::{Clearcoat, Over};
    let coat = |roughness| Some(Clearcoat { strength: 0.8, roughness });
    let fibres = Some(crate::scene::Sheen { color: Vec3::splat(0.7), roughness: 0.6 });
    let overs = [
        None,
        Over::new(coat(0.0), None),
        Over::new(coat(0.4), None),
        Over::new(None, fibres),
        Over::new(coat(0.2), fibres),
    ];
    for over in overs {
        for (metal, r) in [(0.0, 0.3), (0.0, 0.0), (1.0, 0.5)] {
            for (through, coverage) in [(0.0, 1.0), (0.0, 0.5), (0.6, 1.0), (1.0, 0.3)] {
                let plain = white_metal_rough(metal, r);
                let kept = over.map_or(1.0, |o| o.kept_mean()) * coverage;
                let m = crate::scene::MetalRough {
                    diffuse: Reflectance::constant(plain.diffuse.color * ((1.0 - through) * kept)),
                    through: Reflectance::constant(Vec3::splat(through * (1.0 - metal))),
                    coverage,
                    over,
                    ..plain
                };
                for angle in [0.0, 50.0, 80.0] {
                    let (sum, error) = returned(m.clone(), angle);
                    assert!(
                        (sum - 1.0).abs() < 0.015 + 4.0 * error,
                        "{over:?} m {metal} r {r} t {through} a {coverage} {angle}°: {sum} ± {error}"
                    );
                }
            }
        }
    }
    // A veil of one half: half of what is behind, straight on.
    let veil = crate::scene::MetalRough { coverage: 0.5, ..white_metal_rough(0.0, 1.0) };
    let (b, wo) = seen(veil, 20.0);
    assert_eq!(b.straight(), Vec3::splat(0.5));
    let passed: Vec<BsdfSample> =
        b.parts().flat_map(|p| p.delta_lobes(wo)).flatten().filter(|s| s.transmitted).collect();
    assert_eq!(passed.len(), 1);
    assert_eq!((passed[0].wi, passed[0].weight), (-wo, Vec3::splat(0.5)));
}

/// Sampling and evaluating of several lobes agree: the mean weight is the integral.
#[test]
fn layered_lobes_are_sampled_as_they_are_evaluated() {
    use crate::scene::metal_rough::{Clearcoat, Over};
    let over = Over::new(
        Some(Clearcoat { strength: 1.0, roughness: 0.3 }),
        Some(crate::scene::Sheen { color: Vec3::splat(0.5), roughness: 0.5 }),
    );
    let m = crate::scene::MetalRough { over, ..white_metal_rough(1.0, 0.6) };
    let (b, wo) = seen(m, 55.0);
    let (sampled, error) = albedo(&b, wo, 100_000);
    let summed = albedo_by_quadrature(&b, wo);
    assert!((sampled - summed).abs() < 0.005 + 4.0 * error, "{sampled} ± {error}, {summed}");
}

#[test]
fn grain_stretches_the_highlight_along_it() {
    use crate::scene::metal_rough::Grain;
    let grain = Some(Grain { strength: 0.9, rotation: std::f32::consts::FRAC_PI_2 });
    let m = crate::scene::MetalRough { grain, ..white_metal_rough(1.0, 0.3) };
    let (b, _) = seen(m, 0.0);
    let (across, along) =
        (b.evaluate(Vec3::Z, direction(30.0, 0.0)), b.evaluate(Vec3::Z, direction(30.0, 90.0)));
    // Grooves along v: facets lean along them, and light comes from there.
    assert!(along.x > 4.0 * across.x, "{along} {across}");
}
