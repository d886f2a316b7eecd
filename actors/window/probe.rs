//! Who measures a window in a user's place: `foveal bench viewer`.

use std::time::Duration;

use foveal_engine::navigation::Motion;
use foveal_engine::process::cpu_ns;
use foveal_engine::walk::{FrameTimes, Next, Walk};

/// Walks ahead, stands still, looks on, and closes the window.
#[derive(Clone, Debug)]
pub struct Probe {
    walk: Duration,
    /// How long it goes one way before it turns round; `None`: it goes ahead.
    turns: Option<Duration>,
    idle: Duration,
    stage: Stage,
    pub(super) measured: Measured,
    /// When the last picture came, and how long after the one before each did.
    last: Option<f64>,
    pictures: FrameTimes,
}

/// What a probe does now; times in seconds since the start.
#[derive(Clone, Copy, Debug)]
enum Stage {
    Opening,
    Walking { since: f64, motion: Motion },
    Settling,
    Idle { until: f64, cpu: f64, frames: u32 },
}

/// What a probe measured.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measured {
    /// Seconds until the window showed anything.
    pub visible: Option<f64>,
    /// Seconds until it showed the lit scene.
    pub lit: Option<f64>,
    /// Median and 99th percentile of frame times while walking, seconds.
    pub frames: Option<(f32, f32)>,
    /// The same of the times from one picture in the window to the next.
    pub pictures: Option<(f32, f32)>,
    /// Share of a core that the still view took, all threads together.
    pub idle_cpu: Option<f64>,
    /// Pictures presented in that time.
    pub idle_frames: Option<u32>,
    /// Pictures presented.
    presented: u32,
}

impl Probe {
    /// One that walks and then looks on for so long.
    pub fn new(walk: Duration, idle: Duration) -> Self {
        Self {
            walk,
            turns: None,
            idle,
            stage: Stage::Opening,
            measured: Measured::default(),
            last: None,
            pictures: FrameTimes::default(),
        }
    }

    /// One that walks to and fro, to the side, and so long each way.
    pub fn turning(self, turns: Duration) -> Self {
        Self { turns: Some(turns), ..self }
    }

    /// Something was presented: a new picture of the walk, or something else beside the one before.
    pub(super) fn on_presented(&mut self, now: f64, has_picture: bool, is_new: bool) {
        self.measured.presented += 1;
        if is_new && let Some(last) = self.last.replace(now) {
            self.pictures.push(Duration::from_secs_f64((now - last).max(0.0)));
        }
        self.measured.visible.get_or_insert(now);
        if has_picture {
            self.measured.lit.get_or_insert(now);
        }
    }

    /// Where it goes after so many seconds.
    fn motion(&self, after: f64) -> Motion {
        match self.turns {
            None => Motion::Forward,
            Some(turns) if ((after / turns.as_secs_f64()) as u64).is_multiple_of(2) => Motion::Left,
            Some(_) => Motion::Right,
        }
    }

    /// Goes on. Returns when to be called again, unless it is over.
    pub(super) fn tick(&mut self, walk: &mut Walk, next: Next, now: f64) -> Option<Next> {
        match self.stage {
            Stage::Opening if self.measured.lit.is_some() => {
                walk.navigator.press(self.motion(0.0), now);
                walk.times.clear();
                self.pictures.clear();
                self.stage = Stage::Walking { since: now, motion: self.motion(0.0) };
            }
            Stage::Walking { since, motion } if now - since >= self.walk.as_secs_f64() => {
                self.measured.frames = walk.times.median_p99();
                self.measured.pictures = self.pictures.median_p99();
                walk.navigator.release(motion, now);
                self.stage = Stage::Settling;
            }
            Stage::Walking { since, motion } if motion != self.motion(now - since) => {
                walk.navigator.release(motion, now);
                let motion = self.motion(now - since);
                walk.navigator.press(motion, now);
                self.stage = Stage::Walking { since, motion };
            }
            Stage::Settling if next == Next::Input => {
                let until = now + self.idle.as_secs_f64();
                self.stage = Stage::Idle { until, cpu: 1e-9 * cpu_ns(), frames: self.measured.presented };
                return Some(Next::At(until));
            }
            Stage::Idle { until, .. } if now < until => return Some(Next::At(until)),
            Stage::Idle { cpu, frames, .. } => {
                let share = (1e-9 * cpu_ns() - cpu) / self.idle.as_secs_f64();
                self.measured.idle_cpu = Some(share).filter(|share| share.is_finite());
                self.measured.idle_frames = Some(self.measured.presented - frames);
                return None;
            }
            Stage::Opening | Stage::Walking { .. } | Stage::Settling => {}
        }
        Some(next)
    }
}
