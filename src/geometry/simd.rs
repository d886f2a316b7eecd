//! Several numbers at once: in registers of AVX-512 or AVX2 where the processor has them, else by halves; the same bits
//! either way.

use std::ops::{Add, BitAnd, BitOr, Div, Mul, Sub};

use glam::{BVec4A, Vec4};

use super::level::Portable;

/// Operations on N f32. `min` and `max` return the second operand where one is not a number, as SSE and AVX do.
pub(super) trait Simd<const N: usize>: Copy {
    /// N of them.
    type Lanes: Copy;
    /// Yes or no for each.
    type Mask: Copy;
    fn load(self, values: &[f32; N]) -> Self::Lanes;
    fn splat(self, value: f32) -> Self::Lanes;
    fn store(self, a: Self::Lanes) -> [f32; N];
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

    /// The least of them, none of which is NaN.
    #[inline(always)]
    fn least(self, a: Self::Lanes) -> f32 {
        folded(self.store(a), |a, b| if a < b { a } else { b })
    }

    /// The largest of them, none of which is NaN.
    #[inline(always)]
    fn most(self, a: Self::Lanes) -> f32 {
        folded(self.store(a), |a, b| if a > b { a } else { b })
    }
}

/// Pairs, pairs of pairs, and so on.
#[inline(always)]
fn folded<const N: usize>(mut all: [f32; N], choose: impl Fn(f32, f32) -> f32) -> f32 {
    let mut half = N / 2;
    while half > 0 {
        for i in 0..half {
            all[i] = choose(all[i], all[i + half]);
        }
        half /= 2;
    }
    all[0]
}

/// Operations with two operands, each as `$does` says of them and of the token.
macro_rules! binary {
    ($from:ident -> $to:ident: $($name:ident = |$e:ident, $a:ident, $b:ident| $does:expr),+ $(,)?) => {
        $(
            #[inline(always)]
            fn $name(self, $a: Self::$from, $b: Self::$from) -> Self::$to {
                let $e = self;
                $does
            }
        )+
    };
}

impl Simd<4> for Portable {
    type Lanes = Vec4;
    type Mask = BVec4A;

    #[inline(always)]
    fn load(self, values: &[f32; 4]) -> Vec4 {
        Vec4::from_array(*values)
    }

    #[inline(always)]
    fn splat(self, value: f32) -> Vec4 {
        Vec4::splat(value)
    }

    #[inline(always)]
    fn store(self, a: Vec4) -> [f32; 4] {
        a.to_array()
    }

    binary!(Lanes -> Lanes: add = |_e, a, b| a.add(b), sub = |_e, a, b| a.sub(b), mul = |_e, a, b| a.mul(b));
    binary!(Lanes -> Lanes: div = |_e, a, b| a.div(b), min = |_e, a, b| a.min(b), max = |_e, a, b| a.max(b));
    binary!(Lanes -> Mask: below = |_e, a, b| a.cmplt(b), at_most = |_e, a, b| a.cmple(b), equal = |_e, a, b| a.cmpeq(b));
    binary!(Mask -> Mask: and = |_e, a, b| a.bitand(b), or = |_e, a, b| a.bitor(b), without = |_e, a, b| a & !b);

    #[inline(always)]
    fn bits(self, mask: BVec4A) -> u32 {
        mask.bitmask()
    }

    #[inline(always)]
    fn select(self, mask: BVec4A, yes: Vec4, no: Vec4) -> Vec4 {
        Vec4::select(mask, yes, no)
    }
}

/// Operations on two operands, each on the halves of them.
macro_rules! halved {
    ($half:literal, $from:ident -> $to:ident: $($name:ident)+) => {
        $(
            #[inline(always)]
            fn $name(self, a: Self::$from, b: Self::$from) -> Self::$to {
                [Simd::<$half>::$name(self, a[0], b[0]), Simd::<$half>::$name(self, a[1], b[1])]
            }
        )+
    };
}

/// Twice as many numbers as a token has operations for, as two halves.
macro_rules! two_halves {
    ($token:ty, $half:literal, $all:literal) => {
        impl Simd<$all> for $token {
            type Lanes = [<$token as Simd<$half>>::Lanes; 2];
            type Mask = [<$token as Simd<$half>>::Mask; 2];

            #[inline(always)]
            fn load(self, values: &[f32; $all]) -> Self::Lanes {
                let [low, high]: [[f32; $half]; 2] = bytemuck::cast(*values);
                [Simd::<$half>::load(self, &low), Simd::<$half>::load(self, &high)]
            }

            #[inline(always)]
            fn splat(self, value: f32) -> Self::Lanes {
                [Simd::<$half>::splat(self, value); 2]
            }

            #[inline(always)]
            fn store(self, a: Self::Lanes) -> [f32; $all] {
                bytemuck::cast([Simd::<$half>::store(self, a[0]), Simd::<$half>::store(self, a[1])])
            }

            halved!($half, Lanes -> Lanes: add sub mul div min max);
            halved!($half, Lanes -> Mask: below at_most equal);
            halved!($half, Mask -> Mask: and or without);

            #[inline(always)]
            fn bits(self, mask: Self::Mask) -> u32 {
                Simd::<$half>::bits(self, mask[0]) | Simd::<$half>::bits(self, mask[1]) << $half
            }

            #[inline(always)]
            fn select(self, mask: Self::Mask, yes: Self::Lanes, no: Self::Lanes) -> Self::Lanes {
                let [low, high] = mask;
                [Simd::<$half>::select(self, low, yes[0], no[0]), Simd::<$half>::select(self, high, yes[1], no[1])]
            }
        }
    };
}

two_halves!(Portable, 4, 8);
two_halves!(Portable, 8, 16);

#[cfg(target_arch = "x86_64")]
mod x86 {
    use core::arch::x86_64::*;

    use super::super::level::{Avx2, Avx512};
    use super::Simd;

    /// The operations of AVX2 for a token that has it.
    macro_rules! eight_in_one {
        ($token:ty) => {
            impl Simd<8> for $token {
                type Lanes = __m256;
                type Mask = __m256;

                #[inline(always)]
                fn load(self, values: &[f32; 8]) -> __m256 {
                    bytemuck::cast(*values)
                }

                #[inline(always)]
                fn splat(self, value: f32) -> __m256 {
                    self.0.avx._mm256_set1_ps(value)
                }

                #[inline(always)]
                fn store(self, a: __m256) -> [f32; 8] {
                    bytemuck::cast(a)
                }

                binary!(Lanes -> Lanes:
                    add = |e, a, b| e.0.avx._mm256_add_ps(a, b),
                    sub = |e, a, b| e.0.avx._mm256_sub_ps(a, b),
                    mul = |e, a, b| e.0.avx._mm256_mul_ps(a, b),
                    div = |e, a, b| e.0.avx._mm256_div_ps(a, b),
                    min = |e, a, b| e.0.avx._mm256_min_ps(a, b),
                    max = |e, a, b| e.0.avx._mm256_max_ps(a, b),
                );
                binary!(Lanes -> Mask:
                    below = |e, a, b| e.0.avx._mm256_cmp_ps::<_CMP_LT_OQ>(a, b),
                    at_most = |e, a, b| e.0.avx._mm256_cmp_ps::<_CMP_LE_OQ>(a, b),
                    equal = |e, a, b| e.0.avx._mm256_cmp_ps::<_CMP_EQ_OQ>(a, b),
                );
                binary!(Mask -> Mask:
                    and = |e, a, b| e.0.avx._mm256_and_ps(a, b),
                    or = |e, a, b| e.0.avx._mm256_or_ps(a, b),
                    without = |e, a, b| e.0.avx._mm256_andnot_ps(b, a),
                );

                #[inline(always)]
                fn bits(self, mask: __m256) -> u32 {
                    self.0.avx._mm256_movemask_ps(mask) as u32
                }

                #[inline(always)]
                fn select(self, mask: __m256, yes: __m256, no: __m256) -> __m256 {
                    self.0.avx._mm256_blendv_ps(no, yes, mask)
                }
            }
        };
    }

    eight_in_one!(Avx2);
    eight_in_one!(Avx512);
    two_halves!(Avx2, 8, 16);

    impl Simd<16> for Avx512 {
        type Lanes = __m512;
        type Mask = __mmask16;

        #[inline(always)]
        fn load(self, values: &[f32; 16]) -> __m512 {
            bytemuck::cast(*values)
        }

        #[inline(always)]
        fn splat(self, value: f32) -> __m512 {
            self.0.avx512f._mm512_set1_ps(value)
        }

        #[inline(always)]
        fn store(self, a: __m512) -> [f32; 16] {
            bytemuck::cast(a)
        }

        binary!(Lanes -> Lanes:
            add = |e, a, b| e.0.avx512f._mm512_add_ps(a, b),
            sub = |e, a, b| e.0.avx512f._mm512_sub_ps(a, b),
            mul = |e, a, b| e.0.avx512f._mm512_mul_ps(a, b),
            div = |e, a, b| e.0.avx512f._mm512_div_ps(a, b),
            min = |e, a, b| e.0.avx512f._mm512_min_ps(a, b),
            max = |e, a, b| e.0.avx512f._mm512_max_ps(a, b),
        );
        binary!(Lanes -> Mask:
            below = |e, a, b| e.0.avx512f._mm512_cmp_ps_mask::<_CMP_LT_OQ>(a, b),
            at_most = |e, a, b| e.0.avx512f._mm512_cmp_ps_mask::<_CMP_LE_OQ>(a, b),
            equal = |e, a, b| e.0.avx512f._mm512_cmp_ps_mask::<_CMP_EQ_OQ>(a, b),
        );
        binary!(Mask -> Mask: and = |_e, a, b| a & b, or = |_e, a, b| a | b, without = |_e, a, b| a & !b);

        #[inline(always)]
        fn bits(self, mask: __mmask16) -> u32 {
            u32::from(mask)
        }

        #[inline(always)]
        fn select(self, mask: __mmask16, yes: __m512, no: __m512) -> __m512 {
            self.0.avx512f._mm512_mask_blend_ps(mask, no, yes)
        }

        #[inline(always)]
        fn least(self, a: __m512) -> f32 {
            self.0.avx512f._mm512_reduce_min_ps(a)
        }

        #[inline(always)]
        fn most(self, a: __m512) -> f32 {
            self.0.avx512f._mm512_reduce_max_ps(a)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::level::{Level, Vectors, Work};
    use super::*;

    struct All([f32; 16], [f32; 16]);

    impl Work for All {
        type Output = [Vec<u32>; 2];
        const SIXTEEN: bool = true;

        fn run<V: Vectors>(self, v: V) -> [Vec<u32>; 2] {
            let half = |values: &[f32; 16]| std::array::from_fn(|i| values[i]);
            [found::<8, V>(v, &half(&self.0), &half(&self.1)), found::<16, V>(v, &self.0, &self.1)]
        }
    }

    fn found<const N: usize, E: Simd<N>>(e: E, a: &[f32; N], b: &[f32; N]) -> Vec<u32> {
        let first = e.splat(a[0]);
        let (a, b) = (e.load(a), e.load(b));
        let (below, at_most, equal) = (e.below(a, b), e.at_most(a, b), e.equal(a, b));
        let masks =
            [below, at_most, equal, e.and(below, at_most), e.or(below, equal), e.without(at_most, below)];
        let sums = [e.add(a, b), e.sub(a, b), e.mul(a, b), e.div(a, b), first];
        let chosen = [e.min(a, b), e.max(a, b), e.select(below, a, b)];
        let bits_of = |v: f32| if v.is_nan() { 1 } else { v.to_bits() };
        let values = sums.iter().chain(&chosen).flat_map(|&r| e.store(r).map(bits_of));
        values.chain(masks.map(|m| e.bits(m))).collect()
    }

    #[test]
    fn all_copies_find_the_same_bits() {
        let some = [0.0, -0.0, 1.5, -3e38, f32::INFINITY, f32::NEG_INFINITY, f32::NAN, 1e-40];
        let values: [f32; 16] = std::array::from_fn(|i| some[i % 8] * if i < 8 { 1.0 } else { 1.25 });
        for shift in 0..16 {
            let mut other = values;
            other.rotate_left(shift);
            let all: Vec<_> = Level::all().into_iter().map(|level| level.run(All(values, other))).collect();
            assert!(all.iter().all(|found| *found == all[0]), "{shift}: {all:?}");
        }
    }
}
