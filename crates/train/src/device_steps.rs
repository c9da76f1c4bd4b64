//! Steps on a device that keeps the parameters: the trainer plans the steps up to the next edit of the cloud, and the
//! [`DeviceStepper`](pwrfgs_core::DeviceStepper) of the method runs them.

use crate::settings::Rays;
use crate::trainer::{StepReport, Trainer};
use pwrfgs_core::{DeviceStep, Error, Real, Result, TrainingState, device};
use std::sync::Arc;

/// Maximum number of steps that run together.
const MOST_STEPS: u64 = 100;
/// Size of their measured spectra from which no further step is added, bytes: the host holds all of them.
const MOST_BYTES: usize = 16 << 20;

impl Trainer<'_> {
    /// Runs up to `most` steps, at least one, and returns their reports: one step on the CPU, several where a device keeps the
    /// parameters. They end with the first that changes the number of Gaussians or their state by a rule.
    ///
    /// # Errors
    /// As [`Self::step`].
    pub fn run_steps(&mut self, most: u64) -> Result<Vec<StepReport>> {
        // Runs on a thread of the pool, so that parallel loops need not enter it again.
        rayon::scope(|_| match self.run_on_device(most)? {
            Some(reports) => Ok(reports),
            None => Ok(vec![self.run_step()?]),
        })
    }

    /// Runs up to `most` steps on a device; `None` if there is none that keeps the parameters and supports the next step.
    /// Errors are those of [`Self::step`].
    fn run_on_device(&mut self, most: u64) -> Result<Option<Vec<StepReport>>> {
        if device::name().is_none() {
            return Ok(None);
        }
        let settings = &self.plan.training;
        let is_known = settings.dropout == 0.0
            && settings.rays == Rays::All
            && self.objective.as_spectrum_loss(&[]).is_some()
            && self.cloud.extra.is_empty(); // such as masks: the host leaves out closed Gaussians
        if !is_known || self.cloud.is_empty() {
            return Ok(None);
        }
        let stages = Arc::clone(&self.stages);
        let Some(stepper) = stages.method.device_stepper(&stages.setup) else { return Ok(None) };
        let planned = self.plan_steps(most.clamp(1, MOST_STEPS))?;
        if planned.is_empty() {
            return Ok(None);
        }
        self.before_reset = None;
        let Self { cloud, weights, adam, stats, .. } = self;
        let weights = Arc::make_mut(weights);
        let (cloud_moments, weight_moments) = (&mut adam.cloud, &mut adam.weights);
        let state = TrainingState { cloud, weights, cloud_moments, weight_moments, stats };
        let losses = stepper.run(state, &planned)?;
        self.check_finite(&losses)?;
        let (first, count) = (self.done + 1, self.cloud.len());
        let report = |(step, loss): (u64, Real)| {
            let (phase, loss) = (self.phase(step), loss as f64);
            StepReport { step, phase, loss, penalty: 0.0, gaussians: count, pruned: None }
        };
        let mut reports: Vec<StepReport> = (first..).zip(losses).map(report).collect();
        let context = self.context(self.done + planned.len() as u64);
        let pruned = self.edit(&self.pruners_of(&context), &context)?;
        if let Some(last) = reports.last_mut() {
            (last.pruned, last.gaussians) = (pruned, self.cloud.len());
        }
        self.done = context.step;
        Ok(Some(reports))
    }

    /// Returns the next steps, up to `most`: until one edits the cloud, and before the first that a device cannot run.
    ///
    /// # Errors
    /// A spectrum cannot be read.
    fn plan_steps(&mut self, most: u64) -> Result<Vec<DeviceStep>> {
        let (mut planned, mut bytes) = (Vec::new(), 0);
        let last = self.plan.training.steps.clamp(self.done + 1, self.done + most);
        for step in self.done + 1..=last {
            let context = self.context(step);
            if self.pruners_of(&context).iter().any(|pruner| pruner.acts_between()) {
                break;
            }
            self.set_plane(step);
            let batch = self.batches.draw_batch(step, &self.plan, self.data, &self.stages)?;
            let Some(loss) = self.objective.as_spectrum_loss(&batch.truths) else { break };
            let (ssim, is_squared) = ((loss.ssim_weight, loss.window), loss.is_squared);
            let setup = self.stages.setup.clone();
            let (columns, weights) = (self.column_updates(step), self.weight_updates(step));
            bytes += size_of_val(&batch.truths[..]);
            let (links, truths) = (batch.inputs, batch.truths);
            planned.push(DeviceStep { setup, links, truths, ssim, is_squared, columns, weights });
            if self.is_change_due(&context) || bytes > MOST_BYTES {
                break;
            }
        }
        Ok(planned)
    }

    /// Returns an error unless losses and parameters are finite.
    ///
    /// # Errors
    /// [`Error::NonFinite`] with the first loss, or with the first tensor after the last step.
    fn check_finite(&self, losses: &[Real]) -> Result<()> {
        let steps = self.done + 1..;
        if let Some((step, _)) = steps.zip(losses).find(|(_, loss)| !loss.is_finite()) {
            return Err(Error::NonFinite { tensor: "the loss".into(), step });
        }
        let step = self.done + losses.len() as u64;
        let mut columns = self.cloud.columns();
        if let Some((name, ..)) = columns.find(|(_, _, values)| !values.iter().all(|value| value.is_finite())) {
            return Err(Error::NonFinite { tensor: format!("`{name}`"), step });
        }
        let is_finite = self.weights.iter().all(|weight| weight.is_finite());
        if is_finite { Ok(()) } else { Err(Error::NonFinite { tensor: "the network".into(), step }) }
    }
}
