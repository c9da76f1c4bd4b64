//! Chance: what every strategy has to beat.

use crate::rounds::{check_shares, share_at, without_share};
use pwrfgs_core::{Budget, CloudStats, GaussianCloud, JsonSchema, Moment, Pruner, PrunerTraits, Real, rng};
use serde::{Deserialize, Serialize};

/// Removes random Gaussians: the lower reference for all strategies.
///
/// Each prune step draws anew from the pipeline's seed. What a strategy gains over it at equal N and equal training is what
/// its score knows; the reference from above is [`crate::GreedyElimination`].
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("RandomReference(shares: [0.5])")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RandomReference {
    /// Share of Gaussians removed at each prune step, in order; after the last entry nothing is removed.
    pub shares: Vec<Real>,
}

impl Default for RandomReference {
    fn default() -> Self {
        Self { shares: vec![0.5, 0.5, 0.5] }
    }
}

#[typetag::serde]
impl Pruner for RandomReference {
    fn traits(&self) -> PrunerTraits {
        PrunerTraits { budget: Some(Budget::Rounds), ..PrunerTraits::default() }
    }

    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, moment: &Moment) -> Vec<bool> {
        without_share(&self.score(cloud, stats, moment), share_at(&self.shares, moment))
    }

    fn score(&self, cloud: &GaussianCloud, _: &CloudStats, moment: &Moment) -> Vec<Real> {
        let mut random = rng::stream(moment.seed, "pruner RandomReference", moment.step);
        (0..cloud.len()).map(|_| rng::uniform(&mut random)).collect()
    }

    fn check(&self) -> Result<(), String> {
        check_shares(&self.shares)
    }
}
