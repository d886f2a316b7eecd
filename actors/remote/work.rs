//! The threads of a guest: jobs in, colours out. They trace by the same functions as a walk's tracers, from hits that they
//! draw where jobs look.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread::{self, JoinHandle, Thread};
use std::time::{Duration, Instant};

use crossbeam_queue::SegQueue;
use foveal::allocation::jobs::{GUIDES, pixels_as_told};
use foveal::display::cpu_pass::PartlyDrawn;
use foveal::sampling::Lattice;
use foveal::splatting::trace::{trace_colors, trace_guides};
use foveal::world::World;
use foveal_actors::station::wire::{Colors, DoneJob, JobSpec, ViewSpec};

use crate::link::Waker;

/// Pixels of the largest view that is traced for.
pub const VIEW_PIXELS_MAX: u64 = 1 << 24;
/// Pixels of views that a thread has two of; of larger ones, one.
const TWO_VIEWS_PIXELS: u64 = 1 << 22;

/// What the threads share.
struct Shared {
    world: World,
    k_max: u32,
    jobs: SegQueue<(Arc<ViewSpec>, JobSpec)>,
    done: SegQueue<DoneJob>,
    /// Jobs of views before this one are not begun.
    below: AtomicU32,
    ending: AtomicBool,
    hears: Waker,
}

/// Threads that trace.
pub struct Crew {
    shared: Arc<Shared>,
    threads: Vec<(JoinHandle<()>, Thread)>,
    next: usize,
}

impl Crew {
    /// So many threads; `hears` is woken when one has done a job.
    ///
    /// # Errors
    /// If threads cannot be started.
    pub fn new(world: World, k_max: u32, cores: u16, hears: Waker) -> Result<Self, String> {
        let shared = Arc::new(Shared {
            world,
            k_max,
            jobs: SegQueue::new(),
            done: SegQueue::new(),
            below: AtomicU32::new(0),
            ending: AtomicBool::new(false),
            hears,
        });
        let mut threads = Vec::new();
        for number in 0..cores {
            let shared = Arc::clone(&shared);
            let spawned =
                thread::Builder::new().name(format!("tracer {number}")).spawn(move || work(&shared));
            let handle = spawned.map_err(|e| format!("threads cannot be started: {e}"))?;
            let thread = handle.thread().clone();
            threads.push((handle, thread));
        }
        Ok(Self { shared, threads, next: 0 })
    }

    /// Takes a job of a view.
    pub fn take(&mut self, view: &Arc<ViewSpec>, job: JobSpec) {
        self.shared.jobs.push((Arc::clone(view), job));
        self.next = (self.next + 1) % self.threads.len();
        self.threads[self.next].1.unpark();
    }

    /// Jobs of views before this one need not be begun.
    pub fn retire(&self, below: u32) {
        self.shared.below.fetch_max(below, Ordering::Relaxed);
    }

    /// A job that is done.
    pub fn done(&self) -> Option<DoneJob> {
        self.shared.done.pop()
    }

    /// Jobs that nobody has begun.
    pub fn waiting(&self) -> usize {
        self.shared.jobs.len()
    }
}

impl Drop for Crew {
    fn drop(&mut self) {
        self.shared.ending.store(true, Ordering::SeqCst);
        for (handle, thread) in self.threads.drain(..) {
            thread.unpark();
            let _ = handle.join();
        }
    }
}

fn work(shared: &Shared) {
    let mut views: VecDeque<(u32, PartlyDrawn)> = VecDeque::new();
    while !shared.ending.load(Ordering::SeqCst) {
        let Some((view, job)) = shared.jobs.pop() else {
            thread::park_timeout(Duration::from_millis(20));
            continue;
        };
        let mut done = DoneJob { lease: job.lease, micros: 0, found: None };
        if job.view >= shared.below.load(Ordering::Relaxed) {
            let began = Instant::now();
            // What panics here is said to be not done, and somebody else's.
            done.found = catch_unwind(AssertUnwindSafe(|| trace(shared, &mut views, &view, &job))).ok();
            if done.found.is_none() {
                views.clear();
            }
            done.micros = began.elapsed().as_micros().min(u128::from(u32::MAX)) as u32;
        }
        shared.done.push(done);
        shared.hears.wake();
    }
}

fn trace(
    shared: &Shared,
    views: &mut VecDeque<(u32, PartlyDrawn)>,
    view: &ViewSpec,
    job: &JobSpec,
) -> Colors {
    let [width, height] = view.frame.size;
    let lattice = Lattice::new(shared.k_max, [width as i32 / 2, height as i32 / 2]);
    if !views.iter().any(|(known, _)| *known == view.view) {
        let keep = if u64::from(width) * u64::from(height) <= TWO_VIEWS_PIXELS { 1 } else { 0 };
        while views.len() > keep {
            views.pop_front();
        }
        views.push_back((view.view, PartlyDrawn::new(view.frame, view.cell)));
    }
    let Some((_, drawn)) = views.iter_mut().find(|(known, _)| *known == view.view) else {
        return Colors::default();
    };
    colors(&shared.world, &lattice, drawn, job)
}

/// What a job finds in a view.
pub fn colors(world: &World, lattice: &Lattice, drawn: &mut PartlyDrawn, job: &JobSpec) -> Colors {
    let pixels = pixels_as_told(lattice, &job.order, |x, y| drawn.object_at(world, x as usize, y as usize));
    let (frame, buffers) = (drawn.frame(), drawn.buffers());
    let guides = || trace_guides(world, frame, buffers, pixels.iter().copied());
    if job.order.level == GUIDES {
        return Colors { colors: guides(), guides: Vec::new() };
    }
    Colors {
        colors: trace_colors(world, frame, buffers, pixels.iter().copied(), job.seed),
        guides: if job.order.guided { guides() } else { Vec::new() },
    }
}
