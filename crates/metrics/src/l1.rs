//! Mean absolute error of a pixel.

use crate::{one, per_sample};
use pwrfgs_core::{Evaluation, Goal, JsonSchema, Measurement, Metric, Result, Scope, Task};
use serde::{Deserialize, Serialize};

/// Mean absolute difference of predicted and measured pixels; the L₁ of eq. (9) with the prediction clamped to [0, 1].
///
/// Key `l1`. Use it beside SSIM: it sees a wrong overall level that SSIM forgives.
///
/// ```
/// # use pwrfgs_metrics as _;
/// # use pwrfgs_core::{Metric, Plugin};
/// Plugin::<dyn Metric>::parse("L1()")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct L1 {}

#[typetag::serde]
impl Metric for L1 {
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        let values = per_sample(self, evaluation, |p, t| {
            let differences = p.pixels.iter().zip(&t.pixels).map(|(p, t)| (p.clamp(0.0, 1.0) - t).abs() as f64);
            differences.sum::<f64>() / p.pixels.len().max(1) as f64
        })?;
        Ok(one("l1", "", Goal::Lower, values))
    }

    fn supports(&self, task: Task) -> bool {
        task.has_pixels
    }

    fn scope(&self) -> Scope {
        Scope::Sample
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{of_pictures, spots, value};

    #[test]
    fn differences_are_averaged_after_clamping() {
        let (p, t) = (spots(2, 2, &[(0, 0, 3.0), (1, 1, -2.0)]), spots(2, 2, &[(0, 0, 0.5), (1, 0, 0.25)]));
        assert_eq!(value(&of_pictures(&L1 {}, &p, &t)), (0.5 + 0.25) / 4.0);
    }
}
