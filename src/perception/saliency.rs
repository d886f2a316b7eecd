//! Bottom-up saliency (Itti, Koch & Niebur 1998, as simplified by Haber 2001 §3).
//!
//! In: a display-referred picture (sRGB-encoded values in [0, 1]; the model is not photometric). Out: a
//! map of level-4 size (32 × 32 for 512 × 512), without unit, that ranks places by how much they stand
//! out in intensity, red–green and blue–yellow. Haber's variant has 6 intensity and 12 colour maps; the
//! 24 orientation maps are absent.
//!
//! Deviations, with reasons in REFERENCE §0 and §1: nine levels 0..8 (H9); |(R−G)(c) − (R−G)(s)| as colour
//! opponency (H10), so that R−G and B−Y need one pyramid each (REDUCE is linear); no opponency below a
//! tenth of the brightest intensity.

use glam::Vec3;

use super::pyramid::{ReduceRows, difference_row, lerp_rows, level_side};
use crate::image::Map2d;

/// Levels of each pyramid, 0..8.
pub const LEVELS: usize = 9;
/// The level whose size the saliency map has.
pub const MAP_LEVEL: u32 = 4;
/// Pixels of the picture per cell of the saliency map, along each side.
pub const CELL: usize = 1 << MAP_LEVEL;
/// Centre and surround levels: c in {2, 3, 4}, s = c + {3, 4} (Itti 1998 §2.1).
const PAIRS: [(usize, usize); 6] = [(2, 5), (2, 6), (3, 6), (3, 7), (4, 7), (4, 8)];
/// Maxima below this share of the largest are not counted by N(.) (SaliencyToolbox).
const MAXIMA_FLOOR: f32 = 0.1;
/// Hue is defined where intensity exceeds this share of the picture's maximum (Itti 1998 §2.1).
const HUE_FLOOR: f32 = 0.1;
/// Maps whose largest value is below this are flat: what single precision leaves of a constant.
const FLAT: f32 = 1e-6;
/// Smaller pictures have at most 4 × 4 cells, which say little: use importance alone (REFERENCE §1.5).
pub const MIN_SIDE: usize = 64;

const INTENSITY: usize = 0;
const RED_GREEN: usize = 1;
const BLUE_YELLOW: usize = 2;

/// What the model found in one picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Saliency {
    /// S of REFERENCE §1.5, in [0, 1]. One cell per 16 × 16 pixels; cell (i, j) is centred on pixel (16 i, 16 j).
    pub map: Map2d<f32>,
    /// Conspicuity of intensity: the sum of the six normalised maps, before N(.). Same size.
    pub intensity: Map2d<f32>,
    /// Conspicuity of colour: the sum of the twelve normalised maps, before N(.). Same size.
    pub colour: Map2d<f32>,
}

impl Saliency {}

/// The saliency of a display-referred picture. Allocates; a renderer keeps a [`SaliencyModel`].
pub fn saliency(image: &Map2d<Vec3>) -> Saliency {
    let mut model = SaliencyModel::default();
    model.compute(image);
    model.result
}

/// The model with its working memory: pictures of one size need no allocation after the first.
#[derive(Clone, Debug, Default)]
pub struct SaliencyModel {
    width: usize,
    height: usize,
    /// `pyramids[channel][level]`; level 0 is never stored.
    pyramids: [Vec<Vec<f32>>; 3],
    /// Five rows of level 0 per channel, row y in slot y mod 5.
    ring: [Vec<f32>; 3],
    /// One row of red, green and blue.
    row: [Vec<f32>; 3],
    reduce_rows: ReduceRows,
    coarse_row: Vec<f32>,
    difference: Vec<f32>,
    maxima: Maxima,
    /// Sums of normalised maps at levels 2, 3 and 4, for intensity and colour.
    sums: [[Vec<f32>; 3]; 2],
    result: Saliency,
}

impl SaliencyModel {
    /// The saliency of `image`, display-referred RGB in [0, 1]. Values that are no numbers, negative or
    /// infinite count as 0 or as the largest value. An empty picture gives empty maps.
    pub fn compute(&mut self, image: &Map2d<Vec3>) -> &Saliency {
        self.run(image.width(), image.height(), |y, [red, green, blue]| {
            for (((rgb, r), g), b) in image.row(y).iter().zip(red).zip(green).zip(blue) {
                // Not clamp, which keeps NaN.
                [*r, *g, *b] = rgb.to_array().map(|v| if v > 0.0 { v.min(LARGEST) } else { 0.0 });
            }
        })
    }

    /// The same from bytes, three per pixel in rows.
    ///
    /// # Panics
    /// If `rgb` holds fewer than `3 · width · height` bytes: a bug of the caller.
    pub fn compute_rgb8(&mut self, rgb: &[u8], width: usize, height: usize) -> &Saliency {
        assert!(rgb.len() >= 3 * width * height, "three bytes per pixel of {width} × {height}");
        self.run(width, height, |y, [red, green, blue]| {
            let row = &rgb[3 * y * width..3 * (y + 1) * width];
            for (((rgb, r), g), b) in row.chunks_exact(3).zip(red).zip(green).zip(blue) {
                *r = f32::from(rgb[0]) * (1.0 / 255.0);
                *g = f32::from(rgb[1]) * (1.0 / 255.0);
                *b = f32::from(rgb[2]) * (1.0 / 255.0);
            }
        })
    }

    /// The result of the last picture.
    pub fn result(&self) -> &Saliency {
        &self.result
    }

    fn run(&mut self, width: usize, height: usize, rows: impl Fn(usize, [&mut [f32]; 3])) -> &Saliency {
        if width == 0 || height == 0 {
            self.result = Saliency::default();
            return &self.result;
        }
        self.resize(width, height);
        let brightest = self.brightest(&rows);
        self.first_levels(&rows, brightest);
        for level in 2..LEVELS {
            let (w, h) = self.size(level - 1);
            for pyramid in &mut self.pyramids {
                let (below, above) = pyramid.split_at_mut(level);
                self.reduce_rows.reduce(&below[level - 1], w, h, &mut above[0]);
            }
        }
        self.feature_maps(brightest);
        self.combine();
        &self.result
    }

    fn size(&self, level: usize) -> (usize, usize) {
        (level_side(self.width, level as u32), level_side(self.height, level as u32))
    }

    fn resize(&mut self, width: usize, height: usize) {
        if (self.width, self.height) == (width, height) {
            return;
        }
        (self.width, self.height) = (width, height);
        let sizes: [_; LEVELS] = std::array::from_fn(|level| self.size(level));
        let cells = |level: usize| sizes[level].0 * sizes[level].1;
        self.pyramids = std::array::from_fn(|_| {
            (0..LEVELS).map(|level| vec![0.0; if level == 0 { 0 } else { cells(level) }]).collect()
        });
        self.ring = std::array::from_fn(|_| vec![0.0; 5 * width]);
        self.row = std::array::from_fn(|_| vec![0.0; width]);
        self.sums = std::array::from_fn(|_| std::array::from_fn(|i| vec![0.0; cells(i + 2)]));
        self.difference = vec![0.0; cells(2)];
        let (w, h) = sizes[MAP_LEVEL as usize];
        let map = Map2d::new(w, h, 0.0);
        self.result = Saliency { map: map.clone(), intensity: map.clone(), colour: map };
    }

    /// The largest r + g + b of the picture.
    fn brightest(&mut self, rows: &impl Fn(usize, [&mut [f32]; 3])) -> f32 {
        let mut largest = [0.0f32; 16];
        for y in 0..self.height {
            rows(y, self.row.each_mut().map(Vec::as_mut_slice));
            let [r, g, b] = self.row.each_ref().map(|row| row.chunks(16));
            for ((r, g), b) in r.zip(g).zip(b) {
                for (((m, r), g), b) in largest.iter_mut().zip(r).zip(g).zip(b) {
                    let sum = r + g + b;
                    *m = if sum > *m { sum } else { *m };
                }
            }
        }
        largest.into_iter().fold(0.0, f32::max)
    }

    /// Channels and level 1 in one pass over the picture; level 0 exists five rows at a time.
    fn first_levels(&mut self, rows: &impl Fn(usize, [&mut [f32]; 3]), brightest: f32) {
        let (width, height) = (self.width, self.height);
        let (w, h) = self.size(1);
        let mut next = 0;
        for y in 0..h {
            while next <= (2 * y + 2).min(height - 1) {
                rows(next, self.row.each_mut().map(Vec::as_mut_slice));
                let start = (next % 5) * width;
                let targets = self.ring.each_mut().map(|ring| &mut ring[start..start + width]);
                channels(self.row.each_ref().map(Vec::as_slice), targets, HUE_FLOOR * brightest);
                next += 1;
            }
            for (ring, pyramid) in self.ring.iter().zip(&mut self.pyramids) {
                let row = |offset: isize| {
                    let y = (2 * y as isize + offset).clamp(0, height as isize - 1) as usize;
                    &ring[(y % 5) * width..(y % 5 + 1) * width]
                };
                let rows = [row(-2), row(-1), row(0), row(1), row(2)];
                self.reduce_rows.reduce_rows(rows, &mut pyramid[1][y * w..(y + 1) * w]);
            }
        }
    }

    /// The 18 across-scale differences, normalised and summed per centre level (REFERENCE §1.3, §1.4).
    fn feature_maps(&mut self, brightest: f32) {
        self.sums.iter_mut().flatten().for_each(|sum| sum.fill(0.0));
        for (c, s) in PAIRS {
            let (w, h) = self.size(c);
            let (coarse_w, coarse_h) = self.size(s);
            let factor = 1 << (s - c);
            self.coarse_row.resize(coarse_w, 0.0);
            for channel in [INTENSITY, RED_GREEN, BLUE_YELLOW] {
                let pyramid = &self.pyramids[channel];
                let difference = &mut self.difference[..w * h];
                let rows = pyramid[c].chunks_exact(w).zip(difference.chunks_exact_mut(w));
                for (y, (center, out)) in rows.enumerate() {
                    lerp_rows(&pyramid[s], coarse_w, coarse_h, y, factor, &mut self.coarse_row);
                    difference_row(center, &self.coarse_row, factor, out);
                }
                // Intensity scales with exposure, hue does not.
                let flat = if channel == INTENSITY { FLAT * brightest } else { FLAT };
                let gain = self.maxima.gain(difference, w, flat);
                if gain > 0.0 {
                    let sum = &mut self.sums[usize::from(channel != INTENSITY)][c - 2];
                    sum.iter_mut().zip(difference.iter()).for_each(|(sum, d)| *sum += gain * d);
                }
            }
        }
    }

    /// Reduces the sums to level 4 and combines them (REFERENCE §1.5). REDUCE is linear, so maps of one
    /// centre level are summed before they are reduced.
    fn combine(&mut self) {
        let (width, height) = (self.width, self.height);
        let side = |level| (level_side(width, level), level_side(height, level));
        self.result.map.data_mut().fill(0.0);
        for (which, [two, three, four]) in self.sums.iter_mut().enumerate() {
            // Levels 3 and 4 collect what comes from below before they are reduced themselves.
            let mut collect = |fine: &[f32], coarse: &mut [f32], level| {
                let (w, h) = side(level);
                let reduced = &mut self.difference[..coarse.len()];
                self.reduce_rows.reduce(fine, w, h, reduced);
                coarse.iter_mut().zip(reduced.iter()).for_each(|(c, r)| *c += r);
            };
            collect(two, three, 2);
            collect(three, four, 3);
            let target = if which == 0 { &mut self.result.intensity } else { &mut self.result.colour };
            target.data_mut().copy_from_slice(four);
            // Sums of maps with maximum ≤ 1: flat means that all of them were.
            let gain = 0.5 * self.maxima.gain(four, side(MAP_LEVEL).0, FLAT);
            let map = self.result.map.data_mut();
            map.iter_mut().zip(four.iter()).for_each(|(map, v)| *map += gain * v);
        }
    }
}

/// Larger input values count as this one; keeps all sums finite.
const LARGEST: f32 = 1e6;

/// Intensity, R − G and B − Y of a row (REFERENCE §1.1). Where intensity exceeds `floor / 3` the hue is r, g, b
/// divided by it, so r + g + b = 3 there and R = 1.5·[r − 1]+ and so on; Y = [min(r, g) − b]+.
fn channels([r, g, b]: [&[f32]; 3], [intensity, red_green, blue_yellow]: [&mut [f32]; 3], floor: f32) {
    let n = r.len();
    let (g, b) = (&g[..n], &b[..n]);
    let (intensity, red_green, blue_yellow) =
        (&mut intensity[..n], &mut red_green[..n], &mut blue_yellow[..n]);
    for x in 0..n {
        let sum = r[x] + g[x] + b[x];
        intensity[x] = sum * (1.0 / 3.0);
        let scale = if sum > floor { 3.0 / sum } else { 0.0 };
        // Differences to grey are taken before the division, so that grey is exactly hueless.
        let mean = sum * (1.0 / 3.0);
        let above = |v: f32| if v > mean { v - mean } else { 0.0 };
        let darker = if r[x] < g[x] { r[x] } else { g[x] };
        let yellow = if darker > b[x] { darker - b[x] } else { 0.0 };
        red_green[x] = 1.5 * scale * (above(r[x]) - above(g[x]));
        blue_yellow[x] = scale * (1.5 * above(b[x]) - yellow);
    }
}

/// Working memory of the normalisation operator.
#[derive(Clone, Debug, Default)]
struct Maxima {
    found: Vec<u32>,
    /// 1 where a maximum was found and not counted yet.
    open: Vec<u8>,
    stack: Vec<u32>,
}

impl Maxima {
    /// The factor that N(.) multiplies a map of values ≥ 0 with: (1 − m)² / max, where m is the mean of all
    /// local maxima but the largest, relative to the largest (REFERENCE §1.4). 0 for a flat or empty map.
    fn gain(&mut self, map: &[f32], width: usize, flat: f32) -> f32 {
        let largest = maximum(map);
        if largest <= flat {
            return 0.0;
        }
        self.find(map, width, MAXIMA_FLOOR * largest);
        let (mut sum, mut count) = (0.0f64, 0u32);
        for i in 0..self.found.len() {
            let cell = self.found[i];
            if self.open[cell as usize] == 1 {
                self.close_plateau(map, width, cell);
                sum += f64::from(map[cell as usize]);
                count += 1;
            }
        }
        // One instance of the largest is not among the others.
        let others = f64::from(count.saturating_sub(1)).max(1.0);
        let mean = ((sum - f64::from(largest)) / others / f64::from(largest)).clamp(0.0, 1.0);
        ((1.0 - mean) * (1.0 - mean)) as f32 / largest
    }

    /// Finds the cells ≥ all 8 neighbours and > at least one; what lies outside the map is lower.
    fn find(&mut self, map: &[f32], width: usize, floor: f32) {
        let height = map.len() / width;
        self.found.clear();
        self.open.clear();
        self.open.resize(map.len(), 0);
        for y in 0..height {
            let row = &map[y * width..(y + 1) * width];
            for (x, &value) in row.iter().enumerate() {
                if value < floor {
                    continue;
                }
                let border = x == 0 || y == 0 || x + 1 == width || y + 1 == height;
                let (mut highest, mut lowest) = (f32::MIN, if border { f32::MIN } else { f32::MAX });
                for v in neighbours(map, width, height, x, y) {
                    highest = if v > highest { v } else { highest };
                    lowest = if v < lowest { v } else { lowest };
                }
                if value >= highest && value > lowest {
                    let cell = y * width + x;
                    self.found.push(cell as u32);
                    self.open[cell] = 1;
                }
            }
        }
    }

    /// Marks the maxima connected to `cell` with the same value as counted.
    fn close_plateau(&mut self, map: &[f32], width: usize, cell: u32) {
        let height = map.len() / width;
        self.stack.clear();
        self.stack.push(cell);
        self.open[cell as usize] = 0;
        while let Some(cell) = self.stack.pop() {
            let (x, y) = (cell as usize % width, cell as usize / width);
            for ny in y.saturating_sub(1)..(y + 2).min(height) {
                for nx in x.saturating_sub(1)..(x + 2).min(width) {
                    let other = ny * width + nx;
                    if self.open[other] == 1 && map[other] == map[cell as usize] {
                        self.open[other] = 0;
                        self.stack.push(other as u32);
                    }
                }
            }
        }
    }
}

/// Largest value of a map without NaN; several lanes, so that it is not one chain of comparisons.
fn maximum(map: &[f32]) -> f32 {
    let mut lanes = [0.0f32; 16];
    for chunk in map.chunks(16) {
        lanes.iter_mut().zip(chunk).for_each(|(m, &v)| *m = if v > *m { v } else { *m });
    }
    lanes.into_iter().fold(0.0, f32::max)
}

/// The values around (x, y) that lie inside the map; the value itself stands for those outside.
#[inline(always)]
fn neighbours(map: &[f32], width: usize, height: usize, x: usize, y: usize) -> [f32; 8] {
    let (left, right) = (x.saturating_sub(1), (x + 1).min(width - 1));
    let above = y.saturating_sub(1) * width;
    let here = y * width;
    let below = (y + 1).min(height - 1) * width;
    [
        map[above + left],
        map[above + x],
        map[above + right],
        map[here + left],
        map[here + right],
        map[below + left],
        map[below + x],
        map[below + right],
    ]
}

#[cfg(test)]
#[path = "saliency_tests.rs"]
mod tests;
