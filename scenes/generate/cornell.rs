//! `box`: after the Cornell box, with a mirror ball and a glass ball.

use image::ImageResult;

use super::obj::{Obj, SceneFiles};
use super::shapes::{quad, room, sphere, v};

const MTL: &str = r"
newmtl White
Kd 0.73 0.72 0.68
newmtl Red
Kd 0.62 0.06 0.05
newmtl Green
Kd 0.12 0.44 0.09
newmtl Light
Kd 0.5 0.5 0.5
Ke 17 12.5 7
newmtl MirrorBall
Kd 0 0 0
Ks 0.95 0.95 0.95
illum 3
newmtl GlassBall
Kd 0 0 0
Ks 1 1 1
Ni 1.5
Tf 1 1 1
illum 7
";

const TOML: &str = r#"
format = 1
title = "Box with a mirror ball and a glass ball"
attribution = "the foveal project, CC0"

[geometry]
files = ["box.obj"]
metres_per_unit = 1.0
up = "+y"

[[camera]]
name = "main"
eye = [0.0, 1.0, 2.5]
target = [0.0, 0.82, 0.0]
up = [0.0, 1.0, 0.0]
fov_y = 48.0

[[camera]]
name = "mirror-ball"
eye = [0.1, 0.85, 0.85]
target = [-0.42, 0.42, -0.35]
up = [0.0, 1.0, 0.0]
fov_y = 42.0

[[camera]]
name = "glass-ball"
eye = [0.15, 0.7, 1.6]
target = [0.42, 0.34, 0.28]
up = [0.0, 1.0, 0.0]
fov_y = 38.0

[[path]]
name = "tour"
keys = [
  { t = 0.0, eye = [0.0, 1.0, 2.5], target = [0.0, 0.82, 0.0] },
  { t = 2.0, eye = [0.35, 0.95, 2.0], target = [0.0, 0.7, 0.0] },
  { t = 4.0, eye = [0.2, 0.85, 1.5], target = [-0.1, 0.45, 0.0] },
  { t = 6.0, eye = [-0.3, 0.9, 1.3], target = [0.1, 0.4, 0.0] },
  { t = 8.0, eye = [-0.55, 1.1, 1.7], target = [0.1, 0.5, 0.0] },
  { t = 10.0, eye = [-0.2, 1.05, 2.2], target = [0.0, 0.8, 0.0] },
  { t = 12.0, eye = [0.0, 1.0, 2.5], target = [0.0, 0.82, 0.0] },
]

[material."MirrorBall"]
model = "mirror"
specular = [0.95, 0.95, 0.95]

[material."GlassBall"]
model = "dielectric"
ior = 1.5
transmittance = [0.97, 0.99, 0.98]

[display]
exposure = 1.1
"#;

/// The scene.
pub fn scene() -> ImageResult<SceneFiles> {
    let mut obj = Obj::new(4);
    let [floor, ceiling, left, right, back, front] = room(v(-1.2, 0.0, -1.0), v(1.2, 2.0, 2.6));
    obj.add("Room", "White", floor.with(ceiling).with(back).with(front));
    obj.add("LeftWall", "Red", left);
    obj.add("RightWall", "Green", right);
    let lamp = quad(v(-0.35, 1.995, -0.3), v(0.7, 0.0, 0.0), v(0.0, 0.0, 0.6), [1.0, 1.0]);
    obj.add("Lamp", "Light", lamp);
    obj.add("MirrorBall", "MirrorBall", sphere(v(-0.42, 0.422, -0.35), 0.42, 52, 26));
    obj.add("GlassBall", "GlassBall", sphere(v(0.42, 0.342, 0.28), 0.34, 56, 28));
    Ok(obj.finish("box", MTL, TOML, vec![]))
}
