//! Maps of materials that are read point by point, and what light does at such surfaces.

use super::*;
use foveal::geometry::{Accel, Hit, Ray};
use foveal::illumination::Uniform;
use foveal::rng::Stream;
use foveal::scene::{Placement, Wrap};
use foveal::transport::bsdf::Bsdf;
use foveal::transport::bsdf::bands::Band;
use foveal::transport::interaction::Interaction;
use foveal::transport::light::Receiver;
use foveal::world::World;

/// The quad with a second set of coordinates, which is the first one turned over: (y, x) from the lower left.
fn with_two_sets(name: &str, materials: &str) -> Loaded {
    let place = TempFolder::new(name);
    let mut maker = Maker::default();
    let mesh = quad(&mut maker);
    let other = maker.vec2(&CORNERS.map(|p| Vec2::new(p.y, 1.0 - p.x)));
    let mesh = mesh.replace(r#""TEXCOORD_0":"#, &format!(r#""TEXCOORD_1": {other}, "TEXCOORD_0":"#));
    let rest = format!(r#"{mesh}, "nodes": [{{"mesh": 0, "name": "thing"}}], "materials": {materials}"#);
    loaded(&place, maker.text(&rest))
}

/// The quad at a place, seen from straight above.
fn at(scene: &Scene, x: f32, y: f32) -> Interaction {
    let accel = Accel::build(scene);
    let ray = Ray::new(Vec3::new(x, y, 1.0), Vec3::NEG_Z);
    let hit = accel.intersect(scene, &ray).expect("the quad");
    Interaction::at(scene, &ray, &hit)
}

fn made(scene: &Scene, x: f32, y: f32) -> foveal::scene::recipe::Made {
    let at = at(scene, x, y);
    at.point().made(scene, scene.materials[at.material.0 as usize].model.recipe().expect("a recipe"))
}

#[test]
fn each_map_has_coordinates_of_its_own() {
    // Red, green, blue, black from the upper left, row by row; the nearest texel is shown.
    let colors = data_png_of(2, &[[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [0, 0, 0, 255]]);
    let rough = data_png_of(2, &[[0, 255, 0, 255], [0, 0, 0, 255], [0, 255, 0, 255], [0, 0, 0, 255]]);
    let found = with_two_sets(
        "gltf-two-sets",
        &format!(
            r#"[{{"pbrMetallicRoughness": {{"baseColorTexture": {{"index": 0}}, "metallicFactor": 0,
            "metallicRoughnessTexture": {{"index": 1, "texCoord": 1}}}}}}],
            "textures": [{{"source": 0, "sampler": 0}}, {{"source": 1, "sampler": 0}}], "images": [{colors}, {rough}],
            "samplers": [{{"magFilter": 9728, "wrapS": 33648, "wrapT": 33071}}]"#
        ),
    );
    assert!(found.warnings.iter().all(|w| !w.message.contains("mean")), "{:?}", found.warnings);
    let scene = &found.scene;
    let placement = scene.textures[0].placement;
    assert_eq!((placement.wrap, placement.nearest), ([Wrap::Mirror, Wrap::Clamp], true));
    assert!(scene.textures.iter().any(|t| t.placement.second));
    // The left half is red above and blue below; it is rough where y, the second u, is small.
    for (x, y) in [(0.25, 0.75), (0.75, 0.75), (0.25, 0.25), (0.75, 0.25)] {
        let m = made(scene, x, y);
        assert_eq!(m.roughness, if y < 0.5 { 1.0 } else { 0.0 }, "{x} {y}");
        let color = Vec3::new(
            f32::from(x < 0.5 && y > 0.5),
            f32::from(x > 0.5 && y > 0.5),
            f32::from(x < 0.5 && y < 0.5),
        );
        assert_eq!(m.diffuse.normalize_or_zero(), color, "{x} {y}");
    }
    let Model::MetalRough(m) = &scene.materials[0].model else { panic!() };
    assert_eq!((m.roughness_range, m.is_diffuse), ([0.0, 1.0], false));
}

#[test]
fn a_map_of_one_value_is_a_factor() {
    // 51 is a fifth; as a colour it is 0.0331.
    let (fifth, linear) = (0.2, foveal::image::linear_from_srgb(0.2));
    let picture = data_png(&[[51; 4]; 4]);
    let look = |name: &str, body: &str| {
        let text = format!(
            r#"[{{"pbrMetallicRoughness": {{"metallicFactor": 0.25, "roughnessFactor": 0.5}}, "extensions": {{{body}}}}}],
            "textures": [{{"source": 0}}], "images": [{picture}]"#
        );
        let scene = with_materials(name, &text).scene;
        let at = at(&scene, 0.3, 0.6);
        let bsdf = Bsdf::at(&scene, &at);
        let wi = Vec3::new(0.3, -0.2, 0.7).normalize();
        let wo = at.wo;
        [
            bsdf.evaluate_all(wo, wi),
            bsdf.diffuse_albedo(),
            bsdf.passed_albedo(),
            bsdf.view_dependent_albedo(wo),
        ]
    };
    let map = r#"{"index": 0}"#;
    let cases: [(&str, String, String); 7] = [
        (
            "coat",
            format!(
                r#""KHR_materials_clearcoat": {{"clearcoatFactor": 0.5, "clearcoatRoughnessFactor": 1, "clearcoatTexture": {map}, "clearcoatRoughnessTexture": {map}}}"#
            ),
            format!(
                r#""KHR_materials_clearcoat": {{"clearcoatFactor": {}, "clearcoatRoughnessFactor": {fifth}}}"#,
                0.5 * fifth
            ),
        ),
        (
            "sheen",
            format!(
                r#""KHR_materials_sheen": {{"sheenColorFactor": [1, 0.5, 1], "sheenRoughnessFactor": 1, "sheenColorTexture": {map}, "sheenRoughnessTexture": {map}}}"#
            ),
            format!(
                r#""KHR_materials_sheen": {{"sheenColorFactor": [{linear}, {}, {linear}], "sheenRoughnessFactor": {fifth}}}"#,
                0.5 * linear
            ),
        ),
        (
            "specular",
            format!(r#""KHR_materials_specular": {{"specularFactor": 1, "specularTexture": {map}}}"#),
            format!(r#""KHR_materials_specular": {{"specularFactor": {fifth}}}"#),
        ),
        (
            "specular-color",
            format!(
                r#""KHR_materials_specular": {{"specularColorFactor": [1, 2, 3], "specularColorTexture": {map}}}"#
            ),
            format!(
                r#""KHR_materials_specular": {{"specularColorFactor": [{linear}, {}, {}]}}"#,
                2.0 * linear,
                3.0 * linear
            ),
        ),
        (
            "film",
            format!(
                r#""KHR_materials_iridescence": {{"iridescenceFactor": 1, "iridescenceTexture": {map}, "iridescenceThicknessMinimum": 300, "iridescenceThicknessMaximum": 500, "iridescenceThicknessTexture": {map}}}"#
            ),
            format!(
                r#""KHR_materials_iridescence": {{"iridescenceFactor": {fifth}, "iridescenceThicknessMaximum": 340}}"#
            ),
        ),
        (
            "passes",
            format!(
                r#""KHR_materials_diffuse_transmission": {{"diffuseTransmissionFactor": 1, "diffuseTransmissionTexture": {map}, "diffuseTransmissionColorFactor": [1, 1, 0.5], "diffuseTransmissionColorTexture": {map}}}"#
            ),
            format!(
                r#""KHR_materials_diffuse_transmission": {{"diffuseTransmissionFactor": {fifth}, "diffuseTransmissionColorFactor": [{linear}, {linear}, {}]}}"#,
                0.5 * linear
            ),
        ),
        (
            "gloss",
            format!(
                r#""KHR_materials_pbrSpecularGlossiness": {{"specularFactor": [1, 1, 0.5], "glossinessFactor": 1, "specularGlossinessTexture": {map}}}"#
            ),
            format!(
                r#""KHR_materials_pbrSpecularGlossiness": {{"specularFactor": [{linear}, {linear}, {}], "glossinessFactor": {fifth}}}"#,
                0.5 * linear
            ),
        ),
    ];
    for (name, mapped, constant) in cases {
        let [a, b] = [("map", mapped), ("flat", constant)]
            .map(|(kind, body)| look(&format!("gltf-{name}-{kind}"), &body));
        for (a, b) in a.into_iter().zip(b) {
            // What is made ready takes means from finer integrals than what is read point by point.
            assert!((a - b).abs().max_element() < 2e-3, "{name}: {a} {b}");
        }
    }
}

#[test]
fn backs_are_seen_through_and_lit_all_the_same() {
    let load = |name: &str, material: &str| with_materials(name, &format!("[{material}]")).scene;
    let sees = |scene: &Scene, z: f32| {
        let accel = Accel::build(scene);
        let ray = Ray::new(Vec3::new(0.3, 0.4, z), Vec3::NEG_Z * z.signum());
        let packet = accel.intersect_packet(scene, ray.origin, &[ray.direction; 16]);
        assert_eq!(packet[3].is_some(), accel.intersect_seen(scene, &ray).is_some());
        assert!(accel.intersect(scene, &ray).is_some(), "light meets both sides");
        packet[3].is_some()
    };
    let single = load("gltf-single", "{}");
    assert_eq!([sees(&single, 1.0), sees(&single, -1.0)], [true, false]);
    let double = load("gltf-double", r#"{"doubleSided": true}"#);
    assert_eq!([sees(&double, 1.0), sees(&double, -1.0)], [true, true]);
    let glass = with_body(
        "gltf-cull-glass",
        r#"[{"pbrMetallicRoughness": {"metallicFactor": 0}, "extensions": {"KHR_materials_transmission": {"transmissionFactor": 1},
        "KHR_materials_volume": {"thicknessFactor": 1}}}]"#,
    );
    assert!(!glass.scene.materials[0].culled && single.materials[0].culled);
    let place = TempFolder::new("gltf-no-cull");
    let mut maker = Maker::default();
    let mesh = quad(&mut maker);
    place.write("a.toml", "format = 1\n[gltf]\ncull = false\n");
    let shown =
        loaded(&place, maker.text(&format!(r#"{mesh}, "nodes": [{{"mesh": 0}}], "materials": [{{}}]"#)));
    assert!(sees(&shown.scene, -1.0));
    // Two sheets back to back: each is seen from its side, at one distance.
    let both = load("gltf-cull-both", "{}");
    let mut scene = both.clone();
    let back: Vec<[u32; 3]> = scene.mesh.triangles.iter().map(|&[a, b, c]| [a, c, b]).collect();
    scene.mesh.triangles.extend(back);
    scene.mesh.objects.extend_from_within(..);
    scene.mesh.materials.extend_from_within(..);
    assert_eq!([sees(&scene, 1.0), sees(&scene, -1.0)], [true, true]);
}

#[test]
fn sheets_glow_on_both_sides_where_they_are_double_sided() {
    let seen = |scene: &Scene, z: f32| {
        let world = World::new(scene.clone().into(), std::sync::Arc::new(Uniform(Vec3::ZERO)));
        let ray = Ray::new(Vec3::new(0.3, 0.4, z), Vec3::NEG_Z * z.signum());
        world.path_radiance(&ray, Stream::new(1, 2, 3)).x
    };
    let one = r#""emissiveFactor": [1, 1, 1], "pbrMetallicRoughness": {"baseColorFactor": [0, 0, 0, 1]}"#;
    let single = with_materials("gltf-glow-single", &format!("[{{{one}}}]"));
    let double = with_materials("gltf-glow-double", &format!(r#"[{{{one}, "doubleSided": true}}]"#));
    assert!(double.warnings.iter().all(|w| !w.message.contains("double-sided")), "{:?}", double.warnings);
    let [single, double] = [single, double].map(|loaded| loaded.scene);
    assert_eq!(double.mesh.triangles.len(), 2 * single.mesh.triangles.len());
    // Its gloss shows a little of the sky.
    let glows = |v: f32| (1.0..1.1).contains(&v);
    assert!(glows(seen(&double, 1.0)) && glows(seen(&double, -1.0)));
    assert!(glows(seen(&single, 1.0)) && !glows(seen(&single, -1.0)));
    // Both sides are light sources.
    let power = |scene: &Scene, z: f32| {
        const SHARES: u32 = 4096;
        let lights = foveal::transport::light::Lights::build(scene);
        let at = Receiver { point: Vec3::new(0.5, 0.5, z), normal: Vec3::NEG_Z * z.signum() };
        let drawn = (0..SHARES).filter_map(|i| {
            let u = (f64::from(i) + 0.5) / f64::from(SHARES);
            lights.sample_towards(scene, &at, (u, [0.5, 0.5]), None)
        });
        // Without the sky that such a scene gets.
        let near = drawn.filter(|sample| sample.distance.is_finite());
        near.map(|sample| sample.radiance.x / sample.pdf).sum::<f32>() / SHARES as f32
    };
    assert!((power(&double, 1.0) / power(&double, -1.0) - 1.0).abs() < 2e-2);
    assert!((power(&double, 1.0) / power(&single, 1.0) - 1.0).abs() < 2e-2 && power(&single, -1.0) == 0.0);
    // What is closed has an inside that nobody sees.
    let body = format!(r#"[{{{one}, "doubleSided": true}}]"#);
    let body = with_body("gltf-glow-body", &body).scene;
    let plain = with_body("gltf-plain-body", "[{}]").scene;
    assert_eq!(body.mesh.triangles.len(), plain.mesh.triangles.len());
}

/// The right half of each face is black, seen from within; the last face is half as bright again as white.
#[test]
fn pictures_all_around_light_the_scene() {
    let face = |[r, g, b]: [u8; 3], alpha: u8| {
        let (color, dark) = ([r, g, b, alpha], [0, 0, 0, 255]);
        data_png_of(2, &[color, dark, color, dark])
    };
    let colors = [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 0], [0, 255, 255], [255, 255, 255]];
    let faces: Vec<String> =
        colors.iter().enumerate().map(|(i, c)| face(*c, if i == 5 { 170 } else { 255 })).collect();
    let scene = |name: &str, rest: &str, images: &str| {
        with_materials(
            name,
            &format!(
                r#"[{{}}], "images": [{images}], "scene": 0, "extensionsRequired": ["EXT_lights_image_based"],
                "extensionsUsed": ["EXT_lights_image_based"],
                "scenes": [{{"nodes": [0], "extensions": {{"EXT_lights_image_based": {{"light": 0}}}}}}],
                "extensions": {{"EXT_lights_image_based": {{"lights": [{{"intensity": 2, {rest}
                "irradianceCoefficients": [], "specularImageSize": 2, "specularImages": [[0, 1, 2, 3, 4, 5]]}}]}}}}"#
            ),
        )
    };
    let loaded = scene("gltf-cube-map", "", &faces.join(","));
    assert!(!loaded.warnings.iter().any(|w| w.message.contains("no light")), "{:?}", loaded.warnings);
    assert!(loaded.scene.display.metered);
    let around = loaded.scene.environment.as_ref().expect("an environment");
    let axes = [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];
    // What is upright there, or behind where up is looked at, and what is to the right of both.
    let ups = [Vec3::Y, Vec3::Y, Vec3::NEG_Z, Vec3::Z, Vec3::Y, Vec3::Y];
    for ((axis, up), color) in axes.into_iter().zip(ups).zip(colors) {
        let expected = Vec3::from(color.map(f32::from)) / 255.0 * if axis == Vec3::NEG_Z { 3.0 } else { 2.0 };
        let right = axis.cross(up);
        let close = |a: Vec3, b: Vec3| assert!((a - b).length() < 0.02, "{axis}: {a}, not {b}");
        close(around.radiance(axis - right * 0.6), expected);
        close(around.radiance(axis + right * 0.6), Vec3::ZERO);
    }
    // A quarter turn about y brings what was at +z to +x.
    let h = 0.5f32.sqrt();
    let turned =
        scene("gltf-cube-map-turned", &format!(r#""rotation": [0, {h}, 0, {h}],"#), &faces.join(","));
    let turned = turned.scene.environment.as_ref().expect("an environment");
    let seen = |around: &foveal::scene::Environment, d: Vec3| around.radiance(d + d.cross(Vec3::NEG_Y) * 0.6);
    assert!((seen(turned, Vec3::X) - seen(around, Vec3::Z)).length() < 0.02);
    // Pictures that are no cube are told, and a sky is made up.
    let mut odd = faces.clone();
    odd[3] = data_png_of(1, &[[9; 4]; 2]);
    let broken = scene("gltf-cube-map-odd", "", &odd.join(","));
    assert!(broken.warnings.iter().any(|w| w.message.contains("six squares")), "{:?}", broken.warnings);
    assert!(broken.scene.environment.as_ref().is_some_and(|e| e.map.is_none()));
}

#[test]
fn normals_lean_along_tangents_of_the_file_or_made_ones() {
    // Leans towards +x of the tangent frame by half a right angle.
    let leaning = data_png(&[[218, 128, 218, 255]; 4]);
    let materials = |uv: &str| {
        format!(
            r#"[{{"normalTexture": {{"index": 0{uv}}}}}], "textures": [{{"source": 0}}], "images": [{leaning}]"#
        )
    };
    let lean = |scene: &Scene| at(scene, 0.3, 0.6).shading_normal;
    let close = |a: Vec3, b: Vec3| assert!((a - b).length() < 0.02, "{a} {b}");
    let h = 0.5f32.sqrt();
    close(lean(&with_materials("gltf-lean-u", &materials("")).scene), Vec3::new(h, 0.0, h));
    // The second set's u goes up.
    close(lean(&with_two_sets("gltf-lean-v", &materials(r#", "texCoord": 1"#)).scene), Vec3::new(0.0, h, h));
    // The file's own tangents count before that.
    let place = TempFolder::new("gltf-lean-own");
    let mut maker = Maker::default();
    let mesh = quad(&mut maker);
    let own: Vec<f32> = [-1.0, 0.0, 0.0, 1.0].repeat(4);
    let tangent = maker.accessor(bytemuck::cast_slice(&own), 5126, 4, "VEC4", "");
    let mesh = mesh.replace(r#""TEXCOORD_0":"#, &format!(r#""TANGENT": {tangent}, "TEXCOORD_0":"#));
    let text = maker.text(&format!(r#"{mesh}, "nodes": [{{"mesh": 0}}], "materials": {}"#, materials("")));
    close(lean(&loaded(&place, text).scene), Vec3::new(-h, 0.0, h));
}

#[test]
fn a_coat_lies_smooth_over_bumps_unless_it_has_some_of_its_own() {
    let leaning = data_png(&[[218, 128, 218, 255]; 4]);
    let look = |name: &str, of_coat: &str| {
        let text = format!(
            r#"[{{"normalTexture": {{"index": 0}}, "extensions": {{"KHR_materials_clearcoat": {{"clearcoatFactor": 1{of_coat}}}}}}}],
            "textures": [{{"source": 0}}], "images": [{leaning}]"#
        );
        let scene = with_materials(name, &text).scene;
        let at = at(&scene, 0.3, 0.6);
        let bsdf = Bsdf::at(&scene, &at);
        let delta = bsdf.parts().find_map(|part| part.delta_lobes(at.wo)[0]).expect("a smooth coat");
        (delta.wi, at.shading_normal)
    };
    let (mirrored, below) = look("gltf-coat-smooth", "");
    assert!((mirrored - Vec3::Z).length() < 1e-5 && below.x > 0.5, "{mirrored}");
    let (mirrored, _) = look("gltf-coat-bumps", r#", "clearcoatNormalTexture": {"index": 0}"#);
    // Half a right angle of the normal is a whole one of what it mirrors.
    assert!((mirrored - Vec3::X).length() < 0.1, "{mirrored}");
}

#[test]
fn light_passes_a_leaf_and_none_is_made() {
    let leaf = |name: &str, q: f32| {
        with_materials(
            name,
            &format!(
                r#"[{{"pbrMetallicRoughness": {{"metallicFactor": 0, "baseColorFactor": [0.5, 0.5, 0.5, 1]}}, "extensions": {{
                "KHR_materials_specular": {{"specularFactor": 0}}, "KHR_materials_diffuse_transmission":
                {{"diffuseTransmissionFactor": {q}, "diffuseTransmissionColorFactor": [0.2, 0.8, 0.4]}}}}}}]"#
            ),
        )
        .scene
    };
    for (i, q) in [0.25, 0.6, 1.0].into_iter().enumerate() {
        let mut scene = leaf(&format!("gltf-leaf-{i}"), q);
        // (1 − q) b of what falls on this side, q c of what falls on the other.
        let expected = Vec3::splat(0.5 * (1.0 - q)) + Vec3::new(0.2, 0.8, 0.4) * q;
        let here = at(&scene, 0.3, 0.6);
        let bsdf = Bsdf::at(&scene, &here);
        assert!((bsdf.diffuse_albedo() + bsdf.passed_albedo() - expected).abs().max_element() < 1e-5);
        // Under as much light from everywhere, by the stored light and by paths.
        scene.lights.clear();
        scene.environment =
            Some(foveal::scene::Environment { radiance: Vec3::ONE, map: None, rotate_up: 0.0, up: Vec3::Y });
        let world = World::new(scene.into(), std::sync::Arc::new(Uniform(Vec3::splat(std::f32::consts::PI))));
        let shown = world.tracer().base(&here.point(), || here);
        assert!((shown - expected).abs().max_element() < 1e-4, "{shown} {expected}");
        let paths = world.gather(foveal::transport::gather::Trust::Nobody);
        let ray = Ray::new(Vec3::new(0.3, 0.6, 1.0), Vec3::NEG_Z);
        let n = 4000;
        let seen: Vec3 = (0..n).map(|i| paths.radiance(&ray, Stream::new(5, i, 0))).sum::<Vec3>() / n as f32;
        assert!((seen - expected).abs().max_element() < 0.02, "{seen} {expected}");
    }
}

/// A body of clear glass with further extensions, each after a comma.
fn body_of_glass(name: &str, roughness: f32, more: &str) -> Loaded {
    with_body(
        name,
        &format!(
            r#"[{{"pbrMetallicRoughness": {{"metallicFactor": 0, "roughnessFactor": {roughness}}}, "extensions": {{
            "KHR_materials_transmission": {{"transmissionFactor": 1}}, "KHR_materials_volume": {{"thicknessFactor": 1}}
            {more}}}}}]"#
        ),
    )
}

/// Its first triangle as a ray meets it.
fn first_face(scene: &Scene, ray: Ray) -> (Bsdf, Vec3) {
    let hit = Hit { t: 1.0, triangle: 0, b1: 0.2, b2: 0.2 };
    let at = Interaction::at(scene, &ray, &hit);
    (Bsdf::at(scene, &at), at.wo)
}

#[test]
fn glass_bends_each_band_by_its_own_index() {
    let glass = |name: &str, d: f32| {
        let dispersion = format!(r#", "KHR_materials_dispersion": {{"dispersion": {d}}}"#);
        body_of_glass(name, 0.0, &dispersion).scene
    };
    let scene = glass("gltf-dispersion", 2.0);
    let direction = Vec3::new(0.6, 0.0, -0.8);
    let (bsdf, wo) = first_face(&scene, Ray::new(Vec3::ZERO, direction));
    assert!(bsdf.is_dispersive());
    let mut sum = Vec3::ZERO;
    for (k, band) in Band::ALL.into_iter().enumerate() {
        let index = 1.5 + (k as f32 - 1.0) * 0.5 * 0.025 * 2.0;
        let [_, Some(through)] = bsdf.where_band_crosses(band, 1.0).delta_lobes(wo) else { panic!() };
        // Snell: 0.6 outside.
        assert!((through.wi.x - 0.6 / index).abs() < 1e-5, "{k} {}", through.wi);
        assert_eq!(through.weight * (Vec3::ONE - band.color()), Vec3::ZERO);
        sum += through.weight;
        // Out again through the other side, it is bent back.
        let (inner, wo) = first_face(&scene, Ray::new(Vec3::ZERO, -through.wi.with_x(-through.wi.x)));
        let [_, Some(out)] = inner.of_band(band).delta_lobes(wo) else { panic!() };
        assert!((out.wi.x.abs() - 0.6).abs() < 1e-5, "{}", out.wi);
    }
    let [_, Some(white)] =
        first_face(&glass("gltf-no-dispersion", 0.0), Ray::new(Vec3::ZERO, direction)).0.delta_lobes(wo)
    else {
        panic!()
    };
    // What is bent more is reflected more; on average as much.
    let mean = sum.element_sum() / 3.0;
    assert!(sum.x > sum.z && (mean - white.weight.x).abs() < 1e-4, "{sum} {}", white.weight);
}

#[test]
fn a_film_and_a_coat_on_a_body_of_glass_are_seen_from_both_sides() {
    let film =
        r#", "KHR_materials_iridescence": {"iridescenceFactor": 1, "iridescenceThicknessMaximum": 420}"#;
    let coat = r#", "KHR_materials_clearcoat": {"clearcoatFactor": 1}"#;
    let both = |scene: &Scene, direction: Vec3| {
        let (bsdf, wo) = first_face(scene, Ray::new(Vec3::ZERO, direction));
        let [Some(reflected), Some(through)] = bsdf.delta_lobes(wo) else { panic!("both") };
        assert!((reflected.weight + through.weight - Vec3::ONE).abs().max_element() < 1e-6);
        (reflected.weight, through)
    };
    let direction = Vec3::new(0.6, 0.0, -0.8);
    let bare = both(&body_of_glass("gltf-bare", 0.0, "").scene, direction).0;
    let coated = body_of_glass("gltf-coated-glass", 0.0, coat);
    let (reflected, _) = both(&coated.scene, direction);
    assert!(reflected.x > 1.5 * bare.x && reflected.x < 2.0 * bare.x, "a second face: {reflected} {bare}");
    assert_eq!(reflected.min_element(), reflected.max_element());
    let filmed = body_of_glass("gltf-filmed-glass", 0.0, film);
    let (reflected, through) = both(&filmed.scene, direction);
    assert!(reflected.max_element() > 1.2 * reflected.min_element(), "it has a colour: {reflected}");
    // On its way out the same light meets the same film.
    let inside = through.wi.with_x(-through.wi.x) * -1.0;
    let (out, _) = both(&filmed.scene, inside);
    assert!((out - reflected).abs().max_element() < 3e-3, "{out} {reflected}");
    // Facets that are all but flat choose between both, and show the same on average.
    let rough = body_of_glass("gltf-filmed-rough-glass", 0.05, film);
    let (bsdf, wo) = first_face(&rough.scene, Ray::new(Vec3::ZERO, direction));
    let (n, mut sums) = (4000, [Vec3::ZERO; 2]);
    for i in 0..n {
        let u =
            |k: u32| ((f64::from(i) * [0.754_877_666, 0.569_840_29, 0.618_033_99][k as usize]) % 1.0) as f32;
        if let Some(s) = bsdf.sample(wo, [u(0), u(1)], u(2)) {
            sums[usize::from(s.transmitted)] += s.weight / n as f32;
        }
    }
    assert!((sums[0] - reflected).abs().max_element() < 4e-3, "{sums:?} {reflected}");
    assert!((sums[1] - through.weight).abs().max_element() < 1e-2, "{sums:?} {}", through.weight);
    for (name, more, said) in [
        ("gltf-told-a", film, false),
        (
            "gltf-told-b",
            r#", "KHR_materials_clearcoat": {"clearcoatFactor": 1, "clearcoatRoughnessFactor": 0.5}"#,
            true,
        ),
        ("gltf-told-c", r#", "KHR_materials_sheen": {"sheenColorFactor": [1, 1, 1]}"#, true),
    ] {
        let told = format!("{:?}", body_of_glass(name, 0.0, more).warnings);
        assert_eq!(told.contains("over a volume") || told.contains("below fibres"), said, "{name}: {told}");
    }
}

#[test]
fn maps_say_where_a_film_and_a_coat_lie_on_a_body_of_glass() {
    // 51 is a fifth, all over: as with factors.
    let picture = data_png(&[[51; 4]; 4]);
    let reflected = |name: &str, extensions: &str, rest: &str| {
        let found = with_body(
            name,
            &format!(
                r#"[{{"pbrMetallicRoughness": {{"metallicFactor": 0, "roughnessFactor": 0}}, "extensions": {{
                "KHR_materials_transmission": {{"transmissionFactor": 1}}, "KHR_materials_volume": {{"thicknessFactor": 1}},
                {extensions}}}}}]{rest}"#
            ),
        );
        assert!(found.warnings.iter().all(|w| !w.message.contains("over a volume")), "{:?}", found.warnings);
        let (bsdf, wo) = first_face(&found.scene, Ray::new(Vec3::ZERO, Vec3::new(0.6, 0.0, -0.8)));
        (bsdf.delta_lobes(wo)[0].expect("a mirror").weight, found.scene)
    };
    let maps = format!(r#", "textures": [{{"source": 0}}], "images": [{picture}]"#);
    let (by_texel, scene) = reflected(
        "gltf-mapped-film",
        r#""KHR_materials_iridescence": {"iridescenceFactor": 1, "iridescenceTexture": {"index": 0},
        "iridescenceThicknessMinimum": 300, "iridescenceThicknessMaximum": 500, "iridescenceThicknessTexture": {"index": 0}},
        "KHR_materials_clearcoat": {"clearcoatFactor": 0.5, "clearcoatTexture": {"index": 0}}"#,
        &maps,
    );
    let (by_factor, bare) = reflected(
        "gltf-even-film",
        r#""KHR_materials_iridescence": {"iridescenceFactor": 0.2, "iridescenceThicknessMaximum": 340},
        "KHR_materials_clearcoat": {"clearcoatFactor": 0.1}"#,
        "",
    );
    assert!((by_texel - by_factor).abs().max_element() < 1e-5, "{by_texel} {by_factor}");
    assert_eq!([scene.textures.len(), bare.textures.len()], [1, 0]);
    // No actor shows a level of it that is coarser than what is known of the others.
    assert_eq!(scene.materials[0].maps_by_point().len(), 3);
}

#[test]
fn the_charts_of_texture_transform_agree() {
    // A texel of red at the upper left of four; each transform of the extension's text brings it to the quad's middle.
    let picture = data_png_of(2, &[[255, 0, 0, 255], [0, 0, 0, 255], [0, 0, 0, 255], [0, 0, 0, 255]]);
    let turn = std::f32::consts::FRAC_PI_2;
    for (i, (transform, x, y)) in [
        (r#""offset": [0, 0]"#.to_owned(), 0.25, 0.75),
        (r#""offset": [0.5, 0]"#.to_owned(), 0.75, 0.75),
        (r#""offset": [0, 0.5]"#.to_owned(), 0.25, 0.25),
        (r#""scale": [2, 2]"#.to_owned(), 0.125, 0.875),
        (r#""scale": [2, 2]"#.to_owned(), 0.625, 0.375),
        // u' = w, w' = −u: the texel at (¼, ¼) is read at (¾, ¼) from the upper left.
        (format!(r#""rotation": {turn}"#), 0.75, 0.75),
        (format!(r#""rotation": {turn}, "scale": [0.5, 0.5], "offset": [0, 0.5]"#), 0.5, 0.5),
    ]
    .into_iter()
    .enumerate()
    {
        let text = |more: &str| {
            format!(
                r#"[{{"pbrMetallicRoughness": {{"baseColorTexture": {{"index": 0, "extensions": {{"KHR_texture_transform": {{{transform}}}}}}}}}{more}}}],
                "textures": [{{"source": 0, "sampler": 0}}], "samplers": [{{"magFilter": 9728}}], "images": [{picture}]"#
            )
        };
        // Folded into the coordinates, and kept beside a map that lies plainly.
        for (kind, more) in [("folded", ""), ("kept", r#", "emissiveTexture": {"index": 0}"#)] {
            let scene = with_materials(&format!("gltf-chart-{i}-{kind}"), &text(more)).scene;
            let here = at(&scene, x, y);
            let map = scene.materials[0].picture().expect("a picture");
            let texel = here.point().texel(&scene, map);
            assert!(texel[0] > 0.9 && texel[1] < 0.1, "{transform} {kind}: {texel:?}");
        }
    }
    assert_eq!(Placement::default().bits(), Placement::clamped(false).bits());
}
