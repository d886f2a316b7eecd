//! Pictures and bakes in pieces, for whoever is at hand.
//!
//! A piece is a function of its [`Ground`] (scene, light and what is made of them) and itself, so it does not matter who does
//! it, where, or how often. Results are put together in the order of pieces, so nothing depends on when they came.

use std::ops::Range;
use std::sync::{Arc, OnceLock};

use foveal::display::FrameBuffers;
use foveal::display::cpu_pass;
use foveal::geometry::Ray;
use foveal::illumination::bake::orders::{Answer, Gatherers, Order};
use foveal::illumination::bake::particles::{Arrived, PART};
use foveal::illumination::bake::{BakeSettings, Baker};
use foveal::illumination::stored::Illumination;
use foveal::scene::camera::CameraFrame;
use foveal::splatting::light_tracing::{Splats, trace_run};
use foveal::splatting::supersampling::{SAMPLES_MAX, Tiles, supersample_while};
use foveal::splatting::tile_sums::TileSums;
use foveal::splatting::trace::pixel_stream;
use foveal::transport::Indexed;
use foveal::transport::bidirectional::{Bidirectional, Part, Photons};
use foveal::transport::light::bright::BrightSurfaces;
use foveal::transport::tracer::Tracer;
use foveal::world::World;
use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::interrupt::interrupted;

/// What pieces are of, beside scene and light: enough for another machine to make their ground.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Task {
    /// A picture of a view.
    Picture {
        /// Its camera.
        frame: CameraFrame,
        /// Seed of the random numbers.
        seed: u64,
    },
    /// A bake.
    Bake(BakeSettings),
}

impl Task {
    /// Whether a piece of it can come to that: what came from elsewhere must.
    pub fn may_come_to(&self, piece: &Piece, found: &Found) -> bool {
        let (tiles, of) = match self {
            Self::Picture { frame, .. } => (Tiles::of_size(frame.size[0], frame.size[1]), pixels_of(frame)),
            Self::Bake(_) => (Tiles::of_size(0, 0), 0),
        };
        match (piece, found) {
            (Piece::Converged(pixels) | Piece::Paths { pixels, .. }, Found::Colors(colors)) => {
                colors.len() == pixels.len()
            }
            (&Piece::Tile { tile, samples }, Found::Tile(sums)) => {
                sums.tile == tile && sums.samples == samples.min(SAMPLES_MAX - 1) && sums.fits(&tiles)
            }
            (Piece::Run(run), Found::Run(splats)) => splats.run == *run && splats.fits(of),
            (Piece::Bidirectional { pixels, .. }, Found::Bidirectional(part)) => part.fits(pixels.len(), of),
            (Piece::Gather(order), Found::Gathered(answer)) => order.may_be_answered_by(answer),
            (Piece::Particles(_), Found::Arrived(arrived)) => arrived.iter().all(Arrived::is_sound),
            _ => false,
        }
    }
}

/// Pixels of a picture.
fn pixels_of(frame: &CameraFrame) -> usize {
    frame.size.iter().map(|side| *side as usize).product()
}

/// A piece of work. Pixels are counted row by row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Piece {
    /// Pixels as a still view converges to.
    Converged(Range<u32>),
    /// So many further samples of each pixel of a tile.
    Tile {
        /// Which.
        tile: u32,
        /// How many.
        samples: u32,
    },
    /// A run of light traced to the eye.
    Run(u32),
    /// One path of each pixel.
    Paths {
        /// Which sample of these pixels it is.
        sample: u64,
        /// Which pixels.
        pixels: Range<u32>,
    },
    /// A part of a pass of bidirectional paths.
    Bidirectional {
        /// Which pass.
        pass: u64,
        /// Which pixels' subpaths.
        pixels: Range<u32>,
    },
    /// Light at sites of a bake.
    Gather(Order),
    /// Particles of a bake's caustics, from this one on.
    Particles(u64),
}

/// What a piece comes to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Found {
    /// Of pixels, converged or one path of each.
    Colors(Vec<Vec3>),
    /// Of a tile.
    Tile(TileSums),
    /// Of a run.
    Run(Splats),
    /// Of a pass.
    Bidirectional(Part),
    /// Of sites.
    Gathered(Answer),
    /// Of particles.
    Arrived(Vec<Arrived>),
}

/// What pieces of a task are done with.
#[derive(Clone, Copy)]
pub enum Ground<'a> {
    /// Of a picture.
    Picture(Picture<'a>),
    /// Of a bake.
    Bake {
        /// Of which only scene and settings count.
        baker: &'a Baker,
        /// The scene.
        indexed: Indexed<'a>,
        /// The map of the round before.
        map: &'a Illumination,
        /// Where most of its light comes from, once it was looked for.
        bright: &'a OnceLock<BrightSurfaces>,
        /// When it is good enough, which others need to make theirs.
        settings: &'a BakeSettings,
    },
}

/// What pieces of a picture are done with.
#[derive(Clone, Copy)]
pub struct Picture<'a> {
    /// Scene and light.
    pub world: &'a World,
    /// The camera.
    pub frame: &'a CameraFrame,
    /// Seed of the random numbers.
    pub seed: u64,
    /// The base layer, for what a still view converges to.
    pub base: Option<&'a FrameBuffers>,
    /// Photons of a pass of bidirectional paths.
    pub photons: &'a (dyn Fn(&Bidirectional<'_>, u64) -> Arc<Photons> + Sync),
}

impl Picture<'_> {
    fn has(&self, pixels: &Range<u32>) -> bool {
        pixels.start < pixels.end
            && pixels.end as usize <= pixels_of(self.frame)
            && pixels.end - pixels.start <= PIXELS_MAX
    }

    fn coordinates(&self, pixel: u32) -> (u32, u32) {
        (pixel % self.frame.size[0], pixel / self.frame.size[0])
    }

    /// What a still view shows of a pixel when it has converged.
    fn converged(&self, tracer: &Tracer<'_>, base: &FrameBuffers, pixel: u32) -> Vec3 {
        let (x, y) = self.coordinates(pixel);
        let (column, row) = (x as usize, y as usize);
        let shown = base.color.at(column, row);
        let hit = base.hit.at(column, row).hit();
        let (Some(hit), true) = (hit, base.object.at(column, row) != 0) else { return shown };
        let ray = cpu_pass::primary_ray(self.frame, x, y);
        let at = cpu_pass::primary_interaction(self.world, self.frame, &ray, &hit);
        shown + tracer.view_dependent(&at, shown, pixel_stream(self.seed, x, y, 0))
    }

    /// The radiance of one path through a pixel.
    fn path(&self, sample: u64, pixel: u32) -> Vec3 {
        let (x, y) = self.coordinates(pixel);
        let mut stream = pixel_stream(self.seed, x, y, sample);
        let [dx, dy] = stream.next_2d();
        let ray = Ray::new(self.frame.eye, self.frame.direction(x as f32 + dx, y as f32 + dy));
        self.world.path_radiance(&ray, stream.split(0))
    }

    fn done(&self, piece: &Piece, goes_on: &dyn Fn() -> bool) -> Option<Found> {
        let &Self { world, frame, seed, .. } = self;
        Some(match piece {
            Piece::Converged(pixels) => {
                let (tracer, base) = (world.tracer(), self.base?);
                Found::Colors(pixels.clone().map(|pixel| self.converged(&tracer, base, pixel)).collect())
            }
            &Piece::Tile { tile, samples } => {
                let sums = supersample_while(world, frame, tile, None, samples, seed, goes_on);
                Found::Tile(Some(sums).filter(|sums| sums.samples == samples.min(SAMPLES_MAX - 1))?)
            }
            &Piece::Run(run) => Found::Run(trace_run(world, frame, run, seed, goes_on)?),
            Piece::Paths { sample, pixels } => {
                Found::Colors(pixels.clone().map(|pixel| self.path(*sample, pixel)).collect())
            }
            Piece::Bidirectional { pass, pixels } => {
                let paths = world.bidirectional(frame);
                let photons = (self.photons)(&paths, *pass);
                Found::Bidirectional(paths.part(seed, *pass, pixels.clone(), &photons))
            }
            Piece::Gather(_) | Piece::Particles(_) => return None,
        })
    }
}

/// Pixels of a piece at most, so that a row is one and what it comes to a message.
pub const PIXELS_MAX: u32 = 1 << 14;
/// Pixels of a piece at least, where the picture has as many.
const PIXELS: u32 = 1 << 11;

/// A picture's pixels, in pieces of whole rows.
pub fn strips(frame: &CameraFrame) -> impl Iterator<Item = Range<u32>> + use<> {
    let [width, height] = frame.size;
    let step = width * PIXELS.div_ceil(width.max(1)).min(PIXELS_MAX / width.clamp(1, PIXELS_MAX)).max(1);
    let all = width * height;
    (0..all).step_by(step.max(1) as usize).map(move |first| first..all.min(first + step))
}

impl Ground<'_> {
    /// What its pieces are of.
    pub fn task(&self) -> Task {
        match self {
            Self::Picture(picture) => Task::Picture { frame: *picture.frame, seed: picture.seed },
            Self::Bake { settings, .. } => Task::Bake((*settings).clone()),
        }
    }

    /// The map that it has, if any.
    pub fn map(&self) -> Option<&Illumination> {
        match self {
            Self::Picture(picture) => picture.world.illumination.stored(),
            Self::Bake { map, .. } => Some(map),
        }
    }

    /// Whether a piece is of this ground: what came from elsewhere must be.
    pub fn has(&self, piece: &Piece) -> bool {
        match (self, piece) {
            (Self::Picture(p), Piece::Converged(pixels)) => p.base.is_some() && p.has(pixels),
            (Self::Picture(p), Piece::Tile { tile, samples }) => {
                let [width, height] = p.frame.size;
                (*tile as usize) < Tiles::of_size(width, height).len() && *samples <= SAMPLES_MAX
            }
            (Self::Picture(_), Piece::Run(_)) => true,
            (Self::Picture(p), Piece::Paths { pixels, .. } | Piece::Bidirectional { pixels, .. }) => {
                p.has(pixels)
            }
            (Self::Bake { baker, .. }, Piece::Gather(order)) => baker.has(order),
            // As many as a bake counts, and not at the end of numbers.
            (Self::Bake { .. }, Piece::Particles(first)) => first.is_multiple_of(PART) && *first < 1 << 48,
            (Self::Picture(_), Piece::Gather(_) | Piece::Particles(_)) | (Self::Bake { .. }, _) => false,
        }
    }

    /// Does a piece; none where it is of another ground, or is not to go on.
    pub fn done(&self, piece: &Piece, goes_on: &dyn Fn() -> bool) -> Option<Found> {
        match (self, piece) {
            (Self::Picture(picture), piece) => picture.done(piece, goes_on),
            (Self::Bake { baker, indexed, map, bright, .. }, Piece::Gather(order)) => {
                Some(Found::Gathered(baker.answer(*indexed, (map, bright), order)))
            }
            (Self::Bake { baker, indexed, .. }, Piece::Particles(first)) => {
                Some(Found::Arrived(baker.arrived(*indexed, *first)))
            }
            (Self::Bake { .. }, _) => None,
        }
    }
}

/// Who does pieces.
pub trait Hands: Sync {
    /// Does them, each after it was asked whether it `goes_on`; in the same order, those that were done.
    fn each(
        &self,
        ground: &Ground<'_>,
        pieces: Vec<Piece>,
        goes_on: &(dyn Fn() -> bool + Sync),
    ) -> Vec<Option<Found>>;

    /// How much they do in the time that this machine takes for 1.
    fn worth(&self) -> u64 {
        1
    }

    /// Whether somebody's work was found to be wrong, of whom some had been handed out before. What was made of that since
    /// this was asked last has to be made anew.
    fn doubts(&self) -> bool {
        false
    }
}

/// The threads of this machine.
#[derive(Clone, Copy, Debug)]
pub struct Alone;

impl Hands for Alone {
    fn each(
        &self,
        ground: &Ground<'_>,
        pieces: Vec<Piece>,
        goes_on: &(dyn Fn() -> bool + Sync),
    ) -> Vec<Option<Found>> {
        pieces.par_iter().map(|piece| goes_on().then(|| ground.done(piece, &|| !interrupted()))?).collect()
    }
}

/// A bake whose light hands gather.
pub struct Handed<'a> {
    /// Who gathers.
    pub hands: &'a dyn Hands,
    /// Of the bake.
    pub settings: &'a BakeSettings,
}

fn of_bake<'a>(settings: &'a BakeSettings, baker: &'a Baker, indexed: Indexed<'a>) -> Ground<'a> {
    Ground::Bake { baker, indexed, map: baker.map(), bright: baker.bright(), settings }
}

impl Gatherers for Handed<'_> {
    fn trace(&self, baker: &Baker, indexed: Indexed<'_>, parts: &[u64]) -> Vec<Vec<Arrived>> {
        let ground = of_bake(self.settings, baker, indexed);
        let pieces = parts.iter().map(|part| Piece::Particles(*part)).collect();
        let found = self.hands.each(&ground, pieces, &|| true).into_iter().zip(parts);
        let arrived = |(found, part): (Option<Found>, &u64)| match found {
            Some(Found::Arrived(arrived)) => arrived,
            _ => baker.arrived(indexed, *part),
        };
        found.map(arrived).collect()
    }

    fn gather(&self, baker: &Baker, indexed: Indexed<'_>, orders: &[Order]) -> Vec<Answer> {
        let ground = of_bake(self.settings, baker, indexed);
        let pieces = orders.iter().cloned().map(Piece::Gather).collect();
        let answers = self.hands.each(&ground, pieces, &|| true).into_iter().zip(orders);
        let answer = |(found, order): (Option<Found>, &Order)| match found {
            Some(Found::Gathered(answer)) => answer,
            _ => baker.answer(indexed, (baker.map(), baker.bright()), order),
        };
        answers.map(answer).collect()
    }

    fn worth(&self) -> u64 {
        self.hands.worth()
    }
}
