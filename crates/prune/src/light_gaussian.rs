//! Weight in the pictures, and a little of the volume.

use crate::rounds::{asked, check_shares, check_weight, quantile, share_at, without_share};
use pwrfgs_core::{
    Budget, CloudStats, GaussianCloud, JsonSchema, Moment, Needs, Pruner, PrunerTraits, Real, Statistic,
};
use serde::{Deserialize, Serialize};

/// Removes a share of the Gaussians with the smallest blending weight, weighted by volume (LightGaussian).
///
/// The score is Σ w · min(V/V₉₀, 1)^`volume_power`, w = γ·T the blending weights over all pixels and training transmitters, V
/// the product of the scales and V₉₀ the volume that nine tenths do not reach (LightGaussian, Fan et al., NeurIPS 2024,
/// eq. (4)). It prunes two thirds at once there, then a decaying share, and fine-tunes. What hardly shows goes, however
/// opaque it is; what shows a little to every transmitter stays before what one transmitter alone needs: for that see
/// [`crate::SignalContribution`].
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
        Needs::of(&[Statistic::Weight], self.transmitters)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &Moment) -> Vec<Real> {
        let volumes: Vec<Real> = cloud.log_scales.iter().map(|s| s.iter().sum::<Real>().exp()).collect();
        let large = quantile(&volumes, 0.9);
        let factor = |v: Real| (v / large).min(1.0).powf(self.volume_power);
        let weight = asked(&stats.asked.weight, cloud);
        if stats.asked.weight.len() != cloud.len() {
            return weight;
        }
        weight.iter().zip(volumes).map(|(w, v)| w * factor(v)).collect()
    }

    fn check(&self) -> Result<(), String> {
        check_shares(&self.shares)?;
        check_weight("volume_power", self.volume_power)
    }
}
