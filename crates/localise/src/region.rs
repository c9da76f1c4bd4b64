//! `Region`: the part of the floor that holds a transmitter with a given probability. It may have several parts.

use pwrfgs_core::statistics::bounds;
use std::collections::BTreeMap;

/// Largest number of kernels of a density, those of the largest weights; and of kernels at which its maximum is sought.
const KERNELS: usize = 500;
const PEAKS: usize = 100;
/// Number of cells along the longer side of the grid.
const CELLS: f64 = 64.0;

/// How regions follow from weights; chosen on validation samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegionRule {
    /// Sharpness of the weights.
    pub sharpness: f64,
    /// Width of the kernel around every position, metres.
    pub bandwidth: f64,
    /// Density at the edge of a region, relative to the highest.
    pub share: f64,
}

/// Density of the transmitter over the floor: a sum of kernels 1/(1 + r²)² around positions. Their tails are heavy, so that
/// a density far from all positions is small but not 0.
#[derive(Clone, Debug)]
pub(crate) struct Density {
    /// Weights, which sum to 1, and positions; largest weight first.
    kernels: Vec<(f64, [f64; 2])>,
    bandwidth: f64,
}

impl Density {
    pub(crate) fn new(weights: &[f64], positions: &[[f64; 3]], bandwidth: f64) -> Self {
        let mut order: Vec<usize> = (0..weights.len()).collect();
        order.sort_by(|a, b| weights[*b].total_cmp(&weights[*a]));
        order.truncate(KERNELS);
        let sum: f64 = order.iter().map(|k| weights[*k]).sum();
        let kernel = |k: &usize| (weights[*k] / sum, [positions[*k][0], positions[*k][1]]);
        Self { kernels: order.iter().map(kernel).collect(), bandwidth }
    }

    /// Returns the density at a point, per square metre.
    pub(crate) fn at(&self, point: [f64; 2]) -> f64 {
        let kernel = |(w, p): &(f64, [f64; 2])| {
            let r = [0, 1].map(|k| (point[k] - p[k]) / self.bandwidth);
            w / (1.0 + r[0] * r[0] + r[1] * r[1]).powi(2)
        };
        self.kernels.iter().map(kernel).sum::<f64>() / (std::f64::consts::PI * self.bandwidth * self.bandwidth)
    }

    /// Returns the highest density at the positions of the largest weights.
    pub(crate) fn highest(&self) -> f64 {
        self.kernels.iter().take(PEAKS).map(|(_, p)| self.at(*p)).fold(0.0, f64::max)
    }

    /// Returns the region with at least `share` of the highest density.
    pub(crate) fn region(&self, share: f64) -> Region {
        let reach = self.bandwidth * (1.0 / share.clamp(1e-6, 1.0).sqrt() - 1.0).sqrt() + self.bandwidth;
        let largest = self.kernels.first().map_or(0.0, |(w, _)| *w);
        let framed = || self.kernels.iter().filter(|(w, _)| *w >= 1e-3 * share * largest);
        let [x, y] = [0, 1].map(|k| bounds(framed().map(|(_, p)| p[k])));
        let (low, high) = ([x.0 - reach, y.0 - reach], [x.1 + reach, y.1 + reach]);
        let step = (high[0] - low[0]).max(high[1] - low[1]) / CELLS;
        let [columns, rows] = [0, 1].map(|k| (((high[k] - low[k]) / step).ceil() as usize).max(1));
        let first = low.map(|v| v + step / 2.0);
        let highest = self.highest();
        let at = |k: usize| [first[0] + (k % columns) as f64 * step, first[1] + (k / columns) as f64 * step];
        let values = (0..rows * columns).map(|k| (self.at(at(k)) / highest) as f32).collect();
        Region { first, step, columns, values, share }
    }
}

/// Density over a grid of the floor, and the level of the region.
#[derive(Clone, Debug)]
pub struct Region {
    /// Centre of the first cell, metres.
    pub first: [f64; 2],
    /// Side of a cell, metres.
    pub step: f64,
    /// Number of columns.
    pub columns: usize,
    /// Density relative to the highest, row by row, lowest row first.
    pub values: Vec<f32>,
    /// Density at the edge, relative to the highest.
    pub share: f64,
}

impl Region {
    fn is_inside(&self, column: i64, row: i64) -> bool {
        let columns = self.columns as i64;
        let is_on_grid = (0..columns).contains(&column) && row >= 0;
        is_on_grid && self.values.get((row * columns + column) as usize).is_some_and(|v| f64::from(*v) >= self.share)
    }

    /// Returns the area, square metres.
    pub fn area(&self) -> f64 {
        let inside = self.values.iter().filter(|v| f64::from(**v) >= self.share).count();
        inside as f64 * self.step * self.step
    }

    /// Returns the closed outlines, metres: counter-clockwise around parts, clockwise around holes.
    pub fn outlines(&self) -> Vec<Vec<[f64; 2]>> {
        let (columns, rows) = (self.columns as i64, (self.values.len() / self.columns.max(1)) as i64);
        // Edges of cells with the inside on their left, from corner to corner.
        let mut edges: BTreeMap<[i64; 2], Vec<[i64; 2]>> = BTreeMap::new();
        for (x, y) in (0..rows).flat_map(|y| (0..columns).map(move |x| (x, y))).filter(|(x, y)| self.is_inside(*x, *y))
        {
            let sides = [
                ([0, -1], [x, y], [x + 1, y]),
                ([1, 0], [x + 1, y], [x + 1, y + 1]),
                ([0, 1], [x + 1, y + 1], [x, y + 1]),
                ([-1, 0], [x, y + 1], [x, y]),
            ];
            for (outside, from, to) in sides {
                if !self.is_inside(x + outside[0], y + outside[1]) {
                    edges.entry(from).or_default().push(to);
                }
            }
        }
        let mut outlines = Vec::new();
        while let Some(&start) = edges.keys().next() {
            let (mut corners, mut at) = (vec![start], start);
            while let Some(next) = edges.get_mut(&at).and_then(Vec::pop) {
                if edges[&at].is_empty() {
                    edges.remove(&at);
                }
                if next == start {
                    break;
                }
                corners.push(next);
                at = next;
            }
            outlines.push(self.straight(&corners));
        }
        outlines
    }

    /// Returns the corners at which a closed outline turns, metres.
    fn straight(&self, corners: &[[i64; 2]]) -> Vec<[f64; 2]> {
        let n = corners.len();
        let turns = |i: &usize| {
            let [a, b, c] = [corners[(i + n - 1) % n], corners[*i], corners[(i + 1) % n]];
            (b[0] - a[0]) * (c[1] - b[1]) != (b[1] - a[1]) * (c[0] - b[0])
        };
        let metres = |i: usize| [0, 1].map(|k| self.first[k] + (corners[i][k] as f64 - 0.5) * self.step);
        (0..n).filter(turns).map(metres).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring() -> Region {
        let mut values = vec![1.0; 9];
        values[4] = 0.0;
        values.extend([0.0, 0.0, 0.0]);
        Region { first: [0.5, 0.5], step: 1.0, columns: 3, values, share: 0.5 }
    }

    #[test]
    fn outlines_enclose_parts_and_holes() {
        let area = |outline: &[[f64; 2]]| {
            let n = outline.len();
            let cross = |i: usize| {
                let [a, b] = [outline[i], outline[(i + 1) % n]];
                a[0] * b[1] - a[1] * b[0]
            };
            (0..n).map(cross).sum::<f64>() / 2.0
        };
        let outlines = ring().outlines();
        let mut areas: Vec<f64> = outlines.iter().map(|outline| area(outline)).collect();
        areas.sort_by(f64::total_cmp);
        assert_eq!(areas, [-1.0, 9.0]);
        assert!(outlines.iter().all(|outline| outline.len() == 4));
        assert_eq!(ring().area(), 8.0);
    }

    #[test]
    fn density_is_that_of_its_kernels_and_sums_to_one() {
        let density = Density::new(&[0.5, 0.5], &[[0.0, 0.0, 1.0], [3.0, 0.0, 2.0]], 0.5);
        let step = 0.05;
        let grid = (-400..400).flat_map(|y| (-400..400).map(move |x| [f64::from(x) * step, f64::from(y) * step]));
        let sum = grid.map(|point| density.at(point)).sum::<f64>() * step * step;
        assert!((sum - 1.0).abs() < 0.01, "{sum}");
        let region = density.region(0.5);
        assert_eq!(region.outlines().len(), 2, "two distant positions have two parts");
    }
}
