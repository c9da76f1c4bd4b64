//! How far a received power is off.

use crate::{one, per_sample};
use pwrfgs_core::{Evaluation, Goal, JsonSchema, Measurement, Metric, Result, Scope, Task};
use serde::{Deserialize, Serialize};

/// |predicted − measured| of a received power, dB.
///
/// Key `power_error_db`. Tables give mean, median and 90th percentile over links; papers print one of the first two, often
/// without saying which. What readings at one place differ by is no model's to predict: see the ceiling.
///
/// ```
/// # use pwrfgs_metrics as _;
/// # use pwrfgs_core::{Metric, Plugin};
/// Plugin::<dyn Metric>::parse("PowerError()")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PowerError {}

#[typetag::serde]
impl Metric for PowerError {
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        let values = per_sample(self, evaluation, |p, t| f64::from((p.pixels[0] - t.pixels[0]).abs() as f32))?;
        Ok(one("power_error_db", "dB", Goal::Lower, values))
    }

    fn supports(&self, task: Task) -> bool {
        task.is_scalar
    }

    fn scope(&self) -> Scope {
        Scope::Sample
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{of_kind, value};
    use pwrfgs_core::{Image, Values};

    #[test]
    fn it_is_the_distance_in_decibels() {
        let power = |dbm| Image { width: 1, height: 1, pixels: vec![dbm] };
        let found = of_kind(&PowerError {}, Task::Power, &power(-70.5), &power(-60.0));
        assert_eq!((value(&found[0]), found[0].unit.as_str()), (10.5, "dB"));
        let other = of_kind(&PowerError {}, Task::Channel, &power(1.0), &power(1.0));
        assert!(matches!(&other[0].values, Values::NotApplicable(why) if why.contains("channels")));
    }
}
