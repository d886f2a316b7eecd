//! The lock-free protocols under the model checker, in every interleaving of small cases.
//!
//! `RUSTFLAGS="--cfg loom" cargo test --release -p foveal-runtime --lib model`
//!
//! Queues are stand-ins (loom does not see into crossbeam's, which have their own models); what is checked is the order
//! of our steps around them.

use loom::sync::Arc;
use loom::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use loom::thread;
use std::collections::VecDeque;

use crate::activation::Activation;
use crate::eventcount::EventCount;
use crate::pool::Bitmap;
use crate::signals::{Signals, signal};

/// A linearisable queue.
#[expect(clippy::disallowed_types, reason = "a stand-in for a lock-free queue inside the model checker")]
struct Queue(loom::sync::Mutex<VecDeque<u32>>);

impl Queue {
    #[expect(clippy::disallowed_types, reason = "as above")]
    fn new() -> Self {
        Self(loom::sync::Mutex::new(VecDeque::new()))
    }

    fn push(&self, item: u32) {
        self.0.lock().unwrap().push_back(item);
    }

    fn pop(&self) -> Option<u32> {
        self.0.lock().unwrap().pop_front()
    }

    fn is_empty(&self) -> bool {
        self.0.lock().unwrap().is_empty()
    }
}

/// An actor: senders run it themselves when they activate it, as a worker thread would.
struct Actor {
    mailbox: Queue,
    activation: Activation,
    in_turn: AtomicBool,
    /// Written with plain stores by whoever runs the turn: only the activation orders them.
    state: AtomicUsize,
}

impl Actor {
    fn tell(&self, message: u32) {
        self.mailbox.push(message);
        if self.activation.add() {
            while self.turn() {}
        }
    }

    fn turn(&self) -> bool {
        assert!(!self.in_turn.swap(true, Ordering::Relaxed), "two turns at once");
        let mut consumed = self.activation.owed();
        let mut state = self.state.load(Ordering::Relaxed);
        while self.mailbox.pop().is_some() {
            consumed += 1;
            state += 1;
        }
        self.state.store(state, Ordering::Relaxed);
        self.in_turn.store(false, Ordering::Relaxed);
        self.activation.finish(consumed)
    }
}

#[test]
fn model_activation_runs_every_message_once_and_one_turn_at_a_time() {
    let mut model = loom::model::Builder::new();
    // Three threads without a bound take minutes.
    model.preemption_bound = Some(3);
    model.check(|| {
        let actor = Arc::new(Actor {
            mailbox: Queue::new(),
            activation: Activation::new(),
            in_turn: AtomicBool::new(false),
            state: AtomicUsize::new(0),
        });
        let senders: Vec<_> = (0..2)
            .map(|sender| {
                let actor = Arc::clone(&actor);
                thread::spawn(move || actor.tell(sender))
            })
            .collect();
        actor.tell(7);
        senders.into_iter().for_each(|sender| sender.join().unwrap());
        assert_eq!(
            actor.state.load(Ordering::Relaxed),
            3,
            "a message was lost, or its turn's state not seen"
        );
        assert!(actor.mailbox.is_empty() && actor.activation.pending() == 0);
    });
}

#[test]
fn model_eventcount_loses_no_wake_up() {
    loom::model(|| {
        let shared = Arc::new((EventCount::new(), AtomicUsize::new(0)));
        let sleeper = {
            let shared = Arc::clone(&shared);
            thread::spawn(move || {
                let (sleepers, work) = &*shared;
                while work.load(Ordering::Relaxed) == 0 {
                    sleepers.prepare(0);
                    if work.load(Ordering::Relaxed) == 0 {
                        // A wake-up that is lost here is a deadlock, which loom reports.
                        thread::park();
                    }
                    sleepers.cancel(0);
                }
            })
        };
        let (sleepers, work) = &*shared;
        work.store(1, Ordering::Relaxed);
        if sleepers.notify_one().is_some() {
            sleeper.thread().unpark();
        }
        sleeper.join().unwrap();
    });
}

/// A bucket that promises as little as a queue may: what nothing else orders, a look at it may miss.
struct Bucket(AtomicUsize);

impl Bucket {
    fn new() -> Self {
        Self(AtomicUsize::new(0))
    }

    fn push(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    fn pop(&self) -> Option<usize> {
        self.0.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |jobs| jobs.checked_sub(1)).ok()
    }

    fn is_empty(&self) -> bool {
        self.0.load(Ordering::Relaxed) == 0
    }
}

#[test]
fn model_pool_gives_every_job_once() {
    loom::model(|| {
        let shared = Arc::new((Bitmap::new(), [Bucket::new(), Bucket::new()]));
        let taken = Arc::new(AtomicUsize::new(0));
        let take = |shared: &(Bitmap, [Bucket; 2])| {
            let (bitmap, buckets) = shared;
            bitmap.take(
                0,
                |bucket| buckets[bucket as usize].pop(),
                |bucket| buckets[bucket as usize].is_empty(),
            )
        };
        let pusher = {
            let shared = Arc::clone(&shared);
            thread::spawn(move || {
                // Twice the same bucket: a worker may find it empty between the two and clear its bit.
                for bucket in [0, 0] {
                    shared.1[bucket].push();
                    shared.0.raise(bucket as u32);
                }
            })
        };
        let worker = {
            let (shared, taken) = (Arc::clone(&shared), Arc::clone(&taken));
            thread::spawn(move || {
                if take(&shared).is_some() {
                    taken.fetch_add(1, Ordering::Relaxed);
                }
            })
        };
        if take(&shared).is_some() {
            taken.fetch_add(1, Ordering::Relaxed);
        }
        pusher.join().unwrap();
        worker.join().unwrap();
        // Whatever was not taken on the way is found now: no bit was lost.
        while take(&shared).is_some() {
            taken.fetch_add(1, Ordering::Relaxed);
        }
        assert_eq!(taken.load(Ordering::Relaxed), 2);
        assert!(shared.1.iter().all(Bucket::is_empty));
    });
}

#[test]
fn model_idle_worker_and_pushed_job_find_each_other() {
    loom::model(|| {
        let shared = Arc::new((Bitmap::new(), Queue::new(), EventCount::new()));
        let worker = {
            let shared = Arc::clone(&shared);
            thread::spawn(move || {
                let (bitmap, bucket, idle) = &*shared;
                loop {
                    if bitmap.take(0, |_| bucket.pop(), |_| bucket.is_empty()).is_some() {
                        return;
                    }
                    idle.prepare(0);
                    if bitmap.is_empty() {
                        thread::park();
                    }
                    idle.cancel(0);
                }
            })
        };
        let (bitmap, bucket, idle) = &*shared;
        bucket.push(1);
        bitmap.raise(0);
        if idle.notify_one().is_some() {
            worker.thread().unpark();
        }
        worker.join().unwrap();
    });
}

/// An actor's mailbox with its signals, run as [`Actor`] is.
struct Mailbox {
    data: Queue,
    signals: Signals,
    activation: Activation,
    in_turn: AtomicBool,
    /// Written with plain stores by whoever runs the turn.
    paused: AtomicBool,
    got: AtomicUsize,
}

impl Mailbox {
    fn wake(&self) {
        if self.activation.add() {
            while self.turn() {}
        }
    }

    fn tell(&self, message: u32) {
        self.data.push(message);
        self.wake();
    }

    fn order(&self, bit: u32) {
        if bit == signal::PAUSE {
            self.signals.withdraw(signal::RESUME);
        }
        if self.signals.raise(bit) {
            self.wake();
            if self.signals.unpark() {
                while self.turn() {}
            }
        }
    }

    fn turn(&self) -> bool {
        assert!(!self.in_turn.swap(true, Ordering::Relaxed), "two turns at once");
        let mut consumed = self.activation.owed();
        let mut paused = self.paused.load(Ordering::Relaxed);
        let mut got = self.got.load(Ordering::Relaxed);
        loop {
            let mask = if paused { signal::CONTROL } else { u32::MAX };
            if self.signals.any(mask) {
                let bits = self.signals.take(mask);
                consumed += bits.count_ones() as usize;
                paused = bits & signal::PAUSE != 0 && bits & signal::RESUME == 0
                    || paused && bits & signal::RESUME == 0;
            }
            if paused || self.data.pop().is_none() {
                break;
            }
            consumed += 1;
            got += 1;
        }
        self.paused.store(paused, Ordering::Relaxed);
        self.got.store(got, Ordering::Relaxed);
        self.in_turn.store(false, Ordering::Relaxed);
        let active = self.activation.finish(consumed);
        if active && paused { self.signals.park() } else { active }
    }
}

#[test]
fn model_mailbox_of_a_paused_actor_keeps_all_and_hears_its_orders() {
    let mut model = loom::model::Builder::new();
    model.preemption_bound = Some(3);
    model.check(|| {
        let mailbox = Arc::new(Mailbox {
            data: Queue::new(),
            signals: Signals::new(),
            activation: Activation::new(),
            in_turn: AtomicBool::new(false),
            paused: AtomicBool::new(false),
            got: AtomicUsize::new(0),
        });
        mailbox.order(signal::PAUSE);
        let sender = {
            let mailbox = Arc::clone(&mailbox);
            thread::spawn(move || mailbox.tell(1))
        };
        mailbox.order(signal::RESUME);
        sender.join().unwrap();
        assert_eq!(mailbox.got.load(Ordering::Relaxed), 1, "the message waits for ever");
        assert!(!mailbox.paused.load(Ordering::Relaxed) && mailbox.activation.pending() == 0);
    });
}
