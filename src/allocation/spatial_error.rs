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
use crate::scene::{Texture, Wrap};

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
        let luminances: Vec<Map2d<f32>> = levels.par_iter().map(|level| level.map(luminance)).collect();
        let elevations: Vec<Map2d<f32>> = luminances
            .par_iter()
            .map(|level| elevation(&level.map(|y| settings.white_cd_m2 * y), &elevation_settings))
            .collect();
        let pairs: Vec<(usize, usize)> =
            (0..levels.len()).flat_map(|m| (m + 1..levels.len()).map(move |j| (m, j))).collect();
        let errors = pairs
            .into_par_iter()
            .map(|(m, j)| {
                let masks = (&elevations[m], settings.conservative.then(|| &elevations[j]));
                match settings.difference {
                    TexelDifference::Luminance => {
                        let (pair, scale) = ([&luminances[m], &luminances[j]], mean(&luminances[m]));
                        pair_error(pair, masks.0, masks.1, settings.border, scale, |a, b| (a - b).abs())
                    }
                    TexelDifference::Lab => {
                        let pair = [&levels[m], &levels[j]];
                        let difference = |a, b| delta_e76(lab(a), lab(b));
                        pair_error(pair, masks.0, masks.1, settings.border, 100.0, difference)
                    }
                }
            })
            .collect();
        Self {
            levels: levels.len(),
            errors,
            mean_luminance: luminances.first().map_or(0.0, mean),
            mean_elevation: elevations.first().map_or(1.0, |map| mean(map).max(1.0)),
        }
    }

    /// Compares every pair of levels of a texture, all in memory. Levels of more than a megatexel count as if their details
    /// were those of the first smaller one: what they hold more is seen from near only, and looks alike there.
    pub fn of_texture(texture: &Texture, settings: &SpatialSettings) -> Self {
        const TEXELS_MAX: usize = 1 << 20;
        let size = |level: usize| texture.size(level);
        let count = texture.level_count();
        let first = (0..count).find(|&l| size(l)[0] * size(l)[1] <= TEXELS_MAX).unwrap_or(count - 1);
        let map = |level: usize| {
            let [width, height] = size(level);
            Map2d::from_fn(width, height, |x, y| Vec3::from_slice(&texture.texel(level, x, y)[..3]))
        };
        let levels: Vec<Map2d<Vec3>> = (first..count).map(map).collect();
        let border = if texture.placement.wrap == [Wrap::Repeat; 2] { Border::Wrap } else { Border::Clamp };
        let measured = Self::of_levels(&levels, &SpatialSettings { border, ..*settings });
        let pair = |m: usize, j: usize| match m.checked_sub(first) {
            Some(m) => measured.error(m, j - first),
            None => measured.error(0, j - m),
        };
        let errors =
            (0..count).flat_map(|m| (m + 1..count).map(move |j| (m, j))).map(|(m, j)| pair(m, j)).collect();
        Self { levels: count, errors, ..measured }
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

fn mean(map: &Map2d<f32>) -> f32 {
    let count = map.data().len().max(1) as f64;
    (map.data().iter().map(|&v| f64::from(v)).sum::<f64>() / count) as f32
}

/// Mean over the texels of `fine` of `difference`(wanted, drawn) / elevation, over `scale`; 0 where that is no positive
/// number (a black level).
fn pair_error<V: Texel>(
    [fine, coarse]: [&Map2d<V>; 2],
    fine_elevation: &Map2d<f32>,
    coarse_elevation: Option<&Map2d<f32>>,
    border: Border,
    scale: f32,
    difference: impl Fn(V, V) -> f32,
) -> f32 {
    let count = fine.data().len();
    if count == 0 || coarse.data().is_empty() || scale.is_nan() || scale <= 0.0 {
        return 0.0;
    }
    let columns = taps(fine.width(), coarse.width(), border);
    let (mut row, mut elevation_row) = (Vec::new(), Vec::new());
    let mut sum = 0.0f64;
    for (y, tap) in taps(fine.height(), coarse.height(), border).iter().enumerate() {
        lerp_rows(coarse, tap, &mut row);
        if let Some(map) = coarse_elevation {
            lerp_rows(map, tap, &mut elevation_row);
        }
        let mut in_row = 0.0f32;
        let texels = fine.row(y).iter().zip(fine_elevation.row(y)).zip(&columns);
        for ((&wanted, &elevation), column) in texels {
            let elevation = match coarse_elevation {
                Some(_) => elevation.min(column.of(&elevation_row)),
                None => elevation,
            };
            in_row += difference(wanted, column.of(&row)) / elevation;
        }
        sum += f64::from(in_row);
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

/// What can be interpolated.
trait Texel: Copy + std::ops::Mul<f32, Output = Self> + std::ops::Add<Output = Self> {}
impl Texel for f32 {}
impl Texel for Vec3 {}

impl Tap {
    #[inline]
    fn of<V: Texel>(&self, row: &[V]) -> V {
        row[self.first] * (1.0 - self.weight) + row[self.second] * self.weight
    }
}

/// Taps of a bilinear lookup at the centres of `fine` texels in a level of `coarse` texels, as a texture unit does it.
fn taps(fine: usize, coarse: usize, border: Border) -> Vec<Tap> {
    let inside = |i: isize| match border {
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

fn lerp_rows<V: Texel>(map: &Map2d<V>, tap: &Tap, out: &mut Vec<V>) {
    let rows = map.row(tap.first).iter().zip(map.row(tap.second));
    out.clear();
    out.extend(rows.map(|(&a, &b)| a * (1.0 - tap.weight) + b * tap.weight));
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
        let fine = Map2d::from_vec(2, 2, vec![0.2, 0.4, 0.6, 0.8]);
        let coarse = Map2d::new(1, 1, 0.5);
        let elevation = Map2d::from_vec(2, 2, vec![1.0, 2.0, 2.0, 4.0]);
        let error = |coarse_elevation| {
            let difference = |a: f32, b: f32| (a - b).abs();
            pair_error([&fine, &coarse], &elevation, coarse_elevation, Border::Wrap, mean(&fine), difference)
        };
        assert!((error(None) - 0.2375).abs() < 1e-5);
        // Masking counts only where both mask.
        assert!((error(Some(&Map2d::new(1, 1, 1.0))) - 0.4).abs() < 1e-5);
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

    #[test]
    #[expect(clippy::disallowed_methods, reason = "prints how long it takes, asserts nothing about it")]
    fn timing() {
        let levels = mips(noise(512, 2));
        let start = std::time::Instant::now();
        let errors = SpatialErrors::of_levels(&levels, &SpatialSettings::new(10.8, 100.0));
        println!("spatial errors of a 512 × 512 texture: {:.0} ms", start.elapsed().as_secs_f64() * 1e3);
        assert_eq!(errors.levels(), 10);
    }
}
