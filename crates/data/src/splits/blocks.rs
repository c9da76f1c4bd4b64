//! `TimeBlock` and `Voxel`: hold out a block of the trajectory or whole cells of space.

use super::{DEFAULT_VALIDATION, check_test_share, check_validation_share, partition_of_locations, share_count};
use pwrfgs_core::rng::{self, Rng};
use pwrfgs_core::{
    Dataset, Demand, Error, JsonSchema, Location, Misfit, Partition, Parts, Requirement, Result, Split,
    check_compatible,
};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Largest number of blocks of a trajectory: enough for prediction intervals of levels up to 97 %.
const MOST_BLOCKS: usize = 40;

/// Split by time: the test set is a contiguous block of the sorted transmitter ids, with all links of each.
///
/// Ids follow the trajectory, so this holds out a part of it: most test samples are centimetres from training samples,
/// not millimetres. Validation is also a block: the ids after the test block, then, if these do not suffice, the ids
/// before it.
///
/// Consecutive ids at the ends of the block are still neighbours. `gap` removes the samples on both sides of the block
/// from all sets. `docs/lab/ceiling.md` shows the effect of a gap on measured spectra; `samples.csv` lists every distance.
///
/// ```
/// # use pwrfgs_core::{Plugin, Split};
/// # use pwrfgs_data as _;
/// assert!(Plugin::<dyn Split>::parse("TimeBlock(start: 0.4, length: 0.2, gap: 30)").is_ok());
/// assert!(Plugin::<dyn Split>::parse("TimeBlock(start: 0.9, length: 0.2)").is_err());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TimeBlock {
    /// Start of the test block, as a fraction of the sorted ids in [0, 1).
    pub start: f64,
    /// Length of the test block, as a fraction of the sorted ids in (0, 1).
    pub length: f64,
    /// Number of samples removed on either side of the test block.
    pub gap: usize,
    /// Share of the remaining samples held out next to the test block, in [0, 1); 0 for none.
    pub validation: f64,
}

impl Default for TimeBlock {
    fn default() -> Self {
        Self { start: 0.4, length: 0.2, gap: 0, validation: DEFAULT_VALIDATION }
    }
}

#[typetag::serde]
impl Split for TimeBlock {
    /// Holds out a block of the locations, which are in the order of their ids.
    fn split(&self, data: &Dataset, _: &mut Rng) -> Result<Partition> {
        let count = data.locations.len();
        let length = share_count(self.length, count);
        let first = ((self.start * count as f64).round() as usize).min(count - length);
        let test = first..first + length;
        // Ids before the block and after it, without the gaps.
        let (low, high) = (first.saturating_sub(self.gap), test.end.saturating_add(self.gap).min(count));
        let held_out = share_count(self.validation, low + count - high);
        let after = held_out.min(count - high);
        let before = held_out - after;
        let train = (0..low - before).chain(high + after..count).collect();
        let validation = (low - before..low).chain(high..high + after).collect();
        partition_of_locations(data, Partition { train, validation, test: test.collect() })
    }

    /// Returns contiguous blocks of the trajectory, at most `MOST_BLOCKS`.
    fn blocks(&self, data: &Dataset, links: &[usize]) -> Vec<Vec<usize>> {
        let units = self.units(data, links);
        units.chunks(units.len().div_ceil(MOST_BLOCKS).max(1)).map(<[_]>::concat).collect()
    }

    fn is_in_order(&self) -> bool {
        true
    }

    fn check(&self) -> Result<(), String> {
        if !(0.0..1.0).contains(&self.start) {
            return Err(format!(
                "`start` is {}; it is a fraction of the sorted ids: use a number from 0 to below 1",
                self.start
            ));
        }
        check_test_share("length", self.length)?;
        // The sum of decimals such as 0.7 and 0.3 may be rounded up.
        if self.start + self.length > 1.0 + 1e-9 {
            let end = self.start + self.length;
            return Err(format!(
                "`start` + `length` is {end}; the block must end at 1 at the latest: lower one of them"
            ));
        }
        check_validation_share(self.validation)
    }
}

/// Split by space: whole cubic cells are drawn at random until the test share is reached. All links of a transmitter
/// are in one set. Data without transmitter positions are an error.
///
/// No test sample has a training sample in its own cell, so the test measures prediction at unmeasured positions. Cells
/// lie on a grid through the world origin; a sample on a wall belongs to the cell above. Cells are computed in decimal
/// arithmetic from coordinates and `size_m` as written, since 1.4/0.2 is less than 7 in floating point: use decimal
/// arithmetic to reproduce a split. The last cell drawn may exceed the share; one cell always remains for training.
/// Validation cells are drawn in the same way from the remaining cells.
///
/// ```
/// # use pwrfgs_core::{Plugin, Split};
/// # use pwrfgs_data as _;
/// assert!(Plugin::<dyn Split>::parse("Voxel(size_m: 0.2, test: 0.2)").is_ok());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Voxel {
    /// Edge of a cell, metres, above 0.
    pub size_m: f64,
    /// Share of all samples in the test set, in (0, 1).
    pub test: f64,
    /// Share of the remaining samples held out as whole cells, in [0, 1); 0 for none.
    pub validation: f64,
}

impl Default for Voxel {
    fn default() -> Self {
        Self { size_m: 0.2, test: 0.2, validation: DEFAULT_VALIDATION }
    }
}

impl Voxel {
    /// Returns the indices of the grid cell of a position in metres.
    pub(super) fn cell(&self, position: [f64; 3]) -> [i128; 3] {
        position.map(|v| floor_of_ratio(v, self.size_m))
    }

    /// Groups indices by the cells of their positions, in the order of the cells.
    fn group_by_cell(&self, positions: impl Iterator<Item = (usize, [f64; 3])>) -> Vec<Vec<usize>> {
        let mut cells: BTreeMap<[i128; 3], Vec<usize>> = BTreeMap::new();
        positions.for_each(|(i, position)| cells.entry(self.cell(position)).or_default().push(i));
        cells.into_values().collect()
    }
}

/// Returns ⌊v/size⌋, exact for the shortest decimals of both; `size` is above 0. Results out of range saturate.
fn floor_of_ratio(v: f64, size: f64) -> i128 {
    let ((v, v_exponent), (size, exponent)) = (decimal_digits(v), decimal_digits(size));
    let shifted = |digits: i128, by: i32| 10_i128.checked_pow(by.max(0) as u32)?.checked_mul(digits);
    match (shifted(v, v_exponent - exponent), shifted(size, exponent - v_exponent)) {
        (Some(v), Some(size)) => v.div_euclid(size),
        (None, _) => v.signum() * i128::MAX,
        (_, None) => -i128::from(v < 0),
    }
}

/// Returns digits and exponent of a finite number, digits · 10^exponent, from its shortest decimal.
fn decimal_digits(v: f64) -> (i128, i32) {
    let text = format!("{v:e}");
    let (digits, exponent) = text.split_once('e').expect("the form is 1.5e-3");
    let decimals = digits.split_once('.').map_or(0, |(_, decimals)| decimals.len() as i32);
    let number = |text: &str| text.parse::<i128>().expect("17 digits at most");
    (number(&digits.replace('.', "")), number(exponent) as i32 - decimals)
}

#[typetag::serde]
impl Split for Voxel {
    /// Draws cells of locations for the test set, then for validation.
    fn split(&self, data: &Dataset, rng: &mut Rng) -> Result<Partition> {
        let demands = &[Demand::of("split", "Voxel", &[Requirement::Positions])];
        check_compatible(&Parts { data: Some(data), demands, ..Parts::default() }).map_err(Misfit::error)?;
        let mut cells = self.group_by_cell(data.locations.iter().map(Location::position).enumerate());
        let count = data.locations.len();
        if cells.len() < 2 {
            let size = self.size_m;
            let problem = format!("all {count} samples lie in one cell of {size} m; lower `size_m` of Voxel");
            return Err(Error::Config(problem));
        }
        rng::shuffle(rng, &mut cells);
        let test = draw_cells(&mut cells, share_count(self.test, count));
        let validation = draw_cells(&mut cells, share_count(self.validation, count - test.len()));
        partition_of_locations(data, Partition { train: cells.concat(), validation, test })
    }

    /// Returns the links of each cell that has some.
    fn units(&self, data: &Dataset, links: &[usize]) -> Vec<Vec<usize>> {
        self.group_by_cell(links.iter().map(|&i| (i, data.sample(i).position())))
    }

    fn check(&self) -> Result<(), String> {
        if !(self.size_m.is_finite() && self.size_m > 0.0) {
            return Err(format!("`size_m` is {}; use an edge in metres above 0, such as 0.2", self.size_m));
        }
        check_test_share("test", self.test)?;
        check_validation_share(self.validation)
    }
}

/// Removes the last cells until they hold `target` samples, and returns their samples; one cell remains.
fn draw_cells(cells: &mut Vec<Vec<usize>>, target: usize) -> Vec<usize> {
    let mut drawn = Vec::new();
    while drawn.len() < target && cells.len() > 1 {
        drawn.extend(cells.pop().expect("more than one cell is left"));
    }
    drawn
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Positions on walls and close to them, written as decimals; expected cells by integer arithmetic.
        #[test]
        fn cell_boundary_belongs_to_upper_cell(
            size in 1..=5_000_i64, cell in -2_000..2_000_i64, off in -1..=1_i64, decimals in 0..6_usize,
        ) {
            let written = |number: i64| -> f64 {
                let (sign, digits) = (if number < 0 { "-" } else { "" }, format!("{:07}", number.abs()));
                let (whole, fraction) = digits.split_at(7 - decimals);
                format!("{sign}{whole}.{fraction}").parse().unwrap()
            };
            let position = cell * size + off;
            let voxel = Voxel { size_m: written(size), ..Voxel::default() };
            let expected = i128::from(position.div_euclid(size));
            prop_assert_eq!(voxel.cell([written(position), 0.0, -0.0]), [expected, 0, 0]);
        }

        #[test]
        fn voxel_cell_accepts_every_finite_number(v in any::<f64>(), size_m in any::<f64>()) {
            prop_assume!(v.is_finite() && size_m.is_finite() && size_m > 0.0);
            let [cell, ..] = Voxel { size_m, ..Voxel::default() }.cell([v, 0.0, 0.0]);
            prop_assert_eq!(cell < 0, v < 0.0);
        }
    }

    #[test]
    fn map_coordinates_keep_their_decimals() {
        let voxel = Voxel { size_m: 0.1, ..Voxel::default() };
        assert_eq!(voxel.cell([5_432_100.3, 500_000.25, 1e-320]), [54_321_003, 5_000_002, 0]);
        assert_eq!(voxel.cell([-1e300, 1e300, -1e-300]), [-i128::MAX, i128::MAX, -1]);
    }
}
