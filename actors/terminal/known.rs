//! Numbers, no longer than they are known.

use foveal::metrics::quantile;

use crate::table::figure;

/// A median, and between which bounds the true one lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Known {
    /// The median.
    pub median: f64,
    /// The bounds: an interval of 95 % confidence, or of fewer than [`SURE`] values the least and the largest.
    pub bounds: [f64; 2],
    /// How many values it is the median of.
    pub count: usize,
}

/// Values of which the least and the largest hold the true median between them in 95 of 100 cases: with fewer they do not.
pub const SURE: usize = 6;

impl Known {
    /// Of the finite `values`; `None` of none.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let mut sorted: Vec<f64> = values.into_iter().filter(|v| v.is_finite()).collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let count = sorted.len();
        let last = count.checked_sub(1)?;
        // Ranks between which the median lies: how many values are below it is as heads of so many coins.
        let half = 0.98 * (count as f64).sqrt();
        let below = ((count as f64 / 2.0 - half).floor() as usize).min(last);
        let median = quantile(sorted.iter().copied(), 0.5);
        Some(Self { median, bounds: [sorted[below], sorted[last - below]], count })
    }

    /// `108 ± 3 ms`, both to the digit at which the doubt begins. Where the median lies far from the middle of its bounds, or
    /// nearer to 0 than they are apart, `0.12 ms (0.05 – 0.90)`; of few values `0.12 ms (0.05 – 0.90, range of 3 frames)`,
    /// where `of` is what the values are of.
    pub fn text(&self, unit: &str, of: &str) -> String {
        let Self { median, bounds: [low, high], count } = *self;
        let with_unit = |number: String| format!("{number} {unit}").trim_end().to_owned();
        let (near, far) = match (median - low, high - median) {
            (below, above) if below < above => (below, above),
            (below, above) => (above, below),
        };
        let between = || format!("{} – {}", figure(low), figure(high));
        match () {
            () if far <= 0.0 => with_unit(figure(median)),
            () if count < SURE => {
                format!("{} ({}, range of {count} {of})", with_unit(figure(median)), between())
            }
            () if far > 2.0 * near || far > median.abs() => {
                format!("{} ({})", with_unit(figure(median)), between())
            }
            () => with_unit(doubted(median, far)),
        }
    }
}

/// A number and its doubt, both to the digit at which that begins.
fn doubted(number: f64, doubt: f64) -> String {
    match decimals(doubt) {
        digits @ 0.. => {
            let digits = digits as usize;
            format!("{number:.digits$} ± {doubt:.digits$}")
        }
        tens => {
            let unit = 10f64.powi(-tens);
            format!("{:.0} ± {:.0}", unit * (number / unit).round(), unit * (doubt / unit).round())
        }
    }
}

/// Digits behind the point that a number with this doubt has: to the first digit of the doubt, or the second where that
/// one is a 1.
fn decimals(doubt: f64) -> i32 {
    (-12..12).find(|digits| doubt * 10f64.powi(*digits) >= 1.95).unwrap_or(12).min(6)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_end_where_the_doubt_begins() {
        let text = |median: f64, doubt: f64| {
            Known { median, bounds: [median - doubt, median + doubt], count: 40 }.text("", "frames")
        };
        assert_eq!(text(107.9841, 3.2), "108 ± 3");
        assert_eq!(text(107.9841, 1.2), "108.0 ± 1.2");
        assert_eq!(text(107.9841, 0.04), "107.98 ± 0.04");
        assert_eq!(text(1079.841, 32.0), "1080 ± 30");
        assert_eq!(text(0.01234, 0.0006), "0.0123 ± 0.0006");
        assert_eq!(text(12.345, 0.0), "12.3");
    }

    #[test]
    fn bounds_that_are_no_doubt_stand_in_brackets() {
        let text = |bounds, count| Known { median: 0.1234, bounds, count }.text("ms", "frames");
        assert_eq!(text([0.1, 0.16], 40), "0.12 ± 0.04 ms", "as far as the farther of both");
        assert_eq!(text([0.1, 2.4], 40), "0.123 ms (0.100 – 2.40)");
        assert_eq!(text([-0.2, 0.4], 40), "0.123 ms (-0.200 – 0.400)");
        assert_eq!(text([0.1, 0.15], 3), "0.123 ms (0.100 – 0.150, range of 3 frames)");
        assert_eq!(Known::of([2.0]).map(|k| k.text("ms", "frames")).as_deref(), Some("2.00 ms"));
    }

    #[test]
    fn bounds_hold_the_true_median_as_often_as_they_say() {
        // Values of a known distribution, by a generator of no quality: the median of (0, 1) is one half.
        let (mut state, mut held) = (1u64, 0);
        let mut next = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        for _ in 0..2000 {
            let [low, high] = Known::of((0..40).map(|_| next())).expect("values").bounds;
            held += u32::from(low <= 0.5 && 0.5 <= high);
        }
        assert!((1880..=1990).contains(&held), "{held} of 2000");
    }

    #[test]
    fn nothing_is_known_of_nothing() {
        assert_eq!(Known::of([f64::NAN]), None);
        assert_eq!(Known::of([3.0]), Some(Known { median: 3.0, bounds: [3.0, 3.0], count: 1 }));
    }
}
