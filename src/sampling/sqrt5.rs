//! The √5 sampling hierarchy in exact integers (Haber 2001 §4.3; REFERENCE §3).
//!
//! The positions of level set `k` are the Gaussian integers divisible by gₖ = (2 − i)ᵏ, so a level
//! is a set of pixels, each level holds five times as many as the one above, and no rounding
//! exists. Levels are counted as the paper does: 1 is the coarsest (k = K), K + 1 the finest (k = 0).

/// A half-open rectangle of pixels, [`x0`, `x1`) × [`y0`, `y1`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default, serde::Serialize, serde::Deserialize)]
pub struct Rect {
    /// First column.
    pub x0: i32,
    /// First row.
    pub y0: i32,
    /// Column after the last.
    pub x1: i32,
    /// Row after the last.
    pub y1: i32,
}

impl Rect {
    /// The whole of a picture.
    pub fn of_size(width: u32, height: u32) -> Self {
        Self { x0: 0, y0: 0, x1: width as i32, y1: height as i32 }
    }

    /// Whether it holds no pixel.
    pub fn is_empty(&self) -> bool {
        self.x0 >= self.x1 || self.y0 >= self.y1
    }

    /// Number of pixels.
    pub fn area(&self) -> u64 {
        if self.is_empty() { 0 } else { (self.x1 - self.x0) as u64 * (self.y1 - self.y0) as u64 }
    }

    /// Whether the pixel lies inside.
    pub fn contains(&self, x: i32, y: i32) -> bool {
        self.x0 <= x && x < self.x1 && self.y0 <= y && y < self.y1
    }

    /// The pixels in both.
    pub fn intersection(&self, other: Rect) -> Rect {
        Rect {
            x0: self.x0.max(other.x0),
            y0: self.y0.max(other.y0),
            x1: self.x1.min(other.x1),
            y1: self.y1.min(other.y1),
        }
    }
}

/// A place in the enumeration of a level inside a rectangle: every sample before it, in row order,
/// has been visited.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
pub struct Cursor {
    /// Column from which on row `y` is still to be visited.
    pub x: i32,
    /// Row.
    pub y: i32,
}

/// tₖ with tₖ² = −1 (mod 5ᵏ): (x, y) lies in level set k where x + tₖ y ≡ 0 (mod 5ᵏ) (REFERENCE §3.3).
const T: [i64; 11] = [0, 2, 7, 57, 182, 2057, 14557, 45807, 280_182, 280_182, 6_139_557];

/// A √5 hierarchy of K + 1 levels over all pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Lattice {
    k_max: u32,
    origin: [i32; 2],
}

impl Lattice {
    /// The largest K for which the constants of this file hold.
    pub const K_LIMIT: u32 = 9;

    /// A hierarchy whose coarsest level set is K = `k_max`, with a sample of every level at `origin`.
    ///
    /// # Panics
    /// If `k_max > K_LIMIT`: a bug of the caller.
    pub fn new(k_max: u32, origin: [i32; 2]) -> Self {
        assert!(k_max <= Self::K_LIMIT, "K ≤ {}", Self::K_LIMIT);
        Self { k_max, origin }
    }

    /// Number of levels, the paper's l_max.
    pub fn levels(&self) -> u32 {
        self.k_max + 1
    }

    /// Level set k of level l (1 … l_max).
    #[inline]
    pub fn k_of(&self, level: u32) -> u32 {
        debug_assert!((1..=self.levels()).contains(&level));
        self.k_max + 1 - level
    }

    /// gₖ = (2 − i)ᵏ as (real, imaginary).
    pub const fn generator(k: u32) -> (i64, i64) {
        let (mut a, mut b) = (1i64, 0i64);
        let mut i = 0;
        while i < k {
            (a, b) = (2 * a + b, 2 * b - a);
            i += 1;
        }
        (a, b)
    }

    /// Side Lₖ = |aₖ| + |bₖ| of the square that leaves no hole and covers no other sample of its
    /// level (REFERENCE §3.5; the paper's printed side leaves holes, corrections H1 and H2).
    pub const fn square_side(k: u32) -> i32 {
        let (a, b) = Self::generator(k);
        (a.abs() + b.abs()) as i32
    }

    /// The level of a pixel, 1 … l_max: the one level at which it is sampled.
    #[inline]
    pub fn level(&self, x: i32, y: i32) -> u32 {
        let (mut x, mut y) =
            (i64::from(x) - i64::from(self.origin[0]), i64::from(y) - i64::from(self.origin[1]));
        let mut v = 0;
        while v < self.k_max && (x + 2 * y).rem_euclid(5) == 0 {
            (x, y) = ((2 * x - y) / 5, (x + 2 * y) / 5);
            v += 1;
        }
        self.k_max + 1 - v
    }

    /// The sample of level set `k` whose exact tile holds the pixel (REFERENCE §3.6). Tiles have
    /// 5ᵏ pixels, do not overlap and leave none out.
    #[inline]
    pub fn tile_owner(&self, k: u32, x: i32, y: i32) -> (i32, i32) {
        let (a, b) = Self::generator(k);
        let (zx, zy) = (i64::from(x) - i64::from(self.origin[0]), i64::from(y) - i64::from(self.origin[1]));
        let d = 5i64.pow(k);
        // z / g = z · conj(g) / 5ᵏ, rounded to nearest; 5ᵏ is odd, so there are no ties.
        let round = |n: i64| (2 * n + d).div_euclid(2 * d);
        let (qx, qy) = (round(zx * a + zy * b), round(zy * a - zx * b));
        ((qx * a - qy * b) as i32 + self.origin[0], (qx * b + qy * a) as i32 + self.origin[1])
    }

    /// Offsets of the pixels of a tile of level set `k` from its sample, in row order.
    pub fn tile(k: u32) -> Vec<(i16, i16)> {
        let lattice = Self::new(k, [0, 0]);
        let r = Self::square_side(k) / 2;
        let mut pixels = Vec::with_capacity(5usize.pow(k));
        for y in -r..=r {
            for x in -r..=r {
                if lattice.tile_owner(k, x, y) == (0, 0) {
                    pixels.push((x as i16, y as i16));
                }
            }
        }
        pixels
    }

    /// First pixel of level set `k` in row `y` at a column ≥ `x`, and the distance between them.
    #[inline]
    fn first_in_row(&self, k: u32, x: i32, y: i32) -> (i64, i64) {
        let m = 5i64.pow(k);
        let r = (-T[k as usize] * (i64::from(y) - i64::from(self.origin[1])) + i64::from(self.origin[0]))
            .rem_euclid(m);
        (i64::from(x) + (r - i64::from(x)).rem_euclid(m), m)
    }

    /// Number of samples of exactly `level` in row `y` between columns `x0` and `x1`.
    fn count_in_row(&self, level: u32, x0: i32, x1: i32, y: i32) -> u64 {
        let set = |k: u32| {
            let (first, step) = self.first_in_row(k, x0, y);
            if first >= i64::from(x1) { 0 } else { ((i64::from(x1) - 1 - first) / step + 1) as u64 }
        };
        let k = self.k_of(level);
        if k == self.k_max { set(k) } else { set(k) - set(k + 1) }
    }

    /// Number of samples of exactly `level` in a rectangle, without visiting them.
    pub fn count(&self, level: u32, rect: Rect) -> u64 {
        (rect.y0..rect.y1).map(|y| self.count_in_row(level, rect.x0, rect.x1.max(rect.x0), y)).sum()
    }

    /// The samples of exactly `level` inside `rect` from `start` on, in row order. Touches no other pixel
    /// but the one in five that belongs to a coarser level.
    pub fn samples(&self, level: u32, rect: Rect, start: Cursor) -> Samples {
        let k = self.k_of(level);
        let mut samples = Samples { lattice: *self, k, rect, y: start.y.max(rect.y0), x: 0, coarser: 0 };
        if rect.is_empty() {
            samples.y = rect.y1;
        } else if start.y < rect.y0 {
            samples.enter_row(rect.x0);
        } else {
            samples.enter_row(start.x.max(rect.x0));
        }
        samples
    }

    /// The whole level inside `rect`.
    pub fn all_samples(&self, level: u32, rect: Rect) -> Samples {
        self.samples(level, rect, Cursor { x: rect.x0, y: rect.y0 })
    }
}

/// Iterator over the pixels of one level inside a rectangle.
#[derive(Clone, Debug)]
pub struct Samples {
    lattice: Lattice,
    k: u32,
    rect: Rect,
    y: i32,
    /// Next column of the level set in row `y`, may be beyond the rectangle.
    x: i64,
    /// Residue of the coarser level set in row `y`.
    coarser: i64,
}

impl Samples {
    fn enter_row(&mut self, from: i32) {
        self.x = self.lattice.first_in_row(self.k, from, self.y).0;
        if self.k < self.lattice.k_max {
            self.coarser = self.lattice.first_in_row(self.k + 1, 0, self.y).0;
        }
    }

    /// Where the enumeration stands, for `Lattice::samples` to go on from; `None` at its end.
    pub fn cursor(&self) -> Option<Cursor> {
        (self.y < self.rect.y1).then(|| Cursor { x: self.x.min(i64::from(self.rect.x1)) as i32, y: self.y })
    }
}

impl Iterator for Samples {
    type Item = (i32, i32);

    fn next(&mut self) -> Option<(i32, i32)> {
        let m = 5i64.pow(self.k);
        while self.y < self.rect.y1 {
            while self.x < i64::from(self.rect.x1) {
                let x = self.x;
                self.x += m;
                if self.k == self.lattice.k_max || (x - self.coarser).rem_euclid(5 * m) != 0 {
                    return Some((x as i32, self.y));
                }
            }
            self.y += 1;
            if self.y < self.rect.y1 {
                self.enter_row(self.rect.x0);
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn counts(lattice: Lattice, rect: Rect) -> Vec<u64> {
        (1..=lattice.levels()).map(|l| lattice.count(l, rect)).collect()
    }

    #[test]
    fn counts_of_reference_3_4() {
        let seven = Lattice::new(6, [0, 0]);
        assert_eq!(counts(seven, Rect::of_size(512, 512)), [17, 67, 336, 1678, 8388, 41943, 209_715]);
        assert_eq!(counts(seven, Rect::of_size(640, 360)), [16, 58, 295, 1474, 7373, 36864, 184_320]);
        assert_eq!(counts(Lattice::new(4, [0, 0]), Rect::of_size(101, 77)), [14, 49, 249, 1244, 6221]);
        assert_eq!(counts(Lattice::new(3, [0, 0]), Rect::of_size(125, 125)), [125, 500, 2500, 12500]);
    }

    #[test]
    fn valuations_of_reference_3_4() {
        let lattice = Lattice::new(3, [0, 0]);
        let rows = ["3000010000", "0001000010", "0100001000", "0000200001"];
        for (y, row) in rows.iter().enumerate() {
            for (x, v) in row.bytes().enumerate() {
                assert_eq!(
                    lattice.k_of(lattice.level(x as i32, y as i32)),
                    u32::from(v - b'0'),
                    "({x}, {y})"
                );
            }
        }
    }

    #[test]
    fn generators_and_sides_of_reference_3_5() {
        let g: Vec<_> = (0..7).map(Lattice::generator).collect();
        assert_eq!(g, [(1, 0), (2, -1), (3, -4), (2, -11), (-7, -24), (-38, -41), (-117, -44)]);
        let sides: Vec<_> = (0..7).map(Lattice::square_side).collect();
        assert_eq!(sides, [1, 3, 7, 13, 31, 79, 161]);
    }

    #[test]
    fn tiles_have_five_to_the_k_pixels_and_hold_their_sample() {
        for k in 0..6 {
            let tile = Lattice::tile(k);
            assert_eq!(tile.len(), 5usize.pow(k));
            assert!(tile.contains(&(0, 0)));
        }
        let mut plus = Lattice::tile(1);
        plus.sort_unstable();
        assert_eq!(plus, [(-1, 0), (0, -1), (0, 0), (0, 1), (1, 0)]);
    }

    #[test]
    fn squares_leave_no_hole_and_keep_every_centre() {
        let lattice = Lattice::new(3, [11, 7]);
        for k in 1..=3 {
            let r = Lattice::square_side(k) / 2;
            let centres: Vec<_> = (-60..120)
                .flat_map(|y| (-60..120).map(move |x| (x, y)))
                .filter(|&(x, y)| lattice.k_of(lattice.level(x, y)) >= k)
                .collect();
            for y in 0..40 {
                for x in 0..40 {
                    let covering =
                        centres.iter().filter(|c| (c.0 - x).abs() <= r && (c.1 - y).abs() <= r).count();
                    assert!(covering >= 1, "hole at ({x}, {y}), k = {k}");
                    if centres.contains(&(x, y)) {
                        assert_eq!(covering, 1, "centre ({x}, {y}) covered by another, k = {k}");
                    }
                }
            }
        }
    }

    proptest! {
        /// Every pixel of any rectangle comes exactly once over all levels, at the level that
        /// `level` names, from any cut of the iterator, and the closed-form count agrees.
        #[test]
        fn levels_partition_any_rectangle(
            x0 in -300i32..300, y0 in -300i32..300, w in 0i32..90, h in 0i32..90,
            k_max in 0u32..7, ox in -50i32..50, oy in -50i32..50, cut in 1usize..40,
        ) {
            let lattice = Lattice::new(k_max, [ox, oy]);
            let rect = Rect { x0, y0, x1: x0 + w, y1: y0 + h };
            let mut seen = std::collections::BTreeSet::new();
            for level in 1..=lattice.levels() {
                let mut found = Vec::new();
                let mut cursor = Some(Cursor { x: rect.x0, y: rect.y0 });
                while let Some(at) = cursor {
                    let mut samples = lattice.samples(level, rect, at);
                    found.extend(samples.by_ref().take(cut));
                    cursor = samples.cursor();
                }
                prop_assert_eq!(found.len() as u64, lattice.count(level, rect));
                for p in found {
                    prop_assert!(rect.contains(p.0, p.1));
                    prop_assert_eq!(lattice.level(p.0, p.1), level);
                    prop_assert!(seen.insert(p));
                }
            }
            prop_assert_eq!(seen.len() as u64, rect.area());
        }

        /// A pixel's tile owner is a sample of that level set, and the pixel lies in its tile.
        #[test]
        fn tiles_partition_the_plane(x in -2000i32..2000, y in -2000i32..2000, k in 0u32..6) {
            let lattice = Lattice::new(6, [3, -8]);
            let (sx, sy) = lattice.tile_owner(k, x, y);
            prop_assert!(lattice.k_of(lattice.level(sx, sy)) >= k);
            prop_assert_eq!(lattice.tile_owner(k, sx, sy), (sx, sy));
            prop_assert!(Lattice::tile(k).contains(&((x - sx) as i16, (y - sy) as i16)));
        }
    }
}
