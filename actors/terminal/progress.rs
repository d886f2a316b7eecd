//! What long work says on stderr: bars, or lines of JSON; and Ctrl-C.

use std::io::Write as _;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};

use foveal_engine::bake_clock::{BakeStanding, Watch};
use foveal_engine::interrupt::interrupt;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;

/// Milliseconds between two lines of JSON.
const EVERY: u64 = 250;
/// Steps of a bake's bar.
const STEPS: u64 = 1000;

/// From now on Ctrl-C asks for an end instead of forcing one; a second one forces it.
pub fn end_on_interrupt() {
    let handler = || {
        if interrupt() {
            std::process::exit(130);
        }
    };
    // Where it is handled elsewhere it forces an end at once.
    let _ = ctrlc::set_handler(handler);
}

/// Whether progress bars are drawn.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// On a terminal and not quiet.
    pub shown: bool,
}

impl Progress {
    /// A bar over `length` steps, hidden where none is wanted.
    pub fn bar(self, length: u64, what: &'static str) -> ProgressBar {
        self.styled(length, "{msg:>14} {bar:30} {pos}/{len} {eta}").with_message(what)
    }

    /// A bar for a bake, if there is one.
    pub fn baking(self) -> BakeBar {
        BakeBar { progress: self, bar: OnceLock::new() }
    }

    fn styled(self, length: u64, style: &str) -> ProgressBar {
        if !self.shown {
            return ProgressBar::hidden();
        }
        let bar = ProgressBar::new(length);
        match ProgressStyle::with_template(style) {
            Ok(style) => bar.with_style(style),
            Err(_) => bar,
        }
    }
}

/// A bake's bar: appears with its first word, and goes with it.
pub struct BakeBar {
    progress: Progress,
    bar: OnceLock<ProgressBar>,
}

impl Watch for BakeBar {
    fn baking(&self, s: &BakeStanding) {
        let bar = self.bar.get_or_init(|| self.progress.styled(STEPS, "{bar:30} {msg}"));
        let seconds = s.elapsed.as_secs_f64();
        let ahead = s.seconds_left.map_or(0.0, |left| seconds / (seconds + left).max(1e-9));
        bar.set_position((ahead * STEPS as f64) as u64);
        let round =
            if s.stage == "gather" { format!(" {:.0} %", 100.0 * s.rounds.fract()) } else { String::new() };
        let error = s.error.map_or(String::new(), |e| format!(", error {:.1} %", 100.0 * e));
        let eta = s.seconds_left.map_or(String::new(), |s| format!(", {s:.0} s left"));
        bar.set_message(format!("{}{round}{error}{eta}", s.stage));
    }
}

impl Drop for BakeBar {
    fn drop(&mut self) {
        if let Some(bar) = self.bar.get() {
            bar.finish_and_clear();
        }
    }
}

/// A bake's progress as lines of JSON on stderr, for other programs.
#[derive(Default)]
pub struct BakeLines {
    /// Milliseconds from the start to the last line.
    said: AtomicU64,
}

impl Watch for BakeLines {
    fn baking(&self, s: &BakeStanding) {
        let now = s.elapsed.as_millis() as u64;
        let last = self.said.load(Ordering::Relaxed);
        if last != 0 && now < last + EVERY {
            return;
        }
        self.said.store(now.max(1), Ordering::Relaxed);
        let line = json!({
            "schema": "foveal.bake.progress/1",
            "stage": s.stage,
            "seconds": s.elapsed.as_secs_f64(),
            "particles": s.particles,
            "rounds": s.rounds,
            "error": s.error,
            "eta_seconds": s.seconds_left,
        });
        // Nobody may be reading any more.
        let _ = writeln!(std::io::stderr(), "{line}");
    }
}
