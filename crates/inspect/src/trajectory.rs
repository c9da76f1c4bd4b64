//! Where transmitters stand, and how far it is from one to the next.

use pwrfgs_core::{Dataset, Unmatched, neighbours::distance};
use pwrfgs_experiment::scores::quantile;

/// Positions of a data set.
#[derive(Clone, Debug)]
pub struct Trajectory {
    /// How many samples.
    pub samples: usize,
    /// First and last id.
    pub ids: [u32; 2],
    /// Smallest and largest corner, metres.
    pub extent: [[f64; 3]; 2],
    /// Metres between successive ids, ascending; where ids are missing between two it is left out.
    pub steps: Vec<f64>,
    /// Transmitters that stand exactly where another stands.
    pub shared: usize,
    /// Halves of samples.
    pub unmatched: Unmatched,
}

impl Trajectory {
    /// The `q` quantile of steps, metres; NaN where no two ids follow each other.
    pub fn step(&self, q: f64) -> f64 {
        quantile(&self.steps, q)
    }

    /// The longest edge of the extent, metres.
    pub fn size(&self) -> f64 {
        let [low, high] = self.extent;
        (0..3).map(|k| high[k] - low[k]).fold(0.0, f64::max)
    }
}

/// Of all samples.
pub(crate) fn trajectory(data: &Dataset) -> Trajectory {
    let places: Vec<[f64; 3]> = data.transmitters.iter().map(|t| t.position).collect();
    let ends = |pick: fn(f64, f64) -> f64, from: f64| [0, 1, 2].map(|k| places.iter().map(|p| p[k]).fold(from, pick));
    let successive = data.transmitters.windows(2).filter(|pair| pair[1].id == pair[0].id + 1);
    let mut steps: Vec<f64> = successive.map(|pair| distance(pair[0].position, pair[1].position)).collect();
    steps.sort_by(f64::total_cmp);
    let mut sorted = places.clone();
    sorted.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])).then(a[2].total_cmp(&b[2])));
    let same = |i: usize, k: Option<usize>| k.and_then(|k| sorted.get(k)).is_some_and(|other| *other == sorted[i]);
    let shared = (0..sorted.len()).filter(|&i| same(i, i.checked_sub(1)) || same(i, Some(i + 1))).count();
    Trajectory {
        samples: data.len(),
        ids: [data.transmitters.first(), data.transmitters.last()].map(|s| s.map_or(0, |s| s.id)),
        extent: [ends(f64::min, f64::INFINITY), ends(f64::max, f64::NEG_INFINITY)],
        steps,
        shared,
        unmatched: data.unmatched,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Pose, Sample, Spectra};

    #[test]
    fn steps_are_between_successive_ids_and_shared_places_are_counted() {
        let sample = |id, x| Sample::new(id, [x, 0.0, 1.0]);
        let samples = vec![sample(1, 0.0), sample(2, 3.0), sample(4, 0.0), sample(5, 1.0), sample(6, 0.0)];
        let spectra = Spectra::grey((4, 1), vec![0; 20]).unwrap();
        let found = trajectory(&Dataset::new("line", Pose::IDENTITY, vec![], samples, spectra).unwrap());
        assert_eq!((found.steps.as_slice(), found.shared), ([1.0, 1.0, 3.0].as_slice(), 3));
        assert_eq!((found.extent, found.size()), ([[0.0, 0.0, 1.0], [3.0, 0.0, 1.0]], 3.0));
    }
}
