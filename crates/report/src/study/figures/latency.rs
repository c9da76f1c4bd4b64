//! Latency of a prediction by stage: stacked bars.

use super::{COLUMN, Figure};
use crate::canvas::{Anchor, Canvas, Colour, INK, Paint, Point, text_width, wrap_text};
use crate::draw::axes::ticks;
use crate::draw::charts::{Legend, SYMBOL, Symbol};
use crate::draw::marks::SHADES;
use crate::study::comparison::has_unsteady_times;
use minijinja::context;
use pwrfgs_experiment::{Record, Setting, StudyVariant, distinct, statistics::Spread, text::number};

/// Stages with their keys in `scores.csv`.
const STAGES: [(&str, &str); 4] = [
    ("network", "latency_network_ms"),
    ("projection", "latency_projection_ms"),
    ("sort", "latency_sort_ms"),
    ("blending", "latency_blending_ms"),
];
const TOTAL: &str = "latency_total_ms";

/// Heights of a row, of each further line of its name, and of its bar.
const ROW: f64 = 21.0;
const FURTHER: f64 = 12.0;
const BAR: f64 = 13.0;
/// Minimum width of a box; the file rounds smaller ones to 0.
const LEAST: f64 = 0.005;
/// Maximum width of the names of variants.
const NAMES: f64 = 130.0;

/// Bar of one variant.
struct Bar<'a> {
    label: &'a str,
    /// Milliseconds of each stage.
    stages: Vec<f64>,
    total: Spread,
}

impl<'a> Bar<'a> {
    /// Creates the bar of a variant; `None` if it was not timed.
    fn of(variant: &'a StudyVariant) -> Option<Self> {
        let stages: Option<Vec<f64>> = STAGES.iter().map(|(_, key)| Some(variant.score(key)?.mean)).collect();
        Some(Self { label: &variant.label, stages: stages?, total: variant.score(TOTAL)? })
    }

    /// Returns the length of the bar: the sum over the stages, milliseconds.
    fn stage_sum(&self) -> f64 {
        self.stages.iter().sum()
    }

    /// Formats the text at the end of the bar: total and deviation, milliseconds.
    fn end_text(&self) -> String {
        match self.total.deviation {
            // Two digits of the deviation, and as many decimals of the mean.
            Some(deviation) if deviation > 0.0 => {
                let decimals = (1.0 - deviation.log10().floor()).clamp(0.0, 6.0) as usize;
                format!("{:.decimals$} ± {deviation:.decimals$}", self.total.mean)
            }
            _ => number(self.total.mean),
        }
    }
}

/// Draws the latency by stage as stacked bars; `None` without timed variants, or if times are not steady.
pub(super) fn figure(setting: &Setting) -> Option<Figure> {
    if has_unsteady_times(setting) {
        return None;
    }
    let bars: Vec<Bar<'_>> = setting.variants.iter().filter_map(Bar::of).collect();
    let longest = bars.iter().map(Bar::stage_sum).fold(0.0, f64::max);
    if !(longest > 0.0 && longest.is_finite()) {
        return None;
    }
    let words = context! { machines => machines(setting) };
    Some(Figure::new("latency", setting, words, draw_bars(&bars, longest)))
}

/// Describes the machines of the measurements, each once.
fn machines(setting: &Setting) -> Vec<String> {
    let describe = |run: &Record| {
        let machine = &run.facts.machine;
        format!("{}, {} thread{}", machine.cpu, machine.threads, if machine.threads == 1 { "" } else { "s" })
    };
    distinct(setting.runs().map(describe))
}

/// Draws the bars with names, axis and legend; the axis ends at the `longest` bar, milliseconds.
fn draw_bars(bars: &[Bar<'_>], longest: f64) -> Canvas {
    let labels: Vec<Vec<String>> = bars.iter().map(|b| wrap_text(b.label, NAMES)).collect();
    let names = labels.iter().flatten().map(|line| text_width(line)).fold(0.0, f64::max);
    let row = ROW + FURTHER * (labels.iter().map(Vec::len).max().unwrap_or(1) as f64 - 1.0);
    let (left, top) = (names + 12.0, 6.0);
    let ends = bars.iter().map(|b| text_width(&b.end_text())).fold(0.0, f64::max);
    let width = COLUMN - left - ends - 10.0;
    let bottom = top + row * bars.len() as f64;
    let key = |(k, (name, _)): (usize, &(&str, &str))| {
        let mut drawing = Canvas::new(13.0, SYMBOL);
        draw_box(&mut drawing, [0.0, 2.0], [13.0, 10.0], SHADES[k]);
        Symbol { drawing, meaning: (*name).to_owned() }
    };
    let is_drawn = |(k, _): &(usize, _)| bars.iter().any(|bar| width * bar.stages[*k] / longest >= LEAST);
    let legend = Legend::new(STAGES.iter().enumerate().filter(is_drawn).map(key).collect(), COLUMN);
    let mut canvas = Canvas::new(COLUMN, bottom + 36.0 + legend.height());
    let thin = Paint::stroke(INK, 0.9);
    let x = |ms: f64| left + width * ms / longest;
    let fit = |candidates: &[(f64, String)]| {
        candidates
            .windows(2)
            .all(|w| x(w[1].0) - x(w[0].0) > f64::midpoint(text_width(&w[0].1), text_width(&w[1].1)) + 8.0)
    };
    for (ms, label) in ticks((0.0, longest), false, &fit) {
        canvas.line(&[[x(ms), bottom], [x(ms), bottom + 4.0]], thin);
        canvas.text([x(ms), bottom + 16.0], Anchor::Middle, label);
    }
    for (k, bar) in bars.iter().enumerate() {
        let y = top + row * (k as f64 + 0.5);
        canvas.lines([left - 6.0, y], Anchor::End, &labels[k]);
        let mut begun = 0.0;
        for (stage, ms) in bar.stages.iter().enumerate() {
            draw_box(&mut canvas, [x(begun), y - BAR / 2.0], [x(begun + ms) - x(begun), BAR], SHADES[stage]);
            begun += ms;
        }
        canvas.text([x(begun) + 5.0, y + 4.0], Anchor::Start, bar.end_text());
    }
    canvas.line(&[[left, top], [left, bottom], [left + width, bottom]], thin);
    canvas.text([left + width / 2.0, bottom + 32.0], Anchor::Middle, "latency of one prediction [ms]");
    legend.draw(&mut canvas, bottom + 36.0);
    canvas
}

/// Draws a box with a thin dark border; nothing below the width [`LEAST`].
fn draw_box(canvas: &mut Canvas, at: Point, size: Point, shade: u32) {
    if size[0] >= LEAST {
        canvas.rect(at, size, Paint::fill(Colour::hex(shade)).outlined(INK, 0.6));
    }
}
