//! Neighbours in space.
//!
//! For Gaussians and point clouds, in the precision of the rasterizer: the nearest other point (d² of the paper's initial
//! covariance d²·I), the mean over the k nearest (the released initial scale), the nearest point of another set (Chamfer
//! distance), and the k nearest points. Points `[N,3]` in metres, results in m². A kd-tree (kiddo) processes all points in
//! parallel. Ties among the k nearest depend on the points only; distances do not depend on ties.
//!
//! For measured positions, in double precision: [`Nearest`].

use crate::{Real, statistics};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};
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

/// Positions of any dimension, with their samples: exact search in double precision.
///
/// A k-d tree of bounding boxes holds up to nine coordinates. Boxes have equally many positions, so many equal positions
/// do not make it deep. The bound of a box rounds as the distances do, so it never skips a neighbour. More coordinates are in
/// one box: they are scanned.
#[derive(Clone, Debug)]
pub struct Nearest {
    width: usize,
    /// Index in the list of samples and sample of each position, box by box.
    samples: Vec<(usize, usize)>,
    /// Coordinates `[S,width]`, row-major, in the same order.
    coordinates: Vec<f64>,
    /// Smallest and largest coordinates of boxes, `[boxes,2,width]`; box b has the halves 2b + 1 and 2b + 2.
    boxes: Vec<f64>,
}

/// Largest number of positions in a box without halves.
const LEAF: usize = 16;
/// Largest number of coordinates in a tree: those of [`crate::Pose::coordinates`].
const WIDEST: usize = 9;

impl Nearest {
    /// Creates a lookup for samples; `position` returns the `width` coordinates of one, in metres or any other unit.
    pub fn new<P: AsRef<[f64]>>(samples: &[usize], width: usize, position: impl Fn(usize) -> P) -> Self {
        let (width, mut given) = (width.max(1), Vec::with_capacity(samples.len() * width));
        samples.iter().for_each(|&i| given.extend_from_slice(position(i).as_ref()));
        let mut order: Vec<usize> = (0..given.len() / width).collect();
        // A complete tree with `levels` levels below its root: leaves have at most [`LEAF`] positions, unless these have more
        // than [`WIDEST`] coordinates.
        let levels = (order.len() / LEAF).checked_ilog2().filter(|_| width <= WIDEST).map_or(0, |level| level + 1);
        let mut boxes = vec![0.0; ((2 << levels) - 1) * 2 * width];
        divide(0, &mut order, &given, width, &mut boxes);
        let coordinates = order.iter().flat_map(|&k| &given[k * width..][..width]).copied().collect();
        Self { width, samples: order.into_iter().map(|k| (k, samples[k])).collect(), coordinates, boxes }
    }

    /// Creates a lookup for positions, whose samples are 0 to N − 1.
    pub fn of<P: AsRef<[f64]>>(positions: &[P]) -> Self {
        let width = positions.first().map_or(1, |position| position.as_ref().len());
        Self::new(&(0..positions.len()).collect::<Vec<_>>(), width, |i| &positions[i])
    }

    /// Returns the distance from `at` to the nearest position; infinity if there is none.
    pub fn distance(&self, at: &[f64]) -> f64 {
        self.find(at, 1).1.first().map_or(f64::INFINITY, |nearest| nearest.0)
    }

    /// Returns all samples exactly at `at`, in their order in the list, and the `k` nearest as (distance, sample), nearest
    /// first: fewer if there are not enough, one if `k` is 0. Ties go to the lower sample index.
    pub fn find(&self, at: &[f64], k: usize) -> (Vec<usize>, Vec<(f64, usize)>) {
        self.find_where(at, k, |_| true)
    }

    /// Returns the samples as [`Self::find`], of those whose index in the list of samples `is_wanted`.
    pub fn find_where(
        &self,
        at: &[f64],
        k: usize,
        is_wanted: impl Fn(usize) -> bool,
    ) -> (Vec<usize>, Vec<(f64, usize)>) {
        let mut search = Search::new(self, at, k, is_wanted);
        search.visit(0, 0, self.samples.len());
        search.exact.sort_unstable();
        let near = search.near.into_sorted_vec().into_iter().map(|(bits, sample)| (f64::from_bits(bits), sample));
        (search.exact.into_iter().map(|(_, sample)| sample).collect(), near.collect())
    }

    /// Returns the squared distance from `at` to a box: at most that to any position in it.
    fn bound(&self, index: usize, at: &[f64]) -> f64 {
        let (low, high) = self.boxes[index * 2 * self.width..][..2 * self.width].split_at(self.width);
        let outside = low.iter().zip(high).zip(at).map(|((low, high), at)| (low - at).max(at - high).max(0.0));
        outside.map(|outside| outside.powi(2)).sum()
    }
}

/// Returns the nearest other position of each, `[N]`: its distance, 0 for a duplicate, and its index. `None` for a single
/// position, and if all distances are NaN.
pub fn nearest_others(positions: &[[f64; 3]]) -> Vec<Option<(f64, usize)>> {
    let nearest = Nearest::of(positions);
    let other = |(i, at): (usize, &[f64; 3])| nearest.find(at, 2).1.into_iter().find(|(_, j)| *j != i);
    positions.par_iter().enumerate().map(other).collect()
}

/// Divides the positions `order` of a box into halves along its longest side, if it has halves, and writes all boxes.
fn divide(index: usize, order: &mut [usize], given: &[f64], width: usize, boxes: &mut [f64]) {
    let side = |axis: usize| statistics::bounds(order.iter().map(|&k| given[k * width + axis]));
    let sides: Vec<(f64, f64)> = (0..width).map(side).collect();
    let (low, high) = boxes[index * 2 * width..][..2 * width].split_at_mut(width);
    (0..width).for_each(|axis| (low[axis], high[axis]) = sides[axis]);
    if !has_halves(index, width, boxes) {
        return;
    }
    let length = |axis: usize| sides[axis].1 - sides[axis].0;
    let longest = (0..width).reduce(|a, b| if length(b) > length(a) { b } else { a }).unwrap_or(0);
    let middle = order.len() / 2;
    let along = |k: &usize| given[k * width + longest];
    order.select_nth_unstable_by(middle, |a, b| along(a).total_cmp(&along(b)));
    let (lower, upper) = order.split_at_mut(middle);
    divide(2 * index + 1, lower, given, width, boxes);
    divide(2 * index + 2, upper, given, width, boxes);
}

/// Returns whether a box has halves: the second one is within `boxes`.
fn has_halves(index: usize, width: usize, boxes: &[f64]) -> bool {
    (2 * index + 3) * 2 * width <= boxes.len()
}

/// Search for the neighbours of one position.
struct Search<'a, W> {
    among: &'a Nearest,
    at: &'a [f64],
    k: usize,
    is_wanted: W,
    /// Indices of the samples at the position, and the samples.
    exact: Vec<(usize, usize)>,
    /// Nearest samples, after the bits of their distances: those of positive numbers are in the order of the numbers.
    near: BinaryHeap<(u64, usize)>,
    /// Distance beyond which samples are no neighbours, and a bound of its square.
    limit: f64,
    limit_squared: f64,
    /// Number of positions that were compared.
    compared: usize,
}

impl<'a, W: Fn(usize) -> bool> Search<'a, W> {
    fn new(among: &'a Nearest, at: &'a [f64], k: usize, is_wanted: W) -> Self {
        let (exact, near, limit) = (Vec::new(), BinaryHeap::new(), f64::INFINITY);
        Self { among, at, k: k.max(1), is_wanted, exact, near, limit, limit_squared: limit, compared: 0 }
    }

    /// Adds a neighbour, removes the farthest of more than `k`, and updates the limit.
    fn insert(&mut self, distance: f64, sample: usize) {
        self.near.push((distance.to_bits(), sample));
        if self.near.len() > self.k {
            self.near.pop();
        }
        if let Some(worst) = self.near.peek().filter(|_| self.near.len() == self.k) {
            self.limit = f64::from_bits(worst.0);
            // Includes all sums of squares whose square root rounds to the limit.
            self.limit_squared = self.limit.powi(2) * (1.0 + 4.0 * f64::EPSILON) + f64::MIN_POSITIVE;
        }
    }

    /// Searches the positions `start..end` of a box, the nearer half first.
    fn visit(&mut self, index: usize, start: usize, end: usize) {
        if !has_halves(index, self.among.width, &self.among.boxes) {
            return self.scan(start, end);
        }
        let middle = start + (end - start) / 2; // as `divide` chooses it
        let half = |index, start, end| (self.among.bound(index, self.at), index, start, end);
        let mut halves = [half(2 * index + 1, start, middle), half(2 * index + 2, middle, end)];
        halves.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (bound, index, start, end) in halves {
            if bound <= self.limit_squared {
                self.visit(index, start, end);
            }
        }
    }

    /// Compares the positions `start..end`. A position at a distance of NaN is no neighbour.
    fn scan(&mut self, start: usize, end: usize) {
        let Nearest { samples, width, coordinates, .. } = self.among;
        self.compared += end - start;
        let positions = coordinates[start * width..end * width].chunks_exact(*width);
        for (position, rank) in positions.zip(start..) {
            let distance = slice_distance(position, self.at);
            if distance <= self.limit && (self.is_wanted)(samples[rank].0) {
                let (k, sample) = samples[rank];
                if distance == 0.0 {
                    self.exact.push((k, sample));
                }
                self.insert(distance, sample);
            }
        }
    }
}

/// Returns for each of `ranks` the `k` samples nearest to `order[rank]` among those before it in `order`, nearest first; fewer if
/// there are not enough. They are the conditioning sets of a likelihood (Vecchia, Journal of the Royal Statistical Society B 50,
/// 1988). `position` returns the `width` coordinates of a sample.
pub fn nearest_before<P: AsRef<[f64]>>(
    order: &[usize],
    ranks: &[usize],
    k: usize,
    width: usize,
    position: impl Fn(usize) -> P + Sync,
) -> Vec<Vec<usize>> {
    // Each lookup is at most twice as long as the list before a rank.
    let size = |rank: usize| rank.next_power_of_two().max(2 * LEAF).min(order.len());
    let sizes: BTreeSet<usize> = ranks.iter().map(|rank| size(*rank)).collect();
    let lookup = |size| (size, Nearest::new(&order[..size], width, &position));
    let lookups: BTreeMap<usize, Nearest> = sizes.into_iter().map(lookup).collect();
    let near = |&rank: &usize| {
        let near = lookups[&size(rank)].find_where(position(order[rank]).as_ref(), k, |other| other < rank).1;
        near.into_iter().map(|(_, sample)| sample).collect()
    };
    ranks.par_iter().map(near).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng;
    use std::f64::consts::TAU;

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

    /// Returns the samples as [`Nearest::find_where`], by a scan of all positions.
    fn scan(
        samples: &[usize],
        places: &[Vec<f64>],
        at: &[f64],
        k: usize,
        is_wanted: &dyn Fn(usize) -> bool,
    ) -> (Vec<usize>, Vec<(f64, usize)>) {
        let distance = |k: &usize| slice_distance(&places[*k], at);
        let wanted: Vec<usize> = (0..samples.len()).filter(|&k| is_wanted(k) && !distance(&k).is_nan()).collect();
        let exact = wanted.iter().filter(|k| distance(k) == 0.0).map(|&k| samples[k]).collect();
        let mut near: Vec<(f64, usize)> = wanted.iter().map(|k| (distance(k), samples[*k])).collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        near.truncate(k.max(1));
        (exact, near)
    }

    /// Draws `count` positions: random ones, of a grid with ties, of few distinct places, or of huge and odd numbers.
    fn draw(random: &mut rng::Rng, kind: usize, count: usize, width: usize) -> Vec<Vec<f64>> {
        let mut place = |rank: usize| match kind {
            0 => 100.0 * rng::uniform_f64(random),
            1 => rng::below(random, if width > 4 { 3 } else { 12 }) as f64 * 0.1 + 4e6,
            2 => rng::below(random, 2) as f64 * 1e-170,
            3 if rank.is_multiple_of(7) => [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e200][rng::below(random, 4)],
            _ => (rng::below(random, 1 << 20) as f64).exp2().min(1e3) - 500.0 * rng::uniform_f64(random),
        };
        (0..count).map(|rank| (0..width).map(|_| place(rank)).collect()).collect()
    }

    #[test]
    fn tree_finds_what_a_scan_finds() {
        let mut random = rng::stream(1, "tree", 0);
        for (width, kind) in [1, 3, 4, 9, 12].into_iter().flat_map(|width| (0..4).map(move |kind| (width, kind))) {
            for count in [0, 1, 15, 16, 17, 100, 1_500] {
                let places = draw(&mut random, kind, count, width);
                let mut samples: Vec<usize> = (0..count).map(|k| 3 * k + 1).collect();
                rng::shuffle(&mut random, &mut samples);
                let rank_of = |sample: usize| samples.iter().position(|other| *other == sample).unwrap();
                let nearest = Nearest::new(&samples, width, |i| places[rank_of(i)].clone());
                let mut queries = draw(&mut random, kind, 12, width);
                queries.extend(places.iter().take(6).cloned());
                for at in &queries {
                    for k in [0, 1, 5, 48, 2_000] {
                        let same = |a: &(Vec<usize>, Vec<(f64, usize)>), b: &(Vec<usize>, Vec<(f64, usize)>)| {
                            let bits = |near: &[(f64, usize)]| near.iter().map(|n| (n.0.to_bits(), n.1)).collect();
                            let [a_near, b_near]: [Vec<(u64, usize)>; 2] = [bits(&a.1), bits(&b.1)];
                            assert_eq!((&a.0, a_near), (&b.0, b_near), "{width} wide, kind {kind}, {count}, k {k}");
                        };
                        same(&nearest.find(at, k), &scan(&samples, &places, at, k, &|_| true));
                        let third = |k: usize| k % 3 == 1;
                        same(&nearest.find_where(at, k, third), &scan(&samples, &places, at, k, &third));
                    }
                }
            }
        }
    }

    #[test]
    fn neighbours_before_each_rank_are_those_of_the_list_before_it() {
        let mut random = rng::stream(1, "before", 0);
        let places = draw(&mut random, 1, 700, 3);
        let mut order: Vec<usize> = (0..700).collect();
        rng::shuffle(&mut random, &mut order);
        let ranks: Vec<usize> = (0..700).step_by(3).collect();
        let found = nearest_before(&order, &ranks, 8, 3, |i| &places[i]);
        for (rank, found) in ranks.into_iter().zip(found) {
            let nearest = Nearest::new(&order[..rank], 3, |i| &places[i]);
            let expected: Vec<usize> = nearest.find(&places[order[rank]], 8).1.into_iter().map(|n| n.1).collect();
            assert_eq!(found, expected, "rank {rank}");
        }
    }

    /// Positions on a floor, in a volume, over time, and poses on a floor with a heading.
    #[test]
    fn distances_per_query_grow_less_than_twofold_from_8_000_to_80_000_positions() {
        let count_distances = |kind: usize, count: usize| {
            let mut random = rng::stream(1, "growth", kind as u64);
            let place = |_: usize| {
                let [x, y, z, turn] = [(); 4].map(|()| rng::uniform_f64(&mut random));
                let (sin, cos) = (TAU * turn).sin_cos();
                match kind {
                    0 => vec![100.0 * x, 60.0 * y, 1.5],
                    1 => vec![100.0 * x, 60.0 * y, 3.0 * z],
                    2 => vec![100.0 * x, 60.0 * y, 1.5, 0.0],
                    _ => vec![100.0 * x, 60.0 * y, 1.5, cos, sin, 0.0, 0.0, 0.0, 1.0],
                }
            };
            let places: Vec<Vec<f64>> = (0..count + 200).map(place).collect();
            let nearest = Nearest::of(&places[..count]);
            let compared = |at: &Vec<f64>| {
                let mut search = Search::new(&nearest, at, 48, |_| true);
                search.visit(0, 0, count);
                search.compared
            };
            places[count..].iter().map(compared).sum::<usize>() / 200
        };
        for kind in 0..4 {
            let [few, many] = [8_000, 80_000].map(|count| count_distances(kind, count));
            assert!(few < 2_000 && many < 2 * few, "positions {kind}: {few} and {many} distances per query");
        }
    }
}
