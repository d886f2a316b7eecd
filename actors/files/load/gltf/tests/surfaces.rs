//! Materials and their maps.

use super::*;

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
    let texel = |r: &foveal::scene::Reflectance, x| scene.textures[r.map.unwrap().0 as usize].texel(0, x, 0);
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
    use foveal::geometry::Ray;
    let place = TempFolder::new(name);
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
    let world = foveal::world::World::new(
        scene.into(),
        std::sync::Arc::new(foveal::illumination::Uniform(Vec3::ZERO)),
    );
    let mean = |i: u64| {
        let stream = foveal::rng::Stream::new(3, i, 0);
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
    let glass = with_body(
        "gltf-volume",
        r#"[{"pbrMetallicRoughness": {"baseColorFactor": [0.5, 1, 1, 1], "roughnessFactor": 0}, "extensions":
        {"KHR_materials_transmission": {"transmissionFactor": 1}, "KHR_materials_volume": {"thicknessFactor": 1,
        "attenuationDistance": 0.5, "attenuationColor": [0.5, 0.25, 1]}, "KHR_materials_ior": {"ior": 1.3}}}]"#,
    );
    // Metal by default, which is no glass.
    assert!(matches!(glass.scene.materials[0].model, Model::MetalRough(_)));
    let glass = with_body(
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
    // An open mesh encloses nothing.
    let pane = with_materials(
        "gltf-volume-open",
        r#"[{"pbrMetallicRoughness": {"metallicFactor": 0}, "extensions": {"KHR_materials_transmission": {"transmissionFactor": 1},
        "KHR_materials_volume": {"thicknessFactor": 1}}}]"#,
    );
    assert!(says(&pane, "mesh is open") && matches!(pane.scene.materials[0].model, Model::MetalRough(_)));
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
        |id: Option<foveal::scene::TextureId>| apart.textures[id.unwrap().0 as usize].placement.scale_offset;
    assert_eq!(of(m.diffuse.map.or(m.specular.map)), [2.0, 4.0, 0.5, 1.0 - 4.0 - 0.25]);
    assert_eq!(of(apart.materials[0].normal_map), [3.0, 3.0, 0.0, -2.0]);
    // One that is turned beside one that is not.
    let odd =
        with("gltf-odd", &transform(r#"{"rotation": 1, "scale": [2, 3], "offset": [0.1, 0.2]}"#), &normal);
    assert!(odd.warnings.iter().all(|w| !w.message.contains("turned")), "{:?}", odd.warnings);
    let Model::MetalRough(m) = &odd.scene.materials[0].model else { panic!() };
    let map = m.diffuse.map.or(m.specular.map).unwrap();
    let (s, c) = foveal::math::sin_cos(1.0);
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
    assert!(!foveal::transport::light::Lights::build(&found.scene).is_empty());
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
    let place = TempFolder::new("gltf-beside");
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
        let place = TempFolder::new(name);
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
