//! Tiles: which splats may touch which 16 × 16 block of pixels, in depth order.
//!
//! Bookkeeping only: the lists are conservative, and whether a splat is drawn in a pixel is decided there, by its alpha.

use crate::Support;
use pwrfgs_core::{ImagePlane, Real, Splats};
use rayon::prelude::*;
use std::ops::Range;

/// Pixels along the side of a tile, and lanes of the blending kernel.
pub(crate) const TILE: usize = 16;

/// Depth-ordered splats of every tile.
#[derive(Debug)]
pub(crate) struct TileLists {
    /// Tiles a row.
    pub(crate) columns: usize,
    /// `splats[offsets[t]..offsets[t + 1]]` are those of tile t; tiles are row-major.
    pub(crate) offsets: Vec<usize>,
    /// Indices of splats.
    pub(crate) splats: Vec<u32>,
    /// Rows that each splat may touch `[N]`; in `TileSquares` those of whole tiles.
    pub(crate) rows: Vec<Range<i32>>,
}

impl TileLists {
    /// Number of tiles.
    pub(crate) fn len(&self) -> usize {
        self.offsets.len() - 1
    }

    /// First column and row of tile `t`.
    pub(crate) fn corner(&self, t: usize) -> (usize, usize) {
        (t % self.columns * TILE, t / self.columns * TILE)
    }

    /// Splats of tile `t`, nearest first.
    pub(crate) fn of(&self, t: usize) -> &[u32] {
        &self.splats[self.offsets[t]..self.offsets[t + 1]]
    }

    /// Sorts splats by depth (ties by index) and lists them by tile.
    pub(crate) fn build(splats: &Splats, plane: &ImagePlane, support: Support) -> Self {
        let (columns, tile_rows) = (plane.width.div_ceil(TILE), plane.height.div_ceil(TILE));
        let order = depth_order(splats);
        let reach: Vec<Reach> = (0..splats.len())
            .into_par_iter()
            .with_min_len(2048)
            .map(|i| match support {
                Support::Exact => Reach::exact(splats, i, plane),
                Support::TileSquares => Reach::released(splats, i, plane),
            })
            .collect();
        let mut offsets = vec![0usize; columns * tile_rows + 1];
        for &i in &order {
            reach[i as usize].tiles(columns, |t| offsets[t + 1] += 1);
        }
        for t in 1..offsets.len() {
            offsets[t] += offsets[t - 1];
        }
        let mut next = offsets.clone();
        let mut lists = vec![0u32; offsets[offsets.len() - 1]];
        for &i in &order {
            reach[i as usize].tiles(columns, |t| {
                lists[next[t]] = i;
                next[t] += 1;
            });
        }
        Self { columns, offsets, splats: lists, rows: reach.into_iter().map(|r| r.rows).collect() }
    }
}

/// Indices of the splats that reach the picture, nearest first; equal depths in index order.
fn depth_order(splats: &Splats) -> Vec<u32> {
    // The bits of positive floats are ordered like the floats.
    let key = |i: usize| splats.depths[i].to_bits();
    let visible = (0..splats.len()).filter(|&i| splats.radii[i] > 0.0);
    let mut keys: Vec<_> = visible.map(|i| (key(i), i as u32)).collect();
    if keys.len() < 4096 {
        keys.sort_unstable();
    } else {
        keys.par_sort_unstable();
    }
    keys.into_iter().map(|(_, i)| i).collect()
}

/// Tiles and rows that a splat may touch.
struct Reach {
    /// Up to two runs of tile columns: a splat at the seam has one on either side.
    columns: [Range<usize>; 2],
    tile_rows: Range<usize>,
    rows: Range<i32>,
}

impl Reach {
    const NONE: Self = Self { columns: [0..0, 0..0], tile_rows: 0..0, rows: 0..0 };

    /// All pixels where alpha may reach 1/255: the box around the ellipse dᵀ conic d ≤ 2 ln(255 o).
    fn exact(splats: &Splats, i: usize, plane: &ImagePlane) -> Self {
        let level = 2.0 * (255.0 * splats.opacities[i]).ln();
        if level < 0.0 || level.is_nan() || splats.radii[i] == 0.0 {
            return Self::NONE;
        }
        // A hundredth of a pixel covers the rounding of the test in the kernel.
        let half = splats.sigmas2d[i].map(|s| s * level.sqrt() * 1.001 + 0.01);
        let [x, y] = splats.means2d[i];
        let height = plane.height as i32;
        let rows =
            ((y - half[1]).ceil().max(0.0) as i32)..(((y + half[1]).floor() as i32).saturating_add(1).min(height));
        if rows.is_empty() {
            return Self::NONE;
        }
        let columns = columns_of(x - half[0], x + half[0], plane);
        let tile_rows = rows.start as usize / TILE..(rows.end as usize - 1) / TILE + 1;
        Self { columns, tile_rows, rows }
    }

    /// The released rule: every pixel of every tile that the square of the splat's radius meets.
    fn released(splats: &Splats, i: usize, plane: &ImagePlane) -> Self {
        if splats.opacities[i].is_nan() {
            return Self::NONE; // min(NaN, 0.99) would be 0.99
        }
        let (columns, tile_rows) = square(splats.means2d[i], splats.radii[i], plane);
        let rows = (tile_rows.start * TILE) as i32..(tile_rows.end * TILE).min(plane.height) as i32;
        Self { columns: [columns, 0..0], tile_rows, rows }
    }

    fn tiles(&self, columns: usize, mut visit: impl FnMut(usize)) {
        for row in self.tile_rows.clone() {
            for column in self.columns.iter().cloned().flatten() {
                visit(row * columns + column);
            }
        }
    }
}

/// Tile columns that meet the pixel columns from `low` to `high`, brought round the seam where the plane wraps.
fn columns_of(low: Real, high: Real, plane: &ImagePlane) -> [Range<usize>; 2] {
    let width = plane.width as Real;
    let tiles = plane.width.div_ceil(TILE);
    let tile = |x: Real| (x as usize).min(plane.width - 1) / TILE;
    let (low, high) = (low.ceil(), high.floor());
    if high < low {
        return [0..0, 0..0];
    }
    if !plane.wraps {
        let (low, high) = (low.max(0.0), high.min(width - 1.0));
        return if high < low { [0..0, 0..0] } else { [tile(low)..tile(high) + 1, 0..0] };
    }
    if high - low + 1.0 >= width {
        return [0..tiles, 0..0];
    }
    let around = |x: Real| x - width * (x / width).floor();
    let (first, last) = (tile(around(low)), tile(around(high)));
    if around(low) <= around(high) {
        [first..last + 1, 0..0]
    } else if last >= first {
        // Both ends share a tile: everything is covered, and no tile may be listed twice.
        [0..tiles, 0..0]
    } else {
        [0..last + 1, first..tiles]
    }
}

/// Tile columns and rows of the released bounding square (`spec` of WRF-GS, section 4.5); empty for radius 0.
pub(crate) fn square(centre: [Real; 2], radius: Real, plane: &ImagePlane) -> (Range<usize>, Range<usize>) {
    let along = |centre: Real, pixels: usize| {
        let tiles = pixels.div_ceil(TILE) as Real;
        let first = ((centre - radius) / TILE as Real).trunc().clamp(0.0, tiles);
        let last = ((centre + radius + (TILE - 1) as Real) / TILE as Real).trunc().clamp(0.0, tiles);
        if radius > 0.0 { first as usize..last as usize } else { 0..0 }
    };
    (along(centre[0], plane.width), along(centre[1], plane.height))
}
