//! Peak signal-to-noise ratio.

use crate::{one, per_sample};
use pwrfgs_core::{Evaluation, Goal, JsonSchema, Measurement, Metric, Result, Scope, Task};
use serde::{Deserialize, Serialize};

/// Smallest mean squared error that counts; below the 8-bit rounding of measured spectra (about 1.3e-6).
const LEAST_ERROR: f64 = 1e-10;

/// Peak signal-to-noise ratio −10·log₁₀(mean squared error) in dB, for a peak of 1.
///
/// Key `psnr`. The prediction is clamped to [0, 1]. An exact prediction counts as 100 dB rather than infinity, so that
/// means stay finite. Use it to compare with image-like results of other fields.
///
/// ```
/// # use pwrfgs_metrics as _;
/// # use pwrfgs_core::{Metric, Plugin};
/// Plugin::<dyn Metric>::parse("Psnr()")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Psnr {}

#[typetag::serde]
impl Metric for Psnr {
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        let values = per_sample(self, evaluation, |p, t| {
            let squares = p.pixels.iter().zip(&t.pixels).map(|(p, t)| ((p.clamp(0.0, 1.0) - t) as f64).powi(2));
            let error = squares.sum::<f64>() / p.pixels.len().max(1) as f64;
            if error < LEAST_ERROR { -10.0 * LEAST_ERROR.log10() } else { -10.0 * error.log10() }
        })?;
        Ok(one("psnr", "dB", Goal::Higher, values))
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
    fn squares_are_averaged_and_an_exact_picture_stays_finite() {
        let (p, t) = (spots(2, 2, &[(0, 0, 0.5)]), spots(2, 2, &[(0, 0, 0.25), (1, 0, 0.25)]));
        let expected = -10.0 * (0.125f64 / 4.0).log10();
        assert!((value(&of_pictures(&Psnr {}, &p, &t)) - expected).abs() < 1e-12);
        assert_eq!(value(&of_pictures(&Psnr {}, &t, &t)), 100.0);
    }
}
