//! The spatial spectrum: how strongly an array hears each direction, and the picture made of it.

mod kernel;
#[cfg(test)]
mod tests;

use crate::array::Array;
use crate::wave::Complex;
use kernel::Steering;
use pwrfgs_core::Axis;
use serde::{Deserialize, Serialize};

/// A picture whose values differ by less than this share of the largest shows nothing but rounding.
const NO_CONTRAST: f64 = 1e-12;

/// What a picture holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum SpectrumKind {
    /// The amplitude |aᴴh|/K; each picture stretched from its smallest value, black, to its largest, white. What the
    /// measured files hold: absolute power is lost.
    #[default]
    Amplitude,
    /// The power |aᴴh|²/K, eq. (2) of the paper; each picture divided by its largest value.
    Power,
}

/// One spectrum as a picture, and what the picture lost.
#[derive(Clone, Debug, PartialEq)]
pub struct Spectrum {
    /// 8-bit grey, row-major: ⌊255 v⌋ as in the measured files. All black where nothing was received, and, for
    /// [`SpectrumKind::Amplitude`], where all directions are equally strong (a single antenna).
    pub pixels: Vec<u8>,
    /// Smallest value before the picture was stretched.
    pub low: f64,
    /// Largest value before the picture was stretched.
    pub high: f64,
    /// Mean of |h|² over the elements: the path gain, from which RSSI follows.
    pub power: f64,
}

/// Steers an array to every pixel of a picture.
///
/// Column c is azimuth 360 c/width degrees, row r elevation 90 r/height degrees above the plane of the array, in the
/// receiver frame: the grid of the projector `Mercator`. The steering vector of a direction u is aₖ = exp(+j2π/λ pₖ·u).
/// On a uniform array aᴴh is a polynomial in two phase factors, so a pixel costs K complex multiply-adds and no table of
/// steering vectors is kept.
#[derive(Clone, Debug)]
pub struct Beamformer {
    steering: Steering,
    columns: usize,
    pixels: usize,
}

impl Beamformer {
    /// For pictures of `width` columns and `height` rows.
    pub fn new(array: &Array, width: usize, height: usize) -> Self {
        let axis = |degrees: f64, pixels: usize| Axis { first: 0.0, step: degrees / pixels as f64 };
        Self::on_grid(array, (width, axis(360.0, width)), (height, axis(90.0, height)))
    }

    /// For any regular grid: columns and the azimuth of each, rows and the elevation of each.
    fn on_grid(array: &Array, (width, azimuth): (usize, Axis), (height, elevation): (usize, Axis)) -> Self {
        let angle = |axis: Axis, pixel: usize| (axis.first + axis.step * pixel as f64).to_radians();
        let directions = (0..height).flat_map(|row| {
            let (sin, cos) = angle(elevation, row).sin_cos();
            (0..width).map(move |column| {
                let azimuth = angle(azimuth, column);
                glam::DVec3::new(cos * azimuth.cos(), cos * azimuth.sin(), sin)
            })
        });
        let steering = Steering::new(directions, array.spacing_wavelengths);
        Self { steering, columns: array.columns, pixels: width * height }
    }

    /// |aᴴh|/K at every pixel, row-major, from the channel h of the K elements.
    pub fn amplitude(&self, channel: &[Complex]) -> Vec<f64> {
        let mut amplitude = self.steering.magnitude(channel, self.columns);
        amplitude.truncate(self.pixels);
        let scale = 1.0 / channel.len().max(1) as f64;
        amplitude.iter_mut().for_each(|a| *a *= scale);
        amplitude
    }

    /// The picture of the channel h.
    pub fn spectrum(&self, channel: &[Complex], kind: SpectrumKind) -> Spectrum {
        let elements = channel.len().max(1) as f64;
        let mut values = self.amplitude(channel);
        if kind == SpectrumKind::Power {
            values.iter_mut().for_each(|a| *a = *a * *a * elements);
        }
        let (low, high) = range(&values);
        let black = match kind {
            SpectrumKind::Amplitude => low,
            SpectrumKind::Power => 0.0,
        };
        let power = channel.iter().map(Complex::norm_sqr).sum::<f64>() / elements;
        Spectrum { pixels: stretch(&values, black, high), low, high, power }
    }
}

/// Smallest and largest value; zeros for none.
fn range(values: &[f64]) -> (f64, f64) {
    let first = values.first().copied().unwrap_or(0.0);
    values.iter().fold((first, first), |(low, high), v| (low.min(*v), high.max(*v)))
}

/// ⌊255 (v - black)/(white - black)⌋.
fn stretch(values: &[f64], black: f64, white: f64) -> Vec<u8> {
    let contrast = white - black;
    if contrast.is_nan() || contrast <= NO_CONTRAST * white {
        return vec![0; values.len()];
    }
    values.iter().map(|v| ((v - black) / contrast * 255.0) as u8).collect()
}
