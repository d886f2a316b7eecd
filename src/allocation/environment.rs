//! What a view loses without an object's environment map (Dumont 2003 §5.3, Eqs. (8)–(10); REFERENCE §8.8).
//!
//! "No map" means that the mean of the map is drawn, not black: the error is that between the finest and the coarsest
//! level of the map filtered for the object's lobe.

use crate::perception::tvi::tvi;

use super::decision::{Approximation, Resource};

/// Objects that cover less of the picture have no map (Dumont 2003 §5.3).
pub const COVERAGE_MIN: f32 = 0.001;

/// Mean and contrast of a filtered environment map.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct MapContrast {
    /// F̃, the mean luminance over solid angle, in the map's unit.
    pub mean: f32,
    /// Mean |F_finest − F_coarsest| over solid angle, relative to F̃.
    pub relative_difference: f32,
}

impl MapContrast {
    /// `finest`: luminance of each texel. `coarsest`: the coarsest level interpolated to the same texels. `weights`:
    /// solid angle of each, of any scale. All zero for a black or empty map.
    pub fn of_map(finest: &[f32], coarsest: &[f32], weights: &[f32]) -> Self {
        let (mut total, mut sum, mut difference) = (0.0f64, 0.0f64, 0.0f64);
        for ((&fine, &coarse), &weight) in finest.iter().zip(coarsest).zip(weights) {
            let usable = fine.is_finite() && coarse.is_finite() && weight > 0.0 && weight.is_finite();
            if usable {
                let weight = f64::from(weight);
                total += weight;
                sum += weight * f64::from(fine);
                difference += weight * f64::from((fine - coarse).abs());
            }
        }
        if total > 0.0 && sum > 0.0 {
            Self { mean: (sum / total) as f32, relative_difference: (difference / sum) as f32 }
        } else {
            Self::default()
        }
    }
}

/// An object whose map may be left out.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct MapCandidate {
    /// A_i, pixels that show it.
    pub pixels: f32,
    /// Share of the picture that shows it, in [0, 1].
    pub coverage: f32,
    /// L, displayed luminance of its diffuse part, cd/m².
    pub diffuse_cd_m2: f32,
    /// L_e = ρ_s F̃, displayed mean luminance of its reflection, cd/m².
    pub reflection_cd_m2: f32,
    /// Relative contrast of its filtered map.
    pub relative_difference: f32,
    /// Mean threshold elevation of its texture; 1 without.
    pub mean_elevation: f32,
    /// Saliency α, ≥ 0; 1 where all objects matter alike.
    pub saliency: f32,
    /// What the map costs, in the limit's unit.
    pub cost: u64,
}

impl MapCandidate {
    /// f_E, just noticeable differences.
    pub fn visible_error(&self) -> f32 {
        let error = self.reflection_cd_m2 / tvi(self.diffuse_cd_m2 + self.reflection_cd_m2)
            * self.relative_difference
            / self.mean_elevation.max(1.0);
        if error > 0.0 && error.is_finite() { error } else { 0.0 }
    }
}

/// Environment maps under a limit of time or memory: state 0 is without, state 1 with the map, which small objects do not
/// have.
#[derive(Clone, Copy, Debug)]
pub struct MapChoices<'a>(pub &'a [MapCandidate]);

impl Resource for MapChoices<'_> {
    fn action_count(&self) -> usize {
        self.0.len()
    }

    fn saliency(&self, action: usize) -> f64 {
        f64::from(self.0[action].saliency)
    }

    fn approximations(&self, action: usize, out: &mut Vec<Approximation>) {
        let object = &self.0[action];
        let error = f64::from(object.pixels.max(0.0)) * f64::from(object.visible_error());
        out.push(Approximation { cost: 0, error });
        if object.coverage >= COVERAGE_MIN {
            out.push(Approximation { cost: object.cost, error: 0.0 });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::allocation::decision::{Constraint, decide};

    const OBJECT: MapCandidate = MapCandidate {
        pixels: 1000.0,
        coverage: 0.01,
        diffuse_cd_m2: 35.0,
        reflection_cd_m2: 0.3 * 40.0,
        relative_difference: 1.0,
        mean_elevation: 1.0,
        saliency: 1.0,
        cost: 10,
    };

    #[test]
    fn numbers_of_the_reference() {
        assert!((OBJECT.visible_error() - 4.0716).abs() < 1e-3);
        assert!((tvi(47.0) - 2.947_21).abs() < 1e-4);
    }

    #[test]
    fn contrast_is_weighted_by_solid_angle() {
        let contrast = MapContrast::of_map(&[1.0, 3.0], &[2.0, 2.0], &[1.0, 1.0]);
        assert_eq!(contrast, MapContrast { mean: 2.0, relative_difference: 0.5 });
        let contrast = MapContrast::of_map(&[1.0, 3.0, f32::NAN], &[2.0, 2.0, 1.0], &[3.0, 1.0, 1.0]);
        assert_eq!(contrast, MapContrast { mean: 1.5, relative_difference: 4.0 / 6.0 });
        assert_eq!(MapContrast::of_map(&[0.0], &[0.0], &[1.0]), MapContrast::default());
        assert_eq!(MapContrast::of_map(&[], &[], &[]), MapContrast::default());
    }

    #[test]
    fn maps_go_to_objects_that_show_them() {
        let objects = [
            OBJECT,
            MapCandidate { relative_difference: 0.1, ..OBJECT },
            MapCandidate { coverage: 0.0005, pixels: 1e6, ..OBJECT },
            MapCandidate { reflection_cd_m2: 30.0, ..OBJECT },
            MapCandidate { relative_difference: f32::NAN, ..OBJECT },
        ];
        let decided =
            |limit| decide(&MapChoices(&objects), Constraint::Nanoseconds(limit), None).unwrap().states;
        assert_eq!(decided(0), [0; 5]);
        assert_eq!(decided(10), [0, 0, 0, 1, 0]);
        assert_eq!(decided(20), [1, 0, 0, 1, 0]);
        assert_eq!(decided(1000), [1, 1, 0, 1, 0]);
    }
}
