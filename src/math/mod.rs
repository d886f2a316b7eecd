//! Functions of analysis whose bits are the same on every processor and with every C library.
//!
//! Those of the standard library are the system's, which differ in last bits by version and by what the processor
//! offers, and a recorded walk would no longer replay. Here all are made of IEEE operations in a fixed order, none
//! of them fused: the crate `libm` and, where the tracer asks often, `single`. What IEEE defines exactly (`sqrt`,
//! `mul_add`, `%`, rounding) and `powi`, which multiplies, stay the standard library's. `clippy.toml` refuses the
//! others, also where glam hides them. (glam's feature `libm` would turn its square roots into calls.)

mod single;

macro_rules! functions {
    ($($name:ident($($argument:ident),+): $single:path, $double:path, $doc:literal;)+) => {
        /// A floating-point type with these functions.
        pub trait Real: Copy {
            $(#[doc = $doc] fn $name($($argument: Self),+) -> Self;)+
            /// Sine and cosine.
            fn sin_cos(x: Self) -> (Self, Self);
        }

        impl Real for f32 {
            $(#[inline] fn $name($($argument: Self),+) -> Self { $single($($argument),+) })+
            #[inline]
            fn sin_cos(x: Self) -> (Self, Self) {
                single::sin_cos(x)
            }
        }

        impl Real for f64 {
            $(#[inline] fn $name($($argument: Self),+) -> Self { $double($($argument),+) })+
            #[inline]
            fn sin_cos(x: Self) -> (Self, Self) {
                libm::sincos(x)
            }
        }

        $(#[doc = $doc] #[inline] pub fn $name<T: Real>($($argument: T),+) -> T { T::$name($($argument),+) })+
    };
}

functions! {
    sin(x): single::sin, libm::sin, "The sine of an angle in radians.";
    cos(x): single::cos, libm::cos, "The cosine of an angle in radians.";
    tan(x): libm::tanf, libm::tan, "The tangent of an angle in radians.";
    asin(x): libm::asinf, libm::asin, "The angle of a sine, in [−π/2, π/2].";
    acos(x): libm::acosf, libm::acos, "The angle of a cosine, in [0, π].";
    atan(x): libm::atanf, libm::atan, "The angle of a tangent, in [−π/2, π/2].";
    atan2(y, x): libm::atan2f, libm::atan2, "The angle of (x, y), in [−π, π].";
    hypot(x, y): libm::hypotf, libm::hypot, "The length of (x, y), without overflow on the way.";
    exp(x): single::exp, libm::exp, "eˣ.";
    exp2(x): single::exp2, libm::exp2, "2ˣ.";
    ln(x): single::ln, libm::log, "The natural logarithm.";
    log2(x): single::log2, libm::log2, "The logarithm to base 2.";
    log10(x): single::log10, libm::log10, "The logarithm to base 10.";
    powf(x, y): single::powf, libm::pow, "xʸ.";
    cbrt(x): libm::cbrtf, libm::cbrt, "The cube root.";
}

/// Sine and cosine of an angle in radians.
#[inline]
pub fn sin_cos<T: Real>(x: T) -> (T, T) {
    T::sin_cos(x)
}

/// The greatest whole number that is not above `x`: the standard library's, bit for bit but for the sign of zero, without
/// the call that it is on processors without an instruction for it.
#[inline]
pub fn floor(x: f32) -> f32 {
    /// From here on all numbers are whole.
    const WHOLE: f32 = 8_388_608.0;
    if x.abs() < WHOLE {
        let towards_zero = x as i32 as f32;
        if towards_zero > x { towards_zero - 1.0 } else { towards_zero }
    } else {
        x
    }
}

#[cfg(test)]
mod tests;
