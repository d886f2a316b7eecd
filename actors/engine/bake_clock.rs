//! A bake's time: how much is left, where it went, and who is told of it.

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use foveal::illumination::bake::{Progress as Baking, Stage};

use crate::interrupt::interrupted;

/// Names of stages in reports, in the order in which they come.
pub const STAGES: [&str; 6] = ["elements", "direct", "particles", "error", "estimate", "radiosity"];
/// The last estimate gets at least one in so many parts of the time.
const RESERVE: u32 = 6;
/// What it takes, compared to an estimate of the error, about.
const ESTIMATE_PER_ERROR: u64 = 3;
/// Share of the time after which what remains is made coarsely.
const LATE: f32 = 0.95;
/// After an interruption so long is left for as good a map as ever.
const PATIENCE: Duration = Duration::from_secs(3);
/// Where a bake stands.
#[derive(Clone, Copy, Debug)]
pub struct BakeStanding {
    /// What it does: one of [`STAGES`].
    pub stage: &'static str,
    /// Since its start.
    pub elapsed: Duration,
    /// Particles so far; of radiosity its triangles.
    pub particles: u64,
    /// Rounds of direct light so far, the share of the current one in the fraction.
    pub direct_rounds: f32,
    /// Relative error of irradiance, once it is known.
    pub error: Option<f32>,
    /// Seconds left, once they can be foreseen.
    pub seconds_left: Option<f64>,
}

/// Who is told how far a bake is.
pub trait Watch: Sync {
    /// It is about to go on from here. Called a few times a second, from any thread.
    fn baking(&self, standing: &BakeStanding);
}

/// Nobody.
impl Watch for () {
    fn baking(&self, _: &BakeStanding) {}
}

/// A bake's clock: what is left of its time, and the time by stage.
pub struct BakeClock<'w> {
    start: Instant,
    limit: Option<Duration>,
    watch: &'w dyn Watch,
    /// Error and particles at which it ends.
    aims: (f32, u64),
    current: AtomicUsize,
    /// Nanoseconds from the start to when the current stage began.
    since: AtomicU64,
    sums: [AtomicU64; STAGES.len()],
    /// Nanoseconds kept for the last estimate.
    reserve: AtomicU64,
    /// Nanoseconds from the start to when an interruption was noticed; 0 before.
    interrupted: AtomicU64,
    /// Particles that an interrupted bake had before.
    before: AtomicU64,
}

impl<'w> BakeClock<'w> {
    /// A clock of what began at `start`, from which the time limit counts. `aims`: error and particles at which it ends.
    pub fn new(start: Instant, watch: &'w dyn Watch, limit: Option<Duration>, aims: (f32, u64)) -> Self {
        Self {
            start,
            limit,
            watch,
            aims,
            current: AtomicUsize::new(0),
            since: AtomicU64::new(0),
            sums: Default::default(),
            reserve: AtomicU64::new(0),
            interrupted: AtomicU64::new(0),
            before: AtomicU64::new(0),
        }
    }

    /// Another stage begins.
    pub fn enter(&self, stage: usize) {
        let now = self.start.elapsed().as_nanos() as u64;
        let before = self.since.swap(now, Ordering::Relaxed);
        let last = self.current.swap(stage, Ordering::Relaxed);
        self.sums[last].fetch_add(now.saturating_sub(before), Ordering::Relaxed);
    }

    /// The bake goes on from so many particles.
    pub fn resumed_at(&self, particles: u64) {
        self.before.store(particles, Ordering::Relaxed);
    }

    /// Whether the time is up, but for what the last estimate takes.
    pub fn is_over(&self) -> bool {
        let reserve = Duration::from_nanos(self.reserve.load(Ordering::Relaxed));
        self.limit.is_some_and(|limit| self.start.elapsed() + reserve.max(limit / RESERVE) >= limit)
    }

    /// Whether all must end now.
    pub fn is_late(&self) -> bool {
        let elapsed = self.start.elapsed();
        if interrupted() {
            let now = elapsed.as_nanos() as u64;
            let unset = self.interrupted.compare_exchange(0, now, Ordering::Relaxed, Ordering::Relaxed);
            let since = Duration::from_nanos(unset.err().unwrap_or(now));
            return elapsed >= since + PATIENCE;
        }
        self.limit.is_some_and(|limit| elapsed >= limit.mul_f32(LATE))
    }

    /// The bake is about to do `p.stage`.
    pub fn at(&self, p: &Baking) {
        if STAGES[self.current.load(Ordering::Relaxed)] == "error" {
            // The error is estimated from a few elements, the irradiance at all of them.
            let now = self.start.elapsed().as_nanos() as u64;
            let taken = now.saturating_sub(self.since.load(Ordering::Relaxed));
            self.reserve.fetch_max(ESTIMATE_PER_ERROR * taken, Ordering::Relaxed);
        }
        self.enter(match p.stage {
            Stage::Direct => 1,
            Stage::Particles => 2,
            Stage::Density => 3,
            Stage::Estimate => 4,
        });
        self.tell(p.particles, (p.direct_rounds, p.direct_share), p.relative_error);
    }

    /// Tells how far a bake without particles is.
    pub fn say(&self, done: u64, error: Option<f32>) {
        self.tell(done, (0, 0.0), error);
    }

    fn tell(&self, particles: u64, (rounds, share): (u32, f32), error: Option<f32>) {
        let elapsed = self.start.elapsed();
        self.watch.baking(&BakeStanding {
            stage: STAGES[self.current.load(Ordering::Relaxed)],
            elapsed,
            particles,
            direct_rounds: rounds as f32 + share,
            error,
            seconds_left: self.eta(elapsed.as_secs_f64(), particles, error),
        });
    }

    /// Seconds left: the error falls with the cube root of the particles (REFERENCE §6.3).
    fn eta(&self, seconds: f64, particles: u64, error: Option<f32>) -> Option<f64> {
        let (aim, most) = (f64::from(self.aims.0.max(1e-6)), self.aims.1 as f64);
        let done = particles as f64;
        let traced = done - self.before.load(Ordering::Relaxed) as f64;
        let by_particles = (traced > 0.0).then(|| {
            let wanted = error.map_or(most, |e| (done * (f64::from(e) / aim).max(1.0).powi(3)).min(most));
            seconds * ((wanted - done) / traced).max(0.0)
        });
        let by_limit = self.limit.map(|limit| (limit.as_secs_f64() - seconds).max(0.0));
        by_particles.into_iter().chain(by_limit).min_by(f64::total_cmp)
    }

    /// Ends; seconds by stage, without those that never came.
    pub fn finish(&self) -> Vec<(&'static str, f64)> {
        self.enter(0);
        STAGES
            .iter()
            .zip(&self.sums)
            .map(|(&name, sum)| (name, sum.load(Ordering::Relaxed) as f64 * 1e-9))
            .filter(|(_, seconds)| *seconds > 0.0)
            .collect()
    }
}
