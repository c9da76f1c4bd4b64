//! Spectra as maps (azimuth by elevation) and as polar sky plots, with axes in degrees.

use crate::canvas::{
    Anchor, BLACK, Canvas, Colour, INK, LINE, Paint, Point, RasterImage, TextStyle, VectorPath, WHITE,
};
use pwrfgs_core::colour::{Rgb, diverging, sequential};
use pwrfgs_core::{AngleAxis, Image, ImagePlane};

/// Width of the drawing of a map.
const MAP: f64 = 360.0;
/// Radius and resolution of a sky plot.
const SKY: f64 = 95.0;
const SKY_PIXELS: usize = 380;
/// Text height on a page.
const TEXT: TextStyle = TextStyle { size: 10.5, colour: INK };

/// Colour scale.
#[derive(Clone, Copy, Debug)]
pub(crate) enum ColourScale {
    /// Power from 0 to 1.
    Power,
    /// Signed error up to this size.
    Error(f64),
}

impl ColourScale {
    /// Returns the colour of a value, limited to the range.
    fn colour(self, value: f64) -> Rgb {
        match self {
            Self::Power => sequential(value),
            Self::Error(limit) => diverging(value / limit),
        }
    }

    /// Returns the smallest and largest value of the scale.
    fn range(self) -> (f64, f64) {
        match self {
            Self::Power => (0.0, 1.0),
            Self::Error(limit) => (-limit, limit),
        }
    }

    /// Adds a horizontal colour bar with numbers at its ends and middle.
    pub(crate) fn draw(self, canvas: &mut Canvas, [left, top]: Point, width: f64) {
        let (low, high) = self.range();
        let colours = (0..256).map(|i| self.colour(low + (high - low) * f64::from(i) / 255.0));
        let rgba = colours.flat_map(|[r, g, b]| [r, g, b, 255]).collect();
        canvas.framed_pixels([left, top], [width, 8.0], RasterImage { width: 256, height: 1, rgba, smooth: false });
        for part in [0.0, 0.5, 1.0] {
            let (x, value) = (left + width * part, low + (high - low) * part);
            let sign = if value > 0.0 && low < 0.0 { "+" } else { "" };
            let label = format!("{sign}{}", (value * 100.0).round() / 100.0).replace('-', "−");
            canvas.line(&[[x, top + 8.0], [x, top + 11.0]], Paint::stroke(INK, 0.9));
            canvas.text([x, top + 22.0], Anchor::Middle, label);
        }
    }

    /// Draws the colour bar alone.
    pub(crate) fn draw_bar(self) -> Canvas {
        let mut canvas = Canvas::new(404.0, 28.0);
        canvas.letters = TEXT;
        self.draw(&mut canvas, [102.0, 2.0], 200.0);
        canvas
    }

    /// Returns the colours of lines and of text on this scale: white, or dark if the middle of the scale is white.
    fn contrasting_colours(self) -> (Colour, Colour) {
        match self {
            Self::Power => (WHITE.with_opacity(0.45), WHITE.with_opacity(0.9)),
            Self::Error(_) => (INK.with_opacity(0.25), INK),
        }
    }
}

/// Marked pixel.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Mark {
    /// Strongest measured pixel.
    Measured(usize),
    /// Strongest predicted pixel.
    Predicted(usize),
}

impl Mark {
    /// Draws a ring or a cross, white on a dark halo.
    fn draw(self, canvas: &mut Canvas, at: Point) {
        for paint in [Paint::stroke(BLACK.with_opacity(0.75), 3.4), Paint::stroke(WHITE, 1.6)] {
            match self {
                Self::Measured(_) => canvas.circle(at, 6.0, paint),
                Self::Predicted(_) => {
                    let mut cross = VectorPath::default();
                    cross.add_cross(at, 4.0);
                    canvas.path(cross, paint);
                }
            }
        }
    }

    /// Returns column and row of the pixel in an image of this width.
    fn column_and_row(self, width: usize) -> (f64, f64) {
        let (Self::Measured(index) | Self::Predicted(index)) = self;
        ((index % width) as f64, (index / width) as f64)
    }
}

/// Returns the spectrum as an image, elevation upwards; the first row of an image of a camera is at the top.
pub(crate) fn spectrum_image(image: &Image, plane: &ImagePlane, scale: ColourScale) -> RasterImage {
    let (width, height) = (image.width, image.height);
    let upwards = plane.angles.map_or(plane.camera.is_none(), |(_, elevation)| elevation.step > 0.0);
    let row = |k: usize| if upwards { height - 1 - k } else { k };
    let values = (0..height).flat_map(|k| &image.pixels[row(k) * width..][..width]);
    let rgba = values.map(|value| scale.colour(*value as f64)).flat_map(|[r, g, b]| [r, g, b, 255]).collect();
    RasterImage { width, height, rgba, smooth: false }
}

/// Draws the map: azimuth to the right, elevation upwards, in degrees; in pixels if the plane has no angles.
pub(crate) fn draw_map(image: &Image, plane: &ImagePlane, scale: ColourScale, marks: &[Mark]) -> Canvas {
    let height = MAP * image.height as f64 / image.width as f64;
    let (left, top) = (44.0, 8.0);
    let mut canvas = Canvas::new(418.0, top + height + 34.0);
    canvas.letters = TEXT;
    canvas.framed_pixels(
        [left, top],
        [MAP, height],
        RasterImage { smooth: true, ..spectrum_image(image, plane, scale) },
    );
    draw_azimuth(&mut canvas, plane, [left, top + height], MAP);
    draw_elevation(&mut canvas, plane, [left, top], height);
    canvas.letters.colour = Colour::hex(0x7a_808b);
    let [across, up] = axis_names(plane);
    canvas.text([left + MAP / 2.0, top + height + 28.0], Anchor::Middle, across);
    canvas.upright_text([9.0, top + height / 2.0], up);
    let [across, up] = rulers(plane);
    for mark in marks {
        let (column, row) = mark.column_and_row(image.width);
        let (x, y) = (across.share_of_pixel(column), 1.0 - up.share_of_pixel(row));
        mark.draw(&mut canvas, [left + MAP * x, top + height * y]);
    }
    canvas
}

/// Draws the sky plot: zenith (boresight) in the centre, horizon at the rim, azimuth counter-clockwise from the x axis
/// of the receiver on the right. `None` if the plane has no angles.
pub(crate) fn draw_sky(image: &Image, plane: &ImagePlane, scale: ColourScale, marks: &[Mark]) -> Option<Canvas> {
    let (azimuth, elevation) = plane.angles?;
    let middle @ [cx, cy] = [125.0, 114.0];
    let mut canvas = Canvas::new(250.0, 228.0);
    canvas.pixels([cx - SKY, cy - SKY], [2.0 * SKY; 2], sky_image(image, plane, scale)?);
    canvas.circle(middle, SKY, Paint::stroke(INK, 0.7));
    let (ring, text) = scale.contrasting_colours();
    canvas.letters = TextStyle { size: 9.0, colour: text };
    for degrees in [30.0, 60.0] {
        let radius = SKY * (1.0 - degrees / 90.0);
        canvas.circle(middle, radius, Paint::stroke(ring, 0.7));
        // At 22.5 degrees below the horizontal, between two lines.
        let beside = [cx + radius * 0.924 + 2.0, cy + radius * 0.383 + 3.0];
        canvas.text(beside, Anchor::Start, format!("{degrees}°"));
    }
    canvas.letters = TEXT;
    let sides =
        [(Anchor::Start, 5.0, 4.0), (Anchor::Middle, 0.0, -5.0), (Anchor::End, -5.0, 4.0), (Anchor::Middle, 0.0, 13.0)];
    for (quarter, (anchor, dx, dy)) in (0..).zip(sides) {
        let (sin, cos) = f64::from(90 * quarter).to_radians().sin_cos();
        let [x, y] = [cx + SKY * cos, cy - SKY * sin];
        canvas.line(&[middle, [x, y]], Paint::stroke(ring, 0.7));
        canvas.text([x + dx, y + dy], anchor, format!("{}°", 90 * quarter));
    }
    for mark in marks {
        let (column, row) = mark.column_and_row(image.width);
        let (sin, cos) = (azimuth.first + azimuth.step * column).to_radians().sin_cos();
        let radius = SKY * (1.0 - (elevation.first + elevation.step * row) / 90.0).clamp(0.0, 1.0);
        mark.draw(&mut canvas, [cx + radius * cos, cy - radius * sin]);
    }
    Some(canvas)
}

/// Returns the image of the sky disc, transparent outside; `None` if the plane has no angles.
fn sky_image(image: &Image, plane: &ImagePlane, scale: ColourScale) -> Option<RasterImage> {
    let (azimuth, elevation) = plane.angles?;
    let size = SKY_PIXELS;
    let half = size as f64 / 2.0;
    let mut rgba = vec![0u8; 4 * size * size];
    for (i, pixel) in rgba.chunks_exact_mut(4).enumerate() {
        let (x, y) = (((i % size) as f64 + 0.5 - half) / half, (half - (i / size) as f64 - 0.5) / half);
        let radius = x.hypot(y);
        if radius > 1.0 {
            continue;
        }
        let az = y.atan2(x).to_degrees().rem_euclid(360.0);
        let (px, py) =
            ((az - azimuth.first) / azimuth.step, (90.0 * (1.0 - radius) - elevation.first) / elevation.step);
        let [r, g, b] = scale.colour(interpolate(image, plane.wraps, px, py));
        // The rim fades over one pixel.
        pixel.copy_from_slice(&[r, g, b, (255.0 * ((1.0 - radius) * half).min(1.0)) as u8]);
    }
    Some(RasterImage { width: size, height: size, rgba, smooth: true })
}

/// Interpolates bilinearly between pixels at column `px` and row `py`; beyond the border the nearest pixel, or the opposite
/// side if azimuth is periodic.
fn interpolate(image: &Image, wraps: bool, px: f64, py: f64) -> f64 {
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

/// Range of values along an axis of pixels, from edge to edge.
pub(super) struct Ruler {
    axis: AngleAxis,
    low: f64,
    high: f64,
    /// Unit after each number.
    unit: &'static str,
}

/// Returns the axes of a spectrum, azimuth first; without angles, those of pixel columns and rows. Rows of a camera count
/// from the top, as negative numbers: axes point up.
pub(super) fn rulers(plane: &ImagePlane) -> [Ruler; 2] {
    let pixel = |step| AngleAxis { first: 0.0, step };
    let down = if plane.camera.is_some() { -1.0 } else { 1.0 };
    let (azimuth, elevation) = plane.angles.unwrap_or((pixel(1.0), pixel(down)));
    let unit = if plane.angles.is_some() { "°" } else { "" };
    [Ruler::new(azimuth, plane.width, unit), Ruler::new(elevation, plane.height, unit)]
}

/// Returns the names of the axes, the horizontal one first.
pub(crate) fn axis_names(plane: &ImagePlane) -> [&'static str; 2] {
    if plane.angles.is_some() { ["azimuth", "elevation"] } else { ["column", "row"] }
}

impl Ruler {
    /// Creates the axis of `n` pixels.
    fn new(axis: AngleAxis, n: usize, unit: &'static str) -> Self {
        let ends = [-0.5, n as f64 - 0.5].map(|pixel| axis.first + axis.step * pixel);
        Self { axis, low: ends[0].min(ends[1]), high: ends[0].max(ends[1]), unit }
    }

    /// Returns the position of a value, from 0 at the low to 1 at the high end.
    fn share(&self, value: f64) -> f64 {
        (value - self.low) / (self.high - self.low)
    }

    /// Returns the position of the centre of a pixel, from 0 to 1.
    pub(super) fn share_of_pixel(&self, pixel: f64) -> f64 {
        self.share(self.axis.first + self.axis.step * pixel)
    }

    /// Returns the multiples of `step` on the axis. Also returns those up to 2 % of its length beyond, since its ends lie half a
    /// pixel off round values. The step becomes finer on an axis shorter than 1.5 steps, by thirds before halves so that degrees
    /// stay round (90, 30, 10, 5), and coarser on one longer than 10.
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

    /// Returns the labels of round values with positions from 0 to 1, with at most `intervals` between them; the first and the
    /// last value always have one. Pixel numbers have no sign.
    fn ticks(&self, step: f64, intervals: f64) -> Vec<(String, f64)> {
        let values = self.multiples(step);
        let gaps = values.len().saturating_sub(1).max(1);
        let stride = (1..=gaps).find(|s| gaps.is_multiple_of(*s) && (gaps / s) as f64 <= intervals).unwrap_or(gaps);
        let number = |v: f64| if self.unit.is_empty() { v.abs() } else { v };
        let tick = |v: f64| (format!("{}{}", number(v), self.unit).replace('-', "−"), self.share(v).clamp(0.0, 1.0));
        values.into_iter().step_by(stride).map(tick).collect()
    }
}

/// Draws ticks and numbers of the azimuth below a panel of this width; those at its ends stay inside.
pub(crate) fn draw_azimuth(canvas: &mut Canvas, plane: &ImagePlane, [left, bottom]: Point, width: f64) {
    let [across, _] = rulers(plane);
    // A label needs 42 units.
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

/// Draws ticks and numbers of the elevation left of a panel of this height.
pub(crate) fn draw_elevation(canvas: &mut Canvas, plane: &ImagePlane, [left, top]: Point, height: f64) {
    let [_, up] = rulers(plane);
    // A label needs 16 units.
    for (label, part) in up.ticks(30.0, (height / 16.0).floor().max(1.0)) {
        let y = top + height * (1.0 - part);
        canvas.line(&[[left - 3.0, y], [left, y]], Paint::stroke(INK, 0.9));
        canvas.text([left - 5.0, y + 4.0], Anchor::End, label);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sky_plot_wraps_at_azimuth_zero() {
        let image = Image { width: 4, height: 1, pixels: vec![0.0, 1.0, 0.0, 1.0] };
        assert_eq!(interpolate(&image, true, 3.5, 0.0), 0.5);
        assert_eq!(interpolate(&image, false, 3.5, 0.0), 1.0);
    }

    #[test]
    fn plane_without_angles_has_no_sky_plot() {
        let plane = ImagePlane::plain(4, 2);
        let image = Image::zeros(4, 2);
        assert!(draw_sky(&image, &plane, ColourScale::Power, &[]).is_none());
        let map = draw_map(&image, &plane, ColourScale::Error(0.5), &[Mark::Measured(3), Mark::Predicted(5)]);
        assert!(map.svg("map", "").contains(">column<"));
    }

    const DEGREE: AngleAxis = AngleAxis { first: 0.0, step: 1.0 };

    #[test]
    fn ruler_returns_multiples_within_plane() {
        assert_eq!(Ruler::new(DEGREE, 360, "°").multiples(90.0), [0.0, 90.0, 180.0, 270.0, 360.0]);
        assert_eq!(Ruler::new(DEGREE, 90, "°").multiples(30.0), [0.0, 30.0, 60.0, 90.0]);
        assert!(Ruler::new(DEGREE, 8, "°").multiples(90.0).len() >= 2);
    }

    #[test]
    fn ticks_keep_the_ends() {
        let plane = ImagePlane { wraps: true, angles: Some((DEGREE, DEGREE)), ..ImagePlane::plain(360, 90) };
        let [azimuth, _] = rulers(&plane);
        let labels = |n| azimuth.ticks(90.0, n).into_iter().map(|t| t.0).collect::<Vec<_>>();
        assert_eq!(labels(4.0), ["0°", "90°", "180°", "270°", "360°"]);
        assert_eq!(labels(2.0), ["0°", "180°", "360°"]);
        assert_eq!(labels(1.0), ["0°", "360°"]);
    }
}
