//! Lights, cameras, and what animations, skins and morph targets move.

use super::*;

#[test]
fn lights_and_cameras_come_after_those_of_the_sidecar() {
    let place = TempFolder::new("gltf-lights");
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

#[test]
fn a_camera_that_moves_is_a_path_and_a_time_poses_things() {
    let place = TempFolder::new("gltf-path");
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
fn a_skin_of_one_joint_is_the_nodes_transform_and_targets_move_by_their_weights() {
    let place = TempFolder::new("gltf-skin");
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
fn lights_colours_and_weights_are_those_of_the_shown_time() {
    let place = TempFolder::new("gltf-pointers");
    let mut maker = Maker::default();
    let mesh = quad(&mut maker);
    let times = maker.accessor(bytemuck::cast_slice(&[0.0f32, 2.0]), 5126, 2, "SCALAR", "");
    let scalars = maker.accessor(bytemuck::cast_slice(&[0.0f32, 8.0]), 5126, 2, "SCALAR", "");
    let colors = maker.vec3(&[Vec3::ZERO, Vec3::new(1.0, 0.5, 0.25)]);
    let weights = maker.accessor(bytemuck::cast_slice(&[0.0f32, 0.0, 1.0, 0.5]), 5126, 4, "SCALAR", "");
    let up = maker.vec3(&[Vec3::Z; 4]);
    let mesh = mesh.replace(
        r#""indices""#,
        &format!(r#""targets": [{{"POSITION": {up}}}, {{"POSITION": {up}}}], "indices""#),
    );
    let pointer = |sampler: u32, to: &str| {
        format!(
            r#"{{"sampler": {sampler}, "target": {{"path": "pointer", "extensions": {{"KHR_animation_pointer": {{"pointer": "{to}"}}}}}}}}"#
        )
    };
    let channels = [
        pointer(0, "/extensions/KHR_lights_punctual/lights/0/intensity"),
        pointer(1, "/materials/0/emissiveFactor"),
        pointer(1, "/nodes/1/translation"),
        pointer(0, "/materials/0/occlusionTexture/strength"),
        r#"{"sampler": 2, "target": {"node": 0, "path": "weights"}}"#.to_owned(),
    ];
    let sampler = |output: usize| format!(r#"{{"input": {times}, "output": {output}}}"#);
    let rest = format!(
        r#"{mesh}, "materials": [{{}}], "nodes": [{{"mesh": 0}}, {{"extensions": {{"KHR_lights_punctual": {{"light": 0}}}}}}],
        "extensions": {{"KHR_lights_punctual": {{"lights": [{{"type": "point", "intensity": 3}}]}}}},
        "extensionsUsed": ["KHR_lights_punctual", "KHR_animation_pointer"],
        "animations": [{{"channels": [{}], "samplers": [{}, {}, {}]}}]"#,
        channels.join(","),
        sampler(scalars),
        sampler(colors),
        sampler(weights),
    );
    let before = loaded(&place, maker.text(&rest)).scene;
    assert_eq!((before.mesh.positions[0].z, before.materials[0].emission.color), (0.0, Vec3::ZERO));
    place.write("a.toml", "format = 1\n[gltf]\ntime = 1.0\n");
    let found = loaded(&place, maker.text(&rest));
    let Light::Point { position, intensity, .. } = found.scene.lights[0] else { panic!() };
    assert_eq!((position, intensity), (Vec3::new(0.5, 0.25, 0.125), Vec3::splat(4.0)));
    assert_eq!(found.scene.materials[0].emission.color, Vec3::new(0.5, 0.25, 0.125));
    // Half of one and a quarter of the other target.
    assert_eq!(found.scene.mesh.positions[0].z, 0.75);
    assert!(says(&found, "occlusionTexture"));
    let used: Vec<&str> = found.scene.extensions.iter().map(|e| e.name.as_str()).collect();
    assert_eq!(used, ["KHR_animation_pointer", "KHR_lights_punctual"]);
}

#[test]
fn one_candela_at_one_metre_is_one_lux_and_a_range_ends_it() {
    use foveal::geometry::{Hit, Ray};
    use foveal::transport::bsdf::Bsdf;
    use foveal::transport::gather::Trust;
    use foveal::transport::interaction::Interaction;
    use foveal::transport::medium::Media;
    // 1 − (d / range)⁴ at half the range is 15/16.
    for (name, range, expected) in
        [("none", "", 1.0), ("two", r#", "range": 2"#, 0.9375), ("one", r#", "range": 1"#, 0.0)]
    {
        let place = TempFolder::new(&format!("gltf-candela-{name}"));
        let mut maker = Maker::default();
        let mesh = quad(&mut maker);
        let scene = loaded(
            &place,
            maker.text(&format!(
                r#"{mesh}, "materials": [{{"pbrMetallicRoughness": {{"metallicFactor": 0}}}}], "nodes": [{{"mesh": 0}},
                {{"translation": [0.6, 0.3, 1], "extensions": {{"KHR_lights_punctual": {{"light": 0}}}}}}],
                "extensions": {{"KHR_lights_punctual": {{"lights": [{{"type": "point", "intensity": 1{range}}}]}}}}"#
            )),
        )
        .scene;
        let uniform = std::sync::Arc::new(foveal::illumination::Uniform(Vec3::ZERO));
        let world = foveal::world::World::new(scene.into(), uniform);
        // Below the lamp: (0, 0), (1, 0), (1, 1) with weights 0.4, 0.3, 0.3.
        let hit = Hit { t: 1.0, triangle: 0, b1: 0.3, b2: 0.3 };
        let at = Interaction::at(&world.scene, &Ray::new(Vec3::new(0.6, 0.3, 1.0), Vec3::NEG_Z), &hit);
        let bsdf = Bsdf::at(&world.scene, &at);
        let found = world.gather(Trust::Nobody).named(&at, &bsdf, Media::EMPTY);
        assert!((found - Vec3::splat(expected)).abs().max_element() < 1e-6, "{name}: {found}");
    }
}

#[test]
fn lamps_in_other_units_than_what_glows_are_told() {
    let said = |name: &str, intensity: f64| {
        let place = TempFolder::new(name);
        let mut maker = Maker::default();
        let mesh = quad(&mut maker);
        let loaded = loaded(
            &place,
            maker.text(&format!(
                r#"{mesh}, "materials": [{{"emissiveFactor": [1, 1, 1]}}], "nodes": [{{"mesh": 0}},
                {{"translation": [0.6, 0.3, 1], "extensions": {{"KHR_lights_punctual": {{"light": 0}}}}}}],
                "extensions": {{"KHR_lights_punctual": {{"lights": [{{"type": "point", "intensity": {intensity}}}]}}}}"#
            )),
        );
        loaded.warnings.into_iter().map(|w| w.message).find(|m| m.contains("light_scale"))
    };
    assert_eq!((said("gltf-units-1", 1.0), said("gltf-units-2", 5e3)), (None, None));
    assert!(said("gltf-units-3", 1e6).is_some_and(|m| m.contains("brighter")));
    assert!(said("gltf-units-4", 1e-5).is_some_and(|m| m.contains("darker")));
}
