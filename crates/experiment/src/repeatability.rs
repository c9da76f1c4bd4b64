//! `Repeatability`: agreement of two spectra measured at the same transmitter position.
//!
//! No function of the position can do much better than one measurement predicts another. Two measurements at exactly
//! the same position are rare, so pairs at small distances are extrapolated to distance zero. Samples are assumed to be
//! in order of time. Measurements close in time share more than the position (transmitter orientation, people, the
//! receiver), so pairs near in time and far apart in time are treated separately.
//!
//! The result is the agreement of two measurements. The mean of all measurements at a position is slightly closer to
//! each than they are to each other, so a perfect predictor of the mean would score slightly higher.
//!
//! [`ceiling`] is the noise ceiling of a test set, a row in the table of baselines. If most test samples were measured
//! shortly before or after a training sample, it uses pairs near in time, which share short-term conditions; otherwise
//! it uses pairs far apart in time.

mod extrapolate;
mod pairs;

pub use extrapolate::ZeroDistanceEstimate;
pub use pairs::{FAR_IDS, NEAR_IDS, PairLag, in_order};

use crate::scores::CEILING;
use crate::statistics::Summary;
use crate::text::{grouped, number};
use extrapolate::{MetricScale, at_zero};
use pairs::SamplePair;
use pwrfgs_core::{
    Dataset, Evaluation, Goal, Image, ImagePlane, Measurement, Metric, Partition, Plugin, Result, Scope, Task, Values,
    check_stopped, evenly,
};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::AtomicBool;

/// Largest number of closest pairs used for the extrapolation.
const CLOSEST: usize = 400;
/// Smallest number of pairs for an estimate.
const LEAST: usize = 20;
/// Largest distance of these pairs, metres: spectra change within a fraction of a wavelength, which is 33 cm at 0.9 GHz
/// and 5 cm at 6 GHz, so more distant pairs do not help the extrapolation.
pub const REACH_M: f64 = 0.02;
/// Number of measured pairs per range of larger distances.
const A_BIN: usize = 100;
/// Number of pairs in memory at once, and of their pixels.
const CHUNK: usize = 64;
const PIXELS: usize = 1 << 21;

/// Agreement of pairs near in time and of pairs far apart in time.
#[derive(Clone, Debug)]
pub struct Repeatability {
    /// Pairs at most [`NEAR_IDS`] ids apart.
    pub near: PairSimilarity,
    /// Pairs more than [`FAR_IDS`] ids apart.
    pub far: PairSimilarity,
}

/// Agreement of the spectra of sample pairs, by each per-sample metric.
#[derive(Clone, Debug)]
pub struct PairSimilarity {
    /// Number of closest pairs used for the extrapolation.
    pub closest: usize,
    /// Largest distance between the transmitters of these pairs, metres; 0 without pairs.
    pub reach_m: f64,
    /// One entry per metric.
    pub metrics: Vec<MetricSimilarity>,
}

/// One metric of pairs: score of the earlier spectrum as a prediction of the later one.
#[derive(Clone, Debug)]
pub struct MetricSimilarity {
    /// Name, such as `ssim`.
    pub key: String,
    /// Unit, or empty.
    pub unit: String,
    /// Direction of better values.
    pub goal: Goal,
    /// Ranges of distance, ascending; ranges without pairs are omitted.
    pub bins: Vec<DistanceBin>,
    /// Mean over unrelated pairs: samples drawn at random. NaN if there are none.
    pub unrelated: f64,
    /// Extrapolation to distance zero, or why it is not possible.
    pub at_zero: Result<ZeroDistanceEstimate, String>,
}

/// Pairs in a range of distances.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DistanceBin {
    /// Lower limit of the distance between the transmitters, metres, inclusive.
    pub from_m: f64,
    /// Upper limit, metres, exclusive.
    pub to_m: f64,
    /// Number of measured pairs.
    pub pairs: usize,
    /// Mean over the pairs.
    pub mean: f64,
    /// Median over the pairs.
    pub median: f64,
}

/// Measures pairs near in time and far apart in time by every per-sample metric. The number of pairs is bounded, and
/// their choice depends only on the data.
///
/// # Errors
/// A metric returns an error or a spectrum cannot be read; [`pwrfgs_core::Error::Stopped`] once `stop` is set.
pub fn repeatability(data: &Dataset, metrics: &[Plugin<dyn Metric>], stop: &AtomicBool) -> Result<Repeatability> {
    let of = |lag| similarity(data, lag, true, metrics, stop);
    Ok(Repeatability { near: of(PairLag::Near)?, far: of(PairLag::Far)? })
}

/// Measures one kind of pairs: the closest, and, for the whole `curve`, some of the others.
pub(crate) fn similarity(
    data: &Dataset,
    lag: PairLag,
    curve: bool,
    metrics: &[Plugin<dyn Metric>],
    stop: &AtomicBool,
) -> Result<PairSimilarity> {
    let pairs = pairs::find(data, lag);
    // Measured pairs: the closest, some of every range of distances, and unrelated ones.
    let mut selected = closest(&pairs);
    let closest = selected.len();
    let mut ranges = Vec::new();
    for (edges, range) in pairs::bins(&pairs).into_iter().filter(|_| curve) {
        let first = selected.len();
        selected.extend(evenly(&pairs[range], A_BIN));
        ranges.push((edges, first..selected.len()));
    }
    let related = selected.len();
    selected.extend(pairs::unrelated(data));
    let similarity = |measured: PairMetric| {
        let PairMetric { key, unit, goal, best, values } = measured;
        let summary = |values: &[f64]| Summary::of(values, goal == Goal::Higher);
        let bin = |([from_m, to_m], range): &([f64; 2], Range<usize>)| {
            let Summary { mean, median, .. } = summary(&values[range.clone()]);
            DistanceBin { from_m: *from_m, to_m: *to_m, pairs: range.len(), mean, median }
        };
        let unrelated = summary(&values[related..]).mean;
        let scale = MetricScale { goal, best, unrelated };
        let at_zero = if closest < LEAST {
            let (words, cm) = (lag.words(), REACH_M * 100.0);
            let what = format!("are within {cm:.0} cm of each other; at least {LEAST} are needed");
            Err(format!("{closest} pairs of samples {words} {what}"))
        } else {
            at_zero(&selected[..closest], &single(data.task(), &values[..closest]), &scale)
        };
        MetricSimilarity { key, unit, goal, bins: ranges.iter().map(bin).collect(), unrelated, at_zero }
    };
    let metrics = measure(data, &selected, metrics, stop)?.into_iter().map(similarity).collect();
    let reach_m = selected[..closest].last().map_or(0.0, |pair| pair.distance);
    Ok(PairSimilarity { closest, reach_m, metrics })
}

/// Scores of a perfect predictor of the mean reading, given `values` between two readings.
fn single(task: Task, values: &[f64]) -> Vec<f64> {
    values.iter().map(|v| task.ceiling.share * v).collect()
}

/// Pairs used for the extrapolation, out of `pairs` of ascending distances. If the closest pairs have nearly equal
/// distances, such as steps of a walk, they show no slope: a subset of all close pairs is used instead.
fn closest(pairs: &[SamplePair]) -> Vec<SamplePair> {
    let within = &pairs[..pairs.partition_point(|pair| pair.distance <= REACH_M)];
    let first = &within[..within.len().min(CLOSEST)];
    match first {
        [nearest, .., farthest] if nearest.distance > 0.5 * farthest.distance => evenly(within, CLOSEST),
        _ => first.to_vec(),
    }
}

/// One metric of all pairs, in their order.
struct PairMetric {
    key: String,
    unit: String,
    goal: Goal,
    /// Score of a spectrum as a prediction of itself.
    best: f64,
    values: Vec<f64>,
}

/// Scores the earlier spectrum of each pair as a prediction of the later one, by the per-sample metrics.
fn measure(
    data: &Dataset,
    pairs: &[SamplePair],
    metrics: &[Plugin<dyn Metric>],
    stop: &AtomicBool,
) -> Result<Vec<PairMetric>> {
    let metrics: Vec<&Plugin<dyn Metric>> = metrics.iter().filter(|m| m.scope() == Scope::Sample).collect();
    let plane = data.plane();
    let itself = [data.image(0)];
    let best = evaluate(data, &plane, &metrics, &itself, &itself)?;
    let started = |m: Measurement| match m.values {
        Values::PerSample(best) if best.len() == 1 => {
            Some(PairMetric { key: m.key, unit: m.unit, goal: m.goal, best: best[0], values: Vec::new() })
        }
        _ => None,
    };
    let mut all: Vec<PairMetric> = best.into_iter().filter_map(started).collect();
    let size = (PIXELS / (data.width * data.height).max(1)).clamp(1, CHUNK);
    for some in pairs.chunks(size) {
        check_stopped(stop)?;
        let images = |side: fn(&SamplePair) -> usize| some.par_iter().map(|pair| data.image(side(pair))).collect();
        let (earlier, later): (Vec<Image>, Vec<Image>) = (images(|pair| pair.earlier), images(|pair| pair.later));
        data.observations.check()?;
        for found in evaluate(data, &plane, &metrics, &earlier, &later)? {
            if let (Some(of), Values::PerSample(values)) = (all.iter_mut().find(|m| m.key == found.key), found.values) {
                of.values.extend(values);
            }
        }
    }
    // Metrics without one number per pair are skipped.
    all.retain(|measured| measured.values.len() == pairs.len());
    Ok(all)
}

fn evaluate(
    data: &Dataset,
    plane: &ImagePlane,
    metrics: &[&Plugin<dyn Metric>],
    predictions: &[Image],
    truths: &[Image],
) -> Result<Vec<Measurement>> {
    let evaluation = Evaluation { predictions, truths, ..Evaluation::of(data, plane) };
    let found: Result<Vec<_>> = metrics.iter().map(|metric| metric.evaluate(&evaluation)).collect();
    Ok(found?.concat())
}

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
    let known = |m: &MetricSimilarity| Some((m.key.clone(), m.at_zero.as_ref().ok().copied()?));
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
