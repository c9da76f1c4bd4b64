//! Distribution of errors, and errors against the distance to the nearest training transmitter.
//!
//! If test transmitters are millimetres from training transmitters, a copy of the nearest spectrum scores best, and a
//! mean over the test set does not describe positions farther away. A mean of powers or channels hides large errors.

use super::Figure;
use super::shown::grey_baselines;
use super::tradeoff::row_style;
use crate::draw::charts::{Chart, ChartAxis, ChartLine};
use crate::draw::marks::{Stroke, Style};
use minijinja::context;
use pwrfgs_core::statistics::{quantile, sorted};
use pwrfgs_core::{Headline, Task};
use pwrfgs_experiment::{Record, Setting, scores::MODEL};
use std::collections::BTreeMap;

/// Minimum number of test samples per bin, and maximum number of bins.
const PER_BIN: usize = 10;
const MOST_BINS: usize = 8;
/// Maximum number of variants with bands of quartiles; more bands overlap, and look alike in grey.
const MOST_BANDS: usize = 2;

/// Draws the error against the distance to the nearest training transmitter, which reveals leakage of a split; `None`
/// without distances.
pub(super) fn distance_figure(setting: &Setting) -> Option<Figure> {
    let mut lines = Vec::new();
    let banded = setting.variants.len() <= MOST_BANDS;
    let task = setting.task();
    for (k, variant) in setting.variants.iter().enumerate() {
        let (style, bins) = (Style::variant(k), error_bins(&variant.runs, MODEL, task));
        let quartile = |q: usize| bins.iter().map(move |b| (b.distance, b.quartiles[q]));
        let mut line = ChartLine::new(quartile(1).collect(), style).named(&variant.label);
        line.marks.clone_from(&line.points);
        lines.push(line);
        if banded {
            let round = quartile(2).chain(quartile(0).rev()).collect();
            lines.push(ChartLine::new(round, Style { stroke: Stroke::Area, ..style }));
        }
    }
    for (k, name) in grey_baselines(setting) {
        // Equal in all variants, except for splits that depend on the seed.
        let bins = error_bins(&setting.variants[0].runs, name, task);
        let points = bins.iter().map(|b| (b.distance, b.quartiles[1])).collect();
        lines.push(ChartLine::new(points, row_style(setting, k, name)).named_at_end(name));
    }
    let x = ChartAxis { name: "distance to the nearest training transmitter [m]".into(), log: true, ends: None };
    let Headline { name, higher, best, .. } = task.headline;
    let name = best.filter(|_| higher).map_or_else(|| name.to_owned(), |best| format!("error {best} − {name}"));
    let chart = Chart { x, y: ChartAxis { name: name.clone(), ..ChartAxis::default() }, lines, ..Chart::default() };
    Figure::from_chart("distance", setting, context! { banded, axis => name }, chart)
}

/// Bin of test samples of similar distance.
#[derive(Debug, PartialEq)]
struct Bin {
    /// Median distance, m.
    distance: f64,
    /// Quartiles of the error.
    quartiles: [f64; 3],
}

/// Returns the bins of errors by distance over all `runs` of one predictor; none if it lacks the first metric.
fn error_bins(runs: &[Record], predictor: &str, task: Task) -> Vec<Bin> {
    let Headline { key, higher, best, .. } = task.headline;
    // As the axis of `distance_figure` says.
    let drawn = |score: f64| best.filter(|_| higher).map_or(score, |best| best - score);
    let pairs = |run: &Record| -> Vec<(f64, f64)> {
        let samples = run.scores.values_by_id(predictor, key).unwrap_or_default();
        samples.iter().filter_map(|(id, score)| Some((*run.test.nearest_train_m.get(id)?, drawn(*score)))).collect()
    };
    let samples = runs.first().map_or(0, |r| pairs(r).len());
    bin_pairs(runs.iter().flat_map(pairs).collect(), samples / PER_BIN)
}

/// Groups pairs of distance and error by distance in `count` bins, at least 2 and at most [`MOST_BINS`], but no more than pairs.
/// Omits pairs that are not finite, and distances of 0, because the axis is logarithmic.
fn bin_pairs(mut pairs: Vec<(f64, f64)>, count: usize) -> Vec<Bin> {
    pairs.retain(|p| p.0 > 0.0 && p.0.is_finite() && p.1.is_finite());
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let count = count.clamp(2, MOST_BINS).min(pairs.len());
    let bin = |k: usize| {
        let part = &pairs[k * pairs.len() / count..(k + 1) * pairs.len() / count];
        let distances: Vec<f64> = part.iter().map(|p| p.0).collect();
        let errors = sorted(part.iter().map(|p| p.1));
        Bin { distance: quantile(&distances, 0.5), quartiles: [0.25, 0.5, 0.75].map(|q| quantile(&errors, q)) }
    };
    (0..count).map(bin).collect()
}

/// Number of points of a distribution.
const SHARES: usize = 200;
/// Share of the scores of each predictor that is drawn.
const INSIDE: f64 = 0.98;

/// Draws the share of the test set below each value of the first metric, without the worst; `None` for spectra, whose SSIM is in
/// other figures, and without scores.
pub(super) fn distribution_figure(setting: &Setting) -> Option<Figure> {
    if setting.task().has_pixels {
        return None;
    }
    let headline = setting.headline();
    let tail = if headline.higher { 1.0 - INSIDE..=1.0 } else { 0.0..=INSIDE };
    let points = |runs: &[Record], predictor: &str| -> Vec<(f64, f64)> {
        let samples = runs.iter().filter_map(|run| run.scores.values_by_id(predictor, headline.key));
        let values = sorted(samples.flat_map(BTreeMap::into_values).filter(|v| v.is_finite()));
        let shares = (0..=SHARES).map(|k| k as f64 / SHARES as f64).filter(|share| tail.contains(share));
        if values.is_empty() { Vec::new() } else { shares.map(|share| (quantile(&values, share), share)).collect() }
    };
    let mut lines = Vec::new();
    for (k, variant) in setting.variants.iter().enumerate() {
        let mut line = ChartLine::new(points(&variant.runs, MODEL), Style::variant(k)).named(&variant.label);
        // Every twentieth point, with a different start per line.
        line.marks = line.points.iter().skip(10 + 5 * (k % 4)).step_by(20).copied().collect();
        lines.push(line);
    }
    for (k, name) in grey_baselines(setting) {
        lines.push(ChartLine::new(points(&setting.variants[0].runs, name), row_style(setting, k, name)).named(name));
    }
    let x = ChartAxis { name: headline.name.into(), ..ChartAxis::default() };
    let y = ChartAxis { name: "share of the test set below".into(), ends: Some((0.0, 1.0)), log: false };
    let percent = (INSIDE * 100.0).round() as u32;
    let chart = Chart { x, y, lines, ..Chart::default() };
    Figure::from_chart("distribution", setting, context! { axis => headline.name, percent }, chart)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_are_equally_full_and_omit_unplaced_samples() {
        let mut pairs: Vec<(f64, f64)> = (1..=10).map(|k| (f64::from(k), f64::from(k) / 10.0)).collect();
        pairs.extend([(0.0, 9.0), (f64::INFINITY, 9.0)]);
        pairs.reverse();
        let bins = bin_pairs(pairs, 1);
        assert_eq!(bins.len(), 2);
        assert_eq!((bins[0].distance, bins[0].quartiles), (3.0, [0.2, 0.3, 0.4]));
        assert_eq!((bins[1].distance, bins[1].quartiles), (8.0, [0.7, 0.8, 0.9]));
        assert!(bin_pairs(Vec::new(), 5).is_empty());
        assert_eq!(bin_pairs(vec![(1.0, 0.5)], 5).len(), 1);
        assert_eq!(bin_pairs(vec![(1.0, 0.5); 1000], 50).len(), MOST_BINS);
    }
}
