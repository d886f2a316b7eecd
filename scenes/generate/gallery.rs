//! `gallery`: a room with paintings, a mirror and a polished floor.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::{DAffine3, DVec2, DVec3};
use image::ImageResult;

use super::obj::{Corner, Mesh, Obj, SceneFiles};
use super::shapes::{curve, frame, lathe, quad, room, rounded_box, torus, v};
use super::textures::{
    Color, hash, jpeg, leaf, marble_tiles, mix, noise, normal_map, picture, png, png_alpha, smoothstep,
    turbulence,
};

const MTL: &str = r"
newmtl Wall
Kd 0.42 0.13 0.12
newmtl Ceiling
Kd 0.80 0.79 0.77
newmtl Cornice
Kd 0.78 0.76 0.70
newmtl Floor
map_Kd marble.jpg
Ks 0.04 0.04 0.04
Ns 5000
newmtl Gilt
Kd 0 0 0
Ks 0.95 0.72 0.35
Pr 0.45
Pm 1
newmtl DarkFrame
Kd 0.06 0.04 0.03
Ks 0.04 0.04 0.04
Ns 200
newmtl Mirror
Kd 0 0 0
Ks 0.92 0.93 0.92
illum 3
newmtl Dusk
map_Kd dusk.jpg
newmtl Circles
map_Kd circles.jpg
newmtl Grid
map_Kd grid.jpg
newmtl Waves
map_Kd waves.jpg
newmtl Set
map_Kd set.jpg
newmtl Copper
Kd 0 0 0
Ks 0.93 0.62 0.52
Ns 60
newmtl Plinth
Kd 0.70 0.69 0.66
newmtl Leather
Kd 0.12 0.05 0.025
Ks 0.04 0.04 0.04
Ns 60
newmtl Steel
Kd 0 0 0
Ks 0.6 0.58 0.55
Pm 1
Pr 0.3
newmtl Pot
Kd 0.20 0.30 0.34
Ks 0.05 0.05 0.05
Ns 2000
newmtl Soil
Kd 0.05 0.035 0.025
newmtl Leaf
map_Kd leaf.png
map_d leaf.png
newmtl Stalk
Kd 0.10 0.18 0.05
newmtl Light
Kd 0.6 0.6 0.6
Ke 20 19.2 18
newmtl LampBody
Kd 0.03 0.03 0.03
";

const TOML: &str = r#"
format = 1
title = "Gallery"
attribution = "the foveal project, CC0"

[geometry]
files = ["gallery.obj"]
metres_per_unit = 1.0
up = "+y"

[[camera]]
name = "main"
eye = [-2.4, 1.6, 2.1]
target = [0.6, 1.15, -1.0]
up = [0.0, 1.0, 0.0]
fov_y = 52.0

[[camera]]
name = "sculpture"
eye = [-0.9, 1.5, 1.0]
target = [0.0, 1.1, -0.3]
up = [0.0, 1.0, 0.0]
fov_y = 38.0

[[camera]]
name = "mirror"
eye = [1.0, 1.55, 1.6]
target = [3.45, 1.4, -0.1]
up = [0.0, 1.0, 0.0]
fov_y = 50.0

[[camera]]
name = "painting"
eye = [-1.6, 1.5, -0.6]
target = [-2.0, 1.55, -2.5]
up = [0.0, 1.0, 0.0]
fov_y = 45.0

[[path]]
name = "tour"
keys = [
  { t = 0.0, eye = [-2.4, 1.6, 2.1], target = [0.6, 1.15, -1.0] },
  { t = 3.0, eye = [-1.6, 1.6, 0.6], target = [-1.6, 1.5, -2.5] },
  { t = 6.0, eye = [0.0, 1.6, 0.9], target = [0.0, 1.35, -2.0] },
  { t = 9.0, eye = [1.3, 1.6, 0.9], target = [3.4, 1.4, -0.4] },
  { t = 12.0, eye = [0.6, 1.6, 1.6], target = [0.2, 1.3, -1.0] },
  { t = 15.0, eye = [-2.4, 1.6, 2.1], target = [0.6, 1.15, -1.0] },
]

[[light]]
kind = "spot"
position = [-2.0, 3.02, -1.1]
direction = [0.0, -1.45, -1.4]
intensity = [22.0, 20.2, 17.0]
inner = 17.0
outer = 27.0

[[light]]
kind = "spot"
position = [0.0, 3.02, -1.1]
direction = [0.0, -1.45, -1.4]
intensity = [22.0, 20.2, 17.0]
inner = 17.0
outer = 27.0

[[light]]
kind = "spot"
position = [2.0, 3.02, -1.1]
direction = [0.0, -1.45, -1.4]
intensity = [22.0, 20.2, 17.0]
inner = 17.0
outer = 27.0

[material."Floor"]
model = "plastic"
map_albedo = "marble.jpg"
ior = 1.5
alpha = 0.02

[material."Gilt"]
model = "conductor"
map_specular = "gilt.jpg"
alpha = 0.2

[material."DarkFrame"]
model = "plastic"
albedo = [0.06, 0.04, 0.03]
ior = 1.5
alpha = 0.1

[material."Mirror"]
model = "mirror"
specular = [0.92, 0.93, 0.92]

[material."Copper"]
model = "conductor"
eta = [0.20004, 0.92209, 1.09988]
k = [3.91205, 2.45186, 2.14219]
alpha = 0.18

[material."Leather"]
model = "plastic"
albedo = [0.12, 0.05, 0.025]
ior = 1.45
alpha = 0.25
map_normal = "tufted.png"

[material."Pot"]
model = "plastic"
albedo = [0.20, 0.30, 0.34]
ior = 1.5
alpha = 0.03

[material."Leaf"]
model = "lambert"
map_albedo = "leaf.png"
map_opacity = "leaf.png"

[display]
exposure = 2.0
"#;

/// A landscape at dusk: hills one behind the other under a low sun.
fn dusk(u: f64, v: f64) -> Color {
    let sky = mix([0.98, 0.68, 0.38], [0.22, 0.26, 0.48], smoothstep(0.3, 1.0, v));
    let (dx, dy) = ((u - 0.62) * 1.4, v - 0.47);
    let sun = (dx * dx + dy * dy).sqrt();
    let glow = 1.0 - smoothstep(0.0, 0.5, sun);
    let mut color = mix(sky, [1.0, 0.85, 0.55], 0.7 * glow * glow);
    if sun < 0.055 {
        color = [1.0, 0.95, 0.8];
    }
    let cloud = turbulence(u, v * 3.0, [3, 3], 4, 90);
    color = mix(color, [0.95, 0.55, 0.45], 0.6 * smoothstep(0.55, 0.75, cloud) * smoothstep(0.4, 0.7, v));
    for layer in 0..5 {
        let depth = f64::from(layer);
        let line = 0.47 - 0.095 * depth
            + (0.10 + 0.03 * depth) * (turbulence(u, 0.1 * depth, [3, 3], 5, 60 + layer as u64) - 0.5) * 2.0;
        if v < line {
            let near = depth / 4.0;
            color = mix([0.62, 0.42, 0.45], [0.08, 0.11, 0.12], near);
            color = color.map(|c| c * (0.9 + 0.25 * noise(u * 90.0, v * 90.0, [90, 90], 70)));
        }
    }
    color
}

/// Squares with rings of colours.
fn circles(u: f64, v: f64) -> Color {
    const INKS: [Color; 8] = [
        [0.85, 0.24, 0.16],
        [0.95, 0.70, 0.20],
        [0.16, 0.34, 0.55],
        [0.90, 0.86, 0.76],
        [0.24, 0.50, 0.40],
        [0.12, 0.12, 0.16],
        [0.80, 0.48, 0.50],
        [0.45, 0.30, 0.50],
    ];
    let (x, y) = ((u * 4.0).floor(), (v * 3.0).floor());
    let wobble = 0.06 * (noise(u * 20.0, v * 15.0, [20, 15], 14) - 0.5);
    let (dx, dy) = (u * 4.0 - x - 0.5, v * 3.0 - y - 0.5);
    let ring = (((dx * dx + dy * dy).sqrt() + wobble) / 0.115).floor().min(4.0);
    let cell = (y * 4.0 + x) as i64;
    let ink = INKS[(hash(cell, ring as i64, 4) * 8.0) as usize];
    ink.map(|c| c * (0.85 + 0.3 * turbulence(u, v, [16, 12], 3, 8)))
}

/// Lines and planes.
fn grid(u: f64, v: f64) -> Color {
    let lines_x = [0.0, 0.18, 0.52, 0.81, 1.0];
    let lines_y = [0.0, 0.27, 0.44, 0.78, 1.0];
    let near = |lines: &[f64], x: f64, width: f64| lines.iter().any(|l| (l - x).abs() < width);
    if near(&lines_x[1..4], u, 0.012) || near(&lines_y[1..4], v, 0.016) {
        return [0.07, 0.07, 0.08];
    }
    let column = lines_x.iter().filter(|&&l| l < u).count();
    let row = lines_y.iter().filter(|&&l| l < v).count();
    let base = match (column, row) {
        (3, 4) | (1, 1) => [0.80, 0.12, 0.10],
        (1, 3) => [0.12, 0.22, 0.55],
        (4, 2) => [0.93, 0.76, 0.14],
        (2, 2) | (4, 4) => [0.78, 0.79, 0.80],
        _ => [0.93, 0.92, 0.88],
    };
    base.map(|c| c * (0.94 + 0.1 * noise(u * 80.0, v * 120.0, [80, 120], 3)))
}

/// A sea at night under the moon.
fn waves(u: f64, v: f64) -> Color {
    let (dx, dy) = ((u - 0.35) * 0.75, v - 0.8);
    let moon = (dx * dx + dy * dy).sqrt();
    if v > 0.52 {
        let sky = mix([0.10, 0.20, 0.32], [0.02, 0.04, 0.12], smoothstep(0.52, 1.0, v));
        let glow = (1.0 - smoothstep(0.0, 0.45, moon)).powi(2);
        let sky = mix(sky, [0.55, 0.62, 0.66], glow * 0.8);
        return if moon < 0.055 { [0.97, 0.95, 0.86] } else { sky };
    }
    let far = (0.52 - v) / 0.52;
    let swell = turbulence(u / (0.25 + far), 1.5 / (0.12 + far), [8, 8], 4, 33);
    let path = (-((u - 0.35) / (0.05 + 0.16 * far)).powi(2)).exp();
    let water = mix([0.03, 0.10, 0.17], [0.12, 0.30, 0.38], smoothstep(0.3, 0.7, swell));
    mix(water, [0.92, 0.92, 0.82], path * smoothstep(0.48, 0.62, swell))
}

/// The Julia set of −0.79 + 0.15 i.
fn julia(u: f64, v: f64) -> Color {
    let (mut x, mut y) = ((u - 0.5) * 2.9, (v - 0.5) * 2.2);
    let mut count = 0;
    while count < 90 && x * x + y * y < 64.0 {
        (x, y) = (x * x - y * y - 0.79, 2.0 * x * y + 0.15);
        count += 1;
    }
    let t = f64::from(count) / 90.0;
    let low = mix([0.05, 0.07, 0.20], [0.15, 0.45, 0.55], smoothstep(0.02, 0.2, t));
    mix(mix(low, [0.96, 0.80, 0.40], smoothstep(0.15, 0.45, t)), [0.45, 0.08, 0.12], smoothstep(0.5, 1.0, t))
}

/// A picture hung on a wall: canvas and frame, the wall at z = 0.
fn hang(obj: &mut Obj, name: &str, material: &str, gilt: bool, size: [f64; 2], place: DAffine3) {
    let canvas =
        quad(v(-0.5 * size[0], -0.5 * size[1], 0.02), v(size[0], 0.0, 0.0), v(0.0, size[1], 0.0), [1.0, 1.0]);
    obj.add_textured(name, material, canvas.transform(place));
    let (profile, finish): (&[[f64; 2]], &str) = if gilt {
        (
            &[
                [-0.004, 0.016],
                [0.0, 0.026],
                [0.012, 0.03],
                [0.03, 0.05],
                [0.05, 0.06],
                [0.068, 0.054],
                [0.08, 0.03],
                [0.082, -0.01],
            ],
            "Gilt",
        )
    } else {
        (&[[-0.004, 0.016], [0.0, 0.035], [0.03, 0.038], [0.034, 0.034], [0.036, -0.01]], "DarkFrame")
    };
    obj.add_textured(&format!("{name}Frame"), finish, frame(size, profile).transform(place));
}

/// A plant of cut-out leaves in a pot.
fn plant(obj: &mut Obj, at: DVec3) {
    let outside = curve(
        &[[0.0, 0.0], [0.1, 0.0], [0.11, 0.01], [0.15, 0.16], [0.165, 0.3], [0.17, 0.315], [0.163, 0.32]],
        3,
    );
    let inside = curve(&[[0.163, 0.32], [0.152, 0.31], [0.146, 0.26], [0.142, 0.24]], 2);
    obj.add("Pot", "Pot", lathe(&[outside, inside], 24).at(at.x, at.y - 0.001, at.z));
    let soil = curve(&[[0.15, 0.28], [0.08, 0.29], [0.0, 0.285]], 1);
    obj.add("Soil", "Soil", lathe(&[soil], 16).at(at.x, at.y, at.z));
    let (mut leaves, mut stalks) = (Mesh::default(), Mesh::default());
    for i in 0..18i64 {
        let r = |k: i64| hash(i, k, 7);
        let (turn, rise) = (i as f64 * 137.508 + 20.0 * r(0), 0.35 + 0.5 * r(1));
        let (reach, length) = (0.08 + 0.12 * r(2), 0.30 + 0.14 * r(3));
        let tilt = 0.35 + 0.75 * (1.0 - rise) + 0.2 * r(4);
        // The stalk, then the blade bending outwards, in the plane of x and y.
        let foot = [0.02, 0.27];
        let top = [reach, 0.28 + rise * 0.6];
        let stalk = curve(&[foot, [0.3 * reach, 0.28 + rise * 0.3], top], 2);
        stalks = stalks.with(super::shapes::tube(&stalk, 0.004, 1.0, 5).turned(turn).at(at.x, at.y, at.z));
        let mut rows: Vec<(DVec2, f64)> = vec![(DVec2::from(top), tilt)];
        for k in 0..5 {
            let (p, angle) = rows[k];
            let step = length / 5.0;
            rows.push((p + DVec2::new(angle.sin(), angle.cos()) * step, angle + 0.24));
        }
        let corner = |k: usize, side: f64| {
            let (p, angle) = rows[k];
            let lift = (side * 0.012).abs();
            Corner {
                position: v(p.x - lift, p.y + lift, side * 0.085),
                normal: v(-angle.cos(), angle.sin(), 0.0),
                uv: DVec2::new(0.5 + 0.5 * side, k as f64 / 5.0),
            }
        };
        let mut blade = Mesh::default();
        for k in 0..5 {
            for side in [-1.0, 0.0] {
                blade.faces.push(vec![
                    corner(k, side),
                    corner(k, side + 1.0),
                    corner(k + 1, side + 1.0),
                    corner(k + 1, side),
                ]);
            }
        }
        leaves = leaves.with(blade.turned(turn).at(at.x, at.y, at.z));
    }
    obj.add("Stalks", "Stalk", stalks);
    obj.add_textured("Leaves", "Leaf", leaves);
}

/// Three linked rings.
fn rings() -> Mesh {
    (0..3).fold(Mesh::default(), |mesh, i| {
        let tilt = DAffine3::from_rotation_x(1.0) * DAffine3::from_translation(v(0.1, 0.0, 0.0));
        let ring = torus(0.18, 0.034, 40, 14).transform(DAffine3::from_rotation_x(FRAC_PI_2)).transform(tilt);
        mesh.with(ring.turned(120.0 * f64::from(i)))
    })
}

/// The scene.
pub fn scene() -> ImageResult<SceneFiles> {
    let mut obj = Obj::new(4);
    let (lo, hi) = (v(-3.5, 0.0, -2.5), v(3.5, 3.2, 2.5));
    let [floor, ceiling, left, right, back, front] = room(lo, hi);
    obj.add_textured("Floor", "Floor", floor.uv_times(0.5, 0.5));
    obj.add("Ceiling", "Ceiling", ceiling);
    for (name, wall) in [("LeftWall", left), ("RightWall", right), ("BackWall", back), ("FrontWall", front)] {
        obj.add(name, "Wall", wall);
    }
    let lying = DAffine3::from_rotation_x(-FRAC_PI_2);
    let skirting = frame([7.0, 5.0], &[[-0.025, -0.01], [-0.025, 0.10], [-0.015, 0.115], [0.01, 0.12]]);
    let cornice = frame([7.0, 5.0], &[[0.01, -0.14], [-0.03, -0.13], [-0.1, -0.04], [-0.11, 0.01]]);
    let inward = |mesh: Mesh| mesh.transform(lying);
    obj.add("Skirting", "Cornice", inward(skirting));
    obj.add("Cornice", "Cornice", inward(cornice).at(0.0, 3.2, 0.0));
    for (i, x) in [-2.1, 0.0, 2.1].into_iter().enumerate() {
        let panel = quad(v(x - 0.6, 3.19, 0.05), v(1.2, 0.0, 0.0), v(0.0, 0.0, 0.7), [1.0, 1.0]);
        obj.add(&format!("Panel{i}"), "Light", panel);
    }
    // Lamps of the spots: open tubes around each light's position.
    for (i, x) in [-2.0, 0.0, 2.0].into_iter().enumerate() {
        let tube = lathe(&[vec![DVec2::new(0.04, -0.02), DVec2::new(0.04, 0.1), DVec2::new(0.02, 0.12)]], 16);
        let aim = DAffine3::from_rotation_x(-(1.4f64 / 1.45).atan());
        obj.add(&format!("Spot{i}"), "LampBody", tube.transform(aim).at(x, 3.02, -1.1));
    }

    let on_back = |x: f64, y: f64| DAffine3::from_translation(v(x, y, -2.5));
    hang(&mut obj, "Dusk", "Dusk", true, [1.3, 0.9], on_back(-2.0, 1.55));
    hang(&mut obj, "Circles", "Circles", false, [1.4, 1.05], on_back(0.0, 1.6));
    hang(&mut obj, "Waves", "Waves", true, [1.2, 1.0], on_back(2.0, 1.55));
    let on_left =
        |z: f64| DAffine3::from_translation(v(-3.5, 1.55, z)) * DAffine3::from_rotation_y(FRAC_PI_2);
    hang(&mut obj, "Grid", "Grid", false, [1.1, 0.9], on_left(-1.0));
    hang(&mut obj, "Set", "Set", true, [1.2, 0.9], on_left(0.8));
    let on_right = DAffine3::from_translation(v(3.5, 1.45, -0.2)) * DAffine3::from_rotation_y(-FRAC_PI_2);
    hang(&mut obj, "Mirror", "Mirror", true, [2.0, 1.7], on_right);
    let on_front = DAffine3::from_translation(v(0.8, 1.55, 2.5)) * DAffine3::from_rotation_y(PI);
    hang(&mut obj, "SecondDusk", "Dusk", false, [1.6, 1.1], on_front);

    obj.add("Plinth", "Plinth", rounded_box(v(-0.22, -0.001, -0.52), v(0.22, 0.95, -0.08), 0.01, 1));
    obj.add("Rings", "Copper", rings().at(0.0, 1.14, -0.3));
    let cushion = rounded_box(v(-0.7, 0.33, -0.22), v(0.7, 0.45, 0.22), 0.04, 3).uv_times(4.0, 4.0);
    obj.add_textured("Bench", "Leather", cushion.turned(8.0).at(1.7, 0.0, 0.7));
    let mut legs = Mesh::default();
    for x in [-0.6, 0.6] {
        for z in [-0.16, 0.16] {
            let leg = lathe(&[vec![DVec2::new(0.014, -0.001), DVec2::new(0.014, 0.36)]], 16);
            legs = legs.with(leg.at(x, 0.0, z));
        }
    }
    obj.add("BenchLegs", "Steel", legs.turned(8.0).at(1.7, 0.0, 0.7));
    plant(&mut obj, v(-2.95, 0.0, -1.95));

    let tufted = normal_map(64, 0.05, |u, v| {
        let (x, y) = ((u * TAU).sin() * (v * TAU).sin(), turbulence(u, v, [8, 8], 3, 12));
        x.abs().sqrt() + 0.25 * y
    });
    let gilt =
        picture(64, 64, |u, v| mix([0.98, 0.86, 0.58], [0.86, 0.68, 0.36], turbulence(u, v, [8, 8], 3, 99)));
    let textures = vec![
        ("marble.jpg", jpeg(&picture(512, 512, marble_tiles(1)), 80)?),
        ("dusk.jpg", jpeg(&picture(256, 176, dusk), 84)?),
        ("circles.jpg", jpeg(&picture(256, 192, circles), 84)?),
        ("grid.jpg", jpeg(&picture(256, 208, grid), 84)?),
        ("waves.jpg", jpeg(&picture(256, 212, waves), 84)?),
        ("set.jpg", jpeg(&picture(256, 192, julia), 84)?),
        ("gilt.jpg", jpeg(&gilt, 80)?),
        ("tufted.png", png(&tufted)?),
        ("leaf.png", png_alpha(&leaf())?),
    ];
    Ok(obj.finish("gallery", MTL, TOML, textures))
}
