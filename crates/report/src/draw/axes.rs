//! Grid and axes of a chart, drawn by plotters on a canvas, and the mapping of data to positions.
//!
//! Three properties of plotters are adapted here. It uses whole pixels only, which would be visible in print: it works
//! with [`GRID`] pixels per unit, which are divided again. Its SVG writer shrinks text by 1.24 and has a fixed size:
//! neither it nor the fonts of plotters are compiled in, because the canvas does both. The numbers on axes are
//! computed here: a logarithmic axis over less than a decade (N from 60 to 12) still needs numbers.

use crate::canvas::{Anchor, Canvas, Colour, INK, LETTER_MIDDLE, Paint, Point, TEXT, text_width};
use plotters::prelude::*;
use plotters_backend::text_anchor::{HPos, VPos};
use plotters_backend::{
    BackendColor, BackendCoord, BackendStyle, BackendTextStyle, DrawingBackend, DrawingErrorKind, FontTransform,
};
use pwrfgs_core::statistics::bounds;
use pwrfgs_experiment::text::grouped;
use std::convert::Infallible;

/// Axis of a chart.
#[derive(Clone, Debug, Default)]
pub(crate) struct ChartAxis {
    /// Name; empty if the heading contains it.
    pub name: String,
    /// Ends of the axis; by default those of the data with a margin.
    pub ends: Option<(f64, f64)>,
    /// Whether the axis is logarithmic.
    pub log: bool,
}

/// Axis with known ends, as logarithms if it is logarithmic.
pub(super) struct AxisScale {
    ends: (f64, f64),
    log: bool,
}

impl AxisScale {
    /// Creates the scale of an axis with its given ends, or else with ends around `values`. `None` if given ends do not ascend,
    /// or no value is finite.
    pub(super) fn new(axis: &ChartAxis, values: impl Iterator<Item = f64>) -> Option<Self> {
        let mut scale = Self { ends: (0.0, 0.0), log: axis.log };
        scale.ends = if let Some((low, high)) = axis.ends {
            (scale.coordinate(low), scale.coordinate(high))
        } else {
            let (low, high) = bounds(values.map(|v| scale.coordinate(v)).filter(|v| v.is_finite()));
            let least = match (axis.log, low < high) {
                (true, _) => 0.02,
                (false, true) => 1e-9,
                // Equal values: wide enough for different numbers on the axis.
                (false, false) => 0.01 * high.abs().max(1e-3),
            };
            let margin = (0.05 * (high - low)).max(least);
            (low - margin, high + margin)
        };
        (scale.ends.0 < scale.ends.1).then_some(scale)
    }

    /// Returns the coordinate of a value: on a logarithmic axis, its decimal logarithm, unless it is infinite.
    fn coordinate(&self, value: f64) -> f64 {
        if self.log && value.is_finite() { value.log10() } else { value }
    }

    /// Returns the position of a coordinate along the axis: 0 at the low end, 1 at the high end.
    fn fraction(&self, coordinate: f64) -> f64 {
        (coordinate - self.ends.0) / (self.ends.1 - self.ends.0)
    }

    /// Returns the ticks that `fits` allows on an axis of this length: their positions in pixels of plotters, and their labels.
    fn keyed_ticks(&self, length: f64, fits: &dyn Fn(&[Tick]) -> bool) -> (Vec<i32>, Vec<String>) {
        let key = |tick: Tick| (pixels(length * self.fraction(tick.0)), tick.1);
        ticks(self.ends, self.log, fits).into_iter().map(key).unzip()
    }
}

/// Mapping of data to positions on the drawing.
pub(super) struct PlotArea {
    pub(super) x: AxisScale,
    pub(super) y: AxisScale,
    pub(super) left: f64,
    pub(super) top: f64,
    pub(super) right: f64,
    pub(super) bottom: f64,
}

impl PlotArea {
    /// Returns the horizontal position of a value, limited to the plot area.
    pub(super) fn x_position(&self, x: f64) -> f64 {
        (self.left + (self.right - self.left) * self.x.fraction(self.x.coordinate(x))).clamp(self.left, self.right)
    }

    /// Returns the position of a point of the data on the drawing, horizontally limited to the plot area; `None` if it is not
    /// finite there.
    pub(super) fn position(&self, (x, y): (f64, f64)) -> Option<Point> {
        let point =
            [self.x_position(x), self.bottom - (self.bottom - self.top) * self.y.fraction(self.y.coordinate(y))];
        point.iter().all(|v| v.is_finite()).then_some(point)
    }

    /// Draws grid, ticks and names; `height` is that of the chart without its legend. plotters gets axes that count pixels: the
    /// ticks computed here are key points on them, and get the labels computed here.
    pub(super) fn draw(&self, canvas: &mut Canvas, height: f64, [x, y]: [&ChartAxis; 2]) {
        let (across, up) = (self.right - self.left, self.bottom - self.top);
        let fit = |ticks: &[Tick]| {
            // Labels are at least 8 apart.
            let reach = |tick: &Tick| (across * self.x.fraction(tick.0), text_width(&tick.1) / 2.0);
            ticks.windows(2).map(|w| (reach(&w[0]), reach(&w[1]))).all(|((a, p), (b, q))| a + p + 8.0 < b - q)
        };
        let (x_keys, x_labels) = self.x.keyed_ticks(across, &fit);
        let (y_keys, y_labels) = self.y.keyed_ticks(up, &|_| true);
        let label = |keys: &[i32], labels: &[String], key: i32| {
            keys.iter().position(|k| *k == key).map_or_else(String::new, |k| labels[k].clone())
        };
        let line = |colour| Color::stroke_width(&to_rgb(colour), GRID as u32);
        let letters = ("sans-serif", TEXT * GRID).into_font().color(&to_rgb(INK));
        let (beside, below) = (canvas.width - self.right, canvas.height - height);
        let root = PlottersBackend(canvas).into_drawing_area();
        // Left of the plot area, margin and label area add up to `left`.
        let drawn = ChartBuilder::on(&root)
            .margin_left(pixels(4.0))
            .margin_top(pixels(self.top))
            .margin_right(pixels(beside))
            .margin_bottom(pixels(below))
            .set_label_area_size(LabelAreaPosition::Left, pixels(self.left - 4.0))
            .set_label_area_size(LabelAreaPosition::Bottom, pixels(height - self.bottom))
            .build_cartesian_2d(
                (0..pixels(across)).with_key_points(x_keys.clone()),
                (0..pixels(up)).with_key_points(y_keys.clone()),
            )
            .and_then(|mut axes| {
                let x_label = |key: &i32| label(&x_keys, &x_labels, *key);
                let y_label = |key: &i32| label(&y_keys, &y_labels, *key);
                let mut mesh = axes.configure_mesh();
                mesh.disable_x_mesh().bold_line_style(line(Colour::hex(0xde_e0e5))).axis_style(line(INK));
                mesh.set_all_tick_mark_size(pixels(3.5)).label_style(letters.clone()).axis_desc_style(letters);
                mesh.x_label_formatter(&x_label).y_label_formatter(&y_label).x_desc(&x.name).y_desc(&y.name).draw()
            });
        drawn.expect("a canvas takes everything");
    }
}

/// Converts a colour without opacity for plotters.
fn to_rgb(colour: Colour) -> RGBColor {
    let [r, g, b] = colour.rgb;
    RGBColor(r, g, b)
}

/// Pixels of plotters per unit of the canvas.
pub(super) const GRID: f64 = 100.0;

/// Converts a length on the canvas to pixels of plotters.
fn pixels(length: f64) -> i32 {
    (length * GRID).round() as i32
}

/// Backend of plotters.
pub(super) struct PlottersBackend<'a>(pub(super) &'a mut Canvas);

/// Error of the backend; drawing into memory cannot fail.
type DrawResult = Result<(), DrawingErrorKind<Infallible>>;

/// Converts a position of plotters to units of the canvas.
fn to_point((x, y): BackendCoord) -> Point {
    [f64::from(x) / GRID, f64::from(y) / GRID]
}

/// Converts a colour of plotters.
fn to_colour(colour: BackendColor) -> Colour {
    let (r, g, b) = colour.rgb;
    Colour { rgb: [r, g, b], opacity: colour.alpha }
}

/// Converts the style of a line of plotters to a stroke.
fn to_stroke(style: &impl BackendStyle) -> Paint {
    Paint::stroke(to_colour(style.color()), f64::from(style.stroke_width()) / GRID)
}

impl DrawingBackend for PlottersBackend<'_> {
    type ErrorType = Infallible;

    fn get_size(&self) -> (u32, u32) {
        ((self.0.width * GRID) as u32, (self.0.height * GRID) as u32)
    }

    fn ensure_prepared(&mut self) -> DrawResult {
        Ok(())
    }

    fn present(&mut self) -> DrawResult {
        Ok(())
    }

    fn draw_pixel(&mut self, at: BackendCoord, ink: BackendColor) -> DrawResult {
        self.0.rect(to_point(at), [1.0 / GRID; 2], Paint::fill(to_colour(ink)));
        Ok(())
    }

    fn draw_line<S: BackendStyle>(&mut self, from: BackendCoord, to: BackendCoord, style: &S) -> DrawResult {
        self.draw_path([from, to], style)
    }

    fn draw_path<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(&mut self, path: I, style: &S) -> DrawResult {
        let points: Vec<Point> = path.into_iter().map(to_point).collect();
        self.0.line(&points, to_stroke(style));
        Ok(())
    }

    fn draw_text<T: BackendTextStyle>(&mut self, words: &str, style: &T, at: BackendCoord) -> DrawResult {
        let [x, y] = to_point(at);
        // From the given position down to the base line; tall letters such as `d` reach 0.76 of the text height.
        let down = TEXT
            * match style.anchor().v_pos {
                VPos::Top => 0.76,
                VPos::Center => LETTER_MIDDLE,
                VPos::Bottom => -LETTER_MIDDLE,
            };
        let anchor = match style.anchor().h_pos {
            HPos::Left => Anchor::Start,
            HPos::Center => Anchor::Middle,
            HPos::Right => Anchor::End,
        };
        match style.transform() {
            FontTransform::None => self.0.text([x, y + down], anchor, words),
            _ => self.0.upright_text([x + down, y], words),
        }
        Ok(())
    }
}

/// Position on the axis (the logarithm if logarithmic) and label.
pub(crate) type Tick = (f64, String);

/// Returns the ticks between two positions on an axis, logarithms if `log`: the densest that `fits` allows next to each
/// other, otherwise the sparsest.
pub(crate) fn ticks((low, high): (f64, f64), log: bool, fits: &dyn Fn(&[Tick]) -> bool) -> Vec<Tick> {
    let decades = high - low; // only if `log`
    // On less than half a decade, ticks are multiples of a step, as on a linear axis.
    let candidates: Vec<Vec<Tick>> = if log && decades >= 0.5 {
        let digits: [&[f64]; 4] = [&[1.0, 1.5, 2.0, 3.0, 5.0, 7.0], &[1.0, 2.0, 5.0], &[1.0, 3.0], &[1.0]];
        let densest = if decades > 3.5 { 3 } else { usize::from(decades > 1.5) };
        digits[densest..].iter().map(|digits| power_ticks((low, high), digits)).collect()
    } else {
        let (from, to) = if log { (10f64.powf(low), 10f64.powf(high)) } else { (low, high) };
        let tick = |v: f64| (if log { v.log10() } else { v }, tick_label(v));
        [6.0, 4.0, 2.0].iter().map(|&gaps| round_multiples(from, to, gaps).into_iter().map(tick).collect()).collect()
    };
    let sparsest = candidates.last().cloned().unwrap_or_default();
    candidates.into_iter().find(|ticks| fits(ticks)).unwrap_or(sparsest)
}

/// Returns ticks at the powers of ten times each of `digits`, between two logarithms; every second power over more than
/// eight decades.
fn power_ticks((low, high): (f64, f64), digits: &[f64]) -> Vec<Tick> {
    let stride = if high - low > 8.0 { 2 } else { 1 };
    (low.floor() as i32..=high.ceil() as i32)
        .filter(|power| power.rem_euclid(stride) == 0)
        .flat_map(|power| digits.iter().map(move |d| d * 10f64.powi(power)))
        .map(|v| (v.log10(), tick_label(v)))
        .filter(|(position, _)| (low..=high).contains(position))
        .collect()
}

/// Returns the multiples of 1, 2 or 5 times a power of ten between two ends, two to seven of them.
pub(crate) fn linear_ticks(low: f64, high: f64) -> Vec<f64> {
    round_multiples(low, high, 6.0)
}

/// Returns at most `most` of the [`linear_ticks`], evenly chosen, within the ends.
pub(crate) fn few_ticks(low: f64, high: f64, most: usize) -> Vec<f64> {
    let ticks = linear_ticks(low, high);
    let stride = ticks.len().div_ceil(most).max(1);
    ticks.into_iter().filter(|v| (low..=high).contains(v)).step_by(stride).collect()
}

/// Returns the multiples of 1, 2 or 5 times a power of ten between two ends, which are at most `gaps` such steps apart.
fn round_multiples(low: f64, high: f64, gaps: f64) -> Vec<f64> {
    let rough = (high - low) / gaps;
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|d| d * power).find(|s| *s >= rough).unwrap_or(power);
    let (first, last) = ((low / step - 1e-9).ceil() as i64, (high / step + 1e-9).floor() as i64);
    (first..=last).map(|k| k as f64 * step).collect()
}

/// Formats a number on an axis: from 10,000 as `k` and from a million as `M`, with two decimals at most; below 1e-4 with an
/// exponent. The minus sign is typographic.
pub(crate) fn tick_label(value: f64) -> String {
    let text = match value.abs() {
        0.0 => "0".into(),
        s if s >= 1e6 => format!("{}M", (value / 1e4).round() / 100.0),
        s if s >= 1e4 => format!("{}k", (value / 10.0).round() / 100.0),
        s if s >= 1e3 => {
            let digits = ((value * 1e6).round() / 1e6).to_string();
            let (whole, fraction) = digits.split_at(digits.find('.').unwrap_or(digits.len()));
            grouped(whole.parse().unwrap_or_default()) + fraction
        }
        s if s >= 1e-4 => format!("{}", (value * 1e6).round() / 1e6),
        _ => format!("{value:.0e}"),
    };
    text.replace('-', "−")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(range: (f64, f64), log: bool, most: usize) -> Vec<String> {
        ticks(range, log, &|ticks| ticks.len() <= most).into_iter().map(|t| t.1).collect()
    }

    #[test]
    fn ticks_are_round_numbers() {
        assert_eq!(labels((0.0, 1.0), false, 99), ["0", "0.2", "0.4", "0.6", "0.8", "1"]);
        assert_eq!(labels((0.0, 200_000.0), false, 99), ["0", "50k", "100k", "150k", "200k"]);
        assert_eq!(labels((1.0, 3.0), true, 99), ["10", "20", "50", "100", "200", "500", "1,000"]);
        assert_eq!(labels((-20.0, 30.0), false, 99), ["−20", "−10", "0", "10", "20", "30"]);
        assert!(labels((1.1, 1.3), true, 99).len() >= 3);
        assert_eq!(labels((1_233.6, 1_235.0), false, 99), ["1,234", "1,234.5", "1,235"]);
    }

    #[test]
    fn axis_of_equal_values_has_different_labels() {
        let scale = AxisScale::new(&ChartAxis::default(), [0.7, 0.7].into_iter()).unwrap();
        assert_eq!(scale.keyed_ticks(100.0, &|_| true).1, ["0.695", "0.7", "0.705"]);
        assert!(AxisScale::new(&ChartAxis::default(), [f64::NAN].into_iter()).is_none());
    }

    #[test]
    fn short_axis_has_fewer_labels() {
        assert_eq!(labels((1.0, 3.0), true, 6), ["10", "30", "100", "300", "1,000"]);
        assert_eq!(labels((1.0, 3.0), true, 3), ["10", "100", "1,000"]);
        assert_eq!(labels((1.0, 3.0), true, 0), ["10", "100", "1,000"], "the sparsest rather than none");
        assert_eq!(labels((0.0, 1.0), false, 4), ["0", "0.5", "1"]);
    }
}
