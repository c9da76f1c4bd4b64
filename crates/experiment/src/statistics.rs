//! Summaries of test samples, mean and deviation over seeds, and bootstrap intervals of paired differences.
//!
//! A difference has two sources of randomness: the training seed and the choice of test transmitters. All seeds may use
//! the same test positions, so seeds and positions are *crossed*: a replicate resamples seeds and, common to all of
//! them, blocks of neighbouring positions (Owen, "The pigeonhole bootstrap", 2007). Neighbours have similar errors;
//! resampling single spectra would treat them as independent and give far too narrow intervals.
//!
//! From n seeds (or blocks) a replicate draws n−1, with replacement: the variance of its mean is then s²/n, where n
//! draws would give s²(n−1)/n² (Rao and Wu, 1988). That matters with three seeds. With few seeds the intervals remain
//! optimistic in shape: percentiles of three values lack the long tails of Student's distribution.
//! `bootstrap_interval_has_expected_coverage` measures this.

use pwrfgs_core::rng::{self, Rng};
pub use pwrfgs_core::statistics::quantile;
use pwrfgs_core::statistics::{bounds, sorted};
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::iter::repeat_with;

/// Number of bootstrap replicates.
pub const REPLICATES: usize = 10_000;
/// Coverage of the intervals.
pub const CONFIDENCE: f64 = 0.95;

/// Mean, median and tail percentile of per-sample values. Infinite values (a perfect PSNR) are stored as `null`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Arithmetic mean.
    #[serde(deserialize_with = "read_null_as_infinite")]
    pub mean: f64,
    /// Middle value.
    #[serde(deserialize_with = "read_null_as_infinite")]
    pub median: f64,
    /// Bad tail: the 10th percentile if higher is better, else the 90th.
    #[serde(deserialize_with = "read_null_as_infinite")]
    pub tail10: f64,
}

impl Summary {
    /// Summarises any number of values; NaN for none. Quantiles are interpolated linearly between order statistics.
    pub fn of(values: &[f64], higher_is_better: bool) -> Self {
        let sorted = sorted(values.iter().copied());
        Self {
            mean: values.iter().sum::<f64>() / values.len() as f64,
            median: quantile(&sorted, 0.5),
            tail10: quantile(&sorted, if higher_is_better { 0.1 } else { 0.9 }),
        }
    }
}

/// Reads a number, `null` as infinity: JSON has neither infinity nor NaN, and stores both as `null`.
pub(crate) fn read_null_as_infinite<'de, D: Deserializer<'de>>(d: D) -> Result<f64, D::Error> {
    Ok(Option::<f64>::deserialize(d)?.unwrap_or(f64::INFINITY))
}

/// Mean and sample standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Arithmetic mean.
    pub mean: f64,
    /// Sample standard deviation (n−1 in the denominator); `None` for one value, or if a value is infinite.
    pub deviation: Option<f64>,
    /// Number of values.
    pub n: usize,
}

impl Spread {
    /// Computes mean and deviation of at least one value; `None` without values.
    pub fn of(values: &[f64]) -> Option<Self> {
        let (n, first) = (values.len(), *values.first()?);
        // Equal values have deviation 0, independent of rounding.
        let mean = if values.iter().all(|v| *v == first) { first } else { values.iter().sum::<f64>() / n as f64 };
        let squares: f64 = values.iter().map(|v| (v - mean) * (v - mean)).sum();
        let deviation = (n > 1 && mean.is_finite()).then(|| (squares / (n - 1) as f64).sqrt());
        Some(Self { mean, deviation, n })
    }
}

/// Differences of one seed in one block of space.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BlockSum {
    /// Sum of the differences.
    pub sum: f64,
    /// Number of differences.
    pub count: usize,
}

impl BlockSum {
    /// Adds a difference to sum and count.
    pub fn add_difference(&mut self, difference: f64) {
        self.sum += difference;
        self.count += 1;
    }
}

/// Mean difference with its confidence interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// Mean over seeds of the mean over test spectra.
    pub mean: f64,
    /// Percentile interval of [`CONFIDENCE`]; `None` with a single block.
    pub interval: Option<(f64, f64)>,
    /// Number of common seeds; with one, the interval excludes the variation between seeds.
    pub seeds: usize,
}

impl Difference {
    /// Computes the difference of `cells[seed][block]`, all seeds with the same blocks; `None` without any difference.
    pub fn of(cells: &[Vec<BlockSum>]) -> Option<Self> {
        Self::with_replicates(cells, REPLICATES)
    }

    /// Computes the difference as [`Self::of`] does, with a number of bootstrap replicates. `None` without any
    /// difference.
    fn with_replicates(cells: &[Vec<BlockSum>], replicates: usize) -> Option<Self> {
        let cells: Vec<&[BlockSum]> =
            cells.iter().map(Vec::as_slice).filter(|c| c.iter().any(|c| c.count > 0)).collect();
        let seeds: Vec<usize> = (0..cells.len()).collect();
        let blocks: Vec<usize> =
            (0..cells.first()?.len()).filter(|b| cells.iter().any(|seed| seed[*b].count > 0)).collect();
        let mean = crossed_mean(&cells, &seeds, &blocks)?;
        let interval = (blocks.len() > 1).then(|| {
            // Same random stream for every difference, so that rows of a table are comparable.
            let mut random = rng::stream(0, "bootstrap", 0);
            let replicate = || {
                let (seeds, blocks) = (draw_indices(&mut random, &seeds), draw_indices(&mut random, &blocks));
                crossed_mean(&cells, &seeds, &blocks).unwrap_or(mean)
            };
            let means = sorted(repeat_with(replicate).take(replicates));
            let tail = (1.0 - CONFIDENCE) / 2.0;
            (quantile(&means, tail), quantile(&means, 1.0 - tail))
        });
        Some(Self { mean, interval, seeds: cells.len() })
    }

    /// Returns whether the interval excludes 0.
    pub fn is_clear(&self) -> bool {
        self.interval.is_some_and(|(low, high)| low > 0.0 || high < 0.0)
    }
}

/// Draws n−1 of n `indices`, with replacement; returns a single index as it is.
fn draw_indices(random: &mut Rng, indices: &[usize]) -> Vec<usize> {
    let count = indices.len().saturating_sub(1).max(1);
    repeat_with(|| indices[rng::below(random, indices.len())]).take(count).collect()
}

/// Computes the mean over `seeds` of the mean difference in `blocks`; seeds without differences in these blocks are
/// skipped, `None` if all are.
fn crossed_mean(cells: &[&[BlockSum]], seeds: &[usize], blocks: &[usize]) -> Option<f64> {
    let of_seed = |seed: &usize| {
        let (sum, count) = blocks
            .iter()
            .fold((0.0, 0), |(sum, count), b| (sum + cells[*seed][*b].sum, count + cells[*seed][*b].count));
        (count > 0).then(|| sum / count as f64)
    };
    let (sum, count) = seeds.iter().filter_map(of_seed).fold((0.0, 0), |(sum, count), m| (sum + m, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

/// Smallest number of cubes with test transmitters, for a bootstrap.
const WANTED: usize = 30;
/// Longest side of the positions over the smallest edge of a cube.
const FINEST: u32 = 256;

/// Blocks of test samples for the bootstrap: cubes of space, or single samples if positions are unknown.
///
/// Spectra of neighbouring transmitters are similar, and so are the errors of a model. If this correlation extends
/// beyond a cube, intervals are too narrow; but resampling needs enough cubes. The edge is the largest that leaves 30
/// cubes. Reports print it.
#[derive(Clone, Debug, PartialEq)]
pub struct Blocks {
    /// Edge of a cube in metres; `None` if each test sample is a block.
    pub edge_m: Option<f64>,
    /// Number of blocks that hold test transmitters.
    pub count: usize,
    /// Block of each test sample, by id.
    by_id: BTreeMap<u32, usize>,
}

impl Blocks {
    /// Creates the blocks of test samples from their positions by id, metres. If any position is unknown, each sample
    /// is a block.
    pub fn new(positions: &BTreeMap<u32, Option<[f64; 3]>>) -> Self {
        let complete: Option<_> = positions.iter().map(|(id, position)| Some((*id, (*position)?))).collect();
        let single =
            || Self { edge_m: None, count: positions.len(), by_id: positions.keys().copied().zip(0..).collect() };
        complete.map_or_else(single, |positions| Self::with_cubes(&positions))
    }

    /// Creates cubes with the largest edge that leaves [`WANTED`] cubes, or as many as the finest edge if these are fewer; all
    /// `positions` are known.
    fn with_cubes(positions: &BTreeMap<u32, [f64; 3]>) -> Self {
        let ends = [0, 1, 2].map(|k| bounds(positions.values().map(|position| position[k])));
        let extent = ends.iter().map(|(low, high)| high - low).fold(0.0, f64::max);
        let cube = |position: &[f64; 3], edge: f64| [0, 1, 2].map(|k| ((position[k] - ends[k].0) / edge) as i64);
        let edge = |parts: u32| if extent > 0.0 { extent / f64::from(parts) } else { 1.0 };
        let cubes = |edge: f64| positions.values().map(|position| cube(position, edge)).collect::<BTreeSet<_>>();
        let distinct = cubes(edge(FINEST)).len();
        let parts = (1..FINEST).find(|parts| cubes(edge(*parts)).len() >= WANTED.min(distinct)).unwrap_or(FINEST);
        let edge_m = edge(parts);
        let number: BTreeMap<_, usize> = cubes(edge_m).into_iter().zip(0..).collect();
        let by_id = positions.iter().map(|(id, position)| (*id, number[&cube(position, edge_m)])).collect();
        Self { edge_m: Some(edge_m), count: number.len(), by_id }
    }

    /// Sums the differences of test samples, by id, in each block `[count]`; unknown ids and values that are not finite are
    /// omitted.
    pub fn block_sums(&self, differences: impl IntoIterator<Item = (u32, f64)>) -> Vec<BlockSum> {
        let mut cells = vec![BlockSum::default(); self.count];
        for (id, difference) in differences.into_iter().filter(|(_, difference)| difference.is_finite()) {
            if let Some(block) = self.block_of(id) {
                cells[block].add_difference(difference);
            }
        }
        cells
    }

    /// Returns the index of the block of a test sample; `None` for an unknown id.
    pub fn block_of(&self, id: u32) -> Option<usize> {
        self.by_id.get(&id).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Standard deviations of the components of a difference.
    #[derive(Clone, Copy, Debug, Default)]
    struct Model {
        seed: f64,
        block: f64,
        sample: f64,
    }

    impl Model {
        /// Normal differences about 0, `samples` in each cell.
        fn draw(self, random: &mut Rng, [seeds, blocks, samples]: [usize; 3]) -> Vec<Vec<BlockSum>> {
            let mut normal = |deviation: f64| deviation * f64::from(rng::normal(random));
            let of_block: Vec<f64> = (0..blocks).map(|_| normal(self.block)).collect();
            let of_seed: Vec<f64> = (0..seeds).map(|_| normal(self.seed)).collect();
            let mut cell = |seed: &f64, block: &f64| {
                let mut cell = BlockSum::default();
                (0..samples).for_each(|_| cell.add_difference(seed + block + normal(self.sample)));
                cell
            };
            of_seed.iter().map(|seed| of_block.iter().map(|block| cell(seed, block)).collect()).collect()
        }

        /// Share of intervals that contain the true mean, 0.
        fn coverage(self, shape: [usize; 3]) -> f64 {
            let mut random = rng::stream(7, "coverage", 0);
            let holds = |cells: &[Vec<BlockSum>]| {
                let (low, high) = Difference::with_replicates(cells, 400).unwrap().interval.unwrap();
                low <= 0.0 && 0.0 <= high
            };
            let hits = (0..500).filter(|_| holds(&self.draw(&mut random, shape))).count();
            hits as f64 / 500.0
        }
    }

    fn width(difference: &Difference) -> f64 {
        difference.interval.map(|(low, high)| high - low).unwrap()
    }

    #[test]
    fn spread_is_sample_standard_deviation() {
        let s = Spread::of(&[1.0, 2.0, 3.0, 6.0]).unwrap();
        assert_eq!((s.mean, s.n), (3.0, 4));
        assert!((s.deviation.unwrap() - (14.0f64 / 3.0).sqrt()).abs() < 1e-15);
        assert_eq!(Spread::of(&[0.1; 3]), Some(Spread { mean: 0.1, deviation: Some(0.0), n: 3 }));
        assert_eq!(Spread::of(&[0.1]), Some(Spread { mean: 0.1, deviation: None, n: 1 }));
        assert_eq!(Spread::of(&[]), None);
        let perfect = Spread::of(&[f64::INFINITY, f64::INFINITY]).unwrap();
        assert_eq!((perfect.mean, perfect.deviation), (f64::INFINITY, None));
    }

    #[test]
    fn interval_of_one_seed_matches_normal_theory() {
        let n = 400;
        let cells = Model { sample: 0.3, ..Model::default() }.draw(&mut rng::stream(1, "test", 0), [1, n, 1]);
        let values: Vec<f64> = cells[0].iter().map(|c| c.sum).collect();
        let s = Spread::of(&values).unwrap();
        let difference = Difference::of(&cells).unwrap();
        assert!((difference.mean - s.mean).abs() < 1e-12);
        let expected = 2.0 * 1.96 * s.deviation.unwrap() / (n as f64).sqrt();
        assert!((width(&difference) / expected - 1.0).abs() < 0.03, "{} against {expected}", width(&difference));
        let (low, high) = difference.interval.unwrap();
        assert!((f64::midpoint(low, high) - s.mean).abs() < 0.03 * expected);
    }

    #[test]
    fn seed_variation_widens_interval_as_mean_of_seeds() {
        let model = Model { seed: 1.0, sample: 0.01, ..Model::default() };
        let cells = model.draw(&mut rng::stream(2, "test", 0), [60, 40, 1]);
        let means: Vec<f64> = cells.iter().map(|c| c.iter().map(|c| c.sum).sum::<f64>() / 40.0).collect();
        let expected = 2.0 * 1.96 * Spread::of(&means).unwrap().deviation.unwrap() / 60f64.sqrt();
        let measured = width(&Difference::of(&cells).unwrap());
        assert!((measured / expected - 1.0).abs() < 0.03, "{measured} against {expected}");
    }

    #[test]
    fn bootstrap_interval_has_expected_coverage() {
        let cases = [
            // One seed; samples in a block are independent or strongly correlated.
            (Model { sample: 1.0, ..Model::default() }, [1, 40, 1], 0.92..0.97),
            (Model { block: 1.0, sample: 0.5, ..Model::default() }, [1, 40, 8], 0.92..0.97),
            // Crossed: the same blocks for all seeds.
            (Model { seed: 0.2, block: 1.0, sample: 0.5 }, [10, 40, 4], 0.92..0.98),
            // Three seeds with a dominant seed variance: the interval is too narrow, and the report notes it.
            (Model { seed: 1.0, block: 0.5, sample: 0.5 }, [3, 40, 4], 0.60..0.90),
        ];
        for (model, shape, expected) in cases {
            let coverage = model.coverage(shape);
            println!("seeds, blocks, samples {shape:?}, {model:?}: {coverage}");
            assert!(expected.contains(&coverage), "{shape:?}: {coverage}");
        }
    }

    #[test]
    fn sample_bootstrap_underestimates_interval_of_correlated_spectra() {
        let model = Model { block: 1.0, sample: 0.5, ..Model::default() };
        let cells = model.draw(&mut rng::stream(3, "test", 0), [1, 40, 8]);
        // The same eight differences per block, as if each were a separate block.
        let each = |c: &BlockSum| vec![BlockSum { sum: c.sum / 8.0, count: 1 }; 8];
        let single: Vec<Vec<BlockSum>> = cells.iter().map(|seed| seed.iter().flat_map(each).collect()).collect();
        let [with, without] = [&cells, &single].map(|c| width(&Difference::of(c).unwrap()));
        assert!(without < 0.5 * with, "{without} against {with}");
    }

    #[test]
    fn bootstrap_is_bit_identical_for_equal_input() {
        let cells = Model { seed: 1.0, block: 1.0, sample: 1.0 }.draw(&mut rng::stream(4, "test", 0), [3, 9, 2]);
        assert_eq!(Difference::of(&cells), Difference::of(&cells));
    }

    #[test]
    fn too_few_samples_give_no_interval() {
        assert_eq!(Difference::of(&[]), None);
        assert_eq!(Difference::of(&[vec![BlockSum::default(); 3]]), None);
        let one = |sum| BlockSum { sum, count: 1 };
        let difference =
            Difference::of(&[vec![BlockSum::default(), one(0.5)], vec![BlockSum::default(), one(0.7)]]).unwrap();
        assert_eq!((difference.mean, difference.interval, difference.seeds), (0.6, None, 2));
        assert!(!difference.is_clear());
        // Blocks with data of only one seed: the other seed is skipped there.
        let difference =
            Difference::of(&[vec![one(1.0), BlockSum::default()], vec![BlockSum::default(), one(3.0)]]).unwrap();
        assert_eq!((difference.mean, difference.interval, difference.is_clear()), (2.0, Some((1.0, 3.0)), true));
    }

    #[test]
    fn quantiles_match_numpy() {
        let s = Summary::of(&[4.0, 1.0, 2.0, 3.0], true);
        assert_eq!((s.mean, s.median), (2.5, 2.5));
        assert!((s.tail10 - 1.3).abs() < 1e-12);
        assert!((Summary::of(&[4.0, 1.0, 2.0, 3.0], false).tail10 - 3.7).abs() < 1e-12, "the tail is at the other end");
        assert!(Summary::of(&[], true).mean.is_nan());
    }

    #[test]
    fn neighbouring_positions_share_cube() {
        // 10 x 10 places, 1 m apart, in clumps of two that are 1 cm apart.
        let places =
            (0..200u32).map(|id| (id, Some([f64::from(id / 2 % 10), f64::from(id / 20), 0.01 * f64::from(id % 2)])));
        let blocks = Blocks::new(&places.collect());
        assert!((0..100).all(|k| blocks.block_of(2 * k) == blocks.block_of(2 * k + 1)));
        assert!((30..=50).contains(&blocks.count), "{}", blocks.count);
        assert!((1.0..2.0).contains(&blocks.edge_m.unwrap()), "{:?}", blocks.edge_m);
        assert_eq!(
            (blocks.block_of(0), blocks.block_of(199), blocks.block_of(200)),
            (Some(0), Some(blocks.count - 1), None)
        );
    }

    #[test]
    fn few_positions_get_one_cube_each() {
        let positions = BTreeMap::from([(1, [0.0; 3]), (5, [0.1, 0.0, 0.0]), (9, [3.0, 0.0, 1.0])]);
        let positions = positions.into_iter().map(|(id, position)| (id, Some(position))).collect();
        let blocks = Blocks::new(&positions);
        assert_eq!(BTreeSet::from([1, 5, 9].map(|id| blocks.block_of(id).unwrap())).len(), 3);
        assert_eq!(Blocks::new(&BTreeMap::from([1, 2].map(|id| (id, Some([2.0; 3]))))).count, 1);
        assert_eq!(Blocks::new(&BTreeMap::new()).count, 0);
    }

    #[test]
    fn samples_without_positions_are_single_blocks() {
        let positions = (0..1_000).map(|id| (id, if id < 2 { Some([0.0; 3]) } else { None })).collect();
        let blocks = Blocks::new(&positions);
        assert_eq!((blocks.edge_m, blocks.count), (None, 1_000));
        assert_eq!((0..1_000).map(|id| blocks.block_of(id).unwrap()).collect::<BTreeSet<_>>().len(), 1_000);
    }
}
