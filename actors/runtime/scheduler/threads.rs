//! The worker threads: what each does until the system stops.

use crossbeam_deque::Worker;
use std::cell::Cell;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::Thread;
use std::time::Duration;

use super::{LIGHT_IN_A_ROW, Runnable, Scheduler, ThreadCx};
use crate::message::incident::{Incident, guarded};
use crate::scheduler::priority::give_way;

/// The worker threads of a running system.
pub(crate) struct Threads {
    handles: Vec<std::thread::JoinHandle<()>>,
}

impl Threads {
    /// Starts one thread for each run queue.
    pub(crate) fn start<N: Runnable + ?Sized + 'static>(
        scheduler: &Arc<Scheduler>,
        nodes: &Arc<[Arc<N>]>,
        locals: Vec<Worker<u32>>,
        gives_way: bool,
    ) -> std::io::Result<Self> {
        let mut handles = Vec::with_capacity(locals.len());
        for (index, local) in locals.into_iter().enumerate() {
            let (scheduler, nodes) = (Arc::clone(scheduler), Arc::clone(nodes));
            let body = move || {
                if gives_way {
                    give_way();
                }
                worker(&scheduler, &nodes, local, index);
            };
            handles.push(std::thread::Builder::new().name(format!("actors-{index}")).spawn(body)?);
        }
        let threads: Box<[Thread]> = handles.iter().map(|handle| handle.thread().clone()).collect();
        let _ = scheduler.handles.set(threads);
        scheduler.notify_all();
        Ok(Self { handles })
    }

    /// Waits until all have ended; `Scheduler::stop` makes them.
    pub(crate) fn join(self) {
        for handle in self.handles {
            let _ = handle.join();
        }
    }
}

fn worker<N: Runnable + ?Sized>(scheduler: &Scheduler, nodes: &[Arc<N>], local: Worker<u32>, index: usize) {
    while scheduler.handles.get().is_none() && !scheduler.stopping.load(Ordering::SeqCst) {
        std::thread::park();
    }
    let thread = ThreadCx { local: Some(local), lane: index as u16 + 1, last_end: Cell::new(0) };
    while !scheduler.stopping.load(Ordering::Relaxed) {
        if let Err(message) = guarded(|| work(scheduler, nodes, &thread, index)) {
            scheduler.sleepers.cancel(index);
            scheduler.note(Incident::Beside { what: format!("thread {}", thread.lane), message });
        }
    }
}

/// What a worker thread does until the system stops.
fn work<N: Runnable + ?Sized>(scheduler: &Scheduler, nodes: &[Arc<N>], thread: &ThreadCx, index: usize) {
    let mut tick = 0_u32;
    // This thread ran a heavy actor and is the one to run the next, unless it finds something else to do. Were another
    // one woken each time, many threads would take turns, each of them rested and so preferred to the main thread.
    let (mut freed, mut light) = (false, 0);
    while !scheduler.stopping.load(Ordering::Relaxed) {
        tick = tick.wrapping_add(1);
        if scheduler.halted() {
            if std::mem::take(&mut freed) {
                scheduler.offer_heavy();
            }
            scheduler.rest();
        }
        let next_timer = scheduler.timers.next();
        if next_timer != u64::MAX {
            scheduler.timers.serve(scheduler.clock.now(), scheduler, thread);
        }
        // Every so often a heavy actor goes first, so that a flood of light ones cannot starve it.
        if tick.is_multiple_of(61) && run_heavy(scheduler, nodes, thread) {
            (freed, light) = (true, 0);
            continue;
        }
        if let Some(actor) = scheduler.find(thread, index, tick) {
            scheduler.run(nodes, actor, thread);
            light += 1;
            if light >= LIGHT_IN_A_ROW && std::mem::take(&mut freed) {
                scheduler.offer_heavy();
            }
            continue;
        }
        light = 0;
        freed = run_heavy(scheduler, nodes, thread);
        if freed {
            continue;
        }
        thread.last_end.set(0);
        scheduler.sleepers.prepare(index);
        if !scheduler.has_work() && !scheduler.stopping.load(Ordering::SeqCst) {
            match scheduler.timers.next() {
                u64::MAX => std::thread::park(),
                due => {
                    let wait = due.saturating_sub(scheduler.clock.now());
                    if wait > 0 {
                        std::thread::park_timeout(Duration::from_nanos(wait));
                    }
                }
            }
        }
        scheduler.sleepers.cancel(index);
    }
}

fn run_heavy<N: Runnable + ?Sized>(scheduler: &Scheduler, nodes: &[Arc<N>], thread: &ThreadCx) -> bool {
    let Some(actor) = scheduler.claim_heavy() else { return false };
    let link = nodes[actor as usize].link();
    link.in_slot.store(true, Ordering::Relaxed);
    scheduler.run(nodes, actor, thread);
    scheduler.release_slot_of(link);
    true
}
