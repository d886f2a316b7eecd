//! Random numbers as a hash of (seed, stream, index, dimension): no state, so the same number comes
//! out for any thread and any order of evaluation.

/// One stream of random numbers, identified by a seed and two indices (for example pixel and sample).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stream {
    key: u64,
    dimension: u32,
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
        Self { key: hash(seed, index, sample), dimension: 0 }
    }

    /// The next number in [0, 1). Advances the dimension by one.
    #[inline]
    pub fn next_f32(&mut self) -> f32 {
        unit_f32(self.next_u64())
    }

    /// The next two numbers in [0, 1)².
    #[inline]
    pub fn next_2d(&mut self) -> [f32; 2] {
        let bits = self.next_u64();
        [unit_f32(bits), unit_f32(bits << 24)]
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
        Self { key: hash(self.key, u64::from(self.dimension), branch), dimension: 0 }
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
}
