//! Scene and illumination as plain arrays, in the order in which they are drawn.
//!
//! Triangles are sorted by the textures they need, then along a space-filling curve, and a tree of
//! bounds stands over each run of them: [`BaseGeometry::visible`] cuts whatever lies outside the
//! picture off near the root.

use bytemuck::{Pod, Zeroable};
use foveal::illumination::stored::Illumination;
use foveal::illumination::{Irradiance, atlas::Corners};
use foveal::scene::camera::CameraFrame;
use foveal::scene::{Mesh, Placement, Reflectance, Scene, TextureId, Wrap};
use glam::Vec3;

/// Triangles under one leaf of the tree.
const LEAF_TRIANGLES: usize = 128;
/// Triangles under a node within the picture that are drawn in one go, near to far or not.
const SORTED_TRIANGLES: usize = 1024;
/// Irradiance at texels of the lightmap, in [`TriangleRecord::light_kind`].
const LIGHT_TEXELS: u32 = 0;
/// Irradiance at three elements.
const LIGHT_ELEMENTS: u32 = 1;

/// A triangle as `base.wgsl` reads it: [`TRIANGLE_TEXELS`] texels of four words.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct TriangleRecord {
    /// First corner.
    pub a: [f32; 3],
    /// Object id.
    pub object: u32,
    /// Second corner.
    pub b: [f32; 3],
    /// Index of its material.
    pub material: u32,
    /// Third corner.
    pub c: [f32; 3],
    /// How `light` is meant.
    pub light_kind: u32,
    /// Texel coordinates in the lightmap; or the bits of element indices, each with a zero.
    pub light: [[f32; 2]; 3],
    /// Texture coordinates per scene unit.
    pub uv_density: f32,
    /// Its index in the scene.
    pub triangle: u32,
    /// Texture coordinates of the corners, origin at the lower left.
    pub uvs: [[f32; 2]; 3],
    /// To align the record.
    pub padding: [u32; 2],
}

/// Texels of a [`TriangleRecord`].
pub const TRIANGLE_TEXELS: usize = size_of::<TriangleRecord>() / 16;
/// Texels in a row of the textures that hold records and light, as in `base.wgsl`.
pub const ROW: usize = 4096;

/// Whether the passes show all of a scene's surfaces: not those whose maps lie on a second set of coordinates, are turned,
/// or are read point by point. The processor draws these.
pub fn shows(scene: &Scene) -> bool {
    let plain = |t: &foveal::scene::Texture| {
        let wrap = t.placement.wrap;
        let p = Placement { scale_offset: t.placement.scale_offset, wrap, ..Placement::default() };
        t.placement == p && wrap[0] == wrap[1] && wrap[0] != Wrap::Mirror
    };
    scene.textures.iter().all(plain) && scene.materials.iter().all(|m| m.model.recipe().is_none())
}

/// Rows of the largest texture that a scene's geometry is bound as.
pub fn most_rows(scene: &Scene) -> usize {
    (scene.mesh.triangles.len() * TRIANGLE_TEXELS).div_ceil(ROW)
}

/// A material as `base.wgsl` reads it: its `MATERIAL_TEXELS` texels of four words.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct MaterialRecord {
    /// Factor of the albedo's texture; without one, and without any other, the whole of what is reflected.
    pub albedo: [f32; 3],
    /// Bit 0: the back reflects too; bit 1: opacity is the texture's alpha, not its grey; then whether there are
    /// textures of albedo, emission and opacity.
    pub flags: u32,
    /// Factor of the emission's texture.
    pub emission: [f32; 3],
    /// Id of the texture that shows most of it, `u32::MAX` for none.
    pub picture: u32,
    /// What a coat lets in and out, and what it sends back to the base: 1 and 0 without coat.
    pub coat: [f32; 2],
    /// Cut-out opacity.
    pub opacity: f32,
    /// To align the record.
    pub padding: u32,
    /// Scale and offset of the coordinates of the three textures: albedo, emission, opacity.
    pub scale_offset: [[f32; 4]; 3],
    /// Of these textures and of the picture: texels of level 0 per texture coordinate, the finest level that is held, and
    /// two zeros.
    pub texels: [[f32; 4]; 4],
}

/// The textures a draw needs: albedo, emission, opacity.
pub type TextureSet = [Option<TextureId>; 3];

/// A node of a tree of bounds, in depth-first order.
#[derive(Clone, Copy, Debug)]
struct Node {
    min: Vec3,
    max: Vec3,
    /// Triangles below it, in draw order.
    first: u32,
    count: u32,
    /// The node after its subtree.
    skip: u32,
}

/// A run of triangles that share textures.
#[derive(Clone, Debug)]
pub struct Run {
    /// The textures.
    pub textures: TextureSet,
    /// Whether pixels of it may be left out, which only the shader knows; then none can be tested by depth before.
    pub masked: bool,
    /// Whether its colour depends on textures, or pixels want a mip level of one.
    pub textured: bool,
    /// First triangle in draw order.
    pub first: u32,
    /// The triangle after its last.
    pub end: u32,
    nodes: Vec<Node>,
}

/// Everything about a scene that the base pass draws, but its light.
#[derive(Clone, Debug, Default)]
pub struct BaseGeometry {
    /// Triangles in draw order.
    pub triangles: Vec<TriangleRecord>,
    /// Runs of triangles, one draw call or more each.
    pub runs: Vec<Run>,
}

/// Irradiance at elements of the surface, front and back.
#[derive(Clone, Debug, Default)]
pub struct BaseLight {
    /// Columns and rows of the lightmap, whose texels are the first elements.
    pub lightmap: [u32; 2],
    /// Per triangle of the scene, where its light is.
    pub corners: Vec<Corners>,
    /// Irradiance on the front, per element.
    pub front: Vec<[f32; 3]>,
    /// Irradiance on the back, per element; empty where all backs are dark.
    pub back: Vec<[f32; 3]>,
}

impl BaseLight {
    /// What `illumination` knows: its own elements where it has some, else its values at the corners
    /// of each triangle.
    pub fn new(mesh: &Mesh, illumination: &dyn Irradiance) -> Self {
        let total = |stored: &Illumination, back: bool| {
            (0..stored.element_count()).map(|e| stored.total(e, back).truncate().to_array()).collect()
        };
        let mut light = match illumination.stored() {
            Some(stored) if stored.triangle_count() == mesh.triangles.len() => Self {
                lightmap: stored.lightmap_size(),
                corners: stored.corners().to_vec(),
                // Named lights as well: adapters do not ask for them pixel by pixel.
                front: total(stored, false),
                back: total(stored, true),
            },
            _ => {
                let at_corners = |back: bool| {
                    let corner = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)];
                    (0..mesh.triangles.len() as u32)
                        .flat_map(|t| {
                            corner.map(|(b1, b2)| illumination.irradiance(t, b1, b2, back).to_array())
                        })
                        .collect()
                };
                Self {
                    lightmap: [0, 0],
                    corners: (0..mesh.triangles.len() as u32)
                        .map(|t| Corners::Vertices([3 * t, 3 * t + 1, 3 * t + 2]))
                        .collect(),
                    front: at_corners(false),
                    back: at_corners(true),
                }
            }
        };
        if light.back.iter().flatten().all(|v| *v == 0.0) {
            light.back = Vec::new();
        }
        light
    }
}

impl BaseGeometry {
    /// The scene's triangles under `light`'s layout.
    pub fn new(scene: &Scene, light: &BaseLight) -> Self {
        let mesh = &scene.mesh;
        let sets: Vec<(bool, bool, TextureSet)> = scene
            .materials
            .iter()
            .map(|m| {
                let set = texture_set(m);
                let textured = m.picture().is_some() || set[..2].iter().any(Option::is_some);
                (is_masked(m), textured, set)
            })
            .collect();
        let mut distinct = sets.clone();
        distinct.sort();
        distinct.dedup();
        let mut order: Vec<(u32, u32, u32)> = (0..mesh.triangles.len() as u32)
            .map(|t| {
                let set = sets[mesh.materials[t as usize].0 as usize];
                let run = distinct.partition_point(|s| *s < set) as u32;
                (run, morton(centroid(mesh, t), scene.bounds), t)
            })
            .collect();
        order.sort_unstable();
        let drawn: Vec<u32> = order.iter().map(|o| o.2).collect();
        let mut runs = Vec::new();
        let mut start = 0;
        for (index, (masked, textured, textures)) in distinct.iter().enumerate() {
            let end = order.partition_point(|o| o.0 <= index as u32);
            if end > start {
                let mut nodes = Vec::new();
                build_tree(mesh, &drawn, start, end, &mut nodes);
                runs.push(Run {
                    textures: *textures,
                    masked: *masked,
                    textured: *textured,
                    first: start as u32,
                    end: end as u32,
                    nodes,
                });
            }
            start = end;
        }
        Self { triangles: drawn.iter().map(|&t| triangle_record(mesh, light, t)).collect(), runs }
    }

    /// Calls `draw` with each run and ranges of its triangles that may be in the picture, roughly from near to far, so
    /// that most of what is hidden is never shaded.
    pub fn visible(&self, frame: &CameraFrame, mut draw: impl FnMut(usize, std::ops::Range<u32>)) {
        // Inward normals of the four sides through the eye: |x| ≤ depth and |y| ≤ depth.
        let (x, y) = (frame.right / frame.right.length_squared(), frame.up / frame.up.length_squared());
        let planes =
            [frame.forward - x, frame.forward + x, frame.forward - y, frame.forward + y, frame.forward];
        let mut stack = Vec::new();
        for (index, run) in self.runs.iter().enumerate() {
            let mut pending: Option<std::ops::Range<u32>> = None;
            stack.push((0, false));
            while let Some((i, is_inside)) = stack.pop() {
                let node = &run.nodes[i];
                let place = if is_inside { Place::Inside } else { place(node, frame.eye, &planes) };
                let is_leaf = node.skip as usize == i + 1;
                if place == Place::Outside {
                    continue;
                }
                if is_leaf || place == Place::Inside && node.count as usize <= SORTED_TRIANGLES {
                    let range = node.first..node.first + node.count;
                    match &mut pending {
                        Some(p) if p.end == range.start => p.end = range.end,
                        Some(p) if range.end == p.start => p.start = range.start,
                        _ => {
                            if let Some(p) = pending.replace(range) {
                                draw(index, p);
                            }
                        }
                    }
                    continue;
                }
                let [near, far] = run.children(i, frame);
                stack.push((far, place == Place::Inside));
                stack.push((near, place == Place::Inside));
            }
            if let Some(p) = pending {
                draw(index, p);
            }
        }
    }
}

impl Run {
    /// The children of an inner node, the nearer first.
    fn children(&self, node: usize, frame: &CameraFrame) -> [usize; 2] {
        let (a, b) = (node + 1, self.nodes[node + 1].skip as usize);
        let depth = |i: usize| (self.nodes[i].min + self.nodes[i].max).dot(frame.forward);
        if depth(a) <= depth(b) { [a, b] } else { [b, a] }
    }
}

/// Where a box lies to the view's pyramid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    Outside,
    Across,
    Inside,
}

fn place(node: &Node, eye: Vec3, planes: &[Vec3]) -> Place {
    let (center, half) = ((node.min + node.max) * 0.5 - eye, (node.max - node.min) * 0.5);
    let mut inside = true;
    for normal in planes {
        let (distance, reach) = (center.dot(*normal), half.dot(normal.abs()));
        // A little slack, since the vertex shader rounds in another order.
        let slack = 1e-5 * (center.abs().dot(normal.abs()) + reach);
        if distance + reach < -slack {
            return Place::Outside;
        }
        inside &= distance - reach > slack;
    }
    if inside { Place::Inside } else { Place::Across }
}

fn build_tree(mesh: &Mesh, drawn: &[u32], start: usize, end: usize, nodes: &mut Vec<Node>) {
    let index = nodes.len();
    let (first, count) = (start as u32, (end - start) as u32);
    nodes.push(Node { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY, first, count, skip: 0 });
    let (mut min, mut max) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    if end - start <= LEAF_TRIANGLES {
        for p in drawn[start..end].iter().flat_map(|&t| mesh.corners(t)) {
            (min, max) = (min.min(p), max.max(p));
        }
    } else {
        let middle = start + (end - start) / 2;
        for (a, b) in [(start, middle), (middle, end)] {
            let child = nodes.len();
            build_tree(mesh, drawn, a, b, nodes);
            (min, max) = (min.min(nodes[child].min), max.max(nodes[child].max));
        }
    }
    let skip = nodes.len() as u32;
    nodes[index] = Node { min, max, skip, ..nodes[index] };
}

fn centroid(mesh: &Mesh, triangle: u32) -> Vec3 {
    let [a, b, c] = mesh.corners(triangle);
    (a + b + c) / 3.0
}

/// Place along the Z-shaped curve through `bounds`, 10 bits per axis.
fn morton(point: Vec3, bounds: [Vec3; 2]) -> u32 {
    let extent = (bounds[1] - bounds[0]).max(Vec3::splat(f32::MIN_POSITIVE));
    let spread = |v: f32| {
        // The cast saturates and sends NaN to 0.
        let mut v = ((v * 1024.0) as u32).min(1023);
        for (shift, mask) in [(16, 0x0300_00ff), (8, 0x0300_f00f), (4, 0x030c_30c3), (2, 0x0924_9249)] {
            v = (v | (v << shift)) & mask;
        }
        v
    };
    let p = (point - bounds[0]) / extent;
    spread(p.x) | (spread(p.y) << 1) | (spread(p.z) << 2)
}

/// Whether the shader leaves out pixels of a material: as it asks there.
fn is_masked(material: &foveal::scene::Material) -> bool {
    material.opacity_map.is_some() || material.opacity < 0.5 || material.culled
}

fn texture_set(material: &foveal::scene::Material) -> TextureSet {
    [diffuse(material).albedo.map, material.emission.map, material.opacity_map]
}

fn triangle_record(mesh: &Mesh, light: &BaseLight, t: u32) -> TriangleRecord {
    let i = t as usize;
    let element = |e: u32| [f32::from_bits(e), 0.0];
    let [a, b, c] = mesh.corners(t).map(|p| p.to_array());
    let (light_kind, corners) = match light.corners.get(i) {
        Some(Corners::Texels(uv)) => (LIGHT_TEXELS, uv.map(|p| p.to_array())),
        Some(Corners::Vertices(v)) => (LIGHT_ELEMENTS, v.map(element)),
        None => (LIGHT_ELEMENTS, [element(0); 3]),
    };
    TriangleRecord {
        a,
        object: mesh.objects[i],
        b,
        material: mesh.materials[i].0,
        c,
        light_kind,
        light: corners,
        uv_density: uv_density(mesh, i),
        triangle: t,
        uvs: mesh.triangles[i].map(|v| mesh.uvs[v as usize].to_array()),
        padding: [0; 2],
    }
}

/// The CPU pass is `Interaction::uv_density`.
fn uv_density(mesh: &Mesh, triangle: usize) -> f32 {
    let [a, b, c] = mesh.corners(triangle as u32);
    let [ta, tb, tc] = mesh.triangles[triangle].map(|v| mesh.uvs[v as usize]);
    let doubled_area = (b - a).cross(c - a).length();
    let density = ((tb - ta).perp_dot(tc - ta).abs() / doubled_area).sqrt();
    if density.is_finite() { density } else { 0.0 }
}

/// What the view-independent part of a material's reflection is made of.
struct Diffuse {
    albedo: Reflectance,
    /// What a coat lets in and out, and what it sends back to the base.
    coat: [f32; 2],
}

/// The CPU pass is the diffuse part in `foveal::transport::bsdf`.
fn diffuse(material: &foveal::scene::Material) -> Diffuse {
    use foveal::scene::Model;
    let bare = |albedo| Diffuse { albedo, coat: [1.0, 0.0] };
    match &material.model {
        Model::Lambert { albedo } => bare(*albedo),
        Model::CookTorrance { diffuse, .. } | Model::Ward { diffuse, .. } => bare(*diffuse),
        Model::MetalRough(m) => bare(m.diffuse),
        Model::Plastic { albedo, coat } => {
            Diffuse { albedo: *albedo, coat: [coat.in_and_out(), coat.back()] }
        }
        Model::Mirror { .. } | Model::Conductor { .. } | Model::Metal { .. } | Model::Dielectric { .. } => {
            bare(Reflectance::constant(Vec3::ZERO))
        }
    }
}

/// A scene's materials, where the adapter holds of each texture the levels from `firsts` on.
pub fn materials(scene: &Scene, firsts: &[usize]) -> Vec<MaterialRecord> {
    scene.materials.iter().map(|m| material_record(scene, firsts, m)).collect()
}

fn material_record(scene: &Scene, firsts: &[usize], material: &foveal::scene::Material) -> MaterialRecord {
    let (maps, diffuse) = (texture_set(material), diffuse(material));
    let texture = |map: Option<TextureId>| map.and_then(|id| scene.textures.get(id.0 as usize));
    let alpha = texture(maps[2]).is_some_and(|t| t.has_alpha);
    let mut flags = u32::from(material.two_sided) | (u32::from(alpha) << 1);
    flags |= u32::from(material.shadeless) << 5 | u32::from(material.culled) << 6;
    for (i, map) in maps.iter().enumerate() {
        flags |= u32::from(map.is_some()) << (2 + i);
    }
    let (mut albedo, mut coat) = (diffuse.albedo.color, diffuse.coat);
    if maps[0].is_none() {
        albedo = albedo.clamp(Vec3::ZERO, Vec3::ONE);
        albedo *= coat[0] / (Vec3::ONE - albedo * coat[1]);
        coat = [1.0, 0.0];
    }
    MaterialRecord {
        albedo: albedo.to_array(),
        flags,
        emission: material.emission.color.to_array(),
        picture: material.picture().map_or(u32::MAX, |id| id.0),
        coat,
        opacity: material.opacity,
        padding: 0,
        scale_offset: maps.map(|m| texture(m).map_or([1.0, 1.0, 0.0, 0.0], |t| t.placement.scale_offset)),
        texels: [maps[0], maps[1], maps[2], material.picture()].map(|map| match (map, texture(map)) {
            (Some(id), Some(t)) => {
                let [width, height] = t.size(0);
                let first = firsts.get(id.0 as usize).copied().unwrap_or_default();
                [width.max(height) as f32 * t.placement.density(), first as f32, 0.0, 0.0]
            }
            _ => [0.0; 4],
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::test_scene;
    use foveal::illumination::Uniform;
    use foveal::scene::Camera;

    #[test]
    fn every_triangle_is_drawn_once_and_those_in_the_picture_are_visible() {
        let scene = test_scene::room(40);
        let light = BaseLight::new(&scene.mesh, &Uniform(Vec3::ONE));
        let geometry = BaseGeometry::new(&scene, &light);
        let mut seen: Vec<u32> = geometry.triangles.iter().map(|t| t.triangle).collect();
        seen.sort_unstable();
        assert!(
            seen.iter().enumerate().all(|(i, t)| i as u32 == *t) && seen.len() == scene.mesh.triangles.len()
        );
        for (turn, eye) in [(0.0f32, Vec3::ZERO), (1.0, Vec3::ONE * 0.5), (2.5, Vec3::new(0.0, -0.7, 0.9))] {
            let camera =
                Camera { eye, target: eye + Vec3::new(turn.sin(), 0.2, turn.cos()), up: Vec3::Y, fov_y: 0.8 };
            let frame = camera.frame(64, 48);
            let mut drawn = vec![false; geometry.triangles.len()];
            geometry.visible(&frame, |_, range| {
                for i in range {
                    assert!(!std::mem::replace(&mut drawn[i as usize], true), "drawn twice");
                }
            });
            for (record, drawn) in geometry.triangles.iter().zip(&drawn) {
                let projected = scene.mesh.corners(record.triangle).map(|p| frame.project(p));
                let inside = |p: &Option<(f32, f32, f32)>| {
                    p.is_some_and(|(x, y, _)| x > 0.0 && y > 0.0 && x < 64.0 && y < 48.0)
                };
                assert!(*drawn || !projected.iter().any(inside), "a visible triangle was cut off");
            }
            let count = drawn.iter().filter(|d| **d).count();
            assert!(count * 2 < drawn.len(), "culling left {count} of {}", drawn.len());
        }
    }

    #[test]
    fn light_without_stored_values_is_taken_at_the_corners() {
        let scene = test_scene::room(4);
        let light = BaseLight::new(&scene.mesh, &Uniform(Vec3::splat(2.0)));
        assert_eq!(light.front.len(), 3 * scene.mesh.triangles.len());
        assert!(light.front.iter().flatten().all(|v| *v == 2.0));
        let dark = BaseLight::new(&scene.mesh, &Uniform(Vec3::ZERO));
        assert!(dark.back.is_empty());
    }
}
