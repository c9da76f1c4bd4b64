//! Stochastic mask: a gate that is open with probability σ(m), with a relaxation that makes m learnable.

use dfdx::prelude::{MeanTo, Rank0};
use pwrfgs::core::rng;
use pwrfgs::prelude::*;

/// Column of gate logits m.
const COLUMN: &str = "gumbel_logits";
/// Minimum distance of uniform samples from 0 and 1, which limits the noise to ±13.8.
const EDGE: Real = 1e-6;

/// Learns one stochastic gate per Gaussian, open with probability σ(m) (Gumbel or binary concrete mask).
///
/// Each step draws one relaxed Bernoulli sample per Gaussian (binary concrete distribution: Maddison et al. and Jang et
/// al., ICLR 2017). With u uniform in (0, 1) and logistic noise g = ln u − ln(1−u), the difference of two Gumbel samples,
/// the gate is y = σ((m + g)/temperature), and y > 1/2 with probability σ(m). If the spectrum needs a Gaussian, closed
/// gates increase the loss, and m rises. The penalty lambda · mean σ(m), the expected share of open gates, lowers m of
/// other Gaussians. If m < 0, the gate is 0: the Gaussian is not drawn, cannot return, and is removed at the next prune
/// step. During fine-tuning, all gates are open.
///
/// Compare it with `LearnableMask`, whose gate has no noise. A lower temperature moves gates closer to 0 and 1 and makes
/// gradients rarer; a larger lambda keeps fewer Gaussians.
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
    /// Temperature of the relaxation, from 0.2 to 5: lower values move gates closer to 0 and 1.
    pub temperature: Real,
    /// Initial logit m, above 0; σ(3) is 0.95.
    pub initial_logit: Real,
    /// Learning rate of m (Adam).
    pub learning_rate: Real,
}

impl Default for GumbelMask {
    fn default() -> Self {
        Self { lambda: 0.01, temperature: 0.5, initial_logit: 3.0, learning_rate: 0.01 }
    }
}

#[typetag::serde]
impl Pruner for GumbelMask {
    fn traits(&self) -> PrunerTraits {
        let columns = vec![ColumnSpec::learned(COLUMN, self.initial_logit, self.learning_rate)];
        PrunerTraits { columns, ..PrunerTraits::default() }
    }

    fn gate(&self, cloud: &TracedCloud, context: &StepContext) -> Option<Gate> {
        if context.phase == Phase::Finetune {
            return None;
        }
        // One random stream per step and pruner: a resumed run draws the same samples.
        let mut random = rng::stream(context.seed, "pruner GumbelMask", context.step);
        let noise = (0..cloud.len()).map(|_| logistic(rng::uniform(&mut random))).collect();
        let y = ((cloud.column(COLUMN) + cloud.constant(noise)) / self.temperature).sigmoid();
        let logits = cloud.leaf(COLUMN).as_vec();
        let open = logits.iter().map(|m| Real::from(u8::from(*m >= 0.0))).collect();
        Some((y * cloud.constant(open)).into())
    }

    fn penalty(&self, cloud: &TracedCloud, context: &StepContext) -> Option<TraceScalar> {
        (context.phase != Phase::Finetune && !cloud.is_empty())
            .then(|| cloud.column(COLUMN).sigmoid().mean::<Rank0, _>() * self.lambda)
    }

    fn score(&self, cloud: &GaussianCloud, _: &CloudStats, _: &StepContext) -> Vec<Real> {
        cloud.extra(COLUMN).map_or_else(|| cloud.opacity_logits.clone(), |c| c.values.clone())
    }

    fn check(&self) -> Result<(), String> {
        let Self { lambda, temperature, initial_logit, learning_rate } = self;
        if !(lambda.is_finite() && *lambda >= 0.0) {
            return Err(format!("`lambda` is {lambda}, expected 0 or more; set e.g. 0.01 (larger values prune more)"));
        }
        // Below 0.2, a closed gate could be 0 in single precision, which means that it cannot reopen.
        if !(0.2..=5.0).contains(temperature) {
            return Err(format!("`temperature` is {temperature}, expected 0.2 to 5; set e.g. 0.5"));
        }
        if !(initial_logit.is_finite() && *initial_logit > 0.0) {
            return Err(format!("`initial_logit` is {initial_logit}, expected a number above 0; set e.g. 3.0"));
        }
        if !(learning_rate.is_finite() && *learning_rate > 0.0) {
            return Err(format!("`learning_rate` is {learning_rate}, expected a positive number; set e.g. 0.01"));
        }
        Ok(())
    }
}

/// Returns logistic noise ln u − ln(1−u) from a uniform sample u.
fn logistic(u: Real) -> Real {
    let u = u.clamp(EDGE, 1.0 - EDGE);
    u.ln() - (1.0 - u).ln()
}

#[cfg(test)]
mod tests;
