//! Pruners by blending weight: weighted random sample, cumulated weight or quantile.

use crate::common::{quantile, requested_statistic, rounded_share};
use crate::settings::check_share;
use pwrfgs_core::{
    Budget, CloudStats, GaussianCloud, JsonSchema, Needs, Pruner, PrunerTraits, Real, Statistic, StepContext, best, rng,
};
use serde::{Deserialize, Serialize};

/// Selection rule by weight.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub enum SelectionRule {
    /// Random sample of this share of all Gaussians, with probability proportional to weight.
    Sampled(Real),
    /// Gaussians with the largest weights that together have this share of the total weight.
    Cumulated(Real),
    /// All Gaussians above this quantile of the weight.
    Above(Real),
}

impl SelectionRule {
    /// Returns the share or quantile of the rule.
    fn share(self) -> Real {
        let (Self::Sampled(share) | Self::Cumulated(share) | Self::Above(share)) = self;
        share
    }
}

/// Keeps a random sample of Gaussians by weight, or the Gaussians with nearly all of the weight (Mini-Splatting).
///
/// The weight is Σ w over the training transmitters. The rules are:
///
/// - `Sampled` draws without replacement with probability proportional to weight. It keeps a sparse cover of the scene,
///   whereas the largest weights alone may cluster.
/// - `Cumulated` keeps the largest weights until they sum to that share of the total. Source of both: Mini-Splatting,
///   Fang and Wang, ECCV 2024, section 3.3, with half drawn at step 15,000 and 0.99 of the weight kept at 20,000.
/// - `Above(0.05)` is the rule of EAGLES (Girish et al., ECCV 2024, section 3.3: 5 % every 3,000 steps). It removes all
///   invisible Gaussians at once.
///
/// Samples follow from the seed of the pipeline. With `training.target_count`, `Cumulated` and `Above` are equal: the largest
/// weights are kept.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("MiniSplatting(rule: Cumulated(0.99))")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MiniSplatting {
    /// Selection rule.
    pub rule: SelectionRule,
    /// Number of training transmitters used for the score; 0 for all.
    pub transmitters: usize,
}

impl Default for MiniSplatting {
    fn default() -> Self {
        Self { rule: SelectionRule::Sampled(0.5), transmitters: 0 }
    }
}

#[typetag::serde]
impl Pruner for MiniSplatting {
    fn traits(&self) -> PrunerTraits {
        PrunerTraits { budget: Some(Budget::Gradual), ..PrunerTraits::default() }
    }

    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, context: &StepContext) -> Vec<bool> {
        if context.round == 0 {
            return vec![true; cloud.len()];
        }
        let scores = self.score(cloud, stats, context);
        match self.rule {
            // The quantile 0 is the lowest score, which is not above itself.
            SelectionRule::Above(0.0) => vec![true; scores.len()],
            SelectionRule::Above(share) => {
                let limit = quantile(&scores, share);
                scores.iter().map(|score| *score > limit).collect()
            }
            SelectionRule::Sampled(share) => keep_without_lowest(&scores, 1.0 - share),
            SelectionRule::Cumulated(share) => {
                let total: f64 = scores.iter().map(|s| f64::from(*s)).sum();
                let mut order: Vec<usize> = (0..scores.len()).collect();
                order.sort_by(|&i, &j| scores[j].total_cmp(&scores[i]));
                let (mut keep, mut sum) = (vec![false; scores.len()], 0.0);
                for i in order {
                    keep[i] = sum < f64::from(share) * total;
                    sum += f64::from(scores[i]);
                }
                keep
            }
        }
    }

    fn needs(&self, _: &GaussianCloud, _: &StepContext) -> Needs {
        Needs::of(&[Statistic::Weight], self.transmitters)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, context: &StepContext) -> Vec<Real> {
        let weights = requested_statistic(&stats.requested.weight, cloud);
        match self.rule {
            SelectionRule::Cumulated(_) | SelectionRule::Above(_) => weights,
            // The largest of these keys are a sample without replacement (Efraimidis and Spirakis, 2006).
            SelectionRule::Sampled(_) => {
                let mut random = rng::stream(context.seed, "pruner MiniSplatting", context.step);
                weights.iter().map(|w| rng::uniform(&mut random).max(Real::MIN_POSITIVE).ln() / w.max(0.0)).collect()
            }
        }
    }

    fn check(&self) -> Result<(), String> {
        check_share("rule", self.rule.share())
    }
}

/// Returns whether each Gaussian is kept: all except the `share` with the lowest scores, rounded down to whole ones.
fn keep_without_lowest(scores: &[Real], share: Real) -> Vec<bool> {
    let removed = rounded_share(scores.len(), share).floor() as usize;
    best(scores.len() - removed.min(scores.len()), scores, |_| true)
}
