//! `furnace` and `diffuse`: rooms with a known answer, and without anything to correct.

use image::ImageResult;

use super::obj::{Mesh, Obj, SceneFiles};
use super::shapes::{cuboid, quad, quad_with_hole, room, rounded_box, sphere, v};

const FURNACE_MTL: &str = r"
newmtl Walls
Kd 0.5 0.5 0.5
Ke 0.5 0.5 0.5
newmtl Diffuse
Kd 0.5 0.5 0.5
Ke 0.5 0.5 0.5
newmtl Mirror
Kd 0 0 0
Ks 1 1 1
illum 3
newmtl Glass
Kd 0 0 0
Ks 1 1 1
Ni 1.5
illum 7
";

const FURNACE_TOML: &str = r#"
format = 1
title = "Furnace: radiance is 1 everywhere"
attribution = "the foveal project, CC0"

# Every wall reflects one half and emits one half; mirror and glass lose nothing.

[geometry]
files = ["furnace.obj"]
metres_per_unit = 1.0
up = "+y"

[[camera]]
name = "main"
eye = [0.0, 1.1, 0.9]
target = [0.0, 0.75, -0.4]
up = [0.0, 1.0, 0.0]
fov_y = 60.0

[[path]]
name = "tour"
keys = [
  { t = 0.0, eye = [0.0, 1.1, 0.9], target = [0.0, 0.75, -0.4] },
  { t = 2.0, eye = [0.4, 1.3, 0.8], target = [0.0, 0.7, -0.4] },
  { t = 4.0, eye = [0.0, 1.1, 0.9], target = [0.0, 0.75, -0.4] },
]

[material."Mirror"]
model = "mirror"
specular = [1.0, 1.0, 1.0]

[material."Glass"]
model = "dielectric"
ior = 1.5
transmittance = [1.0, 1.0, 1.0]
"#;

/// The closed white box.
pub fn furnace() -> ImageResult<SceneFiles> {
    let mut obj = Obj::new(4);
    let walls = room(v(-1.0, 0.0, -1.0), v(1.0, 2.0, 1.0)).into_iter().fold(Mesh::default(), Mesh::with);
    obj.add("Walls", "Walls", walls);
    obj.add("Block", "Diffuse", cuboid(v(-0.3, -0.001, -0.9), v(0.3, 0.6, -0.5)));
    obj.add("MirrorBall", "Mirror", sphere(v(-0.5, 0.45, -0.1), 0.3, 28, 14));
    obj.add("GlassBall", "Glass", sphere(v(0.5, 0.45, -0.1), 0.3, 28, 14));
    Ok(obj.finish("furnace", FURNACE_MTL, FURNACE_TOML, vec![]))
}

const DIFFUSE_MTL: &str = r"
newmtl Wall
Kd 0.74 0.70 0.62
newmtl Blue
Kd 0.16 0.28 0.52
newmtl Orange
Kd 0.78 0.36 0.10
newmtl Floor
Kd 0.45 0.38 0.32
newmtl Ball
Kd 0.70 0.72 0.74
newmtl Light
Kd 0.4 0.4 0.4
Ke 7 6.6 5.8
";

const DIFFUSE_TOML: &str = r#"
format = 1
title = "Room of diffuse things, the sun through its window"
attribution = "the foveal project, CC0"

[geometry]
files = ["diffuse.obj"]
metres_per_unit = 1.0
up = "+y"

[[camera]]
name = "main"
eye = [1.3, 1.5, 2.1]
target = [-0.2, 0.7, -0.6]
up = [0.0, 1.0, 0.0]
fov_y = 50.0

[[camera]]
name = "close"
eye = [0.6, 0.9, 0.7]
target = [-0.1, 0.5, -0.5]
up = [0.0, 1.0, 0.0]
fov_y = 45.0

[[path]]
name = "tour"
keys = [
  { t = 0.0, eye = [1.3, 1.5, 2.1], target = [-0.2, 0.7, -0.6] },
  { t = 2.0, eye = [0.6, 1.3, 1.6], target = [-0.1, 0.6, -0.5] },
  { t = 4.0, eye = [-0.4, 1.2, 1.5], target = [-0.1, 0.6, -0.5] },
  { t = 6.0, eye = [1.3, 1.5, 2.1], target = [-0.2, 0.7, -0.6] },
]

[[light]]
kind = "directional"
direction = [0.75, -0.62, -0.22]
irradiance = [9.0, 8.2, 6.8]

[material."Ball"]
model = "lambert"
two_sided = false

[display]
exposure = 1.4
"#;

/// The room with nothing to correct.
pub fn diffuse() -> ImageResult<SceneFiles> {
    let mut obj = Obj::new(4);
    let [floor, ceiling, _left, right, back, front] = room(v(-1.8, 0.0, -1.8), v(1.8, 2.6, 2.6));
    obj.add("Floor", "Floor", floor);
    obj.add("Walls", "Wall", ceiling.with(back).with(front));
    obj.add("BlueWall", "Blue", right);
    // The window, 1.2 × 1.1 m, in the wall at −x.
    let (lo, hi) = (glam::DVec2::new(0.36, 0.38), glam::DVec2::new(0.64, 0.8));
    let wall = quad_with_hole(v(-1.8, 0.0, 2.6), v(0.0, 0.0, -4.4), v(0.0, 2.6, 0.0), lo, hi, [4.4, 2.6]);
    obj.add("WindowWall", "Wall", wall);
    obj.add("Lamp", "Light", quad(v(-0.5, 2.59, -0.4), v(1.0, 0.0, 0.0), v(0.0, 0.0, 0.8), [1.0, 1.0]));
    let block = rounded_box(v(-0.35, -0.001, -0.35), v(0.35, 1.1, 0.35), 0.02, 1);
    obj.add("Tall", "Orange", block.turned(18.0).at(-0.7, 0.0, -0.9));
    let low = rounded_box(v(-0.4, -0.001, -0.4), v(0.4, 0.45, 0.4), 0.02, 1);
    obj.add("Low", "Wall", low.turned(-20.0).at(0.45, 0.0, -0.3));
    obj.add("Ball", "Ball", sphere(v(0.45, 0.7, -0.3), 0.252, 32, 16));
    obj.add("SmallBall", "Orange", sphere(v(-0.3, 0.199, 0.5), 0.2, 24, 12));
    Ok(obj.finish("diffuse", DIFFUSE_MTL, DIFFUSE_TOML, vec![]))
}
