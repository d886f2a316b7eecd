//! How long frames take, for whoever watches them go.

use std::collections::VecDeque;
use std::time::Duration;

use foveal::metrics::quantile;

/// How long the last frames took.
#[derive(Clone, Debug, Default)]
pub struct FrameTimes {
    times: VecDeque<Duration>,
}

impl FrameTimes {
    /// Frames that are remembered.
    pub const CAPACITY: usize = 120;

    /// The times, oldest first.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = Duration> + '_ {
        self.times.iter().copied()
    }

    /// A frame took so long.
    pub fn push(&mut self, time: Duration) {
        if self.times.len() == Self::CAPACITY {
            self.times.pop_front();
        }
        self.times.push_back(time);
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        self.times.clear();
    }

    /// Median and 99th percentile, seconds.
    pub fn median_p99(&self) -> Option<(f32, f32)> {
        let of = |share| quantile(self.times.iter().map(Duration::as_secs_f64), share) as f32;
        (!self.times.is_empty()).then(|| (of(0.5), of(0.99)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_the_last_frames() {
        let mut times = FrameTimes::default();
        assert_eq!(times.median_p99(), None);
        for i in 0..(FrameTimes::CAPACITY as u64 + 50) {
            times.push(Duration::from_millis(if i < 50 { 9000 } else { 10 + i % 3 }));
        }
        let (median, p99) = times.median_p99().expect("frames");
        assert!((median - 0.011).abs() < 1e-6 && (p99 - 0.012).abs() < 1e-6, "{median} {p99}");
    }
}
