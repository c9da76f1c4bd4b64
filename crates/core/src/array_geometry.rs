//! Geometry of antenna arrays: a grid, or given positions.

use std::fmt::Display;
use std::ops::RangeInclusive;

/// Largest number of rows, and of columns.
const LARGEST: usize = 32;
/// Largest number of given antennas.
const MOST: usize = LARGEST * LARGEST;
/// Distances between neighbours of the grid, wavelengths.
const SPACINGS: RangeInclusive<f64> = 1e-3..=100.0;
/// Largest coordinate of an antenna, wavelengths.
const FARTHEST: f64 = 1e3;

/// Antennas of a receiver: a grid in its x-y plane, or given positions. Distances have the precision `T` of the settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArrayGeometry<'a, T> {
    /// Number of antennas along y.
    pub rows: usize,
    /// Number of antennas along x.
    pub columns: usize,
    /// Distance between neighbours of the grid, wavelengths.
    pub spacing: T,
    /// Positions `[K]` that replace the grid, wavelengths, receiver frame; empty for the grid.
    pub positions: &'a [[T; 3]],
}

impl<T: Copy + Display + PartialEq + Into<f64>> ArrayGeometry<'_, T> {
    /// Returns the number of antennas K.
    pub fn element_count(&self) -> usize {
        if self.positions.is_empty() { self.rows * self.columns } else { self.positions.len() }
    }

    /// Returns the positions `[K]` relative to the receiver, receiver frame, in the unit of `wavelength`: metres, or wavelengths
    /// if it is 1. The grid is centred, and x varies fastest.
    pub fn element_positions(&self, wavelength: f64) -> Vec<[f64; 3]> {
        if !self.positions.is_empty() {
            return self.positions.iter().map(|p| p.map(|v| v.into() * wavelength)).collect();
        }
        let spacing = self.spacing.into() * wavelength;
        let coordinate = |index: usize, count: usize| (index as f64 - (count as f64 - 1.0) / 2.0) * spacing;
        (0..self.element_count())
            .map(|k| [coordinate(k % self.columns, self.columns), coordinate(k / self.columns, self.rows), 0.0])
            .collect()
    }

    /// Checks the grid and the positions.
    ///
    /// # Errors
    /// The grid or a position is invalid, or both positions and a grid other than `default` are given. The message states
    /// the problem and the next step, with the names of the settings.
    pub fn check(&self, default: ArrayGeometry<'_, T>) -> Result<(), String> {
        for (field, count) in [("rows", self.rows), ("columns", self.columns)] {
            if !(1..=LARGEST).contains(&count) {
                return Err(format!("`{field}` is {count}; give 1 to {LARGEST} antennas"));
            }
        }
        if !SPACINGS.contains(&self.spacing.into()) {
            let range = format!("{} to {}", SPACINGS.start(), SPACINGS.end());
            let advice = "usually 0.5 or a little less";
            return Err(format!("`spacing_wavelengths` is {}; give {range}, {advice}", self.spacing));
        }
        let has_default_grid = (self.rows, self.columns) == (default.rows, default.columns);
        let is_default = has_default_grid && self.spacing == default.spacing;
        if !(self.positions.is_empty() || is_default) {
            let grid = "`rows`, `columns` and `spacing_wavelengths`";
            return Err(format!("`positions_wavelengths` replaces {grid}; give either the positions or the grid"));
        }
        self.check_positions().map_err(|why| format!("`positions_wavelengths`: {why}"))
    }

    /// Returns an error for too many given positions, a coordinate that is NaN or too large, or two equal positions.
    fn check_positions(&self) -> Result<(), String> {
        if self.positions.len() > MOST {
            return Err(format!("{} antennas are too many; give at most {MOST}", self.positions.len()));
        }
        for (i, position) in self.positions.iter().enumerate() {
            let [x, y, z] = position;
            let number = i + 1;
            if !position.iter().all(|v| (*v).into().abs() <= FARTHEST) {
                let advice = format!("give coordinates from -{FARTHEST} to {FARTHEST} wavelengths");
                return Err(format!("antenna {number} is at ({x}, {y}, {z}); {advice}"));
            }
            if let Some(other) = self.positions[..i].iter().position(|other| other == position) {
                let both = format!("antennas {} and {number} are both at ({x}, {y}, {z})", other + 1);
                return Err(format!("{both}; give each antenna its own position"));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: ArrayGeometry<'_, f64> = ArrayGeometry { rows: 4, columns: 4, spacing: 0.5, positions: &[] };

    #[test]
    fn grid_has_x_fastest_and_zero_mean() {
        let grid = ArrayGeometry { rows: 2, columns: 3, spacing: 0.25, ..GRID };
        let positions = grid.element_positions(4.0);
        assert_eq!(positions.len(), grid.element_count());
        assert_eq!(positions[..2], [[-1.0, -0.5, 0.0], [0.0, -0.5, 0.0]]);
        assert_eq!(positions[3], [-1.0, 0.5, 0.0]);
        assert_eq!(positions.iter().flatten().sum::<f64>(), 0.0);
    }

    #[test]
    fn given_positions_replace_grid() {
        let given = [[0.0, 0.0, 0.0], [0.5, 0.0, -1.0], [0.0, 2.0, 0.25]];
        let array = ArrayGeometry { positions: &given, ..GRID };
        assert_eq!((array.element_count(), array.check(GRID)), (3, Ok(())));
        assert_eq!(array.element_positions(0.4), given.map(|p| p.map(|v| v * 0.4)));
    }

    #[test]
    fn reports_each_invalid_geometry() {
        let rejected = |array: ArrayGeometry<'_, f64>| array.check(GRID).unwrap_err();
        assert_eq!(rejected(ArrayGeometry { rows: 0, ..GRID }), "`rows` is 0; give 1 to 32 antennas");
        assert_eq!(rejected(ArrayGeometry { columns: 33, ..GRID }), "`columns` is 33; give 1 to 32 antennas");
        for spacing in [0.0, -1.0, f64::NAN] {
            let expected =
                format!("`spacing_wavelengths` is {spacing}; give 0.001 to 100, usually 0.5 or a little less");
            assert_eq!(rejected(ArrayGeometry { spacing, ..GRID }), expected);
        }
        let given = |positions| ArrayGeometry { positions, ..GRID };
        assert_eq!(
            rejected(given(&[[0.0; 3], [0.0, f64::INFINITY, 0.0]])),
            "`positions_wavelengths`: antenna 2 is at (0, inf, 0); give coordinates from -1000 to 1000 wavelengths"
        );
        assert_eq!(
            rejected(given(&[[0.5, 0.0, 0.0], [0.0; 3], [0.5, -0.0, 0.0]])),
            "`positions_wavelengths`: antennas 1 and 3 are both at (0.5, -0, 0); give each antenna its own position"
        );
        let many: Vec<[f64; 3]> = (0..1025).map(|i| [f64::from(i) / 4.0, 0.0, 0.0]).collect();
        assert_eq!(rejected(given(&many)), "`positions_wavelengths`: 1025 antennas are too many; give at most 1024");
        assert_eq!(
            rejected(ArrayGeometry { rows: 1, ..given(&[[0.0; 3]]) }),
            "`positions_wavelengths` replaces `rows`, `columns` and `spacing_wavelengths`; give either the positions or the \
             grid"
        );
    }
}
