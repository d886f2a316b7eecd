//! A tree over the elements with the sums of what arrived in each node: a kernel of any radius sees a
//! bounded number of clusters, however fine the mesh below it is.

use glam::Vec3;
use rayon::prelude::*;

use super::atlas::Element;
use super::bins::{Arrived, Bins};

/// Elements in a leaf at most.
const LEAF: usize = 4;

/// A cluster of elements.
#[derive(Clone, Copy, Debug, Default)]
pub struct Node {
    /// Area-weighted centroid.
    pub center: Vec3,
    /// All elements' centroids are within this distance of `center`.
    pub radius: f32,
    /// Mean normal.
    pub normal: Vec3,
    /// Largest angle between `normal` and an element's, radians; π where normals cancel.
    pub spread: f32,
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

/// The tree. The geometry stays; the sums follow the bins.
#[derive(Debug, Default)]
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
            split(elements, &mut order, 0, &mut nodes, 0);
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

    /// Elements in the tree.
    pub fn len(&self) -> usize {
        self.order.len()
    }

    /// Whether no element has an area.
    pub fn is_empty(&self) -> bool {
        self.order.is_empty()
    }

    /// Takes the sums of `bins`.
    pub fn update(&mut self, bins: &Bins) {
        self.leaf_sums =
            self.order.par_iter().map(|&e| [bins.arrived(e, false), bins.arrived(e, true)]).collect();
        let mut sums = vec![[Arrived::default(); 2]; self.nodes.len()];
        // Children stand after their parent.
        for i in (0..self.nodes.len()).rev() {
            let node = &self.nodes[i];
            let parts: Vec<[Arrived; 2]> = match node.second {
                0 => self.leaf_sums[node.first as usize..(node.first + node.count) as usize].to_vec(),
                second => vec![sums[i + 1], sums[second as usize]],
            };
            for part in parts {
                for (sum, p) in sums[i].iter_mut().zip(part) {
                    sum.flux += p.flux;
                    sum.square += p.square;
                    sum.count += p.count;
                }
            }
        }
        self.sums = sums;
    }

    /// Calls `visit` for clusters that together hold every element within `radius` of `center` whose
    /// normal, or its opposite, is within `normal_angle` (radians) of `normal`. Clusters are no wider
    /// than `resolution` (radius of their centroids), unless they are single elements. Some lie outside
    /// the radius or the cone: the caller weights them.
    pub fn visit(
        &self,
        center: Vec3,
        normal: Vec3,
        radius: f32,
        normal_angle: f32,
        resolution: f32,
        visit: &mut impl FnMut(&Cluster),
    ) {
        if self.nodes.is_empty() {
            return;
        }
        let mut stack = [0u32; 64];
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let i = stack[depth] as usize;
            let node = &self.nodes[i];
            let reach = radius + node.radius;
            if node.center.distance_squared(center) > reach * reach {
                continue;
            }
            let angle = node.normal.dot(normal).abs().min(1.0).acos();
            if angle > normal_angle + node.spread {
                continue;
            }
            // A narrow cone, so that the mean normal speaks for all.
            if node.radius <= resolution && node.spread < 0.15 {
                visit(&Cluster {
                    center: node.center,
                    normal: node.normal,
                    area: node.area,
                    arrived: self.sums[i],
                });
            } else if node.second == 0 {
                for k in node.first as usize..(node.first + node.count) as usize {
                    let (center, normal, area) = self.leaves[k];
                    visit(&Cluster { center, normal, area, arrived: self.leaf_sums[k] });
                }
            } else if depth + 2 <= stack.len() {
                stack[depth] = node.second;
                stack[depth + 1] = i as u32 + 1;
                depth += 2;
            }
        }
    }
}

/// Builds the node of `order` and those below it by halving along the longest axis.
fn split(elements: &[Element], order: &mut [u32], first: u32, nodes: &mut [Node], index: u32) {
    let at = |e: u32| elements[e as usize].position;
    let (mut low, mut high) = (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
    let (mut center, mut normal, mut area) = (Vec3::ZERO, Vec3::ZERO, 0.0f32);
    for &e in order.iter() {
        let element = &elements[e as usize];
        low = low.min(element.position);
        high = high.max(element.position);
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
    let spread = if normal == Vec3::ZERO { std::f32::consts::PI } else { cosine.clamp(-1.0, 1.0).acos() };
    let count = order.len();
    let half = count / 2;
    let below = node_count(half);
    let (node, rest) = nodes.split_at_mut(1);
    let second = if count <= LEAF { 0 } else { index + 1 + below as u32 };
    node[0] =
        Node { center, radius: radius.sqrt(), normal, spread, area, first, count: count as u32, second };
    if count <= LEAF {
        return;
    }
    let size = high - low;
    let axis = size.max_position();
    order.select_nth_unstable_by(half, |&a, &b| at(a)[axis].total_cmp(&at(b)[axis]).then(a.cmp(&b)));
    let (left, right) = order.split_at_mut(half);
    let (left_nodes, right_nodes) = rest.split_at_mut(below);
    if count > 8192 {
        rayon::join(
            || split(elements, left, first, left_nodes, index + 1),
            || split(elements, right, first + half as u32, right_nodes, second),
        );
    } else {
        split(elements, left, first, left_nodes, index + 1);
        split(elements, right, first + half as u32, right_nodes, second);
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
                    ..Element::default()
                }
            })
            .collect()
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
            tree.update(&bins);
            let (center, radius) = (Vec3::new(0.4, 0.6, 0.0), 0.3);
            let (mut inside, mut all) = (0.0, 0.0);
            tree.visit(center, Vec3::Z, radius, 0.4, 0.0, &mut |c| {
                all += c.arrived[0].count;
                if c.center.distance(center) <= radius {
                    inside += c.arrived[0].count;
                }
            });
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
        tree.update(&bins);
        let (mut area, mut clusters) = (0.0, 0);
        tree.visit(Vec3::splat(0.5), Vec3::Z, 10.0, 0.4, 0.2, &mut |c| {
            area += c.area;
            clusters += 1;
        });
        assert!((area - 1.0f32).abs() < 1e-4);
        assert!(clusters < 200, "{clusters}");
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
