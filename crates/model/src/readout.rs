//! Readout: from blended signals to a spectrum, and back.

use pwrfgs_core::Real;
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
        let mut image = Vec::with_capacity(signals.len() / 2);
        for pair in signals.chunks_exact(2 * pixels) {
            let (c0, c1) = pair.split_at(pixels);
            let power = c0.iter().zip(c1).map(|(a, b)| a * a + b * b);
            match self {
                Self::Magnitude => image.extend(power.map(Real::sqrt)),
                _ => image.extend(power),
            }
        }
        image
    }

    /// Cotangents of the signals, given those of the image.
    pub fn vjp(self, signals: &[Real], pixels: usize, d_image: &[Real]) -> Vec<Real> {
        if self == Self::Real {
            return d_image.to_vec();
        }
        let mut d = Vec::with_capacity(signals.len());
        for (pair, d_image) in signals.chunks_exact(2 * pixels).zip(d_image.chunks_exact(pixels)) {
            let (c0, c1) = pair.split_at(pixels);
            for own in [c0, c1] {
                d.extend(own.iter().zip(c0.iter().zip(c1)).zip(d_image).map(|((s, (a, b)), d)| {
                    if self == Self::Power {
                        return 2.0 * s * d;
                    }
                    let magnitude = (a * a + b * b).sqrt();
                    if magnitude > 0.0 { s / magnitude * d } else { 0.0 }
                }));
            }
        }
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
