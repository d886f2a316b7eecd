//! Random numbers as a hash of (seed, stream, index, dimension): no state, so the same number comes
//! out for any thread and any order of evaluation.
//!
//! A stream of a pixel starts with numbers that neighbours share out among themselves: the pixels of a tile take
//! the points of an Owen-scrambled Sobol' sequence in Morton order, so that any 2ᵏ × 2ᵏ pixels of a tile hold a
//! stratified set, and what noise is left is fine-grained (Ahmed and Wonka 2020).

/// One stream of random numbers, identified by a seed and two indices (for example pixel and sample).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stream {
    key: u64,
    dimension: u32,
    /// The numbers shared out among pixels, where this stream still has them.
    pattern: Option<Pattern>,
}

/// A point's index in a Sobol' sequence, and what scrambles that.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Pattern {
    index: u32,
    key: u64,
}

/// Side of the tiles whose pixels share a sequence, as a power of two; 4⁶ · 16 points are what the tables of
/// `sobol_burley` hold.
const TILE_BITS: u32 = 6;

/// The bits of `v` (below 2⁶) with zeros between them.
#[inline]
fn spread(v: u32) -> u32 {
    let v = (v | v << 4) & 0x0f0f;
    let v = (v | v << 2) & 0x3333;
    (v | v << 1) & 0x5555
}

/// A bijective 64-bit mix (Stafford's variant 13 of the MurmurHash3 finaliser, as in SplitMix64).
#[inline]
pub fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A hash of three words. Every word reaches every bit of the result.
#[inline]
pub fn hash(a: u64, b: u64, c: u64) -> u64 {
    const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;
    let h = mix(a.wrapping_add(GOLDEN));
    let h = mix(h ^ b.wrapping_mul(GOLDEN).wrapping_add(0x1234_5678_9abc_def1));
    mix(h ^ c.wrapping_mul(0xd6e8_feb8_6659_fd93).wrapping_add(GOLDEN))
}

/// The upper 24 bits as a float in [0, 1).
#[inline]
pub fn unit_f32(bits: u64) -> f32 {
    (bits >> 40) as f32 * (1.0 / (1u64 << 24) as f32)
}

impl Stream {
    /// The stream of `seed` at `index` (pixel, particle) and `sample`.
    #[inline]
    pub fn new(seed: u64, index: u64, sample: u64) -> Self {
        Self { key: hash(seed, index, sample), dimension: 0, pattern: None }
    }

    /// The stream of a pixel, whose first numbers are shared out among its neighbours.
    #[inline]
    pub fn of_pixel(seed: u64, x: u32, y: u32, sample: u64) -> Self {
        const INSIDE: u32 = (1 << TILE_BITS) - 1;
        let tile = u64::from(y >> TILE_BITS) << 32 | u64::from(x >> TILE_BITS);
        let index = spread(x & INSIDE) | spread(y & INSIDE) << 1;
        let pattern = Some(Pattern { index, key: hash(seed, !tile, sample) });
        Self { pattern, ..Self::new(seed, u64::from(y) << 32 | u64::from(x), sample) }
    }

    /// Sample `index` of a sequence of its own, `key` of `seed`: all samples together are stratified.
    #[inline]
    pub fn in_sequence(seed: u64, key: u64, index: u32) -> Self {
        // As many points as the tables hold; then another scramble.
        const POINTS: u32 = 1 << 16;
        let pattern = Pattern { index: index % POINTS, key: hash(seed, key, !u64::from(index / POINTS)) };
        Self { pattern: Some(pattern), ..Self::new(seed, key, u64::from(index)) }
    }

    /// The next number in [0, 1). Advances the dimension by one.
    #[inline]
    pub fn next_f32(&mut self) -> f32 {
        match self.pattern {
            None => unit_f32(self.next_u64()),
            Some(pattern) => sobol_burley::sample(pattern.index, 0, self.next_scramble(pattern)),
        }
    }

    /// The next number in [0, 1) with as many bits as there are, for a choice among many. What is shared out among
    /// neighbours are its first bits.
    #[inline]
    pub fn next_f64(&mut self) -> f64 {
        const BELOW: f64 = 1.0 / (1u64 << 53) as f64;
        match self.pattern {
            None => (self.next_u64() >> 11) as f64 * BELOW,
            Some(_) => f64::from(self.next_f32()) + (self.next_u64() >> 35) as f64 * BELOW,
        }
    }

    /// The next two numbers in [0, 1)².
    #[inline]
    pub fn next_2d(&mut self) -> [f32; 2] {
        let Some(pattern) = self.pattern else {
            let bits = self.next_u64();
            return [unit_f32(bits), unit_f32(bits << 24)];
        };
        // Four dimensions at once take as long as one; the first two are those of `sample`, to the bit.
        let [u, v, ..] = sobol_burley::sample_4d(pattern.index, 0, self.next_scramble(pattern));
        [u, v]
    }

    #[inline]
    fn next_scramble(&mut self, pattern: Pattern) -> u32 {
        self.dimension += 1;
        mix(pattern.key ^ u64::from(self.dimension).wrapping_mul(0x9e37_79b9_7f4a_7c15)) as u32
    }

    /// The next 64 random bits.
    #[inline]
    pub fn next_u64(&mut self) -> u64 {
        self.dimension += 1;
        mix(self.key ^ u64::from(self.dimension).wrapping_mul(0x9e37_79b9_7f4a_7c15))
    }

    /// An independent stream, for a path that branches.
    #[inline]
    pub fn split(&mut self, branch: u64) -> Self {
        let below = |key| hash(key, u64::from(self.dimension), branch);
        let pattern = self.pattern.map(|p| Pattern { key: below(p.key), ..p });
        Self { key: below(self.key), dimension: 0, pattern }
    }

    /// The stream of sample `i` of `n` ≤ 16 at one branch. Where pixels share numbers out, the samples of each do so
    /// too; otherwise they are independent.
    #[inline]
    pub fn sample_of(&mut self, i: u32, n: u32) -> Self {
        let first = self.split(0);
        let pattern = first.pattern.filter(|_| n <= 16).map(|p| Pattern { index: p.index * n + i, ..p });
        Self { pattern, ..self.split(u64::from(i)) }
    }

    /// The same stream at another dimension: where each use has a dimension of its own, one more changes no other.
    #[inline]
    pub fn at(self, dimension: u32) -> Self {
        Self { dimension, ..self }
    }

    /// Whether its numbers are shared out among pixels and samples.
    #[inline]
    pub fn is_shared_out(&self) -> bool {
        self.pattern.is_some()
    }

    /// The same stream without that, for the many numbers of which none matters much.
    #[inline]
    pub fn independent(self) -> Self {
        Self { pattern: None, ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_uniform_and_uncorrelated_between_neighbours() {
        let n = 200_000u64;
        let (mut mean, mut product) = (0.0f64, 0.0f64);
        let mut bins = [0u32; 16];
        let mut last = 0.5;
        for i in 0..n {
            let x = Stream::new(7, i, 0).next_f32();
            assert!((0.0..1.0).contains(&x));
            mean += f64::from(x);
            product += f64::from(x - 0.5) * (last - 0.5);
            last = f64::from(x);
            bins[(x * 16.0) as usize] += 1;
        }
        let n = n as f64;
        assert!((mean / n - 0.5).abs() < 4.0 / (12.0 * n).sqrt());
        assert!((product / n).abs() < 4.0 / (144.0 * n).sqrt());
        let expected = n / 16.0;
        let chi2: f64 = bins.iter().map(|&b| (f64::from(b) - expected).powi(2) / expected).sum();
        assert!(chi2 < 45.0, "χ² with 15 degrees of freedom: {chi2}");
    }

    /// Each 2ᵏ × 2ᵏ pixels have one number in each 4ᵏ-th of [0, 1), in each dimension and branch; each 2ᵏ × 2ᵏ pairs
    /// one in each cell of a 2ᵏ × 2ᵏ grid; with n samples per pixel n times as many.
    #[test]
    fn neighbours_share_out_the_unit_square() {
        for (k, n) in [(1u32, 1u32), (2, 1), (3, 1), (1, 4), (2, 4)] {
            let (side, cells) = (1u32 << k, (1usize << (2 * k)) * n as usize);
            let (mut line, mut grid) = (vec![0; cells], vec![0; cells]);
            // cells = 2ᵃ × 2ᵃ or, for odd powers of two, not a square: all n here are powers of four.
            let across = (cells as f32).sqrt() as usize;
            for y in 64..64 + side {
                for x in 8..8 + side {
                    for i in 0..n {
                        let mut s = Stream::of_pixel(3, x, y, 0);
                        let _ = s.next_f32();
                        let mut s = s.split(5).sample_of(i, n);
                        line[(s.next_f32() * cells as f32) as usize] += 1;
                        let [u, v] = s.next_2d();
                        let cell = |v: f32| (v * across as f32) as usize;
                        grid[cell(v) * across + cell(u)] += 1;
                    }
                }
            }
            assert!(line.iter().chain(&grid).all(|&c| c == 1), "k {k}, n {n}: {line:?} {grid:?}");
        }
        // Other samples of a pixel, other tiles and seeds go their own ways.
        let first = |seed, x, sample| Stream::of_pixel(seed, x, 0, sample).next_f32();
        let all = [first(0, 0, 0), first(1, 0, 0), first(0, 64, 0), first(0, 0, 1)];
        assert!((0..4).all(|i| (0..i).all(|j| all[i] != all[j])), "{all:?}");
    }
}
