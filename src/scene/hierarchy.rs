//! Objects: groups of triangles of one material in one neighbourhood (Haber 2001 §4.1, after Haber,
//! Stamminger & Seidel 2000; REFERENCE §10). All diffuse triangles share object 0.

use std::collections::HashMap;

use glam::Vec3;
use rayon::prelude::*;

use super::{Material, MaterialId, Mesh, Object, TriangleIndex};

/// Vertices closer than this part of the scene's diagonal are one (REFERENCE §10).
const WELD: f32 = 1e-5;

/// Parts merge while their gap is below this part of the smaller one's diagonal (REFERENCE §10).
const GAP: f32 = 0.25;

/// Parts merge while the surface of the common bounds is at most this times the sum (REFERENCE §10).
const GROWTH: f32 = 1.5;

/// Groups that fill less than this part of the surface of their bounds are split (REFERENCE §10,
/// with surface for area on the screen, which is not known here).
const FILL: f32 = 0.1;

/// Neighbours along the Morton curve that a part is compared with (Meister & Bittner 2018 use 8–100).
const WINDOW: usize = 12;

/// The objects of a mesh.
#[derive(Clone, Debug)]
pub struct Grouping {
    /// Index 0 is everything diffuse.
    pub objects: Vec<Object>,
    /// Object of each triangle.
    pub of_triangle: Vec<u32>,
}

/// Bounds, surface area and triangles of a part.
#[derive(Clone, Debug)]
struct Cluster {
    low: Vec3,
    high: Vec3,
    area: f32,
    triangles: Vec<TriangleIndex>,
}

impl Cluster {
    fn empty() -> Self {
        Self { low: Vec3::INFINITY, high: Vec3::NEG_INFINITY, area: 0.0, triangles: Vec::new() }
    }

    fn add(&mut self, mesh: &Mesh, t: TriangleIndex) {
        let [a, b, c] = mesh.corners(t);
        self.low = self.low.min(a).min(b).min(c);
        self.high = self.high.max(a).max(b).max(c);
        self.area += 0.5 * (b - a).cross(c - a).length();
        self.triangles.push(t);
    }

    fn of(mesh: &Mesh, triangles: &[TriangleIndex]) -> Self {
        let mut part = Self::empty();
        for &t in triangles {
            part.add(mesh, t);
        }
        part
    }

    fn diagonal(&self) -> f32 {
        (self.high - self.low).length()
    }
}

/// Surface of a box.
fn surface(low: Vec3, high: Vec3) -> f32 {
    let d = (high - low).max(Vec3::ZERO);
    2.0 * (d.x * d.y + d.y * d.z + d.z * d.x)
}

/// Groups the triangles of a mesh. `label` names a triangle, or is empty. Time O(n log n).
pub fn group<'a>(
    mesh: &Mesh,
    materials: &[Material],
    up: Vec3,
    label: impl Fn(TriangleIndex) -> &'a str,
) -> Grouping {
    let diagonal = {
        let [low, high] = mesh.bounds();
        (high - low).length()
    };
    let diffuse: Vec<bool> = materials.iter().map(Material::is_diffuse).collect();
    let mut of_material: Vec<Vec<TriangleIndex>> = vec![Vec::new(); materials.len()];
    let mut zero = Cluster::empty();
    for (t, m) in mesh.materials.iter().enumerate() {
        let m = m.0 as usize;
        if diffuse.get(m).copied().unwrap_or(true) {
            zero.add(mesh, t as u32);
        } else {
            of_material[m].push(t as u32);
        }
    }
    let mut groups: Vec<(MaterialId, Cluster)> = of_material
        .par_iter()
        .enumerate()
        .flat_map_iter(|(m, triangles)| {
            let parts = connected(mesh, triangles, WELD * diagonal);
            let merged = merge(parts);
            let split: Vec<Cluster> = merged.into_iter().flat_map(|p| split(mesh, p)).collect();
            split.into_iter().map(move |p| (MaterialId(m as u32), p))
        })
        .collect();
    // In the order of the file, so that ids do not depend on the order of materials.
    groups.sort_by_key(|(_, p)| p.triangles.first().copied());

    let mut of_triangle = vec![0; mesh.triangles.len()];
    let first_diffuse = zero.triangles.first().map_or(MaterialId(0), |&t| mesh.materials[t as usize]);
    let mut objects = Vec::with_capacity(groups.len() + 1);
    let has_diffuse = !zero.triangles.is_empty();
    objects.push(object("diffuse".to_owned(), first_diffuse, zero, None));
    let parents = supports(&groups, up, WELD.max(1e-3) * diagonal);
    for (i, ((material, part), parent)) in groups.into_iter().zip(parents).enumerate() {
        for &t in &part.triangles {
            of_triangle[t as usize] = i as u32 + 1;
        }
        let given = part.triangles.first().map_or("", |&t| label(t));
        let name = if given.is_empty() {
            materials.get(material.0 as usize).map_or_else(String::new, |m| m.name.clone())
        } else {
            given.to_owned()
        };
        let parent = parent.map(|p| p + 1).or(if has_diffuse { Some(0) } else { None });
        objects.push(object(name, material, part, parent));
    }
    Grouping { objects, of_triangle }
}

fn object(name: String, material: MaterialId, part: Cluster, parent: Option<u32>) -> Object {
    let bounds = if part.triangles.is_empty() { [Vec3::ZERO; 2] } else { [part.low, part.high] };
    Object { name, material, bounds, area: part.area, parent, triangles: part.triangles }
}

/// Union by the smaller root, so that the result does not depend on the order of unions.
struct DisjointSets(Vec<u32>);

impl DisjointSets {
    fn new(n: usize) -> Self {
        Self((0..n as u32).collect())
    }

    fn root(&mut self, mut i: u32) -> u32 {
        while self.0[i as usize] != i {
            // Path halving.
            self.0[i as usize] = self.0[self.0[i as usize] as usize];
            i = self.0[i as usize];
        }
        i
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

/// Parts whose triangles share vertices, or vertices within `weld` of each other.
fn connected(mesh: &Mesh, triangles: &[TriangleIndex], weld: f32) -> Vec<Cluster> {
    if triangles.is_empty() {
        return Vec::new();
    }
    let mut vertices: Vec<u32> = triangles.iter().flat_map(|&t| mesh.triangles[t as usize]).collect();
    vertices.sort_unstable();
    vertices.dedup();
    // The rank of a vertex; direct addressing between the lowest and the highest one.
    let base = vertices[0];
    let mut rank = vec![0u32; (vertices[vertices.len() - 1] - base) as usize + 1];
    for (i, v) in vertices.iter().enumerate() {
        rank[(v - base) as usize] = i as u32;
    }
    let mut sets = DisjointSets::new(vertices.len());
    weld_vertices(mesh, &vertices, weld, &mut sets);
    for &t in triangles {
        let [a, b, c] = mesh.triangles[t as usize].map(|v| rank[(v - base) as usize]);
        sets.join(a, b);
        sets.join(b, c);
    }
    let mut part_of = vec![u32::MAX; vertices.len()];
    let mut parts: Vec<Cluster> = Vec::new();
    for &t in triangles {
        let root = sets.root(rank[(mesh.triangles[t as usize][0] - base) as usize]);
        if part_of[root as usize] == u32::MAX {
            part_of[root as usize] = parts.len() as u32;
            parts.push(Cluster::empty());
        }
        parts[part_of[root as usize] as usize].add(mesh, t);
    }
    parts
}

/// Most vertices of a cell of the grid below. With more they are closer than a weld on average, as where a scene is a grain
/// in its own bounds, and comparing all with all would take forever; one then stands for all others in its cell.
const CELL_FULL: usize = 64;

/// Joins vertices within `weld` of each other, by a hashed grid of cells four times as large: the
/// cube around a vertex reaches into 3.4 cells on average. Returns the number of comparisons.
fn weld_vertices(mesh: &Mesh, vertices: &[u32], weld: f32, sets: &mut DisjointSets) -> usize {
    let mut comparisons = 0;
    if weld <= 0.0 {
        return comparisons;
    }
    let cell = 4.0 * f64::from(weld);
    let slots = (vertices.len() * 2).next_power_of_two();
    let mut heads = vec![u32::MAX; slots];
    let mut next = vec![u32::MAX; vertices.len()];
    let slot = |x: i64, y: i64, z: i64| {
        let h = crate::rng::mix((x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (y as u64).rotate_left(21))
            ^ (z as u64).wrapping_mul(0xd6e8_feb8_6659_fd93);
        (crate::rng::mix(h) as usize) & (slots - 1)
    };
    for (i, &v) in vertices.iter().enumerate() {
        let p = mesh.positions[v as usize];
        let q = p.as_dvec3() / cell;
        let (low, high) = ((q - 0.25).floor().as_i64vec3(), (q + 0.25).floor().as_i64vec3());
        let mut is_duplicate = false;
        for x in low.x..=high.x {
            for y in low.y..=high.y {
                for z in low.z..=high.z {
                    let mut at = heads[slot(x, y, z)];
                    while at != u32::MAX {
                        comparisons += 1;
                        let other = mesh.positions[vertices[at as usize] as usize];
                        if other.distance_squared(p) <= weld * weld {
                            sets.join(at, i as u32);
                            is_duplicate |= other == p;
                        }
                        at = next[at as usize];
                    }
                }
            }
        }
        // Of vertices at the same place one stands for all: a thousand of them would be a long chain.
        if !is_duplicate {
            let c = q.floor().as_i64vec3();
            let s = slot(c.x, c.y, c.z);
            let some = |at: u32| (at != u32::MAX).then_some(at);
            let chain = || std::iter::successors(some(heads[s]), |&at| some(next[at as usize]));
            if chain().nth(CELL_FULL).is_some() {
                // Cells may share a slot by chance.
                let cell_of = |at: u32| {
                    let other = mesh.positions[vertices[at as usize] as usize];
                    (other.as_dvec3() / cell).floor().as_i64vec3()
                };
                let mut same = chain().filter(|&at| cell_of(at) == c);
                let first = same.next();
                if let (Some(first), Some(_)) = (first, same.nth(CELL_FULL - 2)) {
                    sets.join(first, i as u32);
                    continue;
                }
            }
            next[i] = heads[s];
            heads[s] = i as u32;
        }
    }
    comparisons
}

/// Distance of two boxes; 0 where they overlap.
fn gap(a: &Cluster, b: &Cluster) -> f32 {
    (a.low - b.high).max(b.low - a.high).max(Vec3::ZERO).length()
}

/// What merging two parts costs, if they may merge: the gap, then the surface of the common bounds.
fn cost(a: &Cluster, b: &Cluster) -> Option<(f32, f32)> {
    let distance = gap(a, b);
    // Strictly below, or a gap of 0 between flat parts; touching boxes merge however thin they are.
    if distance > 0.0 && distance >= GAP * a.diagonal().min(b.diagonal()) {
        return None;
    }
    let union = surface(a.low.min(b.low), a.high.max(b.high));
    let sum = surface(a.low, a.high) + surface(b.low, b.high);
    (union <= GROWTH * sum).then_some((distance, union))
}

/// Spreads the lower 21 bits to every third.
fn spread(v: u64) -> u64 {
    let v = (v | (v << 32)) & 0x001f_0000_0000_ffff;
    let v = (v | (v << 16)) & 0x001f_0000_ff00_00ff;
    let v = (v | (v << 8)) & 0x100f_00f0_0f00_f00f;
    let v = (v | (v << 4)) & 0x10c3_0c30_c30c_30c3;
    (v | (v << 2)) & 0x1249_2492_4924_9249
}

/// Merges neighbouring parts of one material: rounds in which each pair that prefers each other
/// merges, the neighbours being those near on the Morton curve (as PLOC, Meister & Bittner 2018).
fn merge(mut parts: Vec<Cluster>) -> Vec<Cluster> {
    if parts.len() < 2 {
        return parts;
    }
    let low = parts.iter().fold(Vec3::INFINITY, |a, p| a.min(p.low));
    let high = parts.iter().fold(Vec3::NEG_INFINITY, |a, p| a.max(p.high));
    let extent = (high - low).max_element().max(f32::MIN_POSITIVE);
    let code = |p: &Cluster| {
        let c = ((p.low + p.high) * 0.5 - low) / extent * 2_097_151.0;
        spread(c.x as u64) | (spread(c.y as u64) << 1) | (spread(c.z as u64) << 2)
    };
    // Each round either merges a pair or is the last one. A round that merges less than a hundredth
    // of what is left is the last but a few.
    let mut slow = 0;
    loop {
        parts.sort_by_cached_key(|p| (code(p), p.triangles[0]));
        let n = parts.len();
        let best: Vec<usize> = (0..n)
            .into_par_iter()
            .map(|i| {
                let from = i.saturating_sub(WINDOW);
                let to = (i + WINDOW + 1).min(n);
                (from..to)
                    .filter(|&j| j != i)
                    .filter_map(|j| cost(&parts[i], &parts[j]).map(|c| (c, i.min(j), i.max(j), j)))
                    .min_by(|a, b| {
                        (a.0.0.total_cmp(&b.0.0))
                            .then(a.0.1.total_cmp(&b.0.1))
                            .then((a.1, a.2).cmp(&(b.1, b.2)))
                    })
                    .map_or(usize::MAX, |(.., j)| j)
            })
            .collect();
        let mut kept: Vec<Option<Cluster>> = parts.into_iter().map(Some).collect();
        let mut merged = 0;
        for i in 0..n {
            let j = best[i];
            if j == usize::MAX || j < i || best[j] != i {
                continue;
            }
            if let (Some(a), Some(b)) = (kept[i].take(), kept[j].take()) {
                kept[i] = Some(join(a, b));
                merged += 1;
            }
        }
        parts = kept.into_iter().flatten().collect();
        slow += usize::from(merged * 100 < n);
        if merged == 0 || parts.len() < 2 || slow > 8 {
            break;
        }
    }
    for p in &mut parts {
        p.triangles.sort_unstable();
    }
    parts
}

fn join(a: Cluster, b: Cluster) -> Cluster {
    // The lowest triangle stays first: it orders parts of the same code.
    let (mut a, b) = if a.triangles[0] < b.triangles[0] { (a, b) } else { (b, a) };
    a.low = a.low.min(b.low);
    a.high = a.high.max(b.high);
    a.area += b.area;
    a.triangles.extend(b.triangles);
    a
}

/// Splits a part that is mostly air, as a frame or a string of lights, at the largest gap between
/// the centres of its triangles, as long as that makes the bounds much smaller.
fn split(mesh: &Mesh, part: Cluster) -> Vec<Cluster> {
    let mut done = Vec::new();
    let mut open = vec![(part, 0)];
    while let Some((part, depth)) = open.pop() {
        let whole = surface(part.low, part.high);
        if depth >= 6 || part.triangles.len() < 2 || part.area >= FILL * whole {
            done.push(part);
            continue;
        }
        let centre = |t: TriangleIndex| {
            let [a, b, c] = mesh.corners(t);
            (a + b + c) / 3.0
        };
        let mut largest = (0.0f32, 0, 0.0f32);
        for axis in 0..3 {
            let mut along: Vec<f32> = part.triangles.iter().map(|&t| centre(t)[axis]).collect();
            along.sort_unstable_by(f32::total_cmp);
            for w in along.windows(2) {
                if w[1] - w[0] > largest.0 {
                    largest = (w[1] - w[0], axis, (w[0] + w[1]) * 0.5);
                }
            }
        }
        let d = part.high - part.low;
        let longest = d.max_position();
        // Where the largest gap cuts off too little, the middle of the longest side may do better.
        let planes = [(largest.1, largest.2), (longest, part.low[longest] + 0.5 * d[longest])];
        let halves = planes.into_iter().find_map(|(axis, at)| {
            let (near, far): (Vec<u32>, Vec<u32>) =
                part.triangles.iter().partition(|&&t| centre(t)[axis] < at);
            let (near, far) = (Cluster::of(mesh, &near), Cluster::of(mesh, &far));
            let smaller = surface(near.low, near.high) + surface(far.low, far.high);
            let good = !near.triangles.is_empty() && !far.triangles.is_empty() && smaller <= 0.7 * whole;
            good.then_some((near, far))
        });
        match halves {
            None => done.push(part),
            Some((near, far)) => open.extend([(far, depth + 1), (near, depth + 1)]),
        }
    }
    done
}

/// For each group the one whose top holds the middle of its lower side, if there is one.
fn supports(groups: &[(MaterialId, Cluster)], up: Vec3, tolerance: f32) -> Vec<Option<u32>> {
    let axis = up.abs().max_position();
    let sign = if up[axis] < 0.0 { -1.0 } else { 1.0 };
    let flat = [(axis + 1) % 3, (axis + 2) % 3];
    // Height of top and bottom along up.
    let ends = |p: &Cluster| {
        let (a, b) = (sign * p.low[axis], sign * p.high[axis]);
        (a.min(b), a.max(b))
    };
    // Tops by height, in buckets of the tolerance, so that only those at the right height are asked.
    let bucket = |height: f32| (height / tolerance.max(f32::MIN_POSITIVE)).floor() as i64;
    let mut tops: HashMap<i64, Vec<u32>> = HashMap::new();
    for (i, (_, p)) in groups.iter().enumerate() {
        tops.entry(bucket(ends(p).1)).or_default().push(i as u32);
    }
    groups
        .par_iter()
        .enumerate()
        .map(|(i, (_, p))| {
            let (bottom, _) = ends(p);
            let middle = (p.low + p.high) * 0.5;
            let b = bucket(bottom);
            (b.saturating_sub(1)..=b.saturating_add(1))
                .filter_map(|b| tops.get(&b))
                // Many groups at one height are those of a scene of equal pieces, not of supports.
                .flat_map(|list| list.iter().take(4096))
                .filter(|&&j| j as usize != i)
                .filter(|&&j| {
                    let q = &groups[j as usize].1;
                    let (low, top) = ends(q);
                    // What lies flat on the same ground is no support.
                    (top - bottom).abs() <= tolerance
                        && low < bottom - tolerance
                        && flat.iter().all(|&f| q.low[f] <= middle[f] && middle[f] <= q.high[f])
                })
                .copied()
                .min_by(|&a, &b| {
                    let s = |j: u32| surface(groups[j as usize].1.low, groups[j as usize].1.high);
                    s(a).total_cmp(&s(b)).then(a.cmp(&b))
                })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::test_scenes::{add_box, grey, mirror};
    use super::*;

    fn run(mesh: &Mesh, materials: &[Material]) -> Grouping {
        let g = group(mesh, materials, Vec3::Y, |_| "");
        // Every triangle is in exactly the object that it says.
        let mut seen = vec![u32::MAX; mesh.triangles.len()];
        for (i, o) in g.objects.iter().enumerate() {
            assert!(o.triangles.is_sorted());
            for &t in &o.triangles {
                assert_eq!(seen[t as usize], u32::MAX);
                seen[t as usize] = i as u32;
                for p in mesh.corners(t) {
                    assert!(p.cmpge(o.bounds[0]).all() && p.cmple(o.bounds[1]).all());
                }
            }
        }
        assert_eq!(seen, g.of_triangle);
        g
    }

    /// A table of one part with two cups of the same china, 0.1 across and 0.3 apart.
    fn table_and_cups(table: u32) -> Mesh {
        let mut mesh = Mesh::default();
        add_box(&mut mesh, Vec3::new(0.0, 0.0, 0.0), Vec3::new(1.0, 0.7, 0.6), table, false);
        for x in [0.2, 0.56] {
            add_box(&mut mesh, Vec3::new(x, 0.7, 0.2), Vec3::new(x + 0.06, 0.76, 0.26), 1, false);
        }
        mesh
    }

    #[test]
    fn two_cups_on_a_table() {
        let g = run(&table_and_cups(0), &[grey(), mirror()]);
        assert_eq!(g.objects.len(), 3);
        assert_eq!(g.objects[1].parent, Some(0));
        assert_eq!(g.objects[1].name, "mirror");
        assert!((g.objects[1].area - 6.0 * 0.0036).abs() < 1e-6);
        let g = run(&table_and_cups(2), &[grey(), mirror(), mirror()]);
        assert_eq!(g.objects.len(), 4);
        assert_eq!((g.objects[2].parent, g.objects[3].parent), (Some(1), Some(1)));
        assert_eq!(g.objects[1].parent, None);
    }

    #[test]
    fn near_parts_merge_and_opposite_walls_do_not() {
        let mut mesh = Mesh::default();
        // Drawer fronts with a small gap.
        for i in 0..4 {
            let y = i as f32 * 0.21;
            add_box(&mut mesh, Vec3::new(0.0, y, 0.0), Vec3::new(0.6, y + 0.2, 0.4), 0, false);
        }
        assert_eq!(run(&mesh, &[mirror()]).objects.len(), 2);
        let mut mesh = Mesh::default();
        for x in [0.0, 5.0] {
            add_box(&mut mesh, Vec3::new(x, 0.0, 0.0), Vec3::new(x + 0.1, 3.0, 4.0), 0, false);
        }
        assert_eq!(run(&mesh, &[mirror()]).objects.len(), 3);
    }

    #[test]
    fn seams_are_welded() {
        // The same strip with its own vertices on each quad, offset by less than the tolerance.
        let mut mesh = Mesh::default();
        for i in 0..40 {
            let x = i as f32 + if i % 2 == 0 { 1e-5 } else { 0.0 };
            let base = mesh.positions.len() as u32;
            for (dx, y) in [(0.0, 0.0), (1.0, 0.0), (1.0, 3.0), (0.0, 3.0)] {
                mesh.positions.push(Vec3::new(x + dx, y, 0.0));
            }
            for t in [[0, 1, 2], [0, 2, 3]] {
                mesh.triangles.push(t.map(|v| v + base));
                mesh.materials.push(MaterialId(0));
            }
        }
        let triangles: Vec<u32> = (0..80).collect();
        assert_eq!(connected(&mesh, &triangles, 1e-4).len(), 1);
        assert_eq!(connected(&mesh, &triangles, 1e-7).len(), 40);
    }

    #[test]
    fn a_grain_in_a_huge_scene_is_compared_in_linear_time() {
        let mut mesh = Mesh::default();
        // All of it within one weld of the diagonal, then within many.
        for (count, size) in [(3_000, 1.0_f32), (30_000, 1.0), (30_000, 500.0)] {
            mesh.positions = (0..count as u32)
                .map(|i| {
                    size * Vec3::from(
                        [0, 1, 2]
                            .map(|axis| (crate::rng::hash(1, i.into(), axis) % 65_536) as f32 / 65_536.0),
                    )
                })
                .collect();
            let vertices: Vec<u32> = (0..count as u32).collect();
            let mut sets = DisjointSets::new(count);
            let comparisons = weld_vertices(&mesh, &vertices, 10.0, &mut sets);
            assert!(comparisons < 8 * (CELL_FULL + 1) * count, "{comparisons} for {count} in {size}");
            let roots = (0..count as u32).filter(|&i| sets.root(i) == i).count();
            assert!(size > 10.0 || roots == 1, "{roots} grains");
        }
    }

    #[test]
    fn a_string_of_lamps_is_split() {
        let mut mesh = Mesh::default();
        let rod =
            |mesh: &mut Mesh, low: [f32; 3], high: [f32; 3]| add_box(mesh, low.into(), high.into(), 0, false);
        // Two lumps joined by a thin diagonal chain: one connected part, mostly air.
        rod(&mut mesh, [0.0, 0.0, 0.0], [1.0, 1.0, 1.0]);
        for i in 0..50 {
            let at = 1.0 + i as f32 * 0.5;
            rod(&mut mesh, [at; 3], [at + 0.5; 3]);
        }
        rod(&mut mesh, [26.0; 3], [27.0; 3]);
        let g = run(&mesh, &[mirror()]);
        assert!(g.objects.len() > 2, "{}", g.objects.len());
    }

    #[test]
    fn nothing_one_and_many_equal_triangles() {
        assert_eq!(run(&Mesh::default(), &[mirror()]).objects.len(), 1);
        let mut mesh = Mesh::default();
        for _ in 0..2000 {
            let base = mesh.positions.len() as u32;
            mesh.positions.extend([Vec3::ZERO, Vec3::X, Vec3::Y]);
            mesh.triangles.push([base, base + 1, base + 2]);
            mesh.materials.push(MaterialId(0));
        }
        assert_eq!(run(&mesh, &[mirror()]).objects.len(), 2);
        assert_eq!(run(&mesh, &[grey()]).objects.len(), 1);
    }
}
