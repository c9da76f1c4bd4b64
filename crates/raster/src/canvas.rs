//! Tiles of images `[channels, H, W]`: written by many threads at once, and read.
//!
//! The rows of a tile are not contiguous in memory, so that a slice cannot borrow them. [`patches`] divides images into
//! one [`Patch`] per tile. Together the patches hold the borrow; no two share a pixel, and each writes only its own
//! pixels. The compiler cannot verify this here; `tests/miri.sh` checks it with Miri.
#![allow(unsafe_code)]

use crate::blend::{PIXELS, TILE};
use pwrfgs_core::{ImagePlane, Real};
use std::marker::PhantomData;

/// Pixels of one tile, borrowed mutably.
pub(crate) struct Patch<'a> {
    /// First pixel of the tile in the first image.
    start: *mut Real,
    /// Columns and rows inside the image.
    columns: usize,
    rows: usize,
    /// Stride from one row to the next, and from one image to the next.
    width: usize,
    size: usize,
    channels: usize,
    images: PhantomData<&'a mut [Real]>,
}

// SAFETY: no other patch or reference accesses these pixels during its lifetime, so it may be moved like the `&mut
// [Real]` that it represents.
unsafe impl Send for Patch<'_> {}

/// Divides `images` `[channels, H, W]` into tiles, row by row as in [`TileLists`](crate::tiles::TileLists).
pub(crate) fn patches<'a>(images: &'a mut [Real], plane: &ImagePlane) -> Vec<Patch<'a>> {
    let (width, height) = (plane.width, plane.height);
    let size = width * height;
    assert!(images.len().is_multiple_of(size), "whole images");
    let (start, channels) = (images.as_mut_ptr(), images.len() / size.max(1));
    let corners = (0..height).step_by(TILE).flat_map(|y| (0..width).step_by(TILE).map(move |x| (x, y)));
    let patch = |(x, y)| Patch {
        start: start.wrapping_add(y * width + x),
        columns: TILE.min(width - x),
        rows: TILE.min(height - y),
        width,
        size,
        channels,
        images: PhantomData,
    };
    corners.map(patch).collect()
}

impl Patch<'_> {
    /// Copies `tile` `[channels][PIXELS]` into the images.
    #[inline]
    pub(crate) fn write_tile(&mut self, tile: &[Real]) {
        for (c, tile) in tile.chunks_exact(PIXELS).take(self.channels).enumerate() {
            for row in 0..self.rows {
                // SAFETY: the patch begins at column x and row y of whole images with x + columns ≤ W and y + rows ≤ H,
                // so these numbers are inside them. They belong to one row of this tile, which no other patch has, and
                // the images are borrowed for the lifetime of the patch.
                let to = unsafe {
                    let first = self.start.add(c * self.size + row * self.width);
                    std::slice::from_raw_parts_mut(first, self.columns)
                };
                copy_row(to, &tile[row * TILE..], self.columns);
            }
        }
    }
}

/// Copies the tile at column x and row y of `images` into `tile` `[channels][PIXELS]`; pixels outside the image are
/// 0.
#[inline]
pub(crate) fn gather_tile(images: &[Real], plane: &ImagePlane, (x, y): (usize, usize), tile: &mut [Real]) {
    let (columns, rows) = (TILE.min(plane.width - x), TILE.min(plane.height - y));
    tile.fill(0.0);
    for (image, tile) in images.chunks_exact(plane.width * plane.height).zip(tile.chunks_exact_mut(PIXELS)) {
        for row in 0..rows {
            copy_row(&mut tile[row * TILE..], &image[(y + row) * plane.width + x..], columns);
        }
    }
}

/// Copies the pixels of a tile in one row; whole rows pass through registers, because calls of `memcpy` for 64 bytes
/// took a tenth of a training step.
#[inline]
fn copy_row(to: &mut [Real], from: &[Real], columns: usize) {
    match (to.first_chunk_mut::<TILE>(), from.first_chunk::<TILE>()) {
        (Some(to), Some(from)) if columns == TILE => *to = *from,
        _ => to[..columns].copy_from_slice(&from[..columns]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Uses neither rayon nor vectors, because Miri runs this test.
    #[test]
    fn threads_write_only_their_own_tiles() {
        for (width, height, channels) in [(37, 21, 2), (16, 16, 1), (5, 40, 3), (32, 1, 1), (0, 7, 0)] {
            let plane = ImagePlane::plain(width, height);
            let mut images = vec![-1.0; channels * width * height];
            let patches = patches(&mut images, &plane);
            let across = width.div_ceil(TILE);
            assert_eq!(patches.len(), across * height.div_ceil(TILE));
            // Tile t holds the numbers from 1000 t on, with different numbers in every channel.
            let tile = |t: usize| (0..channels * PIXELS).map(move |i| (1000 * t + i) as Real).collect::<Vec<_>>();
            std::thread::scope(|scope| {
                for (t, mut patch) in patches.into_iter().enumerate() {
                    scope.spawn(move || patch.write_tile(&tile(t)));
                }
            });
            for (i, pixel) in images.iter().enumerate() {
                let (c, x, y) = (i / (width * height), i % width, i / width % height);
                let t = y / TILE * across + x / TILE;
                let expected = 1000 * t + c * PIXELS + y % TILE * TILE + x % TILE;
                assert_eq!(*pixel, expected as Real, "channel {c}, column {x}, row {y}");
            }
            for t in 0..across * height.div_ceil(TILE) {
                let (x, y) = (t % across * TILE, t / across * TILE);
                let mut read = vec![7.0; channels * PIXELS];
                gather_tile(&images, &plane, (x, y), &mut read);
                for (i, (pixel, written)) in read.iter().zip(tile(t)).enumerate() {
                    let inside = x + i % TILE < width && y + i / TILE % TILE < height;
                    assert_eq!(*pixel, if inside { written } else { 0.0 });
                }
            }
        }
    }
}
