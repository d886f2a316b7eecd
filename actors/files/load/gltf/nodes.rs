//! The graph of nodes: what a scene shows, and where.

use glam::{DMat3, DMat4, DVec3};

use super::animation::Moved;
use super::document::{Document, Node};
use super::number::Index;
use super::{Problem, get};

/// Levels of nodes.
const DEPTH_MAX: usize = 4096;

/// A node of the shown scene.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placed {
    pub node: usize,
    /// World from the node's own space.
    pub world: DMat4,
}

/// The nodes of a scene in the order of the document, parents before children, each as `moved` says.
pub(super) fn placed(
    document: &Document,
    roots: &[Index],
    moved: impl Fn(usize) -> Moved,
) -> Result<Vec<Placed>, Problem> {
    check(document)?;
    let mut order = Vec::new();
    let mut seen = vec![false; document.nodes.len()];
    let mut stack: Vec<(usize, DMat4, usize)> = Vec::new();
    for root in roots.iter().rev() {
        get(&document.nodes, *root, "nodes")?;
        stack.push((root.at(), DMat4::IDENTITY, 1));
    }
    while let Some((index, above, depth)) = stack.pop() {
        // A root that is a child as well, or is named twice, is shown once.
        if std::mem::replace(&mut seen[index], true) {
            continue;
        }
        if depth > DEPTH_MAX {
            let message = format!("lies below {DEPTH_MAX} other nodes; flatten the file");
            return Err(Problem::new(format!("/nodes/{index}"), message));
        }
        let node = &document.nodes[index];
        if node.extensions.as_ref().is_some_and(|e| e.visibility.as_ref().is_some_and(|v| !v.visible)) {
            continue;
        }
        let world = above * local(node, &moved(index));
        order.push(Placed { node: index, world });
        for child in node.children.iter().rev() {
            stack.push((child.at(), world, depth + 1));
        }
    }
    Ok(order)
}

/// Every node has at most one parent, and none is above itself.
fn check(document: &Document) -> Result<(), Problem> {
    let mut parent = vec![u32::MAX; document.nodes.len()];
    for (i, node) in document.nodes.iter().enumerate() {
        for child in node.children.iter() {
            let at = || format!("/nodes/{i}/children");
            if child.at() >= parent.len() {
                return Err(Problem::new(at(), format!("names node {}, which does not exist", child.0)));
            }
            let slot = &mut parent[child.at()];
            if *slot != u32::MAX {
                let message =
                    format!("node {} is a child of {slot} and of {i}; a node has one parent", child.0);
                return Err(Problem::new(at(), message));
            }
            *slot = i as u32;
        }
    }
    // With one parent each, a walk upwards ends or goes round; what was walked before is not walked again.
    let mut ends = vec![0u32; parent.len()];
    for start in 0..parent.len() {
        let mut at = start;
        let mark = start as u32 + 1;
        while ends[at] == 0 {
            ends[at] = mark;
            if parent[at] == u32::MAX {
                break;
            }
            at = parent[at] as usize;
            if ends[at] == mark {
                let message = "is above itself; break the circle".to_owned();
                return Err(Problem::new(format!("/nodes/{at}"), message));
            }
        }
    }
    Ok(())
}

/// Rotation by a quaternion (x, y, z, w) of any length; none where it has no length.
pub(super) fn rotation(q: [f32; 4]) -> DMat3 {
    let [x, y, z, w] = q.map(f64::from);
    let length2 = x * x + y * y + z * z + w * w;
    if !(length2 > 0.0 && length2.is_finite()) {
        return DMat3::IDENTITY;
    }
    let s = 2.0 / length2;
    DMat3::from_cols(
        DVec3::new(1.0 - s * (y * y + z * z), s * (x * y + z * w), s * (x * z - y * w)),
        DVec3::new(s * (x * y - z * w), 1.0 - s * (x * x + z * z), s * (y * z + x * w)),
        DVec3::new(s * (x * z + y * w), s * (y * z - x * w), 1.0 - s * (x * x + y * y)),
    )
}

/// T · R · S.
pub(super) fn transform(translation: [f32; 3], turn: [f32; 4], scale: [f32; 3]) -> DMat4 {
    let r = rotation(turn);
    let [sx, sy, sz] = scale.map(f64::from);
    let [x, y, z] = translation.map(f64::from);
    let axes = DMat3::from_cols(r.x_axis * sx, r.y_axis * sy, r.z_axis * sz);
    DMat4::from_cols(
        axes.x_axis.extend(0.0),
        axes.y_axis.extend(0.0),
        axes.z_axis.extend(0.0),
        DVec3::new(x, y, z).extend(1.0),
    )
}

/// A node's own transform; what is moved takes the place of what the node says.
fn local(node: &Node, moved: &Moved) -> DMat4 {
    match &node.matrix {
        Some(m) if *moved == Moved::default() => DMat4::from_cols_array(&m.map(f64::from)),
        _ => transform(
            moved.translation.or(node.translation).unwrap_or([0.0; 3]),
            moved.rotation.or(node.rotation).unwrap_or([0.0, 0.0, 0.0, 1.0]),
            moved.scale.or(node.scale).unwrap_or([1.0; 3]),
        ),
    }
}

/// The nodes above each of some nodes and the node itself, the highest first. The graph was checked by [`placed`].
pub(super) fn chains(document: &Document, of: &[usize]) -> Vec<Vec<usize>> {
    let mut parent = vec![usize::MAX; document.nodes.len()];
    for (i, node) in document.nodes.iter().enumerate() {
        node.children.iter().for_each(|c| parent[c.at()] = i);
    }
    let chain = |&node: &usize| {
        let mut chain: Vec<usize> =
            std::iter::successors(Some(node), |&n| Some(parent[n]).filter(|&p| p != usize::MAX)).collect();
        chain.reverse();
        chain
    };
    of.iter().map(chain).collect()
}

/// World from the space of the last node of a chain.
pub(super) fn world(document: &Document, chain: &[usize], moved: impl Fn(usize) -> Moved) -> DMat4 {
    chain.iter().fold(DMat4::IDENTITY, |above, &n| above * local(&document.nodes[n], &moved(n)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn still(_: usize) -> Moved {
        Moved::default()
    }

    fn document(nodes: &str) -> Document {
        serde_json::from_str(&format!("{{\"asset\": {{\"version\": \"2.0\"}}, \"nodes\": [{nodes}]}}"))
            .unwrap()
    }

    fn children(lists: &[&[usize]]) -> Document {
        let nodes: Vec<String> = lists.iter().map(|l| format!("{{\"children\": {l:?}}}")).collect();
        document(&nodes.join(","))
    }

    #[test]
    fn a_turn_of_90_degrees_about_y_takes_z_to_x() {
        let h = 0.5f32.sqrt();
        let turned = rotation([0.0, h, 0.0, h]) * DVec3::Z;
        assert!((turned - DVec3::X).length() < 1e-7, "{turned}");
        assert_eq!(rotation([0.0; 4]), DMat3::IDENTITY);
        let m = transform([1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 1.0], [2.0, 3.0, 4.0]);
        assert_eq!(m.transform_point3(DVec3::ONE), DVec3::new(3.0, 5.0, 7.0));
    }

    #[test]
    fn transforms_add_up_from_the_root() {
        let d = document("{\"translation\": [1, 0, 0], \"children\": [1]}, {\"scale\": [2, 2, 2]}");
        let found = placed(&d, &[Index(0)], still).unwrap();
        assert_eq!(found.len(), 2);
        assert_eq!(found[1].world.transform_point3(DVec3::ONE), DVec3::new(3.0, 2.0, 2.0));
    }

    #[test]
    fn circles_lattices_and_deep_chains_end_with_a_message() {
        let refused = |d: &Document| placed(d, &[Index(0)], still).unwrap_err();
        assert!(refused(&children(&[&[1], &[2], &[1]])).message.contains("one parent"));
        assert!(refused(&children(&[&[], &[2], &[3], &[1]])).message.contains("above itself"));
        assert!(refused(&children(&[&[0]])).message.contains("above itself"));
        assert!(refused(&children(&[&[1, 1], &[]])).message.contains("one parent"));
        assert!(refused(&children(&[&[7]])).message.contains("does not exist"));
        // 2⁴⁰ paths from root to leaf.
        let lattice: Vec<Vec<usize>> =
            (0..80).map(|i| if i < 78 { vec![i / 2 * 2 + 2, i / 2 * 2 + 3] } else { vec![] }).collect();
        let lists: Vec<&[usize]> = lattice.iter().map(Vec::as_slice).collect();
        assert!(refused(&children(&lists)).message.contains("one parent"));
        let chain: Vec<Vec<usize>> = (1..=DEPTH_MAX + 1).map(|i| vec![i]).chain([vec![]]).collect();
        let lists: Vec<&[usize]> = chain.iter().map(Vec::as_slice).collect();
        assert!(refused(&children(&lists)).message.contains("flatten"));
        assert_eq!(
            placed(&children(&lists[2..].iter().map(|_| &[][..]).collect::<Vec<_>>()), &[], still)
                .unwrap()
                .len(),
            0
        );
    }
}
