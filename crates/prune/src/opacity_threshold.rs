//! Discards what is nearly transparent.

use pwrfgs_core::{Budget, CloudStats, GaussianCloud, JsonSchema, Moment, Pruner, PrunerTraits, Real, sigmoid};
use serde::{Deserialize, Serialize};

/// Keeps Gaussians with an opacity o = σ(logit) of at least `epsilon` (WRF-GS).
///
/// With the paper's 0.005 it takes dead weight away and goes beside [`crate::LearnableMask`] (section IV; a Gaussian
/// must satisfy both to stay). Alone, with 0.005 to 0.5, it is the WRF-GS baseline of fig. 2b: simple, but opacity is
/// not importance, and quality falls fast. It is asked at the prune steps only; densification has its own floor,
/// `opacity_floor`, because every Gaussian starts at 0.1 and each opacity reset sets it to 0.01 at most.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("OpacityThreshold(epsilon: 0.1)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct OpacityThreshold {
    /// Smallest opacity ε that is kept, from 0 (all Gaussians) to below 1.
    pub epsilon: Real,
}

impl Default for OpacityThreshold {
    fn default() -> Self {
        Self { epsilon: 0.005 }
    }
}

#[typetag::serde]
impl Pruner for OpacityThreshold {
    fn traits(&self) -> PrunerTraits {
        PrunerTraits { budget: Some(Budget::Rounds), ..PrunerTraits::default() }
    }

    fn keep(&self, cloud: &GaussianCloud, _: &CloudStats, _: &Moment) -> Vec<bool> {
        cloud.opacity_logits.iter().map(|logit| sigmoid(*logit) >= self.epsilon).collect()
    }

    fn check(&self) -> Result<(), String> {
        if (0.0..1.0).contains(&self.epsilon) {
            return Ok(());
        }
        Err(format!("`epsilon` is {}; give an opacity from 0 to below 1, such as 0.005", self.epsilon))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{cloud, moment};
    use pwrfgs_core::{Phase, logit};

    #[test]
    fn opacities_from_epsilon_on_stay() {
        let cloud = cloud(&[logit(0.0049), logit(0.0051), 0.0, 40.0, -40.0]);
        let keep = |epsilon| OpacityThreshold { epsilon }.keep(&cloud, &CloudStats::zeros(5), &moment(Phase::Prune));
        assert_eq!(keep(0.005), [false, true, true, true, false]);
        assert_eq!(keep(0.5), [false, false, true, true, false]);
        assert_eq!(keep(0.0), [true; 5]);
    }
}
