//! `Estimate`: memory and time of a training, before its first step.

use crate::batches::Batches;
use crate::graph::loss_and_gradients;
use crate::settings::Rays;
use crate::trainer::Trainer;
use pwrfgs_core::{Deformation, GaussianCloud, Real, Result};
use std::sync::Arc;
use std::time::Instant;

/// Estimated memory and time of the remaining training; densification and pruning change both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Current number of Gaussians N.
    pub gaussians: usize,
    /// Memory of a step in addition to the loaded data, bytes, accurate to about a third.
    pub step_bytes: u64,
    /// Time per step with that N, seconds.
    pub step_seconds: f64,
}

/// Numbers stored per network weight: the weight, two moments, and its derivative in each of sixteen accumulators.
const PER_WEIGHT: usize = 20;
/// Numbers stored per Gaussian: derivatives, activated and projected parameters, tiles, sort keys.
const PER_GAUSSIAN: usize = 220;
/// Numbers stored per Gaussian and transmitter: deformation terms, their derivatives and temporary buffers.
const PER_TERM: usize = 75;
/// Numbers stored per pixel and transmitter: spectra, signals, SSIM buffers and derivatives.
const PER_PIXEL: usize = 20;

/// Number of Gaussians times transmitters in a trial step.
const TRIAL: usize = 4_000;

/// Returns the bytes that the network of `deformation` needs in training; it does not create the network.
pub fn network_bytes(deformation: &dyn Deformation) -> u64 {
    let weights = deformation.layout().numbers() as u64;
    weights * (PER_WEIGHT * size_of::<Real>()) as u64
}

impl Trainer<'_> {
    /// Estimates the cost of the next step. It runs a step on a subset of the Gaussians, and on half of this subset,
    /// without changing the training.
    ///
    /// # Errors
    /// Values that are not finite.
    pub fn estimate(&self) -> Result<Estimate> {
        let (n, batch) = (self.cloud.len(), self.plan.training.batch);
        // For many Gaussians it uses an eighth of them; a smaller subset would amplify small, noisy times a
        // hundredfold.
        let most = (TRIAL / batch).max(n / 8).clamp(16, n.max(16)).min(n);
        let (whole, half) = (self.trial(most)?, if most < n { self.trial(most / 2)? } else { 0.0 });
        let each = if most < n { ((whole - half) / (most - most / 2) as f64).max(0.0) } else { 0.0 };
        let step_seconds = whole + each * (n - most) as f64;
        let setup = &self.stages.setup;
        let of_each = self.data.len().div_ceil(self.data.transmitters.len().max(1));
        let (links, chosen) = match self.plan.training.rays {
            Rays::All => (batch * of_each, setup.numbers()),
            Rays::Same(rays) => (batch * of_each, rays),
            Rays::Each(pairs) => (pairs, 1),
        };
        let cost = self.stages.method.cost(setup, links, chosen);
        let numbers = n * (PER_GAUSSIAN + cost.per_gaussian + batch * PER_TERM) + links * cost.pixels * PER_PIXEL;
        let weights = (self.weights() * PER_WEIGHT * size_of::<Real>()) as u64;
        let step_bytes = (numbers * size_of::<Real>()) as u64 + weights + cost.bytes;
        Ok(Estimate { gaussians: n, step_bytes, step_seconds })
    }

    /// Returns the time of the next step with `n` evenly selected Gaussians, seconds; the shorter of two runs.
    fn trial(&self, n: usize) -> Result<f64> {
        let rows: Vec<usize> = (0..n).map(|i| i * self.cloud.len() / n.max(1)).collect();
        let cloud: GaussianCloud = self.cloud.select(&rows);
        let step = self.done + 1;
        let context = self.context(step);
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
            rayon::scope(|_| loss_and_gradients(stages, &cloud, &weights, &batch, &*self.objective, &[], &context))?;
            shortest = shortest.min(start.elapsed().as_secs_f64());
        }
        Ok(shortest)
    }
}
