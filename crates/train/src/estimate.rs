//! Memory of a training step, and [`TimeEstimate`]: the time of a training before its first step.

use crate::settings::{Densify, Rays, Training};
use crate::trainer::Trainer;
use pwrfgs_core::plugin::Checked;
use pwrfgs_core::{Deformation, Error, InitializerInput, KEPT_BYTES, Real, Result};
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

/// Estimated time of all training steps, from timed steps with two numbers of Gaussians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeEstimate {
    /// Steps with the initial Gaussians.
    pub start: TimedSteps,
    /// Steps with the target of pruning; without a target, with a tenth of the initial Gaussians.
    pub end: TimedSteps,
    /// Shortest and longest expected time of all steps, seconds. Without a target, the longest is without pruning.
    pub seconds: [f64; 2],
    /// Shortest and longest expected time of the initial search before the first step, seconds; 0 without one.
    pub search_seconds: [f64; 2],
    /// Upper over lower quartile of the times of equal steps: about 1 on an idle machine.
    pub spread: f64,
}

/// Timed steps with one number of Gaussians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedSteps {
    /// Number of Gaussians N.
    pub gaussians: usize,
    /// Median time per step, seconds.
    pub step_seconds: f64,
}

/// Numbers stored per network weight: the weight, two moments, its derivative in the graph and in the method, and fifteen
/// accumulators of it.
const PER_WEIGHT: usize = 20;
/// Numbers stored per Gaussian: derivatives, activated and projected parameters, tiles, sort keys.
const PER_GAUSSIAN: usize = 220;
/// Numbers stored per Gaussian and transmitter: deformation terms, their derivatives and temporary buffers.
const PER_TERM: usize = 75;
/// Numbers stored per pixel and transmitter: spectra, signals, SSIM buffers and derivatives.
const PER_PIXEL: usize = 20;

/// Share of the Gaussians that pruning keeps at least, if it has no target.
const KEPT: f64 = 0.1;
/// Number of timed steps with one N, if they take less than `PATIENCE`.
const TIMED: usize = 40;
const PATIENCE: Duration = Duration::from_millis(1_500);

/// Returns the bytes that the network of `deformation` needs in training; it does not create the network.
pub fn network_bytes(deformation: &dyn Deformation) -> u64 {
    let weights = deformation.layout().numbers() as u64;
    weights * (PER_WEIGHT * size_of::<Real>()) as u64
}

/// Time of a training in which step times fall evenly from `first` to `last` seconds while it prunes. `phases` are the
/// last steps of densification, pruning and training.
fn weighted([before, until, steps]: [u64; 3], first: f64, last: f64) -> f64 {
    before as f64 * first + (until - before) as f64 * (first + last) / 2.0 + (steps - until) as f64 * last
}

impl Trainer<'_> {
    /// Returns the memory of the next step in addition to the loaded data, bytes, accurate to about a third.
    pub fn step_bytes(&self) -> u64 {
        let (n, batch) = (self.cloud.len(), self.plan.training.batch);
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
        let kept = (n * batch * cost.per_term * size_of::<Real>()).min(KEPT_BYTES);
        (numbers * size_of::<Real>() + kept) as u64 + weights + cost.bytes
    }

    /// Estimates the time of the training: it times steps with the current N and with the N at the end of pruning, and
    /// weights them by the schedule. It also times one candidate of an initial search. Densification and the statistics
    /// of prune steps are not included.
    ///
    /// # Errors
    /// As [`Self::step`].
    pub fn time(mut self) -> Result<TimeEstimate> {
        let search_seconds = self.search_seconds()?;
        let t = Training::clone(&self.plan.training);
        let (n, target) = (self.cloud.len(), self.goal.map(|goal| goal.target));
        let [before, until] = [t.densify_until, t.prune_until].map(|step| step.min(t.steps));
        let is_pruned = n > 1 && until > before && !self.plan.pruners.is_empty();
        let last = match target {
            _ if !is_pruned => n,
            Some(target) => target.min(n),
            None => (n as f64 * KEPT).ceil() as usize,
        };
        // No timed step changes N.
        let endless = Training {
            densify_until: u64::MAX,
            prune_until: u64::MAX,
            densify: Densify { every: 0, ..t.densify.clone() },
            ..t.clone()
        };
        self.plan.training = Checked::new(endless).map_err(Error::Config)?;
        let start = self.quartiles()?;
        let end = if last < n {
            let kept: Vec<bool> = (0..n).map(|i| (i + 1) * last / n > i * last / n).collect();
            self.keep(&kept)?;
            self.quartiles()?
        } else {
            start
        };
        let total = |first, last| weighted([before, until, t.steps], first, last);
        let longest = if target.is_some() { end[2] } else { start[2] };
        Ok(TimeEstimate {
            start: TimedSteps { gaussians: n, step_seconds: start[1] },
            end: TimedSteps { gaussians: last, step_seconds: end[1] },
            seconds: [total(start[0], end[0]), total(start[2], longest)],
            search_seconds,
            spread: (start[2] / start[0]).max(end[2] / end[0]),
        })
    }

    fn search_seconds(&self) -> Result<[f64; 2]> {
        let input = InitializerInput {
            data: self.data,
            train: self.batches.train(),
            plane: &self.plane,
            method: &*self.stages.method,
            progress: &|_, _| {},
            stop: &AtomicBool::new(false),
        };
        self.plan.initializer.search_seconds(&input)
    }

    /// Quartiles of the times of a few steps, seconds. The first step allocates memory and is not timed, unless it takes
    /// long.
    fn quartiles(&mut self) -> Result<[f64; 3]> {
        let begun = Instant::now();
        let mut seconds = Vec::new();
        while seconds.len() <= TIMED && (seconds.len() < 2 || begun.elapsed() < PATIENCE) {
            let step = Instant::now();
            self.step()?;
            seconds.push(step.elapsed().as_secs_f64());
            if begun.elapsed() > 4 * PATIENCE {
                break;
            }
        }
        let timed = if seconds.len() > 1 { &mut seconds[1..] } else { &mut seconds[..] };
        timed.sort_by(f64::total_cmp);
        Ok([1, 2, 3].map(|quarter| timed[(timed.len() - 1) * quarter / 4]))
    }
}

#[cfg(test)]
mod tests {
    use super::weighted;

    #[test]
    fn schedule_weights_step_times() {
        assert_eq!(weighted([20, 60, 100], 2.0, 1.0), 20.0 * 2.0 + 40.0 * 1.5 + 40.0 * 1.0);
        assert_eq!(weighted([0, 0, 100], 2.0, 2.0), 200.0);
    }
}
