//! What pictures of a still view and of a walk are held against.
//!
//! `traced` is what a view converges to: nothing but the work that was left out is missing beside it. `path` knows of no
//! baked light and no bound on rare lights, and has the mean over each pixel; so a converged view keeps an error beside
//! it. How much of that is the one sample of each pixel, and how much the base light, a refined view tells; how much the
//! reference's own noise, the two halves of its samples: they differ by about twice of it.

use foveal::image::Map2d;
use foveal::rng::hash;
use foveal::scene::camera::CameraFrame;
use foveal::world::World;
use glam::Vec3;

use super::error::ErrorArguments;
use super::error_curves::{Against, ReferenceKind};
use super::study::Study;
use foveal_engine::failure::Failure;
use foveal_engine::interrupt::{interrupted, uninterrupted};
use foveal_engine::reference::{path_picture, traced_picture};

/// Seed of references: not that of the pictures.
const SEED: u64 = 0x5eed;

/// References of one scene. The still view is the walk's first.
pub(super) struct References {
    /// Of the still view.
    pub traced: Map2d<Vec3>,
    /// What the still view is refined to, as many samples per pixel as paths.
    pub refined: Map2d<Vec3>,
    /// What each view of the walk converges to, one sample per pixel.
    pub converged: Vec<Map2d<Vec3>>,
    /// The still view by paths.
    pub still: Paths,
    /// Each view of the walk by paths.
    pub walking: Paths,
    /// Samples per pixel of the still view's traced one.
    traced_spp: u32,
}

/// Pictures by paths.
pub(super) struct Paths {
    pub pictures: Vec<Map2d<Vec3>>,
    /// The same by two halves of the samples; of one sample there are none.
    pub halves: Option<[Vec<Map2d<Vec3>>; 2]>,
    spp: u32,
}

impl References {
    /// Steps of work.
    pub(super) fn steps(a: &ErrorArguments) -> u64 {
        u64::from(a.frames) + 2
    }

    /// Traces them all; `done` hears of each step.
    ///
    /// # Errors
    /// If Ctrl-C was pressed.
    pub(super) fn new(a: &ErrorArguments, study: &Study, done: &dyn Fn()) -> Result<Self, Failure> {
        let goes_on = || !interrupted();
        let (world, view) = (study.world(), &study.still().frame);
        let seed = if a.traced_spp == 1 { 0 } else { SEED };
        let traced = traced_picture(world, view, seed, a.traced_spp, &goes_on).picture;
        let refined = traced_picture(world, view, SEED, a.reference_spp, &goes_on).picture;
        done();
        let still = Paths::new(world, [view], a.reference_spp, done)?;
        let walking = Paths::new(world, study.views.iter().map(|v| &v.frame), a.walk_spp, done)?;
        Ok(Self { traced, refined, converged: study.converged(), still, walking, traced_spp: a.traced_spp })
    }

    /// What corrections of the still view become.
    pub(super) fn traced_still(&self) -> Against {
        Against { kind: ReferenceKind::Traced, spp: self.traced_spp }
    }

    /// What corrections of each view of a walk would become.
    pub(super) fn traced_walking(&self) -> Against {
        Against { kind: ReferenceKind::Traced, spp: 1 }
    }
}

impl Paths {
    fn new<'f>(
        world: &World,
        frames: impl IntoIterator<Item = &'f CameraFrame>,
        spp: u32,
        done: &dyn Fn(),
    ) -> Result<Self, Failure> {
        let [n, m] = [spp.div_ceil(2), spp / 2];
        let (mut pictures, mut halves) = (Vec::new(), [Vec::new(), Vec::new()]);
        for (i, frame) in frames.into_iter().enumerate() {
            // Noise of its own for each view, or a walk's references would look through one dirty pane.
            let half =
                |h: u64, spp| path_picture(world, frame, hash(SEED, i as u64, h), spp, &|| !interrupted());
            let first = half(0, n);
            if m == 0 {
                pictures.push(first);
            } else {
                let second = half(1, m);
                pictures.push(mean([&first, &second], [n, m]));
                halves[0].push(first);
                halves[1].push(second);
            }
            uninterrupted()?;
            done();
        }
        Ok(Self { pictures, halves: (m > 0).then_some(halves), spp })
    }

    pub(super) fn against(&self) -> Against {
        Against { kind: ReferenceKind::Path, spp: self.spp }
    }

    /// What one half is held against: the other.
    pub(super) fn against_half(&self) -> Against {
        Against { kind: ReferenceKind::Path, spp: self.spp.div_ceil(2) }
    }
}

/// The mean of two pictures that are means of so many samples.
fn mean([a, b]: [&Map2d<Vec3>; 2], spp: [u32; 2]) -> Map2d<Vec3> {
    let [n, m] = spp.map(|n| n as f32);
    let mean = |(&a, &b): (&Vec3, &Vec3)| (a * n + b * m) / (n + m);
    Map2d::from_vec(a.width(), a.height(), a.data().iter().zip(b.data()).map(mean).collect())
}
