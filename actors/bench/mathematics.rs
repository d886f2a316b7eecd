//! What the same bits on every machine cost: functions of `foveal::math` beside those of the standard library, which are the
//! C library's or the compiler's.

use std::hint::black_box;

use foveal::math;
use foveal_terminal::table::{Row, median};

use super::timed;

/// Calls that are timed at once.
const CALLS: usize = 1 << 18;

/// A function by both names.
struct Pair {
    name: &'static str,
    ours: fn(f32) -> f32,
    theirs: fn(f32) -> f32,
}

/// Arguments lie in (0, 2π).
const PAIRS: [Pair; 5] = [
    Pair { name: "sin and cos", ours: |x| sum(math::sin_cos(x)), theirs: |x| sum(x.sin_cos()) },
    Pair { name: "exp", ours: |x| math::exp(x), theirs: f32::exp },
    Pair { name: "ln", ours: |x| math::ln(x), theirs: f32::ln },
    Pair { name: "x^2.2", ours: |x| math::powf(x, 2.2), theirs: |x| x.powf(2.2) },
    Pair { name: "acos", ours: |x| math::acos(x * 0.1), theirs: |x| (x * 0.1).acos() },
];

fn sum((sine, cosine): (f32, f32)) -> f32 {
    sine + cosine
}

/// Nanoseconds of a call, as functions that nobody inlines.
pub fn rows(runs: u32) -> Vec<Row> {
    let arguments: Vec<f32> =
        (1..=CALLS).map(|i| i as f32 * (std::f32::consts::TAU / CALLS as f32)).collect();
    let time = |function: fn(f32) -> f32| -> Vec<f64> {
        let all = || arguments.iter().map(|x| black_box(function)(*x)).sum::<f32>();
        (0..runs).map(|_| timed(|| black_box(all())).0 * 1e6 / CALLS as f64).collect()
    };
    let row = |pair: &Pair| {
        let (ours, theirs) = (time(pair.ours), time(pair.theirs));
        Row::new(format!("{} with the same bits everywhere", pair.name), "ns", &ours)
            .against("standard library", median(&theirs))
    };
    PAIRS.iter().map(row).collect()
}
