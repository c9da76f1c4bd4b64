//! Noise ceiling of a test set: agreement of two spectra measured at one position, as a row in the table of baselines.
//!
//! The pairs depend on the split. If most test samples were measured shortly before or after a training sample, the
//! ceiling uses pairs near in time, which share short-term conditions; otherwise it uses pairs far apart in time.

use crate::repeatability::{FAR_IDS, PairLag, PairSimilarity, ZeroDistanceEstimate, in_order, similarity};
use crate::scores::CEILING;
use crate::text::{grouped, number};
use pwrfgs_core::{Dataset, Metric, Partition, Plugin, Result, Task};
use std::sync::atomic::AtomicBool;

/// Noise ceiling of a test set: best score to expect from a predictor.
#[derive(Clone, Debug, Default)]
pub struct NoiseCeiling {
    /// Metric keys with their ceiling; empty if it cannot be estimated.
    pub of: Vec<(String, ZeroDistanceEstimate)>,
    /// Notes below the table: the pairs used, or why there is no ceiling.
    pub notes: Vec<String>,
}

/// Estimates the noise ceiling of the test set of `partition` by every per-sample metric.
///
/// # Errors
/// Same as [`crate::repeatability()`].
pub fn ceiling(
    data: &Dataset,
    partition: &Partition,
    metrics: &[Plugin<dyn Metric>],
    stop: &AtomicBool,
) -> Result<NoiseCeiling> {
    let lags = lags(data, partition);
    let (lag, why) = lag(data, &lags);
    let found = similarity(data, lag, false, metrics, stop)?;
    let known = |m: &crate::repeatability::MetricSimilarity| Some((m.key.clone(), m.at_zero.as_ref().ok().copied()?));
    let of: Vec<(String, ZeroDistanceEstimate)> = found.metrics.iter().filter_map(known).collect();
    let unknown = found.metrics.iter().filter_map(|m| Some((&m.key, m.at_zero.as_ref().err()?)));
    let notes = match (of.is_empty(), found.metrics.first().map(|m| &m.at_zero)) {
        (false, _) => {
            let by = |(key, why): (&String, &String)| format!("no {CEILING} by {key}: {why}");
            notes(data.task(), &found, lag, &why, &of).into_iter().chain(unknown.map(by)).collect()
        }
        (true, Some(Err(reason))) => vec![format!("no {CEILING}: {reason}")],
        (true, _) => Vec::new(),
    };
    Ok(NoiseCeiling { of, notes })
}

/// Kind of sample pairs that the noise ceiling of `partition` uses.
pub fn lapse_of(data: &Dataset, partition: &Partition) -> PairLag {
    lag(data, &lags(data, partition)).0
}

/// Difference of ids between each test sample and the nearest training or validation sample.
fn lags(data: &Dataset, partition: &Partition) -> Vec<u32> {
    let ids: Vec<u32> = partition.known().all().iter().map(|&i| data.sample(i).id).collect();
    let lag = |&i: &usize| {
        let id = data.sample(i).id;
        let next = ids.partition_point(|known| *known < id);
        let around = [next.checked_sub(1), Some(next)].into_iter().flatten().filter_map(|k| ids.get(k));
        around.map(|known| known.abs_diff(id)).min().unwrap_or(u32::MAX)
    };
    partition.test.iter().map(lag).collect()
}

/// Kind of pairs, and the reason.
fn lag(data: &Dataset, lags: &[u32]) -> (PairLag, String) {
    if !in_order(data) {
        return (PairLag::Far, "since samples with consecutive ids are not close in space".into());
    }
    let near = lags.iter().filter(|lag| **lag <= FAR_IDS).count();
    let percent = |count: usize| (100 * count + lags.len() / 2) / lags.len().max(1);
    if 2 * near >= lags.len() {
        let share = percent(near);
        (PairLag::Near, format!("since {share} % of the test samples have a known one at most {FAR_IDS} ids away"))
    } else {
        let share = percent(lags.len() - near);
        (PairLag::Far, format!("since {share} % of the test samples have no known one within {FAR_IDS} ids"))
    }
}

fn notes(
    task: Task,
    found: &PairSimilarity,
    lag: PairLag,
    why: &str,
    of: &[(String, ZeroDistanceEstimate)],
) -> Vec<String> {
    let what = task.ceiling.note;
    let is_perfect = task.ceiling.share < 1.0; // the row is that of the perfect predictor already
    let more = if is_perfect { "" } else { "; a perfect predictor of the mean could reach a little more" };
    let (pairs, words) = (grouped(found.closest as i64), lag.words());
    let interval = |(key, at_zero): &(String, ZeroDistanceEstimate)| {
        let [low, high] = at_zero.interval.map(number);
        format!("{key} {low} to {high}")
    };
    let intervals: Vec<String> = of.iter().map(interval).collect();
    vec![
        format!(
            "{CEILING} is {what}: {pairs} pairs {words}, at most {:.0} mm between their transmitters, followed to distance \
             zero; {why}",
            (found.reach_m * 1e3).ceil()
        ),
        format!("{CEILING} is an estimate and not ranked{more}; 95 % intervals of its means: {}", intervals.join(", ")),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Pose, Sample, Spectra};

    fn data(place: impl Fn(u32) -> f64) -> Dataset {
        let samples: Vec<Sample> = (0..400).map(|id| Sample::new(id, [place(id), 0.0, 0.0])).collect();
        let spectra = Spectra::grey((1, 1), vec![0; samples.len()]).unwrap();
        Dataset::new("line", Pose::IDENTITY, vec![], samples, spectra).unwrap()
    }

    fn partition(is_test: impl Fn(usize) -> bool) -> Partition {
        let (test, train) = (0..400).partition(|&i| is_test(i));
        Partition { train, validation: vec![], test }
    }

    #[test]
    fn partition_selects_pairs_of_noise_ceiling() {
        let walk = data(|id| f64::from(id) * 0.01);
        let of = |data: &Dataset, partition: &Partition| lag(data, &lags(data, partition));
        let (near, why) = of(&walk, &partition(|i| i % 5 == 0));
        assert_eq!(near, PairLag::Near);
        assert_eq!(why, "since 100 % of the test samples have a known one at most 30 ids away");
        let (far, why) = of(&walk, &partition(|i| (100..300).contains(&i)));
        assert_eq!(far, PairLag::Far);
        assert_eq!(why, "since 70 % of the test samples have no known one within 30 ids");
        let anywhere = data(|id| f64::from(id * 149 % 400));
        assert_eq!(of(&anywhere, &partition(|i| i % 5 == 0)).0, PairLag::Far, "ids carry no time information");
    }

    #[test]
    fn lag_is_measured_to_nearest_training_sample() {
        let walk = data(f64::from);
        let known = Partition { train: vec![3, 390], validation: vec![200], test: vec![0, 100, 399] };
        assert_eq!(lags(&walk, &known), [3, 97, 9]);
        assert_eq!(lags(&walk, &Partition { test: vec![1], ..Partition::default() }), [u32::MAX]);
    }
}
