use super::*;

use crate::math;

/// Preorder split bits of the three quadtrees of the reference check (2028 leaves, 675 inner nodes).
const SPLITS: &str = "\
    f4210c2108610840e108430842184210c087084218410c10610843a108610843084218420d083042184210c21083420c\
    21048430421e1084308214210c210864218420a10860842c2084841c210848430842184210f04218420c108610384210\
    c1086108430821a10861084308421842107c210861084308420b0841820c2108701840c210861084384210c208308421\
    e108428184210c108708421210c2086104384210c210861084308421c10610428184210f08421840c210861084384210\
    30421c210861084308420d08428418420784210c2108608430841c1086108430821410e1083084214210c21087084218\
    2103b0420c10870842184210c21038210c210861080f0842184210c210861084384210c10850841c2108610843084218\
    42108c21084e10843084218410c2107084218210c2108610842e10830821210c21085842106108438410c21086108430\
    8420";

/// Sees one per cent, everywhere alike.
const EYE: Eye<'_> = Eye {
    tvi: &|l| 0.01 * l,
    sensitivity: &|_| 100.0,
    cd_m2_per_unit: 100.0,
    white_cd_m2: 1e4,
    summed_area: 0.0,
};

fn reference_forest() -> Forest {
    let bits: Vec<bool> = SPLITS
        .chars()
        .filter_map(|c| c.to_digit(16))
        .flat_map(|d| (0..4).map(move |i| d >> (3 - i) & 1 == 1))
        .collect();
    let functions: [fn(f64, f64) -> f64; 3] = [
        |x, y| 10.0 * math::exp(-40.0 * ((x - 0.3).powi(2) + (y - 0.6).powi(2))),
        |x, y| if x + 0.3 * y > 0.55 { 3.0 } else { 1.0 },
        |x, y| 1.0 + 0.2 * math::sin(40.0 * x) * math::sin(33.0 * y),
    ];
    let mut forest = Forest::default();
    let mut at = 0;
    for f in functions {
        let root = forest.nodes.len();
        forest.nodes.push(node(None, 1.0));
        fill(&mut forest, root, &bits, &mut at, (0.0, 0.0, 1.0), f);
    }
    assert_eq!(at, 2703);
    for i in (0..forest.nodes.len()).rev() {
        if forest.nodes[i].children.is_some() {
            forest.nodes[i].value = forest.children(i).map(|c| forest.nodes[c].value).sum::<f64>() / 4.0;
        }
    }
    forest
}

fn node(parent: Option<u32>, area: f64) -> QuadNode {
    QuadNode { parent, children: None, area, value: 0.0, elevation: 1.0 }
}

fn fill(
    forest: &mut Forest,
    i: usize,
    bits: &[bool],
    at: &mut usize,
    (x, y, s): (f64, f64, f64),
    f: fn(f64, f64) -> f64,
) {
    *at += 1;
    if !bits[*at - 1] {
        forest.nodes[i].value = f(x + s / 2.0, y + s / 2.0);
        return;
    }
    let first = forest.nodes.len();
    forest.nodes[i].children = Some(first as u32);
    let child = node(Some(i as u32), forest.nodes[i].area / 4.0);
    forest.nodes.extend([child; 4]);
    for c in 0..4usize {
        let corner = (x + s / 2.0 * (c & 1) as f64, y + s / 2.0 * (c >> 1) as f64, s / 2.0);
        fill(forest, first + c, bits, at, corner, f);
    }
}

fn check(criterion: Criterion<'_>, expected: [(usize, f64); 3]) {
    let forest = reference_forest();
    for (k, error) in expected {
        let cut = simplify(&forest, k, &criterion);
        assert_eq!(cut.elements_before, 2028);
        assert_eq!(cut.elements, k);
        assert_eq!(cut.is_leaf.iter().filter(|&&e| e).count(), k);
        assert!(cut.joined.is_empty());
        assert!((cut.squared_error - error).abs() <= 6e-6, "{k}: {}", cut.squared_error);
    }
}

#[test]
fn whole_subtrees_reach_the_optimum_where_their_hull_meets_k() {
    check(Criterion::Optimal, [(300, 0.00873), (99, 0.12133), (594, 0.00197)]);
    let cut = simplify(&reference_forest(), 600, &Criterion::Optimal);
    assert_eq!(cut.elements, 600);
    assert!(cut.squared_error < 0.00198, "{}", cut.squared_error);
}

#[test]
fn a_sort_by_one_key_is_the_heap() {
    let forest = reference_forest();
    let keys = forest.keys(&forest.cost(&Criterion::Photometric), &forest.deviations());
    let mut highest = keys.clone();
    for i in (0..keys.len()).rev() {
        for c in forest.children(i).filter(|&c| forest.nodes[c].children.is_some()) {
            highest[i] = highest[i].max(highest[c]);
        }
    }
    let mut inner: Vec<usize> = (0..keys.len()).filter(|&i| forest.nodes[i].children.is_some()).collect();
    inner.sort_by(|&a, &b| highest[a].total_cmp(&highest[b]).then(b.cmp(&a)));
    let last = highest[inner[(2028usize - 300).div_ceil(3) - 1]];
    let cut = simplify(&forest, 300, &Criterion::Photometric);
    for &i in &inner {
        let above = std::iter::successors(Some(i), |&n| forest.nodes[n].parent.map(|p| p as usize));
        let is_cut = above.into_iter().any(|n| cut.is_leaf[n]);
        // Equal keys may go in either order.
        assert!(highest[i] == last || is_cut == (highest[i] < last), "{i}");
    }
}

#[test]
fn the_perceptual_criterion_spares_what_is_seen() {
    // Two roots with the same relative error; texture hides it on the first.
    let mut forest = Forest::default();
    for root in 0..2u32 {
        let at = forest.nodes.len() as u32;
        forest.nodes.push(QuadNode {
            parent: None,
            children: Some(at + 1),
            area: 1.0,
            value: 2.0,
            elevation: if root == 0 { 5.0 } else { 1.0 },
        });
        for value in [1.9, 2.1, 1.9, 2.1] {
            forest.nodes.push(QuadNode {
                parent: Some(at),
                children: None,
                area: 0.25,
                value,
                elevation: 1.0,
            });
        }
    }
    let criterion = Criterion::Perceptual(EYE);
    let cut = simplify(&forest, 5, &criterion);
    assert_eq!(cut.elements, 5);
    assert!(cut.is_leaf[0] && !cut.is_leaf[5]);
}

/// Elements, each as the leaves that it consists of.
fn elements(cut: &Simplified) -> Vec<Vec<u32>> {
    let alone = |&n: &u32| cut.is_leaf[n as usize] && !cut.joined.iter().flatten().any(|&j| j == n);
    let mut elements: Vec<Vec<u32>> = (0..cut.is_leaf.len() as u32).filter(alone).map(|n| vec![n]).collect();
    elements.extend(cut.joined.iter().cloned());
    elements
}

#[test]
fn every_number_of_elements_is_reached_exactly() {
    let forest = reference_forest();
    let criteria = [Criterion::Photometric, Criterion::Perceptual(EYE), Criterion::Optimal];
    for criterion in criteria {
        let mut before = f64::INFINITY;
        for k in (3..40).chain([99, 100, 101, 598, 599, 600, 2025, 2026, 2027, 2028]) {
            let cut = simplify(&forest, k, &criterion);
            let elements = elements(&cut);
            assert_eq!((cut.elements, elements.len()), (k, k));
            // They cover each tree once, and the error is that of showing their means.
            let area: f64 = elements.iter().flatten().map(|&n| forest.nodes[n as usize].area).sum();
            assert!((area - 3.0).abs() < 1e-9, "{k}: {area}");
            let mut squared = 0.0;
            for element in &elements {
                let mut leaves = element.clone();
                let mut below: Vec<usize> = Vec::new();
                while let Some(n) = leaves.pop() {
                    match forest.children(n as usize) {
                        children if children.is_empty() => below.push(n as usize),
                        children => leaves.extend(children.map(|c| c as u32)),
                    }
                }
                squared += forest.mean(&below).1;
            }
            assert!((cut.squared_error - squared).abs() < 1e-9, "{k}: {} {squared}", cut.squared_error);
            if let Criterion::Optimal = criterion {
                assert!(squared <= before, "{k}: {squared} {before}");
                before = squared;
            }
        }
    }
}

#[test]
fn roots_are_the_least_and_nothing_is_cut_above_k() {
    let forest = reference_forest();
    for criterion in [Criterion::Photometric, Criterion::Optimal] {
        assert_eq!(simplify(&forest, 0, &criterion).elements, 3);
        assert_eq!(simplify(&forest, 5000, &criterion).elements, 2028);
    }
    assert_eq!(simplify(&Forest::default(), 3, &Criterion::Optimal).elements, 0);
}

#[test]
fn a_texture_hides_weak_errors_and_hardly_strong_ones() {
    for elevation in [1.0, 3.0, 20.0] {
        assert_eq!(unmasked(elevation, elevation), 1.0 / elevation);
        assert_eq!(unmasked(0.5, elevation), 1.0 / elevation);
        assert!(unmasked(100.0, elevation) > 0.8);
        let seen = |v: f64| v * unmasked(v, elevation);
        assert!((1..400).map(f64::from).all(|i| seen(0.1 * i) < seen(0.1 * (i + 1.0))));
    }
}

#[test]
fn what_is_beyond_white_or_too_small_to_see_goes_first() {
    let eye = Eye { white_cd_m2: 100.0, summed_area: 0.01, ..EYE };
    let (forest, criterion) = (reference_forest(), Criterion::Perceptual(eye));
    let cost = forest.cost(&criterion);
    let of = |value: f64, area: f64| cost(&QuadNode { value, ..node(None, area) }, 0.1 * value);
    assert!(of(1.0, 0.02) > 0.0 && of(100.0, 0.02) == 0.0);
    assert_eq!(of(1.0, 0.02), of(1.0, 0.01));
    assert!((of(1.0, 0.001) / of(1.0, 0.01) - 0.1).abs() < 1e-9);
}
