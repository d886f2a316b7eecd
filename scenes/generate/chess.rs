//! `chess`: pieces of every finish on a lacquered board under a studio sky.

use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3};
use image::ImageResult;

use super::implicit::{blend, capsule, ellipsoid, surface};
use super::obj::{Mesh, Obj, SceneFiles};
use super::shapes::{cuboid, curve, lathe, quad, rounded_box, sphere, v};
use super::textures::{Color, hdr, jpeg, mix, picture, smoothstep, wood};

const MTL: &str = r"
newmtl Table
Kd 0.10 0.085 0.075
newmtl BoardRim
map_Kd wood.jpg
Kd 0.35 0.25 0.2
Ks 0.04 0.04 0.04
Ns 800
newmtl BoardLight
map_Kd wood.jpg
Ks 0.04 0.04 0.04
Ns 800
newmtl BoardDark
map_Kd wood.jpg
Kd 0.16 0.10 0.08
Ks 0.04 0.04 0.04
Ns 800
newmtl Chrome
Kd 0 0 0
Ks 0.55 0.55 0.55
illum 3
newmtl Gold
Kd 0 0 0
Ks 0.95 0.72 0.35
illum 3
newmtl Copper
Kd 0 0 0
Ks 0.93 0.62 0.52
Ns 40
newmtl Glass
Kd 0 0 0
Ks 1 1 1
Ni 1.5
illum 7
newmtl GreenGlass
Kd 0 0 0
Ks 1 1 1
Ni 1.5
Tf 0.6 0.9 0.7
illum 7
newmtl FrostedGlass
Kd 0 0 0
Ks 1 1 1
Ni 1.5
illum 7
newmtl White
Kd 0.75 0.72 0.64
Ks 0.04 0.04 0.04
Ns 800
newmtl Black
Kd 0.02 0.02 0.022
Ks 0.04 0.04 0.04
Ns 800
newmtl Brushed
Kd 0.05 0.05 0.05
Ks 0.6 0.6 0.62
Ns 60
newmtl Bronze
Kd 0.12 0.06 0.025
Ks 0.6 0.42 0.22
Ns 40
newmtl Mirror
Kd 0 0 0
Ks 0.96 0.96 0.96
illum 3
newmtl Light
Kd 0.5 0.5 0.5
Ke 5 4.9 4.7
";

const TOML: &str = r#"
format = 1
title = "Chess pieces of every finish"
attribution = "the foveal project, CC0"

[geometry]
files = ["chess.obj"]
metres_per_unit = 0.01
up = "+y"

[[camera]]
name = "main"
eye = [24.0, 25.0, 40.0]
target = [-0.5, 2.6, 0.5]
up = [0.0, 1.0, 0.0]
fov_y = 30.0

[[camera]]
name = "white"
eye = [9.0, 9.5, 27.0]
target = [0.5, 3.4, 7.0]
up = [0.0, 1.0, 0.0]
fov_y = 33.0

[[camera]]
name = "black"
eye = [-15.0, 9.0, 8.0]
target = [-1.0, 3.2, -9.0]
up = [0.0, 1.0, 0.0]
fov_y = 36.0

[[path]]
name = "tour"
keys = [
  { t = 0.0, eye = [24.0, 25.0, 40.0], target = [-0.5, 2.6, 0.5] },
  { t = 2.0, eye = [14.0, 17.0, 34.0], target = [0.0, 3.0, 3.0] },
  { t = 4.0, eye = [4.0, 12.0, 30.0], target = [0.0, 3.0, 3.0] },
  { t = 6.0, eye = [-14.0, 12.0, 26.0], target = [-1.0, 3.0, 0.0] },
  { t = 8.0, eye = [-27.0, 14.0, 12.0], target = [-1.0, 3.0, -2.0] },
  { t = 10.0, eye = [-14.0, 24.0, 34.0], target = [0.0, 2.8, 0.0] },
  { t = 12.0, eye = [24.0, 25.0, 40.0], target = [-0.5, 2.6, 0.5] },
]

[environment]
map = "studio.hdr"
scale = 1.0
rotate_up = 0.0

[material."BoardRim"]
model = "plastic"
albedo = [0.35, 0.25, 0.2]
map_albedo = "wood.jpg"
ior = 1.5
alpha = 0.03

[material."BoardLight"]
model = "plastic"
map_albedo = "wood.jpg"
ior = 1.5
alpha = 0.03

[material."BoardDark"]
model = "plastic"
albedo = [0.16, 0.10, 0.08]
map_albedo = "wood.jpg"
ior = 1.5
alpha = 0.03

[material."Chrome"]      # chromium
model = "conductor"
eta = [3.1071, 3.1812, 2.323]
k = [3.3314, 3.3291, 3.135]
alpha = 0.0

[material."Gold"]
model = "conductor"
eta = [0.14282, 0.37414, 1.43944]
k = [3.97472, 2.38066, 1.59981]
alpha = 0.03

[material."Copper"]
model = "conductor"
eta = [0.20004, 0.92209, 1.09988]
k = [3.91205, 2.45186, 2.14219]
alpha = 0.25
distribution = "beckmann"

[material."Glass"]       # transmittance per centimetre
model = "dielectric"
ior = 1.5
transmittance = [0.98, 0.995, 0.99]

[material."GreenGlass"]
model = "dielectric"
ior = 1.5
transmittance = [0.45, 0.82, 0.6]

[material."FrostedGlass"]
model = "dielectric"
ior = 1.5
transmittance = [0.97, 0.98, 1.0]
alpha = 0.15

[material."White"]
model = "plastic"
albedo = [0.75, 0.72, 0.64]
ior = 1.5
alpha = 0.05

[material."Black"]
model = "plastic"
albedo = [0.02, 0.02, 0.022]
ior = 1.5
alpha = 0.05

[material."Brushed"]     # turned steel: grooves run around
model = "ward"
diffuse = [0.05, 0.05, 0.05]
specular = [0.6, 0.6, 0.62]
alpha_x = 0.06
alpha_y = 0.3

[material."Bronze"]
model = "cook_torrance"
diffuse = [0.12, 0.06, 0.025]
specular = [0.6, 0.42, 0.22]
alpha = 0.2
distribution = "beckmann"

[material."Mirror"]
model = "mirror"
specular = [0.96, 0.96, 0.96]

[display]
exposure = 1.1
"#;

/// The foot that all pieces share, up to the waist at `height`; radii times `scale`.
fn foot(scale: f64, height: f64) -> Vec<Vec<DVec2>> {
    let s = |points: &[[f64; 2]]| points.iter().map(|p| [p[0] * scale, p[1]]).collect::<Vec<_>>();
    vec![
        curve(&s(&[[0.0, 0.0], [1.5, 0.0], [1.62, 0.08], [1.66, 0.25], [1.6, 0.48], [1.42, 0.6]]), 1),
        curve(
            &s(&[
                [1.42, 0.6],
                [1.25, 0.66],
                [1.2, 0.78],
                [1.1, 0.95],
                [0.82, 1.35],
                [0.62, 2.0],
                [0.52, height],
            ]),
            2,
        ),
    ]
}

/// Strokes after a foot, moved up by `base`.
fn above(mut strokes: Vec<Vec<DVec2>>, base: f64, rest: &[&[[f64; 2]]]) -> Mesh {
    for points in rest {
        strokes.push(curve(points, 2).into_iter().map(|p| p + DVec2::new(0.0, base)).collect());
    }
    lathe(&strokes, 20)
}

fn pawn() -> Mesh {
    let ball: Vec<DVec2> = (0..=8)
        .map(|i| {
            let angle = (-0.32 + 0.82 * f64::from(i) / 8.0) * PI;
            DVec2::new(if i == 8 { 0.0 } else { 0.9 * angle.cos() }, 3.62 + 0.9 * angle.sin())
        })
        .collect();
    let mut strokes = foot(0.86, 2.5);
    strokes.push(curve(&[[0.4472, 2.5], [0.85, 2.58], [0.9, 2.68], [0.82, 2.78], ball[0].to_array()], 2));
    strokes.push(ball);
    lathe(&strokes, 20)
}

fn rook() -> Mesh {
    let mut body = above(
        foot(1.0, 3.0),
        3.0,
        &[
            &[[0.52, 0.0], [0.75, 0.12], [1.05, 0.35], [1.1, 0.5]],
            &[[1.1, 0.5], [1.12, 0.9], [1.15, 1.35]],
            &[[1.15, 1.35], [1.1, 1.36], [0.8, 1.36]],
            &[[0.8, 1.36], [0.78, 1.1], [0.7, 1.0], [0.0, 0.98]],
        ],
    );
    // Merlons sunk into the rim.
    for i in 0..6 {
        let angle = f64::from(i) * 60.0;
        body = body.with(rounded_box(v(0.82, 4.3, -0.28), v(1.13, 4.72, 0.28), 0.03, 1).turned(angle));
    }
    body
}

fn bishop() -> Mesh {
    above(
        foot(0.95, 3.0),
        3.0,
        &[
            &[[0.494, 0.0], [0.9, 0.08], [0.95, 0.18], [0.88, 0.28], [0.55, 0.36]],
            &[[0.55, 0.36], [0.78, 0.7], [0.82, 1.1], [0.62, 1.6], [0.28, 2.02], [0.2, 2.12]],
            &[[0.2, 2.12], [0.27, 2.2], [0.3, 2.32], [0.22, 2.48], [0.0, 2.55]],
        ],
    )
}

fn queen() -> Mesh {
    above(
        foot(1.05, 4.0),
        4.0,
        &[
            &[[0.546, 0.0], [0.98, 0.08], [1.05, 0.2], [0.96, 0.32], [0.6, 0.42]],
            &[[0.6, 0.42], [0.62, 0.7], [0.82, 1.3], [1.1, 1.75]],
            &[[1.1, 1.75], [1.08, 1.82], [0.95, 1.8]],
            &[[0.95, 1.8], [0.7, 1.86], [0.4, 2.05], [0.26, 2.12]],
            &[[0.26, 2.12], [0.34, 2.25], [0.34, 2.4], [0.22, 2.56], [0.0, 2.62]],
        ],
    )
}

fn king() -> Mesh {
    let body = above(
        foot(1.08, 4.3),
        4.3,
        &[
            &[[0.5616, 0.0], [1.0, 0.08], [1.08, 0.2], [1.0, 0.34], [0.64, 0.44]],
            &[[0.64, 0.44], [0.66, 0.8], [0.85, 1.5], [1.0, 1.9]],
            &[[1.0, 1.9], [0.96, 2.0], [0.6, 2.2], [0.3, 2.32], [0.0, 2.36]],
        ],
    );
    body.with(rounded_box(v(-0.14, 6.6, -0.13), v(0.14, 7.65, 0.13), 0.04, 1)).with(rounded_box(
        v(-0.4, 7.08, -0.12),
        v(0.4, 7.35, 0.12),
        0.04,
        1,
    ))
}

/// Distance to the horse's head, looking along +x.
fn horse(p: DVec3) -> f64 {
    let q = DVec3::new(p.x, p.y, p.z.abs());
    let neck = capsule(q, v(-0.1, 2.0, 0.0), v(-0.3, 3.3, 0.0), 0.82, 0.62);
    let crest = capsule(q, v(-0.6, 2.4, 0.0), v(-0.35, 4.0, 0.0), 0.36, 0.34);
    let head = capsule(q, v(-0.15, 3.85, 0.0), v(0.95, 3.25, 0.0), 0.52, 0.3);
    let cheek = ellipsoid(q, v(0.05, 3.6, 0.3), v(0.4, 0.36, 0.2));
    let nose = ellipsoid(q, v(1.05, 3.12, 0.0), v(0.28, 0.26, 0.3));
    let ear = capsule(q, v(-0.3, 4.2, 0.17), v(-0.36, 4.62, 0.24), 0.16, 0.05);
    let chest = ellipsoid(q, v(0.1, 2.1, 0.0), v(0.8, 0.5, 0.75));
    let upper = blend(blend(neck, crest, 0.3), blend(blend(head, cheek, 0.25), nose, 0.2), 0.4);
    blend(blend(upper, ear, 0.12), chest, 0.4)
}

fn knight() -> Mesh {
    let mut strokes = foot(0.97, 1.6);
    strokes.truncate(1);
    strokes.push(curve(
        &[
            [1.3774, 0.6],
            [1.2, 0.66],
            [1.15, 0.8],
            [1.05, 1.0],
            [0.95, 1.4],
            [0.9, 1.7],
            [0.5, 1.95],
            [0.0, 2.0],
        ],
        2,
    ));
    let head = surface(v(-1.2, 0.9, -1.0), v(1.55, 4.9, 1.0), 20, &horse);
    lathe(&strokes, 20).with(head)
}

/// Radiance of the studio: grey, a warm and a cool soft box, a bright strip overhead.
fn studio(u: f64, v: f64) -> Color {
    // Column as in the sidecar's convention: u = atan2(x, −z) / 2π.
    let (height, angle) = ((v - 0.5) * PI, u * TAU);
    let base = mix([0.10, 0.11, 0.13], [0.50, 0.54, 0.62], smoothstep(-0.1, 1.3, height));
    let soft_box = |center: f64, width: f64, low: f64, high: f64| {
        let mut d = (angle - center).abs();
        d = d.min(TAU - d);
        let side = 1.0 - smoothstep(width - 0.06, width + 0.06, d);
        side * smoothstep(low - 0.05, low + 0.05, height)
            * (1.0 - smoothstep(high - 0.05, high + 0.05, height))
    };
    let key = soft_box(0.72 * TAU, 0.45, 0.25, 1.0);
    let fill = soft_box(0.22 * TAU, 0.35, 0.1, 0.8);
    let back = soft_box(0.0, 0.8, 0.5, 0.75);
    [0, 1, 2]
        .map(|i| base[i] + key * [9.0, 7.8, 6.2][i] + fill * [2.2, 2.9, 3.8][i] + back * [3.0, 3.0, 3.0][i])
}

/// The scene.
pub fn scene() -> ImageResult<SceneFiles> {
    let mut obj = Obj::new(3);
    obj.add(
        "Table",
        "Table",
        quad(v(-200.0, -2.0, 200.0), v(400.0, 0.0, 0.0), v(0.0, 0.0, -400.0), [1.0, 1.0]),
    );
    // The rim and the squares' bed; the squares lie 0.5 mm above it, each with its own wood.
    obj.add_textured(
        "BoardRim",
        "BoardRim",
        rounded_box(v(-22.5, -2.02, -22.5), v(22.5, -0.05, 22.5), 0.25, 2).uv_times(0.03, 0.06),
    );
    let mut squares = [Mesh::default(), Mesh::default()];
    for row in 0..8 {
        for column in 0..8 {
            let (x, z) = (-20.0 + 5.0 * f64::from(column), 20.0 - 5.0 * f64::from(row));
            let mut square = quad(v(x, 0.0, z), v(5.0, 0.0, 0.0), v(0.0, 0.0, -5.0), [0.2, 0.25]);
            let shift = DVec2::new(f64::from(column * 37 % 11) / 11.0, f64::from(row * 29 % 13) / 13.0);
            for corner in square.faces.iter_mut().flatten() {
                corner.uv += shift + DVec2::new(0.13 * f64::from(row), 0.19 * f64::from(column));
            }
            let index = usize::from((row + column) % 2 == 0);
            squares[index] = std::mem::take(&mut squares[index]).with(square);
        }
    }
    // The squares' common edge, down into the bed.
    let bed = cuboid(v(-20.0, -0.06, -20.0), v(20.0, 0.0, 20.0));
    let sides = Mesh { faces: bed.faces.into_iter().filter(|f| f[0].normal.y == 0.0).collect() };
    obj.add_textured("BoardEdge", "BoardRim", sides.uv_times(0.03, 0.06));
    let [light, dark] = squares;
    obj.add_textured("LightSquares", "BoardLight", light);
    obj.add_textured("DarkSquares", "BoardDark", dark);

    // File a–h, rank 1–8 from the viewer's side; pieces hover a fiftieth of a millimetre.
    type Make = fn() -> Mesh;
    let pieces: [(&str, &str, char, u32, Make, f64); 16] = [
        ("WhiteKing", "Gold", 'e', 2, king, 20.0),
        ("WhiteQueen", "Glass", 'd', 3, queen, 0.0),
        ("WhiteRook", "Brushed", 'f', 1, rook, 10.0),
        ("WhiteBishop", "Copper", 'c', 2, bishop, 0.0),
        ("WhiteKnight", "Chrome", 'f', 3, knight, 120.0),
        ("WhitePawnB", "White", 'b', 3, pawn, 0.0),
        ("WhitePawnE", "White", 'e', 4, pawn, 0.0),
        ("WhitePawnG", "FrostedGlass", 'g', 2, pawn, 0.0),
        ("BlackKing", "Mirror", 'e', 7, king, -15.0),
        ("BlackQueen", "Bronze", 'c', 6, queen, 0.0),
        ("BlackRook", "Black", 'd', 8, rook, 0.0),
        ("BlackBishop", "GreenGlass", 'f', 5, bishop, 0.0),
        ("BlackKnight", "Black", 'b', 5, knight, -50.0),
        ("BlackPawnA", "Black", 'a', 6, pawn, 0.0),
        ("BlackPawnD", "Black", 'd', 5, pawn, 0.0),
        ("BlackPawnF", "Chrome", 'f', 7, pawn, 0.0),
    ];
    for (name, material, file, rank, make, turn) in pieces {
        let x = -17.5 + 5.0 * f64::from(file as u32 - 'a' as u32);
        let z = 17.5 - 5.0 * f64::from(rank - 1);
        let piece = make().turned(turn).at(x, 0.002, z);
        // Grooves need a direction.
        if material == "Brushed" {
            obj.add_textured(name, material, piece);
        } else {
            obj.add(name, material, piece);
        }
    }
    obj.add("CapturedPawn", "Gold", pawn().transform(lying()).at(27.5, -0.58, 9.0));
    obj.add("Marble", "GreenGlass", sphere(v(27.0, -1.0, 1.0), 0.98, 28, 14));
    obj.add(
        "SoftBox",
        "Light",
        quad(v(-30.0, 70.0, -45.0), v(60.0, 0.0, 0.0), v(0.0, 0.0, 40.0), [1.0, 1.0]),
    );

    let wood = picture(512, 256, wood([0.62, 0.42, 0.22], [0.90, 0.74, 0.50], 61));
    let textures = vec![("wood.jpg", jpeg(&wood, 82)?), ("studio.hdr", hdr(128, 64, studio))];
    Ok(obj.finish("chess", MTL, TOML, textures))
}

/// A pawn fallen on the table, on its foot's edge and its head.
fn lying() -> glam::DAffine3 {
    glam::DAffine3::from_rotation_y(0.6) * glam::DAffine3::from_rotation_z(PI / 2.0 + 0.13)
}
