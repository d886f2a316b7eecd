//! Where another round of direct light is worth its time.

use rayon::prelude::*;

use super::atlas::Element;
use super::bake::{BLOCK, Baker};
use super::direct::DirectBin;
use crate::image::luminance;

/// Cells along the scene's diagonal.
const CELLS: f32 = 40.0;
/// Places for them; cells that share one are lit together.
const PLACES: usize = 1 << 16;
/// Irradiance below this share of the mean may be noisier.
const DIM: f32 = 0.1;
/// Noise of direct light, relative to what arrives in the same place, that is seen.
const NOISE_SEEN: f32 = 0.02;
/// Elements that smoothing makes a mean of without wiping out the light of a small lamp.
const SMOOTHED: f32 = 16.0;
/// Share of the lit surface that may be noisier.
const OVERLOOKED: f32 = 2e-3;
/// A standard error, relative to what arrives, below which nothing is gained.
const CLEAN: f32 = 0.01;

/// Cells of space and direction in which samples found light.
struct LitCells {
    size: f32,
    lit: Vec<bool>,
}

impl LitCells {
    fn new(elements: &[Element], direct: &[[DirectBin; 2]], diagonal: f32) -> Self {
        let mut cells = Self { size: diagonal / CELLS, lit: vec![false; PLACES] };
        for (e, sides) in elements.iter().zip(direct) {
            for (side, bin) in sides.iter().enumerate() {
                if bin.has_found_light() {
                    let place = cells.place(e, side);
                    cells.lit[place] = true;
                }
            }
        }
        cells
    }

    fn place(&self, e: &Element, side: usize) -> usize {
        let cell = (e.position / self.size).floor().as_ivec3();
        let axis = e.normal.abs().max_position();
        let towards = 2 * axis + usize::from((e.normal[axis] < 0.0) != (side == 1));
        let xy =
            crate::rng::hash(u64::from(cell.x as u32), u64::from(cell.y as u32), u64::from(cell.z as u32));
        (xy as usize).wrapping_mul(6).wrapping_add(towards) % PLACES
    }

    fn contains(&self, e: &Element, side: usize) -> bool {
        self.lit[self.place(e, side)]
    }
}

/// One side of a block of elements.
#[derive(Clone, Copy, Default)]
struct Block {
    area: f32,
    /// What arrives, W.
    power: f32,
    /// Mean variance of direct light times the area.
    variance: f32,
    /// Whether direct light was found here or nearby.
    is_lit: bool,
}

/// How noisy direct light is, block by block.
pub(super) struct DirectNoise {
    blocks: Vec<[Block; 2]>,
    /// Irradiance that counts as dim, W/m².
    dim: f32,
    /// Mean relative variance on lit surface.
    mean: f32,
}

impl Baker<'_> {
    /// Of what was gathered so far.
    pub(super) fn direct_noise(&self) -> DirectNoise {
        let (elements, emitted) = (&self.atlas.elements, self.emitted.max(1) as f32);
        let cells = LitCells::new(elements, &self.direct, self.diagonal);
        let of_block = |(first, bins): (usize, &[[DirectBin; 2]])| {
            [0, 1].map(|side| {
                let mut block = Block::default();
                for (index, bin) in (first * BLOCK..).zip(bins) {
                    let e = &elements[index];
                    if e.area > 0.0 && self.watched[index] {
                        let (mean, variance) = bin[side].mean();
                        let particles = luminance(self.bins.arrived(index as u32, side == 1).flux) / emitted;
                        block.area += e.opaque;
                        block.power += luminance(mean) * e.opaque + particles;
                        block.variance += variance * e.opaque;
                        block.is_lit |= cells.contains(e, side);
                    }
                }
                block
            })
        };
        let blocks: Vec<[Block; 2]> = self.direct.par_chunks(BLOCK).enumerate().map(of_block).collect();
        let (mut area, mut power) = (0.0f64, 0.0f64);
        for block in blocks.iter().flatten().filter(|b| b.is_lit) {
            area += f64::from(block.area);
            power += f64::from(block.power);
        }
        if area <= 0.0 {
            return DirectNoise { blocks, dim: 0.0, mean: 0.0 };
        }
        let mut noise = DirectNoise { blocks, dim: DIM * (power / area) as f32, mean: 0.0 };
        let of = |b: &Block| f64::from(b.area) * f64::from(noise.of(b));
        noise.mean = (noise.blocks.iter().flatten().filter(|b| b.is_lit).map(of).sum::<f64>() / area) as f32;
        noise
    }
}

impl DirectNoise {
    /// Variance of the direct light of an element, relative to what arrives.
    fn of(&self, b: &Block) -> f32 {
        let noise = (b.variance / b.area) / (b.power / b.area + self.dim).powi(2);
        if noise.is_finite() { noise } else { 0.0 }
    }

    /// Whether smoothing leaves noise that is seen, anywhere: the light of a small lamp is lost in the mean of a house.
    pub(super) fn is_seen(&self) -> bool {
        let (mut lit, mut noisy) = (0.0, 0.0);
        for block in self.blocks.iter().flatten().filter(|b| b.is_lit) {
            lit += block.area;
            if self.of(block) > SMOOTHED * NOISE_SEEN * NOISE_SEEN {
                noisy += block.area;
            }
        }
        noisy > OVERLOOKED * lit
    }

    /// Per block and side whether it takes part in the next round, after so many: those where light was found, there or
    /// nearby, and after four rounds, when the spread is known, those noisier than most. Not single elements: those that
    /// missed the light by chance would stop and stay dark.
    pub(super) fn worth_a_round(&self, rounds: u32) -> Vec<[bool; 2]> {
        let enough = if rounds < 4 { -1.0 } else { (0.5 * self.mean).max(CLEAN * CLEAN) };
        self.blocks.iter().map(|sides| sides.each_ref().map(|b| b.is_lit && self.of(b) > enough)).collect()
    }
}
