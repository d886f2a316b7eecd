//! Irradiance from particle density: a local linear fit with kernels in world space (REFERENCE §6.2;
//! Walter, Hubbard, Shirley & Greenberg 1997).
//!
//! Particles are counted per element, so a kernel weights elements instead of particles, and the
//! moments of the surface inside the kernel are sums over the same elements: borders and corners need
//! no clipping, and a constant irradiance is met exactly. Deviation from the paper: kernels do not
//! know charts or polygons, only positions and normals, so there are no seams between charts.

use glam::{Mat2, Vec2, Vec3};

use super::atlas::Element;
use super::clusters::{Cluster, ClusterTree};
use crate::image::luminance;

/// Particles count together if their normals are within 25° (REFERENCE §6.2).
pub const NORMAL_ANGLE: f32 = 25.0 * std::f32::consts::PI / 180.0;
const NORMAL_COSINE: f32 = 0.906_307_8;
/// Slope against the tangent plane beyond which a piece belongs to another surface, such as the top of
/// a book beside the table it lies on; sin(25°/2) is what a smooth bend may reach.
const SLOPE_MAX: f32 = 0.25;
/// Clusters in a kernel are no wider than this share of its radius.
const RESOLUTION: f32 = 0.12;
/// Ridge on the second moments, in units of the squared radius: a strip much narrower than the kernel
/// has no measurable slope across. A full disc has 1/6.
const RIDGE: f32 = 1e-3;
/// Fewer particles than this carry no slope: the area form is used.
const SLOPE_COUNT_MIN: f32 = 16.0;

/// An estimate at one element and side.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimate {
    /// Irradiance per band, W/m², not negative.
    pub irradiance: Vec3,
    /// Variance of its luminance.
    pub variance: f32,
    /// Change of the irradiance per scene unit along the two tangents of the element.
    pub slope: [Vec3; 2],
}

impl Estimate {
    /// The fit at an offset from the element it was made at, along its two tangents.
    pub fn at(&self, x: f32, y: f32) -> Vec3 {
        let value = self.irradiance + self.slope[0] * x + self.slope[1] * y;
        value.clamp(0.5 * self.irradiance, 2.0 * self.irradiance)
    }
}

/// How wide kernels are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bandwidth {
    /// Particles wanted inside a kernel.
    pub count: f32,
    /// Largest radius, scene units.
    pub radius_max: f32,
    /// Whether kernels see few large clusters: for a first picture.
    pub coarse: bool,
}

impl Bandwidth {
    /// For `stored` particles in a scene of this diagonal. The radius of least error falls with
    /// N^(−1/6) (REFERENCE §6.2), so the particles inside grow with N^(2/3).
    pub fn new(stored: u64, diagonal: f32) -> Self {
        Self {
            count: (0.1 * (stored as f32).powf(2.0 / 3.0)).max(24.0),
            radius_max: 0.1 * diagonal,
            coarse: false,
        }
    }

    /// The radius at which a kernel on a plane holds `count` of `stored` particles spread evenly over `area`.
    pub fn radius_for(&self, area: f32, stored: u64) -> f32 {
        (self.count * area / (std::f32::consts::PI * stored.max(1) as f32)).sqrt()
    }

    /// The smallest radius at an element: a kernel must hold several elements.
    pub fn radius_min(element: &Element) -> f32 {
        2.2 * element.area.sqrt()
    }

    /// The estimate with this bandwidth, and the radius to guess for a neighbour. A slope fitted at a border or in a corner is noisier than in the
    /// open by up to an order of magnitude; there the radius grows by up to two.
    pub fn estimate(
        &self,
        tree: &ClusterTree,
        element: &Element,
        back: bool,
        guess: f32,
        emitted: u64,
    ) -> (Estimate, f32) {
        let radius = self.radius(tree, element, back, guess);
        (self.estimate_within(tree, element, back, radius, emitted), radius)
    }

    /// The same, if the radius is known.
    pub fn estimate_within(
        &self,
        tree: &ClusterTree,
        element: &Element,
        back: bool,
        radius: f32,
        emitted: u64,
    ) -> Estimate {
        let resolution = if self.coarse { 2.0 * RESOLUTION } else { RESOLUTION };
        let first = estimate_with(tree, element, back, radius, resolution, emitted);
        // ∫K² of a whole disc (REFERENCE §6.2).
        let in_the_open = 4.0 / (3.0 * self.count) * luminance(first.irradiance).powi(2);
        let excess = first.variance / in_the_open.max(1e-30);
        if self.coarse || in_the_open <= 0.0 || excess < 1.6 {
            return first;
        }
        let wider = (radius * excess.sqrt().min(2.0)).min(1.5 * self.radius_max.max(radius));
        let second = estimate_with(tree, element, back, wider, resolution, emitted);
        if second.variance < first.variance { second } else { first }
    }

    /// The radius at `element`, starting from `guess` (a former radius, or 0), at which the kernel holds
    /// about `count` particles.
    pub fn radius(&self, tree: &ClusterTree, element: &Element, back: bool, guess: f32) -> f32 {
        let low = Self::radius_min(element);
        let high = self.radius_max.max(low);
        let mut radius = if guess > 0.0 { guess.clamp(low, high) } else { (low * high).sqrt() };
        for _ in 0..6 {
            let mut count = 0.0;
            visit_disc(tree, element, back, radius, 0.25, &mut |_, cluster, side| {
                count += cluster.arrived[side].count;
            });
            // The count grows with the square of the radius.
            let factor = (self.count / count.max(0.5)).sqrt().clamp(0.35, 3.0);
            let next = (radius * factor).clamp(low, high);
            let done = (next / radius - 1.0).abs() < 0.1;
            radius = next;
            if done {
                break;
            }
        }
        radius
    }
}

/// Calls `visit` with the offset in the tangent plane in units of `radius`, the cluster, and its side
/// that looks to where `element`'s side looks.
fn visit_disc(
    tree: &ClusterTree,
    element: &Element,
    back: bool,
    radius: f32,
    resolution: f32,
    visit: &mut impl FnMut(Vec2, &Cluster, usize),
) {
    let normal = if back { -element.normal } else { element.normal };
    let (tangent, bitangent) = element.normal.any_orthonormal_pair();
    let inverse = 1.0 / radius;
    let mut on_cluster = |cluster: &Cluster| {
        let cosine = cluster.normal.dot(normal);
        if cosine.abs() < NORMAL_COSINE {
            return;
        }
        let d = cluster.center - element.position;
        let height = d.dot(normal);
        let u = Vec2::new(d.dot(tangent), d.dot(bitangent)) * inverse;
        if u.length_squared() >= 1.0 || height.abs() > SLOPE_MAX * d.length() + 0.02 * radius {
            return;
        }
        visit(u, cluster, usize::from(cosine < 0.0));
    };
    tree.visit(element.position, normal, radius * 1.04, NORMAL_ANGLE, resolution * radius, &mut on_cluster);
}

/// Sums over a kernel.
#[derive(Default)]
struct Moments {
    m0: f32,
    m1: Vec2,
    m2: [f32; 3],
    flux: Vec3,
    flux_u: [Vec3; 2],
    square: f32,
    square_u: Vec2,
    square_uu: [f32; 3],
    count: f32,
}

/// The estimate at one side of `element` from `emitted` particles with kernels of `radius`.
pub fn estimate(tree: &ClusterTree, element: &Element, back: bool, radius: f32, emitted: u64) -> Estimate {
    estimate_with(tree, element, back, radius, RESOLUTION, emitted)
}

/// The same from fewer, larger clusters: where noise is the larger error.
pub fn estimate_coarsely(
    tree: &ClusterTree,
    element: &Element,
    back: bool,
    radius: f32,
    emitted: u64,
) -> Estimate {
    estimate_with(tree, element, back, radius, 2.0 * RESOLUTION, emitted)
}

fn estimate_with(
    tree: &ClusterTree,
    element: &Element,
    back: bool,
    radius: f32,
    resolution: f32,
    emitted: u64,
) -> Estimate {
    let mut m = Moments::default();
    visit_disc(tree, element, back, radius, resolution, &mut |u, cluster, side| {
        let k = 1.0 - u.length_squared();
        let arrived = &cluster.arrived[side];
        let w = k * cluster.area;
        m.m0 += w;
        m.m1 += w * u;
        m.m2[0] += w * u.x * u.x;
        m.m2[1] += w * u.x * u.y;
        m.m2[2] += w * u.y * u.y;
        let flux = k * arrived.flux;
        m.flux += flux;
        m.flux_u[0] += flux * u.x;
        m.flux_u[1] += flux * u.y;
        let square = k * k * arrived.square;
        m.square += square;
        m.square_u += square * u;
        m.square_uu[0] += square * u.x * u.x;
        m.square_uu[1] += square * u.x * u.y;
        m.square_uu[2] += square * u.y * u.y;
        m.count += arrived.count;
    });
    m.solve(emitted, radius)
}

impl Moments {
    /// The value of the linear fit at the centre, or the area form Σ w K / ∫ K.
    fn solve(&self, emitted: u64, radius: f32) -> Estimate {
        if self.m0 <= 0.0 || emitted == 0 {
            return Estimate::default();
        }
        let n = emitted as f32;
        let area_form = Estimate {
            irradiance: self.flux / (self.m0 * n),
            variance: self.square / (self.m0 * n).powi(2),
            slope: [Vec3::ZERO; 2],
        };
        if self.count < SLOPE_COUNT_MIN {
            return area_form;
        }
        // With μ = m1/m0 and C = M2/m0 − μμᵀ the fit's value at the centre is Σ wK(1 + gᵀ(u − μ))/m0 with
        // g = −C⁻¹μ.
        let mean = self.m1 / self.m0;
        let xx = self.m2[0] / self.m0 - mean.x * mean.x + RIDGE;
        let xy = self.m2[1] / self.m0 - mean.x * mean.y;
        let yy = self.m2[2] / self.m0 - mean.y * mean.y + RIDGE;
        let covariance = Mat2::from_cols(Vec2::new(xx, xy), Vec2::new(xy, yy));
        if covariance.determinant() < 1e-9 {
            return area_form;
        }
        let inverse = covariance.inverse();
        let g = -(inverse * mean);
        let rise = [self.flux_u[0] - self.flux * mean.x, self.flux_u[1] - self.flux * mean.y];
        let per_unit = 1.0 / (self.m0 * n * radius);
        let slope = [inverse.x_axis, inverse.y_axis].map(|c| (rise[0] * c.x + rise[1] * c.y) * per_unit);
        let constant = 1.0 - g.dot(mean);
        let irradiance = (self.flux * constant + self.flux_u[0] * g.x + self.flux_u[1] * g.y) / (self.m0 * n);
        let variance = (constant * constant * self.square
            + 2.0 * constant * g.dot(self.square_u)
            + g.x * g.x * self.square_uu[0]
            + 2.0 * g.x * g.y * self.square_uu[1]
            + g.y * g.y * self.square_uu[2])
            / (self.m0 * n).powi(2);
        // A slope through few particles may overshoot; a mean cannot.
        if irradiance.min_element() < 0.0
            || luminance(irradiance) > 4.0 * luminance(area_form.irradiance)
            || !irradiance.is_finite()
            || !slope.iter().all(|s| s.is_finite())
        {
            return area_form;
        }
        Estimate { irradiance, variance: variance.max(0.0), slope }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illumination::bins::Bins;

    /// A unit square of n × n elements, with `flux(position)` per area arriving as many small particles.
    fn square(n: u32, flux: impl Fn(Vec3) -> f32, per_element: u32) -> (Vec<Element>, ClusterTree) {
        let side = 1.0 / n as f32;
        let elements: Vec<Element> = (0..n * n)
            .map(|i| Element {
                position: Vec3::new((i % n) as f32 + 0.5, (i / n) as f32 + 0.5, 0.0) * side,
                normal: Vec3::Z,
                area: side * side,
                ..Element::default()
            })
            .collect();
        let bins = Bins::new(elements.len(), 1.0);
        for (i, e) in elements.iter().enumerate() {
            for _ in 0..per_element {
                bins.add(i as u32, false, Vec3::splat(flux(e.position) * e.area / per_element as f32));
            }
        }
        let mut tree = ClusterTree::build(&elements);
        tree.update(&bins);
        (elements, tree)
    }

    #[test]
    fn a_linear_irradiance_is_met_up_to_the_border() {
        let f = |p: Vec3| 1.0 + 0.5 * p.x + 0.25 * p.y;
        let (elements, tree) = square(80, f, 4);
        for e in &elements {
            let found = estimate(&tree, e, false, 0.15, 1).irradiance.x;
            // Fixed point, and the ridge at the border.
            assert!((found / f(e.position) - 1.0).abs() < 4e-3, "{} {found} {}", e.position, f(e.position));
        }
    }

    #[test]
    fn a_constant_irradiance_is_met_in_strips_and_corners() {
        let (elements, tree) = square(40, |_| 1.0, 2);
        for e in &elements {
            for radius in [0.06, 0.2, 2.0] {
                let found = estimate(&tree, e, false, radius, 1).irradiance.x;
                assert!((found - 1.0).abs() < 2e-3, "{} {radius} {found}", e.position);
            }
        }
    }

    #[test]
    fn the_back_does_not_see_the_front() {
        let (elements, tree) = square(10, |_| 1.0, 2);
        assert_eq!(estimate(&tree, &elements[44], true, 0.3, 1), Estimate::default());
    }

    #[test]
    fn the_standard_error_is_that_of_repeated_trials() {
        let side = 1.0 / 24.0;
        let elements: Vec<Element> = (0..576u32)
            .map(|i| Element {
                position: Vec3::new((i % 24) as f32 + 0.5, (i / 24) as f32 + 0.5, 0.0) * side,
                normal: Vec3::Z,
                area: side * side,
                ..Element::default()
            })
            .collect();
        let mut tree = ClusterTree::build(&elements);
        // interior, border, corner
        for at in [300, 12, 0] {
            let (mut sum, mut squares, mut claimed) = (0.0f64, 0.0f64, 0.0f64);
            let (trials, n) = (300u64, 2000u64);
            for trial in 0..trials {
                let bins = Bins::new(elements.len(), 1.0);
                for i in 0..n {
                    let e = crate::rng::Stream::new(trial, i, 0).next_u64() % 576;
                    bins.add(e as u32, false, Vec3::ONE);
                }
                tree.update(&bins);
                let found = estimate(&tree, &elements[at], false, 0.25, n);
                sum += f64::from(found.irradiance.x);
                squares += f64::from(found.irradiance.x).powi(2);
                claimed += f64::from(found.variance);
            }
            let n = trials as f64;
            let (mean, claimed) = (sum / n, claimed / n);
            let variance = squares / n - mean * mean;
            assert!((mean - 1.0).abs() < 5.0 * (claimed / n).sqrt(), "{at}: {mean}");
            assert!((0.7..1.4).contains(&(variance / claimed)), "{at}: {variance} {claimed}");
        }
    }

    #[test]
    fn the_radius_follows_the_density() {
        let (elements, tree) = square(64, |_| 1.0, 4);
        let bandwidth = Bandwidth { count: 400.0, radius_max: 1.0, coarse: false };
        let exact = (400.0 / (4.0 * 64.0 * 64.0) / std::f32::consts::PI).sqrt();
        let found = bandwidth.radius(&tree, &elements[64 * 32 + 32], false, 0.0);
        assert!((found / exact - 1.0).abs() < 0.15, "{found} {exact}");
        let corner = bandwidth.radius(&tree, &elements[0], false, 0.0);
        assert!((1.6..2.4).contains(&(corner / exact)), "{}", corner / exact);
    }
}
