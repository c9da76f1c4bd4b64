//! Blocks of space that are held out together: cubes that follow the spacing of positions and the size of the site.

use crate::neighbours::nearest_others;
use crate::statistics;
use std::collections::BTreeMap;

/// Edge of blocks in units of the spacing, and in parts of the longest side of the site: the larger one applies. Smaller
/// blocks leave a training position next to almost every held-out one, so they test repetition.
const SPACINGS: f64 = 3.0;
const SITE_PARTS: f64 = 20.0;

/// Spacing and size of a set of positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SiteSize {
    /// Median distance from a position to the nearest other one, metres; 1 for fewer than two different positions.
    pub spacing: f64,
    /// Longest side of the box of all positions, metres.
    pub longest: f64,
}

impl SiteSize {
    /// Measures `positions`, metres, which may repeat. Positions that are not finite are ignored.
    pub fn new(positions: impl IntoIterator<Item = [f64; 3]>) -> Self {
        let mut positions: Vec<[f64; 3]> =
            positions.into_iter().filter(|position| position.iter().all(|v| v.is_finite())).collect();
        positions
            .sort_unstable_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])).then(a[2].total_cmp(&b[2])));
        positions.dedup();
        if positions.is_empty() {
            return Self { spacing: 1.0, longest: 0.0 };
        }
        let side = |k: usize| {
            let (low, high) = statistics::bounds(positions.iter().map(|position| position[k]));
            high - low
        };
        let spacing =
            statistics::median(nearest_others(&positions).into_iter().flatten().map(|(distance, _)| distance));
        Self { spacing: if spacing.is_finite() { spacing } else { 1.0 }, longest: (0..3).map(side).fold(0.0, f64::max) }
    }

    /// Returns the edge of blocks that are held out together, metres.
    pub fn block_edge(&self) -> f64 {
        (SPACINGS * self.spacing).max(self.longest / SITE_PARTS)
    }
}

/// Returns the block that holds a position, metres: the indices of a cube of `edge` metres.
pub fn block_of(position: [f64; 3], edge: f64) -> [i64; 3] {
    position.map(|v| (v / edge).floor() as i64)
}

/// Returns the mean of the values of (block, value), and its standard error. Values of one block may depend on each
/// other, those of different blocks are independent. NaN without values; the error is 0 for a single block.
pub fn block_mean(values: impl IntoIterator<Item = ([i64; 3], f64)>) -> (f64, f64) {
    let mut blocks: BTreeMap<[i64; 3], (f64, f64)> = BTreeMap::new();
    for (block, value) in values {
        let (sum, count) = blocks.entry(block).or_default();
        *sum += value;
        *count += 1.0;
    }
    let (sum, count) = blocks.values().fold((0.0, 0.0), |total, block| (total.0 + block.0, total.1 + block.1));
    let mean = sum / count;
    let squares: f64 = blocks.values().map(|(sum, count)| (sum - mean * count).powi(2)).sum();
    (mean, squares.sqrt() / count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn block_edges_follow_spacing_and_site() {
        let line =
            |count: usize, step: f64| SiteSize::new((0..count).map(move |i| [4e6 + step * (i / 2) as f64, 1.0, 0.0]));
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-6 * b, "{a} instead of {b}");
        near(line(40, 1.0).spacing, 1.0);
        near(line(40, 1.0).block_edge(), 3.0);
        near(line(1_002, 2.0).block_edge(), 50.0);
        for count in [0, 1, 2] {
            assert_eq!(line(count, 1.0), SiteSize { spacing: 1.0, longest: 0.0 });
        }
        assert_eq!(block_of([2.5, -0.1, 0.0], 1.0), [2, -1, 0]);
    }

    #[test]
    fn standard_errors_count_blocks() {
        let values = [(0, 1.0), (0, 1.0), (1, 3.0), (1, 3.0)].map(|(block, value)| ([block, 0, 0], value));
        assert_eq!(block_mean(values), (2.0, 8f64.sqrt() / 4.0));
        assert!(block_mean([]).0.is_nan());
    }
}
