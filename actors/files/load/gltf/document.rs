//! What of a document (glTF 2.0 §5) is read. Everything else in it is passed over without being kept.

mod materials;

use serde::Deserialize;
#[cfg(not(feature = "draco"))]
use serde::de::IgnoredAny;

use super::number::{Index, List, Whole};
pub(super) use materials::{EmissiveStrength, Material, TextureInfo, TextureTransform, Volume};

/// Joints of a skin, and targets of a primitive.
pub(super) const JOINTS_MAX: usize = 4096;
pub(super) const TARGETS_MAX: usize = 1024;

/// Nodes of a document.
pub(super) const NODES_MAX: usize = 1 << 22;

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Document {
    pub asset: Asset,
    pub scene: Option<Index>,
    #[serde(default)]
    pub scenes: List<Scene>,
    #[serde(default)]
    pub nodes: List<Node, NODES_MAX>,
    #[serde(default)]
    pub meshes: List<Mesh>,
    #[serde(default)]
    pub materials: List<Material>,
    #[serde(default)]
    pub textures: List<Texture>,
    #[serde(default)]
    pub images: List<Image>,
    #[serde(default)]
    pub samplers: List<Sampler>,
    #[serde(default)]
    pub accessors: List<Accessor>,
    #[serde(default)]
    pub buffer_views: List<BufferView>,
    #[serde(default)]
    pub buffers: List<Buffer>,
    #[serde(default)]
    pub cameras: List<Camera>,
    #[serde(default)]
    pub animations: List<Animation>,
    #[serde(default)]
    pub skins: List<Skin>,
    #[serde(default)]
    pub extensions_used: List<String>,
    #[serde(default)]
    pub extensions_required: List<String>,
    #[serde(default)]
    pub extensions: RootExtensions,
}

#[derive(Debug, Default, Deserialize)]
pub(super) struct Asset {
    pub version: String,
}

#[derive(Debug, Default, Deserialize)]
pub(super) struct RootExtensions {
    #[serde(rename = "KHR_lights_punctual")]
    pub lights: Option<Lights>,
    #[serde(rename = "KHR_materials_variants")]
    pub variants: Option<Variants>,
    #[serde(rename = "EXT_lights_image_based")]
    pub image_based: Option<ImageBasedLights>,
}

#[derive(Debug, Deserialize)]
pub(super) struct ImageBasedLights {
    #[serde(default)]
    pub lights: List<ImageBasedLight>,
}

/// Radiance from all around as the faces of cubes, the finest first.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct ImageBasedLight {
    #[serde(default = "one")]
    pub intensity: f32,
    #[serde(default = "unturned")]
    pub rotation: [f32; 4],
    #[serde(default)]
    pub specular_images: List<[Index; 6]>,
}

fn unturned() -> [f32; 4] {
    [0.0, 0.0, 0.0, 1.0]
}

#[derive(Debug, Default, Deserialize)]
pub(super) struct SceneExtensions {
    #[serde(rename = "EXT_lights_image_based")]
    pub image_based: Option<NodeLight>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Lights {
    #[serde(default)]
    pub lights: List<Light>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Light {
    #[serde(rename = "type")]
    pub kind: String,
    #[serde(default = "ones")]
    pub color: [f32; 3],
    #[serde(default = "one")]
    pub intensity: f32,
    pub range: Option<f32>,
    pub spot: Option<Spot>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Spot {
    #[serde(default)]
    pub inner_cone_angle: f32,
    #[serde(default = "quarter_turn_half")]
    pub outer_cone_angle: f32,
}

#[derive(Debug, Deserialize)]
pub(super) struct Variants {
    #[serde(default)]
    pub variants: List<Variant>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Variant {
    pub name: String,
}

#[derive(Debug, Deserialize)]
pub(super) struct Scene {
    pub name: Option<String>,
    #[serde(default)]
    pub nodes: List<Index, NODES_MAX>,
    #[serde(default)]
    pub extensions: SceneExtensions,
}

#[derive(Debug, Default, Deserialize)]
pub(super) struct Node {
    pub name: Option<Box<str>>,
    pub mesh: Option<Index>,
    pub skin: Option<Index>,
    pub camera: Option<Index>,
    #[serde(default)]
    pub children: List<Index, NODES_MAX>,
    pub matrix: Option<Box<[f32; 16]>>,
    pub translation: Option<[f32; 3]>,
    pub rotation: Option<[f32; 4]>,
    pub scale: Option<[f32; 3]>,
    #[serde(default)]
    pub weights: List<f32, TARGETS_MAX>,
    pub extensions: Option<Box<NodeExtensions>>,
}

#[derive(Debug, Default, Deserialize)]
pub(super) struct NodeExtensions {
    #[serde(rename = "KHR_lights_punctual")]
    pub light: Option<NodeLight>,
    #[serde(rename = "EXT_mesh_gpu_instancing")]
    pub instancing: Option<Instancing>,
    #[serde(rename = "KHR_node_visibility")]
    pub visibility: Option<Visibility>,
}

#[derive(Debug, Deserialize)]
pub(super) struct NodeLight {
    pub light: Index,
}

#[derive(Debug, Deserialize)]
pub(super) struct Instancing {
    #[serde(default)]
    pub attributes: InstanceAttributes,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub(super) struct InstanceAttributes {
    pub translation: Option<Index>,
    pub rotation: Option<Index>,
    pub scale: Option<Index>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Visibility {
    #[serde(default = "yes")]
    pub visible: bool,
}

#[derive(Debug, Deserialize)]
pub(super) struct Mesh {
    pub name: Option<String>,
    pub primitives: List<Primitive>,
    /// Of morph targets, unless a node has others.
    #[serde(default)]
    pub weights: List<f32, TARGETS_MAX>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Primitive {
    pub attributes: Attributes,
    pub indices: Option<Index>,
    pub material: Option<Index>,
    pub mode: Option<Index>,
    #[serde(default)]
    pub targets: List<MorphTarget, TARGETS_MAX>,
    #[serde(default)]
    pub extensions: PrimitiveExtensions,
}

/// What a primitive is moved by, times a weight.
#[derive(Debug, Deserialize)]
pub(super) struct MorphTarget {
    #[serde(rename = "POSITION")]
    pub position: Option<Index>,
    #[serde(rename = "NORMAL")]
    pub normal: Option<Index>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Attributes {
    #[serde(rename = "POSITION")]
    pub position: Option<Index>,
    #[serde(rename = "NORMAL")]
    pub normal: Option<Index>,
    #[serde(rename = "TANGENT")]
    pub tangent: Option<Index>,
    #[serde(rename = "TEXCOORD_0")]
    pub uv0: Option<Index>,
    #[serde(rename = "TEXCOORD_1")]
    pub uv1: Option<Index>,
    #[serde(rename = "COLOR_0")]
    pub color: Option<Index>,
    #[serde(rename = "JOINTS_0")]
    pub joints0: Option<Index>,
    #[serde(rename = "JOINTS_1")]
    pub joints1: Option<Index>,
    #[serde(rename = "WEIGHTS_0")]
    pub weights0: Option<Index>,
    #[serde(rename = "WEIGHTS_1")]
    pub weights1: Option<Index>,
}

#[cfg(feature = "draco")]
impl Attributes {
    /// Those that are there, by the names that files have for them.
    pub fn named(&self) -> impl Iterator<Item = (&'static str, Index)> {
        let all = [
            ("POSITION", self.position),
            ("NORMAL", self.normal),
            ("TANGENT", self.tangent),
            ("TEXCOORD_0", self.uv0),
            ("TEXCOORD_1", self.uv1),
            ("COLOR_0", self.color),
            ("JOINTS_0", self.joints0),
            ("JOINTS_1", self.joints1),
            ("WEIGHTS_0", self.weights0),
            ("WEIGHTS_1", self.weights1),
        ];
        all.into_iter().filter_map(|(name, index)| Some((name, index?)))
    }
}

#[derive(Debug, Default, Deserialize)]
pub(super) struct PrimitiveExtensions {
    #[serde(rename = "KHR_materials_variants")]
    pub variants: Option<Mappings>,
    #[serde(rename = "KHR_draco_mesh_compression")]
    pub draco: Option<Draco>,
}

/// What a compressed mesh is, to builds that do not read it.
#[cfg(not(feature = "draco"))]
pub(super) type Draco = IgnoredAny;

/// Where a compressed mesh is, and which of its attributes has which name.
#[cfg(feature = "draco")]
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Draco {
    pub buffer_view: Index,
    #[serde(default)]
    pub attributes: std::collections::BTreeMap<String, Index>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Mappings {
    #[serde(default)]
    pub mappings: List<Mapping>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Mapping {
    pub material: Index,
    #[serde(default)]
    pub variants: List<Index>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Accessor {
    pub buffer_view: Option<Index>,
    #[serde(default)]
    pub byte_offset: Whole,
    pub component_type: Index,
    pub count: Whole,
    #[serde(rename = "type")]
    pub shape: String,
    #[serde(default)]
    pub normalized: bool,
    pub sparse: Option<Sparse>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Sparse {
    pub count: Whole,
    pub indices: SparseIndices,
    pub values: SparseValues,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseIndices {
    pub buffer_view: Index,
    #[serde(default)]
    pub byte_offset: Whole,
    pub component_type: Index,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseValues {
    pub buffer_view: Index,
    #[serde(default)]
    pub byte_offset: Whole,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferView {
    pub buffer: Index,
    #[serde(default)]
    pub byte_offset: Whole,
    pub byte_length: Whole,
    pub byte_stride: Option<Whole>,
    #[serde(default)]
    pub extensions: ViewExtensions,
}

#[derive(Debug, Default, Deserialize)]
pub(super) struct ViewExtensions {
    #[serde(rename = "EXT_meshopt_compression", alias = "KHR_meshopt_compression")]
    pub meshopt: Option<Meshopt>,
}

/// Where a compressed view really lies.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Meshopt {
    pub buffer: Index,
    #[serde(default)]
    pub byte_offset: Whole,
    pub byte_length: Whole,
    pub byte_stride: Whole,
    pub count: Whole,
    pub mode: String,
    pub filter: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Buffer {
    pub uri: Option<String>,
    pub byte_length: Whole,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Image {
    pub uri: Option<String>,
    pub buffer_view: Option<Index>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Texture {
    pub source: Option<Index>,
    pub sampler: Option<Index>,
    #[serde(default)]
    pub extensions: TextureExtensions,
}

#[derive(Debug, Default, Deserialize)]
pub(super) struct TextureExtensions {
    #[serde(rename = "EXT_texture_webp")]
    pub webp: Option<OtherSource>,
    #[serde(rename = "KHR_texture_basisu")]
    pub basisu: Option<OtherSource>,
}

#[derive(Debug, Deserialize)]
pub(super) struct OtherSource {
    pub source: Option<Index>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Sampler {
    pub wrap_s: Option<Index>,
    pub wrap_t: Option<Index>,
    pub mag_filter: Option<Index>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Skin {
    pub joints: List<Index, JOINTS_MAX>,
    pub inverse_bind_matrices: Option<Index>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Animation {
    pub name: Option<String>,
    #[serde(default)]
    pub channels: List<Channel>,
    #[serde(default)]
    pub samplers: List<AnimationSampler>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Channel {
    pub sampler: Index,
    pub target: Target,
}

#[derive(Debug, Deserialize)]
pub(super) struct Target {
    pub node: Option<Index>,
    pub path: String,
    #[serde(default)]
    pub extensions: TargetExtensions,
}

#[derive(Debug, Default, Deserialize)]
pub(super) struct TargetExtensions {
    #[serde(rename = "KHR_animation_pointer")]
    pub pointer: Option<Pointer>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Pointer {
    pub pointer: String,
}

#[derive(Debug, Deserialize)]
pub(super) struct AnimationSampler {
    pub input: Index,
    pub output: Index,
    pub interpolation: Option<String>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Camera {
    pub name: Option<String>,
    #[serde(rename = "type")]
    pub kind: String,
    pub perspective: Option<Perspective>,
    pub orthographic: Option<Orthographic>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Perspective {
    pub yfov: f32,
}

#[derive(Debug, Deserialize)]
pub(super) struct Orthographic {
    pub ymag: f32,
}

fn one() -> f32 {
    1.0
}

fn yes() -> bool {
    true
}

fn ones() -> [f32; 3] {
    [1.0; 3]
}

fn quarter_turn_half() -> f32 {
    std::f32::consts::FRAC_PI_4
}
