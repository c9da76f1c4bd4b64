//! A pull on all opacities until nothing more goes.

use crate::rounds::{check_below_one, check_share, check_weight};
use dfdx::prelude::{Rank0, SumTo};
use pwrfgs_core::{
    Budget, CloudStats, ColumnSpec, GaussianCloud, JsonSchema, Moment, Phase, Pruner, PrunerTraits, Real, sigmoid,
    tape::{TraceScalar, Traced},
};
use serde::{Deserialize, Serialize};

/// The column that says whether the pull is on.
const PULL: &str = "control_pull";
/// The column of the number of Gaussians before the prune step that was taken last; 0 once it is counted.
const COUNT: &str = "control_count";
/// The column that says how pruning goes: 0, not many are gone yet; −1, they are going; 1, it has settled.
const TREND: &str = "control_trend";

/// Decreases all opacities and removes faint Gaussians, until a prune step removes almost none (ControlGS).
///
/// The loss gains lambda · Σ o; what is below `epsilon` goes, at each prune step, as long as the one before took at least the
/// share `settle` of all (ControlGS, Zhang et al., 2025: 3e-7, and 2,000 of some million a round). Then the pull and the
/// pruning stop: the number of Gaussians follows from lambda alone and not from how long one waits. That it has stopped is
/// kept in a column, checkpoints included.
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
    /// Pruning ends with the first prune step that removes less than this share of all Gaussians, from 0 to 1.
    pub settle: Real,
}

impl Default for ControlGs {
    fn default() -> Self {
        Self { lambda: 0.00001, epsilon: 0.005, settle: 0.01 }
    }
}

#[typetag::serde]
impl Pruner for ControlGs {
    fn traits(&self) -> PrunerTraits {
        // Of all Gaussians the same: what is remembered of the pipeline.
        let columns = vec![ColumnSpec::state(PULL, 1.0), ColumnSpec::state(COUNT, 0.0), ColumnSpec::state(TREND, 0.0)];
        PrunerTraits { columns, budget: Some(Budget::Rounds), ..PrunerTraits::default() }
    }

    fn keep(&self, cloud: &GaussianCloud, _: &CloudStats, _: &Moment) -> Vec<bool> {
        let settled = number(cloud, TREND) > 0.0;
        cloud.opacity_logits.iter().map(|logit| settled || sigmoid(*logit) >= self.epsilon).collect()
    }

    fn penalty(&self, cloud: &Traced, moment: &Moment) -> Option<TraceScalar> {
        (moment.phase == Phase::Prune && !cloud.is_empty())
            .then(|| (cloud.opacities() * cloud.leaf(PULL).clone()).sum::<Rank0, _>() * self.lambda)
    }

    fn update(&self, cloud: &mut GaussianCloud, _: &CloudStats, moment: &Moment) {
        let (n, before, mut trend) = (cloud.len(), number(cloud, COUNT), number(cloud, TREND));
        if before > 0.0 {
            // Before many have faded, few that go are no sign that it has settled.
            let many = (before - n as Real).max(0.0) >= self.settle * before;
            trend = match (many, trend < 0.0) {
                (true, _) => -1.0,
                (false, true) => 1.0,
                (false, false) => trend,
            };
        }
        let pull = if trend > 0.0 { 0.0 } else { 1.0 };
        let count = if moment.round > 0 { n as Real } else { 0.0 };
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
        check_share("settle", self.settle)?;
        check_below_one("epsilon", self.epsilon)
    }
}

/// The value of a column that all Gaussians have; 0 without it.
fn number(cloud: &GaussianCloud, column: &str) -> Real {
    cloud.extra(column).and_then(|column| column.values.first()).copied().unwrap_or(0.0)
}
