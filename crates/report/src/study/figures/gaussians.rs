//! N against training steps: figure 2a of the paper.

use super::Figure;
use crate::draw::charts::{Band, Chart, ChartAxis, ChartLine, decimate_steps, phases};
use crate::draw::marks::{Stroke, Style};
use minijinja::context;
use pwrfgs_experiment::{Setting, StudyVariant};
use std::collections::BTreeMap;

/// Number of marks per line.
const MARKS: usize = 6;

pub(super) fn figure(setting: &Setting) -> Option<Figure> {
    let end = setting.variants.iter().map(|v| v.runs[0].pipeline.training.steps).max().unwrap_or(0) as f64;
    let bands = shared_phases(setting);
    let words = context! { shaded => !bands.is_empty() };
    let mut lines = Vec::new();
    let count = setting.variants.len();
    for (k, variant) in setting.variants.iter().enumerate().filter(|(_, v)| v.runs[0].facts.gaussians > 0) {
        let style = Style::variant(k);
        let [low, middle, high] = curves(variant);
        let mut line = ChartLine::new(decimate_steps(&middle), style).named(&variant.label);
        line.marks = marks(&middle, end, (k as f64 + 0.5) / count as f64);
        lines.push(line);
        if low != high {
            let round = decimate_steps(&high).into_iter().chain(decimate_steps(&low).into_iter().rev()).collect();
            lines.push(ChartLine::new(round, Style { stroke: Stroke::Area, ..style }));
        }
    }
    let chart = Chart {
        x: ChartAxis { name: "training step".into(), ends: Some((0.0, end)), log: false },
        y: ChartAxis { name: "number of Gaussians N".into(), ends: None, log: true },
        bands,
        lines,
        ..Chart::default()
    };
    Figure::chart("gaussians", setting, words, chart)
}

/// Phases, if they are equal in all runs.
fn shared_phases(setting: &Setting) -> Vec<Band> {
    let schedule = |v: &StudyVariant| {
        let t = &v.runs[0].pipeline.training;
        (t.densify_until, t.prune_until, t.steps)
    };
    let first = &setting.variants[0];
    let same = setting.variants.iter().all(|v| schedule(v) == schedule(first));
    if same { phases(&first.runs[0].pipeline.training) } else { Vec::new() }
}

/// Minimum, mean and maximum N at each step that all runs of the variant recorded.
fn curves(variant: &StudyVariant) -> [Vec<(f64, f64)>; 3] {
    let mut at: BTreeMap<u64, Vec<f64>> = BTreeMap::new();
    for (step, n) in variant.runs.iter().flat_map(|r| r.curve_of(4)) {
        at.entry(step as u64).or_default().push(n);
    }
    at.retain(|_, all| all.len() == variant.runs.len());
    let fold = |f: &dyn Fn(&[f64]) -> f64| at.iter().map(|(step, all)| (*step as f64, f(all))).collect();
    let extreme = |f: fn(f64, f64) -> f64| fold(&|all| all.iter().copied().reduce(f).unwrap_or(f64::NAN));
    [extreme(f64::min), fold(&|all| all.iter().sum::<f64>() / all.len() as f64), extreme(f64::max)]
}

/// Some points on the curve; `shift` in 0..1 moves them, so that the marks of two lines do not coincide.
fn marks(points: &[(f64, f64)], end: f64, shift: f64) -> Vec<(f64, f64)> {
    let place = |k: usize| end * (k as f64 + shift) / MARKS as f64;
    (0..MARKS)
        .filter_map(|k| {
            let next = points.partition_point(|p| p.0 < place(k));
            points.get(next).copied()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::marks;

    #[test]
    fn marks_lie_on_the_curve() {
        let points: Vec<(f64, f64)> = (1..=100).map(|k| (f64::from(k), 5.0)).collect();
        let first = marks(&points, 100.0, 0.25);
        assert_eq!(first.len(), 6);
        assert!(first.iter().all(|p| points.contains(p)));
        assert!(marks(&points, 100.0, 0.75).iter().all(|p| !first.contains(p)));
        assert!(marks(&[], 100.0, 0.5).is_empty());
    }
}
