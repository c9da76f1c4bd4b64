//! Which curves the report shows: loss and N over the steps, SSIM on validation, the spread of SSIM over the test part.

use crate::draw::charts::{Chart, Line};
use crate::draw::marks::{Stroke, Style};
use crate::draw::steps::{phases, stairs};
use plotters::style::RGBColor;
use pwrfgs_core::Result;
use pwrfgs_experiment::Results;
use pwrfgs_experiment::folder::{CURVE, VALIDATION};
use pwrfgs_experiment::scores::MODEL;
use pwrfgs_experiment::series;
use serde::Serialize;

/// At most this many places along a curve are drawn.
const PLACES: usize = 400;
/// At most this many stretches of the loss are averaged.
const STRETCHES: usize = 150;
const MODEL_COLOUR: RGBColor = RGBColor(24, 78, 163);
/// For baselines, in their order: told apart by the colour-blind (Okabe and Ito).
const FLOOR_COLOURS: [RGBColor; 8] = [
    RGBColor(120, 124, 132),
    RGBColor(230, 159, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(213, 94, 0),
    RGBColor(16, 19, 24),
    RGBColor(150, 130, 0),
    RGBColor(86, 180, 233),
];

/// A chart with its heading and the meaning of its colours.
#[derive(Serialize)]
pub(super) struct Figure {
    title: &'static str,
    svg: String,
    /// Name, colour and whether it is dashed.
    legend: Vec<(String, String, bool)>,
}

/// Every figure there are numbers for.
pub(super) fn all(results: &Results<'_>) -> Result<Vec<Figure>> {
    let mut figures = Vec::new();
    if let Some(folder) = results.training {
        let rows = series::read(&folder.join(CURVE));
        let column = |k: usize| -> Vec<(f64, f64)> {
            rows.iter().filter_map(|row| Some(((*row.first()?)?, (*row.get(k)?)?))).collect()
        };
        figures.extend(loss(results, &column(2))?);
        figures.extend(gaussians(results, &column(4))?);
        figures.extend(validation(results, &series::read(&folder.join(VALIDATION)))?);
    }
    figures.extend(distribution(results)?);
    Ok(figures)
}

/// A chart over the steps, with the three phases of algorithm 1 shaded.
fn over_steps(results: &Results<'_>) -> Chart {
    let training = &results.pipeline.training;
    let x = Some((0.0, training.steps as f64));
    Chart { x_name: "step".into(), x, bands: phases(training), ..Chart::default() }
}

fn line(points: Vec<(f64, f64)>, colour: RGBColor, width: u32) -> Line {
    Line::new(points, Style::line(colour, width, Stroke::Full))
}

fn figure(title: &'static str, chart: &Chart, legend: &[(&str, RGBColor, bool)]) -> Result<Option<Figure>> {
    let css = |c: &RGBColor| format!("rgb({},{},{})", c.0, c.1, c.2);
    let legend = legend.iter().map(|(name, colour, dashed)| ((*name).to_owned(), css(colour), *dashed)).collect();
    Ok(chart.svg()?.map(|svg| Figure { title, svg, legend }))
}

/// The loss on a logarithmic axis: its mean over short stretches, and the range within each.
fn loss(results: &Results<'_>, points: &[(f64, f64)]) -> Result<Option<Figure>> {
    let stretches: Vec<&[(f64, f64)]> = points.chunks(points.len().div_ceil(STRETCHES).max(1)).collect();
    let middle = |s: &[(f64, f64)], y: f64| (s[s.len() / 2].0, y);
    let fold =
        |s: &[(f64, f64)], f: fn(f64, f64) -> f64| middle(s, s.iter().map(|p| p.1).reduce(f).unwrap_or(f64::NAN));
    let mean: Vec<_> =
        stretches.iter().map(|s| middle(s, s.iter().map(|p| p.1).sum::<f64>() / s.len() as f64)).collect();
    let upper = stretches.iter().map(|s| fold(s, f64::max));
    let range: Vec<_> = upper.chain(stretches.iter().rev().map(|s| fold(s, f64::min))).collect();
    let mut chart = Chart { log: true, ..over_steps(results) };
    if points.len() > stretches.len() {
        chart.lines.push(Line::new(range, Style::line(MODEL_COLOUR, 1, Stroke::Area)));
    }
    chart.lines.push(line(mean, MODEL_COLOUR, 2));
    figure("Training loss", &chart, &[])
}

/// N on a logarithmic axis.
fn gaussians(results: &Results<'_>, points: &[(f64, f64)]) -> Result<Option<Figure>> {
    let chart = Chart { log: true, lines: vec![line(stairs(points), MODEL_COLOUR, 2)], ..over_steps(results) };
    figure("Number of Gaussians", &chart, &[])
}

/// SSIM on the validation samples, with the floors on the very same samples.
fn validation(results: &Results<'_>, rows: &[Vec<Option<f64>>]) -> Result<Option<Figure>> {
    let column = |k: usize| rows.iter().filter_map(|r| Some(((*r.first()?)?, (*r.get(k)?)?))).collect::<Vec<_>>();
    if rows.is_empty() {
        return Ok(None);
    }
    let mut chart = over_steps(results);
    let end = results.pipeline.training.steps as f64;
    let mut legend = vec![("model, mean", MODEL_COLOUR, false), ("model, median", RGBColor(110, 160, 220), false)];
    for ((name, floor), colour) in results.floors.iter().zip(FLOOR_COLOURS.iter().cycle()) {
        let points = vec![(0.0, floor.ssim_mean), (end, floor.ssim_mean)];
        chart.lines.push(Line::new(points, Style::line(*colour, 2, Stroke::Dashed)));
        legend.push((name, *colour, true));
    }
    chart.lines.push(line(column(2), RGBColor(110, 160, 220), 2));
    chart.lines.push(line(column(1), MODEL_COLOUR, 3));
    figure("SSIM on validation samples", &chart, &legend)
}

/// Which share of the test spectra stays below an SSIM.
fn distribution(results: &Results<'_>) -> Result<Option<Figure>> {
    let scores = &results.assessment.scores;
    let mut low: f64 = 1.0;
    let mut chart = Chart { x_name: "SSIM".into(), y: Some((0.0, 1.0)), ..Chart::default() };
    let mut legend = Vec::new();
    let mut floors = FLOOR_COLOURS.iter().cycle();
    for (name, _) in &scores.predictors {
        let Some(values) = scores.samples(name, "ssim") else { continue };
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let stride = sorted.len().div_ceil(PLACES).max(1);
        let share = |i: usize| (i + 1) as f64 / sorted.len() as f64;
        let mut points: Vec<_> = (0..sorted.len()).step_by(stride).map(|i| (sorted[i], share(i))).collect();
        points.extend(sorted.last().map(|v| (*v, 1.0)));
        low = low.min(sorted.first().map_or(1.0, |v| (v * 10.0).floor() / 10.0)).max(-1.0);
        let own = name == MODEL;
        let colour = if own { MODEL_COLOUR } else { *floors.next().unwrap_or(&MODEL_COLOUR) };
        chart.lines.push(line(points, colour, if own { 3 } else { 2 }));
        legend.push((name.as_str(), colour, false));
    }
    chart.lines.reverse(); // the model on top
    chart.x = Some((low, 1.0));
    figure("Share of test spectra below an SSIM", &chart, &legend)
}
