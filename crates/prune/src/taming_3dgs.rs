//! A sum of everything that may matter, each over its median.

use crate::rounds::{check_shares, quantile, share_at, without_share};
use pwrfgs_core::{
    Budget, CloudStats, GaussianCloud, JsonSchema, Moment, Needs, Pruner, PrunerTraits, Real, Statistic, sigmoid,
};
use serde::{Deserialize, Serialize};

/// Removes the Gaussians with the lowest weighted sum of several scores, each divided by its median (Taming 3DGS).
///
/// Gradient 25, opacity 100, radius 10, scale 25, loss 10 (weights times errors), count 0.1 (pictures that it is seen in),
/// blend 50 (blending weights): the score of Taming 3DGS (Mallick et al., SIGGRAPH Asia 2024, section 4.2), which uses it to
/// choose what to densify under an exact budget. Its terms for depth and for distance are left out: they tell cameras apart
/// that go round a scene, and a receiver stands still.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("Taming3dgs(shares: [0.5])")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Taming3dgs {
    /// Share of Gaussians removed at each prune step, in order; after the last entry nothing is removed.
    pub shares: Vec<Real>,
    /// Number of training transmitters used for the score; 0 for all.
    pub transmitters: usize,
}

impl Default for Taming3dgs {
    fn default() -> Self {
        Self { shares: vec![0.5], transmitters: 256 }
    }
}

#[typetag::serde]
impl Pruner for Taming3dgs {
    fn traits(&self) -> PrunerTraits {
        PrunerTraits { budget: Some(Budget::Rounds), ..PrunerTraits::default() }
    }

    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, moment: &Moment) -> Vec<bool> {
        without_share(&self.score(cloud, stats, moment), share_at(&self.shares, moment))
    }

    fn needs(&self, _: &GaussianCloud, moment: &Moment) -> Needs {
        if moment.target.is_none() && share_at(&self.shares, moment) == 0.0 {
            return Needs::nothing();
        }
        Needs::of(&[Statistic::Weight, Statistic::Error { high: 1.0 }], self.transmitters)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &Moment) -> Vec<Real> {
        let n = cloud.len();
        let scale = |s: &[Real; 3]| s.iter().copied().fold(Real::NEG_INFINITY, Real::max).exp();
        let terms: [(Real, Vec<Real>); 7] = [
            (25.0, mean_gradients(stats)),
            (100.0, cloud.opacity_logits.iter().map(|o| sigmoid(*o)).collect()),
            (10.0, stats.radius.clone()),
            (25.0, cloud.log_scales.iter().map(scale).collect()),
            (10.0, stats.asked.error.clone()),
            (0.1, stats.visible.clone()),
            (50.0, stats.asked.weight.clone()),
        ];
        let mut sums = vec![0.0; n];
        for (weight, values) in terms.iter().filter(|(_, values)| values.len() == n) {
            let positive: Vec<Real> = values.iter().copied().filter(|v| *v > 0.0).collect();
            let median = quantile(&positive, 0.5);
            if median > 0.0 {
                sums.iter_mut().zip(values).for_each(|(sum, v)| *sum += weight * v / median);
            }
        }
        sums
    }

    fn check(&self) -> Result<(), String> {
        check_shares(&self.shares)
    }
}

/// Of each picture that it was seen in.
fn mean_gradients(stats: &CloudStats) -> Vec<Real> {
    let pairs = stats.gradient.iter().zip(&stats.visible);
    pairs.map(|(sum, count)| if *count > 0.0 { sum / count } else { 0.0 }).collect()
}
