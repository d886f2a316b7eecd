//! Counters and turn times of every actor, always on, readable at any time.

use crossbeam_utils::CachePadded;
use std::sync::atomic::{AtomicU64, Ordering};

/// Turns an actor's ring holds unless the configuration says otherwise.
pub const RING_TURNS: usize = 256;

/// One turn in the ring: when it began, and packed duration (ns, 32 bits), messages (20 bits), thread (12 bits).
#[derive(Default)]
struct Slot {
    start: AtomicU64,
    packed: AtomicU64,
}

/// Counters of one actor. Only the thread that runs the actor writes most of them, so they cost plain stores.
pub(crate) struct Counters {
    delivered: CachePadded<AtomicU64>,
    turns: AtomicU64,
    busy_ns: AtomicU64,
    depth_max: AtomicU64,
    dead_letters: AtomicU64,
    panics: AtomicU64,
    rejected: CachePadded<AtomicU64>,
    replaced: AtomicU64,
    ring: Box<[Slot]>,
}

/// Counters of one actor as they stood at some moment.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ActorCounters {
    /// The actor's name.
    pub name: String,
    /// Deliveries, jobs and timers included.
    pub delivered: u64,
    /// Turns.
    pub turns: u64,
    /// Time spent in turns, in nanoseconds.
    pub busy_ns: u64,
    /// Data messages that wait now; always 0 for ports.
    pub depth: u64,
    /// Most messages that ever waited when a turn began.
    pub depth_max: u64,
    /// Messages the mailbox gave back.
    pub rejected: u64,
    /// Newest-only messages that a newer one replaced.
    pub replaced: u64,
    /// Messages that were accepted and never handled, because the actor stopped or panicked over them.
    pub dead_letters: u64,
    /// Turns that panicked.
    pub panics: u64,
}

/// One turn of one actor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TurnTime {
    /// When it began, in nanoseconds since the system was built.
    pub start_ns: u64,
    /// How long it took, in nanoseconds (at most 4.29 s are told).
    pub duration_ns: u32,
    /// Deliveries in it.
    pub messages: u32,
    /// Thread: 0 the main one, then the workers.
    pub thread: u16,
}

impl Counters {
    pub(crate) fn new(turns: usize) -> Self {
        Self {
            delivered: CachePadded::default(),
            turns: AtomicU64::default(),
            busy_ns: AtomicU64::default(),
            depth_max: AtomicU64::default(),
            dead_letters: AtomicU64::default(),
            panics: AtomicU64::default(),
            rejected: CachePadded::default(),
            replaced: AtomicU64::default(),
            ring: (0..turns.next_power_of_two()).map(|_| Slot::default()).collect(),
        }
    }

    #[inline]
    pub(crate) fn delivered(&self) {
        add(&self.delivered, 1);
    }

    pub(crate) fn deliveries(&self) -> u64 {
        self.delivered.load(Ordering::Relaxed)
    }

    #[inline]
    pub(crate) fn turn(&self, start: u64, end: u64, messages: u64, depth: u64, thread: u16) {
        let turns = self.turns.load(Ordering::Relaxed);
        let duration = end.saturating_sub(start);
        let slot = &self.ring[turns as usize & (self.ring.len() - 1)];
        slot.start.store(start, Ordering::Relaxed);
        let packed = duration.min(u64::from(u32::MAX)) << 32
            | messages.min(0xf_ffff) << 12
            | u64::from(thread & 0xfff);
        slot.packed.store(packed, Ordering::Relaxed);
        self.turns.store(turns + 1, Ordering::Release);
        add(&self.busy_ns, duration);
        if depth > self.depth_max.load(Ordering::Relaxed) {
            self.depth_max.store(depth, Ordering::Relaxed);
        }
    }

    pub(crate) fn rejected(&self) {
        self.rejected.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn replaced(&self) {
        self.replaced.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn dead_letters(&self, count: u64) {
        add(&self.dead_letters, count);
    }

    pub(crate) fn panicked(&self) {
        add(&self.panics, 1);
    }

    pub(crate) fn read(&self, name: &str) -> ActorCounters {
        let load = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        ActorCounters {
            name: name.to_owned(),
            delivered: load(&self.delivered),
            turns: load(&self.turns),
            busy_ns: load(&self.busy_ns),
            depth: 0,
            depth_max: load(&self.depth_max),
            rejected: load(&self.rejected),
            replaced: load(&self.replaced),
            dead_letters: load(&self.dead_letters),
            panics: load(&self.panics),
        }
    }

    /// The turns still in the ring, oldest first. One that is being written may come out mixed of two.
    pub(crate) fn turn_times(&self) -> Vec<TurnTime> {
        let turns = self.turns.load(Ordering::Acquire);
        let first = turns.saturating_sub(self.ring.len() as u64);
        (first..turns)
            .map(|turn| {
                let slot = &self.ring[turn as usize & (self.ring.len() - 1)];
                let packed = slot.packed.load(Ordering::Relaxed);
                TurnTime {
                    start_ns: slot.start.load(Ordering::Relaxed),
                    duration_ns: (packed >> 32) as u32,
                    messages: (packed >> 12) as u32 & 0xf_ffff,
                    thread: packed as u16 & 0xfff,
                }
            })
            .collect()
    }
}

/// Adds to a counter that only one thread writes at a time.
#[inline]
fn add(counter: &AtomicU64, amount: u64) {
    counter.store(counter.load(Ordering::Relaxed) + amount, Ordering::Relaxed);
}

/// The time that so many turns take to enter an actor's ring and counters, with their clock readings or without: for
/// benchmarks.
pub fn ring_cost(turns: u32, reads_clock: bool) -> std::time::Duration {
    let (counters, clock) = (Counters::new(RING_TURNS), crate::scheduler::clock::Clock::real());
    let mut last = 0;
    for _ in 0..turns {
        // A turn begins where the last one ended: one reading each.
        let end = if reads_clock { clock.turn_time() } else { last + 1000 };
        std::hint::black_box(&counters).turn(last, end, 1, 1, 0);
        last = end;
    }
    std::time::Duration::from_nanos(clock.now())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ring_keeps_the_newest_turns() {
        let counters = Counters::new(4);
        (0..10).for_each(|turn| counters.turn(turn * 100, turn * 100 + 7, turn, turn, 3));
        let turns = counters.turn_times();
        assert_eq!(turns.iter().map(|turn| turn.start_ns).collect::<Vec<_>>(), [600, 700, 800, 900]);
        assert_eq!(turns[3], TurnTime { start_ns: 900, duration_ns: 7, messages: 9, thread: 3 });
        let read = counters.read("a");
        assert_eq!((read.turns, read.busy_ns, read.depth_max), (10, 70, 9));
    }
}
