//! A tree over the elements with the sums of what arrived in each node: a kernel of any radius sees a
//! bounded number of clusters, however fine the mesh below it is.

use glam::Vec3;
use rayon::prelude::*;

use super::atlas::Element;
use super::bins::{Arrived, Bins};

use crate::math;

/// Elements in a leaf at most.
const LEAF: usize = 4;
/// A difference of normals of 1 counts like a distance of this share of the scene's size, so that clusters as
/// large as a kernel resolves have narrow normals (compare Walter et al. 2005, Lightcuts).
const NORMAL_SCALE: f32 = 0.08;

/// A cluster of elements.
#[derive(Clone, Copy, Debug, Default)]
pub struct Node {
    /// Area-weighted centroid.
    pub center: Vec3,
    /// All elements' centroids are within this distance of `center`.
    pub radius: f32,
    /// Mean normal.
    pub normal: Vec3,
    /// Cosine of the largest angle between `normal` and an element's; −1 where normals cancel.
    pub cosine: f32,
    /// Its sine.
    pub sine: f32,
    /// Sum of areas.
    pub area: f32,
    /// First element in `order`.
    first: u32,
    /// Elements.
    count: u32,
    /// Index of the second child; the first follows its parent. 0 for a leaf.
    second: u32,
}

/// What a query is given: an element or a whole cluster.
#[derive(Clone, Copy, Debug)]
pub struct Cluster {
    /// Centroid.
    pub center: Vec3,
    /// Normal of the front.
    pub normal: Vec3,
    /// Area.
    pub area: f32,
    /// What arrived on the front and on the back.
    pub arrived: [Arrived; 2],
}

/// How far a node extends.
#[derive(Clone, Copy, Debug)]
pub struct Extent {
    /// Its middle.
    pub center: Element,
    /// All centroids are within this distance of it.
    pub reach: f32,
    /// All normals are within the angle of this cosine of its own.
    pub cosine: f32,
}

impl Extent {
    /// That of a single element.
    pub fn of(element: &Element) -> Self {
        Self { center: *element, reach: 0.0, cosine: 1.0 }
    }

    /// The largest angle between its normal and an element's, radians.
    pub fn spread(&self) -> f32 {
        math::acos(self.cosine.clamp(-1.0, 1.0))
    }
}

/// A cluster in the tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClusterIndex {
    /// All elements of a node.
    Node(u32),
    /// The element at this place of the order.
    Leaf(u32),
}

/// What clusters are wanted.
#[derive(Clone, Copy, Debug)]
pub struct Query {
    /// Middle of the sphere in which elements are wanted.
    pub center: Vec3,
    /// Normal of the surface asked for, or its opposite.
    pub normal: Vec3,
    /// Radius of the sphere.
    pub radius: f32,
    /// Elements whose normals are within this angle of `normal` or its opposite are wanted, radians.
    pub normal_angle: f32,
    /// Elements are wanted up to a height of `height` + `slope` × distance over the plane of `center`.
    pub slope: f32,
    /// See `slope`.
    pub height: f32,
    /// Clusters are no wider than this (radius of their centroids), unless they are single elements.
    pub resolution: f32,
    /// Cosine of the angle within which the mean normal of a cluster speaks for all of it.
    pub narrow: f32,
}

/// The tree. The geometry stays; the sums follow the bins.
#[derive(Clone, Debug, Default)]
pub struct ClusterTree {
    order: Vec<u32>,
    nodes: Vec<Node>,
    leaves: Vec<(Vec3, Vec3, f32)>,
    leaf_sums: Vec<[Arrived; 2]>,
    sums: Vec<[Arrived; 2]>,
}

/// Nodes of the tree over `n` elements. Halving leaves only two sizes per level, `small` and `small` + 1.
fn node_count(n: usize) -> usize {
    if n == 0 {
        return 0;
    }
    let (mut small, mut smaller, mut larger) = (n, 1, 0);
    let mut nodes = 1;
    while small > LEAF {
        (smaller, larger) = if small.is_multiple_of(2) {
            (2 * smaller + larger, larger)
        } else {
            (smaller, smaller + 2 * larger)
        };
        small /= 2;
        nodes += smaller + larger;
    }
    if small == LEAF { nodes + 2 * larger } else { nodes }
}

impl ClusterTree {
    /// A tree over the elements that have an area.
    pub fn build(elements: &[Element]) -> Self {
        Self::build_where(elements, &|_| true)
    }

    /// A tree over those of them that `counts` accepts.
    pub fn build_where(elements: &[Element], counts: &dyn Fn(u32) -> bool) -> Self {
        let mut order: Vec<u32> =
            (0..elements.len() as u32).filter(|&e| elements[e as usize].area > 0.0 && counts(e)).collect();
        let mut nodes = vec![Node::default(); node_count(order.len())];
        if !order.is_empty() {
            let (low, high) = order
                .iter()
                .map(|&e| elements[e as usize].position)
                .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)));
            split(elements, &mut order, 0, &mut nodes, 0, NORMAL_SCALE * low.distance(high));
        }
        let leaves = order
            .iter()
            .map(|&e| {
                let e = &elements[e as usize];
                (e.position, e.normal, e.area)
            })
            .collect();
        Self { order, nodes, leaves, leaf_sums: Vec::new(), sums: Vec::new() }
    }

    /// The elements in the order of the tree: neighbours on surfaces are near each other.
    pub fn order(&self) -> &[u32] {
        &self.order
    }

    /// Runs of neighbours of about `size` elements in the order of the tree, each as the node that holds them.
    pub fn subtrees(&self, size: u32) -> Vec<u32> {
        if self.nodes.is_empty() { Vec::new() } else { self.subtrees_of(0, size) }
    }

    /// The same below the node `root`.
    pub fn subtrees_of(&self, root: u32, size: u32) -> Vec<u32> {
        let mut found = Vec::new();
        let mut open = vec![root];
        while let Some(i) = open.pop() {
            let node = &self.nodes[i as usize];
            if node.count <= size || node.second == 0 {
                found.push(i);
            } else {
                open.extend([node.second, i + 1]);
            }
        }
        found
    }

    /// A node as one element, with the mean area of its elements.
    pub fn as_element(&self, i: u32) -> Extent {
        let node = &self.nodes[i as usize];
        let area = node.area / node.count as f32;
        let center = Element { position: node.center, normal: node.normal, area, ..Element::default() };
        Extent { center, reach: node.radius, cosine: node.cosine }
    }

    /// The two halves of a node; `None` for a leaf.
    pub fn halves(&self, i: u32) -> Option<[u32; 2]> {
        let second = self.nodes[i as usize].second;
        (second != 0).then_some([i + 1, second])
    }

    /// What arrived at one side of the elements of a node, and their area.
    pub fn sums(&self, i: u32, side: usize) -> (Arrived, f32) {
        (self.sums[i as usize][side], self.nodes[i as usize].area)
    }

    /// The elements of a node, as a range of the order.
    pub fn range(&self, i: u32) -> std::ops::Range<usize> {
        let node = &self.nodes[i as usize];
        node.first as usize..(node.first + node.count) as usize
    }

    /// Elements in the tree.
    pub fn len(&self) -> usize {
        self.order.len()
    }

    /// Whether no element has an area.
    pub fn is_empty(&self) -> bool {
        self.order.is_empty()
    }

    /// Takes the sums of `bins`, of these elements.
    pub fn update(&mut self, elements: &[Element], bins: &Bins) {
        let area = |e: u32| elements[e as usize].opaque;
        let arrived = |e: u32, back: bool| Arrived { area: area(e), ..bins.arrived(e, back) };
        self.update_with(&|e| [arrived(e, false), arrived(e, true)], &|_| [true; 2]);
    }

    /// Takes what `arrived` at the two sides of each element, and on which area. Sides that are not `open` have no
    /// area and count for nothing: the inner ones of closed bodies, which would darken whatever they touch.
    pub fn update_with(
        &mut self,
        arrived: &(dyn Fn(u32) -> [Arrived; 2] + Sync),
        open: &(dyn Fn(u32) -> [bool; 2] + Sync),
    ) {
        let of = |&e: &u32| {
            let (sides, open) = (arrived(e), open(e));
            [0, 1].map(|side| if open[side] { sides[side] } else { Arrived::default() })
        };
        self.leaf_sums = self.order.par_iter().map(of).collect();
        let mut sums = vec![[Arrived::default(); 2]; self.nodes.len()];
        if !sums.is_empty() {
            sum_up(&self.nodes, &self.leaf_sums, 0, &mut sums);
        }
        self.sums = sums;
    }

    /// Finds at most `most` clusters that together hold every element that `query` asks for; `false` if there are more, or
    /// if that takes more than `visits` nodes. Some lie outside: the caller weights them.
    pub fn collect(
        &self,
        query: &Query,
        most: usize,
        mut visits: usize,
        found: &mut Vec<ClusterIndex>,
    ) -> bool {
        found.clear();
        if self.nodes.is_empty() {
            return true;
        }
        let mut stack = [0u32; 64];
        let mut depth = 1;
        let (sin_angle, cos_angle) = math::sin_cos(query.normal_angle);
        while depth > 0 {
            depth -= 1;
            if visits == 0 {
                return false;
            }
            visits -= 1;
            let i = stack[depth];
            let node = &self.nodes[i as usize];
            let offset = node.center - query.center;
            let reach = query.radius + node.radius;
            let squared = offset.length_squared();
            if squared > reach * reach {
                continue;
            }
            // Outside the cone even if widened by the spread: cos x < cos(a + b), as long as a + b < π/2.
            let limit = cos_angle * node.cosine - sin_angle * node.sine;
            if node.cosine > 0.0 && node.normal.dot(query.normal).abs() < limit {
                continue;
            }
            // Above or below the slab that a bending surface stays in, with all of its elements.
            let above = offset.dot(query.normal).abs() - node.radius - query.height;
            if above > 0.0 && above > query.slope * (squared.sqrt() + node.radius) {
                continue;
            }
            if node.radius <= query.resolution && node.cosine > query.narrow {
                if found.len() >= most {
                    return false;
                }
                found.push(ClusterIndex::Node(i));
            } else if node.second == 0 {
                if found.len() + node.count as usize > most {
                    return false;
                }
                found.extend((node.first..node.first + node.count).map(ClusterIndex::Leaf));
            } else if depth + 2 <= stack.len() {
                stack[depth] = node.second;
                stack[depth + 1] = i + 1;
                depth += 2;
            }
        }
        true
    }

    /// A cluster that was found.
    #[inline]
    pub fn cluster(&self, index: ClusterIndex) -> Cluster {
        match index {
            ClusterIndex::Node(i) => {
                let node = &self.nodes[i as usize];
                let (center, normal, area) = (node.center, node.normal, node.area);
                Cluster { center, normal, area, arrived: self.sums[i as usize] }
            }
            ClusterIndex::Leaf(k) => {
                let (center, normal, area) = self.leaves[k as usize];
                Cluster { center, normal, area, arrived: self.leaf_sums[k as usize] }
            }
        }
    }
}

/// Sums of node `index` and those below it, which stand behind it: the first of `sums` is that of the node.
fn sum_up(nodes: &[Node], leaves: &[[Arrived; 2]], index: usize, sums: &mut [[Arrived; 2]]) {
    let add = |sum: &mut [Arrived; 2], parts: &[[Arrived; 2]]| {
        for part in parts {
            for (sum, p) in sum.iter_mut().zip(part) {
                sum.flux += p.flux;
                sum.square += p.square;
                sum.count += p.count;
                sum.area += p.area;
            }
        }
    };
    let node = &nodes[index];
    let (own, below) = sums.split_at_mut(1);
    if node.second == 0 {
        return add(&mut own[0], &leaves[node.first as usize..(node.first + node.count) as usize]);
    }
    let second = node.second as usize;
    let (left, right) = below.split_at_mut(second - index - 1);
    let right = &mut right[..node_count(node.count as usize - node.count as usize / 2)];
    let mut sum_left = || sum_up(nodes, leaves, index + 1, left);
    let mut sum_right = || sum_up(nodes, leaves, second, right);
    if node.count > 8192 {
        rayon::join(sum_left, sum_right);
    } else {
        sum_left();
        sum_right();
    }
    add(&mut own[0], &[left[0], right[0]]);
}

/// Builds the node of `order` and those below it by halving along the longest axis.
fn split(elements: &[Element], order: &mut [u32], first: u32, nodes: &mut [Node], index: u32, scale: f32) {
    let at = |e: u32| elements[e as usize].position;
    let facing = |e: u32| elements[e as usize].normal;
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let (mut low_normal, mut high_normal) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let (mut center, mut normal, mut area) = (Vec3::ZERO, Vec3::ZERO, 0.0f32);
    for &e in order.iter() {
        let element = &elements[e as usize];
        low = low.min(element.position);
        high = high.max(element.position);
        low_normal = low_normal.min(element.normal);
        high_normal = high_normal.max(element.normal);
        center += element.area * element.position;
        normal += element.area * element.normal;
        area += element.area;
    }
    center /= area;
    let normal = normal.normalize_or_zero();
    let (mut radius, mut cosine) = (0.0f32, 1.0f32);
    for &e in order.iter() {
        radius = radius.max(at(e).distance_squared(center));
        cosine = cosine.min(elements[e as usize].normal.dot(normal));
    }
    let cosine = if normal == Vec3::ZERO { -1.0 } else { cosine.clamp(-1.0, 1.0) };
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    let count = order.len();
    let half = count / 2;
    let below = node_count(half);
    let (node, rest) = nodes.split_at_mut(1);
    let second = if count <= LEAF { 0 } else { index + 1 + below as u32 };
    node[0] = Node {
        center,
        radius: radius.sqrt(),
        normal,
        cosine,
        sine,
        area,
        first,
        count: count as u32,
        second,
    };
    if count <= LEAF {
        return;
    }
    let (size, size_normal) = (high - low, scale * (high_normal - low_normal));
    let by_normal = size_normal.max_element() > size.max_element();
    let axis = if by_normal { size_normal.max_position() } else { size.max_position() };
    let along = |e: u32| if by_normal { facing(e)[axis] } else { at(e)[axis] };
    order.select_nth_unstable_by(half, |&a, &b| along(a).total_cmp(&along(b)).then(a.cmp(&b)));
    let (left, right) = order.split_at_mut(half);
    let (left_nodes, right_nodes) = rest.split_at_mut(below);
    let mut split_left = || split(elements, left, first, left_nodes, index + 1, scale);
    let mut split_right = || split(elements, right, first + half as u32, right_nodes, second, scale);
    if count > 8192 {
        rayon::join(split_left, split_right);
    } else {
        split_left();
        split_right();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn elements(n: u32) -> Vec<Element> {
        (0..n)
            .map(|i| {
                let mut s = crate::rng::Stream::new(3, u64::from(i), 0);
                let [x, y] = s.next_2d();
                let flipped = i % 3 == 0;
                Element {
                    position: Vec3::new(x, y, 0.0),
                    normal: if flipped { Vec3::NEG_Z } else { Vec3::Z },
                    area: 1.0 / n as f32,
                    opaque: 1.0 / n as f32,
                    ..Element::default()
                }
            })
            .collect()
    }

    fn query(center: Vec3, radius: f32, resolution: f32) -> Query {
        let (normal_angle, slope, height, narrow) = (0.4, 0.25, 0.0, 0.97);
        Query { center, normal: Vec3::Z, radius, normal_angle, slope, height, resolution, narrow }
    }

    #[test]
    fn a_query_sees_every_element_in_reach_exactly_once() {
        for n in [0, 1, 4, 5, 77, 3000] {
            let elements = elements(n);
            let mut tree = ClusterTree::build(&elements);
            let bins = Bins::new(elements.len(), 1.0);
            for e in 0..n {
                bins.add(e, false, Vec3::ONE);
            }
            tree.update(&elements, &bins);
            let (center, radius) = (Vec3::new(0.4, 0.6, 0.0), 0.3);
            let (mut inside, mut all) = (0.0, 0.0);
            let mut found = Vec::new();
            assert!(tree.collect(&query(center, radius, 0.0), usize::MAX, usize::MAX, &mut found));
            for c in found.iter().map(|&i| tree.cluster(i)) {
                all += c.arrived[0].count;
                if c.center.distance(center) <= radius {
                    inside += c.arrived[0].count;
                }
            }
            let exact = elements.iter().filter(|e| e.position.distance(center) <= radius).count();
            assert_eq!(inside, exact as f32, "{n}");
            assert!(all >= inside);
        }
    }

    #[test]
    fn coarse_queries_need_few_clusters_and_keep_the_sum() {
        let mut flat = elements(20_000);
        for e in &mut flat {
            e.normal = Vec3::Z;
        }
        let mut tree = ClusterTree::build(&flat);
        let bins = Bins::new(flat.len(), 1.0);
        tree.update(&flat, &bins);
        let mut found = Vec::new();
        let middle = Vec3::new(0.5, 0.5, 0.0);
        assert!(tree.collect(&query(middle, 10.0, 0.2), usize::MAX, usize::MAX, &mut found));
        let area: f32 = found.iter().map(|&i| tree.cluster(i).area).sum();
        assert!((area - 1.0f32).abs() < 1e-4);
        assert!(found.len() < 200, "{}", found.len());
        let many = query(middle, 10.0, 0.0);
        assert!(!tree.collect(&many, 10, usize::MAX, &mut found) && found.len() <= 10);
        assert!(!tree.collect(&many, usize::MAX, 1000, &mut found) && found.len() <= 4000);
    }

    #[test]
    fn the_number_of_nodes_is_known_beforehand() {
        for n in 1..200 {
            let tree = ClusterTree::build(&elements(n));
            assert!(tree.nodes.iter().all(|node| node.count > 0), "{n}");
            assert_eq!(tree.len(), n as usize);
        }
    }
}
