//! Where illumination is stored: a lightmap atlas for large triangles, vertices for dense meshes.
//!
//! Both become [`Element`]s: small pieces of surface with a position, a normal and an area. Particles
//! are counted per element, irradiance is estimated per element and interpolated between them.

use std::sync::Arc;

use glam::{Vec2, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::raster::{Coverage, rasterise};
use super::smoothing::smooth_corners;
use crate::scene::Mesh;

/// Texels between a chart and its neighbour's border; bilinear lookups reach one texel beyond a chart.
pub const PADDING: u32 = 1;
/// Triangles handed to the unwrapper at most; beyond that only the largest get texels.
const UNWRAPPED_TRIANGLES_MAX: usize = 120_000;
/// A triangle whose longest edge is below this many texels is stored per vertex.
const DENSE_EDGE_TEXELS: f32 = 1.5;
/// Longest edge and area of a triangle for which nothing is stored.
const NOT_STORED: (f32, f32) = (-1.0, 0.0);
/// Share of the page that packed charts cover, before it is known.
const UTILISATION: f32 = 0.7;

/// Texture coordinates of a mesh for a lightmap.
#[derive(Clone, Debug, PartialEq)]
pub struct Unwrapped {
    /// Columns of the page.
    pub width: u32,
    /// Rows of the page.
    pub height: u32,
    /// Charts.
    pub charts: u32,
    /// Per triangle the corners in texels (texel (0, 0) spans [0, 1)²), or `None` where it has no chart.
    pub corners: Vec<Option<[Vec2; 3]>>,
}

/// Flattens a mesh into charts that do not overlap, at least `2 · padding` texels apart.
pub trait Unwrap: Sync {
    /// Unwraps `indices` (three per triangle) at a density of `texels_per_unit`.
    ///
    /// # Errors
    /// Says in words why this mesh cannot be unwrapped.
    fn unwrap(
        &self,
        positions: &[[f32; 3]],
        indices: &[u32],
        texels_per_unit: f32,
        padding: u32,
    ) -> Result<Unwrapped, String>;
}

/// The crate `uvunwrap`: planar regions first, then least squares conformal maps.
#[derive(Clone, Copy, Debug, Default)]
pub struct ConformalCharts;

impl Unwrap for ConformalCharts {
    fn unwrap(
        &self,
        positions: &[[f32; 3]],
        indices: &[u32],
        texels_per_unit: f32,
        padding: u32,
    ) -> Result<Unwrapped, String> {
        let options = uvunwrap::Options {
            max_chart_angle: 45.0,
            max_area_distortion: 2.0,
            density: uvunwrap::Density::Fixed { texels_per_unit, page_size: None },
            padding,
            packing: uvunwrap::Packing::Fast,
            ..uvunwrap::Options::default()
        };
        let mesh = uvunwrap::MeshInput::new(positions, indices);
        let atlas = uvunwrap::generate(&[mesh], &options).map_err(|error| error.to_string())?;
        let scale = Vec2::new(atlas.width as f32, atlas.height as f32);
        let output = &atlas.meshes[0];
        let corners = output
            .indices
            .chunks_exact(3)
            .map(|corner| {
                let vertex = |i: usize| &output.vertices[corner[i] as usize];
                let chart = vertex(0).chart?;
                if vertex(1).chart != Some(chart) || vertex(2).chart != Some(chart) {
                    return None;
                }
                let uv = [0, 1, 2].map(|i| Vec2::from(vertex(i).uv) * scale);
                let doubled_area = (uv[1] - uv[0]).perp_dot(uv[2] - uv[0]);
                (doubled_area.abs() > 1e-6).then_some(uv)
            })
            .collect();
        Ok(Unwrapped { width: atlas.width, height: atlas.height, charts: atlas.chart_count, corners })
    }
}

/// Where a triangle's illumination is found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Corners {
    /// In the lightmap, at these texel coordinates.
    Texels([Vec2; 3]),
    /// At these elements, interpolated linearly.
    Vertices([u32; 3]),
}

/// A small piece of surface.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Element {
    /// Centroid, scene units.
    pub position: Vec3,
    /// Mean geometric normal, unit; zero where there is no surface.
    pub normal: Vec3,
    /// Area, square scene units; 0 where there is no surface.
    pub area: f32,
    /// The part of it that no mask cuts out.
    pub opaque: f32,
    /// The triangle that holds the point at which direct light is gathered.
    pub triangle: u32,
    /// Barycentric coordinate of that point at the second corner.
    pub b1: f32,
    /// Barycentric coordinate of that point at the third corner.
    pub b2: f32,
}

/// The storage of a scene's illumination: `width × height` texels in rows, then the vertex elements.
#[derive(Clone, Debug, Default)]
pub struct Atlas {
    /// Columns of the lightmap.
    pub width: u32,
    /// Rows of the lightmap.
    pub height: u32,
    /// Charts of the lightmap.
    pub charts: u32,
    /// Texels per scene unit.
    pub texels_per_unit: f32,
    /// Per triangle.
    pub corners: Arc<Vec<Corners>>,
    /// Texels, then vertex elements.
    pub elements: Vec<Element>,
    /// What did not go as asked, for the user.
    pub notes: Vec<String>,
}

/// Area of a triangle, square scene units.
pub fn triangle_area([a, b, c]: [Vec3; 3]) -> f32 {
    0.5 * (b - a).cross(c - a).length()
}

fn longest_edge([a, b, c]: [Vec3; 3]) -> f32 {
    a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a)).sqrt()
}

impl Atlas {
    /// Divides the triangles of `mesh` between a lightmap of about `texels` texels and vertices.
    ///
    /// The page never exceeds `texels`: where charts are so many that their padding would need much more, texels
    /// become coarser and a note says so. Triangles that `is_diffuse` denies share one
    /// element without area: nothing is stored for them. Those that `is_fine` denies are stored per vertex.
    pub fn build(
        mesh: &Mesh,
        texels: u32,
        is_diffuse: &(dyn Fn(u32) -> bool + Sync),
        is_fine: &(dyn Fn(u32) -> bool + Sync),
        unwrap: &dyn Unwrap,
    ) -> Self {
        let built = Self::build_while(mesh, texels, is_diffuse, is_fine, unwrap, &|| true);
        built.unwrap_or_else(|| unreachable!("it is always wanted"))
    }

    /// The same, as long as it is wanted, which is asked before each attempt at a page; `None` where that ended before.
    pub fn build_while(
        mesh: &Mesh,
        texels: u32,
        is_diffuse: &(dyn Fn(u32) -> bool + Sync),
        is_fine: &(dyn Fn(u32) -> bool + Sync),
        unwrap: &dyn Unwrap,
        is_wanted: &dyn Fn() -> bool,
    ) -> Option<Self> {
        let triangles = mesh.triangles.len() as u32;
        let sizes: Vec<(f32, f32)> = (0..triangles)
            .into_par_iter()
            .map(|t| {
                if !is_diffuse(t) {
                    return NOT_STORED;
                }
                let corners = mesh.corners(t);
                (longest_edge(corners), triangle_area(corners))
            })
            .collect();
        let mut atlas = Self::default();
        let (mut large, mut density) = choose_large(&sizes, texels, is_fine);
        let (mut unwrapped, mut needed) = (None, None);
        for attempt in 0.. {
            if large.is_empty() {
                break;
            }
            if !is_wanted() {
                return None;
            }
            match unwrap_part(mesh, &large, density, unwrap) {
                Ok(page) => {
                    let used = u64::from(page.width) * u64::from(page.height);
                    if used <= u64::from(texels).min(u64::from(u32::MAX / 2)) {
                        unwrapped = Some(page);
                        break;
                    }
                    // Packing loses more than was thought, or padding dominates: then coarser texels turn more
                    // triangles into vertex storage, until a map remains that fits.
                    needed = needed.or(Some(used));
                    let excess = (f64::from(texels) / used as f64).sqrt() as f32;
                    density *= if attempt < 2 { (0.97 * excess).max(0.4) } else { excess.min(0.6) };
                    large.retain(|&t| sizes[t as usize].0 * density > DENSE_EDGE_TEXELS);
                }
                Err(why) => {
                    atlas.notes.push(format!("no lightmap, illumination is kept per vertex: {why}"));
                    large.clear();
                }
            }
        }
        // That charts leave gaps is no news; that their padding does not fit is.
        if let Some(used) = needed.filter(|&used| used > 2 * u64::from(texels)) {
            atlas.notes.push(format!(
                "the lightmap would need {used} texels; coarser texels of {:.3} units are used",
                1.0 / density
            ));
        }
        let mut placed: Vec<Option<[Vec2; 3]>> = vec![None; triangles as usize];
        if let Some(page) = unwrapped {
            (atlas.width, atlas.height, atlas.charts) = (page.width, page.height, page.charts);
            for (&t, uv) in large.iter().zip(page.corners) {
                placed[t as usize] = uv;
            }
        }
        atlas.texels_per_unit = density;
        is_wanted().then(|| {
            atlas.place(mesh, &placed, &sizes);
            atlas
        })
    }

    /// Elements of the lightmap; the elements after them are vertices.
    pub fn texel_count(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Width of a texel, or about that of what a vertex stands for, scene units.
    pub fn width_of(&self, element: u32) -> f32 {
        if (element as usize) < self.texel_count() {
            1.0 / self.texels_per_unit
        } else {
            self.elements[element as usize].area.sqrt()
        }
    }

    fn place(&mut self, mesh: &Mesh, placed: &[Option<[Vec2; 3]>], sizes: &[(f32, f32)]) {
        self.elements =
            rasterise(mesh, placed, self.width, self.height).iter().map(Coverage::element).collect();
        let is_stored = |t: usize| sizes[t] != NOT_STORED;
        let dense: Vec<u32> = (0..placed.len() as u32)
            .filter(|&t| placed[t as usize].is_none() && is_stored(t as usize))
            .collect();
        let first = self.elements.len() as u32;
        let (corner_vertices, vertices) = smooth_corners(mesh, &dense, sizes);
        self.elements.extend(vertices);
        let nothing = self.elements.len() as u32;
        if dense.len() < placed.len() {
            self.elements.push(Element::default());
        }
        let mut dense_corners = corner_vertices.into_iter();
        let corners = placed
            .iter()
            .enumerate()
            .map(|(t, uv)| match uv {
                Some(uv) => Corners::Texels(*uv),
                None if is_stored(t) => {
                    Corners::Vertices(dense_corners.next().unwrap_or_default().map(|v| v + first))
                }
                None => Corners::Vertices([nothing; 3]),
            })
            .collect();
        self.corners = Arc::new(corners);
    }

    /// The element that counts what arrives at a point of a triangle.
    pub fn element_at(&self, triangle: u32, b1: f32, b2: f32) -> u32 {
        match &self.corners[triangle as usize] {
            Corners::Vertices(v) => {
                let b0 = 1.0 - b1 - b2;
                if b0 >= b1 && b0 >= b2 {
                    v[0]
                } else if b1 >= b2 {
                    v[1]
                } else {
                    v[2]
                }
            }
            Corners::Texels(uv) => {
                let p = uv[0] * (1.0 - b1 - b2) + uv[1] * b1 + uv[2] * b2;
                let x = (p.x.max(0.0) as u32).min(self.width - 1);
                let y = (p.y.max(0.0) as u32).min(self.height - 1);
                let index = y * self.width + x;
                if self.elements[index as usize].area > 0.0 { index } else { self.covered_near(x, y) }
            }
        }
    }

    /// Rounding may put a point of a chart's border into the texel beside it.
    fn covered_near(&self, x: u32, y: u32) -> u32 {
        for (dx, dy) in NEIGHBOURS {
            let (nx, ny) = (x.wrapping_add_signed(dx), y.wrapping_add_signed(dy));
            if nx < self.width && ny < self.height {
                let index = ny * self.width + nx;
                if self.elements[index as usize].area > 0.0 {
                    return index;
                }
            }
        }
        y * self.width + x
    }
}

/// The eight neighbours of a texel, nearest first.
pub(super) const NEIGHBOURS: [(i32, i32); 8] =
    [(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)];

/// The triangles that get texels, ascending, and texels per unit.
fn choose_large(sizes: &[(f32, f32)], texels: u32, is_fine: &dyn Fn(u32) -> bool) -> (Vec<u32>, f32) {
    let fine: Vec<u32> = (0..sizes.len() as u32).filter(|&t| is_fine(t)).collect();
    let total: f64 = fine.iter().map(|&t| f64::from(sizes[t as usize].1)).sum();
    if texels == 0 || total <= 0.0 || !total.is_finite() {
        return (Vec::new(), 0.0);
    }
    let density_for = |area: f64| ((f64::from(texels) * f64::from(UTILISATION)) / area).sqrt() as f32;
    let mut density = density_for(total);
    let mut large = Vec::new();
    // Dense meshes give their share of the texels to the rest, which then becomes finer.
    for _ in 0..2 {
        large = fine
            .iter()
            .copied()
            .filter(|&t| sizes[t as usize].1 > 0.0 && sizes[t as usize].0 * density > DENSE_EDGE_TEXELS)
            .collect();
        let area: f64 = large.iter().map(|&t| f64::from(sizes[t as usize].1)).sum();
        if area <= 0.0 {
            return (Vec::new(), density);
        }
        density = density_for(area);
    }
    if large.len() > UNWRAPPED_TRIANGLES_MAX {
        large.sort_by(|&a, &b| sizes[b as usize].0.total_cmp(&sizes[a as usize].0).then(a.cmp(&b)));
        large.truncate(UNWRAPPED_TRIANGLES_MAX);
        large.sort_unstable();
    }
    (large, density)
}

fn unwrap_part(mesh: &Mesh, part: &[u32], density: f32, unwrap: &dyn Unwrap) -> Result<Unwrapped, String> {
    let mut renumbered = vec![u32::MAX; mesh.positions.len()];
    let mut positions = Vec::new();
    let mut indices = Vec::with_capacity(part.len() * 3);
    for &t in part {
        for v in mesh.triangles[t as usize] {
            let slot = &mut renumbered[v as usize];
            if *slot == u32::MAX {
                *slot = positions.len() as u32;
                positions.push(mesh.positions[v as usize].to_array());
            }
            indices.push(*slot);
        }
    }
    unwrap.unwrap(&positions, &indices, density, PADDING)
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::sync::atomic::{AtomicU32, Ordering};

    use super::*;
    use crate::illumination::test_scenes::{grid, quad};
    use crate::math;

    fn area_of(atlas: &Atlas) -> f32 {
        atlas.elements.iter().map(|e| e.area).sum()
    }

    /// Pages that do not fit at first, by the number of those made before.
    #[derive(Default)]
    struct Shrinking(AtomicU32);

    impl Unwrap for Shrinking {
        fn unwrap(&self, _: &[[f32; 3]], indices: &[u32], _: f32, _: u32) -> Result<Unwrapped, String> {
            let side = 100 - 20 * self.0.fetch_add(1, Ordering::Relaxed);
            Ok(Unwrapped { width: side, height: side, charts: 1, corners: vec![None; indices.len() / 3] })
        }
    }

    #[test]
    fn what_is_not_wanted_any_more_is_not_unwrapped_again() {
        let mesh = quad(Vec3::ZERO, Vec3::X * 3.0, Vec3::Y * 2.0);
        // Wanted so many times: whether there is an atlas, and how many pages were made.
        let build = |times: u32| {
            let (asked, pages) = (Cell::new(0), Shrinking::default());
            let is_wanted = || asked.replace(asked.get() + 1) < times;
            let atlas = Atlas::build_while(&mesh, 4096, &|_| true, &|_| true, &pages, &is_wanted);
            (atlas.is_some(), pages.0.into_inner())
        };
        // Of 100² and 80² texels no page has room, of 60² one has.
        assert_eq!([0, 1, 2, 3, 4].map(build), [(false, 0), (false, 1), (false, 2), (false, 3), (true, 3)]);
    }

    #[test]
    fn a_large_quad_gets_texels_whose_areas_sum_to_its_area() {
        let mesh = quad(Vec3::ZERO, Vec3::X * 3.0, Vec3::Y * 2.0);
        let atlas = Atlas::build(&mesh, 4096, &|_| true, &|_| true, &ConformalCharts);
        assert!(atlas.corners.iter().all(|c| matches!(c, Corners::Texels(_))));
        assert!((area_of(&atlas) - 6.0).abs() < 1e-3, "{}", area_of(&atlas));
        let covered = atlas.elements.iter().filter(|e| e.area > 0.0).count();
        assert!((2000..=4096).contains(&covered), "{covered}");
        for e in atlas.elements.iter().filter(|e| e.area > 0.0) {
            assert!(e.normal.distance(Vec3::Z) < 1e-5);
            let [a, b, c] = mesh.corners(e.triangle);
            let p = a * (1.0 - e.b1 - e.b2) + b * e.b1 + c * e.b2;
            assert!(p.distance(e.position) < 0.1, "{p} {}", e.position);
        }
    }

    #[test]
    fn a_dense_mesh_is_stored_per_vertex_and_keeps_its_area() {
        let mesh = grid(60, 60, |x, y| Vec3::new(x, y, 0.0));
        let atlas = Atlas::build(&mesh, 64, &|_| true, &|_| true, &ConformalCharts);
        assert!(atlas.corners.iter().all(|c| matches!(c, Corners::Vertices(_))));
        assert_eq!(atlas.elements.len(), 61 * 61);
        assert!((area_of(&atlas) - 1.0).abs() < 1e-4);
    }

    #[test]
    fn every_point_of_a_triangle_has_a_covered_element_nearby() {
        let mesh = grid(4, 3, |x, y| Vec3::new(x * 2.0, y, math::sin(x * 3.0) * 0.3));
        let atlas = Atlas::build(&mesh, 2048, &|_| true, &|_| true, &ConformalCharts);
        let mut stream = crate::rng::Stream::new(1, 2, 3);
        for _ in 0..20_000 {
            let t = (stream.next_u64() % mesh.triangles.len() as u64) as u32;
            let [u, v] = stream.next_2d();
            let s = u.sqrt();
            let (b1, b2) = (s * (1.0 - v), s * v);
            let e = &atlas.elements[atlas.element_at(t, b1, b2) as usize];
            let [a, b, c] = mesh.corners(t);
            let p = a * (1.0 - b1 - b2) + b * b1 + c * b2;
            assert!(e.area > 0.0);
            assert!(p.distance(e.position) < 3.0 / atlas.texels_per_unit);
        }
    }

    #[test]
    fn tiny_charts_do_not_make_the_page_larger_than_the_budget() {
        let mut mesh = Mesh::default();
        for i in 0..2000u32 {
            let at = Vec3::new((i % 50) as f32, (i / 50) as f32, (i % 7) as f32);
            let n = mesh.positions.len() as u32;
            mesh.positions.extend([at, at + Vec3::X * 0.3, at + Vec3::Y * 0.3]);
            mesh.triangles.push([n, n + 1, n + 2]);
        }
        let atlas = Atlas::build(&mesh, 4096, &|_| true, &|_| true, &ConformalCharts);
        assert!(atlas.texel_count() <= 4096, "{}", atlas.texel_count());
        assert!((area_of(&atlas) - 2000.0 * 0.045).abs() < 0.1);
    }

    #[test]
    fn nothing_is_stored_for_mirrors() {
        let mesh = grid(4, 4, |x, y| Vec3::new(x, y, 0.0));
        let atlas = Atlas::build(&mesh, 1000, &|t| t >= 16, &|_| true, &ConformalCharts);
        assert!((area_of(&atlas) - 0.5).abs() < 1e-3);
        for t in 0..16 {
            let Corners::Vertices([e, ..]) = atlas.corners[t] else { panic!("a mirror with texels") };
            assert_eq!(atlas.elements[e as usize], Element::default());
        }
    }

    #[test]
    fn degenerate_and_empty_meshes_have_an_atlas() {
        let empty = Atlas::build(&Mesh::default(), 1024, &|_| true, &|_| true, &ConformalCharts);
        assert!(empty.elements.is_empty());
        let mut line = quad(Vec3::ZERO, Vec3::X, Vec3::X * 2.0);
        line.positions[2] = Vec3::ZERO;
        let atlas = Atlas::build(&line, 1024, &|_| true, &|_| true, &ConformalCharts);
        assert_eq!(atlas.corners.len(), line.triangles.len());
    }
}
