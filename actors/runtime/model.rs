//! The protocols without locks of ours under the model checker, in every interleaving of small cases.
//!
//! `RUSTFLAGS="--cfg loom" cargo test --release -p foveal-runtime --lib model`
//!
//! Actors, mailboxes and the scheduler are those of a live system: loom switches threads at each step of activation,
//! signals and parking ([`crate::sync`]). It does not see into crossbeam's queues, which have their own models; where a
//! model has a queue that must promise as little as possible, it is a stand-in.

use loom::sync::Arc;
use loom::sync::atomic::{AtomicUsize, Ordering};
use loom::thread;
use std::collections::VecDeque;

use crate::actor::node::AnyNode;
use crate::actor::supervise::OnPanic;
use crate::actor::{Actor, Cx};
use crate::mailbox::{Address, Bounds, Envelope};
use crate::message::{ActorId, Digest, Lane, Message};
use crate::pool::bitmap::Bitmap;
use crate::runtime::Runtime;
use crate::runtime::config::Config;
use crate::scheduler::eventcount::EventCount;
use crate::scheduler::link::{Control, Link};
use crate::scheduler::signals::signal;
use crate::scheduler::{Budget, ThreadCx};

/// A linearisable queue.
#[expect(clippy::disallowed_types, reason = "a stand-in for another crate's queue inside the model checker")]
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

/// What the modelled actor is told.
enum Word {
    Data,
    Urgent,
    Newest,
}

impl Message for Word {
    fn digest(&self, _: &mut Digest) {}

    fn kind(&self) -> &'static str {
        "Word"
    }

    fn lane(&self) -> Lane {
        match self {
            Self::Data => Lane::Data,
            Self::Urgent => Lane::Control,
            Self::Newest => Lane::Latest(0),
        }
    }
}

/// Counts by kind. Nothing but the activation orders one turn's writes before the next turn's reads.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Tally {
    data: usize,
    urgent: usize,
    newest: usize,
}

impl Actor for Tally {
    type Msg = Word;
    const NAME: &'static str = "tally";

    fn handle(&mut self, word: Word, _: &mut Cx<'_, Word>) {
        match word {
            Word::Data => self.data += 1,
            Word::Urgent => self.urgent += 1,
            Word::Newest => self.newest += 1,
        }
    }
}

/// A live system of one actor without threads of its own: each of loom's threads is a worker.
#[derive(Clone)]
struct System {
    address: Address<Word>,
    nodes: std::sync::Arc<[std::sync::Arc<dyn AnyNode>]>,
}

impl System {
    /// Runs `body` in every interleaving, then resumes the actor; returns what it was told must be `expected`.
    fn check(preemptions: usize, expected: Tally, body: fn(&Self) -> Vec<thread::JoinHandle<()>>) {
        let mut model = loom::model::Builder::new();
        // Without a bound this takes minutes.
        model.preemption_bound = Some(preemptions);
        model.check(move || {
            // A turn that looked at a real clock would differ from one interleaving to the next.
            let budget = Budget { messages: u64::MAX, nanoseconds: u64::MAX };
            let (runtime, (address, tally)) =
                Runtime::build(Config { budget, ring_turns: 1, ..Config::live(0) }, |wiring| {
                    let declared = wiring.declare::<Tally>(Bounds::messages(4));
                    let address = declared.address();
                    (address, wiring.spawn(declared, Tally::default(), OnPanic::Resume))
                })
                .expect("builds");
            let system = Self { address, nodes: std::sync::Arc::clone(&runtime.nodes) };
            body(&system).into_iter().for_each(|thread| thread.join().unwrap());
            system.order(Control::Resume);
            let link = system.link();
            assert_eq!(runtime.inspect(tally, |tally| *tally), Some(expected), "a message waits for ever");
            assert_eq!(link.activation.pending(), 0, "a unit of work is left");
            assert!(!link.signals.any(u32::MAX), "a signal is left");
            assert!(!link.signals.is_parked(), "nobody is paused");
            assert!(link.scheduler.settled(), "the system never comes to rest");
        });
    }

    fn link(&self) -> &Link {
        &self.address.mailbox.link
    }

    /// What a worker thread does: runs whatever is on a run queue.
    fn work(&self, thread: &ThreadCx) {
        let scheduler = &self.link().scheduler;
        while let Some(actor) = scheduler.next_light() {
            scheduler.run(&self.nodes, actor, thread);
        }
    }

    fn tell(&self, message: Word) {
        let thread = ThreadCx::outside();
        let envelope = Envelope { from: ActorId(9), sequence: 0, digest: 0, external: None, message };
        assert!(self.address.mailbox.accept(envelope, &thread).is_ok());
        self.work(&thread);
    }

    fn order(&self, control: Control) {
        let thread = ThreadCx::outside();
        self.link().control(control, &thread);
        self.work(&thread);
    }

    fn spawn(&self, body: impl FnOnce(&Self) + 'static) -> thread::JoinHandle<()> {
        let system = self.clone();
        thread::spawn(move || body(&system))
    }
}

#[test]
fn model_every_message_is_handled_once_and_one_turn_at_a_time() {
    System::check(2, Tally { data: 3, ..Tally::default() }, |system| {
        let senders = [0, 1].map(|_| system.spawn(|system| system.tell(Word::Data)));
        system.tell(Word::Data);
        senders.into()
    });
}

#[test]
fn model_every_way_into_the_mailbox_is_heard() {
    System::check(2, Tally { data: 1, urgent: 1, newest: 1 }, |system| {
        let urgent = system.spawn(|system| system.tell(Word::Urgent));
        let newest = system.spawn(|system| system.tell(Word::Newest));
        system.tell(Word::Data);
        vec![urgent, newest]
    });
}

#[test]
fn model_orders_that_follow_each_other_leave_no_work_behind() {
    System::check(2, Tally { data: 1, ..Tally::default() }, |system| {
        // Each of these comes while the turns that the others began go on.
        let orders = system.spawn(|system| {
            [Control::Resume, Control::Pause].into_iter().for_each(|order| system.order(order));
        });
        let message = system.spawn(|system| system.tell(Word::Data));
        let orders_here = [Control::Pause, Control::Resume, Control::Pause];
        orders_here.into_iter().for_each(|order| system.order(order));
        vec![orders, message]
    });
}

#[test]
fn model_a_paused_actor_keeps_all_and_hears_what_gets_through() {
    System::check(3, Tally { data: 1, ..Tally::default() }, |system| {
        system.order(Control::Pause);
        let sender = system.spawn(|system| system.tell(Word::Data));
        let recorder = system.spawn(|system| {
            let thread = ThreadCx::outside();
            system.link().raise(signal::FLUSH, &thread);
            system.work(&thread);
        });
        system.order(Control::Resume);
        vec![sender, recorder]
    });
}
