//! Do numbers have the same bits on two machines? Those of whoever traces together must.

use foveal::math;
use xxhash_rust::xxh3::Xxh3;

/// Arguments of each function.
const ARGUMENTS: u32 = 4096;

/// A hash of what the mathematical functions of tracing give at some thousand places each.
pub fn probe() -> u64 {
    let mut h = Xxh3::new();
    let mut add = |value: f32| h.update(&value.to_bits().to_le_bytes());
    for i in 0..ARGUMENTS {
        // Places that no rounding makes regular.
        let x = foveal::rng::unit_f32(foveal::rng::hash(0x00b1_75b1_7500_0001, u64::from(i), 0));
        let (wide, signed) = (x * 64.0, x * 2.0 - 1.0);
        for value in [
            math::sin(wide),
            math::cos(wide),
            math::exp(-wide),
            math::ln(x + 1e-6),
            math::powf(x, wide),
            math::atan2(signed, x + 1e-3),
            math::acos(signed),
            wide.sqrt(),
            wide * 0.3 + signed / (x + 0.5),
        ] {
            add(value);
        }
    }
    h.digest()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whoever changes a function of the core changes this; machines that differ differ here.
    #[test]
    fn the_probe_is_a_number_of_the_program() {
        assert_eq!(probe(), probe());
        assert_ne!(probe(), 0);
    }
}
