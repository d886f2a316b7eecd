//! Rooms of one kind of light each, for measurements of light: what a way of sampling gets wrong shows in one of them.

use glam::DVec2;
use image::ImageResult;

use super::obj::{Mesh, Obj, SceneFiles};
use super::shapes::{cuboid, lathe, quad, quad_with_hole, room, sphere, straight, v};
use super::textures::{picture, png, turbulence};

const MTL: &str = r"
newmtl Wall
Kd 0.74 0.71 0.66
newmtl Floor
Kd 0.46 0.38 0.30
newmtl Red
Kd 0.60 0.12 0.08
newmtl Blue
Kd 0.14 0.25 0.52
newmtl Cloth
Kd 0.66 0.60 0.48
newmtl Metal
Kd 0.30 0.30 0.32
newmtl Mirror
Kd 0 0 0
Ks 0.92 0.93 0.92
illum 3
newmtl Glass
Kd 0 0 0
Ks 1 1 1
Ni 1.5
illum 7
newmtl Pane
Kd 0 0 0
Ni 1.5
d 0.1
illum 4
newmtl Lamp
Kd 0.5 0.5 0.5
Ke 18 16.5 14
newmtl Bulb
Kd 0.5 0.5 0.5
Ke 160 140 110
";

const CAMERA: &str = r#"
[geometry]
files = ["NAME.obj"]
metres_per_unit = 1.0
up = "+y"

[[camera]]
name = "main"
eye = [1.75, 1.55, 1.8]
target = [-0.5, 0.85, -0.6]
up = [0.0, 1.0, 0.0]
fov_y = 58.0
"#;

/// Half the sides of the floor, and the height.
const SIDE: f64 = 2.0;
const HEIGHT: f64 = 2.6;

/// A scene of these parts: what its sidecar says beside the camera, and what its materials are beside the common ones.
fn finish(obj: Obj, name: &str, title: &str, says: [&str; 2], textures: Vec<(&str, Vec<u8>)>) -> SceneFiles {
    let [light, materials] = says;
    let camera = CAMERA.replace("NAME", name);
    let toml = format!(
        "format = 1\ntitle = \"{title}\"\nattribution = \"the foveal project, CC0\"\n{camera}{light}"
    );
    obj.finish(name, &format!("{MTL}{materials}"), &toml, textures)
}

/// Floor, ceiling and the walls of these directions: −x, +x, −z, +z.
fn walls(obj: &mut Obj, with: [bool; 4]) {
    let (lo, hi) = (v(-SIDE, 0.0, -SIDE), v(SIDE, HEIGHT, SIDE));
    let [floor, ceiling, left, right, back, front] = room(lo, hi);
    obj.add("Floor", "Floor", floor);
    obj.add("Ceiling", "Wall", ceiling);
    let materials = ["Red", "Blue", "Wall", "Wall"];
    for (i, wall) in [left, right, back, front].into_iter().enumerate().filter(|(i, _)| with[*i]) {
        obj.add(["Left", "Right", "Back", "Front"][i], materials[i], wall);
    }
}

/// The wall at −x with an opening, in shares of its length and height.
fn window(obj: &mut Obj, lo: [f64; 2], hi: [f64; 2]) {
    let (along, up) = (v(0.0, 0.0, -2.0 * SIDE), v(0.0, HEIGHT, 0.0));
    let [lo, hi] = [lo, hi].map(DVec2::from_array);
    let wall = quad_with_hole(v(-SIDE, 0.0, SIDE), along, up, lo, hi, [4.0, 2.6]);
    obj.add("WindowWall", "Wall", wall);
}

/// A table and a chest, for light to fall on and beside.
fn furniture(obj: &mut Obj) {
    let mut table = cuboid(v(-0.6, 0.70, -0.35), v(0.6, 0.74, 0.35));
    for (x, z) in [(-0.54, -0.29), (0.54, -0.29), (-0.54, 0.29), (0.54, 0.29)] {
        table = table.with(cuboid(v(x - 0.03, 0.001, z - 0.03), v(x + 0.03, 0.699, z + 0.03)));
    }
    obj.add("Table", "Floor", table.turned(14.0).at(-0.4, 0.0, -0.3));
    obj.add("Chest", "Cloth", cuboid(v(-0.45, 0.001, -0.25), v(0.45, 0.8, 0.25)).at(-0.9, 0.0, -1.7));
    obj.add("Ball", "Wall", sphere(v(-0.3, 0.9, -0.3), 0.15, 24, 12));
}

const SUN: &str = r#"
[environment]
radiance = [1.2, 1.5, 1.9]

[[light]]
kind = "directional"
direction = [0.72, -0.6, -0.3]
irradiance = [40.0, 36.0, 30.0]
"#;

const PANE: &str = r#"
[material."Pane"]
model = "dielectric"
ior = 1.5
transmittance = [0.98, 0.99, 0.98]
thin = true
"#;

/// The sun through panes.
fn panes() -> ImageResult<SceneFiles> {
    let mut obj = Obj::new(4);
    walls(&mut obj, [false, true, true, true]);
    window(&mut obj, [0.3, 0.34], [0.7, 0.84]);
    // Bars of a window of four panes.
    let bars = cuboid(v(-2.03, 0.88, -0.02), v(-1.97, 2.19, 0.02))
        .with(cuboid(v(-2.025, 1.5, -0.8), v(-1.975, 1.54, 0.8)));
    obj.add("Bars", "Cloth", bars);
    let pane = quad(v(-2.0, 0.88, 0.8), v(0.0, 0.0, -1.6), v(0.0, 1.31, 0.0), [1.0, 1.0]);
    obj.add("Pane", "Pane", pane.at(-0.04, 0.0, 0.0));
    furniture(&mut obj);
    Ok(finish(obj, "panes", "The sun through panes", [&format!("{SUN}{PANE}"), ""], vec![]))
}

/// Sun and sky through blinds.
fn blinds() -> ImageResult<SceneFiles> {
    let mut obj = Obj::new(4);
    walls(&mut obj, [false, true, true, true]);
    window(&mut obj, [0.25, 0.3], [0.75, 0.88]);
    let mut slats = Mesh::default();
    for i in 0..26 {
        let y = 0.8 + 0.058 * f64::from(i);
        let across = v(0.042, 0.034, 0.0);
        slats = slats.with(quad(v(-1.99, y, 1.0), v(0.0, 0.0, -2.0), across, [1.0, 1.0]));
    }
    obj.add("Slats", "Wall", slats);
    furniture(&mut obj);
    Ok(finish(obj, "blinds", "Sun and sky through blinds", [SUN, ""], vec![]))
}

/// A bulb in a shade of cloth, open above and below.
fn shade() -> ImageResult<SceneFiles> {
    let mut obj = Obj::new(4);
    walls(&mut obj, [true; 4]);
    furniture(&mut obj);
    let cone = lathe(&[straight(&[[0.2, 0.0], [0.12, 0.26]])], 28).at(0.0, 1.32, 0.0);
    obj.add("Shade", "Cloth", cone.at(-0.75, 0.0, -0.3));
    obj.add("Bulb", "Bulb", sphere(v(-0.75, 1.42, -0.3), 0.035, 12, 6));
    Ok(finish(obj, "shade", "A lamp in its shade", ["", ""], vec![]))
}

/// A lamp that shines at the ceiling alone.
fn uplight() -> ImageResult<SceneFiles> {
    let mut obj = Obj::new(4);
    walls(&mut obj, [true; 4]);
    furniture(&mut obj);
    let bowl = lathe(&[straight(&[[0.02, 0.0], [0.16, 0.1], [0.17, 0.2]])], 24);
    obj.add("Bowl", "Metal", bowl.at(-1.5, 1.7, 0.6));
    let stand = cuboid(v(-1.52, 0.001, 0.58), v(-1.48, 1.699, 0.62));
    obj.add("Stand", "Metal", stand);
    let disk = quad(v(-1.58, 1.82, 0.68), v(0.16, 0.0, 0.0), v(0.0, 0.0, -0.16), [1.0, 1.0]);
    obj.add("Light", "Bulb", disk);
    Ok(finish(obj, "uplight", "A lamp that shines at the ceiling", ["", ""], vec![]))
}

/// A dark room with three small windows under a bright sky.
fn slits() -> ImageResult<SceneFiles> {
    let mut obj = Obj::new(4);
    walls(&mut obj, [false, true, true, true]);
    for i in 0..3 {
        let z = SIDE - 4.0 * f64::from(i) / 3.0;
        let (along, up) = (v(0.0, 0.0, -4.0 / 3.0), v(0.0, HEIGHT, 0.0));
        let [lo, hi] = [[0.44, 0.5], [0.56, 0.68]].map(DVec2::from_array);
        let name = ["WallA", "WallB", "WallC"][i as usize];
        obj.add(name, "Wall", quad_with_hole(v(-SIDE, 0.0, z), along, up, lo, hi, [1.3, 2.6]));
    }
    furniture(&mut obj);
    let sky = "\n[environment]\nradiance = [60.0, 70.0, 85.0]\n";
    Ok(finish(obj, "slits", "Small bright windows", [sky, ""], vec![]))
}

/// Mirrors opposite each other, a lamp with an area between.
fn mirrors() -> ImageResult<SceneFiles> {
    let mut obj = Obj::new(4);
    walls(&mut obj, [true; 4]);
    furniture(&mut obj);
    let left = quad(v(-1.98, 0.5, 0.9), v(0.0, 0.0, -1.9), v(0.0, 1.5, 0.0), [1.0, 1.0]);
    let right = quad(v(1.98, 0.5, -1.0), v(0.0, 0.0, 1.9), v(0.0, 1.5, 0.0), [1.0, 1.0]);
    obj.add("LeftMirror", "Mirror", left);
    obj.add("RightMirror", "Mirror", right);
    let lamp = quad(v(-0.3, 2.58, -0.3), v(0.6, 0.0, 0.0), v(0.0, 0.0, 0.6), [1.0, 1.0]);
    obj.add("Light", "Lamp", lamp);
    Ok(finish(obj, "mirrors", "Mirrors opposite", ["", ""], vec![]))
}

/// Bodies of glass on a diffuse floor under a lamp with an area and one without.
fn bodies() -> ImageResult<SceneFiles> {
    let mut obj = Obj::new(4);
    walls(&mut obj, [true; 4]);
    obj.add("Block", "Cloth", cuboid(v(-0.9, 0.001, -1.1), v(-0.2, 0.5, -0.4)));
    obj.add("GlassBall", "Glass", sphere(v(0.2, 0.301, -0.1), 0.3, 40, 20));
    obj.add("GlassBlock", "Glass", cuboid(v(-0.9, 0.002, 0.0), v(-0.5, 0.6, 0.4)));
    obj.add("GlassOnBlock", "Glass", sphere(v(-0.55, 0.722, -0.75), 0.22, 32, 16));
    let lamp = quad(v(0.2, 2.58, -0.8), v(0.5, 0.0, 0.0), v(0.0, 0.0, 0.5), [1.0, 1.0]);
    obj.add("Light", "Lamp", lamp);
    let light = "\n[[light]]\nkind = \"point\"\nposition = [-0.9, 2.0, 1.0]\nintensity = [5.0, 4.6, 4.0]\n\n\
                 [material.\"Glass\"]\nmodel = \"dielectric\"\nior = 1.5\n";
    Ok(finish(obj, "bodies", "Bodies of glass over a diffuse floor", [light, ""], vec![]))
}

/// Bumps on walls and floor, light from one side.
fn bumps() -> ImageResult<SceneFiles> {
    let mut obj = Obj::new(4);
    let (lo, hi) = (v(-SIDE, 0.0, -SIDE), v(SIDE, HEIGHT, SIDE));
    let [floor, ceiling, left, right, back, front] = room(lo, hi);
    obj.add_textured("Floor", "Tiles", floor);
    obj.add("Ceiling", "Wall", ceiling);
    obj.add_textured("Left", "Plaster", left);
    obj.add("Right", "Blue", right);
    obj.add_textured("Back", "Plaster", back);
    obj.add("Front", "Wall", front);
    furniture(&mut obj);
    let lamp = quad(v(1.0, 2.58, 0.8), v(0.6, 0.0, 0.0), v(0.0, 0.0, 0.6), [1.0, 1.0]);
    obj.add("Light", "Lamp", lamp);
    let tile = |u: f64, v: f64| {
        let edge = |x: f64| (4.0 * (8.0 * x).fract().min(1.0 - (8.0 * x).fract())).min(1.0);
        [edge(u).min(edge(v)); 3]
    };
    let textures = vec![
        ("tiles.png", png(&picture(128, 128, tile))?),
        ("plaster.png", png(&picture(128, 128, |u, v| [turbulence(u, v, [16, 16], 3, 5); 3]))?),
    ];
    let materials = "newmtl Tiles\nKd 0.46 0.38 0.30\nmap_bump tiles.png\nnewmtl Plaster\nKd 0.74 0.71 0.66\nmap_bump plaster.png\n";
    let says = "\n[material.\"Tiles\"]\nmodel = \"lambert\"\nalbedo = [0.46, 0.38, 0.30]\nmap_bump = \"tiles.png\"\n\n\
                [material.\"Plaster\"]\nmodel = \"lambert\"\nalbedo = [0.74, 0.71, 0.66]\nmap_bump = \"plaster.png\"\n";
    Ok(finish(obj, "bumps", "Bumps on walls and floor", [says, materials], textures))
}

/// A floor and a wall of black and white squares.
fn checks() -> ImageResult<SceneFiles> {
    let mut obj = Obj::new(4);
    let (lo, hi) = (v(-SIDE, 0.0, -SIDE), v(SIDE, HEIGHT, SIDE));
    let [floor, ceiling, left, right, back, front] = room(lo, hi);
    obj.add_textured("Floor", "Checks", floor);
    obj.add("Ceiling", "Wall", ceiling);
    obj.add("Left", "Red", left);
    obj.add("Right", "Blue", right);
    obj.add_textured("Back", "Checks", back);
    obj.add("Front", "Wall", front);
    furniture(&mut obj);
    let lamp = quad(v(-0.3, 2.58, -0.3), v(0.6, 0.0, 0.0), v(0.0, 0.0, 0.6), [1.0, 1.0]);
    obj.add("Light", "Lamp", lamp);
    let check = |u: f64, v: f64| {
        [f64::from(u8::from(((4.0 * u) as u32 + (4.0 * v) as u32).is_multiple_of(2))) * 0.85; 3]
    };
    let textures = vec![("checks.png", png(&picture(64, 64, check))?)];
    let materials = "newmtl Checks\nmap_Kd checks.png\n";
    Ok(finish(obj, "checks", "Squares of black and white", ["", materials], textures))
}

/// Sheets without thickness that part a room, bright on one side.
fn sheets() -> ImageResult<SceneFiles> {
    let mut obj = Obj::new(4);
    walls(&mut obj, [true; 4]);
    furniture(&mut obj);
    let screen = quad(v(-1.2, 0.0, -1.0), v(1.3, 0.0, 0.2), v(0.0, 1.7, 0.0), [1.0, 1.0]).with(quad(
        v(0.1, 0.0, -0.8),
        v(0.9, 0.0, -0.5),
        v(0.0, 1.7, 0.0),
        [1.0, 1.0],
    ));
    obj.add("Screen", "Cloth", screen);
    obj.add("Shelf", "Wall", quad(v(-1.99, 1.3, 0.9), v(0.5, 0.0, 0.0), v(0.0, 0.0, -1.2), [1.0, 1.0]));
    let lamp = quad(v(-0.8, 2.4, -1.9), v(0.5, 0.0, 0.0), v(0.0, 0.0, 0.3), [1.0, 1.0]);
    obj.add("Light", "Lamp", lamp);
    Ok(finish(obj, "sheets", "Sheets without thickness", ["", ""], vec![]))
}

/// All of them by name.
pub const KINDS: [(&str, super::Make); 10] = [
    ("panes", panes),
    ("blinds", blinds),
    ("shade", shade),
    ("uplight", uplight),
    ("slits", slits),
    ("mirrors", mirrors),
    ("bodies", bodies),
    ("bumps", bumps),
    ("checks", checks),
    ("sheets", sheets),
];
