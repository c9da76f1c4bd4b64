//! Received powers on the page: distribution of errors, and best and worst links.

use super::examples::Example;
use super::maps::{LinkError, error_maps};
use crate::canvas::{BLACK, Colour};
use crate::draw::charts::{Chart, ChartAxis, ChartLine};
use crate::draw::marks::{Stroke, Style};
use minijinja::{Value, context};
use pwrfgs_core::statistics::{evenly, quantile, sorted};
use pwrfgs_experiment::LoadedRun;

/// Maximum number of dots of the scatter plot.
const DOTS: usize = 3_000;
/// Number of bars of the histogram.
const BARS: usize = 48;
const BLUE: Colour = Colour::hex(0x18_4ea3);

/// Test link: measured and predicted power, dBm.
#[derive(Clone, Copy)]
struct PowerPair {
    link: usize,
    measured: f64,
    predicted: f64,
}

impl PowerPair {
    /// Returns the error, positive if the prediction is too high, dB.
    fn error(&self) -> f64 {
        self.predicted - self.measured
    }
}

/// Returns the values for `powers.html`: figures, median and mean error (dB), counts, unit of the powers, maps and examples. Links
/// without a finite error are left out, except in the examples.
pub(super) fn section(run: &LoadedRun<'_>, chosen: &[Example]) -> Value {
    let mut pairs = Vec::with_capacity(run.partition.test.len());
    super::examples::for_each_link(run, &run.partition.test, |link, truth, prediction| {
        pairs.push(PowerPair { link, measured: truth.pixels[0] as f64, predicted: prediction.pixels[0] as f64 });
    });
    pairs.retain(|pair| pair.error().is_finite());
    let errors = sorted(pairs.iter().map(PowerPair::error));
    let [_, unit] = run.data.task().level_name_at(&run.data.scene.receivers);
    let figures: Vec<(&str, String)> =
        [draw_histogram(&errors), draw_scatter(&pairs, unit)].into_iter().flatten().collect();
    let by_link = pairs.iter().map(|pair| LinkError { link: pair.link, error: pair.error() }).collect();
    context! {
        figures,
        median => signed_db(quantile(&errors, 0.5)),
        mean => signed_db(errors.iter().sum::<f64>() / errors.len().max(1) as f64),
        dots => pairs.len().min(DOTS),
        links => pairs.len(),
        unit,
        maps => error_maps(run, by_link),
        examples => example_rows(run, chosen),
    }
}

/// Formats decibels with two decimals and sign.
fn signed_db(db: f64) -> String {
    format!("{db:+.2}").replace('-', "−")
}

/// Draws the histogram of the ascending `errors` in per cent of the test links, and returns title and SVG. The outermost bars
/// contain all larger errors, about one in a hundred at most. `None` without errors, or if the others do not fit into
/// [`BARS`] bars of 10 dB.
fn draw_histogram(errors: &[f64]) -> Option<(&'static str, String)> {
    errors.first()?;
    let reach = quantile(errors, 0.01).abs().max(quantile(errors, 0.99).abs());
    let reach = if reach > 0.0 { reach } else { 1.0 };
    let step = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0].into_iter().find(|s| 2.0 * reach / s <= BARS as f64)?;
    let half = (reach / step).ceil().max(1.0) as i64;
    let mut counts = vec![0usize; 2 * half as usize];
    for error in errors {
        counts[((error / step).floor() as i64).clamp(-half, half - 1).abs_diff(-half) as usize] += 1;
    }
    let share = |count: usize| 100.0 * count as f64 / errors.len() as f64;
    let edge = |k: usize| (k as i64 - half) as f64 * step;
    let mut outline = vec![(edge(0), 0.0)];
    for (k, &count) in counts.iter().enumerate() {
        outline.extend([(edge(k), share(count)), (edge(k + 1), share(count))]);
    }
    outline.push((edge(counts.len()), 0.0));
    let most = counts.iter().map(|&count| share(count)).fold(0.0, f64::max);
    let median = quantile(errors, 0.5);
    let upright = |x: f64, stroke| ChartLine::new(vec![(x, 0.0), (x, 1.05 * most)], Style::line(BLACK, 1.3, stroke));
    let lines = vec![
        upright(0.0, Stroke::FULL),
        upright(median, Stroke::DASHED).named(&format!("median, {} dB", signed_db(median))),
        ChartLine::new(outline.clone(), Style::line(BLUE, 1.2, Stroke::FULL)),
        ChartLine::new(outline, Style::line(BLUE, 1.0, Stroke::Area)),
    ];
    let x =
        ChartAxis { name: "predicted − measured, dB".into(), ends: Some((edge(0), edge(counts.len()))), log: false };
    let name = format!("test links per {step} dB, %");
    let y = ChartAxis { name, ends: Some((0.0, 1.05 * most.max(1e-9))), log: false };
    let title = "Errors of the model";
    Some((title, Chart { x, y, lines, ..Chart::default() }.draw()?.svg("chart", title)))
}

/// Draws the predicted against the measured power of at most [`DOTS`] links with the line of equality, and returns title and
/// SVG; `None` without links.
fn draw_scatter(pairs: &[PowerPair], unit: &str) -> Option<(&'static str, String)> {
    pairs.first()?;
    let dots: Vec<(f64, f64)> = evenly(pairs, DOTS).iter().map(|pair| (pair.measured, pair.predicted)).collect();
    let powers = || dots.iter().flat_map(|(a, b)| [*a, *b]);
    let (low, high) = (powers().fold(f64::INFINITY, f64::min), powers().fold(f64::NEG_INFINITY, f64::max));
    let margin = (0.04 * (high - low)).max(1.0);
    let ends = (low - margin, high + margin);
    let lines = vec![
        ChartLine::new(vec![(ends.0, ends.0), (ends.1, ends.1)], Style::line(BLACK, 1.3, Stroke::DASHED))
            .named("predicted = measured"),
        ChartLine::new(dots, Style::line(BLUE.with_opacity(0.55), 2.6, Stroke::Dots)),
    ];
    let axis = |name: &str| ChartAxis { name: format!("{name}, {unit}"), ends: Some(ends), log: false };
    let chart = Chart { x: axis("measured"), y: axis("predicted"), lines, ..Chart::default() };
    let title = "Predicted against measured";
    Some((title, chart.draw()?.svg("chart", title)))
}

/// Returns the best, median and worst link as table rows.
fn example_rows(run: &LoadedRun<'_>, chosen: &[Example]) -> Vec<Value> {
    let row = |example: &Example| {
        let Example { score, truth, prediction, .. } = example;
        context! {
            measured => format!("{:.1}", truth.pixels[0]).replace('-', "−"),
            predicted => format!("{:.1}", prediction.pixels[0]).replace('-', "−"),
            error => format!("{score:.2}"),
            ..example.words(run)
        }
    };
    chosen.iter().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn power_plots_handle_empty_equal_and_extreme_links() {
        assert!(draw_histogram(&[]).is_none() && draw_scatter(&[], "dBm").is_none());
        let one = PowerPair { link: 0, measured: -60.0, predicted: -60.0 };
        for errors in [vec![0.0], vec![0.0; 9], vec![-300.0, 0.1, 0.2, 4000.0]] {
            if let Some((_, svg)) = draw_histogram(&errors) {
                assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
            }
        }
        assert!(draw_histogram(&[0.0]).is_some());
        assert!(draw_scatter(&[one, one], "dBm").unwrap().1.contains("measured, dBm"));
    }
}
