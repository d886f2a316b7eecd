//! Numbers, no longer than they are known.

use foveal::metrics::quantile;

use crate::table::figure;

/// A median, and between which bounds the true one lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Known {
    /// The median.
    pub median: f64,
    /// The bounds, 95 % sure; of fewer than six values the least and the largest, which are less sure than that.
    pub bounds: [f64; 2],
}

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
        Some(Self { median, bounds: [sorted[below], sorted[last - below]] })
    }

    /// `108 ± 3`: both to the digit at which the doubt begins.
    pub fn text(&self) -> String {
        let [low, high] = self.bounds;
        let doubt = 0.5 * (high - low);
        if doubt <= 0.0 {
            return figure(self.median);
        }
        match decimals(doubt) {
            digits @ 0.. => {
                let digits = digits as usize;
                format!("{:.digits$} ± {doubt:.digits$}", self.median)
            }
            tens => {
                let unit = 10f64.powi(-tens);
                format!("{:.0} ± {:.0}", unit * (self.median / unit).round(), unit * (doubt / unit).round())
            }
        }
    }

    /// The median alone, to that digit.
    pub fn rounded(&self) -> String {
        self.text().split(" ±").next().unwrap_or_default().to_owned()
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
        let text = |median, doubt: f64| Known { median, bounds: [median - doubt, median + doubt] }.text();
        assert_eq!(text(107.9841, 3.2), "108 ± 3");
        assert_eq!(text(107.9841, 1.2), "108.0 ± 1.2");
        assert_eq!(text(107.9841, 0.04), "107.98 ± 0.04");
        assert_eq!(text(1079.841, 32.0), "1080 ± 30");
        assert_eq!(text(0.01234, 0.0006), "0.0123 ± 0.0006");
        assert_eq!(text(12.345, 0.0), "12.3");
        assert_eq!(Known { median: 107.98, bounds: [104.0, 112.0] }.rounded(), "108");
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
        assert_eq!(Known::of([3.0]), Some(Known { median: 3.0, bounds: [3.0, 3.0] }));
    }
}
