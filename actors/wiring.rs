//! Who is there and who tells whom: the only file that knows all actors.
//!
//! Mailboxes, and why they suffice:
//!
//! | inbox | holds | because |
//! | --- | --- | --- |
//! | renderer | inputs, aged samples, samples of every job that can be out while it draws | jobs are bounded by the pixels of the views on their way |
//! | cache ager | a view, the same samples | as above |
//! | allocator | views, ranks, one answer for each job in flight | jobs in flight are bounded by `Settings::jobs_in_flight` |
//! | illuminator | its own word to go on | it is the only sender |
//! | analyzer | one frame, the newest | |
//! | station | answers of its guest | those are bounded by the jobs that it keeps |
//!
//! What a panic does to each of them:
//!
//! | actor | its panic | because |
//! | --- | --- | --- |
//! | tracer | its job goes back, it goes on | it tells only after it has traced |
//! | analyzer | it starts anew | the next frame says all it has to know |
//! | cache ager | it starts anew, without samples; the renderer tells it again what the user changed | samples are only reused |
//! | station | it goes on; jobs it has lost sight of are handed back when it stops | its guest may come anew |
//! | allocator, renderer, illuminator | the walk ends in order | nobody else knows what is out, shown, or baked so far |

use std::sync::Arc;
use std::time::Duration;

use foveal::display::cpu_pass::Passes;
use foveal::display::first_approximation::{FirstApproximation, Probes};
use foveal::scene::plan::{ScenePlan, Subsystem};
use foveal::world::World;
use foveal_runtime::{Bounds, Declared, Handle, JobPool, OnPanic, Port, Wiring};

use crate::allocator::Allocator;
use crate::allocator::maps::Environments;
use crate::allocator::textures::Textures;
use crate::analyzer::Analyzer;
use crate::cache_ager::CacheAger;
use crate::illuminator::{Illuminator, Refinement};
use crate::insight::InsightSlot;
use crate::message::saved::SnapshotContext;
use crate::message::{AllocatorMessage, RendererInput, RendererMessage, TraceJob};
use crate::renderer::{FrameSink, Neighbours, Renderer};
use crate::settings::Settings;
use crate::stages::StageTimes;
use crate::station::board::Board;
use crate::station::{CREDITS_MAX, Heard, Listeners, Outlet, STATIONS_MAX, Silent, Station, StationMessage};
use crate::textures::TextureStore;
use crate::tracer::Tracer;

/// For so long a tracer has a job. Most take milliseconds, the filter of a large picture seconds: a tracer that has not
/// done it by then hangs, in a file of a disk that does not answer, say.
const LEASE: Duration = Duration::from_secs(300);

/// What a system of actors is made of.
pub struct Parts {
    /// Settings of the session.
    pub settings: Settings,
    /// What is walked through.
    pub world: World,
    /// What each object of it sees around, where somebody has looked already: of many objects that takes seconds.
    pub probes: Option<Arc<Probes>>,
    /// What the display pass must fill.
    pub passes: Passes,
    /// Whether there is anything to correct; if not, only the renderer is started.
    pub corrects: bool,
    /// Textures, where they do not all fit into their limit; `world` has them at their coarsest then.
    pub textures: Option<Arc<TextureStore>>,
    /// What the illumination is refined towards while one walks; `None` where it is final.
    pub refinement: Option<Refinement>,
    /// Who looks on, if anybody.
    pub insight: Option<InsightSlot>,
    /// Where durations go.
    pub stages: StageTimes,
    /// Who sees the frames.
    pub sink: Box<dyn FrameSink>,
    /// What leads from each [station](Settings::stations) to its guest; the others lead nowhere.
    pub outlets: Vec<Box<dyn Outlet>>,
}

impl Parts {
    /// What the scene needs, without a limit on textures, under light that is final, with nobody who looks on.
    pub fn new(settings: Settings, world: World, sink: Box<dyn FrameSink>) -> Self {
        let plan = ScenePlan::new(&world.scene, &world.scene.budget);
        Self {
            settings,
            passes: Passes { texture_ids: plan.needs(Subsystem::TextureIdPass) },
            corrects: plan.needs(Subsystem::Tracers),
            world,
            probes: None,
            textures: None,
            refinement: None,
            insight: None,
            stages: StageTimes::default(),
            sink,
            outlets: Vec::new(),
        }
    }
}

/// The actors of a running system, to be inspected, and its ingress.
pub struct Actors {
    /// Clock and user.
    pub input: Port<RendererInput, RendererMessage>,
    /// What is on screen.
    pub renderer: Handle<Renderer>,
    /// The others; `None` in a scene without anything to correct.
    pub correction: Option<Correction>,
    /// By number; none in a scene without anything to correct.
    pub tracers: Vec<Handle<Tracer>>,
    /// Refines the illumination, where it is not final.
    pub illuminator: Option<Handle<Illuminator>>,
    /// What the tracers take their work from.
    pub pool: Option<JobPool<TraceJob>>,
    /// By number; none where no machine may come.
    pub stations: Vec<Handle<Station>>,
    /// How these stand.
    pub board: Board,
    /// What leads from each guest to its station.
    pub station_inputs: Vec<Port<Heard, StationMessage>>,
}

/// The actors behind the corrections.
#[derive(Clone, Copy)]
pub struct Correction {
    /// Owns the sample cache.
    pub cache_ager: Handle<CacheAger>,
    /// Looks at frames.
    pub analyzer: Handle<Analyzer>,
    /// Orders jobs.
    pub allocator: Handle<Allocator>,
}

/// Places in a mailbox for samples, at most: room is taken at once, and what finds none waits with who sends it.
const BATCHES_MAX: usize = 1 << 16;

/// Samples of all the jobs that can be done while a receiver is busy with one turn: every pixel of two views.
fn batches_on_their_way(settings: &Settings) -> usize {
    let pixels = settings.width as usize * settings.height as usize;
    (2 * (pixels / settings.samples_per_job.max(1) as usize) + 4096).min(BATCHES_MAX)
}

/// Makes mailboxes and starts actors. The same function for live, recorded, replayed and simulated runs.
pub fn wire(wiring: &mut Wiring, parts: Parts) -> Actors {
    let Parts {
        settings,
        world,
        probes,
        passes,
        corrects,
        textures,
        refinement,
        insight,
        stages,
        sink,
        outlets,
    } = parts;
    let batches = batches_on_their_way(&settings);
    let look_around = || probes.unwrap_or_else(|| Arc::new(Probes::of_world(&world)));
    let probes = corrects.then(look_around);
    wiring.context(SnapshotContext {
        world: world.clone(),
        passes,
        probes: probes.clone(),
        textures: textures.clone(),
        book: refinement.as_ref().and_then(|refinement| refinement.book.clone()),
    });
    let renderer: Declared<Renderer> = wiring.declare(Bounds::messages(batches + 64));
    let input = wiring.port("input", &renderer.address());
    let refines = refinement.is_some();
    let illuminator = refinement.map(|refinement| {
        let declared: Declared<Illuminator> = wiring.declare(Bounds::messages(4));
        let actor = Illuminator::new(refinement, renderer.address());
        wiring.spawn(declared, actor, OnPanic::End)
    });
    let Some(probes) = probes else {
        let actor = Renderer::new(settings, world, passes, None, None, stages, sink).awaiting_light(refines);
        let renderer = wiring.spawn(renderer, actor, OnPanic::End);
        return Actors {
            input,
            renderer,
            correction: None,
            tracers: Vec::new(),
            pool: None,
            illuminator,
            stations: Vec::new(),
            board: Board::default(),
            station_inputs: Vec::new(),
        };
    };
    let cache_ager: Declared<CacheAger> = wiring.declare(Bounds::messages(batches + 64));
    let analyzer: Declared<Analyzer> = wiring.declare(Bounds::messages(4));
    let allocator: Declared<Allocator> =
        wiring.declare(Bounds::messages(2 * jobs_in_flight_at_most(&settings) + 256));
    let pool: JobPool<TraceJob> = wiring.pool(jobs_in_flight_at_most(&settings) + 64);
    wiring.supervisor(&allocator.address(), AllocatorMessage::Incident);
    wiring.gives_up(&pool, &allocator.address(), AllocatorMessage::JobDead);
    wiring.leases(&pool, LEASE);
    let (mut addresses, mut tracers) = (Vec::new(), Vec::new());
    for index in 0..settings.tracers {
        let tracer: Declared<Tracer> = wiring.declare(Bounds::messages(4));
        let actor = Tracer::new(
            index,
            settings.lattice(),
            renderer.address(),
            cache_ager.address(),
            allocator.address(),
        );
        addresses.push(tracer.address());
        // It tells only after it has traced, so what it holds is whole whatever it panicked over.
        tracers.push(wiring.spawn_worker(tracer, actor, &pool, OnPanic::Resume));
    }
    let listeners = Listeners {
        renderer: renderer.address(),
        cache_ager: cache_ager.address(),
        allocator: allocator.address(),
    };
    let neighbours = Neighbours {
        cache_ager: cache_ager.address(),
        allocator: allocator.address(),
        analyzer: analyzer.address(),
    };
    let correction = Correction {
        cache_ager: {
            let (world, renderer, stages) = (world.clone(), renderer.address(), stages.clone());
            let anew = move || CacheAger::new(settings, &world, renderer.clone(), stages.clone());
            wiring.spawn(cache_ager, anew(), OnPanic::restart(anew))
        },
        analyzer: {
            let (allocator, stages) = (allocator.address(), stages.clone());
            let anew = move || Analyzer::new(allocator.clone(), stages.clone());
            wiring.spawn(analyzer, anew(), OnPanic::restart(anew))
        },
        allocator: {
            let environments = Environments::new(world.clone(), probes.clone(), settings.environment_bytes);
            let actor = Allocator::new(
                settings,
                renderer.address(),
                pool.clone(),
                addresses,
                environments,
                textures.and_then(|store| Textures::new(store, &world)),
                stages.clone(),
            );
            let actor = actor.looked_on_by(insight).with_cache_ager(neighbours.cache_ager.id());
            wiring.spawn(allocator, actor, OnPanic::End)
        },
    };
    let approximation = settings.approximates.then(|| FirstApproximation::new(probes));
    let actor = Renderer::new(settings, world, passes, Some(neighbours), approximation, stages, sink)
        .awaiting_light(refines);
    let renderer = wiring.spawn(renderer, actor, OnPanic::End);
    // Behind all others, whose numbers do not depend on them.
    let (mut stations, mut station_inputs) = (Vec::new(), Vec::new());
    let board = Board::new(settings.stations.min(STATIONS_MAX));
    let mut outlets = outlets.into_iter();
    for number in 0..settings.stations.min(STATIONS_MAX) {
        // An answer for each job, and those who come and go.
        let station: Declared<Station> = wiring.declare(Bounds::messages(4 * CREDITS_MAX as usize));
        station_inputs.push(wiring.port(&format!("guest {number}"), &station.address()));
        let outlet = outlets.next().unwrap_or_else(|| Box::new(Silent));
        let (index, to) = (settings.tracers + number, listeners.clone());
        let own = (settings.checked, (board.clone(), number as usize));
        let actor = Station::new(index, settings.lattice(), pool.clone(), to, outlet, own);
        // A job is over in its state before anybody is told.
        stations.push(wiring.spawn_worker(station, actor, &pool, OnPanic::Resume));
    }
    Actors {
        input,
        renderer,
        correction: Some(correction),
        tracers,
        pool: Some(pool),
        illuminator,
        stations,
        board,
        station_inputs,
    }
}

/// Jobs of samples that can be out: those of the tracers, and what stations can have beside them.
fn jobs_in_flight_at_most(settings: &Settings) -> usize {
    let stations = settings.stations.min(STATIONS_MAX) as usize;
    settings.jobs_in_flight() as usize + stations * CREDITS_MAX as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whatever a recording's header says: mailboxes take their room at once.
    #[test]
    fn mailboxes_have_a_bound_that_no_picture_raises() {
        let of = |side, samples_per_job| {
            batches_on_their_way(&Settings { samples_per_job, ..Settings::new(side, side, 2) })
        };
        assert_eq!(of(8192, 1), BATCHES_MAX);
        assert!(of(64, 256) < of(512, 256) && of(512, 256) < BATCHES_MAX);
    }
}
