//! `finishes`: balls and a leaf in glTF, one for each extension of materials that `atelier` does not have.

use glam::{DVec2, DVec3};
use image::ImageResult;

use super::gltf::Gltf;
use super::obj::SceneFiles;
use super::shapes::{quad, quad_with_hole, room, sphere, torus, v};
use super::textures::{picture, png, turbulence};

const TOML: &str = r#"
format = 1
title = "Finishes, in glTF"
attribution = "the foveal project, CC0"

[geometry]
files = ["finishes.gltf"]
metres_per_unit = 1.0
up = "+y"

[[path]]
name = "tour"
keys = [
  { t = 0.0, eye = [-0.5, 0.7, 1.25], target = [-0.1, 0.12, 0.0] },
  { t = 3.0, eye = [0.1, 0.5, 1.0], target = [0.0, 0.12, 0.0] },
  { t = 6.0, eye = [0.6, 0.6, 1.2], target = [0.1, 0.12, 0.0] },
]
"#;

/// Names, metalness, roughness, base colours, and what each has.
const BALLS: [(&str, [f64; 2], [f64; 3], &str); 8] = [
    (
        "Coat",
        [0.0, 0.9],
        [0.45, 0.02, 0.02],
        r#""KHR_materials_clearcoat": { "clearcoatFactor": 1, "clearcoatRoughnessFactor": 0.03 }"#,
    ),
    (
        "Flakes",
        [1.0, 0.45],
        [0.1, 0.16, 0.4],
        r#""KHR_materials_clearcoat": { "clearcoatFactor": 1, "clearcoatRoughnessFactor": 0 }"#,
    ),
    (
        "Velvet",
        [0.0, 1.0],
        [0.12, 0.02, 0.1],
        r#""KHR_materials_sheen": { "sheenColorFactor": [0.9, 0.5, 0.8], "sheenRoughnessFactor": 0.35 }"#,
    ),
    (
        "Spun",
        [1.0, 0.3],
        [0.85, 0.83, 0.8],
        r#""KHR_materials_anisotropy": { "anisotropyStrength": 0.85, "anisotropyRotation": 0 }"#,
    ),
    (
        "Film",
        [0.0, 0.02],
        [0.02, 0.02, 0.02],
        r#""KHR_materials_iridescence": { "iridescenceFactor": 1, "iridescenceIor": 1.4, "iridescenceThicknessMaximum": 420 },
    "KHR_materials_ior": { "ior": 2.2 }"#,
    ),
    (
        "Tempered",
        [1.0, 0.15],
        [0.75, 0.72, 0.7],
        r#""KHR_materials_iridescence": { "iridescenceFactor": 1, "iridescenceIor": 1.8, "iridescenceThicknessMaximum": 330 }"#,
    ),
    (
        "Crystal",
        [0.0, 0.0],
        [1.0, 1.0, 1.0],
        r#""KHR_materials_transmission": { "transmissionFactor": 1 }, "KHR_materials_volume": { "thicknessFactor": 0.2 },
    "KHR_materials_ior": { "ior": 1.7 }, "KHR_materials_dispersion": { "dispersion": 3 }"#,
    ),
    (
        "Bubble",
        [0.0, 0.0],
        [1.0, 1.0, 1.0],
        r#""KHR_materials_transmission": { "transmissionFactor": 1 },
    "KHR_materials_volume": { "thicknessFactor": 0.2, "attenuationColor": [0.9, 0.97, 1], "attenuationDistance": 0.2 },
    "KHR_materials_iridescence": { "iridescenceFactor": 1, "iridescenceIor": 1.8, "iridescenceThicknessMinimum": 150,
        "iridescenceThicknessMaximum": 600, "iridescenceThicknessTexture": { "index": 0 } }"#,
    ),
];

/// How thick a film that runs down a ball is, in green: thin above, with eddies.
fn film(u: f64, v: f64) -> [f64; 3] {
    let eddies = turbulence(u, v, [6, 4], 4, 77) - 0.5;
    [0.0, 0.85 - 0.7 * v + 0.5 * eddies, 0.0]
}

const EXTENSIONS: [&str; 10] = [
    "KHR_lights_punctual",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_diffuse_transmission",
    "KHR_materials_dispersion",
    "KHR_materials_ior",
    "KHR_materials_iridescence",
    "KHR_materials_sheen",
    "KHR_materials_transmission",
    "KHR_materials_volume",
];

/// The scene.
pub fn scene() -> ImageResult<SceneFiles> {
    let mut g = Gltf::default();
    let mut roots = Vec::new();
    let plain = |[r, g, b]: [f64; 3], [metallic, roughness]: [f64; 2], more: &str| {
        format!(
            r#""pbrMetallicRoughness": {{ "baseColorFactor": [{r}, {g}, {b}, 1], "metallicFactor": {metallic}, "roughnessFactor": {roughness} }}{more}"#
        )
    };
    let plaster = g.material("Plaster", &plain([0.7, 0.68, 0.64], [0.0, 1.0], ""));
    let [floor, ceiling, left, right, back, front] = room(v(-1.4, 0.0, -1.0), v(1.4, 1.6, 1.6));
    let hole = (DVec2::new(0.3, 0.35), DVec2::new(0.7, 0.85));
    let window =
        quad_with_hole(v(-1.4, 0.0, 1.6), v(0.0, 0.0, -2.6), v(0.0, 1.6, 0.0), hole.0, hole.1, [1.0; 2]);
    let _ = left;
    let walls = floor.with(ceiling).with(right).with(back).with(front).with(window);
    let walls = g.mesh("Room", &walls, plaster, "");
    roots.push(g.thing("Room", walls, 1, ""));
    for (i, (name, shape, color, extensions)) in BALLS.into_iter().enumerate() {
        let material =
            g.material(name, &plain(color, shape, &format!(r#", "extensions": {{ {extensions} }}"#)));
        // Grain follows the coordinates of a ring as of something turned on a lathe.
        let of = if name == "Spun" { torus(0.085, 0.05, 64, 32) } else { sphere(DVec3::ZERO, 0.13, 48, 24) };
        let mesh = g.mesh(name, &of, material, "");
        let (row, column) = (i as i32 / 4, i as i32 % 4);
        // In front of all, so that both faces of its film are seen.
        let [x, z] =
            if name == "Bubble" { [-16, 48] } else { [-48 + 32 * column + 16 * row, -15 + 32 * row] };
        let [x, z] = [x, z].map(|v| f64::from(v) / 100.0);
        let y = if name == "Spun" { 0.0505 } else { 0.1305 };
        roots.push(g.thing(name, mesh, 1, &format!(r#""translation": [{x}, {y}, {z}]"#)));
    }
    let paper = plain(
        [0.75, 0.6, 0.35],
        [0.0, 1.0],
        r#", "doubleSided": true, "extensions": { "KHR_materials_diffuse_transmission":
    { "diffuseTransmissionFactor": 0.6, "diffuseTransmissionColorFactor": [0.95, 0.65, 0.3] } }"#,
    );
    let paper = g.material("Paper", &paper);
    // Between the eye and the sun, so that what passes it is seen.
    let shade = quad(v(-0.78, 0.001, 0.05), v(0.14, 0.0, -0.34), v(0.0, 0.42, 0.0), [1.0, 1.0]);
    let shade = g.mesh("Paper", &shade, paper, "");
    roots.push(g.thing("Paper", shade, 1, ""));
    let light =
        |number: usize| format!(r#""extensions": {{ "KHR_lights_punctual": {{ "light": {number} }} }}"#);
    let sun = Gltf::pose(v(-4.0, 3.0, 0.6), v(0.0, 0.1, 0.0));
    roots.push(g.node("Sun", &format!("{sun}, {}", light(0))));
    for (number, name, place, target) in [
        (1, "Spot", v(0.6, 1.5, 1.1), v(0.0, 0.1, 0.0)),
        (1, "Other spot", v(-0.7, 1.5, 1.2), v(0.0, 0.1, 0.1)),
    ] {
        roots.push(g.node(name, &format!("{}, {}", Gltf::pose(place, target), light(number))));
    }
    for (name, eye, target) in [
        ("main", v(-0.12, 0.86, 1.15), v(-0.06, 0.08, 0.0)),
        ("close", v(0.35, 0.3, 0.75), v(0.2, 0.12, 0.1)),
    ] {
        roots.push(g.node(name, &format!(r#"{}, "camera": 0"#, Gltf::pose(eye, target))));
    }
    let used: Vec<String> = EXTENSIONS.iter().map(|e| format!("\"{e}\"")).collect();
    let rest = format!(
        r#"
"cameras": [{{ "type": "perspective", "perspective": {{ "yfov": 0.7, "znear": 0.05 }} }}],
"extensions": {{ "KHR_lights_punctual": {{ "lights": [
    {{ "type": "directional", "color": [1, 0.93, 0.82], "intensity": 5 }},
    {{ "type": "spot", "color": [1, 0.96, 0.9], "intensity": 5, "spot": {{ "innerConeAngle": 0.4, "outerConeAngle": 0.7 }} }}] }} }},
"textures": [{{ "source": 0 }}], "images": [{{ "uri": "film.png" }}],
"extensionsUsed": [{}]
"#,
        used.join(", ")
    );
    let pictures = vec![
        ("finishes.toml", TOML.trim_start().as_bytes().to_vec()),
        ("film.png", png(&picture(128, 64, film))?),
    ];
    Ok(g.finish("finishes", &roots, &rest, pictures))
}
