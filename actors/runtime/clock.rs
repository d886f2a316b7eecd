//! Time as the runtime sees it: nanoseconds since the system was built, real or virtual.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// A moment, in nanoseconds since the system was built.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Time(pub u64);

impl Time {
    /// Seconds since the system was built.
    pub fn seconds(self) -> f64 {
        self.0 as f64 * 1e-9
    }

    /// The time from `earlier` to this moment; zero if `earlier` is later.
    pub fn since(self, earlier: Self) -> Duration {
        Duration::from_nanos(self.0.saturating_sub(earlier.0))
    }
}

impl std::ops::Add<Duration> for Time {
    type Output = Self;

    fn add(self, duration: Duration) -> Self {
        Self(self.0.saturating_add(nanoseconds(duration)))
    }
}

/// Nanoseconds of a duration; more than 584 years are cut.
pub(crate) fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

/// The one place where the runtime reads a clock.
#[derive(Debug)]
pub(crate) enum Clock {
    Real {
        start: Instant,
        /// The processor's counter, where it has one that runs evenly: a third of the cost of asking the system. A
        /// machine that slept may set it back, so nothing waits by it.
        counter: quanta::Clock,
        counter_start: u64,
    },
    /// Moved only by the simulator.
    Virtual(AtomicU64),
}

impl Clock {
    pub(crate) fn real() -> Self {
        let counter = quanta::Clock::new();
        let counter_start = counter.raw();
        Self::Real { start: Instant::now(), counter, counter_start }
    }

    pub(crate) fn starting_at_zero() -> Self {
        Self::Virtual(AtomicU64::new(0))
    }

    #[inline]
    pub(crate) fn now(&self) -> u64 {
        match self {
            Self::Real { start, .. } => nanoseconds(start.elapsed()),
            Self::Virtual(now) => now.load(Ordering::Relaxed),
        }
    }

    /// The time for begin, length and budget of turns: read for each of them, so it must cost next to nothing.
    #[inline]
    pub(crate) fn turn_time(&self) -> u64 {
        match self {
            Self::Real { counter, counter_start, .. } => {
                counter.delta_as_nanos(*counter_start, counter.raw())
            }
            Self::Virtual(now) => now.load(Ordering::Relaxed),
        }
    }

    /// Moves a virtual clock forward to `time`; a real one moves by itself.
    pub(crate) fn advance_to(&self, time: u64) {
        if let Self::Virtual(now) = self {
            now.fetch_max(time, Ordering::Relaxed);
        }
    }
}
