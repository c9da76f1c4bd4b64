//! Attenuation and phase ([`PropagationLaw`]) from each sample of a ray to the receiver, and the received sum of the
//! emissions: Σ s·exp(jψ)·c.

use pwrfgs_core::{Real, consts};
use pwrfgs_networks::dense::{amplitude, amplitude_slope};

/// Constant that NeRF2 adds to 1 − α in the product.
const EPSILON: Real = 1e-10;
/// Amplitude of a spectrum at distance 1, as released.
const AMPLITUDE: Real = 0.025;
/// Length of the last step, as released.
const ENDLESS: Real = 1e10;
/// Smallest remaining amplitude; samples behind it are ignored.
const DARK: Real = 1e-12;

/// Conversion of attenuation to the complex factor c of an emission.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum PropagationLaw {
    /// Spectra: alpha compositing in front of the sample, phases by length, amplitudes as 0.025 over the distance of the
    /// next sample.
    Spectrum,
    /// Powers and channels: attenuation up to and including the sample, phases of the medium and of the wave.
    Wave {
        /// Phase per unit length, radians.
        wavenumber: Real,
    },
}

/// Returns the phase 2π σ(x) of a raw network output, radians.
pub(crate) fn phase_turn(x: Real) -> Real {
    2.0 * consts::PI / (1.0 + (-x).exp())
}

/// Returns the derivative of [`phase_turn`], given its result.
pub(crate) fn phase_turn_slope(turned: Real) -> Real {
    turned * (1.0 - turned / (2.0 * consts::PI))
}

impl PropagationLaw {
    /// Returns the offset, radians, that is subtracted from the phases of emissions: π for powers and channels, whose phases are
    /// in −π to π; 0 for spectra.
    pub(crate) fn phase_offset(self) -> Real {
        if self == Self::Spectrum { 0.0 } else { consts::PI }
    }

    /// Returns the length of the step after sample `i`, in the network's unit; [`ENDLESS`] after the last.
    fn step_length(samples: &[Real], i: usize) -> Real {
        samples.get(i + 1).map_or(ENDLESS, |next| next - samples[i])
    }

    /// Computes the complex factors `[n, 2]` from the samples of a ray to the receiver, given raw attenuations and phases
    /// `[n]`. Returns the number of samples in use: those before the remaining amplitude falls below [`DARK`], without the last
    /// sample of a wave. Other factors are unchanged.
    pub(crate) fn fill_factors(self, samples: &[Real], raw: [&[Real]; 2], factors: &mut [[Real; 2]]) -> usize {
        let [raw, raw_phase] = raw;
        // As released: the phase of a spectrum begins at 1 radian.
        let (mut log, mut phase) = (0.0, if self == Self::Spectrum { 1.0 } else { 0.0 });
        let limit = DARK.ln();
        for (i, factor) in factors.iter_mut().enumerate() {
            let step = Self::step_length(samples, i);
            let (loss, turned) = (amplitude(raw[i]) * step, phase_turn(raw_phase[i]));
            let strength = match self {
                Self::Spectrum => {
                    let next = samples.get(i + 1).map_or(ENDLESS, |next| *next);
                    AMPLITUDE / next
                }
                // The infinite last step transmits nothing, unless its attenuation is exactly zero.
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
                log += ((-loss).exp() + EPSILON).ln();
                phase += turned * step;
            }
        }
        factors.len()
    }

    /// Sets the cotangents `d_raw` and `d_raw_phase`, given those `d` of the first `d.len()` factors; those of the other
    /// factors are 0.
    pub(crate) fn fill_factors_vjp(
        self,
        samples: &[Real],
        [raw, raw_phase]: [&[Real]; 2],
        factors: &[[Real; 2]],
        d: &[[Real; 2]],
        [d_raw, d_raw_phase]: [&mut [Real]; 2],
    ) {
        d_raw.fill(0.0);
        d_raw_phase.fill(0.0);
        // Cotangents of the logarithm of the magnitude and of the phase, summed from the far end.
        let (mut size, mut phase) = (0.0, 0.0);
        for i in (0..d.len()).rev() {
            let step = Self::step_length(samples, i);
            let (rate, turned) = (amplitude(raw[i]), phase_turn(raw_phase[i]));
            let (d_size, d_phase) =
                (d[i][0] * factors[i][0] + d[i][1] * factors[i][1], d[i][1] * factors[i][0] - d[i][0] * factors[i][1]);
            match self {
                Self::Spectrum => {
                    let left = (-rate * step).exp();
                    d_raw[i] = -step * left / (left + EPSILON) * size * amplitude_slope(raw[i]);
                    d_raw_phase[i] = step * phase * phase_turn_slope(turned);
                    size += d_size;
                    phase += d_phase;
                }
                Self::Wave { .. } => {
                    size += d_size;
                    phase += d_phase;
                    d_raw[i] = -step * size * amplitude_slope(raw[i]);
                    d_raw_phase[i] = phase * phase_turn_slope(turned);
                }
            }
        }
    }
}

/// Returns the received sum over the samples of a ray, given raw amplitudes and phases `[n]` and the factors of the path.
/// `phase_offset` (radians) is subtracted from each phase after its conversion from the raw value.
pub(crate) fn ray_sum([raw, raw_phase]: [&[Real]; 2], factors: &[[Real; 2]], phase_offset: Real) -> [Real; 2] {
    let mut total = [0.0; 2];
    for ((raw, raw_phase), c) in raw.iter().zip(raw_phase).zip(factors) {
        let (sin, cos) = (phase_turn(*raw_phase) - phase_offset).sin_cos();
        let s = amplitude(*raw);
        total[0] += s * (cos * c[0] - sin * c[1]);
        total[1] += s * (cos * c[1] + sin * c[0]);
    }
    total
}

/// Computes the derivative of [`ray_sum`], given the cotangent `d` of the sum: sets the cotangents of the raw values, adds
/// those of the factors.
pub(crate) fn ray_sum_vjp(
    [raw, raw_phase]: [&[Real]; 2],
    factors: &[[Real; 2]],
    phase_offset: Real,
    d: [Real; 2],
    [d_raw, d_raw_phase]: [&mut [Real]; 2],
    d_factors: &mut [[Real; 2]],
) {
    for i in 0..factors.len() {
        let turned = phase_turn(raw_phase[i]);
        let (sin, cos) = (turned - phase_offset).sin_cos();
        let (s, c) = (amplitude(raw[i]), factors[i]);
        let (re, im) = (cos * c[0] - sin * c[1], cos * c[1] + sin * c[0]);
        d_raw[i] = (d[0] * re + d[1] * im) * amplitude_slope(raw[i]);
        d_raw_phase[i] = s * (d[1] * re - d[0] * im) * phase_turn_slope(turned);
        d_factors[i][0] += s * (d[0] * cos + d[1] * sin);
        d_factors[i][1] += s * (d[1] * cos - d[0] * sin);
    }
}
