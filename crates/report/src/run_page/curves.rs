//! Curves of the page: loss and N over the steps, validation score, and distribution of test scores.

use crate::canvas::{Colour, INK};
use crate::draw::charts::{Chart, ChartAxis, ChartLine, decimate_steps, phase_bands};
use crate::draw::marks::{Stroke, Style};
use minijinja::{Value, context};
use pwrfgs_core::statistics::{self, bounds, quantile};
use pwrfgs_core::{Appearance, Headline};
use pwrfgs_experiment::record::{VALIDATION_MEAN, VALIDATION_MEDIAN, series_column};
use pwrfgs_experiment::{IntervalScores, LoadedRun, scores::MODEL};

/// Maximum number of ranges over which the loss is averaged.
const MOST_RANGES: usize = 150;
const MODEL_COLOUR: Colour = Colour::hex(0x18_4ea3);
/// Colours of baselines, in their order, for the colour-blind (Okabe and Ito).
const BASELINE_COLOURS: [u32; 8] =
    [0x78_7c84, 0xe6_9f00, 0x00_9e73, 0xcc_79a7, 0xd5_5e00, 0x10_1318, 0x96_8200, 0x56_b4e9];

/// Maximum number of baselines in a chart, so that it has at most six curves; `run.html` prints it.
const BASELINES: usize = 5;

/// Returns the index of a baseline in the table of scores; `None` for the model and its members.
fn baseline_index(run: &LoadedRun<'_>, name: &str) -> Option<usize> {
    run.record.scores.table.baselines().position(|baseline| baseline == name)
}

/// Returns the style of a predictor, the same in all charts of a page.
fn predictor_style(run: &LoadedRun<'_>, name: &str) -> Style {
    match baseline_index(run, name) {
        Some(k) => {
            let stroke = [Stroke::DASHED, Stroke::DASH_DOTTED, Stroke::DOTTED][k % 3];
            Style::line(Colour::hex(BASELINE_COLOURS[k % BASELINE_COLOURS.len()]), 2.0, stroke)
        }
        None if name == MODEL => Style::line(MODEL_COLOUR, 3.0, Stroke::FULL),
        None => Style::line(LIGHT, 1.5, Stroke::FULL),
    }
}

/// Selects the `most` best entries, without a change of their order; an oracle baseline only if too few others exist.
/// `name_and_score` returns the predictor of an entry and its score by the first metric.
fn select_best<T>(
    run: &LoadedRun<'_>,
    entries: Vec<T>,
    most: usize,
    name_and_score: impl Fn(&T) -> (&String, f64),
) -> Vec<T> {
    let headline = run.data.task().headline;
    let rank = |(k, entry): (usize, T)| {
        let (name, score) = name_and_score(&entry);
        (run.record.scores.table.oracles.contains(name), headline.cost(score), k, entry)
    };
    let mut ranked: Vec<_> = entries.into_iter().enumerate().map(rank).collect();
    ranked.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    ranked.truncate(most);
    ranked.sort_by_key(|(_, _, k, _)| *k);
    ranked.into_iter().map(|(.., entry)| entry).collect()
}

/// Colour of the second curve of the model, and of its members.
const LIGHT: Colour = Colour::hex(0x6e_a0dc);

/// Heading and SVG.
type Figure = (String, String);

/// Returns heading and SVG of every figure for which there are numbers.
pub(super) fn figures(run: &LoadedRun<'_>) -> Vec<Figure> {
    let mut figures = Vec::new();
    if !run.record.curve.is_empty() {
        figures.extend(loss_figure(run, &run.record.loss_curve()));
        figures.extend(gaussians_figure(run, &run.record.gaussians_curve()));
        figures.extend(validation_figure(run));
    }
    figures.extend(distribution_figure(run));
    figures.extend(reliability_figure(run));
    figures
}

/// Draws the measured against the nominal coverage of prediction intervals; `None` without intervals.
fn reliability_figure(run: &LoadedRun<'_>) -> Option<Figure> {
    let scores = &run.record.scores.table.intervals;
    let curve = |intervals: &IntervalScores| {
        let points = intervals.levels.iter().map(|level| (level.level, level.coverage)).collect();
        let style = Style { width: 3.0, ..predictor_style(run, &intervals.predictor) };
        ChartLine::new(points, style).named(&intervals.predictor)
    };
    // The first line is on top: dashes of a baseline stay visible on the line of the model.
    let mut lines: Vec<ChartLine> =
        scores.iter().rev().filter(|intervals| !intervals.levels.is_empty()).map(curve).collect();
    lines.first()?;
    let equal = ChartLine::new(vec![(0.0, 0.0), (1.0, 1.0)], Style::line(INK, 1.0, Stroke::DASHED));
    lines.push(equal.named("nominal = measured"));
    let axis = |name: &str| ChartAxis { name: name.into(), ends: Some((0.0, 1.0)), log: false };
    let chart = Chart { x: axis("nominal coverage"), y: axis("measured coverage"), lines, ..Chart::default() };
    draw_figure("Prediction intervals: coverage of the test set", &chart)
}

/// Creates a chart of `lines` over the training steps, with the three phases of the training shaded; its vertical axis is
/// logarithmic if `log`.
fn chart_over_steps(run: &LoadedRun<'_>, log: bool, lines: Vec<ChartLine>) -> Chart {
    let training = &run.record.pipeline.training;
    let x = ChartAxis { name: "step".into(), ends: Some((0.0, training.steps as f64)), log: false };
    Chart { x, y: ChartAxis { log, ..ChartAxis::default() }, bands: phase_bands(training), lines, ..Chart::default() }
}

/// Creates a solid line without marks.
fn solid_line(points: Vec<(f64, f64)>, colour: Colour, width: f64) -> ChartLine {
    ChartLine::new(points, Style::line(colour, width, Stroke::FULL))
}

/// Returns the addition to the title of a training curve: `, mean of 4 models`; empty for one model.
fn models_suffix(run: &LoadedRun<'_>) -> String {
    let models = run.record.pipeline.members;
    if models > 1 { format!(", mean of {models} models") } else { String::new() }
}

/// Draws a chart with a title; `None` if there is nothing to draw.
fn draw_figure(title: impl Into<String>, chart: &Chart) -> Option<Figure> {
    let title = title.into();
    chart.draw().map(|canvas| (title.clone(), canvas.svg("chart", &title)))
}

/// Draws the loss on a logarithmic axis: mean and range over short ranges of steps. `None` without points.
fn loss_figure(run: &LoadedRun<'_>, points: &[(f64, f64)]) -> Option<Figure> {
    let ranges: Vec<&[(f64, f64)]> = points.chunks(points.len().div_ceil(MOST_RANGES).max(1)).collect();
    let at_middle = |part: &[(f64, f64)], loss: f64| (part[part.len() / 2].0, loss);
    let losses = |part: &[(f64, f64)]| part.iter().map(|point| point.1).collect::<Vec<f64>>();
    let mean: Vec<_> = ranges.iter().map(|part| at_middle(part, statistics::mean(losses(part)))).collect();
    let upper = ranges.iter().map(|part| at_middle(part, bounds(losses(part)).1));
    let lower = ranges.iter().rev().map(|part| at_middle(part, bounds(losses(part)).0));
    let range: Vec<_> = upper.chain(lower).collect();
    let mut lines = vec![solid_line(mean, MODEL_COLOUR, 2.0)];
    if points.len() > ranges.len() {
        lines.push(ChartLine::new(range, Style::line(MODEL_COLOUR, 1.0, Stroke::Area)));
    }
    draw_figure(format!("Training loss{}", models_suffix(run)), &chart_over_steps(run, true, lines))
}

/// Draws N over the steps on a logarithmic axis. `None` without points.
fn gaussians_figure(run: &LoadedRun<'_>, points: &[(f64, f64)]) -> Option<Figure> {
    let lines = vec![solid_line(decimate_steps(points), MODEL_COLOUR, 2.0)];
    let splats = run.model.is_drawn_as(Appearance::Ellipsoids);
    let title = if splats { "Number of Gaussians" } else { "Number of virtual transmitters" };
    draw_figure(format!("{title}{}", models_suffix(run)), &chart_over_steps(run, true, lines))
}

/// Draws the validation score over the steps, with the baselines on the same samples; `None` without validations.
fn validation_figure(run: &LoadedRun<'_>) -> Option<Figure> {
    let rows = &run.record.validation;
    if rows.is_empty() {
        return None;
    }
    let mut lines = vec![
        solid_line(series_column(rows, VALIDATION_MEAN), MODEL_COLOUR, 3.0).named("model, mean"),
        solid_line(series_column(rows, VALIDATION_MEDIAN), LIGHT, 2.0).named("model, median"),
    ];
    let task = run.data.task();
    let baselines = run.record.facts.validation_baselines.iter().collect();
    // The model has two curves here.
    let shown = select_best(run, baselines, BASELINES - 1, |(name, mean): &&(String, f64)| (name, *mean));
    for (name, mean) in shown {
        lines.push(ChartLine::horizontal(*mean, predictor_style(run, name)).named(name));
    }
    let title = format!("Validation {}: {}{}", task.counted[1], task.headline.name, models_suffix(run));
    draw_figure(title, &chart_over_steps(run, false, lines))
}

/// Number of groups of test samples by spread; `run.html` prints it.
const GROUPS: usize = 10;

/// Draws the error of an ensemble against the spread of its members: median, and range from the 10th to the 90th percentile, of
/// groups of equal numbers of test samples. Returns it with the rank correlation of both; `None` for a single model,
/// or if all members agree exactly.
pub(super) fn confidence_chart(run: &LoadedRun<'_>) -> Option<Value> {
    let measured = run.record.confidence.as_ref()?;
    let groups = measured.group_by_spread(GROUPS);
    let at = |q: f64| move |(spread, errors): &(f64, Vec<f64>)| (*spread, quantile(errors, q));
    let range: Vec<_> = groups.iter().map(at(0.9)).chain(groups.iter().rev().map(at(0.1))).collect();
    let median: Vec<_> = groups.iter().map(at(0.5)).collect();
    let last = groups.last()?.0;
    let mut middle = solid_line(median.clone(), MODEL_COLOUR, 2.5).named("median error per group");
    middle.marks = median;
    let lines = vec![
        middle,
        ChartLine::new(range, Style::line(MODEL_COLOUR, 1.0, Stroke::Area)),
        ChartLine::new(
            vec![(0.0, 0.0), (last, last)],
            Style::line(Colour::hex(BASELINE_COLOURS[0]), 1.5, Stroke::DASHED),
        )
        .named("error = spread"),
    ];
    let x = ChartAxis { name: "spread of the members, RMS".into(), ends: Some((0.0, last)), log: false };
    let y = ChartAxis { name: "error of the mean, RMS".into(), ends: None, log: false };
    let chart = Chart { x, y, lines, ..Chart::default() };
    let rank = measured.rank_correlation();
    let svg = chart.draw()?.svg("chart", "Error against the spread of the members");
    Some(context! { svg, rank => rank.is_finite().then(|| format!("{rank:.2}")), samples => measured.ids.len() })
}

/// Maximum number of points along a curve.
const MOST_POINTS: usize = 400;
/// Share of each predictor within the axis, for errors and ratios without natural limits.
const INSIDE: f64 = 0.98;

/// Draws the share of the test set below each value of the first metric, for the model, its members and the best
/// baselines. `None` without per-sample values.
fn distribution_figure(run: &LoadedRun<'_>) -> Option<Figure> {
    let scores = &run.record.scores;
    let task = run.data.task();
    let headline = task.headline;
    let mut sorted: Vec<(&String, Vec<f64>)> = Vec::new();
    for (name, _) in &scores.predictors {
        let Some(values) = scores.sample_values(name, headline.key) else { continue };
        sorted.push((name, statistics::sorted(values.iter().copied())));
    }
    let (baselines, models): (Vec<_>, Vec<_>) =
        sorted.into_iter().partition(|(name, _)| baseline_index(run, name).is_some());
    let mean = |values: &[f64]| statistics::mean(values.iter().copied());
    let shown = select_best(run, baselines, BASELINES, |(name, values): &(&String, Vec<f64>)| (*name, mean(values)));
    let sorted = [models, shown].concat();
    let ends = axis_ends(&headline, &sorted);
    let (mut lines, mut members) = (Vec::new(), Some("members")); // only the first member has a name, which stands for all
    for (name, sorted) in &sorted {
        let stride = sorted.len().div_ceil(MOST_POINTS).max(1);
        let share = |i: usize| (i + 1) as f64 / sorted.len() as f64;
        let mut points: Vec<_> = (0..sorted.len()).step_by(stride).map(|i| (sorted[i], share(i))).collect();
        points.extend(sorted.last().map(|v| (*v, 1.0)));
        points.retain(|(value, _)| (ends.0..=ends.1).contains(value));
        let line = ChartLine::new(points, predictor_style(run, name));
        let title = if scores.table.members.contains(name) { members.take() } else { Some(name.as_str()) };
        lines.push(match title {
            Some(title) => line.named(title),
            None => line,
        });
    }
    let x = ChartAxis { name: headline.name.into(), ends: Some(ends), log: false };
    let y = ChartAxis { ends: Some((0.0, 1.0)), ..ChartAxis::default() };
    let title = format!("Share of test {} below an {}", task.counted[1], headline.short);
    draw_figure(title, &Chart { x, y, lines, ..Chart::default() })
}

/// Returns the ends of the axis of a metric for the `sorted` values of each predictor, rounded outwards:
/// - SSIM: from the lowest value, at least minus the best possible one, to the best possible one;
/// - error: from the best possible value to the quantile [`INSIDE`] of the worst predictor, at least 1;
/// - SNR, without a best possible value: from the quantile 1 − [`INSIDE`] of the worst predictor to the highest value;
///   −1 to 1 if that range is empty.
fn axis_ends(headline: &Headline, sorted: &[(&String, Vec<f64>)]) -> (f64, f64) {
    let at = |q: f64| sorted.iter().map(move |(_, values)| quantile(values, q)).filter(|v| v.is_finite());
    match (headline.best, headline.higher) {
        (Some(best), true) => {
            let first = sorted.iter().map(|(_, values)| values.first().map_or(best, |v| (v * 10.0).floor() / 10.0));
            (first.fold(best, |low: f64, value| low.min(value).max(-best)), best)
        }
        (Some(best), false) => (best, at(INSIDE).fold(1.0, f64::max).ceil()),
        (None, _) => {
            let low = at(1.0 - INSIDE).fold(f64::INFINITY, f64::min).floor();
            let high = at(1.0).fold(f64::NEG_INFINITY, f64::max).ceil();
            if low < high { (low, high) } else { (-1.0, 1.0) }
        }
    }
}
