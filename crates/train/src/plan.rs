//! `TrainingPlan`: all inputs of a training except the data.

use crate::settings::{Densify, Rays, Training};
use pwrfgs_core::plugin::{Checked, Plugin};
use pwrfgs_core::{ColumnSpec, Error, Initializer, Method, Parts, PruneTarget, Pruner, Result, TrainingNumbers};

/// All inputs of a training except the data. `pwrfgs_pipeline::Pipeline::plan` creates it from a pipeline.
#[derive(Clone, Debug)]
pub struct TrainingPlan {
    /// Name of the training in messages.
    pub name: String,
    /// Seed of all random streams.
    pub seed: u64,
    /// Method that maps Gaussians and weights to observations.
    pub method: Plugin<dyn Method>,
    /// Initialiser of the Gaussians.
    pub initializer: Plugin<dyn Initializer>,
    /// Pruners; a Gaussian is kept if all of them keep it.
    pub pruners: Vec<Plugin<dyn Pruner>>,
    /// Training settings of algorithm 1.
    pub training: Checked<Training>,
}

impl TrainingPlan {
    /// Returns this plan as parts for [`check_compatible`](pwrfgs_core::check_compatible), without data; `initial` is the number
    /// of initial Gaussians, if known.
    pub fn parts(&self, initial: Option<usize>) -> Parts<'_> {
        let Training { rays, stride, prune_until, densify_until, target_count: target, .. } = *self.training;
        // Pixels per spectrum; 0 for pairs of spectrum and pixel.
        let pixels = match rays {
            Rays::All => None,
            Rays::Same(count) => Some(count),
            Rays::Each(_) => Some(0),
        };
        let (densified, prunes) = (self.max_densified(), prune_until > densify_until);
        let training = TrainingNumbers { stride, pixels, initial, densified, target, prunes };
        let (method, training) = (Some(self.method.get()), Some(training));
        Parts { method, pruners: &self.pruners, training, ..Parts::default() }
    }

    /// Returns the limit of densification on the number of Gaussians: 0 without densification, `usize::MAX` without a limit.
    fn max_densified(&self) -> usize {
        let Densify { every, from, max_gaussians, .. } = self.training.densify;
        let most = if max_gaussians == 0 { usize::MAX } else { max_gaussians };
        if every > 0 && from < self.training.densify_until { most } else { 0 }
    }

    /// Returns the target of the training and its pruner; `None` without a target.
    pub(crate) fn goal(&self) -> Option<PruneTarget> {
        PruneTarget::of(&self.pruners, self.training.target_count)
    }

    /// Returns the target if it removes none of the `n` initial Gaussians and none are added; otherwise `None`.
    pub(crate) fn idle_target(&self, n: usize) -> Option<usize> {
        let goal = self.goal()?;
        (goal.target >= n && !goal.can_reach(&self.pruners, self.max_densified(), n + 1)).then_some(goal.target)
    }
}

/// Rejects pruners that this program cannot run.
///
/// # Errors
/// [`Error::Config`] if a pruner is [unavailable](pwrfgs_core::PrunerTraits::unavailable), with the next step.
pub fn check_available(pruners: &[Plugin<dyn Pruner>]) -> Result<()> {
    let why = pruners.iter().find_map(|pruner| pruner.traits().unavailable);
    why.map_or(Ok(()), |why| Err(Error::Config(why)))
}

/// Returns the columns that the pruners request, each as the first of them specifies it; none if `prune_until` is 0, so that
/// no pruner takes part.
pub(crate) fn requested_columns(plan: &TrainingPlan) -> Vec<ColumnSpec> {
    let mut specs: Vec<ColumnSpec> = Vec::new();
    if plan.training.prune_until > 0 {
        for spec in plan.pruners.iter().flat_map(|pruner| pruner.traits().columns) {
            if specs.iter().all(|s| s.name != spec.name) {
                specs.push(spec);
            }
        }
    }
    specs
}
