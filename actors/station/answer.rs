//! What a guest answers to a job: made whole again, and held against what is traced here.

use foveal::allocation::jobs::{GUIDES, guide_pixels, job_pixels};
use foveal::rng;
use foveal::sampling::Lattice;
use foveal::splatting::trace::{Owner, samples_of_colors, trace_colors, trace_guides};
use foveal::splatting::{Guides, SampleBatch};
use glam::Vec3;

use super::wire::Colors;
use crate::message::SampleOrder;

/// The answer to a job, made whole again.
pub(super) enum Answer {
    Samples(SampleBatch),
    Guides(Guides),
}

impl Answer {
    /// None where the colours are not as many as the job wants.
    pub(super) fn of(order: &SampleOrder, lattice: &Lattice, traced: &Colors) -> Option<Self> {
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

/// The colours of a job as they are, of all its pixels or of those that `only` names by their number.
pub(super) fn colors_of(order: &SampleOrder, lattice: &Lattice, only: Option<&[usize]>) -> Colors {
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

/// Whether so many of the colours, chosen by `salt`, are what is traced here.
pub(super) fn is_right(
    order: &SampleOrder,
    lattice: &Lattice,
    traced: &Colors,
    checked: usize,
    salt: u64,
) -> bool {
    let count = traced.colors.len();
    let which: Option<Vec<usize>> = (checked < count).then(|| {
        let drawn = |i: usize| rng::hash(salt, i as u64, u64::from(order.order.object)) as usize % count;
        (0..checked).map(drawn).collect()
    });
    let here = colors_of(order, lattice, which.as_deref());
    let bits = |c: &Vec3| c.to_array().map(f32::to_bits);
    let same = |here: &[Vec3], there: &[Vec3]| match &which {
        None => here.iter().map(bits).eq(there.iter().map(bits)),
        Some(which) => {
            let there = which.iter().filter_map(|i| there.get(*i));
            here.iter().map(bits).eq(there.map(bits))
        }
    };
    same(&here.colors, &traced.colors) && same(&here.guides, &traced.guides)
}
