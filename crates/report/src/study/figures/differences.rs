//! Paired differences from the reference: a mark and an interval per row.

use super::{COLUMN, Figure, PAGE};
use crate::canvas::{Anchor, BLACK, Canvas, INK, LINE, Paint, WHITE, text_width, wrap_text};
use crate::draw::axes::ticks;
use crate::study::comparison::RowKind;
use crate::study::reference::{Reference, RowDifferences};
use minijinja::context;
use pwrfgs_core::statistics::bounds;
use pwrfgs_experiment::Setting;
use pwrfgs_experiment::statistics::{CONFIDENCE, Difference};

/// Maximum number of rows; more would not fit a page.
const ROWS: usize = 40;
/// Distance of rows, and maximum width of their names.
const ROW: f64 = 18.0;
const NAMES: f64 = 230.0;

/// Draws the differences by a metric, whose `axis` has its name and unit; `None` without any, and for too many rows.
pub(in super::super) fn figure(
    setting: &Setting,
    (key, axis): (&str, &str),
    reference: &Reference<'_>,
    differences: &[RowDifferences<'_>],
) -> Option<Figure> {
    // Baselines are far from the variants, whose intervals would be too short to read; they are in the table.
    let is_variant = |d: &&RowDifferences<'_>| [RowKind::Variant, RowKind::External].contains(&d.row.kind);
    let are_several = differences.iter().any(|d| d.row.kind == RowKind::Variant);
    let shown = differences.iter().filter(|d| !are_several || is_variant(d));
    let rows: Vec<(&str, &Difference)> = shown.filter_map(|d| Some((d.row.label, d.by_key.get(key)?))).collect();
    let label = reference.label;
    let percent = (CONFIDENCE * 100.0).round() as u32;
    let words = context! { label, is_by_axis => reference.is_by_axis, percent, are_several };
    let draw = || draw_rows(&rows, &format!("Δ {axis} from {label}"));
    (1..=ROWS).contains(&rows.len()).then(|| Figure::new("differences", setting, words, draw()))
}

/// Draws the rows over an axis that includes 0, with its name.
fn draw_rows(rows: &[(&str, &Difference)], axis: &str) -> Canvas {
    let ends = |d: &Difference| d.interval.map_or([d.mean; 2], |(low, high)| [low, high]);
    let (low, high) = bounds(rows.iter().flat_map(|(_, d)| ends(d)).chain([0.0]).filter(|v| v.is_finite()));
    let margin = if low < high { 0.04 * (high - low) } else { 0.01 };
    let (low, high) = (low - margin, high + margin);
    let names: Vec<Vec<String>> = rows.iter().map(|(name, _)| wrap_text(name, NAMES)).collect();
    let left = 12.0 + names.iter().flatten().map(|line| text_width(line)).fold(0.0, f64::max);
    let lines = names.iter().map(Vec::len).max().unwrap_or(1);
    let (row, top) = (ROW + LINE * (lines as f64 - 1.0), 6.0);
    let width = PAGE.min(left + COLUMN) - left - 10.0;
    let bottom = top + row * rows.len() as f64;
    let axis = wrap_text(axis, width);
    let mut canvas = Canvas::new(left + width + 10.0, bottom + 22.0 + LINE * axis.len() as f64);
    let x = |value: f64| left + width * (value - low) / (high - low);
    let thin = Paint::stroke(INK, 0.9);
    canvas.line(&[[x(0.0), top], [x(0.0), bottom]], thin);
    canvas.line(&[[left, bottom], [left + width, bottom]], thin);
    let fits = |ticks: &[(f64, String)]| {
        let gap = |pair: &[(f64, String)]| x(pair[1].0) - x(pair[0].0);
        ticks.windows(2).all(|pair| gap(pair) > f64::midpoint(text_width(&pair[0].1), text_width(&pair[1].1)) + 8.0)
    };
    for (value, label) in ticks((low, high), false, &fits) {
        canvas.line(&[[x(value), bottom], [x(value), bottom + 4.0]], thin);
        canvas.text([x(value), bottom + 16.0], Anchor::Middle, label);
    }
    for (k, (_, difference)) in rows.iter().enumerate() {
        let y = top + row * (k as f64 + 0.5);
        canvas.lines([left - 6.0, y], Anchor::End, &names[k]);
        let [from, to] = ends(difference);
        canvas.line(&[[x(from), y], [x(to), y]], Paint::stroke(BLACK, 1.4));
        let inside = if difference.is_clear() { BLACK } else { WHITE };
        canvas.circle([x(difference.mean), y], 3.2, Paint::fill(inside).outlined(BLACK, 1.2));
    }
    let middle = left + width / 2.0;
    canvas.lines([middle, bottom + 22.0 + LINE * axis.len() as f64 / 2.0], Anchor::Middle, &axis);
    canvas
}
