//! The shown scene of a document: things, lights and cameras where their nodes put them, each with what it needs.

use std::borrow::Cow;
use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};
use std::rc::Rc;

use glam::{DMat4, Vec2, Vec4};

use super::super::obj::Run;
use super::accessor::Accessors;
use super::animation::{self, Motion, Moved};
use super::buffers::Buffers;
use super::document::{self, Document, Instancing, Primitive};
use super::meshes::{self, Part, Stands};
use super::number::Index;
use super::paths::{Above, named};
use super::pictures::{Coordinates, Pictures};
use super::tangents::{self, Along};
use super::{Choices, GltfFile, Oddities, Problem, get, image_based, lights, materials, nodes, skins};
use foveal::scene::camera::PathKey;
use foveal::scene::{CameraPath, NamedCamera};

/// Things that are drawn: nodes with a mesh, and instances of them.
const INSTANCES_MAX: usize = 1 << 22;

/// Reads what a document shows.
pub(super) struct Reader<'d, 'o> {
    document: &'d Document,
    choices: &'d Choices,
    triangles_max: usize,
    variant: Option<u32>,
    odd: &'o mut Oddities,
    out: GltfFile,
    /// Names of materials so far.
    names: HashSet<String>,
    /// Slot of a material of the document, times a colour, on an open mesh or another; `u32::MAX` is the one of what has
    /// none.
    material_of: HashMap<(u32, [u8; 4], bool), u32>,
    /// Of each slot.
    coordinates: Vec<Coordinates>,
    /// Parts with tangents that were made, by mesh, primitive, colour and slot.
    dressed: HashMap<(u32, usize, meshes::Shade, u32), Rc<Part>>,
    pictures: Pictures<'d>,
}

impl<'d, 'o> Reader<'d, 'o> {
    /// For a document that makes at most so many triangles.
    pub fn new(
        document: &'d Document,
        choices: &'d Choices,
        triangles_max: usize,
        odd: &'o mut Oddities,
    ) -> Self {
        Self {
            document,
            choices,
            triangles_max,
            variant: None,
            odd,
            out: GltfFile::default(),
            names: HashSet::new(),
            material_of: HashMap::new(),
            coordinates: Vec::new(),
            dressed: HashMap::new(),
            pictures: Pictures::new(document),
        }
    }

    /// What is shown.
    pub fn read(mut self, buffers: &mut Buffers<'d>) -> Result<GltfFile, Problem> {
        self.read_scene(buffers)?;
        Ok(self.out)
    }

    fn read_scene(&mut self, buffers: &mut Buffers<'d>) -> Result<(), Problem> {
        let document = self.document;
        self.choose_variant();
        let every: Vec<Index>;
        let roots: &[Index] = match self.scene()? {
            Some(scene) => {
                let scene = get(&document.scenes, scene, "scenes")?;
                if let Some(of) = &scene.extensions.image_based {
                    self.out.cube_map =
                        image_based::read(document, of.light, &self.pictures, buffers, self.odd)?;
                }
                &scene.nodes
            }
            None => {
                every = (0..document.nodes.len() as u32).map(Index).collect();
                &every
            }
        };
        let motion = match animation::chosen(document, self.choices.play.as_deref(), self.odd) {
            None => Motion::default(),
            Some(animation) => animation::read(animation, document, buffers, self.odd)?,
        };
        let time = self.choices.time;
        let placed = nodes::placed(document, roots, |n| time.map_or(Moved::default(), |t| motion.at(n, t)))?;
        if !document.animations.is_empty() && time.is_none() {
            self.odd.count("animation", "not played; things stand as they do before it begins");
        }
        let mut viewers: Vec<(usize, String)> = Vec::new();
        let mut worlds = vec![None; if document.skins.is_empty() { 0 } else { document.nodes.len() }];
        if !worlds.is_empty() {
            placed.iter().for_each(|p| worlds[p.node] = Some(p.world));
        }
        let mut parts: HashMap<u32, Vec<Option<Part>>> = HashMap::new();
        let mut things = 0usize;
        let mut above = Above::new(document);
        for p in &placed {
            let node = &document.nodes[p.node];
            let parent = above.thing_of(p.node);
            if let Some(camera) = node.camera {
                let camera = get(&document.cameras, camera, "cameras")?;
                if let Some(view) = lights::camera(camera, &p.world, self.odd) {
                    let name =
                        node.name.as_deref().or(camera.name.as_deref()).map_or_else(String::new, named);
                    viewers.extend(self.add_camera(name, view).map(|name| (p.node, name)));
                }
            }
            let extensions = node.extensions.as_deref();
            if let (Some(light), Some(all)) =
                (extensions.and_then(|e| e.light.as_ref()), &document.extensions.lights)
            {
                let light = get(&all.lights, light.light, "extensions/KHR_lights_punctual/lights")?;
                self.out.lights.extend(lights::light(light, &p.world, self.choices.light_scale, self.odd));
            }
            let Some(index) = node.mesh else { continue };
            let mesh = get(&document.meshes, index, "meshes")?;
            let instances = match extensions.and_then(|e| e.instancing.as_ref()) {
                None => vec![p.world],
                Some(of) => instances(of, &p.world, document, buffers)?,
            };
            things = things.saturating_add(instances.len());
            if things > INSTANCES_MAX {
                let message = format!("is one more than {INSTANCES_MAX} things to draw; split the file");
                return Err(Problem::new(format!("/nodes/{}", p.node), message));
            }
            let name = node.name.as_deref().or(mesh.name.as_deref());
            let name = name.map_or_else(|| format!("node {}", p.node), named);
            let name_index = self.out.mesh.names.len() as u32;
            let path = above.path(document, p.node, &name);
            if extensions.is_some_and(|e| e.instancing.is_some()) {
                // Each of them is a thing of its own.
                for i in 0..instances.len() {
                    self.out.mesh.names.push(format!("{name}[{i}]"));
                    self.out.mesh.paths.push((format!("{path}[{i}]"), parent));
                }
            } else {
                self.out.mesh.names.push(name);
                self.out.mesh.paths.push((path, parent));
                above.is(p.node, name_index);
            }
            let read = match parts.entry(index.0) {
                Entry::Occupied(known) => known.into_mut(),
                Entry::Vacant(place) => {
                    let mut accessors = Accessors::new(document, buffers);
                    let read: Result<Vec<_>, Problem> =
                        mesh.primitives.iter().map(|q| meshes::read(q, &mut accessors, self.odd)).collect();
                    place.insert(read?)
                }
            };
            let weights: &[f32] = if node.weights.is_empty() { &mesh.weights } else { &node.weights };
            let played = time.and_then(|t| motion.weights(p.node, t));
            let weights = played.as_deref().unwrap_or(weights);
            let joints = match node.skin {
                None => None,
                Some(skin) => {
                    let skin = get(&document.skins, skin, "skins")?;
                    skins::joints(skin, document, &worlds, &mut Accessors::new(document, buffers), self.odd)?
                }
            };
            for (number, (primitive, part)) in mesh.primitives.iter().zip(read.iter()).enumerate() {
                let Some(part) = part else { continue };
                let mut accessors = Accessors::new(document, buffers);
                let mut part = Cow::Borrowed(part);
                if !primitive.targets.is_empty() && weights.iter().any(|w| *w != 0.0) {
                    skins::morph(part.to_mut(), primitive, weights, &mut accessors, self.odd)?;
                }
                let mut stands = instances.as_slice();
                let moved = match &joints {
                    None => None,
                    Some(joints) => skins::skinned(&part, primitive, joints, &mut accessors, self.odd)?,
                };
                if let Some(moved) = moved {
                    // Joints put it into the world; where its own node is does not matter.
                    (part, stands) = (Cow::Owned(moved), &[DMat4::IDENTITY]);
                }
                let is_shared = matches!(part, Cow::Borrowed(_));
                for (color, part) in part.shades() {
                    let slot = self.material(primitive, color, &part, buffers)?;
                    let along = self.coordinates[slot as usize].along.filter(|_| part.tangents.is_empty());
                    let key = is_shared.then_some((index.0, number, color, slot));
                    let dressed = along.and_then(|along| self.dressed(&part, along, key));
                    let part = dressed.as_deref().unwrap_or(&part);
                    // The inside of a body glows for nobody.
                    let has_back = self.out.materials[slot as usize].glows_behind && part.is_open();
                    for (name, world) in (name_index..).zip(stands) {
                        let mut added = self.add(part, world, slot, name);
                        if has_back && let Some(back) = part.back(world) {
                            added = added.and_then(|()| self.add(&back, &DMat4::IDENTITY, slot, name));
                        }
                        added.map_err(|message| Problem::new(format!("/nodes/{}", p.node), message))?;
                    }
                }
            }
        }
        self.add_paths(&viewers, &motion)
    }

    /// Adds the paths of cameras that move.
    fn add_paths(&mut self, viewers: &[(usize, String)], motion: &Motion) -> Result<(), Problem> {
        let document = self.document;
        let chains = nodes::chains(document, &viewers.iter().map(|v| v.0).collect::<Vec<_>>());
        for ((node, name), chain) in viewers.iter().zip(chains) {
            let moving: Vec<usize> = chain.iter().copied().filter(|&n| motion.moves(n)).collect();
            let Some(camera) = document.nodes[*node].camera.filter(|_| !moving.is_empty()) else { continue };
            let camera = get(&document.cameras, camera, "cameras")?;
            let mut unheard = Oddities::default();
            let keys: Vec<PathKey> = motion
                .moments(&moving, self.odd)
                .into_iter()
                .filter_map(|t| {
                    let world = nodes::world(document, &chain, |n| motion.at(n, t));
                    let view = lights::camera(camera, &world, &mut unheard)?;
                    Some(PathKey { t, eye: view.eye, target: view.target })
                })
                .collect();
            if !keys.is_empty() {
                self.out.paths.push(CameraPath { name: name.clone(), keys });
            }
        }
        Ok(())
    }

    /// The scene to show; `None` where the document has none, and all nodes are.
    fn scene(&mut self) -> Result<Option<Index>, Problem> {
        let document = self.document;
        if let Some(wanted) = &self.choices.scene {
            let found = document.scenes.iter().position(|s| s.name.as_ref() == Some(wanted));
            if let Some(i) = found {
                return Ok(Some(Index(i as u32)));
            }
            self.odd
                .count(&format!("scene \"{wanted}\" of the sidecar"), "not in the file; its own is shown");
        }
        match document.scene {
            Some(scene) => get(&document.scenes, scene, "scenes").map(|_| Some(scene)),
            None if document.scenes.is_empty() => Ok(None),
            None => Ok(Some(Index(0))),
        }
    }

    fn choose_variant(&mut self) {
        let Some(wanted) = &self.choices.variant else { return };
        let all = self.document.extensions.variants.as_ref();
        let found = all.and_then(|v| v.variants.iter().position(|v| v.name == *wanted));
        self.variant = found.map(|i| i as u32);
        if found.is_none() {
            let names: Vec<&str> =
                all.map_or(Vec::new(), |v| v.variants.iter().take(16).map(|v| v.name.as_str()).collect());
            let what = format!("variant \"{wanted}\" (there are: {})", names.join(", "));
            self.odd.count(&what, "not in the file; shown without");
        }
    }

    /// Adds a camera; returns the name that it has got.
    fn add_camera(&mut self, name: String, camera: foveal::scene::Camera) -> Option<String> {
        let name = if name.is_empty() { "camera".to_owned() } else { name };
        let taken = |n: &str| self.out.cameras.iter().any(|c| c.name == n);
        // A document of a million cameras is no reason to look long for a name.
        if self.out.cameras.len() >= 1024 {
            self.odd.count("a camera beyond the first 1024", "left out");
            return None;
        }
        let unique = (2..).map(|n| format!("{name} ({n})"));
        let name = std::iter::once(name.clone()).chain(unique).find(|n| !taken(n)).unwrap_or(name);
        self.out.cameras.push(NamedCamera { name: name.clone(), camera });
        Some(name)
    }

    /// The slot of the material of a primitive.
    fn material(
        &mut self,
        primitive: &Primitive,
        color: [u8; 4],
        part: &Part,
        buffers: &mut Buffers<'d>,
    ) -> Result<u32, Problem> {
        let mapped = self.variant.and_then(|variant| {
            let all = primitive.extensions.variants.as_ref()?;
            all.mappings.iter().find(|m| m.variants.contains(&Index(variant))).map(|m| m.material)
        });
        let index = mapped.or(primitive.material);
        let default = document::Material::default();
        let material = match index {
            None => &default,
            Some(i) => get(&self.document.materials, i, "materials")?,
        };
        let is_open = material.extensions.volume.is_some() && part.is_open();
        let key = (index.map_or(u32::MAX, |i| i.0), color, is_open);
        if let Some(&slot) = self.material_of.get(&key) {
            return Ok(slot);
        }
        let plain = material.name.as_deref().map_or_else(String::new, named);
        let plain = match (plain.is_empty(), index) {
            (false, _) => plain,
            (true, Some(i)) => format!("material {}", i.0),
            (true, None) => "default".to_owned(),
        };
        let mut name = plain.clone();
        if !self.names.insert(name.clone()) {
            name = format!("{plain} #{}", self.out.materials.len());
            self.names.insert(name.clone());
        }
        let (mut source, coordinates) = materials::read(
            material,
            name.clone(),
            is_open,
            self.choices,
            &mut self.pictures,
            buffers,
            self.odd,
        )?;
        let [r, g, b, opacity] = color.map(|v| f32::from(v) / 255.0);
        source.base *= glam::Vec3::new(r, g, b);
        source.base_alpha *= opacity;
        let slot = self.out.materials.len() as u32;
        self.out.materials.push(source);
        self.coordinates.push(coordinates);
        self.out.mesh.materials.push((name, 0));
        self.material_of.insert(key, slot);
        Ok(slot)
    }

    /// A part with tangents, made once for all that is drawn of it.
    fn dressed(
        &mut self,
        part: &Part,
        along: Along,
        key: Option<(u32, usize, meshes::Shade, u32)>,
    ) -> Option<Rc<Part>> {
        if let Some(known) = key.and_then(|key| self.dressed.get(&key)) {
            return Some(known.clone());
        }
        let made = Rc::new(tangents::with_tangents(part, along)?);
        if let Some(key) = key {
            self.dressed.insert(key, made.clone());
        }
        Some(made)
    }

    /// Adds a part where an instance puts it.
    fn add(&mut self, part: &Part, world: &DMat4, slot: u32, name: u32) -> Result<(), String> {
        let mesh = &mut self.out.mesh;
        let all = mesh.triangles.len() + part.triangles.len();
        let vertices = mesh.positions.len() + part.positions.len();
        if all > self.triangles_max || vertices > 3 * self.triangles_max {
            return Err(format!(
                "makes more than {} triangles of the scene; split the file",
                self.triangles_max
            ));
        }
        let Some(Stands { positions, normals, tangents, turned }) = part.placed(world) else {
            self.odd.count("a thing whose transform leaves no volume", "left out");
            return Ok(());
        };
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(positions);
        mesh.normals.extend(normals);
        let coordinates = self.coordinates[slot as usize];
        let set = &part.uvs[coordinates.set];
        let moved = |uv: Vec2| match coordinates.moved {
            None => uv,
            Some((linear, offset)) => meshes::finite(linear * uv + offset),
        };
        // From the upper left to the lower left.
        mesh.uvs.extend(set.iter().map(|&uv| moved(uv)).map(|uv| Vec2::new(uv.x, 1.0 - uv.y)));
        mesh.uvs.resize(mesh.positions.len(), Vec2::ZERO);
        if coordinates.both || !mesh.uvs1.is_empty() {
            mesh.uvs1.resize(first as usize, Vec2::ZERO);
            let other = if coordinates.both { &part.uvs[1 - coordinates.set][..] } else { &[] };
            mesh.uvs1.extend(other.iter().map(|uv| Vec2::new(uv.x, 1.0 - uv.y)));
            mesh.uvs1.resize(mesh.positions.len(), Vec2::ZERO);
        }
        if coordinates.along.is_some() && !tangents.is_empty() || !mesh.tangents.is_empty() {
            mesh.tangents.resize(first as usize, Vec4::ZERO);
            mesh.tangents.extend(tangents.into_iter().filter(|_| coordinates.along.is_some()));
            mesh.tangents.resize(mesh.positions.len(), Vec4::ZERO);
        }
        mesh.runs.push(Run { first: mesh.triangles.len(), name, material: Some(slot) });
        mesh.triangles.extend(part.triangles.iter().map(|&[a, b, c]| {
            if turned { [first + a, first + c, first + b] } else { [first + a, first + b, first + c] }
        }));
        Ok(())
    }
}

/// Where the instances of a node stand (`EXT_mesh_gpu_instancing`).
fn instances<'d>(
    of: &Instancing,
    world: &DMat4,
    document: &'d Document,
    buffers: &mut Buffers<'d>,
) -> Result<Vec<DMat4>, Problem> {
    let a = &of.attributes;
    let mut accessors = Accessors::new(document, buffers);
    let mut count = None;
    for index in [a.translation, a.rotation, a.scale].into_iter().flatten() {
        let n = accessors.count(index)?;
        if n > INSTANCES_MAX as u64 || count.is_some_and(|c| c != n) {
            let message = format!("has {n} instances, others more or fewer, or more than {INSTANCES_MAX}");
            return Err(Problem::new(format!("/accessors/{}/count", index.0), message));
        }
        count = Some(n);
    }
    let translations = a.translation.map(|i| accessors.floats::<3>(i, "translations")).transpose()?;
    let rotations = a.rotation.map(|i| accessors.floats::<4>(i, "rotations")).transpose()?;
    let scales = a.scale.map(|i| accessors.floats::<3>(i, "scales")).transpose()?;
    let at = |i: usize| {
        let translation = translations.as_ref().map_or([0.0; 3], |t| t[i]);
        let rotation = rotations.as_ref().map_or([0.0, 0.0, 0.0, 1.0], |r| r[i]);
        let scale = scales.as_ref().map_or([1.0; 3], |s| s[i]);
        *world * nodes::transform(translation, rotation, scale)
    };
    Ok((0..count.unwrap_or(1) as usize).map(at).collect())
}
