//! The sets of instructions that traversal is compiled for, chosen at run time: AVX-512, AVX2, and what every processor
//! has. None fuses or reorders an operation, so all find the same bits.
//!
//! What is there is asked once per tree. `pulp`'s tokens stand for the answer, so that their intrinsics are safe to call.

use super::simd::Simd;

/// Instructions for eight and for sixteen numbers at once.
pub(super) trait Vectors: Simd<8> + Simd<16> {}

impl<V: Simd<8> + Simd<16>> Vectors for V {}

/// Four at once, on any processor.
#[derive(Clone, Copy, Debug)]
pub(super) struct Portable;

/// Eight at once.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy, Debug)]
pub(super) struct Avx2(pub pulp::x86::V3);

/// Sixteen at once.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy, Debug)]
pub(super) struct Avx512(pub pulp::x86::V4);

/// What this processor has.
#[derive(Clone, Copy, Debug)]
pub(super) struct Level {
    #[cfg(target_arch = "x86_64")]
    avx2: Option<pulp::x86::V3>,
    #[cfg(target_arch = "x86_64")]
    avx512: Option<pulp::x86::V4>,
}

/// Work to be compiled for each set of instructions.
pub(super) trait Work {
    type Output;
    /// Whether registers of sixteen numbers are of use; work on eight is no faster with them and takes long to compile.
    const SIXTEEN: bool;
    fn run<V: Vectors>(self, vectors: V) -> Self::Output;
}

impl Level {
    /// Asks the processor.
    pub fn detect() -> Self {
        Self {
            #[cfg(target_arch = "x86_64")]
            avx2: pulp::x86::V3::try_new(),
            #[cfg(target_arch = "x86_64")]
            avx512: pulp::x86::V4::try_new(),
        }
    }

    /// All that there are here, the best first; the last is what every processor has.
    #[cfg(test)]
    pub fn all() -> Vec<Self> {
        let mut level = Self::detect();
        let mut all = vec![level];
        #[cfg(target_arch = "x86_64")]
        {
            level.avx512 = None;
            all.push(level);
            level.avx2 = None;
        }
        all.push(level);
        all
    }

    /// Runs the best copy.
    #[inline(always)]
    pub fn run<W: Work>(self, work: W) -> W::Output {
        #[cfg(target_arch = "x86_64")]
        {
            struct Compiled<W, V>(W, V);
            impl<W: Work, V: Vectors> pulp::NullaryFnOnce for Compiled<W, V> {
                type Output = W::Output;

                #[inline(always)]
                fn call(self) -> W::Output {
                    self.0.run(self.1)
                }
            }
            if W::SIXTEEN
                && let Some(avx512) = self.avx512
            {
                return avx512.vectorize(Compiled(work, Avx512(avx512)));
            }
            if let Some(avx2) = self.avx2 {
                return avx2.vectorize(Compiled(work, Avx2(avx2)));
            }
        }
        work.run(Portable)
    }
}

impl Default for Level {
    fn default() -> Self {
        Self::detect()
    }
}
