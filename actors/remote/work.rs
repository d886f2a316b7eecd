//! The threads of a guest: jobs in, colours out; pieces of work in, what they come to out. They trace by the same functions
//! as a walk's tracers, from hits that they draw where jobs look.

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
use foveal::splatting::light_tracing::trace_run;
use foveal::splatting::trace::{trace_colors, trace_guides};
use foveal::world::World;
use foveal_actors::station::wire::{Body, Colors, DoneJob, JobSpec, Order, ViewSpec, round_of};
use foveal_engine::batch::{Found, Piece};

use crate::ground::{OwnGround, Pass};
use crate::link::Waker;

/// Pixels of the largest view that is traced for.
pub const VIEW_PIXELS_MAX: u64 = 1 << 24;
/// Pixels of views that a thread has two of; of larger ones, one.
const TWO_VIEWS_PIXELS: u64 = 1 << 22;

/// What a thread is to do.
enum Task {
    Samples(Arc<ViewSpec>, JobSpec),
    Piece { lease: u64, ground: Arc<OwnGround>, pass: Pass, piece: Piece },
}

/// What a thread has done.
pub enum Finished {
    /// A walk's job.
    Samples(DoneJob),
    /// A piece of work.
    Piece {
        /// Which.
        lease: u64,
        /// Time of one core, µs.
        micros: u32,
        /// What it comes to; none where it could not be done.
        found: Option<Found>,
    },
}

/// What the threads share.
struct CrewShared {
    world: World,
    k_max: u32,
    tasks: SegQueue<Task>,
    done: SegQueue<Finished>,
    /// Jobs of views before this one are not begun, nor pieces of rounds before it.
    below: AtomicU32,
    ending: AtomicBool,
    hears: Waker,
}

/// Threads that trace.
pub struct Crew {
    shared: Arc<CrewShared>,
    threads: Vec<(JoinHandle<()>, Thread)>,
    next: usize,
}

impl Crew {
    /// So many threads; `hears` is woken when one has done a job.
    ///
    /// # Errors
    /// If threads cannot be started.
    pub fn new(world: World, k_max: u32, cores: u16, hears: Waker) -> Result<Self, String> {
        let shared = Arc::new(CrewShared {
            world,
            k_max,
            tasks: SegQueue::new(),
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
        self.push(Task::Samples(Arc::clone(view), job));
    }

    /// Takes a piece of work, which has the photons of a pass in common with others.
    pub fn take_piece(&mut self, lease: u64, ground: &Arc<OwnGround>, pass: Pass, piece: Piece) {
        self.push(Task::Piece { lease, ground: Arc::clone(ground), pass, piece });
    }

    fn push(&mut self, task: Task) {
        self.shared.tasks.push(task);
        self.next = (self.next + 1) % self.threads.len();
        self.threads[self.next].1.unpark();
    }

    /// Jobs of views before this one, and pieces of rounds, need not be begun.
    pub fn retire(&self, below: u32) {
        self.shared.below.fetch_max(below, Ordering::Relaxed);
    }

    /// What was done.
    pub fn done(&self) -> Option<Finished> {
        self.shared.done.pop()
    }

    /// How much was done and not [told](Self::done) yet.
    pub fn finished(&self) -> usize {
        self.shared.done.len()
    }

    /// Jobs and pieces that nobody has begun.
    pub fn waiting(&self) -> usize {
        self.shared.tasks.len()
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

fn work(shared: &CrewShared) {
    let mut views: VecDeque<(u32, PartlyDrawn)> = VecDeque::new();
    while !shared.ending.load(Ordering::SeqCst) {
        let Some(task) = shared.tasks.pop() else {
            thread::park_timeout(Duration::from_millis(20));
            continue;
        };
        let began = Instant::now();
        let micros = || began.elapsed().as_micros().min(u128::from(u32::MAX)) as u32;
        // What panics here is said to be not done, and somebody else's.
        let done = match task {
            Task::Samples(view, job) => {
                let is_wanted = job.view >= shared.below.load(Ordering::Relaxed);
                let traced = is_wanted
                    .then(|| catch_unwind(AssertUnwindSafe(|| trace(shared, &mut views, &view, &job))));
                if matches!(traced, Some(Err(_))) {
                    views.clear();
                }
                let found = traced.and_then(Result::ok).flatten();
                let micros = if is_wanted { micros() } else { 0 };
                Finished::Samples(DoneJob { lease: job.lease, micros, found })
            }
            Task::Piece { lease, ground, pass, piece } => {
                let is_wanted = || {
                    round_of(lease) >= shared.below.load(Ordering::Relaxed)
                        && !shared.ending.load(Ordering::Relaxed)
                };
                let done = || ground.with(&pass, |ground| ground.done(&piece, &is_wanted));
                let found =
                    is_wanted().then(|| catch_unwind(AssertUnwindSafe(done)).ok().flatten()).flatten();
                Finished::Piece { lease, micros: micros(), found }
            }
        };
        shared.done.push(done);
        shared.hears.wake();
    }
}

fn trace(
    shared: &CrewShared,
    views: &mut VecDeque<(u32, PartlyDrawn)>,
    view: &ViewSpec,
    job: &JobSpec,
) -> Option<Body> {
    // A block takes longer than a view that has begun can wait for the cores.
    let is_wanted =
        || job.view >= shared.below.load(Ordering::Relaxed) && !shared.ending.load(Ordering::Relaxed);
    let [width, height] = view.frame.size;
    let lattice = Lattice::new(shared.k_max, [width as i32 / 2, height as i32 / 2]);
    if !views.iter().any(|(known, _)| *known == view.view) {
        let keep = if u64::from(width) * u64::from(height) <= TWO_VIEWS_PIXELS { 1 } else { 0 };
        while views.len() > keep {
            views.pop_front();
        }
        views.push_back((view.view, PartlyDrawn::new(view.frame, view.cell)));
    }
    let (_, drawn) = views.iter_mut().find(|(known, _)| *known == view.view)?;
    found(&shared.world, &lattice, drawn, job, &is_wanted)
}

/// What a job finds in a view; nothing where a block or run is not to go on.
pub fn found(
    world: &World,
    lattice: &Lattice,
    drawn: &mut PartlyDrawn,
    job: &JobSpec,
    goes_on: &dyn Fn() -> bool,
) -> Option<Body> {
    let order = match &job.order {
        Order::Samples(order) => order,
        Order::Block(block) => {
            return block.traced(world, drawn.frame(), job.seed, goes_on).map(Body::Block);
        }
        Order::Run(run) => return trace_run(world, drawn.frame(), *run, job.seed, goes_on).map(Body::Run),
    };
    let pixels = pixels_as_told(lattice, order, |x, y| drawn.object_at(world, x as usize, y as usize));
    let (frame, buffers) = (drawn.frame(), drawn.buffers());
    let guides = || trace_guides(world, frame, buffers, pixels.iter().copied());
    if order.level == GUIDES {
        return Some(Body::Colors(Colors { colors: guides(), guides: Vec::new() }));
    }
    Some(Body::Colors(Colors {
        colors: trace_colors(world, frame, buffers, pixels.iter().copied(), job.seed),
        guides: if order.guided { guides() } else { Vec::new() },
    }))
}
