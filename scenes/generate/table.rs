//! `table`: two glasses and a mug on a wooden table by a window.

use glam::{DAffine3, DVec2, DVec3};
use image::ImageResult;

use super::obj::{Mesh, Obj, SceneFiles};
use super::shapes::{
    cuboid, curve, lathe, quad, quad_with_hole, room, rounded_box, sphere, straight, tube, v,
};
use super::textures::{jpeg, picture, planks, png, turbulence, wood};

const MTL: &str = r"
newmtl Plaster
Kd 0.78 0.75 0.69
newmtl Sage
Kd 0.36 0.44 0.34
newmtl Ceiling
Kd 0.82 0.82 0.80
newmtl Floor
map_Kd planks.jpg
newmtl TableWood
map_Kd wood.jpg
Ks 0.04 0.04 0.04
Ns 400
newmtl WindowFrame
Kd 0.78 0.78 0.76
newmtl Pane
Kd 0 0 0
Ni 1.5
d 0.1
illum 4
newmtl ClearGlass
Kd 0 0 0
Ks 1 1 1
Ni 1.52
illum 7
newmtl BlueGlass
Kd 0 0 0
Ks 1 1 1
Ni 1.52
Tf 0.4 0.7 0.95
illum 7
newmtl Mug
Kd 0.55 0.06 0.04
Ks 0.05 0.05 0.05
Ns 2000
newmtl Bowl
Kd 0.05 0.05 0.05
Ks 0.6 0.58 0.55
Ns 60
newmtl Lemon
Kd 0.80 0.60 0.05
Ks 0.04 0.04 0.04
Ns 60
newmtl Shade
Kd 0.10 0.05 0.03
Ks 0.70 0.45 0.30
Ns 40
newmtl Cord
Kd 0.03 0.03 0.03
newmtl Light
Kd 0.5 0.5 0.5
Ke 8 7.6 7
";

const TOML: &str = r#"
format = 1
title = "Two glasses and a mug by a window"
attribution = "the foveal project, CC0"

[geometry]
files = ["table.obj"]
metres_per_unit = 1.0
up = "+y"

[[camera]]
name = "main"
eye = [0.34, 1.04, 0.66]
target = [-0.01, 0.795, -0.02]
up = [0.0, 1.0, 0.0]
fov_y = 34.0

[[camera]]
name = "glasses"
eye = [0.12, 0.92, 0.5]
target = [-0.08, 0.83, 0.0]
up = [0.0, 1.0, 0.0]
fov_y = 34.0

[[camera]]
name = "room"
eye = [1.4, 1.55, 1.7]
target = [-0.3, 0.9, -0.3]
up = [0.0, 1.0, 0.0]
fov_y = 55.0

[[path]]
name = "tour"
keys = [
  { t = 0.0, eye = [0.34, 1.04, 0.66], target = [-0.01, 0.795, -0.02] },
  { t = 2.0, eye = [0.25, 1.0, 0.62], target = [-0.05, 0.81, -0.01] },
  { t = 4.0, eye = [-0.1, 0.95, 0.6], target = [-0.03, 0.81, 0.0] },
  { t = 6.0, eye = [-0.45, 1.05, 0.65], target = [0.0, 0.8, -0.02] },
  { t = 8.0, eye = [-0.3, 1.3, 0.95], target = [0.0, 0.8, -0.02] },
  { t = 10.0, eye = [0.2, 1.25, 1.0], target = [0.0, 0.8, -0.02] },
  { t = 12.0, eye = [0.34, 1.04, 0.66], target = [-0.01, 0.795, -0.02] },
]

[environment]
radiance = [2.4, 3.0, 3.8]

[[light]]                # the lamp's bulb
kind = "point"
position = [0.05, 1.5, -0.05]
intensity = [2.6, 2.1, 1.4]

[material."TableWood"]
model = "plastic"
map_albedo = "wood.jpg"
ior = 1.5
alpha = 0.05

[material."Pane"]
model = "dielectric"
ior = 1.5
transmittance = [0.98, 0.99, 0.985]
thin = true

[material."ClearGlass"]
model = "dielectric"
ior = 1.52
transmittance = [0.05, 0.2, 0.1]      # per metre: 3 mm of glass

[material."BlueGlass"]
model = "dielectric"
ior = 1.52
transmittance = [1e-60, 1e-22, 1e-4]  # per metre

[material."Mug"]
model = "plastic"
albedo = [0.55, 0.06, 0.04]
ior = 1.55
alpha = 0.015

[material."Bowl"]        # spun steel
model = "ward"
diffuse = [0.05, 0.05, 0.05]
specular = [0.6, 0.58, 0.55]
alpha_x = 0.07
alpha_y = 0.28

[material."Lemon"]
model = "plastic"
albedo = [0.80, 0.60, 0.05]
ior = 1.4
alpha = 0.25
map_bump = "peel.png"

[material."Shade"]
model = "cook_torrance"
diffuse = [0.10, 0.05, 0.03]
specular = [0.70, 0.45, 0.30]
alpha = 0.22
distribution = "beckmann"

[display]
exposure = 1.3
"#;

/// A tumbler: 2 mm walls, 9 mm base.
fn tumbler() -> Mesh {
    let outside = curve(&[[0.0, 0.0], [0.026, 0.0], [0.0295, 0.002], [0.031, 0.006]], 2);
    let wall = curve(&[[0.031, 0.006], [0.0335, 0.04], [0.036, 0.093]], 3);
    let rim =
        curve(&[[0.036, 0.093], [0.0357, 0.0946], [0.035, 0.0952], [0.0343, 0.0946], [0.034, 0.093]], 2);
    let inside = curve(&[[0.034, 0.093], [0.0313, 0.04], [0.0285, 0.014], [0.024, 0.0095], [0.0, 0.009]], 2);
    lathe(&[joined(&[outside, wall, rim, inside])], 36)
}

/// A stemmed glass: 1.5 mm walls.
fn goblet() -> Mesh {
    let foot = curve(&[[0.0, 0.0], [0.02, 0.0], [0.034, 0.0], [0.0352, 0.001], [0.0345, 0.0022]], 2);
    let stem = curve(
        &[[0.0345, 0.0022], [0.02, 0.0045], [0.0065, 0.011], [0.004, 0.03], [0.004, 0.065], [0.0075, 0.078]],
        3,
    );
    let bowl = curve(&[[0.0075, 0.078], [0.024, 0.089], [0.037, 0.112], [0.0385, 0.135], [0.033, 0.17]], 3);
    let rim = curve(&[[0.033, 0.17], [0.0327, 0.1708], [0.0322, 0.171], [0.0317, 0.1708], [0.0315, 0.17]], 2);
    let inside = curve(
        &[[0.0315, 0.17], [0.037, 0.135], [0.0355, 0.1128], [0.0228, 0.0905], [0.008, 0.0845], [0.0, 0.084]],
        4,
    );
    lathe(&[joined(&[foot, stem, bowl, rim, inside])], 36)
}

/// One smooth stroke of several that follow each other.
fn joined(strokes: &[Vec<DVec2>]) -> Vec<DVec2> {
    let mut all: Vec<DVec2> = strokes.concat();
    all.dedup_by(|a, b| a.distance(*b) < 1e-9);
    all
}

/// A mug with its handle towards +x.
fn mug() -> Mesh {
    let outside =
        curve(&[[0.0, 0.0], [0.034, 0.0], [0.0385, 0.0015], [0.04, 0.006], [0.041, 0.05], [0.041, 0.09]], 2);
    let rim = curve(&[[0.041, 0.09], [0.0405, 0.092], [0.039, 0.093], [0.0375, 0.092], [0.037, 0.09]], 2);
    let inside = curve(&[[0.037, 0.09], [0.0365, 0.05], [0.036, 0.012], [0.033, 0.007], [0.0, 0.006]], 2);
    let handle = curve(
        &[[0.039, 0.077], [0.056, 0.079], [0.069, 0.069], [0.07, 0.047], [0.06, 0.028], [0.0385, 0.019]],
        5,
    );
    lathe(&[joined(&[outside, rim, inside])], 36).with(tube(&handle, 0.0048, 1.3, 10))
}

/// A bowl of 2 mm sheet.
fn bowl() -> Mesh {
    let outside = curve(&[[0.0, 0.0], [0.045, 0.0], [0.05, 0.002], [0.085, 0.024], [0.112, 0.06]], 3);
    let rim = curve(&[[0.112, 0.06], [0.1118, 0.0615], [0.1105, 0.062], [0.1095, 0.061]], 2);
    let inside = curve(&[[0.1095, 0.061], [0.083, 0.0262], [0.048, 0.0045], [0.0, 0.0025]], 3);
    lathe(&[joined(&[outside, rim, inside])], 36)
}

/// A lemon of half length 1 along x.
fn lemon() -> Mesh {
    let side = curve(
        &[
            [0.0, -1.0],
            [0.1, -0.98],
            [0.22, -0.88],
            [0.5, -0.6],
            [0.7, 0.0],
            [0.5, 0.6],
            [0.2, 0.9],
            [0.08, 0.99],
            [0.0, 1.0],
        ],
        2,
    );
    lathe(&[side], 18).transform(DAffine3::from_rotation_z(-std::f64::consts::FRAC_PI_2))
}

/// A table whose top is at 0.74.
fn table() -> Mesh {
    let mut table = rounded_box(v(-0.65, 0.705, -0.4), v(0.65, 0.74, 0.4), 0.008, 1).uv_times(1.0, 2.0);
    let part = |lo: DVec3, hi: DVec3| rounded_box(lo, hi, 0.006, 1).uv_times(2.0, 4.0);
    for x in [-0.59, 0.59] {
        for z in [-0.34, 0.34] {
            table = table.with(part(v(x - 0.03, -0.001, z - 0.03), v(x + 0.03, 0.715, z + 0.03)));
        }
        table = table.with(part(v(x - 0.012, 0.62, -0.33), v(x + 0.012, 0.71, 0.33)));
    }
    for z in [-0.34, 0.34] {
        table = table.with(part(v(-0.58, 0.621, z - 0.012), v(0.58, 0.711, z + 0.012)));
    }
    table
}

/// The scene.
pub fn scene() -> ImageResult<SceneFiles> {
    let mut obj = Obj::new(5);
    let [floor, ceiling, _left, right, back, front] = room(v(-1.7, 0.0, -1.6), v(1.8, 2.5, 2.2));
    obj.add_textured("Floor", "Floor", floor.uv_times(0.5, 1.0));
    obj.add("Ceiling", "Ceiling", ceiling);
    obj.add("Walls", "Plaster", right.with(front));
    obj.add("BackWall", "Sage", back);
    obj.add("Lamp", "Light", quad(v(-0.2, 2.49, 0.4), v(0.9, 0.0, 0.0), v(0.0, 0.0, 0.9), [1.0, 1.0]));

    // The window: z −0.9…0.5, y 0.95…2.05, in a wall 0.16 thick.
    let (lo, hi) = (DVec2::new(1.7 / 3.8, 0.38), DVec2::new(3.1 / 3.8, 0.82));
    let wall = quad_with_hole(v(-1.7, 0.0, 2.2), v(0.0, 0.0, -3.8), v(0.0, 2.5, 0.0), lo, hi, [3.8, 2.5]);
    let (z0, z1, y0, y1) = (-0.9, 0.5, 0.95, 2.05);
    let deep = v(-0.16, 0.0, 0.0);
    let (along_z, along_y) = (v(0.0, 0.0, z1 - z0), v(0.0, y1 - y0, 0.0));
    let reveal = quad(v(-1.7, y0, z0), deep, along_z, [0.16, 1.4])
        .with(quad(v(-1.7, y1, z1), deep, -along_z, [0.16, 1.4]))
        .with(quad(v(-1.7, y0, z1), deep, along_y, [0.16, 1.1]))
        .with(quad(v(-1.7, y1, z0), deep, -along_y, [0.16, 1.1]));
    obj.add("WindowWall", "Plaster", wall.with(reveal));
    let bar = |lo: DVec3, hi: DVec3| cuboid(lo, hi);
    // Each bar reaches into the wall or its neighbour.
    let bars = bar(v(-1.83, y0 - 0.01, z0 - 0.01), v(-1.775, y0 + 0.05, z1 + 0.01))
        .with(bar(v(-1.83, y1 - 0.05, z0 - 0.01), v(-1.775, y1 + 0.01, z1 + 0.01)))
        .with(bar(v(-1.829, y0 + 0.04, z0 - 0.009), v(-1.776, y1 - 0.04, z0 + 0.05)))
        .with(bar(v(-1.829, y0 + 0.04, z1 - 0.05), v(-1.776, y1 - 0.04, z1 + 0.009)))
        .with(bar(v(-1.828, y0 + 0.04, -0.225), v(-1.777, y1 - 0.04, -0.175)));
    obj.add("WindowFrame", "WindowFrame", bars);
    let pane = quad(
        v(-1.8, y0 + 0.03, z1 - 0.03),
        v(0.0, 0.0, z0 - z1 + 0.06),
        v(0.0, y1 - y0 - 0.06, 0.0),
        [1.0, 1.0],
    );
    obj.add("Pane", "Pane", pane);

    obj.add_textured("Table", "TableWood", table());
    // Glass stands a fifth of a millimetre above the wood.
    let top = 0.7402;
    obj.add("Goblet", "ClearGlass", goblet().at(-0.1, top, 0.06));
    obj.add("Tumbler", "BlueGlass", tumbler().at(0.045, top, 0.13));
    obj.add("Mug", "Mug", mug().turned(35.0).at(0.16, top, -0.06));
    obj.add_textured("Bowl", "Bowl", bowl().at(-0.16, top, -0.16));
    let lemons = [(v(-0.2, 0.776, -0.15), 0.046, 20.0), (v(-0.115, 0.777, -0.19), 0.044, 110.0)];
    for (i, (place, size, turn)) in lemons.into_iter().enumerate() {
        let scaled = lemon().transform(DAffine3::from_scale(DVec3::splat(size)));
        obj.add_textured(
            &format!("Lemon{i}"),
            "Lemon",
            scaled.turned(turn).at(place.x, place.y + 0.002, place.z),
        );
    }
    let fallen = lemon().transform(DAffine3::from_scale(DVec3::splat(0.045))).turned(-35.0);
    obj.add_textured("Lemon2", "Lemon", fallen.at(0.005, 0.7402 + 0.0316, -0.13));
    // The lamp above: a double shade, open below, and its cord.
    let outside = curve(&[[0.15, 0.0], [0.13, 0.05], [0.07, 0.11], [0.018, 0.14]], 2);
    let cap = straight(&[[0.018, 0.14], [0.012, 0.141], [0.0, 0.141]]);
    let inside = curve(&[[0.0, 0.132], [0.016, 0.132], [0.067, 0.107], [0.127, 0.048], [0.147, 0.0]], 2);
    let edge = straight(&[[0.147, 0.0], [0.15, 0.0]]);
    obj.add("Shade", "Shade", lathe(&[outside, cap, inside, edge], 36).at(0.05, 1.47, -0.05));
    obj.add("Cord", "Cord", lathe(&[straight(&[[0.003, 1.605], [0.003, 2.51]])], 8).at(0.05, 0.0, -0.05));
    obj.add("Bulb", "Cord", sphere(v(0.05, 1.575, -0.05), 0.022, 12, 6));

    let peel = picture(96, 96, |u, v| [turbulence(u, v, [24, 24], 2, 31); 3]);
    let wood = picture(512, 256, wood([0.30, 0.15, 0.07], [0.62, 0.40, 0.22], 41));
    let floor = picture(256, 256, planks([0.40, 0.30, 0.22], [0.68, 0.56, 0.42], 6, 51));
    let textures =
        vec![("wood.jpg", jpeg(&wood, 82)?), ("planks.jpg", jpeg(&floor, 80)?), ("peel.png", png(&peel)?)];
    Ok(obj.finish("table", MTL, TOML, textures))
}
