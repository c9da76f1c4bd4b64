//! A pull on all opacities until nothing more goes.

use crate::rounds::{check_below_one, check_share, check_target, check_weight};
use dfdx::prelude::{Rank0, SumTo};
use pwrfgs_core::{
    Budget, CloudStats, ColumnSpec, GaussianCloud, JsonSchema, Moment, Phase, Pruner, Real, sigmoid,
    tape::{TraceScalar, Traced},
};
use serde::{Deserialize, Serialize};

/// The column that says whether the pull is on.
const PULL: &str = "control_pull";

/// Pulls all opacities down a little and drops what has faded, until a prune step takes next to nothing (ControlGS).
///
/// The loss gains lambda · Σ o; what is below `epsilon` goes, at each prune step, as long as the one before took at least the
/// share `settle` of all (ControlGS, Zhang et al., 2025: 3e-7, and 2,000 of some million a round). Then the pull and the
/// pruning stop: the number of Gaussians follows from lambda alone and not from how long one waits. That it has stopped is a
/// number which the pipeline remembers, checkpoints included.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner};
/// Plugin::<dyn Pruner>::parse("ControlGs(lambda: 1e-5)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ControlGs {
    /// Weight λ of the sum of opacities, 0 or more.
    pub lambda: Real,
    /// Opacity ε below which a Gaussian goes, from 0 to below 1.
    pub epsilon: Real,
    /// A prune step that takes less than this share of all is the last, from 0 to 1.
    pub settle: Real,
    /// How many Gaussians there shall be at the end of pruning, in equal ratios from prune step to prune step; in place of
    /// `epsilon`.
    pub target: Option<usize>,
}

impl Default for ControlGs {
    fn default() -> Self {
        Self { lambda: 0.00001, epsilon: 0.005, settle: 0.01, target: None }
    }
}

#[typetag::serde]
impl Pruner for ControlGs {
    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &Moment) -> Vec<bool> {
        let settled = settled(&stats.state);
        cloud.opacity_logits.iter().map(|logit| settled || sigmoid(*logit) >= self.epsilon).collect()
    }

    fn columns(&self) -> Vec<ColumnSpec> {
        // Of all Gaussians the same: the tape sees columns, and no memory of the pipeline.
        vec![ColumnSpec::state(PULL, 1.0)]
    }

    fn penalty(&self, cloud: &Traced, moment: &Moment) -> Option<TraceScalar> {
        (moment.phase == Phase::Prune && !cloud.is_empty())
            .then(|| (cloud.opacities() * cloud.leaf(PULL).clone()).sum::<Rank0, _>() * self.lambda)
    }

    fn update(&self, cloud: &mut GaussianCloud, stats: &CloudStats, _: &Moment) {
        let pull = if settled(&stats.state) { 0.0 } else { 1.0 };
        cloud.extra.iter_mut().filter(|column| column.name == PULL).for_each(|column| column.values.fill(pull));
    }

    fn state(&self) -> Option<Vec<Real>> {
        Some(vec![0.0])
    }

    fn advance(&self, state: &mut [Real], n: usize, cloud: &GaussianCloud, _: &Moment) {
        let many = n.saturating_sub(cloud.len()) as Real >= self.settle * n as Real;
        // Before many have faded, few that go are no sign that it has settled.
        state[0] = match (many, state[0] < 0.0) {
            (true, _) => -1.0,
            (false, true) => 1.0,
            (false, false) => state[0],
        };
    }

    fn with_target(&self, target: usize) -> Option<Box<dyn Pruner>> {
        Some(Box::new(Self { target: Some(target), ..self.clone() }))
    }

    fn budget(&self) -> Option<Budget> {
        self.target.map(Budget::Rounds)
    }

    fn check(&self) -> Result<(), String> {
        check_weight("lambda", self.lambda)?;
        check_share("settle", self.settle)?;
        check_below_one("epsilon", self.epsilon)?;
        check_target(self.target)
    }
}

/// 0: not many have gone yet; −1: they are going; 1: it has settled.
fn settled(state: &[Real]) -> bool {
    state.first().is_some_and(|state| *state > 0.0)
}
