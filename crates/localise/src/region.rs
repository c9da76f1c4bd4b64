//! `Region`: the part of the floor that holds a transmitter with a given probability. It may have several parts.

use pwrfgs_core::statistics::bounds;
use std::collections::BTreeSet;
use std::f64::consts::PI;

/// Largest number of kernels of a density: those of the largest weights.
pub(crate) const KERNELS: usize = 500;
/// Largest number of kernels at which the maximum of a density is sought.
const PEAKS: usize = 100;
/// Length of the longer side of the grid, cells; aligned with the origin, it may have one more.
const CELLS: f64 = 64.0;
/// Share of the weights whose positions are in the grid.
const FRAMED: f64 = 0.999;
/// Margin of the grid around these positions, kernel widths.
const MARGIN: f64 = 6.0;
/// Largest number of steps towards a mode.
const STEPS: usize = 200;
/// Length of the last step towards a mode, kernel widths.
const END: f64 = 1e-3;

/// Density of the transmitter over the floor: a sum of kernels 1/(1 + r²)² around positions. Their tails are heavy, so that
/// a density far from all positions is small but not 0.
#[derive(Clone, Debug)]
pub(crate) struct Density {
    /// Weights, which sum to 1, and positions; largest weight first.
    kernels: Vec<(f64, [f64; 3])>,
    /// Width of the kernels, metres.
    pub(crate) bandwidth: f64,
}

impl Density {
    /// Creates the density with kernels (weight, position), largest weight first, and scales the weights to the sum 1.
    pub(crate) fn new(mut kernels: Vec<(f64, [f64; 3])>, bandwidth: f64) -> Self {
        let sum: f64 = kernels.iter().map(|(w, _)| w).sum();
        kernels.iter_mut().for_each(|(w, _)| *w /= sum);
        Self { kernels, bandwidth }
    }

    /// Returns the weight of each kernel, its closeness 1/(1 + r²) to a point, and its position; r is the horizontal distance in
    /// kernel widths.
    fn kernels_with_closeness(&self, [x, y]: [f64; 2]) -> impl Iterator<Item = (f64, f64, &[f64; 3])> {
        let scale = 1.0 / (self.bandwidth * self.bandwidth);
        self.kernels.iter().map(move |(w, p)| {
            let (dx, dy) = (x - p[0], y - p[1]);
            (*w, 1.0 / (1.0 + scale * (dx * dx + dy * dy)), p)
        })
    }

    /// Returns the density at a point, per square metre.
    pub(crate) fn value_at(&self, point: [f64; 2]) -> f64 {
        let mut sum = 0.0;
        for (w, near, _) in self.kernels_with_closeness(point) {
            sum += w * near * near;
        }
        sum / (PI * self.bandwidth * self.bandwidth)
    }

    /// Returns the mode, by ascent from the densest of the [`PEAKS`] positions with the largest weights; `None` without
    /// kernels.
    fn mode(&self) -> Option<[f64; 2]> {
        let peaks =
            self.kernels.iter().take(PEAKS).map(|(_, p)| [p[0], p[1]]).map(|point| (self.value_at(point), point));
        let (_, peak) = peaks.max_by(|a, b| a.0.total_cmp(&b.0))?;
        Some(self.ascend(peak))
    }

    /// Returns the mode that mean shift finds from a point: every step leads to a weighted mean of the positions, which is
    /// the point itself if the gradient is 0 there.
    fn ascend(&self, mut point: [f64; 2]) -> [f64; 2] {
        for _ in 0..STEPS {
            let next = self.weighted_mean(point, 3);
            let length = (next[0] - point[0]).hypot(next[1] - point[1]);
            point = [next[0], next[1]];
            if length < END * self.bandwidth {
                break;
            }
        }
        point
    }

    /// Returns the mean of the positions, weighted by their weights times this `power` of the closeness to a point: 2, as in
    /// the density, or 3, as in its gradient.
    fn weighted_mean(&self, point: [f64; 2], power: usize) -> [f64; 3] {
        let (mut x, mut y, mut z, mut total) = (0.0, 0.0, 0.0, 0.0);
        for (w, near, p) in self.kernels_with_closeness(point) {
            let weight = (0..power).fold(w, |weight, _| weight * near);
            total += weight;
            x += weight * p[0];
            y += weight * p[1];
            z += weight * p[2];
        }
        [x / total, y / total, z / total]
    }

    /// Returns, per axis, the weighted root mean square distance of the selected positions from `position`, metres; 0
    /// without any.
    pub(crate) fn spread(&self, position: [f64; 3], is_selected: impl Fn(&[f64; 3]) -> bool) -> [f64; 3] {
        let selected = || self.kernels.iter().filter(|(_, p)| is_selected(p));
        let sum: f64 = selected().map(|(w, _)| w).sum();
        let square = |k: usize| selected().map(|(w, p)| w * (p[k] - position[k]).powi(2)).sum::<f64>();
        [0, 1, 2].map(|k| if sum > 0.0 { (square(k) / sum).sqrt() } else { 0.0 })
    }

    /// Returns the grid of the density, around the kernels with a share of [`FRAMED`] of the weights.
    pub(crate) fn grid(&self) -> Grid<'_> {
        let sums_before = self.kernels.iter().scan(0.0, |sum, (w, p)| Some((std::mem::replace(sum, *sum + w), p)));
        let framed: Vec<&[f64; 3]> = sums_before.take_while(|(sum, _)| *sum < FRAMED).map(|(_, p)| p).collect();
        let reach = MARGIN * self.bandwidth;
        let ends = [0, 1].map(|k| bounds(framed.iter().map(|p| p[k])));
        let sides = ends.map(|(low, high)| high - low + 2.0 * reach);
        // Cells need the step, and the highest value needs the cells.
        let mut grid =
            Grid { density: self, step: sides[0].max(sides[1]) / CELLS, low: [0; 2], high: [0; 2], highest: 1.0 };
        grid.low = grid.cell_at(ends.map(|(low, _)| low - reach));
        grid.high = grid.cell_at(ends.map(|(_, high)| high + reach));
        if let Some(mode) = self.mode() {
            let cell = grid.cell_at(mode);
            grid.highest = grid.values(cell, cell)[0];
        }
        grid
    }
}

/// Square cells of the floor with the density at their centres. Regions consist of these cells, in the calibration of the
/// level as in files; the cells do not depend on the level.
pub(crate) struct Grid<'a> {
    density: &'a Density,
    /// Side of a cell, metres.
    step: f64,
    /// First and last cell: numbers of cells from the origin.
    low: [i64; 2],
    high: [i64; 2],
    /// Value in the cell of the highest mode.
    highest: f32,
}

impl Grid<'_> {
    /// Returns the cell that contains a point.
    fn cell_at(&self, point: [f64; 2]) -> [i64; 2] {
        point.map(|v| (v / self.step).floor() as i64)
    }

    /// Returns the density at the centres of the cells from `low` to `high`, row by row, relative to [`Self::highest`]. It sums
    /// one row at a time in 32 bits, for vector instructions; a value does not depend on the other cells.
    fn values(&self, low: [i64; 2], high: [i64; 2]) -> Vec<f32> {
        let (columns, rows) = ((high[0] - low[0] + 1) as usize, (high[1] - low[1] + 1) as usize);
        let (mut x_squares, mut values) = (vec![0.0_f32; columns], vec![0.0_f32; columns * rows]);
        for (w, p) in &self.density.kernels {
            // Squared distance of row or column `k` from the kernel, kernel widths.
            let square = |axis: usize, k: usize| {
                let r = ((low[axis] + k as i64) as f64 + 0.5) * self.step - p[axis];
                (r / self.density.bandwidth).powi(2) as f32
            };
            let weight = *w as f32;
            x_squares.iter_mut().enumerate().for_each(|(k, x)| *x = square(0, k));
            for (k, row) in values.chunks_exact_mut(columns).enumerate() {
                let y = 1.0 + square(1, k);
                for (value, x) in row.iter_mut().zip(&x_squares) {
                    *value += weight / ((x + y) * (x + y));
                }
            }
        }
        values.iter_mut().for_each(|value| *value /= self.highest);
        values
    }

    /// Returns the highest level of a region that holds a point, at most 1; 0 for a point outside of the grid.
    pub(crate) fn level_at(&self, point: [f64; 2]) -> f32 {
        let cell = self.cell_at(point);
        let is_on_grid = (0..2).all(|k| (self.low[k]..=self.high[k]).contains(&cell[k]));
        if is_on_grid { self.values(cell, cell)[0].min(1.0) } else { 0.0 }
    }

    /// Returns the region of the cells with at least `level` of the highest density.
    pub(crate) fn region(&self, level: f32) -> Region {
        let values = self.values(self.low, self.high);
        let (columns, parts) = ((self.high[0] - self.low[0] + 1) as usize, vec![0; values.len()]);
        let mut region = Region { low: self.low, step: self.step, columns, values, level, parts, count: 0 };
        region.number_parts();
        region
    }
}

/// Density over a grid of the floor, and the level of the region.
#[derive(Clone, Debug)]
pub struct Region {
    /// First cell: the number of cells between its lower corner and the origin.
    low: [i64; 2],
    /// Side of a cell, metres.
    pub step: f64,
    /// Number of columns.
    pub columns: usize,
    /// Density relative to the highest, row by row, lowest row first; empty after [`Self::without_values`].
    pub values: Vec<f32>,
    /// Density at the edge, relative to the highest.
    pub level: f32,
    /// Part of every cell, counted from 1; 0 outside.
    parts: Vec<u16>,
    count: u16,
}

impl Region {
    /// Returns the centre of the first cell, metres.
    pub fn first_centre(&self) -> [f64; 2] {
        self.low.map(|k| (k as f64 + 0.5) * self.step)
    }

    /// Returns the number of parts: cells with a common side are in one part.
    pub fn part_count(&self) -> usize {
        self.count as usize
    }

    /// Returns the part of the cell in a column and a row of the grid, counted from 1; 0 outside of the region.
    fn part_of_cell(&self, [column, row]: [i64; 2]) -> u16 {
        let is_on_grid = (0..self.columns as i64).contains(&column) && row >= 0;
        let cell = is_on_grid.then_some((row * self.columns as i64 + column) as usize);
        cell.and_then(|cell| self.parts.get(cell)).copied().unwrap_or(0)
    }

    /// Returns the part at a point, counted from 1; 0 outside of the region.
    pub(crate) fn part_at(&self, point: [f64; 2]) -> u16 {
        self.part_of_cell([0, 1].map(|k| (point[k] / self.step).floor() as i64 - self.low[k]))
    }

    /// Returns whether the region holds a point.
    pub fn holds(&self, point: [f64; 2]) -> bool {
        self.part_at(point) > 0
    }

    /// Numbers the parts by flood fill over the cells with at least the level, from 1 in the order of their first cells.
    fn number_parts(&mut self) {
        let (columns, cells) = (self.columns, self.values.len());
        let is_inside = |k: usize| self.values[k] >= self.level;
        for start in 0..cells {
            if !is_inside(start) || self.parts[start] > 0 {
                continue;
            }
            self.count += 1;
            self.parts[start] = self.count;
            let mut stack = vec![start];
            while let Some(k) = stack.pop() {
                let column = k % columns;
                let sides = [
                    (column > 0).then(|| k - 1),
                    (column + 1 < columns).then_some(k + 1),
                    k.checked_sub(columns),
                    (k + columns < cells).then_some(k + columns),
                ];
                for side in sides.into_iter().flatten() {
                    if self.parts[side] == 0 && is_inside(side) {
                        self.parts[side] = self.count;
                        stack.push(side);
                    }
                }
            }
        }
    }

    /// Returns the part with the largest probability; 0 without parts.
    fn most_probable_part(&self) -> u16 {
        let mut sums = vec![0.0; self.part_count() + 1];
        self.parts.iter().zip(&self.values).for_each(|(part, value)| sums[*part as usize] += f64::from(*value));
        (1..=self.count).max_by(|a, b| sums[*a as usize].total_cmp(&sums[*b as usize])).unwrap_or(0)
    }

    /// Returns the most probable part and its mode, metres, at the mean height of the positions around. The mode is that of
    /// the kernels in the part, with width `bandwidth` and weights to the power of `sharpness`. If it is outside of the
    /// part, it is the mode for the width and the weights of `density`; if this is outside too, the centre of the cell
    /// with the highest density in the part.
    pub(crate) fn most_probable_mode(&self, density: &Density, bandwidth: f64, sharpness: f64) -> (u16, [f64; 3]) {
        let part = self.most_probable_part();
        let is_in_part = |point: [f64; 2]| self.part_at(point) == part;
        let inner_kernels = || density.kernels.iter().filter(|(_, [x, y, _])| is_in_part([*x, *y]));
        let largest = inner_kernels().next().map_or(1.0, |(w, _)| *w); // kernels descend by weight
        let sharper = inner_kernels().map(|(w, p)| ((w / largest).powf(sharpness), *p)).collect();
        let is_mode_inside = |mode: &[f64; 2]| is_in_part(*mode);
        let unsharpened_mode = || {
            let kernels = inner_kernels().copied().collect();
            Density { kernels, bandwidth: density.bandwidth }.mode().filter(is_mode_inside)
        };
        let mode = Density { kernels: sharper, bandwidth }.mode().filter(is_mode_inside).or_else(unsharpened_mode);
        let [x, y] = mode.unwrap_or_else(|| self.highest_centre(part));
        (part, [x, y, density.weighted_mean([x, y], 2)[2]])
    }

    /// Returns the centre of the cell of the highest density in `part`, metres; of the first cell if it has none.
    fn highest_centre(&self, part: u16) -> [f64; 2] {
        let cells = (0..self.values.len()).filter(|k| self.parts[*k] == part);
        let highest = cells.max_by(|a, b| self.values[*a].total_cmp(&self.values[*b])).unwrap_or(0);
        let ([x, y], (row, column)) = (self.first_centre(), (highest / self.columns, highest % self.columns));
        [x + column as f64 * self.step, y + row as f64 * self.step]
    }

    /// Returns the region without the density, which only an image needs.
    #[must_use]
    pub fn without_values(mut self) -> Self {
        self.values = Vec::new();
        self
    }

    /// Returns the area of all parts, square metres.
    pub fn area(&self) -> f64 {
        let inside = self.parts.iter().filter(|part| **part > 0).count();
        inside as f64 * self.step * self.step
    }

    /// Returns the closed outlines, metres, without a repeated first corner: counter-clockwise around parts, clockwise
    /// around holes.
    pub fn outlines(&self) -> Vec<Vec<[f64; 2]>> {
        let (columns, rows) = (self.columns as i64, (self.parts.len() / self.columns.max(1)) as i64);
        // Edges of cells with the inside on their left, from corner to corner.
        let mut edges: BTreeSet<[[i64; 2]; 2]> = BTreeSet::new();
        let cells =
            (0..rows).flat_map(|y| (0..columns).map(move |x| [x, y])).filter(|cell| self.part_of_cell(*cell) > 0);
        for [x, y] in cells {
            let sides = [
                ([0, -1], [x, y], [x + 1, y]),
                ([1, 0], [x + 1, y], [x + 1, y + 1]),
                ([0, 1], [x + 1, y + 1], [x, y + 1]),
                ([-1, 0], [x, y + 1], [x, y]),
            ];
            let is_edge = |[dx, dy]: [i64; 2]| self.part_of_cell([x + dx, y + dy]) == 0;
            edges.extend(sides.into_iter().filter(|(outside, ..)| is_edge(*outside)).map(|(_, from, to)| [from, to]));
        }
        let mut outlines = Vec::new();
        while let Some(&[start, mut next]) = edges.first() {
            let (mut corners, mut at) = (vec![start], start);
            while edges.remove(&[at, next]) && next != start {
                corners.push(next);
                let [dx, dy] = [0, 1].map(|k| next[k] - at[k]);
                at = next;
                // To the left first, around the same cell: parts that touch at a corner have separate outlines.
                let ends = [[-dy, dx], [dx, dy], [dy, -dx]].map(|[x, y]| [at[0] + x, at[1] + y]);
                next = ends.into_iter().find(|end| edges.contains(&[at, *end])).unwrap_or(start);
            }
            outlines.push(self.turning_corners(&corners));
        }
        outlines
    }

    /// Returns the `corners` at which a closed outline turns, converted to metres.
    fn turning_corners(&self, corners: &[[i64; 2]]) -> Vec<[f64; 2]> {
        let n = corners.len();
        let turns = |i: &usize| {
            let [a, b, c] = [corners[(i + n - 1) % n], corners[*i], corners[(i + 1) % n]];
            (b[0] - a[0]) * (c[1] - b[1]) != (b[1] - a[1]) * (c[0] - b[0])
        };
        let metres = |i: usize| [0, 1].map(|k| (self.low[k] + corners[i][k]) as f64 * self.step);
        (0..n).filter(turns).map(metres).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a region of cells of 1 m whose rows, lowest first, have a `#` inside.
    fn region(rows: &[&str]) -> Region {
        let values: Vec<f32> = rows.concat().bytes().map(|b| f32::from(u8::from(b == b'#'))).collect();
        let (columns, parts) = (rows[0].len(), vec![0; values.len()]);
        let mut region = Region { low: [0, 0], step: 1.0, columns, values, level: 0.5, parts, count: 0 };
        region.number_parts();
        region
    }

    #[test]
    fn outlines_enclose_parts_and_holes() {
        let area = |outline: &Vec<[f64; 2]>| {
            let n = outline.len();
            let cross = |i: usize| {
                let [a, b] = [outline[i], outline[(i + 1) % n]];
                a[0] * b[1] - a[1] * b[0]
            };
            (0..n).map(cross).sum::<f64>() / 2.0
        };
        for (rows, parts, areas) in [
            (&["###.", "#.#.", "###."][..], 1, &[-1.0, 9.0][..]),
            (&["#..#", ".##.", "#..."][..], 4, &[1.0, 1.0, 1.0, 2.0][..]),
            (&["####", "#.##", "##.#", "####"][..], 1, &[-2.0, 16.0][..]),
        ] {
            let region = region(rows);
            let mut signed_areas: Vec<f64> = region.outlines().iter().map(area).collect();
            signed_areas.sort_by(f64::total_cmp);
            assert_eq!((region.part_count(), &signed_areas[..]), (parts, areas), "{rows:?}");
            assert_eq!(region.area(), areas.iter().sum::<f64>());
        }
        assert!(region(&["###", "#.#", "###"]).outlines().iter().all(|outline| outline.len() == 4));
    }

    #[test]
    fn density_is_that_of_its_kernels_and_sums_to_one() {
        let density = Density::new(vec![(0.5, [0.0, 0.0, 1.0]), (0.5, [3.0, 0.0, 2.0])], 0.5);
        let step = 0.05;
        let grid = (-400..400).flat_map(|y| (-400..400).map(move |x| [f64::from(x) * step, f64::from(y) * step]));
        let sum = grid.map(|point| density.value_at(point)).sum::<f64>() * step * step;
        assert!((sum - 1.0).abs() < 0.01, "{sum}");
        let region = density.grid().region(0.5);
        assert_eq!((region.outlines().len(), region.part_count()), (2, 2), "two distant positions have two parts");
    }

    #[test]
    fn estimate_is_the_mode_of_the_most_probable_part() {
        // The highest mode has one position; three others close together are more probable.
        let positions = [[0.0, 0.0, 1.0], [6.0, 0.0, 2.0], [6.9, 0.0, 2.0], [7.8, 0.0, 2.0]];
        let density = Density::new([0.34, 0.22, 0.22, 0.22].into_iter().zip(positions).collect(), 0.4);
        let region = density.grid().region(0.1);
        let (_, [x, y, z]) = region.most_probable_mode(&density, 0.4, 1.0);
        assert_eq!(region.part_count(), 2);
        assert!((x - 6.9).abs() < 0.1 && y.abs() < 1e-6 && z > 1.9, "{x} {y} {z}");
        assert!(region.holds([x, y]) && region.part_at([x, y]) != region.part_at([0.0, 0.0]));
    }

    #[test]
    fn region_of_a_level_holds_the_point_of_this_level() {
        let positions: Vec<[f64; 3]> = (0..60).map(|k| [f64::from(k * 7 % 20), f64::from(k * 11 % 13), 0.0]).collect();
        let weights: Vec<f64> = (0..60).map(|k| 0.9_f64.powi(k)).collect();
        for bandwidth in [0.2, 1.0, 5.0] {
            let density = Density::new(weights.iter().copied().zip(positions.iter().copied()).collect(), bandwidth);
            let grid = density.grid();
            for k in 0..200 {
                let point = [f64::from(k * 37 % 101) * 0.31 - 5.0, f64::from(k * 53 % 103) * 0.2 - 4.0];
                let level = grid.level_at(point);
                if level > 0.0 {
                    assert!(grid.region(level).holds(point), "{point:?} {level}");
                    assert!(level == 1.0 || !grid.region(level * 1.000_001).holds(point), "{point:?} {level}");
                }
            }
        }
    }
}
