//! Eight numbers at once: with AVX2 where the processor has it, else as two times four; the same bits either way.

use glam::{BVec4A, Vec4};

use super::level::Portable;

/// Operations on eight f32. `min` and `max` return the second operand where one is not a number, as SSE and AVX do.
pub(super) trait Eight: Copy {
    /// Eight of them.
    type Lanes: Copy;
    /// Yes or no for each.
    type Mask: Copy;
    fn load(self, values: &[f32; 8]) -> Self::Lanes;
    fn splat(self, value: f32) -> Self::Lanes;
    fn store(self, a: Self::Lanes) -> [f32; 8];
    fn add(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes;
    fn sub(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes;
    fn mul(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes;
    fn div(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes;
    fn min(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes;
    fn max(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes;
    /// a < b.
    fn below(self, a: Self::Lanes, b: Self::Lanes) -> Self::Mask;
    /// a ≤ b.
    fn at_most(self, a: Self::Lanes, b: Self::Lanes) -> Self::Mask;
    /// a = b.
    fn equal(self, a: Self::Lanes, b: Self::Lanes) -> Self::Mask;
    fn and(self, a: Self::Mask, b: Self::Mask) -> Self::Mask;
    fn or(self, a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// a and not b.
    fn without(self, a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// A bit for each.
    fn bits(self, mask: Self::Mask) -> u32;
    /// `yes` where the mask holds, else `no`.
    fn select(self, mask: Self::Mask, yes: Self::Lanes, no: Self::Lanes) -> Self::Lanes;
}

impl Eight for Portable {
    type Lanes = [Vec4; 2];
    type Mask = [BVec4A; 2];

    #[inline(always)]
    fn load(self, v: &[f32; 8]) -> [Vec4; 2] {
        [Vec4::new(v[0], v[1], v[2], v[3]), Vec4::new(v[4], v[5], v[6], v[7])]
    }

    #[inline(always)]
    fn splat(self, value: f32) -> [Vec4; 2] {
        [Vec4::splat(value); 2]
    }

    #[inline(always)]
    fn store(self, a: [Vec4; 2]) -> [f32; 8] {
        bytemuck::cast(a.map(|v| v.to_array()))
    }

    #[inline(always)]
    fn add(self, a: [Vec4; 2], b: [Vec4; 2]) -> [Vec4; 2] {
        [a[0] + b[0], a[1] + b[1]]
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
    fn div(self, a: [Vec4; 2], b: [Vec4; 2]) -> [Vec4; 2] {
        [a[0] / b[0], a[1] / b[1]]
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
    fn below(self, a: [Vec4; 2], b: [Vec4; 2]) -> [BVec4A; 2] {
        [a[0].cmplt(b[0]), a[1].cmplt(b[1])]
    }

    #[inline(always)]
    fn at_most(self, a: [Vec4; 2], b: [Vec4; 2]) -> [BVec4A; 2] {
        [a[0].cmple(b[0]), a[1].cmple(b[1])]
    }

    #[inline(always)]
    fn equal(self, a: [Vec4; 2], b: [Vec4; 2]) -> [BVec4A; 2] {
        [a[0].cmpeq(b[0]), a[1].cmpeq(b[1])]
    }

    #[inline(always)]
    fn and(self, a: [BVec4A; 2], b: [BVec4A; 2]) -> [BVec4A; 2] {
        [a[0] & b[0], a[1] & b[1]]
    }

    #[inline(always)]
    fn or(self, a: [BVec4A; 2], b: [BVec4A; 2]) -> [BVec4A; 2] {
        [a[0] | b[0], a[1] | b[1]]
    }

    #[inline(always)]
    fn without(self, a: [BVec4A; 2], b: [BVec4A; 2]) -> [BVec4A; 2] {
        [a[0] & !b[0], a[1] & !b[1]]
    }

    #[inline(always)]
    fn bits(self, mask: [BVec4A; 2]) -> u32 {
        mask[0].bitmask() | mask[1].bitmask() << 4
    }

    #[inline(always)]
    fn select(self, mask: [BVec4A; 2], yes: [Vec4; 2], no: [Vec4; 2]) -> [Vec4; 2] {
        [Vec4::select(mask[0], yes[0], no[0]), Vec4::select(mask[1], yes[1], no[1])]
    }
}

/// The operations of AVX2 for a token that has it.
#[cfg(target_arch = "x86_64")]
macro_rules! eight_in_one {
    ($token:ty) => {
        impl Eight for $token {
            type Lanes = core::arch::x86_64::__m256;
            type Mask = core::arch::x86_64::__m256;

            #[inline(always)]
            fn load(self, values: &[f32; 8]) -> Self::Lanes {
                bytemuck::cast(*values)
            }

            #[inline(always)]
            fn splat(self, value: f32) -> Self::Lanes {
                self.0.avx._mm256_set1_ps(value)
            }

            #[inline(always)]
            fn store(self, a: Self::Lanes) -> [f32; 8] {
                bytemuck::cast(a)
            }

            #[inline(always)]
            fn add(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes {
                self.0.avx._mm256_add_ps(a, b)
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
            fn div(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes {
                self.0.avx._mm256_div_ps(a, b)
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
            fn below(self, a: Self::Lanes, b: Self::Lanes) -> Self::Mask {
                self.0.avx._mm256_cmp_ps::<{ core::arch::x86_64::_CMP_LT_OQ }>(a, b)
            }

            #[inline(always)]
            fn at_most(self, a: Self::Lanes, b: Self::Lanes) -> Self::Mask {
                self.0.avx._mm256_cmp_ps::<{ core::arch::x86_64::_CMP_LE_OQ }>(a, b)
            }

            #[inline(always)]
            fn equal(self, a: Self::Lanes, b: Self::Lanes) -> Self::Mask {
                self.0.avx._mm256_cmp_ps::<{ core::arch::x86_64::_CMP_EQ_OQ }>(a, b)
            }

            #[inline(always)]
            fn and(self, a: Self::Mask, b: Self::Mask) -> Self::Mask {
                self.0.avx._mm256_and_ps(a, b)
            }

            #[inline(always)]
            fn or(self, a: Self::Mask, b: Self::Mask) -> Self::Mask {
                self.0.avx._mm256_or_ps(a, b)
            }

            #[inline(always)]
            fn without(self, a: Self::Mask, b: Self::Mask) -> Self::Mask {
                self.0.avx._mm256_andnot_ps(b, a)
            }

            #[inline(always)]
            fn bits(self, mask: Self::Mask) -> u32 {
                self.0.avx._mm256_movemask_ps(mask) as u32
            }

            #[inline(always)]
            fn select(self, mask: Self::Mask, yes: Self::Lanes, no: Self::Lanes) -> Self::Lanes {
                self.0.avx._mm256_blendv_ps(no, yes, mask)
            }
        }
    };
}

#[cfg(target_arch = "x86_64")]
eight_in_one!(super::level::Avx2);
#[cfg(target_arch = "x86_64")]
eight_in_one!(super::level::Avx512);

#[cfg(test)]
mod tests {
    use super::super::level::{Level, Vectors, Work};
    use super::*;

    struct All([f32; 8], [f32; 8]);

    impl Work for All {
        type Output = Vec<u32>;
        const SIXTEEN: bool = true;

        fn run<V: Vectors>(self, v: V) -> Vec<u32> {
            self.of_eight(v)
        }
    }

    impl All {
        fn of_eight<E: Eight>(&self, e: E) -> Vec<u32> {
            let (a, b) = (e.load(&self.0), e.load(&self.1));
            let masks = [e.below(a, b), e.at_most(a, b), e.equal(a, b)];
            let masks = [
                masks[0],
                masks[1],
                masks[2],
                e.and(masks[0], masks[1]),
                e.or(masks[0], masks[2]),
                e.without(masks[1], masks[0]),
            ];
            let results = [
                e.add(a, b),
                e.sub(a, b),
                e.mul(a, b),
                e.div(a, b),
                e.min(a, b),
                e.max(a, b),
                e.splat(self.0[0]),
                e.select(masks[0], a, b),
            ];
            let bits_of = |v: f32| if v.is_nan() { 1 } else { v.to_bits() };
            results.iter().flat_map(|&r| e.store(r).map(bits_of)).chain(masks.map(|m| e.bits(m))).collect()
        }
    }

    #[test]
    fn all_copies_find_the_same_bits() {
        let values = [0.0, -0.0, 1.5, -3e38, f32::INFINITY, f32::NEG_INFINITY, f32::NAN, 1e-40];
        for shift in 0..8 {
            let mut other = values;
            other.rotate_left(shift);
            let all = Level::all().into_iter().map(|level| level.run(All(values, other)));
            let all: Vec<Vec<u32>> = all.collect();
            assert!(all.iter().all(|found| *found == all[0]), "{shift}: {all:?}");
        }
    }
}
