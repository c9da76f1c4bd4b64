//! Faint, and not about to change.

use crate::rounds::{check_share, quantile};
use pwrfgs_core::{Budget, CloudStats, GaussianCloud, JsonSchema, Moment, Pruner, PrunerTraits, Real};
use serde::{Deserialize, Serialize};

/// Removes faint Gaussians with small gradients, in rounds with training in between (Trimming the Fat).
///
/// A Gaussian goes where its opacity is below a quantile of all opacities and its mean positional gradient since the last
/// densification below a quantile of all gradients: what is still being moved gets its chance (Trimming the Fat, Salman et
/// al., BMVC 2024). Under `training.target` the score is the larger of its two ranks. Needs no pass.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("TrimmingTheFat(opacity_quantile: 0.1)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TrimmingTheFat {
    /// Opacities below this quantile, from 0 to 1, are faint.
    pub opacity_quantile: Real,
    /// Gradients below this quantile, from 0 to 1, are small.
    pub gradient_quantile: Real,
}

impl Default for TrimmingTheFat {
    fn default() -> Self {
        Self { opacity_quantile: 0.1, gradient_quantile: 0.5 }
    }
}

#[typetag::serde]
impl Pruner for TrimmingTheFat {
    fn traits(&self) -> PrunerTraits {
        PrunerTraits { budget: Some(Budget::Rounds), ..PrunerTraits::default() }
    }

    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, moment: &Moment) -> Vec<bool> {
        if moment.round == 0 {
            return vec![true; cloud.len()];
        }
        let gradients = gradients(stats, cloud.len());
        let faint = quantile(&cloud.opacity_logits, self.opacity_quantile);
        let small = quantile(&gradients, self.gradient_quantile);
        cloud.opacity_logits.iter().zip(&gradients).map(|(o, g)| *o >= faint || *g >= small).collect()
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &Moment) -> Vec<Real> {
        let ranks = [ranks(&cloud.opacity_logits), ranks(&gradients(stats, cloud.len()))];
        ranks[0].iter().zip(&ranks[1]).map(|(a, b)| a.max(*b)).collect()
    }

    fn check(&self) -> Result<(), String> {
        check_share("opacity_quantile", self.opacity_quantile)?;
        check_share("gradient_quantile", self.gradient_quantile)
    }
}

/// Mean positional gradient of each picture it was seen in.
fn gradients(stats: &CloudStats, n: usize) -> Vec<Real> {
    (0..n).map(|i| if stats.visible[i] > 0.0 { stats.gradient[i] / stats.visible[i] } else { 0.0 }).collect()
}

/// How many are smaller, of all; equal values have equal ranks.
fn ranks(values: &[Real]) -> Vec<Real> {
    let mut sorted = values.to_vec();
    sorted.sort_by(Real::total_cmp);
    values.iter().map(|v| sorted.partition_point(|s| s.total_cmp(v).is_lt()) as Real).collect()
}
