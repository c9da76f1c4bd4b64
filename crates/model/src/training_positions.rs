//! `TrainingPositions`: transmitter positions of the training set, thinned, to recognise extrapolations.

use pwrfgs_core::Real;
use pwrfgs_core::neighbours::{Nearest, nearest_others};
use pwrfgs_core::statistics::sorted;
use rayon::prelude::*;

/// Maximum number of positions.
const MOST: usize = 1_024;
/// Minimum distance between two positions, as a share of the diagonal of their bounding box: it keeps the file small.
const CLOSEST: Real = 0.01;
/// Percentile of the distances between neighbours, and the factor from it to the limit. Both are chosen, not fitted: the
/// percentile ignores outliers; on the quickstart the limit is 0.44 m, and test positions are at most 0.30 m away.
const SPACING: f64 = 0.95;
const LIMIT: Real = 3.0;

/// Thinned transmitter positions of a training set, one or more, and the distance beyond which a prediction is an
/// extrapolation.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainingPositions {
    positions: Vec<[Real; 3]>,
    limit: Real,
}

impl TrainingPositions {
    /// Thins `all` positions (metres from the origin of the model); `None` without positions. Starts with the first, and each
    /// step adds the position farthest from those selected. At most 1,024 positions remain, each farther from the others
    /// than 1 % of the diagonal of the bounding box.
    pub fn thinned(all: &[[Real; 3]]) -> Option<Self> {
        let mut selected = vec![*all.first()?];
        // Squares of the distances to the selected positions.
        let mut distances = vec![Real::INFINITY; all.len()];
        let sides = (0..3).map(|k| {
            let (low, high) = all.iter().fold((all[0][k], all[0][k]), |(l, h), p| (l.min(p[k]), h.max(p[k])));
            (high - low).powi(2)
        });
        let closest_square = CLOSEST.powi(2) * sides.sum::<Real>();
        while selected.len() < MOST {
            let last = selected[selected.len() - 1];
            let (mut farthest, mut largest) = (0, Real::NEG_INFINITY);
            for (i, (position, distance)) in all.iter().zip(&mut distances).enumerate() {
                *distance = distance.min((0..3).map(|k| (position[k] - last[k]).powi(2)).sum());
                if *distance > largest {
                    (farthest, largest) = (i, *distance);
                }
            }
            if largest <= closest_square {
                break;
            }
            selected.push(all[farthest]);
        }
        Self::of(selected)
    }

    /// Creates the set from thinned positions; `None` without positions.
    pub(crate) fn of(positions: Vec<[Real; 3]>) -> Option<Self> {
        let precise: Vec<[f64; 3]> = positions.iter().map(|at| at.map(f64::from)).collect();
        let spacings = sorted(nearest_others(&precise).into_iter().flatten().map(|(distance, _)| distance));
        let last = positions.len().checked_sub(1)?;
        // A single position has no neighbour.
        let spacing = spacings.get((SPACING * last as f64).round() as usize).copied().unwrap_or(0.0);
        let limit = LIMIT * spacing as Real;
        Some(Self { positions, limit })
    }

    /// Returns the positions `[K,3]`, metres from the origin of the model.
    pub fn positions(&self) -> &[[Real; 3]] {
        &self.positions
    }

    /// Returns the distance in metres beyond which a prediction is an extrapolation: three times the spacing of the
    /// positions, which is the 95th percentile of the distances between nearest neighbours. 0 for a single position.
    pub fn limit(&self) -> Real {
        self.limit
    }

    /// Returns the distance of each of `queries` (metres from the origin of the model) to the nearest position, metres.
    pub fn distances(&self, queries: &[[Real; 3]]) -> Vec<Real> {
        let precise = |at: &[Real; 3]| at.map(f64::from);
        let nearest = Nearest::of(&self.positions.iter().map(precise).collect::<Vec<_>>());
        queries.par_iter().map(|at| nearest.distance(&precise(at)) as Real).collect()
    }
}

/// Distances of transmitter positions to the nearest training positions of an ensemble.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainingDistances {
    /// Distance per position `[K]`, metres: the least over the members, which leave out parts of the training set.
    pub metres: Vec<f64>,
    /// Distance beyond which a prediction is an extrapolation, metres: the smallest over the members.
    pub limit: f64,
}

impl TrainingDistances {
    /// Returns whether the prediction at position `k` is an extrapolation.
    pub fn is_beyond(&self, k: usize) -> bool {
        self.metres[k] > self.limit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Positions of a square grid of `n` by `n`, one metre apart.
    fn grid(n: usize) -> Vec<[Real; 3]> {
        (0..n * n).map(|i| [(i % n) as Real, (i / n) as Real, 1.0]).collect()
    }

    #[test]
    fn few_positions_remain_and_repeated_ones_count_once() {
        let ten = grid(10);
        let repeated: Vec<_> = ten.iter().flat_map(|p| [*p, [p[0] + 0.01, p[1], p[2]], *p]).collect();
        let thinned = TrainingPositions::thinned(&repeated).unwrap();
        assert_eq!(thinned.positions().len(), 100);
        assert!((thinned.limit() - 3.0).abs() < 0.1, "three spacings of a metre: {}", thinned.limit());
        let one = TrainingPositions::thinned(&[[1.0, 2.0, 3.0]; 5]).unwrap();
        assert_eq!((one.positions(), one.limit()), (&[[1.0, 2.0, 3.0]][..], 0.0));
        assert_eq!(TrainingPositions::thinned(&[]), None);
    }

    #[test]
    fn thinning_leaves_no_hole_and_an_outlier_keeps_the_limit() {
        let mut all = grid(80);
        let thinned = TrainingPositions::thinned(&all).unwrap();
        assert_eq!(thinned.positions().len(), MOST);
        let farthest = thinned.distances(&all).into_iter().fold(0.0, Real::max);
        assert!(farthest < thinned.limit() / 2.0, "{farthest} of {}", thinned.limit());
        assert_eq!(thinned.distances(&[[-22.0, 0.0, 1.0]]), [22.0]);
        all.push([400.0, 0.0, 1.0]);
        let limit = TrainingPositions::thinned(&all).unwrap().limit();
        assert!(limit < 5.0 * thinned.limit(), "{limit} m with an outlier, {} m without", thinned.limit());
    }
}
