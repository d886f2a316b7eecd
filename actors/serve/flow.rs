//! What keeps a viewer's connection fluid and within bounds: rates, the page's clock, and how good pictures are.

use std::collections::VecDeque;

use foveal::metrics::quantile;

/// Lets so many through a second, with a second's worth at once.
#[derive(Clone, Copy, Debug)]
pub struct Rate {
    per_second: f64,
    left: f64,
    at: f64,
}

impl Rate {
    /// So many a second.
    pub fn new(per_second: f64, now: f64) -> Self {
        Self { per_second, left: per_second, at: now }
    }

    fn refill(&mut self, now: f64) {
        self.left = (self.left + (now - self.at).max(0.0) * self.per_second).min(self.per_second);
        self.at = self.at.max(now);
    }

    /// One more. Whether it may pass.
    pub fn take(&mut self, now: f64) -> bool {
        self.refill(now);
        self.left -= 1.0;
        self.left >= 0.0
    }

    /// Whether something may pass, however large.
    pub fn is_open(&mut self, now: f64) -> bool {
        self.refill(now);
        self.left > 0.0
    }

    /// Something of this size has passed; what is more than there was must be made up for first.
    pub fn spend(&mut self, size: f64, now: f64) {
        self.refill(now);
        self.left -= size;
    }
}

/// Messages by which the page's clock is read.
const READINGS: usize = 32;
/// Input is told at most so late, seconds.
const LATE: f64 = 0.25;

/// Maps times of a page to times of the server: by the message that came fastest of late. So no event is of the future,
/// and what the network does to single messages does not show in the way that is walked.
#[derive(Clone, Debug, Default)]
pub struct PageClock {
    /// Server's time less page's.
    offsets: VecDeque<f64>,
    last: f64,
}

impl PageClock {
    /// A message came at `now` with something of this page time (seconds), the last in it.
    pub fn heard(&mut self, page: f64, now: f64) {
        if self.offsets.len() == READINGS {
            self.offsets.pop_front();
        }
        self.offsets.push_back(now - page);
    }

    /// The server's time of an event: not before another that was asked for, nor later than now or long before.
    pub fn time(&mut self, page: f64, now: f64) -> f64 {
        let offset = self.offsets.iter().copied().fold(f64::INFINITY, f64::min);
        let at = if offset.is_finite() { page + offset } else { now };
        self.last = at.clamp(now - LATE, now).max(self.last).min(now);
        self.last
    }
}

/// Best and worst quality of JPEG, and a step of it.
const BEST: u8 = 85;
const WORST: u8 = 50;
const STEP: u8 = 10;
/// A frame that took longer than this until it was drawn is late, one that took less than that was fast, seconds.
const SLOW: f64 = 0.12;
const FAST: f64 = 0.06;
/// How long frames must be fast before they become better, seconds.
const PATIENCE: f64 = 2.0;
/// Frames that are judged by.
const JUDGED: usize = 8;

/// How good pictures are, by how long they take until they are drawn.
#[derive(Clone, Debug)]
pub struct Quality {
    /// Quality of JPEG.
    pub jpeg: u8,
    /// Whether they have half the columns and rows.
    pub half: bool,
    ages: VecDeque<f64>,
    fast_since: Option<f64>,
}

impl Default for Quality {
    fn default() -> Self {
        Self { jpeg: 80, half: false, ages: VecDeque::new(), fast_since: None }
    }
}

impl Quality {
    /// A frame was drawn so many seconds after it was sent.
    pub fn drawn(&mut self, age: f64, now: f64) {
        if self.ages.len() == JUDGED {
            self.ages.pop_front();
        }
        self.ages.push_back(age);
        let Some(median) = self.median().filter(|_| self.ages.len() >= JUDGED / 2) else { return };
        if median > SLOW {
            self.worse();
        } else if median >= FAST {
            self.fast_since = None;
        } else if now - *self.fast_since.get_or_insert(now) >= PATIENCE {
            self.better();
        }
    }

    /// Median time of the last frames until they were drawn, seconds.
    pub fn median(&self) -> Option<f64> {
        Some(quantile(self.ages.iter().copied(), 0.5)).filter(|median| median.is_finite())
    }

    fn worse(&mut self) {
        self.half |= self.jpeg == WORST;
        self.jpeg = self.jpeg.saturating_sub(STEP).max(WORST);
        self.ages.clear();
        self.fast_since = None;
    }

    fn better(&mut self) {
        if self.half {
            self.half = false;
        } else {
            self.jpeg = (self.jpeg + STEP).min(BEST);
        }
        self.ages.clear();
        self.fast_since = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_lets_a_second_s_worth_through_and_no_more() {
        let mut rate = Rate::new(10.0, 0.0);
        assert_eq!((0..30).filter(|_| rate.take(0.0)).count(), 10);
        let mut rate = Rate::new(10.0, 0.0);
        assert!((0..200).all(|i| rate.take(f64::from(i) * 0.1)));
        rate.spend(25.0, 20.0);
        assert!(!rate.is_open(20.5) && !rate.is_open(21.4) && rate.is_open(22.0));
    }

    #[test]
    fn page_times_are_told_apart_as_they_were_whatever_the_network_does() {
        let mut clock = PageClock::default();
        // The page's clock is 1000 s ahead; ways take 20 ms, sometimes 200.
        let mut before = 0.0;
        for i in 0..100 {
            let page = 1000.0 + f64::from(i) * 0.05;
            let way = if i % 7 == 3 { 0.2 } else { 0.02 };
            let now = f64::from(i) * 0.05 + way;
            clock.heard(page, now);
            let at = clock.time(page, now);
            assert!(at <= now && at >= before, "{i}: {at}");
            if i > 0 {
                assert!((at - before - 0.05).abs() < 1e-9, "{i}: {at} after {before}");
            }
            before = at;
        }
    }

    #[test]
    fn no_page_time_is_of_the_future_or_long_ago() {
        let mut clock = PageClock::default();
        clock.heard(0.0, 10.0);
        assert_eq!(clock.time(1e9, 10.0), 10.0);
        assert_eq!(clock.time(-1e9, 10.0), 10.0);
        assert_eq!(clock.time(-1e9, 11.0), 10.75);
    }

    #[test]
    fn quality_falls_on_slow_ways_and_comes_back() {
        let mut quality = Quality::default();
        let mut now = 0.0;
        let mut run = |quality: &mut Quality, age: f64, frames: usize| {
            for _ in 0..frames {
                now += 0.1;
                quality.drawn(age, now);
            }
        };
        run(&mut quality, 0.05, 8);
        assert_eq!((quality.jpeg, quality.half), (80, false));
        run(&mut quality, 0.3, 12);
        assert!(quality.jpeg < 80);
        run(&mut quality, 0.3, 40);
        assert_eq!((quality.jpeg, quality.half), (WORST, true));
        run(&mut quality, 0.09, 100);
        assert_eq!((quality.jpeg, quality.half), (WORST, true));
        run(&mut quality, 0.01, 300);
        assert_eq!((quality.jpeg, quality.half), (BEST, false));
    }
}
