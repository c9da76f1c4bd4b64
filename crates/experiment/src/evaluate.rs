//! Evaluation of the model and all baselines on the test set, by all metrics of the pipeline.
//!
//! Baselines choose their hyperparameters on the validation set and are then fitted on training and validation samples
//! together, which makes them stronger.

use crate::evaluation_set::{EvaluationSet, Predictor, ScoredPredictor};
use crate::load::{ActiveRun, SplitData};
use crate::partial_scores::PartialScores;
use crate::record::Confidence;
use crate::repeatability::CeilingEstimator;
use crate::residuals::{left_out_links, trained_links};
use crate::scores::{IntervalScores, MODEL, ScoreTable, Scores};
use crate::session::{Session, run_stage};
use crate::text::number;
use pwrfgs_core::kriging::{Correlation, ProcessFit};
use pwrfgs_core::{
    Baseline, Dataset, FittingSet, Image, ImagePlane, Measurement, Metric, Misfit, ModelFacts, Parts, Plugin, Result,
    Scope, Task, check_compatible, check_stopped, evenly,
};
use pwrfgs_model::{Ensemble, Prepared, ResidualProcess, Residuals, file};
use pwrfgs_pipeline::defaults;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Number of test links predicted together.
const CHUNK: usize = 64;
/// Largest ensemble whose members are scored one by one: each is a column of the score table.
const MOST_SHOWN: usize = 4;

/// Scores of a model and of the baselines.
#[derive(Clone, Debug)]
pub struct EvaluationResult {
    /// The scores.
    pub scores: Scores,
    /// Spread and error of the members of an ensemble; `None` for a single model.
    pub confidence: Option<Confidence>,
}

impl ActiveRun<'_, '_> {
    /// Scores `model`, or an ensemble with its members, and the baselines of the pipeline on the test set. For an ensemble,
    /// also measures whether the spread of its members predicts the error.
    ///
    /// # Errors
    /// The model predicts other observations than the data ([`check_alike`]), or a baseline returns an error; otherwise as
    /// [`EvaluationSet::score`].
    pub fn evaluate(&mut self, model: &Ensemble) -> Result<EvaluationResult> {
        self.evaluate_parts(model, &mut PartialScores::default())
    }

    /// Scores as [`Self::evaluate`] does. The results of an earlier start with the same request are taken from `folder`, and
    /// each further result is written there, to [`PARTIAL_SCORES`](crate::folder::PARTIAL_SCORES).
    ///
    /// # Errors
    /// As [`Self::evaluate`]; a file that cannot be read or written.
    pub fn evaluate_into(&mut self, folder: &Path, model: &Ensemble) -> Result<EvaluationResult> {
        let mut partial = PartialScores::open(folder, model, self.pipeline, self.split)?;
        self.evaluate_parts(model, &mut partial)
    }

    /// Scores as [`Self::evaluate`] does; takes the results that an earlier start has written to `partial`, and adds the
    /// others.
    ///
    /// # Errors
    /// As [`Self::evaluate`]; a file that cannot be written.
    pub(crate) fn evaluate_parts(&mut self, model: &Ensemble, partial: &mut PartialScores) -> Result<EvaluationResult> {
        let SplitData { data, partition } = self.split;
        let ready = &model.prepare();
        check_alike(ready, data)?;
        let table = ScoreTable { task: data.task(), ..ScoreTable::default() };
        let test = EvaluationSet::new(data, &partition.test, model.plane());
        let mut evaluation = OpenEvaluation {
            scorer: TestScorer { run: self, test, left_out: None },
            partial,
            predictors: Vec::new(),
            table,
        };
        evaluation.score_model(MODEL, model, ready)?;
        let is_ensemble = model.members().len() > 1;
        let confidence = is_ensemble.then(|| evaluation.score_members(model, ready)).transpose()?;
        evaluation.table.notes.extend(model.residuals().map(|residuals| residuals_note(residuals, data.task())));
        evaluation.table.share = model.residuals().and_then(Residuals::share);
        let columns = evaluation.measure_intervals(model, ready)?;
        evaluation.score_baselines()?;
        Ok(EvaluationResult { scores: Scores { intervals: columns, ..evaluation.conclude()? }, confidence })
    }

    /// Scores the baselines except external ones, fitted to the training set alone, on the samples of `validation.csv`. Returns
    /// their names with the mean of the first validation metric; a mean that is not finite is left out. Empty if the pipeline
    /// validates nothing.
    ///
    /// # Errors
    /// A baseline returns an error; otherwise as [`EvaluationSet::score`].
    pub(crate) fn validation_baselines(
        &mut self,
        plane: &ImagePlane,
        partial: &mut PartialScores,
    ) -> Result<Vec<(String, f64)>> {
        let (pipeline, SplitData { data, partition }) = (self.pipeline, self.split);
        let validated = evenly(&partition.validation, pipeline.training.validation_samples);
        if validated.is_empty() || pipeline.training.validate_every == 0 {
            return Ok(Vec::new());
        }
        let (samples, metrics) =
            (EvaluationSet::new(data, &validated, plane), defaults::validation_metrics(data.task()));
        let mut means = Vec::new();
        for (index, baseline) in pipeline.baselines.iter().enumerate().filter(|(_, baseline)| !baseline.is_external()) {
            self.session.check_stopped()?;
            means.extend(partial.complete(&format!("validation of baseline {index}"), || {
                let fitted = baseline.fit(data, FittingSet::train(&partition.train).stopped_by(self.session.stop))?;
                let name = baseline.name_for(data.task());
                let predictor = Predictor::Baseline(&*fitted);
                let measured =
                    samples.score(ScoredPredictor { name: &name, predictor, metrics: &metrics }, self.session)?;
                Ok(measured.first().map(|m| m.values.mean()).filter(|mean| mean.is_finite()).map(|mean| (name, mean)))
            })?);
        }
        Ok(means)
    }
}

/// Evaluation in progress: the measurements of the predictors so far.
struct OpenEvaluation<'r, 'a, 's> {
    scorer: TestScorer<'r, 'a, 's>,
    partial: &'r mut PartialScores,
    /// Names and measurements, the model first.
    predictors: Vec<(String, Vec<Measurement>)>,
    /// Oracle baselines, ensemble members, intervals and notes of these predictors.
    table: ScoreTable,
}

/// Run with its test set.
struct TestScorer<'r, 'a, 's> {
    run: &'r mut ActiveRun<'a, 's>,
    test: EvaluationSet<'r>,
    /// Lists of links that calibrate the intervals of baselines; `None` if the model has no intervals.
    left_out: Option<Vec<Vec<usize>>>,
}

/// Scores of one baseline.
#[derive(Serialize, Deserialize)]
struct ScoredBaseline {
    name: String,
    measured: Vec<Measurement>,
    is_oracle: bool,
    intervals: Option<IntervalScores>,
    /// What readers must know of the baseline.
    note: Option<String>,
}

impl OpenEvaluation<'_, '_, '_> {
    /// Scores `model`, the model or a member, and adds it as predictor `name`; `ready` is its prepared form.
    fn score_model(&mut self, name: &str, model: &Ensemble, ready: &Prepared<'_>) -> Result<()> {
        let title = if name == MODEL { "the model" } else { name };
        let facts = ModelFacts {
            means: &model.means_from(self.scorer.run.split.data.scene.origin),
            gaussian_bytes: model.gaussian_bytes(),
            file_bytes: file::size(model),
        };
        let (predictor, metrics) = (Predictor::Model(ready, Some(facts)), &self.scorer.run.pipeline.metrics);
        let score =
            || self.scorer.test.score(ScoredPredictor { name: title, predictor, metrics }, self.scorer.run.session);
        let measured = self.partial.complete(name, score)?;
        self.predictors.push((name.to_owned(), measured));
        Ok(())
    }

    /// Scores the members of an ensemble, if they are at most [`MOST_SHOWN`], and adds them as predictors. Returns spread and
    /// error of all members.
    fn score_members(&mut self, model: &Ensemble, ready: &Prepared<'_>) -> Result<Confidence> {
        let shown = if model.members().len() > MOST_SHOWN { &[] } else { model.members() };
        for (name, member) in model.names().iter().zip(shown) {
            let (name, member) = (format!("member {name}"), Ensemble::of(member.clone()));
            self.score_model(&name, &member, &member.prepare())?;
            self.table.members.push(name);
        }
        let SplitData { data, partition } = self.scorer.run.split;
        let measure = || Confidence::measure(ready, data, &partition.test, self.scorer.run.session);
        self.partial.complete("confidence", measure)
    }

    /// Measures the intervals of a calibrated model, and lists the links that calibrate those of the baselines. Returns the
    /// columns of `samples.csv`, a row per test link; empty without a calibration, or if it has too few blocks.
    fn measure_intervals(&mut self, model: &Ensemble, ready: &Prepared<'_>) -> Result<Vec<Vec<f64>>> {
        let Some(calibration) = model.calibration() else { return Ok(Vec::new()) };
        self.scorer.left_out =
            Some(left_out_links(self.scorer.run.pipeline, self.scorer.run.split, model.members().len())?);
        let measure = || self.scorer.run.measure_intervals((MODEL, ready), calibration);
        let (scores, rows) = self.partial.complete("intervals", measure)?;
        self.table.intervals.push(scores);
        Ok(rows)
    }

    /// Scores the baselines of the pipeline.
    fn score_baselines(&mut self) -> Result<()> {
        let (pipeline, SplitData { data, partition }) = (self.scorer.run.pipeline, self.scorer.run.split);
        pipeline.check_external(data, &partition.test)?;
        for (index, baseline) in pipeline.baselines.iter().enumerate() {
            self.scorer.run.session.check_stopped()?;
            let mut score = || self.scorer.score_baseline(baseline);
            // The file of predictions may have been mended since.
            let scored = if baseline.is_external() {
                score()?
            } else {
                self.partial.complete(&format!("baseline {index}"), score)?
            };
            self.add_baseline(scored);
        }
        Ok(())
    }

    /// Adds the scores of a baseline.
    fn add_baseline(&mut self, ScoredBaseline { name, measured, is_oracle, intervals, note }: ScoredBaseline) {
        let table = &mut self.table;
        table.oracles.extend(is_oracle.then(|| name.clone()));
        table.intervals.extend(intervals);
        table.notes.extend(note.filter(|note| !table.notes.contains(note)));
        self.predictors.push((name, measured));
    }

    /// Summarises all scores, with noise ceiling, paired differences and notes.
    fn conclude(self) -> Result<Scores> {
        let (ActiveRun { pipeline, split, session, .. }, predictors, mut table) =
            (self.scorer.run, self.predictors, self.table);
        let SplitData { data, partition } = split;
        let ceiling = CeilingEstimator::new(data, &pipeline.metrics, session.stop).estimate(partition)?;
        let ids: Vec<u32> = partition.test.iter().map(|&i| data.label(i)).collect();
        let baseline_samples = partition.known().all().len();
        let model_samples = trained_links(pipeline, partition).len();
        table.samples = [model_samples, baseline_samples, ids.len()];
        table.notes.extend(ceiling.notes);
        // The first intervals are those of the model.
        table.notes.extend(table.intervals.iter().map(|scores| scores.note(data.task(), &table.intervals[0])));
        for (name, measured) in &predictors {
            let note = |m: &Measurement| Some(format!("{} of {name}: {}", m.key, m.note.as_ref()?));
            table.notes.extend(measured.iter().filter_map(note));
        }
        let mut scores = Scores::new(ids, predictors, table);
        let summaries: Vec<_> = ceiling.metrics.into_iter().map(|(key, estimate)| (key, estimate.summary)).collect();
        scores.table.add_ceiling(&summaries);
        let position = |&i: &usize| (data.label(i), data.placed.then(|| data.sample(i).position()));
        scores.table.paired = scores.paired_differences(&partition.test.iter().map(position).collect());
        Ok(scores)
    }
}

impl TestScorer<'_, '_, '_> {
    /// Fits `baseline` to training and validation samples and scores it. If the model has intervals, also scores those of the
    /// baseline, unless it is an oracle.
    fn score_baseline(&mut self, baseline: &Plugin<dyn Baseline>) -> Result<ScoredBaseline> {
        let SplitData { data, partition } = self.run.split;
        let run = &mut *self.run;
        let fitted = baseline.fit(data, partition.known().stopped_by(run.session.stop))?;
        let name = baseline.name_for(data.task());
        // An external baseline reads a file: its latency is not that of a method.
        let is_measured = |metric: &&Plugin<dyn Metric>| !baseline.is_external() || metric.scope() != Scope::Model;
        let metrics: Vec<_> = run.pipeline.metrics.iter().filter(is_measured).cloned().collect();
        let predictor = Predictor::Baseline(&*fitted);
        let measured = self.test.score(ScoredPredictor { name: &name, predictor, metrics: &metrics }, run.session)?;
        let mut intervals = None;
        if let Some(left_out) = self.left_out.as_ref().filter(|_| !fitted.is_oracle())
            && let Some(calibration) = run.calibrate_baseline(&*fitted, left_out)?
        {
            intervals = Some(run.measure_intervals((&name, &*fitted), &calibration)?.0);
        }
        Ok(ScoredBaseline { name, measured, is_oracle: fitted.is_oracle(), intervals, note: fitted.note() })
    }
}

/// Describes the share of a model and its residual processes.
fn residuals_note(residuals: &Residuals, task: Task) -> String {
    let describe = |process: &ResidualProcess| {
        let ProcessFit { correlation: Correlation { kind, scales: [x, y, z, _], noise }, .. } = process.fit;
        let lengths = if x == y && y == z { vec![x] } else { vec![x, y, z] };
        let lengths = lengths.into_iter().map(number).collect::<Vec<_>>().join(", ");
        format!("{} with {lengths} m, noise {}", kind.words(), number(noise))
    };
    let mut processes: Vec<String> = residuals.processes().iter().flatten().map(describe).collect();
    processes.dedup(); // receivers may share a fit
    let share = residuals.describe_share(task).unwrap_or_default();
    format!("{share}; residuals are Kriged ({})", processes.join("; "))
}

/// Checks that a model predicts observations such as those of the data: task, size, directions, receivers and frequencies.
///
/// # Errors
/// [`Error::Config`](pwrfgs_core::Error::Config) if they differ; the message gives the first difference.
pub fn check_alike(model: &Prepared<'_>, data: &Dataset) -> Result<()> {
    check_compatible(&Parts { data: Some(data), trained: Some(model.setup()), ..Parts::default() })
        .map_err(Misfit::error)
}

impl Confidence {
    /// Measures spread of the members and error of their mean on `samples` (indices of links).
    ///
    /// # Errors
    /// A spectrum that cannot be read; [`pwrfgs_core::Error::Stopped`] once the session is stopped.
    pub fn measure(model: &Prepared<'_>, data: &Dataset, samples: &[usize], session: &mut Session<'_>) -> Result<Self> {
        let stop = session.stop;
        run_stage(session.observer, "measuring the spread of members", |progress| {
            let mut confidence = Self { ids: samples.iter().map(|&i| data.label(i)).collect(), ..Self::default() };
            let measure_link =
                |(&i, (mean, deviation)): (&usize, (Image, Image))| spread_and_error(data, i, mean, &deviation);
            for chunk in samples.chunks(CHUNK) {
                check_stopped(stop)?;
                let queries = data.queries(chunk);
                let predicted = chunk.par_iter().zip(model.predict_many_with_deviation(&queries));
                let pairs: Vec<(f64, f64)> = predicted.map(measure_link).collect();
                confidence.spreads.extend(pairs.iter().map(|(spread, _)| spread));
                confidence.errors.extend(pairs.iter().map(|(_, error)| error));
                progress(confidence.errors.len(), samples.len());
            }
            data.observations.check()?;
            Ok(confidence)
        })
    }
}

/// Returns the root mean squares over the pixels of link `i`: of `deviation`, and of the `mean` prediction minus the measurement.
fn spread_and_error(data: &Dataset, i: usize, mean: Image, deviation: &Image) -> (f64, f64) {
    let (shown, truth) = (data.task().shown(mean), data.image(i));
    let errors = shown.pixels.iter().zip(&truth.pixels).map(|(a, b)| *a as f64 - *b as f64);
    (root_mean_square(deviation.pixels.iter().map(|p| *p as f64)), root_mean_square(errors))
}

/// Returns the root mean square of `values`; NaN without values.
fn root_mean_square(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    (values.map(|value| value.powi(2)).sum::<f64>() / count).sqrt()
}
