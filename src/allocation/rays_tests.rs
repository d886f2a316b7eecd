//! The estimates on known numbers, and the toy study of REFERENCE §13.4.

use super::*;
use crate::allocation::decision::{Constraint, decide};
use crate::allocation::policy::{Demand, Policy, RayPolicy};
use crate::image::Map2d;
use crate::math;
use crate::rng::Stream;
use crate::sampling::Lattice;

fn residual(mean: f32, count: u32) -> Residual {
    let mut residual = Residual::default();
    (0..count).for_each(|_| residual.add_difference(mean));
    residual
}

fn ledger() -> RayLedger {
    let mut ledger = RayLedger::default();
    ledger.start_view(4);
    ledger
}

fn demand(object: u32, level: u32, left: &[u32]) -> RayDemand<'_> {
    RayDemand { object, pixels: 1000, weight: 1.0, level, left, guides: 0, life_frames: f32::INFINITY }
}

#[test]
fn means_and_errors_of_residuals() {
    let mut r = Residual::default();
    assert_eq!((r.mean(), r.standard_error()), (None, f32::INFINITY));
    [1.0, 3.0, f32::NAN, -2.0].iter().for_each(|&v| r.add_difference(v));
    assert_eq!((r.mean(), r.count()), (Some(1.0), 4));
    // Variance 2 of four samples, doubled error.
    assert!((r.standard_error() - 2.0 * 0.5f32.sqrt()).abs() < 1e-6);
    let thresholds = TviTable::default();
    let mut r = Residual::default();
    r.add(&thresholds, 100.0, 100.0 - 3.0 * 5.559);
    assert!((r.mean().unwrap() - 3.0).abs() < 0.02);
}

#[test]
fn the_ratio_is_the_prior_until_levels_say_otherwise() {
    let mut ledger = ledger();
    assert!((ledger.ratio(1) - 0.6).abs() < 1e-6);
    ledger.record(1, 1, &residual(8.0, 20), 20, 1e-3);
    assert!((ledger.ratio(1) - 0.6).abs() < 1e-6);
    ledger.record(1, 2, &residual(2.0, 80), 80, 1e-3);
    assert!((ledger.ratio(1) - (0.6 + 0.25) / 2.0).abs() < 1e-6);
    // Bounds: an error that grew counts as the largest ratio, few samples as none.
    ledger.record(1, 3, &residual(9.0, 400), 400, 1e-3);
    assert!((ledger.ratio(1) - (0.6 + 0.25 + 0.95) / 3.0).abs() < 1e-6);
    ledger.record(1, 4, &residual(0.0, 3), 3, 1e-3);
    assert!((ledger.ratio(1) - 0.6).abs() < 1e-6);
}

#[test]
fn the_displayed_error_falls_while_a_level_is_traced() {
    let mut ledger = ledger();
    assert_eq!(ledger.displayed_error(1, 1, 20), None);
    ledger.record(1, 1, &residual(10.0, 10), 10, 1e-3);
    // Ten samples of 10 beside four that were expected to be 3: 8. Half of level 1: halfway from there to 60 %.
    assert!((ledger.displayed_error(1, 1, 10).unwrap() - 0.8 * 8.0).abs() < 1e-5);
    ledger.record(1, 1, &residual(10.0, 10), 10, 1e-3);
    let before = (20.0 * 10.0 + 4.0 * 3.0) / 24.0;
    assert!((ledger.displayed_error(1, 2, 100).unwrap() - 0.6 * before).abs() < 1e-5);
    // A level of one sample that found nothing does not say that there is nothing.
    ledger.record(1, 2, &residual(0.0, 1), 1, 1e-3);
    assert!(ledger.displayed_error(1, 3, 100).unwrap() > 0.2 * before);
}

#[test]
fn utility_is_drop_of_error_per_second() {
    let mut ledger = ledger();
    assert_eq!(ledger.utility(&demand(1, 1, &[4, 20])), f32::INFINITY);
    assert_eq!(ledger.utility(&demand(1, 1, &[0, 0])), 0.0);
    ledger.record(1, 1, &residual(10.0, 4), 4, 4e-3);
    assert!((ledger.seconds_per_ray(1) - 1e-3).abs() < 1e-9);
    // Four samples of 10 beside four of 3: e = .6 · 6.5; level 2: 40 % for 20 rays; both: 100 % for 120.
    let left = [20, 100];
    let e = 0.6 * 6.5;
    let expected = 1000.0 * e * (0.4 / 20.0) / 1e-3;
    assert!((ledger.utility(&demand(1, 2, &left)) / expected - 1.0).abs() < 1e-5);
    // The last level is exact: cheap enough, it decides.
    let expected = 1000.0 * e * (1.0 / 30.0) / 1e-3;
    assert!((ledger.utility(&demand(1, 2, &[20, 10])) / expected - 1.0).abs() < 1e-5);
    let moving = RayDemand { life_frames: 1.0, ..demand(1, 2, &left) };
    let share = ledger.utility(&moving) / ledger.utility(&demand(1, 2, &left));
    assert!((share - (1.0 - math::exp(-1.0f32))).abs() < 1e-5);
    let nobody = RayDemand { weight: f32::NAN, ..demand(1, 2, &left) };
    assert_eq!(ledger.utility(&nobody), 0.0);
}

/// The same code that chooses textures and maps chooses levels within a time.
#[test]
fn time_goes_to_the_levels_that_bring_most() {
    let mut ledger = ledger();
    ledger.record(1, 1, &residual(20.0, 40), 40, 40e-6);
    ledger.record(2, 1, &residual(2.0, 40), 40, 40e-6);
    let left = [20, 100];
    let demands = [demand(1, 2, &left), demand(2, 2, &left)];
    let choices = RayChoices { ledger: &ledger, demands: &demands };
    let within = |ns| decide(&choices, Constraint::Nanoseconds(ns), None).unwrap().states;
    assert_eq!(within(0), [0, 0]);
    assert_eq!(within(20_000), [1, 0]);
    assert_eq!(within(40_000), [1, 1]);
    assert_eq!(within(140_000), [2, 1]);
    assert_eq!(within(250_000), [2, 2]);
    // The order in which steps are taken is that of the utilities.
    assert!(ledger.utility(&demands[0]) > 5.0 * ledger.utility(&demands[1]));
}

#[test]
fn a_part_begins_with_what_is_known_of_its_object() {
    let mut ledger = ledger();
    ledger.record(2, 1, &residual(8.0, 20), 20, 1e-3);
    ledger.add_part(2);
    ledger.add_part(2);
    let of_whole = ledger.displayed_error(2, 2, 10);
    assert_eq!((ledger.displayed_error(4, 2, 10), ledger.displayed_error(5, 2, 10)), (of_whole, of_whole));
    assert_eq!(ledger.seconds_per_ray(4), ledger.seconds_per_ray(2));
    ledger.record(4, 2, &residual(0.0, 50), 50, 0.0);
    assert!(ledger.displayed_error(4, 3, 10) < of_whole && ledger.displayed_error(5, 2, 10) == of_whole);
    assert!(ledger.is_good_enough(4) && !ledger.is_good_enough(5));
    // The next view has no parts, and knows what rays cost.
    ledger.start_view(4);
    assert_eq!(ledger.displayed_error(4, 2, 10), None);
    assert!(ledger.seconds_per_ray(2) > 0.0);
}

#[test]
fn utilities_put_the_unseen_first_and_the_dear_last() {
    let mut ledger = ledger();
    ledger.record(1, 1, &residual(10.0, 4), 4, 4e-3);
    ledger.record(2, 1, &residual(10.0, 4), 4, 40e-3);
    let left = [20, 100];
    let demands = [demand(1, 2, &left), demand(2, 2, &left), demand(3, 1, &left)];
    let of_all = utilities(&ledger, &demands);
    assert!((of_all[0] - 0.99).abs() < 1e-6 && (of_all[1] - 0.099).abs() < 1e-6);
    assert_eq!(of_all[2], 1.0);
    // Object 3 has no cost of its own: the mean of the others.
    assert!((ledger.seconds_per_ray(3) - 5.5e-3).abs() < 1e-6);
    ledger.start_view(4);
    assert_eq!(ledger.utility(&demand(1, 1, &left)), f32::INFINITY);
    // Its first level is on its way: what comes after it counts as if it were somewhat wrong.
    assert!(ledger.utility(&demands[0]).is_finite());
    assert!((ledger.seconds_per_ray(2) - 1e-2).abs() < 1e-8);
    assert_eq!(
        (ledger.job_size(2, 2e-3), ledger.job_size(1, 0.1005), ledger.job_size(1, 9.0)),
        (32, 100, 512)
    );
}

#[test]
fn stops_where_nothing_can_be_seen() {
    let mut ledger = ledger();
    assert!(!ledger.is_good_enough(1));
    ledger.record(1, 1, &residual(0.2, 30), 30, 1e-3);
    assert!(ledger.is_good_enough(1));
    ledger.record(1, 2, &residual(0.7, 30), 30, 1e-3);
    assert!(!ledger.is_good_enough(1));
    // One sample proves nothing; neither do ids and levels that do not exist.
    ledger.record(2, 1, &residual(0.0, 1), 1, 1e-3);
    ledger.record(9, 1, &residual(0.0, 9), 9, 1e-3);
    ledger.record(2, 0, &residual(0.0, 9), 9, 1e-3);
    ledger.record(2, 99, &residual(0.0, 9), 9, f32::NAN);
    assert!(!ledger.is_good_enough(2) && !ledger.is_good_enough(9));
}

/// Objects of random size, contrast and frequency on a black ground.
struct Toy {
    reference: Map2d<f32>,
    ids: Map2d<u32>,
    objects: u32,
}

const SIDE: usize = 128;
const K: u32 = 4;

impl Toy {
    fn new(seed: u64) -> Self {
        let mut random = Stream::new(seed, 0, 0);
        let mut toy =
            Self { reference: Map2d::new(SIDE, SIDE, 0.0), ids: Map2d::new(SIDE, SIDE, 0), objects: 9 };
        for id in 1..=toy.objects {
            let [w, h] = [(); 2].map(|()| 9 + (46.0 * random.next_f32()) as usize);
            let [x0, y0] = [w, h].map(|side| (random.next_f32() * (SIDE - side) as f32) as usize);
            let frequency = math::exp2(1.0 + 4.5 * random.next_f32()) * std::f32::consts::TAU / SIDE as f32;
            let contrast = math::powf(10f32, -1.5 + 1.5 * random.next_f32());
            let (angle, phase, level) = (
                std::f32::consts::TAU * random.next_f32(),
                std::f32::consts::TAU * random.next_f32(),
                random.next_f32() - 0.5,
            );
            for y in y0..y0 + h {
                for x in x0..x0 + w {
                    let along = x as f32 * math::cos(angle) + y as f32 * math::sin(angle);
                    *toy.ids.at_mut(x, y) = id;
                    *toy.reference.at_mut(x, y) =
                        contrast * (math::sin(frequency * along + phase) + 2.0 * level);
                }
            }
        }
        toy
    }

    fn error(&self, shown: &Map2d<f32>) -> f64 {
        shown.data().iter().zip(self.reference.data()).map(|(a, b)| f64::from((a - b).abs())).sum()
    }

    /// Area under the error-over-rays curve of a policy.
    fn area(&self, policy: &RayPolicy) -> f64 {
        let lattice = Lattice::new(K, [64, 64]);
        let mut shown = Map2d::new(SIDE, SIDE, 0.0f32);
        let base = self.error(&shown);
        let (mut area, mut before) = (0.0, base);
        let mut ledger = RayLedger::default();
        ledger.start_view(self.objects as usize + 1);
        let pixels: Vec<(usize, usize, u32, u32)> = (0..SIDE * SIDE)
            .map(|i| (i % SIDE, i / SIDE))
            .map(|(x, y)| (x, y, self.ids.at(x, y), lattice.level(x as i32, y as i32)))
            .collect();
        let mut left = vec![[0u32; K as usize + 1]; self.objects as usize + 1];
        pixels.iter().for_each(|&(_, _, id, level)| left[id as usize][level as usize - 1] += 1);
        let visible: Vec<u32> =
            (1..=self.objects).filter(|&id| left[id as usize].iter().sum::<u32>() > 0).collect();
        let total: u32 = visible.iter().flat_map(|&id| left[id as usize]).sum();
        let mut next = vec![1u32; self.objects as usize + 1];
        let mut rays = 0;
        loop {
            let open: Vec<u32> = visible.iter().copied().filter(|&id| next[id as usize] <= K + 1).collect();
            let counts: Vec<u32> = visible.iter().map(|&id| left[id as usize].iter().sum()).collect();
            let demands: Vec<RayDemand> = open
                .iter()
                .map(|&id| {
                    let of_object = counts[visible.iter().position(|&v| v == id).unwrap()];
                    let left = &left[id as usize][next[id as usize] as usize - 1..];
                    RayDemand { pixels: of_object, ..demand(id, next[id as usize], left) }
                })
                .collect();
            let of_all = utilities(&ledger, &demands);
            let priority = |i: usize| {
                let id = open[i];
                let coverage = demands[i].pixels as f32 / (SIDE * SIDE) as f32;
                let level = next[id as usize];
                policy.priority(&Demand {
                    object: id,
                    level,
                    attention: 0.5,
                    coverage,
                    utility: of_all[i],
                    frame: 0,
                })
            };
            let Some(best) =
                (0..open.len()).max_by(|&a, &b| priority(a).total_cmp(&priority(b)).then_with(|| b.cmp(&a)))
            else {
                break;
            };
            let (id, level) = (open[best], next[open[best] as usize]);
            let mut differences = Residual::default();
            let k = lattice.k_of(level);
            for &(x, y, _, _) in pixels.iter().filter(|p| p.2 == id && p.3 == level) {
                // Just noticeable differences stand for one per unit.
                differences.add_difference((shown.at(x, y) - self.reference.at(x, y)).abs());
            }
            for &(x, y, _, _) in pixels.iter().filter(|p| p.2 == id) {
                let (sx, sy) = lattice.tile_owner(k, x as i32, y as i32);
                let inside = (0..SIDE as i32).contains(&sx) && (0..SIDE as i32).contains(&sy);
                if inside && self.ids.at(sx as usize, sy as usize) == id {
                    *shown.at_mut(x, y) = self.reference.at(sx as usize, sy as usize);
                }
            }
            ledger.record(id, level, &differences, differences.count(), 1e-6 * differences.count() as f32);
            rays += differences.count();
            next[id as usize] += 1;
            let after = self.error(&shown);
            area += 0.5 * (before + after) * f64::from(differences.count());
            before = after;
        }
        assert_eq!(rays, total);
        assert_eq!(self.error(&shown), 0.0, "every policy ends at the reference");
        area / (base * f64::from(total))
    }
}

#[test]
fn utility_wins_the_toy_study() {
    let scenes: Vec<Toy> = (0..8).map(Toy::new).collect();
    let mean = |policy: Policy| {
        let policy = RayPolicy::new(policy, 1);
        scenes.iter().map(|toy| toy.area(&policy)).sum::<f64>() / scenes.len() as f64
    };
    let utility = mean(Policy::Utility);
    for (policy, most) in [(Policy::Uniform, 0.9), (Policy::Coverage, 0.8), (Policy::Random, 0.8)] {
        let other = mean(policy);
        println!("area under the error curve: utility {utility:.4}, {policy} {other:.4}");
        assert!(utility < most * other, "{policy}: {utility} {other}");
    }
}

/// Utilities relative to the largest finite one, for [`Demand::utility`]: objects of which nothing was traced come first.
fn utilities(ledger: &RayLedger, demands: &[RayDemand]) -> Vec<f32> {
    let raw: Vec<f32> = demands.iter().map(|demand| ledger.utility(demand)).collect();
    let largest = raw.iter().copied().filter(|utility| utility.is_finite()).fold(0.0, f32::max);
    let relative = |utility: f32| if largest > 0.0 { 0.99 * (utility / largest) } else { 0.0 };
    raw.iter().map(|&utility| if utility.is_finite() { relative(utility) } else { 1.0 }).collect()
}

/// What guides take is weighed like any other step: cheap ones raise what a part is worth, dear ones do not.
#[test]
fn guides_count_by_their_own_time() {
    let mut ledger = RayLedger::new(RaySettings::default());
    ledger.start_view(3);
    for object in [1, 2] {
        ledger.record(object, 3, &residual(4.0, 100), 100, 100.0 * 40e-6);
    }
    assert_eq!(ledger.seconds_per_guide(1), 0.15 * ledger.seconds_per_ray(1));
    ledger.record_guides(1, 100, 100.0 * 1e-6);
    ledger.record_guides(2, 100, 100.0 * 400e-6);
    assert!((ledger.seconds_per_guide(1) - 1e-6).abs() < 1e-9);
    // Guides that leave a third of the error.
    assert_eq!(ledger.guide_ratio(1), RaySettings::default().guide_ratio_prior);
    for object in [1, 2] {
        ledger.record_guided(object, [&residual(1.0, 1000), &residual(3.0, 1000)]);
    }
    assert!((ledger.guide_ratio(1) - 1.0 / 3.0).abs() < 0.01);
    let left = [200, 800];
    let plain = demand(1, 4, &left);
    let guided = |object| ledger.utility(&RayDemand { guides: 1000, ..demand(object, 4, &left) });
    assert!(guided(1) > 2.0 * ledger.utility(&plain), "{} {}", guided(1), ledger.utility(&plain));
    assert!(guided(2) < ledger.utility(&plain), "{} {}", guided(2), ledger.utility(&plain));
}
