//! Tile lists: the splats that may cover each block of 16 × 16 pixels, in depth order.
//!
//! The lists are conservative; the alpha of a splat decides in each pixel whether it is drawn.

use crate::blend::{ALPHA_MIN, TILE, nearest_image};
use pwrfgs_core::{ImagePlane, JsonSchema, Real, Splats, widest};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Pixels that a Gaussian covers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Support {
    /// Pixels with γ ≥ 1/255.
    #[default]
    Exact,
    /// Pixels of all tiles that intersect the square of radius 3σ, as in the released code.
    TileSquares,
}

/// Depth-ordered splats of every tile.
#[derive(Debug)]
pub(crate) struct TileLists {
    /// Tiles per row.
    columns: usize,
    /// Range of each tile in `splats`: `offsets[t]..offsets[t + 1]`; tiles are row-major.
    offsets: Vec<usize>,
    /// Indices of splats, grouped by tile.
    pub(crate) splats: Vec<u32>,
    /// First row of the tile that the splat may cover, and the row after the last.
    rows: Vec<[u8; 2]>,
}

/// Pixels that a splat may cover in one column of tiles.
struct Strip {
    splat: u32,
    column: u32,
    rows: Range<u32>,
}

/// Number of splats per task of the listing.
const CHUNK: usize = 2048;

impl TileLists {
    /// Returns the number of tiles.
    pub(crate) fn tile_count(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Returns the first pixel column and row of tile `t`.
    pub(crate) fn corner(&self, t: usize) -> (usize, usize) {
        (t % self.columns * TILE, t / self.columns * TILE)
    }

    /// Returns the splats of tile `t`, nearest first, and the rows that each may cover.
    pub(crate) fn tile_splats(&self, t: usize) -> (&[u32], &[[u8; 2]]) {
        let entries = self.offsets[t]..self.offsets[t + 1];
        (&self.splats[entries.clone()], &self.rows[entries])
    }

    /// Sorts splats by depth (ties by index) and lists them per tile.
    pub(crate) fn build(splats: &Splats, plane: &ImagePlane, support: Support) -> Self {
        let (columns, tile_rows) = (plane.width.div_ceil(TILE), plane.height.div_ceil(TILE));
        let list = |chunk: &[u32]| widest(Listing { splats, chunk, plane, support });
        let strips: Vec<Vec<Strip>> = depth_order(splats).par_chunks(CHUNK).map(list).collect();
        let mut offsets = vec![0usize; columns * tile_rows + 1];
        for strip in strips.iter().flatten() {
            strip.visit_tiles(|row, _| offsets[row * columns + strip.column as usize + 1] += 1);
        }
        for t in 1..offsets.len() {
            offsets[t] += offsets[t - 1];
        }
        let (mut next, count) = (offsets.clone(), offsets[offsets.len() - 1]);
        let (mut entries, mut rows) = (vec![0u32; count], vec![[0u8; 2]; count]);
        for strip in strips.iter().flatten() {
            strip.visit_tiles(|row, within| {
                let entry = &mut next[row * columns + strip.column as usize];
                (entries[*entry], rows[*entry]) = (strip.splat, within);
                *entry += 1;
            });
        }
        Self { columns, offsets, splats: entries, rows }
    }
}

/// Strips of a range of splats, computed with rounding instructions that not every processor has.
struct Listing<'a> {
    splats: &'a Splats,
    chunk: &'a [u32],
    plane: &'a ImagePlane,
    support: Support,
}

impl pulp::WithSimd for Listing<'_> {
    type Output = Vec<Strip>;
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Vec<Strip> {
        let Self { splats, chunk, plane, support } = self;
        let mut strips = Vec::with_capacity(4 * chunk.len());
        for &i in chunk {
            match support {
                Support::Exact => list_exact_strips(splats, i, plane, &mut strips),
                Support::TileSquares => list_released_strips(splats, i, plane, &mut strips),
            }
        }
        strips
    }
}

impl Strip {
    /// Calls `visit` with each tile row that the strip covers, and the first pixel row within it and the row after the
    /// last.
    fn visit_tiles(&self, mut visit: impl FnMut(usize, [u8; 2])) {
        const SIDE: u32 = TILE as u32;
        for tile in self.rows.start / SIDE..self.rows.end.div_ceil(SIDE) {
            let within = |row: u32| row.saturating_sub(tile * SIDE).min(SIDE) as u8;
            visit(tile as usize, [within(self.rows.start), within(self.rows.end)]);
        }
    }
}

/// Returns the indices of the splats in the image, nearest first.
fn depth_order(splats: &Splats) -> Vec<u32> {
    let visible = (0..splats.len()).filter(|&i| splats.radii[i] > 0.0);
    nearest_first(visible.map(|i| (splats.depths[i], i)))
}

/// Returns the indices of depths, nearest first by single-precision depth; ties in index order.
pub(crate) fn nearest_first(depths: impl Iterator<Item = (Real, usize)>) -> Vec<u32> {
    // The bits of positive floats are ordered like the floats.
    let mut keys: Vec<_> = depths.map(|(depth, i)| ((depth as f32).to_bits(), i as u32)).collect();
    if keys.len() < 4096 {
        keys.sort_unstable(); // one thread is faster
    } else {
        keys.par_sort_unstable();
    }
    keys.into_iter().map(|(_, i)| i).collect()
}

/// Adds the pixels where alpha of splat `i` may reach 1/255 to `strips`, one strip per column of tiles: those inside the
/// ellipse dᵀ conic d ≤ 2 ln(255 o).
#[inline(always)]
fn list_exact_strips(splats: &Splats, i: u32, plane: &ImagePlane, strips: &mut Vec<Strip>) {
    let Some(ellipse) = Ellipse::new(splats, i as usize) else { return };
    let rows = ellipse.image_rows(ellipse.half[1], -ellipse.half[1], plane);
    if rows.is_empty() {
        return;
    }
    let (x, width) = (ellipse.mean[0], plane.width as Real);
    let columns = tile_columns(x - ellipse.half[0], x + ellipse.half[0], plane);
    // The bounding box suffices for one column, and for columns that may contain the splat from both sides.
    let boxed = columns.iter().map(Range::len).sum::<usize>() == 1
        || plane.wraps && 2.0 * (ellipse.half[0] + TILE as Real) >= width;
    for column in columns.into_iter().flatten() {
        let middle = x - (column * TILE) as Real - REACH;
        let middle = if plane.wraps { nearest_image(middle, width) } else { middle };
        let rows = if boxed {
            rows.clone()
        } else {
            ellipse
                .vertical_range(middle - REACH, middle + REACH)
                .map_or(0..0, |[above, below]| ellipse.image_rows(above, below, plane))
        };
        if !rows.is_empty() {
            strips.push(Strip { splat: i, column: column as u32, rows });
        }
    }
}

/// Distance from the centre of a tile to its outermost pixels, pixels.
const REACH: Real = (TILE - 1) as Real / 2.0;

/// Ellipse in which a splat is drawn.
struct Ellipse {
    mean: [Real; 2],
    conic: [Real; 3],
    sigmas: [Real; 2],
    /// Value of dᵀ conic d on the boundary.
    level: Real,
    /// Half the sides of the bounding box, enlarged by a hundredth of a pixel; pixels.
    half: [Real; 2],
}

impl Ellipse {
    /// Returns the ellipse of splat `i`; `None` if the splat is not drawn.
    #[inline(always)]
    fn new(splats: &Splats, i: usize) -> Option<Self> {
        let opacity = splats.opacities[i];
        if opacity.is_nan() || opacity < ALPHA_MIN || splats.radii[i] == 0.0 {
            return None;
        }
        let (mean, conic, sigmas) = (splats.means2d[i], splats.conics[i], splats.sigmas2d[i]);
        // For a thin, slanted splat, dᵀ conic d of the kernel is a small difference of large numbers; a·σ² bounds their
        // ratio. The rest is a margin for rounding here and in the exponential of the kernel.
        let margin = 1.002 + 4.0 * Real::from(f32::EPSILON) * conic[0] * sigmas[0] * sigmas[0];
        let level = 2.0 * (opacity / ALPHA_MIN).ln().max(0.0) * margin + 1e-5;
        Some(Self { mean, conic, sigmas, level, half: sigmas.map(|s| s * level.sqrt() + 0.01) })
    }

    /// Returns the largest and the smallest dy = mean − pixel of the points with dx from `low` to `high`; `None` if the
    /// ellipse has no such points.
    #[inline(always)]
    fn vertical_range(&self, low: Real, high: Real) -> Option<[Real; 2]> {
        let (low, high) = (low.max(-self.half[0]), high.min(self.half[0]));
        if low > high {
            return None;
        }
        let [a, b, c] = self.conic;
        let rim = |dx: Real| ((self.level - (dx / self.sigmas[0]).powi(2)).max(0.0) / c).sqrt();
        let tip = b / a * self.half[1]; // dx of the lowest point; that of the highest is −tip
        let (highest, lowest) = ((-tip).max(low).min(high), tip.max(low).min(high));
        Some([-b / c * highest + rim(highest), -b / c * lowest - rim(lowest)])
    }

    /// Returns the image rows with dy from `below` to `above`, with a margin of a hundredth of a pixel; all rows if
    /// both are NaN.
    #[inline(always)]
    fn image_rows(&self, above: Real, below: Real, plane: &ImagePlane) -> Range<u32> {
        let y = self.mean[1];
        let last = (y - below + 0.01).floor().min(plane.height as Real - 1.0);
        if last < 0.0 { 0..0 } else { (y - above - 0.01).ceil().max(0.0) as u32..last as u32 + 1 }
    }
}

/// Adds the pixels of splat `i` by the released rule to `strips`: every pixel of every tile that intersects the square of
/// the splat's radius.
fn list_released_strips(splats: &Splats, i: u32, plane: &ImagePlane, strips: &mut Vec<Strip>) {
    let index = i as usize;
    if splats.opacities[index].is_nan() {
        return; // min(NaN, 0.99) would be 0.99
    }
    let (columns, tile_rows) = square_tiles(splats.means2d[index], splats.radii[index], plane);
    let rows = (tile_rows.start * TILE) as u32..(tile_rows.end * TILE).min(plane.height) as u32;
    if !rows.is_empty() {
        strips.extend(columns.map(|column| Strip { splat: i, column: column as u32, rows: rows.clone() }));
    }
}

/// Returns the tile columns that intersect the pixel columns from `low` to `high`. The second range is empty unless they
/// cross the seam of a plane that wraps.
#[inline(always)]
fn tile_columns(low: Real, high: Real, plane: &ImagePlane) -> [Range<usize>; 2] {
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
        // Both ends share a tile: all columns are covered, and each tile is listed once.
        [0..tiles, 0..0]
    } else {
        [0..last + 1, first..tiles]
    }
}

/// Returns the tile columns and rows that intersect the square of `radius` about `centre`, by the rule of the released
/// kernels of WRF-GS and 3DGS; empty for radius 0.
pub(crate) fn square_tiles(centre: [Real; 2], radius: Real, plane: &ImagePlane) -> (Range<usize>, Range<usize>) {
    let along = |centre: Real, pixels: usize| {
        let tiles = pixels.div_ceil(TILE) as Real;
        let first = ((centre - radius) / TILE as Real).trunc().clamp(0.0, tiles);
        let last = ((centre + radius + (TILE - 1) as Real) / TILE as Real).trunc().clamp(0.0, tiles);
        if radius > 0.0 { first as usize..last as usize } else { 0..0 }
    };
    (along(centre[0], plane.width), along(centre[1], plane.height))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Creates one splat with standard deviations `sigmas` along axes rotated by `angle`.
    fn one(mean: [f64; 2], sigmas: [f64; 2], angle: f64, opacity: f64) -> Splats {
        let (s, c) = angle.sin_cos();
        let [p, q] = sigmas.map(|s| s * s);
        let (xx, xy, yy) = (c * c * p + s * s * q, c * s * (p - q), s * s * p + c * c * q);
        let det = p * q;
        let mut splats = Splats::zeros(1);
        splats.means2d[0] = mean.map(|v| v as Real);
        splats.conics[0] = [yy / det, -xy / det, xx / det].map(|v| v as Real);
        splats.sigmas2d[0] = [xx.sqrt() as Real, yy.sqrt() as Real];
        (splats.radii[0], splats.opacities[0]) = (1.0, opacity as Real);
        splats
    }

    /// Returns a mask of the pixels that the tile lists pass to the kernel.
    fn offered(splats: &Splats, plane: &ImagePlane) -> Vec<bool> {
        let lists = TileLists::build(splats, plane, Support::Exact);
        let mut offered = vec![false; plane.width * plane.height];
        for t in 0..lists.tile_count() {
            let (x, y) = lists.corner(t);
            for &[first, end] in lists.tile_splats(t).1 {
                for row in first as usize..end as usize {
                    offered[(y + row) * plane.width..][x..(x + TILE).min(plane.width)].fill(true);
                }
            }
        }
        offered
    }

    /// Returns whether the kernel draws the splat in a pixel, computed from its own formula.
    fn counts(splats: &Splats, plane: &ImagePlane, (x, y): (usize, usize)) -> bool {
        let ([mx, my], [a, b, c]) = (splats.means2d[0], splats.conics[0]);
        let (dx, dy) = (mx - x as Real, my - y as Real);
        let dx = if plane.wraps { nearest_image(dx, plane.width as Real) } else { dx };
        let power = (-b * dy).mul_add(dx, -0.5 * a * dx * dx + -0.5 * c * dy * dy);
        power <= 0.0 && splats.opacities[0] * power.exp() >= ALPHA_MIN
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(400))]

        #[test]
        fn tiles_include_every_contributing_pixel(
            mean in prop::array::uniform2(-30.0..160.0f64), sigmas in (0.55..80.0f64, 0.55..8.0f64),
            angle in 0.0..3.2f64, opacity in 0.004..1.0f64, width in 20usize..150, height in 5usize..80, wraps: bool,
            faint in prop::option::of((-9.0..-5.0f64, prop::array::uniform2(-6.0..-3.0f64))),
        ) {
            // Some splats are just bright enough, and almost centred on a pixel.
            let (mean, opacity) = match faint {
                Some((more, off)) => {
                    let mean = [0, 1].map(|k| mean[k].round() + 10f64.powf(off[k]));
                    (mean, f64::from(ALPHA_MIN as f32) * (1.0 + 10f64.powf(more)))
                }
                None => (mean, opacity),
            };
            let plane = ImagePlane { wraps, ..ImagePlane::plain(width, height) };
            let splats = one(mean, sigmas.into(), angle, opacity);
            let offered = offered(&splats, &plane);
            for p in 0..width * height {
                let pixel = (p % width, p / width);
                prop_assert!(offered[p] || !counts(&splats, &plane, pixel), "{pixel:?}");
            }
        }
    }

    #[test]
    fn thin_slanted_splat_skips_tiles_of_bounding_box() {
        let plane = ImagePlane { wraps: true, ..ImagePlane::plain(360, 90) };
        let splats = one([100.0, 45.0], [30.0, 1.0], 0.6, 0.9);
        let count = |list: &[bool]| list.iter().filter(|&&p| p).count();
        let needed = (0..360 * 90).filter(|p| counts(&splats, &plane, (p % 360, p / 360))).count();
        assert!(count(&offered(&splats, &plane)) < 5 * needed);
        let [across, down] = splats.sigmas2d[0].map(|s| 6.0 * s); // where γ is 1/100 of its peak
        assert!(count(&offered(&splats, &plane)) as Real * 3.0 < across * down);
    }
}
