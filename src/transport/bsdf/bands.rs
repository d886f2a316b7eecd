//! Glass that bends red less than blue (glTF's `KHR_materials_dispersion`): each band has an index of its own, n ∓ (n − 1) d / 40.

use glam::Vec3;

use super::{Bsdf, Lobe};

/// A band of light, on its own: 0 red, 1 green, 2 blue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Band(u8);

impl Band {
    /// All of them.
    pub const ALL: [Self; 3] = [Self(0), Self(1), Self(2)];

    /// The one that a number in [0, 1) chooses.
    pub fn chosen(u: f32) -> Self {
        Self(((u * 3.0) as u8).min(2))
    }

    /// White light of this band alone.
    pub fn color(self) -> Vec3 {
        Vec3::AXES[usize::from(self.0.min(2))]
    }
}

impl Bsdf {
    /// Whether light is bent differently by its colour.
    #[inline]
    pub fn is_dispersive(&self) -> bool {
        matches!(self.lobe, Lobe::Glass { spread, .. } if spread != 0.0)
    }

    /// The surface as one band meets it.
    pub fn of_band(&self, band: Band) -> Self {
        let Lobe::Glass { eta, microfacet, tint, spread } = self.lobe else { return *self };
        let more = spread * (f32::from(band.0) - 1.0);
        // From inside `eta` is one divided by the index.
        let eta = if eta < 1.0 { 1.0 / (1.0 / eta + more) } else { eta + more };
        Self { lobe: Lobe::Glass { eta, microfacet, tint, spread: 0.0 }, ..*self }
    }

    /// The same for light of all bands, of which only this one crosses, as often as `times` says.
    pub fn where_band_crosses(&self, band: Band, times: f32) -> Self {
        let mut bsdf = self.of_band(band);
        if let Lobe::Glass { tint, .. } = &mut bsdf.lobe {
            *tint *= band.color() * times;
        }
        bsdf
    }
}
