//! The rendering loss of eq. (9): (1-w)·L1 + w·(1-SSIM), averaged over the transmitters of a batch.

use pwrfgs_core::Real;
use pwrfgs_core::ssim::{self, Window};
use rayon::prelude::*;

/// w of eq. (9), and the window of the trained SSIM.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RenderingLoss {
    /// Weight of 1-SSIM; L1 has the rest.
    pub ssim_weight: Real,
    /// Gaussian, zero padding; σ = 1.5 px by default.
    pub window: Window,
}

impl RenderingLoss {
    /// With the usual window.
    pub fn new(ssim_weight: Real) -> Self {
        Self { ssim_weight, window: Window::default() }
    }

    /// With the window that is as wide on every `stride`-th pixel as the usual one on all.
    pub fn strided(ssim_weight: Real, stride: usize) -> Self {
        if stride == 1 {
            Self::new(ssim_weight)
        } else {
            Self { ssim_weight, window: Window::new(1.5 / stride as f64) }
        }
    }

    /// Loss of predictions `[B, H·W]` against truths `[B, H·W]`, and its derivative in the predictions.
    pub fn evaluate(
        &self,
        predictions: &[Real],
        truths: &[Real],
        (width, height): (usize, usize),
    ) -> (Real, Vec<Real>) {
        let (pixels, ssim_weight) = (width * height, self.ssim_weight);
        let batch = (predictions.len() / pixels) as Real;
        let mut d = vec![0.0; predictions.len()];
        let parts: Vec<Real> = (d.par_chunks_exact_mut(pixels))
            .zip(predictions.par_chunks_exact(pixels))
            .zip(truths.par_chunks_exact(pixels))
            .map(|((d, p), t)| {
                let l1_scale = (1.0 - ssim_weight) / (pixels as Real * batch);
                let mut l1 = 0.0;
                for ((d, p), t) in d.iter_mut().zip(p).zip(t) {
                    let error = p - t;
                    l1 += error.abs();
                    *d = if error == 0.0 { 0.0 } else { l1_scale.copysign(error) };
                }
                let mut loss = l1 * l1_scale;
                if ssim_weight > 0.0 {
                    let (ssim, d_ssim) = ssim::training(p, t, (width, height), &self.window);
                    loss += ssim_weight / batch * (1.0 - ssim);
                    d.iter_mut().zip(&d_ssim).for_each(|(d, s)| *d -= ssim_weight / batch * s);
                }
                loss
            })
            .collect();
        (parts.iter().sum(), d)
    }
}
