//! A spectrum as a map (azimuth by elevation) and as a polar sky plot, each one SVG with its pixels inside.

use super::picture::png_data;
use pwrfgs_core::{Axis, Image, ImagePlane};
use pwrfgs_experiment::colour::{Rgb, diverging, sequential};
use std::fmt::Write as _;

/// Width of a map's picture in SVG units.
const MAP: f64 = 360.0;
/// Diameter of a sky plot in SVG units, and its resolution.
const SKY: f64 = 190.0;
const SKY_PIXELS: usize = 380;

/// What colours mean.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Scale {
    /// Power from 0 to 1.
    Power,
    /// A signed error up to this size.
    Error(f64),
}

impl Scale {
    fn colour(self, value: f64) -> Rgb {
        match self {
            Self::Power => sequential(value),
            Self::Error(limit) => diverging(value / limit),
        }
    }

    fn range(self) -> (f64, f64) {
        match self {
            Self::Power => (0.0, 1.0),
            Self::Error(limit) => (-limit, limit),
        }
    }

    /// All its colours from left to right, as a `data:` address.
    pub(crate) fn strip(self) -> String {
        let (low, high) = self.range();
        let pixels = (0..256).flat_map(|i| {
            let [r, g, b] = self.colour(low + (high - low) * f64::from(i) / 255.0);
            [r, g, b, 255]
        });
        png_data(256, 1, &pixels.collect::<Vec<u8>>())
    }

    /// A horizontal colour bar with its two ends and middle.
    pub(crate) fn bar(self) -> String {
        let (low, high) = self.range();
        let mut svg = String::from("<svg class=\"bar\" viewBox=\"0 0 404 26\" role=\"img\" aria-label=\"colour bar\">");
        let _ = write!(
            svg,
            "<image x=\"102\" y=\"2\" width=\"200\" height=\"8\" preserveAspectRatio=\"none\" href=\"{}\"/>\
             <rect class=\"frame\" x=\"102\" y=\"2\" width=\"200\" height=\"8\"/>",
            self.strip()
        );
        for part in [0.0, 0.5, 1.0] {
            let value = low + (high - low) * part;
            let sign = if value > 0.0 && low < 0.0 { "+" } else { "" };
            let text = format!("{sign}{}", (value * 100.0).round() / 100.0).replace('-', "−");
            let _ = write!(svg, "<text x=\"{}\" y=\"22\" text-anchor=\"middle\">{text}</text>", 102.0 + 200.0 * part);
        }
        svg + "</svg>"
    }
}

/// A marked pixel.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Mark {
    /// Where the measured spectrum is strongest.
    Measured(usize),
    /// Where the predicted one is.
    Predicted(usize),
}

impl Mark {
    fn svg(self, x: f64, y: f64) -> String {
        match self {
            Self::Measured(_) => format!(
                "<circle class=\"mark halo\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"6\"/>\
                 <circle class=\"mark\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"6\"/>"
            ),
            Self::Predicted(_) => {
                let cross = format!("M{:.1} {:.1}l8 8m0 -8l-8 8", x - 4.0, y - 4.0);
                format!("<path class=\"mark halo\" d=\"{cross}\"/><path class=\"mark\" d=\"{cross}\"/>")
            }
        }
    }

    /// Column and row.
    fn pixel(self, width: usize) -> (f64, f64) {
        let (Self::Measured(index) | Self::Predicted(index)) = self;
        ((index % width) as f64, (index / width) as f64)
    }
}

/// The spectrum as a picture, elevation upwards, as a `data:` address.
pub(crate) fn pixels(image: &Image, plane: &ImagePlane, scale: Scale) -> String {
    let (w, h) = (image.width, image.height);
    let upwards = plane.angles.is_none_or(|(_, elevation)| elevation.step > 0.0);
    let mut rgba = Vec::with_capacity(4 * w * h);
    for row in 0..h {
        let row = if upwards { h - 1 - row } else { row };
        for value in &image.pixels[row * w..][..w] {
            let [r, g, b] = scale.colour(*value as f64);
            rgba.extend([r, g, b, 255]);
        }
    }
    png_data(w, h, &rgba)
}

/// The two axes of a picture of spectra: degrees, or pixels where the plane has no angles.
pub(crate) fn rulers(plane: &ImagePlane) -> (Ruler, Ruler) {
    let pixel = Axis { first: 0.0, step: 1.0 };
    let (azimuth, elevation) = plane.angles.unwrap_or((pixel, pixel));
    (Ruler::new(azimuth, plane.width), Ruler::new(elevation, plane.height))
}

/// The map: azimuth to the right, elevation upwards, in degrees; pixels where the plane has no angles.
pub(crate) fn map(image: &Image, plane: &ImagePlane, scale: Scale, marks: &[Mark]) -> String {
    let (w, h) = (image.width, image.height);
    let height = MAP * h as f64 / w as f64;
    let (left, top) = (44.0, 8.0);
    let (azimuth, elevation) = plane.angles.unwrap_or((Axis { first: 0.0, step: 1.0 }, Axis { first: 0.0, step: 1.0 }));
    let (across, up) = (Ruler::new(azimuth, w), Ruler::new(elevation, h));
    let mut svg = format!(
        "<svg class=\"map\" viewBox=\"0 0 418 {:.0}\" role=\"img\"><image class=\"pixels\" x=\"{left}\" y=\"{top}\" \
         width=\"{MAP}\" height=\"{height}\" preserveAspectRatio=\"none\" href=\"{}\"/>\
         <rect class=\"frame\" x=\"{left}\" y=\"{top}\" width=\"{MAP}\" height=\"{height}\"/>",
        top + height + 34.0,
        pixels(image, plane, scale)
    );
    let degree = if plane.angles.is_some() { "°" } else { "" };
    for value in across.ticks(90.0, 4.0) {
        let (x, y) = (left + MAP * across.part(value), top + height);
        let _ = write!(
            svg,
            "<path class=\"tick\" d=\"M{x:.1} {y:.1}v4\"/><text x=\"{x:.1}\" y=\"{:.1}\" \
             text-anchor=\"middle\">{value}{degree}</text>",
            y + 15.0
        );
    }
    for value in up.ticks(30.0, 3.0) {
        let y = top + height * (1.0 - up.part(value));
        let _ = write!(
            svg,
            "<path class=\"tick\" d=\"M{left} {y:.1}h-4\"/><text x=\"{}\" y=\"{:.1}\" \
             text-anchor=\"end\">{value}{degree}</text>",
            left - 6.0,
            y + 3.5
        );
    }
    let names = if plane.angles.is_some() { ("azimuth", "elevation") } else { ("column", "row") };
    let _ = write!(
        svg,
        "<text class=\"axis\" x=\"{}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text><text class=\"axis\" \
         transform=\"translate(9 {:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
        left + MAP / 2.0,
        top + height + 28.0,
        names.0,
        top + height / 2.0,
        names.1
    );
    for mark in marks {
        let (column, row) = mark.pixel(w);
        let x = left + MAP * across.part(azimuth.first + azimuth.step * column);
        let y = top + height * (1.0 - up.part(elevation.first + elevation.step * row));
        svg.push_str(&mark.svg(x, y));
    }
    svg + "</svg>"
}

/// The sky: zenith (boresight) in the middle, horizon at the rim, azimuth counter-clockwise from the receiver's x axis
/// on the right. `None` where the plane has no angles.
pub(crate) fn sky(image: &Image, plane: &ImagePlane, scale: Scale, marks: &[Mark]) -> Option<String> {
    let (azimuth, elevation) = plane.angles?;
    let size = SKY_PIXELS;
    let mut rgba = vec![0u8; 4 * size * size];
    for (i, pixel) in rgba.chunks_exact_mut(4).enumerate() {
        let half = size as f64 / 2.0;
        let (x, y) = (((i % size) as f64 + 0.5 - half) / half, (half - (i / size) as f64 - 0.5) / half);
        let radius = x.hypot(y);
        if radius > 1.0 {
            continue;
        }
        let az = y.atan2(x).to_degrees().rem_euclid(360.0);
        let (px, py) =
            ((az - azimuth.first) / azimuth.step, (90.0 * (1.0 - radius) - elevation.first) / elevation.step);
        let [r, g, b] = scale.colour(bilinear(image, plane.wraps, px, py));
        // The rim fades over one pixel.
        pixel.copy_from_slice(&[r, g, b, (255.0 * ((1.0 - radius) * half).min(1.0)) as u8]);
    }
    let (cx, cy, r) = (125.0, 114.0, SKY / 2.0);
    let mut svg = format!(
        "<svg class=\"sky\" viewBox=\"0 0 250 228\" role=\"img\"><image x=\"{}\" y=\"{}\" width=\"{SKY}\" \
         height=\"{SKY}\" href=\"{}\"/>",
        cx - r,
        cy - r,
        png_data(size, size, &rgba)
    );
    for el in [0.0, 30.0, 60.0] {
        let ring = r * (1.0 - el / 90.0);
        let class = if el == 0.0 { "frame" } else { "ring" };
        let _ = write!(svg, "<circle class=\"{class}\" cx=\"{cx}\" cy=\"{cy}\" r=\"{ring:.1}\"/>");
        if el > 0.0 {
            let (x, y) = (cx + ring * 0.924 + 2.0, cy + ring * 0.383 + 3.0);
            let _ = write!(svg, "<text class=\"onsky\" x=\"{x:.1}\" y=\"{y:.1}\">{el}°</text>");
        }
    }
    for (az, anchor, dx, dy) in
        [(0, "start", 5.0, 4.0), (90, "middle", 0.0, -5.0), (180, "end", -5.0, 4.0), (270, "middle", 0.0, 13.0)]
    {
        let (sin, cos) = f64::from(az).to_radians().sin_cos();
        let _ = write!(
            svg,
            "<path class=\"ring\" d=\"M{cx} {cy}L{:.1} {:.1}\"/><text x=\"{:.1}\" y=\"{:.1}\" \
             text-anchor=\"{anchor}\">{az}°</text>",
            cx + r * cos,
            cy - r * sin,
            cx + r * cos + dx,
            cy - r * sin + dy
        );
    }
    for mark in marks {
        let (column, row) = mark.pixel(image.width);
        let az = (azimuth.first + azimuth.step * column).to_radians();
        let radius = r * (1.0 - (elevation.first + elevation.step * row) / 90.0).clamp(0.0, 1.0);
        svg.push_str(&mark.svg(cx + radius * az.cos(), cy - radius * az.sin()));
    }
    Some(svg + "</svg>")
}

/// Where values lie along an axis of `n` pixels, from edge to edge.
pub(crate) struct Ruler {
    low: f64,
    high: f64,
}

impl Ruler {
    fn new(axis: Axis, n: usize) -> Self {
        let ends = [-0.5, n as f64 - 0.5].map(|pixel| axis.first + axis.step * pixel);
        Self { low: ends[0].min(ends[1]), high: ends[0].max(ends[1]) }
    }

    /// From 0 at the low end to 1 at the high one.
    pub(crate) fn part(&self, value: f64) -> f64 {
        (value - self.low) / (self.high - self.low)
    }

    /// Multiples of `step` within half a pixel or so of the axis; of a finer or coarser one where there would be less
    /// than two or many more than `wanted`.
    pub(crate) fn ticks(&self, step: f64, wanted: f64) -> Vec<f64> {
        let span = self.high - self.low;
        let mut step = step;
        while span / step < 1.5 {
            step /= if step % 3.0 == 0.0 { 3.0 } else { 2.0 };
        }
        while span / step > 2.5 * wanted {
            step *= 2.0;
        }
        let slack = 0.02 * span;
        let (first, last) = (((self.low - slack) / step).ceil() as i64, ((self.high + slack) / step).floor() as i64);
        (first..=last).map(|k| k as f64 * step).collect()
    }
}

/// The value at a place between pixels; beyond the border the nearest pixel, or the other side where azimuth wraps.
fn bilinear(image: &Image, wraps: bool, px: f64, py: f64) -> f64 {
    let (w, h) = (image.width as i64, image.height as i64);
    let (x0, y0) = (px.floor(), py.floor());
    let (fx, fy) = (px - x0, py - y0);
    let at = |x: i64, y: i64| {
        let x = if wraps { x.rem_euclid(w) } else { x.clamp(0, w - 1) };
        image.pixels[(y.clamp(0, h - 1) * w + x) as usize] as f64
    };
    let (x, y) = (x0 as i64, y0 as i64);
    (at(x, y) * (1.0 - fx) + at(x + 1, y) * fx) * (1.0 - fy) + (at(x, y + 1) * (1.0 - fx) + at(x + 1, y + 1) * fx) * fy
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_of_the_usual_plane() {
        let azimuth = Ruler::new(Axis { first: 0.0, step: 1.0 }, 360);
        assert_eq!(azimuth.ticks(90.0, 4.0), [0.0, 90.0, 180.0, 270.0, 360.0]);
        let elevation = Ruler::new(Axis { first: 0.0, step: 1.0 }, 90);
        assert_eq!(elevation.ticks(30.0, 3.0), [0.0, 30.0, 60.0, 90.0]);
        assert!(Ruler::new(Axis { first: 0.0, step: 1.0 }, 8).ticks(90.0, 4.0).len() >= 2);
    }

    #[test]
    fn the_sky_wraps_at_the_seam() {
        let image = Image { width: 4, height: 1, pixels: vec![0.0, 1.0, 0.0, 1.0] };
        assert_eq!(bilinear(&image, true, 3.5, 0.0), 0.5);
        assert_eq!(bilinear(&image, false, 3.5, 0.0), 1.0);
    }

    #[test]
    fn a_plane_without_angles_has_no_sky() {
        let plane = ImagePlane { width: 4, height: 2, wraps: false, angles: None };
        let image = Image::zeros(4, 2);
        assert!(sky(&image, &plane, Scale::Power, &[]).is_none());
        assert!(map(&image, &plane, Scale::Error(0.5), &[Mark::Measured(3), Mark::Predicted(5)]).contains("column"));
    }
}
