//! Achievable-rate ratio, eq. (15): what steering by the prediction costs.

use crate::{one, per_sample};
use pwrfgs_core::{Evaluation, Goal, Image, JsonSchema, Measurement, Metric, Result, Scope, Task};
use serde::{Deserialize, Serialize};

/// Rate reached by steering to the strongest predicted direction, over the rate of the truly strongest one.
///
/// η(ρ) = log₂(1 + ρ·P(predicted direction)) / log₂(1 + ρ·max P), eq. (15), in [0, 1]; ρ is the transmit
/// signal-to-noise ratio. Key `eta_0db` for 0 dB, and so on. The direction is the strongest pixel of the prediction
/// before clamping (clamping would make ties), the first in row-major order where several are equal. Where the
/// measured spectrum is 0 everywhere no direction is better than another: 1. It is a forgiving number: even the mean
/// training spectrum reaches 0.8 to 0.9, so read it beside the baselines.
///
/// ```
/// # use pwrfgs_metrics as _;
/// # use pwrfgs_core::{Metric, Plugin};
/// Plugin::<dyn Metric>::parse("RateRatio(snr_db: 10.0)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RateRatio {
    /// Transmit signal-to-noise ratio ρ in dB, −100 to 100; the paper reports 0.
    pub snr_db: f64,
}

impl RateRatio {
    fn ratio(&self, prediction: &Image, truth: &Image) -> f64 {
        let snr = 10f64.powf(self.snr_db / 10.0);
        let rate = |image: &Image| truth.pixels.get(image.argmax()).map_or(0.0, |p| (snr * *p as f64).ln_1p());
        let best = rate(truth);
        if best > 0.0 { rate(prediction) / best } else { 1.0 }
    }
}

#[typetag::serde]
impl Metric for RateRatio {
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        let values = per_sample(self, evaluation, |p, t| self.ratio(p, t))?;
        let snr = self.snr_db + 0.0; // no `-0` in the name
        Ok(one(&format!("eta_{snr}db"), "", Goal::Higher, values))
    }

    fn supports(&self, task: Task) -> bool {
        task.has_pixels
    }

    fn scope(&self) -> Scope {
        Scope::Sample
    }

    fn check(&self) -> Result<(), String> {
        if !(-100.0..=100.0).contains(&self.snr_db) {
            return Err(format!("`snr_db` is {}; give a ratio between -100 and 100 dB", self.snr_db));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{of_pictures, spots, value};
    use pwrfgs_core::Plugin;

    #[test]
    fn the_ratio_is_that_of_the_two_rates() {
        let truth = spots(4, 3, &[(1, 1, 1.0), (2, 2, 0.5)]);
        let prediction = spots(4, 3, &[(1, 1, 1.5), (2, 2, 1.6)]);
        let found = of_pictures(&RateRatio::default(), &prediction, &truth);
        assert_eq!(found.key, "eta_0db");
        assert!((value(&found) - 1.5f64.log2()).abs() < 1e-12, "both peaks clamp to 1: the unclamped one decides");
        let found = of_pictures(&RateRatio { snr_db: 10.0 }, &prediction, &truth);
        assert_eq!(found.key, "eta_10db");
        assert!((value(&found) - 6f64.ln() / 11f64.ln()).abs() < 1e-12);
        assert_eq!(value(&of_pictures(&RateRatio::default(), &truth, &truth)), 1.0);
    }

    #[test]
    fn equal_pixels_count_as_the_first() {
        let truth = spots(4, 3, &[(1, 1, 1.0), (2, 0, 0.25)]);
        let prediction = spots(4, 3, &[(1, 1, 0.7), (2, 0, 0.7)]);
        assert!((value(&of_pictures(&RateRatio::default(), &prediction, &truth)) - 1.25f64.log2()).abs() < 1e-12);
    }

    #[test]
    fn a_dark_spectrum_gives_one() {
        let (dark, prediction) = (spots(4, 3, &[]), spots(4, 3, &[(1, 1, 0.7)]));
        assert_eq!(value(&of_pictures(&RateRatio::default(), &prediction, &dark)), 1.0);
        assert_eq!(value(&of_pictures(&RateRatio::default(), &spots(0, 0, &[]), &spots(0, 0, &[]))), 1.0);
    }

    #[test]
    fn absurd_ratios_are_refused() {
        for snr in ["NaN", "inf", "-101.0"] {
            let why = Plugin::<dyn Metric>::parse(&format!("RateRatio(snr_db: {snr})")).unwrap_err();
            assert!(why.contains("between -100 and 100"), "{why}");
        }
        let key = of_pictures(&RateRatio { snr_db: -0.0 }, &spots(1, 1, &[]), &spots(1, 1, &[])).key;
        assert_eq!(key, "eta_0db");
    }
}
