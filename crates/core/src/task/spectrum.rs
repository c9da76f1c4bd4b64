//! Spatial spectra `[L, H, W]`: images of the receiver's sky; 1 is the strongest direction.

use super::{Ceiling, Columns, Description, Headline, Intervals};
use crate::{Image, Number, Real, Result, Sampling, Spectra, ssim};
use std::borrow::Cow;

pub(super) static SPECTRUM: Description = Description {
    name: "spectrum",
    singular: "spectrum",
    plural: "spectra",
    counted: ["spectrum", "spectra"],
    headline: Headline {
        key: "ssim",
        short: "SSIM",
        name: "SSIM",
        higher: true,
        best: Some(1.0),
        columns: ["ssim_mean", "ssim_median", "eta_0db"],
    },
    main_metrics: ["ssim", "eta_0db", "gaussians", "latency_total_ms"],
    ceiling: Ceiling { note: "repeatability of two measured spectra at one position", share: 1.0 },
    method: "readout: Magnitude",
    level_name: ["strongest level of the spectrum", ""],
    mean_name: "mean spectrum",
    comparison: "methods",
    intervals: Some(Intervals { columns: &["coverage_90", "width_90", "ssim_bound_90"], values: "pixels", unit: "" }),
    has_path_loss: false,
    has_pixels: true,
    is_scalar: false,
    is_complex: false,
    level: |image| image.pixels[image.argmax()] as f64,
    score: |prediction, truth| ssim::evaluation(&prediction.clamped(), truth),
    likeness: |prediction, truth| ssim::evaluation(&prediction.clamped(), truth),
    shape: |(width, height)| vec![height, width],
    size: |shape| (shape[1], shape[0]),
    size_text: |(width, height)| Some(format!("{width} x {height} pixels")),
};

impl Columns for Spectra {
    fn len(&self) -> usize {
        Self::len(self)
    }

    fn size(&self) -> (usize, usize) {
        (self.width(), self.height())
    }

    fn image(&self, i: usize) -> Image {
        Self::image(self, i)
    }

    fn sampled(&self, i: usize, sampling: Sampling, out: &mut [Real]) {
        Self::sampled(self, i, sampling, out);
    }

    fn add(&self, i: usize, weight: f64, sum: &mut [f64]) {
        Self::add(self, i, weight, sum);
    }

    fn number(&self) -> Number {
        Self::number(self)
    }

    fn raw(&self, i: usize) -> Cow<'_, [u8]> {
        Self::raw(self, i)
    }

    fn bytes_in_memory(&self) -> usize {
        Self::bytes_in_memory(self)
    }

    fn check(&self) -> Result<()> {
        Self::check(self)
    }
}
