//! Bytes of the model file.

use crate::{no_gaussians, not_a_model};
use pwrfgs_core::{Evaluation, Goal, JsonSchema, Measurement, Metric, Result, Scope, Values};
use serde::{Deserialize, Serialize};

/// Bytes of the Gaussians alone, and of Gaussians and network together.
///
/// Keys `gaussian_bytes` and `model_bytes`. Both, because the paper's 100-fold storage reduction counts the Gaussians
/// alone: the deformation network does not shrink with N and soon outweighs them. `n/a` for baselines, which keep the
/// measured spectra instead.
///
/// ```
/// # use pwrfgs_metrics as _;
/// # use pwrfgs_core::{Metric, Plugin};
/// Plugin::<dyn Metric>::parse("ModelSize()")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ModelSize {}

#[typetag::serde]
impl Metric for ModelSize {
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        let bytes = evaluation.model.map(|m| (m.gaussian_bytes, m.gaussian_bytes + m.network_bytes));
        let measurement = |key: &str, bytes: Option<usize>| {
            let values = match bytes {
                None => not_a_model(),
                Some(0) => no_gaussians(),
                Some(bytes) => Values::Whole(bytes as f64),
            };
            Measurement { key: key.to_owned(), unit: "B".to_owned(), goal: Goal::Lower, values }
        };
        Ok(vec![measurement("gaussian_bytes", bytes.map(|b| b.0)), measurement("model_bytes", bytes.map(|b| b.1))])
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
    fn the_network_counts_in_the_second() {
        let model = ModelFacts { means: &[], gaussian_bytes: 560, network_bytes: 40 };
        let found = of_model(&ModelSize {}, Some(model), &scene(&[]));
        assert_eq!((found[0].key.as_str(), value(&found[0])), ("gaussian_bytes", 560.0));
        assert_eq!((found[1].key.as_str(), value(&found[1])), ("model_bytes", 600.0));
        assert!(
            of_model(&ModelSize {}, None, &scene(&[])).iter().all(|m| matches!(m.values, Values::NotApplicable(_)))
        );
    }
}
