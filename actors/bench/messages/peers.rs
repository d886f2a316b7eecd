//! The peers under the same loads: a bounded channel, a queue behind a lock, and two actor runtimes on tokio.

use std::collections::VecDeque;
use std::sync::Arc;
#[expect(clippy::disallowed_types, reason = "the queue that this program does without, to be measured")]
use std::sync::{Condvar, Mutex};
use std::time::{Duration, Instant};

use foveal::metrics::quantile;

use super::load::{Cost, IN_FLIGHT, Payload, WORKERS, cost};
use super::ours::HOPS;

/// What threads hand each other payloads by.
pub trait Queue<P>: Clone + Send + 'static {
    /// A queue of so many.
    fn bounded(capacity: usize) -> Self;
    /// Waits for room.
    fn send(&self, payload: Option<P>);
    /// Waits for a payload; none at the end.
    fn receive(&self) -> Option<P>;
}

/// `crossbeam-channel`.
pub struct Channel<P>(crossbeam_channel::Sender<Option<P>>, crossbeam_channel::Receiver<Option<P>>);

impl<P> Clone for Channel<P> {
    fn clone(&self) -> Self {
        Self(self.0.clone(), self.1.clone())
    }
}

impl<P: Send + 'static> Queue<P> for Channel<P> {
    fn bounded(capacity: usize) -> Self {
        let (sender, receiver) = crossbeam_channel::bounded(capacity);
        Self(sender, receiver)
    }

    fn send(&self, payload: Option<P>) {
        let _ = self.0.send(payload);
    }

    fn receive(&self) -> Option<P> {
        self.1.recv().ok().flatten()
    }
}

/// A queue behind a mutex with condition variables.
#[expect(clippy::disallowed_types, reason = "as above")]
pub struct Locked<P>(Arc<(Mutex<VecDeque<Option<P>>>, Condvar, Condvar, usize)>);

impl<P> Clone for Locked<P> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<P: Send + 'static> Queue<P> for Locked<P> {
    #[expect(clippy::disallowed_types, reason = "as above")]
    fn bounded(capacity: usize) -> Self {
        Self(Arc::new((Mutex::new(VecDeque::new()), Condvar::new(), Condvar::new(), capacity)))
    }

    fn send(&self, payload: Option<P>) {
        let (queue, filled, emptied, capacity) = &*self.0;
        let Ok(mut queue) = queue.lock() else { return };
        while queue.len() >= *capacity {
            let Ok(waited) = emptied.wait(queue) else { return };
            queue = waited;
        }
        queue.push_back(payload);
        filled.notify_one();
    }

    fn receive(&self) -> Option<P> {
        let (queue, filled, emptied, _) = &*self.0;
        let mut queue = queue.lock().ok()?;
        loop {
            if let Some(payload) = queue.pop_front() {
                emptied.notify_one();
                return payload;
            }
            queue = filled.wait(queue).ok()?;
        }
    }
}

/// One source, four workers, one collector, a thread each.
pub fn threads_fan<P: Payload, Q: Queue<P>>(jobs: u64) -> Cost {
    let pool = P::pool();
    let out = Q::bounded(IN_FLIGHT);
    let inputs: Vec<Q> = (0..WORKERS).map(|_| Q::bounded(IN_FLIGHT)).collect();
    let workers: Vec<_> = inputs
        .iter()
        .map(|input| {
            let (input, out) = (input.clone(), out.clone());
            std::thread::spawn(move || {
                let mut sum = 0_u64;
                while let Some(payload) = input.receive() {
                    sum = sum.wrapping_add(payload.sum());
                    out.send(Some(payload));
                }
                sum
            })
        })
        .collect();
    let collector = {
        let (out, pool) = (out.clone(), pool.clone());
        std::thread::spawn(move || {
            for _ in 0..jobs {
                let Some(payload) = out.receive() else { return };
                payload.give_back(&pool);
            }
        })
    };
    cost(|| {
        for number in 0..jobs {
            inputs[number as usize % WORKERS].send(Some(P::make(&pool, number)));
        }
        inputs.iter().for_each(|input| input.send(None));
        let _ = collector.join();
        workers.into_iter().for_each(|worker| drop(worker.join()));
    })
}

/// Median nanoseconds of a message between two threads that wait for each other.
pub fn threads_ping_pong<Q: Queue<u64>>(hops: u64) -> f64 {
    let (there, back) = (Q::bounded(4), Q::bounded(4));
    let other = {
        let (there, back) = (there.clone(), back.clone());
        std::thread::spawn(move || {
            while let Some(left) = there.receive() {
                back.send(Some(left));
            }
        })
    };
    let mut times = Vec::new();
    for _ in 0..hops / HOPS {
        let start = Instant::now();
        for left in 0..HOPS / 2 {
            there.send(Some(left));
            let _ = back.receive();
        }
        times.push(start.elapsed().as_nanos() as f64 / HOPS as f64);
    }
    there.send(None);
    let _ = other.join();
    quantile(times, 0.5)
}

/// Median microseconds from sending to a thread that sleeps to the line behind its receive.
pub fn threads_wake<Q: Queue<u64>>(count: u64) -> f64 {
    let queue = Q::bounded(4);
    let start = Instant::now();
    let other = {
        let queue = queue.clone();
        std::thread::spawn(move || {
            let mut times = Vec::new();
            while let Some(sent) = queue.receive() {
                times.push((start.elapsed().as_nanos() as u64).saturating_sub(sent) as f64 * 1e-3);
            }
            times
        })
    };
    for _ in 0..count {
        std::thread::sleep(Duration::from_micros(500));
        queue.send(Some(start.elapsed().as_nanos() as u64));
    }
    queue.send(None);
    other.join().map_or(f64::NAN, |times| quantile(times, 0.5))
}

fn tokio() -> Option<tokio::runtime::Runtime> {
    tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().ok()
}

/// Signals the end of a run from inside tokio.
type Done = Arc<tokio::sync::Notify>;

mod on_ractor {
    use super::*;
    use ractor::{Actor, ActorProcessingErr, ActorRef};

    struct Worker<P>(std::marker::PhantomData<fn(P)>);
    struct Collector<P>(std::marker::PhantomData<fn(P)>);

    impl<P: Payload> Actor for Worker<P> {
        type Msg = P;
        type State = (ActorRef<P>, u64);
        type Arguments = ActorRef<P>;

        async fn pre_start(
            &self,
            _: ActorRef<P>,
            to: ActorRef<P>,
        ) -> Result<Self::State, ActorProcessingErr> {
            Ok((to, 0))
        }

        async fn handle(
            &self,
            _: ActorRef<P>,
            payload: P,
            (to, sum): &mut Self::State,
        ) -> Result<(), ActorProcessingErr> {
            *sum = sum.wrapping_add(payload.sum());
            let _ = to.send_message(payload);
            Ok(())
        }
    }

    impl<P: Payload> Actor for Collector<P> {
        type Msg = P;
        type State = (u64, P::Pool, Done);
        type Arguments = (u64, P::Pool, Done);

        async fn pre_start(
            &self,
            _: ActorRef<P>,
            state: Self::State,
        ) -> Result<Self::State, ActorProcessingErr> {
            Ok(state)
        }

        async fn handle(
            &self,
            _: ActorRef<P>,
            payload: P,
            (left, pool, done): &mut Self::State,
        ) -> Result<(), ActorProcessingErr> {
            payload.give_back(pool);
            *left -= 1;
            if *left == 0 {
                done.notify_one();
            }
            Ok(())
        }
    }

    /// The fan; its mailboxes have no bound.
    pub fn fan<P: Payload>(jobs: u64) -> Cost {
        let nan = Cost { seconds: f64::NAN, cpu_ns: f64::NAN };
        let Some(tokio) = tokio() else { return nan };
        let (pool, done): (P::Pool, Done) = (P::pool(), Done::default());
        let spawned = tokio.block_on(async {
            let state = (jobs, pool.clone(), done.clone());
            let (collector, _) = Actor::spawn(None, Collector::<P>(Default::default()), state).await.ok()?;
            let mut workers = Vec::new();
            for _ in 0..WORKERS {
                let worker = Worker::<P>(Default::default());
                workers.push(Actor::spawn(None, worker, collector.clone()).await.ok()?.0);
            }
            Some(workers)
        });
        let Some(workers) = spawned else { return nan };
        cost(|| {
            tokio.block_on(async {
                let source = tokio::spawn(async move {
                    for number in 0..jobs {
                        let _ = workers[number as usize % WORKERS].send_message(P::make(&pool, number));
                        if number % 64 == 0 {
                            tokio::task::yield_now().await;
                        }
                    }
                });
                done.notified().await;
                let _ = source.await;
            });
        })
    }
}

mod on_kameo {
    use super::*;
    use kameo::Actor;
    use kameo::actor::{ActorRef, Spawn};
    use kameo::mailbox;
    use kameo::message::{Context, Message};

    #[derive(Actor)]
    struct Worker<P: Payload> {
        to: ActorRef<Collector<P>>,
        sum: u64,
    }

    #[derive(Actor)]
    struct Collector<P: Payload> {
        left: u64,
        pool: P::Pool,
        done: Done,
    }

    struct Work<P>(P);

    impl<P: Payload> Message<Work<P>> for Worker<P> {
        type Reply = ();

        async fn handle(&mut self, work: Work<P>, _: &mut Context<Self, ()>) {
            self.sum = self.sum.wrapping_add(work.0.sum());
            let _ = self.to.tell(work).await;
        }
    }

    impl<P: Payload> Message<Work<P>> for Collector<P> {
        type Reply = ();

        async fn handle(&mut self, work: Work<P>, _: &mut Context<Self, ()>) {
            work.0.give_back(&self.pool);
            self.left -= 1;
            if self.left == 0 {
                self.done.notify_one();
            }
        }
    }

    /// The fan.
    pub fn fan<P: Payload>(jobs: u64) -> Cost {
        let Some(tokio) = tokio() else { return Cost { seconds: f64::NAN, cpu_ns: f64::NAN } };
        let (pool, done): (P::Pool, Done) = (P::pool(), Done::default());
        let workers: Vec<ActorRef<Worker<P>>> = tokio.block_on(async {
            let collector = Collector::<P> { left: jobs, pool: pool.clone(), done: done.clone() };
            let to = Collector::spawn_with_mailbox(collector, mailbox::bounded(IN_FLIGHT));
            let worker = || Worker { to: to.clone(), sum: 0 };
            (0..WORKERS).map(|_| Worker::spawn_with_mailbox(worker(), mailbox::bounded(IN_FLIGHT))).collect()
        });
        cost(|| {
            tokio.block_on(async {
                let source = tokio::spawn(async move {
                    for number in 0..jobs {
                        let work = Work(P::make(&pool, number));
                        let _ = workers[number as usize % WORKERS].tell(work).await;
                    }
                });
                done.notified().await;
                let _ = source.await;
            });
        })
    }
}

pub use on_kameo::fan as kameo_fan;
pub use on_ractor::fan as ractor_fan;
