//! Curves over steps and distributions, drawn with plotters as SVG.
//!
//! Ticks are ours: a logarithmic axis over less than a decade (N from 60 to 12) still needs numbers.

use crate::scores::grouped;
use plotters::element::DashedPathElement;
use plotters::prelude::*;
use plotters::style::register_font;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use pwrfgs_core::{Error, Result};
use std::sync::OnceLock;

/// Width and height of a chart in SVG units.
const SIZE: (u32, u32) = (560, 334);
/// Room for axes: left, top, right, bottom.
const MARGINS: (u32, u32, u32, u32) = (62, 40, 18, 46);

/// A chart.
#[derive(Clone, Debug, Default)]
pub(super) struct Chart {
    /// Below the horizontal axis.
    pub(super) x_name: &'static str,
    /// Ends of the horizontal axis.
    pub(super) x: (f64, f64),
    /// Whether the vertical axis is logarithmic.
    pub(super) log: bool,
    /// Ends of the vertical axis, or those of what is drawn.
    pub(super) y: Option<(f64, f64)>,
    /// Shaded stretches of the horizontal axis.
    pub(super) bands: Vec<Band>,
    /// What is drawn, in this order.
    pub(super) lines: Vec<Line>,
}

/// A shaded stretch.
#[derive(Clone, Debug)]
pub(super) struct Band {
    /// Written at its top.
    pub(super) name: &'static str,
    /// Ends.
    pub(super) x: (f64, f64),
    /// Filling.
    pub(super) colour: RGBColor,
}

/// A line.
#[derive(Clone, Debug)]
pub(super) struct Line {
    /// Points from left to right; those without a finite place are left out.
    pub(super) points: Vec<(f64, f64)>,
    /// Colour.
    pub(super) colour: RGBColor,
    /// Stroke width; 0 fills the area between the two halves of `points` (there and back).
    pub(super) width: u32,
    /// Dashes instead of a full stroke.
    pub(super) dashed: bool,
}

impl Chart {
    /// The chart as SVG text, or nothing where there is nothing to draw.
    pub(super) fn svg(&self) -> Result<Option<String>> {
        let height = |y: f64| if self.log { y.log10() } else { y };
        let place = |(x, y): &(f64, f64)| (*x, height(*y));
        let lines: Vec<Vec<(f64, f64)>> = self
            .lines
            .iter()
            .map(|l| l.points.iter().map(place).filter(|p| p.0.is_finite() && p.1.is_finite()).collect())
            .collect();
        let all = || lines.iter().flatten().map(|p| p.1);
        let (low, high) = self.y.map_or_else(
            || (all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max)),
            |(low, high)| (height(low), height(high)),
        );
        if !(low <= high && self.x.0 < self.x.1) {
            return Ok(None);
        }
        let air = if self.y.is_some() { 0.0 } else { (0.05 * (high - low)).max(if self.log { 0.02 } else { 1e-9 }) };
        let mut svg = String::new();
        self.draw(&mut svg, &lines, (low - air, high + air))
            .map_err(|e| Error::Config(format!("cannot draw a chart: {e}")))?;
        // The backend fixes width and height; the page scales by viewBox.
        let fixed = format!("width=\"{}\" height=\"{}\" ", SIZE.0, SIZE.1);
        Ok(Some(svg.replacen(&fixed, "class=\"chart\" ", 1)))
    }

    fn draw(
        &self,
        svg: &mut String,
        lines: &[Vec<(f64, f64)>],
        y: (f64, f64),
    ) -> Result<(), Box<dyn std::error::Error>> {
        register()?;
        let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
        let mut chart = ChartBuilder::on(&root)
            .margin_left(MARGINS.0)
            .margin_top(MARGINS.1)
            .margin_right(MARGINS.2)
            .margin_bottom(MARGINS.3)
            .build_cartesian_2d(self.x.0..self.x.1, y.0..y.1)?;
        let ink = RGBColor(70, 74, 82);
        let style = |h: HPos, v: VPos| ("sans-serif", 14).into_font().color(&ink).pos(Pos::new(h, v));
        for band in &self.bands {
            let (from, to) = (band.x.0.max(self.x.0), band.x.1.min(self.x.1));
            if from < to {
                chart.draw_series([Rectangle::new([(from, y.0), (to, y.1)], band.colour.filled())])?;
                let (a, b) = (chart.backend_coord(&(from, y.1)), chart.backend_coord(&(to, y.1)));
                // A name wider than its band begins above the band, one line higher than those that fit.
                let fits = b.0 - a.0 > 8 * band.name.len() as i32;
                let (at, place) = if fits {
                    ((i32::midpoint(a.0, b.0), a.1 - 6), HPos::Center)
                } else {
                    ((a.0, a.1 - 20), HPos::Left)
                };
                root.draw(&Text::new(band.name, at, style(place, VPos::Bottom)))?;
            }
        }
        let grid = RGBColor(222, 224, 229).stroke_width(1);
        for (value, label) in ticks(y, self.log) {
            chart.draw_series([PathElement::new([(self.x.0, value), (self.x.1, value)], grid)])?;
            let (px, py) = chart.backend_coord(&(self.x.0, value));
            root.draw(&Text::new(label, (px - 7, py), style(HPos::Right, VPos::Center)))?;
        }
        for (value, label) in ticks(self.x, false) {
            let (px, py) = chart.backend_coord(&(value, y.0));
            root.draw(&PathElement::new([(px, py), (px, py + 4)], ink.stroke_width(1)))?;
            root.draw(&Text::new(label, (px, py + 7), style(HPos::Center, VPos::Top)))?;
        }
        for (line, points) in self.lines.iter().zip(lines) {
            if line.width == 0 {
                chart.draw_series([Polygon::new(points.clone(), line.colour.mix(0.22).filled())])?;
            } else if line.dashed {
                let stroke = line.colour.stroke_width(line.width);
                chart.draw_series([DashedPathElement::new(points.iter().copied(), 6, 4, stroke)])?;
            } else {
                chart.draw_series([PathElement::new(points.clone(), line.colour.stroke_width(line.width))])?;
            }
        }
        let (a, b) = (chart.backend_coord(&(self.x.0, y.0)), chart.backend_coord(&(self.x.1, y.1)));
        root.draw(&PathElement::new([(a.0, b.1), a, (b.0, a.1)], ink.stroke_width(1)))?;
        let below = (i32::midpoint(a.0, b.0), a.1 + 27);
        root.draw(&Text::new(self.x_name, below, style(HPos::Center, VPos::Top)))?;
        root.present()?;
        Ok(())
    }
}

/// Registers the font that measures labels, once.
fn register() -> Result<(), &'static str> {
    static DONE: OnceLock<bool> = OnceLock::new();
    let font = include_bytes!("../../assets/labels.ttf");
    let done = DONE.get_or_init(|| register_font("sans-serif", FontStyle::Normal, font).is_ok());
    if *done { Ok(()) } else { Err("the built-in font cannot be read") }
}

/// Places on the axis (already logarithms where `log`) with their labels.
fn ticks((low, high): (f64, f64), log: bool) -> Vec<(f64, String)> {
    let decades = high - low;
    if !log || decades < 0.5 {
        let (from, to) = if log { (10f64.powf(low), 10f64.powf(high)) } else { (low, high) };
        return linear_ticks(from, to).into_iter().map(|v| (if log { v.log10() } else { v }, label(v))).collect();
    }
    let digits: &[f64] = match decades {
        d if d > 3.5 => &[1.0],
        d if d > 1.5 => &[1.0, 2.0, 5.0],
        _ => &[1.0, 1.5, 2.0, 3.0, 5.0, 7.0],
    };
    let stride = if decades > 8.0 { 2 } else { 1 };
    (low.floor() as i32..=high.ceil() as i32)
        .filter(|power| power.rem_euclid(stride) == 0)
        .flat_map(|power| digits.iter().map(move |d| d * 10f64.powi(power)))
        .map(|v| (v.log10(), label(v)))
        .filter(|(place, _)| (low..=high).contains(place))
        .collect()
}

/// Multiples of 1, 2 or 5 times a power of ten, four to nine of them.
pub(super) fn linear_ticks(low: f64, high: f64) -> Vec<f64> {
    let rough = (high - low) / 6.0;
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|d| d * power).find(|s| *s >= rough).unwrap_or(power);
    let (first, last) = ((low / step - 1e-9).ceil() as i64, (high / step + 1e-9).floor() as i64);
    (first..=last).map(|k| k as f64 * step).collect()
}

/// A short number.
pub(super) fn label(value: f64) -> String {
    match value.abs() {
        0.0 => "0".into(),
        s if s >= 1e6 => format!("{}M", (value / 1e4).round() / 100.0),
        s if s >= 1e4 => format!("{}k", (value / 10.0).round() / 100.0),
        s if s >= 1e3 => grouped(value.round() as i64),
        s if s >= 1e-4 => format!("{}", (value * 1e6).round() / 1e6),
        _ => format!("{value:.0e}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_numbers() {
        let labels = |range, log| ticks(range, log).into_iter().map(|t| t.1).collect::<Vec<_>>();
        assert_eq!(labels((0.0, 1.0), false), ["0", "0.2", "0.4", "0.6", "0.8", "1"]);
        assert_eq!(labels((0.0, 200_000.0), false), ["0", "50k", "100k", "150k", "200k"]);
        assert_eq!(labels((1.0, 3.0), true), ["10", "20", "50", "100", "200", "500", "1,000"]);
        assert!(labels((1.1, 1.3), true).len() >= 3);
    }

    #[test]
    fn an_empty_chart_is_no_chart() {
        let chart = Chart { x: (0.0, 1.0), ..Chart::default() };
        assert!(chart.svg().unwrap().is_none());
    }
}
