//! Readout: from blended signals to a spectrum, and back.

use pwrfgs_core::Real;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How the two real channels of a blended signal become one grey value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Readout {
    /// The first channel alone: WRF-GS.
    Real,
    /// √(c₀² + c₁²): P-WRFGS, since the files hold amplitudes. Its derivative at (0, 0) is 0: most pixels of a sparse
    /// picture are empty and must not give NaN.
    #[default]
    Magnitude,
    /// c₀² + c₁², as eq. (2) of the paper has it.
    Power,
}

impl Readout {
    /// Channels a transmitter needs.
    pub fn channels(self) -> usize {
        if self == Self::Real { 1 } else { 2 }
    }

    /// Grey values `[B, H·W]` of blended signals `[B·channels, H·W]`.
    pub fn forward(self, signals: &[Real], pixels: usize) -> Vec<Real> {
        if self == Self::Real {
            return signals.to_vec();
        }
        let mut image = vec![0.0; signals.len() / 2];
        let pictures = image.par_chunks_exact_mut(pixels).zip(signals.par_chunks_exact(2 * pixels));
        pictures.for_each(|(image, pair)| {
            let (c0, c1) = pair.split_at(pixels);
            for ((value, a), b) in image.iter_mut().zip(c0).zip(c1) {
                let power = a * a + b * b;
                *value = if self == Self::Magnitude { power.sqrt() } else { power };
            }
        });
        image
    }

    /// Cotangents of the signals, given those of the image.
    pub fn vjp(self, signals: &[Real], pixels: usize, d_image: &[Real]) -> Vec<Real> {
        if self == Self::Real {
            return d_image.to_vec();
        }
        let mut d = vec![0.0; signals.len()];
        let pictures = (d.par_chunks_exact_mut(2 * pixels))
            .zip(signals.par_chunks_exact(2 * pixels))
            .zip(d_image.par_chunks_exact(pixels));
        pictures.for_each(|((d, pair), d_image)| {
            let ((c0, c1), (d0, d1)) = (pair.split_at(pixels), d.split_at_mut(pixels));
            for k in 0..pixels {
                if self == Self::Power {
                    (d0[k], d1[k]) = (2.0 * c0[k] * d_image[k], 2.0 * c1[k] * d_image[k]);
                    continue;
                }
                let magnitude = (c0[k] * c0[k] + c1[k] * c1[k]).sqrt();
                if magnitude > 0.0 {
                    (d0[k], d1[k]) = (c0[k] / magnitude * d_image[k], c1[k] / magnitude * d_image[k]);
                }
            }
        });
        d
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::testing::check_vjp;

    #[test]
    fn derivative_agrees_with_differences() {
        if size_of::<Real>() < 8 {
            return;
        }
        let x: Vec<Real> = (0..24).map(|i| (i as Real * 0.7).sin() + 0.1).collect();
        for readout in [Readout::Real, Readout::Magnitude, Readout::Power] {
            check_vjp("readout", &x, |x| readout.forward(x, 3), |x, d| readout.vjp(x, 3, d), 1e-6, 1e-6);
        }
    }

    #[test]
    fn an_empty_pixel_has_no_derivative() {
        assert_eq!(Readout::Magnitude.vjp(&[0.0, 0.0], 1, &[1.0]), vec![0.0, 0.0]);
    }
}
