//! How the errors of powers and channels are spread over the test part: a mean hides a tail.

use super::{Figure, looks};
use crate::draw::charts::{Axis, Chart, Line};
use crate::study::Setting;
use minijinja::context;
use pwrfgs_experiment::Record;
use pwrfgs_experiment::scores::MODEL;
use pwrfgs_experiment::statistics::quantile;
use std::collections::BTreeMap;

/// Shares of the test part that are drawn.
const PLACES: usize = 200;
/// This share of every predictor is within the axis.
const INSIDE: f64 = 0.98;

/// The share of the test part below each value of the first metric; nothing of spectra, whose SSIM has a figure of its own.
pub(super) fn figure(setting: &Setting) -> Option<Figure> {
    if setting.task().has_pixels {
        return None;
    }
    let headline = setting.headline();
    let tail = if headline.higher { 1.0 - INSIDE..=1.0 } else { 0.0..=INSIDE };
    let points = |runs: &[Record], predictor: &str| -> Vec<(f64, f64)> {
        let samples = runs.iter().filter_map(|run| run.scores.by_id(predictor, headline.key));
        let mut values: Vec<f64> = samples.flat_map(BTreeMap::into_values).filter(|v| v.is_finite()).collect();
        values.sort_by(f64::total_cmp);
        let shares = (0..=PLACES).map(|k| k as f64 / PLACES as f64).filter(|share| tail.contains(share));
        if values.is_empty() { Vec::new() } else { shares.map(|share| (quantile(&values, share), share)).collect() }
    };
    let mut lines = Vec::new();
    for (k, variant) in setting.variants.iter().enumerate() {
        let mut line = Line::new(points(&variant.runs, MODEL), looks::variant(k)).named(&variant.label);
        line.marks = line.points.iter().skip(10 + 5 * (k % 4)).step_by(20).copied().collect();
        lines.push(line);
    }
    for (k, name) in setting.floors().into_iter().enumerate() {
        lines.push(Line::new(points(&setting.variants[0].runs, name), looks::floor(k)).named(name));
    }
    let x = Axis { name: headline.name.into(), ..Axis::default() };
    let y = Axis { name: "share of the test part below".into(), ends: Some((0.0, 1.0)), log: false };
    let percent = (INSIDE * 100.0).round() as u32;
    let chart = Chart { x, y, lines, ..Chart::default() };
    Figure::chart("distribution", setting, context! { axis => headline.name, percent }, chart)
}
