//! Readout: from blended signals to a spectrum, and the backward pass.

use pwrfgs_core::stretch::{gain, range};
use pwrfgs_core::{JsonSchema, Real, Task};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Conversion of the two real channels of a blended signal to one pixel value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub enum Readout {
    /// First channel only, as in WRF-GS.
    Real,
    /// Magnitude √(c₀² + c₁²), as in P-WRFGS, since the files hold amplitudes. Its derivative at (0, 0) is 0, because
    /// most pixels of a sparse spectrum are empty and must not give NaN.
    #[default]
    Magnitude,
    /// Power c₀² + c₁², eq. (2) of the paper.
    Power,
    /// Magnitude m of each spectrum, scaled from its smallest to its largest value: (m - min)/(max - min). The measured
    /// files are scaled in this way, so that absolute power is neither needed nor learned. Every spectrum then contains
    /// a 0 and a 1. If all directions are equally strong, the result is zero without derivative. Differentiable if
    /// smallest and largest pixel are unique; otherwise the first one counts.
    MinMax,
    /// Received power in dBm: 10 log₁₀ of c₀² + c₁² integrated over solid angle, plus a learned offset and path-loss
    /// term per receiver. The sky is a grid of directions with a pixel size of `sky_deg`.
    ReceivedPower {
        /// Pixel size of the sky, degrees; a divisor of 180.
        #[serde(default = "default_sky_deg")]
        sky_deg: u32,
        /// Variance added to both diagonal entries of the 2-D covariance of a Gaussian on this sky, in place of the
        /// projector's filter, degrees².
        #[serde(default = "default_filter_deg2")]
        filter_deg2: Real,
    },
}

/// Returns the default of `sky_deg`, degrees; a received power needs no finer sky.
const fn default_sky_deg() -> u32 {
    10
}

/// Returns the default of `filter_deg2`, degrees²: a standard deviation of half a pixel of 10 degrees. Narrower Gaussians
/// would fall between pixels.
const fn default_filter_deg2() -> Real {
    30.0
}

impl Readout {
    /// Readout of a received power with the standard settings.
    pub const RECEIVED: Self = Self::ReceivedPower { sky_deg: default_sky_deg(), filter_deg2: default_filter_deg2() };

    /// Returns the measurement type of the output.
    pub fn task(self) -> Task {
        match self {
            Self::ReceivedPower { .. } => Task::Power,
            _ => Task::Spectrum,
        }
    }

    /// Checks the settings of a received power.
    ///
    /// # Errors
    /// `sky_deg` or `filter_deg2` is out of range; the message states the valid values.
    pub fn check(self) -> Result<(), String> {
        match self {
            Self::ReceivedPower { sky_deg, .. } if sky_deg == 0 || !180u32.is_multiple_of(sky_deg) || sky_deg > 60 => {
                Err(format!("readout: `sky_deg` is {sky_deg}; give a divisor of 180 up to 60, such as 10"))
            }
            Self::ReceivedPower { filter_deg2, .. } if !(filter_deg2 > 0.0 && filter_deg2 <= 1e4) => Err(format!(
                "readout: `filter_deg2` is {filter_deg2}; give degrees² above 0 and up to 10000, such as 30"
            )),
            _ => Ok(()),
        }
    }

    /// Returns the number of channels per transmitter.
    pub fn channel_count(self) -> usize {
        if self == Self::Real { 1 } else { 2 }
    }

    /// Returns the pixel values `[B, H·W]` of blended signals `[B·channels, H·W]`; `pixels` is H·W.
    pub fn forward(self, signals: &[Real], pixels: usize) -> Vec<Real> {
        if self == Self::Real {
            return signals.to_vec();
        }
        let mut image = vec![0.0; signals.len() / 2];
        let images = image.par_chunks_exact_mut(pixels).zip(signals.par_chunks_exact(2 * pixels));
        images.for_each(|(image, pair)| {
            fill_powers(image, pair.split_at(pixels));
            match self {
                Self::MinMax => {
                    let (darkest, brightest) = range(image);
                    stretch_roots(image, darkest.sqrt(), brightest.sqrt());
                }
                Self::Magnitude => stretch_roots(image, 0.0, 1.0),
                _ => {}
            }
        });
        image
    }

    /// Returns the derivative of each pixel value with respect to its channels, `[channels, H·W]`, for one transmitter;
    /// that of [`Self::MinMax`] treats the smallest and the largest value as constants.
    pub(crate) fn pixel_slopes(self, signals: &[Real], pixels: usize) -> Vec<Real> {
        let gain = if self == Self::MinMax {
            let mut image = vec![0.0; pixels];
            fill_powers(&mut image, signals.split_at(pixels));
            let (low, high) = range(&image);
            gain(low.sqrt(), high.sqrt())
        } else {
            1.0
        };
        let readout = if self == Self::MinMax { Self::Magnitude } else { self };
        readout.vjp(signals, pixels, &vec![gain; pixels])
    }

    /// Returns the cotangents of the signals `[B·channels, H·W]`, given those `[B, H·W]` of the pixel values.
    pub fn vjp(self, signals: &[Real], pixels: usize, d_image: &[Real]) -> Vec<Real> {
        if self == Self::Real {
            return d_image.to_vec();
        }
        let mut d = vec![0.0; signals.len()];
        let images = (d.par_chunks_exact_mut(2 * pixels))
            .zip(signals.par_chunks_exact(2 * pixels))
            .zip(d_image.par_chunks_exact(pixels));
        images.for_each_init(
            || (Vec::new(), Vec::new()),
            |(magnitude, d_magnitude), ((d, pair), d_image)| {
                let ((c0, c1), (d0, d1)) = (pair.split_at(pixels), d.split_at_mut(pixels));
                if self == Self::Power {
                    for (((d0, d1), (c0, c1)), d) in d0.iter_mut().zip(d1).zip(c0.iter().zip(c1)).zip(d_image) {
                        (*d0, *d1) = (2.0 * c0 * d, 2.0 * c1 * d);
                    }
                    return;
                }
                magnitude.resize(pixels, 0.0);
                fill_powers(magnitude, (c0, c1));
                stretch_roots(magnitude, 0.0, 1.0);
                let d_image = if self == Self::MinMax {
                    stretch_vjp(magnitude, d_image, d_magnitude);
                    d_magnitude
                } else {
                    d_image
                };
                magnitude_vjp(d0, d1, (c0, c1), magnitude, d_image);
            },
        );
        d
    }
}

/// Returns the magnitudes `[N]` of signals `[N, 2]`.
pub(crate) fn magnitudes(signals: &[Real]) -> Vec<Real> {
    signals.as_chunks::<2>().0.iter().map(|[a, b]| (a * a + b * b).sqrt()).collect()
}

/// Sets every pixel of `image` to the power c₀² + c₁² of its channels.
fn fill_powers(image: &mut [Real], (c0, c1): (&[Real], &[Real])) {
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || image.iter_mut().zip(c0).zip(c1).for_each(|((v, a), b)| *v = a * a + b * b),
    );
}

/// Converts the powers of `image` to magnitudes, scaled from `low`..`high` to [0, 1]; the limits 0 and 1 do not scale.
fn stretch_roots(image: &mut [Real], low: Real, high: Real) {
    let gain = gain(low, high);
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || image.iter_mut().for_each(|v| *v = (v.sqrt() - low) * gain),
    );
}

/// Sets `d0` and `d1` to the cotangents of both channels, given those `d` of the magnitude: d along the direction of the
/// signal, zero for a zero signal.
fn magnitude_vjp(d0: &mut [Real], d1: &mut [Real], (c0, c1): (&[Real], &[Real]), magnitude: &[Real], d: &[Real]) {
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || {
            for ((((d0, d1), (c0, c1)), m), d) in d0.iter_mut().zip(d1).zip(c0.iter().zip(c1)).zip(magnitude).zip(d) {
                let share = if *m > 0.0 { d / m } else { 0.0 };
                (*d0, *d1) = (c0 * share, c1 * share);
            }
        },
    );
}

/// Sets `out` to the cotangents of the magnitude, given those of the image that is scaled to [0, 1].
fn stretch_vjp(magnitude: &[Real], d_image: &[Real], out: &mut Vec<Real>) {
    const LANES: usize = 16;
    let (low, high) = range(magnitude);
    let gain = gain(low, high);
    out.clear();
    out.extend(d_image.iter().map(|d| d * gain));
    // Sums d and d·v with v = (m − low)·gain in lanes: additions are vectorised, in one order on every machine.
    let (mut total, mut weighted) = ([0.0; LANES], [0.0; LANES]);
    for (d, m) in out.chunks(LANES).zip(magnitude.chunks(LANES)) {
        let (d, m) = (&d[..d.len().min(LANES)], &m[..d.len().min(LANES)]); // without bounds checks in the lanes
        for lane in 0..d.len() {
            total[lane] += d[lane];
            weighted[lane] += d[lane] * ((m[lane] - low) * gain);
        }
    }
    let (total, weighted): (Real, Real) = (total.iter().sum(), weighted.iter().sum());
    // Adds the derivatives by the limits: ∂v/∂low = −gain·(1 − v), ∂v/∂high = −gain·v.
    let first = |value: Real| magnitude.iter().position(|m| *m == value);
    if let (Some(darkest), Some(brightest)) = (first(low), first(high)) {
        out[darkest] -= total - weighted;
        out[brightest] -= weighted;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::testing::check_vjp;

    #[test]
    #[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
    fn derivative_agrees_with_differences() {
        let x: Vec<Real> = (0..24).map(|i| (i as Real * 0.7).sin() + 0.1).collect();
        for readout in [Readout::Real, Readout::Magnitude, Readout::Power, Readout::MinMax] {
            check_vjp("readout", &x, |x| readout.forward(x, 3), |x, d| readout.vjp(x, 3, d), 1e-6, 1e-6);
        }
        let x: Vec<Real> = (0..2 * 2 * 37).map(|i| (i as Real * 1.7).sin() + 0.02 * i as Real).collect();
        let readout = Readout::MinMax;
        check_vjp("long", &x, |x| readout.forward(x, 37), |x, d| readout.vjp(x, 37, d), 1e-6, 1e-6);
    }

    #[test]
    fn magnitude_has_zero_derivative_at_zero_pixel() {
        assert_eq!(Readout::Magnitude.vjp(&[0.0, 0.0], 1, &[1.0]), vec![0.0, 0.0]);
    }

    #[test]
    fn min_max_spans_zero_to_one_at_any_scale() {
        let signals: Vec<Real> = (0..80).map(|i| (i as Real * 0.9).cos() + 2.0).collect();
        let picture = |scale: Real| {
            let scaled: Vec<Real> = signals.iter().map(|s| scale * s).collect();
            Readout::MinMax.forward(&scaled, 40)
        };
        let one = picture(1.0);
        assert_eq!(range(&one), (0.0, 1.0));
        assert!(one.iter().zip(picture(1e-6)).all(|(a, b)| (a - b).abs() < 1e-5));
    }

    #[test]
    fn min_max_of_constant_image_is_zero_with_zero_derivative() {
        let flat: Vec<Real> = [[3.0; 20], [4.0; 20]].concat();
        assert!(Readout::MinMax.forward(&flat, 20).iter().all(|v| *v == 0.0));
        assert!(Readout::MinMax.vjp(&flat, 20, &[1.0; 20]).iter().all(|v| *v == 0.0));
        assert_eq!(Readout::MinMax.forward(&[0.0; 8], 4), vec![0.0; 4]);
    }
}
