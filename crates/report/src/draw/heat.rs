//! Values over a plane as a coloured map with a bar, axes in metres and receivers.

use super::plan::Plan;
use super::ticks::{label, linear_ticks};
use crate::canvas::{Anchor, BLACK, Canvas, INK, Paint, Path, Pixels, Point, WHITE};
use pwrfgs_core::colour::{Rgb, cyclic, sequential};

/// Width of the picture, and the largest height of the map.
const WIDTH: f64 = 470.0;
const MOST_HEIGHT: f64 = 420.0;
/// Room above the map for the title, and below for the bar.
const HEAD: f64 = 22.0;
const FOOT: f64 = 44.0;
/// Where there is no finite value.
const NOTHING: Rgb = [0xe3, 0xe5, 0xe9];
/// Units of the picture between two arrows.
const ARROWS: f64 = 26.0;

/// How values become colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Colours {
    /// From the smallest, dark, to the largest, light.
    Sequential,
    /// Degrees, once around.
    Cyclic,
}

/// What is mapped.
#[derive(Clone, Debug)]
pub struct Heat<'a> {
    /// Above the map.
    pub title: String,
    /// Below the bar.
    pub unit: String,
    /// Names of the axes, across first.
    pub names: [&'static str; 2],
    /// Where the first value lies, metres.
    pub first: Point,
    /// Metres between values.
    pub step: f64,
    /// Values across.
    pub columns: usize,
    /// Row by row, the lowest first; NaN where there is none.
    pub values: &'a [f32],
    /// How they become colours.
    pub colours: Colours,
    /// Where receivers are.
    pub receivers: Vec<Point>,
    /// A vector for every value, drawn as an arrow now and then; empty for none.
    pub arrows: &'a [[f32; 2]],
}

impl Heat<'_> {
    /// The picture.
    pub fn draw(&self) -> Canvas {
        let rows = self.values.len() / self.columns.max(1);
        let half = self.step / 2.0;
        let end = |k: usize, count: usize| self.first[k] + self.step * (count.max(1) as f64 - 0.5);
        let corners = [self.first.map(|v| v - half), [end(0, self.columns), end(1, rows)]];
        let plan = Plan::new(corners, self.names, WIDTH, MOST_HEIGHT);
        let mut map = plan.canvas();
        let [a, b] = [plan.place([corners[0][0], corners[1][1]]), plan.place([corners[1][0], corners[0][1]])];
        let (low, high) = self.range();
        map.pixels(a, [b[0] - a[0], b[1] - a[1]], self.pixels(rows, low, high));
        self.draw_arrows(&mut map, &plan);
        self.receivers.iter().for_each(|at| plan.receiver(&mut map, *at));
        plan.axes(&mut map);
        let width = plan.size[0].max(300.0);
        let mut canvas = Canvas::new(width, HEAD + plan.size[1] + FOOT);
        canvas.text([width / 2.0, 15.0], Anchor::Middle, &self.title);
        canvas.put([(width - plan.size[0]) / 2.0, HEAD], 1.0, &map);
        self.draw_bar(&mut canvas, HEAD + plan.size[1] + 4.0, (low, high));
        canvas
    }

    /// What the colours span.
    fn range(&self) -> (f64, f64) {
        if self.colours == Colours::Cyclic {
            return (0.0, 360.0);
        }
        let finite = self.values.iter().copied().filter(|v| v.is_finite()).map(f64::from);
        let (low, high) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        match high - low {
            gap if gap > 1e-6 * high.abs().max(1e-9) => (low, high),
            _ if low.is_finite() => (low - 0.5, low + 0.5),
            _ => (0.0, 1.0),
        }
    }

    fn colour(&self, value: f64, (low, high): (f64, f64)) -> Rgb {
        match self.colours {
            _ if !value.is_finite() => NOTHING,
            Colours::Sequential => sequential((value - low) / (high - low)),
            Colours::Cyclic => cyclic(value / 360.0),
        }
    }

    fn pixels(&self, rows: usize, low: f64, high: f64) -> Pixels {
        let upwards = (0..rows).rev().flat_map(|row| &self.values[row * self.columns..][..self.columns]);
        let rgba = upwards.map(|v| self.colour(f64::from(*v), (low, high))).flat_map(|[r, g, b]| [r, g, b, 255]);
        Pixels { width: self.columns, height: rows, rgba: rgba.collect(), smooth: false }
    }

    fn draw_arrows(&self, canvas: &mut Canvas, plan: &Plan) {
        if self.arrows.len() != self.values.len() {
            return;
        }
        let [o, x] = [self.first, [self.first[0] + self.step, self.first[1]]].map(|p| plan.place(p));
        let stride = (ARROWS / (x[0] - o[0]).max(1e-9)).ceil().max(1.0) as usize;
        let (mut lines, rows) = (Path::default(), self.values.len() / self.columns);
        for row in (stride / 2..rows).step_by(stride) {
            for column in (stride / 2..self.columns).step_by(stride) {
                let [u, v] = self.arrows[row * self.columns + column].map(f64::from);
                let length = u.hypot(v);
                if !(length.is_finite() && length > 1e-3) {
                    continue;
                }
                let far = [column, row].map(|k| self.step * k as f64);
                let [px, py] = plan.place([self.first[0] + far[0], self.first[1] + far[1]]);
                let [u, v] = [u / length, -v / length].map(|part| part * 0.36 * ARROWS * length.clamp(0.25, 1.0));
                let tip = [px + u, py + v];
                let barb = |side: f64| [tip[0] - 0.55 * u + side * 0.35 * v, tip[1] - 0.55 * v - side * 0.35 * u];
                lines.add(&[[px - u, py - v], tip]);
                lines.add(&[barb(1.0), tip, barb(-1.0)]);
            }
        }
        canvas.path(lines.clone(), Paint::stroke(WHITE.faint(0.75), 2.6));
        canvas.path(lines, Paint::stroke(BLACK, 1.0));
    }

    /// The bar with its numbers and its unit.
    fn draw_bar(&self, canvas: &mut Canvas, top: f64, (low, high): (f64, f64)) {
        let width = (0.7 * canvas.width).min(300.0);
        let left = (canvas.width - width) / 2.0;
        let value = |k: i32| low + (high - low) * f64::from(k) / 255.0;
        let rgba = (0..256).map(|k| self.colour(value(k), (low, high))).flat_map(|[r, g, b]| [r, g, b, 255]).collect();
        canvas.framed([left, top], [width, 9.0], Pixels { width: 256, height: 1, rgba, smooth: false });
        let numbers = match self.colours {
            Colours::Cyclic => vec![0.0, 90.0, 180.0, 270.0, 360.0],
            Colours::Sequential => linear_ticks(low, high),
        };
        let stride = numbers.len().div_ceil(7).max(1);
        canvas.letters.size = 10.0;
        for v in numbers.into_iter().filter(|v| (low..=high).contains(v)).step_by(stride) {
            let x = left + width * (v - low) / (high - low);
            canvas.line(&[[x, top + 9.0], [x, top + 12.0]], Paint::stroke(INK, 0.8));
            canvas.text([x, top + 22.0], Anchor::Middle, label(v));
        }
        canvas.text([canvas.width / 2.0, top + 36.0], Anchor::Middle, &self.unit);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_map_is_drawn_whatever_its_values() {
        let flat = [3.0; 6];
        let broken = [f32::NAN, f32::INFINITY, -60.0, -61.0, -70.0, f32::NEG_INFINITY];
        let none = [f32::NAN; 6];
        for values in [&flat, &broken, &none] {
            for colours in [Colours::Sequential, Colours::Cyclic] {
                let heat = Heat {
                    title: "received power".into(),
                    unit: "dBm".into(),
                    names: ["x", "y"],
                    first: [0.0, 1.0],
                    step: 0.5,
                    columns: 3,
                    values,
                    colours,
                    receivers: vec![[0.5, 1.0], [99.0, 0.0]],
                    arrows: &[[1.0, 0.0], [0.0, 1.0], [0.0, 0.0], [f32::NAN, 1.0], [0.5, 0.5], [-1.0, 0.0]],
                };
                let svg = heat.draw().svg("map", "");
                assert!(svg.contains("dBm") && !svg.contains("NaN") && !svg.contains("inf"), "{svg}");
            }
        }
    }
}
