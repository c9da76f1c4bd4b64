//! Pruners that remove a share at each prune step, by the effect of a Gaussian on the spectra: blending weight
//! (LightGaussian), contributed signal (`SignalContribution`), or sensitivity (`SpeedySplat`).

use crate::rounds::{check_shares, check_weight, needs, quantile, removes_shares, requested_statistic};
use pwrfgs_core::{CloudStats, GaussianCloud, JsonSchema, Needs, Pruner, Real, Statistic, StepContext};
use serde::{Deserialize, Serialize};

/// Removes a share of the Gaussians with the smallest blending weight, weighted by volume (LightGaussian).
///
/// The score is Σ w · min(V/V₉₀, 1)^`volume_power`. Here w = γ·T are the blending weights over all pixels and training
/// transmitters, V is the product of the scales, and V₉₀ is the 90th percentile of V. The method prunes two thirds at
/// once, then a decaying share, and fine-tunes. It removes Gaussians of low visibility, however opaque they are. It
/// prefers Gaussians that are weakly visible for every transmitter to Gaussians that one transmitter needs;
/// [`crate::SignalContribution`] can keep the latter. Source: LightGaussian, Fan et al., NeurIPS 2024, eq. (4).
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("LightGaussian(volume_power: 0.1)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LightGaussian {
    /// Share of Gaussians removed at each prune step, in order; after the last entry nothing is removed.
    pub shares: Vec<Real>,
    /// Exponent of the volume, 0 or more; 0 ignores the volume.
    pub volume_power: Real,
    /// Number of training transmitters used for the score; 0 for all.
    pub transmitters: usize,
}

impl Default for LightGaussian {
    fn default() -> Self {
        Self { shares: vec![0.66, 0.4, 0.24], volume_power: 0.1, transmitters: 0 }
    }
}

#[typetag::serde]
impl Pruner for LightGaussian {
    removes_shares!();

    fn needs(&self, _: &GaussianCloud, context: &StepContext) -> Needs {
        needs(&[Statistic::Weight], self.transmitters, &self.shares, context)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &StepContext) -> Vec<Real> {
        let volumes: Vec<Real> = cloud.log_scales.iter().map(|s| s.iter().sum::<Real>().exp()).collect();
        let large = quantile(&volumes, 0.9);
        let factor = |v: Real| (v / large).min(1.0).powf(self.volume_power);
        let weight = requested_statistic(&stats.requested.weight, cloud);
        if stats.requested.weight.len() != cloud.len() {
            return weight;
        }
        weight.iter().zip(volumes).map(|(w, v)| w * factor(v)).collect()
    }

    fn check(&self) -> Result<(), String> {
        check_shares(&self.shares)?;
        check_weight("volume_power", self.volume_power)
    }
}

/// Reduction of the scores over transmitters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum LinkReduction {
    /// Mean over transmitters.
    #[default]
    Mean,
    /// Maximum over transmitters.
    Max,
}

/// Removes the Gaussians with the smallest contribution (signal times blending weight), as mean or maximum over
/// transmitters.
///
/// The score is Σ ‖s(tx)‖ · w over the pixels, with the signal s of the Gaussian for a transmitter and its blending
/// weights w = γ·T. The signal of a Gaussian depends on the transmitter. Opacity alone, the score of the baseline in
/// fig. 2b of the paper, is therefore a weak measure: an opaque Gaussian may emit no signal. `Mean` keeps the Gaussians
/// that contribute on average. `Max` keeps those that a single transmitter needs, as RadSplat does per pixel.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("SignalContribution(over: Max)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SignalContribution {
    /// Reduction over transmitters.
    pub over: LinkReduction,
    /// Share of Gaussians removed at each prune step, in order; after the last entry nothing is removed.
    pub shares: Vec<Real>,
    /// Number of training transmitters used for the score; 0 for all.
    pub transmitters: usize,
}

impl Default for SignalContribution {
    fn default() -> Self {
        Self { over: LinkReduction::Mean, shares: vec![0.5, 0.5, 0.5], transmitters: 0 }
    }
}

#[typetag::serde]
impl Pruner for SignalContribution {
    removes_shares!();

    fn needs(&self, _: &GaussianCloud, context: &StepContext) -> Needs {
        needs(&[Statistic::SignalWeight], self.transmitters, &self.shares, context)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &StepContext) -> Vec<Real> {
        requested_statistic(
            if self.over == LinkReduction::Max { &stats.requested.signal_max } else { &stats.requested.signal_mean },
            cloud,
        )
    }

    fn check(&self) -> Result<(), String> {
        check_shares(&self.shares)
    }
}

/// Removes the Gaussians to which the spectra are least sensitive (Speedy-Splat).
///
/// The score is Σ (∂P̂/∂a)² over pixels and training transmitters, with a factor a = 1 on γ of the Gaussian. It has one
/// value per Gaussian, the diagonal of the Gauss-Newton Hessian with respect to a, and is of second order. The paper
/// removes 80 % at once ("soft", during training), then 30 % per prune step ("hard"). The score includes occlusion: a
/// Gaussian in front of another one with the same signal counts little. Source: Speedy-Splat, Hanson et al., CVPR 2025,
/// eq. (10), with the derivative by the value of the Gaussian.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("SpeedySplat(shares: [0.8])")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SpeedySplat {
    /// Share of Gaussians removed at each prune step, in order; after the last entry nothing is removed.
    pub shares: Vec<Real>,
    /// Number of training transmitters used for the score; 0 for all.
    pub transmitters: usize,
}

impl Default for SpeedySplat {
    fn default() -> Self {
        Self { shares: vec![0.8, 0.3, 0.3, 0.3], transmitters: 256 }
    }
}

#[typetag::serde]
impl Pruner for SpeedySplat {
    removes_shares!();

    fn needs(&self, _: &GaussianCloud, context: &StepContext) -> Needs {
        needs(&[Statistic::Sensitivity], self.transmitters, &self.shares, context)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &StepContext) -> Vec<Real> {
        requested_statistic(&stats.requested.sensitivity, cloud)
    }

    fn check(&self) -> Result<(), String> {
        check_shares(&self.shares)
    }
}
