//! Blocks of space: cubes whose test transmitters are drawn together by the bootstrap.
//!
//! Spectra of neighbouring transmitters are alike, and so are the errors of a model there. How far that reaches is not
//! known; a longer reach than the edge of a cube leaves intervals too narrow. Larger cubes are fewer, and from few
//! nothing can be drawn: the edge is the largest that leaves 30 of them. Reports print it.

use crate::statistics::Cell;
use std::collections::{BTreeMap, BTreeSet};

/// Cubes with test transmitters that there should be.
const WANTED: usize = 30;
/// The edge is not made smaller than this part of the room.
const FINEST: u32 = 256;

/// Test samples in cubes of space, or single ones if their positions are unknown.
#[derive(Clone, Debug, PartialEq)]
pub struct Blocks {
    /// Edge of a cube in metres; `None` if each test sample is a block.
    pub edge_m: Option<f64>,
    /// Number of blocks that hold test transmitters.
    pub count: usize,
    /// The block of each test sample, by id.
    of: BTreeMap<u32, usize>,
}

impl Blocks {
    /// Creates the blocks of test samples from their positions by id, metres. If any position is unknown, each sample is a
    /// block.
    pub fn new(positions: &BTreeMap<u32, Option<[f64; 3]>>) -> Self {
        let known: Option<_> = positions.iter().map(|(id, position)| Some((*id, (*position)?))).collect();
        let single = || Self { edge_m: None, count: positions.len(), of: positions.keys().copied().zip(0..).collect() };
        known.map_or_else(single, |places| Self::cubes(&places))
    }

    fn cubes(places: &BTreeMap<u32, [f64; 3]>) -> Self {
        let end = |pick: fn(f64, f64) -> f64, start: f64| {
            [0, 1, 2].map(|k| places.values().fold(start, |end, place| pick(end, place[k])))
        };
        let (low, high) = (end(f64::min, f64::INFINITY), end(f64::max, f64::NEG_INFINITY));
        let extent = (0..3).map(|k| high[k] - low[k]).fold(0.0, f64::max);
        let cube = |place: &[f64; 3], edge: f64| [0, 1, 2].map(|k| ((place[k] - low[k]) / edge) as i64);
        let edge = |parts: u32| if extent > 0.0 { extent / f64::from(parts) } else { 1.0 };
        let cubes = |edge: f64| places.values().map(|place| cube(place, edge)).collect::<BTreeSet<_>>();
        let distinct = cubes(edge(FINEST)).len();
        let parts = (1..FINEST).find(|parts| cubes(edge(*parts)).len() >= WANTED.min(distinct)).unwrap_or(FINEST);
        let edge_m = edge(parts);
        let number: BTreeMap<_, usize> = cubes(edge_m).into_iter().zip(0..).collect();
        let of = places.iter().map(|(id, place)| (*id, number[&cube(place, edge_m)])).collect();
        Self { edge_m: Some(edge_m), count: number.len(), of }
    }

    /// Differences of test samples, by id, gathered by block; those that are not finite are left out.
    pub fn cells(&self, differences: impl IntoIterator<Item = (u32, f64)>) -> Vec<Cell> {
        let mut cells = vec![Cell::default(); self.count];
        for (id, difference) in differences.into_iter().filter(|(_, difference)| difference.is_finite()) {
            if let Some(block) = self.of(id) {
                cells[block].add(difference);
            }
        }
        cells
    }

    /// The block of a test sample.
    pub fn of(&self, id: u32) -> Option<usize> {
        self.of.get(&id).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_share_a_cube() {
        // 10 x 10 places, 1 m apart, in clumps of two that are 1 cm apart.
        let places =
            (0..200u32).map(|id| (id, Some([f64::from(id / 2 % 10), f64::from(id / 20), 0.01 * f64::from(id % 2)])));
        let blocks = Blocks::new(&places.collect());
        assert!((0..100).all(|k| blocks.of(2 * k) == blocks.of(2 * k + 1)));
        assert!((30..=50).contains(&blocks.count), "{}", blocks.count);
        assert!((1.0..2.0).contains(&blocks.edge_m.unwrap()), "{:?}", blocks.edge_m);
        assert_eq!((blocks.of(0), blocks.of(199), blocks.of(200)), (Some(0), Some(blocks.count - 1), None));
    }

    #[test]
    fn few_places_have_a_cube_each_and_one_place_has_one() {
        let places = BTreeMap::from([(1, [0.0; 3]), (5, [0.1, 0.0, 0.0]), (9, [3.0, 0.0, 1.0])]);
        let places = places.into_iter().map(|(id, place)| (id, Some(place))).collect();
        let blocks = Blocks::new(&places);
        assert_eq!(BTreeSet::from([1, 5, 9].map(|id| blocks.of(id).unwrap())).len(), 3);
        assert_eq!(Blocks::new(&BTreeMap::from([1, 2].map(|id| (id, Some([2.0; 3]))))).count, 1);
        assert_eq!(Blocks::new(&BTreeMap::new()).count, 0);
    }

    #[test]
    fn samples_without_positions_are_blocks_of_their_own() {
        let positions = (0..1_000).map(|id| (id, if id < 2 { Some([0.0; 3]) } else { None })).collect();
        let blocks = Blocks::new(&positions);
        assert_eq!((blocks.edge_m, blocks.count), (None, 1_000));
        assert_eq!((0..1_000).map(|id| blocks.of(id).unwrap()).collect::<BTreeSet<_>>().len(), 1_000);
    }
}
