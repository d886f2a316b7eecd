//! How long something will take, by how long it took: what follows a deadline must begin so much before it, and what does
//! not fit is not begun.

use std::collections::VecDeque;
use std::time::Duration;

/// A running estimate of a time that is rarely exceeded: of the newest times, what all but the longest kept to. One frame
/// that the system held up, or the first, for which pages are still to be read, says nothing about the next. (A mean with
/// deviations, as TCP waits for an answer, took ten frames to forget it, and tracers had no time in those.)
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Foresight {
    /// The newest times, oldest first.
    times: VecDeque<Duration>,
}

impl Foresight {
    /// Times that count: the share of those that take longer than expected is two of one more than that.
    const NEWEST: usize = 24;

    /// It took so long this time.
    pub fn learn(&mut self, took: Duration) {
        if self.times.len() == Self::NEWEST {
            self.times.pop_front();
        }
        self.times.push_back(took);
    }

    /// Whether it was seen at least once.
    pub fn is_known(&self) -> bool {
        !self.times.is_empty()
    }

    /// How long it takes at most, nearly always; nothing before it was seen once.
    pub fn expected(&self) -> Duration {
        let keep = |(longest, second): (Duration, Duration), &took: &Duration| match took > longest {
            true => (took, longest),
            false => (longest, second.max(took)),
        };
        let (longest, second) = self.times.iter().fold(Default::default(), keep);
        if self.times.len() == 1 { longest } else { second }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: f64) -> Duration {
        Duration::from_secs_f64(1e-3 * ms)
    }

    #[test]
    fn what_is_always_the_same_is_foreseen_exactly_and_what_varies_with_room() {
        let mut foresight = Foresight::default();
        assert!(foresight.expected() == Duration::ZERO && !foresight.is_known());
        for _ in 0..60 {
            foresight.learn(ms(7.0));
        }
        assert!((foresight.expected().as_secs_f64() - 7e-3).abs() < 1e-6);
        let late = |foresight: &mut Foresight| {
            let times = (0..400u32).map(|i| ms(5.0 + f64::from(i * 7 % 11)));
            times
                .filter(|&took| {
                    let is_late = took > foresight.expected();
                    foresight.learn(took);
                    is_late
                })
                .count()
        };
        // Even times between 5 and 15 ms.
        assert!(late(&mut foresight) < 40, "one of ten");
        assert!(foresight.expected() > ms(13.0) && foresight.expected() <= ms(15.0));
    }
    #[test]
    fn one_long_time_is_no_reason_to_expect_another_and_two_are() {
        let mut foresight = Foresight::default();
        foresight.learn(ms(80.0));
        assert_eq!(foresight.expected(), ms(80.0), "nothing else is known");
        (0..3).for_each(|_| foresight.learn(ms(9.0)));
        assert_eq!(foresight.expected(), ms(9.0));
        foresight.learn(ms(70.0));
        assert_eq!(foresight.expected(), ms(70.0));
        (0..Foresight::NEWEST).for_each(|_| foresight.learn(ms(9.0)));
        assert_eq!(foresight.expected(), ms(9.0), "both are forgotten");
    }
}
