//! Blocks of space that are held out together: cubes that follow the spacing of places and the size of the site.

use crate::neighbours::nearest_other_squared;
use crate::{Real, statistics};

/// Edge of blocks in units of the spacing, and in parts of the longest side of the site: the larger one applies. Smaller
/// blocks leave a known neighbour next to almost every place, so they test repetition.
const SPACINGS: f64 = 3.0;
const SITE_PARTS: f64 = 20.0;

/// Spacing and size of a set of places.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SiteSize {
    /// Median distance from a place to the nearest other one, metres; 1 for fewer than two different places.
    pub spacing: f64,
    /// Longest side of the box of all places, metres.
    pub longest: f64,
}

impl SiteSize {
    /// Measures `places`, metres, which may repeat.
    pub fn new(places: impl IntoIterator<Item = [f64; 3]>) -> Self {
        let mut places: Vec<[f64; 3]> =
            places.into_iter().filter(|place| place.iter().all(|v| v.is_finite())).collect();
        places.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])).then(a[2].total_cmp(&b[2])));
        places.dedup();
        let Some(&first) = places.first() else { return Self { spacing: 1.0, longest: 0.0 } };
        let side = |k: usize| {
            let (low, high) = statistics::bounds(places.iter().map(|place| place[k]));
            high - low
        };
        // Single precision suffices for distances from one of the places.
        let near: Vec<[Real; 3]> = places.iter().map(|at| [0, 1, 2].map(|k| (at[k] - first[k]) as Real)).collect();
        let nearest = nearest_other_squared(&near).into_iter().map(|squared| f64::from(squared as f32).sqrt());
        let spacing = statistics::median(nearest.filter(|distance| *distance > 0.0 && distance.is_finite()));
        Self { spacing: if spacing.is_finite() { spacing } else { 1.0 }, longest: (0..3).map(side).fold(0.0, f64::max) }
    }

    /// Returns the edge of blocks that are held out together, metres.
    pub fn block_edge(&self) -> f64 {
        (SPACINGS * self.spacing).max(self.longest / SITE_PARTS)
    }
}

/// Returns the block of a place: a cube of `edge` metres.
pub fn block_of(place: [f64; 3], edge: f64) -> [i64; 3] {
    place.map(|v| (v / edge).floor() as i64)
}
