//! Loss functions for each type of observation.

use crate::settings::{PixelLoss, Training};
use pwrfgs_core::ssim::{self, Window};
use pwrfgs_core::{Dataset, Real, SpectrumLoss};
use rayon::prelude::*;

/// Loss of predictions against measurements.
pub trait Objective: std::fmt::Debug + Send + Sync {
    /// Returns the loss of predictions `[L, numbers]` against measurements `[L, numbers]`, averaged over links, and its
    /// derivative with respect to the predictions. `size` is columns and rows of one observation.
    fn evaluate(&self, predictions: &[Real], truths: &[Real], size: (usize, usize)) -> (Real, Vec<Real>);

    /// Returns this loss as data, for methods that [compute it themselves](pwrfgs_core::Method::loss_vjp); `None` if it has
    /// another form.
    fn as_spectrum_loss<'a>(&self, _truths: &'a [Real]) -> Option<SpectrumLoss<'a>> {
        None
    }
}

/// Creates the loss for `settings` and `data` with the training links `train`.
pub(crate) fn create_objective(settings: &Training, data: &Dataset, train: &[usize]) -> Box<dyn Objective> {
    let task = data.task();
    if task.has_pixels {
        // Keeps the size of the SSIM window on the whole image: the standard σ is 1.5 px.
        let stride = settings.stride;
        let window = if stride == 1 { Window::default() } else { Window::new(1.5 / stride as f64) };
        Box::new(RenderingLoss { ssim_weight: settings.loss.ssim_weight, window, errors: settings.loss.pixel })
    } else if task.is_complex {
        Box::new(ChannelLoss::of(data, train))
    } else {
        Box::new(LinkLoss { power: settings.loss.power })
    }
}

impl PixelLoss {
    /// Returns the sum of the errors over pairs; writes its derivative times `share` to `d`.
    fn sum_errors(self, predictions: &[Real], truths: &[Real], share: Real, d: &mut [Real]) -> Real {
        let mut sum = 0.0;
        for ((d, p), t) in d.iter_mut().zip(predictions).zip(truths) {
            let error = p - t;
            match self {
                Self::Absolute => {
                    sum += error.abs();
                    *d = if error == 0.0 { 0.0 } else { share.copysign(error) };
                }
                Self::Squared => {
                    sum += error * error;
                    *d = 2.0 * share * error;
                }
            }
        }
        sum
    }
}

/// Error of received powers, dB or dB².
#[derive(Clone, Copy, Debug)]
pub struct LinkLoss {
    /// Absolute or squared error.
    pub power: PixelLoss,
}

impl Objective for LinkLoss {
    fn evaluate(&self, predictions: &[Real], truths: &[Real], _: (usize, usize)) -> (Real, Vec<Real>) {
        let share = 1.0 / predictions.len().max(1) as Real;
        let mut d = vec![0.0; predictions.len()];
        let sum = self.power.sum_errors(predictions, truths, share, &mut d);
        (share * sum, d)
    }
}

/// Squared error of channels over the mean squared channel; -10 log₁₀ of it is an SNR.
#[derive(Clone, Copy, Debug)]
pub struct ChannelLoss {
    /// Mean of Σ|h|² over links.
    pub mean_energy: Real,
}

impl ChannelLoss {
    /// Creates the loss relative to the links `train` of `data`; an absolute loss if all their channels are 0.
    pub fn of(data: &Dataset, train: &[usize]) -> Self {
        let energy = |i: &usize| data.image(*i).pixels.iter().map(|v| f64::from(*v as f32).powi(2)).sum::<f64>();
        let mean = train.iter().map(energy).sum::<f64>() / train.len().max(1) as f64;
        Self { mean_energy: if mean > 0.0 { mean as Real } else { 1.0 } }
    }
}

impl Objective for ChannelLoss {
    fn evaluate(&self, predictions: &[Real], truths: &[Real], (width, height): (usize, usize)) -> (Real, Vec<Real>) {
        let links = (predictions.len() / (width * height).max(1)).max(1) as Real;
        let share = 1.0 / (links * self.mean_energy);
        let errors = || predictions.iter().zip(truths).map(|(p, t)| p - t);
        let loss: Real = errors().map(|error| share * error * error).sum();
        (loss, errors().map(|error| 2.0 * share * error).collect())
    }
}

/// Rendering loss of eq. (9): (1-w)·L1 + w·(1-SSIM), averaged over the spectra of a batch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RenderingLoss {
    /// Weight w of 1-SSIM; L1 has weight 1-w.
    pub ssim_weight: Real,
    /// Window of SSIM: Gaussian, zero padding; σ = 1.5 px by default.
    pub window: Window,
    /// Pixel loss that replaces L1.
    pub errors: PixelLoss,
}

impl RenderingLoss {
    /// Creates the loss with the standard window.
    pub fn new(ssim_weight: Real) -> Self {
        Self { ssim_weight, ..Self::default() }
    }
}

impl Objective for RenderingLoss {
    fn evaluate(&self, predictions: &[Real], truths: &[Real], (width, height): (usize, usize)) -> (Real, Vec<Real>) {
        let (pixels, ssim_weight) = (width * height, self.ssim_weight);
        let batch = (predictions.len() / pixels) as Real;
        let mut d = vec![0.0; predictions.len()];
        let parts: Vec<Real> = (d.par_chunks_exact_mut(pixels))
            .zip(predictions.par_chunks_exact(pixels))
            .zip(truths.par_chunks_exact(pixels))
            .map(|((d, p), t)| {
                let l1_scale = (1.0 - ssim_weight) / (pixels as Real * batch);
                let mut loss = l1_scale * self.errors.sum_errors(p, t, l1_scale, d);
                if ssim_weight > 0.0 {
                    let (ssim, d_ssim) = ssim::training_form(p, t, (width, height), &self.window);
                    loss += ssim_weight / batch * (1.0 - ssim);
                    d.iter_mut().zip(&d_ssim).for_each(|(d, s)| *d -= ssim_weight / batch * s);
                }
                loss
            })
            .collect();
        (parts.iter().sum(), d)
    }

    fn as_spectrum_loss<'a>(&self, truths: &'a [Real]) -> Option<SpectrumLoss<'a>> {
        let &Self { ssim_weight, window, errors } = self;
        Some(SpectrumLoss { truths, ssim_weight, window, is_squared: errors == PixelLoss::Squared })
    }
}
