//! What a Gaussian sends into the picture, over transmitters.

use crate::rounds::{asked, check_shares, share_at, without_share};
use pwrfgs_core::{
    Budget, CloudStats, GaussianCloud, JsonSchema, Moment, Needs, Pruner, PrunerTraits, Real, Statistic,
};
use serde::{Deserialize, Serialize};

/// How the numbers of all transmitters become one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Over {
    /// Their mean.
    #[default]
    Mean,
    /// The largest.
    Max,
}

/// Drops what sends least into the pictures: signal times weight, in the mean over transmitters or for the one that needs
/// it most.
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
    /// How transmitters are put together.
    pub over: Over,
    /// The share that goes at each prune step, from the first on; after the last of them nothing goes.
    pub shares: Vec<Real>,
    /// Training transmitters that a pass looks at; 0: all.
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
