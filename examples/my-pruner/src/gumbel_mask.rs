//! A stochastic mask: a gate that is open with probability σ(m), relaxed so that m can be learned.

use dfdx::prelude::{MeanTo, Rank0};
use pwrfgs::core::rng;
use pwrfgs::prelude::*;

/// The column of gate logits m.
const COLUMN: &str = "gumbel_logits";
/// Uniform draws keep this distance from 0 and 1: the noise stays within ±13.8.
const EDGE: Real = 1e-6;

/// One gate a Gaussian that is thrown like a coin at every step: open with probability σ(m), m learned (Gumbel or binary concrete mask).
///
/// The throw is relaxed (the binary concrete distribution of Maddison et al. and Jang et al., ICLR 2017): with u uniform
/// in (0, 1) and the logistic noise g = ln u − ln(1−u), which is the difference of two Gumbel draws, the gate is
/// y = σ((m + g)/temperature), and y > 1/2 with probability σ(m). So a Gaussian that the picture needs is missed
/// whenever its gate falls shut, and m rises; one that is not needed is pressed down by the penalty
/// lambda · mean σ(m), the expected part of open gates. Where m < 0, more often shut than open, the gate is 0: the
/// Gaussian is not drawn, cannot come back, and is discarded at the next prune step. What stays is drawn with its gate
/// open from fine-tuning on.
///
/// Use it beside `LearnableMask`, whose gate has no noise, to see whether noise finds fewer Gaussians for the same
/// quality. A lower temperature makes gates nearer to 0 and 1 and their derivatives rarer; a larger lambda leaves fewer.
///
/// ```
/// # use my_pruner as _;
/// # use pwrfgs::prelude::*;
/// Plugin::<dyn Pruner>::parse("GumbelMask(lambda: 0.02, temperature: 0.5)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GumbelMask {
    /// Weight λ of the penalty, 0 or more.
    pub lambda: Real,
    /// How far gates are from 0 and 1: from 0.2 to 5.
    pub temperature: Real,
    /// m at the start, above 0; σ(3) is 0.95.
    pub initial_logit: Real,
    /// Adam's rate for m.
    pub learning_rate: Real,
}

impl Default for GumbelMask {
    fn default() -> Self {
        Self { lambda: 0.01, temperature: 0.5, initial_logit: 3.0, learning_rate: 0.01 }
    }
}

#[typetag::serde]
impl Pruner for GumbelMask {
    fn keep(&self, cloud: &GaussianCloud, _: &CloudStats, _: &Moment) -> Vec<bool> {
        cloud.extra(COLUMN).map_or_else(|| vec![true; cloud.len()], |c| c.values.iter().map(|m| *m >= 0.0).collect())
    }

    fn traits(&self) -> PrunerTraits {
        let columns = vec![ColumnSpec::learned(COLUMN, self.initial_logit, self.learning_rate)];
        PrunerTraits { columns, ..PrunerTraits::default() }
    }

    fn gate(&self, cloud: &Traced, moment: &Moment) -> Option<Gate> {
        if moment.phase == Phase::Finetune {
            return None;
        }
        // A stream of this step and of this pruner alone: a run that goes on after a crash throws the same coins.
        let mut random = rng::stream(moment.seed, "pruner GumbelMask", moment.step);
        let noise = (0..cloud.len()).map(|_| logistic(rng::uniform(&mut random))).collect();
        let y = ((cloud.column(COLUMN) + cloud.constant(noise)) / self.temperature).sigmoid();
        let logits = cloud.leaf(COLUMN).as_vec();
        let open = logits.iter().map(|m| Real::from(u8::from(*m >= 0.0))).collect();
        Some((y * cloud.constant(open)).into())
    }

    fn penalty(&self, cloud: &Traced, moment: &Moment) -> Option<TraceScalar> {
        (moment.phase != Phase::Finetune && !cloud.is_empty())
            .then(|| cloud.column(COLUMN).sigmoid().mean::<Rank0, _>() * self.lambda)
    }

    fn score(&self, cloud: &GaussianCloud, _: &CloudStats, _: &Moment) -> Vec<Real> {
        cloud.extra(COLUMN).map_or_else(|| cloud.opacity_logits.clone(), |c| c.values.clone())
    }

    fn check(&self) -> Result<(), String> {
        let Self { lambda, temperature, initial_logit, learning_rate } = self;
        if !(lambda.is_finite() && *lambda >= 0.0) {
            return Err(format!("`lambda` is {lambda}; give 0 or more, such as 0.01: a larger one prunes more"));
        }
        // Below, a gate that falls shut could be 0 in single precision, which says that it never opens again.
        if !(0.2..=5.0).contains(temperature) {
            return Err(format!("`temperature` is {temperature}; give a number from 0.2 to 5, such as 0.5"));
        }
        if !(initial_logit.is_finite() && *initial_logit > 0.0) {
            return Err(format!("`initial_logit` is {initial_logit}; give a number above 0, such as 3.0"));
        }
        if !(learning_rate.is_finite() && *learning_rate > 0.0) {
            return Err(format!("`learning_rate` is {learning_rate}; give a positive number, such as 0.01"));
        }
        Ok(())
    }
}

/// Logistic noise of a uniform draw.
fn logistic(u: Real) -> Real {
    let u = u.clamp(EDGE, 1.0 - EDGE);
    u.ln() - (1.0 - u).ln()
}

#[cfg(test)]
mod tests;
