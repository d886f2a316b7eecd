//! The whole path of a sample, told while it is traced: surfaces, lobes, lights, random numbers and what each of them adds.
//!
//! A tracer without a witness is compiled without any of this, and finds the same bits.

use std::cell::RefCell;

use glam::Vec3;

use crate::scene::MaterialId;
use crate::transport::interaction::Interaction;

/// Who is told what a tracer does.
pub trait Witness {
    /// Something begins; what follows until it closes is part of it.
    fn open(&self, _event: impl FnOnce() -> Event) {}
    /// What it adds is multiplied by this.
    fn scale(&self, _factor: impl FnOnce() -> Vec3) {}
    /// It ends.
    fn close(&self) {}
    /// Something is met, or adds this light.
    fn note(&self, _event: impl FnOnce() -> Event, _light: Vec3) {}
    /// Random numbers that the next event was drawn with.
    fn drew(&self, _numbers: impl FnOnce() -> Vec<f32>) {}
}

/// Nobody looks.
#[derive(Clone, Copy, Debug)]
pub struct Nobody;

impl Witness for Nobody {}

/// Something on a sample's way.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The sample itself.
    Sample,
    /// A surface is met.
    Surface {
        /// Object id.
        object: u32,
        /// Its material.
        material: MaterialId,
        /// Where, in the scene's coordinates.
        position: Vec3,
        /// The shading normal on the side that is seen.
        normal: Vec3,
        /// From where the ray began.
        distance: f32,
        /// Surfaces before it.
        depth: u32,
    },
    /// Nothing is met: the environment is seen.
    Escaped {
        /// Direction of the ray.
        direction: Vec3,
    },
    /// A ray goes on through a lobe.
    Lobe {
        /// The lobe has one direction only.
        delta: bool,
        /// It crosses the surface.
        transmitted: bool,
        /// Its direction.
        direction: Vec3,
        /// Its density over solid angle; a delta lobe's probability.
        pdf: f32,
    },
    /// A glossy lobe is estimated.
    Glossy {
        /// Rays of the lobe.
        rays: u32,
        /// Samples of lights.
        lights: u32,
    },
    /// One layer of a surface of several.
    Layer {
        /// Its number, where all are followed and none is chosen.
        number: Option<u32>,
    },
    /// One band of light, in glass that bends them apart.
    Band {
        /// Its share of red, green and blue.
        color: Vec3,
    },
    /// Chance decides whether a ray goes on, or whether light is worth a shadow ray.
    Roulette {
        /// Probability that it does.
        survival: f32,
        /// The random number.
        drawn: f32,
    },
    /// A sample of a light.
    Light {
        /// Direction to it.
        direction: Vec3,
        /// Its density over solid angle; 1 for a light without area.
        pdf: f32,
        /// Its share beside rays of the lobe.
        weight: f32,
        /// Whether something stands before it.
        blocked: bool,
    },
    /// What the surface emits.
    Emission,
    /// Stored light on the diffuse part.
    Diffuse,
    /// Stored light on the other side, which shines through.
    Through,
    /// What a coat takes from or adds to what the display shows.
    Coat,
}

impl Event {
    /// A surface that a ray met.
    pub(super) fn surface(at: &Interaction, depth: u32) -> Self {
        Self::Surface {
            object: at.object,
            material: at.material,
            position: at.position,
            normal: at.facing_shading(),
            distance: at.t,
            depth,
        }
    }
}

/// An event and what it adds.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// What it is part of, by number; none of the sample itself.
    pub parent: Option<usize>,
    /// What it is.
    pub event: Event,
    /// Random numbers that it was drawn with.
    pub numbers: Vec<f32>,
    /// What all that is part of it is multiplied by.
    pub factor: Vec3,
    /// Light of its own, radiance, before the factors of what it is part of.
    pub light: Vec3,
}

/// A sample's way: a tree of steps, parents before their parts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Path {
    /// The steps.
    pub steps: Vec<Step>,
}

impl Path {
    /// What one unit of light at each step adds to the sample.
    pub fn throughput(&self) -> Vec<Vec3> {
        let mut of = Vec::with_capacity(self.steps.len());
        for step in &self.steps {
            let before = step.parent.map_or(Vec3::ONE, |parent: usize| of[parent]);
            of.push(before * step.factor);
        }
        of
    }

    /// What each step, with all that is part of it, adds to the sample.
    pub fn added(&self) -> Vec<Vec3> {
        let mut added: Vec<Vec3> = Vec::with_capacity(self.steps.len());
        for (step, through) in self.steps.iter().zip(self.throughput()) {
            added.push(step.light * through);
        }
        for number in (0..self.steps.len()).rev() {
            if let Some(parent) = self.steps[number].parent {
                let part = added[number];
                added[parent] += part;
            }
        }
        added
    }
}

/// Writes a path down.
#[derive(Debug, Default)]
pub struct Scribe {
    written: RefCell<Written>,
}

#[derive(Debug, Default)]
struct Written {
    path: Path,
    open: Vec<usize>,
    numbers: Vec<f32>,
}

impl Scribe {
    /// What was written.
    pub fn path(self) -> Path {
        self.written.into_inner().path
    }
}

impl Written {
    fn push(&mut self, event: Event, light: Vec3) -> usize {
        let (parent, numbers) = (self.open.last().copied(), std::mem::take(&mut self.numbers));
        self.path.steps.push(Step { parent, event, numbers, factor: Vec3::ONE, light });
        self.path.steps.len() - 1
    }
}

impl Witness for Scribe {
    fn open(&self, event: impl FnOnce() -> Event) {
        let mut written = self.written.borrow_mut();
        let number = written.push(event(), Vec3::ZERO);
        written.open.push(number);
    }

    fn scale(&self, factor: impl FnOnce() -> Vec3) {
        let mut written = self.written.borrow_mut();
        if let Some(open) = written.open.last().copied() {
            written.path.steps[open].factor *= factor();
        }
    }

    fn close(&self) {
        self.written.borrow_mut().open.pop();
    }

    fn note(&self, event: impl FnOnce() -> Event, light: Vec3) {
        self.written.borrow_mut().push(event(), light);
    }

    fn drew(&self, numbers: impl FnOnce() -> Vec<f32>) {
        self.written.borrow_mut().numbers = numbers();
    }
}
