//! Pruners that rank Gaussians by their effect on the spectra: blending weight (LightGaussian), contributed signal
//! (`SignalContribution`), or sensitivity (`SpeedySplat`).

use crate::common::{quantile, ranking_traits, requested_statistic};
use pwrfgs_core::{CloudStats, GaussianCloud, JsonSchema, Needs, Pruner, PrunerTraits, Real, Statistic, StepContext};
use serde::{Deserialize, Serialize};

/// Removes the Gaussians with the smallest blending weight, weighted by volume (LightGaussian).
///
/// The score is Σ w · min(V/V₉₀, 1)^0.1. Here w = γ·T are the blending weights over all pixels and training
/// transmitters, V is the product of the scales, and V₉₀ is the 90th percentile of V. It removes Gaussians of low
/// visibility, however opaque they are. It prefers Gaussians that are weakly visible for every transmitter to Gaussians
/// that one transmitter needs; [`crate::SignalContribution`] can keep the latter. Source: LightGaussian, Fan et al.,
/// NeurIPS 2024, eq. (4); the paper removes 66 % at the first prune step.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("LightGaussian(transmitters: 256)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LightGaussian {
    /// Number of training transmitters used for the score; 0 for all.
    pub transmitters: usize,
}

/// Exponent of the volume, as in the published code.
const VOLUME_POWER: Real = 0.1;

#[typetag::serde]
impl Pruner for LightGaussian {
    fn traits(&self) -> PrunerTraits {
        ranking_traits()
    }

    fn needs(&self, _: &GaussianCloud, _: &StepContext) -> Needs {
        Needs::of(&[Statistic::Weight], self.transmitters)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &StepContext) -> Vec<Real> {
        let volumes: Vec<Real> = cloud.log_scales.iter().map(|s| s.iter().sum::<Real>().exp()).collect();
        let v90 = quantile(&volumes, 0.9);
        let factor = |v: Real| (v / v90).min(1.0).powf(VOLUME_POWER);
        let weight = requested_statistic(&stats.requested.weight, cloud);
        if stats.requested.weight.len() != cloud.len() {
            return weight;
        }
        weight.iter().zip(volumes).map(|(w, v)| w * factor(v)).collect()
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
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SignalContribution {
    /// Reduction over transmitters.
    pub over: LinkReduction,
    /// Number of training transmitters used for the score; 0 for all.
    pub transmitters: usize,
}

#[typetag::serde]
impl Pruner for SignalContribution {
    fn traits(&self) -> PrunerTraits {
        ranking_traits()
    }

    fn needs(&self, _: &GaussianCloud, _: &StepContext) -> Needs {
        Needs::of(&[Statistic::SignalWeight], self.transmitters)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &StepContext) -> Vec<Real> {
        requested_statistic(
            if self.over == LinkReduction::Max { &stats.requested.signal_max } else { &stats.requested.signal_mean },
            cloud,
        )
    }
}

/// Removes the Gaussians to which the spectra are least sensitive (Speedy-Splat).
///
/// The score is Σ (∂P̂/∂a)² over pixels and training transmitters, with a factor a = 1 on γ of the Gaussian. It has one
/// value per Gaussian, the diagonal of the Gauss-Newton Hessian with respect to a, and is of second order. The score
/// includes occlusion: a Gaussian in front of another one with the same signal counts little. Source: Speedy-Splat,
/// Hanson et al., CVPR 2025, eq. (10), with the derivative by the value of the Gaussian; the paper removes 80 % at once,
/// then 30 % per prune step.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("SpeedySplat(transmitters: 64)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SpeedySplat {
    /// Number of training transmitters used for the score; 0 for all.
    pub transmitters: usize,
}

impl Default for SpeedySplat {
    fn default() -> Self {
        Self { transmitters: 256 }
    }
}

#[typetag::serde]
impl Pruner for SpeedySplat {
    fn traits(&self) -> PrunerTraits {
        ranking_traits()
    }

    fn needs(&self, _: &GaussianCloud, _: &StepContext) -> Needs {
        Needs::of(&[Statistic::Sensitivity], self.transmitters)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &StepContext) -> Vec<Real> {
        requested_statistic(&stats.requested.sensitivity, cloud)
    }
}
