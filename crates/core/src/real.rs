//! The one floating-point type of all kernels.
//!
//! `f32` by default; the crate feature `f64` turns every formula into double precision so that hand-written
//! derivatives can be checked against central differences. Feature-gated rather than generic: a kernel stays a
//! formula one can read.

/// Single precision, or double with the feature `f64`.
#[cfg(not(feature = "f64"))]
pub type Real = f32;
/// Single precision, or double with the feature `f64`.
#[cfg(feature = "f64")]
pub type Real = f64;

/// Three numbers: a position or direction, in metres unless said otherwise.
#[cfg(not(feature = "f64"))]
pub type Vec3 = glam::Vec3;
/// Three numbers: a position or direction, in metres unless said otherwise.
#[cfg(feature = "f64")]
pub type Vec3 = glam::DVec3;

/// A 3x3 matrix, stored by columns.
#[cfg(not(feature = "f64"))]
pub type Mat3 = glam::Mat3;
/// A 3x3 matrix, stored by columns.
#[cfg(feature = "f64")]
pub type Mat3 = glam::DMat3;

/// The numbers π and 2π, and the conversion from radians to degrees, at the precision of [`Real`].
pub mod consts {
    use super::Real;
    /// π.
    pub const PI: Real = std::f64::consts::PI as Real;
    /// 2π.
    pub const TAU: Real = std::f64::consts::TAU as Real;
    /// Degrees in a radian.
    pub const DEG: Real = 180.0 / PI;
    /// ln 10.
    pub const LN_10: Real = std::f64::consts::LN_10 as Real;
}

/// The logistic function σ(x) = 1/(1 + e⁻ˣ).
#[inline]
pub fn sigmoid(x: Real) -> Real {
    if x >= 0.0 {
        1.0 / (1.0 + (-x).exp())
    } else {
        let e = x.exp();
        e / (1.0 + e)
    }
}

/// The inverse of [`sigmoid`]: ln(p/(1-p)) for p in (0, 1).
#[inline]
pub fn logit(p: Real) -> Real {
    (p / (1.0 - p)).ln()
}
