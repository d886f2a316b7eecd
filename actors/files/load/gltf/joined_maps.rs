//! Maps that lie on each other, joined texel by texel: those of base colour, of roughness and metalness, and of what lets
//! light through, become one of the diffuse part and one of f₀, so that a surface reads two pictures wherever it is met.

use std::sync::Arc;

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::texels::{encoded, mean_of};
use foveal::image::SrgbSteps;
use foveal::scene::metal_rough::Layer;
use foveal::scene::texture::Pixels;
use foveal::scene::texture::{Between, MipChain, mean};
use foveal::scene::{Placement, Texture, TextureId};

/// How texels become those of a surface.
pub(super) struct Rule {
    pub base: Vec3,
    pub metallic: f32,
    pub roughness: f32,
    pub through: f32,
    pub f0: Vec3,
    pub layer: Layer,
}

impl Rule {
    /// (1 − m) (1 − t) b (1 − Ē), f₀, and t (1 − m) b.
    #[inline]
    pub fn at(&self, base: Vec3, m: f32, r: f32, t: f32) -> [Vec3; 3] {
        let below = base * (1.0 - m);
        [below * ((1.0 - t) * (1.0 - self.layer.mean(r))), self.f0 * (1.0 - m) + base * m, below * t]
    }
}

/// What makes two joined maps the same.
pub(super) type Key = ([Option<u32>; 3], bool, [u32; 10]);

/// Maps that were made of others, and what is known of them.
#[derive(Clone)]
pub(super) struct Joined {
    pub diffuse: TextureId,
    pub specular: TextureId,
    pub through: Option<TextureId>,
    pub metal: [f32; 2],
    pub range: [f32; 2],
    pub mean: f32,
}

/// A map as one of so many columns and rows.
enum Rows<'t> {
    /// Of ones.
    One,
    /// It has as many.
    Same(&'t Texture),
    /// Where columns and rows lie between those that it has.
    Between { map: &'t Texture, columns: Vec<Between>, rows: Vec<Between> },
}

impl<'t> Rows<'t> {
    fn of(map: Option<TextureId>, [w, h]: [usize; 2], textures: &'t [Texture]) -> Self {
        let Some(map) = map.map(|map| &textures[map.0 as usize]) else { return Self::One };
        let [own_w, own_h] = map.size(0);
        if [own_w, own_h] == [w, h] {
            return Self::Same(map);
        }
        // Coordinates are those of all maps, so texels are read where they lie, without scale and offset.
        let [across, down] = map.placement.wrap;
        let flat = Placement { wrap: [across, down], ..Placement::default() };
        let middle = |i: usize, n: usize| (i as f32 + 0.5) / n as f32;
        let column = |x| Between::at(flat.place(Vec2::new(middle(x, w), 0.5)).x, own_w as i32, across);
        let row = |y| Between::at(flat.place(Vec2::new(0.5, 1.0 - middle(y, h))).y, own_h as i32, down);
        Self::Between { map, columns: (0..w).map(column).collect(), rows: (0..h).map(row).collect() }
    }

    /// Reads a row; of ones it is as it has to be before.
    fn read(&self, y: usize, out: &mut [[f32; 4]], aside: &mut [Vec<[f32; 4]>; 2]) {
        match self {
            Self::One => {}
            Self::Same(map) => map.row(y, out),
            Self::Between { map, columns, rows } => {
                let row = rows[y];
                for (which, aside) in [row.low, row.high].into_iter().zip(aside.iter_mut()) {
                    aside.resize(map.size(0)[0], [0.0; 4]);
                    map.row(which, aside);
                }
                let [above, below] = &*aside;
                for (texel, c) in out.iter_mut().zip(columns) {
                    let four = [above[c.low], above[c.high], below[c.low], below[c.high]];
                    *texel = mean(four, c.share, row.share);
                }
            }
        }
    }
}

/// Least and greatest.
type Range = [u8; 2];

fn widened([low, high]: Range, [least, most]: Range) -> Range {
    [low.min(least), high.max(most)]
}

/// Fewer rows are not worth another thread.
const ROWS_AT_ONCE: usize = 8;

/// Makes the maps of a surface from those of base colour, of roughness (green) and metalness (blue), and of transmission
/// (red). Where the base colour's alpha says what is there, the diffuse map is multiplied by it and has it.
pub(super) fn join(
    rule: &Rule,
    maps: [Option<TextureId>; 3],
    coverage_in_alpha: bool,
    textures: &mut Vec<Texture>,
) -> Joined {
    let of = |id: Option<TextureId>| id.map(|id| &textures[id.0 as usize]);
    let size = |t: Option<&Texture>| t.map_or([1, 1], |t| t.size(0));
    let [w, h] = maps.map(|m| size(of(m))).into_iter().fold([1, 1], |[w, h], [a, b]| [w.max(a), h.max(b)]);
    let read = maps.map(|m| Rows::of(m, [w, h], textures));
    let steps = SrgbSteps::shared();
    let passes = rule.through > 0.0;
    // Memory that nobody touches where nothing passes.
    let [mut diffuse, mut specular, mut through] = [(); 3].map(|()| vec![[0u8; 4]; w * h]);
    let rows = diffuse.par_chunks_mut(w).zip(specular.par_chunks_mut(w)).zip(through.par_chunks_mut(w));
    let ranges: Vec<[Range; 2]> = rows
        .enumerate()
        .with_min_len(ROWS_AT_ONCE)
        .map_init(
            || ([(); 3].map(|()| vec![[1.0f32; 4]; w]), [Vec::new(), Vec::new()]),
            |(rows, aside), (y, ((diffuse, specular), through))| {
                read.iter().zip(rows.iter_mut()).for_each(|(map, row)| map.read(y, row, aside));
                let [base, rough, clear] = &*rows;
                let mut ranges = [[255, 0]; 2];
                let texels = base.iter().zip(rough).zip(clear).zip(diffuse).zip(specular).zip(through);
                for (((((base, rough), clear), diffuse), specular), through) in texels {
                    let &[red, green, blue, alpha] = base;
                    let color = Vec3::new(red, green, blue) * rule.base;
                    let there = if coverage_in_alpha { alpha } else { 1.0 };
                    let &[_, green, blue, _] = rough;
                    let m = (rule.metallic * blue).clamp(0.0, 1.0);
                    let r = (rule.roughness * green).clamp(0.0, 1.0);
                    let t = (rule.through * clear[0]).clamp(0.0, 1.0);
                    let [below, f0, passed] = rule.at(color, m, r, t);
                    // What is there, or else how much of it is metal.
                    *diffuse = encoded(below * there, if coverage_in_alpha { there } else { m }, steps);
                    *specular = encoded(f0, r, steps);
                    if passes {
                        *through = encoded(passed, 1.0, steps);
                    }
                    let metal = (m * 255.0 + 0.5) as u8;
                    ranges = [widened(ranges[0], [metal; 2]), widened(ranges[1], [specular[3]; 2])];
                }
                ranges
            },
        )
        .collect();
    let [metal, range] = ranges
        .into_iter()
        .fold([[255, 0]; 2], |all, row| [widened(all[0], row[0]), widened(all[1], row[1])])
        .map(|range| range.map(|v| f32::from(v) / 255.0));
    let like = maps.iter().find_map(|m| of(*m));
    let (name, placement) =
        like.map_or((String::new(), Placement::default()), |t| (t.name.clone(), t.placement));
    let mut add = |what: &str, texels, has_alpha| {
        let mips = Arc::new(MipChain::alone(w, h, Pixels::Byte { texels, gamma: true }));
        let texture =
            Texture { name: format!("{name} ({what})"), mips, has_alpha, is_color: true, placement };
        textures.push(texture);
        TextureId(textures.len() as u32 - 1)
    };
    let diffuse = add("diffuse", diffuse, coverage_in_alpha);
    let specular = add("specular", specular, true);
    let through = passes.then(|| add("through", through, false));
    let mean = mean_of(specular, textures)[3];
    Joined { diffuse, specular, through, metal, range, mean }
}
