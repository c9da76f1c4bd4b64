//! What the samples of a ray emit towards the receiver: Σ s·exp(jψ)·c.

use crate::nerf2::path::{amplitude, amplitude_slope, turn, turn_slope};
use pwrfgs_core::Real;

/// Σ over samples, given raw amplitudes and phases `[n]` and the factors of the path; `back` is taken from the phase.
pub(crate) fn sum(raw: &[Real], raw_phase: &[Real], factors: &[[Real; 2]], back: Real) -> [Real; 2] {
    let mut total = [0.0; 2];
    for ((raw, raw_phase), c) in raw.iter().zip(raw_phase).zip(factors) {
        let (sin, cos) = (turn(*raw_phase) - back).sin_cos();
        let s = amplitude(*raw);
        total[0] += s * (cos * c[0] - sin * c[1]);
        total[1] += s * (cos * c[1] + sin * c[0]);
    }
    total
}

/// Cotangents of the raw numbers (written) and of the factors (added), given that of the sum.
pub(crate) fn sum_vjp(
    [raw, raw_phase]: [&[Real]; 2],
    factors: &[[Real; 2]],
    back: Real,
    d: [Real; 2],
    [d_raw, d_raw_phase]: [&mut [Real]; 2],
    d_factors: &mut [[Real; 2]],
) {
    for i in 0..factors.len() {
        let turned = turn(raw_phase[i]);
        let (sin, cos) = (turned - back).sin_cos();
        let (s, c) = (amplitude(raw[i]), factors[i]);
        let (re, im) = (cos * c[0] - sin * c[1], cos * c[1] + sin * c[0]);
        d_raw[i] = (d[0] * re + d[1] * im) * amplitude_slope(raw[i]);
        d_raw_phase[i] = s * (d[1] * re - d[0] * im) * turn_slope(turned);
        d_factors[i][0] += s * (d[0] * cos + d[1] * sin);
        d_factors[i][1] += s * (d[1] * cos - d[0] * sin);
    }
}
