//! The axes of a spectrum: degrees, or pixels where the plane has no angles.

use crate::canvas::font::LINE;
use crate::canvas::{Anchor, Canvas, INK, Paint, Point};
use pwrfgs_core::{Axis, ImagePlane};

/// Where values lie along an axis of `n` pixels, from edge to edge.
pub(super) struct Ruler {
    axis: Axis,
    low: f64,
    high: f64,
    /// After each number.
    unit: &'static str,
}

/// The two axes of a picture of spectra, azimuth first.
pub(super) fn rulers(plane: &ImagePlane) -> [Ruler; 2] {
    let pixel = Axis { first: 0.0, step: 1.0 };
    let (azimuth, elevation) = plane.angles.unwrap_or((pixel, pixel));
    let unit = if plane.angles.is_some() { "°" } else { "" };
    [Ruler::new(azimuth, plane.width, unit), Ruler::new(elevation, plane.height, unit)]
}

/// What stands beside the axes.
pub(crate) fn names(plane: &ImagePlane) -> [&'static str; 2] {
    if plane.angles.is_some() { ["azimuth", "elevation"] } else { ["column", "row"] }
}

impl Ruler {
    fn new(axis: Axis, n: usize, unit: &'static str) -> Self {
        let ends = [-0.5, n as f64 - 0.5].map(|pixel| axis.first + axis.step * pixel);
        Self { axis, low: ends[0].min(ends[1]), high: ends[0].max(ends[1]), unit }
    }

    /// From 0 at the low end to 1 at the high one.
    fn part(&self, value: f64) -> f64 {
        (value - self.low) / (self.high - self.low)
    }

    /// The same for a pixel.
    pub(super) fn part_of_pixel(&self, pixel: f64) -> f64 {
        self.part(self.axis.first + self.axis.step * pixel)
    }

    /// Multiples of `step` within half a pixel or so of the axis; of a finer or coarser one where there would be less
    /// than two or many more than four.
    fn multiples(&self, mut step: f64) -> Vec<f64> {
        let span = self.high - self.low;
        while span / step < 1.5 {
            step /= if step % 3.0 == 0.0 { 3.0 } else { 2.0 };
        }
        while span / step > 10.0 {
            step *= 2.0;
        }
        let slack = 0.02 * span;
        let (first, last) = (((self.low - slack) / step).ceil() as i64, ((self.high + slack) / step).floor() as i64);
        (first..=last).map(|k| k as f64 * step).collect()
    }

    /// Labels of round values with their places from 0 to 1; so many intervals at most, the ends of the axis first of
    /// all.
    fn ticks(&self, step: f64, intervals: f64) -> Vec<(String, f64)> {
        let all = self.multiples(step);
        let whole = all.len().saturating_sub(1).max(1);
        let stride = (1..=whole).find(|s| whole.is_multiple_of(*s) && (whole / s) as f64 <= intervals).unwrap_or(whole);
        let tick = |v: f64| (format!("{v}{}", self.unit).replace('-', "−"), self.part(v).clamp(0.0, 1.0));
        all.into_iter().step_by(stride).map(tick).collect()
    }
}

/// Ticks and numbers below a panel; those at its ends stay within it.
pub(crate) fn draw_azimuth(canvas: &mut Canvas, plane: &ImagePlane, [left, bottom]: Point, width: f64) {
    let [across, _] = rulers(plane);
    for (label, part) in across.ticks(90.0, (width / 42.0).floor().max(2.0)) {
        let x = left + width * part;
        canvas.line(&[[x, bottom], [x, bottom + 3.0]], Paint::stroke(INK, 0.9));
        let (anchor, shift) = match part {
            p if p < 0.05 => (Anchor::Start, -1.0),
            p if p > 0.95 => (Anchor::End, 1.0),
            _ => (Anchor::Middle, 0.0),
        };
        canvas.text([x + shift, bottom + LINE], anchor, label);
    }
}

/// Ticks and numbers left of a panel.
pub(crate) fn draw_elevation(canvas: &mut Canvas, plane: &ImagePlane, [left, top]: Point, height: f64) {
    let [_, up] = rulers(plane);
    for (label, part) in up.ticks(30.0, (height / 16.0).floor().max(1.0)) {
        let y = top + height * (1.0 - part);
        canvas.line(&[[left - 3.0, y], [left, y]], Paint::stroke(INK, 0.9));
        canvas.text([left - 5.0, y + 4.0], Anchor::End, label);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::Sampling;

    const DEGREE: Axis = Axis { first: 0.0, step: 1.0 };

    #[test]
    fn multiples_of_the_usual_plane() {
        assert_eq!(Ruler::new(DEGREE, 360, "°").multiples(90.0), [0.0, 90.0, 180.0, 270.0, 360.0]);
        assert_eq!(Ruler::new(DEGREE, 90, "°").multiples(30.0), [0.0, 30.0, 60.0, 90.0]);
        assert!(Ruler::new(DEGREE, 8, "°").multiples(90.0).len() >= 2);
    }

    #[test]
    fn ticks_keep_the_ends() {
        let plane = ImagePlane {
            width: 360,
            height: 90,
            wraps: true,
            angles: Some((DEGREE, DEGREE)),
            sampling: Sampling::WHOLE,
        };
        let [azimuth, _] = rulers(&plane);
        let labels = |n| azimuth.ticks(90.0, n).into_iter().map(|t| t.0).collect::<Vec<_>>();
        assert_eq!(labels(4.0), ["0°", "90°", "180°", "270°", "360°"]);
        assert_eq!(labels(2.0), ["0°", "180°", "360°"]);
        assert_eq!(labels(1.0), ["0°", "360°"]);
    }
}
