//! `NearestFingerprints`: the baseline of localisation.

use crate::{FingerprintFeatures, Fingerprints, mean_and_median};
use pwrfgs_core::{Dataset, FittingSet, neighbours::distance};
use rayon::prelude::*;

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
    /// Fits to the training links; `floor` is the power of a receiver that did not hear a transmitter.
    pub fn fit(data: &Dataset, known: FittingSet<'_>, features: &FingerprintFeatures, floor: f32) -> Self {
        let of = |links: &[usize]| Fingerprints::measured(features, data, &data.transmitters_of(links), floor);
        let (fingerprints, truths) = (of(known.train), of(known.validation));
        let mut best = Self { fingerprints, k: 1 };
        if !truths.is_empty() {
            let error = |k: usize| {
                let one = |i: usize| distance(best.nearest(truths.row(i), k), truths.positions[i]);
                mean_and_median((0..truths.len()).into_par_iter().map(one).collect())[0]
            };
            best.k =
                COUNTS.map(|k| (error(k), k)).into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).map_or(1, |own| own.1);
        }
        best
    }

    /// Returns the position of an observation, metres.
    pub fn locate(&self, observation: &[f32]) -> [f64; 3] {
        self.nearest(observation, self.k)
    }

    fn nearest(&self, observation: &[f32], k: usize) -> [f64; 3] {
        let misfits = self.fingerprints.misfits(observation);
        let mut order: Vec<usize> = (0..misfits.len()).collect();
        order.sort_by(|a, b| misfits[*a].total_cmp(&misfits[*b]));
        order.truncate(k);
        let mut mean = [0.0; 3];
        for place in &order {
            (0..3).for_each(|axis| mean[axis] += self.fingerprints.positions[*place][axis] / order.len() as f64);
        }
        mean
    }
}
