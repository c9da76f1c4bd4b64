//! How long one prediction takes, stage by stage.

use pwrfgs_core::{Evaluation, Goal, Measurement, Metric, Result, StageTimes, Values};
use serde::{Deserialize, Serialize};

/// Median milliseconds of one prediction: network, projection, sorting, blending, and all of it.
///
/// Keys `latency_network_ms`, `latency_projection_ms`, `latency_sort_ms`, `latency_blending_ms`, `latency_total_ms`
/// (table I of the paper gives the total). Each median is taken by itself, so the stages need not add up to the total.
/// Times are those of this machine under its present load and differ from run to run. `n/a` for baselines.
///
/// ```
/// # use pwrfgs_metrics as _;
/// # use pwrfgs_core::{Metric, Plugin};
/// Plugin::<dyn Metric>::parse("Latency(repeats: 50)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Latency {
    /// Predictions timed, 1 to 10,000.
    pub repeats: usize,
    /// Predictions made before, not timed: they fill caches and start threads. At most 10,000.
    pub warm_up: usize,
}

impl Default for Latency {
    fn default() -> Self {
        Self { repeats: 20, warm_up: 3 }
    }
}

type Stage = (&'static str, fn(&StageTimes) -> f64);

const STAGES: [Stage; 5] = [
    ("latency_network_ms", |t| t.network),
    ("latency_projection_ms", |t| t.projection),
    ("latency_sort_ms", |t| t.sort),
    ("latency_blending_ms", |t| t.blending),
    ("latency_total_ms", |t| t.total),
];

#[typetag::serde]
impl Metric for Latency {
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        let times = evaluation.model.map(|model| {
            for _ in 0..self.warm_up {
                (model.timed_prediction)();
            }
            (0..self.repeats).map(|_| (model.timed_prediction)()).collect::<Vec<_>>()
        });
        let values = |seconds: fn(&StageTimes) -> f64| match &times {
            Some(times) => Values::Whole(1e3 * median(times.iter().map(seconds).collect())),
            None => Values::NotApplicable("only models are timed".to_owned()),
        };
        let measurement = |(key, seconds): Stage| Measurement {
            key: key.to_owned(),
            unit: "ms",
            goal: Goal::Lower,
            values: values(seconds),
        };
        Ok(STAGES.map(measurement).into())
    }

    fn about(&self) -> &'static str {
        "median milliseconds of a prediction, stage by stage"
    }

    fn check(&self) -> Result<(), String> {
        if !(1..=10_000).contains(&self.repeats) {
            return Err(format!("`repeats` is {}; time between 1 and 10000 predictions", self.repeats));
        }
        if self.warm_up > 10_000 {
            return Err(format!("`warm_up` is {}; 10000 predictions are the most", self.warm_up));
        }
        Ok(())
    }
}

/// The middle one, or the mean of the middle two; NaN of none.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => f64::NAN,
        n => f64::midpoint(values[(n - 1) / 2], values[n / 2]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{of_model, scene, value};
    use pwrfgs_core::{ModelFacts, Plugin};
    use std::cell::Cell;

    #[test]
    fn medians_are_of_the_repeats_alone() {
        let calls = Cell::new(0);
        let predict = || {
            calls.set(calls.get() + 1);
            let k = f64::from(calls.get());
            StageTimes { network: k, projection: 2.0 * k, sort: 3.0 * k, blending: 4.0 * k, total: 1e3 / k }
        };
        let model = ModelFacts { means: &[], gaussian_bytes: 0, network_bytes: 0, timed_prediction: &predict };
        let found = of_model(&Latency { repeats: 4, warm_up: 3 }, Some(model), &scene(&[]));
        assert_eq!(calls.get(), 7);
        let keys: Vec<&str> = found.iter().map(|m| m.key.as_str()).collect();
        assert_eq!(keys, STAGES.map(|s| s.0));
        let middle = 5.5; // of 4, 5, 6, 7
        for (m, factor) in found.iter().zip([1.0, 2.0, 3.0, 4.0]) {
            assert!((value(m) - 1e3 * factor * middle).abs() < 1e-9);
        }
        assert!((value(&found[4]) - 1e6 * f64::midpoint(1.0 / 5.0, 1.0 / 6.0)).abs() < 1e-6);
    }

    #[test]
    fn a_baseline_is_not_timed_and_no_repeats_are_refused() {
        let found = of_model(&Latency::default(), None, &scene(&[]));
        assert!(found.iter().all(|m| matches!(m.values, Values::NotApplicable(_))));
        assert!(Plugin::<dyn Metric>::parse("Latency(repeats: 0)").is_err());
    }
}
