//! A salon for the measurement of simplified radiosity meshes: papered walls, parquet and a rug, whose patterns hide
//! shades of light, beside plaster, which shows each of them (the third test scene of Dumont et al. 2003, figure 18).

use image::ImageResult;

use super::obj::{Mesh, Obj, SceneFiles};
use super::shapes::{cuboid, quad, room, v};
use super::textures::{Color, hash, jpeg, mix, noise, picture, planks, smoothstep, turbulence, wood};

const MTL: &str = r"
newmtl Plaster
Kd 0.78 0.76 0.72
newmtl Papered
map_Kd paper.jpg
newmtl Parquet
map_Kd parquet.jpg
newmtl Rug
map_Kd rug.jpg
newmtl Books
map_Kd books.jpg
newmtl Wood
map_Kd wood.jpg
newmtl Cloth
Kd 0.20 0.28 0.34
newmtl Black
Kd 0.03 0.03 0.03
newmtl Lamp
Kd 0.3 0.3 0.3
Ke 90 84 74
newmtl Upward
Kd 0.3 0.3 0.3
Ke 60 54 44
";

const TOML: &str = r#"
format = 1
title = "Salon"
attribution = "the foveal project, CC0"

[geometry]
files = ["salon.obj"]
metres_per_unit = 1.0
up = "+y"
CAMERAS
[display]
exposure = 5.0
"#;

/// Eye and target of each view.
const VIEWS: [[[f64; 3]; 2]; 10] = [
    [[2.6, 1.7, 2.2], [-1.5, 1.1, -1.5]],
    [[0.6, 1.6, 2.2], [-1.2, 1.2, -2.5]],
    [[-0.6, 1.6, 2.1], [1.6, 1.2, -2.5]],
    [[-2.5, 1.7, 2.1], [1.5, 1.0, -1.2]],
    [[-2.4, 1.5, 0.4], [2.8, 1.7, 0.2]],
    [[-2.4, 1.6, -1.9], [1.8, 1.2, 2.3]],
    [[0.2, 1.6, -1.9], [-1.0, 1.1, 2.4]],
    [[2.4, 1.6, -1.2], [-2.2, 0.9, 1.6]],
    [[2.4, 1.5, 0.6], [-2.9, 1.6, 0.2]],
    [[0.8, 1.3, 0.9], [-0.8, 2.7, -2.0]],
];

/// Dark damask: lobed figures, two of them shifted against each other, over a weave.
fn paper(u: f64, w: f64) -> Color {
    let figure = |x: f64, y: f64| {
        let (dx, dy) = (x - x.floor() - 0.5, y - y.floor() - 0.5);
        let angle = dy.atan2(dx);
        let radius = (dx * dx + dy * dy).sqrt() / (0.30 + 0.10 * (5.0 * angle).cos());
        smoothstep(1.05, 0.95, radius) - 0.7 * smoothstep(0.55, 0.45, radius)
    };
    let ink = figure(4.0 * u, 4.0 * w).max(figure(4.0 * u + 0.5, 4.0 * w + 0.5));
    let weave = 0.75 + 0.5 * noise(u * 96.0, w * 96.0, [96, 96], 5);
    mix([0.20, 0.10, 0.09], [0.62, 0.50, 0.30], ink).map(|c| c * weave)
}

/// Medallions in a border.
fn rug(u: f64, w: f64) -> Color {
    let edge = u.min(1.0 - u).min(w.min(1.0 - w));
    let knot = 0.7 + 0.6 * hash((u * 180.0) as i64, (w * 128.0) as i64, 3);
    let (x, y) = ((u * 14.0) as i64, (w * 10.0) as i64);
    let lozenge = ((u * 14.0).fract() - 0.5).abs() + ((w * 10.0).fract() - 0.5).abs();
    let color = match () {
        () if edge < 0.05 => [0.16, 0.07, 0.08],
        () if edge < 0.12 && ((u + w) * 40.0).fract() < 0.5 => [0.70, 0.55, 0.32],
        () if edge < 0.12 => [0.18, 0.18, 0.30],
        () if lozenge < 0.25 => [0.72, 0.58, 0.36],
        () if lozenge < 0.42 && (x + y) % 2 == 0 => [0.14, 0.16, 0.28],
        () => [0.55, 0.10, 0.09],
    };
    color.map(|c| c * knot)
}

/// Backs of books on shelves.
fn books(u: f64, w: f64) -> Color {
    let (shelf, up) = ((w * 5.0) as i64, (w * 5.0).fract());
    let place = u * 24.0;
    let (book, across) = (place as i64, place.fract());
    let r = |k: i64| hash(book + 31 * shelf, k, 11);
    if up < 0.07 || up > 0.72 + 0.2 * r(0) {
        return [0.10, 0.06, 0.04];
    }
    let inks =
        [[0.45, 0.10, 0.08], [0.12, 0.20, 0.30], [0.15, 0.28, 0.16], [0.55, 0.45, 0.28], [0.2, 0.12, 0.1]];
    let round = 0.4 + 0.6 * (across * std::f64::consts::PI).sin();
    let band = if (0.55..0.6).contains(&up) || (0.15..0.18).contains(&up) { 1.7 } else { 1.0 };
    inks[(r(1) * 5.0) as usize]
        .map(|c: f64| (c * round * band * (0.8 + 0.4 * turbulence(u, w, [32, 32], 2, 4))).min(1.0))
}

/// A table: a top on four legs.
fn table(size: [f64; 3], leg: f64) -> Mesh {
    let [w, h, d] = [0.5 * size[0], size[1], 0.5 * size[2]];
    let top = cuboid(v(-w, h - 0.04, -d), v(w, h, d));
    [-1.0, 1.0].into_iter().flat_map(|x| [-1.0, 1.0].map(|z| (x, z))).fold(top, |mesh, (x, z)| {
        let (x, z) = (x * (w - leg), z * (d - leg));
        mesh.with(cuboid(v(x - 0.5 * leg, -0.001, z - 0.5 * leg), v(x + 0.5 * leg, h - 0.04, z + 0.5 * leg)))
    })
}

/// A lamp that shines down through the mouth of a black box, which casts the edge of its light on the walls.
fn spot(obj: &mut Obj, name: &str, x: f64, z: f64) {
    let (half, top, mouth) = (0.07, 2.96, 2.78);
    obj.add(
        name,
        "Lamp",
        quad(v(x - half, top, z - half), v(2.0 * half, 0.0, 0.0), v(0.0, 0.0, 2.0 * half), [1.0, 1.0]),
    );
    let shade = [
        quad(v(x - 0.1, mouth, z + 0.1), v(0.0, 0.0, -0.2), v(0.0, 0.2, 0.0), [1.0, 1.0]),
        quad(v(x + 0.1, mouth, z - 0.1), v(0.0, 0.0, 0.2), v(0.0, 0.2, 0.0), [1.0, 1.0]),
        quad(v(x - 0.1, mouth, z - 0.1), v(0.2, 0.0, 0.0), v(0.0, 0.2, 0.0), [1.0, 1.0]),
        quad(v(x + 0.1, mouth, z + 0.1), v(-0.2, 0.0, 0.0), v(0.0, 0.2, 0.0), [1.0, 1.0]),
    ];
    obj.add(&format!("{name}Shade"), "Black", shade.into_iter().fold(Mesh::default(), Mesh::with));
}

/// The scene.
pub fn scene() -> ImageResult<SceneFiles> {
    let mut obj = Obj::new(4);
    let [floor, ceiling, left, right, back, front] = room(v(-3.0, 0.0, -2.5), v(3.0, 3.0, 2.5));
    obj.add_textured("Floor", "Parquet", floor.uv_times(0.5, 0.5));
    obj.add("Ceiling", "Plaster", ceiling);
    obj.add_textured("LeftWall", "Papered", left);
    obj.add_textured("FrontWall", "Papered", front);
    obj.add("RightWall", "Plaster", right);
    obj.add("BackWall", "Plaster", back);
    let rug_at = quad(v(-1.6, 0.01, 1.1), v(3.0, 0.0, 0.0), v(0.0, 0.0, -2.1), [1.0, 1.0]);
    obj.add_textured("Rug", "Rug", rug_at);
    obj.add_textured("Shelves", "Wood", cuboid(v(-2.3, -0.001, -2.499), v(-0.7, 2.1, -2.16)));
    let backs = quad(v(-2.26, 0.04, -2.155), v(1.52, 0.0, 0.0), v(0.0, 2.02, 0.0), [1.0, 1.0]);
    obj.add_textured("Books", "Books", backs);
    obj.add_textured("Table", "Wood", table([1.3, 0.74, 0.8], 0.08).turned(12.0).at(-0.2, 0.012, 0.1));
    for (i, (x, z, turn)) in
        [(-0.3, 1.05, 8.0), (0.75, 0.0, 95.0), (-1.2, 0.3, -80.0)].into_iter().enumerate()
    {
        let back = cuboid(v(-0.22, 0.45, 0.17), v(0.22, 0.95, 0.21));
        let chair = table([0.44, 0.46, 0.42], 0.05).with(back).turned(turn).at(x, 0.012, z);
        obj.add_textured(&format!("Chair{i}"), "Wood", chair);
    }
    let sofa =
        cuboid(v(1.9, -0.001, -1.9), v(2.9, 0.42, 0.5)).with(cuboid(v(2.65, 0.42, -1.9), v(2.9, 0.85, 0.5)));
    obj.add("Sofa", "Cloth", sofa);
    for (i, (x, z)) in
        [(-2.45, -0.9), (-0.2, 0.15), (1.4, -2.05), (-2.4, 1.5), (2.3, 1.4)].into_iter().enumerate()
    {
        spot(&mut obj, &format!("Spot{i}"), x, z);
    }
    // A standing lamp that lights the ceiling.
    obj.add("Stand", "Black", cuboid(v(2.37, -0.001, -2.13), v(2.43, 1.8, -2.07)));
    obj.add("Bowl", "Upward", quad(v(2.28, 1.9, -1.98), v(0.24, 0.0, 0.0), v(0.0, 0.0, -0.24), [1.0, 1.0]));
    let camera = |(i, [eye, target]): (usize, &[[f64; 3]; 2])| {
        format!(
            "\n[[camera]]\nname = \"view{i}\"\neye = {eye:?}\ntarget = {target:?}\nup = [0.0, 1.0, 0.0]\nfov_y = 55.0\n"
        )
    };
    let cameras: String = VIEWS.iter().enumerate().map(camera).collect();
    let textures = vec![
        ("paper.jpg", jpeg(&picture(512, 512, paper), 88)?),
        ("parquet.jpg", jpeg(&picture(512, 512, planks([0.24, 0.12, 0.06], [0.62, 0.42, 0.24], 10, 2)), 88)?),
        ("rug.jpg", jpeg(&picture(512, 360, rug), 88)?),
        ("books.jpg", jpeg(&picture(512, 512, books), 88)?),
        ("wood.jpg", jpeg(&picture(256, 256, wood([0.20, 0.10, 0.05], [0.50, 0.32, 0.18], 8)), 86)?),
    ];
    Ok(obj.finish("salon", MTL, &TOML.replace("CAMERAS", &cameras), textures))
}
