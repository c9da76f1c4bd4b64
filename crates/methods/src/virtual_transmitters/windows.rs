//! Levels of the search: rows in windows of neighbouring positions and subcarriers, within which a cell is coherent.
//!
//! Over a cell of size s at distance D, the phases of two positions w apart differ by about s·w/(λ D) cycles, those of two
//! subcarriers b apart by s·b/c. Each level doubles the cells, halves the windows of positions, and limits the
//! windows of subcarriers to c/4s. A window thereby resolves ranges to c/B, and the array resolves directions.

use crate::virtual_transmitters::equations::MeasurementRows;
use crate::virtual_transmitters::grid::{START, SearchGrid};
use crate::virtual_transmitters::links::ChannelInputs;
use pwrfgs_core::statistics::bounds;
use pwrfgs_core::{Real, SPEED_OF_LIGHT, evenly};

/// Minimum mean number of measured values per window.
const LEAST: usize = 8;
/// Minimum number of rows per window, if it has as many.
const ROWS: usize = 32;
/// Maximum number of windows per level.
const WINDOWS: usize = 256;

/// One level of the search.
#[derive(Clone, Debug)]
pub(crate) struct SearchLevel {
    /// Spacing of cells in the innermost shell, metres.
    pub(crate) step: f64,
    pub(crate) rows: MeasurementRows,
    /// End of each window in `rows`.
    pub(crate) ends: Vec<usize>,
}

impl SearchLevel {
    /// Creates the levels of a search from fine to coarse. Each has about `most` rows of the channel `h` (`[A,F]` per position)
    /// at the positions `items`. The last level has at most [`START`] cells, if its windows have enough values.
    pub(crate) fn create_levels(
        links: &ChannelInputs<'_>,
        h: &[&[[Real; 2]]],
        (items, most): (&[usize], usize),
        grid: &SearchGrid,
        seed: u64,
    ) -> Vec<Self> {
        let subcarriers = links.frequencies.len();
        let values: Vec<usize> = (0..links.antennas.len() * subcarriers).collect();
        let rows = MeasurementRows::new(links, h, (items, &values), most, seed);
        let mut levels = vec![Self { step: grid.step, ends: vec![rows.len()], rows }];
        let (lowest, highest) = bounds(links.frequencies.iter().copied());
        let bandwidth = highest - lowest;
        let aperture = widest_side(links.antennas);
        let (mut step, mut width) = (grid.step, grid.side);
        while grid.cell_count(step) > START {
            (step, width) = (2.0 * step, width / 2.0);
            let windows = split_items(links.positions, items.to_vec(), width);
            let bands =
                (4.0 * bandwidth * grid.widest_step(step) / SPEED_OF_LIGHT).ceil().clamp(1.0, subcarriers as f64);
            let bands = bands as usize;
            if width < aperture || items.len() * values.len() < LEAST * windows.len() * bands {
                break;
            }
            let band_of = |value: &usize| value % subcarriers * bands / subcarriers;
            let parts: Vec<(&Vec<usize>, usize)> =
                windows.iter().flat_map(|window| (0..bands).map(move |band| (window, band))).collect();
            let parts = evenly(&parts, WINDOWS);
            let each = most.div_ceil(parts.len()).max(ROWS);
            let mut level = Self { step, rows: MeasurementRows::default(), ends: Vec::new() };
            for (window, band) in parts {
                let values: Vec<usize> = values.iter().copied().filter(|value| band_of(value) == band).collect();
                level.rows.extend(MeasurementRows::new(links, h, (window, &values), each, seed));
                level.ends.push(level.rows.len());
            }
            levels.push(level);
        }
        levels
    }
}

/// Returns the longest side of the bounding box of `points`, metres; 0 without points.
fn widest_side(points: &[[Real; 3]]) -> f64 {
    (0..3).map(|k| bounds(points.iter().map(|p| f64::from(p[k])))).map(|(low, high)| high - low).fold(0.0, f64::max)
}

/// Splits `items` at the middle of the longest side of their positions, until no side is longer than `width`.
fn split_items(positions: &[[Real; 3]], items: Vec<usize>, width: f64) -> Vec<Vec<usize>> {
    let sides = [0, 1, 2].map(|k| bounds(items.iter().map(|i| f64::from(positions[*i][k]))));
    let longest = (0..3).fold(0, |l, k| if sides[k].1 - sides[k].0 > sides[l].1 - sides[l].0 { k } else { l });
    let (low, high) = sides[longest];
    if high - low <= width {
        return vec![items];
    }
    let middle = f64::midpoint(low, high);
    let (below, above) = items.into_iter().partition(|i: &usize| f64::from(positions[*i][longest]) <= middle);
    let mut windows = split_items(positions, below, width);
    windows.extend(split_items(positions, above, width));
    windows
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::virtual_transmitters::sweep::sweep_cells;
    use crate::virtual_transmitters::{VirtualSources, field, turn};
    use pwrfgs_core::rng;
    use std::sync::atomic::AtomicBool;

    /// Site of 8 m with one source, 16 antennas and eight subcarriers over 40 MHz: links, channel, and best cell of a sweep
    /// with the number of scored cells and of cells of the whole grid.
    fn sweep_site(carrier: f64, source: [f64; 3]) -> ([f64; 3], f64, [usize; 2]) {
        let mut random = rng::stream(3, "positions", 0);
        let mut draw = |_| [8.0, 6.0, 0.8].map(|side| side * rng::uniform(&mut random));
        let positions: Vec<[Real; 3]> = (0..300).map(&mut draw).collect();
        let wavelength = SPEED_OF_LIGHT / carrier;
        let along = |k: usize| (0.49 * wavelength * k as f64) as Real;
        let antennas: Vec<[Real; 3]> = (0..16).map(|k| [along(k % 4), along(k / 4), 0.0]).collect();
        let frequencies: Vec<f64> = (0..8).map(|k| carrier + 5e6 * f64::from(k)).collect();
        let links = ChannelInputs { positions: &positions, antennas: &antennas, frequencies: &frequencies };
        let mut truth = VirtualSources::default();
        truth.push(source, turn::IDENTITY, [1.0, 0.0]);
        let h = field(&truth.to_cloud(), None, &links);
        let grid = SearchGrid {
            centre: [4.0, 3.0, 0.4],
            side: 8.0,
            half: 28.0,
            step: wavelength / 4.0,
            quats: turn::mirror_rotations(&antennas.iter().map(|r| r.map(f64::from)).collect::<Vec<_>>()),
        };
        let items: Vec<usize> = (0..300).collect();
        let levels = SearchLevel::create_levels(&links, &h.chunks(128).collect::<Vec<_>>(), (&items, 512), &grid, 0);
        let mut reports = Vec::new();
        let stop = AtomicBool::new(false);
        let cells = sweep_cells((&levels, &grid), &VirtualSources::default(), (1, 1), &stop, &mut |done, total| {
            reports.push((done, total));
        });
        assert!(reports.len() > 8 && reports.windows(2).all(|pair| pair[0].0 < pair[1].0), "{reports:?}");
        let (done, total) = *reports.last().unwrap();
        assert_eq!(done, total);
        (cells[0].centre, wavelength, [done, grid.cell_count(grid.step)])
    }

    #[test]
    #[cfg_attr(feature = "f64", ignore = "searched in single precision")]
    fn cells_of_search_grow_less_than_eightfold_over_two_octaves() {
        let source = [-3.1, 2.2, 2.9];
        let [(_, _, low), (found, wavelength, high)] = [0.6e9, 2.4e9].map(|carrier| sweep_site(carrier, source));
        assert!(high[0] < 8 * low[0] && high[1] > 60 * low[1], "{low:?} {high:?}");
        let off = (0..3).map(|k| (found[k] - source[k]).powi(2)).sum::<f64>().sqrt();
        assert!(off < wavelength / 2.0, "{found:?} is {off} m from {source:?}");
    }

    #[test]
    fn windows_resolve_band_and_neighbours() {
        let positions: Vec<[Real; 3]> = (0..64).map(|k| [0.1 * k as Real, 0.0, 0.0]).collect();
        let windows = split_items(&positions, (0..64).collect(), 0.8);
        assert_eq!(windows.iter().map(Vec::len).collect::<Vec<_>>(), [8; 8]);
        assert_eq!(split_items(&[[1.0; 3]; 4], vec![0, 1, 2, 3], 0.0).len(), 1, "equal positions stay together");
    }
}
