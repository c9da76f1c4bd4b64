//! Metrics of spectra: SSIM, mean absolute error, PSNR, and the strongest direction (angle error and achievable rate).

use crate::{score_samples, single_measurement};
use pwrfgs_core::{
    Evaluation, Goal, Image, ImagePlane, JsonSchema, Measurement, Metric, Real, Result, Scope, Task, Values, ssim,
};
use serde::{Deserialize, Serialize};

/// Task and scope of a metric of spectra: one value per sample.
macro_rules! of_spectra {
    () => {
        fn tasks(&self) -> &'static [Task] {
            &[Task::Spectrum]
        }

        fn scope(&self) -> Scope {
            Scope::Sample
        }
    };
}

/// Structural similarity of predicted and measured spectrum; 1 if they are equal.
///
/// Key `ssim`. Uniform 7x7 windows, data range 1, sample covariance, mean over the image without its border of 3 px:
/// scikit-image's `structural_similarity(a, b, data_range=1)`, as in the released test. The prediction is clamped to
/// [0, 1]. The SSIM of the training loss has a Gaussian window and gives other values. Papers often print the median
/// without naming it; the report gives mean and median. Compare it with the baselines: neighbouring transmitters have
/// nearly equal spectra.
///
/// ```
/// # use pwrfgs_metrics as _;
/// # use pwrfgs_core::{Metric, Plugin};
/// Plugin::<dyn Metric>::parse("Ssim()")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Ssim {}

#[typetag::serde]
impl Metric for Ssim {
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        let values = score_samples(self, evaluation, |p, t| ssim::evaluation(&p.clamped(), t))?;
        Ok(single_measurement("ssim", "", Goal::Higher, values))
    }

    of_spectra!();
}

/// Mean absolute difference of predicted and measured pixels; the L₁ of eq. (9) with the prediction clamped to [0, 1].
///
/// Key `l1`. Use it together with SSIM: it detects a wrong overall level, to which SSIM is less sensitive.
///
/// ```
/// # use pwrfgs_metrics as _;
/// # use pwrfgs_core::{Metric, Plugin};
/// Plugin::<dyn Metric>::parse("L1()")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct L1 {}

#[typetag::serde]
impl Metric for L1 {
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        let values = score_samples(self, evaluation, |p, t| {
            let differences = p.pixels.iter().zip(&t.pixels).map(|(p, t)| (p.clamp(0.0, 1.0) - t).abs() as f64);
            differences.sum::<f64>() / p.pixels.len().max(1) as f64
        })?;
        Ok(single_measurement("l1", "", Goal::Lower, values))
    }

    of_spectra!();
}

/// Lower limit of the mean squared error; below the 8-bit rounding of measured spectra (about 1.3e-6).
const LEAST_ERROR: f64 = 1e-10;

/// Peak signal-to-noise ratio −10·log₁₀(mean squared error) in dB, for a peak of 1.
///
/// Key `psnr`. The prediction is clamped to [0, 1]. An exact prediction counts as 100 dB instead of infinity, so that
/// means are finite. Use it to compare with image quality in other fields.
///
/// ```
/// # use pwrfgs_metrics as _;
/// # use pwrfgs_core::{Metric, Plugin};
/// Plugin::<dyn Metric>::parse("Psnr()")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Psnr {}

#[typetag::serde]
impl Metric for Psnr {
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        let values = score_samples(self, evaluation, |p, t| {
            let squares = p.pixels.iter().zip(&t.pixels).map(|(p, t)| ((p.clamp(0.0, 1.0) - t) as f64).powi(2));
            let error = squares.sum::<f64>() / p.pixels.len().max(1) as f64;
            if error < LEAST_ERROR { -10.0 * LEAST_ERROR.log10() } else { -10.0 * error.log10() }
        })?;
        Ok(single_measurement("psnr", "dB", Goal::Higher, values))
    }

    of_spectra!();
}

/// Great-circle angle between the strongest directions of prediction and measurement, degrees.
///
/// Key `direction_error`. The angle is correct at the seam in azimuth and near the zenith, unlike a distance in pixels.
/// The strongest pixel is selected before clamping; ties take the first in row-major order. Two equally strong paths
/// make the angle jump, so use the median. `n/a` with the released projection, whose pixels have no angles.
///
/// ```
/// # use pwrfgs_metrics as _;
/// # use pwrfgs_core::{Metric, Plugin};
/// Plugin::<dyn Metric>::parse("DirectionError()")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DirectionError {}

#[typetag::serde]
impl Metric for DirectionError {
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        let plane = evaluation.plane;
        let values = if plane.angles.is_some() {
            score_samples(self, evaluation, |p, t| {
                match (strongest_direction(plane, p), strongest_direction(plane, t)) {
                    (Some(a), Some(b)) => angle_deg(a, b),
                    _ => f64::NAN,
                }
            })?
        } else {
            Values::NotApplicable("pixels of this projection have no angle".to_owned())
        };
        Ok(single_measurement("direction_error", "deg", Goal::Lower, values))
    }

    of_spectra!();
}

/// Returns the unit vector of the strongest pixel; `None` if the pixel has no direction.
fn strongest_direction(plane: &ImagePlane, image: &Image) -> Option<[f64; 3]> {
    let (best, width) = (image.argmax(), image.width.max(1));
    let direction = plane.direction((best % width) as Real, (best / width) as Real)?;
    Some(direction.map(|v| v as f64))
}

/// Returns the angle between two unit vectors, degrees; accurate for small angles, unlike the arc cosine.
fn angle_deg(a: [f64; 3], b: [f64; 3]) -> f64 {
    let cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let dot: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
    cross.iter().map(|c| c * c).sum::<f64>().sqrt().atan2(dot).to_degrees()
}

/// Rate with steering to the strongest predicted direction, relative to the rate of the true strongest direction.
///
/// η(ρ) = log₂(1 + ρ·P(predicted direction)) / log₂(1 + ρ·max P), eq. (15), in [0, 1]; ρ is the transmit
/// signal-to-noise ratio. Key `eta_0db` for 0 dB, and so on. The direction is the strongest pixel of the prediction
/// before clamping, which would create ties; ties take the first in row-major order. If the measured spectrum is zero,
/// η is 1. The mean training spectrum alone has 0.916 on the measured set s23, so compare η with the baselines.
///
/// ```
/// # use pwrfgs_metrics as _;
/// # use pwrfgs_core::{Metric, Plugin};
/// Plugin::<dyn Metric>::parse("RateRatio(snr_db: 10.0)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RateRatio {
    /// Transmit signal-to-noise ratio ρ in dB, −100 to 100; the paper reports 0.
    pub snr_db: f64,
}

impl RateRatio {
    /// Returns the ratio η, eq. (15), of a prediction; 1 if the measured spectrum is zero.
    fn ratio(&self, prediction: &Image, truth: &Image) -> f64 {
        let snr = 10f64.powf(self.snr_db / 10.0);
        let rate = |image: &Image| truth.pixels.get(image.argmax()).map_or(0.0, |p| (snr * *p as f64).ln_1p());
        let best = rate(truth);
        if best > 0.0 { rate(prediction) / best } else { 1.0 }
    }
}

#[typetag::serde]
impl Metric for RateRatio {
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        let values = score_samples(self, evaluation, |p, t| self.ratio(p, t))?;
        let snr = self.snr_db + 0.0; // no `-0` in the name
        Ok(single_measurement(&format!("eta_{snr}db"), "", Goal::Higher, values))
    }

    of_spectra!();

    fn check(&self) -> Result<(), String> {
        if !(-100.0..=100.0).contains(&self.snr_db) {
            return Err(format!("`snr_db` is {}; give a ratio between -100 and 100 dB", self.snr_db));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{self, of_pictures, of_plane, plane, spots, value};
    use pwrfgs_core::Plugin;

    #[test]
    fn ssim_of_constant_images_has_closed_form() {
        let constant = |v| Image { width: 9, height: 8, pixels: vec![v; 72] };
        let measured = fixture::value(&fixture::of_pictures(&Ssim {}, &constant(0.25), &constant(0.5)));
        let expected = (2.0 * 0.25 * 0.5 + 1e-4) / (0.25 * 0.25 + 0.5 * 0.5 + 1e-4);
        assert!((measured - expected).abs() < 1e-9);
        let too_bright = fixture::value(&fixture::of_pictures(&Ssim {}, &constant(7.0), &constant(1.0)));
        assert!((too_bright - 1.0).abs() < 1e-12, "a prediction is clamped first");
    }

    #[test]
    fn differences_are_averaged_after_clamping() {
        let (p, t) = (spots(2, 2, &[(0, 0, 3.0), (1, 1, -2.0)]), spots(2, 2, &[(0, 0, 0.5), (1, 0, 0.25)]));
        assert_eq!(value(&of_pictures(&L1 {}, &p, &t)), (0.5 + 0.25) / 4.0);
    }

    #[test]
    fn psnr_averages_squares_and_is_finite_for_exact_image() {
        let (p, t) = (spots(2, 2, &[(0, 0, 0.5)]), spots(2, 2, &[(0, 0, 0.25), (1, 0, 0.25)]));
        let expected = -10.0 * (0.125f64 / 4.0).log10();
        assert!((value(&of_pictures(&Psnr {}, &p, &t)) - expected).abs() < 1e-12);
        assert_eq!(value(&of_pictures(&Psnr {}, &t, &t)), 100.0);
    }

    fn error(a: (usize, usize), b: (usize, usize)) -> f64 {
        let peak = |(x, y)| spots(360, 90, &[(x, y, 1.0)]);
        value(&of_pictures(&DirectionError {}, &peak(a), &peak(b)))
    }

    #[test]
    fn angles_are_measured_on_the_sphere() {
        let close = |a: f64, b: f64| assert!((a - b).abs() < 2e-4, "{a} instead of {b}");
        close(error((10, 20), (10, 20)), 0.0);
        close(error((359, 0), (1, 0)), 2.0); // across the seam
        close(error((7, 30), (7, 75)), 45.0);
        close(error((0, 89), (180, 89)), 2.0); // over the zenith
        close(error((0, 60), (90, 60)), (0.75f64).acos().to_degrees());
    }

    #[test]
    fn direction_error_requires_angles() {
        let peak = spots(4, 3, &[(1, 1, 1.0)]);
        let blind = ImagePlane { angles: None, ..plane(4, 3) };
        let measured = of_plane(&DirectionError {}, &peak, &peak, &blind);
        assert!(matches!(measured.values, Values::NotApplicable(_)));
    }

    #[test]
    fn rate_ratio_divides_both_rates() {
        let truth = spots(4, 3, &[(1, 1, 1.0), (2, 2, 0.5)]);
        let prediction = spots(4, 3, &[(1, 1, 1.5), (2, 2, 1.6)]);
        let measured = of_pictures(&RateRatio::default(), &prediction, &truth);
        assert_eq!(measured.key, "eta_0db");
        assert!((value(&measured) - 1.5f64.log2()).abs() < 1e-12, "both peaks clamp to 1: the unclamped one decides");
        let measured = of_pictures(&RateRatio { snr_db: 10.0 }, &prediction, &truth);
        assert_eq!(measured.key, "eta_10db");
        assert!((value(&measured) - 6f64.ln() / 11f64.ln()).abs() < 1e-12);
        assert_eq!(value(&of_pictures(&RateRatio::default(), &truth, &truth)), 1.0);
    }

    #[test]
    fn rate_ratio_uses_first_of_equal_peaks() {
        let truth = spots(4, 3, &[(1, 1, 1.0), (2, 0, 0.25)]);
        let prediction = spots(4, 3, &[(1, 1, 0.7), (2, 0, 0.7)]);
        assert!((value(&of_pictures(&RateRatio::default(), &prediction, &truth)) - 1.25f64.log2()).abs() < 1e-12);
    }

    #[test]
    fn rate_ratio_of_zero_spectrum_is_one() {
        let (dark, prediction) = (spots(4, 3, &[]), spots(4, 3, &[(1, 1, 0.7)]));
        assert_eq!(value(&of_pictures(&RateRatio::default(), &prediction, &dark)), 1.0);
        assert_eq!(value(&of_pictures(&RateRatio::default(), &spots(0, 0, &[]), &spots(0, 0, &[]))), 1.0);
    }

    #[test]
    fn rejects_snr_out_of_range() {
        for snr in ["NaN", "inf", "-101.0"] {
            let why = Plugin::<dyn Metric>::parse(&format!("RateRatio(snr_db: {snr})")).unwrap_err();
            assert!(why.contains("between -100 and 100"), "{why}");
        }
        let key = of_pictures(&RateRatio { snr_db: -0.0 }, &spots(1, 1, &[]), &spots(1, 1, &[])).key;
        assert_eq!(key, "eta_0db");
    }
}
