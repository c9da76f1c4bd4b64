//! `Fingerprints`: features of the observations at known positions, and the baseline that searches them.

use crate::{FingerprintFeatures, mean_and_median};
use pwrfgs_core::neighbours::distance;
use pwrfgs_core::{Dataset, FittingSet, Predict};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Number of degrees of freedom of the mean variance of all links in the variance of a link.
const PRIOR: f32 = 3.0;

/// Features at K positions, structure of arrays. NaN stands for an unknown value.
#[derive(Clone, Debug, Default)]
pub struct Fingerprints {
    /// Positions `[K]`, metres.
    pub positions: Vec<[f64; 3]>,
    /// Features `[K, D]`: those of all receivers, one after another.
    values: Vec<f32>,
    /// Weights of squared differences from the features, `[K, D]`, or `[D]` of all positions: smaller where repeated readings of a
    /// link spread.
    weights: Vec<f32>,
    /// Number of features D.
    width: usize,
}

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

    /// Returns the measured fingerprints of `places` of [`Self::places`].
    pub(crate) fn measured_at(&self, places: &[Vec<usize>]) -> Fingerprints {
        self.build(places, |link| self.features.extract(&self.data.image(link)))
    }

    /// Returns the predicted fingerprints of `places`, for the same links as [`Self::measured_at`].
    pub(crate) fn predicted(&self, places: &[Vec<usize>], model: &dyn Predict) -> Fingerprints {
        self.build(places, |link| self.features.extract(&model.predict(self.data.query(link))))
    }

    /// Groups `transmitters` by position, so that repeated readings of powers make one fingerprint. Other observations stay
    /// alone.
    pub(crate) fn places(&self, transmitters: &[usize]) -> Vec<Vec<usize>> {
        let (mut places, mut known): (Vec<Vec<usize>>, _) = (Vec::new(), BTreeMap::new());
        for &t in transmitters {
            let place = *known.entry(self.data.locations[t].position().map(f64::to_bits)).or_insert(places.len());
            match places.get_mut(place).filter(|_| self.data.task().is_scalar) {
                Some(repeated) => repeated.push(t),
                None => places.push(vec![t]),
            }
        }
        places
    }

    /// Creates the fingerprints of `places`, the mean of all readings of each link; `link_features` returns the features of a
    /// reading. The variance of the difference between a mean of n readings and a new one, v (1 + 1/n), relative to that of a link
    /// with one reading, divides the weight of a feature; v is the variance of the link, drawn to that of all links.
    fn build(&self, places: &[Vec<usize>], link_features: impl Fn(usize) -> Vec<f32> + Sync) -> Fingerprints {
        let (data, count) = (self.data, self.features.count());
        let missing = if self.floor.is_finite() { self.floor } else { f32::NAN };
        let width = count * data.scene.receivers.len();
        // Number of readings, their mean and the sum of squared deviations, by feature.
        let row = |place: &Vec<usize>| {
            let mut row = vec![(0.0, missing, 0.0); width];
            for link in data.links_of(place) {
                let features = &mut row[data.links[link].receiver * count..][..count];
                for ((n, mean, squares), value) in features.iter_mut().zip(link_features(link)) {
                    *n += 1.0;
                    let deviation = if *n == 1.0 { 0.0 } else { value - *mean };
                    *mean = if *n == 1.0 { value } else { *mean + deviation / *n };
                    *squares += deviation * (value - *mean);
                }
            }
            row
        };
        let rows: Vec<(f32, f32, f32)> = places.par_iter().flat_map_iter(row).collect();
        let repeated = || rows.iter().filter(|(n, ..)| *n > 1.0);
        let variance = repeated().map(|row| row.2).sum::<f32>() / repeated().map(|row| row.0 - 1.0).sum::<f32>();
        let weight = |&(n, _, squares): &(f32, f32, f32)| {
            let own = (PRIOR * variance + squares) / (PRIOR + n - 1.0);
            if n > 1.0 { 2.0 * variance / (own * (1.0 + 1.0 / n)) } else { 1.0 }
        };
        let weights = if variance > 0.0 { rows.iter().map(weight).collect() } else { vec![1.0; width] };
        let positions = places.iter().map(|place| data.locations[place[0]].position()).collect();
        Fingerprints { positions, values: rows.into_iter().map(|row| row.1).collect(), weights, width }
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

    /// Returns a mixture with a `share` of `other`, which has the same positions.
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

    /// Returns the weighted mean squared difference of an observation `[D]` from every fingerprint, `[K]`, over the features
    /// that both contain; infinite if there are none.
    pub fn misfits(&self, observation: &[f32]) -> Vec<f32> {
        (0..self.len()).map(|k| mean_squared_difference(observation, self.row(k), self.row_weights(k))).collect()
    }
}

/// Number of sums that run side by side.
const LANES: usize = 16;

/// Returns the weighted mean squared difference of features over those that both contain; infinite if there are none. Sums of
/// [`LANES`] run side by side, for vector instructions.
fn mean_squared_difference(a: &[f32], b: &[f32], weights: &[f32]) -> f32 {
    let (mut sums, mut totals) = ([0.0_f32; LANES], [0.0_f32; LANES]);
    let mut add = |k: usize, a: f32, b: f32, weight: f32| {
        let d = a - b;
        sums[k] += if d.is_nan() { 0.0 } else { weight * (d * d) };
        totals[k] += if d.is_nan() { 0.0 } else { weight };
    };
    let (left, right, third) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>(), weights.as_chunks::<LANES>());
    for ((a, b), weights) in left.0.iter().zip(right.0).zip(third.0) {
        (0..LANES).for_each(|k| add(k, a[k], b[k], weights[k]));
    }
    let rest = left.1.iter().zip(right.1).zip(third.1);
    rest.enumerate().for_each(|(k, ((a, b), weight))| add(k, *a, *b, *weight));
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
    /// Fits to the training links, with the number of neighbours of the smallest mean error on validation links; `floor` is
    /// the power of a receiver that did not receive a transmitter, dBm.
    pub fn fit(data: &Dataset, links: FittingSet<'_>, features: &FingerprintFeatures, floor: f32) -> Self {
        let builder = FingerprintBuilder { data, features, floor };
        let fingerprints = builder.measured_at(&builder.places(&data.locations_of(links.train)));
        let truths = builder.measured(&data.locations_of(links.validation));
        let mut best = Self { fingerprints, k: 1 };
        if !truths.is_empty() {
            let error = |k: usize| {
                let sample_error = |i: usize| distance(best.nearest_position(truths.row(i), k), truths.positions[i]);
                mean_and_median((0..truths.len()).into_par_iter().map(sample_error).collect())[0]
            };
            best.k = COUNTS.map(|k| (error(k), k)).into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).map_or(1, |(_, k)| k);
        }
        best
    }

    /// Returns the position of an observation, metres.
    pub fn locate(&self, observation: &[f32]) -> [f64; 3] {
        self.nearest_position(observation, self.k)
    }

    /// Returns the mean position of the `k` fingerprints of least misfit, metres.
    fn nearest_position(&self, observation: &[f32], k: usize) -> [f64; 3] {
        let misfits = self.fingerprints.misfits(observation);
        let mut order: Vec<usize> = (0..misfits.len()).collect();
        order.sort_by(|a, b| misfits[*a].total_cmp(&misfits[*b]));
        order.truncate(k);
        let mut mean = [0.0; 3];
        for neighbour in &order {
            (0..3).for_each(|axis| mean[axis] += self.fingerprints.positions[*neighbour][axis] / order.len() as f64);
        }
        mean
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Pose, Real, Receiver, Sample};

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
        let places = builder.places(&[0, 1, 2, 3]);
        assert_eq!(places, [vec![0, 1, 2], vec![3]]);
        let joined = builder.measured_at(&places);
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
