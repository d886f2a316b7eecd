//! What rough lobes reflect altogether: the split sum of Karis 2013.
//!
//! A lobe of microfacets with Schlick's Fresnel reflects f₀ A + f₉₀ B of the light.

use glam::Vec3;

use crate::math;

/// Sides of the table.
const COSINES: usize = 24;
const ROUGHNESSES: usize = 16;

/// A and B of the split sum for GGX with height-correlated Smith shadowing, by ⟨n, v⟩ and roughness √α.
#[derive(Clone, Debug)]
pub struct SplitSum(Vec<[f32; 2]>);

impl Default for SplitSum {
    fn default() -> Self {
        let entry = |i: usize| {
            let cosine = ((i % COSINES) as f32 + 0.5) / COSINES as f32;
            let roughness = ((i / COSINES) as f32 + 0.5) / ROUGHNESSES as f32;
            integrate(cosine, roughness * roughness)
        };
        Self((0..COSINES * ROUGHNESSES).map(entry).collect())
    }
}

/// ∫ f cos dω split into the parts that F₀ scales and that it does not.
fn integrate(cosine: f32, alpha: f32) -> [f32; 2] {
    const SAMPLES: u32 = 256;
    let a2 = alpha * alpha;
    let v = Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
    let (mut scale, mut bias) = (0.0, 0.0);
    for i in 0..SAMPLES {
        let u = (i as f32 + 0.5) / SAMPLES as f32;
        let phi = std::f32::consts::TAU * (i.reverse_bits() as f32 / 4_294_967_296.0);
        let z = ((1.0 - u) / (1.0 + (a2 - 1.0) * u)).sqrt();
        let r = (1.0 - z * z).max(0.0).sqrt();
        let h = Vec3::new(r * math::cos(phi), r * math::sin(phi), z);
        let vh = v.dot(h).max(0.0);
        let l = h * (2.0 * v.dot(h)) - v;
        if l.z <= 0.0 || vh <= 0.0 {
            continue;
        }
        let lambda = |c: f32| (a2 + (1.0 - a2) * c * c).sqrt();
        let shadowing = 2.0 * l.z * cosine / (l.z * lambda(cosine) + cosine * lambda(l.z));
        let visible = shadowing * vh / (z * cosine);
        let fresnel = (1.0 - vh).powi(5);
        scale += (1.0 - fresnel) * visible;
        bias += fresnel * visible;
    }
    [scale / SAMPLES as f32, bias / SAMPLES as f32]
}

impl SplitSum {
    /// (A, B) at a cosine in [0, 1] and α in [0, 1].
    pub fn at(&self, cosine: f32, alpha: f32) -> [f32; 2] {
        let position = |v: f32, n: usize| {
            let p = (v.clamp(0.0, 1.0) * n as f32 - 0.5).clamp(0.0, (n - 1) as f32);
            let low = (p as usize).min(n - 2);
            (low, p - low as f32)
        };
        let (x, fx) = position(cosine, COSINES);
        let (y, fy) = position(alpha.max(0.0).sqrt(), ROUGHNESSES);
        let entry = |x: usize, y: usize| self.0[y * COSINES + x];
        std::array::from_fn(|i| {
            let row = |y: usize| entry(x, y)[i] + (entry(x + 1, y)[i] - entry(x, y)[i]) * fx;
            row(y) + (row(y + 1) - row(y)) * fy
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_the_reference() {
        let exact = [
            (0.1, 0.1, 0.416, 0.578),
            (0.1, 0.5, 0.968, 0.031),
            (0.5, 0.5, 0.836, 0.022),
            (0.5, 1.0, 0.916, 0.0),
            (0.9, 0.5, 0.532, 0.005),
            (0.9, 1.0, 0.420, 0.0),
        ];
        for (roughness, cosine, a, b) in exact {
            let found = integrate(cosine, roughness * roughness);
            assert!(
                (found[0] - a).abs() < 0.015 && (found[1] - b).abs() < 0.015,
                "{roughness} {cosine} {found:?}"
            );
            let tabulated = SplitSum::default().at(cosine, roughness * roughness);
            assert!((tabulated[0] - a).abs() < 0.06, "{roughness} {cosine} {tabulated:?}");
        }
    }

    #[test]
    fn any_numbers_give_some() {
        let table = SplitSum::default();
        for v in [f32::NAN, f32::INFINITY, -1.0, 0.0, 1.0, 2.0] {
            for w in [f32::NAN, f32::INFINITY, -1.0, 0.0, 1.0, 2.0] {
                let [a, b] = table.at(v, w);
                // NaN in is NaN out of a clamp; everything else is an albedo.
                assert!(v.is_nan() || w.is_nan() || ((0.0..=1.001).contains(&a) && (0.0..=1.0).contains(&b)));
            }
        }
    }
}
