//! What a path travels through: which dielectrics it is inside of, and how they absorb.

use glam::Vec3;

use super::bsdf::Bsdf;
use super::bsdf::bands::Band;
use super::interaction::Interaction;
use crate::geometry::{Accel, Ray};
use crate::math;
use crate::scene::{MaterialId, Model, Scene};

/// How many nested dielectrics are remembered; beyond, the outermost is forgotten. The side on which a path
/// meets a surface still tells what it leaves.
const REMEMBERED: usize = 8;

/// The dielectrics around a point, outermost first.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Media {
    inside: [MaterialId; REMEMBERED],
    count: u8,
    /// The band that a path carries alone since it was bent by its colour.
    band: Option<Band>,
}

impl Media {
    /// Outside of everything.
    pub const EMPTY: Self = Self { inside: [MaterialId(0); REMEMBERED], count: 0, band: None };
}

/// Transmittance per band after `distance` in a material; 1 for what is not a solid dielectric.
fn after(scene: &Scene, material: MaterialId, distance: f32) -> Vec3 {
    match scene.materials[material.0 as usize].model {
        Model::Dielectric { transmittance, thin: false, .. } => {
            let length = distance.max(0.0);
            if transmittance == Vec3::ONE {
                return Vec3::ONE;
            }
            let t = transmittance.clamp(Vec3::ZERO, Vec3::ONE).map(|t| math::powf(t, length));
            if t.is_finite() { t } else { Vec3::ZERO }
        }
        _ => Vec3::ONE,
    }
}

impl Media {
    /// Those around the beginning of a ray: the ones that a straight way out of the scene leaves more often than it enters
    /// them.
    pub fn around(scene: &Scene, accel: &Accel, ray: &Ray) -> Self {
        /// More surfaces than lie on a way out of any body.
        const SURFACES_MAX: usize = 256;
        let (mut ray, mut entered, mut left) = (*ray, Vec::new(), Vec::new());
        for _ in 0..SURFACES_MAX {
            let Some(hit) = accel.intersect(scene, &ray) else { break };
            let at = Interaction::at(scene, &ray, &hit);
            if matches!(at.material(scene).model, Model::Dielectric { thin: false, .. }) {
                if !at.back {
                    entered.push(at.material);
                } else if let Some(i) = entered.iter().rposition(|m| *m == at.material) {
                    entered.remove(i);
                } else {
                    left.push(at.material);
                }
            }
            ray = at.spawn(ray.direction);
        }
        let mut media = Self::EMPTY;
        // The innermost was left first.
        for material in left.into_iter().take(REMEMBERED).rev() {
            media.inside[usize::from(media.count)] = material;
            media.count += 1;
        }
        media
    }

    /// A surface as a path in here meets it: by its band, where it carries one alone.
    #[inline]
    pub fn banded(&self, bsdf: Bsdf) -> Bsdf {
        match self.band {
            Some(band) if bsdf.is_dispersive() => bsdf.of_band(band),
            _ => bsdf,
        }
    }

    /// The same for a path that carries `band` alone from now on, unless it carried one before.
    pub fn with_band(self, band: Option<Band>) -> Self {
        Self { band: self.band.or(band), ..self }
    }

    /// Whether no dielectric is around.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Transmittance of a straight way of `distance` that begins and ends in here.
    #[inline]
    pub fn transmittance(&self, scene: &Scene, distance: f32) -> Vec3 {
        match self.inside[..usize::from(self.count)].last() {
            Some(&m) => after(scene, m, distance),
            None => Vec3::ONE,
        }
    }

    /// Transmittance of the way of `distance` to a surface. What is met from its back was travelled through,
    /// whatever is remembered: a camera may begin inside.
    #[inline]
    pub fn transmittance_to(&self, scene: &Scene, at: &Interaction, distance: f32) -> Vec3 {
        let solid = matches!(at.material(scene).model, Model::Dielectric { thin: false, .. });
        if at.back && solid {
            after(scene, at.material, distance)
        } else {
            self.transmittance(scene, distance)
        }
    }

    /// The media beyond a surface that a path has passed.
    #[inline]
    pub fn crossed(mut self, scene: &Scene, at: &Interaction) -> Self {
        if !matches!(at.material(scene).model, Model::Dielectric { thin: false, .. }) {
            return self;
        }
        let count = usize::from(self.count);
        if !at.back {
            if count == REMEMBERED {
                self.inside.copy_within(1.., 0);
                self.inside[REMEMBERED - 1] = at.material;
            } else {
                self.inside[count] = at.material;
                self.count += 1;
            }
        } else if let Some(i) = self.inside[..count].iter().rposition(|&m| m == at.material) {
            // Not always the last one: dielectrics may overlap.
            self.inside.copy_within(i + 1..count, i);
            self.count -= 1;
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Hit, Ray};
    use crate::illumination::test_scenes::{join, lambert, quad, scene};
    use crate::scene::{Mesh, Roughness};

    fn glass(transmittance: f32) -> crate::scene::Material {
        let mut m = lambert(0.0, 0.0);
        m.model = Model::Dielectric {
            ior: 1.5,
            transmittance: Vec3::splat(transmittance),
            thin: false,
            roughness: Roughness { alpha_x: 0.0, alpha_y: 0.0, distribution: Default::default() },
        };
        m
    }

    #[test]
    fn nested_dielectrics_absorb_in_turn() {
        let mut mesh = Mesh::default();
        for material in 0..3 {
            join(&mut mesh, &quad(Vec3::ZERO, Vec3::X, Vec3::Y), material);
        }
        let s = scene(mesh, vec![glass(0.5), glass(0.25), lambert(0.5, 0.0)], vec![]);
        let side = |material: u32, back: bool| {
            let z = if back { 1.0 } else { -1.0 };
            let hit = Hit { t: 1.0, triangle: 2 * material, b1: 0.2, b2: 0.2 };
            let at = Interaction::at(&s, &Ray::new(Vec3::new(0.3, 0.2, -z), Vec3::Z * z), &hit);
            assert_eq!(at.back, back);
            at
        };
        let outside = Media::default();
        assert_eq!(outside.transmittance(&s, 2.0), Vec3::ONE);
        let outer = outside.crossed(&s, &side(0, false));
        let inner = outer.crossed(&s, &side(1, false));
        assert_eq!(outer.transmittance(&s, 2.0), Vec3::splat(0.25));
        assert_eq!(inner.transmittance(&s, 2.0), Vec3::splat(0.0625));
        // A wall in the glass: the glass absorbs on the way to it, and it is no border.
        assert_eq!(outer.transmittance_to(&s, &side(2, true), 1.0), Vec3::splat(0.5));
        assert_eq!(outer.crossed(&s, &side(2, true)), outer);
        assert_eq!(inner.crossed(&s, &side(1, true)).transmittance(&s, 1.0), Vec3::splat(0.5));
        // Overlapping, the outer left first.
        assert_eq!(inner.crossed(&s, &side(0, true)).transmittance(&s, 1.0), Vec3::splat(0.25));
        // A camera that begins inside.
        assert_eq!(outside.transmittance_to(&s, &side(0, true), 1.0), Vec3::splat(0.5));
        assert!(outside.crossed(&s, &side(0, true)).is_empty());
        let mut deep = outside;
        for _ in 0..60 {
            deep = deep.crossed(&s, &side(0, false));
        }
        for _ in 0..60 {
            deep = deep.crossed(&s, &side(0, true));
        }
        assert!(deep.is_empty());
    }
}
