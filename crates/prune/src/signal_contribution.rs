//! What a Gaussian sends into the picture, over transmitters.

use crate::rounds::{asked, check_shares, share_at, without_share};
use pwrfgs_core::{
    Budget, CloudStats, GaussianCloud, JsonSchema, Moment, Needs, Pruner, PrunerTraits, Real, Statistic,
};
use serde::{Deserialize, Serialize};

/// Reduction of the scores over transmitters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Over {
    /// Mean over transmitters.
    #[default]
    Mean,
    /// Maximum over transmitters.
    Max,
}

/// Removes the Gaussians with the smallest contribution (signal times blending weight), as mean or maximum over
/// transmitters.
///
/// The score is Σ ‖s(tx)‖ · w over the pixels, with the Gaussian's signal s for a transmitter and its blending weights w = γ·T.
/// In radiance fields of radio a Gaussian's signal depends on the transmitter, so opacity alone, the score of the baseline in
/// the paper's fig. 2b, says little: an opaque Gaussian may be silent. `Mean` asks for what helps in general, `Max` keeps what
/// a single transmitter cannot do without, as RadSplat does with pixels.
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
    pub over: Over,
    /// Share of Gaussians removed at each prune step, in order; after the last entry nothing is removed.
    pub shares: Vec<Real>,
    /// Number of training transmitters used for the score; 0 for all.
    pub transmitters: usize,
}

impl Default for SignalContribution {
    fn default() -> Self {
        Self { over: Over::Mean, shares: vec![0.5, 0.5, 0.5], transmitters: 0 }
    }
}

#[typetag::serde]
impl Pruner for SignalContribution {
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
        Needs::of(&[Statistic::SignalWeight], self.transmitters)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &Moment) -> Vec<Real> {
        asked(if self.over == Over::Max { &stats.asked.signal_max } else { &stats.asked.signal_mean }, cloud)
    }

    fn check(&self) -> Result<(), String> {
        check_shares(&self.shares)
    }
}
