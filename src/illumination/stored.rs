//! Irradiance as it is read: one fetch from vertices or a bilinear lookup in the lightmap.

mod plain;

use std::sync::Arc;

use glam::{Vec2, Vec3, Vec4};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::atlas::{Atlas, Corners, NEIGHBOURS};
use super::{Irradiance, Unnamed};

/// Elements that share one decision whether their back is stored.
const BLOCK: usize = 64;
/// A block whose back is dark.
const DARK: u32 = u32::MAX;

/// What a bake came to.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Paths sampled, from surfaces and from lights.
    pub particles: u64,
    /// Rounds in which they were.
    pub rounds: u32,
    /// Upper limit of the error of the luminance of irradiance where it is seen, relative to its mean there, by points that
    /// the map is not made of (95 % certain): whatever the reason for the error.
    pub relative_error: f32,
    /// The part of it that is noise of straight light, root of the area-weighted mean square.
    pub direct_error: f32,
    /// The part that is noise of all other light.
    pub particle_error: f32,
    /// What neither of them explains: smoothing, resolution, and doubt.
    pub bias_error: f32,
    /// Power that arrives on both sides per area of surface and band, W/m².
    pub mean: [f32; 3],
    /// Whether light arrives anywhere after a diffuse reflection.
    pub has_indirect: bool,
    /// What did not go as asked, for the user.
    pub notes: Vec<String>,
}

/// A part of the irradiance per element.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Part {
    front: Vec<[f32; 3]>,
    /// Empty where all backs are dark.
    back: Vec<[f32; 3]>,
}

impl Part {
    /// Of values per element of `atlas`, front and back.
    fn new(atlas: &Atlas, sides: [Vec<Value>; 2]) -> Self {
        assert!(sides.iter().all(|side| side.len() == atlas.elements.len()), "values per element");
        let [front, back] = sides.map(|mut side| {
            fill_unknown(atlas, &mut side);
            let stored = |v: &Value| {
                let v = v.unwrap_or_default().truncate();
                if v.is_finite() { v.max(Vec3::ZERO).to_array() } else { [0.0; 3] }
            };
            side.par_iter().map(stored).collect::<Vec<_>>()
        });
        let back = if back.iter().flatten().any(|v| *v > 0.0) { back } else { Vec::new() };
        Self { front, back }
    }

    #[inline]
    fn value(&self, element: usize, back: bool) -> Vec3 {
        let side = if back { &self.back } else { &self.front };
        side.get(element).map_or(Vec3::ZERO, |v| Vec3::from_array(*v))
    }

    /// Whether it is one of so many elements, with values that are finite and not negative.
    fn is_sound(&self, elements: usize) -> bool {
        let Self { front, back } = self;
        front.len() == elements
            && (back.is_empty() || back.len() == elements)
            && [front, back].into_iter().all(|side| are_sound(side.as_flattened()))
    }

    fn bytes(&self) -> usize {
        (self.front.len() + self.back.len()) * size_of::<[f32; 3]>()
    }
}

/// Whether all values are finite and not negative. Many at a time, without a branch for each.
fn are_sound(values: &[f32]) -> bool {
    let is_sound = |v: &f32| *v >= 0.0 && *v < f32::INFINITY;
    values.chunks(1024).all(|some| some.iter().fold(true, |all, v| all & is_sound(v)))
}

/// Irradiance on all surfaces, front and back, with its standard error.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Illumination {
    width: u32,
    height: u32,
    /// Shared by all maps of an atlas.
    corners: Arc<Vec<Corners>>,
    /// Per element red, green, blue, and the standard error of the luminance.
    front: Vec<[f32; 4]>,
    /// Per block of elements, the block of `back` that holds its back, or `DARK`.
    back_blocks: Vec<u32>,
    back: Vec<[f32; 4]>,
    /// What comes straight from named lights, where that is kept apart: not in `front` and `back`, then.
    named: Option<Part>,
    /// What of the values no path from a surface finds; `None` where there is nothing.
    unfound: Option<Part>,
    /// What the bake came to.
    pub summary: Summary,
}

/// The elements around a point, and how much each counts.
enum Around {
    /// The corners of its triangle, and their weights.
    Vertices([usize; 3], [f32; 3]),
    /// Four texels, and how far the point lies from the first of them towards the last.
    Texels([usize; 4], Vec2),
}

impl Around {
    /// The mean of their values.
    #[inline]
    fn mean(&self, value: &impl Fn(usize) -> Vec4) -> Vec4 {
        match *self {
            Self::Vertices(elements, weights) => {
                let [a, b, c] = elements.map(value);
                a * weights[0] + b * weights[1] + c * weights[2]
            }
            Self::Texels(elements, f) => {
                let [a, b, c, d] = elements.map(value);
                a.lerp(b, f.x).lerp(c.lerp(d, f.x), f.y)
            }
        }
    }
}

/// Values of one side of an element: irradiance and the standard error of its luminance, or `None` where
/// nothing is known, so that neighbours speak for it.
pub type Value = Option<Vec4>;

impl Illumination {
    /// Stores values per element of `atlas`, front and back. Texels without a value take the mean of
    /// their neighbours, so that no lookup reads outside of its chart.
    pub fn new(atlas: &Atlas, mut front: Vec<Value>, mut back: Vec<Value>, summary: Summary) -> Self {
        assert!(front.len() == atlas.elements.len() && back.len() == front.len(), "values per element");
        rayon::join(|| fill_unknown(atlas, &mut front), || fill_unknown(atlas, &mut back));
        let stored = |v: &Value| {
            let v = v.unwrap_or_default();
            if v.is_finite() { v.max(Vec4::ZERO).to_array() } else { [0.0; 4] }
        };
        let is_lit = |v: &Value| v.is_some_and(|v| v.truncate().max_element() > 0.0);
        let lit: Vec<bool> = back.par_chunks(BLOCK).map(|block| block.iter().any(is_lit)).collect();
        let mut blocks = 0;
        let place = |lit: &bool| {
            if *lit {
                blocks += 1;
                blocks - 1
            } else {
                DARK
            }
        };
        let back_blocks = lit.iter().map(place).collect();
        let lit_blocks = back.par_chunks(BLOCK).zip(&lit).filter(|(_, lit)| **lit);
        let lit_back = lit_blocks.flat_map_iter(|(block, _)| {
            let values = block.iter().map(stored);
            values.chain(std::iter::repeat_n([0.0; 4], BLOCK - block.len()))
        });
        Self {
            width: atlas.width,
            height: atlas.height,
            corners: Arc::clone(&atlas.corners),
            front: front.par_iter().map(stored).collect(),
            back_blocks,
            back: lit_back.collect(),
            named: None,
            unfound: None,
            summary,
        }
    }

    /// With what comes straight from named lights, front and back, which the values do not hold.
    pub fn with_named(self, atlas: &Atlas, sides: [Vec<Value>; 2]) -> Self {
        Self { named: Some(Part::new(atlas, sides)), ..self }
    }

    /// With what of the values no path from a surface finds ([`crate::transport::caustic::Class::Unfound`]), front and back.
    pub fn with_unfound(self, atlas: &Atlas, sides: [Vec<Value>; 2]) -> Self {
        let lit = |v: &Value| v.is_some_and(|v| v.truncate().max_element() > 0.0);
        let any = sides.iter().flatten().any(lit);
        Self { unfound: any.then(|| Part::new(atlas, sides)), ..self }
    }

    /// Columns and rows of the lightmap.
    pub fn lightmap_size(&self) -> [u32; 2] {
        [self.width, self.height]
    }

    /// Texels and vertices.
    pub fn element_count(&self) -> usize {
        self.front.len()
    }

    /// Triangles.
    pub fn triangle_count(&self) -> usize {
        self.corners.len()
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> usize {
        self.corners.len() * size_of::<Corners>()
            + (self.front.len() + self.back.len()) * size_of::<[f32; 4]>()
            + self.back_blocks.len() * 4
            + [&self.named, &self.unfound].into_iter().flatten().map(Part::bytes).sum::<usize>()
    }

    /// Irradiance and the standard error of its luminance.
    pub fn lookup(&self, triangle: u32, b1: f32, b2: f32, back: bool) -> Vec4 {
        match &self.named {
            None => self.interpolated(triangle, b1, b2, &|e| self.value(e, back)),
            Some(_) => self.interpolated(triangle, b1, b2, &|e| self.total(e, back)),
        }
    }

    /// The same without what comes straight from named lights, as far as that is kept apart.
    pub fn lookup_unnamed(&self, triangle: u32, b1: f32, b2: f32, back: bool) -> Vec4 {
        self.interpolated(triangle, b1, b2, &|e| self.value(e, back))
    }

    /// What comes straight from named lights, where that is kept apart.
    pub fn lookup_named(&self, triangle: u32, b1: f32, b2: f32, back: bool) -> Vec3 {
        self.interpolated(triangle, b1, b2, &|e| self.named_value(e, back)).truncate()
    }

    /// Whether what comes straight from named lights is kept apart.
    pub fn has_named(&self) -> bool {
        self.named.is_some()
    }

    #[inline]
    fn interpolated(&self, triangle: u32, b1: f32, b2: f32, value: &impl Fn(usize) -> Vec4) -> Vec4 {
        self.around(triangle, b1, b2).map_or(Vec4::ZERO, |around| around.mean(value))
    }

    /// The elements around a point.
    #[inline]
    fn around(&self, triangle: u32, b1: f32, b2: f32) -> Option<Around> {
        let b0 = 1.0 - b1 - b2;
        Some(match self.corners.get(triangle as usize)? {
            Corners::Vertices(v) => {
                Around::Vertices(v.map(|v| v as usize), [b0.max(0.0), b1.max(0.0), b2.max(0.0)])
            }
            Corners::Texels(uv) => {
                let p = uv[0] * b0 + uv[1] * b1 + uv[2] * b2;
                let last = Vec2::new(self.width as f32 - 1.0, self.height as f32 - 1.0);
                let p = (p - 0.5).max(Vec2::ZERO).min(last);
                let (x, y) = (p.x as usize, p.y as usize);
                let (right, below) =
                    ((x + 1).min(self.width as usize - 1), (y + 1).min(self.height as usize - 1));
                let at = |x: usize, y: usize| y * self.width as usize + x;
                let texels = [at(x, y), at(right, y), at(x, below), at(right, below)];
                Around::Texels(texels, p - Vec2::new(x as f32, y as f32))
            }
        })
    }

    #[inline]
    fn value(&self, element: usize, back: bool) -> Vec4 {
        if !back {
            return Vec4::from_array(self.front[element]);
        }
        match self.back_blocks[element / BLOCK] {
            DARK => Vec4::ZERO,
            block => Vec4::from_array(self.back[block as usize * BLOCK + element % BLOCK]),
        }
    }

    #[inline]
    fn named_value(&self, element: usize, back: bool) -> Vec4 {
        self.named.as_ref().map_or(Vec4::ZERO, |named| named.value(element, back).extend(0.0))
    }

    /// What is stored of a side of an element: irradiance without what named lights bring straight, where that is kept apart, and
    /// the standard error of its luminance.
    pub fn unnamed_of(&self, element: usize, back: bool) -> Vec4 {
        self.value(element, back)
    }

    /// What comes straight from named lights to a side of an element, where that is kept apart.
    pub fn named_of(&self, element: usize, back: bool) -> Vec3 {
        self.named_value(element, back).truncate()
    }

    /// All irradiance on a side of an element, and the standard error of its luminance.
    #[inline]
    pub fn total(&self, element: usize, back: bool) -> Vec4 {
        self.value(element, back) + self.named_value(element, back)
    }

    /// Where each triangle's illumination is found.
    pub fn corners(&self) -> &[Corners] {
        &self.corners
    }

    /// Whether all indices are inside and all values finite and not negative: what a file must
    /// prove before it is read from.
    pub fn is_sound(&self) -> bool {
        let texels = u64::from(self.width) * u64::from(self.height);
        let elements = self.front.len() as u64;
        let texel_corners_allowed = self.width > 0 && self.height > 0;
        texels <= elements
            && self.back_blocks.len() == self.front.len().div_ceil(BLOCK)
            && self.back_blocks.iter().all(|&b| b == DARK || (b as usize + 1) * BLOCK <= self.back.len())
            && [&self.front, &self.back].into_iter().all(|side| are_sound(side.as_flattened()))
            && [&self.named, &self.unfound].into_iter().flatten().all(|part| part.is_sound(self.front.len()))
            && self.corners.iter().all(|c| match c {
                Corners::Vertices(v) => v.iter().all(|&e| u64::from(e) < elements),
                Corners::Texels(uv) => texel_corners_allowed && uv.iter().all(|p| p.is_finite()),
            })
    }

    /// What `from` shows, stored at the elements of `atlas`: the start of a refinement.
    pub fn resampled(atlas: &Atlas, from: &dyn Irradiance) -> Self {
        type At<'a> = &'a (dyn Fn(u32, f32, f32, bool) -> Vec3 + Sync);
        let sides = |at: At<'_>| {
            [false, true].map(|back| {
                let value = |e: &super::atlas::Element| {
                    (e.area > 0.0).then(|| at(e.triangle, e.b1, e.b2, back).extend(0.0))
                };
                atlas.elements.par_iter().map(value).collect::<Vec<Value>>()
            })
        };
        let stored = from.stored();
        let summary = stored.map(|s| s.summary.clone()).unwrap_or_default();
        match stored.filter(|s| s.has_named()) {
            None => {
                let [front, back] = sides(&|t, b1, b2, back| from.irradiance(t, b1, b2, back));
                Self::new(atlas, front, back, summary)
            }
            Some(s) => {
                let [front, back] = sides(&|t, b1, b2, back| s.lookup_unnamed(t, b1, b2, back).truncate());
                let named = sides(&|t, b1, b2, back| s.lookup_named(t, b1, b2, back));
                Self::new(atlas, front, back, summary).with_named(atlas, named)
            }
        }
    }

    /// A hash of all values and of where they are found.
    pub fn digest(&self) -> u64 {
        let mut h = blake3::Hasher::new();
        h.update(&self.width.to_le_bytes());
        h.update(&(self.corners.len() as u64).to_le_bytes());
        for values in [&self.front, &self.back] {
            h.update(bytemuck::cast_slice(values));
        }
        h.update(bytemuck::cast_slice(&self.back_blocks));
        for Part { front, back } in [&self.named, &self.unfound].into_iter().flatten() {
            h.update(bytemuck::cast_slice(front));
            h.update(bytemuck::cast_slice(back));
        }
        h.update(&self.summary.particles.to_le_bytes());
        h.update(bytemuck::bytes_of(&self.summary.mean));
        let bytes = h.finalize();
        bytes.as_bytes()[..8].iter().fold(0, |sum, &b| sum << 8 | u64::from(b))
    }

    /// Whether both have the same elements.
    fn fits(&self, other: &Self) -> bool {
        let same = Arc::ptr_eq(&self.corners, &other.corners) || self.corners == other.corners;
        same && self.front.len() == other.front.len()
    }

    /// Whether each value of `target` is this one's but for `relative` of it plus `absolute` W/m² in each band. `None` if
    /// they are stored differently.
    pub fn is_near(&self, target: &Self, relative: f32, absolute: f32) -> Option<bool> {
        let fits = self.fits(target);
        let near = |from: Vec4, to: Vec4| {
            let most = from * relative + absolute;
            (to - from).abs().cmple(most).bitmask() & 0b111 == 0b111
        };
        let is_near =
            |e: usize| [false, true].into_iter().all(|back| near(self.value(e, back), target.value(e, back)));
        fits.then(|| (0..target.front.len()).into_par_iter().all(is_near))
    }

    /// Moved towards `target` by a `share` of what is missing, from 0 to 1. `None` if they are stored differently.
    pub fn approached(&self, target: &Self, share: f32) -> Option<Self> {
        if !self.fits(target) {
            return None;
        }
        let step = |from: Vec4, to: Vec4| from.lerp(to, share).truncate().extend(to.w).to_array();
        let front = (0..target.front.len())
            .into_par_iter()
            .map(|e| step(self.value(e, false), target.value(e, false)))
            .collect();
        let (mut back, mut back_blocks) = (Vec::new(), target.back_blocks.clone());
        for (i, block) in back_blocks.iter_mut().enumerate() {
            if *block == DARK && self.back_blocks[i] == DARK {
                continue;
            }
            *block = (back.len() / BLOCK) as u32;
            for e in i * BLOCK..((i + 1) * BLOCK).min(target.front.len()) {
                back.push(step(self.value(e, true), target.value(e, true)));
            }
            back.resize(back.len().next_multiple_of(BLOCK), [0.0; 4]);
        }
        Some(Self {
            width: target.width,
            height: target.height,
            corners: Arc::clone(&target.corners),
            front,
            back_blocks,
            back,
            // Exact from the first map of these elements on.
            named: target.named.clone(),
            unfound: target.unfound.clone(),
            summary: target.summary.clone(),
        })
    }
}

impl Irradiance for Illumination {
    fn irradiance(&self, triangle: u32, b1: f32, b2: f32, back: bool) -> Vec3 {
        self.lookup(triangle, b1, b2, back).truncate()
    }

    fn unnamed(&self, triangle: u32, b1: f32, b2: f32, back: bool) -> Unnamed {
        let Some(around) = self.around(triangle, b1, b2) else {
            return Unnamed { rest: Vec3::ZERO, named: None };
        };
        let rest = around.mean(&|e| self.value(e, back)).truncate();
        let named = self.named.is_some().then(|| around.mean(&|e| self.named_value(e, back)).truncate());
        Unnamed { rest, named: named.filter(|&named| named != Vec3::ZERO) }
    }

    fn unfound(&self, triangle: u32, b1: f32, b2: f32, back: bool) -> Vec3 {
        let Some(unfound) = &self.unfound else { return Vec3::ZERO };
        self.interpolated(triangle, b1, b2, &|e| unfound.value(e, back).extend(0.0)).truncate()
    }

    fn stored(&self) -> Option<&Illumination> {
        Some(self)
    }
}

/// Texels of a chart that know nothing take the mean of their neighbours, again and again; then those
/// around charts, once: charts are two texels apart, so that none takes from another.
fn fill_unknown(atlas: &Atlas, values: &mut [Value]) {
    let surface = |e: usize| atlas.elements[e].area > 0.0;
    let found = |values: &[Value], e: usize| mean_around(atlas, values, e).map(|value| (e, value));
    let texels = atlas.texel_count();
    let unknown = |&e: &usize| values[e].is_none() && surface(e);
    let mut next: Vec<(usize, Vec4)> =
        (0..texels).into_par_iter().filter(unknown).filter_map(|e| found(values, e)).collect();
    while !next.is_empty() {
        for &(e, value) in &next {
            values[e] = Some(value);
        }
        // Only beside those just filled is anything new known.
        let is_open = |&n: &usize| values[n].is_none() && surface(n);
        let mut open: Vec<usize> =
            next.iter().flat_map(|&(e, _)| beside(atlas, e, &NEIGHBOURS)).filter(is_open).collect();
        open.sort_unstable();
        open.dedup();
        next = open.into_iter().filter_map(|e| found(values, e)).collect();
    }
    let border: Vec<(usize, Value)> = (0..texels)
        .into_par_iter()
        .filter(|&e| !surface(e))
        .map(|e| (e, mean_around(atlas, values, e)))
        .collect();
    for (e, value) in border {
        values[e] = value;
    }
}

/// Neighbours of a texel on the page.
fn beside<'a>(atlas: &'a Atlas, e: usize, ring: &'a [(i32, i32)]) -> impl Iterator<Item = usize> + use<'a> {
    let (width, height) = (atlas.width as usize, atlas.height as usize);
    let (x, y) = (e % width, e / width);
    ring.iter().filter_map(move |&(dx, dy)| {
        let (x, y) = (x.checked_add_signed(dx as isize)?, y.checked_add_signed(dy as isize)?);
        (x < width && y < height).then_some(y * width + x)
    })
}

/// Mean of the nearest neighbours that are known: those beside, else those across a corner.
fn mean_around(atlas: &Atlas, values: &[Value], e: usize) -> Value {
    for ring in [&NEIGHBOURS[..4], &NEIGHBOURS[4..]] {
        let (mut sum, mut count) = (Vec4::ZERO, 0.0);
        for n in beside(atlas, e, ring).filter(|&n| atlas.elements[n].area > 0.0) {
            if let Some(v) = values[n] {
                sum += v;
                count += 1.0;
            }
        }
        if count > 0.0 {
            return Some(sum / count);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illumination::atlas::ConformalCharts;
    use crate::illumination::test_scenes::{grid, join, quad};

    fn atlas() -> (crate::scene::Mesh, Atlas) {
        let mut mesh = quad(Vec3::ZERO, Vec3::X * 2.0, Vec3::Y);
        join(&mut mesh, &quad(Vec3::Z, Vec3::X, Vec3::Y * 0.4), 0);
        join(&mut mesh, &grid(40, 40, |x, y| Vec3::new(x * 0.1, y * 0.1, 3.0)), 0);
        let atlas = Atlas::build(&mesh, 1000, &|_| true, &|_| true, &ConformalCharts);
        (mesh, atlas)
    }

    #[test]
    fn lookups_follow_a_linear_field_and_never_leave_their_chart() {
        let (mesh, atlas) = atlas();
        let f = |p: Vec3| 1.0 + p.x + 2.0 * p.y + 10.0 * p.z;
        let values: Vec<Value> = atlas
            .elements
            .iter()
            .map(|e| (e.area > 0.0).then(|| Vec4::new(f(e.position), 1.0, 2.0, 0.1)))
            .collect();
        let dark = vec![None; values.len()];
        let map = Illumination::new(&atlas, values, dark, Summary::default());
        assert!(map.is_sound());
        assert_eq!(map.back.len(), 0);
        let texel = 1.0 / atlas.texels_per_unit;
        let mut stream = crate::rng::Stream::new(5, 5, 5);
        for _ in 0..20_000 {
            let t = (stream.next_u64() % mesh.triangles.len() as u64) as u32;
            let [u, v] = stream.next_2d();
            let s = u.sqrt();
            let (b1, b2) = (s * (1.0 - v), s * v);
            let [a, b, c] = mesh.corners(t);
            let p = a * (1.0 - b1 - b2) + b * b1 + c * b2;
            let found = map.irradiance(t, b1, b2, false);
            // The border is constant in the last texel; another chart would be off by 10.
            assert!((found.x - f(p)).abs() < 2.5 * texel, "{p}: {} {}", found.x, f(p));
            assert!((found.y - 1.0).abs() < 1e-5 && (found.z - 2.0).abs() < 1e-5);
            assert_eq!(map.irradiance(t, b1, b2, true), Vec3::ZERO);
        }
    }

    #[test]
    fn only_lit_backs_are_stored_and_unknown_texels_are_filled() {
        let (_, atlas) = atlas();
        let front: Vec<Value> = atlas
            .elements
            .iter()
            .enumerate()
            .map(|(i, e)| (e.area > 0.0 && i % 5 != 0).then_some(Vec4::splat(3.0)))
            .collect();
        let texels = atlas.texel_count();
        let back: Vec<Value> = (0..front.len()).map(|i| (i >= texels).then_some(Vec4::ONE * 0.5)).collect();
        let map = Illumination::new(&atlas, front, back, Summary::default());
        assert!(map.back.len() < map.element_count());
        assert!((map.irradiance(0, 0.3, 0.3, false) - Vec3::splat(3.0)).length() < 1e-5);
        let dense = map.triangle_count() as u32 - 1;
        assert!((map.irradiance(dense, 0.3, 0.3, true) - Vec3::splat(0.5)).length() < 1e-5);
    }

    #[test]
    fn an_approach_goes_a_share_of_the_way() {
        let (_, atlas) = atlas();
        let n = atlas.elements.len();
        let constant = |v: f32, back: Option<Vec4>| {
            Illumination::new(&atlas, vec![Some(Vec4::splat(v)); n], vec![back; n], Summary::default())
        };
        let (mut shown, target) = (constant(1.0, None), constant(3.0, Some(Vec4::ONE)));
        assert_eq!(shown.is_near(&target, 0.1, 0.05), Some(false));
        // What lies in the dark of one and not of the other is not near.
        assert_eq!(constant(3.0, None).is_near(&target, 0.1, 0.05), Some(false));
        assert_eq!(constant(2.8, Some(Vec4::splat(0.95))).is_near(&target, 0.1, 0.05), Some(true));
        // A half of the way, and half of the rest of it.
        for (front, back) in [(2.0, 0.5), (2.5, 0.75)] {
            shown = shown.approached(&target, 0.5).unwrap();
            assert!(shown.is_sound() && shown != target && shown.digest() != target.digest());
            assert_eq!(shown.irradiance(0, 0.2, 0.2, false), Vec3::splat(front));
            assert_eq!(shown.irradiance(0, 0.2, 0.2, true), Vec3::splat(back));
        }
        let other = Illumination::default();
        assert!(shown.approached(&other, 0.1).is_none() && shown.is_near(&other, 0.1, 0.1).is_none());
    }

    #[test]
    fn impossible_indices_and_values_are_not_sound() {
        let (_, atlas) = atlas();
        let n = atlas.elements.len();
        let map =
            Illumination::new(&atlas, vec![Some(Vec4::ONE); n], vec![Some(Vec4::ONE); n], Summary::default());
        assert!(map.is_sound());
        let broken: [fn(&mut Illumination); 6] = [
            |m| Arc::make_mut(&mut m.corners)[0] = Corners::Vertices([0, 1, m.front.len() as u32]),
            |m| Arc::make_mut(&mut m.corners)[0] = Corners::Texels([Vec2::NAN; 3]),
            |m| m.front[3][1] = f32::NAN,
            |m| m.back[3][2] = -1.0,
            |m| m.back_blocks[0] = (m.back.len() / BLOCK) as u32,
            |m| m.width = 1 << 20,
        ];
        for (i, breaks) in broken.iter().enumerate() {
            let mut other = map.clone();
            breaks(&mut other);
            assert!(!other.is_sound(), "{i}");
        }
    }
}
