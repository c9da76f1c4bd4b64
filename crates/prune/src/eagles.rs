//! Influence on the pictures: a quantile of it goes.

use crate::rounds::{asked, check_share, check_target, quantile};
use pwrfgs_core::{
    Budget, CloudStats, GaussianCloud, JsonSchema, Moment, Needs, Pruner, PrunerTraits, Real, Statistic,
};
use serde::{Deserialize, Serialize};

/// Drops what has the least influence on the pictures, a small part at every prune step (EAGLES).
///
/// Influence is Σ w, the blending weights γ·T over all pixels and training transmitters; what lies at or below a quantile of
/// it goes (EAGLES, Girish et al., ECCV 2024, section 3.3: 5 % every 3,000 steps). Gaussians that nobody sees share the
/// value 0 and go together. Slow and safe: many prune steps with training between them.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("Eagles(quantile: 0.05)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Eagles {
    /// What lies at or below this quantile goes, from 0 to 1.
    pub quantile: Real,
    /// Training transmitters that a pass looks at; 0: all.
    pub transmitters: usize,
    /// How many Gaussians there shall be at the end of pruning, in equal ratios from prune step to prune step; in place of
    /// `quantile`.
    pub target: Option<usize>,
}

impl Default for Eagles {
    fn default() -> Self {
        Self { quantile: 0.05, transmitters: 0, target: None }
    }
}

#[typetag::serde]
impl Pruner for Eagles {
    fn traits(&self) -> PrunerTraits {
        PrunerTraits { budget: self.target.map(Budget::Rounds), ..PrunerTraits::default() }
    }

    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, moment: &Moment) -> Vec<bool> {
        let scores = self.score(cloud, stats, moment);
        if moment.round == 0 || self.quantile == 0.0 {
            return vec![true; scores.len()];
        }
        let limit = quantile(&scores, self.quantile);
        scores.iter().map(|score| *score > limit).collect()
    }

    fn needs(&self, _: &GaussianCloud, _: &Moment) -> Needs {
        Needs::of(&[Statistic::Weight], self.transmitters)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &Moment) -> Vec<Real> {
        asked(&stats.asked.weight, cloud)
    }

    fn with_target(&self, target: usize) -> Option<Box<dyn Pruner>> {
        Some(Box::new(Self { target: Some(target), ..self.clone() }))
    }

    fn check(&self) -> Result<(), String> {
        check_share("quantile", self.quantile)?;
        check_target(self.target)
    }
}
