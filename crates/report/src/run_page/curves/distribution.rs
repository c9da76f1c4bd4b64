//! How the first metric of the kind is spread over the test part, for the model and every baseline.

use super::{Chart, FLOOR_COLOURS, Figure, MODEL_COLOUR, figure, line};
use crate::canvas::Colour;
use crate::draw::charts::Axis;
use pwrfgs_core::Headline;
use pwrfgs_experiment::LoadedRun;
use pwrfgs_experiment::scores::MODEL;
use pwrfgs_experiment::statistics::quantile;

/// At most this many places along a curve are drawn.
const PLACES: usize = 400;
/// Of errors and ratios, which have no ends of their own, this share of each predictor's is within the axis.
const INSIDE: f64 = 0.98;

/// Which share of the test part stays below each value.
pub(super) fn figure_of(run: &LoadedRun<'_>) -> Option<Figure> {
    let scores = &run.record.scores;
    let task = run.data.task();
    let headline = task.headline;
    let mut sorted: Vec<(&String, Vec<f64>)> = Vec::new();
    for (name, _) in &scores.predictors {
        let Some(values) = scores.samples(name, headline.key) else { continue };
        let mut values = values.to_vec();
        values.sort_by(f64::total_cmp);
        sorted.push((name, values));
    }
    let ends = ends(&headline, &sorted);
    let mut floors = FLOOR_COLOURS.into_iter().map(Colour::hex).cycle();
    let mut lines = Vec::new();
    for (name, sorted) in &sorted {
        let stride = sorted.len().div_ceil(PLACES).max(1);
        let share = |i: usize| (i + 1) as f64 / sorted.len() as f64;
        let mut points: Vec<_> = (0..sorted.len()).step_by(stride).map(|i| (sorted[i], share(i))).collect();
        points.extend(sorted.last().map(|v| (*v, 1.0)));
        points.retain(|(value, _)| (ends.0..=ends.1).contains(value));
        let own = *name == MODEL;
        let colour = if own { MODEL_COLOUR } else { floors.next().unwrap_or(MODEL_COLOUR) };
        lines.push(line(points, colour, if own { 3.0 } else { 2.0 }).named(name));
    }
    let x = Axis { name: headline.name.into(), ends: Some(ends), log: false };
    let y = Axis { ends: Some((0.0, 1.0)), ..Axis::default() };
    let title = format!("Share of test {} below an {}", task.counted[1], headline.short);
    figure(title, &Chart { x, y, lines, ..Chart::default() })
}

/// Where the axis begins and ends.
fn ends(headline: &Headline, sorted: &[(&String, Vec<f64>)]) -> (f64, f64) {
    let at = |q: f64| sorted.iter().map(move |(_, values)| quantile(values, q)).filter(|v| v.is_finite());
    match (headline.best, headline.higher) {
        (Some(best), true) => {
            let first = sorted.iter().map(|(_, values)| values.first().map_or(best, |v| (v * 10.0).floor() / 10.0));
            (first.fold(best, |low: f64, own| low.min(own).max(-best)), best)
        }
        (Some(best), false) => (best, at(INSIDE).fold(1.0, f64::max).ceil()),
        (None, _) => {
            let low = at(1.0 - INSIDE).fold(f64::INFINITY, f64::min).floor();
            let high = at(1.0).fold(f64::NEG_INFINITY, f64::max).ceil();
            if low < high { (low, high) } else { (-1.0, 1.0) }
        }
    }
}
