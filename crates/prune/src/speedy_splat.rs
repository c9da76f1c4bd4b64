//! How much the picture changes with the Gaussian's own strength.

use crate::rounds::{asked, check_shares, share_at, without_share};
use pwrfgs_core::{
    Budget, CloudStats, GaussianCloud, JsonSchema, Moment, Needs, Pruner, PrunerTraits, Real, Statistic,
};
use serde::{Deserialize, Serialize};

/// Removes the Gaussians to which the spectra are least sensitive (Speedy-Splat).
///
/// The score is Σ (∂P̂/∂a)² over pixels and training transmitters, with a factor a on the Gaussian's γ, at 1: one number a
/// Gaussian, of second order, as it is the diagonal of the Gauss-Newton Hessian along its own strength (Speedy-Splat, Hanson
/// et al., CVPR 2025, eq. (10), whose derivative is by the Gaussian's value). 80 % may go at once ("soft", while training
/// goes on), then 30 % at a time ("hard"). It sees hiding: a Gaussian before another of the same signal hardly counts.
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
        Needs::of(&[Statistic::Sensitivity], self.transmitters)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &Moment) -> Vec<Real> {
        asked(&stats.asked.sensitivity, cloud)
    }

    fn check(&self) -> Result<(), String> {
        check_shares(&self.shares)
    }
}
