//! Small files made here: what they become, and how those end that cannot be.

use std::path::PathBuf;

use glam::{Vec2, Vec3};

use super::super::file_tests::{Place, png, promises};
use super::super::{LoadOptions, Loaded, load, load_with};
use super::SceneError;
use crate::scene::{Light, Model, Scene};

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

fn loaded(place: &Place, text: impl AsRef<[u8]>) -> Loaded {
    let loaded = load(&place.write("a.gltf", text)).unwrap_or_else(|e| panic!("{e}"));
    promises(&loaded.scene);
    loaded
}

/// The quad with these materials (and whatever keys follow them), in one node.
fn with_materials(name: &str, materials: &str) -> Loaded {
    let place = Place::new(name);
    let mut maker = Maker::default();
    let mesh = quad(&mut maker);
    let rest = format!(r#"{mesh}, "nodes": [{{"mesh": 0, "name": "thing"}}], "materials": {materials}"#);
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

#[test]
fn an_obj_and_a_gltf_of_one_scene_have_the_same_bits() {
    let place = Place::new("gltf-twin");
    let mut obj = String::from("o fan\nusemtl m\n");
    for i in 0..5 {
        let (x, y) = (i as f32 * 0.37 - 0.81, (i * i) as f32 * 0.13);
        obj +=
            &format!("v {x} {y} {}\nvt {} {}\nvn 0 0.6 0.8\n", 0.1 - x, i as f32 / 4.0, 1.0 - i as f32 / 8.0);
    }
    obj += "f 1/1/1 2/2/2 3/3/3\nf 1/1/1 3/3/3 4/4/4\nf 1/1/1 4/4/4 5/5/5\n";
    let sidecar = "format = 1\n[[camera]]\nname = \"m\"\neye = [0.0, 1.0, 3.0]\ntarget = [0.0, 1.0, 0.0]\nfov_y = 50.0\n\
        [environment]\nradiance = [1.0, 0.5, 0.25]\n[material.\"m\"]\nmodel = \"plastic\"\nalbedo = [0.5, 0.4, 0.3]\nalpha = 0.2\n";
    place.write("one.toml", sidecar);
    place.write("two.toml", sidecar);
    place.write("three.toml", sidecar);
    let one = load(&place.write("one.obj", obj)).unwrap().scene;
    let m = &one.mesh;
    let mut maker = Maker::default();
    let position = maker.vec3(&m.positions);
    let normal = maker.vec3(&m.normals);
    let uv = maker.vec2(&m.uvs.iter().map(|uv| Vec2::new(uv.x, 1.0 - uv.y)).collect::<Vec<_>>());
    let indices = maker.indices(bytemuck::cast_slice(&m.triangles));
    let rest = format!(
        r#""meshes": [{{"primitives": [{{"attributes": {{"POSITION": {position}, "NORMAL": {normal},
        "TEXCOORD_0": {uv}}}, "indices": {indices}, "material": 0}}]}}],
        "nodes": [{{"mesh": 0, "name": "fan"}}], "materials": [{{"name": "m"}}]"#
    );
    let text = load(&place.write("two.gltf", maker.text(&rest))).unwrap().scene;
    let binary = load(&place.write("three.glb", maker.glb(&rest))).unwrap().scene;
    for two in [text, binary] {
        let bits =
            |v: &[Vec3]| -> Vec<u32> { v.iter().flat_map(|v| v.to_array().map(f32::to_bits)).collect() };
        assert_eq!(bits(&one.mesh.positions), bits(&two.mesh.positions));
        assert_eq!(bits(&one.mesh.normals), bits(&two.mesh.normals));
        assert_eq!((&one.mesh.uvs, &one.mesh.triangles), (&two.mesh.uvs, &two.mesh.triangles));
        assert_eq!((&one.materials, &one.cameras), (&two.materials, &two.cameras));
        assert_eq!(one.objects[1].name, two.objects[1].name);
        assert_eq!(one.display, two.display, "a sidecar's light is metered neither way");
    }
}

#[test]
fn every_way_to_say_a_quad_gives_the_same() {
    let ways: [(&str, &[u32]); 4] = [
        ("4", &[0, 1, 2, 0, 2, 3]),
        ("5", &[0, 1, 3, 2]),
        ("6", &[0, 1, 2, 3]),
        ("4.0", &[0, 1, 2, 2, 3, 0]),
    ];
    for (mode, indices) in ways {
        let place = Place::new(&format!("gltf-mode-{mode}-{}", indices.len() + indices[3] as usize));
        for indexed in [true, false] {
            let mut maker = Maker::default();
            let points: Vec<Vec3> = indices.iter().map(|&i| CORNERS[i as usize]).collect();
            let position = maker.vec3(if indexed { &CORNERS } else { &points });
            let list = maker.indices(indices);
            let list = if indexed { format!(r#", "indices": {list}"#) } else { String::new() };
            let rest = format!(
                r#""meshes": [{{"primitives": [{{"attributes": {{"POSITION": {position}}}, "mode": {mode}{list}}}]}}],
                "nodes": [{{"mesh": 0}}]"#
            );
            let scene = loaded(&place, maker.text(&rest)).scene;
            assert_eq!((area(&scene), scene.mesh.triangles.len()), (1.0, 2), "{mode} {indexed}");
        }
    }
}

#[test]
fn sparse_and_quantised_positions_are_those_of_floats() {
    let place = Place::new("gltf-sparse");
    let scene_of = |maker: &Maker, position: usize, node: &str| {
        let rest = format!(
            r#""meshes": [{{"primitives": [{{"attributes": {{"POSITION": {position}}}, "mode": 6}}]}}],
            "nodes": [{{"mesh": 0{node}}}]"#
        );
        loaded(&place, maker.text(&rest)).scene.mesh.clone()
    };
    let mut maker = Maker::default();
    let mut bent = CORNERS;
    bent[2] = Vec3::new(2.0, 2.0, 0.5);
    let dense = maker.vec3(&bent);
    let dense = scene_of(&maker, dense, "");
    let (places, values) = (maker.view(&[2]), maker.view(bytemuck::cast_slice(&bent[2..3])));
    let sparse = format!(
        r#", "sparse": {{"count": 1, "indices": {{"bufferView": {places}, "componentType": 5121}},
        "values": {{"bufferView": {values}}}}}"#
    );
    let sparse = maker.accessor(bytemuck::cast_slice(&CORNERS), 5126, 4, "VEC3", &sparse);
    assert_eq!(dense.positions, scene_of(&maker, sparse, "").positions);
    // Sixteen bits of [−1, 1], padded to eight bytes, under a scale of 2.
    let words: Vec<i16> = bent
        .iter()
        .flat_map(|p| (*p * 0.5 * 32_767.0).extend(0.0).to_array().map(|v| v.round() as i16))
        .collect();
    let view = maker.view(bytemuck::cast_slice(&words));
    maker.views[view] = maker.views[view].replace("}", r#", "byteStride": 8}"#);
    maker.accessors.push(format!(
        r#"{{"bufferView": {view}, "componentType": 5122, "normalized": true, "count": 4, "type": "VEC3"}}"#
    ));
    let quantised = scene_of(&maker, maker.accessors.len() - 1, r#", "scale": [2, 2, 2]"#);
    for (a, b) in dense.positions.iter().zip(&quantised.positions) {
        assert!((*a - *b).abs().max_element() <= 2.0 / 32_767.0, "{a} {b}");
    }
}

#[test]
fn instances_stand_where_their_nodes_are_and_bear_their_names() {
    let place = Place::new("gltf-instances");
    let mut maker = Maker::default();
    let mesh = quad(&mut maker);
    let shifts = maker.vec3(&[Vec3::ZERO, Vec3::new(0.0, 0.0, 7.0)]);
    let rest = format!(
        r#"{mesh}, "nodes": [
            {{"mesh": 0, "name": "near"}},
            {{"name": "group", "translation": [0, 0, -4], "children": [2, 3]}},
            {{"mesh": 0, "name": "mirrored", "scale": [-1, 1, 1]}},
            {{"mesh": 0, "scale": [1, 0, 1]}},
            {{"mesh": 0, "name": "many", "translation": [20, 0, 0],
              "extensions": {{"EXT_mesh_gpu_instancing": {{"attributes": {{"TRANSLATION": {shifts}}}}}}}}},
            {{"mesh": 0, "name": "hidden", "extensions": {{"KHR_node_visibility": {{"visible": false}}}}}},
            {{"mesh": 0, "name": "of another scene"}}],
        "scenes": [{{"nodes": [0, 1, 4, 5]}}, {{"name": "other", "nodes": [6]}}], "scene": 0,
        "materials": [{{"pbrMetallicRoughness": {{"metallicFactor": 1, "roughnessFactor": 0.3}}}}]"#
    );
    let found = loaded(&place, maker.text(&rest));
    let scene = &found.scene;
    assert_eq!(scene.mesh.triangles.len(), 8);
    assert!(says(&found, "leaves no volume"));
    // Also the mirrored one faces +z.
    assert_eq!(area(scene), 4.0);
    let mirrored = scene.mesh.corners(2);
    assert!(mirrored.iter().all(|p| p.z == -4.0 && p.x <= 0.0), "{mirrored:?}");
    assert!(scene.mesh.corners(6).iter().all(|p| p.z == 7.0 && p.x >= 20.0));
    let names: Vec<&str> = scene.objects.iter().skip(1).map(|o| o.name.as_str()).collect();
    assert_eq!(names, ["near", "mirrored", "many", "many"]);
    place.write("a.toml", "format = 1\n[gltf]\nscene = \"other\"\n");
    let other = loaded(&place, maker.text(&rest)).scene;
    assert_eq!((other.mesh.triangles.len(), other.objects[1].name.as_str()), (2, "of another scene"));
}

#[test]
fn lights_and_cameras_come_after_those_of_the_sidecar() {
    let place = Place::new("gltf-lights");
    let mut maker = Maker::default();
    let mesh = quad(&mut maker);
    let rest = format!(
        r#"{mesh}, "materials": [{{}}], "cameras": [{{"type": "perspective", "perspective": {{"yfov": 0.7, "znear": 0.1}}}}],
        "nodes": [{{"mesh": 0}}, {{"name": "eye", "camera": 0, "translation": [0, 0, 5]}}, {{"camera": 0}}, {{"camera": 0}},
            {{"translation": [0, 0, 2], "extensions": {{"KHR_lights_punctual": {{"light": 0}}}}}}],
        "extensions": {{"KHR_lights_punctual": {{"lights": [{{"type": "point", "intensity": 8, "range": 9}}]}}}}"#
    );
    let found = loaded(&place, maker.text(&rest));
    let names = |scene: &Scene| scene.cameras.iter().map(|c| c.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&found.scene), ["eye", "camera", "camera (2)"]);
    assert!(found.scene.display.metered && found.scene.environment.is_none());
    let position = Vec3::new(0.0, 0.0, 2.0);
    assert_eq!(found.scene.lights, [Light::Point { position, intensity: Vec3::splat(8.0), range: 9.0 }]);
    place.write(
        "a.toml",
        "format = 1\n[gltf]\nlight_scale = 0.5\n[display]\nexposure = 3.0\n[[camera]]\nname = \"mine\"\neye = [0.0, 0.0, 3.0]\n\
         target = [0.0, 0.0, 0.0]\nfov_y = 45.0\n",
    );
    let scene = loaded(&place, maker.text(&rest)).scene;
    assert_eq!(names(&scene), ["mine", "eye", "camera", "camera (2)"]);
    assert_eq!(scene.lights, [Light::Point { position, intensity: Vec3::splat(4.0), range: 9.0 }]);
    assert_eq!((scene.display.exposure, scene.display.metered), (3.0, false));
    // A sidecar alone finds the file beside it.
    assert_eq!(load(&place.0.join("a.toml")).unwrap().scene.cameras.len(), 4);
}

fn data_png(pixels: &[[u8; 4]]) -> String {
    use base64::Engine;
    let mut bytes = Vec::new();
    let picture = image::RgbaImage::from_vec(pixels.len() as u32, 1, pixels.concat()).unwrap();
    picture.write_to(&mut std::io::Cursor::new(&mut bytes), image::ImageFormat::Png).unwrap();
    format!(
        r#"{{"uri": "data:image/png;base64,{}"}}"#,
        base64::engine::general_purpose::STANDARD.encode(bytes)
    )
}

#[test]
fn maps_of_colour_metalness_and_roughness_become_those_that_are_shown() {
    // Left metal of r = 0.2, right dielectric of r = 1.
    let rough = data_png(&[[9, 51, 255, 255], [9, 255, 0, 255]]);
    let base = data_png(&[[255, 0, 0, 255], [255, 255, 255, 255]]);
    let found = with_materials(
        "gltf-maps",
        &format!(
            r#"[{{"pbrMetallicRoughness": {{"baseColorTexture": {{"index": 0}}, "metallicRoughnessTexture": {{"index": 1}}}},
            "occlusionTexture": {{"index": 1}}}}], "textures": [{{"source": 0}}, {{"source": 1}}], "images": [{base}, {rough}]"#
        ),
    );
    let scene = &found.scene;
    assert!(says(&found, "occlusion"));
    let Model::MetalRough(m) = &scene.materials[0].model else { panic!("{:?}", scene.materials[0]) };
    assert!(m.roughness_in_alpha && !m.is_diffuse);
    assert_eq!(m.roughness_range, [0.2, 1.0]);
    let texel = |r: &crate::scene::Reflectance, x| scene.textures[r.map.unwrap().0 as usize].texel(0, x, 0);
    assert_eq!(scene.textures.len(), 2, "the maps that they were made of are gone");
    let close = |a: [f32; 4], b: [f32; 4]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 0.004);
    assert!(close(texel(&m.specular, 0), [1.0, 0.0, 0.0, 0.2]), "{:?}", texel(&m.specular, 0));
    assert!(close(texel(&m.specular, 1), [0.04, 0.04, 0.04, 1.0]), "{:?}", texel(&m.specular, 1));
    // Its alpha is how much of it is metal.
    assert!(m.metallic_in_alpha && close(texel(&m.diffuse, 0), [0.0, 0.0, 0.0, 1.0]));
    let kept = 1.0 - m.layer.mean(1.0);
    assert!(close(texel(&m.diffuse, 1), [kept, kept, kept, 0.0]), "{:?}", texel(&m.diffuse, 1));
}

#[test]
fn what_is_rough_and_no_metal_is_diffuse() {
    let of = |metal: f32, rough: f32| {
        let m = with_materials(
            &format!("gltf-diffuse-{metal}-{rough}"),
            &format!(
                r#"[{{"pbrMetallicRoughness": {{"metallicFactor": {metal}, "roughnessFactor": {rough}}}}}]"#
            ),
        );
        (m.scene.materials[0].is_diffuse(), m.scene.objects.len())
    };
    assert_eq!(of(0.0, 0.95), (true, 1));
    assert_eq!(of(0.0, 0.5), (false, 2));
    assert_eq!(of(1.0, 0.95), (false, 2));
}

#[test]
fn alpha_cuts_out_where_it_is_below_the_cutoff() {
    let picture = data_png(&[[255, 255, 255, 60], [255, 255, 255, 200]]);
    let of = |name: &str, more: &str, factor: f32| {
        let materials = format!(
            r#"[{{"pbrMetallicRoughness": {{"baseColorFactor": [1, 1, 1, {factor}], "baseColorTexture": {{"index": 0}}}},
            "alphaMode": {more}}}], "textures": [{{"source": 0, "sampler": 0}}], "images": [{picture}],
            "samplers": [{{"wrapS": 33071, "wrapT": 33071}}]"#
        );
        with_materials(name, &materials).scene
    };
    // Barycentrics of the first triangle: (1 − b1 − b2) is at uv (0, 0).
    let there = |scene: &Scene| [scene.is_opaque_at(0, 0.1, 0.0), scene.is_opaque_at(0, 0.9, 0.0)];
    assert_eq!(there(&of("gltf-mask", r#""MASK""#, 1.0)), [false, true]);
    assert_eq!(there(&of("gltf-low", r#""MASK", "alphaCutoff": 0.2"#, 1.0)), [true, true]);
    assert_eq!(there(&of("gltf-high", r#""MASK", "alphaCutoff": 0.7"#, 0.8)), [false, false]);
    assert_eq!(there(&of("gltf-none", r#""MASK", "alphaCutoff": 0"#, 0.0)), [true, true]);
    assert_eq!(there(&of("gltf-opaque", r#""OPAQUE""#, 0.1)), [true, true]);
    // What is half there shows by its share what it is, and by the rest what is behind.
    let veil = of("gltf-veil", r#""BLEND""#, 1.0);
    let Model::MetalRough(m) = &veil.materials[0].model else { panic!("{:?}", veil.materials[0]) };
    assert!(m.coverage_in_alpha && m.is_seen_through() && veil.materials[0].is_transparent());
    let texel = veil.textures[m.diffuse.map.unwrap().0 as usize].texel(0, 0, 0);
    assert!((texel[3] - 60.0 / 255.0).abs() < 1e-6, "{texel:?}");
    // An edge between all and nothing is cut out.
    let edge = data_png(&[[255, 255, 255, 0], [255, 255, 255, 255]]);
    let cut = with_materials(
        "gltf-edge",
        &format!(
            r#"[{{"pbrMetallicRoughness": {{"baseColorTexture": {{"index": 0}}}}, "alphaMode": "BLEND"}}],
            "textures": [{{"source": 0}}], "images": [{edge}]"#
        ),
    );
    assert!(says(&cut, "cut out") && cut.scene.materials[0].opacity_map.is_some());
}

/// The radiance that a camera straight above sees of an unlit thing behind a sheet.
fn seen_through(name: &str, sheet: &str) -> Vec3 {
    use crate::geometry::Ray;
    let place = Place::new(name);
    let mut maker = Maker::default();
    let mesh = quad(&mut maker);
    let position = maker.vec3(&CORNERS.map(|p| p * 4.0 - Vec3::new(2.0, 2.0, 1.0)));
    let indices = maker.indices(&[0, 1, 2, 0, 2, 3]);
    let mesh = mesh.replace(
        r#""meshes": ["#,
        &format!(
            r#""meshes": [{{"primitives": [{{"attributes": {{"POSITION": {position}}}, "indices": {indices}, "material": 1}}]}}, "#
        ),
    );
    let rest = format!(
        r#"{mesh}, "nodes": [{{"mesh": 0}}, {{"mesh": 1}}], "materials": [{sheet}, {{"extensions": {{"KHR_materials_unlit": {{}}}}}}]"#
    );
    let scene = loaded(&place, maker.text(&rest)).scene;
    let world =
        crate::world::World::new(scene.into(), std::sync::Arc::new(crate::illumination::Uniform(Vec3::ZERO)));
    let mean = |i: u64| {
        let stream = crate::rng::Stream::new(3, i, 0);
        world.tracer().radiance(&Ray::new(Vec3::new(0.4, 0.3, 2.0), Vec3::NEG_Z), stream)
    };
    (0..64).map(mean).sum::<Vec3>() / 64.0
}

#[test]
fn veils_blend_and_glass_passes_what_is_not_reflected() {
    let unlit = |alpha: f32, color: &str| {
        format!(
            r#"{{"alphaMode": "BLEND", "pbrMetallicRoughness": {{"baseColorFactor": [{color}, {alpha}]}}, "extensions": {{"KHR_materials_unlit": {{}}}}}}"#
        )
    };
    let close = |a: Vec3, b: Vec3| assert!((a - b).abs().max_element() < 2e-3, "{a} {b}");
    close(seen_through("gltf-blend-half", &unlit(0.5, "0.2, 0.4, 0")), Vec3::new(0.6, 0.7, 0.5));
    close(seen_through("gltf-blend-quarter", &unlit(0.25, "0, 0, 0")), Vec3::splat(0.75));
    // Straight on 4 % of the sky is reflected; the rest passes and is tinted.
    let glass = |more: &str| {
        format!(
            r#"{{"pbrMetallicRoughness": {{"metallicFactor": 0, "roughnessFactor": 0, "baseColorFactor": [1, 0.5, 0, 1]{more}}},
            "extensions": {{"KHR_materials_transmission": {{"transmissionFactor": 1}}}}}}"#
        )
    };
    let through = seen_through("gltf-thin-glass", &glass(""));
    close(through, Vec3::new(0.96, 0.48, 0.0) + 0.04 * Vec3::new(0.45, 0.55, 0.7));
}

#[test]
fn a_body_of_glass_absorbs_by_its_distance_and_is_tinted_at_its_surface() {
    let glass = with_materials(
        "gltf-volume",
        r#"[{"pbrMetallicRoughness": {"baseColorFactor": [0.5, 1, 1, 1], "roughnessFactor": 0}, "extensions":
        {"KHR_materials_transmission": {"transmissionFactor": 1}, "KHR_materials_volume": {"thicknessFactor": 1,
        "attenuationDistance": 0.5, "attenuationColor": [0.5, 0.25, 1]}, "KHR_materials_ior": {"ior": 1.3}}}]"#,
    );
    // Metal by default, which is no glass.
    assert!(matches!(glass.scene.materials[0].model, Model::MetalRough(_)));
    let glass = with_materials(
        "gltf-volume-glass",
        r#"[{"pbrMetallicRoughness": {"baseColorFactor": [0.5, 1, 1, 1], "roughnessFactor": 0, "metallicFactor": 0}, "extensions":
        {"KHR_materials_transmission": {"transmissionFactor": 1}, "KHR_materials_volume": {"thicknessFactor": 1,
        "attenuationDistance": 0.5, "attenuationColor": [0.5, 0.25, 1]}, "KHR_materials_ior": {"ior": 1.3}}}]"#,
    );
    let m = &glass.scene.materials[0];
    assert_eq!(m.tint.color, Vec3::new(0.5, 1.0, 1.0));
    let Model::Dielectric { ior, transmittance, thin: false, .. } = m.model else { panic!("{m:?}") };
    assert_eq!(ior, 1.3);
    // After one unit, which is twice the distance.
    assert!((transmittance - Vec3::new(0.25, 0.0625, 1.0)).abs().max_element() < 1e-5, "{transmittance}");
}

#[test]
fn a_coat_fibres_and_grain_are_read() {
    let found = with_materials(
        "gltf-over",
        r#"[{"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1}, "extensions": {
        "KHR_materials_clearcoat": {"clearcoatFactor": 0.5, "clearcoatRoughnessFactor": 0.1},
        "KHR_materials_sheen": {"sheenColorFactor": [0.2, 0.4, 0.6], "sheenRoughnessFactor": 0.3},
        "KHR_materials_anisotropy": {"anisotropyStrength": 0.5, "anisotropyRotation": 1}}}]"#,
    );
    let m = &found.scene.materials[0];
    assert!(!m.is_diffuse() && m.is_glossy());
    let Model::MetalRough(m) = &m.model else { panic!("{m:?}") };
    let over = m.over.unwrap();
    assert_eq!((over.coat.unwrap().strength, over.sheen.unwrap().color), (0.5, Vec3::new(0.2, 0.4, 0.6)));
    assert_eq!(m.grain.unwrap().alphas(0.0), [0.25, 0.0]);
    // What is below them gets less.
    let alone = 1.0 - m.layer.mean(1.0);
    assert!((m.diffuse.color.x - alone * over.kept_mean()).abs() < 1e-6);
}

#[test]
fn compressed_views_are_those_that_they_were_made_of() {
    let place = Place::new("gltf-meshopt");
    let mut maker = Maker::default();
    let mesh = quad(&mut maker);
    let rest = format!(r#"{mesh}, "nodes": [{{"mesh": 0}}], "materials": [{{}}]"#);
    let plain = loaded(&place, maker.text(&rest)).scene;
    // Indices 0 1 2 0 2 3 as triangles: three new ones, then the newest edge and a new one. The version of two baselines
    // says the same.
    let triangles = [&[0xe1, 0xf0, 0x00][..], &[0; 16]].concat();
    let deltas = [0i32, 1, 1, -2, 2, 1];
    let zigzag = |d: i32| ((if d < 0 { (-d - 1) << 1 | 1 } else { d << 1 }) << 1) as u8;
    let indices: Vec<u8> =
        std::iter::once(0xd1).chain(deltas.iter().map(|&d| zigzag(d))).chain([0; 4]).collect();
    for (name, mode, bytes) in [("EXT", "TRIANGLES", triangles), ("KHR", "INDICES", indices)] {
        let mut packed = Maker { bytes: maker.bytes.clone(), ..Maker::default() };
        packed.views = maker.views.clone();
        packed.accessors = maker.accessors.clone();
        let at = packed.view(&bytes);
        packed.views.pop();
        let start = packed.bytes.len() - bytes.len().next_multiple_of(4);
        assert_eq!(at, 3);
        packed.views[2] = format!(
            r#"{{"buffer": 1, "byteLength": 24, "extensions": {{"{name}_meshopt_compression": {{"buffer": 0, "byteOffset": {start},
            "byteLength": {}, "byteStride": 4, "count": 6, "mode": "{mode}"}}}}}}"#,
            bytes.len()
        );
        let text = packed.text(&rest);
        let text = text.replacen("}],", r#"}, {"byteLength": 24}],"#, 1);
        let scene = loaded(&place, &text).scene;
        assert_eq!(scene.mesh.triangles, plain.mesh.triangles, "{mode}");
        let short = text.replace(r#""count": 6, "mode""#, r#""count": 9, "mode""#);
        let error = load(&place.write("bad.gltf", short)).unwrap_err();
        assert!(error.to_string().contains("/bufferViews/2"), "{error}");
        let wrong = text.replace(r#""byteStride": 4, "count": 6"#, r#""byteStride": 3, "count": 8"#);
        assert!(load(&place.write("bad.gltf", wrong)).is_err());
    }
}

#[test]
fn a_camera_that_moves_is_a_path_and_a_time_poses_things() {
    let place = Place::new("gltf-path");
    let mut maker = Maker::default();
    let mesh = quad(&mut maker);
    let times = maker.accessor(bytemuck::cast_slice(&[1.0f32, 3.0]), 5126, 2, "SCALAR", "");
    let there = maker.vec3(&[Vec3::ZERO, Vec3::new(4.0, 0.0, 0.0)]);
    let h = 0.5f32.sqrt();
    let turns =
        maker.accessor(bytemuck::cast_slice(&[0.0f32, 0.0, 0.0, 1.0, 0.0, h, 0.0, h]), 5126, 2, "VEC4", "");
    let rest = format!(
        r#"{mesh}, "materials": [{{}}], "cameras": [{{"type": "perspective", "perspective": {{"yfov": 0.7}}}}],
        "nodes": [{{"mesh": 0, "name": "still"}}, {{"name": "cart", "children": [2, 3]}}, {{"name": "eye", "camera": 0,
            "translation": [0, 1, 0]}}, {{"mesh": 0}}, {{"name": "fixed", "camera": 0}}],
        "animations": [{{"name": "drive", "samplers": [{{"input": {times}, "output": {there}}}, {{"input": {times}, "output": {turns},
            "interpolation": "STEP"}}], "channels": [{{"sampler": 0, "target": {{"node": 1, "path": "translation"}}}},
            {{"sampler": 1, "target": {{"node": 1, "path": "rotation"}}}}]}}]"#
    );
    let scene = loaded(&place, maker.text(&rest)).scene;
    assert_eq!(scene.paths.len(), 1);
    let path = &scene.paths[0];
    assert_eq!((path.name.as_str(), path.duration()), ("eye", 2.0));
    let camera = path.at(1.0, Vec3::Y, 0.7);
    assert!((camera.eye - Vec3::new(2.0, 1.0, 0.0)).length() < 1e-3, "{}", camera.eye);
    assert!(((camera.target - camera.eye).normalize() - Vec3::NEG_Z).length() < 1e-3);
    let end = path.at(2.0, Vec3::Y, 0.7);
    assert!(((end.target - end.eye).normalize() - Vec3::NEG_X).length() < 1e-3);
    // Things stand where they are before it begins, or at the time that the sidecar says.
    assert_eq!(scene.mesh.corners(2)[1], Vec3::X);
    place.write("a.toml", "format = 1\n[gltf]\nplay = \"drive\"\ntime = 2.0\n");
    let posed = loaded(&place, maker.text(&rest)).scene;
    assert_eq!(posed.mesh.corners(2)[1], Vec3::X * 3.0);
    assert_eq!(posed.mesh.corners(0)[1], Vec3::X);
}

#[test]
fn coordinates_are_scaled_turned_and_moved() {
    let picture = data_png(&[[255; 4]; 4]);
    let with = |name: &str, base: &str, normal: &str| {
        let materials = format!(
            r#"[{{"pbrMetallicRoughness": {{"baseColorTexture": {{"index": 0{base}}}}}{normal}}}],
            "textures": [{{"source": 0}}], "images": [{picture}]"#
        );
        with_materials(name, &materials)
    };
    let transform = |t: &str| format!(r#", "extensions": {{"KHR_texture_transform": {t}}}"#);
    // A quarter turn, counter-clockwise to the eye, takes the right of the picture's frame to its top: (1, 0) to (0, −1).
    let turned =
        with("gltf-turned", &transform(r#"{"rotation": 1.5707963267948966, "offset": [0.25, 0.5]}"#), "")
            .scene;
    let upper_left = |uv: Vec2| Vec2::new(uv.x, 1.0 - uv.y);
    for (corner, uv) in CORNERS.iter().zip(&turned.mesh.uvs) {
        let (u, v) = (corner.x, 1.0 - corner.y);
        assert!((upper_left(*uv) - Vec2::new(v + 0.25, 0.5 - u)).length() < 1e-6, "{corner} {uv}");
    }
    // Maps that lie differently keep scale and offset of their own.
    let normal = format!(r#", "normalTexture": {{"index": 0{}}}"#, transform(r#"{"scale": [3, 3]}"#));
    let apart = with("gltf-apart", &transform(r#"{"scale": [2, 4], "offset": [0.5, 0.25]}"#), &normal).scene;
    assert_eq!(apart.mesh.uvs[1], Vec2::new(1.0, 0.0));
    let Model::MetalRough(m) = &apart.materials[0].model else { panic!("{:?}", apart.materials[0]) };
    let of =
        |id: Option<crate::scene::TextureId>| apart.textures[id.unwrap().0 as usize].placement.scale_offset;
    assert_eq!(of(m.diffuse.map.or(m.specular.map)), [2.0, 4.0, 0.5, 1.0 - 4.0 - 0.25]);
    assert_eq!(of(apart.materials[0].normal_map), [3.0, 3.0, 0.0, -2.0]);
    // One that is turned beside one that is not.
    let odd =
        with("gltf-odd", &transform(r#"{"rotation": 1, "scale": [2, 3], "offset": [0.1, 0.2]}"#), &normal);
    assert!(odd.warnings.iter().all(|w| !w.message.contains("turned")), "{:?}", odd.warnings);
    let Model::MetalRough(m) = &odd.scene.materials[0].model else { panic!() };
    let map = m.diffuse.map.or(m.specular.map).unwrap();
    let (s, c) = crate::math::sin_cos(1.0);
    for uv in &odd.scene.mesh.uvs {
        let flat = upper_left(*uv) * Vec2::new(2.0, 3.0);
        let expected = Vec2::new(c * flat.x + s * flat.y + 0.1, c * flat.y - s * flat.x + 0.2);
        let found = upper_left(odd.scene.textures[map.0 as usize].placement.moved(*uv));
        assert!((found - expected).length() < 1e-5, "{found} {expected}");
    }
}

#[test]
fn unlit_things_show_their_colour_and_light_nothing() {
    let found = with_materials(
        "gltf-unlit",
        r#"[{"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.25, 1, 1]}, "extensions": {"KHR_materials_unlit": {}}}]"#,
    );
    let m = &found.scene.materials[0];
    assert!(m.shadeless && !m.is_emissive());
    assert_eq!(m.emission.color, Vec3::new(0.5, 0.25, 1.0));
    assert!(found.scene.environment.is_some(), "no light but that of the sky");
    assert!(crate::transport::light::Lights::build(&found.scene).total_power().is_finite());
}

#[test]
fn variants_and_required_extensions_are_chosen_by_name() {
    let place = Place::new("gltf-variants");
    let mut maker = Maker::default();
    let mesh = quad(&mut maker).replace(
        r#""material": 0"#,
        r#""material": 0, "extensions": {"KHR_materials_variants": {"mappings": [{"material": 1, "variants": [1]}]}}"#,
    );
    let rest = format!(
        r#"{mesh}, "nodes": [{{"mesh": 0}}], "materials": [{{"name": "wood"}}, {{"name": "steel"}}],
        "extensions": {{"KHR_materials_variants": {{"variants": [{{"name": "a"}}, {{"name": "b"}}]}}}},
        "extensionsRequired": ["KHR_materials_lint"], "extensionsUsed": ["KHR_materials_lint"]"#
    );
    let file = place.write("a.gltf", maker.text(&rest));
    let with = |ignored: &[&str], variant: Option<&str>| {
        let options = LoadOptions {
            ignored_extensions: ignored.iter().map(|s| (*s).to_owned()).collect(),
            variant: variant.map(str::to_owned),
            ..LoadOptions::default()
        };
        load_with(&file, &options)
    };
    assert!(matches!(with(&[], None), Err(SceneError::RequiredExtension { names, .. }) if names.len() == 1));
    let name = |variant| with(&["KHR_materials_lint"], variant).unwrap().scene.materials[0].name.clone();
    assert_eq!([name(None), name(Some("a")), name(Some("b"))], ["wood", "wood", "steel"]);
    assert!(says(&with(&["KHR_materials_lint"], Some("c")).unwrap(), "there are: a, b"));
    let hash = |variant| with(&["KHR_materials_lint"], variant).unwrap().scene.content_hash;
    assert_ne!(hash(None), hash(Some("b")), "bakes of the one are none of the other");
}

#[test]
fn no_name_leads_out_of_the_folder_or_to_a_device() {
    let place = Place::new("gltf-escapes");
    let secret = place.write("secret.bin", vec![0u8; 48]);
    let inner = place.0.join("inner");
    std::fs::create_dir_all(&inner).unwrap();
    let absolute = secret.display().to_string();
    let mut uris: Vec<String> = [
        "../secret.bin",
        "%2e%2e/secret.bin",
        "..%2Fsecret.bin",
        "..\\\\secret.bin",
        "x/../../secret.bin",
        "%252e%252e/secret.bin",
        "file:///etc/passwd",
        "file:../secret.bin",
        "http://example.org/a.bin",
        "C:\\\\a.bin",
        "\\\\\\\\host\\\\a.bin",
        "nowhere.bin",
        "",
        "data:;base64,*",
        "data:text/plain,abc",
    ]
    .map(String::from)
    .to_vec();
    uris.push(absolute);
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink("/dev/zero", inner.join("zero.bin")).unwrap();
        std::os::unix::fs::symlink("../secret.bin", inner.join("link.bin")).unwrap();
        let made = std::process::Command::new("mkfifo").arg(inner.join("pipe.bin")).status();
        assert!(made.is_ok_and(|s| s.success()));
        uris.extend(["zero.bin", "link.bin", "pipe.bin", "."].map(String::from));
    }
    for uri in uris {
        let text = format!(
            r#"{{"asset": {{"version": "2.0"}}, "buffers": [{{"uri": "{uri}", "byteLength": 36}}],
            "bufferViews": [{{"buffer": 0, "byteLength": 36}}],
            "accessors": [{{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}}],
            "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}}}}]}}], "nodes": [{{"mesh": 0}}]}}"#
        );
        let file = inner.join("a.gltf");
        std::fs::write(&file, text).unwrap();
        let error = load(&file).expect_err(&uri);
        let SceneError::Document { pointer, .. } = &error else { panic!("{uri}: {error}") };
        assert_eq!(pointer, "/buffers/0/uri", "{uri}");
        assert!(error.to_string().contains("a.gltf"), "{error}");
    }
}

#[test]
fn numbers_that_leave_the_bytes_end_with_the_place() {
    let place = Place::new("gltf-hostile");
    let mut maker = Maker::default();
    let mesh = quad(&mut maker);
    let good = maker.text(&format!(r#"{mesh}, "nodes": [{{"mesh": 0}}], "materials": [{{}}]"#));
    assert_eq!(area(&loaded(&place, &good).scene), 1.0);
    let refused = |from: &str, to: &str| -> (PathBuf, String, String) {
        assert!(good.contains(from), "{from}");
        let file = place.write("bad.gltf", good.replacen(from, to, 1));
        match load(&file) {
            Err(SceneError::Document { place, pointer, message }) => (place.path, pointer, message),
            other => panic!("{to}: {other:?}"),
        }
    };
    for (from, to, at) in [
        (r#""count": 4"#, r#""count": 5"#, "/accessors/0"),
        (r#""count": 4"#, r#""count": 1537228672809129302"#, "/accessors/0/count"),
        (r#""count": 4"#, r#""byteOffset": 18446744073709551612, "count": 4"#, "/accessors/0"),
        (r#""byteOffset": 0"#, r#""byteOffset": 18446744073709551600"#, "/bufferViews/0"),
        (r#""byteOffset": 0"#, r#""byteStride": 4, "byteOffset": 0"#, "/accessors/0/bufferView"),
        (r#""byteOffset": 0"#, r#""byteStride": 4294967296, "byteOffset": 0"#, "/bufferViews/0/byteStride"),
        (r#""bufferView": 0"#, r#""bufferView": 99"#, "/bufferViews"),
        (r#""buffer": 0"#, r#""buffer": 7"#, "/buffers"),
        (r#""VEC3""#, r#""VEC2""#, "/accessors/0/type"),
        (r#""VEC3""#, r#""VEC33""#, "/accessors/0/type"),
        (r#""componentType": 5126"#, r#""componentType": 5124"#, "/accessors/0/componentType"),
        (r#""POSITION": 0"#, r#""POSITION": 3"#, "/accessors"),
        (r#""indices": 2"#, r#""indices": 0"#, "/accessors/0"),
        (r#""mesh": 0"#, r#""mesh": 1"#, "/meshes"),
        (r#""mesh": 0"#, r#""mesh": 0, "children": [0]"#, "/nodes/0"),
        (r#""version": "2.0""#, r#""version": "1.0""#, "/asset/version"),
        (r#""material": 0"#, r#""material": 4"#, "/materials"),
        (r#""count": 4"#, r#""count": -1"#, ""),
        (r#""byteLength""#, r#""byteLengths""#, ""),
    ] {
        let (path, pointer, message) = refused(from, to);
        assert!(path.ends_with("bad.gltf") && pointer == at, "{to}: {pointer}: {message}");
        assert!(message.len() > 10, "{message}");
    }
    // Zeros cost nothing to write, so not many of them are made.
    for (count, more) in [
        (1u64 << 31, ""),
        (
            1 << 22,
            r#", "sparse": {"count": 4000000, "indices": {"bufferView": 0, "componentType": 5125}, "values": {"bufferView": 0}}"#,
        ),
    ] {
        let to = format!(r#""count": {count}, "type": "VEC3"{more}}}, {{"componentType": 5126, "count": 4"#);
        let (_, pointer, _) = refused(
            r#""bufferView": 0, "componentType": 5126, "count": 4"#,
            &format!(r#""componentType": 5126, {to}"#),
        );
        assert!(pointer.starts_with("/accessors/0"), "{pointer}");
    }
    let deep = format!(r#"{{"asset": {}1"#, "[".repeat(100_000));
    assert!(matches!(load(&place.write("deep.gltf", deep)), Err(SceneError::Document { .. })));
    let chunk = maker.glb(&mesh);
    let cut = load(&place.write("cut.glb", &chunk[..chunk.len() - 9]));
    assert!(matches!(cut, Err(SceneError::Container { .. })));
}

#[test]
fn what_a_file_does_not_draw_is_not_read() {
    let place = Place::new("gltf-unused");
    let mut maker = Maker::default();
    let mesh = quad(&mut maker);
    let text = maker.text(&format!(r#"{mesh}, "nodes": [{{"mesh": 0}}], "materials": [{{}}]"#));
    let text = text.replace(
        r#""buffers": ["#,
        r#""unknown": {"deep": [[1]]}, "images": [{"uri": "../x.png"}], "buffers": ["#,
    );
    let text = text.replacen("}],", r#"}, {"uri": "ftp://nowhere", "byteLength": 99}],"#, 1);
    assert_eq!(area(&loaded(&place, text).scene), 1.0);
}

#[test]
fn seventy_thousand_nodes_of_few_meshes_load() {
    let place = Place::new("gltf-many");
    let mut maker = Maker::default();
    let mesh = quad(&mut maker);
    let nodes: Vec<String> = (0..70_000)
        .map(|i| format!(r#"{{"mesh": 0, "translation": [{}, {}, 0]}}"#, i % 300, i / 300))
        .collect();
    let text = maker.text(&format!(
        r#"{mesh}, "nodes": [{}], "materials": [{{"pbrMetallicRoughness":
        {{"metallicFactor": 0, "roughnessFactor": 1}}}}]"#,
        nodes.join(",")
    ));
    let file = place.write("a.gltf", text);
    let scene = load(&file).unwrap().scene;
    assert_eq!((scene.mesh.triangles.len(), scene.objects.len()), (140_000, 1));
    let few = LoadOptions { triangles_max: 1000, ..LoadOptions::default() };
    let error = load_with(&file, &few).unwrap_err().to_string();
    assert!(error.contains("/nodes/500") && error.contains("1000 triangles"), "{error}");
}

#[test]
fn a_picture_that_is_not_there_shows_a_checker() {
    let found = with_materials(
        "gltf-missing",
        r#"[{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0},
        "normalTexture": {"index": 1}, "emissiveTexture": {"index": 2}, "emissiveFactor": [1, 1, 1]}],
        "textures": [{"source": 0}, {"source": 1}, {}], "images": [{"uri": "../up.png"}, {"uri": "none.png"}]"#,
    );
    assert!(says(&found, "leads out") && says(&found, "none.png"));
    assert!(found.scene.materials[0].normal_map.is_none());
    let place = Place::new("gltf-beside");
    place.write("maps/a b.png", png(2, 2, [255, 0, 0, 255]));
    let mut maker = Maker::default();
    let mesh = quad(&mut maker);
    let rest = format!(
        r#"{mesh}, "nodes": [{{"mesh": 0}}], "materials": [{{"pbrMetallicRoughness": {{"metallicFactor": 0,
        "baseColorTexture": {{"index": 0}}}}}}], "textures": [{{"source": 0}}], "images": [{{"uri": "maps/a%20b.png"}}]"#
    );
    let scene = loaded(&place, maker.text(&rest)).scene;
    assert_eq!((scene.textures.len(), scene.textures[0].name.as_str()), (1, "maps/a b.png"));
}

#[test]
fn what_only_glows_in_the_open_stands_under_a_sky() {
    let of = |name: &str, more: &str| {
        let place = Place::new(name);
        let mut maker = Maker::default();
        let mesh = quad(&mut maker);
        let rest = format!(
            r#"{mesh}, "nodes": [{{"mesh": 0}}{more}], "materials": [{{"emissiveFactor": [1, 1, 1]}}],
            "extensions": {{"KHR_lights_punctual": {{"lights": [{{"type": "point"}}]}}}}"#
        );
        loaded(&place, maker.text(&rest)).scene
    };
    let label = of("gltf-label", "");
    assert!(label.environment.is_some() && !label.display.metered);
    let lit = of(
        "gltf-lit",
        r#", {"extensions": {"KHR_lights_punctual": {"light": 0}}, "translation": [0, 0, 2]}"#,
    );
    assert!(lit.environment.is_none() && lit.display.metered);
}

#[test]
fn a_skin_of_one_joint_is_the_nodes_transform_and_targets_move_by_their_weights() {
    let place = Place::new("gltf-skin");
    let mut maker = Maker::default();
    let mesh = quad(&mut maker);
    let plain = format!(
        r#"{mesh}, "materials": [{{}}], "nodes": [{{"mesh": 0, "translation": [1, 2, 3], "rotation": [0, 0.6, 0, 0.8], "scale": [2, 2, 2]}}]"#
    );
    let plain = loaded(&place, maker.text(&plain)).scene.mesh.positions.clone();
    let joints = maker.accessor(&[0u8; 16], 5121, 4, "VEC4", "");
    let weights = maker.accessor(bytemuck::cast_slice(&[[0.5f32, 0.0, 0.0, 0.0]; 4]), 5126, 4, "VEC4", "");
    // Bound where x was one less.
    let bind = glam::Mat4::from_translation(Vec3::X).to_cols_array();
    let bind = maker.accessor(bytemuck::cast_slice(&bind), 5126, 1, "MAT4", "");
    let skinned = mesh.replace(
        r#""TEXCOORD_0""#,
        &format!(r#""JOINTS_0": {joints}, "WEIGHTS_0": {weights}, "TEXCOORD_0""#),
    );
    let rest = |joint: &str| {
        format!(
            r#"{skinned}, "materials": [{{}}], "nodes": [{{"mesh": 0, "skin": 0, "translation": [9, 9, 9]}},
            {{"translation": [1, 2, 3], "rotation": [0, 0.6, 0, 0.8], "scale": [2, 2, 2]}}],
            "skins": [{{"joints": [{joint}], "inverseBindMatrices": {bind}}}]"#
        )
    };
    let found = loaded(&place, maker.text(&rest("1")));
    // x = 1 of the bound mesh is where x = 0 of the plain one would be moved by one.
    let moved = found.scene.mesh.positions[0];
    assert!((moved - plain[1]).length() < 1e-5, "{moved} {plain:?}");
    let lost = loaded(&place, maker.text(&rest("1, 7")));
    assert!(says(&lost, "joints are not in the scene") || says(&lost, "matrix for each joint"));
    let up = maker.vec3(&[Vec3::Z * 4.0; 4]);
    let target =
        mesh.replace(r#""material": 0"#, &format!(r#""material": 0, "targets": [{{"POSITION": {up}}}]"#));
    for (weights, z) in [("", 0.0), (r#", "weights": [0.25]"#, 1.0)] {
        let rest = format!(r#"{target}, "materials": [{{}}], "nodes": [{{"mesh": 0{weights}}}]"#);
        let scene = loaded(&place, maker.text(&rest)).scene;
        assert!(scene.mesh.positions.iter().all(|p| p.z == z), "{:?}", scene.mesh.positions);
    }
}

#[test]
fn colours_of_vertices_are_factors_of_the_base_colour() {
    let place = Place::new("gltf-colors");
    let mut maker = Maker::default();
    let mesh = quad(&mut maker);
    let half = [1.0f32, 0.5, 0.0];
    let even = maker.accessor(bytemuck::cast_slice(&[half; 4]), 5126, 4, "VEC3", "");
    let of = |maker: &Maker, colors: usize| {
        let mesh = mesh.replace(r#""TEXCOORD_0""#, &format!(r#""COLOR_0": {colors}, "TEXCOORD_0""#));
        let rest = format!(
            r#"{mesh}, "nodes": [{{"mesh": 0}}], "materials": [{{"extensions": {{"KHR_materials_unlit": {{}}}},
            "pbrMetallicRoughness": {{"baseColorFactor": [0.5, 1, 1, 1]}}}}]"#
        );
        loaded(&place, maker.text(&rest)).scene
    };
    let scene = of(&maker, even);
    assert_eq!(scene.materials.len(), 1);
    assert!((scene.materials[0].emission.color - Vec3::new(0.5, 0.5, 0.0)).abs().max_element() < 0.005);
    // Each triangle the mean of its corners; the same area in as many triangles.
    let bytes = [[255u8, 0, 0, 255], [255, 0, 0, 255], [255, 0, 0, 255], [0, 0, 255, 255]];
    let uneven = maker.accessor(&bytes.concat(), 5121, 4, "VEC4", r#", "normalized": true"#);
    let scene = of(&maker, uneven);
    assert_eq!((scene.materials.len(), scene.mesh.triangles.len(), area(&scene)), (2, 2, 1.0));
    assert!(scene.materials[1].emission.color.z > 0.3);
}

#[test]
fn normals_lean_as_far_as_their_scale_says() {
    // Leaning by 45 degrees along x: half as far is a slope of one half.
    let lean = data_png(&[[218, 128, 218, 255]]);
    let found = with_materials(
        "gltf-lean",
        &format!(
            r#"[{{"normalTexture": {{"index": 0, "scale": 0.5}}}}], "textures": [{{"source": 0}}], "images": [{lean}]"#
        ),
    );
    let map = found.scene.materials[0].normal_map.unwrap();
    assert_eq!(found.scene.textures.len(), 1);
    let [x, y, z, _] = found.scene.textures[map.0 as usize].texel(0, 0, 0).map(|v| 2.0 * v - 1.0);
    assert!((x / z - 0.5).abs() < 0.01 && y.abs() < 0.01, "{x} {y} {z}");
}
