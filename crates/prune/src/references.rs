//! Reference strategies: random removal as the lower reference, and greedy elimination as the upper reference.

use crate::common::{ranking_traits, requested_statistic};
use pwrfgs_core::{
    CloudStats, GaussianCloud, JsonSchema, Needs, PassStatistics, Pruner, PrunerTraits, Real, Statistic, StepContext,
    rng,
};
use serde::{Deserialize, Serialize};

/// Removes random Gaussians: the lower reference for all strategies.
///
/// Each prune step draws a new sample from the seed of the pipeline. The gain of a strategy over random removal, at
/// equal N and equal training, is the value of its score. The upper reference is [`crate::GreedyElimination`].
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("RandomReference()")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RandomReference {}

#[typetag::serde]
impl Pruner for RandomReference {
    fn traits(&self) -> PrunerTraits {
        ranking_traits()
    }

    fn score(&self, cloud: &GaussianCloud, _: &CloudStats, context: &StepContext) -> Vec<Real> {
        let mut random = rng::stream(context.seed, "pruner RandomReference", context.step);
        (0..cloud.len()).map(|_| rng::uniform(&mut random)).collect()
    }
}

/// Removes one Gaussian at a time: the one whose removal gives the smallest training loss.
///
/// This is the upper reference for small numbers, for any method and any observation. It computes the exact loss of
/// `transmitters` without each Gaussian in turn, N(N+1)/2 times in all. Above `most` Gaussians this is too expensive;
/// it then removes Gaussians by sensitivity, as [`crate::SpeedySplat`] does (by opacity if the method does not blend),
/// until `most` are left. The search is greedy, so that training with fewer Gaussians from the start can be better.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("GreedyElimination(most: 50)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GreedyElimination {
    /// The exact loss is used for at most this many Gaussians, from 2 to 1,000.
    pub most: usize,
    /// Number of training transmitters of the loss, from 1 to 1,000; their observations are held in memory.
    pub transmitters: usize,
}

impl Default for GreedyElimination {
    fn default() -> Self {
        Self { most: 100, transmitters: 64 }
    }
}

#[typetag::serde]
impl Pruner for GreedyElimination {
    fn traits(&self) -> PrunerTraits {
        ranking_traits()
    }

    fn needs(&self, cloud: &GaussianCloud, _: &StepContext) -> Needs {
        if cloud.len() > self.most {
            return Needs::of(&[], self.transmitters).and_where_blended(&[Statistic::Sensitivity]);
        }
        Needs::of(&[Statistic::Elimination { most: self.most }], self.transmitters)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &StepContext) -> Vec<Real> {
        let PassStatistics { elimination, sensitivity, .. } = &stats.requested;
        requested_statistic(if elimination.len() == cloud.len() { elimination } else { sensitivity }, cloud)
    }

    fn check(&self) -> Result<(), String> {
        let Self { most, transmitters } = self;
        if !(1..=1000).contains(transmitters) {
            return Err(format!("`transmitters` is {transmitters}; give a number from 1 to 1000, such as 64"));
        }
        if !(2..=1000).contains(most) {
            return Err(format!("`most` is {most}; give a number from 2 to 1000: the work grows with its square"));
        }
        Ok(())
    }
}
