//! `atelier`: a room in glTF, with every material that the format's core and its exact extensions have.

use glam::{DQuat, DVec2, DVec3};
use image::ImageResult;

use super::gltf::{Gltf, looking};
use super::obj::{Mesh, SceneFiles};
use super::shapes::{cuboid, curve, lathe, quad, quad_with_hole, room, rounded_box, sphere, torus, v};
use super::textures::{jpeg, leaf, mix, picture, planks, png, png_alpha, smoothstep, turbulence};

/// What is used of extensions; all of them are read exactly.
const EXTENSIONS: [&str; 13] = [
    "EXT_mesh_gpu_instancing",
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_node_visibility",
    "KHR_texture_transform",
];

/// Where the animated camera is and what it looks at, every two seconds.
const TOUR: [[[f64; 3]; 2]; 7] = [
    [[1.25, 1.5, 2.3], [-0.2, 0.85, -0.6]],
    [[0.7, 1.4, 1.5], [-0.15, 0.85, -0.6]],
    [[0.1, 1.3, 0.95], [-0.2, 0.85, -0.6]],
    [[-0.5, 1.35, 0.9], [0.0, 0.85, -0.6]],
    [[-0.7, 1.5, 1.5], [0.15, 0.85, -0.6]],
    [[0.4, 1.6, 2.1], [0.0, 0.85, -0.6]],
    [[1.25, 1.5, 2.3], [-0.2, 0.85, -0.6]],
];

const TOML: &str = r#"
format = 1
title = "Atelier, in glTF"
attribution = "the foveal project, CC0"

[geometry]
files = ["atelier.gltf"]
metres_per_unit = 1.0
up = "+y"
"#;

/// The scene.
pub fn scene() -> ImageResult<SceneFiles> {
    let mut g = Gltf::default();
    let mut roots = Vec::new();
    shell(&mut g, &mut roots);
    table(&mut g, &mut roots);
    plant_and_veil(&mut g, &mut roots);
    lamps_and_cameras(&mut g, &mut roots);
    let times = g.floats(
        &(0..TOUR.len()).map(|i| [2.0 * i as f64]).collect::<Vec<_>>(),
        r#", "min": [0], "max": [12]"#,
    );
    let eyes = g.floats(&TOUR.map(|[eye, _]| eye), "");
    let turns = g.floats(&TOUR.map(|[eye, target]| looking(eye.into(), target.into()).to_array()), "");
    let tour = roots[roots.len() - 1];
    let used: Vec<String> = EXTENSIONS.iter().map(|e| format!("\"{e}\"")).collect();
    let rest = format!(
        r#"
"textures": [{{ "source": 0 }}, {{ "source": 1 }}, {{ "source": 2, "sampler": 0 }}, {{ "source": 3 }}],
"samplers": [{{ "wrapS": 33071, "wrapT": 33071 }}],
"images": [{{ "uri": "boards.jpg" }}, {{ "uri": "wear.png" }}, {{ "uri": "leaf.png" }}, {{ "uri": "chart.png" }}],
"cameras": [{{ "type": "perspective", "perspective": {{ "yfov": 0.9, "znear": 0.05 }} }}],
"animations": [{{ "name": "tour", "samplers": [{{ "input": {times}, "output": {eyes} }}, {{ "input": {times}, "output": {turns} }}],
  "channels": [{{ "sampler": 0, "target": {{ "node": {tour}, "path": "translation" }} }},
    {{ "sampler": 1, "target": {{ "node": {tour}, "path": "rotation" }} }}] }}],
"extensions": {{
  "KHR_lights_punctual": {{ "lights": [
    {{ "type": "point", "color": [1, 0.82, 0.6], "intensity": 3, "range": 6 }},
    {{ "type": "spot", "color": [1, 0.93, 0.85], "intensity": 14, "spot": {{ "innerConeAngle": 0.35, "outerConeAngle": 0.55 }} }},
    {{ "type": "directional", "color": [1, 0.9, 0.75], "intensity": 9 }}] }},
  "KHR_materials_variants": {{ "variants": [{{ "name": "plaster" }}, {{ "name": "slate" }}] }} }},
"extensionsUsed": [{}],
"extensionsRequired": ["KHR_mesh_quantization", "EXT_mesh_gpu_instancing"]
"#,
        used.join(", ")
    );
    let boards = planks([0.16, 0.09, 0.05], [0.42, 0.27, 0.15], 6, 5);
    let pictures = vec![
        ("atelier.toml", TOML.trim_start().as_bytes().to_vec()),
        ("boards.jpg", jpeg(&picture(512, 512, boards), 85)?),
        ("wear.png", png(&picture(128, 128, wear))?),
        ("leaf.png", png_alpha(&leaf())?),
        ("chart.png", png(&picture(64, 64, chart))?),
    ];
    Ok(g.finish("atelier", &roots, &rest, pictures))
}

/// Roughness (green) and metalness (blue) of worn gilding: smooth metal, rough ground where it is rubbed off.
fn wear(u: f64, v: f64) -> [f64; 3] {
    let rubbed = smoothstep(0.5, 0.62, turbulence(u, v, [4, 4], 4, 11));
    [1.0, 0.25 + 0.55 * rubbed, 1.0 - rubbed]
}

fn chart(u: f64, v: f64) -> [f64; 3] {
    let (x, y) = ((u * 4.0) as i32, (v * 4.0) as i32);
    mix([0.9, 0.9, 0.85], [f64::from(x) / 4.0, f64::from(y) / 4.0, 0.3], f64::from((x + y) % 2))
}

fn shell(g: &mut Gltf, roots: &mut Vec<usize>) {
    let plaster = g.material("Plaster", &plain([0.78, 0.75, 0.7], 0.0, 1.0));
    let slate = g.material("Slate", &plain([0.2, 0.24, 0.28], 0.0, 1.0));
    let boards = g.material(
        "Boards",
        r#""pbrMetallicRoughness": { "metallicFactor": 0, "roughnessFactor": 0.45, "baseColorTexture": { "index": 0,
    "extensions": { "KHR_texture_transform": { "scale": [0.5, 0.5], "offset": [0.25, 0] } } } }"#,
    );
    let [floor, ceiling, _left, right, back, front] = room(v(-1.8, 0.0, -1.8), v(1.8, 2.6, 2.6));
    let (lo, hi) = (DVec2::new(0.36, 0.38), DVec2::new(0.64, 0.8));
    let window = quad_with_hole(v(-1.8, 0.0, 2.6), v(0.0, 0.0, -4.4), v(0.0, 2.6, 0.0), lo, hi, [4.4, 2.6]);
    let variants = format!(
        r#", "extensions": {{ "KHR_materials_variants": {{ "mappings": [{{ "material": {plaster}, "variants": [0] }},
    {{ "material": {slate}, "variants": [1] }}] }} }}"#
    );
    let walls = g.mesh("Walls", &ceiling.with(back).with(front).with(right), plaster, &variants);
    roots.push(g.thing("Walls", walls, 1, ""));
    let window = g.mesh("WindowWall", &window, plaster, "");
    roots.push(g.thing("WindowWall", window, 1, ""));
    let floor = g.mesh("Floor", &floor, boards, "");
    roots.push(g.thing("Floor", floor, 1, ""));
}

/// Keys of a material of one colour, metalness and roughness.
fn plain([r, g, b]: [f64; 3], metallic: f64, roughness: f64) -> String {
    format!(
        r#""pbrMetallicRoughness": {{ "baseColorFactor": [{r}, {g}, {b}, 1], "metallicFactor": {metallic}, "roughnessFactor": {roughness} }}"#
    )
}

fn table(g: &mut Gltf, roots: &mut Vec<usize>) {
    let with = |base: String, extensions: &str| format!(r#"{base}, "extensions": {{ {extensions} }}"#);
    let lacquer = g.material(
        "Lacquer",
        &with(
            plain([0.28, 0.06, 0.05], 0.0, 0.2),
            r#""KHR_materials_ior": { "ior": 1.6 }, "KHR_materials_specular": { "specularFactor": 0.9, "specularColorFactor": [1, 0.9, 0.8] }"#,
        ),
    );
    let gold = g.material("Gold", &plain([1.0, 0.77, 0.34], 1.0, 0.25));
    let chrome = g.material("Chrome", &plain([0.86, 0.87, 0.88], 1.0, 0.0));
    let gilding = g.material(
        "Gilding",
        r#""pbrMetallicRoughness": { "baseColorFactor": [0.95, 0.72, 0.4, 1], "metallicRoughnessTexture": { "index": 1 } }"#,
    );
    let enamel = g.material(
        "Enamel",
        r#""extensions": { "KHR_materials_pbrSpecularGlossiness": { "diffuseFactor": [0.05, 0.2, 0.45, 1], "specularFactor": [0.06, 0.06, 0.06], "glossinessFactor": 0.85 } }"#,
    );
    let glass = g.material(
        "Glass",
        &with(
            plain([1.0, 1.0, 1.0], 0.0, 0.0),
            r#""KHR_materials_transmission": { "transmissionFactor": 1 }, "KHR_materials_volume": { "thicknessFactor": 0.02,
    "attenuationColor": [0.35, 0.8, 0.55], "attenuationDistance": 0.03 }"#,
        ),
    );
    let pane = g.material(
        "Pane",
        &with(
            plain([0.95, 0.8, 0.55], 0.0, 0.0),
            r#""KHR_materials_transmission": { "transmissionFactor": 1 }"#,
        ),
    );
    // One box for the top and the four legs, in sixteen bits.
    let block = g.quantised("Block", &cuboid(v(-0.5, -0.5, -0.5), v(0.5, 0.5, 0.5)), lacquer);
    let scaled = |x: f64, y: f64, z: f64, size: [f64; 3]| {
        format!(r#""translation": [{x}, {y}, {z}], "scale": {size:?}"#)
    };
    roots.push(g.thing("Top", block, 1, &scaled(0.0, 0.72, -0.6, [1.7, 0.05, 0.8])));
    for (i, (x, z)) in [(-0.78, -0.93), (0.78, -0.93), (-0.78, -0.27), (0.78, -0.27)].into_iter().enumerate()
    {
        roots.push(g.thing(&format!("Leg {i}"), block, 1, &scaled(x, 0.348, z, [0.06, 0.695, 0.06])));
    }
    let ball = |radius: f64| sphere(DVec3::ZERO, radius, 40, 20);
    for (name, material, radius, x, z) in [
        ("Gold", gold, 0.13, -0.62, -0.62),
        ("Chrome", chrome, 0.15, -0.28, -0.72),
        ("Enamel", enamel, 0.1, 0.02, -0.42),
    ] {
        let mesh = g.mesh(name, &ball(radius), material, "");
        let y = 0.7455 + radius;
        roots.push(g.thing(name, mesh, 1, &format!(r#""translation": [{x}, {y}, {z}]"#)));
    }
    let ring = g.mesh("Ring", &torus(0.13, 0.04, 48, 20), gilding, "");
    roots.push(g.thing("Ring", ring, 1, r#""translation": [-0.36, 0.7865, -0.36]"#));
    let tumbler = tumbler();
    let tumbler = g.mesh("Tumbler", &tumbler, glass, "");
    roots.push(g.thing("Tumbler", tumbler, 1, r#""translation": [0.3, 0.7455, -0.55]"#));
    let screen = g.mesh(
        "Screen",
        &quad(v(-0.13, 0.0, 0.0), v(0.26, 0.0, 0.0), v(0.0, 0.3, 0.0), [1.0, 1.0]),
        pane,
        "",
    );
    let turn = DQuat::from_xyzw(0.0, -0.34, 0.0, 0.94).normalize();
    let [x, y, z, w] = turn.to_array().map(|v| (v * 1e4).round() / 1e4);
    roots.push(g.thing(
        "Screen",
        screen,
        1,
        &format!(r#""translation": [0.52, 0.7455, -0.45], "rotation": [{x}, {y}, {z}, {w}]"#),
    ));
    let hidden =
        g.thing("Spare", ring, 0, r#""extensions": { "KHR_node_visibility": { "visible": false } }"#);
    roots.push(hidden);
}

/// A tumbler with walls of real thickness.
fn tumbler() -> Mesh {
    let outer = curve(&[[0.05, 0.0], [0.055, 0.08], [0.06, 0.16]], 4);
    let rim = curve(&[[0.06, 0.16], [0.058, 0.162], [0.056, 0.16]], 2);
    let inner = curve(&[[0.056, 0.16], [0.051, 0.08], [0.046, 0.012]], 4);
    let bottom = vec![DVec2::new(0.046, 0.012), DVec2::new(0.0, 0.012)];
    let foot = vec![DVec2::new(0.0, 0.0), DVec2::new(0.05, 0.0)];
    lathe(&[foot, outer, rim, inner, bottom], 48)
}

fn plant_and_veil(g: &mut Gltf, roots: &mut Vec<usize>) {
    let green = g.material(
        "Leaf",
        r#""alphaMode": "MASK", "alphaCutoff": 0.5, "doubleSided": true, "pbrMetallicRoughness": { "metallicFactor": 0, "roughnessFactor": 0.9, "baseColorTexture": { "index": 2 } }"#,
    );
    let clay = g.material("Clay", &plain([0.55, 0.28, 0.16], 0.0, 0.95));
    let pot = lathe(
        &[
            curve(&[[0.0, 0.0], [0.1, 0.0]], 1),
            curve(&[[0.1, 0.0], [0.13, 0.12], [0.15, 0.2]], 4),
            curve(&[[0.15, 0.2], [0.0, 0.19]], 1),
        ],
        32,
    );
    let pot = g.mesh("Pot", &pot, clay, "");
    roots.push(g.thing("Pot", pot, 1, r#""translation": [1.3, 0.001, -1.3]"#));
    // Leaves around, each a card that leans outwards.
    let card = quad(v(-0.09, 0.0, 0.0), v(0.18, 0.0, 0.0), v(0.0, 0.42, 0.0), [1.0, 1.0]);
    let card = g.mesh("Leaf", &card, green, "");
    let mut rows = (Vec::new(), Vec::new(), Vec::new());
    for i in 0..14 {
        let (s, c) = (f64::from(i) * 2.399_963).sin_cos();
        let lean = 0.18 + 0.05 * f64::from(i % 5);
        rows.0.push([0.04 * s, 0.19 + 0.008 * f64::from(i), 0.04 * c]);
        rows.1.push(
            (DQuat::from_rotation_y(f64::from(i) * 2.399_963) * DQuat::from_rotation_x(lean)).to_array(),
        );
        rows.2.push([1.0, 0.8 + 0.07 * f64::from(i % 4), 1.0]);
    }
    let (t, r, s) = (g.floats(&rows.0, ""), g.floats(&rows.1, ""), g.floats(&rows.2, ""));
    let keys = format!(
        r#""translation": [1.3, 0.001, -1.3], "extensions": {{ "EXT_mesh_gpu_instancing": {{ "attributes": {{ "TRANSLATION": {t}, "ROTATION": {r}, "SCALE": {s} }} }} }}"#
    );
    roots.push(g.thing("Leaves", card, rows.0.len(), &keys));
    let veil = g.material(
        "Veil",
        r#""alphaMode": "BLEND", "doubleSided": true, "pbrMetallicRoughness": { "metallicFactor": 0, "roughnessFactor": 1, "baseColorFactor": [0.85, 0.82, 0.75, 0.5] }"#,
    );
    let curtain = quad(v(-1.76, 0.9, 0.2), v(0.0, 0.0, -0.45), v(0.0, 1.35, 0.0), [1.0, 1.0]);
    let curtain = g.mesh("Curtain", &curtain, veil, "");
    roots.push(g.thing("Curtain", curtain, 1, ""));
    let sign = g.material(
        "Chart",
        r#""pbrMetallicRoughness": { "baseColorTexture": { "index": 3 }, "baseColorFactor": [0.5, 0.5, 0.5, 1] }, "extensions": { "KHR_materials_unlit": {} }"#,
    );
    let sign_mesh = quad(v(0.35, 1.35, -1.78), v(0.5, 0.0, 0.0), v(0.0, 0.5, 0.0), [1.0, 1.0]);
    let sign_mesh = g.mesh("Chart", &sign_mesh, sign, "");
    roots.push(g.thing("Chart", sign_mesh, 1, ""));
    let bench = g.material("Oak", &plain([0.5, 0.36, 0.2], 0.0, 0.6));
    let bench_mesh =
        g.mesh("Bench", &rounded_box(v(0.95, 0.001, 0.3), v(1.45, 0.42, 1.2), 0.02, 2), bench, "");
    roots.push(g.thing("Bench", bench_mesh, 1, ""));
}

fn lamps_and_cameras(g: &mut Gltf, roots: &mut Vec<usize>) {
    let glow = g.material(
        "Glow",
        r#""emissiveFactor": [1, 0.75, 0.45], "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": 12 } }, "pbrMetallicRoughness": { "metallicFactor": 0, "roughnessFactor": 1 }"#,
    );
    let bulb = g.mesh("Bulb", &sphere(DVec3::ZERO, 0.07, 24, 12), glow, "");
    roots.push(g.thing("Bulb", bulb, 1, r#""translation": [1.3, 1.9, -1.3]"#));
    let light =
        |number: usize| format!(r#""extensions": {{ "KHR_lights_punctual": {{ "light": {number} }} }}"#);
    roots.push(g.node("Ceiling light", &format!(r#""translation": [-0.9, 2.3, 1.2], {}"#, light(0))));
    let spot = Gltf::pose(v(0.1, 2.45, 0.5), v(-0.1, 0.75, -0.6));
    roots.push(g.node("Spot", &format!("{spot}, {}", light(1))));
    let sun = Gltf::pose(v(-4.0, 3.9, 0.8), v(0.0, 0.6, -0.4));
    roots.push(g.node("Sun", &format!("{sun}, {}", light(2))));
    let main = Gltf::pose(v(1.25, 1.5, 2.3), v(-0.1, 0.85, -0.6));
    roots.push(g.node("main", &format!(r#"{main}, "camera": 0"#)));
    let close = Gltf::pose(v(-0.1, 1.2, 0.45), v(-0.12, 0.82, -0.6));
    roots.push(g.node("close", &format!(r#"{close}, "camera": 0"#)));
    let [eye, target] = TOUR[0];
    let tour = Gltf::pose(eye.into(), target.into());
    roots.push(g.node("tour", &format!(r#"{tour}, "camera": 0"#)));
}
