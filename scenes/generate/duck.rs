//! `duck`: a chrome duck on a wooden chair, the figure of Haber et al. 2001.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DAffine3, DVec3};
use image::ImageResult;

use super::implicit::{blend, capsule, ellipsoid, surface};
use super::obj::{Mesh, Obj, SceneFiles};
use super::shapes::{frame, quad, quad_uv, room, rounded_box, sphere, v};
use super::textures::{self, jpeg, mix, noise, picture, planks, png, smoothstep, turbulence, wood};

const MTL: &str = r"
newmtl Plaster
Kd 0.76 0.72 0.64
newmtl BlueWall
Kd 0.18 0.34 0.44
newmtl Ceiling
Kd 0.80 0.80 0.78
newmtl Skirting
Kd 0.72 0.70 0.66
newmtl Floor
map_Kd planks.jpg
Ks 0.04 0.04 0.04
Ns 400
newmtl ChairWood
map_Kd wood.jpg
Ks 0.04 0.04 0.04
Ns 90
newmtl Rug
map_Kd rug.jpg
newmtl Screen
Kd 0.55 0.30 0.15
map_d lattice.png
newmtl Chrome
Kd 0 0 0
Ks 0.55 0.55 0.55
illum 3
newmtl Bill
Kd 0 0 0
Ks 0.95 0.72 0.35
illum 3
newmtl Eye
Kd 0.01 0.01 0.01
Ks 0.04 0.04 0.04
Ns 10000
newmtl Light
Kd 0.5 0.5 0.5
Ke 20 18.4 16
";

const TOML: &str = r#"
format = 1
title = "Chrome duck on a wooden chair"
attribution = "the foveal project, CC0"

[geometry]
files = ["duck.obj"]
metres_per_unit = 1.0
up = "+y"

[[camera]]
name = "main"
eye = [0.92, 0.98, 1.1]
target = [0.0, 0.5, -0.05]
up = [0.0, 1.0, 0.0]
fov_y = 36.0

[[camera]]
name = "duck"
eye = [0.5, 0.8, 0.55]
target = [0.0, 0.58, 0.0]
up = [0.0, 1.0, 0.0]
fov_y = 38.0

[[camera]]
name = "room"
eye = [1.6, 1.5, 2.2]
target = [-0.3, 0.8, -0.6]
up = [0.0, 1.0, 0.0]
fov_y = 55.0

[[path]]
name = "tour"
keys = [
  { t = 0.0, eye = [0.92, 0.98, 1.1], target = [0.0, 0.5, -0.05] },
  { t = 2.0, eye = [0.75, 0.95, 0.9], target = [0.0, 0.56, -0.05] },
  { t = 4.0, eye = [0.3, 0.9, 0.8], target = [0.0, 0.58, 0.0] },
  { t = 6.0, eye = [-0.35, 0.95, 0.9], target = [0.0, 0.56, 0.0] },
  { t = 8.0, eye = [-0.2, 1.2, 1.5], target = [0.0, 0.55, -0.1] },
  { t = 10.0, eye = [0.6, 1.15, 1.6], target = [0.0, 0.55, -0.1] },
  { t = 12.0, eye = [0.92, 0.98, 1.1], target = [0.0, 0.5, -0.05] },
]

[material."Floor"]
model = "plastic"
map_albedo = "planks.jpg"
ior = 1.5
alpha = 0.06

[material."ChairWood"]
model = "plastic"
map_albedo = "wood.jpg"
ior = 1.5
alpha = 0.12

[material."Rug"]
model = "lambert"
map_albedo = "rug.jpg"
map_normal = "weave.png"

[material."Skirting"]
model = "plastic"
albedo = [0.72, 0.70, 0.66]
ior = 1.45
alpha = 0.2
distribution = "beckmann"

[material."Screen"]
model = "lambert"
albedo = [0.55, 0.30, 0.15]
map_opacity = "lattice.png"

[material."Chrome"]      # chromium
model = "conductor"
eta = [3.1071, 3.1812, 2.323]
k = [3.3314, 3.3291, 3.135]
alpha = 0.0

[material."Bill"]        # gold
model = "conductor"
eta = [0.14282, 0.37414, 1.43944]
k = [3.97472, 2.38066, 1.59981]
alpha = 0.08

[material."Eye"]
model = "plastic"
albedo = [0.01, 0.01, 0.01]
ior = 1.5
alpha = 0.0

[display]
exposure = 1.8
"#;

/// Distance to the duck's body; it looks along +x and stands on y = 0.
fn duck(p: DVec3) -> f64 {
    // Both sides alike.
    let p = DVec3::new(p.x, p.y, p.z.abs());
    let body = ellipsoid(p, v(-0.005, 0.077, 0.0), v(0.128, 0.08, 0.092));
    let chest = ellipsoid(p, v(0.055, 0.095, 0.0), v(0.078, 0.078, 0.074));
    let tail = capsule(p, v(-0.085, 0.09, 0.0), v(-0.152, 0.15, 0.0), 0.045, 0.008);
    let neck = capsule(p, v(0.066, 0.12, 0.0), v(0.086, 0.2, 0.0), 0.042, 0.044);
    let head = ellipsoid(p, v(0.09, 0.225, 0.0), v(0.062, 0.056, 0.054));
    let wing = ellipsoid(p, v(-0.03, 0.1, 0.082), v(0.088, 0.036, 0.02));
    let wing_tip = capsule(p, v(-0.06, 0.105, 0.088), v(-0.13, 0.128, 0.07), 0.022, 0.006);
    let trunk = blend(blend(body, chest, 0.05), tail, 0.05);
    let upper = blend(blend(neck, head, 0.025), trunk, 0.05);
    blend(upper, blend(wing, wing_tip, 0.03), 0.014)
}

/// Distance to its bill, slightly open.
fn bill(p: DVec3) -> f64 {
    let upper = ellipsoid(p, v(0.158, 0.222, 0.0), v(0.04, 0.011, 0.026));
    let tip = ellipsoid(p, v(0.185, 0.226, 0.0), v(0.02, 0.008, 0.024));
    let lower = ellipsoid(p, v(0.15, 0.206, 0.0), v(0.032, 0.007, 0.02));
    blend(blend(upper, tip, 0.012), lower, 0.012)
}

/// A chair whose seat's top is at 0.45, its back at −z.
fn chair() -> Mesh {
    let part = |lo: DVec3, hi: DVec3| rounded_box(lo, hi, 0.008, 1).uv_times(2.0, 4.0);
    let mut chair = rounded_box(v(-0.22, 0.418, -0.21), v(0.22, 0.45, 0.22), 0.012, 2).uv_times(2.0, 4.0);
    for x in [-0.185, 0.185] {
        // Legs reach 1 mm into the floor and 10 mm into the seat, so that no two faces coincide.
        chair = chair.with(part(v(x - 0.019, -0.001, 0.161), v(x + 0.019, 0.428, 0.199)));
        chair = chair.with(part(v(x - 0.017, -0.001, -0.193), v(x + 0.017, 0.93, -0.157)));
        chair = chair.with(part(v(x - 0.011, 0.17, -0.165), v(x + 0.011, 0.2, 0.17)));
        chair = chair.with(part(v(x - 0.013, 0.378, -0.166), v(x + 0.013, 0.421, 0.17)));
    }
    for (z, lo, hi) in [(0.18, 0.376, 0.421), (-0.175, 0.376, 0.421), (0.0, 0.176, 0.194)] {
        chair = chair.with(part(v(-0.18, lo, z - 0.0125), v(0.18, hi, z + 0.0125)));
    }
    for (lo, hi) in [(0.86, 0.915), (0.56, 0.6)] {
        chair = chair.with(part(v(-0.18, lo, -0.187), v(0.18, hi, -0.165)));
    }
    for i in 0..4 {
        let x = -0.108 + 0.072 * f64::from(i);
        chair = chair.with(part(v(x - 0.014, 0.59, -0.183), v(x + 0.014, 0.87, -0.169)));
    }
    chair
}

/// The scene.
pub fn scene() -> ImageResult<SceneFiles> {
    let mut obj = Obj::new(4);
    let (lo, hi) = (v(-2.0, 0.0, -1.7), v(2.2, 2.6, 2.6));
    let [floor, ceiling, left, right, back, front] = room(lo, hi);
    obj.add_textured("Floor", "Floor", floor.uv_times(0.5, 1.0));
    obj.add("Ceiling", "Ceiling", ceiling);
    obj.add("Walls", "Plaster", left.with(right).with(front));
    obj.add("BackWall", "BlueWall", back);
    obj.add("Lamp", "Light", quad(v(-0.6, 2.59, -0.3), v(1.3, 0.0, 0.0), v(0.0, 0.0, 0.9), [1.0, 1.0]));
    let skirting = rounded_box(v(-2.01, -0.01, -1.71), v(2.21, 0.12, -1.68), 0.006, 1)
        .with(rounded_box(v(-2.01, -0.01, -1.69), v(-1.98, 0.121, 2.61), 0.006, 1))
        .with(rounded_box(v(2.18, -0.01, -1.69), v(2.21, 0.121, 2.61), 0.006, 1));
    obj.add("Skirting", "Skirting", skirting);
    let rug = quad(v(-0.9, 0.006, 0.75), v(1.8, 0.0, 0.0), v(0.0, 0.0, -1.3), [1.0, 1.0]);
    let lying = DAffine3::from_rotation_x(-FRAC_PI_2);
    let edge = frame([1.8, 1.3], &[[0.0, 0.0], [0.006, -0.008]]).transform(lying).at(0.0, 0.006, 0.1);
    obj.add_textured("Rug", "Rug", rug.with(edge));
    // A screen of three leaves in the corner, cut out of sheets.
    let foot: [[f64; 2]; 4] = [[-1.75, -0.35], [-1.4, -0.75], [-1.0, -0.95], [-0.75, -1.45]];
    for (i, w) in foot.windows(2).enumerate() {
        let (a, b) = (v(w[0][0], 0.02, w[0][1]), v(w[1][0], 0.02, w[1][1]));
        let up = v(0.0, 1.6, 0.0);
        let sheet = quad_uv([a, b, b + up, a + up], [[0.0, 0.0], [1.0, 0.0], [1.0, 3.0], [0.0, 3.0]]);
        obj.add_textured(&format!("Screen{i}"), "Screen", sheet);
    }
    obj.add_textured("Chair", "ChairWood", chair());
    let place = |mesh: Mesh| mesh.turned(-22.0).at(0.0, 0.447, 0.03);
    obj.add("Duck", "Chrome", place(surface(v(-0.19, -0.03, -0.13), v(0.17, 0.31, 0.13), 36, &duck)));
    obj.add("Bill", "Bill", place(surface(v(0.09, 0.18, -0.05), v(0.22, 0.25, 0.05), 20, &bill)));
    for (name, side) in [("LeftEye", -1.0), ("RightEye", 1.0)] {
        obj.add(name, "Eye", place(sphere(v(0.124, 0.244, side * 0.039), 0.0095, 16, 8)));
    }
    let rug_picture = picture(256, 184, |u, v| {
        let (x, y) = ((u - 0.5).abs() * 2.0, (v - 0.5).abs() * 2.0);
        let edge = (1.0 - x).min((1.0 - y) * 0.72);
        let diamond = (x * 6.0 + y * 4.0) - (x * 6.0 + y * 4.0).floor();
        let ground = mix([0.48, 0.13, 0.12], [0.60, 0.24, 0.16], smoothstep(0.4, 0.6, diamond));
        let medal = x * x * 2.2 + y * y;
        let ground = if medal < 0.18 {
            [0.75, 0.65, 0.45]
        } else if medal < 0.26 {
            [0.14, 0.20, 0.32]
        } else {
            ground
        };
        let band = if edge < 0.03 {
            [0.70, 0.62, 0.48]
        } else if edge < 0.12 {
            [0.14, 0.20, 0.32]
        } else if edge < 0.14 {
            [0.75, 0.65, 0.45]
        } else {
            ground
        };
        band.map(|c| c * (0.85 + 0.3 * noise(u * 64.0, v * 64.0, [64, 64], 5)))
    });
    let weave = textures::normal_map(64, 0.02, |u, v| {
        let thread = (u * 16.0 * PI).sin().abs() * (v * 16.0 * PI).sin().abs();
        thread + 0.3 * turbulence(u, v, [8, 8], 2, 77)
    });
    let wood = picture(512, 256, wood([0.36, 0.18, 0.07], [0.66, 0.40, 0.19], 11));
    let floor = picture(512, 512, planks([0.34, 0.20, 0.10], [0.66, 0.45, 0.26], 8, 21));
    let textures = vec![
        ("planks.jpg", jpeg(&floor, 82)?),
        ("wood.jpg", jpeg(&wood, 82)?),
        ("rug.jpg", jpeg(&rug_picture, 82)?),
        ("weave.png", png(&weave)?),
        ("lattice.png", png(&textures::lattice())?),
    ];
    Ok(obj.finish("duck", MTL, TOML, textures))
}
