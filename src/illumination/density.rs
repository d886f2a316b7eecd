//! Irradiance from particle density: a local linear fit with kernels in world space (REFERENCE §6.2;
//! Walter, Hubbard, Shirley & Greenberg 1997).
//!
//! Particles are counted per element, so a kernel weights elements instead of particles, and the
//! moments of the surface inside the kernel are sums over the same elements: borders and corners need
//! no clipping, and a constant irradiance is met exactly. Deviation from the paper: kernels do not
//! know charts or polygons, only positions and normals, so there are no seams between charts.

use glam::{Mat2, Vec2, Vec3, Vec4};

use super::atlas::Element;
use super::clusters::{ClusterTree, Extent};
use super::neighbourhood::{Neighbourhood, REACH, RESOLUTION};
use crate::image::luminance;
use crate::math;

/// Ridge on the second moments, in units of the squared radius: a strip much narrower than the kernel
/// has no measurable slope across. A full disc has 1/6.
const RIDGE: f32 = 1e-3;
/// Fewer particles than this carry no slope: the area form is used.
const SLOPE_COUNT_MIN: f32 = 16.0;

/// Radius of the narrower kernel that a wide one is held against.
const NARROW: f32 = 0.5;
/// The least of these in units of an element's side: its neighbours just count.
const RADIUS_MIN_NARROW: f32 = 1.1;
/// Squared differences beyond so many variances are no noise.
const TRUSTED: f32 = 8.0;

/// An estimate at one element and side.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimate {
    /// Irradiance per band, W/m², not negative.
    pub irradiance: Vec3,
    /// Variance of its luminance.
    pub variance: f32,
    /// Change of the irradiance per scene unit along the two tangents of the element.
    pub slope: [Vec3; 2],
    /// Irradiance per flux of a particle that arrives at the element itself, per square scene unit.
    pub own: f32,
}

impl Estimate {
    /// The fit at an offset from the element it was made at, along its two tangents.
    pub fn at(&self, x: f32, y: f32) -> Vec3 {
        let value = self.irradiance + self.slope[0] * x + self.slope[1] * y;
        value.clamp(0.5 * self.irradiance, 2.0 * self.irradiance)
    }

    /// Drawn towards another by a share `w` in [0, 1] of the difference. Their noise is taken for independent.
    fn towards(&self, other: &Self, w: f32) -> Self {
        let own = 1.0 - w;
        Self {
            irradiance: self.irradiance * own + other.irradiance * w,
            variance: self.variance * own * own + other.variance * w * w,
            slope: [0, 1].map(|i| self.slope[i] * own + other.slope[i] * w),
            own: self.own * own + other.own * w,
        }
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
            count: (0.1 * math::powf(stored as f32, 2.0 / 3.0)).max(24.0),
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

    /// Size of clusters as a share of the radius.
    fn resolution(&self) -> f32 {
        if self.coarse { 2.0 * RESOLUTION } else { RESOLUTION }
    }

    /// The radius for a kernel at `element`, given the radius that holds the particles wanted.
    fn limited(&self, element: &Element, radius: f32) -> f32 {
        let low = Self::radius_min(element);
        radius.clamp(low, self.radius_max.max(low))
    }

    /// The radius of the kernel at the placed element of a neighbourhood.
    pub fn kernel(&self, hood: &Neighbourhood, element: &Element, back: bool) -> f32 {
        self.limited(element, hood.radius(self.count, back)).min(REACH * hood.nominal())
    }

    /// Gathers the neighbourhood of the elements of `extent`, starting from `guess` (a former radius, or 0). Returns the
    /// radius of the kernel at its center, which is placed unless the neighbourhood [gave up](Neighbourhood::gave_up).
    pub fn focus(&self, hood: &mut Neighbourhood, tree: &ClusterTree, extent: &Extent, guess: f32) -> f32 {
        let center = &extent.center;
        let low = Self::radius_min(center);
        let high = self.radius_max.max(low);
        let mut nominal = if guess > 0.0 { guess.clamp(low, high) } else { (low * high).sqrt() };
        let mut radius = nominal;
        for _ in 0..6 {
            hood.gather(tree, extent, nominal, self.resolution());
            if hood.gave_up() {
                return nominal;
            }
            hood.place(center);
            radius = self.limited(center, hood.radius(self.count, false).clamp(0.3 * nominal, 3.0 * nominal));
            // Clutter may allow no larger one.
            let limited = hood.nominal() < 0.99 * nominal && radius > hood.nominal();
            if limited || (0.6 * nominal..=1.3 * nominal).contains(&radius) {
                break;
            }
            nominal = radius;
        }
        radius.min(REACH * hood.nominal())
    }

    /// The estimate at the placed element of a neighbourhood, and the radius of its kernel: one bandwidth for all of a
    /// scene is too wide in caustics and contact shadows, so that a kernel much narrower has a say where noise does not
    /// explain how they differ (after Lepski's method; Goldenshluger & Nemirovski 1997).
    pub fn estimate(
        &self,
        hood: &Neighbourhood,
        element: &Element,
        back: bool,
        emitted: u64,
    ) -> (Estimate, f32) {
        let (wide, radius) = self.steady_estimate(hood, element, back, emitted);
        match self.coarse {
            true => (wide, radius),
            false => (refined(hood, element, back, emitted, (wide, radius)), radius),
        }
    }

    /// A slope fitted at a border or in a corner is noisier than in the open by up to an order of magnitude; there the
    /// radius grows by up to two.
    fn steady_estimate(
        &self,
        hood: &Neighbourhood,
        element: &Element,
        back: bool,
        emitted: u64,
    ) -> (Estimate, f32) {
        let widest = REACH * hood.nominal();
        let radius = self.kernel(hood, element, back);
        let first = hood.estimate(radius, back, emitted);
        // ∫K² of a whole disc (REFERENCE §6.2).
        let in_the_open = 4.0 / (3.0 * self.count) * luminance(first.irradiance).powi(2);
        let excess = first.variance / in_the_open.max(1e-30);
        if self.coarse || in_the_open <= 0.0 || excess < 1.6 {
            return (first, radius);
        }
        let wider = (radius * excess.sqrt().min(2.0)).min(1.5 * self.radius_max.max(radius)).min(widest);
        let second = hood.estimate(wider, back, emitted);
        (if second.variance < first.variance { second } else { first }, radius)
    }
}

/// An estimate of this radius drawn to what narrower kernels say.
fn refined(
    hood: &Neighbourhood,
    element: &Element,
    back: bool,
    emitted: u64,
    (wide, radius): (Estimate, f32),
) -> Estimate {
    let narrow = NARROW * radius;
    if narrow < RADIUS_MIN_NARROW * element.area.sqrt() || wide.variance <= 0.0 {
        return wide;
    }
    let near = hood.estimate(narrow, back, emitted);
    // Nor is it asked where masks leave it less than half of its share of the surface.
    if near.own <= 0.0 || near.own > 2.0 * (radius / narrow).powi(2) * wide.own {
        return wide;
    }
    // Few particles cannot tell their noise: that of the wide kernel can, for the smaller area.
    let expected = wide.variance * (radius / narrow).powi(2);
    let trusted = TRUSTED * near.variance.max(expected);
    let difference = luminance(near.irradiance - wide.irradiance).powi(2);
    if difference <= trusted {
        return wide;
    }
    refined(hood, element, back, emitted, (near, narrow)).towards(&wide, trusted / difference)
}

/// The estimate at one side of `element` from `emitted` particles with kernels of `radius`.
pub fn estimate(tree: &ClusterTree, element: &Element, back: bool, radius: f32, emitted: u64) -> Estimate {
    let mut hood = Neighbourhood::default();
    hood.gather(tree, &Extent::of(element), radius, RESOLUTION);
    hood.place(element);
    hood.estimate(radius, back, emitted)
}

/// Sums over a kernel.
#[derive(Default)]
pub(super) struct Moments {
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

impl Moments {
    /// Adds a cluster at `u` in units of the kernel's radius: its area, the flux that arrived there with the sum of
    /// squared luminances, and the count.
    #[inline]
    pub(super) fn add(&mut self, u: Vec2, area: f32, flux: Vec4, count: f32) {
        let k = 1.0 - u.length_squared();
        let w = k * area;
        self.m0 += w;
        self.m1 += w * u;
        self.m2[0] += w * u.x * u.x;
        self.m2[1] += w * u.x * u.y;
        self.m2[2] += w * u.y * u.y;
        let square = k * k * flux.w;
        let flux = k * flux.truncate();
        self.flux += flux;
        self.flux_u[0] += flux * u.x;
        self.flux_u[1] += flux * u.y;
        self.square += square;
        self.square_u += square * u;
        self.square_uu[0] += square * u.x * u.x;
        self.square_uu[1] += square * u.x * u.y;
        self.square_uu[2] += square * u.y * u.y;
        self.count += count;
    }

    /// The value of the linear fit at the centre, or the area form Σ w K / ∫ K.
    pub(super) fn solve(&self, emitted: u64, radius: f32) -> Estimate {
        if self.m0 <= 0.0 || emitted == 0 {
            return Estimate::default();
        }
        let n = emitted as f32;
        let area_form = Estimate {
            irradiance: self.flux / (self.m0 * n),
            variance: self.square / (self.m0 * n).powi(2),
            slope: [Vec3::ZERO; 2],
            own: 1.0 / (self.m0 * n),
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
        Estimate { irradiance, variance: variance.max(0.0), slope, own: constant * area_form.own }
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
                opaque: side * side,
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
        tree.update(&elements, &bins);
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
        let found = estimate(&tree, &elements[44], true, 0.3, 1);
        assert_eq!((found.irradiance, found.variance), (Vec3::ZERO, 0.0));
    }

    #[test]
    fn the_standard_error_is_that_of_repeated_trials() {
        let side = 1.0 / 24.0;
        let elements: Vec<Element> = (0..576u32)
            .map(|i| Element {
                position: Vec3::new((i % 24) as f32 + 0.5, (i / 24) as f32 + 0.5, 0.0) * side,
                normal: Vec3::Z,
                area: side * side,
                opaque: side * side,
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
                tree.update(&elements, &bins);
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
        let mut hood = Neighbourhood::default();
        let mut at = |e: &Element| bandwidth.focus(&mut hood, &tree, &Extent::of(e), 0.0);
        let found = at(&elements[64 * 32 + 32]);
        assert!((found / exact - 1.0).abs() < 0.15, "{found} {exact}");
        let corner = at(&elements[0]);
        assert!((1.6..2.4).contains(&(corner / exact)), "{}", corner / exact);
    }
}
