use xxhash_rust::xxh3::Xxh3;

use super::*;
use crate::rng::Stream;

/// A function of f32 and the same in f64.
type Pair = (&'static str, fn(f32, f32) -> f32, fn(f64, f64) -> f64);

macro_rules! pairs {
    ($($name:ident $arguments:tt),+) => {
        [$((stringify!($name), |x, y| { let _ = y; pairs!(@ $name $arguments x y) },
            |x, y| { let _ = y; pairs!(@ $name $arguments x y) })),+]
    };
    (@ $name:ident (x) $x:ident $y:ident) => { $name($x) };
    (@ $name:ident (x, y) $x:ident $y:ident) => { $name($x, $y) };
}

const ALL: [Pair; 15] = pairs!(
    sin(x),
    cos(x),
    tan(x),
    asin(x),
    acos(x),
    atan(x),
    atan2(x, y),
    hypot(x, y),
    exp(x),
    exp2(x),
    ln(x),
    log2(x),
    log10(x),
    powf(x, y),
    cbrt(x)
);

/// Arguments of the i-th trial: of any size, of the size of angles, around 1, and below it.
fn arguments(i: u64) -> [f32; 2] {
    let mut stream = Stream::new(11, i, 0);
    let any = f32::from_bits(stream.next_u64() as u32);
    let [u, v] = stream.next_2d();
    let y = 8.0 * v - 4.0;
    match i % 4 {
        0 => [any, y],
        1 => [14.0 * u - 7.0, y],
        2 => [1.0 + (u - 0.5) * (u - 0.5) * (u - 0.5), 300.0 * y],
        _ => [2.0 * u - 1.0, y],
    }
}

/// How far `found` is from `exact`, in units of its last place.
fn units(found: f32, exact: f64) -> f64 {
    let exact = exact.clamp(-f64::from(f32::MAX), f64::from(f32::MAX));
    let found = found.clamp(-f32::MAX, f32::MAX);
    let unit = f64::from(found.abs().next_up()) - f64::from(found.abs());
    (f64::from(found) - exact).abs() / if unit.is_finite() { unit } else { 2f64.powi(104) }
}

/// What stands in place of `libm`'s single precision is nearer to the exact value than that: hardly more than rounding.
#[test]
fn polynomials_are_off_by_half_a_unit() {
    for (name, single, double) in ALL {
        let ours = ["sin", "cos", "exp", "exp2", "ln", "log2", "log10", "powf"].contains(&name);
        let mut worst = (0.0, [0.0; 2]);
        for i in 0..200_000 {
            let [x, y] = arguments(i);
            let (found, exact) = (single(x, y), double(f64::from(x), f64::from(y)));
            assert_eq!(found.is_nan(), exact.is_nan(), "{name}({x}, {y}): {found} instead of {exact}");
            let units = if exact.is_nan() { 0.0 } else { units(found, exact) };
            worst = if units > worst.0 { (units, [x, y]) } else { worst };
        }
        assert!(worst.0 < if ours { 0.52 } else { 1.5 }, "{name}: {worst:?}");
    }
}

#[test]
fn edges_are_those_of_the_standard() {
    let edges =
        [0.0, -0.0, 1.0, -1.0, 2.0, -2.0, 0.5, 3.0, -3.0, 1e-45, f32::MAX, f32::INFINITY, f32::NEG_INFINITY];
    for (name, single, double) in ALL {
        for x in edges.into_iter().chain([f32::NAN]) {
            for y in edges.into_iter().chain([f32::NAN]) {
                let (found, exact) = (single(x, y), double(f64::from(x), f64::from(y)) as f32);
                let same = found == exact && found.is_sign_negative() == exact.is_sign_negative();
                let near = found.is_finite() && (found - exact).abs() <= 2e-7 * exact.abs();
                assert!(
                    same || near || found.is_nan() && exact.is_nan(),
                    "{name}({x}, {y}): {found}, {exact}"
                );
            }
        }
    }
    assert_eq!(
        [powf(3.0f32, 4.0), powf(0.25f32, 1.5), exp2(-149.0f32), exp(0.0f32)],
        [81.0, 0.125, 1e-45, 1.0]
    );
    assert_eq!([ln(1.0f32), log2(0.125f32), log10(1000.0f32), log2(1e-45f32)], [0.0, -3.0, 3.0, -149.0]);
}

/// The bits of 4,000 results of each function, as computed on x86-64. A machine that computes others cannot replay
/// what was recorded on this one; a change here needs the recordings made anew.
#[test]
fn bits_are_known() {
    let known: [(&str, u64); 15] = [
        ("sin", 0x9e9b_028e_8626_0dff),
        ("cos", 0xbb2f_4b7b_86b7_d249),
        ("tan", 0x1e2b_980c_c00b_8543),
        ("asin", 0x4cd1_5469_9d99_4d7e),
        ("acos", 0xd30f_04e1_79a2_9b5c),
        ("atan", 0xab8c_b5ed_a93b_b979),
        ("atan2", 0x1204_1ec5_2cde_4e01),
        ("hypot", 0x2260_a16e_23fb_b42e),
        ("exp", 0x3587_085c_4788_17aa),
        ("exp2", 0x2991_61dc_9f03_42ef),
        ("ln", 0x8577_f05b_8dd0_c156),
        ("log2", 0x9010_0006_aba8_8918),
        ("log10", 0xecac_6d6f_d35d_0430),
        ("powf", 0x10f1_4c5a_73a4_c996),
        ("cbrt", 0x4d55_9546_63e4_331b),
    ];
    let digests = ALL.map(|(name, single, double)| {
        let mut bits = Xxh3::new();
        for i in 0..4000 {
            let [x, y] = arguments(i);
            // What kind of NaN comes out is the processor's choice.
            let (a, b) = (single(x, y), double(f64::from(x), f64::from(y)));
            bits.update(&if a.is_nan() { 0 } else { a.to_bits() }.to_le_bytes());
            bits.update(&if b.is_nan() { 0 } else { b.to_bits() }.to_le_bytes());
        }
        (name, bits.digest())
    });
    assert_eq!(digests, known, "{digests:#x?}");
    let one_by_one = arguments(2)[0];
    assert_eq!(sin_cos(one_by_one), (sin(one_by_one), cos(one_by_one)));
    let double = f64::from(one_by_one);
    assert_eq!(sin_cos(double), (sin(double), cos(double)));
}

#[test]
fn the_floor_is_the_one_of_the_standard_library() {
    let mut some: Vec<f32> = (0..20_000).map(|i| f32::from_bits(crate::rng::hash(1, i, 2) as u32)).collect();
    for whole in [0.0, 1.0, 2.0, 255.0, 8_388_607.0, 8_388_608.0, 16_777_216.0, f32::INFINITY] {
        some.extend(
            [whole, whole.next_down(), whole.next_up(), whole + 0.5].into_iter().flat_map(|v| [v, -v]),
        );
    }
    for x in some {
        let (ours, known) = (floor(x), x.floor());
        assert!(ours == known || ours.is_nan() && known.is_nan(), "{x}: {ours} {known}");
    }
}
