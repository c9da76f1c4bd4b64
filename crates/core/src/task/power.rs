//! Received powers `[L]`, dBm.

use super::{Ceiling, Columns, Description, Headline, Intervals};
use crate::{Image, Real};

pub(super) static POWER: Description = Description {
    name: "power",
    singular: "received power",
    plural: "received powers",
    counted: ["link", "links"],
    headline: Headline {
        key: "power_error_db",
        short: "error",
        name: "error [dB]",
        higher: false,
        best: Some(0.0),
        columns: ["power_error_db_mean", "power_error_db_median", "power_error_db_p90"],
    },
    main_metrics: ["power_error_db", "gaussians", "model_bytes", "latency_total_ms"],
    // Both readings are noisy, and independent errors of equal size add up to √2 times that size.
    ceiling: Ceiling {
        note: "error of a perfect predictor of the mean reading: difference of two readings at one position over √2",
        share: std::f64::consts::FRAC_1_SQRT_2,
    },
    method: "readout: ReceivedPower(sky_deg: 10)",
    level_name: ["received power", "dBm"],
    mean_name: "mean of the receiver",
    comparison: "methods-powers",
    intervals: Some(Intervals { columns: &["lower_dbm_90", "upper_dbm_90"], values: "links", unit: " dB" }),
    has_path_loss: true,
    has_pixels: false,
    is_scalar: true,
    is_complex: false,
    level: |image| image.pixels[0] as f64,
    score: |prediction, truth| f64::from((prediction.pixels[0] - truth.pixels[0]).abs() as f32),
    likeness: |prediction, truth| -(prediction.pixels[0] as f64 - truth.pixels[0] as f64).abs(),
    shape: |_| Vec::new(),
    size: |_| (1, 1),
    size_text: |_| None,
};

impl Columns for Vec<Real> {
    fn len(&self) -> usize {
        Self::len(self)
    }

    fn size(&self) -> (usize, usize) {
        (1, 1)
    }

    fn image(&self, i: usize) -> Image {
        Image { width: 1, height: 1, pixels: vec![self[i]] }
    }

    fn bytes_in_memory(&self) -> usize {
        size_of_val(self.as_slice())
    }

    fn antennas(&self) -> Option<usize> {
        Some(1)
    }

    fn fault(&self) -> Option<String> {
        if self.is_empty() {
            return Some("no received powers; give at least one".into());
        }
        self.iter().position(|v| !v.is_finite()).map(|i| format!("powers[{i}] is {}; give dBm", self[i]))
    }
}
