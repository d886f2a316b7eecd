//! Small files made here: what they become, and how those end that cannot be.

#[cfg(any(feature = "basisu", feature = "draco"))]
mod compressed;
mod maps;
mod motion;
mod refusals;
mod shapes;
mod surfaces;

use std::path::PathBuf;

use glam::{Vec2, Vec3};

use super::super::file_tests::{TempFolder, png, promises};
use super::super::{LoadOptions, Loaded, load, load_with};
use super::SceneError;
use foveal::scene::{Light, Model, Scene};

/// A document and the bytes of its one buffer, put together.
#[derive(Default)]
struct Maker {
    bytes: Vec<u8>,
    views: Vec<String>,
    accessors: Vec<String>,
}

impl Maker {
    /// A view of these bytes.
    fn view(&mut self, bytes: &[u8]) -> usize {
        let (at, length) = (self.bytes.len(), bytes.len());
        self.bytes.extend(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(format!(r#"{{"buffer": 0, "byteOffset": {at}, "byteLength": {length}}}"#));
        self.views.len() - 1
    }

    fn accessor(&mut self, bytes: &[u8], component: u32, count: usize, shape: &str, more: &str) -> usize {
        let view = self.view(bytes);
        self.accessors.push(format!(
            r#"{{"bufferView": {view}, "componentType": {component}, "count": {count}, "type": "{shape}"{more}}}"#
        ));
        self.accessors.len() - 1
    }

    fn vec3(&mut self, values: &[Vec3]) -> usize {
        self.accessor(bytemuck::cast_slice(values), 5126, values.len(), "VEC3", "")
    }

    fn vec2(&mut self, values: &[Vec2]) -> usize {
        self.accessor(bytemuck::cast_slice(values), 5126, values.len(), "VEC2", "")
    }

    fn indices(&mut self, values: &[u32]) -> usize {
        self.accessor(bytemuck::cast_slice(values), 5125, values.len(), "SCALAR", "")
    }

    /// The document, its buffer a data URI, with `rest` of its keys.
    fn text(&self, rest: &str) -> String {
        use base64::Engine;
        let data = base64::engine::general_purpose::STANDARD.encode(&self.bytes);
        let uri = format!(r#""uri": "data:application/octet-stream;base64,{data}", "#);
        self.document(if self.bytes.is_empty() { "" } else { &uri }, rest)
    }

    fn document(&self, uri: &str, rest: &str) -> String {
        format!(
            r#"{{"asset": {{"version": "2.0"}}, "buffers": [{{{uri}"byteLength": {}}}], "bufferViews": [{}],
            "accessors": [{}], {rest}}}"#,
            self.bytes.len(),
            self.views.join(","),
            self.accessors.join(",")
        )
    }

    /// The same as a binary file.
    fn glb(&self, rest: &str) -> Vec<u8> {
        let mut json = self.document("", rest).into_bytes();
        json.resize(json.len().next_multiple_of(4), b' ');
        let mut file = b"glTF".to_vec();
        let length = 12 + 8 + json.len() + 8 + self.bytes.len();
        for word in [2, length as u32, json.len() as u32] {
            file.extend(word.to_le_bytes());
        }
        file.extend(b"JSON");
        file.extend(json);
        file.extend((self.bytes.len() as u32).to_le_bytes());
        file.extend(b"BIN\0");
        file.extend(&self.bytes);
        file
    }
}

const CORNERS: [Vec3; 4] =
    [Vec3::ZERO, Vec3::new(1.0, 0.0, 0.0), Vec3::new(1.0, 1.0, 0.0), Vec3::new(0.0, 1.0, 0.0)];

/// One quad of mesh 0 in the plane z = 0, whose texture coordinates, from the upper left, are x and 1 − y.
fn quad(maker: &mut Maker) -> String {
    let position = maker.vec3(&CORNERS);
    let uv = maker.vec2(&CORNERS.map(|p| Vec2::new(p.x, 1.0 - p.y)));
    let indices = maker.indices(&[0, 1, 2, 0, 2, 3]);
    format!(
        r#""meshes": [{{"name": "sheet", "primitives": [{{"attributes": {{"POSITION": {position}, "TEXCOORD_0": {uv}}},
        "indices": {indices}, "material": 0}}]}}]"#
    )
}

fn loaded(place: &TempFolder, text: impl AsRef<[u8]>) -> Loaded {
    let loaded = load(&place.write("a.gltf", text)).unwrap_or_else(|e| panic!("{e}"));
    promises(&loaded.scene);
    loaded
}

/// The quad with these materials (and whatever keys follow them), in one node.
fn with_materials(name: &str, materials: &str) -> Loaded {
    let place = TempFolder::new(name);
    let mut maker = Maker::default();
    let mesh = quad(&mut maker);
    let rest = format!(r#"{mesh}, "nodes": [{{"mesh": 0, "name": "thing"}}], "materials": {materials}"#);
    loaded(&place, maker.text(&rest))
}

/// The same with both sides of the quad apart, so that it encloses a body, if a flat one.
fn with_body(name: &str, materials: &str) -> Loaded {
    let place = TempFolder::new(name);
    let mut maker = Maker::default();
    let position = maker.vec3(&CORNERS);
    let uv = maker.vec2(&CORNERS.map(|p| Vec2::new(p.x, p.y)));
    let indices = maker.indices(&[0, 1, 2, 0, 2, 3, 0, 2, 1, 0, 3, 2]);
    let rest = format!(
        r#""meshes": [{{"primitives": [{{"attributes": {{"POSITION": {position}, "TEXCOORD_0": {uv}}}, "indices": {indices}, "material": 0}}]}}],
        "nodes": [{{"mesh": 0}}], "materials": {materials}"#
    );
    loaded(&place, maker.text(&rest))
}

fn area(scene: &Scene) -> f32 {
    let of = |t: usize| {
        let [a, b, c] = scene.mesh.corners(t as u32);
        0.5 * (b - a).cross(c - a).z
    };
    (0..scene.mesh.triangles.len()).map(of).sum()
}

fn says(loaded: &Loaded, what: &str) -> bool {
    loaded.warnings.iter().any(|w| w.message.contains(what))
}

fn data_png(pixels: &[[u8; 4]]) -> String {
    data_png_of(pixels.len(), pixels)
}

/// The same in rows of so many pixels, from the top.
fn data_png_of(columns: usize, pixels: &[[u8; 4]]) -> String {
    use base64::Engine;
    let mut bytes = Vec::new();
    let size = [columns, pixels.len() / columns].map(|n| n as u32);
    let picture = image::RgbaImage::from_vec(size[0], size[1], pixels.concat()).unwrap();
    picture.write_to(&mut std::io::Cursor::new(&mut bytes), image::ImageFormat::Png).unwrap();
    format!(
        r#"{{"uri": "data:image/png;base64,{}"}}"#,
        base64::engine::general_purpose::STANDARD.encode(bytes)
    )
}
