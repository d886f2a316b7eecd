//! Surfaces that reflect much light, as lights to look for: a wall in the sun, the inside of a lampshade.
//!
//! Of indirect light most comes from few small surfaces that directions by the cosine rarely find. A map says where they are, or,
//! before there is one, what named lights bring straight: the brightest cells of triangles stand in a tree of their own, as lights
//! do, and a share of all directions goes to points on them. What is found is weighed by the densities of both ways (balance
//! heuristic; Veach 1997, §9.2), so that a map that is wrong costs noise and nothing else.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;
use rayon::prelude::*;

use super::tree::{Bounds, LightTree};
use super::{Lights, Receiver, normal_and_area, uniform_barycentrics};
use crate::geometry::{Accel, Hit, Ray};
use crate::illumination::Irradiance;
use crate::image::luminance;
use crate::scene::{Scene, TriangleIndex};
use crate::transport::bsdf::Bsdf;
use crate::transport::gather::{Gather, Trust};
use crate::transport::interaction::Interaction;
use crate::transport::medium::Media;
use crate::transport::surface::SurfacePoint;

/// About so many cells all surfaces are cut into.
const CELLS: f32 = 8192.0;
/// Cells along an edge of a triangle at most.
const EDGE_MAX: f32 = 64.0;
/// So many times brighter than the mean is bright.
const BRIGHT: f64 = 4.0;
/// No more cells than these are looked for.
const MOST: usize = 4096;
/// Share of all reflected light that bright surfaces must hold to be looked for, and the share of directions at most.
const SHARE: (f32, f32) = (0.05, 0.5);

/// A footprint of which every texture shows its coarsest level.
const COARSEST: f32 = 1e30;

/// What belongs to no cell.
const NONE: u32 = u32::MAX;

/// The brightest cells of a scene's surfaces under a map. Each triangle is cut along its edges into n² cells alike.
#[derive(Clone, Debug, Default)]
pub struct BrightSurfaces {
    cells: Vec<Cell>,
    tree: LightTree,
    /// Per triangle where its cells begin in `places`, if it has bright ones.
    first: Vec<u32>,
    /// Per cell of such a triangle, fronts, then backs, its number among the bright ones.
    places: Vec<u32>,
    share: f32,
}

/// A part of one side of a triangle.
#[derive(Clone, Copy, Debug)]
struct Cell {
    triangle: TriangleIndex,
    back: bool,
    /// Cells along an edge.
    edge: u32,
    number: u32,
    /// Reflected radiance, luminance, and area.
    radiance: f64,
    area: f32,
}

/// A point of such a surface, and the direction to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aim {
    /// Unit direction.
    pub wi: Vec3,
    /// Triangle that it goes to.
    pub triangle: TriangleIndex,
    /// Whether to its back.
    pub back: bool,
}

/// The cell of n² along an edge that a point lies in.
fn cell_at(edge: u32, b1: f32, b2: f32) -> u32 {
    let along = |b: f32| {
        let scaled = b.clamp(0.0, 1.0) * edge as f32;
        let whole = (scaled as u32).min(edge - 1);
        (whole, scaled - whole as f32)
    };
    let ((i, x), (j, y)) = (along(b1), along(b2));
    // Those in which both are large are upside down; there is none beyond the third edge.
    let upper = u32::from(x + y > 1.0 && i + j + 2 <= edge);
    2 * (j * edge + i) + upper
}

/// Barycentric weights of a cell's corners.
fn corners_of(edge: u32, number: u32) -> [[f32; 2]; 3] {
    let (at, upper) = (number / 2, number % 2 == 1);
    let (i, j) = (at % edge, at / edge);
    let corner = |x: u32, y: u32| [(i + x) as f32 / edge as f32, (j + y) as f32 / edge as f32];
    if upper {
        [corner(1, 1), corner(0, 1), corner(1, 0)]
    } else {
        [corner(0, 0), corner(1, 0), corner(0, 1)]
    }
}

/// The numbers of all cells.
fn cells_of(edge: u32) -> impl Iterator<Item = u32> {
    (0..edge * edge).flat_map(move |at| {
        let room = at % edge + at / edge;
        let whole = u32::from(room < edge) + u32::from(room + 2 <= edge);
        (0..whole).map(move |upper| 2 * at + upper)
    })
}

/// Radiance that the side of a triangle reflects at a point under some light, luminance: wide lobes as if they were diffuse.
fn reflected(
    scene: &Scene,
    light: [Vec3; 2],
    triangle: TriangleIndex,
    back: bool,
    [b1, b2]: [f32; 2],
) -> f64 {
    if light == [Vec3::ZERO; 2] {
        return 0.0;
    }
    let along = seen_along(scene, triangle, back);
    let hit = Hit { t: 1.0, triangle, b1, b2 };
    // By the coarsest level of textures: that is in memory whatever walks left out.
    let point = SurfacePoint::at(scene, along, &hit, COARSEST);
    let lobes = wide_lobes(scene, along, &hit);
    let (own, other) = if back { (light[1], light[0]) } else { (light[0], light[1]) };
    let radiance = (point.diffuse_albedo(scene) + lobes) * own + point.passed_albedo(scene) * other;
    f64::from(luminance(radiance * FRAC_1_PI))
}

/// The direction in which who looks straight at a side of a triangle sees it; 0 where it has no area.
fn seen_along(scene: &Scene, triangle: TriangleIndex, back: bool) -> Vec3 {
    let normal = normal_and_area(scene.mesh.corners(triangle)).0;
    if back { normal } else { -normal }
}

fn point_of(scene: &Scene, hit: &Hit) -> Vec3 {
    let [a, b, c] = scene.mesh.corners(hit.triangle);
    a * (1.0 - hit.b1 - hit.b2) + b * hit.b1 + c * hit.b2
}

/// A point for who looks straight at it.
fn looked_at(scene: &Scene, along: Vec3, hit: &Hit) -> Interaction {
    let ray = Ray::new(point_of(scene, hit) - along, along);
    Interaction::at(scene, &ray, hit).with_footprint(COARSEST)
}

/// Albedo of the lobes that paths meet as they meet diffuse surfaces ([`Bsdf::is_wide`]), for who looks straight at them.
fn wide_lobes(scene: &Scene, along: Vec3, hit: &Hit) -> Vec3 {
    let is_rough = scene.material_of(hit.triangle).model.roughness().is_some();
    if !is_rough || along == Vec3::ZERO {
        return Vec3::ZERO;
    }
    let at = looked_at(scene, along, hit);
    let bsdf = Bsdf::at(scene, &at);
    if bsdf.is_wide() { bsdf.view_dependent_albedo(at.wo) } else { Vec3::ZERO }
}

/// How surfaces are cut into cells.
struct Cuts<'a> {
    scene: &'a Scene,
    areas: Vec<f32>,
    all: f64,
}

impl<'a> Cuts<'a> {
    fn new(scene: &'a Scene) -> Self {
        let count = scene.mesh.triangles.len() as u32;
        let areas: Vec<f32> = (0..count).map(|t| normal_and_area(scene.mesh.corners(t)).1).collect();
        let all = areas.iter().map(|a| f64::from(*a)).sum();
        Self { scene, areas, all }
    }

    /// The lit cells of both sides of a triangle, `light` being the irradiance of points on its front and its back.
    fn lit(
        &self,
        triangle: TriangleIndex,
        light: impl Fn([f32; 2]) -> [Vec3; 2],
    ) -> impl Iterator<Item = Cell> {
        let (scene, area) = (self.scene, self.areas[triangle as usize]);
        let material = scene.material_of(triangle);
        let is_wanted = area > 0.0 && material.has_diffuse() && !material.is_emissive();
        let edge = (area * CELLS / self.all as f32).sqrt().clamp(1.0, EDGE_MAX).ceil() as u32;
        let numbers = is_wanted.then(|| cells_of(edge)).into_iter().flatten();
        let cells = numbers.flat_map(move |number| {
            let corners = corners_of(edge, number);
            let middle = std::array::from_fn(|k| corners.iter().map(|c| c[k]).sum::<f32>() / 3.0);
            let light = light(middle);
            [false, true].map(|back| {
                let radiance = reflected(scene, light, triangle, back, middle);
                Cell { triangle, back, edge, number, radiance, area: area / (edge * edge) as f32 }
            })
        });
        cells.filter(|cell| cell.radiance > 0.0 && cell.radiance.is_finite())
    }
}

impl BrightSurfaces {
    /// Finds those that are bright under a map; there may be none.
    pub fn new(scene: &Scene, map: &dyn Irradiance) -> Self {
        let cuts = Cuts::new(scene);
        let under_map = |t, [b1, b2]: [f32; 2]| [false, true].map(|back| map.irradiance(t, b1, b2, back));
        // Not in parallel: many may wait for it in threads that would take each other's work on.
        let triangles = 0..scene.mesh.triangles.len() as u32;
        let cells = triangles.flat_map(|t| cuts.lit(t, move |middle| under_map(t, middle))).collect();
        Self::among(scene, cells)
    }

    /// Finds those that lights with names make bright, exactly: that light has no noise and is known before all else.
    pub fn lit_by_named(scene: &Scene, accel: &Accel, lights: &Lights) -> Self {
        if !lights.has_any_named() {
            return Self::default();
        }
        let (cuts, gather) = (Cuts::new(scene), Gather::new(scene, accel, lights, Trust::Nobody));
        let named = |triangle, [b1, b2]: [f32; 2]| {
            let hit = Hit { t: 1.0, triangle, b1, b2 };
            [false, true].map(|back| {
                let along = seen_along(scene, triangle, back);
                if !lights.named(scene, point_of(scene, &hit)).any(|light| light.wi.dot(along) < 0.0) {
                    return Vec3::ZERO;
                }
                let at = looked_at(scene, along, &hit);
                gather.named(&at, &Bsdf::at(scene, &at), Media::EMPTY)
            })
        };
        let triangles = (0..scene.mesh.triangles.len() as u32).into_par_iter();
        let cells = triangles.flat_map_iter(|t| cuts.lit(t, move |middle| named(t, middle))).collect();
        Self::among(scene, cells)
    }

    /// The bright ones among cells.
    fn among(scene: &Scene, cells: Vec<Cell>) -> Self {
        let count = scene.mesh.triangles.len();
        let power = |cell: &Cell| cell.radiance * f64::from(cell.area);
        let total: f64 = cells.iter().map(power).sum();
        let lit: f64 = cells.iter().map(|cell| f64::from(cell.area)).sum();
        let mut bright: Vec<Cell> =
            cells.into_iter().filter(|cell| cell.radiance * lit > BRIGHT * total).collect();
        if bright.len() > MOST {
            bright.sort_by(|a, b| power(b).total_cmp(&power(a)));
            bright.truncate(MOST);
        }
        let share = (bright.iter().map(power).sum::<f64>() / total) as f32;
        // Also where there is no light.
        if !(share >= SHARE.0) {
            return Self::default();
        }
        let (mut first, mut places) = (vec![NONE; count], Vec::new());
        for (i, cell) in bright.iter().enumerate() {
            let all = 2 * cell.edge * cell.edge;
            let begin = &mut first[cell.triangle as usize];
            if *begin == NONE {
                *begin = places.len() as u32;
                places.push(cell.edge);
                places.resize(places.len() + 2 * all as usize, NONE);
            }
            places[(*begin + 1 + u32::from(cell.back) * all + cell.number) as usize] = i as u32;
        }
        let bounds = bright.iter().map(|cell| {
            let corners = cell.corners(scene);
            let normal = normal_and_area(scene.mesh.corners(cell.triangle)).0;
            let facing = if cell.back { -normal } else { normal };
            Some(Bounds::of_triangle(corners, facing, power(cell)))
        });
        let tree = LightTree::new(bounds);
        Self { tree, first, places, share: share.min(SHARE.1), cells: bright }
    }

    /// Share of directions that go to them; 0 where there are none.
    pub fn share(&self) -> f32 {
        self.share
    }

    /// A direction to one of them; all numbers uniform in [0, 1).
    pub fn aim(&self, scene: &Scene, at: &Receiver, choice: f64, u: [f32; 2]) -> Option<Aim> {
        let cell = &self.cells[self.tree.choose(at, choice)?.0];
        let (b1, b2) = uniform_barycentrics(u);
        let [a, b, c] = cell.corners(scene);
        let wi = (a * (1.0 - b1 - b2) + b * b1 + c * b2 - at.point).try_normalize()?;
        Some(Aim { wi, triangle: cell.triangle, back: cell.back })
    }

    /// Density per solid angle with which [`Self::aim`] finds the point `hit`, seen from a side of it, along `wi`.
    pub fn pdf(&self, scene: &Scene, at: &Receiver, wi: Vec3, hit: &Hit, back: bool) -> f32 {
        let begin = self.first.get(hit.triangle as usize).copied().unwrap_or(NONE);
        if begin == NONE {
            return 0.0;
        }
        let edge = self.places[begin as usize];
        let number = u32::from(back) * 2 * edge * edge + cell_at(edge, hit.b1, hit.b2);
        let place = self.places[(begin + 1 + number) as usize];
        let Some(cell) = self.cells.get(place as usize) else { return 0.0 };
        let (normal, _) = normal_and_area(scene.mesh.corners(hit.triangle));
        let density = hit.t * hit.t / (cell.area * normal.dot(wi).abs());
        let pdf = (f64::from(density) * self.tree.probability(place as usize, at)) as f32;
        if pdf.is_finite() { pdf } else { 0.0 }
    }
}

impl Cell {
    fn corners(&self, scene: &Scene) -> [Vec3; 3] {
        let [a, b, c] = scene.mesh.corners(self.triangle);
        corners_of(self.edge, self.number).map(|[b1, b2]| a * (1.0 - b1 - b2) + b * b1 + c * b2)
    }
}
