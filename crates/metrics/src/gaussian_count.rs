//! N, the number of Gaussians.

use crate::{no_gaussians, not_a_model, one};
use pwrfgs_core::{Evaluation, Goal, JsonSchema, Measurement, Metric, Result, Scope, Values};
use serde::{Deserialize, Serialize};

/// Number of Gaussians of the model: the horizontal axis of the paper's trade-off (fig. 2b).
///
/// Key `gaussians`. `n/a` for baselines, and for a method without Gaussians.
///
/// ```
/// # use pwrfgs_metrics as _;
/// # use pwrfgs_core::{Metric, Plugin};
/// Plugin::<dyn Metric>::parse("GaussianCount()")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GaussianCount {}

#[typetag::serde]
impl Metric for GaussianCount {
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        let values = match evaluation.model {
            None => not_a_model(),
            Some(model) if model.means.is_empty() => no_gaussians(),
            Some(model) => Values::Whole(model.means.len() as f64),
        };
        Ok(one("gaussians", "", Goal::Lower, values))
    }

    fn scope(&self) -> Scope {
        Scope::Model
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{of_model, scene, value};
    use pwrfgs_core::ModelFacts;

    #[test]
    fn centres_are_counted() {
        let means = [[0.0; 3]; 5];
        let model = ModelFacts { means: &means, gaussian_bytes: 0, network_bytes: 0 };
        assert_eq!(value(&of_model(&GaussianCount {}, Some(model), &scene(&[]))[0]), 5.0);
        let baseline = of_model(&GaussianCount {}, None, &scene(&[]));
        assert!(matches!(baseline[0].values, Values::NotApplicable(_)));
    }
}
