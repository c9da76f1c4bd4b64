//! `Fingerprints`: features of the observations at known positions, and the baseline that searches them.

use crate::{FingerprintFeatures, mean_and_median};
use pwrfgs_core::neighbours::distance;
use pwrfgs_core::{Dataset, FittingSet, Link, Predict};
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

/// Builder of the features of all receivers for one transmitter.
struct RowBuilder<'a> {
    data: &'a Dataset,
    features: &'a FingerprintFeatures,
    /// Value of a receiver without a link.
    missing: f32,
}

impl RowBuilder<'_> {
    /// Returns the features of transmitter `t`; `link_features` returns those of a link.
    fn build(&self, t: usize, link_features: impl Fn(usize) -> Vec<f32>) -> Vec<f32> {
        let count = self.features.count();
        let mut row = vec![self.missing; count * self.data.scene.receivers.len()];
        for link in self.data.links_of(&[t]) {
            let Link { receiver, .. } = self.data.links[link];
            row[receiver * count..][..count].copy_from_slice(&link_features(link));
        }
        row
    }
}

impl Fingerprints {
    /// Returns the measured fingerprints of `transmitters`. Powers of receivers without a link are `floor`: the transmitter
    /// was not received.
    pub fn measured(features: &FingerprintFeatures, data: &Dataset, transmitters: &[usize], floor: f32) -> Self {
        Self::new(features, data, transmitters, floor, |link| features.of(&data.image(link)))
    }

    /// Returns the predicted fingerprints of `transmitters`, for the same links as [`Self::measured`].
    pub fn predicted(
        features: &FingerprintFeatures,
        data: &Dataset,
        transmitters: &[usize],
        floor: f32,
        model: &dyn Predict,
    ) -> Self {
        Self::new(features, data, transmitters, floor, |link| features.of(&model.predict(data.query(link))))
    }

    /// Creates the fingerprints of `transmitters`; `link_features` returns the features of a link.
    fn new(
        features: &FingerprintFeatures,
        data: &Dataset,
        transmitters: &[usize],
        floor: f32,
        link_features: impl Fn(usize) -> Vec<f32> + Sync,
    ) -> Self {
        let missing = if floor.is_finite() { floor } else { f32::NAN };
        let builder = RowBuilder { data, features, missing };
        let rows: Vec<Vec<f32>> = transmitters.par_iter().map(|&t| builder.build(t, &link_features)).collect();
        let positions = transmitters.iter().map(|&t| data.locations[t].position()).collect();
        Self { positions, values: rows.concat(), width: features.count() * data.scene.receivers.len() }
    }

    /// Returns the number of positions K.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Returns whether there are no positions.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Returns the features of position `k`.
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

    /// Returns the mean squared difference of an observation from every fingerprint, over the features that both
    /// contain; infinite if there are none.
    pub fn misfits(&self, observation: &[f32]) -> Vec<f32> {
        (0..self.len()).map(|k| misfit(observation, self.row(k))).collect()
    }
}

/// Number of sums that run side by side.
const LANES: usize = 16;

/// Returns the mean squared difference over the features that both contain.
fn misfit(a: &[f32], b: &[f32]) -> f32 {
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
    /// Fits to the training links; `floor` is the power of a receiver that did not receive a transmitter.
    pub fn fit(data: &Dataset, links: FittingSet<'_>, features: &FingerprintFeatures, floor: f32) -> Self {
        let measured = |links: &[usize]| Fingerprints::measured(features, data, &data.locations_of(links), floor);
        let (fingerprints, truths) = (measured(links.train), measured(links.validation));
        let mut best = Self { fingerprints, k: 1 };
        if !truths.is_empty() {
            let error = |k: usize| {
                let sample_error = |i: usize| distance(best.nearest(truths.row(i), k), truths.positions[i]);
                mean_and_median((0..truths.len()).into_par_iter().map(sample_error).collect())[0]
            };
            best.k = COUNTS.map(|k| (error(k), k)).into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).map_or(1, |(_, k)| k);
        }
        best
    }

    /// Returns the position of an observation, metres.
    pub fn locate(&self, observation: &[f32]) -> [f64; 3] {
        self.nearest(observation, self.k)
    }

    /// Returns the mean position of the `k` fingerprints of least misfit, metres.
    fn nearest(&self, observation: &[f32], k: usize) -> [f64; 3] {
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
        assert_eq!(misfit(&a, &b), 4.0);
        b[3] = f32::NAN;
        b[39] = f32::NAN;
        assert_eq!(misfit(&a, &b), 4.0);
        assert_eq!(misfit(&[f32::NAN], &[1.0]), f32::INFINITY);
    }
}
