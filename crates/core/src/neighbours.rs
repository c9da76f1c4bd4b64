//! Distances between points in space: the nearest other point (d² of the paper's initial covariance d²·I), the mean
//! over the k nearest (the released initial scale), the nearest point of another set (Chamfer distance), and the k
//! nearest points. Points `[N,3]` in metres, results in m².
//!
//! A kd-tree (kiddo) processes all points in parallel. Ties among the k nearest depend on the points only; distances do
//! not depend on ties.

use crate::Real;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZero;

type Tree = ImmutableKdTree<Real, 3>;

/// Returns |a − b|, in the unit of both.
pub fn distance<const N: usize>(a: [f64; N], b: [f64; N]) -> f64 {
    slice_distance(&a, &b)
}

/// Computes |a − b| of points of any dimension.
fn slice_distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// Returns the squared distance of each point to the nearest other point, `[N]`: 0 for a duplicate, infinity for a
/// single point.
pub fn nearest_other_squared(points: &[[Real; 3]]) -> Vec<Real> {
    mean_of_k_nearest_squared(points, 1)
}

/// Returns the mean squared distance of each point to its `k` nearest other points, `[N]`; to all others if there are
/// fewer than `k`. Infinity without other points, or if `k` is 0.
pub fn mean_of_k_nearest_squared(points: &[[Real; 3]], k: usize) -> Vec<Real> {
    let k = k.min(points.len().saturating_sub(1));
    let (Some(tree), true) = (build_tree(points), k > 0) else { return vec![Real::INFINITY; points.len()] };
    let with_itself = NonZero::<usize>::MIN.saturating_add(k);
    let mean = |point: &[Real; 3]| {
        let neighbours = tree.query(point).nearest_n::<SquaredEuclidean<Real>>(with_itself).execute();
        // The nearest point is the point itself or its duplicate, at distance 0 in both cases.
        let others = neighbours.iter().skip(1).map(|n| n.distance);
        match neighbours.len() {
            0 | 1 => Real::INFINITY,
            n => others.sum::<Real>() / (n - 1) as Real,
        }
    };
    points.par_iter().map(mean).collect()
}

/// Returns the squared distance of each point of `from` to the nearest point of `to`, `[from]`; infinity if `to` is
/// empty.
pub fn nearest_squared(from: &[[Real; 3]], to: &[[Real; 3]]) -> Vec<Real> {
    let Some(tree) = build_tree(to) else { return vec![Real::INFINITY; from.len()] };
    from.par_iter().map(|p| tree.query(p).nearest_one::<SquaredEuclidean<Real>>().execute().distance).collect()
}

/// Returns the `k` nearest of `points` to each of `from`, nearest first, `[from, k]`: indices, and squared distances.
/// The lists are shorter if there are fewer points. A point of `from` that is in `points` finds itself.
pub fn k_nearest(from: &[[Real; 3]], points: &[[Real; 3]], k: usize) -> Vec<Vec<(usize, Real)>> {
    let (Some(tree), Some(k)) = (build_tree(points), NonZero::new(k.min(points.len()))) else {
        return vec![Vec::new(); from.len()];
    };
    let find = |p: &[Real; 3]| {
        let neighbours = tree.query(p).nearest_n::<SquaredEuclidean<Real>>(k).execute();
        let mut neighbours: Vec<(usize, Real)> = neighbours.iter().map(|n| (n.item as usize, n.distance)).collect();
        neighbours.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        neighbours
    };
    from.par_iter().map(find).collect()
}

/// Builds the kd-tree of points; `None` without points.
fn build_tree(points: &[[Real; 3]]) -> Option<Tree> {
    (!points.is_empty()).then(|| Tree::new_from_slice(points).expect("a tree of some points can be built"))
}

/// Positions of any dimension, with their samples: exact search through all of them; 80,000 take less than a millisecond.
#[derive(Clone, Debug)]
pub struct Nearest {
    /// Coordinates `[S,width]`, row-major.
    coordinates: Vec<f64>,
    width: usize,
    samples: Vec<usize>,
}

impl Nearest {
    /// Creates a lookup for samples with coordinates of `width` numbers each, in metres or any other unit.
    pub fn new<P: AsRef<[f64]>>(samples: Vec<usize>, width: usize, position: impl Fn(usize) -> P) -> Self {
        let mut coordinates = Vec::with_capacity(samples.len() * width);
        samples.iter().for_each(|&i| coordinates.extend_from_slice(position(i).as_ref()));
        Self { coordinates, width: width.max(1), samples }
    }

    /// Returns all samples exactly at `at`, and the `k` nearest (or fewer if there are not enough), nearest first, with
    /// distances. Ties go to the lower sample index.
    pub fn find(&self, at: &[f64], k: usize) -> (Vec<usize>, Vec<(f64, usize)>) {
        /// Number of candidates beyond k that are kept before the worst are dropped.
        const SPARE: usize = 1024;
        let k = k.clamp(1, self.samples.len().max(1));
        let by_distance = |a: &(f64, usize), b: &(f64, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        let keep_nearest = |near: &mut Vec<(f64, usize)>| {
            if near.len() > k {
                near.select_nth_unstable_by(k - 1, by_distance);
                near.truncate(k);
            }
        };
        let (mut exact, mut near, mut worst) = (Vec::new(), Vec::with_capacity(k + SPARE), f64::INFINITY);
        for (position, &sample) in self.coordinates.chunks_exact(self.width).zip(&self.samples) {
            let distance = slice_distance(position, at);
            if distance == 0.0 {
                exact.push(sample);
            }
            if distance <= worst {
                near.push((distance, sample));
                if near.len() == k + SPARE {
                    keep_nearest(&mut near);
                    worst = near.iter().fold(0.0, |worst, n| worst.max(n.0));
                }
            }
        }
        keep_nearest(&mut near);
        near.sort_unstable_by(by_distance);
        (exact, near)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng;

    fn cloud(n: usize, name: &str) -> Vec<[Real; 3]> {
        let mut random = rng::stream(1, name, 0);
        (0..n).map(|_| [(); 3].map(|()| 5.0 * rng::normal(&mut random))).collect()
    }

    fn squared(a: &[Real; 3], b: &[Real; 3]) -> Real {
        (0..3).map(|k| (a[k] - b[k]).powi(2)).sum()
    }

    fn assert_close(actual: &[Real], expected: &[Real]) {
        assert_eq!(actual.len(), expected.len());
        for (f, e) in actual.iter().zip(expected) {
            assert!((f - e).abs() <= 1e-5 * e.max(1e-6), "{f} instead of {e}");
        }
    }

    #[test]
    fn neighbour_distances_match_brute_force() {
        let (a, b) = (cloud(700, "a"), cloud(90, "b"));
        let sorted = |p: &[Real; 3], others: &[[Real; 3]]| {
            let mut d: Vec<Real> = others.iter().map(|q| squared(p, q)).collect();
            d.sort_by(Real::total_cmp);
            d
        };
        let single: Vec<Real> = a.iter().map(|p| sorted(p, &a)[1]).collect();
        let three: Vec<Real> = a.iter().map(|p| sorted(p, &a)[1..4].iter().sum::<Real>() / 3.0).collect();
        let across: Vec<Real> = a.iter().map(|p| sorted(p, &b)[0]).collect();
        assert_close(&nearest_other_squared(&a), &single);
        assert_close(&mean_of_k_nearest_squared(&a, 3), &three);
        assert_close(&nearest_squared(&a, &b), &across);
    }

    #[test]
    fn nearest_points_match_brute_force() {
        let (from, points) = (cloud(40, "from"), cloud(300, "points"));
        for (p, actual) in from.iter().zip(k_nearest(&from, &points, 7)) {
            let mut sorted_points: Vec<(usize, Real)> = points.iter().map(|q| squared(p, q)).enumerate().collect();
            sorted_points.sort_by(|a, b| a.1.total_cmp(&b.1));
            let (expected, actual): (Vec<usize>, Vec<usize>) =
                (sorted_points[..7].iter().map(|n| n.0).collect(), actual.iter().map(|n| n.0).collect());
            assert_eq!(actual, expected);
        }
        assert_eq!(k_nearest(&from[..1], &from[..3], 9)[0].len(), 3);
        assert!(k_nearest(&from[..1], &[], 9)[0].is_empty() && k_nearest(&from[..1], &points, 0)[0].is_empty());
    }

    #[test]
    fn duplicate_points_have_distance_zero() {
        let points = vec![[1.0, 2.0, 3.0]; 1000];
        assert!(nearest_other_squared(&points).iter().all(|d| *d == 0.0));
        assert!(mean_of_k_nearest_squared(&points, 3).iter().all(|d| *d == 0.0));
    }

    #[test]
    fn neighbour_search_accepts_too_few_points() {
        let single = [[1.0, 2.0, 3.0]];
        assert!(nearest_other_squared(&[]).is_empty());
        assert_eq!(nearest_other_squared(&single), [Real::INFINITY]);
        assert_eq!(mean_of_k_nearest_squared(&[[0.0; 3], [2.0, 0.0, 0.0]], 3), [4.0, 4.0]);
        assert_eq!(mean_of_k_nearest_squared(&[[0.0; 3], [2.0, 0.0, 0.0]], 0), [Real::INFINITY; 2]);
        assert_eq!(nearest_squared(&single, &[]), [Real::INFINITY]);
        assert!(nearest_squared(&[], &single).is_empty());
    }

    #[test]
    fn nan_point_does_not_panic() {
        let points = [[0.0; 3], [Real::NAN, 0.0, 0.0], [1.0, 0.0, 0.0]];
        assert_eq!(nearest_other_squared(&points).len(), 3);
        assert_eq!(nearest_squared(&points, &points).len(), 3);
    }
}
