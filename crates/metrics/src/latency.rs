//! Prediction time, stage by stage.

use crate::create_measurement;
use pwrfgs_core::numbers::number;
use pwrfgs_core::statistics::{median, sorted};
use pwrfgs_core::{Evaluation, Goal, JsonSchema, Measurement, Metric, Result, Scope, StageTimes, UNSTEADY, Values};
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// Median time of one prediction, ms: network, projection, sorting, blending, and total.
///
/// Predictions are timed in up to five series of `repeats`, until the times of a series are steady. If none is steady, as
/// on a busy machine, the fastest series counts, and a note below the tables states how far its times differ.
///
/// Keys `latency_prepare_ms`, `latency_network_ms`, `latency_projection_ms`, `latency_sort_ms`, `latency_blending_ms`,
/// `latency_total_ms`. Each median is computed separately, so that the stages need not sum to the total. Times depend
/// on the machine and its load, and vary between runs. A baseline has only the total, without its fitting time; it is
/// timed for at most two seconds, but at least once. No series of a model after the first starts later than that.
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
    /// Number of timed predictions per series, 1 to 10,000.
    pub repeats: usize,
    /// Number of untimed predictions before; they fill caches and start threads. At most 10,000.
    pub warm_up: usize,
}

impl Default for Latency {
    fn default() -> Self {
        Self { repeats: 20, warm_up: 3 }
    }
}

/// Time after which no further prediction of a baseline and no further series starts, seconds.
const PATIENCE: f64 = 2.0;
/// Largest number of series.
const SERIES: usize = 5;
/// Largest ratio of the upper to the lower quartile of steady times, and of a median to the sum of the medians of its
/// parts: a wait that moves between stages is in the median of the total, but not in those of the stages.
const STEADY: f64 = 1.5;
/// Difference of times that is always steady, seconds.
const EXACT: f64 = 2e-5;

/// Key of a stage and its time, seconds.
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
        let times = evaluation.timed_prediction.map(|predict| self.time_predictions(predict, patience));
        let note = times.as_ref().and_then(|times| describe_unsteadiness(times));
        let values = |(key, seconds): Stage| match &times {
            None => Values::NotApplicable("no prediction to time".to_owned()),
            Some(_) if evaluation.model.is_none() && key != TOTAL => {
                Values::NotApplicable("a baseline has no such stage".to_owned())
            }
            Some(times) => Values::Whole(1e3 * median(times.iter().map(seconds))),
        };
        let mut measurements = STAGES.map(|stage| create_measurement(stage.0, "ms", Goal::Lower, values(stage)));
        measurements[STAGES.len() - 1].note = note; // the total
        Ok(measurements.into())
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
    /// Times up to [`SERIES`] series of `repeats` predictions, and returns the first steady one, or the fastest.
    /// No prediction except the first starts more than `patience` seconds after the first warm-up, and no further series
    /// more than [`PATIENCE`] after it.
    fn time_predictions(&self, predict: &dyn Fn() -> StageTimes, patience: f64) -> Vec<StageTimes> {
        let begun = Instant::now();
        let in_time = |_: &usize| begun.elapsed().as_secs_f64() < patience;
        (0..self.warm_up).take_while(in_time).for_each(|_| _ = predict());
        let series = || -> Vec<StageTimes> {
            let first = predict();
            std::iter::once(first).chain((1..self.repeats).take_while(in_time).map(|_| predict())).collect()
        };
        let total = |times: &[StageTimes]| median(times.iter().map(|t| t.total));
        let mut best = series();
        for _ in 1..SERIES {
            if describe_unsteadiness(&best).is_none() || begun.elapsed().as_secs_f64() >= PATIENCE {
                break;
            }
            let next = series();
            if describe_unsteadiness(&next).is_none() || total(&next) < total(&best) {
                best = next;
            }
        }
        best
    }
}

/// Describes how far the times of predictions differ, with the next step; `None` for steady times.
fn describe_unsteadiness(times: &[StageTimes]) -> Option<String> {
    let median_of = |seconds: fn(&StageTimes) -> f64| median(times.iter().map(seconds));
    let totals = sorted(times.iter().map(|t| t.total));
    let [low, high] = [totals.len() / 4, totals.len() - 1 - totals.len() / 4].map(|k| totals[k]);
    let unassigned = |t: &StageTimes| t.total - t.network - t.projection - t.sort - t.blending;
    let parts = median_of(|t| t.network)
        + median_of(|t| t.projection)
        + median_of(|t| t.sort)
        + median_of(|t| t.blending)
        + median_of(unassigned);
    let total = median_of(|t| t.total);
    let is_steady = |low: f64, high: f64| high <= STEADY * low || high - low <= EXACT;
    if is_steady(low, high) && is_steady(parts, total) {
        return None;
    }
    let [low, high, parts, total] = [low, high, parts, total].map(|seconds| number(1e3 * seconds));
    Some(format!(
        "{UNSTEADY}half of the predictions take {low} to {high} ms, and the medians of the parts add up to {parts} ms \
         (total {total} ms); evaluate again on a machine without other load"
    ))
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
        let measured = of_timed(&Latency { repeats: 4, warm_up: 3 }, Some(model), &scene(&[]), Some(&predict));
        assert_eq!(calls.get(), 7);
        let keys: Vec<&str> = measured.iter().map(|m| m.key.as_str()).collect();
        assert_eq!(keys, STAGES.map(|s| s.0));
        let middle = 5.5; // of 4, 5, 6, 7
        for (m, factor) in measured.iter().zip([5.0, 1.0, 2.0, 3.0, 4.0]) {
            assert!((value(m) - 1e3 * factor * middle).abs() < 1e-9);
        }
        assert!((value(&measured[5]) - 1e6 * f64::midpoint(1.0 / 5.0, 1.0 / 6.0)).abs() < 1e-6);
    }

    #[test]
    fn baseline_latency_is_total_only_and_time_limited() {
        let slow = || {
            std::thread::sleep(std::time::Duration::from_millis(3));
            StageTimes { total: 0.25, ..StageTimes::default() }
        };
        let measured = of_timed(&Latency { repeats: 2, warm_up: 0 }, None, &scene(&[]), Some(&slow));
        let (total, stages) = measured.split_last().unwrap();
        assert!(stages.iter().all(|m| matches!(m.values, Values::NotApplicable(_))));
        assert!((value(total) - 250.0).abs() < 1e-9);
        let latency = Latency { repeats: 10_000, warm_up: 10_000 };
        assert_eq!(latency.time_predictions(&slow, 0.0).len(), 1, "one at least");
        assert_eq!(latency.time_predictions(&slow, 0.01).len(), 1, "warming up counts");
    }

    #[test]
    fn unsteady_latency_is_repeated_and_then_marked() {
        let model = ModelFacts { means: &[], gaussian_bytes: 0, file_bytes: 0 };
        // A wait of 33 ms in another stage of every prediction, as on a busy machine, in the first `busy` of them.
        let measured = |busy: usize| {
            let calls = Cell::new(0);
            let predict = || {
                let k = calls.replace(calls.get() + 1);
                let mut parts = [2e-4; 3];
                if k < busy {
                    parts[k % 3] += 0.033;
                }
                let [network, sort, blending] = parts;
                StageTimes { network, sort, blending, total: parts.iter().sum(), ..StageTimes::default() }
            };
            let all = of_timed(&Latency { repeats: 20, warm_up: 0 }, Some(model), &scene(&[]), Some(&predict));
            let note = all[5].note.clone();
            (value(&all[5]), note, calls.get())
        };
        let (ms, note, calls) = measured(0);
        assert!((ms - 0.6).abs() < 1e-9 && note.is_none() && calls == 20);
        let (ms, note, calls) = measured(25);
        assert!((ms - 0.6).abs() < 1e-9 && note.is_none() && calls == 40, "{ms} ms, {note:?}, {calls}");
        let (ms, note, calls) = measured(1_000);
        assert!((ms - 33.6).abs() < 1e-9 && calls == 100);
        assert!(note.unwrap().contains("add up to 0.6000 ms (total 33.60 ms)"));
    }

    #[test]
    fn latency_requires_predictor_and_repeats() {
        let measured = of_model(&Latency::default(), None, &scene(&[]));
        assert!(measured.iter().all(|m| matches!(m.values, Values::NotApplicable(_))));
        assert!(Plugin::<dyn Metric>::parse("Latency(repeats: 0)").is_err());
    }
}
