//! A bake's time: how much is left, where it went, and who is told of it.

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use foveal::illumination::bake::{Progress as Baking, Stage};

/// Names of stages in reports, in the order in which they come.
pub const STAGES: [&str; 6] = ["elements", "first", "gather", "smooth", "test", "radiosity"];
/// The one in which maps are smoothed.
const SMOOTH: usize = 3;
/// The last map is smoothed in one in so many parts of the time, before it is known what that takes.
const RESERVE: u32 = 6;
/// Where a bake stands.
#[derive(Clone, Copy, Debug)]
pub struct BakeStanding {
    /// What it does: one of [`STAGES`].
    pub stage: &'static str,
    /// Since its start.
    pub elapsed: Duration,
    /// Paths so far; of radiosity its triangles.
    pub particles: u64,
    /// Rounds so far, the share of the current one in the fraction.
    pub rounds: f32,
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
    /// Error and paths at which it ends.
    aims: (f32, u64),
    current: AtomicUsize,
    /// Nanoseconds from the start to when the current stage began.
    since: AtomicU64,
    sums: [AtomicU64; STAGES.len()],
    /// Nanoseconds kept for smoothing the last map; 0 while that is not known.
    reserve: AtomicU64,
    /// Paths that an interrupted bake had before.
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

    /// The bake goes on from so many paths.
    pub fn resumed_at(&self, particles: u64) {
        self.before.store(particles, Ordering::Relaxed);
    }

    /// Whether the time is up, but for what smoothing takes.
    pub fn is_over(&self) -> bool {
        self.limit.is_some_and(|limit| {
            let reserve = match self.reserve.load(Ordering::Relaxed) {
                0 => limit / RESERVE,
                known => Duration::from_nanos(known),
            };
            self.start.elapsed() + reserve >= limit
        })
    }

    /// The bake is about to do `p.stage`.
    pub fn at(&self, p: &Baking) {
        if p.rounds > 0 {
            let smoothing = self.sums[SMOOTH].load(Ordering::Relaxed) / u64::from(p.rounds);
            self.reserve.store(smoothing, Ordering::Relaxed);
        }
        self.enter(match p.stage {
            Stage::First => 1,
            Stage::Gather => 2,
            Stage::Smooth => SMOOTH,
            Stage::Test => 4,
        });
        self.tell(p.particles, (p.rounds, p.round_share), p.relative_error);
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
            rounds: rounds as f32 + share,
            error,
            seconds_left: self.eta(elapsed.as_secs_f64(), particles, error),
        });
    }

    /// Seconds left: the error falls with the square root of the paths.
    fn eta(&self, seconds: f64, particles: u64, error: Option<f32>) -> Option<f64> {
        let (aim, most) = (f64::from(self.aims.0.max(1e-6)), self.aims.1 as f64);
        let done = particles as f64;
        let traced = done - self.before.load(Ordering::Relaxed) as f64;
        let by_particles = (traced > 0.0).then(|| {
            let wanted = error.map_or(most, |e| (done * (f64::from(e) / aim).max(1.0).powi(2)).min(most));
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
