//! Draws in double precision from the streams of `pwrfgs_core::rng`, whose own draws have the precision of the model.

use pwrfgs_core::rng::{self, Rng};
use std::f64::consts::TAU;

/// Uniform in [0, 1), with 53 bits.
pub(crate) fn uniform(random: &mut Rng) -> f64 {
    rng::below(random, 1 << 53) as f64 / (1u64 << 53) as f64
}

/// Standard normal (Box and Muller), two uniforms a draw.
pub(crate) fn normal(random: &mut Rng) -> f64 {
    let u = 1.0 - uniform(random);
    (-2.0 * u.ln()).sqrt() * (TAU * uniform(random)).cos()
}
