//! `CoarseGrid`: every n-th row and column of an image, and cubic interpolation between them.
//!
//! Spectra of small arrays are smooth. On s23 (4 x 4 antennas), residuals on every fourth row and column lose 0.0003 of
//! SSIM against exact ones (`docs/lab/residuals.md`), and need neither a basis nor its factorisation.

use pwrfgs_core::{ImagePlane, Real};

/// Every `stride`-th row and column of an image, with the weights of the interpolation.
#[derive(Clone, Debug)]
pub(crate) struct CoarseGrid {
    pub(crate) stride: usize,
    rows: Vec<Node>,
    columns: Vec<Node>,
    /// Number of stored rows and columns.
    size: [usize; 2],
}

/// Indices of four stored rows or columns around a row or column of pixels, with their weights.
type Node = [(usize, Real); 4];

impl CoarseGrid {
    /// Creates the grid of a `plane`. Columns wrap around if those of the plane do and `stride` divides their number.
    pub(crate) fn new(plane: &ImagePlane, stride: usize) -> Self {
        let wraps = plane.wraps && plane.width.is_multiple_of(stride);
        let size = [plane.height.div_ceil(stride), plane.width.div_ceil(stride)];
        let rows = (0..plane.height).map(|y| cubic_node(y, stride, size[0], false)).collect();
        let columns = (0..plane.width).map(|x| cubic_node(x, stride, size[1], wraps)).collect();
        Self { stride, rows, columns, size }
    }

    /// Returns the number of stored pixels.
    pub(crate) fn len(&self) -> usize {
        self.size[0] * self.size[1]
    }

    /// Returns the stored pixels of a whole image.
    pub(crate) fn sampled(&self, pixels: &[Real]) -> impl Iterator<Item = Real> {
        let rows = pixels.chunks_exact(self.columns.len()).step_by(self.stride);
        rows.flat_map(|row| row.iter().step_by(self.stride).copied())
    }

    /// Returns the share of the variance of `images` about their mean that the grid loses: the squared error of
    /// restored images, or of restored differences from the mean if `is_centred`. 0 without variance.
    pub(crate) fn lost_share(&self, images: &[Vec<Real>], is_centred: bool) -> f64 {
        let mut mean = vec![0.0; self.rows.len() * self.columns.len()];
        let share = 1.0 / images.len().max(1) as Real;
        for image in images {
            mean.iter_mut().zip(image).for_each(|(mean, v)| *mean += share * v);
        }
        let (mut lost, mut total) = (0.0, 0.0);
        for image in images {
            let centred: Vec<Real> = image.iter().zip(&mean).map(|(v, mean)| v - mean).collect();
            let stored = if is_centred { &centred } else { image };
            let mut restored = vec![0.0; stored.len()];
            self.add_interpolated(&self.sampled(stored).collect::<Vec<_>>(), &mut restored);
            lost += stored.iter().zip(restored).map(|(v, restored)| (*v as f64 - restored as f64).powi(2)).sum::<f64>();
            total += centred.iter().map(|v| (*v as f64).powi(2)).sum::<f64>();
        }
        if total > 0.0 { lost / total } else { 0.0 }
    }

    /// Adds the interpolated `stored` pixels to `pixels`.
    pub(crate) fn add_interpolated(&self, stored: &[Real], pixels: &mut [Real]) {
        if self.stride == 1 {
            pixels.iter_mut().zip(stored).for_each(|(pixel, v)| *pixel += v);
            return;
        }
        let width = self.columns.len();
        let across = |row: &[Real]| -> Vec<Real> {
            self.columns.iter().map(|node| node.iter().map(|&(k, w)| w * row[k]).sum()).collect()
        };
        let wide: Vec<Vec<Real>> = stored.chunks_exact(self.size[1]).map(across).collect();
        for (pixels, node) in pixels.chunks_exact_mut(width).zip(&self.rows) {
            for &(k, weight) in node {
                pixels.iter_mut().zip(&wide[k]).for_each(|(pixel, v)| *pixel += weight * v);
            }
        }
    }

    /// Returns the cotangents of the stored pixels of [`Self::add_interpolated`], given those of the pixels.
    pub(crate) fn add_interpolated_vjp(&self, d_pixels: &[Real]) -> Vec<Real> {
        if self.stride == 1 {
            return d_pixels.to_vec();
        }
        let (width, mut d_stored) = (self.columns.len(), vec![0.0; self.len()]);
        let mut d_wide = vec![0.0; self.size[0] * width];
        for (d, node) in d_pixels.chunks_exact(width).zip(&self.rows) {
            for &(k, weight) in node {
                d_wide[k * width..][..width].iter_mut().zip(d).for_each(|(sum, d)| *sum += weight * d);
            }
        }
        for (d_row, d_wide) in d_stored.chunks_exact_mut(self.size[1]).zip(d_wide.chunks_exact(width)) {
            for (node, d) in self.columns.iter().zip(d_wide) {
                node.iter().for_each(|&(k, weight)| d_row[k] += weight * d);
            }
        }
        d_stored
    }
}

/// Returns the four of `count` stored rows or columns around number `at` of the image, and their weights of a cubic
/// convolution (Keys, IEEE Transactions on Acoustics, Speech, and Signal Processing 29, 1981). Beyond the border, the last
/// stored one repeats, or the first follows if the image `wraps`.
fn cubic_node(at: usize, stride: usize, count: usize, wraps: bool) -> Node {
    let (left, f) = (at / stride, (at % stride) as Real / stride as Real);
    let weights = [
        -0.5 * f * f * f + f * f - 0.5 * f,
        1.5 * f * f * f - 2.5 * f * f + 1.0,
        -1.5 * f * f * f + 2.0 * f * f + 0.5 * f,
        0.5 * f * f * f - 0.5 * f * f,
    ];
    // Counted from one before `left`.
    let stored = |k: usize| {
        if wraps { (left + k + count - 1) % count } else { (left + k).saturating_sub(1).min(count - 1) }
    };
    [0, 1, 2, 3].map(|k| (stored(k), weights[k]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Elevation, Task};

    fn plane(width: usize, height: usize) -> ImagePlane {
        Task::Spectrum.plane((width, height), Elevation::UPPER)
    }

    #[test]
    fn interpolation_returns_stored_pixels_and_smooth_images() {
        let plane = plane(48, 20);
        let smooth = |i: usize| {
            let (x, y) = ((i % 48) as Real, (i / 48) as Real);
            (x * std::f64::consts::TAU as Real / 48.0).cos() + 0.02 * y * y
        };
        let image: Vec<Real> = (0..48 * 20).map(smooth).collect();
        for (stride, error) in [(1, 0.0), (4, 0.03)] {
            let grid = CoarseGrid::new(&plane, stride);
            let stored: Vec<Real> = grid.sampled(&image).collect();
            assert_eq!(stored.len(), grid.len());
            let mut restored = vec![0.0; image.len()];
            grid.add_interpolated(&stored, &mut restored);
            for (i, (restored, truth)) in restored.iter().zip(&image).enumerate().filter(|(i, _)| i / 48 < 12) {
                assert!((restored - truth).abs() <= error, "{i} with stride {stride}: {restored} instead of {truth}");
            }
            let again: Vec<Real> = grid.sampled(&restored).collect();
            again.iter().zip(&stored).for_each(|(a, b)| assert!((a - b).abs() < 1e-5));
        }
    }

    #[test]
    fn coarse_grid_loses_fine_detail_only() {
        let plane = plane(64, 8);
        let wave = |period: Real, phase: Real| -> Vec<Real> {
            (0..64 * 8).map(|k| ((k % 64) as Real * std::f64::consts::TAU as Real / period + phase).sin()).collect()
        };
        let lost = |period: Real, stride| {
            CoarseGrid::new(&plane, stride).lost_share(&[0.0, 1.0, 2.0].map(|phase| wave(period, phase)), true)
        };
        assert!(lost(64.0, 4) < 1e-4 && lost(4.0, 4) > 0.3 && lost(4.0, 1) == 0.0);
        assert_eq!(CoarseGrid::new(&plane, 4).lost_share(&[vec![0.5; 64 * 8]], true), 0.0);
    }

    #[test]
    fn every_image_size_has_a_grid() {
        for (width, height, stride) in [(1, 1, 4), (5, 3, 4), (7, 1, 3), (9, 9, 64)] {
            let grid = CoarseGrid::new(&plane(width, height), stride);
            let mut pixels = vec![0.0; width * height];
            grid.add_interpolated(&vec![2.0; grid.len()], &mut pixels);
            assert!(pixels.iter().all(|p| (p - 2.0).abs() < 1e-5), "{width} x {height}: {pixels:?}");
        }
    }
}
