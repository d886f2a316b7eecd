//! A pool of jobs: one actor decides what is worth doing, workers take the best job whenever they have time.
//!
//! `cargo run -p foveal-runtime --example jobs`

use foveal_runtime::*;
use std::time::Duration;

/// Counts the primes of a stretch of numbers.
struct Stretch {
    from: u64,
    to: u64,
}

impl Job for Stretch {
    fn digest(&self, digest: &mut Digest) {
        let Self { from, to } = self;
        digest.value(&(from, to));
    }

    /// Where a job that is given up began.
    type Brief = u64;

    fn brief(&self) -> u64 {
        self.from
    }
}

#[derive(Message)]
enum BossMsg {
    Counted { from: u64, primes: u64 },
}

/// Hands out work and adds up what comes back.
struct Boss {
    pool: JobPool<Stretch>,
    open: u32,
    primes: u64,
}

impl Actor for Boss {
    type Msg = BossMsg;
    const NAME: &'static str = "boss";

    fn started(&mut self, cx: &mut Cx<'_, BossMsg>) {
        for number in 0..100_u64 {
            // Bucket 0 goes first: the large numbers, which take longest.
            let bucket = 63 - (number * 64 / 100) as u8;
            let job = Stretch { from: number * 10_000, to: (number + 1) * 10_000 };
            if cx.push(&self.pool, bucket, 0, job).is_ok() {
                self.open += 1;
            }
        }
    }

    fn handle(&mut self, BossMsg::Counted { from, primes }: BossMsg, cx: &mut Cx<'_, BossMsg>) {
        self.open -= 1;
        self.primes += primes;
        if self.open == 0 {
            cx.mark(0, self.primes);
            println!("{} primes; the stretch from {from} was the last", self.primes);
        }
    }
}

#[derive(Message)]
enum HandMsg {}

/// Keeps nothing: a job in, an answer out.
struct Hand {
    boss: Address<BossMsg>,
}

impl Actor for Hand {
    type Msg = HandMsg;
    const NAME: &'static str = "hand";
    const CLASS: Class = Class::Heavy; // milliseconds a turn: one thread stays free for the others

    fn handle(&mut self, message: HandMsg, _: &mut Cx<'_, HandMsg>) {
        match message {}
    }
}

impl Worker for Hand {
    type Job = Stretch;

    fn run(&mut self, job: &Stretch, cx: &mut Cx<'_, HandMsg>) {
        let divides = |n: u64| move |d: &u64| n.is_multiple_of(*d);
        let is_prime = |n: &u64| *n > 1 && !(2..).take_while(|d| d * d <= *n).any(|d| divides(*n)(&d));
        let primes = (job.from..job.to).filter(is_prime).count() as u64;
        // The boss's mailbox has room for an answer to each job.
        let _ = cx.tell(&self.boss, BossMsg::Counted { from: job.from, primes });
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (mut runtime, pool) = Runtime::build(Config::live(3), |wiring| {
        let pool = wiring.pool::<Stretch>(100);
        let boss = wiring.declare::<Boss>(Bounds::messages(100));
        for _ in 0..2 {
            let hand = wiring.declare::<Hand>(Bounds::messages(1));
            wiring.spawn_worker(hand, Hand { boss: boss.address() }, &pool, OnPanic::Resume);
        }
        wiring.spawn(boss, Boss { pool: pool.clone(), open: 0, primes: 0 }, OnPanic::End);
        pool
    })?;
    runtime.pump(Limit::IDLE);
    println!("{:?}", pool.stats());
    runtime.shutdown(Duration::from_secs(1));
    Ok(())
}
