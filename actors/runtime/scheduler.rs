//! Which actor runs on which thread: k worker threads over stealing deques, and the main thread's pump.
//!
//! A run queue holds actor numbers. An actor is in at most one queue at a time, so no queue grows beyond the number of
//! actors. Light actors go to the deque of the thread that woke them; heavy ones (jobs of milliseconds) to a queue of
//! their own, of which at most `k − 1` run at once when `k > 1`; pinned ones to the main thread.

pub(crate) mod activation;
#[expect(clippy::disallowed_methods, reason = "the one clock, which actors reach by their `Cx`")]
pub(crate) mod clock;
pub(crate) mod eventcount;
pub(crate) mod link;
mod main_gate;
pub(crate) mod priority;
pub(crate) mod profile;
pub(crate) mod signals;
mod threads;
pub(crate) mod timer;
pub(crate) mod work;

use crossbeam_deque::{Injector, Steal, Stealer, Worker};
use crossbeam_queue::{ArrayQueue, SegQueue};
use crossbeam_utils::{Backoff, CachePadded};
use std::any::Any;
use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::Thread;

use crate::message::incident::{Incident, message_of};
use crate::scheduler::clock::Clock;
use crate::scheduler::eventcount::EventCount;
use crate::scheduler::link::{Class, Link};
use crate::scheduler::timer::Timers;
use crate::sync::QueueOrder;

use main_gate::MainGate;

pub(crate) use main_gate::Waker;
pub(crate) use threads::Threads;

/// The system stands, since it has come to where it was to stop, or diverged.
const STANDS: u8 = 1;
/// Somebody looks at all of it for a moment.
const HELD: u8 = 2;
/// Something that takes turns: an actor, whatever its messages are.
pub(crate) trait Runnable: Send + Sync {
    /// Runs one turn; true if it must be queued again.
    fn turn(&self, thread: &ThreadCx) -> bool;
    fn link(&self) -> &Arc<Link>;
}

/// How a turn is bounded: the actor goes to the back of the queue after either.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Budget {
    /// Messages.
    pub messages: u64,
    /// Nanoseconds.
    pub nanoseconds: u64,
}

impl Default for Budget {
    fn default() -> Self {
        Self { messages: 128, nanoseconds: 200_000 }
    }
}

/// What code on one thread of the system knows about its thread.
pub(crate) struct ThreadCx {
    /// The thread's own run queue; none on the main thread and outside.
    pub(crate) local: Option<Worker<u32>>,
    /// Position in profiles: 0 is the main thread.
    pub(crate) lane: u16,
    /// End of the last turn on this thread if nothing came between, else 0: the next turn's start without a clock read.
    pub(crate) last_end: Cell<u64>,
}

impl ThreadCx {
    pub(crate) fn outside() -> Self {
        Self { local: None, lane: 0, last_end: Cell::new(0) }
    }
}

/// One running timer in the word that counts active actors.
const TIMER: u64 = 1 << 32;

/// The run queues and everything needed to wake a thread for them.
pub(crate) struct Scheduler {
    pub(crate) clock: Clock,
    pub(crate) timers: Timers,
    pub(crate) budget: Budget,
    /// Nobody is to begin or go on with a turn.
    halted: AtomicU8,
    threads: usize,
    light: Injector<u32>,
    heavy: Injector<u32>,
    pinned: SegQueue<u32>,
    order: QueueOrder,
    stealers: Box<[Stealer<u32>]>,
    handles: OnceLock<Box<[Thread]>>,
    sleepers: EventCount,
    main: MainGate,
    /// Actors on a queue or in a turn, and from bit 32 on the timers that run: one word, so that neither can pass into
    /// the other unseen.
    active: CachePadded<AtomicU64>,
    heavy_running: CachePadded<AtomicUsize>,
    /// Most heavy turns at once.
    heavy_limit: AtomicUsize,
    /// The same where no processor is left to others, and where each has one.
    heavy_most: [usize; 2],
    stopping: AtomicBool,
    /// Worker threads that rest because the system is halted.
    resting: AtomicUsize,
    /// What went wrong, oldest first.
    incidents: ArrayQueue<Incident>,
}

impl Scheduler {
    /// For `threads` worker threads (at most 64); the caller's thread becomes the main thread.
    pub(crate) fn new(
        threads: usize,
        clock: Clock,
        budget: Budget,
        waker: Option<Waker>,
    ) -> (Self, Vec<Worker<u32>>) {
        let threads = threads.min(64);
        let cores = std::thread::available_parallelism().map_or(usize::MAX, usize::from);
        // More than there are cores would only take time from the main thread.
        let heavy_most = threads.saturating_sub(1).min(cores).max(1);
        let locals: Vec<Worker<u32>> = (0..threads).map(|_| Worker::new_fifo()).collect();
        let scheduler = Self {
            clock,
            timers: Timers::new(),
            budget,
            halted: AtomicU8::new(0),
            threads,
            light: Injector::new(),
            heavy: Injector::new(),
            pinned: SegQueue::new(),
            order: QueueOrder::new(),
            stealers: locals.iter().map(Worker::stealer).collect(),
            handles: OnceLock::new(),
            sleepers: EventCount::new(),
            main: MainGate::new(waker),
            active: CachePadded::new(AtomicU64::new(0)),
            heavy_running: CachePadded::new(AtomicUsize::new(0)),
            heavy_limit: AtomicUsize::new(heavy_most),
            heavy_most: [heavy_most, cores],
            stopping: AtomicBool::new(false),
            resting: AtomicUsize::new(0),
            incidents: ArrayQueue::new(INCIDENTS_MAX),
        };
        (scheduler, locals)
    }

    pub(crate) fn threads(&self) -> usize {
        self.threads
    }

    /// Puts an actor that became active on a run queue.
    #[inline]
    pub(crate) fn activate(&self, class: Class, actor: u32, thread: &ThreadCx) {
        self.active.fetch_add(1, Ordering::SeqCst);
        self.order.pass();
        match class {
            Class::Pinned => {
                self.pinned.push(actor);
                self.notify_main();
            }
            Class::Heavy => {
                self.heavy.push(actor);
                self.notify();
            }
            Class::Light => match &thread.local {
                Some(local) => {
                    local.push(actor);
                    if local.len() > self.in_a_row() {
                        self.notify();
                    }
                }
                None => {
                    self.light.push(actor);
                    self.notify();
                }
            },
        }
    }

    /// Light actors that run next on the very thread that activated them; more are work for somebody else.
    fn in_a_row(&self) -> usize {
        if self.heavy_running.load(Ordering::Relaxed) > 0 { LIGHT_IN_A_ROW } else { 1 }
    }

    /// Queues an active actor again after a turn that left work.
    fn again(&self, class: Class, actor: u32, thread: &ThreadCx) {
        self.order.pass();
        match (class, &thread.local) {
            (Class::Pinned, _) => self.pinned.push(actor),
            (Class::Heavy, _) => self.heavy.push(actor),
            (Class::Light, Some(local)) => {
                local.push(actor);
                if local.len() > self.in_a_row() {
                    self.notify();
                }
            }
            (Class::Light, None) => self.light.push(actor),
        }
    }

    /// Wakes one thread that can run light and heavy actors.
    #[inline]
    pub(crate) fn notify(&self) {
        if self.threads == 0 {
            self.notify_main();
        } else if let Some(thread) = self.sleepers.notify_one()
            && let Some(handles) = self.handles.get()
        {
            handles[thread].unpark();
        }
    }

    /// Wakes everyone, for a stop or a halt.
    pub(crate) fn notify_all(&self) {
        if let Some(handles) = self.handles.get() {
            handles.iter().for_each(Thread::unpark);
        }
        self.notify_main();
    }

    /// The next pinned actor.
    pub(crate) fn next_pinned(&self) -> Option<u32> {
        self.pinned.pop()
    }

    /// The next light actor, for a main thread that works alone.
    pub(crate) fn next_light(&self) -> Option<u32> {
        self.order.pass();
        steal(|| self.light.steal())
    }

    /// The next heavy actor, for a main thread that works alone.
    pub(crate) fn next_heavy(&self) -> Option<u32> {
        steal(|| self.heavy.steal())
    }

    pub(crate) fn heavy_waits(&self) -> bool {
        !self.heavy.is_empty()
    }

    /// No actor is on a run queue or in a turn.
    pub(crate) fn idle(&self) -> bool {
        self.active.load(Ordering::SeqCst).is_multiple_of(TIMER)
    }

    /// Neither is one, nor will a timer make one so.
    pub(crate) fn settled(&self) -> bool {
        self.active.load(Ordering::SeqCst) == 0
    }

    /// A timer runs from here on.
    pub(crate) fn timer_started(&self) {
        self.active.fetch_add(TIMER, Ordering::SeqCst);
    }

    /// A timer has fired; its actor is active already, or was.
    pub(crate) fn timer_fired(&self) {
        if self.active.fetch_sub(TIMER, Ordering::SeqCst) == TIMER {
            self.notify_main();
        }
    }

    #[inline]
    pub(crate) fn halted(&self) -> bool {
        self.halted.load(Ordering::Relaxed) != 0
    }

    /// Ends all turns at their next delivery, until [`Self::go_on`].
    pub(crate) fn halt(&self) {
        self.halted.fetch_or(STANDS, Ordering::SeqCst);
        self.notify_all();
    }

    pub(crate) fn go_on(&self) {
        self.halted.fetch_and(!STANDS, Ordering::SeqCst);
        self.notify_all();
    }

    /// The same, until [`Self::let_go`], whether the system stands or comes to stand meanwhile. Returns whether nobody holds
    /// it yet.
    pub(crate) fn hold(&self) -> bool {
        let is_first = self.halted.fetch_or(HELD, Ordering::SeqCst) & HELD == 0;
        self.notify_all();
        is_first
    }

    pub(crate) fn let_go(&self) {
        self.halted.fetch_and(!HELD, Ordering::SeqCst);
        self.notify_all();
    }

    /// A turn may be running or about to run on a worker thread. What waits for the main thread is not.
    pub(crate) fn busy(&self) -> bool {
        if self.halted() {
            return self.resting.load(Ordering::SeqCst) < self.threads;
        }
        let pinned = self.pinned.len() as u64;
        self.active.load(Ordering::SeqCst) % TIMER > pinned
    }

    /// Keeps a worker thread still while the system is halted.
    fn rest(&self) {
        self.resting.fetch_add(1, Ordering::SeqCst);
        while self.halted() && !self.stopping.load(Ordering::SeqCst) {
            std::thread::park();
        }
        self.resting.fetch_sub(1, Ordering::SeqCst);
    }

    /// Keeps an incident that no actor can be told of.
    pub(crate) fn note(&self, incident: Incident) {
        tracing::error!("{incident}");
        self.keep(incident);
    }

    /// Keeps an incident for whoever asks; where there are too many, the oldest are forgotten.
    pub(crate) fn keep(&self, incident: Incident) {
        self.incidents.force_push(incident);
    }

    /// What was kept since the last call.
    pub(crate) fn incidents(&self) -> Vec<Incident> {
        std::iter::from_fn(|| self.incidents.pop()).collect()
    }

    /// Runs one turn of `actor` on this thread and puts it back on a queue if it is not done.
    #[inline]
    pub(crate) fn run<N: Runnable + ?Sized>(&self, nodes: &[Arc<N>], actor: u32, thread: &ThreadCx) {
        let node = &nodes[actor as usize];
        let goes_on = match catch_unwind(AssertUnwindSafe(|| node.turn(thread))) {
            Ok(goes_on) => goes_on,
            Err(panic) => self.broke_off(node.link(), panic.as_ref()),
        };
        if goes_on {
            self.again(node.link().class, actor, thread);
        } else if self.active.fetch_sub(1, Ordering::SeqCst) % TIMER == 1 {
            self.notify_main();
        }
    }

    /// A turn did not come to its end; what is left of it is closed in the next one.
    #[cold]
    fn broke_off(&self, link: &Link, panic: &(dyn Any + Send)) -> bool {
        let message = message_of(panic);
        self.note(Incident::TurnBroke { actor: link.id, name: link.name.clone(), message });
        true
    }

    /// Makes every worker thread end.
    pub(crate) fn stop(&self) {
        self.stopping.store(true, Ordering::SeqCst);
        self.notify_all();
    }

    /// Whether worker threads are to end.
    pub(crate) fn is_stopping(&self) -> bool {
        self.stopping.load(Ordering::Relaxed)
    }

    fn find(&self, thread: &ThreadCx, index: usize, tick: u32) -> Option<u32> {
        let local = thread.local.as_ref()?;
        if tick.is_multiple_of(61)
            && let Some(actor) = steal(|| self.light.steal())
        {
            return Some(actor);
        }
        local.pop().or_else(|| steal(|| self.light.steal_batch_and_pop(local))).or_else(|| {
            (1..self.threads).find_map(|step| steal(|| self.stealers[(index + step) % self.threads].steal()))
        })
    }

    fn claim_heavy(&self) -> Option<u32> {
        if self.heavy.is_empty() {
            return None;
        }
        let limit = self.heavy_limit.load(Ordering::SeqCst);
        // A thread that finds the limit reached leaves no trace: it would wake the next one to find the same.
        let below = |running: usize| (running < limit).then_some(running + 1);
        self.heavy_running.fetch_update(Ordering::SeqCst, Ordering::SeqCst, below).ok()?;
        let actor = steal(|| self.heavy.steal());
        if actor.is_none() {
            self.release_heavy();
            self.offer_heavy();
        }
        actor
    }

    /// Heavy turns leave so many processors to others from now on; one may always run.
    pub(crate) fn leave_cores(&self, cores: usize) {
        let [most, all] = self.heavy_most;
        let limit = most.min(all.saturating_sub(cores)).max(1);
        let before = self.heavy_limit.swap(limit, Ordering::SeqCst);
        // Somebody sleeps for each that may run now.
        (before..limit).for_each(|_| self.offer_heavy());
    }

    /// A heavy actor's turn is over, or hangs: another one may run. True the first time.
    fn release_slot_of(&self, link: &Link) -> bool {
        let held = link.in_slot.swap(false, Ordering::SeqCst);
        if held {
            self.release_heavy();
        }
        held
    }

    /// A heavy actor hangs in its turn: another one may run on another thread.
    pub(crate) fn free_slot_of(&self, link: &Link) {
        if self.release_slot_of(link) {
            self.offer_heavy();
        }
    }

    fn release_heavy(&self) {
        self.heavy_running.fetch_sub(1, Ordering::SeqCst);
    }

    /// Somebody may have gone to sleep because the limit was reached, and it no longer is.
    fn offer_heavy(&self) {
        if self.threads > 1 && !self.heavy.is_empty() {
            self.notify();
        }
    }

    fn has_work(&self) -> bool {
        !self.light.is_empty()
            || self.stealers.iter().any(|stealer| !stealer.is_empty())
            || (!self.heavy.is_empty()
                && self.heavy_running.load(Ordering::SeqCst) < self.heavy_limit.load(Ordering::SeqCst))
    }
}

/// Incidents that are kept until somebody asks.
const INCIDENTS_MAX: usize = 64;

/// Light turns that a thread makes one after the other, while heavy ones take the cores, before it wakes another thread for
/// what waits behind them: most take a few microseconds, less than waking; and a thread that is woken beside busy ones
/// shares a core with one of them for milliseconds, while the core of the one that woke it may fall idle.
const LIGHT_IN_A_ROW: usize = 2;

/// Repeats a steal until it is decided. The one in whose way it is may have lost its core: it soon gets this one.
#[inline]
fn steal(mut attempt: impl FnMut() -> Steal<u32>) -> Option<u32> {
    let backoff = Backoff::new();
    loop {
        match attempt() {
            Steal::Success(actor) => return Some(actor),
            Steal::Empty => return None,
            Steal::Retry => backoff.snooze(),
        }
    }
}
