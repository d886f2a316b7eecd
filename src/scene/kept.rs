//! A scene as bytes: what is small by serde, long lists as they lie in memory.
//!
//! Whoever reads them believes nothing: lengths, indices and sizes are held against each other, so that what comes out is a
//! scene or nothing.

use std::collections::HashMap;
use std::sync::Arc;

use glam::{Vec2, Vec3, Vec4};
use serde::{Deserialize, Serialize};

use super::bulk::{Bulk, BulkReader};
use super::texture::MipChain;
use super::{
    Budget, CameraPath, Display, Environment, ExtensionUse, Light, Material, MaterialId, Mesh, NamedCamera,
    Object, Placement, Scene, SceneParts, Texture, TextureId, Things,
};
use crate::image::Map2d;

/// What of a scene is short. Its materials are apart: what they say is read knowing how many textures there are.
#[derive(Debug, Serialize, Deserialize)]
pub struct SceneHead {
    name: String,
    title: String,
    lights: Vec<Light>,
    environment: Option<EnvironmentHead>,
    cameras: Vec<NamedCamera>,
    paths: Vec<CameraPath>,
    objects: Vec<ObjectHead>,
    things: Things,
    bounds: [Vec3; 2],
    metres_per_unit: f32,
    up: Vec3,
    display: Display,
    budget: Budget,
    extensions: Vec<ExtensionUse>,
    files: Vec<(String, [u8; 32])>,
    content_hash: [u8; 32],
    mesh: MeshHead,
    chains: Vec<ChainHead>,
    textures: Vec<TextureHead>,
    materials: Vec<u8>,
}

/// Lengths.
#[derive(Debug, Serialize, Deserialize)]
struct MeshHead {
    vertices: usize,
    uvs1: usize,
    tangents: usize,
    triangles: usize,
}

#[derive(Debug, Serialize, Deserialize)]
struct EnvironmentHead {
    radiance: Vec3,
    rotate_up: f32,
    up: Vec3,
    map: Option<[usize; 2]>,
}

#[derive(Debug, Serialize, Deserialize)]
struct ObjectHead {
    name: String,
    material: MaterialId,
    bounds: [Vec3; 2],
    area: f32,
    parent: Option<u32>,
}

/// A picture with its mip levels.
#[derive(Debug, Serialize, Deserialize)]
struct ChainHead {
    size: [usize; 2],
    gamma: bool,
    texel: usize,
}

#[derive(Debug, Serialize, Deserialize)]
struct TextureHead {
    name: String,
    chain: usize,
    has_alpha: bool,
    is_color: bool,
    placement: Placement,
}

impl Scene {
    /// Writes the scene: lists into `bulk`, and what is returned. `None` where a texture is not all in memory.
    pub fn keep<'a>(&'a self, bulk: &mut Bulk<'a>) -> Option<SceneHead> {
        let mesh = &self.mesh;
        let lengths = MeshHead {
            vertices: mesh.positions.len(),
            uvs1: mesh.uvs1.len(),
            tangents: mesh.tangents.len(),
            triangles: mesh.triangles.len(),
        };
        bulk.put(&mesh.positions);
        bulk.put(&mesh.normals);
        bulk.put(&mesh.uvs);
        bulk.put(&mesh.uvs1);
        bulk.put(&mesh.tangents);
        bulk.put(&mesh.triangles);
        bulk.put_made(&mesh.materials.iter().map(|m| m.0).collect::<Vec<u32>>());
        bulk.put(&mesh.objects);
        let environment = self.environment.as_ref().map(|e| {
            let map = e.map.as_ref().map(|map| {
                bulk.put(map.data());
                [map.width(), map.height()]
            });
            EnvironmentHead { radiance: e.radiance, rotate_up: e.rotate_up, up: e.up, map }
        });
        let (mut chains, mut of_chain) = (Vec::new(), HashMap::new());
        let mut textures = Vec::new();
        for texture in &self.textures {
            let mips = &texture.mips;
            let chain = match of_chain.get(&Arc::as_ptr(mips)) {
                Some(&chain) => chain,
                None => {
                    for level in 0..mips.level_count() {
                        bulk.put(mips.level(level)?.as_bytes());
                    }
                    let texel = mips.level(0)?.size();
                    chains.push(ChainHead { size: texture.size(0), gamma: mips.is_gamma_encoded(), texel });
                    of_chain.insert(Arc::as_ptr(mips), chains.len() - 1);
                    chains.len() - 1
                }
            };
            let (name, placement) = (texture.name.clone(), texture.placement);
            let (has_alpha, is_color) = (texture.has_alpha, texture.is_color);
            textures.push(TextureHead { name, chain, has_alpha, is_color, placement });
        }
        let object = |o: &Object| ObjectHead {
            name: o.name.clone(),
            material: o.material,
            bounds: o.bounds,
            area: o.area,
            parent: o.parent,
        };
        Some(SceneHead {
            name: self.name.clone(),
            title: self.title.clone(),
            lights: self.lights.clone(),
            environment,
            cameras: self.cameras.clone(),
            paths: self.paths.clone(),
            objects: self.objects.iter().map(object).collect(),
            things: self.things.clone(),
            bounds: self.bounds,
            metres_per_unit: self.metres_per_unit,
            up: self.up,
            display: self.display,
            budget: self.budget,
            extensions: self.extensions.clone(),
            files: self.files.clone(),
            content_hash: self.content_hash,
            mesh: lengths,
            chains,
            textures,
            materials: postcard::to_stdvec(&self.materials).ok()?,
        })
    }

    /// What [`Self::keep`] wrote; `None` where it cannot be that.
    pub fn from_kept(head: SceneHead, bulk: &mut BulkReader<'_>) -> Option<Self> {
        let mesh = mesh(&head.mesh, bulk)?;
        let environment = match head.environment {
            None => None,
            Some(e) => {
                let map = match e.map {
                    None => None,
                    Some([width, height]) => {
                        let count = width.checked_mul(height).filter(|&count| count > 0)?;
                        let values: Vec<Vec3> = bulk.take(count)?;
                        let is_light = |v: &Vec3| v.is_finite() && v.min_element() >= 0.0;
                        let map = values.iter().all(is_light).then_some(values)?;
                        Some(Map2d::from_vec(width, height, map))
                    }
                };
                Some(Environment { radiance: e.radiance, map, rotate_up: e.rotate_up, up: e.up })
            }
        };
        let mut chains = Vec::new();
        for ChainHead { size: [width, height], gamma, texel } in head.chains {
            if width == 0 || height == 0 || width.max(height) > u32::MAX as usize {
                return None;
            }
            chains.push(Arc::new(MipChain::take(width, height, gamma, texel, bulk)?));
        }
        let mut textures = Vec::new();
        for t in head.textures {
            textures.push(Texture {
                name: t.name,
                mips: chains.get(t.chain)?.clone(),
                has_alpha: t.has_alpha,
                is_color: t.is_color,
                placement: t.placement,
            });
        }
        let count = u32::try_from(textures.len()).ok()?;
        let materials: Vec<Material> =
            TextureId::below(count, || postcard::from_bytes(&head.materials)).ok()?;
        let objects = objects(head.objects, &mesh, materials.len())?;
        let is_known = |m: &MaterialId| (m.0 as usize) < materials.len();
        if materials.is_empty() || head.cameras.is_empty() || !mesh.materials.iter().all(is_known) {
            return None;
        }
        if head.paths.iter().any(|path| path.keys.is_empty()) || !head.things.is_sound(mesh.triangles.len()) {
            return None;
        }
        let parts = SceneParts {
            name: head.name,
            title: head.title,
            mesh,
            materials,
            lights: head.lights,
            environment,
            cameras: head.cameras,
            paths: head.paths,
            objects,
            things: head.things,
            bounds: head.bounds,
            metres_per_unit: head.metres_per_unit,
            up: head.up,
            display: head.display,
            budget: head.budget,
            extensions: head.extensions,
            files: head.files,
            content_hash: head.content_hash,
        };
        Some(parts.with_textures(textures))
    }
}

fn mesh(head: &MeshHead, bulk: &mut BulkReader<'_>) -> Option<Mesh> {
    let fits = |length: usize| length == 0 || length == head.vertices;
    if !fits(head.uvs1) || !fits(head.tangents) {
        return None;
    }
    let positions: Vec<Vec3> = bulk.take(head.vertices)?;
    let normals: Vec<Vec3> = bulk.take(head.vertices)?;
    let uvs: Vec<Vec2> = bulk.take(head.vertices)?;
    let uvs1: Vec<Vec2> = bulk.take(head.uvs1)?;
    let tangents: Vec<Vec4> = bulk.take(head.tangents)?;
    let triangles: Vec<[u32; 3]> = bulk.take(head.triangles)?;
    let materials: Vec<u32> = bulk.take(head.triangles)?;
    let objects: Vec<u32> = bulk.take(head.triangles)?;
    let last = triangles.as_flattened().iter().copied().max();
    if last.is_some_and(|last| last as usize >= head.vertices) || !positions.iter().all(|p| p.is_finite()) {
        return None;
    }
    let materials = materials.into_iter().map(MaterialId).collect();
    Some(Mesh { positions, normals, uvs, uvs1, tangents, triangles, materials, objects })
}

/// Objects with the triangles that the mesh says are theirs.
fn objects(heads: Vec<ObjectHead>, mesh: &Mesh, materials: usize) -> Option<Vec<Object>> {
    let mut counts = vec![0usize; heads.len()];
    for &object in &mesh.objects {
        *counts.get_mut(object as usize)? += 1;
    }
    let mut objects = Vec::with_capacity(heads.len());
    for (o, count) in heads.iter().zip(counts) {
        let parent_is_known = o.parent.is_none_or(|parent| (parent as usize) < heads.len());
        if !parent_is_known || o.material.0 as usize >= materials {
            return None;
        }
        objects.push(Object {
            name: o.name.clone(),
            material: o.material,
            triangles: Vec::with_capacity(count),
            bounds: o.bounds,
            area: o.area,
            parent: o.parent,
        });
    }
    for (t, &object) in mesh.objects.iter().enumerate() {
        objects[object as usize].triangles.push(t as u32);
    }
    Some(objects)
}
