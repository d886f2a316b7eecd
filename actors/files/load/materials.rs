//! The materials that triangles use: which definition counts, and what is put right in them.

use std::collections::HashMap;
use std::path::Path;

use glam::Vec3;

use super::assemble::Joined;
use super::error::{Place, Warning};
use super::folder::Folder;
use super::from_mtl::{self, Doubts};
use super::meshes::Definitions;
use super::sidecar::Sidecar;
use super::textures::TextureRequests;
use super::{gltf, mtl};

use foveal::math;
use foveal::scene::{Material, MaterialId, Model, Reflectance, Scene, TextureId};

/// The materials that triangles use.
pub(super) struct Materials {
    pub materials: Vec<Material>,
    /// Those from MTL, whose glass filters by passage.
    pub filters: Vec<MaterialId>,
    /// Those from glTF, whose maps are still to be joined.
    pub pending: Vec<gltf::surfaces::Pending>,
}

/// The materials that triangles use, from sidecar, MTL and glTF; texture ids are those of `requests`.
pub(super) fn materials(
    joined: &Joined,
    sidecar: &Sidecar,
    folder: &Folder,
    requests: &mut TextureRequests,
    warnings: &mut Vec<Warning>,
) -> Materials {
    let by_name: HashMap<&str, usize> =
        sidecar.materials.iter().enumerate().map(|(i, m)| (m.material.name.as_str(), i)).collect();
    let mut doubts = Doubts::default();
    let mut materials = Vec::with_capacity(joined.uses.len());
    let (mut filters, mut pending) = (Vec::new(), Vec::new());
    for used in &joined.uses {
        let mut material = if let Some(&i) = by_name.get(used.called()) {
            let table = &sidecar.materials[i];
            let mut ids = Vec::new();
            for m in &table.maps {
                ids.push(requests.ask(folder, &[Path::new("")], &m.statement, m.is_color, m.place.clone()));
            }
            let ids: Vec<Option<TextureId>> = ids.into_iter().map(Some).collect();
            let mut material = table.material.clone();
            resolve_maps(&mut material, &ids);
            material
        } else if let Some((library, at)) = used.definition {
            let id = MaterialId(materials.len() as u32);
            let library = &joined.libraries[library];
            match &library.materials {
                Definitions::Mtl(list) => {
                    filters.push(id);
                    let beside = library.relative.parent().unwrap_or(Path::new(""));
                    let bases = [beside, joined.base_of(used.file)];
                    let mut texture = |map: &mtl::MapStatement, is_color: bool| {
                        let place = Place::new(&library.shown, map.line);
                        requests.ask(folder, &bases, map, is_color, place)
                    };
                    from_mtl::material(&list[at], &mut texture, &mut doubts)
                }
                Definitions::Gltf(list) => {
                    let place = Place::new(&library.shown, 0);
                    let (material, rest) = gltf::surfaces::ask(&list[at], id, &place, requests);
                    pending.push(rest);
                    material
                }
            }
        } else {
            if let Some(line) = used.line {
                let message = format!("no material library has \"{}\"; grey instead", used.name);
                warnings.push(Warning::new(Place::new(joined.shown_of(used.file), line), message));
            }
            from_mtl::default_material(&used.name)
        };
        material.name = used.unique.clone();
        materials.push(material);
    }
    for table in &sidecar.materials {
        let name = &table.material.name;
        if !joined.knows_material(name) {
            let message = format!("no mesh and no material library has a material \"{name}\"; not used");
            warnings.push(Warning::new(table.place.clone(), message));
        }
    }
    for (names, what) in [
        (doubts.bright, "reflects more light than it gets; scaled down to 1"),
        (doubts.opaque, "is wholly transparent by `Tr 1`; taken for opaque (write `d 0` if it is not)"),
    ] {
        if let (Some(first), Some(library)) = (names.first(), joined.libraries.first()) {
            let more =
                if names.len() > 1 { format!(" (and {} more)", names.len() - 1) } else { String::new() };
            let line = library.materials.line_of(first);
            warnings
                .push(Warning::new(Place::new(&library.shown, line), format!("\"{first}\"{more} {what}")));
        }
    }
    if materials.is_empty() {
        materials.push(from_mtl::default_material("default"));
    }
    Materials { materials, filters, pending }
}

/// Largest diffuse reflectance: at 1 light between walls would never end.
const ALBEDO_MAX: f32 = 0.99;

/// Keeps diffuse reflectances below 1; says of which materials.
pub(super) fn clamp_albedo(scene: &mut Scene) -> Vec<String> {
    let textures = scene.textures.clone();
    let mut messages = Vec::new();
    for material in &mut scene.materials {
        let (Model::Lambert { albedo: diffuse }
        | Model::Plastic { albedo: diffuse, .. }
        | Model::CookTorrance { diffuse, .. }
        | Model::Ward { diffuse, .. }) = &mut material.model
        else {
            continue;
        };
        let mean = diffuse.map.map_or(1.0, |map| {
            let [r, g, b, _] = textures[map.0 as usize].mean();
            r.max(g).max(b)
        });
        let limit = ALBEDO_MAX / mean.max(1e-6);
        if diffuse.color.max_element() > limit {
            diffuse.color = diffuse.color.min(Vec3::splat(limit));
            messages.push(format!(
                "material \"{}\" reflects all light that falls on it; {ALBEDO_MAX} of it is used",
                material.name
            ));
        }
    }
    messages
}

/// Replaces the ids of a material's pictures; a missing picture leaves the colour, and half of it
/// where it was the diffuse colour.
pub(super) fn resolve_maps(material: &mut Material, ids: &[Option<TextureId>]) {
    let new = |id: &mut Option<TextureId>| -> bool {
        let Some(old) = *id else { return false };
        *id = ids.get(old.0 as usize).copied().flatten();
        id.is_none()
    };
    let color = |r: &mut Reflectance| {
        if new(&mut r.map) {
            r.color *= 0.5;
        }
    };
    let factor = |r: &mut Reflectance| {
        new(&mut r.map);
    };
    match &mut material.model {
        Model::Lambert { albedo } | Model::Plastic { albedo, .. } => color(albedo),
        Model::Mirror { specular } | Model::Metal { specular, .. } => factor(specular),
        Model::CookTorrance { diffuse, specular, .. } | Model::Ward { diffuse, specular, .. } => {
            color(diffuse);
            factor(specular);
        }
        // Made after this, of maps that are there.
        Model::MetalRough(_) | Model::Conductor { .. } | Model::Dielectric { .. } => {}
    }
    factor(&mut material.emission);
    for id in [&mut material.opacity_map, &mut material.bump_map, &mut material.normal_map] {
        new(id);
    }
}

/// MTL filters light once per passage; solid glass absorbs per length of path. The mean chord of a
/// convex body is 4 V / S; here that of the bounds of the material's parts.
pub(super) fn filters_to_absorption(scene: &mut Scene, filters: &[MaterialId]) {
    for &id in filters {
        let mut chords = Vec::new();
        for object in scene.objects.iter().skip(1).filter(|o| o.material == id) {
            let d = object.bounds[1] - object.bounds[0];
            let surface = 2.0 * (d.x * d.y + d.y * d.z + d.z * d.x);
            if surface > 0.0 {
                chords.push(4.0 * d.x * d.y * d.z / surface);
            }
        }
        let mean = chords.iter().sum::<f32>() / chords.len().max(1) as f32;
        if let Some(Model::Dielectric { transmittance, thin: false, .. }) =
            scene.materials.get_mut(id.0 as usize).map(|m| &mut m.model)
            && mean > 0.0
        {
            let inverse = 1.0 / mean;
            *transmittance =
                transmittance.max(Vec3::splat(1e-6)).map(|t| math::powf(t, inverse).clamp(0.0, 1.0));
        }
    }
}
