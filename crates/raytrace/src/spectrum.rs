//! Spatial spectrum: beamforming power of an array over directions, as an image.

#[cfg(test)]
mod tests;

use crate::Complex;
use crate::array::{Array, mean_power};
use glam::DVec3;
use pulp::{Arch, Simd, WithSimd};
use pwrfgs_core::AngleAxis;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Contrast relative to the largest value below which a spectrum is constant up to rounding.
const NO_CONTRAST: f64 = 1e-12;
/// Columns of a spectrum: azimuths 0 to 359 degrees.
pub const WIDTH: usize = 360;
/// Rows of a spectrum: elevations 0 to 89 degrees.
pub const HEIGHT: usize = 90;
/// Directions are padded to a multiple of this, the widest vector of any processor.
const LANES: usize = 8;

/// Quantity in the pixels of a spectrum.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum SpectrumKind {
    /// Amplitude |aᴴh|/K, stretched per spectrum from its smallest value (black) to its largest (white). As in the
    /// measured files, absolute power is lost.
    #[default]
    Amplitude,
    /// Power |aᴴh|²/K, eq. (2) of the paper, divided by the largest value of each spectrum.
    Power,
}

/// Spectrum as an image, with its absolute scale.
#[derive(Clone, Debug, PartialEq)]
pub struct Spectrum {
    /// 8-bit grey, row-major: ⌊255 v⌋ as in the measured files. All black without a signal, and, for
    /// [`SpectrumKind::Amplitude`], if all directions are equally strong (a single antenna).
    pub pixels: Vec<u8>,
    /// Smallest value before stretching.
    pub low: f64,
    /// Largest value before stretching.
    pub high: f64,
    /// Mean of |h|² over the elements: the path gain, from which RSSI follows.
    pub power: f64,
}

/// Beamformer that steers an array to every pixel of a spectrum.
///
/// Column c is azimuth 360 c/width degrees, row r elevation 90 r/height degrees above the plane of the array, in the
/// receiver frame: the grid of the projector `Mercator`. The steering vector of a direction u is aₖ = exp(+j2π/λ pₖ·u).
/// For a grid of antennas aᴴh is a polynomial in two phase factors, so a pixel costs K complex multiply-adds, without a
/// table of steering vectors. Given positions cost K sines and cosines per pixel.
#[derive(Clone, Debug)]
pub struct Beamformer {
    steering: Steering,
    pixels: usize,
}

impl Beamformer {
    /// Creates a beamformer for images of `width` columns and `height` rows.
    pub fn new(array: &Array, width: usize, height: usize) -> Self {
        let axis = |degrees: f64, pixels: usize| AngleAxis { first: 0.0, step: degrees / pixels as f64 };
        Self::on_grid(array, (width, axis(360.0, width)), (height, axis(90.0, height)))
    }

    /// Creates a beamformer for any regular grid: columns and their azimuths, rows and their elevations.
    fn on_grid(array: &Array, (width, azimuth): (usize, AngleAxis), (height, elevation): (usize, AngleAxis)) -> Self {
        let angle = |axis: AngleAxis, pixel: usize| (axis.first + axis.step * pixel as f64).to_radians();
        let directions = (0..height).flat_map(|row| {
            let (sin, cos) = angle(elevation, row).sin_cos();
            (0..width).map(move |column| {
                let azimuth = angle(azimuth, column);
                DVec3::new(cos * azimuth.cos(), cos * azimuth.sin(), sin)
            })
        });
        Self { steering: Steering::new(directions, array), pixels: width * height }
    }

    /// Returns |aᴴh|/K at every pixel, row-major, from the channel h of the K elements.
    pub fn amplitude(&self, channel: &[Complex]) -> Vec<f64> {
        let mut amplitude = self.steering.magnitude(channel);
        amplitude.truncate(self.pixels);
        let scale = 1.0 / channel.len().max(1) as f64;
        amplitude.iter_mut().for_each(|a| *a *= scale);
        amplitude
    }

    /// Returns the spectrum of the channel h `[K]` as an image.
    pub fn spectrum(&self, channel: &[Complex], kind: SpectrumKind) -> Spectrum {
        let mut values = self.amplitude(channel);
        if kind == SpectrumKind::Power {
            let elements = channel.len() as f64;
            values.iter_mut().for_each(|a| *a = *a * *a * elements);
        }
        let (low, high) = value_range(&values);
        let black = match kind {
            SpectrumKind::Amplitude => low,
            SpectrumKind::Power => 0.0,
        };
        Spectrum { pixels: stretch_to_bytes(&values, black, high), low, high, power: mean_power(channel) }
    }
}

/// Returns the smallest and largest value; zeros if there are none.
fn value_range(values: &[f64]) -> (f64, f64) {
    let first = values.first().copied().unwrap_or(0.0);
    values.iter().fold((first, first), |(low, high), v| (low.min(*v), high.max(*v)))
}

/// Returns the values stretched to bytes, ⌊255 (v - black)/(white - black)⌋; all 0 without contrast.
fn stretch_to_bytes(values: &[f64], black: f64, white: f64) -> Vec<u8> {
    let contrast = white - black;
    if contrast.is_nan() || contrast <= NO_CONTRAST * white {
        return vec![0; values.len()];
    }
    values.iter().map(|v| ((v - black) / contrast * 255.0) as u8).collect()
}

/// Steering to many directions: aᴴh.
#[derive(Clone, Debug)]
enum Steering {
    /// Grid of antennas: phase factors between neighbours in x and in y per direction, and the number of columns.
    Grid { x: ComplexLanes, y: ComplexLanes, columns: usize },
    /// Any antennas: their positions `[K]`, wavelengths, and the directions.
    Positions { positions: Vec<DVec3>, directions: Vec<DVec3> },
}

/// Complex numbers as separate real and imaginary arrays.
#[derive(Clone, Debug, Default)]
struct ComplexLanes {
    re: Vec<f64>,
    im: Vec<f64>,
}

impl ComplexLanes {
    /// Appends a number.
    fn push(&mut self, value: Complex) {
        self.re.push(value.re);
        self.im.push(value.im);
    }
}

impl Steering {
    /// Creates the steering of `array`; `directions` are unit vectors in the receiver frame.
    fn new(directions: impl Iterator<Item = DVec3>, array: &Array) -> Self {
        if !array.positions_wavelengths.is_empty() {
            return Self::Positions { positions: array.offsets(1.0), directions: directions.collect() };
        }
        let spacing = array.spacing_wavelengths;
        let (mut x, mut y) = (ComplexLanes::default(), ComplexLanes::default());
        for direction in directions {
            x.push(Complex::cis(-TAU * spacing * direction.x));
            y.push(Complex::cis(-TAU * spacing * direction.y));
        }
        let padded = x.re.len().next_multiple_of(LANES);
        for column in [&mut x.re, &mut x.im, &mut y.re, &mut y.im] {
            column.resize(padded, 0.0);
        }
        Self::Grid { x, y, columns: array.columns }
    }

    /// Returns |aᴴh| for every direction, h being the `channel` `[K]`; for a grid, padded to a multiple of `LANES`.
    fn magnitude(&self, channel: &[Complex]) -> Vec<f64> {
        match self {
            Self::Grid { x, y, columns } => {
                let mut magnitude = vec![0.0; x.re.len()];
                Arch::new().dispatch(Horner { x, y, channel, columns: *columns, magnitude: &mut magnitude });
                magnitude
            }
            Self::Positions { positions, directions } => {
                let steered =
                    |u: &DVec3| positions.iter().zip(channel).map(|(p, h)| Complex::cis(-TAU * p.dot(*u)) * h).sum();
                directions.iter().map(|u| Complex::norm(steered(u))).collect()
            }
        }
    }
}

/// Horner evaluation of a grid, in two variables; the phase of its corner relative to its centre is omitted, since it does
/// not change the magnitude.
struct Horner<'a> {
    x: &'a ComplexLanes,
    y: &'a ComplexLanes,
    channel: &'a [Complex],
    columns: usize,
    magnitude: &'a mut [f64],
}

impl WithSimd for Horner<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { x, y, .. } = self;
        let x = S::as_simd_f64s(&x.re).0.iter().zip(S::as_simd_f64s(&x.im).0);
        let y = S::as_simd_f64s(&y.re).0.iter().zip(S::as_simd_f64s(&y.im).0);
        let zero = simd.splat_f64s(0.0);
        for (out, (x, y)) in S::as_mut_simd_f64s(self.magnitude).0.iter_mut().zip(x.zip(y)) {
            let mut sum = (zero, zero);
            for row in self.channel.chunks(self.columns.max(1)).rev() {
                let mut inner = (zero, zero);
                for value in row.iter().rev() {
                    let value = (simd.splat_f64s(value.re), simd.splat_f64s(value.im));
                    inner = multiply_add(simd, inner, x, value);
                }
                sum = multiply_add(simd, sum, y, inner);
            }
            let squared = simd.add_f64s(simd.mul_f64s(sum.0, sum.0), simd.mul_f64s(sum.1, sum.1));
            *out = simd.sqrt_f64s(squared);
        }
    }
}

/// Real and imaginary parts of a vector of complex numbers.
type SimdComplex<S> = (<S as Simd>::f64s, <S as Simd>::f64s);

/// Returns a·b + c with separate rounding of multiplication and addition, so that all processors give identical results.
#[inline(always)]
fn multiply_add<S: Simd>(simd: S, a: SimdComplex<S>, b: (&S::f64s, &S::f64s), c: SimdComplex<S>) -> SimdComplex<S> {
    let re = simd.sub_f64s(simd.mul_f64s(a.0, *b.0), simd.mul_f64s(a.1, *b.1));
    let im = simd.add_f64s(simd.mul_f64s(a.0, *b.1), simd.mul_f64s(a.1, *b.0));
    (simd.add_f64s(re, c.0), simd.add_f64s(im, c.1))
}
