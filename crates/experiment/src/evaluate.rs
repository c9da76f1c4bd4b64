//! Evaluation of the model and all baselines on the test set, by all metrics of the pipeline.
//!
//! Baselines choose their hyperparameters on the validation set and are then fitted on training and validation samples
//! together, which makes them stronger.

use crate::evaluation_set::EvaluationSet;
use crate::intervals::Calibrator;
use crate::load::SplitData;
use crate::record::Confidence;
use crate::repeatability::ceiling;
use crate::scores::{MODEL, ScoreTable, Scores};
use crate::session::{Session, staged};
use crate::text::number;
use pwrfgs_core::kriging::Correlation;
use pwrfgs_core::{
    Dataset, FittingSet, Image, ImagePlane, Metric, Misfit, ModelFacts, Parts, Plugin, Result, Scope, check_stopped,
    compatible, evenly,
};
use pwrfgs_model::{Ensemble, Prepared, ProcessFit, ResidualProcess, Residuals, file};
use pwrfgs_pipeline::{Pipeline, defaults};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Number of test spectra predicted together.
const CHUNK: usize = 64;

/// Scores of a model and of the baselines.
#[derive(Clone, Debug)]
pub struct EvaluationResult {
    /// The scores.
    pub scores: Scores,
    /// Spread and error of the members of an ensemble.
    pub confidence: Option<Confidence>,
}

/// Scores `model`, or an ensemble with its members, and the baselines of the pipeline on the test set of `data`. For an
/// ensemble, also measures whether the spread of its members predicts the error.
///
/// # Errors
/// The image size of the model differs from the data, or a metric or baseline returns an error;
/// [`Error::Stopped`](pwrfgs_core::Error::Stopped) once the session is stopped.
pub fn evaluate(
    model: &Ensemble,
    pipeline: &Pipeline,
    split: &SplitData,
    session: &mut Session<'_>,
) -> Result<EvaluationResult> {
    let SplitData { data, partition } = split;
    let (ensemble, model, plane) = (model, &model.prepare(), model.plane());
    check_alike(model, data)?;
    let test = EvaluationSet::new(data, &partition.test, plane);
    let score = |ensemble: &Ensemble, ready: &Prepared<'_>, name: &str, session: &mut Session<'_>| {
        let facts = ModelFacts {
            means: &ensemble.means_from(data.scene.origin),
            gaussian_bytes: ensemble.gaussian_bytes(),
            file_bytes: file::size(ensemble),
        };
        test.model(name, ready, Some(facts), &pipeline.metrics, session)
    };
    let mut predictors = vec![(MODEL.to_owned(), score(ensemble, model, "the model", session)?)];
    let (mut members, mut confidence) = (Vec::new(), None);
    if ensemble.members().len() > 1 {
        for (name, member) in ensemble.names().iter().zip(ensemble.members()) {
            let name = format!("member {name}");
            let member = Ensemble::of(member.clone());
            let scores = score(&member, &member.prepare(), &name, session)?;
            predictors.push((name.clone(), scores));
            members.push(name);
        }
        confidence = Some(Confidence::measure(model, data, &partition.test, session)?);
    }
    let (mut notes, mut oracles): (Vec<String>, Vec<String>) = Default::default();
    notes.extend(ensemble.residuals().map(note_of));
    let (mut intervals, mut columns, mut calibrator) = (Vec::new(), Vec::new(), None);
    if let Some(calibration) = ensemble.calibration() {
        let own = Calibrator::new(pipeline, split, ensemble.members().len())?;
        let (scores, of_links) = own.measure((MODEL, model), calibration, session)?;
        (intervals, columns, calibrator) = (vec![scores], of_links, Some(own));
    }
    pipeline.check_external(data, &partition.test)?;
    for baseline in &pipeline.baselines {
        session.check_stopped()?;
        let fitted = baseline.fit(data, partition.known())?;
        let name = baseline.name_for(data.task());
        // Reading a file has no latency of a method.
        let is_measured = |metric: &&Plugin<dyn Metric>| !baseline.is_external() || metric.scope() != Scope::Model;
        let metrics: Vec<_> = pipeline.metrics.iter().filter(is_measured).cloned().collect();
        let measured = test.baseline(&name, &*fitted, &metrics, session)?;
        oracles.extend(fitted.is_oracle().then(|| name.clone()));
        if let Some(calibrator) = calibrator.as_ref().filter(|_| !fitted.is_oracle())
            && let Some(calibration) = calibrator.of_baseline(&*fitted, session)?
        {
            intervals.push(calibrator.measure((&name, &*fitted), &calibration, session)?.0);
        }
        predictors.push((name, measured));
        notes.extend(fitted.note().filter(|note| !notes.contains(note)));
    }
    let ceiling = ceiling(data, partition, &pipeline.metrics, session.stop)?;
    notes.extend(ceiling.notes);
    let ids: Vec<u32> = partition.test.iter().map(|&i| data.label(i)).collect();
    let samples = [partition.train.len(), partition.known().all().len(), ids.len()];
    notes.extend(intervals.iter().map(|own| own.note(data.task(), &intervals[0])));
    let measured = predictors.iter().flat_map(|(name, all)| all.iter().map(move |one| (name, one)));
    notes.extend(measured.filter_map(|(name, one)| Some(format!("{} of {name}: {}", one.key, one.note.as_ref()?))));
    let known = ScoreTable { task: data.task(), oracles, members, samples, intervals, notes, ..ScoreTable::default() };
    let mut scores = Scores { intervals: columns, ..Scores::new(ids, predictors, known) };
    let summaries: Vec<_> = ceiling.of.into_iter().map(|(key, at_zero)| (key, at_zero.summary)).collect();
    scores.table.add_ceiling(&summaries);
    let position = |&i: &usize| (data.label(i), data.placed.then(|| data.sample(i).position()));
    scores.table.paired = scores.paired(&partition.test.iter().map(position).collect());
    Ok(EvaluationResult { scores, confidence })
}

/// Describes the residual processes of a model, which share their fit.
fn note_of(residuals: &Residuals) -> String {
    let of = |process: &ResidualProcess| {
        let ProcessFit { trend, correlation: Correlation { kind, scales: [x, y, z, _], noise }, .. } = process.fit;
        let [x, y, z, noise] = [x, y, z, noise].map(number);
        let law = trend.path_loss.map_or_else(String::new, |_| format!(", of the path loss {}", 1.0 - trend.share));
        let share = format!("share of the model b = {}{law}", trend.share);
        format!("{share}, {} with {x}, {y}, {z} m, noise {noise}", kind.words())
    };
    let mut notes: Vec<String> = residuals.processes().iter().flatten().map(of).collect();
    notes.dedup();
    format!("the residuals of the model are Kriged ({})", notes.join("; "))
}

/// Returns the mean of the first validation metric for each baseline, fitted on the training set alone, on the samples
/// of `validation.csv`; finite values only.
///
/// # Errors
/// A baseline or a metric returns an error; [`Error::Stopped`](pwrfgs_core::Error::Stopped) once the session is stopped.
pub(crate) fn validation_baselines(
    plane: &ImagePlane,
    pipeline: &Pipeline,
    SplitData { data, partition }: &SplitData,
    session: &mut Session<'_>,
) -> Result<Vec<(String, f64)>> {
    let part = evenly(&partition.validation, pipeline.training.validation_samples);
    if part.is_empty() || pipeline.training.validate_every == 0 {
        return Ok(Vec::new());
    }
    let (bench, metrics) = (EvaluationSet::new(data, &part, plane), defaults::validation(data.task()));
    let mut all = Vec::new();
    for baseline in pipeline.baselines.iter().filter(|baseline| !baseline.is_external()) {
        session.check_stopped()?;
        let fitted = baseline.fit(data, FittingSet::train(&partition.train))?;
        let name = baseline.name_for(data.task());
        let measured = bench.baseline(&name, &*fitted, &metrics, session)?;
        all.extend(measured.first().map(|m| m.values.mean()).filter(|mean| mean.is_finite()).map(|mean| (name, mean)));
    }
    Ok(all)
}

/// Checks that a model predicts observations such as those of the data: task, size, directions, receivers and frequencies.
///
/// # Errors
/// The first difference.
pub fn check_alike(model: &Prepared<'_>, data: &Dataset) -> Result<()> {
    compatible(&Parts { data: Some(data), trained: Some(model.setup()), ..Parts::default() }).map_err(Misfit::error)
}

impl Confidence {
    /// Measures the confidence on the samples `part`.
    ///
    /// # Errors
    /// A spectrum that cannot be read; [`pwrfgs_core::Error::Stopped`] once the session is stopped.
    pub fn measure(model: &Prepared<'_>, data: &Dataset, part: &[usize], session: &mut Session<'_>) -> Result<Self> {
        let stop = session.stop;
        staged(session.observer, "measuring the spread of members", |progress| {
            let mut all = Self { ids: part.iter().map(|&i| data.label(i)).collect(), ..Self::default() };
            let done = AtomicUsize::new(0);
            let of = |&i: &usize| {
                let (mean, deviation, _) = model.predict_with_deviation(data.query(i));
                let pair = (size(&deviation), distance(&data.task().shown(mean), &data.image(i)));
                progress(done.fetch_add(1, Ordering::Relaxed) + 1, part.len());
                pair
            };
            for chunk in part.chunks(CHUNK) {
                check_stopped(stop)?;
                let pairs: Vec<(f64, f64)> = chunk.par_iter().map(of).collect();
                all.spreads.extend(pairs.iter().map(|pair| pair.0));
                all.errors.extend(pairs.iter().map(|pair| pair.1));
            }
            data.observations.check()?;
            Ok(all)
        })
    }
}

/// Returns the root mean square of the pixels.
fn size(image: &Image) -> f64 {
    let sum: f64 = image.pixels.iter().map(|p| (*p as f64).powi(2)).sum();
    (sum / image.pixels.len() as f64).sqrt()
}

/// Returns the root mean square of the difference.
fn distance(a: &Image, b: &Image) -> f64 {
    let sum: f64 = a.pixels.iter().zip(&b.pixels).map(|(a, b)| (*a as f64 - *b as f64).powi(2)).sum();
    (sum / a.pixels.len() as f64).sqrt()
}
