//! What an MTL material becomes. The first row that fits wins.
//!
//! | MTL | [`Model`] |
//! | --- | --- |
//! | `illum` 4, 6, 7 or 9; or `d` < 1 (`Tr` > 0) without `map_d` | `Dielectric`; a thin pane where `illum` is 4 or 9 or `Ni` is within 0.01 of 1; `Ni` absent, or 1 where `illum` says glass: 1.5 |
//! | `Pm` > 0.5 | `Metal` of `Kd`, or of `Ks` where `Kd` is black |
//! | `illum` 3, 5 or 8, `Ks` ≥ 0.5, `Kd` ≤ 0.1, `Ns` ≥ 900 or `Pr` ≤ 0.2 (or neither given) | `Mirror` of `Ks` |
//! | the same, but rougher | `Metal` of `Ks` |
//! | `Pr` given, `Ks` not | `Plastic` of `Kd` under a coat of `Ni` (absent: 1.5) |
//! | `illum` 0 or 1, or `Ks` black | `Lambert` of `Kd` |
//! | anything else | `CookTorrance` (GGX, Schlick) of `Kd` and `Ks`, scaled together where a band of their sum is above 1 |
//!
//! - Roughness α = `Pr`²; without `Pr` √(2 / (`Ns` + 2)) (Walter et al. 2007 for Beckmann, used for
//!   both); without both √(2 / 12). `aniso` stretches α by 1 / √(1 − 0.9 `aniso`) along the tangent
//!   and by its inverse across it (Burley 2012).
//! - Transmittance: `Tf`; without it (1 − `d`) + `d` `Kd`. MTL means one passage, so for solid glass
//!   the loader turns it into one per unit of length by the mean chord 4 V / S of its parts' bounds.
//! - `Tr` is 1 − `d`; where both are given `d` counts. `Tr` 1 without `d` would make a thing invisible,
//!   and some exporters mean the opposite: opaque.
//! - A black `Kd` under a `map_Kd` is white, since many exporters leave it black.
//! - A missing texture of the diffuse colour leaves half of the factor.

use glam::Vec3;

use super::mtl::{MapStatement, MtlMaterial};
use foveal::scene::{Coat, Distribution, Material, Model, Reflectance, Roughness, TextureId};

/// What was put right in materials, by the name of the first one.
#[derive(Debug, Default)]
pub(super) struct Doubts {
    /// Reflects more than it gets.
    pub bright: Vec<String>,
    /// `Tr` 1 taken for opaque.
    pub opaque: Vec<String>,
}

/// A material that OBJ faces without one get.
pub(super) fn default_material(name: &str) -> Material {
    Material::new(name, Model::Lambert { albedo: Reflectance::constant(Vec3::splat(0.5)) })
}

fn roughness(m: &MtlMaterial) -> Roughness {
    let alpha = match (m.pr, m.ns) {
        (Some(pr), _) => pr.clamp(0.0, 1.0).powi(2),
        (None, ns) => (2.0 / (ns.unwrap_or(10.0).max(0.0) + 2.0)).sqrt(),
    };
    let stretch = (1.0 - 0.9 * m.aniso.unwrap_or(0.0).clamp(0.0, 1.0)).sqrt();
    Roughness {
        alpha_x: (alpha / stretch).min(1.0),
        alpha_y: alpha * stretch,
        distribution: Distribution::Ggx,
    }
}

/// Turns a material around. `texture` asks for a picture; its flag says whether it is a colour.
pub(super) fn material(
    m: &MtlMaterial,
    texture: &mut impl FnMut(&MapStatement, bool) -> TextureId,
    doubts: &mut Doubts,
) -> Material {
    let mut color_map = |map: &Option<MapStatement>| map.as_ref().map(|s| texture(s, true));
    let (map_kd, map_ks, map_ke) = (color_map(&m.map_kd), color_map(&m.map_ks), color_map(&m.map_ke));
    let mut kd = m.kd.unwrap_or(if map_kd.is_some() { Vec3::ONE } else { Vec3::splat(0.5) });
    if map_kd.is_some() && kd == Vec3::ZERO {
        kd = Vec3::ONE;
    }
    let ks = m.ks.unwrap_or(if map_ks.is_some() { Vec3::ONE } else { Vec3::ZERO });
    let illum = m.illum.unwrap_or(2);
    let d = match (m.d, m.tr) {
        (Some(d), _) => d,
        (None, Some(tr)) if tr >= 1.0 && !matches!(illum, 4 | 6 | 7 | 9) => {
            doubts.opaque.push(m.name.clone());
            1.0
        }
        (None, Some(tr)) => 1.0 - tr,
        (None, None) => 1.0,
    }
    .clamp(0.0, 1.0);
    let cut_out = m.map_d.is_some();
    let mut bounded = |c: Vec3| {
        if c.max_element() > 1.0 + 1e-3 {
            doubts.bright.push(m.name.clone());
        }
        c.clamp(Vec3::ZERO, Vec3::ONE)
    };
    let rough = roughness(m);
    let reflective = matches!(illum, 3 | 5 | 8) && ks.max_element() >= 0.5 && kd.max_element() <= 0.1;
    let model = if matches!(illum, 4 | 6 | 7 | 9) || (d < 1.0 && !cut_out) {
        let glass = matches!(illum, 4 | 6 | 7 | 9);
        let ni = m.ni.filter(|n| *n > 0.0);
        let near_one = ni.is_some_and(|n| (n - 1.0).abs() < 0.01);
        let filter = match m.tf {
            Some(tf) => tf,
            None => Vec3::splat(1.0 - d) + kd * d,
        };
        Model::Dielectric {
            ior: ni.filter(|_| !(glass && near_one)).unwrap_or(1.5).clamp(0.1, 10.0),
            transmittance: if glass && d >= 1.0 && m.tf.is_none() { Vec3::ONE } else { bounded(filter) },
            thin: matches!(illum, 4 | 9) || near_one,
            // Exporters write the same `Ns` for glass as for all else; only `Pr` is meant.
            roughness: if m.pr.is_some() { rough } else { Roughness { alpha_x: 0.0, alpha_y: 0.0, ..rough } },
        }
    } else if m.pm.unwrap_or(0.0) > 0.5 {
        let specular = if kd.max_element() > 0.0 {
            Reflectance { color: bounded(kd), map: map_kd }
        } else {
            Reflectance { color: bounded(ks), map: map_ks }
        };
        Model::Metal { specular, roughness: rough }
    } else if reflective {
        let specular = Reflectance { color: bounded(ks), map: map_ks };
        let smooth = match (m.pr, m.ns) {
            (Some(pr), _) => pr <= 0.2,
            (None, Some(ns)) => ns >= 900.0,
            (None, None) => true,
        };
        if smooth { Model::Mirror { specular } } else { Model::Metal { specular, roughness: rough } }
    } else if m.pr.is_some() && m.ks.is_none() && map_ks.is_none() {
        let ior = m.ni.filter(|n| *n > 1.01).unwrap_or(1.5).min(10.0);
        Model::Plastic {
            albedo: Reflectance { color: bounded(kd), map: map_kd },
            coat: Coat::new(ior, rough),
        }
    } else if illum < 2 || ks.max_element() <= 0.0 {
        Model::Lambert { albedo: Reflectance { color: bounded(kd), map: map_kd } }
    } else {
        let sum = (kd + ks).max_element();
        let scale = if sum > 1.0 { 1.0 / sum } else { 1.0 };
        bounded(Vec3::splat(sum));
        Model::CookTorrance {
            diffuse: Reflectance { color: kd * scale, map: map_kd },
            specular: Reflectance { color: ks * scale, map: map_ks },
            roughness: rough,
        }
    };
    let ke = m.ke.unwrap_or(if map_ke.is_some() { Vec3::ONE } else { Vec3::ZERO });
    let ke = if map_ke.is_some() && ke == Vec3::ZERO { Vec3::ONE } else { ke };
    Material {
        name: m.name.clone(),
        model,
        emission: Reflectance { color: ke, map: map_ke },
        // Exporters that write a mask often write `d 0` with it.
        opacity: if cut_out && d > 0.0 { d } else { 1.0 },
        opacity_map: m.map_d.as_ref().map(|s| texture(s, false)),
        bump_map: m.bump.as_ref().map(|s| texture(s, false)),
        bump_scale: m.bump.as_ref().map_or(1.0, |s| s.bump),
        normal_map: m.norm.as_ref().map(|s| texture(s, false)),
        two_sided: true,
        shadeless: false,
        culled: false,
        dispersion: 0.0,
        coating: None,
        tint: foveal::scene::Reflectance::constant(glam::Vec3::ONE),
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn read(body: &str) -> (Material, Doubts) {
        let parsed = super::super::mtl::parse(
            format!("newmtl m\n{body}").as_bytes(),
            Path::new("m.mtl"),
            &mut Vec::new(),
        );
        let mut doubts = Doubts::default();
        let m = material(&parsed[0], &mut |_, color| TextureId(u32::from(color)), &mut doubts);
        (m, doubts)
    }

    fn model(body: &str) -> Model {
        read(body).0.model
    }

    #[test]
    fn the_table_of_models() {
        assert!(matches!(model("Kd 1 1 1\nillum 2\nKs 0 0 0"), Model::Lambert { .. }));
        assert!(matches!(model("Kd .5 .5 .5\nKs .5 .5 .5\nillum 1"), Model::Lambert { .. }));
        assert!(matches!(model("Kd .5 .5 .5\nKs .1 .1 .1\nNs 100"), Model::CookTorrance { .. }));
        assert!(matches!(model("Kd .01 .01 .01\nKs .95 .95 .95\nNs 1000\nillum 5"), Model::Mirror { .. }));
        assert!(matches!(model("Kd 0 0 0\nKs .9 .9 .9\nNs 50\nillum 3"), Model::Metal { .. }));
        assert!(matches!(model("Kd 0 0 0\nKs .9 .6 .3\nPr .3\nPm 1\nillum 3"), Model::Metal { .. }));
        assert!(matches!(model("Kd .5 .5 .5\nPr .3"), Model::Plastic { .. }));
        assert!(matches!(model("Ni 1.5\nillum 7"), Model::Dielectric { thin: false, .. }));
        assert!(matches!(model("Ni 1.5\nillum 4"), Model::Dielectric { thin: true, .. }));
        assert!(matches!(model("d 0.5\nNi 1\nillum 2"), Model::Dielectric { thin: true, .. }));
        assert!(matches!(model("Tr 0.5\nNi 1.5"), Model::Dielectric { thin: false, .. }));
        assert!(matches!(model("d 0.5\nmap_d a.png"), Model::Lambert { .. }));
        assert!(matches!(model(""), Model::Lambert { .. }));
    }

    #[test]
    fn roughness_follows_pr_then_ns() {
        let alpha = |body: &str| match model(&format!("Ks .5 .5 .5\nKd .1 .1 .1\n{body}")) {
            Model::CookTorrance { roughness, .. } => [roughness.alpha_x, roughness.alpha_y],
            other => panic!("{other:?}"),
        };
        assert_eq!(alpha("Ns 198"), [0.1, 0.1]);
        let [a, b] = alpha("Pr 0.5\nNs 198");
        assert!((a - 0.25).abs() < 1e-6 && a == b);
        let [x, y] = alpha("Pr 0.5\naniso 0.8");
        assert!((x * y - 0.0625).abs() < 1e-6 && x > y);
        assert_eq!(alpha("Pr 9\nNs -3"), [1.0, 1.0]);
    }

    #[test]
    fn no_more_light_leaves_than_arrives() {
        let (m, doubts) = read("Kd .8 .2 .2\nKs .8 .8 .8\nNs 10");
        let Model::CookTorrance { diffuse, specular, .. } = m.model else { panic!("{m:?}") };
        assert!(((diffuse.color + specular.color).max_element() - 1.0).abs() < 1e-6);
        assert_eq!(doubts.bright, ["m"]);
        assert_eq!(read("Kd 5 1 1").1.bright, ["m"]);
    }

    #[test]
    fn transmittance_by_filter_or_by_opacity() {
        let t = |body: &str| match model(body) {
            Model::Dielectric { transmittance, .. } => transmittance,
            other => panic!("{other:?}"),
        };
        assert_eq!(t("illum 7\nTf .5 .6 .7"), Vec3::new(0.5, 0.6, 0.7));
        assert_eq!(t("illum 7\nKd 0 0 0"), Vec3::ONE);
        assert_eq!(t("d .25\nKd 0 0 1"), Vec3::new(0.75, 0.75, 1.0));
        let (m, doubts) = read("Tr 1\nKd .5 .5 .5");
        assert!(matches!(m.model, Model::Lambert { .. }));
        assert_eq!(doubts.opaque, ["m"]);
    }

    #[test]
    fn maps_are_colours_or_masks() {
        let (m, _) = read("Kd 0 0 0\nmap_Kd a\nmap_d b\nbump -bm .2 c\nnorm d\nKe 1 2 3\nmap_Ke e");
        assert_eq!(
            m.model,
            Model::Lambert { albedo: Reflectance { color: Vec3::ONE, map: Some(TextureId(1)) } }
        );
        assert_eq!(
            (m.opacity_map, m.bump_map, m.normal_map),
            (Some(TextureId(0)), Some(TextureId(0)), Some(TextureId(0)))
        );
        assert_eq!(m.bump_scale, 0.2);
        assert_eq!(m.emission, Reflectance { color: Vec3::new(1.0, 2.0, 3.0), map: Some(TextureId(1)) });
    }
}
