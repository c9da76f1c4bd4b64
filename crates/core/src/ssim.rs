//! Structural similarity of two spectra: the evaluation form and the training form.
//!
//! Both are the mean over windows of (2μ₁μ₂+C₁)(2σ₁₂+C₂) / ((μ₁²+μ₂²+C₁)(σ₁²+σ₂²+C₂)) with C₁ = 0.01², C₂ = 0.03²
//! (values in [0, 1]). They differ in the window, and strongly in value (0.447 and 0.564 for one pair of spectra), so
//! always state the form:
//!
//! * [`evaluation`]: uniform 7x7 windows inside the image, sample covariance (49/48); equal to scikit-image's
//!   `structural_similarity(a, b, data_range=1)`.
//! * [`training()`], the `SSIM` of eq. (9), with its derivative: 11 Gaussian taps of σ = 1.5 px about every pixel, zeros
//!   beyond the border, covariance `E[xy] − E[x]·E[y]`; as in the released training.
//!
//! Neither wraps in azimuth. Images are row-major `[height, width]`.

mod training;

use crate::Image;
use training::{C1, C2};
pub use training::{Window, training};

/// Returns the SSIM of scikit-image for two images of the same size; computed in double precision.
///
/// scikit-image rejects images with a side below 7 px; here the window shrinks to the largest odd square that fits. Two
/// images without pixels have SSIM 1.
pub fn evaluation(a: &Image, b: &Image) -> f64 {
    assert_eq!((a.width, a.height), (b.width, b.height), "SSIM compares pictures of one size");
    assert_eq!((a.pixels.len(), b.pixels.len()), (a.width * a.height, a.width * a.height), "pixels fill the picture");
    let (width, height) = (a.width, a.height);
    let Some(window) = [7, 5, 3, 1].into_iter().find(|w| *w <= width.min(height)) else { return 1.0 };
    // Sums over `window` rows, column by column, of x, y, x², y², xy.
    let mut columns = [(); 5].map(|()| vec![0.0f64; width]);
    let (mut total, columns_out) = (0.0, width - window + 1);
    for y in 0..height {
        let rows = |y: usize| (&a.pixels[y * width..][..width], &b.pixels[y * width..][..width]);
        add_row(&mut columns, rows(y), 1.0);
        if y >= window {
            add_row(&mut columns, rows(y - window), -1.0);
        }
        if y + 1 >= window {
            total += sum_of_row(&columns, window);
        }
    }
    total / (columns_out * (height - window + 1)) as f64
}

/// Adds `sign` times x, y, x², y², xy of one row to the column sums.
fn add_row(columns: &mut [Vec<f64>; 5], (a, b): (&[crate::Real], &[crate::Real]), sign: f64) {
    let [x1, x2, x11, x22, x12] = columns;
    for (i, (a, b)) in a.iter().zip(b).enumerate() {
        let (a, b) = (*a as f64, *b as f64);
        x1[i] += sign * a;
        x2[i] += sign * b;
        x11[i] += sign * (a * a);
        x22[i] += sign * (b * b);
        x12[i] += sign * (a * b);
    }
}

/// Returns the sum of the SSIM of all windows of one row, given the column sums.
fn sum_of_row(columns: &[Vec<f64>; 5], window: usize) -> f64 {
    let n = (window * window) as f64;
    let sample = if window > 1 { n / (n - 1.0) } else { 1.0 };
    let mut sums = [0.0; 5];
    let mut total = 0.0;
    for right in 0..columns[0].len() {
        for k in 0..5 {
            sums[k] += columns[k][right];
            if right >= window {
                sums[k] -= columns[k][right - window];
            }
        }
        if right + 1 >= window {
            let [m1, m2, e11, e22, e12] = [sums[0] / n, sums[1] / n, sums[2] / n, sums[3] / n, sums[4] / n];
            let variances = sample * ((e11 - m1 * m1) + (e22 - m2 * m2));
            let covariance = sample * (e12 - m1 * m2);
            total += (2.0 * m1 * m2 + C1) * (2.0 * covariance + C2) / ((m1 * m1 + m2 * m2 + C1) * (variances + C2));
        }
    }
    total
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Real;

    fn trained(a: &Image, b: &Image) -> f64 {
        training(&a.pixels, &b.pixels, (a.width, a.height), &Window::default()).0 as f64
    }

    /// Creates an image that Python can reproduce: bytes of a hash of the position, averaged with a ramp if `ramp`.
    fn picture(width: usize, height: usize, seed: u64, ramp: bool) -> Image {
        let pixel = |i: usize| {
            let (x, y) = ((i % width) as u64, (i / width) as u64);
            let hash = ((x * 7919 + y * 104_729 + seed * 1_299_709).wrapping_mul(2_654_435_761) % (1 << 32)) >> 24;
            let noise = hash as f64 / 255.0;
            (if ramp { 0.5 * noise + 0.5 * (x as f64 / width as f64) } else { noise }) as Real
        };
        Image { width, height, pixels: (0..width * height).map(pixel).collect() }
    }

    #[test]
    fn ssim_matches_scikit_image_and_scipy() {
        // width, height, ramp, skimage.metrics.structural_similarity(data_range=1), scipy convolve1d (zero padding)
        let known = [
            (7, 7, false, -0.311_215_119_881, 0.247_837_366_820),
            (7, 7, true, 0.280_773_196_175, 0.626_314_718_809),
            (9, 16, false, -0.319_688_485_290, 0.071_910_652_571),
            (9, 16, true, 0.169_158_601_237, 0.439_479_811_098),
            (40, 23, false, -0.322_458_835_732, -0.154_219_487_589),
            (40, 23, true, -0.265_594_330_924, 0.007_293_166_073),
            (360, 90, false, -0.325_195_483_948, -0.290_892_582_326),
            (360, 90, true, -0.305_138_487_355, -0.240_999_383_803),
        ];
        for (width, height, ramp, expected_evaluation, expected_training) in known {
            let (a, b) = (picture(width, height, 1, ramp), picture(width, height, 2, ramp));
            let found = evaluation(&a, &b);
            assert!((found - expected_evaluation).abs() < 1e-6, "{width}x{height}: {found}");
            let found = trained(&a, &b);
            assert!((found - expected_training).abs() < 2e-6, "{width}x{height}: {found}");
        }
    }

    #[test]
    fn ssim_of_measured_spectra_matches_known_values() {
        let Some(folder) = crate::testing::shared("data/s23/spectrum") else { return };
        let read = |id: &str| {
            let picture = image::open(folder.join(format!("{id}.png"))).unwrap().into_luma8();
            Image::from_bytes(picture.width() as usize, picture.height() as usize, picture.as_raw())
        };
        let (a, b) = (read("00001"), read("00002"));
        assert!((evaluation(&a, &b) - 0.447_368).abs() < 1e-6);
        assert!((trained(&a, &b) - 0.564_120).abs() < 1e-6);
    }

    #[test]
    fn ssim_of_equal_images_is_one_at_any_size() {
        for (width, height) in [(0, 0), (1, 1), (2, 9), (6, 6), (7, 7), (30, 11)] {
            let a = picture(width, height, 3, true);
            assert_eq!(evaluation(&a, &a), 1.0, "{width}x{height}");
            assert!((trained(&a, &a) - 1.0).abs() < 1e-5, "{width}x{height}");
        }
    }

    #[test]
    fn small_image_uses_one_ssim_window() {
        let (a, b) = (picture(3, 3, 1, false), picture(3, 3, 2, false));
        let mean = |f: &dyn Fn(usize) -> f64| (0..9).map(f).sum::<f64>() / 9.0;
        let (x, y) = (|i: usize| a.pixels[i] as f64, |i: usize| b.pixels[i] as f64);
        let (m1, m2) = (mean(&x), mean(&y));
        let covariance = |f: &dyn Fn(usize) -> f64| 9.0 / 8.0 * mean(f);
        let v1 = covariance(&|i| (x(i) - m1).powi(2));
        let v2 = covariance(&|i| (y(i) - m2).powi(2));
        let v12 = covariance(&|i| (x(i) - m1) * (y(i) - m2));
        let expected = (2.0 * m1 * m2 + C1) * (2.0 * v12 + C2) / ((m1 * m1 + m2 * m2 + C1) * (v1 + v2 + C2));
        assert!((evaluation(&a, &b) - expected).abs() < 1e-12);
    }
}
