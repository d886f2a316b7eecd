//! Time as the runtime sees it: nanoseconds since the system was built, real or virtual.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use crate::scheduler::work::{HEAVY_NS, Work};

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
        /// The processor's counter, where it has one that runs evenly, and where it stood: a third of the cost of asking the
        /// system. A machine that slept may set it back, so nothing waits by it. `None` where the system is asked.
        counter: Option<(quanta::Clock, u64)>,
    },
    /// Moved only by the simulator, and by what work is said to take.
    Virtual {
        now: AtomicU64,
        work: Work,
        seed: u64,
        /// Durations drawn so far.
        drawn: AtomicU64,
    },
}

/// Processor time of this thread so far, nanoseconds.
#[cfg(unix)]
fn thread_ns() -> u64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
}

/// Not told here: the time of day stands in.
#[cfg(not(unix))]
fn thread_ns() -> u64 {
    std::time::SystemTime::UNIX_EPOCH.elapsed().map_or(0, nanoseconds)
}

impl Clock {
    pub(crate) fn real() -> Self {
        let counter = quanta::Clock::new();
        let counted = counter.raw();
        Self::Real { start: Instant::now(), counter: Some((counter, counted)) }
    }

    /// For a replay: to measure the processor's counter takes some milliseconds, and up to 200 where other programs run,
    /// longer than a look at one moment.
    pub(crate) fn of_replay() -> Self {
        Self::Real { start: Instant::now(), counter: None }
    }

    pub(crate) fn starting_at_zero(work: Work, seed: u64) -> Self {
        Self::Virtual { now: AtomicU64::new(0), work, seed, drawn: AtomicU64::new(0) }
    }

    #[inline]
    pub(crate) fn now(&self) -> u64 {
        match self {
            Self::Real { start, .. } => nanoseconds(start.elapsed()),
            Self::Virtual { now, .. } => now.load(Ordering::Relaxed),
        }
    }

    /// The time for begin, length and budget of turns: read for each of them, so it must cost next to nothing.
    #[inline]
    pub(crate) fn turn_time(&self) -> u64 {
        match self {
            Self::Real { counter: Some((counter, start)), .. } => {
                counter.delta_as_nanos(*start, counter.raw())
            }
            _ => self.now(),
        }
    }

    /// Does `work` and says how long it took: that long a virtual clock has moved on.
    pub(crate) fn measure<R>(&self, work: impl FnOnce() -> R) -> (R, u64) {
        let start = self.now();
        let spent = self.spent();
        let result = work();
        if let Self::Virtual { now, work, seed, drawn } = self {
            let took = match work {
                Work::Constant => 0,
                Work::Seeded => Work::draw(*seed, drawn.fetch_add(1, Ordering::Relaxed), HEAVY_NS),
                Work::Measured => self.spent().saturating_sub(spent),
            };
            now.fetch_add(took, Ordering::Relaxed);
        }
        (result, self.now().saturating_sub(start))
    }

    /// Where virtual time is what work really takes: the processor time of this thread so far.
    pub(crate) fn spent(&self) -> u64 {
        match self {
            Self::Virtual { work: Work::Measured, .. } => thread_ns(),
            _ => 0,
        }
    }

    /// Moves a virtual clock forward to `time`; a real one moves by itself.
    pub(crate) fn advance_to(&self, time: u64) {
        if let Self::Virtual { now, .. } = self {
            now.fetch_max(time, Ordering::Relaxed);
        }
    }
}

/// When a caller from outside has waited long enough, whatever clock the system goes by.
pub(crate) struct Deadline(Option<Instant>);

impl Deadline {
    /// So much later than now; never, if that is later than any moment there is.
    pub(crate) fn after(time: Duration) -> Self {
        Self(Instant::now().checked_add(time))
    }

    /// How long it is until then; none if that is over.
    pub(crate) fn left(&self) -> Option<Duration> {
        match self.0 {
            None => Some(Duration::MAX),
            Some(end) => end.checked_duration_since(Instant::now()).filter(|left| !left.is_zero()),
        }
    }
}
