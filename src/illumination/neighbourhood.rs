//! The clusters around a run of neighbouring elements, gathered once from the tree and then read in a row for
//! every kernel of the run. Their number is bounded: where a scene is so cluttered that kernels would see more,
//! clusters become larger.

use glam::{Vec2, Vec3, Vec4};

use super::atlas::Element;
use super::clusters::{ClusterIndex, ClusterTree, Extent, Query};
use super::density::{Estimate, Moments};
use crate::image::luminance;
use crate::math;

/// Elements count together if their normals are within 25° (REFERENCE §6.2).
pub const NORMAL_ANGLE: f32 = 25.0 * std::f32::consts::PI / 180.0;
const NORMAL_COSINE: f32 = 0.906_307_8;
/// Slope against the tangent plane beyond which a piece belongs to another surface, such as the top of
/// a book beside the table it lies on; sin(25°/2) is what a smooth bend may reach.
const SLOPE_MAX: f32 = 0.25;
/// Height over the tangent plane that counts as none, in units of the kernel's radius.
const HEIGHT: f32 = 0.02;
/// Clusters in a kernel are no wider than this share of its radius.
pub const RESOLUTION: f32 = 0.16;
/// Cosine of the angle within which the mean normal of a cluster speaks for all of it in a kernel, 0.25 rad; beside it
/// the same where clutter is denser and denser. Never more than kernels accept: a cluster of two walls would count for
/// neither.
const NARROW: [f32; 3] = [0.968_912_4, 0.95, 0.921];
/// Clusters become at most so many times twice as large: not larger than a kernel.
const CLUTTER_MAX: u32 = 2;
/// The same for a first picture.
const NARROW_COARSE: [f32; 2] = [0.968_912_4, NORMAL_COSINE];
const CLUTTER_MAX_COARSE: u32 = 1;
/// In a hurry a search visits so many nodes for each cluster that it may find.
const VISITS_HURRIED: usize = 4;
/// Clusters in a neighbourhood at most; a flat surface has about 560.
const CLUSTERS_MAX: usize = 840;
/// Where clusters are as large as they may become and still too many, kernels become smaller, by this factor at a time.
const SHRINKING: f32 = 0.75;
/// So many times at most.
const SHRUNK_MAX: u32 = 12;
/// What a kernel accepts where it finds nothing else: cosine between normals, and slope against the tangent plane.
const RELAXED: [(f32, f32); 2] = [(0.5, 1.0), (0.0, f32::INFINITY)];
/// Kernels may be wider than the nominal radius by this factor.
pub const REACH: f32 = 1.5;
/// Rings of equal area in which particles are counted to find a radius.
const RINGS: usize = 64;

/// What arrived at a cluster: flux per band and the squared luminance, the count, and the area for it.
type Arrival = (Vec4, f32, f32);

/// See above.
#[derive(Debug, Default)]
pub struct Neighbourhood {
    /// The radius that kernels have, about.
    nominal: f32,
    /// How many times clusters are twice as large as they should be.
    clutter: u32,
    /// How many times the radius is smaller than it should be.
    shrunk: u32,
    /// Whether there is no time for clutter.
    hurried: bool,
    gave_up: bool,
    found: Vec<ClusterIndex>,
    position: [Vec<f32>; 3],
    normal: [Vec<f32>; 3],
    /// On the side that looks to where the run looks, and on the other one.
    arrivals: Vec<[Arrival; 2]>,
    /// Places in the tangent plane of the element in question, and the squared distance there; infinite for clusters
    /// of other surfaces.
    placed: [Vec<f32>; 3],
    /// The least of these distances.
    nearest: f32,
}

impl Neighbourhood {
    /// Forgets the last one, so that the next does not depend on it.
    pub fn reset(&mut self) {
        (self.clutter, self.shrunk, self.hurried, self.gave_up) = (0, 0, false, false);
    }

    /// From here on gives up where a scene is cluttered.
    pub fn hurry(&mut self) {
        self.hurried = true;
    }

    /// Whether there is no time for clutter.
    pub fn is_hurried(&self) -> bool {
        self.hurried
    }

    /// Whether the last search found clutter and no time for it: then nothing is in the neighbourhood.
    pub fn gave_up(&self) -> bool {
        self.gave_up
    }

    /// Gathers what kernels of radius up to [`REACH`] × `nominal` need at the elements of `extent`. `resolution`: size of
    /// clusters as a share of the radius.
    pub fn gather(&mut self, tree: &ClusterTree, extent: &Extent, nominal: f32, resolution: f32) {
        let Extent { center, reach, .. } = *extent;
        let spread = extent.spread();
        let mut query = Query {
            center: center.position,
            normal: center.normal,
            radius: 0.0,
            normal_angle: NORMAL_ANGLE + spread,
            slope: SLOPE_MAX + math::sin(spread.min(std::f32::consts::FRAC_PI_2)),
            height: 0.0,
            resolution: 0.0,
            narrow: 1.0,
        };
        let coarse = resolution > RESOLUTION;
        let (most, narrow, clutter_max) = match coarse {
            true => (CLUSTERS_MAX / 3, &NARROW_COARSE[..], CLUTTER_MAX_COARSE),
            false => (CLUSTERS_MAX, &NARROW[..], CLUTTER_MAX),
        };
        // Clutter begins and ends gradually: what was too much for the last neighbourhood is so for this one.
        let (mut clutter, mut shrunk) = (self.clutter.min(clutter_max), self.shrunk);
        self.gave_up = false;
        loop {
            self.nominal = nominal * SHRINKING.powi(shrunk as i32);
            query.radius = REACH * self.nominal * 1.04 + reach;
            query.height = HEIGHT * self.nominal + 2.0 * reach;
            query.resolution = resolution * self.nominal * (1 << clutter) as f32;
            query.narrow = narrow[(clutter as usize).min(narrow.len() - 1)];
            let last = clutter == clutter_max;
            let most = match (last, shrunk >= SHRUNK_MAX) {
                (false, _) => most,
                (true, false) if !self.hurried => 2 * most,
                (true, false) => most,
                (true, true) => usize::MAX,
            };
            let visits = if self.hurried { VISITS_HURRIED * most } else { usize::MAX };
            if tree.collect(&query, most, visits, &mut self.found) {
                break;
            }
            if self.hurried && last {
                (self.clutter, self.gave_up) = (clutter, true);
                self.clear();
                self.placed.iter_mut().for_each(Vec::clear);
                return;
            }
            match last {
                true => shrunk += 1,
                false => clutter += 1,
            }
        }
        let few = self.found.len() < most / 3;
        self.shrunk = if few { shrunk.saturating_sub(1) } else { shrunk };
        self.clutter = if few && shrunk == 0 { clutter.saturating_sub(1) } else { clutter };
        self.clear();
        for &index in &self.found {
            let cluster = tree.cluster(index);
            let facing = cluster.normal.dot(center.normal) >= 0.0;
            let sign = if facing { 1.0 } else { -1.0 };
            for (axis, lane) in self.position.iter_mut().enumerate() {
                lane.push(cluster.center[axis]);
            }
            for (axis, lane) in self.normal.iter_mut().enumerate() {
                lane.push(sign * cluster.normal[axis]);
            }
            let [front, back] = cluster.arrived.map(|a| (a.flux.extend(a.square), a.count, a.area));
            self.arrivals.push(if facing { [front, back] } else { [back, front] });
        }
        for lane in &mut self.placed {
            lane.clear();
            lane.resize(self.arrivals.len(), 0.0);
        }
    }

    fn clear(&mut self) {
        for lane in self.position.iter_mut().chain(&mut self.normal) {
            lane.clear();
        }
        self.arrivals.clear();
    }

    /// The radius that kernels have, about.
    pub fn nominal(&self) -> f32 {
        self.nominal
    }

    /// Clusters in it.
    pub fn len(&self) -> usize {
        self.arrivals.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.arrivals.is_empty()
    }

    /// Turns to `element`: what follows is about kernels around it.
    pub fn place(&mut self, element: &Element) {
        let n = element.normal;
        let (s, t) = n.any_orthonormal_pair();
        let p = element.position;
        let height = HEIGHT * self.nominal;
        let count = self.arrivals.len();
        let [x, y, z] = self.position.each_ref().map(|lane| &lane[..count]);
        let [nx, ny, nz] = self.normal.each_ref().map(|lane| &lane[..count]);
        let [u, v, squared] = self.placed.each_mut().map(|lane| &mut lane[..count]);
        let mut nearest = f32::INFINITY;
        for i in 0..count {
            let (dx, dy, dz) = (x[i] - p.x, y[i] - p.y, z[i] - p.z);
            let above = (dx * n.x + dy * n.y + dz * n.z).abs();
            let distance = (dx * dx + dy * dy + dz * dz).sqrt();
            let cosine = nx[i] * n.x + ny[i] * n.y + nz[i] * n.z;
            u[i] = dx * s.x + dy * s.y + dz * s.z;
            v[i] = dx * t.x + dy * t.y + dz * t.z;
            let counts = (cosine >= NORMAL_COSINE) & (above <= SLOPE_MAX * distance + height);
            squared[i] = if counts { u[i] * u[i] + v[i] * v[i] } else { f32::INFINITY };
            nearest = nearest.min(squared[i]);
        }
        // On rubble, what speaks for many elements may stand askew to all of them.
        for (cosine_min, slope) in RELAXED {
            if nearest.is_finite() {
                break;
            }
            for i in 0..count {
                let (dx, dy, dz) = (x[i] - p.x, y[i] - p.y, z[i] - p.z);
                let above = (dx * n.x + dy * n.y + dz * n.z).abs();
                let distance = (dx * dx + dy * dy + dz * dz).sqrt();
                let cosine = nx[i] * n.x + ny[i] * n.y + nz[i] * n.z;
                if cosine >= cosine_min && above <= slope * distance + height {
                    squared[i] = u[i] * u[i] + v[i] * v[i];
                    nearest = nearest.min(squared[i]);
                }
            }
        }
        self.nearest = nearest;
    }

    /// The radius at which a kernel around the placed element holds `count` particles on its front or back, as many as
    /// particles of equal flux would have to be for the same noise (Kish 1965); where the neighbourhood has fewer, what
    /// their density lets expect.
    pub fn radius(&self, count: f32, back: bool) -> f32 {
        let limit = REACH * self.nominal;
        let scale = RINGS as f32 / (limit * limit);
        let mut rings = [[0.0f32; 3]; RINGS];
        for (&squared, arrivals) in self.placed[2].iter().zip(&self.arrivals) {
            let ring = squared * scale;
            if ring < RINGS as f32 {
                let (flux, count, _) = arrivals[usize::from(back)];
                let of_ring = [luminance(flux.truncate()), flux.w, count];
                rings[ring as usize].iter_mut().zip(of_ring).for_each(|(sum, x)| *sum += x);
            }
        }
        let (mut sums, mut before) = ([0.0f32; 3], 0.0f32);
        for (i, ring) in rings.iter().enumerate() {
            sums.iter_mut().zip(ring).for_each(|(sum, x)| *sum += x);
            let [sum, square, all] = sums;
            // Squares of very small fluxes are rounded to nothing.
            let equal = if square > 0.0 { (sum * sum / square).min(all) } else { all };
            if equal >= count {
                return ((i as f32 + (count - before) / (equal - before)) / scale).sqrt();
            }
            before = equal;
        }
        limit * (count / before.max(0.5)).sqrt()
    }

    /// Mean luminance of what arrived per area around the placed element, and the mean variance of an element's, where what
    /// arrived came with its variance.
    pub fn pooled(&self, radius: f32, back: bool) -> (f32, f32) {
        let limit = radius * radius;
        let (mut sum, mut square, mut all, mut squared_areas) = (0.0f32, 0.0f32, 0.0f32, 0.0f32);
        for (&squared, arrivals) in self.placed[2].iter().zip(&self.arrivals) {
            let (flux, count, area) = arrivals[usize::from(back)];
            if squared < limit && area > 0.0 && count > 0.0 {
                let w = 1.0 - squared / limit;
                sum += w * luminance(flux.truncate());
                square += w * flux.w;
                all += w * area;
                squared_areas += w * area * area / count;
            }
        }
        if all > 0.0 { (sum / all, square / squared_areas) } else { (0.0, 0.0) }
    }

    /// The estimate on the front or back of the placed element with kernels of `radius`, from `emitted` particles.
    pub fn estimate(&self, radius: f32, back: bool, emitted: u64) -> Estimate {
        let mut moments = Moments::default();
        // A kernel holds at least the cluster beside it.
        let radius = radius.max((2.0 * self.nearest.max(0.0)).sqrt().min(f32::MAX));
        let (limit, inverse) = (radius * radius, 1.0 / radius);
        let [us, vs, squares] = &self.placed;
        for (i, &squared) in squares.iter().enumerate() {
            if squared < limit {
                let u = Vec2::new(us[i], vs[i]) * inverse;
                let (flux, count, area) = self.arrivals[i][usize::from(back)];
                moments.add(u, area, flux, count);
            }
        }
        moments.solve(emitted, radius)
    }
}

/// Any offset along the two tangents of an element, in which slopes are given.
pub fn along_tangents(element: &Element, to: Vec3) -> [f32; 2] {
    let (s, t) = element.normal.any_orthonormal_pair();
    let d = to - element.position;
    [d.dot(s), d.dot(t)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illumination::bins::Bins;
    use crate::rng::Stream;

    /// Rubble: faces of all directions side by side, far more of them than a kernel reads, and everything equally lit.
    #[test]
    fn rubble_under_even_light_has_no_dark_places() {
        let elements: Vec<Element> = (0..60_000u64)
            .map(|i| {
                let mut s = Stream::new(9, i, 0);
                let position = Vec3::new(s.next_f32(), s.next_f32(), 0.3 * s.next_f32());
                let normal = Vec3::new(s.next_f32() - 0.5, s.next_f32() - 0.5, s.next_f32() - 0.5);
                Element {
                    position,
                    normal: normal.normalize(),
                    area: 1e-4,
                    opaque: 1e-4,
                    ..Element::default()
                }
            })
            .collect();
        let bins = Bins::new(elements.len(), 1.0);
        for e in 0..elements.len() as u32 {
            bins.add(e, false, Vec3::splat(1e-4));
            bins.add(e, true, Vec3::splat(1e-4));
        }
        let mut tree = ClusterTree::build(&elements);
        tree.update(&elements, &bins);
        let mut hood = Neighbourhood::default();
        for nominal in [0.05, 0.2, 0.4] {
            for node in tree.subtrees(8).into_iter().step_by(61) {
                let extent = tree.as_element(node);
                hood.gather(&tree, &extent, nominal, RESOLUTION);
                hood.place(&extent.center);
                let found = hood.estimate(nominal, false, 1);
                assert!((found.irradiance.x - 1.0).abs() < 0.02, "{nominal}: {}", found.irradiance);
            }
        }
    }
}
