//! The largest weight in any pixel.

use crate::rounds::{asked, check_share};
use pwrfgs_core::{
    Budget, CloudStats, GaussianCloud, JsonSchema, Moment, Needs, Pruner, PrunerTraits, Real, Statistic,
};
use serde::{Deserialize, Serialize};

/// Keeps Gaussians with a blending weight of at least `threshold` in any pixel of any transmitter (RadSplat).
///
/// The score is max w, the largest blending weight γ·T over all pixels and training transmitters (RadSplat, Niemeyer et al.,
/// 3DV 2025, eq. (12); 0.01 there, 0.25 for a light model). A maximum keeps what a single pixel needs, where a sum keeps what
/// is seen often: of two like Gaussians behind each other the front one stays.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("RadSplat(threshold: 0.01)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RadSplat {
    /// Smallest blending weight that is kept, from 0 to 1.
    pub threshold: Real,
    /// Number of training transmitters used for the score; 0 for all.
    pub transmitters: usize,
}

impl Default for RadSplat {
    fn default() -> Self {
        Self { threshold: 0.01, transmitters: 0 }
    }
}

#[typetag::serde]
impl Pruner for RadSplat {
    fn traits(&self) -> PrunerTraits {
        PrunerTraits { budget: Some(Budget::Rounds), ..PrunerTraits::default() }
    }

    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &Moment) -> Vec<bool> {
        let known = stats.asked.largest_weight.len() == cloud.len();
        (0..cloud.len()).map(|i| !known || stats.asked.largest_weight[i] >= self.threshold).collect()
    }

    fn needs(&self, _: &GaussianCloud, _: &Moment) -> Needs {
        Needs::of(&[Statistic::LargestWeight], self.transmitters)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &Moment) -> Vec<Real> {
        asked(&stats.asked.largest_weight, cloud)
    }

    fn check(&self) -> Result<(), String> {
        check_share("threshold", self.threshold)
    }
}
