//! Pruner that lets all opacities decay against the gradient of the loss.

use crate::settings::{check_below_one, check_weight};
use dfdx::prelude::{MeanTo, Rank0};
use pwrfgs_core::{
    Budget, CloudStats, ColumnSpec, GaussianCloud, JsonSchema, Phase, Pruner, PrunerTraits, Real, StepContext, sigmoid,
    tape::{TraceScalar, TracedCloud},
};
use serde::{Deserialize, Serialize};

/// Column of lives: moving averages of opacity.
const LIFE: &str = "life";
/// Decay factor of the moving average of opacity per step.
const MEMORY: Real = 0.9;

/// Decreases all opacities equally; gradients preserve the Gaussians that are needed (Natural Selection).
///
/// The loss gains `pressure` times the mean opacity logit. Every logit thus decreases at the same rate, whatever the
/// opacity of its Gaussian, unless the gradient of the loss opposes it. Life is a moving average of opacity, so that
/// one noisy batch does not remove a Gaussian. Prune steps remove the Gaussians with a life below `epsilon`. Source:
/// Gaussian Natural Selection, 2025, whose decay field is this penalty; a final cut to a budget (`training.target_count`)
/// sets its number of Gaussians.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("NaturalSelection(pressure: 0.05)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct NaturalSelection {
    /// Weight of the mean logit, 0 or more.
    pub pressure: Real,
    /// Gaussians whose averaged opacity is below ε are removed; from 0 to below 1.
    pub epsilon: Real,
}

impl Default for NaturalSelection {
    fn default() -> Self {
        Self { pressure: 0.05, epsilon: 0.005 }
    }
}

#[typetag::serde]
impl Pruner for NaturalSelection {
    fn traits(&self) -> PrunerTraits {
        PrunerTraits {
            // Lives start at 1; the moving average soon forgets this value.
            columns: vec![ColumnSpec::state(LIFE, 1.0)],
            budget: Some(Budget::FinalStep),
            ..PrunerTraits::default()
        }
    }

    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, context: &StepContext) -> Vec<bool> {
        self.score(cloud, stats, context).iter().map(|life| *life >= self.epsilon).collect()
    }

    fn penalty(&self, cloud: &TracedCloud, context: &StepContext) -> Option<TraceScalar> {
        (context.phase == Phase::Prune && !cloud.is_empty())
            .then(|| cloud.column("opacity_logits").mean::<Rank0, _>() * self.pressure)
    }

    fn update(&self, cloud: &mut GaussianCloud, _: &CloudStats, _: &StepContext) {
        let opacities: Vec<Real> = cloud.opacity_logits.iter().map(|o| sigmoid(*o)).collect();
        for column in cloud.extra.iter_mut().filter(|column| column.name == LIFE) {
            let lives = column.values.iter_mut().zip(&opacities);
            lives.for_each(|(life, o)| *life = MEMORY * *life + (1.0 - MEMORY) * o);
        }
    }

    fn score(&self, cloud: &GaussianCloud, _: &CloudStats, _: &StepContext) -> Vec<Real> {
        let opacities = || cloud.opacity_logits.iter().map(|o| sigmoid(*o)).collect();
        cloud.extra(LIFE).map_or_else(opacities, |column| column.values.clone())
    }

    fn check(&self) -> Result<(), String> {
        check_weight("pressure", self.pressure)?;
        check_below_one("epsilon", self.epsilon)
    }
}
