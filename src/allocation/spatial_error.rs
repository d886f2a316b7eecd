//! What is lost of a texture's level when a coarser one is drawn in its place: the part of Dumont's metric
//! that depends on the texture alone (2003 §5.2.3, Eqs. (6), (7), (11); REFERENCE §8.7).
//!
//! In: the mip chain, linear RGB. Out: S\[m\]\[j\], mean relative error over threshold elevation, for every pair of
//! levels. A pre-process, to be kept with the texture: levels²/2 floats.

use glam::Vec3;
use rayon::prelude::*;

use crate::image::{Map2d, luminance};
use crate::perception::color_difference::{delta_e76, lab};
use crate::perception::elevation::{Border, ElevationSettings, elevation};

/// How the difference of two texels is measured. The two never mix: their units differ (correction D2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum TexelDifference {
    /// |ΔY| / T̃: the relative change of luminance.
    #[default]
    Luminance,
    /// ΔE*76 / 100, for a ranking that sees hue.
    Lab,
}

/// How spatial errors are measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpatialSettings {
    /// Pixels per degree of the display.
    pub pixels_per_degree: f32,
    /// Luminance in cd/m² at which a texel of reflectance 1 is assumed to be displayed.
    pub white_cd_m2: f32,
    /// Measure of texel differences.
    pub difference: TexelDifference,
    /// Beyond the edge.
    pub border: Border,
    /// Whether masking counts only where the coarser level masks too.
    pub conservative: bool,
}

impl SpatialSettings {
    /// Luminance differences, repeating textures, masking by the level wanted (Dumont 2003).
    pub const fn new(pixels_per_degree: f32, white_cd_m2: f32) -> Self {
        Self {
            pixels_per_degree,
            white_cd_m2,
            difference: TexelDifference::Luminance,
            border: Border::Wrap,
            conservative: false,
        }
    }
}

/// S\[m\]\[j\] of one texture: level m is wanted, level j ≥ m is drawn.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SpatialErrors {
    levels: usize,
    /// Pairs m < j, rows of m one after another.
    errors: Vec<f32>,
    mean_luminance: f32,
    mean_elevation: f32,
}

impl SpatialErrors {
    /// Compares every pair of `levels` of a mip chain, the finest first.
    pub fn of_levels(levels: &[Map2d<Vec3>], settings: &SpatialSettings) -> Self {
        let elevation_settings = ElevationSettings {
            border: settings.border,
            ..ElevationSettings::new(settings.pixels_per_degree)
        };
        let elevations: Vec<Map2d<f32>> = levels
            .par_iter()
            .map(|level| elevation(&level.map(|t| settings.white_cd_m2 * luminance(t)), &elevation_settings))
            .collect();
        let pairs: Vec<(usize, usize)> =
            (0..levels.len()).flat_map(|m| (m + 1..levels.len()).map(move |j| (m, j))).collect();
        let errors = pairs
            .into_par_iter()
            .map(|(m, j)| {
                let coarse_elevation = settings.conservative.then(|| &elevations[j]);
                pair_error(&levels[m], &levels[j], &elevations[m], coarse_elevation, settings)
            })
            .collect();
        Self {
            levels: levels.len(),
            errors,
            mean_luminance: levels.first().map_or(0.0, mean_luminance),
            mean_elevation: elevations.first().map_or(1.0, |map| mean(map.data().iter().copied()).max(1.0)),
        }
    }

    /// Number of levels.
    pub fn levels(&self) -> usize {
        self.levels
    }

    /// S\[`wanted`\]\[`drawn`\]; 0 where the level drawn is as fine as the level wanted. Levels beyond the last count as the
    /// last.
    pub fn error(&self, wanted: usize, drawn: usize) -> f32 {
        let drawn = drawn.min(self.levels.saturating_sub(1));
        if drawn <= wanted {
            return 0.0;
        }
        let row = wanted * (2 * self.levels - wanted - 1) / 2;
        // Read from a cache file, the vector may be short.
        self.errors.get(row + drawn - wanted - 1).copied().unwrap_or(0.0)
    }

    /// T̃, the mean luminance of its texels, in [0, 1].
    pub fn mean_luminance(&self) -> f32 {
        self.mean_luminance
    }

    /// Mean threshold elevation of the finest level, ≥ 1.
    pub fn mean_elevation(&self) -> f32 {
        self.mean_elevation
    }
}

fn mean(values: impl ExactSizeIterator<Item = f32>) -> f32 {
    let count = values.len().max(1) as f64;
    (values.map(f64::from).sum::<f64>() / count) as f32
}

fn mean_luminance(level: &Map2d<Vec3>) -> f32 {
    mean(level.data().iter().map(|&t| luminance(t)))
}

/// Mean over the texels of `fine` of difference / elevation, relative to the mean luminance where the difference is one of
/// luminance; 0 for a black level.
fn pair_error(
    fine: &Map2d<Vec3>,
    coarse: &Map2d<Vec3>,
    fine_elevation: &Map2d<f32>,
    coarse_elevation: Option<&Map2d<f32>>,
    settings: &SpatialSettings,
) -> f32 {
    let scale = match settings.difference {
        TexelDifference::Luminance => mean_luminance(fine),
        TexelDifference::Lab => 100.0,
    };
    let count = fine.data().len();
    if count == 0 || coarse.data().is_empty() || scale.is_nan() || scale <= 0.0 {
        return 0.0;
    }
    let (columns, rows) =
        (taps(fine.width(), coarse.width(), settings), taps(fine.height(), coarse.height(), settings));
    let mut sum = 0.0f64;
    for (y, row) in rows.iter().enumerate() {
        for (x, column) in columns.iter().enumerate() {
            let drawn = interpolate(coarse, column, row, |t| t);
            let wanted = fine.at(x, y);
            let difference = match settings.difference {
                TexelDifference::Luminance => luminance(wanted - drawn).abs(),
                TexelDifference::Lab => delta_e76(lab(wanted), lab(drawn)),
            };
            let mut elevation = fine_elevation.at(x, y);
            if let Some(map) = coarse_elevation {
                elevation = elevation.min(interpolate(map, column, row, |v| v));
            }
            sum += f64::from(difference / elevation);
        }
    }
    let error = (sum / count as f64) as f32 / scale;
    if error.is_finite() { error } else { 0.0 }
}

/// The two coarse texels around a fine one, and the weight of the second.
struct Tap {
    first: usize,
    second: usize,
    weight: f32,
}

/// Taps of a bilinear lookup at the centres of `fine` texels in a level of `coarse` texels, as a texture unit does it.
fn taps(fine: usize, coarse: usize, settings: &SpatialSettings) -> Vec<Tap> {
    let inside = |i: isize| match settings.border {
        Border::Wrap => i.rem_euclid(coarse as isize) as usize,
        Border::Clamp => i.clamp(0, coarse as isize - 1) as usize,
    };
    let tap = |x: usize| {
        let at = (x as f32 + 0.5) * coarse as f32 / fine as f32 - 0.5;
        let first = at.floor();
        Tap { first: inside(first as isize), second: inside(first as isize + 1), weight: at - first }
    };
    (0..fine).map(tap).collect()
}

fn interpolate<T, V>(map: &Map2d<T>, column: &Tap, row: &Tap, value: impl Fn(T) -> V) -> V
where
    T: Copy,
    V: std::ops::Mul<f32, Output = V> + std::ops::Add<Output = V>,
{
    let along = |y: usize| {
        value(map.at(column.first, y)) * (1.0 - column.weight)
            + value(map.at(column.second, y)) * column.weight
    };
    along(row.first) * (1.0 - row.weight) + along(row.second) * row.weight
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng;

    fn mips(mut level: Map2d<Vec3>) -> Vec<Map2d<Vec3>> {
        let mut all = vec![level.clone()];
        while level.width().max(level.height()) > 1 {
            let (w, h) = ((level.width() / 2).max(1), (level.height() / 2).max(1));
            let (sx, sy) = (level.width() / w, level.height() / h);
            level = Map2d::from_fn(w, h, |x, y| {
                let mut sum = Vec3::ZERO;
                for i in 0..sx * sy {
                    sum += level.at(x * sx + i % sx, y * sy + i / sx);
                }
                sum / (sx * sy) as f32
            });
            all.push(level.clone());
        }
        all
    }

    fn noise(side: usize, block: usize) -> Map2d<Vec3> {
        Map2d::from_fn(side, side, |x, y| {
            Vec3::splat(rng::unit_f32(rng::hash((x / block) as u64, (y / block) as u64, 3)))
        })
    }

    #[test]
    fn the_spatial_term_of_the_reference() {
        let fine = Map2d::from_vec(2, 2, [0.2, 0.4, 0.6, 0.8].map(Vec3::splat).to_vec());
        let coarse = Map2d::new(1, 1, Vec3::splat(0.5));
        let elevation = Map2d::from_vec(2, 2, vec![1.0, 2.0, 2.0, 4.0]);
        let settings = SpatialSettings::new(10.0, 100.0);
        let error = pair_error(&fine, &coarse, &elevation, None, &settings);
        assert!((error - 0.2375).abs() < 1e-5, "{error}");
        // Masking counts only where both mask.
        let unmasked = pair_error(&fine, &coarse, &elevation, Some(&Map2d::new(1, 1, 1.0)), &settings);
        assert!((unmasked - 0.4).abs() < 1e-5, "{unmasked}");
    }

    #[test]
    fn coarser_levels_lose_more_and_flat_ones_nothing() {
        let settings = SpatialSettings::new(10.8, 100.0);
        let errors = SpatialErrors::of_levels(&mips(noise(32, 4)), &settings);
        assert_eq!(errors.levels(), 6);
        for m in 0..6 {
            assert_eq!(errors.error(m, m), 0.0);
            assert_eq!(errors.error(m, 0), 0.0);
            for j in m + 1..5 {
                assert!(errors.error(m, j + 1) >= 0.9 * errors.error(m, j), "{m} {j}");
            }
        }
        assert!(errors.error(0, 5) > 0.01);
        assert_eq!(errors.error(0, 99), errors.error(0, 5));
        let flat = SpatialErrors::of_levels(&mips(Map2d::new(32, 32, Vec3::new(0.3, 0.4, 0.5))), &settings);
        assert!((0..6).all(|j| flat.error(0, j) < 1e-6));
        assert!((flat.mean_luminance() - luminance(Vec3::new(0.3, 0.4, 0.5))).abs() < 1e-6);
    }

    #[test]
    fn hue_is_seen_by_lab_alone() {
        let stripes = Map2d::from_fn(16, 16, |x, _| {
            // Equal luminance, different hue.
            if x / 8 == 0 { Vec3::X * (0.1 / 0.212_672_9) } else { Vec3::Y * (0.1 / 0.715_152_2) }
        });
        let luminance = SpatialSettings::new(10.8, 100.0);
        let lab = SpatialSettings { difference: TexelDifference::Lab, ..luminance };
        assert!(SpatialErrors::of_levels(&mips(stripes.clone()), &luminance).error(0, 4) < 1e-5);
        assert!(SpatialErrors::of_levels(&mips(stripes), &lab).error(0, 4) > 0.1);
    }

    #[test]
    fn odd_black_empty_and_broken_textures() {
        let settings = SpatialSettings { border: Border::Clamp, ..SpatialSettings::new(10.8, 100.0) };
        for texture in [
            Map2d::new(1, 1, Vec3::ONE),
            Map2d::new(300, 1, Vec3::ONE),
            Map2d::new(16, 16, Vec3::ZERO),
            Map2d::from_fn(16, 8, |x, _| Vec3::splat([f32::NAN, f32::INFINITY, -1.0, 0.5][x % 4])),
        ] {
            let errors = SpatialErrors::of_levels(&mips(texture), &settings);
            for m in 0..errors.levels() {
                for j in 0..errors.levels() {
                    assert!(errors.error(m, j) >= 0.0 && errors.error(m, j).is_finite());
                }
            }
        }
        let none = SpatialErrors::of_levels(&[], &settings);
        assert_eq!((none.levels(), none.error(0, 3)), (0, 0.0));
    }
}
