//! `Fingerprints`: features of the observations at known positions, and the baseline that searches them.

use crate::{FingerprintFeatures, MOST_SAMPLES};
use pwrfgs_core::neighbours::distance;
use pwrfgs_core::statistics::{evenly, mean};
use pwrfgs_core::{Dataset, FittingSet, Predict};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Weight of the variance of all links in the variance of a link, in degrees of freedom.
const PRIOR: f32 = 3.0;

/// Readings of a feature at a position.
#[derive(Clone, Copy)]
struct Readings {
    /// Number of readings n.
    count: f32,
    mean: f32,
    /// Sum of squared deviations from the mean.
    squares: f32,
}

impl Readings {
    /// Adds a reading (Welford, 1962).
    fn add(&mut self, value: f32) {
        self.count += 1.0;
        // Before the first reading, the mean is the value of a missing link, which may be NaN.
        let deviation = if self.count == 1.0 { 0.0 } else { value - self.mean };
        self.mean = if self.count == 1.0 { value } else { self.mean + deviation / self.count };
        self.squares += deviation * (value - self.mean);
    }

    /// Returns the weight of a squared difference from the mean, 1 for at most one reading: inverse to v (1 + 1/n), the
    /// variance of the difference between the mean and a new reading. v is the variance of these readings, drawn to the
    /// `variance` of all links.
    fn weight(&self, variance: f32) -> f32 {
        let drawn = (PRIOR * variance + self.squares) / (PRIOR + self.count - 1.0);
        if self.count > 1.0 { 2.0 * variance / (drawn * (1.0 + 1.0 / self.count)) } else { 1.0 }
    }
}

/// Features at K positions, structure of arrays. NaN stands for an unknown value.
#[derive(Clone, Debug, Default)]
pub struct Fingerprints {
    /// Positions `[K]`, metres.
    pub positions: Vec<[f64; 3]>,
    /// Features `[K, D]`: those of all receivers, one after another.
    values: Vec<f32>,
    /// Weights of squared differences from the features, `[K, D]`, or `[D]` for all positions; smaller if repeated readings of
    /// a link spread.
    weights: Vec<f32>,
    /// Number of features D.
    width: usize,
}

/// Largest number of links that a model predicts in one call.
const LINKS: usize = 512;
/// Largest number of values of the predictions of one call.
const VALUES: usize = 1 << 21;
/// Number of positions whose features are held at a time.
const CHUNK: usize = 512;

/// Builder of the fingerprints of transmitters of a data set.
pub(crate) struct FingerprintBuilder<'a> {
    pub(crate) data: &'a Dataset,
    pub(crate) features: &'a FingerprintFeatures,
    /// Power of a receiver without a link, which did not receive the transmitter, dBm; unknown if not finite.
    pub(crate) floor: f32,
}

impl FingerprintBuilder<'_> {
    /// Returns the measured fingerprints of `transmitters`, one each.
    pub(crate) fn measured(&self, transmitters: &[usize]) -> Fingerprints {
        self.measured_at(&transmitters.iter().map(|t| vec![*t]).collect::<Vec<_>>())
    }

    /// Returns the measured fingerprints, one per group of transmitters at one position.
    pub(crate) fn measured_at(&self, groups: &[Vec<usize>]) -> Fingerprints {
        self.build(groups, |links| {
            links.par_iter().map(|link| self.features.extract(&self.data.image(*link))).collect()
        })
    }

    /// Returns the predicted fingerprints of `groups`, for the same links as [`Self::measured_at`]; `done` gets the number of
    /// links of each call of the model.
    pub(crate) fn predicted(&self, groups: &[Vec<usize>], model: &dyn Predict, done: impl Fn(usize)) -> Fingerprints {
        let predict = |links: &[usize]| {
            let images = model.predict_many(&self.data.queries(links));
            done(links.len());
            images.par_iter().map(|image| self.features.extract(image)).collect::<Vec<Vec<f32>>>()
        };
        self.build(groups, |links| links.chunks(self.links_per_call()).flat_map(&predict).collect())
    }

    /// Returns the largest number of links of one call of a model.
    fn links_per_call(&self) -> usize {
        (VALUES / (self.data.width * self.data.height).max(1)).clamp(1, LINKS)
    }

    /// Groups `transmitters` by position, so that repeated readings of powers make one fingerprint. For other observations,
    /// each transmitter is a group.
    pub(crate) fn group_by_position(&self, transmitters: &[usize]) -> Vec<Vec<usize>> {
        let (mut groups, mut indices): (Vec<Vec<usize>>, _) = (Vec::new(), BTreeMap::new());
        for &t in transmitters {
            let index = *indices.entry(self.data.locations[t].position().map(f64::to_bits)).or_insert(groups.len());
            match groups.get_mut(index).filter(|_| self.data.task().is_scalar) {
                Some(repeated) => repeated.push(t),
                None => groups.push(vec![t]),
            }
        }
        groups
    }

    /// Creates one fingerprint per group of transmitters: the mean of its readings at each receiver, with [`Readings::weight`]
    /// as the weight of squared differences from it. `link_features` returns the features of links, in their order.
    fn build(&self, groups: &[Vec<usize>], link_features: impl Fn(&[usize]) -> Vec<Vec<f32>>) -> Fingerprints {
        let (data, count) = (self.data, self.features.count());
        let missing = if self.floor.is_finite() { self.floor } else { f32::NAN };
        let width = count * data.scene.receivers.len();
        let row = |links: &[usize], features: &[Vec<f32>]| {
            let mut row = vec![Readings { count: 0.0, mean: missing, squares: 0.0 }; width];
            for (link, values) in links.iter().zip(features) {
                let readings = &mut row[data.links[*link].receiver * count..][..count];
                readings.iter_mut().zip(values).for_each(|(readings, value)| readings.add(*value));
            }
            row
        };
        let mut rows: Vec<Readings> = Vec::with_capacity(groups.len() * width);
        for chunk in groups.chunks(CHUNK) {
            let links: Vec<Vec<usize>> = chunk.iter().map(|group| data.links_of(group)).collect();
            let features = link_features(&links.concat());
            let mut remaining = features.as_slice();
            for links in &links {
                let (features, after) = remaining.split_at(links.len());
                rows.extend(row(links, features));
                remaining = after;
            }
        }
        let repeated = || rows.iter().filter(|readings| readings.count > 1.0);
        let freedom = repeated().map(|readings| readings.count - 1.0).sum::<f32>();
        let variance = repeated().map(|readings| readings.squares).sum::<f32>() / freedom;
        // Without repeated readings, the variance is NaN.
        let weights = if variance > 0.0 {
            rows.iter().map(|readings| readings.weight(variance)).collect()
        } else {
            vec![1.0; width]
        };
        let positions = groups.iter().map(|group| data.locations[group[0]].position()).collect();
        Fingerprints { positions, values: rows.into_iter().map(|readings| readings.mean).collect(), weights, width }
    }
}

impl Fingerprints {
    /// Returns the number of positions K.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Returns whether there are no positions.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Returns the features of position `k`, `[D]`.
    pub fn row(&self, k: usize) -> &[f32] {
        &self.values[k * self.width..][..self.width]
    }

    /// Returns the weights of position `k`, `[D]`.
    fn row_weights(&self, k: usize) -> &[f32] {
        let first = if self.weights.len() == self.width { 0 } else { k * self.width };
        &self.weights[first..][..self.width]
    }

    /// Returns a mixture with a `share` of the features of `other`, which has the same positions; the weights are those of
    /// `self`.
    #[must_use]
    pub fn blended(&self, other: &Self, share: f32) -> Self {
        let values =
            self.values.iter().zip(&other.values).map(|(value, other)| value + share * (other - value)).collect();
        Self { values, ..self.clone() }
    }

    /// Returns the fingerprints whose positions satisfy `is_kept`.
    #[must_use]
    pub fn filtered(&self, is_kept: impl Fn([f64; 3]) -> bool) -> Self {
        let kept: Vec<usize> = (0..self.len()).filter(|k| is_kept(self.positions[*k])).collect();
        let values = kept.iter().flat_map(|k| self.row(*k)).copied().collect();
        let weights = kept.iter().flat_map(|k| self.row_weights(*k)).copied().collect();
        Self { positions: kept.iter().map(|k| self.positions[*k]).collect(), values, weights, width: self.width }
    }

    /// Returns the indices and misfits of up to `count` fingerprints of least misfit, least first, ties in the order of the
    /// positions. The misfit is the weighted mean squared difference from an observation `[D]` over the features that both
    /// contain; it is infinite without a common feature, and at the position `left_out`.
    pub(crate) fn nearest(&self, observation: &[f32], count: usize, left_out: Option<[f64; 3]>) -> Vec<(u32, f32)> {
        let by_misfit = |a: &(u32, f32), b: &(u32, f32)| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0));
        let keep_nearest = |near: &mut Vec<(u32, f32)>| {
            if near.len() > count {
                near.select_nth_unstable_by(count, by_misfit);
                near.truncate(count);
            }
        };
        let (mut near, mut worst) = (Vec::with_capacity(2 * count), f32::INFINITY);
        for (k, position) in self.positions.iter().enumerate() {
            let misfit = if left_out == Some(*position) {
                f32::INFINITY
            } else {
                mean_squared_difference(observation, self.row(k), self.row_weights(k))
            };
            // Later positions lose ties.
            if misfit < worst || near.len() < count {
                near.push((k as u32, misfit));
                if near.len() == 2 * count {
                    keep_nearest(&mut near);
                    worst = near.iter().fold(0.0, |worst, (_, misfit)| worst.max(*misfit));
                }
            }
        }
        keep_nearest(&mut near);
        near.sort_unstable_by(by_misfit);
        near
    }
}

/// Number of sums that run side by side.
const LANES: usize = 16;

/// Returns the weighted mean squared difference of features over those that both contain; infinite if there are none. Sums of
/// [`LANES`] run side by side, for vector instructions.
fn mean_squared_difference(a: &[f32], b: &[f32], weights: &[f32]) -> f32 {
    // A single feature: equals the sums below, in a fraction of their time.
    if let (&[a], &[b], &[weight]) = (a, b, weights) {
        let d = a - b;
        return if d.is_nan() || weight == 0.0 { f32::INFINITY } else { weight * (d * d) / weight };
    }
    let (mut sums, mut totals) = ([0.0_f32; LANES], [0.0_f32; LANES]);
    let mut add = |k: usize, a: f32, b: f32, weight: f32| {
        let d = a - b;
        sums[k] += if d.is_nan() { 0.0 } else { weight * (d * d) };
        totals[k] += if d.is_nan() { 0.0 } else { weight };
    };
    let (a, b, weights) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>(), weights.as_chunks::<LANES>());
    for ((a, b), weights) in a.0.iter().zip(b.0).zip(weights.0) {
        (0..LANES).for_each(|k| add(k, a[k], b[k], weights[k]));
    }
    let remainder = a.1.iter().zip(b.1).zip(weights.1);
    remainder.enumerate().for_each(|(k, ((a, b), weight))| add(k, *a, *b, *weight));
    let total = totals.iter().sum::<f32>();
    if total == 0.0 { f32::INFINITY } else { sums.iter().sum::<f32>() / total }
}

/// Numbers of neighbours to choose from.
const COUNTS: [usize; 5] = [1, 3, 5, 8, 12];

/// Mean position of the k measured fingerprints that are most like an observation. Validation samples choose k.
#[derive(Clone, Debug)]
pub struct NearestFingerprints {
    fingerprints: Fingerprints,
    /// Number of neighbours.
    pub k: usize,
}

impl NearestFingerprints {
    /// Fits to the training links, with the number of neighbours of the smallest mean error on validation links, 1 without
    /// these; `floor` is the power of a receiver that did not receive a transmitter, dBm.
    pub fn fit(data: &Dataset, links: FittingSet<'_>, features: &FingerprintFeatures, floor: f32) -> Self {
        let builder = FingerprintBuilder { data, features, floor };
        let fingerprints = builder.measured_at(&builder.group_by_position(&data.locations_of(links.train)));
        let truths = builder.measured(&evenly(&data.locations_of(links.validation), MOST_SAMPLES));
        let mut best = Self { fingerprints, k: 1 };
        if !truths.is_empty() {
            let most = COUNTS[COUNTS.len() - 1];
            let nearest = |i: usize| best.fingerprints.nearest(truths.row(i), most, None);
            let nearest: Vec<Vec<(u32, f32)>> = (0..truths.len()).into_par_iter().map(nearest).collect();
            let error = |k: usize| {
                let errors = nearest.iter().zip(&truths.positions);
                mean(errors.map(|(near, truth)| distance(best.mean_position(&near[..k.min(near.len())]), *truth)))
            };
            best.k = COUNTS.map(|k| (error(k), k)).into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).map_or(1, |(_, k)| k);
        }
        best
    }

    /// Returns the estimated position of the transmitter of an observation `[D]`, metres.
    pub fn locate(&self, observation: &[f32]) -> [f64; 3] {
        self.mean_position(&self.fingerprints.nearest(observation, self.k, None))
    }

    /// Returns the mean position of fingerprints, metres; the origin for none.
    fn mean_position(&self, near: &[(u32, f32)]) -> [f64; 3] {
        let mut mean = [0.0; 3];
        for (neighbour, _) in near {
            let position = self.fingerprints.positions[*neighbour as usize];
            (0..3).for_each(|axis| mean[axis] += position[axis] / near.len() as f64);
        }
        mean
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Image, Pose, Query, Real, Receiver, Sample};

    #[test]
    fn misfit_is_the_mean_over_known_features() {
        let a: Vec<f32> = (0..40).map(|k| k as f32).collect();
        let mut b: Vec<f32> = a.iter().map(|v| v + 2.0).collect();
        let ones = [1.0; 40];
        assert_eq!(mean_squared_difference(&a, &b, &ones), 4.0);
        b[3] = f32::NAN;
        b[39] = f32::NAN;
        assert_eq!(mean_squared_difference(&a, &b, &ones), 4.0);
        assert_eq!(mean_squared_difference(&[f32::NAN], &[1.0], &[1.0]), f32::INFINITY);
        assert_eq!(mean_squared_difference(&[1.0, 5.0], &[0.0, 3.0], &[1.0, 0.5]), 2.0);
    }

    #[test]
    fn nearest_fingerprints_are_those_of_a_full_sort() {
        let values: Vec<f32> = (0..900).map(|k| (k * 7 % 23) as f32).collect();
        let positions: Vec<[f64; 3]> = (0..900).map(|k| [f64::from(k), 0.0, 0.0]).collect();
        let all = Fingerprints { positions, values, weights: vec![1.0], width: 1 };
        for (observed, left_out) in [(4.4, None), (11.0, Some([5.0, 0.0, 0.0])), (f32::NAN, None)] {
            let misfit = |k: u32| {
                let is_left_out = left_out.is_some_and(|[x, ..]: [f64; 3]| x as u32 == k);
                let misfit = (observed - all.values[k as usize]).powi(2);
                if is_left_out || observed.is_nan() { f32::INFINITY } else { misfit }
            };
            let mut sorted: Vec<(u32, f32)> = (0..900).map(|k| (k, misfit(k))).collect();
            sorted.sort_by(|a, b| a.1.total_cmp(&b.1)); // stable: ties in the order of positions
            for count in [1, 100, 900, 2_000] {
                let expected = &sorted[..count.min(900)];
                assert_eq!(all.nearest(&[observed], count, left_out), expected, "{observed} {count}");
            }
        }
    }

    /// Predicts the ID, and records the sizes of calls.
    struct Recorded(std::sync::Mutex<Vec<usize>>);

    impl Predict for Recorded {
        fn predict(&self, query: Query<'_>) -> Image {
            Image { width: 1, height: 1, pixels: vec![(query.id.unwrap_or(0) as Real).sin()] }
        }

        fn predict_many(&self, queries: &[Query<'_>]) -> Vec<Image> {
            self.0.lock().unwrap().push(queries.len());
            queries.iter().map(|query| self.predict(*query)).collect()
        }
    }

    #[test]
    fn model_predicts_fingerprints_in_batches() {
        let samples: Vec<Sample> = (0..1_100).map(|id| Sample::new(id, [f64::from(id), 0.0, 1.0])).collect();
        let powers = vec![-50.0; samples.len()];
        let receiver = vec![Receiver::new("a", Pose::IDENTITY)];
        let data = Dataset::of_links("hall", receiver, vec![], &samples, powers.into()).unwrap();
        let features = FingerprintFeatures::new(&data, &[0]);
        let builder = FingerprintBuilder { data: &data, features: &features, floor: -80.0 };
        let (model, done) = (Recorded(std::sync::Mutex::default()), std::cell::RefCell::new(Vec::new()));
        let groups = builder.group_by_position(&(0..1_100).collect::<Vec<_>>());
        let predicted = builder.predicted(&groups, &model, |links| done.borrow_mut().push(links));
        assert_eq!((done.into_inner(), model.0.into_inner().unwrap()), (vec![512, 512, 76], vec![512, 512, 76]));
        assert!((0..1_100).all(|k| predicted.row(k) == [(k as Real).sin() as f32]));
    }

    /// Three readings at the first position, of which one receiver has two, and one at the second.
    #[test]
    fn repeated_readings_make_one_fingerprint_with_their_noise() {
        let readings = [(0, 0, -50.0), (0, 1, -60.0), (1, 0, -50.0), (1, 1, -70.0), (2, 0, -53.0), (3, 0, -80.0)];
        let at = |location: u32| [if location < 3 { 0.0 } else { 5.0 }, 1.0, 2.0];
        let sample = |&(id, receiver, _): &(u32, usize, Real)| Sample { receiver, ..Sample::new(id, at(id)) };
        let samples: Vec<Sample> = readings.iter().map(sample).collect();
        let receivers: Vec<Receiver> = ["a", "b"].map(|name| Receiver::new(name, Pose::IDENTITY)).into();
        let powers: Vec<Real> = readings.iter().map(|reading| reading.2).collect();
        let data = Dataset::of_links("hall", receivers, vec![], &samples, powers.into()).unwrap();
        let features = FingerprintFeatures::new(&data, &[0, 1]);
        let builder = FingerprintBuilder { data: &data, features: &features, floor: -80.0 };
        let groups = builder.group_by_position(&[0, 1, 2, 3]);
        assert_eq!(groups, [vec![0, 1, 2], vec![3]]);
        let joined = builder.measured_at(&groups);
        assert_eq!((joined.row(0), joined.row(1)), (&[-51.0, -65.0][..], &[-80.0, -80.0][..]));
        // Squared deviations 6 of three readings and 50 of two: 56/3 of all links, and of each link, drawn to it.
        let variance = 56.0 / 3.0;
        let weight =
            |squares: f32, n: f32| 2.0 * variance * (3.0 + n - 1.0) / ((3.0 * variance + squares) * (1.0 + 1.0 / n));
        let expected = [weight(6.0, 3.0), weight(50.0, 2.0), 1.0, 1.0];
        assert!(joined.weights.iter().zip(expected).all(|(w, e)| (w - e).abs() < 1e-5), "{:?}", joined.weights);
        assert!(joined.weights[0] > joined.weights[1]);
        let kept = joined.filtered(|[x, ..]| x > 1.0);
        assert_eq!((kept.row(0), kept.row_weights(0)), (joined.row(1), &[1.0, 1.0][..]));
        assert_eq!(builder.measured(&[0, 1, 2, 3]).len(), 4);
        assert_eq!(builder.measured(&[2]).row(0), [-53.0, -80.0]);
    }
}
