//! Pruner that decreases all opacities until pruning settles.

use crate::settings::{check_below_one, check_weight};
use dfdx::prelude::{Rank0, SumTo};
use pwrfgs_core::{
    Budget, CloudStats, ColumnSpec, GaussianCloud, JsonSchema, Phase, Pruner, PrunerTraits, Real, StepContext, sigmoid,
    tape::{TraceScalar, TracedCloud},
};
use serde::{Deserialize, Serialize};

/// Column that states whether the opacity penalty is active.
const PULL: &str = "control_pull";
/// Column with the number of Gaussians before the previous prune step; 0 once that step is evaluated.
const COUNT: &str = "control_count";
/// Column with the state of pruning: 0, few Gaussians removed so far; −1, many are being removed; 1, settled.
const TREND: &str = "control_trend";
/// Pruning has settled if a prune step removes less than this share of all Gaussians. The published 2,000 of some
/// million would be less than one Gaussian of a small cloud.
const SETTLED: Real = 0.01;

/// Decreases all opacities and removes faint Gaussians, until a prune step removes almost none (ControlGS).
///
/// The loss gains lambda · Σ o. Each prune step removes the Gaussians below `epsilon`. Once a prune step has removed
/// at least 1 % of all Gaussians, the penalty and the pruning stop after the first step that removes less. The number
/// of Gaussians thus follows from lambda alone, not from the length of the pruning phase. A column stores this state,
/// so that checkpoints keep it. Source: ControlGS, Zhang et al., 2025, with 3e-7 and 2,000 of some million Gaussians
/// per round.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("ControlGs(lambda: 1e-5)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ControlGs {
    /// Weight λ of the sum of opacities, 0 or more.
    pub lambda: Real,
    /// Gaussians with an opacity below ε are removed; from 0 to below 1.
    pub epsilon: Real,
}

impl Default for ControlGs {
    fn default() -> Self {
        Self { lambda: 0.00001, epsilon: 0.005 }
    }
}

#[typetag::serde]
impl Pruner for ControlGs {
    fn traits(&self) -> PrunerTraits {
        // All Gaussians have equal values in these columns: they store the state of the pruner.
        let columns = vec![ColumnSpec::state(PULL, 1.0), ColumnSpec::state(COUNT, 0.0), ColumnSpec::state(TREND, 0.0)];
        PrunerTraits { columns, budget: Some(Budget::Gradual), ..PrunerTraits::default() }
    }

    fn keep(&self, cloud: &GaussianCloud, _: &CloudStats, _: &StepContext) -> Vec<bool> {
        let settled = shared_value(cloud, TREND) > 0.0;
        cloud.opacity_logits.iter().map(|logit| settled || sigmoid(*logit) >= self.epsilon).collect()
    }

    fn penalty(&self, cloud: &TracedCloud, context: &StepContext) -> Option<TraceScalar> {
        (context.phase == Phase::Prune && !cloud.is_empty())
            .then(|| (cloud.opacities() * cloud.leaf(PULL).clone()).sum::<Rank0, _>() * self.lambda)
    }

    /// Updates the state of pruning after a prune step, from N before it, which this function stores in the prune step.
    fn update(&self, cloud: &mut GaussianCloud, _: &CloudStats, context: &StepContext) {
        let (n, before, mut trend) = (cloud.len(), shared_value(cloud, COUNT), shared_value(cloud, TREND));
        if before > 0.0 {
            // Before many Gaussians have faded, a small number of removals does not mean that pruning has settled.
            let many = (before - n as Real).max(0.0) >= SETTLED * before;
            trend = match (many, trend < 0.0) {
                (true, _) => -1.0,
                (false, true) => 1.0,
                (false, false) => trend,
            };
        }
        let pull = if trend > 0.0 { 0.0 } else { 1.0 };
        let count = if context.round > 0 { n as Real } else { 0.0 };
        for column in &mut cloud.extra {
            match column.name.as_str() {
                PULL => column.values.fill(pull),
                COUNT => column.values.fill(count),
                TREND => column.values.fill(trend),
                _ => {}
            }
        }
    }

    fn check(&self) -> Result<(), String> {
        check_weight("lambda", self.lambda)?;
        check_below_one("epsilon", self.epsilon)
    }
}

/// Returns the value that all Gaussians share in a column; 0 without the column.
fn shared_value(cloud: &GaussianCloud, column: &str) -> Real {
    cloud.extra(column).and_then(|column| column.values.first()).copied().unwrap_or(0.0)
}
