//! Rate ratio against signal-to-noise ratio: cost of steering by the prediction for weak and strong transmitters.

use super::Figure;
use super::shown::grey_baselines;
use super::tradeoff::row_style;
use crate::draw::charts::{Chart, ChartAxis, ChartLine};
use crate::draw::marks::Style;
use minijinja::context;
use pwrfgs_core::{Baseline, Dataset, Error, Measurement, Metric, Plugin, Result, evenly};
use pwrfgs_experiment::{EvaluationSet, NoopObserver, Predictor, Record, ScoredPredictor, Session, Setting};

/// Ends of the axis, dB, and number of steps between them.
const LOW_DB: f64 = -20.0;
const HIGH_DB: f64 = 30.0;
const STEPS: usize = 20;
/// Maximum number of predicted test spectra per run.
const SAMPLES: usize = 200;

/// Draws the rate loss against the signal-to-noise ratio; `None` without spectra, or if there is nothing to draw.
///
/// # Errors
/// A damaged model, changed data, or a baseline that cannot be fitted.
pub(super) fn figure(setting: &Setting, data: &Dataset) -> Result<Option<Figure>> {
    if data.observations.spectra().is_none() {
        return Ok(None);
    }
    let metric = |snr: f64| Plugin::parse(&format!("RateRatio(snr_db: {snr:.1})")).map_err(Error::Config);
    let metrics: Vec<Plugin<dyn Metric>> = snrs_db().map(metric).collect::<Result<_>>()?;
    let mut lines = Vec::new();
    let mut fewer = false;
    for (k, variant) in setting.variants.iter().enumerate() {
        let mut curves = Vec::new();
        for run in &variant.runs {
            let test = run.partition(data)?.test;
            fewer |= test.len() > SAMPLES;
            curves.push(model_curve(run, data, &evenly(&test, SAMPLES), &metrics)?);
        }
        let mut line = ChartLine::new(mean_curve(&curves), Style::variant(k)).named(&variant.label);
        // Every fourth point, with a different start per line.
        line.marks = line.points.iter().skip(k % 4).step_by(4).copied().collect();
        lines.push(line);
    }
    lines.extend(baseline_lines(setting, data, &metrics)?);
    let words = context! { part => fewer.then_some(SAMPLES) };
    Ok(Figure::from_chart("eta-snr", setting, words, rate_chart(lines)))
}

/// Returns the rate losses of the model of a run on the samples `part`.
fn model_curve(
    run: &Record,
    data: &Dataset,
    part: &[usize],
    metrics: &[Plugin<dyn Metric>],
) -> Result<Vec<(f64, f64)>> {
    let model = run.model(data)?;
    let samples = EvaluationSet::new(data, part, model.plane());
    let predictor = Predictor::Model(&model.prepare(), None);
    let scored = ScoredPredictor { name: "the model", predictor, metrics };
    Ok(loss_curve(&samples.score(scored, &mut Session::new(&mut NoopObserver))?))
}

/// Creates the chart of rate losses over the signal-to-noise ratio.
fn rate_chart(lines: Vec<ChartLine>) -> Chart {
    let x =
        ChartAxis { name: "transmit signal-to-noise ratio ρ [dB]".into(), ends: Some((LOW_DB, HIGH_DB)), log: false };
    let y = ChartAxis { name: "rate loss 1 − η".into(), log: true, ends: None };
    Chart { x, y, lines, ..Chart::default() }
}

/// Returns the lines of the [`grey_baselines`], fitted to training and validation sets, on at most [`SAMPLES`] test spectra of
/// the first run.
fn baseline_lines(setting: &Setting, data: &Dataset, metrics: &[Plugin<dyn Metric>]) -> Result<Vec<ChartLine>> {
    let run = &setting.variants[0].runs[0];
    let (partition, model) = (run.partition(data)?, run.model(data)?);
    let samples = EvaluationSet::new(data, &evenly(&partition.test, SAMPLES), model.plane());
    let line = |(k, baseline): (usize, &Plugin<dyn Baseline>)| {
        let fitted = baseline.fit(data, partition.known())?;
        let name = baseline.name();
        let scored = ScoredPredictor { name: &name, predictor: Predictor::Baseline(&*fitted), metrics };
        let measured = samples.score(scored, &mut Session::new(&mut NoopObserver))?;
        Ok(ChartLine::new(loss_curve(&measured), row_style(setting, k, &name)).named_at_end(&name))
    };
    // The files of an external baseline may have been moved since the run.
    let is_readable = |baseline: &&Plugin<dyn Baseline>| baseline.check_test(data, &partition.test).is_ok();
    let shown = grey_baselines(setting);
    let line_index =
        |baseline: &Plugin<dyn Baseline>| shown.iter().find(|(_, name)| *name == baseline.name()).map(|(k, _)| *k);
    let readable = run.pipeline.baselines.iter().filter(is_readable);
    readable.filter_map(|baseline| Some((line_index(baseline)?, baseline))).map(line).collect()
}

/// Returns the signal-to-noise ratios at which η is computed, dB.
fn snrs_db() -> impl Iterator<Item = f64> {
    (0..=STEPS).map(|k| LOW_DB + (HIGH_DB - LOW_DB) * k as f64 / STEPS as f64)
}

/// Returns the mean loss 1 − η over samples of each measurement, at its signal-to-noise ratio. Good values of η are all
/// near 1, so the axis of the loss is logarithmic.
fn loss_curve(measured: &[Measurement]) -> Vec<(f64, f64)> {
    snrs_db().zip(measured.iter().map(|m| 1.0 - m.values.mean())).collect()
}

/// Returns the mean of curves with the same horizontal coordinates; empty without curves.
fn mean_curve(curves: &[Vec<(f64, f64)>]) -> Vec<(f64, f64)> {
    let height = |k: usize| curves.iter().map(|c| c[k].1).sum::<f64>() / curves.len() as f64;
    let first = curves.first().map_or(&[][..], Vec::as_slice);
    first.iter().enumerate().map(|(k, point)| (point.0, height(k))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::marks::Stroke;
    use pwrfgs_core::{Goal, Values};

    #[test]
    fn rate_ratios_near_one_are_distinguishable() {
        let line = |ratio: f64| {
            let at = |_| Measurement {
                key: String::new(),
                unit: String::new(),
                goal: Goal::Higher,
                values: Values::PerSample(vec![ratio]),
                note: None,
            };
            loss_curve(&snrs_db().map(at).collect::<Vec<_>>())
        };
        let [poor, good, best] = [0.9, 0.999, 0.9999].map(|ratio| line(ratio)[0].1.log10());
        assert!(
            (poor - good - 2.0).abs() < 1e-6 && (good - best - 1.0).abs() < 1e-6,
            "decades: {poor}, {good}, {best}"
        );
        let lines = [0.9, 0.999, 1.0]
            .map(|ratio| ChartLine::new(line(ratio), Style::line(crate::canvas::INK, 1.0, Stroke::FULL)));
        let svg = rate_chart(lines.into()).draw().unwrap().svg("chart", "");
        assert!(svg.contains(">0.01<") && svg.contains("rate loss 1 − η"), "{svg}");
    }
}
