//! Rooms of many triangles, for measurements.

use image::ImageResult;

use super::obj::{Mesh, Obj, SceneFiles};
use super::shapes::{curve, lathe, quad, room, rounded_box, v};
use super::textures::hash;

const MTL: &str = r"
newmtl Wall
Kd 0.72 0.70 0.66
newmtl Floor
Kd 0.30 0.28 0.27
Ks 0.04 0.04 0.04
Ns 2000
newmtl Clay
Kd 0.60 0.30 0.18
newmtl Chalk
Kd 0.75 0.75 0.72
newmtl Slate
Kd 0.18 0.22 0.26
newmtl Glaze
Kd 0.10 0.25 0.40
Ks 0.05 0.05 0.05
Ns 2000
newmtl Chrome
Kd 0 0 0
Ks 0.6 0.6 0.6
illum 3
newmtl Glass
Kd 0 0 0
Ks 1 1 1
Ni 1.5
illum 7
newmtl Light
Kd 0.5 0.5 0.5
Ke 5 4.8 4.5
";

const TOML: &str = r#"
format = 1
title = "Hall of vases, NAME"
attribution = "the foveal project, CC0"

[geometry]
files = ["NAME.obj"]
metres_per_unit = 1.0
up = "+y"

[[camera]]
name = "main"
eye = [0.0, 2.0, 7.4]
target = [0.0, 0.6, 0.0]
up = [0.0, 1.0, 0.0]
fov_y = 45.0

[[path]]
name = "tour"
keys = [
  { t = 0.0, eye = [0.0, 2.0, 7.4], target = [0.0, 0.6, 0.0] },
  { t = 4.0, eye = [2.5, 1.9, 5.0], target = [0.0, 0.5, -1.0] },
  { t = 8.0, eye = [0.0, 1.8, 2.5], target = [-1.0, 0.5, -3.0] },
  { t = 12.0, eye = [0.0, 2.0, 7.4], target = [0.0, 0.6, 0.0] },
]

[material."Floor"]
model = "plastic"
albedo = [0.30, 0.28, 0.27]
ior = 1.5
alpha = 0.05

[material."Glaze"]
model = "plastic"
albedo = [0.10, 0.25, 0.40]
ior = 1.5
alpha = 0.05

[material."Chrome"]
model = "conductor"
eta = [3.1071, 3.1812, 2.323]
k = [3.3314, 3.3291, 3.135]
alpha = 0.0

[material."Glass"]
model = "dielectric"
ior = 1.5
transmittance = [0.9, 0.95, 0.93]

[display]
exposure = 1.3
"#;

/// A hall of 15 × 15 vases on blocks, of about `triangle_count` triangles.
pub fn hall(triangle_count: usize) -> ImageResult<SceneFiles> {
    let side = 15usize;
    let mut obj = Obj::new(4);
    let [floor, ceiling, left, right, back, front] = room(v(-8.0, 0.0, -8.0), v(8.0, 4.0, 8.0));
    obj.add("Floor", "Floor", floor);
    obj.add(
        "Walls",
        "Wall",
        [ceiling, left, right, back, front].into_iter().fold(Mesh::default(), Mesh::with),
    );
    for i in 0..4 {
        let (x, z) = (-5.0 + 6.0 * f64::from(i % 2), -5.0 + 6.0 * f64::from(i / 2));
        obj.add(
            &format!("Panel{i}"),
            "Light",
            quad(v(x, 3.99, z), v(4.0, 0.0, 0.0), v(0.0, 0.0, 4.0), [1.0, 1.0]),
        );
    }
    // A vase: ten pieces of `steps` rings of `around` quadrilaterals.
    let per_vase = triangle_count as f64 / (side * side) as f64 - 12.0;
    let steps = ((per_vase / 2.0).sqrt() / 10.0).round().max(1.0) as usize;
    let around = (per_vase / (20 * steps - 2) as f64).round().max(8.0) as usize;
    for index in 0..side * side {
        let r = |k: i64| hash(index as i64, k, 1);
        let (column, row) = ((index % side) as f64, (index / side) as f64);
        let (x, z) = (-7.0 + column + 0.2 * (r(0) - 0.5), -7.0 + row + 0.2 * (r(1) - 0.5));
        let height = 0.15 + 0.35 * r(2);
        obj.add(
            &format!("Block{index}"),
            "Wall",
            rounded_box(v(-0.2, -0.001, -0.2), v(0.2, height, 0.2), 0.01, 0).at(x, 0.0, z),
        );
        let profile = [
            [0.0, 0.0],
            [0.08, 0.0],
            [0.1 + 0.06 * r(3), 0.08],
            [0.09 + 0.08 * r(4), 0.2],
            [0.05 + 0.03 * r(5), 0.34],
            [0.08, 0.4],
            [0.06, 0.4],
            [0.035, 0.34],
            [0.07, 0.2],
            [0.07, 0.06],
            [0.0, 0.03],
        ];
        let stroke = curve(&profile, steps);
        let materials =
            ["Clay", "Chalk", "Slate", "Clay", "Chalk", "Glaze", "Chrome", "Glass", "Slate", "Glaze"];
        let material = materials[(r(6) * 10.0) as usize];
        obj.add(&format!("Vase{index}"), material, lathe(&[stroke], around).at(x, height + 0.001, z));
    }
    let name = format!("room-{}k", triangle_count / 1000);
    Ok(obj.finish(&name, MTL, &TOML.replace("NAME", &name), vec![]))
}
