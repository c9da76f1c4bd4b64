//! SSIM as scikit-image computes it: the number that papers of this field print.

use crate::{one, per_sample};
use pwrfgs_core::{Evaluation, Goal, JsonSchema, Measurement, Metric, Result, Scope, Task, ssim};
use serde::{Deserialize, Serialize};

/// Structural similarity of predicted and measured spectrum, 1 where they are equal.
///
/// Key `ssim`. Uniform 7x7 windows, data range 1, sample covariance, mean over the picture without its border of 3 px:
/// scikit-image's `structural_similarity(a, b, data_range=1)`, which is what the released test prints. The prediction is
/// clamped to [0, 1]. It is not the SSIM of the training loss, whose Gaussian window gives other values. Papers often
/// print the median without saying so; the report gives both. Read it beside the baselines: neighbouring transmitters
/// have nearly equal spectra.
///
/// ```
/// # use pwrfgs_metrics as _;
/// # use pwrfgs_core::{Metric, Plugin};
/// Plugin::<dyn Metric>::parse("Ssim()")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Ssim {}

#[typetag::serde]
impl Metric for Ssim {
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        let values = per_sample(self, evaluation, |p, t| ssim::evaluation(&p.clamped(), t))?;
        Ok(one("ssim", "", Goal::Higher, values))
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
    use crate::fixture;
    use pwrfgs_core::Image;

    #[test]
    fn constant_pictures_have_a_closed_form() {
        let constant = |v| Image { width: 9, height: 8, pixels: vec![v; 72] };
        let found = fixture::value(&fixture::of_pictures(&Ssim {}, &constant(0.25), &constant(0.5)));
        let expected = (2.0 * 0.25 * 0.5 + 1e-4) / (0.25 * 0.25 + 0.5 * 0.5 + 1e-4);
        assert!((found - expected).abs() < 1e-9);
        let too_bright = fixture::value(&fixture::of_pictures(&Ssim {}, &constant(7.0), &constant(1.0)));
        assert!((too_bright - 1.0).abs() < 1e-12, "a prediction is clamped first");
    }
}
