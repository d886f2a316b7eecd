//! Meshes: however a file says one, the same triangles come of it.

use super::*;

#[test]
fn an_obj_and_a_gltf_of_one_scene_have_the_same_bits() {
    let place = TempFolder::new("gltf-pair");
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
        let place = TempFolder::new(&format!("gltf-mode-{mode}-{}", indices.len() + indices[3] as usize));
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
    let place = TempFolder::new("gltf-sparse");
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
    let place = TempFolder::new("gltf-instances");
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
    assert_eq!(names, ["near", "mirrored", "many[0]", "many[1]"]);
    let paths: Vec<&str> = scene.things.iter().map(|thing| thing.path.as_str()).collect();
    assert_eq!(paths, ["near", "group/mirrored", "many[0]", "many[1]"]);
    let of: Vec<u32> = (0..8).map(|t| scene.things.of(t).expect("a thing").0).collect();
    assert_eq!(of, [0, 0, 1, 1, 2, 2, 3, 3]);
    place.write("a.toml", "format = 1\n[gltf]\nscene = \"other\"\n");
    let other = loaded(&place, maker.text(&rest)).scene;
    assert_eq!((other.mesh.triangles.len(), other.objects[1].name.as_str()), (2, "of another scene"));
}

/// Diffuse things are things too, whatever hangs from what; a name that is there twice means two of them.
#[test]
fn diffuse_nodes_are_things_with_paths_and_parents() {
    let place = TempFolder::new("gltf-things");
    let mut maker = Maker::default();
    let mesh = quad(&mut maker);
    let rest = format!(
        r#"{mesh}, "nodes": [
            {{"mesh": 0, "name": "table", "children": [1, 2]}},
            {{"children": [3]}},
            {{"mesh": 0, "name": "a/b"}},
            {{"mesh": 0}},
            {{"mesh": 0, "name": "table"}}],
        "scenes": [{{"nodes": [0, 4]}}], "scene": 0,
        "materials": [{{"pbrMetallicRoughness": {{"metallicFactor": 0}}}}]"#
    );
    let scene = loaded(&place, maker.text(&rest)).scene;
    assert_eq!(scene.objects.len(), 1);
    let things: Vec<(&str, Option<u32>)> =
        scene.things.iter().map(|t| (t.path.as_str(), t.parent.map(|p| p.0))).collect();
    let expected = [
        ("table", None),
        // Without a name of its own it goes by its mesh's.
        ("table/node 1/sheet", Some(0)),
        ("table/a\\/b", Some(0)),
        ("table#2", None),
    ];
    assert_eq!(things, expected);
    assert_eq!(scene.things.find("a/b"), scene.things.find("table/a\\/b"));
    assert_eq!(scene.things.at(7).map(|t| t.path.as_str()), Some("table#2"));
}

/// A chain of nodes makes paths no longer than a few names.
#[test]
fn paths_of_deep_nodes_are_short() {
    let place = TempFolder::new("gltf-deep");
    let mut maker = Maker::default();
    let mesh = quad(&mut maker);
    let name = "n".repeat(300);
    let nodes: Vec<String> = (0..1000)
        .map(|i| format!(r#"{{"mesh": 0, "name": "{name}", "children": [{}]}}"#, i + 1))
        .chain([r#"{"mesh": 0}"#.to_owned()])
        .collect();
    let rest = format!(
        r#"{mesh}, "nodes": [{}], "scenes": [{{"nodes": [0]}}], "scene": 0, "materials": [{{}}]"#,
        nodes.join(",")
    );
    let scene = loaded(&place, maker.text(&rest)).scene;
    assert_eq!(scene.things.len(), 1001);
    let longest = scene.things.iter().map(|thing| thing.path.len()).max();
    assert!(longest < Some(1000), "{longest:?}");
    assert!(scene.things.at(2001).is_some_and(|t| t.path.starts_with("…/") && t.path.ends_with("/sheet")));
}

#[test]
fn compressed_views_are_those_that_they_were_made_of() {
    let place = TempFolder::new("gltf-meshopt");
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
fn seventy_thousand_nodes_of_few_meshes_load() {
    let place = TempFolder::new("gltf-many");
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
fn colours_of_vertices_are_factors_of_the_base_colour() {
    let place = TempFolder::new("gltf-colors");
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
