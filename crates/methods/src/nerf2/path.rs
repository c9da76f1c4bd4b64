//! What is left of a wave from each sample of a ray on its way to the receiver, and how far it has turned ([`Law`]); and
//! what the samples emit towards the receiver: Σ s·exp(jψ)·c.

use pwrfgs_core::{Real, consts};

/// What NeRF2 adds to 1 − α before it multiplies.
const SPARE: Real = 1e-10;
/// The last step has no end.
const ENDLESS: Real = 1e10;
/// Where less than this is left of the amplitude, what lies behind counts nothing.
const DARK: Real = 1e-12;

/// How attenuation becomes a complex factor c of what a sample emits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Law {
    /// The spectrum's: alpha compositing before the sample, phases by length, amplitudes as 0.025 over the distance.
    Spectrum,
    /// The power's and the channel's: attenuation up to and with the sample, phases of the room and of the wave.
    Wave {
        /// Radians that the wave turns over a unit of length.
        wavenumber: Real,
    },
}

/// |leaky ReLU|, the amplitude of a raw output.
pub(crate) fn amplitude(x: Real) -> Real {
    if x > 0.0 { x } else { -0.01 * x }
}

/// Its derivative; 0 at 0, as the slope of |x| there.
pub(crate) fn amplitude_slope(x: Real) -> Real {
    if x > 0.0 {
        1.0
    } else if x < 0.0 {
        -0.01
    } else {
        0.0
    }
}

/// 2π σ(x).
pub(crate) fn turn(x: Real) -> Real {
    2.0 * consts::PI / (1.0 + (-x).exp())
}

/// Its derivative, of what [`turn`] gave.
pub(crate) fn turn_slope(turned: Real) -> Real {
    turned * (1.0 - turned / (2.0 * consts::PI))
}

impl Law {
    /// What is taken from the phases of what samples emit: those of powers and channels lie from −π to π.
    pub(crate) fn phase_offset(self) -> Real {
        if self == Self::Spectrum { 0.0 } else { consts::PI }
    }

    /// Lengths of the steps between samples.
    fn step(samples: &[Real], i: usize) -> Real {
        samples.get(i + 1).map_or(ENDLESS, |next| next - samples[i])
    }

    /// Factors `[n, 2]` of the samples of a ray, given raw attenuations and phases `[n]`; gives how many samples count.
    pub(crate) fn factors(
        self,
        samples: &[Real],
        raw: &[Real],
        raw_phase: &[Real],
        factors: &mut [[Real; 2]],
    ) -> usize {
        let (mut log, mut phase) = (0.0, if self == Self::Spectrum { 1.0 } else { 0.0 });
        let limit = DARK.ln();
        for (i, factor) in factors.iter_mut().enumerate() {
            let step = Self::step(samples, i);
            let (loss, turned) = (amplitude(raw[i]) * step, turn(raw_phase[i]));
            let strength = match self {
                Self::Spectrum => {
                    let next = samples.get(i + 1).map_or(ENDLESS, |next| *next);
                    0.025 / next
                }
                // Nothing comes through an endless step, but for an attenuation of exactly nothing.
                Self::Wave { .. } if i + 1 == samples.len() => return i,
                Self::Wave { wavenumber } => {
                    log -= loss;
                    phase += turned - consts::PI + wavenumber * step;
                    1.0
                }
            };
            if log < limit {
                return i;
            }
            let size = strength * log.exp();
            *factor = [size * phase.cos(), size * phase.sin()];
            if self == Self::Spectrum {
                log += ((-loss).exp() + SPARE).ln();
                phase += turned * step;
            }
        }
        factors.len()
    }

    /// Cotangents of the raw numbers, given those `d` of the first `d.len()` factors; the others are 0.
    pub(crate) fn factors_vjp(
        self,
        samples: &[Real],
        [raw, raw_phase]: [&[Real]; 2],
        factors: &[[Real; 2]],
        d: &[[Real; 2]],
        [d_raw, d_raw_phase]: [&mut [Real]; 2],
    ) {
        d_raw.fill(0.0);
        d_raw_phase.fill(0.0);
        // Of the logarithm of the size and of the phase, summed from the far end.
        let (mut size, mut phase) = (0.0, 0.0);
        for i in (0..d.len()).rev() {
            let step = Self::step(samples, i);
            let (rate, turned) = (amplitude(raw[i]), turn(raw_phase[i]));
            let own =
                (d[i][0] * factors[i][0] + d[i][1] * factors[i][1], d[i][1] * factors[i][0] - d[i][0] * factors[i][1]);
            match self {
                Self::Spectrum => {
                    let left = (-rate * step).exp();
                    d_raw[i] = -step * left / (left + SPARE) * size * amplitude_slope(raw[i]);
                    d_raw_phase[i] = step * phase * turn_slope(turned);
                    size += own.0;
                    phase += own.1;
                }
                Self::Wave { .. } => {
                    size += own.0;
                    phase += own.1;
                    d_raw[i] = -step * size * amplitude_slope(raw[i]);
                    d_raw_phase[i] = phase * turn_slope(turned);
                }
            }
        }
    }
}

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
