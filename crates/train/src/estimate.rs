//! `Estimate`: what training will take, said before its first step.

use crate::batches::Batches;
use crate::graph::loss_and_gradients;
use crate::settings::Rays;
use crate::trainer::Trainer;
use pwrfgs_core::{Deformation, GaussianCloud, Real, Result};
use std::sync::Arc;
use std::time::Instant;

/// Memory and time of training from here on, as far as they can be told before it begins: densification and pruning
/// change both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// N at hand.
    pub gaussians: usize,
    /// Memory of a step beyond what is loaded, bytes, to about a third.
    pub step_bytes: u64,
    /// Seconds of a step with that N.
    pub step_seconds: f64,
}

/// Numbers a weight of the network: itself, two moments, its derivative in each of sixteen accumulators.
const PER_WEIGHT: usize = 20;
/// Numbers a Gaussian: derivatives, what is activated and projected of it, tiles, what is sorted.
const PER_GAUSSIAN: usize = 220;
/// Numbers a Gaussian and transmitter: terms and their derivatives, and the pieces in which they are made.
const PER_TERM: usize = 75;
/// Numbers a pixel and transmitter: spectra, signals, what SSIM keeps, and derivatives.
const PER_PIXEL: usize = 20;

/// Gaussians times transmitters of a trial.
const TRIAL: usize = 4_000;

/// Bytes that the network of `deformation` takes in training; known before anything is made.
pub fn network_bytes(deformation: &dyn Deformation) -> u64 {
    let weights = deformation.layout().numbers() as u64;
    weights * (PER_WEIGHT * size_of::<Real>()) as u64
}

impl Trainer<'_> {
    /// What the next step takes. A step is tried on a part of the Gaussians, and on half of that part; nothing of the
    /// training changes.
    ///
    /// # Errors
    /// Numbers that are not finite.
    pub fn estimate(&self) -> Result<Estimate> {
        let (n, batch) = (self.cloud.len(), self.plan.training.batch);
        // Of many an eighth, or what is small and noisy would be multiplied by a hundred.
        let most = (TRIAL / batch).max(n / 8).clamp(16, n.max(16)).min(n);
        let (whole, half) = (self.trial(most)?, if most < n { self.trial(most / 2)? } else { 0.0 });
        let each = if most < n { ((whole - half) / (most - most / 2) as f64).max(0.0) } else { 0.0 };
        let step_seconds = whole + each * (n - most) as f64;
        let frame = &self.stages.frame;
        let of_each = self.data.len().div_ceil(self.data.transmitters.len().max(1));
        let (links, chosen) = match self.plan.training.rays {
            Rays::All => (batch * of_each, frame.numbers()),
            Rays::Same(rays) => (batch * of_each, rays),
            Rays::Each(pairs) => (pairs, 1),
        };
        let cost = self.stages.method.cost(frame, links, chosen);
        let numbers = n * (PER_GAUSSIAN + cost.per_gaussian + batch * PER_TERM) + links * cost.pixels * PER_PIXEL;
        let weights = (self.weights() * PER_WEIGHT * size_of::<Real>()) as u64;
        let step_bytes = (numbers * size_of::<Real>()) as u64 + weights + cost.bytes;
        Ok(Estimate { gaussians: n, step_bytes, step_seconds })
    }

    /// Seconds of the next step with `n` Gaussians, spread evenly over all; the shorter of two.
    fn trial(&self, n: usize) -> Result<f64> {
        let rows: Vec<usize> = (0..n).map(|i| i * self.cloud.len() / n.max(1)).collect();
        let cloud: GaussianCloud = self.cloud.select(&rows);
        let step = self.done + 1;
        let moment = self.moment(step);
        let batch = Batches::new(self.data, self.batches().train().to_vec()).of_step(
            step,
            &self.plan,
            self.data,
            &self.stages,
        )?;
        let mut shortest = f64::INFINITY;
        for _ in 0..2 {
            let start = Instant::now();
            let (stages, weights) = (&self.stages, Arc::clone(&self.weights));
            rayon::scope(|_| loss_and_gradients(stages, &cloud, &weights, &batch, &*self.objective, &[], &moment))?;
            shortest = shortest.min(start.elapsed().as_secs_f64());
        }
        Ok(shortest)
    }
}
