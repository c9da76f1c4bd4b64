//! Charts: lines, marks, bars and shaded areas on two axes, drawn with plotters as SVG.

use super::marks::{Area, Drawn, Pixel, Style};
use super::ticks::ticks;
use legend::Legend;
use plotters::prelude::*;
use plotters::style::register_font;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use pwrfgs_core::{Error, Result};
use std::sync::OnceLock;

mod legend;

/// Height of text.
const TEXT: u32 = 14;
/// Colour of text and axes.
const INK: RGBColor = RGBColor(70, 74, 82);

/// How large a chart and its parts are.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Look {
    /// Width, and height without the legend.
    pub(crate) size: (u32, u32),
    /// Room for axes: left, top, right, bottom.
    pub(crate) margins: (u32, u32, u32, u32),
    /// SVG units for each unit of the above: plotters draws at whole SVG units, which print shall not show.
    pub(crate) unit: u32,
}

impl Look {
    /// For a page on a screen, which scales it and shows the legend.
    pub(crate) const SCREEN: Self = Self { size: (560, 334), margins: (62, 40, 18, 46), unit: 1 };
    /// For a column of print; text is 7.5 pt high where the column is 3.5 in wide.
    pub(crate) const COLUMN: Self = Self { size: (380, 262), margins: (58, 10, 20, 42), unit: 10 };
}

impl Default for Look {
    fn default() -> Self {
        Self::SCREEN
    }
}

/// A chart.
#[derive(Clone, Debug, Default)]
pub(crate) struct Chart {
    /// Sizes.
    pub(crate) look: Look,
    /// Below the horizontal axis.
    pub(crate) x_name: String,
    /// Beside the vertical axis; empty where the heading says it.
    pub(crate) y_name: String,
    /// Ends of the horizontal axis, or those of what is drawn.
    pub(crate) x: Option<(f64, f64)>,
    /// Whether the horizontal axis is logarithmic.
    pub(crate) log_x: bool,
    /// Ends of the vertical axis, or those of what is drawn.
    pub(crate) y: Option<(f64, f64)>,
    /// Whether the vertical axis is logarithmic.
    pub(crate) log: bool,
    /// Shaded stretches of the horizontal axis.
    pub(crate) bands: Vec<Band>,
    /// What is drawn, in this order.
    pub(crate) lines: Vec<Line>,
}

/// A shaded stretch.
#[derive(Clone, Debug)]
pub(crate) struct Band {
    /// Written at its top.
    pub(crate) name: &'static str,
    /// Ends.
    pub(crate) x: (f64, f64),
    /// Filling.
    pub(crate) colour: RGBColor,
}

/// A line with marks on it.
#[derive(Clone, Debug)]
pub(crate) struct Line {
    /// Its name, and where it stands.
    pub(crate) name: Name,
    /// How it looks.
    pub(crate) style: Style,
    /// Points from left to right, or round an area; those without a finite place are left out.
    pub(crate) points: Vec<(f64, f64)>,
    /// Where marks stand.
    pub(crate) marks: Vec<(f64, f64)>,
    /// Bars from one place to another, across or upright.
    pub(crate) bars: Vec<[(f64, f64); 2]>,
}

/// The name of a line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Name {
    /// Nowhere in the chart.
    Hidden,
    /// Below the chart.
    Legend(String),
    /// At the right of its last point.
    AtEnd(String),
}

impl Line {
    /// A line without name, marks and bars.
    pub(crate) fn new(points: Vec<(f64, f64)>, style: Style) -> Self {
        Self { name: Name::Hidden, style, points, marks: Vec::new(), bars: Vec::new() }
    }

    /// Every place that must be seen.
    fn places(&self) -> impl Iterator<Item = (f64, f64)> {
        self.points.iter().chain(&self.marks).chain(self.bars.iter().flatten()).copied()
    }
}

/// Where data lie on the picture.
struct Frame {
    /// Ends of the axes, logarithms where `log`.
    x: (f64, f64),
    y: (f64, f64),
    log: (bool, bool),
    /// Left, top, right, bottom, SVG units.
    left: i32,
    top: i32,
    right: i32,
    bottom: i32,
}

impl Frame {
    /// The pixel of a place on the axes (logarithms already taken).
    fn pixel(&self, (x, y): (f64, f64)) -> Pixel {
        let part = |v: f64, (low, high): (f64, f64)| (v - low) / (high - low);
        let (width, height) = (f64::from(self.right - self.left), f64::from(self.bottom - self.top));
        let across = (width * part(x, self.x)).round().clamp(-1e6, 1e6) as i32;
        (self.left + across, self.bottom - (height * part(y, self.y)).round().clamp(-1e6, 1e6) as i32)
    }

    /// The pixel of a value; `None` where it has no finite place.
    fn at(&self, place: (f64, f64)) -> Option<Pixel> {
        let p = logged(place, self.log);
        (p.0.is_finite() && p.1.is_finite()).then(|| self.pixel(p))
    }
}

fn logged((x, y): (f64, f64), log: (bool, bool)) -> (f64, f64) {
    (if log.0 { x.log10() } else { x }, if log.1 { y.log10() } else { y })
}

/// Ends of an axis: those given, or those of the values with some air.
fn ends(given: Option<(f64, f64)>, values: impl Iterator<Item = f64>, log: bool) -> (f64, f64) {
    if let Some((low, high)) = given {
        return (if log { low.log10() } else { low }, if log { high.log10() } else { high });
    }
    let (low, high) =
        values.filter(|v| v.is_finite()).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    let air = (0.05 * (high - low)).max(if log { 0.02 } else { 1e-9 });
    (low - air, high + air)
}

impl Chart {
    /// The chart as SVG text, or nothing where there is nothing to draw.
    pub(crate) fn svg(&self) -> Result<Option<String>> {
        let failed = |e: Box<dyn std::error::Error>| Error::Config(format!("cannot draw a chart: {e}"));
        register().map_err(|e| failed(e.into()))?;
        let log = (self.log_x, self.log);
        let places = || self.lines.iter().flat_map(Line::places).map(|p| logged(p, log));
        let x = ends(self.x, places().map(|p| p.0), log.0);
        let y = ends(self.y, places().map(|p| p.1), log.1);
        if !(x.0 < x.1 && y.0 < y.1) || self.lines.is_empty() {
            return Ok(None);
        }
        let Look { size: (width, height), margins, unit } = self.look;
        let right = margins.2.max(self.at_ends().map(|(name, _)| text_width(name) + 12).max().unwrap_or(0));
        let [left, top, right, bottom] =
            [margins.0, margins.1, width - right.min(width / 2), height - margins.3].map(|v| (v * unit) as i32);
        let frame = Frame { x, y, log, left, top, right, bottom };
        let legend = Legend::new(&self.lines, width);
        let size = (width * unit, (height + legend.height()) * unit);
        let mut svg = String::new();
        self.draw(SVGBackend::with_string(&mut svg, size), &frame, &legend).map_err(failed)?;
        // The backend fixes width and height; the page scales by viewBox.
        let fixed = format!("width=\"{}\" height=\"{}\" ", size.0, size.1);
        Ok(Some(svg.replacen(&fixed, "class=\"chart\" ", 1)))
    }

    /// Names that stand at the ends of lines.
    fn at_ends(&self) -> impl Iterator<Item = (&str, &Line)> {
        self.lines.iter().filter_map(|l| match &l.name {
            Name::AtEnd(name) => Some((name.as_str(), l)),
            _ => None,
        })
    }

    fn draw(&self, backend: SVGBackend<'_>, frame: &Frame, legend: &Legend<'_>) -> Drawn {
        let root = backend.into_drawing_area();
        let unit = self.look.unit;
        self.draw_bands(&root, frame)?;
        self.draw_axes(&root, frame)?;
        let pixels = |places: &[(f64, f64)]| places.iter().filter_map(|p| frame.at(*p)).collect::<Vec<Pixel>>();
        for line in &self.lines {
            let points = pixels(&line.points);
            if points.len() > 1 {
                line.style.draw_line(&root, &points, unit)?;
            }
            for [a, b] in &line.bars {
                if let (Some(a), Some(b)) = (frame.at(*a), frame.at(*b)) {
                    line.style.draw_bar(&root, [a, b], unit)?;
                }
            }
        }
        // Marks above all lines, those of the first line on top.
        for line in self.lines.iter().rev() {
            for at in pixels(&line.marks) {
                line.style.draw_mark(&root, at, unit)?;
            }
        }
        self.draw_end_names(&root, frame)?;
        legend.draw(&root, self.look)?;
        root.present()?;
        Ok(())
    }

    fn draw_bands(&self, root: &Area<'_>, frame: &Frame) -> Drawn {
        let unit = self.look.unit as i32;
        for band in &self.bands {
            let ends = [band.x.0, band.x.1].map(|x| logged((x, 0.0), frame.log).0.clamp(frame.x.0, frame.x.1));
            if ends[0] >= ends[1] {
                continue;
            }
            let [a, b] = ends.map(|x| frame.pixel((x, frame.y.0)).0);
            root.draw(&Rectangle::new([(a, frame.top), (b, frame.bottom)], band.colour.filled()))?;
            if b < frame.right {
                let border = RGBColor(160, 164, 172).stroke_width(self.look.unit);
                root.draw(&PathElement::new(vec![(b, frame.top), (b, frame.bottom)], border))?;
            }
            // A name wider than its band begins above the band, one line higher than those that fit.
            let fits = b - a > unit * text_width(band.name) as i32;
            let (at, place) = if fits {
                ((i32::midpoint(a, b), frame.top - 6 * unit), HPos::Center)
            } else {
                ((a, frame.top - 20 * unit), HPos::Left)
            };
            root.draw(&Text::new(band.name, at, style(self.look, place, VPos::Bottom)))?;
        }
        Ok(())
    }

    fn draw_axes(&self, root: &Area<'_>, frame: &Frame) -> Drawn {
        let unit = self.look.unit as i32;
        let &Frame { left, top, right, bottom, .. } = frame;
        let write = |text: &str, at: Pixel, h: HPos, v: VPos| {
            root.draw(&Text::new(text.to_owned(), at, style(self.look, h, v)))
        };
        for (value, label) in ticks(frame.y, self.log, &|_| true) {
            let y = frame.pixel((frame.x.0, value)).1;
            let grid = RGBColor(222, 224, 229).stroke_width(self.look.unit);
            root.draw(&PathElement::new(vec![(left, y), (right, y)], grid))?;
            write(&label, (left - 7 * unit, y), HPos::Right, VPos::Center)?;
        }
        let apart = |all: &[(f64, String)]| {
            let reach = all.iter().map(|(value, label)| {
                let (x, half) = (frame.pixel((*value, 0.0)).0, text_width(label) as i32 * unit / 2);
                (x - half, x + half)
            });
            let reach: Vec<(i32, i32)> = reach.collect();
            reach.windows(2).all(|w| w[0].1 + 8 * unit < w[1].0)
        };
        for (value, label) in ticks(frame.x, self.log_x, &apart) {
            let x = frame.pixel((value, frame.y.0)).0;
            root.draw(&PathElement::new(vec![(x, bottom), (x, bottom + 4 * unit)], INK.stroke_width(self.look.unit)))?;
            write(&label, (x, bottom + 7 * unit), HPos::Center, VPos::Top)?;
        }
        let corner = vec![(left, top), (left, bottom), (right, bottom)];
        root.draw(&PathElement::new(corner, INK.stroke_width(self.look.unit)))?;
        write(&self.x_name, (i32::midpoint(left, right), bottom + 25 * unit), HPos::Center, VPos::Top)?;
        let upright = style(self.look, HPos::Center, VPos::Top).transform(FontTransform::Rotate270);
        root.draw(&Text::new(self.y_name.clone(), (4 * unit, i32::midpoint(top, bottom)), upright))?;
        Ok(())
    }

    /// Names at the ends of lines, moved apart where they would overlap.
    fn draw_end_names(&self, root: &Area<'_>, frame: &Frame) -> Drawn {
        let unit = self.look.unit as i32;
        let mut names: Vec<(&str, Pixel, i32)> = self
            .at_ends()
            .filter_map(|(name, line)| line.points.iter().rev().find_map(|p| frame.at(*p)).map(|at| (name, at, at.1)))
            .collect();
        names.sort_by_key(|n| n.2);
        let step = 12 * unit;
        let wanted: Vec<i32> = names.iter().map(|n| n.2).collect();
        for (name, y) in names.iter_mut().zip(moved_apart(&wanted, step, (frame.top, frame.bottom))) {
            name.2 = y;
        }
        for (name, at, y) in names {
            let leader = vec![(frame.right + unit, at.1), (frame.right + 6 * unit, y)];
            root.draw(&PathElement::new(leader, INK.stroke_width(self.look.unit / 2)))?;
            root.draw(&Text::new(
                name.to_owned(),
                (frame.right + 8 * unit, y),
                style(self.look, HPos::Left, VPos::Center),
            ))?;
        }
        Ok(())
    }
}

/// Places at least `step` apart and within `ends` where there is room, each as near to `wanted` (ascending) as the
/// simple way up and down allows.
fn moved_apart(wanted: &[i32], step: i32, ends: (i32, i32)) -> Vec<i32> {
    let mut places = wanted.to_vec();
    for k in 1..places.len() {
        places[k] = places[k].max(places[k - 1] + step);
    }
    let mut limit = ends.1.max(ends.0 + step * (wanted.len() as i32 - 1));
    for place in places.iter_mut().rev() {
        *place = (*place).min(limit);
        limit = *place - step;
    }
    places
}

/// Text of a look.
fn style(look: Look, h: HPos, v: VPos) -> TextStyle<'static> {
    ("sans-serif", TEXT * look.unit).into_font().color(&INK).pos(Pos::new(h, v))
}

/// Registers the font that measures labels, once.
fn register() -> Result<(), &'static str> {
    static DONE: OnceLock<bool> = OnceLock::new();
    let done = DONE.get_or_init(|| register_font("sans-serif", FontStyle::Normal, super::print::FONT).is_ok());
    if *done { Ok(()) } else { Err("the built-in font cannot be read") }
}

/// Width of `text` in a chart, before scaling by its unit.
pub(crate) fn text_width(text: &str) -> u32 {
    let measured = register().ok().and_then(|()| ("sans-serif", 100).into_font().layout_box(text).ok());
    // Without the font: half the height a letter.
    measured.map_or(7 * text.chars().count() as u32, |((x0, _), (x1, _))| {
        (f64::from((x1 - x0) * TEXT as i32) / 100.0).ceil() as u32
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::marks::{Marker, Stroke};

    fn chart() -> Chart {
        let style = Style { marker: Some(Marker::Star), ..Style::line(RGBColor(0, 0, 0), 2, Stroke::Dashed) };
        let mut line = Line::new(vec![(1.0, 0.5), (10.0, 0.75), (f64::NAN, 0.1)], style);
        line.marks.clone_from(&line.points);
        line.bars.push([(10.0, 0.7), (10.0, 0.8)]);
        line.name = Name::Legend("with a mask".into());
        let mut level = Line::new(vec![(1.0, 0.6), (10.0, 0.6)], Style::line(RGBColor(9, 9, 9), 1, Stroke::Full));
        level.name = Name::AtEnd("5-NN".into());
        Chart {
            look: Look::COLUMN,
            x_name: "N".into(),
            y_name: "SSIM".into(),
            log_x: true,
            lines: vec![line, level],
            ..Chart::default()
        }
    }

    #[test]
    fn an_empty_chart_is_no_chart() {
        let chart = Chart { x: Some((0.0, 1.0)), ..Chart::default() };
        assert!(chart.svg().unwrap().is_none());
        let nowhere = Line::new(vec![(f64::NAN, 1.0)], Style::line(RGBColor(0, 0, 0), 1, Stroke::Full));
        assert!(Chart { lines: vec![nowhere], ..Chart::default() }.svg().unwrap().is_none());
    }

    #[test]
    fn names_axes_and_ends_are_written() {
        let svg = chart().svg().unwrap().unwrap();
        for text in ["with a mask", "5-NN", "SSIM", "\nN\n", "0.6", "rotate(270"] {
            assert!(svg.contains(text), "`{text}` is not in {svg}");
        }
        assert!(!svg.contains("NaN"));
    }

    #[test]
    fn names_at_ends_keep_apart() {
        assert_eq!(moved_apart(&[10, 12, 13, 80], 10, (0, 100)), [10, 20, 30, 80]);
        assert_eq!(moved_apart(&[90, 95, 99], 10, (0, 100)), [80, 90, 100]);
        assert_eq!(moved_apart(&[5, 5, 5], 10, (0, 15)), [0, 10, 20], "too many for the room");
        assert!(moved_apart(&[], 10, (0, 15)).is_empty());
    }
}
