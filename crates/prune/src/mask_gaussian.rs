//! A coin a Gaussian, thrown at every step; who loses still learns.

use crate::rounds::{check_rate, check_weight, learned, logistic_noise};
use dfdx::prelude::{MeanTo, Rank0};
use pwrfgs_core::{
    Budget, CloudStats, ColumnSpec, Gate, GaussianCloud, JsonSchema, MaskRate, Moment, Phase, Pruner, PrunerTraits,
    Real, rng,
    tape::{Trace, TraceScalar, Traced},
};
use serde::{Deserialize, Serialize};

/// The column of logits m.
const COLUMN: &str = "presence_logits";

/// Learns an existence probability per Gaussian; masked Gaussians still receive gradients (MaskGaussian).
///
/// At every step M = 1[m + g > 0] with logistic noise g, so that M = 1 with probability σ(m); its derivative is that of the
/// relaxed throw σ(m + g). M multiplies the light that a Gaussian takes and nothing else, [`Gate::Presence`]: where M = 0 the
/// picture is drawn without it, and the derivative still says what it would have changed, so that it can come back. The loss
/// gains lambda · (mean M)², whose pressure fades as fewer are there. At a prune step goes what `draws` throws never find
/// open (MaskGaussian, Liu et al., CVPR 2025, section 3.2, where the two logits of each Gaussian are one here). The fair
/// upgrade of [`crate::LearnableMask`], whose closed masks cannot come back; it costs more, as nothing is left out of a step.
///
/// In fine-tuning all that are left are there. Under `training.target` the largest m stay at the last prune step.
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
    /// Initial mask logit m; σ(1) is 0.73.
    pub initial_logit: Real,
    /// Learning rate of the mask logit m (Adam).
    pub learning_rate: Real,
    /// Number of samples of each mask at a prune step, 1 or more.
    pub draws: usize,
}

impl Default for MaskGaussian {
    fn default() -> Self {
        Self { lambda: 0.1, initial_logit: 1.0, learning_rate: 0.01, draws: 10 }
    }
}

#[typetag::serde]
impl Pruner for MaskGaussian {
    fn traits(&self) -> PrunerTraits {
        PrunerTraits {
            columns: vec![ColumnSpec::learned(COLUMN, self.initial_logit, self.learning_rate)],
            budget: Some(Budget::AtLast),
            mask_rate: Some(MaskRate::adam(self.learning_rate)),
            ..PrunerTraits::default()
        }
    }

    fn keep(&self, cloud: &GaussianCloud, _: &CloudStats, moment: &Moment) -> Vec<bool> {
        let Some(column) = cloud.extra(COLUMN) else { return vec![true; cloud.len()] };
        let mut random = rng::stream(moment.seed, "pruner MaskGaussian prune", moment.step);
        let mut keep = vec![false; cloud.len()];
        for _ in 0..self.draws {
            let noise = logistic_noise(cloud.len(), &mut random);
            keep.iter_mut().zip(column.values.iter().zip(noise)).for_each(|(keep, (m, g))| *keep |= m + g > 0.0);
        }
        keep
    }

    fn gate(&self, cloud: &Traced, moment: &Moment) -> Option<Gate> {
        (moment.phase != Phase::Finetune).then(|| Gate::Presence(throw(cloud, moment)))
    }

    fn penalty(&self, cloud: &Traced, moment: &Moment) -> Option<TraceScalar> {
        (moment.phase != Phase::Finetune && !cloud.is_empty())
            .then(|| throw(cloud, moment).mean::<Rank0, _>().square() * self.lambda)
    }

    fn score(&self, cloud: &GaussianCloud, _: &CloudStats, _: &Moment) -> Vec<Real> {
        learned(cloud, COLUMN)
    }

    fn check(&self) -> Result<(), String> {
        check_weight("lambda", self.lambda)?;
        check_rate(self.learning_rate)?;
        check_throws(self)
    }
}

/// M of this step: the same throw for the gate and for the penalty.
fn throw(cloud: &Traced, moment: &Moment) -> Trace {
    let mut random = rng::stream(moment.seed, "pruner MaskGaussian", moment.step);
    let noise = cloud.constant(logistic_noise(cloud.len(), &mut random));
    cloud.straight_through((cloud.column(COLUMN) + noise).sigmoid(), 0.5)
}

fn check_throws(settings: &MaskGaussian) -> Result<(), String> {
    if settings.draws == 0 || !settings.initial_logit.is_finite() {
        return Err("`draws` is at least 1, and `initial_logit` a number; such as 10 and 1.0".to_owned());
    }
    Ok(())
}
