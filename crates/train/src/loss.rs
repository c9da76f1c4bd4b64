//! The rendering loss of eq. (9): (1-w)·L1 + w·(1-SSIM), averaged over the transmitters of a batch.

use pwrfgs_core::{Real, ssim};
use rayon::prelude::*;

/// Loss of predictions `[B, H·W]` against truths `[B, H·W]`, and its derivative in the predictions.
///
/// `ssim_weight` is w. SSIM is the training form (Gaussian window, zero padding).
pub fn rendering_loss(
    predictions: &[Real],
    truths: &[Real],
    (width, height): (usize, usize),
    ssim_weight: Real,
) -> (Real, Vec<Real>) {
    let pixels = width * height;
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
                let (ssim, d_ssim) = ssim::training_vjp(p, t, width, height);
                loss += ssim_weight / batch * (1.0 - ssim);
                d.iter_mut().zip(&d_ssim).for_each(|(d, s)| *d -= ssim_weight / batch * s);
            }
            loss
        })
        .collect();
    (parts.iter().sum(), d)
}
