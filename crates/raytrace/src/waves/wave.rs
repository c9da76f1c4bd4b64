//! What every wave needs.

/// A complex number in double precision.
pub type Complex = num_complex::Complex<f64>;

/// Speed of light in vacuum, m/s.
pub const SPEED_OF_LIGHT: f64 = 299_792_458.0;
