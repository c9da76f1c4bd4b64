//! `Image` and `ImagePlane`: pixels, and what a pixel means as an angle.

use crate::{Real, consts};
use serde::{Deserialize, Serialize};

/// A spatial spectrum as a picture, row-major `[height, width]`; 1 is the strongest direction.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Columns (azimuth).
    pub width: usize,
    /// Rows (elevation).
    pub height: usize,
    /// `height · width` values.
    pub pixels: Vec<Real>,
}

impl Image {
    /// All zero.
    pub fn zeros(width: usize, height: usize) -> Self {
        Self { width, height, pixels: vec![0.0; width * height] }
    }

    /// From 8-bit grey values: value/255.
    pub fn from_bytes(width: usize, height: usize, bytes: &[u8]) -> Self {
        assert_eq!(bytes.len(), width * height, "an image has width times height pixels");
        Self { width, height, pixels: bytes.iter().map(|&b| Real::from(b) / 255.0).collect() }
    }

    /// To 8-bit grey values: clamped to [0, 1], times 255, rounded.
    pub fn to_bytes(&self) -> Vec<u8> {
        self.pixels.iter().map(|p| (p.clamp(0.0, 1.0) * 255.0).round() as u8).collect()
    }

    /// Every pixel clamped to [0, 1], as metrics and pictures show it.
    pub fn clamped(&self) -> Self {
        Self { pixels: self.pixels.iter().map(|p| p.clamp(0.0, 1.0)).collect(), ..*self }
    }

    /// Index of the strongest pixel; the first in row-major order where several are equal.
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
pub struct Axis {
    /// Degrees at pixel 0.
    pub first: f64,
    /// Degrees a pixel.
    pub step: f64,
}

/// The grid that a projector draws on, and what its pixels mean.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImagePlane {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Whether the last column borders on the first (azimuth comes round).
    pub wraps: bool,
    /// Azimuth of a column and elevation of a row in the receiver frame, in degrees; `None` where a pixel has no such
    /// meaning (the released projection).
    pub angles: Option<(Axis, Axis)>,
}

impl ImagePlane {
    /// Azimuth and elevation of a pixel in degrees, or `None` where the plane has no angles.
    pub fn azimuth_elevation_deg(&self, px: Real, py: Real) -> Option<(Real, Real)> {
        self.angles.map(|(az, el)| ((az.first + az.step * px as f64) as Real, (el.first + el.step * py as f64) as Real))
    }

    /// Unit vector in the receiver frame of the pixel at (column `px`, row `py`): the one place where a pixel becomes
    /// an angle. `None` where the plane has no angles.
    pub fn direction(&self, px: Real, py: Real) -> Option<[Real; 3]> {
        self.azimuth_elevation_deg(px, py).map(|(az, el)| {
            let (az, el) = (az / consts::DEG, el / consts::DEG);
            [el.cos() * az.cos(), el.cos() * az.sin(), el.sin()]
        })
    }
}
