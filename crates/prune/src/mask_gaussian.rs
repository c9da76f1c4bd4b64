//! Pruner with one Bernoulli sample per Gaussian and step; masked Gaussians still learn.

use crate::common::{learned_column, logistic_noise, shortened_rate};
use crate::settings::{check_rate, check_weight};
use dfdx::prelude::{MeanTo, Rank0};
use pwrfgs_core::{
    Budget, CloudStats, ColumnSpec, Gate, GaussianCloud, JsonSchema, Phase, Pruner, PrunerTraits, Real, StepContext,
    rng,
    tape::{Trace, TraceScalar, TracedCloud},
};
use serde::{Deserialize, Serialize};

/// Column of logits m.
const COLUMN: &str = "presence_logits";
/// Initial mask logit m; σ(1) is 0.73.
const INITIAL_LOGIT: Real = 1.0;
/// Number of samples of each mask at a prune step: a Gaussian with σ(m) = 0.2 is kept with probability 0.9.
const DRAWS: usize = 10;

/// Learns an existence probability per Gaussian; masked Gaussians still receive gradients (MaskGaussian).
///
/// In each step M = 1[m + g > 0] with logistic noise g, so that M = 1 with probability σ(m). Its derivative is that of
/// the relaxed sample σ(m + g). M multiplies only γ of a Gaussian, [`Gate::Existence`]. A Gaussian with M = 0 is not
/// drawn, but still receives the gradient of its absence, so that it can come back. The loss gains
/// lambda · (mean M)²; this penalty weakens as the number of Gaussians decreases. Prune steps remove the Gaussians
/// whose masks are closed in all of ten samples. Compared with [`crate::LearnableMask`], whose closed masks cannot
/// reopen, a step costs more, because no Gaussian is skipped. Source: MaskGaussian, Liu et al., CVPR 2025, section 3.2,
/// with one logit per Gaussian in place of two.
///
/// Fine-tuning uses all remaining Gaussians without masks. Under `training.target_count` the last prune step keeps the
/// Gaussians with the largest m.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("MaskGaussian(lambda: 0.1)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MaskGaussian {
    /// Weight λ of the penalty, 0 or more.
    pub lambda: Real,
    /// Learning rate of the mask logit m (Adam).
    pub learning_rate: Real,
}

impl Default for MaskGaussian {
    fn default() -> Self {
        Self { lambda: 0.1, learning_rate: 0.01 }
    }
}

#[typetag::serde]
impl Pruner for MaskGaussian {
    fn traits(&self) -> PrunerTraits {
        PrunerTraits {
            columns: vec![ColumnSpec::learned(COLUMN, INITIAL_LOGIT, self.learning_rate)],
            budget: Some(Budget::FinalStep),
            ..PrunerTraits::default()
        }
    }

    fn keep(&self, cloud: &GaussianCloud, _: &CloudStats, context: &StepContext) -> Vec<bool> {
        let Some(column) = cloud.extra(COLUMN) else { return vec![true; cloud.len()] };
        let mut random = rng::stream(context.seed, "pruner MaskGaussian prune", context.step);
        let mut keep = vec![false; cloud.len()];
        for _ in 0..DRAWS {
            let noise = logistic_noise(cloud.len(), &mut random);
            keep.iter_mut().zip(column.values.iter().zip(noise)).for_each(|(keep, (m, g))| *keep |= m + g > 0.0);
        }
        keep
    }

    fn gate(&self, cloud: &TracedCloud, context: &StepContext) -> Option<Gate> {
        (context.phase != Phase::Finetune).then(|| Gate::Existence(sample_mask(cloud, context)))
    }

    fn penalty(&self, cloud: &TracedCloud, context: &StepContext) -> Option<TraceScalar> {
        (context.phase != Phase::Finetune && !cloud.is_empty())
            .then(|| sample_mask(cloud, context).mean::<Rank0, _>().square() * self.lambda)
    }

    fn score(&self, cloud: &GaussianCloud, _: &CloudStats, _: &StepContext) -> Vec<Real> {
        learned_column(cloud, COLUMN)
    }

    fn shortened(&self, scale: f64) -> Option<Box<dyn Pruner>> {
        let learning_rate = shortened_rate(self.learning_rate, true, scale);
        Some(Box::new(Self { learning_rate, ..self.clone() }))
    }

    fn check(&self) -> Result<(), String> {
        check_weight("lambda", self.lambda)?;
        check_rate(self.learning_rate)
    }
}

/// Samples the masks M of this step on the tape: the same sample for the gate and for the penalty.
fn sample_mask(cloud: &TracedCloud, context: &StepContext) -> Trace {
    let mut random = rng::stream(context.seed, "pruner MaskGaussian", context.step);
    let noise = cloud.constant(logistic_noise(cloud.len(), &mut random));
    cloud.straight_through((cloud.column(COLUMN) + noise).sigmoid(), 0.5)
}
