//! Sixteen shadow rays at once, from neighbouring points to one light.
//!
//! What bounds all of them tells of eight boxes at once which ones any may meet (`super::beam`); of these sixteen rays at
//! once are asked, one box after the other, so that each goes only where it would go alone. Of a leaf's triangles those are
//! tested that any may meet, for all rays at once or, where few came so far, for one ray all at once. Each ray meets boxes
//! and triangles by the very operations of a single ray (`super::node`, `super::block`), so that what is found does not
//! depend on its company, to the bit. A shadow is often thrown by what threw the last one: that leaf is looked at first.

use arrayvec::ArrayVec;

use super::Ray;
use super::beam::Beam;
use super::block::{Block, LEAF, Shear, exact};
use super::level::{Vectors, Work};
use super::node::{CHILDREN, Child, FAR, Node, Slabs};
use super::packet::LANES;
use super::simd::Simd;
use super::stack::{Entry, STACK, Stack};
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
const USUAL: [f32; 2] = [1e-15, 1e15];

/// As many rays as these, or as there are boxes to be asked, are sooner there one by one: one meets eight boxes or triangles
/// at once.
const FEW: u32 = 3;

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
        let mut asked = self.lanes;
        let mut company = Company::new(v, self.rays, asked);
        let (usual, is_ray) = company.fit(v);
        if asked & usual != asked {
            // What is no ray hits nothing, as alone.
            shadows.unclear = asked & is_ray & !usual;
            asked &= usual;
            if asked == 0 {
                return shadows;
            }
            company = Company::new(v, self.rays, asked);
        }
        let before = *self.last;
        let mut found = Found { open: asked, shadows, last: LastShadow(None) };
        if company.axis.is_some() {
            self.travel::<false, V>(v, &company, before, &mut found, stack);
        } else {
            self.travel::<true, V>(v, &company, before, &mut found, stack);
        }
        shadows = found.shadows;
        if found.last.0.is_some() || shadows.blocked == 0 {
            *self.last = found.last;
        }
        shadows.unclear &= !shadows.blocked;
        shadows
    }

    #[inline(always)]
    fn travel<const MIXED: bool, V: Vectors>(
        &self,
        v: V,
        company: &Company<V>,
        before: LastShadow,
        found: &mut Found,
        stack: &mut impl Stack,
    ) {
        let (nodes, blocks) = self.wide.parts();
        let shears = Shears::new::<MIXED>(v, company);
        let bundle = Bundle::new(v, company);
        if let Some(block) = before.0 {
            let rays = found.open;
            self.leaf::<MIXED, V>(v, &shears, &bundle, (block, &blocks[block as usize]), rays, found);
            if found.open == 0 {
                return;
            }
        }
        let mut current = Entry::of_rays(found.open, Child::node(0));
        loop {
            let (rays, child) = (current.rays() & found.open, current.child());
            let mut next = None;
            if rays != 0 {
                let slots = if child.is_leaf() {
                    0
                } else {
                    bundle.meet(v, |side| Simd::<8>::load(v, &nodes[child.index()].bounds[side]))
                };
                if rays.count_ones() <= slots.count_ones().max(FEW) {
                    for ray in bits(rays) {
                        self.alone(v, ray, child, found, stack);
                    }
                } else if child.is_leaf() {
                    let index = child.index();
                    self.leaf::<MIXED, V>(v, &shears, &bundle, (index as u32, &blocks[index]), rays, found);
                } else {
                    next = self.enter(v, company, (&nodes[child.index()], slots), rays, stack);
                }
                if found.open == 0 {
                    return;
                }
            }
            let Some(entry) = next.or_else(|| stack.pop()) else { return };
            current = entry;
        }
    }

    /// Which of the children that `slots` names rays enter: the one to go on with, the others on the stack.
    #[inline(always)]
    fn enter<V: Vectors>(
        &self,
        v: V,
        company: &Company<V>,
        (node, slots): (&Node, u32),
        rays: u32,
        stack: &mut impl Stack,
    ) -> Option<Entry> {
        let mut next: Option<Entry> = None;
        for slot in bits(slots) {
            let slot = slot & (CHILDREN - 1);
            let here = company.meet(v, node, slot) & rays;
            if here == 0 {
                continue;
            }
            let entry = Entry::of_rays(here, node.child[slot]);
            // Where most go a blocker is most likely found.
            match &mut next {
                None => next = Some(entry),
                Some(next) if here.count_ones() > next.rays().count_ones() => {
                    stack.push(std::mem::replace(next, entry));
                }
                Some(_) => stack.push(entry),
            }
        }
        next
    }

    /// Tests the triangles of a leaf.
    #[inline(always)]
    fn leaf<const MIXED: bool, V: Vectors>(
        &self,
        v: V,
        shears: &Shears<V>,
        bundle: &Bundle<V>,
        (index, block): (u32, &Block),
        rays: u32,
        found: &mut Found,
    ) {
        let sides = block.bounds(v);
        for lane in bits(bundle.meet(v, |side| sides[side]) & block.used()) {
            let Some(hits) = shears.meet::<MIXED>(v, block, lane, rays & found.open) else { continue };
            for ray in bits(hits.mask) {
                let (t, triangle) = (hits.t[ray], block.index[lane]);
                self.met(ray, LeafHit { t, triangle, b1: hits.b1[ray], b2: hits.b2[ray] }, index, found);
            }
            if rays & found.open == 0 {
                return;
            }
        }
    }

    /// The way of one ray from here on, as it goes alone.
    #[inline(always)]
    fn alone<V: Vectors>(&self, v: V, ray: usize, from: Child, found: &mut Found, stack: &mut impl Stack) {
        let (nodes, blocks) = self.wide.parts();
        let Ray { origin, direction, t_min, t_max, .. } = self.rays[ray];
        let (t_min, t_max) = (t_min.max(0.0), t_max.next_down());
        let (slabs, shear) = (Slabs::new(v, origin, direction, t_min), Shear::new(v, origin, direction));
        let below = stack.len();
        let mut current = from;
        loop {
            if current.is_leaf() {
                let block = &blocks[current.index()];
                if let Some(hits) = block.intersect(v, &shear, t_min, t_max) {
                    for lane in bits(hits.mask) {
                        let lane = lane & (LEAF - 1);
                        let (t, triangle) = (hits.t[lane], block.index[lane]);
                        let hit = LeafHit { t, triangle, b1: hits.b1[lane], b2: hits.b2[lane] };
                        self.met(ray, hit, current.index() as u32, found);
                        if found.open >> ray & 1 == 0 {
                            stack.truncate(below);
                            return;
                        }
                    }
                }
            } else {
                let node = &nodes[current.index()];
                let (enter, mask) = slabs.intersect(node, t_max);
                if mask != 0 {
                    current = stack.visit::<false>(node, &enter, mask, |_| ());
                    continue;
                }
            }
            if stack.len() == below {
                return;
            }
            let Some(entry) = stack.pop() else { return };
            current = entry.child();
        }
    }

    #[inline(always)]
    fn met(&self, ray: usize, hit: LeafHit, leaf: u32, found: &mut Found) {
        match (self.meets)(ray, hit) {
            Meets::Nothing => {}
            Meets::Other => found.shadows.unclear |= 1 << ray,
            Meets::Blocker => {
                found.shadows.blocked |= 1 << ray;
                found.open &= !(1 << ray);
                found.last = LastShadow(Some(leaf));
            }
        }
    }
}

/// What is known of the rays.
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

/// The rays, axis by axis. Those that nobody asks for are copies of the first one.
struct Company<S: Simd<16>> {
    origin: [S::Lanes; 3],
    direction: [S::Lanes; 3],
    /// Never 0 or infinite: a component of nearly zero would make 0 · ∞, and boxes are padded by far more than it is moved.
    inverse: [S::Lanes; 3],
    /// A little larger, for where rays leave boxes.
    to_far: [S::Lanes; 3],
    /// Which of them point upwards along each axis.
    up: [S::Mask; 3],
    t_min: S::Lanes,
    /// The last distance that counts.
    t_max: S::Lanes,
    /// Which axis dominates each direction, as a single ray chooses it (`block::axes`): x, else y, else z.
    along: [S::Mask; 2],
    /// The one that dominates them all.
    axis: Option<usize>,
}

impl<S: Simd<16>> Company<S> {
    #[inline(always)]
    fn new(s: S, rays: &[Ray; LANES], asked: u32) -> Self {
        let first = asked.trailing_zeros() as usize & (LANES - 1);
        let (mut origins, mut directions) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
        let mut limits = [[0.0; LANES]; 2];
        for lane in 0..LANES {
            let ray = &rays[if asked >> lane & 1 != 0 { lane } else { first }];
            for axis in 0..3 {
                (origins[axis][lane], directions[axis][lane]) = (ray.origin[axis], ray.direction[axis]);
            }
            (limits[0][lane], limits[1][lane]) = (ray.t_min, ray.t_max.next_down());
        }
        let origin = [s.load(&origins[0]), s.load(&origins[1]), s.load(&origins[2])];
        let direction = [s.load(&directions[0]), s.load(&directions[1]), s.load(&directions[2])];
        let [dx, dy, dz] = direction;
        let (ax, ay, az) = (magnitude(s, dx), magnitude(s, dy), magnitude(s, dz));
        let least = s.mul(s.max(s.max(ax, ay), az), s.splat(1e-20));
        let x = s.and(s.below(ay, ax), s.below(az, ax));
        let y = s.without(s.below(az, ay), s.below(ay, ax));
        let axis = match (s.bits(x), s.bits(y)) {
            (ALL, _) => Some(0),
            (0, ALL) => Some(1),
            (0, 0) => Some(2),
            _ => None,
        };
        let [x_inverse, y_inverse, z_inverse] =
            [inverse(s, dx, ax, least), inverse(s, dy, ay, least), inverse(s, dz, az, least)];
        let (far, zero) = (s.splat(FAR), s.splat(0.0));
        Self {
            origin,
            direction,
            inverse: [x_inverse, y_inverse, z_inverse],
            to_far: [s.mul(x_inverse, far), s.mul(y_inverse, far), s.mul(z_inverse, far)],
            up: [s.below(zero, x_inverse), s.below(zero, y_inverse), s.below(zero, z_inverse)],
            t_min: s.max(s.load(&limits[0]), zero),
            // What is not a number lets nothing count.
            t_max: s.max(s.load(&limits[1]), s.splat(-1.0)),
            along: [x, y],
            axis,
        }
    }

    /// A bit for each ray whose numbers allow it to go along, and for each that is a ray at all.
    #[inline(always)]
    fn fit(&self, s: S) -> (u32, u32) {
        let [x, y, z] = self.direction;
        let (x, y, z) = (magnitude(s, x), magnitude(s, y), magnitude(s, z));
        let largest = s.max(s.max(x, y), z);
        // What is not a number has no magnitude that is at most anything.
        let finite = |a: S::Lanes| s.bits(s.at_most(a, s.splat(f32::MAX)));
        let [ox, oy, oz] = self.origin;
        let (ox, oy, oz) = (magnitude(s, ox), magnitude(s, oy), magnitude(s, oz));
        let all = finite(x) & finite(y) & finite(z) & finite(ox) & finite(oy) & finite(oz);
        let usual = s.and(s.at_most(s.splat(USUAL[0]), largest), s.at_most(largest, s.splat(USUAL[1])));
        (all & s.bits(usual), all & s.bits(s.below(s.splat(0.0), largest)))
    }

    /// A bit for each ray that meets the box of a child, where it counts.
    #[inline(always)]
    fn meet(&self, s: S, node: &Node, slot: usize) -> u32 {
        let (mut enter, mut leave) = (self.t_min, self.t_max);
        for axis in 0..3 {
            let (low, high) = (s.splat(node.bounds[axis][slot]), s.splat(node.bounds[axis + 3][slot]));
            let from = self.origin[axis];
            let near = s.sub(s.select(self.up[axis], low, high), from);
            let far = s.sub(s.select(self.up[axis], high, low), from);
            enter = s.max(s.mul(near, self.inverse[axis]), enter);
            leave = s.min(s.mul(far, self.to_far[axis]), leave);
        }
        s.bits(s.at_most(enter, leave))
    }
}

#[inline(always)]
fn inverse<S: Simd<16>>(s: S, d: S::Lanes, magnitude: S::Lanes, least: S::Lanes) -> S::Lanes {
    s.div(s.splat(1.0), s.select(s.below(magnitude, least), least, d))
}

#[inline(always)]
fn magnitude<S: Simd<16>>(s: S, a: S::Lanes) -> S::Lanes {
    s.max(a, s.sub(s.splat(0.0), a))
}

/// What bounds all of the rays, for eight boxes at once.
struct Bundle<E: Simd<8>> {
    beam: Beam<E>,
    /// The box around all of them, where they do not point into one octant.
    around: Option<[E::Lanes; 6]>,
    farthest: f32,
}

impl<V: Vectors> Bundle<V> {
    #[inline(always)]
    fn new(v: V, company: &Company<V>) -> Self {
        let farthest = Simd::<16>::most(v, company.t_max);
        let beam = Beam::from_points(v, &company.origin, &company.inverse);
        let mut around = None;
        if !beam.is_bounded {
            let mut sides = [Simd::<8>::splat(v, 0.0); 6];
            for axis in 0..3 {
                let (from, way) = (company.origin[axis], company.direction[axis]);
                let to = Simd::<16>::add(v, from, Simd::<16>::mul(v, way, company.t_max));
                let (low, high) = (Simd::<16>::min(v, to, from), Simd::<16>::max(v, to, from));
                let (low, high) = (Simd::<16>::least(v, low), Simd::<16>::most(v, high));
                let rounding = 4.0 * f32::EPSILON * low.abs().max(high.abs());
                sides[axis] = Simd::<8>::splat(v, low - rounding);
                sides[axis + 3] = Simd::<8>::splat(v, high + rounding);
            }
            around = Some(sides);
        }
        Self { beam, around, farthest }
    }

    /// A bit for each box that any ray may meet. `side` gives their lower x, y, z and then their upper ones.
    #[inline(always)]
    fn meet(&self, v: V, side: impl Fn(usize) -> <V as Simd<8>>::Lanes) -> u32 {
        let (_, mut met) = self.beam.meet(v, &side, self.farthest);
        if let Some(around) = &self.around {
            for axis in 0..3 {
                let begins = Simd::<8>::at_most(v, side(axis), around[axis + 3]);
                let ends = Simd::<8>::at_most(v, around[axis], side(axis + 3));
                met &= Simd::<8>::bits(v, Simd::<8>::and(v, begins, ends));
            }
        }
        met
    }
}

/// Rays prepared for triangles as [`Shear`] prepares one.
struct Shears<S: Simd<16>> {
    axes: [usize; 3],
    along: [S::Mask; 2],
    /// In the order of the axes of each.
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

impl<S: Simd<16>> Shears<S> {
    /// `MIXED`: whether the rays differ in their dominant axis. Which of the two other axes comes first does not matter to a
    /// bit: all of what follows changes its sign, twice.
    #[inline(always)]
    fn new<const MIXED: bool>(s: S, company: &Company<S>) -> Self {
        let kz = company.axis.unwrap_or(2);
        let mut shears = Self {
            axes: [(kz + 1) % 3, (kz + 2) % 3, kz],
            along: company.along,
            origin: [company.t_min; 3],
            x: company.t_min,
            y: company.t_min,
            z: company.t_min,
            t_min: company.t_min,
            t_max: company.t_max,
        };
        shears.origin = shears.in_order::<MIXED>(s, company.origin);
        let [x, y, z] = shears.in_order::<MIXED>(s, company.direction);
        (shears.x, shears.y, shears.z) = (s.div(x, z), s.div(y, z), s.div(s.splat(1.0), z));
        shears
    }

    /// Coordinates in the order of the axes of each ray.
    #[inline(always)]
    fn in_order<const MIXED: bool>(&self, s: S, of: [S::Lanes; 3]) -> [S::Lanes; 3] {
        if MIXED {
            let [x, y, z] = of;
            let [along_x, along_y] = self.along;
            [
                s.select(along_x, y, s.select(along_y, z, x)),
                s.select(along_x, z, s.select(along_y, x, y)),
                s.select(along_x, x, s.select(along_y, y, z)),
            ]
        } else {
            let [kx, ky, kz] = self.axes;
            [of[kx], of[ky], of[kz]]
        }
    }

    /// A corner in the frames of the rays.
    #[inline(always)]
    fn sheared<const MIXED: bool>(&self, s: S, block: &Block, c: usize, lane: usize) -> [S::Lanes; 3] {
        let [x, y, z] = if MIXED {
            let [x, y, z] = &block.corner[c];
            self.in_order::<MIXED>(s, [s.splat(x[lane]), s.splat(y[lane]), s.splat(z[lane])])
        } else {
            let [kx, ky, kz] = self.axes;
            let of = &block.corner[c];
            [s.splat(of[kx][lane]), s.splat(of[ky][lane]), s.splat(of[kz][lane])]
        };
        let z = s.sub(z, self.origin[2]);
        let x = s.sub(s.sub(x, self.origin[0]), s.mul(self.x, z));
        let y = s.sub(s.sub(y, self.origin[1]), s.mul(self.y, z));
        [x, y, z]
    }

    /// Where those of the rays that `open` has a bit for meet a triangle; `None` where none does.
    #[inline(always)]
    fn meet<const MIXED: bool>(&self, s: S, block: &Block, lane: usize, open: u32) -> Option<TriangleHits> {
        let [ax, ay, az] = self.sheared::<MIXED>(s, block, 0, lane);
        let [bx, by, bz] = self.sheared::<MIXED>(s, block, 1, lane);
        let [cx, cy, cz] = self.sheared::<MIXED>(s, block, 2, lane);
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
