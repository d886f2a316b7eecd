//! Sixteen shadow rays at once, from neighbouring points to one light.
//!
//! What bounds all of them tells of eight boxes at once which ones any may meet (`super::beam`); of these sixteen rays at
//! once are asked, one box after the other, so that each goes only where it would go alone. Of a leaf's triangles those are
//! tested that any may meet, for all rays at once or, where few came so far, for one ray all at once. Each ray meets boxes
//! and triangles by the very operations of a single ray (`super::node`, `super::block`), so that what is found does not
//! depend on its company, to the bit. A shadow is often thrown by what threw the last one: that leaf is looked at first.

use arrayvec::ArrayVec;

use super::Ray;
use super::block::{Block, LEAF, Shear};
use super::company::{Bundle, Company, Shears, bits};
use super::level::{Vectors, Work};
use super::node::{CHILDREN, Child, Node, Slabs};
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

#[cfg(test)]
#[path = "shadow_tests.rs"]
mod tests;
