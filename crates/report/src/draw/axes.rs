//! Grid and axes of a chart, laid out by plotters, and where data lie between them.

use super::backend::{GRID, Hand};
use super::ticks::{Tick, ticks};
use crate::canvas::font::{TEXT, text_width};
use crate::canvas::{Canvas, Colour, INK, Point};
use plotters::prelude::*;

/// One axis.
#[derive(Clone, Debug, Default)]
pub(crate) struct Axis {
    /// Empty where the heading says it.
    pub name: String,
    /// Those of what is drawn, with some air, where nothing is said.
    pub ends: Option<(f64, f64)>,
    /// Whether equal steps are equal factors.
    pub log: bool,
}

/// An axis whose ends are known; their logarithms where it has one.
pub(super) struct Scale {
    ends: (f64, f64),
    log: bool,
}

impl Scale {
    /// Nothing where there is nothing to see.
    pub(super) fn new(axis: &Axis, values: impl Iterator<Item = f64>) -> Option<Self> {
        let mut scale = Self { ends: (0.0, 0.0), log: axis.log };
        scale.ends = if let Some((low, high)) = axis.ends {
            (scale.place(low), scale.place(high))
        } else {
            let values = values.map(|v| scale.place(v)).filter(|v| v.is_finite());
            let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
            let air = (0.05 * (high - low)).max(if axis.log { 0.02 } else { 1e-9 });
            (low - air, high + air)
        };
        (scale.ends.0 < scale.ends.1).then_some(scale)
    }

    fn place(&self, value: f64) -> f64 {
        if self.log && value.is_finite() { value.log10() } else { value }
    }

    /// From 0 at the one end to 1 at the other, for a place.
    fn part(&self, place: f64) -> f64 {
        (place - self.ends.0) / (self.ends.1 - self.ends.0)
    }
}

/// Where data lie on the picture.
pub(super) struct Frame {
    pub(super) x: Scale,
    pub(super) y: Scale,
    pub(super) left: f64,
    pub(super) top: f64,
    pub(super) right: f64,
    pub(super) bottom: f64,
}

impl Frame {
    /// Where a value stands between left and right, beyond which nothing is.
    pub(super) fn across(&self, x: f64) -> f64 {
        (self.left + (self.right - self.left) * self.x.part(self.x.place(x))).clamp(self.left, self.right)
    }

    /// The place of a value; `None` where it has no finite one.
    pub(super) fn at(&self, (x, y): (f64, f64)) -> Option<Point> {
        let place = [self.across(x), self.bottom - (self.bottom - self.top) * self.y.part(self.y.place(y))];
        place.iter().all(|v| v.is_finite()).then_some(place)
    }

    /// Draws grid, ticks and names. To plotters both axes count pixels of its own, so that ticks, which are ours, are
    /// key points with known labels.
    pub(super) fn draw(&self, canvas: &mut Canvas, height: f64, [x, y]: [&Axis; 2]) {
        let fine = |length: f64| (length * GRID).round() as i32;
        let (across, up) = (self.right - self.left, self.bottom - self.top);
        let apart = |all: &[Tick]| {
            let reach = |tick: &Tick| (across * self.x.part(tick.0), text_width(&tick.1) / 2.0);
            all.windows(2).map(|w| (reach(&w[0]), reach(&w[1]))).all(|((a, p), (b, q))| a + p + 8.0 < b - q)
        };
        let key = |tick: Tick, scale: &Scale, length: f64| (fine(length * scale.part(tick.0)), tick.1);
        let x_ticks = ticks(self.x.ends, x.log, &apart).into_iter().map(|t| key(t, &self.x, across));
        let y_ticks = ticks(self.y.ends, y.log, &|_| true).into_iter().map(|t| key(t, &self.y, up));
        let [(x_keys, x_labels), (y_keys, y_labels)]: [(Vec<i32>, Vec<String>); 2] = [x_ticks.unzip(), y_ticks.unzip()];
        let label = |keys: &[i32], labels: &[String], key: i32| {
            keys.iter().position(|k| *k == key).map_or_else(String::new, |k| labels[k].clone())
        };
        let line = |colour| plain(colour).stroke_width(GRID as u32);
        let letters = ("sans-serif", TEXT * GRID).into_font().color(&plain(INK));
        let (beside, below) = (canvas.width - self.right, canvas.height - height);
        let root = Hand(canvas).into_drawing_area();
        let drawn = ChartBuilder::on(&root)
            .margin_left(fine(4.0))
            .margin_top(fine(self.top))
            .margin_right(fine(beside))
            .margin_bottom(fine(below))
            .set_label_area_size(LabelAreaPosition::Left, fine(self.left - 4.0))
            .set_label_area_size(LabelAreaPosition::Bottom, fine(height - self.bottom))
            .build_cartesian_2d(
                (0..fine(across)).with_key_points(x_keys.clone()),
                (0..fine(up)).with_key_points(y_keys.clone()),
            )
            .and_then(|mut axes| {
                let x_label = |key: &i32| label(&x_keys, &x_labels, *key);
                let y_label = |key: &i32| label(&y_keys, &y_labels, *key);
                let mut mesh = axes.configure_mesh();
                mesh.disable_x_mesh().bold_line_style(line(Colour::hex(0xde_e0e5))).axis_style(line(INK));
                mesh.set_all_tick_mark_size(fine(3.5)).label_style(letters.clone()).axis_desc_style(letters);
                mesh.x_label_formatter(&x_label).y_label_formatter(&y_label).x_desc(&x.name).y_desc(&y.name).draw()
            });
        drawn.expect("a canvas takes everything");
    }
}

/// As plotters has it.
fn plain(colour: Colour) -> RGBColor {
    let [r, g, b] = colour.rgb;
    RGBColor(r, g, b)
}
