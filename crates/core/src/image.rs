//! `Image` and `ImagePlane`: pixels, and their directions.

use crate::{JsonSchema, Real, consts};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Observation as an array of numbers, row-major `[height, width]`: a spatial spectrum, in which 1 is the strongest
/// direction, or a power or channel as [`Columns`](crate::Columns) describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Number of columns (azimuth of a spectrum).
    pub width: usize,
    /// Number of rows (elevation of a spectrum).
    pub height: usize,
    /// Pixel values, `[height · width]`.
    pub pixels: Vec<Real>,
}

impl Image {
    /// Creates an image of zeros.
    pub fn zeros(width: usize, height: usize) -> Self {
        Self { width, height, pixels: vec![0.0; width * height] }
    }

    /// Converts 8-bit grey values: value/255.
    ///
    /// # Panics
    /// If `bytes` do not fill the image.
    pub fn from_bytes(width: usize, height: usize, bytes: &[u8]) -> Self {
        assert_eq!(bytes.len(), width * height, "an image has width times height pixels");
        Self { width, height, pixels: bytes.iter().map(|&b| Real::from(b) / 255.0).collect() }
    }

    /// Converts to 8-bit grey values: clamped to [0, 1], times 255, rounded.
    pub fn to_bytes(&self) -> Vec<u8> {
        self.pixels.iter().map(|p| (p.clamp(0.0, 1.0) * 255.0).round() as u8).collect()
    }

    /// Returns a copy with every pixel clamped to [0, 1], for metrics and figures.
    pub fn clamped(&self) -> Self {
        Self { pixels: self.pixels.iter().map(|p| p.clamp(0.0, 1.0)).collect(), ..*self }
    }

    /// Returns the index of the strongest pixel; ties take the first in row-major order. 0 without pixels.
    pub fn argmax(&self) -> usize {
        let mut best = 0;
        for (i, p) in self.pixels.iter().enumerate() {
            if *p > self.pixels[best] {
                best = i;
            }
        }
        best
    }
}

/// Angle in degrees as a linear function of a pixel coordinate: `first + step · pixel`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AngleAxis {
    /// Angle at pixel 0, degrees.
    pub first: f64,
    /// Angle per pixel, degrees.
    pub step: f64,
}

/// Elevations of the rows of a spectrum, degrees in the receiver frame. Row r of H is at first + r · (last − first)/H:
/// the bottom row is one step before `last`, as the last column is one step before 360° of azimuth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(inline, with = "(f64, f64)", title = "two numbers")]
#[serde(from = "(f64, f64)", into = "(f64, f64)")]
pub struct Elevation {
    /// Elevation of the top row, degrees.
    pub first: f64,
    /// Elevation one step beyond the bottom row, degrees.
    pub last: f64,
}

impl From<(f64, f64)> for Elevation {
    fn from((first, last): (f64, f64)) -> Self {
        Self { first, last }
    }
}

impl From<Elevation> for (f64, f64) {
    fn from(elevation: Elevation) -> Self {
        (elevation.first, elevation.last)
    }
}

impl Elevation {
    /// Hemisphere in front of the receiver, top row in the plane of the array, as in the measured spectra.
    pub const UPPER: Self = Self { first: 0.0, last: 90.0 };

    /// Returns the axis over `height` rows.
    pub fn axis(self, height: usize) -> AngleAxis {
        AngleAxis { first: self.first, step: (self.last - self.first) / height as f64 }
    }

    /// Returns the error in invalid elevations, with the next step; `None` if they are valid.
    pub fn fault(self) -> Option<String> {
        let fits = [self.first, self.last].iter().all(|v| (-90.0..=90.0).contains(v));
        if fits && (self.last - self.first).abs() >= 1.0 {
            return None;
        }
        let problem = format!("`elevation` is ({}, {})", self.first, self.last);
        let advice = "give the elevations where the top row begins and the bottom row ends, in degrees from -90 to 90";
        Some(format!("{problem}; {advice}, at least 1 apart, such as (0, 90) or (-90, 90)"))
    }

    /// Returns the error if the sides of a pixel differ by more than `factor`, for an image with `width` columns over
    /// the full azimuth and `height` rows; otherwise `None`. The text continues a sentence: `NAME is ..`.
    pub fn misfit(self, (width, height): (usize, usize), factor: f64) -> Option<String> {
        let [across, up] = [360.0 / width as f64, ((self.last - self.first) / height as f64).abs()];
        if across <= factor * up && up <= factor * across {
            return None;
        }
        let Self { first, last } = self;
        Some(format!(
            "is {width} x {height} pixels: over azimuths 0 to 360 and elevations {first} to {last} degrees each would be \
             {across:.3} x {up:.3} degrees"
        ))
    }
}

/// Pinhole camera of an image. A point (x, y, z) in the receiver frame, in which x points right, y down and z forward, has
/// the image coordinates `focal` · (x, y)/z + `centre`. The upper left pixel covers (0, 0) to (1, 1), as in COLMAP.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Focal lengths along columns and rows, px.
    pub focal: [f64; 2],
    /// Principal point from the left and upper edge, px.
    pub centre: [f64; 2],
}

impl Camera {
    /// Returns the error in an invalid camera, with the next step; `None` if it is valid. The text continues a sentence: `NAME
    /// has ..`.
    pub fn fault(&self) -> Option<String> {
        let Self { focal, centre } = self;
        let fits = focal.iter().all(|f| (1e-3..=1e8).contains(f)) && centre.iter().all(|c| c.abs() <= 1e8);
        let advice = "give focal lengths above 0 and a principal point, in pixels";
        (!fits).then(|| format!("a camera with focal lengths {focal:?} and principal point {centre:?}; {advice}"))
    }
}

/// Pixel grid of a projector, with the directions of its pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImagePlane {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Whether the last column is adjacent to the first (azimuth wraps around).
    pub wraps: bool,
    /// Azimuth of a column and elevation of a row in the receiver frame, degrees; `None` if pixels have no angles (a
    /// camera, the released projection).
    pub angles: Option<(AngleAxis, AngleAxis)>,
    /// Camera of images without angles, in the frame of the receiver; `None` for other planes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<Camera>,
    /// Sampled pixels of a larger image. Not stored: a model draws whole images.
    #[serde(skip)]
    pub sampling: Sampling,
}

/// Sampled pixels of an image and their filter: every `stride`-th column and row from `offset`. Training with a stride
/// draws such a plane. Lengths in pixels, such as the filter of a projector, are those of the whole image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampling {
    /// Number of columns, and of rows, of the whole image per pixel.
    pub stride: usize,
    /// Column and row of the whole image at the first pixel, less than `stride`.
    pub offset: [usize; 2],
    /// Variance of the low-pass filter, px² of the whole image; `None` for that of the projector.
    pub filter: Option<Real>,
}

impl Default for Sampling {
    fn default() -> Self {
        Self::WHOLE
    }
}

impl Sampling {
    /// All pixels.
    pub const WHOLE: Self = Self::every(1);

    /// Creates the sampling of every `stride`-th column and row from the first.
    pub const fn every(stride: usize) -> Self {
        Self { stride, offset: [0, 0], filter: None }
    }
}

impl ImagePlane {
    /// Creates a plane whose pixels have no angles.
    pub const fn plain(width: usize, height: usize) -> Self {
        Self { width, height, wraps: false, angles: None, camera: None, sampling: Sampling::WHOLE }
    }

    /// Creates a plane whose columns cover the full circle of azimuths, and whose rows cover these elevations.
    pub fn around(width: usize, height: usize, elevation: Elevation) -> Self {
        let azimuth = AngleAxis { first: 0.0, step: 360.0 / width as f64 };
        let angles = Some((azimuth, elevation.axis(height)));
        Self { wraps: true, angles, ..Self::plain(width, height) }
    }

    /// Returns every `stride`-th column and row of this whole image, from `offset` (column, row). `stride` must divide
    /// both sides.
    #[must_use]
    pub fn strided(&self, stride: usize, offset: [usize; 2]) -> Self {
        debug_assert!(
            self.width.is_multiple_of(stride) && self.height.is_multiple_of(stride),
            "a stride divides the sides"
        );
        let axis = |axis: AngleAxis, offset: usize| AngleAxis {
            first: axis.first + axis.step * offset as f64,
            step: axis.step * stride as f64,
        };
        Self {
            width: self.width / stride,
            height: self.height / stride,
            wraps: self.wraps,
            angles: self.angles.map(|(az, el)| (axis(az, offset[0]), axis(el, offset[1]))),
            camera: self.camera,
            sampling: Sampling { stride, offset, ..self.sampling },
        }
    }

    /// Returns the whole image of a strided plane: the inverse of [`Self::strided`].
    pub fn whole(&self) -> Cow<'_, Self> {
        let Sampling { stride, offset, filter } = self.sampling;
        if stride == 1 {
            return Cow::Borrowed(self);
        }
        let axis = |axis: AngleAxis, offset: usize| {
            let step = axis.step / stride as f64;
            AngleAxis { first: axis.first - step * offset as f64, step }
        };
        Cow::Owned(Self {
            width: self.width * stride,
            height: self.height * stride,
            wraps: self.wraps,
            angles: self.angles.map(|(az, el)| (axis(az, offset[0]), axis(el, offset[1]))),
            camera: self.camera,
            sampling: Sampling { filter, ..Sampling::WHOLE },
        })
    }

    /// Returns the elevations of its rows, the last rounded to a billionth of a degree; `None` if the plane has no angles.
    pub fn elevation(&self) -> Option<Elevation> {
        // 90/H · H may differ from 90 in the last bit.
        let end = |axis: AngleAxis| ((axis.first + axis.step * self.height as f64) * 1e9).round() / 1e9;
        self.angles.map(|(_, axis)| Elevation { first: axis.first, last: end(axis) })
    }

    /// Returns whether it includes directions behind the receiver, below the plane of its array. `false` without angles.
    pub fn has_directions_behind(&self) -> bool {
        // A horizontal row may be rounded.
        self.elevation().is_some_and(|elevation| elevation.first.min(elevation.last) < -1e-9)
    }

    /// Returns azimuth and elevation of the pixel at (column `px`, row `py`), degrees; `None` if the plane has no angles.
    pub fn azimuth_elevation_deg(&self, px: Real, py: Real) -> Option<(Real, Real)> {
        self.angles.map(|(az, el)| ((az.first + az.step * px as f64) as Real, (el.first + el.step * py as f64) as Real))
    }

    /// Returns the unit vector in the receiver frame of the pixel at (column `px`, row `py`); the only conversion of
    /// pixels to directions. `None` if the plane has no angles.
    pub fn direction(&self, px: Real, py: Real) -> Option<[Real; 3]> {
        self.azimuth_elevation_deg(px, py).map(|(az, el)| {
            let (az, el) = (az / consts::DEG, el / consts::DEG);
            [el.cos() * az.cos(), el.cos() * az.sin(), el.sin()]
        })
    }
}

/// Scaling of spectra to [0, 1] from their smallest to their largest value.
pub mod stretch {
    use super::Real;

    /// Relative range of pixel values below which an image contains only rounding errors.
    const NO_CONTRAST: Real = 1e-6;

    /// Returns the smallest and largest value; zeros if empty. NaN is ignored, unless it is the first value: then
    /// both are NaN.
    pub fn range(values: &[Real]) -> (Real, Real) {
        const LANES: usize = 16; // compared at once
        let first = values.first().copied().unwrap_or(0.0);
        let (mut low, mut high) = ([first; LANES], [first; LANES]);
        pulp::Arch::new().dispatch(
            #[inline(always)]
            || {
                let (chunks, remainder) = values.as_chunks::<LANES>();
                let mut widen = |lane: usize, v: Real| {
                    low[lane] = if v < low[lane] { v } else { low[lane] };
                    high[lane] = if v > high[lane] { v } else { high[lane] };
                };
                for chunk in chunks {
                    for lane in 0..LANES {
                        widen(lane, chunk[lane]);
                    }
                }
                for (lane, v) in remainder.iter().enumerate() {
                    widen(lane, *v);
                }
            },
        );
        (low.into_iter().fold(first, Real::min), high.into_iter().fold(first, Real::max))
    }

    /// Returns 1/(high − low) for values from `low` to `high`, none below 0; 0 without contrast or for NaN.
    pub fn gain(low: Real, high: Real) -> Real {
        if high - low > NO_CONTRAST * high { 1.0 / (high - low) } else { 0.0 }
    }

    /// Scales an image from its smallest to its largest value, as the readout `MinMax` does. Sampled pixels must be
    /// scaled again, because the extreme values of the whole image may be outside the sample.
    pub fn stretch(image: &mut [Real]) {
        let (low, high) = range(image);
        let gain = gain(low, high);
        image.iter_mut().for_each(|v| *v = (*v - low) * gain);
    }
}
