//! `Fingerprints`: features of the observations at known positions, and the baseline that searches them.

use crate::{FingerprintFeatures, mean_and_median};
use pwrfgs_core::neighbours::distance;
use pwrfgs_core::{Dataset, FittingSet, Predict};
use rayon::prelude::*;

/// Features at K positions, structure of arrays. NaN stands for an unknown value.
#[derive(Clone, Debug, Default)]
pub struct Fingerprints {
    /// Positions `[K]`, metres.
    pub positions: Vec<[f64; 3]>,
    /// Features `[K, D]`: those of all receivers, one after another.
    values: Vec<f32>,
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
    /// Returns the measured fingerprints of `transmitters`.
    pub(crate) fn measured(&self, transmitters: &[usize]) -> Fingerprints {
        self.build(transmitters, |link| self.features.extract(&self.data.image(link)))
    }

    /// Returns the predicted fingerprints of `transmitters`, for the same links as [`Self::measured`].
    pub(crate) fn predicted(&self, transmitters: &[usize], model: &dyn Predict) -> Fingerprints {
        self.build(transmitters, |link| self.features.extract(&model.predict(self.data.query(link))))
    }

    /// Creates the fingerprints of `transmitters`; `link_features` returns the features of a link.
    fn build(&self, transmitters: &[usize], link_features: impl Fn(usize) -> Vec<f32> + Sync) -> Fingerprints {
        let (data, count) = (self.data, self.features.count());
        let missing = if self.floor.is_finite() { self.floor } else { f32::NAN };
        let width = count * data.scene.receivers.len();
        let row = |t: &usize| {
            let mut row = vec![missing; width];
            for link in data.links_of(&[*t]) {
                let receiver = data.links[link].receiver;
                row[receiver * count..][..count].copy_from_slice(&link_features(link));
            }
            row
        };
        let rows: Vec<Vec<f32>> = transmitters.par_iter().map(row).collect();
        let positions = transmitters.iter().map(|&t| data.locations[t].position()).collect();
        Fingerprints { positions, values: rows.concat(), width }
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

    /// Returns a mixture with a `share` of `other`, which has the same positions.
    #[must_use]
    pub fn blended(&self, other: &Self, share: f32) -> Self {
        let values =
            self.values.iter().zip(&other.values).map(|(value, other)| value + share * (other - value)).collect();
        Self { positions: self.positions.clone(), values, width: self.width }
    }

    /// Returns the fingerprints whose positions satisfy `is_kept`.
    #[must_use]
    pub fn filtered(&self, is_kept: impl Fn([f64; 3]) -> bool) -> Self {
        let kept: Vec<usize> = (0..self.len()).filter(|k| is_kept(self.positions[*k])).collect();
        let values = kept.iter().flat_map(|k| self.row(*k)).copied().collect();
        Self { positions: kept.iter().map(|k| self.positions[*k]).collect(), values, width: self.width }
    }

    /// Returns the mean squared difference of an observation `[D]` from every fingerprint, `[K]`, over the features that
    /// both contain; infinite if there are none.
    pub fn misfits(&self, observation: &[f32]) -> Vec<f32> {
        (0..self.len()).map(|k| mean_squared_difference(observation, self.row(k))).collect()
    }
}

/// Number of sums that run side by side.
const LANES: usize = 16;

/// Returns the mean squared difference of features over those that both contain; infinite if there are none. Sums of
/// [`LANES`] run side by side, for vector instructions.
fn mean_squared_difference(a: &[f32], b: &[f32]) -> f32 {
    let (mut sums, mut counts) = ([0.0_f32; LANES], [0.0_f32; LANES]);
    let (mut left, mut right) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let mut add = |k: usize, a: f32, b: f32| {
        let d = a - b;
        let is_known = f32::from(u8::from(!d.is_nan()));
        sums[k] += if d.is_nan() { 0.0 } else { d * d };
        counts[k] += is_known;
    };
    for (a, b) in (&mut left).zip(&mut right) {
        (0..LANES).for_each(|k| add(k, a[k], b[k]));
    }
    left.remainder().iter().zip(right.remainder()).enumerate().for_each(|(k, (a, b))| add(k, *a, *b));
    let count = counts.iter().sum::<f32>();
    if count == 0.0 { f32::INFINITY } else { sums.iter().sum::<f32>() / count }
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
        let measured = |links: &[usize]| builder.measured(&data.locations_of(links));
        let (fingerprints, truths) = (measured(links.train), measured(links.validation));
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

    #[test]
    fn misfit_is_the_mean_over_known_features() {
        let a: Vec<f32> = (0..40).map(|k| k as f32).collect();
        let mut b: Vec<f32> = a.iter().map(|v| v + 2.0).collect();
        assert_eq!(mean_squared_difference(&a, &b), 4.0);
        b[3] = f32::NAN;
        b[39] = f32::NAN;
        assert_eq!(mean_squared_difference(&a, &b), 4.0);
        assert_eq!(mean_squared_difference(&[f32::NAN], &[1.0]), f32::INFINITY);
    }
}
