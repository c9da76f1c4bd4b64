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
//! [`CeilingEstimator`] estimates the noise ceiling of a test set, a row in the table of baselines. If most test
//! samples were measured shortly before or after a training sample, it uses pairs near in time, which share short-term
//! conditions; otherwise it uses pairs far apart in time.

mod extrapolate;
mod pairs;

pub use extrapolate::ZeroDistanceEstimate;
pub use pairs::{FAR_IDS, NEAR_IDS, PairLag, is_in_time_order};

use crate::scores::CEILING;
use crate::statistics::Summary;
use crate::text::{grouped, number};
use extrapolate::MetricScale;
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
/// Largest distance of the closest pairs, metres: spectra change within a fraction of a wavelength, which is 33 cm at 0.9 GHz
/// and 5 cm at 6 GHz, so more distant pairs do not help the extrapolation.
pub const REACH_M: f64 = 0.02;
/// Number of measured pairs per range of larger distances.
const BIN_PAIRS: usize = 100;
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
pub fn measure_repeatability(
    data: &Dataset,
    metrics: &[Plugin<dyn Metric>],
    stop: &AtomicBool,
) -> Result<Repeatability> {
    let comparison = PairComparison::new(data, metrics, stop);
    Ok(Repeatability { near: comparison.measure(PairLag::Near, true)?, far: comparison.measure(PairLag::Far, true)? })
}

/// Comparison of the observations of sample pairs, by the per-sample metrics.
struct PairComparison<'a> {
    data: &'a Dataset,
    plane: ImagePlane,
    metrics: Vec<&'a Plugin<dyn Metric>>,
    stop: &'a AtomicBool,
}

impl<'a> PairComparison<'a> {
    /// Creates a comparison by those of `metrics` that score one sample at a time.
    fn new(data: &'a Dataset, metrics: &'a [Plugin<dyn Metric>], stop: &'a AtomicBool) -> Self {
        let metrics = metrics.iter().filter(|m| m.scope() == Scope::Sample).collect();
        Self { data, plane: data.plane(), metrics, stop }
    }

    /// Measures the agreement of the closest pairs of one `lag`; if `has_bins`, also of some pairs of every range of
    /// distances.
    fn measure(&self, lag: PairLag, has_bins: bool) -> Result<PairSimilarity> {
        let selected = SelectedPairs::select(self.data, lag, has_bins);
        let scored = self.score_pairs(&selected.pairs)?;
        let metrics = scored.into_iter().map(|metric| selected.summarise(metric, lag, self.data.task())).collect();
        let reach_m = selected.closest().last().map_or(0.0, |pair| pair.distance);
        Ok(PairSimilarity { closest: selected.closest, reach_m, metrics })
    }

    /// Scores the earlier observation of each pair as a prediction of the later one, by each metric that gives one number
    /// per pair.
    fn score_pairs(&self, pairs: &[SamplePair]) -> Result<Vec<PairMetric>> {
        let itself = [self.data.image(0)];
        let open_metric = |m: Measurement| match m.values {
            Values::PerSample(best) if best.len() == 1 => {
                Some(PairMetric { key: m.key, unit: m.unit, goal: m.goal, best: best[0], values: Vec::new() })
            }
            _ => None,
        };
        let mut metrics: Vec<PairMetric> =
            self.evaluate(&itself, &itself)?.into_iter().filter_map(open_metric).collect();
        let size = (PIXELS / (self.data.width * self.data.height).max(1)).clamp(1, CHUNK);
        for chunk in pairs.chunks(size) {
            check_stopped(self.stop)?;
            let images =
                |side: fn(&SamplePair) -> usize| chunk.par_iter().map(|pair| self.data.image(side(pair))).collect();
            let (earlier, later): (Vec<Image>, Vec<Image>) = (images(|pair| pair.earlier), images(|pair| pair.later));
            self.data.observations.check()?;
            for Measurement { key, values, .. } in self.evaluate(&earlier, &later)? {
                if let (Some(metric), Values::PerSample(values)) = (metrics.iter_mut().find(|m| m.key == key), values) {
                    metric.values.extend(values);
                }
            }
        }
        // Metrics without one number per pair are skipped.
        metrics.retain(|metric| metric.values.len() == pairs.len());
        Ok(metrics)
    }

    /// Evaluates all metrics on a chunk of pairs, the measurements of all metrics in one list.
    fn evaluate(&self, predictions: &[Image], truths: &[Image]) -> Result<Vec<Measurement>> {
        let evaluation = Evaluation { predictions, truths, ..Evaluation::of(self.data, &self.plane) };
        let measurements: Result<Vec<_>> = self.metrics.iter().map(|metric| metric.evaluate(&evaluation)).collect();
        Ok(measurements?.concat())
    }
}

/// Pairs to measure: the closest, then some of every range of distances, then unrelated ones.
struct SelectedPairs {
    pairs: Vec<SamplePair>,
    /// Number of closest pairs.
    closest: usize,
    /// Ends of each range of distances, metres, and the indices of its pairs.
    bins: Vec<([f64; 2], Range<usize>)>,
    /// Number of pairs before the unrelated ones.
    related: usize,
}

impl SelectedPairs {
    /// Selects pairs of one `lag`; those of ranges of distances only if `has_bins`.
    fn select(data: &Dataset, lag: PairLag, has_bins: bool) -> Self {
        let candidates = pairs::find_pairs(data, lag);
        let mut pairs = select_closest(&candidates);
        let closest = pairs.len();
        let mut ranges = Vec::new();
        for (ends, range) in pairs::distance_bins(&candidates).into_iter().filter(|_| has_bins) {
            let first = pairs.len();
            pairs.extend(evenly(&candidates[range], BIN_PAIRS));
            ranges.push((ends, first..pairs.len()));
        }
        let related = pairs.len();
        pairs.extend(pairs::draw_unrelated_pairs(data));
        Self { pairs, closest, bins: ranges, related }
    }

    /// Returns the closest pairs.
    fn closest(&self) -> &[SamplePair] {
        &self.pairs[..self.closest]
    }

    /// Summarises one metric of the pairs: by distance, of unrelated pairs, and extrapolated to distance zero.
    fn summarise(&self, metric: PairMetric, lag: PairLag, task: Task) -> MetricSimilarity {
        let (PairMetric { key, unit, goal, best, values }, closest) = (metric, self.closest);
        let summary = |values: &[f64]| Summary::of(values, goal == Goal::Higher);
        let bin = |([from_m, to_m], range): &([f64; 2], Range<usize>)| {
            let Summary { mean, median, .. } = summary(&values[range.clone()]);
            DistanceBin { from_m: *from_m, to_m: *to_m, pairs: range.len(), mean, median }
        };
        let unrelated = summary(&values[self.related..]).mean;
        let at_zero = if closest < LEAST {
            let (words, cm) = (lag.describe(), REACH_M * 100.0);
            let requirement = format!("are within {cm:.0} cm of each other; at least {LEAST} are needed");
            Err(format!("{closest} pairs of samples {words} {requirement}"))
        } else {
            let scale = MetricScale { goal, best, unrelated };
            scale.extrapolate(self.closest(), &ceiling_scores(task, &values[..closest]))
        };
        MetricSimilarity { key, unit, goal, bins: self.bins.iter().map(bin).collect(), unrelated, at_zero }
    }
}

/// Returns the scores of a perfect predictor of the mean reading, given the scores `values` between two readings.
fn ceiling_scores(task: Task, values: &[f64]) -> Vec<f64> {
    values.iter().map(|v| task.ceiling.share * v).collect()
}

/// Selects the pairs for the extrapolation, out of `pairs` of ascending distances. If the distances of the closest pairs
/// differ by less than a factor of two, such as steps of a walk, they show no slope: a subset of all close pairs is used
/// instead.
fn select_closest(pairs: &[SamplePair]) -> Vec<SamplePair> {
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

/// Key of a metric, and its noise ceiling.
type MetricCeiling = (String, ZeroDistanceEstimate);

/// Noise ceiling of a test set: best score to expect from a predictor.
#[derive(Clone, Debug, Default)]
pub struct NoiseCeiling {
    /// Metric keys with their ceiling; empty if it cannot be estimated.
    pub metrics: Vec<MetricCeiling>,
    /// Notes below the table: the pairs used, or why there is no ceiling.
    pub notes: Vec<String>,
}

/// Estimates the noise ceilings of the test sets of a data set. Splits share the pairs of samples and their scores.
pub struct CeilingEstimator<'a> {
    comparison: PairComparison<'a>,
    /// Pairs measured so far.
    measured: Vec<(PairLag, PairSimilarity)>,
}

impl<'a> CeilingEstimator<'a> {
    /// Creates an estimator by those of `metrics` that score one sample at a time.
    pub fn new(data: &'a Dataset, metrics: &'a [Plugin<dyn Metric>], stop: &'a AtomicBool) -> Self {
        Self { comparison: PairComparison::new(data, metrics, stop), measured: Vec::new() }
    }

    /// Estimates the noise ceiling of the test set of `partition` by every metric, from pairs near or far apart in time, or from
    /// any pairs if these are too few. If all are too few, it has no metrics, and a note gives the reason.
    ///
    /// # Errors
    /// Same as [`crate::measure_repeatability`].
    pub fn estimate(&mut self, partition: &Partition) -> Result<NoiseCeiling> {
        let data = self.comparison.data;
        let (mut lag, mut why) = choose_lag(data, &id_gaps(data, partition));
        let closest = self.similarity(lag)?.closest;
        if closest < LEAST && self.similarity(PairLag::Any)?.closest >= LEAST {
            why = format!("since only {closest} close pairs are {}", lag.describe());
            lag = PairLag::Any;
        }
        let similarity = self.similarity(lag)?;
        let estimate = |m: &MetricSimilarity| Some((m.key.clone(), m.at_zero.as_ref().ok().copied()?));
        let ceilings: Vec<MetricCeiling> = similarity.metrics.iter().filter_map(estimate).collect();
        let missing = similarity.metrics.iter().filter_map(|m| Some((&m.key, m.at_zero.as_ref().err()?)));
        let notes = match (ceilings.is_empty(), similarity.metrics.first().map(|m| &m.at_zero)) {
            (false, _) => {
                let by = |(key, why): (&String, &String)| format!("no {CEILING} by {key}: {why}");
                pair_notes(data.task(), similarity, lag, &why, &ceilings).into_iter().chain(missing.map(by)).collect()
            }
            (true, Some(Err(reason))) => vec![format!("no {CEILING}: {reason}")],
            (true, _) => Vec::new(),
        };
        Ok(NoiseCeiling { metrics: ceilings, notes })
    }

    /// Returns the agreement of the closest pairs of one `lag`; measures it in the first call.
    fn similarity(&mut self, lag: PairLag) -> Result<&PairSimilarity> {
        let index = if let Some(index) = self.measured.iter().position(|(other, _)| *other == lag) {
            index
        } else {
            self.measured.push((lag, self.comparison.measure(lag, false)?));
            self.measured.len() - 1
        };
        let (_, similarity) = &self.measured[index];
        Ok(similarity)
    }
}

/// Returns the difference of ids between each test sample and the nearest training or validation sample; `u32::MAX`
/// without such samples.
fn id_gaps(data: &Dataset, partition: &Partition) -> Vec<u32> {
    let ids: Vec<u32> = partition.known().all().iter().map(|&i| data.sample(i).id).collect();
    let gap = |&i: &usize| {
        let id = data.sample(i).id;
        let next = ids.partition_point(|other| *other < id);
        let around = [next.checked_sub(1), Some(next)].into_iter().flatten().filter_map(|k| ids.get(k));
        around.map(|other| other.abs_diff(id)).min().unwrap_or(u32::MAX)
    };
    partition.test.iter().map(gap).collect()
}

/// Chooses pairs near in time if ids follow time and at least half of the `gaps` of [`id_gaps`] are at most [`FAR_IDS`],
/// otherwise pairs far apart. Also returns the reason.
fn choose_lag(data: &Dataset, gaps: &[u32]) -> (PairLag, String) {
    if !is_in_time_order(data) {
        return (PairLag::Far, "since samples with consecutive ids are not close in space".into());
    }
    let near = gaps.iter().filter(|gap| **gap <= FAR_IDS).count();
    let percent = |count: usize| (100 * count + gaps.len() / 2) / gaps.len().max(1);
    if 2 * near >= gaps.len() {
        let share = percent(near);
        (PairLag::Near, format!("since {share} % of the test samples have a known one at most {FAR_IDS} ids away"))
    } else {
        let share = percent(gaps.len() - near);
        (PairLag::Far, format!("since {share} % of the test samples have no known one within {FAR_IDS} ids"))
    }
}

/// Describes the pairs that the ceilings were estimated from, and the intervals of the ceilings.
fn pair_notes(task: Task, pairs: &PairSimilarity, lag: PairLag, why: &str, ceilings: &[MetricCeiling]) -> Vec<String> {
    let meaning = task.ceiling.note;
    let is_perfect = task.ceiling.share < 1.0; // the row is that of the perfect predictor already
    let more = if is_perfect { "" } else { "; a perfect predictor of the mean could reach a little more" };
    let (count, words) = (grouped(pairs.closest as i64), lag.describe());
    let interval = |(key, at_zero): &MetricCeiling| {
        let [low, high] = at_zero.interval.map(number);
        format!("{key} {low} to {high}")
    };
    let intervals: Vec<String> = ceilings.iter().map(interval).collect();
    vec![
        format!(
            "{CEILING} is {meaning}: {count} pairs {words}, at most {:.0} mm between their transmitters, followed to distance \
             zero; {why}",
            (pairs.reach_m * 1e3).ceil()
        ),
        format!("{CEILING} is an estimate and not ranked{more}; 95 % intervals of its means: {}", intervals.join(", ")),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Pose, Sample, Spectra};

    fn data(position: impl Fn(u32) -> f64) -> Dataset {
        let samples: Vec<Sample> = (0..400).map(|id| Sample::new(id, [position(id), 0.0, 0.0])).collect();
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
        let chosen = |data: &Dataset, partition: &Partition| choose_lag(data, &id_gaps(data, partition));
        let (near, why) = chosen(&walk, &partition(|i| i % 5 == 0));
        assert_eq!(near, PairLag::Near);
        assert_eq!(why, "since 100 % of the test samples have a known one at most 30 ids away");
        let (far, why) = chosen(&walk, &partition(|i| (100..300).contains(&i)));
        assert_eq!(far, PairLag::Far);
        assert_eq!(why, "since 70 % of the test samples have no known one within 30 ids");
        let anywhere = data(|id| f64::from(id * 149 % 400));
        assert_eq!(chosen(&anywhere, &partition(|i| i % 5 == 0)).0, PairLag::Far, "ids carry no time information");
    }

    #[test]
    fn splits_share_measured_pairs() {
        let walk = data(|id| f64::from(id % 200) * 0.01);
        let metrics = [Plugin::<dyn Metric>::parse("L1()").unwrap()];
        let stop = AtomicBool::new(false);
        let mut shared = CeilingEstimator::new(&walk, &metrics, &stop);
        let splits = [partition(|i| i % 5 == 0), partition(|i| i < 200), partition(|i| i % 7 == 0)];
        for (split, measured) in splits.iter().zip([1, 2, 2]) {
            let alone = CeilingEstimator::new(&walk, &metrics, &stop).estimate(split).unwrap();
            assert_eq!(format!("{:?}", shared.estimate(split).unwrap()), format!("{alone:?}"));
            assert_eq!(shared.measured.len(), measured);
        }
    }

    #[test]
    fn lag_is_measured_to_nearest_training_sample() {
        let walk = data(f64::from);
        let partition = Partition { train: vec![3, 390], validation: vec![200], test: vec![0, 100, 399] };
        assert_eq!(id_gaps(&walk, &partition), [3, 97, 9]);
        assert_eq!(id_gaps(&walk, &Partition { test: vec![1], ..Partition::default() }), [u32::MAX]);
    }
}
