//! Sixteen shadow rays at once, from neighbouring points to one light.
//!
//! Rays that point into one octant, along one dominant axis, go through the tree as one beam (`super::beam`); of a
//! leaf's triangles those are tested that the beam may meet, for all rays at once. Each ray meets a triangle by the very
//! operations of a single ray (`super::block`), so that what is found does not depend on its company, to the bit.
//! A shadow is often thrown by what threw the last one: that leaf is looked at first.

use arrayvec::ArrayVec;

use super::Ray;
use super::beam::{Beam, most, transposed};
use super::block::{Block, axes, exact};
use super::level::{Vectors, Work};
use super::node::Child;
use super::packet::LANES;
use super::simd::Simd;
use super::stack::{STACK, Stack};
use super::wide::{LeafHit, Wide};

/// What a hit is to a shadow ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Meets {
    /// Nothing: the triangle it left, or a hole.
    Nothing,
    /// What lets no light pass.
    Blocker,
    /// What may let light pass, as far as is known here.
    Other,
}

/// What became of the rays of a packet, a bit for each; of the others nothing stands in the way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Shadows {
    /// Those that something blocks.
    pub blocked: u32,
    /// Those to be asked one by one: something else than a blocker was met, or the ray fits into no packet.
    pub unclear: u32,
}

/// Where the last shadow came from: a leaf of the tree.
#[derive(Clone, Copy, Debug, Default)]
pub struct LastShadow(Option<u32>);

/// Follows those of the rays that `lanes` has a bit for.
pub(super) fn cast(
    wide: &Wide,
    rays: &[Ray; LANES],
    lanes: u32,
    last: &mut LastShadow,
    meets: &impl Fn(usize, LeafHit) -> Meets,
) -> Shadows {
    if wide.is_empty() || lanes == 0 {
        return Shadows::default();
    }
    wide.level().run(Cast { wide, rays, lanes, last, meets })
}

/// The way of the rays through the tree, to be compiled for each set of instructions.
struct Cast<'a, F> {
    wide: &'a Wide,
    rays: &'a [Ray; LANES],
    lanes: u32,
    last: &'a mut LastShadow,
    meets: &'a F,
}

/// Largest components of directions that lie beyond these are followed one by one: their inverses would not be numbers.
const USUAL: std::ops::RangeInclusive<f32> = 1e-15..=1e15;

/// Fewer rays than these gain nothing by company.
const FEWEST: u32 = 4;

/// Rays of one beam begin and end within this share of their length of each other: wider beams meet more boxes than their
/// rays do one by one.
const WIDTH: f32 = 1.0 / 16.0;

/// Beams of fewer than [`FEWEST`] rays before the others are left alone, too: such rays go to no one light.
const STRAYS: u32 = 2;

impl<F: Fn(usize, LeafHit) -> Meets> Work for Cast<'_, F> {
    type Output = Shadows;
    const SIXTEEN: bool = true;

    #[inline(always)]
    fn run<V: Vectors>(mut self, v: V) -> Shadows {
        if self.wide.stack() <= STACK {
            self.go(v, &mut ArrayVec::<_, STACK>::new())
        } else {
            self.go(v, &mut Vec::with_capacity(self.wide.stack()))
        }
    }
}

impl<F: Fn(usize, LeafHit) -> Meets> Cast<'_, F> {
    #[inline(always)]
    fn go<V: Vectors>(&mut self, v: V, stack: &mut impl Stack) -> Shadows {
        let mut shadows = Shadows::default();
        let mut left = self.lanes;
        for lane in bits(self.lanes) {
            let ray = &self.rays[lane];
            // As single rays do, which hit nothing then.
            if !ray.direction.is_finite() || !ray.origin.is_finite() || ray.direction == glam::Vec3::ZERO {
                left &= !(1 << lane);
            } else if !USUAL.contains(&ray.direction.abs().max_element()) {
                left &= !(1 << lane);
                shadows.unclear |= 1 << lane;
            }
        }
        let before = *self.last;
        let mut strays = 0;
        while left != 0 {
            if strays == STRAYS {
                shadows.unclear |= left;
                break;
            }
            let first = left.trailing_zeros() as usize;
            // Who is not asked goes along with one who is.
            let theirs: [usize; LANES] = std::array::from_fn(|l| if left >> l & 1 != 0 { l } else { first });
            let directions = transposed(v, &theirs.map(|l| self.rays[l].direction));
            let origins = transposed(v, &theirs.map(|l| self.rays[l].origin));
            let (inverse, alike) = alike(v, &directions, first);
            let alike = alike & self.beside(v, &origins, &directions, first);
            let members = alike & left;
            left &= !members;
            if members.count_ones() < FEWEST {
                shadows.unclear |= members;
                strays += 1;
                continue;
            }
            let group = Group::new(v, self.rays, &theirs, &origins, &directions, first);
            let beam = if alike == ALL {
                Beam::from_points(v, &origins, &inverse)
            } else {
                let theirs: [usize; LANES] =
                    std::array::from_fn(|l| if members >> l & 1 != 0 { l } else { first });
                let directions = transposed(v, &theirs.map(|l| self.rays[l].direction));
                let (inverse, _) = self::alike(v, &directions, first);
                Beam::from_points(v, &transposed(v, &theirs.map(|l| self.rays[l].origin)), &inverse)
            };
            let mut found = Found { open: members, shadows, last: LastShadow(None) };
            self.travel(v, &group, &beam, before, &mut found, stack);
            shadows = found.shadows;
            if found.last.0.is_some() {
                *self.last = found.last;
            } else if shadows.blocked & members == 0 {
                *self.last = LastShadow(None);
            }
            stack.clear();
        }
        shadows.unclear &= !shadows.blocked;
        shadows
    }

    /// A bit for each ray that begins and ends near ray `first`.
    #[inline(always)]
    fn beside<S: Simd<16>>(
        &self,
        s: S,
        origins: &[S::Lanes; 3],
        directions: &[S::Lanes; 3],
        first: usize,
    ) -> u32 {
        let ray = &self.rays[first];
        let length = ray.direction.abs().max_element();
        // A ray without end is as long as the scene is large.
        let reach = if ray.t_max.is_finite() { 1.0 } else { self.wide.largest_side() / length };
        let width = s.splat(length * reach * WIDTH);
        let (zero, reach_lanes) = (s.splat(0.0), s.splat(reach));
        let mut near = ALL;
        for axis in 0..3 {
            let (origin, direction) = (origins[axis], directions[axis]);
            let end = s.add(origin, s.mul(direction, reach_lanes));
            let (from, to) = (ray.origin[axis], ray.origin[axis] + ray.direction[axis] * reach);
            for (lanes, own) in [(origin, from), (end, to)] {
                let apart = s.sub(lanes, s.splat(own));
                near &= s.bits(s.at_most(s.max(apart, s.sub(zero, apart)), width));
            }
        }
        // Itself in any case: numbers may be too large.
        near | 1 << first
    }

    #[inline(always)]
    fn travel<V: Vectors>(
        &self,
        v: V,
        group: &Group<V>,
        beam: &Beam<V>,
        before: LastShadow,
        found: &mut Found,
        stack: &mut impl Stack,
    ) {
        let (nodes, blocks) = self.wide.parts();
        let farthest = most(v, group.t_max);
        if let Some(block) = before.0
            && self.leaf(v, group, beam, farthest, (block, &blocks[block as usize]), found)
        {
            return;
        }
        let mut current = Child::node(0);
        loop {
            if current.is_leaf() {
                let index = current.index();
                if self.leaf(v, group, beam, farthest, (index as u32, &blocks[index]), found) {
                    return;
                }
            } else {
                let node = &nodes[current.index()];
                let (enter, mask) = beam.meet(v, |side| Simd::<8>::load(v, &node.bounds[side]), farthest);
                if mask != 0 {
                    current = stack.visit::<false>(node, &enter, mask, |_| ());
                    continue;
                }
            }
            let Some(next) = stack.pop() else { return };
            current = next.child();
        }
    }

    /// Tests the triangles of a leaf that the beam may meet; says whether all rays are blocked.
    #[inline(always)]
    fn leaf<V: Vectors>(
        &self,
        v: V,
        group: &Group<V>,
        beam: &Beam<V>,
        farthest: f32,
        (index, block): (u32, &Block),
        found: &mut Found,
    ) -> bool {
        let sides = block.bounds(v);
        let (_, within) = beam.meet(v, |side| sides[side], farthest);
        for lane in bits(within & block.used()) {
            let Some(hits) = group.meet(v, block, lane, found.open) else { continue };
            for ray in bits(hits.mask) {
                let (t, triangle) = (hits.t[ray], block.index[lane]);
                match (self.meets)(ray, LeafHit { t, triangle, b1: hits.b1[ray], b2: hits.b2[ray] }) {
                    Meets::Nothing => {}
                    Meets::Other => found.shadows.unclear |= 1 << ray,
                    Meets::Blocker => {
                        found.shadows.blocked |= 1 << ray;
                        found.open &= !(1 << ray);
                        found.last = LastShadow(Some(index));
                    }
                }
            }
            if found.open == 0 {
                return true;
            }
        }
        false
    }
}

/// What is known of the rays of a beam.
struct Found {
    /// Those that nothing blocks so far.
    open: u32,
    /// Of all rays.
    shadows: Shadows,
    /// Where one of these was blocked.
    last: LastShadow,
}

/// A bit for each ray.
const ALL: u32 = (1 << LANES) - 1;

/// The numbers of the bits that are set.
#[inline(always)]
fn bits(mut mask: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lane = (mask != 0).then(|| mask.trailing_zeros() as usize);
        mask &= mask.wrapping_sub(1);
        lane
    })
}

/// The inverses of directions, and a bit for each that points as that of `lane` does: into its octant, along its dominant
/// axis. A component of nearly zero would make 0 · ∞: boxes are padded by far more than is added here.
#[inline(always)]
fn alike<S: Simd<16>>(s: S, directions: &[S::Lanes; 3], lane: usize) -> ([S::Lanes; 3], u32) {
    let zero = s.splat(0.0);
    let [x, y, z] = *directions;
    let (ax, ay, az) = (s.max(x, s.sub(zero, x)), s.max(y, s.sub(zero, y)), s.max(z, s.sub(zero, z)));
    let least = s.mul(s.max(s.max(ax, ay), az), s.splat(1e-20));
    let usual = |d: S::Lanes, a: S::Lanes| s.select(s.below(a, least), least, d);
    let (x, y, z) = (usual(x, ax), usual(y, ay), usual(z, az));
    let one = s.splat(1.0);
    let inverse = [s.div(one, x), s.div(one, y), s.div(one, z)];
    // The axis as a single ray chooses it (`block::dominant`).
    let (xy, xz, yz) = (s.bits(s.below(ay, ax)), s.bits(s.below(az, ax)), s.bits(s.below(az, ay)));
    let (along_x, along_y) = (xy & xz, !xy & yz);
    let up = [s.bits(s.below(zero, x)), s.bits(s.below(zero, y)), s.bits(s.below(zero, z))];
    let same = |all: u32, bits: u32| all & if bits >> lane & 1 != 0 { bits } else { !bits };
    (inverse, [up[0], up[1], up[2], along_x, along_y].into_iter().fold(ALL, same))
}

/// Rays along one dominant axis, prepared for triangles as [`super::block::Shear`] prepares one.
struct Group<S: Simd<16>> {
    axes: [usize; 3],
    /// In the order of the axes.
    origin: [S::Lanes; 3],
    x: S::Lanes,
    y: S::Lanes,
    z: S::Lanes,
    t_min: S::Lanes,
    t_max: S::Lanes,
}

/// Where rays meet one triangle; of use where the mask has a bit.
struct TriangleHits {
    mask: u32,
    t: [f32; LANES],
    b1: [f32; LANES],
    b2: [f32; LANES],
}

impl<S: Simd<16>> Group<S> {
    /// `rays[of[l]]` for each l, whose origins and directions are also given axis by axis; `first` says along which axes.
    #[inline(always)]
    fn new(
        s: S,
        rays: &[Ray; LANES],
        of: &[usize; LANES],
        origins: &[S::Lanes; 3],
        d: &[S::Lanes; 3],
        first: usize,
    ) -> Self {
        let [kx, ky, kz] = axes(rays[first].direction);
        let limit = |of_ray: fn(&Ray) -> f32| s.load(&of.map(|l| of_ray(&rays[l])));
        Self {
            axes: [kx, ky, kz],
            origin: [origins[kx], origins[ky], origins[kz]],
            x: s.div(d[kx], d[kz]),
            y: s.div(d[ky], d[kz]),
            z: s.div(s.splat(1.0), d[kz]),
            t_min: limit(|ray| ray.t_min.max(0.0)),
            // A hit at t_max itself does not count.
            t_max: limit(|ray| ray.t_max.next_down()),
        }
    }

    /// A corner in the frames of the rays.
    #[inline(always)]
    fn sheared(&self, s: S, block: &Block, c: usize, lane: usize) -> [S::Lanes; 3] {
        let [kx, ky, kz] = self.axes;
        let corner = |k: usize| s.splat(block.corner[c][k][lane]);
        let z = s.sub(corner(kz), self.origin[2]);
        let x = s.sub(s.sub(corner(kx), self.origin[0]), s.mul(self.x, z));
        let y = s.sub(s.sub(corner(ky), self.origin[1]), s.mul(self.y, z));
        [x, y, z]
    }

    /// Where those of the rays that `open` has a bit for meet a triangle; `None` where none does.
    #[inline(always)]
    fn meet(&self, s: S, block: &Block, lane: usize, open: u32) -> Option<TriangleHits> {
        let [ax, ay, az] = self.sheared(s, block, 0, lane);
        let [bx, by, bz] = self.sheared(s, block, 1, lane);
        let [cx, cy, cz] = self.sheared(s, block, 2, lane);
        let u = s.sub(s.mul(cx, by), s.mul(cy, bx));
        let v = s.sub(s.mul(ax, cy), s.mul(ay, cx));
        let w = s.sub(s.mul(bx, ay), s.mul(by, ax));
        let zero = s.splat(0.0);
        let outside = s.and(s.below(s.min(s.min(u, v), w), zero), s.below(zero, s.max(s.max(u, v), w)));
        let on_edge = s.bits(s.or(s.or(s.equal(u, zero), s.equal(v, zero)), s.equal(w, zero))) & open;
        let determinant = s.add(s.add(u, v), w);
        let candidates = s.without(s.equal(determinant, determinant), outside);
        if s.bits(candidates) & open | on_edge == 0 {
            return None;
        }
        let r = s.div(s.splat(1.0), determinant);
        let along = s.add(s.add(s.mul(u, az), s.mul(v, bz)), s.mul(w, cz));
        let t = s.mul(s.mul(along, self.z), r);
        let inside = s.and(s.below(self.t_min, t), s.at_most(t, self.t_max));
        let mask = s.bits(s.and(candidates, inside)) & open & !on_edge;
        if mask | on_edge == 0 {
            return None;
        }
        let mut hits =
            TriangleHits { mask, t: s.store(t), b1: s.store(s.mul(v, r)), b2: s.store(s.mul(w, r)) };
        if on_edge != 0 {
            let corner = |x, y, z| [s.store(x), s.store(y), s.store(z)];
            let corners = [corner(ax, ay, az), corner(bx, by, bz), corner(cx, cy, cz)];
            let bounds = [s.store(self.t_min), s.store(self.t_max)];
            hits.add_exact(on_edge, &corners, &s.store(self.z), &bounds);
        }
        (hits.mask != 0).then_some(hits)
    }
}

impl TriangleHits {
    /// Where products of f32 do not tell the side of an edge.
    #[cold]
    #[inline(never)]
    fn add_exact(
        &mut self,
        on_edge: u32,
        corners: &[[[f32; LANES]; 3]; 3],
        z: &[f32; LANES],
        [t_min, t_max]: &[[f32; LANES]; 2],
    ) {
        for ray in bits(on_edge) {
            let [a, b, c] = corners.each_ref().map(|corner| corner.map(|lanes| f64::from(lanes[ray])));
            if let Some((t, b1, b2)) = exact(a, b, c, f64::from(z[ray]))
                && t > t_min[ray]
                && t <= t_max[ray]
            {
                self.mask |= 1 << ray;
                (self.t[ray], self.b1[ray], self.b2[ray]) = (t, b1, b2);
            }
        }
    }
}

#[cfg(test)]
#[path = "shadow_tests.rs"]
mod tests;
