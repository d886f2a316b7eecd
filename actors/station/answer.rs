//! What a guest answers to a job: made whole again, and held against what is traced here.

use foveal::allocation::jobs::{GUIDES, guide_pixels, job_pixels};
use foveal::image::luminance;
use foveal::rng;
use foveal::sampling::Lattice;
use foveal::splatting::light_tracing::{Splats, trace_run};
use foveal::splatting::tile_sums::TileSums;
use foveal::splatting::trace::{Owner, samples_of_colors, trace_colors, trace_guides};
use foveal::splatting::{Guides, SampleBatch};
use foveal::transport::caustic::RUN;
use glam::Vec3;

use super::wire::{Body, Colors, Order};
use crate::message::{DrawnView, RunWork, SampleOrder, TileWork, TraceJob};

/// The order for a guest that a job is, if it is one that can be done elsewhere; its view, and its seed.
pub(super) fn order_of(job: &TraceJob) -> Option<(Order, &DrawnView, u64)> {
    match job {
        TraceJob::Samples(SampleOrder { drawn, order, seed, .. }) => {
            Some((Order::Samples(*order), drawn, *seed))
        }
        TraceJob::Tile(TileWork { drawn, block, seed }) => Some((Order::Block(*block), drawn, *seed)),
        TraceJob::Run(RunWork { drawn, run, seed }) => Some((Order::Run(*run), drawn, *seed)),
        _ => None,
    }
}

/// The answer to a job, made whole again.
pub(super) enum Answer {
    Samples(SampleBatch),
    Guides(Guides),
    Block(TileSums),
    Run(Splats),
}

impl Answer {
    /// None where it is not what the job wants.
    pub(super) fn of(job: &TraceJob, lattice: &Lattice, body: &Body) -> Option<Self> {
        match (job, body) {
            (TraceJob::Samples(order), Body::Colors(traced)) => Self::of_colors(order, lattice, traced),
            (TraceJob::Tile(TileWork { drawn, block, .. }), Body::Block(sums)) => {
                let wanted = [block.tile, block.first, block.count];
                let is_wanted = [sums.tile, sums.first, sums.samples] == wanted;
                let pixels = block.pixels(drawn.frame.size).len();
                (is_wanted && sums.len() == pixels && sums.is_sound()).then(|| Self::Block(sums.clone()))
            }
            (TraceJob::Run(RunWork { drawn, run, .. }), Body::Run(splats)) => {
                let pixels = drawn.frame.size.iter().map(|side| *side as usize).product();
                (splats.run == *run && splats.fits(pixels)).then(|| Self::Run(splats.clone()))
            }
            _ => None,
        }
    }

    fn of_colors(order: &SampleOrder, lattice: &Lattice, traced: &Colors) -> Option<Self> {
        let SampleOrder { drawn, order: job, .. } = order;
        if job.level == GUIDES {
            let pixels = guide_pixels(job, &drawn.buffers().object);
            let pixels: Vec<_> = pixels.map(|(x, y)| [x as u16, y as u16]).collect();
            let fits = pixels.len() == traced.colors.len() && traced.guides.is_empty();
            return fits
                .then(|| Self::Guides(Guides { view: drawn.view.0, pixels, colors: traced.colors.clone() }));
        }
        let owner = Owner { view: drawn.view.0, object: job.object, k: lattice.k_of(job.level) };
        let pixels = job_pixels(lattice, job, &drawn.buffers().object);
        let (world, frame, buffers) = (&drawn.world, &drawn.frame, drawn.buffers());
        let mut batch = samples_of_colors(world, frame, buffers, owner, pixels, &traced.colors)?;
        let guides = if job.guided { batch.len() } else { 0 };
        if traced.guides.len() != guides {
            return None;
        }
        batch.guides.clone_from(&traced.guides);
        Some(Self::Samples(batch))
    }
}

/// What a job comes to here; none where it is one that stays here.
pub(super) fn traced_here(job: &TraceJob, lattice: &Lattice) -> Option<Body> {
    match job {
        TraceJob::Samples(order) => Some(Body::Colors(colors_of(order, lattice, None))),
        TraceJob::Tile(TileWork { drawn, block, seed }) => {
            block.traced(&drawn.world, &drawn.frame, *seed, &|| true).map(Body::Block)
        }
        TraceJob::Run(RunWork { drawn, run, seed }) => {
            trace_run(&drawn.world, &drawn.frame, *run, *seed, &|| true).map(Body::Run)
        }
        _ => None,
    }
}

/// The colours of a job as they are, of all its pixels or of those that `only` names by their number.
fn colors_of(order: &SampleOrder, lattice: &Lattice, only: Option<&[usize]>) -> Colors {
    let SampleOrder { drawn, order: job, seed, .. } = order;
    let (world, frame, buffers) = (&drawn.world, &drawn.frame, drawn.buffers());
    let all: Vec<(i32, i32)> = match job.level {
        GUIDES => guide_pixels(job, &buffers.object).collect(),
        _ => job_pixels(lattice, job, &buffers.object)
            .filter(|&(x, y)| buffers.hit.at(x as usize, y as usize).hit().is_some())
            .collect(),
    };
    let pixels: Vec<(i32, i32)> = match only {
        Some(only) => only.iter().filter_map(|i| all.get(*i).copied()).collect(),
        None => all,
    };
    let guides = |pixels: &[(i32, i32)]| trace_guides(world, frame, buffers, pixels.iter().copied());
    if job.level == GUIDES {
        return Colors { colors: guides(&pixels), guides: Vec::new() };
    }
    Colors {
        colors: trace_colors(world, frame, buffers, pixels.iter().copied(), *seed),
        guides: if job.guided { guides(&pixels) } else { Vec::new() },
    }
}

/// How numbers from elsewhere are compared with those that are traced here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Likeness {
    /// By their bits.
    Bits,
    /// By what they come to: they are of a machine whose functions round in other ways.
    Near,
}

impl Likeness {
    /// Whether two colours are alike, where all are about as bright as `mean`.
    fn holds(self, [here, there]: [Vec3; 2], mean: f32) -> bool {
        /// What rounding that tips over along a path comes to, and more.
        const SHARE: f32 = 0.02;
        match self {
            Self::Bits => here.to_array().map(f32::to_bits) == there.to_array().map(f32::to_bits),
            Self::Near => {
                let most = here.abs().max_element().max(there.abs().max_element()).max(mean);
                (here - there).abs().max_element() <= SHARE * most
            }
        }
    }
}

/// Which of three kinds it is: colours, a block, a run.
pub(super) fn kind_of(body: &Body) -> usize {
    match body {
        Body::Colors(_) => 0,
        Body::Block(_) => 1,
        Body::Run(_) => 2,
    }
}

/// Whether a run is one of those that are traced here, where so many of its particles are to be checked.
fn is_drawn(run: u32, (checked, salt): (u32, u64)) -> bool {
    let lot = rng::hash(salt, u64::from(run), 0) % RUN;
    lot < u64::from(checked)
}

/// How many comparisons [`differing`] makes.
pub(super) fn compared_of(job: &TraceJob, body: &Body, (checked, salt): (u32, u64)) -> u32 {
    match (job, body) {
        (TraceJob::Samples(_), Body::Colors(traced)) => checked.min(traced.colors.len() as u32),
        (TraceJob::Tile(TileWork { block, .. }), Body::Block(sums)) => {
            checked.div_ceil(block.count.max(1)).min(sums.len() as u32)
        }
        (TraceJob::Run(RunWork { run, .. }), Body::Run(_)) => u32::from(is_drawn(*run, (checked, salt))),
        _ => 0,
    }
}

/// How many of some samples of an answer, about `checked` and chosen by `salt`, are not what is traced here. Of a block those of
/// a pixel count as one; a run is traced as a whole or not at all.
pub(super) fn differing(
    job: &TraceJob,
    lattice: &Lattice,
    body: &Body,
    (checked, salt): (u32, u64),
    likeness: Likeness,
) -> u32 {
    let chosen = |checked: u32, count: usize, of: u32| -> Vec<usize> {
        let drawn = |i: usize| rng::hash(salt, i as u64, u64::from(of)) as usize % count;
        let checked = checked as usize;
        if checked < count { (0..checked).map(drawn).collect() } else { (0..count).collect() }
    };
    let differ = |which: &[usize], here: &[Vec3], there: &[Vec3]| {
        let mean = there.iter().map(|c| luminance(*c)).sum::<f32>().abs() / there.len().max(1) as f32;
        let pairs = here.iter().zip(which).map(|(here, i)| Some([*here, *there.get(*i)?]));
        pairs.filter(|pair| pair.is_none_or(|pair| !likeness.holds(pair, mean))).count() as u32
    };
    match (job, body) {
        (TraceJob::Samples(order), Body::Colors(traced)) => {
            let which = chosen(checked, traced.colors.len(), order.order.object);
            let here = colors_of(order, lattice, Some(&which));
            differ(&which, &here.colors, &traced.colors) + differ(&which, &here.guides, &traced.guides)
        }
        (TraceJob::Tile(TileWork { drawn, block, seed }), Body::Block(sums)) => {
            let which = chosen(checked.div_ceil(block.count.max(1)), sums.len(), block.tile);
            let here = block.traced_only(&which, &drawn.world, &drawn.frame, *seed);
            match likeness {
                Likeness::Bits => u32::from(!sums.has(&which, &here)),
                Likeness::Near => {
                    let means = |sums: &TileSums| sums.uncut().collect::<Vec<_>>();
                    differ(&which, &means(&here), &means(sums))
                }
            }
        }
        (TraceJob::Run(RunWork { drawn, run, seed }), Body::Run(splats)) => {
            if !is_drawn(*run, (checked, salt)) {
                return 0;
            }
            let Some(here) = trace_run(&drawn.world, &drawn.frame, *run, *seed, &|| true) else { return 1 };
            match likeness {
                Likeness::Bits => u32::from(here != *splats),
                Likeness::Near => differ(&[0], &[here.sum()], &[splats.sum()]),
            }
        }
        _ => 1,
    }
}
