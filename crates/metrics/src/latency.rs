//! Prediction time, stage by stage.

use crate::measurement;
use pwrfgs_core::{Evaluation, Goal, JsonSchema, Measurement, Metric, Result, Scope, StageTimes, Values};
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// Median time of one prediction, ms: network, projection, sorting, blending, and total.
///
/// Keys `latency_prepare_ms`, `latency_network_ms`, `latency_projection_ms`, `latency_sort_ms`, `latency_blending_ms`,
/// `latency_total_ms`. Each median is computed separately, so that the stages need not sum to the total. Times depend
/// on the machine and its load, and vary between runs. A baseline has only the total, without its fitting time; it is
/// timed for at most two seconds, but at least once.
///
/// Values that do not depend on the transmitter are prepared once and excluded from the other stages: part of the
/// network and, if geometry does not depend on the transmitter, projection and sorting. `latency_prepare_ms` is the
/// time of this preparation. Table I of the paper includes it in every prediction; add it to the total to compare.
///
/// ```
/// # use pwrfgs_metrics as _;
/// # use pwrfgs_core::{Metric, Plugin};
/// Plugin::<dyn Metric>::parse("Latency(repeats: 50)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Latency {
    /// Number of timed predictions, 1 to 10,000.
    pub repeats: usize,
    /// Number of untimed predictions before; they fill caches and start threads. At most 10,000.
    pub warm_up: usize,
}

impl Default for Latency {
    fn default() -> Self {
        Self { repeats: 20, warm_up: 3 }
    }
}

/// Time after which no further prediction of a baseline is timed, seconds.
const PATIENCE: f64 = 2.0;

type Stage = (&'static str, fn(&StageTimes) -> f64);

const TOTAL: &str = "latency_total_ms";

const STAGES: [Stage; 6] = [
    ("latency_prepare_ms", |t| t.prepare),
    ("latency_network_ms", |t| t.network),
    ("latency_projection_ms", |t| t.projection),
    ("latency_sort_ms", |t| t.sort),
    ("latency_blending_ms", |t| t.blending),
    (TOTAL, |t| t.total),
];

#[typetag::serde]
impl Metric for Latency {
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        let patience = if evaluation.model.is_some() { f64::INFINITY } else { PATIENCE };
        let times = evaluation.timed_prediction.map(|predict| self.times(predict, patience));
        let values = |(key, seconds): Stage| match &times {
            None => Values::NotApplicable("no prediction to time".to_owned()),
            Some(_) if evaluation.model.is_none() && key != TOTAL => {
                Values::NotApplicable("a baseline has no such stage".to_owned())
            }
            Some(times) => Values::Whole(1e3 * median(times.iter().map(seconds).collect())),
        };
        Ok(STAGES.map(|stage| measurement(stage.0, "ms", Goal::Lower, values(stage))).into())
    }

    fn scope(&self) -> Scope {
        Scope::Model
    }

    fn check(&self) -> Result<(), String> {
        if !(1..=10_000).contains(&self.repeats) {
            return Err(format!("`repeats` is {}; give a number from 1 to 10000", self.repeats));
        }
        if self.warm_up > 10_000 {
            return Err(format!("`warm_up` is {}; give a number up to 10000", self.warm_up));
        }
        Ok(())
    }
}

impl Latency {
    /// Returns the times of `repeats` predictions, or of those started within `patience` seconds of the first warm-up.
    fn times(&self, predict: &dyn Fn() -> StageTimes, patience: f64) -> Vec<StageTimes> {
        let begun = Instant::now();
        let in_time = |_: &usize| begun.elapsed().as_secs_f64() < patience;
        (0..self.warm_up).take_while(in_time).for_each(|_| _ = predict());
        let first = predict();
        std::iter::once(first).chain((1..self.repeats).take_while(in_time).map(|_| predict())).collect()
    }
}

/// Returns the median, the mean of the middle two for even numbers; NaN if empty.
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
    use crate::fixture::{of_model, of_timed, scene, value};
    use pwrfgs_core::{ModelFacts, Plugin};
    use std::cell::Cell;

    #[test]
    fn latency_median_excludes_warm_up() {
        let calls = Cell::new(0);
        let predict = || {
            calls.set(calls.get() + 1);
            let k = f64::from(calls.get());
            StageTimes {
                prepare: 5.0 * k,
                network: k,
                projection: 2.0 * k,
                sort: 3.0 * k,
                blending: 4.0 * k,
                total: 1e3 / k,
            }
        };
        let model = ModelFacts { means: &[], gaussian_bytes: 0, file_bytes: 0 };
        let found = of_timed(&Latency { repeats: 4, warm_up: 3 }, Some(model), &scene(&[]), Some(&predict));
        assert_eq!(calls.get(), 7);
        let keys: Vec<&str> = found.iter().map(|m| m.key.as_str()).collect();
        assert_eq!(keys, STAGES.map(|s| s.0));
        let middle = 5.5; // of 4, 5, 6, 7
        for (m, factor) in found.iter().zip([5.0, 1.0, 2.0, 3.0, 4.0]) {
            assert!((value(m) - 1e3 * factor * middle).abs() < 1e-9);
        }
        assert!((value(&found[5]) - 1e6 * f64::midpoint(1.0 / 5.0, 1.0 / 6.0)).abs() < 1e-6);
    }

    #[test]
    fn baseline_latency_is_total_only_and_time_limited() {
        let slow = || {
            std::thread::sleep(std::time::Duration::from_millis(3));
            StageTimes { total: 0.25, ..StageTimes::default() }
        };
        let found = of_timed(&Latency { repeats: 2, warm_up: 0 }, None, &scene(&[]), Some(&slow));
        let (total, stages) = found.split_last().unwrap();
        assert!(stages.iter().all(|m| matches!(m.values, Values::NotApplicable(_))));
        assert!((value(total) - 250.0).abs() < 1e-9);
        let latency = Latency { repeats: 10_000, warm_up: 10_000 };
        assert_eq!(latency.times(&slow, 0.0).len(), 1, "one at least");
        assert_eq!(latency.times(&slow, 0.01).len(), 1, "warming up counts");
    }

    #[test]
    fn latency_requires_predictor_and_repeats() {
        let found = of_model(&Latency::default(), None, &scene(&[]));
        assert!(found.iter().all(|m| matches!(m.values, Values::NotApplicable(_))));
        assert!(Plugin::<dyn Metric>::parse("Latency(repeats: 0)").is_err());
    }
}
