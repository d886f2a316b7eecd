//! A system with all that the runtime has: a pool of jobs, workers that panic, newest-only plans, timers, clock
//! readings, measured durations, credits, and input from outside.

use foveal_runtime::*;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// What the office makes.
pub struct Task {
    pub number: u64,
    /// Workers it kills before it succeeds.
    pub kills: u32,
}

impl Job for Task {
    type Brief = u64;

    fn digest(&self, digest: &mut Digest) {
        digest.u64(self.number);
        digest.u32(self.kills);
    }

    fn brief(&self) -> u64 {
        self.number
    }

    fn save(&self, saver: &mut Saver) {
        saver.put(&(self.number, self.kills));
    }

    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        let (number, kills) = loader.take()?;
        Some(Self { number, kills })
    }
}

#[derive(Serialize, Deserialize)]
pub struct Order {
    pub tasks: u64,
}

#[derive(Message)]
pub enum OfficeMsg {
    Order(Order),
    Done {
        number: u64,
        by: u32,
    },
    Remind(u32),
    #[message(lane = control)]
    Incident(Incident),
    #[message(lane = control)]
    GivenUp(DeadJob<u64>),
}

impl From<Order> for OfficeMsg {
    fn from(order: Order) -> Self {
        Self::Order(order)
    }
}

/// Puts tasks into the pool and counts what comes back.
pub struct Office {
    pub pool: JobPool<Task>,
    pub workers: Vec<Address<WorkerMsg>>,
    pub made: u64,
    pub done: u64,
    pub given_up: u64,
    pub panics: u64,
    pub reminders: u32,
    pub state: u64,
    /// A task that is this modulo 16 kills so many workers.
    pub deadly: Option<(u64, u32)>,
    /// Reads a thread's random state at this task, which no recording knows.
    pub leak_at: Option<u64>,
}

impl Actor for Office {
    type Msg = OfficeMsg;
    const NAME: &'static str = "office";

    fn handle(&mut self, message: OfficeMsg, cx: &mut Cx<'_, OfficeMsg>) {
        let mut state = Digest::new();
        state.u64(self.state);
        message.digest(&mut state);
        self.state = state.finish();
        match message {
            OfficeMsg::Order(order) => {
                let now = cx.now();
                for _ in 0..order.tasks {
                    let number = self.made;
                    let kills =
                        self.deadly.filter(|(rest, _)| number % 16 == *rest).map_or(0, |(_, kills)| kills);
                    let bucket = ((self.state ^ now.0) % 64) as u8;
                    match cx.push(&self.pool, bucket, 0, Task { number, kills }) {
                        Ok(_) => self.made += 1,
                        Err(_) => break,
                    }
                }
                for worker in &self.workers {
                    let _ = cx.tell(worker, WorkerMsg::Plan(self.state));
                }
                let delay = Duration::from_micros(self.state % 500);
                if cx.after(delay, OfficeMsg::Remind(self.reminders + 1)).is_err() {
                    self.reminders += 100;
                }
            }
            OfficeMsg::Done { number, .. } => {
                self.done += 1;
                if self.leak_at == Some(self.done) {
                    // Something that differs from run to run.
                    use std::hash::{BuildHasher, RandomState};
                    self.state ^= RandomState::new().hash_one(number) | 1;
                }
                cx.mark(0, self.state);
            }
            OfficeMsg::Remind(count) => {
                self.reminders = count;
                let cancelled = cx.after(Duration::from_secs(1), OfficeMsg::Remind(0));
                let taken_back = cancelled.ok().and_then(|timer| cx.cancel(timer));
                assert!(matches!(taken_back, Some(OfficeMsg::Remind(0)) | None));
            }
            OfficeMsg::Incident(Incident::Panicked { .. }) => self.panics += 1,
            OfficeMsg::GivenUp(DeadJob { brief, why, .. }) => {
                let known = match &why {
                    Death::Panicked(message) => ["deadly task", "injected"].contains(&message.as_str()),
                    Death::Expired => true,
                };
                assert!(brief < self.made && known, "{why:?}");
                self.given_up += 1;
            }
            OfficeMsg::Incident(_) => {}
        }
    }

    fn digest(&self) -> Option<u64> {
        Some(self.state)
    }

    fn save(&self, saver: &mut Saver) {
        saver.put(&(self.made, self.done, self.given_up, self.panics, self.reminders, self.state));
    }

    fn restore(&mut self, loader: &mut Loader<'_>) -> Option<()> {
        (self.made, self.done, self.given_up, self.panics, self.reminders, self.state) = loader.take()?;
        Some(())
    }
}

#[derive(Message)]
pub enum WorkerMsg {
    #[message(lane = latest(2))]
    Plan(u64),
}

/// Does tasks by the newest plan.
pub struct Hand {
    pub number: u32,
    pub office: Address<OfficeMsg>,
    pub plan: u64,
    pub kills: std::collections::BTreeMap<u64, u32>,
    pub work: u32,
}

impl Actor for Hand {
    type Msg = WorkerMsg;
    const NAME: &'static str = "hand";
    const CLASS: Class = Class::Heavy;

    fn handle(&mut self, message: WorkerMsg, _: &mut Cx<'_, WorkerMsg>) {
        let WorkerMsg::Plan(plan) = message;
        self.plan = plan;
    }

    fn save(&self, saver: &mut Saver) {
        saver.put(&(self.plan, &self.kills));
    }

    fn restore(&mut self, loader: &mut Loader<'_>) -> Option<()> {
        (self.plan, self.kills) = loader.take()?;
        Some(())
    }
}

impl Worker for Hand {
    type Job = Task;

    fn run(&mut self, task: &Task, cx: &mut Cx<'_, WorkerMsg>) {
        if task.kills > 0 && self.kills.get(&task.number).copied().unwrap_or(0) == 0 {
            *self.kills.entry(task.number).or_insert(0) += 1;
            // Not a plain panic: that would fill the test's output.
            std::panic::resume_unwind(Box::new("deadly task"));
        }
        let (result, _) =
            cx.measure(|| (0..self.work).fold(self.plan, |sum, step| sum.rotate_left(7) ^ u64::from(step)));
        let by = self.number ^ (result as u32 & 0xff00);
        if !cx.claim() {
            return;
        }
        cx.tell(&self.office, OfficeMsg::Done { number: task.number, by }).expect("room for every task");
    }
}

pub struct Workshop {
    pub office: Handle<Office>,
    pub orders: Port<Order, OfficeMsg>,
    pub pool: JobPool<Task>,
}

#[derive(Clone, Copy)]
pub struct Options {
    pub workers: u32,
    pub deadly: Option<(u64, u32)>,
    pub leak_at: Option<u64>,
    pub work: u32,
}

impl Options {
    pub fn new(workers: u32) -> Self {
        Self { workers, deadly: None, leak_at: None, work: 50 }
    }
}

pub fn wire(wiring: &mut Wiring, options: Options) -> Workshop {
    let office = wiring.declare::<Office>(Bounds::messages(4096));
    let orders = wiring.port::<Order, OfficeMsg>("orders", &office.address());
    let pool = wiring.pool::<Task>(4096);
    wiring.leases(&pool, Duration::from_secs(60));
    let hands: Vec<_> = (0..options.workers).map(|_| wiring.declare::<Hand>(Bounds::messages(8))).collect();
    let workers = hands.iter().map(Declared::address).collect();
    let address = office.address();
    wiring.supervisor(&address, OfficeMsg::Incident);
    wiring.gives_up(&pool, &address, OfficeMsg::GivenUp);
    for (number, hand) in (0..).zip(hands) {
        let (office, kills) = (address.clone(), Default::default());
        let hand_state = Hand { number, office, plan: 0, kills, work: options.work };
        wiring.spawn_worker(hand, hand_state, &pool, OnPanic::Resume);
    }
    let state = Office {
        pool: pool.clone(),
        workers,
        made: 0,
        done: 0,
        given_up: 0,
        panics: 0,
        reminders: 0,
        state: 1,
        deadly: options.deadly,
        leak_at: options.leak_at,
    };
    let office = wiring.spawn(office, state, OnPanic::Resume);
    Workshop { office, orders, pool }
}
