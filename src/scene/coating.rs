//! What lies on a body of glass: a thin film, and a clear coat over it.
//!
//! Neither takes light away, so what of it is not reflected crosses; and a stack that takes none reflects from inside what it
//! reflects from outside, towards the angle that Snell's law pairs with it. As in glTF's layering, what lies below a coat
//! reflects what it would in air.

use glam::Vec3;

use super::film::Film;
use super::recipe::{FilmMaps, Scalar};
use super::{TextureId, fresnel};

/// Layers that cover glass, and the maps that say how much of each is where.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Coating {
    /// On the glass itself.
    pub film: Option<FilmMaps>,
    /// How much of a clear coat of index 1.5 is there.
    pub coat: Scalar,
}

/// Those layers at a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coated {
    /// On the glass itself.
    pub film: Option<Film>,
    /// How much of a clear coat is there, in [0, 1].
    pub coat: f32,
}

/// Refractive index of a clear coat.
const COAT_INDEX: f32 = 1.5;

impl Coating {
    /// The layers where `texel` reads the maps; `None` where there is nothing of either.
    pub fn at(&self, texel: impl Fn(TextureId) -> [f32; 4]) -> Option<Coated> {
        Coated::new(self.film.map(|film| film.at(&texel)), self.coat.at(&texel))
    }

    /// Calls `f` with each place of a map; it may be changed, but not taken away.
    pub fn each_map(&mut self, mut f: impl FnMut(&mut Option<TextureId>)) {
        if let Some(film) = &mut self.film {
            film.each_map(&mut f);
        }
        self.coat.each_map(&mut f);
    }
}

impl Coated {
    /// `None` where there is nothing of either.
    pub fn new(film: Option<Film>, coat: f32) -> Option<Self> {
        let film = film.filter(|film| film.strength > 0.0);
        (film.is_some() || coat > 0.0).then_some(Self { film, coat })
    }

    /// Reflectance per band of coating and glass together towards `cosine`, on the side from which the glass begins with the
    /// relative index `eta` (below 1 from inside).
    pub fn reflectance(&self, cosine: f32, eta: f32) -> Vec3 {
        let bare = fresnel::dielectric(cosine, eta);
        // Outside, where film and coat are seen from.
        let outside =
            if eta < 1.0 { (1.0 - (1.0 - cosine * cosine) / (eta * eta)).max(0.0).sqrt() } else { cosine };
        if bare >= 1.0 {
            return Vec3::ONE;
        }
        let below = match &self.film {
            Some(film) => {
                let straight = fresnel::dielectric(1.0, eta);
                let filmed = film.reflectance(outside, Vec3::splat(straight));
                Vec3::splat(bare).lerp(filmed, film.strength)
            }
            None => Vec3::splat(bare),
        };
        // Light goes to and fro between coat and glass.
        let coat = self.coat * fresnel::dielectric(outside, COAT_INDEX);
        let crossed = (1.0 - coat) * (1.0 - coat);
        let both = (below * coat).min(Vec3::splat(0.9999));
        (crossed * below / (Vec3::ONE - both) + coat).clamp(Vec3::ZERO, Vec3::ONE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::recipe::Channel;

    fn film(strength: f32) -> Option<Film> {
        Some(Film { strength, ior: 1.3, thickness: 380.0 })
    }

    #[test]
    fn nothing_is_no_coating_and_little_is_nearly_bare() {
        assert_eq!(Coated::new(film(0.0), 0.0), None);
        let faint = Coated::new(film(1e-6), 1e-6).unwrap();
        for eta in [1.5, 1.0 / 1.5, 1.0] {
            for cosine in [0.0, 0.05, 0.4, 0.8, 1.0] {
                let off = faint.reflectance(cosine, eta) - fresnel::dielectric(cosine, eta);
                assert!(off.abs().max_element() < 1e-5, "{eta} {cosine} {off}");
            }
        }
    }

    #[test]
    fn maps_say_how_much_of_each_layer_is_where() {
        let map = |channel| Scalar { factor: 0.5, map: Some((TextureId(channel as u32), channel)) };
        let film = FilmMaps {
            strength: map(Channel::Red),
            ior: 1.3,
            thickness: [200.0, 400.0],
            map: Some(TextureId(7)),
        };
        let mut coating = Coating { film: Some(film), coat: map(Channel::Blue) };
        let mut maps = Vec::new();
        coating.each_map(|map| maps.extend(*map));
        assert_eq!(maps, [TextureId(0), TextureId(7), TextureId(2)]);
        let texel = |map: TextureId| match map.0 {
            0 => [0.5, 0.0, 0.0, 0.0],
            2 => [0.0, 0.0, 0.25, 0.0],
            _ => [0.0, 0.75, 0.0, 0.0],
        };
        let here = coating.at(texel).unwrap();
        assert_eq!(
            here,
            Coated { film: Some(Film { strength: 0.25, ior: 1.3, thickness: 350.0 }), coat: 0.125 }
        );
        assert_eq!(coating.at(|_| [0.0; 4]), None, "where maps are black the glass is bare");
    }

    #[test]
    fn a_stack_reflects_as_much_from_inside_as_from_outside() {
        for coating in [Coated::new(film(1.0), 0.0), Coated::new(None, 1.0), Coated::new(film(0.6), 0.7)] {
            let coating = coating.unwrap();
            for cosine in [0.02_f32, 0.2, 0.5, 0.9, 1.0] {
                let inside = (1.0 - (1.0 - cosine * cosine) / 2.25).sqrt();
                let [a, b] = [coating.reflectance(cosine, 1.5), coating.reflectance(inside, 1.0 / 1.5)];
                assert!((a - b).abs().max_element() < 2e-3, "{cosine} {a} {b}");
            }
            assert_eq!(coating.reflectance(0.3, 1.0 / 1.5), Vec3::ONE, "beyond the critical angle");
        }
    }

    #[test]
    fn a_coat_on_glass_of_its_index_is_a_second_face() {
        // Two equal faces: 2 F / (1 + F).
        let coat = Coated::new(None, 1.0).unwrap();
        let expected = 2.0 * 0.04 / 1.04;
        assert!((coat.reflectance(1.0, 1.5) - expected).abs().max_element() < 1e-6);
    }

    #[test]
    fn whatever_is_asked_the_answer_is_a_share() {
        for ior in [1.0, 1.001, 1.3, 10.0_f32] {
            for strength in [0.1, 1.0] {
                for thickness in [0.0, 1e-3, 250.0, 1e5] {
                    let film = Film { strength, ior, thickness };
                    let coating = Coated::new(Some(film), strength).unwrap();
                    for eta in [0.1, 0.6, 1.0, 1.5, 10.0] {
                        for cosine in [0.0, 1e-6, 0.3, 0.745, 1.0] {
                            let found = coating.reflectance(cosine, eta);
                            assert!(found.cmpge(Vec3::ZERO).all() && found.cmple(Vec3::ONE).all(), "{found}");
                        }
                    }
                }
            }
        }
    }
}
