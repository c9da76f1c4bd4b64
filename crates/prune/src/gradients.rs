//! Pruners whose scores include the gradient of the position.

use crate::common::{quantile, ranking_traits};
use crate::settings::check_share;
use pwrfgs_core::{
    Budget, CloudStats, GaussianCloud, JsonSchema, Needs, Pruner, PrunerTraits, Real, Statistic, StepContext, sigmoid,
};
use serde::{Deserialize, Serialize};

/// Removes faint Gaussians with small gradients, in rounds with training in between (Trimming the Fat).
///
/// A Gaussian is removed if its opacity is below a quantile of all opacities and its mean positional gradient since the
/// last densification is below a quantile of all gradients. Gaussians that are still moving are kept. Under
/// `training.target_count` the score is the larger of the two ranks. The score needs no pass over the training set. Source:
/// Trimming the Fat, Salman et al., BMVC 2024.
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
        PrunerTraits { budget: Some(Budget::Gradual), ..PrunerTraits::default() }
    }

    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, context: &StepContext) -> Vec<bool> {
        if context.round == 0 {
            return vec![true; cloud.len()];
        }
        let gradients = mean_gradients(stats, cloud.len());
        let faint = quantile(&cloud.opacity_logits, self.opacity_quantile);
        let small = quantile(&gradients, self.gradient_quantile);
        cloud.opacity_logits.iter().zip(&gradients).map(|(o, g)| *o >= faint || *g >= small).collect()
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &StepContext) -> Vec<Real> {
        let (opacity, gradient) = (ranks(&cloud.opacity_logits), ranks(&mean_gradients(stats, cloud.len())));
        opacity.iter().zip(&gradient).map(|(a, b)| a.max(*b)).collect()
    }

    fn check(&self) -> Result<(), String> {
        check_share("opacity_quantile", self.opacity_quantile)?;
        check_share("gradient_quantile", self.gradient_quantile)
    }
}

/// Returns the mean positional gradient per Gaussian `[N]`, over the spectra in which it is visible; 0 if there are none.
fn mean_gradients(stats: &CloudStats, n: usize) -> Vec<Real> {
    (0..n).map(|i| if stats.visible[i] > 0.0 { stats.gradient[i] / stats.visible[i] } else { 0.0 }).collect()
}

/// Returns the rank of each value: the number of smaller values. Equal values have equal ranks.
fn ranks(values: &[Real]) -> Vec<Real> {
    let mut sorted = values.to_vec();
    sorted.sort_by(Real::total_cmp);
    values.iter().map(|v| sorted.partition_point(|s| s.total_cmp(v).is_lt()) as Real).collect()
}

/// Removes the Gaussians with the lowest weighted sum of several scores, each divided by its median (Taming 3DGS).
///
/// The score is that of Taming 3DGS (Mallick et al., SIGGRAPH Asia 2024, section 4.2), which uses it to choose
/// Gaussians to densify under an exact budget. Medians are those of positive values. Weights of the terms: gradient
/// 25, opacity 100, radius 10, scale 25, loss 10 (blending weights times errors), count 0.1 (spectra in which the
/// Gaussian is visible), blend 50 (blending weights). The terms for depth and distance are left out: they distinguish
/// moving cameras, and a receiver is fixed.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("Taming3dgs(transmitters: 64)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Taming3dgs {
    /// Number of training transmitters used for the score; 0 for all.
    pub transmitters: usize,
}

impl Default for Taming3dgs {
    fn default() -> Self {
        Self { transmitters: 256 }
    }
}

#[typetag::serde]
impl Pruner for Taming3dgs {
    fn traits(&self) -> PrunerTraits {
        ranking_traits()
    }

    fn needs(&self, _: &GaussianCloud, _: &StepContext) -> Needs {
        let error = Statistic::Error { high: 1.0 }; // high errors are not used
        Needs::of(&[Statistic::Weight, error], self.transmitters)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &StepContext) -> Vec<Real> {
        let n = cloud.len();
        let largest_scale = |s: &[Real; 3]| s.iter().copied().fold(Real::NEG_INFINITY, Real::max).exp();
        // Weights as published.
        let terms: [(Real, Vec<Real>); 7] = [
            (25.0, mean_gradients(stats, n)),
            (100.0, cloud.opacity_logits.iter().map(|o| sigmoid(*o)).collect()),
            (10.0, stats.radius.clone()),
            (25.0, cloud.log_scales.iter().map(largest_scale).collect()),
            (10.0, stats.requested.error.clone()),
            (0.1, stats.visible.clone()),
            (50.0, stats.requested.weight.clone()),
        ];
        let mut sums = vec![0.0; n];
        // A requested statistic is empty if the pass did not compute it.
        for (weight, values) in terms.iter().filter(|(_, values)| values.len() == n) {
            let positive: Vec<Real> = values.iter().copied().filter(|v| *v > 0.0).collect();
            let median = quantile(&positive, 0.5);
            if median > 0.0 {
                sums.iter_mut().zip(values).for_each(|(sum, v)| *sum += weight * v / median);
            }
        }
        sums
    }
}
