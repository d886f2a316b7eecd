//! Sixteen numbers at once, one for each ray of a packet: in one register of AVX-512, or as two times eight; the same
//! bits either way.

use super::eight::Eight;
use super::level::Portable;

/// Operations on sixteen f32; they are those of [`Eight`].
pub(super) trait Sixteen: Copy {
    /// Sixteen of them.
    type Lanes: Copy;
    /// Yes or no for each.
    type Mask: Copy;
    fn load(self, values: &[f32; 16]) -> Self::Lanes;
    fn splat(self, value: f32) -> Self::Lanes;
    fn store(self, a: Self::Lanes) -> [f32; 16];
    fn add(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes;
    fn sub(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes;
    fn mul(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes;
    fn div(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes;
    fn min(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes;
    fn max(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes;
    /// a < b.
    fn below(self, a: Self::Lanes, b: Self::Lanes) -> Self::Mask;
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

/// Two times eight.
macro_rules! two_times_eight {
    ($token:ty) => {
        impl Sixteen for $token {
            type Lanes = [<$token as Eight>::Lanes; 2];
            type Mask = [<$token as Eight>::Mask; 2];

            #[inline(always)]
            fn load(self, values: &[f32; 16]) -> Self::Lanes {
                let [low, high]: [[f32; 8]; 2] = bytemuck::cast(*values);
                [Eight::load(self, &low), Eight::load(self, &high)]
            }

            #[inline(always)]
            fn splat(self, value: f32) -> Self::Lanes {
                [Eight::splat(self, value); 2]
            }

            #[inline(always)]
            fn store(self, a: Self::Lanes) -> [f32; 16] {
                bytemuck::cast([Eight::store(self, a[0]), Eight::store(self, a[1])])
            }

            #[inline(always)]
            fn add(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes {
                [Eight::add(self, a[0], b[0]), Eight::add(self, a[1], b[1])]
            }

            #[inline(always)]
            fn sub(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes {
                [Eight::sub(self, a[0], b[0]), Eight::sub(self, a[1], b[1])]
            }

            #[inline(always)]
            fn mul(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes {
                [Eight::mul(self, a[0], b[0]), Eight::mul(self, a[1], b[1])]
            }

            #[inline(always)]
            fn div(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes {
                [Eight::div(self, a[0], b[0]), Eight::div(self, a[1], b[1])]
            }

            #[inline(always)]
            fn min(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes {
                [Eight::min(self, a[0], b[0]), Eight::min(self, a[1], b[1])]
            }

            #[inline(always)]
            fn max(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes {
                [Eight::max(self, a[0], b[0]), Eight::max(self, a[1], b[1])]
            }

            #[inline(always)]
            fn below(self, a: Self::Lanes, b: Self::Lanes) -> Self::Mask {
                [Eight::below(self, a[0], b[0]), Eight::below(self, a[1], b[1])]
            }

            #[inline(always)]
            fn equal(self, a: Self::Lanes, b: Self::Lanes) -> Self::Mask {
                [Eight::equal(self, a[0], b[0]), Eight::equal(self, a[1], b[1])]
            }

            #[inline(always)]
            fn and(self, a: Self::Mask, b: Self::Mask) -> Self::Mask {
                [Eight::and(self, a[0], b[0]), Eight::and(self, a[1], b[1])]
            }

            #[inline(always)]
            fn or(self, a: Self::Mask, b: Self::Mask) -> Self::Mask {
                [Eight::or(self, a[0], b[0]), Eight::or(self, a[1], b[1])]
            }

            #[inline(always)]
            fn without(self, a: Self::Mask, b: Self::Mask) -> Self::Mask {
                [Eight::without(self, a[0], b[0]), Eight::without(self, a[1], b[1])]
            }

            #[inline(always)]
            fn bits(self, mask: Self::Mask) -> u32 {
                Eight::bits(self, mask[0]) | Eight::bits(self, mask[1]) << 8
            }

            #[inline(always)]
            fn select(self, mask: Self::Mask, yes: Self::Lanes, no: Self::Lanes) -> Self::Lanes {
                let [low, high] = mask;
                [Eight::select(self, low, yes[0], no[0]), Eight::select(self, high, yes[1], no[1])]
            }
        }
    };
}

two_times_eight!(Portable);
#[cfg(target_arch = "x86_64")]
two_times_eight!(super::level::Avx2);

#[cfg(target_arch = "x86_64")]
impl Sixteen for super::level::Avx512 {
    type Lanes = core::arch::x86_64::__m512;
    type Mask = core::arch::x86_64::__mmask16;

    #[inline(always)]
    fn load(self, values: &[f32; 16]) -> Self::Lanes {
        bytemuck::cast(*values)
    }

    #[inline(always)]
    fn splat(self, value: f32) -> Self::Lanes {
        self.0.avx512f._mm512_set1_ps(value)
    }

    #[inline(always)]
    fn store(self, a: Self::Lanes) -> [f32; 16] {
        bytemuck::cast(a)
    }

    #[inline(always)]
    fn add(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes {
        self.0.avx512f._mm512_add_ps(a, b)
    }

    #[inline(always)]
    fn sub(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes {
        self.0.avx512f._mm512_sub_ps(a, b)
    }

    #[inline(always)]
    fn mul(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes {
        self.0.avx512f._mm512_mul_ps(a, b)
    }

    #[inline(always)]
    fn div(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes {
        self.0.avx512f._mm512_div_ps(a, b)
    }

    #[inline(always)]
    fn min(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes {
        self.0.avx512f._mm512_min_ps(a, b)
    }

    #[inline(always)]
    fn max(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes {
        self.0.avx512f._mm512_max_ps(a, b)
    }

    #[inline(always)]
    fn below(self, a: Self::Lanes, b: Self::Lanes) -> Self::Mask {
        self.0.avx512f._mm512_cmp_ps_mask::<{ core::arch::x86_64::_CMP_LT_OQ }>(a, b)
    }

    #[inline(always)]
    fn equal(self, a: Self::Lanes, b: Self::Lanes) -> Self::Mask {
        self.0.avx512f._mm512_cmp_ps_mask::<{ core::arch::x86_64::_CMP_EQ_OQ }>(a, b)
    }

    #[inline(always)]
    fn and(self, a: Self::Mask, b: Self::Mask) -> Self::Mask {
        a & b
    }

    #[inline(always)]
    fn or(self, a: Self::Mask, b: Self::Mask) -> Self::Mask {
        a | b
    }

    #[inline(always)]
    fn without(self, a: Self::Mask, b: Self::Mask) -> Self::Mask {
        a & !b
    }

    #[inline(always)]
    fn bits(self, mask: Self::Mask) -> u32 {
        u32::from(mask)
    }

    #[inline(always)]
    fn select(self, mask: Self::Mask, yes: Self::Lanes, no: Self::Lanes) -> Self::Lanes {
        self.0.avx512f._mm512_mask_blend_ps(mask, no, yes)
    }
}

#[cfg(test)]
mod tests {
    use super::super::level::{Level, Vectors, Work};
    use super::*;

    struct All([f32; 16], [f32; 16]);

    impl All {
        fn of_sixteen<S: Sixteen>(&self, s: S) -> Vec<u32> {
            let (a, b) = (s.load(&self.0), s.load(&self.1));
            let (below, equal) = (s.below(a, b), s.equal(a, b));
            let masks = [below, equal, s.and(below, equal), s.or(below, equal), s.without(equal, below)];
            let sums = [s.add(a, b), s.sub(a, b), s.mul(a, b), s.div(a, b), s.splat(self.0[0])];
            let chosen = [s.min(a, b), s.max(a, b), s.select(below, a, b)];
            let bits_of = |v: f32| if v.is_nan() { 1 } else { v.to_bits() };
            let values = sums.iter().chain(&chosen).flat_map(|&r| s.store(r).map(bits_of));
            values.chain(masks.map(|m| s.bits(m))).collect()
        }
    }

    impl Work for All {
        type Output = Vec<u32>;
        const SIXTEEN: bool = true;

        fn run<V: Vectors>(self, v: V) -> Vec<u32> {
            self.of_sixteen(v)
        }
    }

    #[test]
    fn all_copies_find_the_same_bits() {
        let some = [0.0, -0.0, 1.5, -3e38, f32::INFINITY, f32::NEG_INFINITY, f32::NAN, 1e-40];
        let values: [f32; 16] = std::array::from_fn(|i| some[i % 8] * if i < 8 { 1.0 } else { 1.25 });
        for shift in 0..16 {
            let mut other = values;
            other.rotate_left(shift);
            let all = Level::all().into_iter().map(|level| level.run(All(values, other)));
            let all: Vec<Vec<u32>> = all.collect();
            assert!(all.iter().all(|found| *found == all[0]), "{shift}: {all:?}");
        }
    }
}
