//! The main thread's side of parking, and the hook that calls it back from an event loop of its own.

use std::sync::atomic::{AtomicBool, AtomicU8, Ordering, fence};
use std::thread::Thread;
use std::time::Duration;

use super::Scheduler;
use crate::message::incident::{Incident, guarded};

const AWAY: u8 = 0;
const PUMPING: u8 = 1;
const PARKED: u8 = 2;

/// Calls an event loop.
pub(crate) type Waker = Box<dyn Fn() + Send + Sync>;

/// Where the main thread is.
pub(super) struct MainGate {
    state: AtomicU8,
    thread: Thread,
    called: AtomicBool,
    waker: Option<Waker>,
}

impl MainGate {
    /// Of the thread that calls this.
    pub(super) fn new(waker: Option<Waker>) -> Self {
        let thread = std::thread::current();
        Self { state: AtomicU8::new(AWAY), thread, called: AtomicBool::new(false), waker }
    }
}

impl Scheduler {
    /// Wakes the main thread, or calls its event loop.
    pub(crate) fn notify_main(&self) {
        fence(Ordering::SeqCst);
        match self.main.state.load(Ordering::Relaxed) {
            PARKED => self.main.thread.unpark(),
            AWAY => {
                if let Some(waker) = &self.main.waker
                    && !self.main.called.swap(true, Ordering::AcqRel)
                {
                    self.call(waker);
                }
            }
            _ => {}
        }
    }

    /// Calls the event loop: once for all that waits, so not where messages are counted in nanoseconds.
    #[cold]
    fn call(&self, waker: &(dyn Fn() + Send + Sync)) {
        if let Err(message) = guarded(waker) {
            self.note(Incident::Beside { what: "the waker".to_owned(), message });
        }
    }

    /// The main thread enters its pump.
    pub(crate) fn enter_main(&self) {
        self.main.state.store(PUMPING, Ordering::SeqCst);
    }

    /// The main thread leaves its pump; if work for it is left, its event loop is called at once.
    pub(crate) fn leave_main(&self) {
        self.main.called.store(false, Ordering::SeqCst);
        self.main.state.store(AWAY, Ordering::SeqCst);
        fence(Ordering::SeqCst);
        if self.main_has_work() {
            self.notify_main();
        }
    }

    /// Parks the main thread unless `ready` holds, at most for `timeout`.
    pub(crate) fn park_main(&self, timeout: Duration, ready: impl FnOnce() -> bool) {
        self.main.state.store(PARKED, Ordering::SeqCst);
        fence(Ordering::SeqCst);
        if !self.main_has_work() && !ready() {
            if timeout == Duration::MAX {
                std::thread::park();
            } else {
                std::thread::park_timeout(timeout);
            }
        }
        self.main.state.store(PUMPING, Ordering::SeqCst);
    }

    fn main_has_work(&self) -> bool {
        !self.pinned.is_empty() || (self.threads == 0 && !(self.light.is_empty() && self.heavy.is_empty()))
    }
}
