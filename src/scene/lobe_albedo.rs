//! What a rough lobe of glTF reflects altogether, and what follows from it for a base below.
//!
//! A lobe of GGX microfacets with Schlick's Fresnel reflects f₀ A + f₉₀ B of the light (Karis 2013). Single scattering
//! loses what meets a second facet; [`LobeAlbedo::gain`] gives it back as Turquin 2019 does, by a factor
//! 1 + f₀ (1 / (A + B) − 1). The table is finer than [`super::SplitSum`], holds its ends, and is sampled by visible facets, so
//! that a white furnace stays white to a hundredth. It lies in a file, since to make it takes as long as to load a small
//! scene; a test makes it again.

use std::sync::LazyLock;

#[cfg(test)]
use super::Distribution;
#[cfg(test)]
use super::microfacet::Microfacet;

/// Sides of the table: √⟨n, v⟩ and √α from 0 to 1.
const COSINES: usize = 33;
const ROUGHNESSES: usize = 33;

/// A and B by √⟨n, v⟩ and √α.
#[derive(Clone, Debug)]
pub struct LobeAlbedo(Vec<[f32; 2]>);

/// A and B of each entry, little endian.
static STORED: &[u8; 8 * COSINES * ROUGHNESSES] = include_bytes!("lobe_albedo.bin");

static TABLE: LazyLock<LobeAlbedo> = LazyLock::new(|| {
    let number = |bytes: &[u8; 4]| f32::from_le_bytes(*bytes);
    let entry = |[a, b]: &[[u8; 4]; 2]| [number(a), number(b)];
    LobeAlbedo(STORED.as_chunks::<4>().0.as_chunks::<2>().0.iter().map(entry).collect())
});

/// What a lobe of these A and B and reflectance 1 gains by scattering more than once, less 1: 1 / (A + B) − 1.
fn gained([a, b]: [f32; 2]) -> f32 {
    (1.0 / (a + b).max(0.1) - 1.0).max(0.0)
}

/// What either gains at the same places ([`LobeAlbedo::gain`]): one number to read where a surface is met.
static GAINS: LazyLock<[[f32; COSINES]; ROUGHNESSES]> =
    LazyLock::new(|| std::array::from_fn(|y| std::array::from_fn(|x| gained(TABLE.0[y * COSINES + x]))));

/// Cosine-weighted means of A, of B, and of what either gains ([`LobeAlbedo::gain`]), by √α.
static MEANS: LazyLock<Vec<[f32; 4]>> = LazyLock::new(|| {
    const STEPS: usize = 96;
    let table = LobeAlbedo::table();
    let mean = |y: usize| {
        let r = y as f32 / (ROUGHNESSES - 1) as f32;
        let mut sums = [0.0; 4];
        for i in 0..STEPS {
            let cosine = (i as f32 + 0.5) / STEPS as f32;
            let [a, b] = table.at(cosine, r * r);
            let gain = gained([a, b]);
            for (sum, v) in sums.iter_mut().zip([a, b, a * gain, b * gain]) {
                *sum += 2.0 * cosine * v / STEPS as f32;
            }
        }
        sums
    };
    (0..ROUGHNESSES).map(mean).collect()
});

/// The parts of ∫ f cos dω that f₀ and f₉₀ scale, by samples of visible facets (Heitz 2018).
#[cfg(test)]
fn integrate(cosine: f32, alpha: f32) -> [f32; 2] {
    const SAMPLES: u32 = 256;
    let schlick = |vh: f32| {
        let m = (1.0 - vh).clamp(0.0, 1.0);
        m * m * (m * m) * m
    };
    if alpha < 1e-4 {
        let fresnel = schlick(cosine);
        return [1.0 - fresnel, fresnel];
    }
    let facets = Microfacet { ax: alpha, ay: alpha, distribution: Distribution::Ggx, v_groove: false };
    facets.albedo(cosine, SAMPLES, |vh| [1.0 - schlick(vh), schlick(vh)])
}

/// The row or column of a table below a position in [0, 1], and how far it lies on the way to the next.
#[inline]
fn position(v: f32, n: usize) -> (usize, f32) {
    let p = v * (n - 1) as f32;
    // By way of 32 bits, for which processors have an instruction; what is not a number is 0.
    let low = (p as i32 as usize).min(n - 2);
    (low, p - low as f32)
}

impl LobeAlbedo {
    /// The table, made once.
    pub fn table() -> &'static Self {
        &TABLE
    }

    /// (A, B) at a cosine and an α in [0, 1].
    pub fn at(&self, cosine: f32, alpha: f32) -> [f32; 2] {
        let (x, fx) = position(cosine.clamp(0.0, 1.0).sqrt(), COSINES);
        let (y, fy) = position(alpha.clamp(0.0, 1.0).sqrt(), ROUGHNESSES);
        let entry = |x: usize, y: usize| self.0[y * COSINES + x];
        std::array::from_fn(|i| {
            let row = |y: usize| entry(x, y)[i] + (entry(x + 1, y)[i] - entry(x, y)[i]) * fx;
            row(y) + (row(y + 1) - row(y)) * fy
        })
    }

    /// What a lobe of reflectance 1 and roughness r = √α gains, less 1, from a table of its own.
    #[inline]
    pub fn gain(cosine: f32, r: f32) -> f32 {
        let (x, fx) = position(cosine.clamp(0.0, 1.0).sqrt(), COSINES);
        let (y, fy) = position(r.clamp(0.0, 1.0), ROUGHNESSES);
        let row = |row: &[f32; COSINES]| row[x] + (row[x + 1] - row[x]) * fx;
        let (low, high) = (row(&GAINS[y]), row(&GAINS[y + 1]));
        low + (high - low) * fy
    }

    /// [`Self::layer_mean`] from a table.
    pub fn quick_mean(&self, f0: f32, f90: f32, alpha: f32) -> f32 {
        let p = alpha.clamp(0.0, 1.0).sqrt() * (ROUGHNESSES - 1) as f32;
        let low = (p as usize).min(ROUGHNESSES - 2);
        let (below, above) = (MEANS[low], MEANS[low + 1]);
        let [a, b, a_again, b_again] =
            std::array::from_fn(|i| below[i] + (above[i] - below[i]) * (p - low as f32));
        (f0 * (a + f90 * b_again + f0 * a_again) + f90 * b).clamp(0.0, 1.0)
    }

    /// Reflectance towards `cosine` of a layer with `f0` at normal and `f90` at grazing incidence.
    pub fn layer(&self, f0: f32, f90: f32, cosine: f32, alpha: f32) -> f32 {
        let [a, b] = self.at(cosine, alpha);
        ((f0 * a + f90 * b) * (1.0 + f0 * gained([a, b]))).clamp(0.0, 1.0)
    }

    /// The cosine-weighted mean of [`Self::layer`] over the hemisphere.
    pub fn layer_mean(&self, f0: f32, f90: f32, alpha: f32) -> f32 {
        const STEPS: usize = 96;
        let mean: f32 = (0..STEPS)
            .map(|i| {
                let cosine = (i as f32 + 0.5) / STEPS as f32;
                2.0 * cosine * self.layer(f0, f90, cosine, alpha)
            })
            .sum();
        mean / STEPS as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The file holds what visible facets say, to the bit; where it does not, what belongs there is written elsewhere.
    #[test]
    fn the_table_is_what_facets_reflect() {
        let entry = |i: usize| {
            let x = (i % COSINES) as f32 / (COSINES - 1) as f32;
            let r = (i / COSINES) as f32 / (ROUGHNESSES - 1) as f32;
            integrate((x * x).max(1e-3), r * r)
        };
        let made = (0..COSINES * ROUGHNESSES).flat_map(entry);
        let bytes: Vec<u8> = made.flat_map(f32::to_le_bytes).collect();
        if bytes != STORED {
            let file = std::env::temp_dir().join("lobe_albedo.bin");
            std::fs::write(&file, bytes).unwrap();
            panic!("src/scene/lobe_albedo.bin is to be {}", file.display());
        }
    }

    #[test]
    fn a_white_layer_reflects_all_and_a_dielectric_one_what_fresnel_says() {
        let table = LobeAlbedo::table();
        for alpha in [0.0, 0.04, 0.25, 0.5, 1.0] {
            for cosine in [0.0, 0.05, 0.3, 0.7, 1.0] {
                assert!((table.layer(1.0, 1.0, cosine, alpha) - 1.0).abs() < 1e-5, "{alpha} {cosine}");
            }
        }
        // Schlick's mean is f₀ + (1 − f₀) / 21.
        let mean = table.layer_mean(0.04, 1.0, 0.0);
        assert!((mean - (0.04 + 0.96 / 21.0)).abs() < 0.003, "{mean}");
        for (f0, f90, alpha) in [(0.04, 1.0, 0.01), (0.3, 1.0, 0.4), (0.02, 0.5, 1.0), (1.0, 1.0, 0.25)] {
            let (quick, exact) = (table.quick_mean(f0, f90, alpha), table.layer_mean(f0, f90, alpha));
            assert!((quick - exact).abs() < 2e-3, "{f0} {f90} {alpha}: {quick} {exact}");
        }
        assert!(LobeAlbedo::gain(1.0, 1.0) > 0.5 && LobeAlbedo::gain(1.0, 0.0) < 1e-5);
    }

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
            let found = LobeAlbedo::table().at(cosine, roughness * roughness);
            assert!(
                (found[0] - a).abs() < 0.01 && (found[1] - b).abs() < 0.01,
                "{roughness} {cosine} {found:?}"
            );
        }
    }

    #[test]
    fn any_numbers_give_some() {
        for v in [f32::NAN, f32::INFINITY, -1.0, 0.0, 1.0, 2.0] {
            for w in [f32::NAN, f32::INFINITY, -1.0, 0.0, 1.0, 2.0] {
                let [a, b] = LobeAlbedo::table().at(v, w);
                // NaN in is NaN out of a clamp; everything else is an albedo.
                assert!(v.is_nan() || w.is_nan() || ((0.0..=1.001).contains(&a) && (0.0..=1.0).contains(&b)));
            }
        }
    }
}
