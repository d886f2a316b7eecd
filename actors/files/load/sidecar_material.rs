//! `[material."NAME"]` of the sidecar.

use glam::Vec3;

use super::error::{Place, SceneError};
use super::from_mtl::default_material;
use super::mtl::MapStatement;
use super::sidecar::RADIANCE_MAX;
use super::toml_table::Table;
use foveal::scene::{Coat, Distribution, Material, Model, Reflectance, Roughness, TextureId};

/// A picture that a material asks for.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct MapKey {
    pub statement: MapStatement,
    pub place: Place,
    pub is_color: bool,
}

/// A material whose texture ids are places in `maps`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct MaterialTable {
    pub material: Material,
    pub maps: Vec<MapKey>,
    pub place: Place,
}

struct Reader<'t, 'a> {
    table: &'t Table<'a>,
    maps: Vec<MapKey>,
}

impl Reader<'_, '_> {
    fn map(&mut self, key: &'static str, is_color: bool) -> Result<Option<TextureId>, SceneError> {
        let Some(file) = self.table.string(key)? else { return Ok(None) };
        let place = self.table.place_of(key);
        let statement = MapStatement {
            file: file.to_owned(),
            line: place.line,
            scale_offset: [1.0, 1.0, 0.0, 0.0],
            clamp: false,
            bump: 1.0,
        };
        self.maps.push(MapKey { statement, place, is_color });
        Ok(Some(TextureId(self.maps.len() as u32 - 1)))
    }

    /// `key` or `map_key` or both, in which case the colour is a factor.
    fn reflectance(
        &mut self,
        key: &'static str,
        map_key: &'static str,
        max: f32,
        absent: Vec3,
    ) -> Result<Reflectance, SceneError> {
        let map = self.map(map_key, true)?;
        let color = self.table.color(key, max)?;
        Ok(Reflectance { color: color.unwrap_or(if map.is_some() { Vec3::ONE } else { absent }), map })
    }

    fn roughness(&self, absent: f32) -> Result<Roughness, SceneError> {
        let t = self.table;
        let one = |key| t.number_in(key, |v| (0.0..=1.0).contains(&v), "between 0 and 1");
        let alpha = one("alpha")?.unwrap_or(absent);
        let (alpha_x, alpha_y) = (one("alpha_x")?.unwrap_or(alpha), one("alpha_y")?.unwrap_or(alpha));
        let distribution = match t.string("distribution")? {
            None | Some("ggx") => Distribution::Ggx,
            Some("beckmann") => Distribution::Beckmann,
            Some(_) => return Err(t.invalid("distribution", "must be \"ggx\" or \"beckmann\"")),
        };
        Ok(Roughness { alpha_x, alpha_y, distribution })
    }

    fn ior(&self) -> Result<f32, SceneError> {
        let good = |v: f32| (0.1..=10.0).contains(&v);
        Ok(self.table.number_in("ior", good, "between 0.1 and 10")?.unwrap_or(1.5))
    }

    /// Diffuse and specular, which together must not reflect more than arrives.
    fn layered(&mut self) -> Result<(Reflectance, Reflectance, Roughness), SceneError> {
        let diffuse = self.reflectance("diffuse", "map_diffuse", 1.0, Vec3::ZERO)?;
        let specular = self.reflectance("specular", "map_specular", 1.0, Vec3::ZERO)?;
        if (diffuse.color + specular.color).max_element() > 1.0 + 1e-3 {
            let message =
                "and `diffuse` add up to more than 1: more light would leave than arrives; reduce one";
            return Err(self.table.invalid("specular", message));
        }
        let roughness = self.roughness(0.1)?;
        Ok((diffuse, specular, roughness))
    }
}

/// Reads the table of one material.
pub(super) fn material_table(name: &str, table: &Table<'_>) -> Result<MaterialTable, SceneError> {
    let mut r = Reader { table, maps: Vec::new() };
    let grey = Vec3::splat(0.5);
    let model = table.required("model", table.string("model")?)?;
    let model = match model {
        "lambert" => Model::Lambert { albedo: r.reflectance("albedo", "map_albedo", 1.0, grey)? },
        "mirror" => Model::Mirror { specular: r.reflectance("specular", "map_specular", 1.0, Vec3::ONE)? },
        "conductor" => {
            let (eta, k) = (table.color("eta", 1e3)?, table.color("k", 1e3)?);
            let schlick = table.color("specular", 1.0)?.is_some() || table.string("map_specular")?.is_some();
            if eta.is_none() && k.is_none() {
                let specular = r.reflectance("specular", "map_specular", 1.0, Vec3::ONE)?;
                Model::Metal { specular, roughness: r.roughness(0.0)? }
            } else if schlick {
                return Err(
                    table.invalid("specular", "stands beside `eta` and `k`; give the one or the other")
                );
            } else {
                let (eta, k) = (table.required("eta", eta)?, table.required("k", k)?);
                if eta.min_element() <= 0.0 {
                    return Err(table.invalid("eta", "must be above 0 in every band"));
                }
                Model::Conductor { eta, k, roughness: r.roughness(0.0)? }
            }
        }
        "dielectric" => Model::Dielectric {
            ior: r.ior()?,
            transmittance: table.color("transmittance", 1.0)?.unwrap_or(Vec3::ONE),
            thin: table.boolean("thin")?.unwrap_or(false),
            roughness: r.roughness(0.0)?,
        },
        "plastic" => Model::Plastic {
            albedo: r.reflectance("albedo", "map_albedo", 1.0, grey)?,
            coat: Coat::new(r.ior()?, r.roughness(0.1)?),
        },
        "cook_torrance" => {
            let (diffuse, specular, roughness) = r.layered()?;
            Model::CookTorrance { diffuse, specular, roughness }
        }
        "ward" => {
            let (diffuse, specular, roughness) = r.layered()?;
            Model::Ward { diffuse, specular, roughness }
        }
        other => {
            let message = format!(
                "is \"{other}\"; it must be lambert, mirror, conductor, dielectric, plastic, cook_torrance or ward"
            );
            return Err(table.invalid("model", message));
        }
    };
    let material = Material {
        model,
        emission: r.reflectance("emission", "map_emission", RADIANCE_MAX, Vec3::ZERO)?,
        opacity: table.number_in("opacity", |v| (0.0..=1.0).contains(&v), "between 0 and 1")?.unwrap_or(1.0),
        opacity_map: r.map("map_opacity", false)?,
        bump_map: r.map("map_bump", false)?,
        bump_scale: table.number("bump_scale")?.unwrap_or(1.0),
        normal_map: r.map("map_normal", false)?,
        two_sided: table.boolean("two_sided")?.unwrap_or(true),
        ..default_material(name)
    };
    table.finish()?;
    Ok(MaterialTable { material, maps: r.maps, place: table.place() })
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::sidecar::parse;
    use super::*;

    fn read(body: &str) -> Result<MaterialTable, String> {
        let text = format!("format = 1\n[material.\"m n\"]\n{body}\n");
        let mut sidecar = parse(text.as_bytes(), Path::new("s.toml")).map_err(|e| e.to_string())?;
        Ok(sidecar.materials.remove(0))
    }

    fn check(body: &str, message: &str) {
        assert_eq!(read(body).unwrap_err(), format!("s.toml:{message}"), "{body}");
    }

    #[test]
    fn every_model_reads() {
        let model = |body: &str| read(body).unwrap().material.model;
        assert_eq!(
            model("model = \"lambert\""),
            Model::Lambert { albedo: Reflectance::constant(Vec3::splat(0.5)) }
        );
        assert_eq!(model("model = \"mirror\""), Model::Mirror { specular: Reflectance::constant(Vec3::ONE) });
        assert!(matches!(
            model("model = \"conductor\"\neta = [1, 1, 1]\nk = [2, 2, 2]"),
            Model::Conductor { .. }
        ));
        assert!(matches!(
            model("model = \"conductor\"\nspecular = [0.9, 0.8, 0.7]\nalpha = 0.2"),
            Model::Metal { .. }
        ));
        assert!(matches!(
            model("model = \"dielectric\"\nthin = true"),
            Model::Dielectric { ior: 1.5, thin: true, .. }
        ));
        assert!(matches!(model("model = \"plastic\"\nmap_albedo = \"a.png\""), Model::Plastic { .. }));
        assert!(matches!(
            model("model = \"cook_torrance\"\ndiffuse = [0.5, 0.5, 0.5]"),
            Model::CookTorrance { .. }
        ));
        let Model::Ward { roughness, .. } =
            model("model = \"ward\"\nalpha_x = 0.1\nalpha_y = 0.3\ndistribution = \"beckmann\"")
        else {
            panic!("not Ward")
        };
        assert_eq!((roughness.alpha_x, roughness.alpha_y), (0.1, 0.3));
        assert_eq!(roughness.distribution, Distribution::Beckmann);
    }

    #[test]
    fn maps_keep_their_place_and_kind() {
        let m = read("model = \"lambert\"\nmap_albedo = \"a.png\"\nmap_opacity = \"b.png\"\nopacity = 0.5")
            .unwrap();
        assert_eq!(
            m.material.model,
            Model::Lambert { albedo: Reflectance { color: Vec3::ONE, map: Some(TextureId(0)) } }
        );
        assert_eq!(m.material.opacity_map, Some(TextureId(1)));
        assert!(m.maps[0].is_color && !m.maps[1].is_color);
        assert_eq!(m.maps[1].place, Place::new("s.toml", 5));
    }

    #[test]
    fn messages() {
        check("alpha = 0.1", "2: [material.\"m n\"] has no `model`; add it");
        check(
            "model = \"mirror\"\nalpha = 0.1",
            "4: unknown key `alpha` in [material.\"m n\"]; did you mean `model`?",
        );
        check("model = \"ward\"\nalpha = 2", "4: `alpha` is 2; it must be between 0 and 1");
        check("model = \"conductor\"\neta = [1, 1, 1]", "2: [material.\"m n\"] has no `k`; add it");
        check(
            "model = \"conductor\"\neta = [1, 1, 1]\nk = [1, 1, 1]\nspecular = [1, 1, 1]",
            "6: `specular` stands beside `eta` and `k`; give the one or the other",
        );
        check(
            "model = \"lambert\"\nalbedo = [2, 0, 0]",
            "4: `albedo` is [2, 0, 0]; each number must lie between 0 and 1",
        );
        assert!(
            read("model = \"ward\"\ndiffuse = [0.9, 0, 0]\nspecular = [0.9, 0, 0]")
                .unwrap_err()
                .contains("more than 1")
        );
        assert!(read("model = \"glass\"").unwrap_err().contains("must be lambert, mirror"));
    }
}
