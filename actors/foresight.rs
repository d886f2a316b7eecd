//! How long something will take, by how long it took: what follows a deadline must begin so much before it, and what does
//! not fit is not begun.

use std::time::Duration;

/// A running estimate of a time that is rarely exceeded: the mean and two mean deviations, as TCP waits for an answer
/// (Jacobson, *Congestion avoidance and control*, 1988). The first time, for which pages are still to be read, says nothing of
/// the third: it is forgotten once there is a second one.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Foresight {
    /// Mean and mean deviation, seconds; `None` before anything is known.
    known: Option<(f64, f64)>,
    /// Whether more than the first is known.
    is_settled: bool,
}

impl Foresight {
    /// Weight of the newest time in the mean.
    const MEAN: f64 = 0.125;
    /// The same in the deviation.
    const DEVIATION: f64 = 0.25;

    /// It took so long this time.
    pub fn learn(&mut self, took: Duration) {
        let took = took.as_secs_f64();
        let before = self.known.filter(|_| self.is_settled);
        self.is_settled = self.known.is_some();
        let (mean, deviation) = before.unwrap_or((took, 0.5 * took));
        let error = took - mean;
        self.known =
            Some((mean + Self::MEAN * error, deviation + Self::DEVIATION * (error.abs() - deviation)));
    }

    /// Whether it was seen at least once.
    pub fn is_known(&self) -> bool {
        self.known.is_some()
    }

    /// How long it takes at most, nearly always; nothing before it was seen once.
    pub fn expected(&self) -> Duration {
        let (mean, deviation) = self.known.unwrap_or_default();
        Duration::try_from_secs_f64(mean + 2.0 * deviation).unwrap_or_default()
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
        assert!(foresight.expected() > ms(13.0) && foresight.expected() < ms(20.0));
    }

    #[test]
    fn the_first_time_is_forgotten_once_there_is_a_second() {
        let mut foresight = Foresight::default();
        foresight.learn(ms(60.0));
        assert!(foresight.expected() >= ms(60.0), "nothing else is known");
        foresight.learn(ms(9.0));
        let mut plain = Foresight::default();
        (0..2).for_each(|_| plain.learn(ms(9.0)));
        assert_eq!(foresight, plain);
        foresight.learn(ms(60.0));
        assert!(foresight.expected() > ms(30.0), "a later one is not");
    }
}
