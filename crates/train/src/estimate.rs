//! Memory of a training step, and [`TimeEstimate`]: the time of a training before its first step.

use crate::settings::{Densify, Rays, Training};
use crate::trainer::Trainer;
use pwrfgs_core::plugin::Checked;
use pwrfgs_core::{AdamUpdate, Deformation, Error, InitializerInput, KEPT_BYTES, Real, Result};
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

/// Estimated time of all training steps, from timed steps with two numbers of Gaussians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeEstimate {
    /// Steps with the initial Gaussians.
    pub start: TimedSteps,
    /// Steps with the share of the initial Gaussians that pruning is expected to keep.
    pub end: TimedSteps,
    /// Shortest, expected and longest time of all steps, seconds.
    pub seconds: [f64; 3],
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

/// Shares of the Gaussians that learned masks keep: least, expected, most (3,000 Gaussians on s23, `docs/results.md`).
const KEPT_BY_MASKS: [f64; 3] = [0.01, 0.05, 0.3];
/// Shares that other pruners keep: least, expected, most; their thresholds may remove none.
const KEPT: [f64; 3] = [0.1, 0.3, 1.0];
/// Number of timed steps with one N, if they take less than [`PATIENCE`].
const TIMED: usize = 40;
/// Time after which two or more timed steps are enough; after four times as long, one is.
const PATIENCE: Duration = Duration::from_millis(1_500);

/// Returns the bytes that the network of `deformation` needs in training; it does not create the network.
pub fn network_bytes(deformation: &dyn Deformation) -> u64 {
    let weights = deformation.layout().weight_count() as u64;
    weights * (PER_WEIGHT * size_of::<Real>()) as u64
}

/// Number N of drawn Gaussians over the steps of a training: initial, then the limit of densification, then falling by
/// an equal share per step from the step in which masks can close (or pruning begins) to the end of pruning. Closed masks
/// count as removed: their Gaussians are not evaluated.
#[derive(Clone, Copy, Debug)]
struct CountCurve {
    /// N of the first steps, and N from step `grown` on.
    full: [f64; 2],
    grown: u64,
    /// First and last step of the fall; equal without pruning.
    fall: [u64; 2],
    steps: u64,
}

impl CountCurve {
    /// Returns the sum of N over all steps, if the share `kept` remains at the end of pruning.
    fn sum_over_steps(&self, kept: f64) -> f64 {
        let ([first, full], [from, until]) = (self.full, self.fall);
        let grown = self.grown.min(from);
        // Mean of kept^u for u from 0 to 1.
        let mean = if kept < 1.0 { (kept - 1.0) / kept.ln() } else { 1.0 };
        let [growing, whole, falling, after] =
            [grown, from - grown, until - from, self.steps - until].map(|n| n as f64);
        let last = if until > from { kept * full } else { full };
        growing * first + (whole + falling * mean) * full + after * last
    }

    /// Returns the time of all steps, seconds, if the share `kept` remains. The time of a step is linear in N through two
    /// timed points (N, seconds), or constant if their N are equal.
    fn total_seconds(&self, kept: f64, [(n, time), (other_n, other_time)]: [(f64, f64); 2]) -> f64 {
        let slope = if n == other_n { 0.0 } else { ((time - other_time) / (n - other_n)).max(0.0) };
        let fixed = (other_time - slope * other_n).max(0.0);
        self.steps as f64 * fixed + slope * self.sum_over_steps(kept)
    }
}

impl Trainer<'_> {
    /// Returns the memory of the next step in addition to the loaded data, bytes, accurate to about a third.
    pub fn step_bytes(&self) -> u64 {
        let (n, batch) = (self.cloud.len(), self.plan.training.batch);
        let setup = &self.stages.setup;
        let receivers = self.data.len().div_ceil(self.data.locations.len().max(1));
        let (links, pixels) = match self.plan.training.rays {
            Rays::All => (batch * receivers, setup.value_count()),
            Rays::Same(rays) => (batch * receivers, rays),
            Rays::Each(pairs) => (pairs, 1),
        };
        let cost = self.stages.method.cost(setup, links, pixels);
        let numbers = n * (PER_GAUSSIAN + cost.per_gaussian + batch * PER_TERM) + links * cost.pixels * PER_PIXEL;
        let weights = (self.weight_count() * PER_WEIGHT * size_of::<Real>()) as u64;
        let kept_bytes = (n * batch * cost.per_term * size_of::<Real>()).min(KEPT_BYTES);
        (numbers * size_of::<Real>() + kept_bytes) as u64 + weights + cost.bytes
    }

    /// Estimates the time of the training: it times steps with the current N and with the share of it that pruning is
    /// expected to keep, and weights them by the expected number of Gaussians. It also times one candidate of an
    /// initial search. Densification beyond `max_gaussians`, the statistics of prune steps, validation and scoring are
    /// not included.
    ///
    /// # Errors
    /// As [`Self::step`].
    pub fn estimate_time(mut self) -> Result<TimeEstimate> {
        let search_seconds = self.search_seconds()?;
        let t = Training::clone(&self.plan.training);
        let n = self.cloud.len();
        let (curve, kept) = self.count_curve();
        let last = ((kept[1] * n as f64).round() as usize).clamp(n.min(1), n);
        // No timed step changes N.
        let endless = Training {
            densify_until: u64::MAX,
            prune_until: u64::MAX,
            densify: Densify { every: 0, ..t.densify },
            ..t
        };
        self.plan.training = Checked::new(endless).map_err(Error::Config)?;
        let start = self.time_steps()?;
        let end = if last < n {
            // Keeps `last` rows, evenly spaced.
            let keep: Vec<bool> = (0..n).map(|i| (i + 1) * last / n > i * last / n).collect();
            self.keep(&keep)?;
            self.time_steps()?
        } else {
            start
        };
        // The shortest time belongs to the least share and the lower quartiles, and so on.
        let total = |k: usize| curve.total_seconds(kept[k], [(n as f64, start[k]), (last as f64, end[k])]);
        Ok(TimeEstimate {
            start: TimedSteps { gaussians: n, step_seconds: start[1] },
            end: TimedSteps { gaussians: last, step_seconds: end[1] },
            seconds: [total(0), total(1), total(2)],
            search_seconds,
            spread: (start[2] / start[0]).max(end[2] / end[0]),
        })
    }

    /// Returns the expected number of Gaussians over the steps, and the shares that pruning keeps: least, expected,
    /// most.
    fn count_curve(&self) -> (CountCurve, [f64; 3]) {
        let (t, pruners) = (&self.plan.training, &self.plan.pruners);
        let n = self.cloud.len();
        let [before, until] = [t.densify_until, t.prune_until].map(|step| step.min(t.steps));
        let grows = t.densify.every > 0 && t.densify.from < before && self.stages.method.traits().blends;
        let full = if grows { n.max(t.densify.max_gaussians) } else { n };
        let closing = pruners.iter().filter_map(|pruner| pruner.steps_to_close(AdamUpdate::BETAS)).min();
        let (from, kept) = match (self.goal, closing) {
            _ if n < 2 || until == before || pruners.is_empty() => (until, [1.0; 3]),
            (Some(goal), _) => (before, [goal.target.min(full) as f64 / full as f64; 3]),
            (None, Some(closed)) => (closed.min(until), KEPT_BY_MASKS),
            (None, None) => (before, KEPT),
        };
        let curve = CountCurve {
            full: [n, full].map(|n| n as f64),
            grown: t.densify.from,
            fall: [from, until],
            steps: t.steps,
        };
        (curve, kept)
    }

    /// Returns the shortest and longest expected time of the initial search, seconds; 0 without one. Returns an error if the
    /// initialiser does not support data or method.
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

    /// Times a few steps, and returns the quartiles of their times, seconds, or an error of [`Self::step`]. The first step
    /// allocates memory and is not timed, unless it takes long.
    fn time_steps(&mut self) -> Result<[f64; 3]> {
        let begun = Instant::now();
        let mut seconds = Vec::new();
        while seconds.len() <= TIMED && (seconds.len() < 2 || begun.elapsed() < PATIENCE) {
            let called = Instant::now();
            // A device that keeps the parameters runs several steps at once.
            let steps = self.run_steps(if seconds.is_empty() { 1 } else { 10 })?.len();
            seconds.push(called.elapsed().as_secs_f64() / steps as f64);
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
    use super::{CountCurve, KEPT_BY_MASKS};

    #[test]
    fn counts_are_constant_then_fall_by_equal_shares() {
        let constant = CountCurve { full: [100.0; 2], grown: 0, fall: [100; 2], steps: 100 };
        assert_eq!(constant.total_seconds(1.0, [(100.0, 2.0); 2]), 200.0);
        let curve = CountCurve { full: [50.0, 100.0], grown: 10, fall: [20, 60], steps: 100 };
        let steps: f64 = (0..40).map(|k| 100.0 * 0.01_f64.powf((f64::from(k) + 0.5) / 40.0)).sum();
        let sum = 10.0 * 50.0 + 10.0 * 100.0 + steps + 40.0 * 1.0;
        assert!((curve.sum_over_steps(0.01) / sum - 1.0).abs() < 1e-3);
        let seconds = curve.total_seconds(0.01, [(100.0, 1.1), (1.0, 0.11)]);
        assert!((seconds / (100.0 * 0.1 + 0.01 * sum) - 1.0).abs() < 1e-3, "linear in N");
    }

    /// `pwrfgs-small.ron` on one thread of a Xeon: λ, timed steps (N, seconds) and the time of all 200,000 steps.
    #[test]
    fn estimates_of_recorded_runs_are_within_a_factor_of_1_5() {
        let curve = CountCurve { full: [2_000.0, 3_000.0], grown: 500, fall: [1_411, 40_000], steps: 200_000 };
        let runs = [
            ("0.01", [(2_000.0, 0.115), (72.0, 0.0130)], 3_850.0),
            ("0.0075", [(2_000.0, 0.077), (136.0, 0.0085)], 3_000.0),
        ];
        for (lambda, timed, taken) in runs {
            let [shortest, expected, longest] = KEPT_BY_MASKS.map(|kept| curve.total_seconds(kept, timed));
            let ratio = expected / taken;
            assert!((1.0 / 1.5..1.5).contains(&ratio), "λ = {lambda}: {expected:.0} s expected, {taken} s taken");
            assert!(shortest < taken && taken < longest, "λ = {lambda}: {shortest:.0} to {longest:.0} s");
        }
    }
}
