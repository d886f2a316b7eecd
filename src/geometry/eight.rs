//! Eight numbers at once: with AVX2 where the processor has it, else as two times four; the same bits either way.
//!
//! What is there is asked once per tree. `pulp`'s token stands for the answer, so that its intrinsics are safe to call.

use glam::Vec4;

/// Operations on eight f32. `min` and `max` return the second operand where one is not a number, as SSE and AVX do.
pub(super) trait Eight: Copy {
    /// Eight of them.
    type Lanes: Copy;
    fn load(self, values: &[f32; 8]) -> Self::Lanes;
    fn splat(self, value: f32) -> Self::Lanes;
    fn sub(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes;
    fn mul(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes;
    fn min(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes;
    fn max(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes;
    /// A bit for each lane with a ≤ b.
    fn at_most(self, a: Self::Lanes, b: Self::Lanes) -> u32;
    fn store(self, a: Self::Lanes) -> [f32; 8];
}

/// Two times four, on any processor.
#[derive(Clone, Copy, Debug)]
pub(super) struct Portable;

impl Eight for Portable {
    type Lanes = [Vec4; 2];

    #[inline(always)]
    fn load(self, v: &[f32; 8]) -> [Vec4; 2] {
        [Vec4::new(v[0], v[1], v[2], v[3]), Vec4::new(v[4], v[5], v[6], v[7])]
    }

    #[inline(always)]
    fn splat(self, value: f32) -> [Vec4; 2] {
        [Vec4::splat(value); 2]
    }

    #[inline(always)]
    fn sub(self, a: [Vec4; 2], b: [Vec4; 2]) -> [Vec4; 2] {
        [a[0] - b[0], a[1] - b[1]]
    }

    #[inline(always)]
    fn mul(self, a: [Vec4; 2], b: [Vec4; 2]) -> [Vec4; 2] {
        [a[0] * b[0], a[1] * b[1]]
    }

    #[inline(always)]
    fn min(self, a: [Vec4; 2], b: [Vec4; 2]) -> [Vec4; 2] {
        [a[0].min(b[0]), a[1].min(b[1])]
    }

    #[inline(always)]
    fn max(self, a: [Vec4; 2], b: [Vec4; 2]) -> [Vec4; 2] {
        [a[0].max(b[0]), a[1].max(b[1])]
    }

    #[inline(always)]
    fn at_most(self, a: [Vec4; 2], b: [Vec4; 2]) -> u32 {
        a[0].cmple(b[0]).bitmask() | a[1].cmple(b[1]).bitmask() << 4
    }

    #[inline(always)]
    fn store(self, a: [Vec4; 2]) -> [f32; 8] {
        bytemuck::cast(a.map(|v| v.to_array()))
    }
}

/// AVX2.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy, Debug)]
pub(super) struct Avx2(pub pulp::x86::V3);

#[cfg(target_arch = "x86_64")]
impl Eight for Avx2 {
    type Lanes = core::arch::x86_64::__m256;

    #[inline(always)]
    fn load(self, values: &[f32; 8]) -> Self::Lanes {
        bytemuck::cast(*values)
    }

    #[inline(always)]
    fn splat(self, value: f32) -> Self::Lanes {
        self.0.avx._mm256_set1_ps(value)
    }

    #[inline(always)]
    fn sub(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes {
        self.0.avx._mm256_sub_ps(a, b)
    }

    #[inline(always)]
    fn mul(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes {
        self.0.avx._mm256_mul_ps(a, b)
    }

    #[inline(always)]
    fn min(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes {
        self.0.avx._mm256_min_ps(a, b)
    }

    #[inline(always)]
    fn max(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes {
        self.0.avx._mm256_max_ps(a, b)
    }

    #[inline(always)]
    fn at_most(self, a: Self::Lanes, b: Self::Lanes) -> u32 {
        let ordered = self.0.avx._mm256_cmp_ps::<{ core::arch::x86_64::_CMP_LE_OQ }>(a, b);
        self.0.avx._mm256_movemask_ps(ordered) as u32
    }

    #[inline(always)]
    fn store(self, a: Self::Lanes) -> [f32; 8] {
        bytemuck::cast(a)
    }
}

/// What this processor has.
#[derive(Clone, Copy, Debug)]
pub(super) struct Level {
    #[cfg(target_arch = "x86_64")]
    avx2: Option<pulp::x86::V3>,
}

/// Work to be compiled for each set of instructions.
pub(super) trait Work {
    type Output;
    fn run<E: Eight>(self, eight: E) -> Self::Output;
}

impl Level {
    /// Asks the processor.
    pub fn detect() -> Self {
        Self {
            #[cfg(target_arch = "x86_64")]
            avx2: pulp::x86::V3::try_new(),
        }
    }

    /// What every processor has.
    #[cfg(test)]
    pub fn portable() -> Self {
        Self {
            #[cfg(target_arch = "x86_64")]
            avx2: None,
        }
    }

    /// Runs the best copy.
    #[inline(always)]
    pub fn run<W: Work>(self, work: W) -> W::Output {
        #[cfg(target_arch = "x86_64")]
        if let Some(avx2) = self.avx2 {
            struct Compiled<W>(W, pulp::x86::V3);
            impl<W: Work> pulp::NullaryFnOnce for Compiled<W> {
                type Output = W::Output;

                #[inline(always)]
                fn call(self) -> W::Output {
                    self.0.run(Avx2(self.1))
                }
            }
            return avx2.vectorize(Compiled(work, avx2));
        }
        work.run(Portable)
    }
}

impl Default for Level {
    fn default() -> Self {
        Self::detect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct All([f32; 8], [f32; 8]);

    impl Work for All {
        type Output = Vec<u32>;

        fn run<E: Eight>(self, e: E) -> Vec<u32> {
            let (a, b) = (e.load(&self.0), e.load(&self.1));
            let results = [e.sub(a, b), e.mul(a, b), e.min(a, b), e.max(a, b), e.splat(self.0[0])];
            let mut bits: Vec<u32> = results
                .iter()
                .flat_map(|&r| e.store(r).map(|v| if v.is_nan() { 1 } else { v.to_bits() }))
                .collect();
            bits.push(e.at_most(a, b));
            bits
        }
    }

    #[test]
    fn all_copies_find_the_same_bits() {
        let values = [0.0, -0.0, 1.5, -3e38, f32::INFINITY, f32::NEG_INFINITY, f32::NAN, 1e-40];
        for shift in 0..8 {
            let mut other = values;
            other.rotate_left(shift);
            let best = Level::detect().run(All(values, other));
            assert_eq!(best, Level::portable().run(All(values, other)), "{shift}");
        }
    }
}
