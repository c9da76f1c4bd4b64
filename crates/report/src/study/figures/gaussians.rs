//! N against training steps: figure 2a of the paper.

use super::Figure;
use super::tradeoff::method_style;
use crate::draw::charts::{Band, Chart, ChartAxis, ChartLine, decimate_steps, phase_bands};
use crate::draw::marks::{Stroke, Style};
use minijinja::context;
use pwrfgs_core::statistics::{bounds, mean};
use pwrfgs_experiment::{Record, Setting, StudyVariant, VariantFamily};
use std::collections::BTreeMap;

/// Maximum number of marks per line.
const MARKS: usize = 6;
/// Maximum number of names at the ends of lines.
const MOST_NAMES: usize = 16;
/// Ratio of the end of the axis to the last step that changes N, if trainings differ in length.
const AFTER: f64 = 1.5;

/// Draws N against training steps; `None` if there is nothing to draw.
pub(super) fn figure(setting: &Setting) -> Option<Figure> {
    let (bands, (end, last)) = (shared_phases(setting), axis_ends(setting));
    let by_method = VariantFamily::group(setting).len() > 1;
    let words = context! { shaded => !bands.is_empty(), by_method, cut => end < last };
    let chart = Chart {
        x: ChartAxis { name: "training step".into(), ends: Some((0.0, end)), log: false },
        y: ChartAxis { name: "number of Gaussians N".into(), ends: None, log: true },
        bands,
        lines: variant_lines(setting, end),
        ..Chart::default()
    };
    Figure::from_chart("gaussians", setting, words, chart)
}

/// Returns one line per variant up to step `end`, with the range over seeds. With several methods, the legend names the
/// methods, and up to [`MOST_NAMES`] names at the ends of lines distinguish the variants of each; none if there are more.
pub(super) fn variant_lines(setting: &Setting, end: f64) -> Vec<ChartLine> {
    let families = VariantFamily::group(setting);
    let by_method = families.len() > 1;
    let (mut lines, mut names) = (Vec::new(), Vec::new());
    let (mut shift, count) = (0.5, setting.variants.len() as f64);
    for (m, family) in families.iter().enumerate() {
        let variants = family.variants.iter().zip(&family.values).filter(|(v, _)| v.runs[0].facts.gaussians > 0);
        for (v, (variant, value)) in variants.enumerate() {
            let style = if by_method { method_style(family, m) } else { Style::variant(v) };
            let [low, middle, high] = seed_range(variant, end);
            let mut line = ChartLine::new(decimate_steps(&middle), style);
            line.marks = select_marks(&middle, end, shift / count);
            shift += 1.0;
            if !by_method {
                line = line.named(&variant.label);
            } else if v == 0 {
                line = line.named(&family.title);
            }
            let is_whole = variant.runs[0].pipeline.training.steps as f64 >= end;
            if let Some(last) = line.points.last().filter(|_| by_method && is_whole && family.variants.len() > 1) {
                let invisible = Style { stroke: Stroke::None, ..style };
                let name = ChartLine::new(vec![*last], invisible).named_at_end(value);
                // Variants of several methods may end at one N with one name.
                if !names.iter().any(|other: &ChartLine| (&other.points, &other.name) == (&name.points, &name.name)) {
                    names.push(name);
                }
            }
            lines.push(line);
            if low != high {
                let round = decimate_steps(&high).into_iter().chain(decimate_steps(&low).into_iter().rev()).collect();
                lines.push(ChartLine::new(round, Style { stroke: Stroke::Area, ..style }));
            }
        }
    }
    if names.len() <= MOST_NAMES {
        lines.append(&mut names);
    }
    lines
}

/// Returns the end of the axis, and the last step of all trainings. If these differ in length, the axis ends soon after the last
/// change of N, which is constant from there.
fn axis_ends(setting: &Setting) -> (f64, f64) {
    let steps = || setting.runs().map(|run| run.pipeline.training.steps);
    let (least, most) = (steps().min().unwrap_or(0), steps().max().unwrap_or(0) as f64);
    let changed = |curve: Vec<(f64, f64)>| {
        let is_last = |point: &(f64, f64)| curve.last().is_some_and(|last| last.1 == point.1);
        let before = curve.iter().rposition(|point| !is_last(point))?;
        curve.get(before + 1).map(|point| point.0)
    };
    let last = setting.runs().filter_map(|run| changed(run.gaussians_curve())).fold(0.0, f64::max);
    (if least as f64 == most || last == 0.0 { most } else { most.min(AFTER * last) }, most)
}

/// Returns the phases of training as shaded ranges if they are equal in all variants; otherwise none.
fn shared_phases(setting: &Setting) -> Vec<Band> {
    let schedule = |v: &StudyVariant| {
        let t = &v.runs[0].pipeline.training;
        (t.densify_until, t.prune_until, t.steps)
    };
    let first = &setting.variants[0];
    let same = setting.variants.iter().all(|v| schedule(v) == schedule(first));
    if same { phase_bands(&first.runs[0].pipeline.training) } else { Vec::new() }
}

/// Returns the minimum, mean and maximum N at each step up to `end` that all runs of the variant recorded.
fn seed_range(variant: &StudyVariant, end: f64) -> [Vec<(f64, f64)>; 3] {
    let mut at: BTreeMap<u64, Vec<f64>> = BTreeMap::new();
    for (step, n) in variant.runs.iter().flat_map(Record::gaussians_curve) {
        at.entry(step as u64).or_default().push(n);
    }
    at.retain(|step, counts| *step as f64 <= end && counts.len() == variant.runs.len());
    let line = |value: fn(&[f64]) -> f64| at.iter().map(|(step, counts)| (*step as f64, value(counts))).collect();
    let least = line(|counts| bounds(counts.iter().copied()).0);
    let most = line(|counts| bounds(counts.iter().copied()).1);
    [least, line(|counts| mean(counts.iter().copied())), most]
}

/// Returns the first point of the curve at or after each of [`MARKS`] equally spaced steps up to `end`, if there is one. `shift`,
/// from 0 to 1, moves these steps, so that the marks of two lines do not coincide.
fn select_marks(points: &[(f64, f64)], end: f64, shift: f64) -> Vec<(f64, f64)> {
    let step = |k: usize| end * (k as f64 + shift) / MARKS as f64;
    (0..MARKS)
        .filter_map(|k| {
            let next = points.partition_point(|p| p.0 < step(k));
            points.get(next).copied()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::select_marks;

    #[test]
    fn marks_lie_on_the_curve() {
        let points: Vec<(f64, f64)> = (1..=100).map(|k| (f64::from(k), 5.0)).collect();
        let first = select_marks(&points, 100.0, 0.25);
        assert_eq!(first.len(), 6);
        assert!(first.iter().all(|p| points.contains(p)));
        assert!(select_marks(&points, 100.0, 0.75).iter().all(|p| !first.contains(p)));
        assert!(select_marks(&[], 100.0, 0.5).is_empty());
    }
}
