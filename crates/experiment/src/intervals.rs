//! Prediction intervals of a run: calibration on links that a predictor was not fitted to, coverage on the test set.

use crate::load::ActiveRun;
use crate::residuals::{check_residuals, left_out_links};
use crate::scores::{IntervalScores, LEVEL, LevelScores};
use crate::session::run_stage;
use pwrfgs_core::{Error, Image, Predict, Result, check_stopped};
use pwrfgs_model::{Ensemble, HeldOutScores, Interval, IntervalCalibration, IntervalFactors};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Number of links predicted together.
const CHUNK: usize = 64;
/// Levels that are measured.
const LEVELS: [f64; 10] = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, LEVEL, 0.95];

/// Scores of links that a predictor was not fitted to, by link.
type LinkScores = BTreeMap<usize, HeldOutScores>;

impl ActiveRun<'_, '_> {
    /// Fits the residual process that the pipeline selects to a model trained on the training set, and calibrates its
    /// intervals on the validation set. Keeps the process or the calibration that the model has.
    ///
    /// # Errors
    /// Data that residuals do not support, `folds` with one member, a model that left out a test sample, a prediction that is
    /// not finite, a spectrum that cannot be read, or [`Error::Stopped`].
    pub fn calibrate_model(&mut self, model: Ensemble) -> Result<Ensemble> {
        check_residuals(self.pipeline, self.split, false)?;
        let fitted = self.fit_residuals(model, 1)?;
        self.calibrate(fitted)
    }

    /// Calibrates the intervals of the ensemble on the links that its members left out. Returns it unchanged if it has a
    /// calibration, without such links, or if intervals do not support the observations.
    ///
    /// # Errors
    /// A prediction that is not finite, a spectrum that cannot be read, or [`Error::Stopped`].
    pub(crate) fn calibrate(&mut self, ensemble: Ensemble) -> Result<Ensemble> {
        let split = self.split;
        if ensemble.calibration().is_some() || split.data.task().intervals.is_none() {
            return Ok(ensemble);
        }
        let count = ensemble.members().len();
        let lists = left_out_links(self.pipeline, split, count)?;
        let mut scores = LinkScores::new();
        for (index, left_out) in lists.iter().enumerate().filter(|(_, links)| !links.is_empty()) {
            // The members that did not train on the list, as `left_out_links` numbers them.
            let members: Vec<usize> = (index..count).step_by(lists.len()).collect();
            let known = split.partition.known().all().into_iter();
            let trained: Vec<usize> = known.filter(|link| left_out.binary_search(link).is_err()).collect();
            let held_out = ensemble.held_out(&members, &split.data, &trained)?;
            scores.extend(self.score_held_out(&held_out.prepare(), left_out)?);
        }
        let calibration = self.calibrate_by(scores);
        Ok(ensemble.with_calibration(calibration))
    }

    /// Calibrates a fitted baseline by the lists of links that models left out; `None` if it cannot leave links out, or if the
    /// lists are empty.
    ///
    /// # Errors
    /// As [`Self::calibrate`].
    pub(crate) fn calibrate_baseline(
        &mut self,
        fitted: &dyn Predict,
        left_out: &[Vec<usize>],
    ) -> Result<Option<IntervalCalibration>> {
        let mut scores = LinkScores::new();
        for links in left_out.iter().filter(|links| !links.is_empty()) {
            let Some(held_out) = fitted.without(links) else { return Ok(None) };
            scores.extend(self.score_held_out(&*held_out, links)?);
        }
        Ok(self.calibrate_by(scores))
    }

    /// Scores `links`, which `predictor` was not fitted to, for a calibration.
    fn score_held_out(&mut self, predictor: &dyn Predict, links: &[usize]) -> Result<LinkScores> {
        let task = self.split.data.task();
        let score = |shown: &Image, deviation: f64, truth: &Image| HeldOutScores::of(task, shown, deviation, truth);
        let scores = self.score_links("calibrating intervals", predictor, links, score)?;
        Ok(links.iter().copied().zip(scores).collect())
    }

    /// Calibrates intervals by the scores of held-out links, in the blocks of the split; `None` without links.
    fn calibrate_by(&self, mut scores: LinkScores) -> Option<IntervalCalibration> {
        let links: Vec<usize> = scores.keys().copied().collect();
        let block = |links: Vec<usize>| links.iter().filter_map(|link| scores.remove(link)).collect();
        let blocks: Vec<Vec<HeldOutScores>> =
            self.pipeline.split.blocks(&self.split.data, &links).into_iter().map(block).collect();
        IntervalCalibration::new(&blocks)
    }

    /// Measures the intervals of a predictor, given with its name, on the test set. Also returns those of [`LEVEL`] as columns of
    /// `samples.csv`, a row per test link; empty with too few blocks for this level.
    ///
    /// # Errors
    /// As [`Self::calibrate`].
    pub(crate) fn measure_intervals(
        &mut self,
        (name, predictor): (&str, &dyn Predict),
        calibration: &IntervalCalibration,
    ) -> Result<(IntervalScores, Vec<Vec<f64>>)> {
        let (task, test) = (self.split.data.task(), &self.split.partition.test);
        let factors: Vec<(f64, IntervalFactors)> =
            LEVELS.into_iter().filter_map(|level| Some((level, calibration.factors(level).ok()?))).collect();
        let measure = |prediction: &Image, deviation: f64, truth: &Image| {
            let score = task.ssim(prediction, truth);
            let of_level = |(_, factors): &(f64, IntervalFactors)| {
                MeasuredInterval::of(&factors.interval(task, prediction, deviation), truth, score)
            };
            factors.iter().map(of_level).collect::<Vec<_>>()
        };
        let intervals = self.score_links("measuring intervals", predictor, test, measure)?;
        let blocks = self.pipeline.split.blocks(&self.split.data, test);
        let weights = link_weights(&blocks);
        let scores = |(k, (level, _)): (usize, &(f64, IntervalFactors))| {
            let weighted = test.iter().zip(&intervals).map(|(link, levels)| (weights[link], &levels[k]));
            MeasuredInterval::mean_scores(*level, &weighted.collect::<Vec<_>>())
        };
        let levels = factors.iter().enumerate().map(scores).collect();
        let shown = factors.iter().position(|(level, _)| *level == LEVEL);
        // In the order of the `columns` of `task.intervals`, with and without pixels.
        let columns = |interval: &MeasuredInterval| match *interval {
            MeasuredInterval { coverage, width, ssim: Some([bound, _]), .. } => vec![coverage, width, bound],
            MeasuredInterval { ends, .. } => ends.to_vec(),
        };
        let rows = intervals.iter().filter_map(|levels| Some(columns(&levels[shown?]))).collect();
        let blocks = [calibration.block_count(), blocks.len()];
        Ok((IntervalScores { predictor: name.to_owned(), blocks, levels }, rows))
    }

    /// Passes the prediction of each link, as it is shown, its deviation and the measurement to `score`, in parallel;
    /// returns the scores in the order of `links`.
    ///
    /// # Errors
    /// As [`Self::calibrate`].
    fn score_links<T: Send>(
        &mut self,
        stage: &str,
        predictor: &dyn Predict,
        links: &[usize],
        score: impl Fn(&Image, f64, &Image) -> T + Sync,
    ) -> Result<Vec<T>> {
        let (data, stop) = (&self.split.data, self.session.stop);
        let score_link = |(&i, prediction): (&usize, Image)| {
            let prediction = data.task().shown(prediction);
            let deviation = predictor.deviation(data.query(i)).unwrap_or(1.0); // equal for all without an estimate
            if !(deviation.is_finite() && prediction.pixels.iter().all(|p| p.is_finite())) {
                let problem = "intervals: a prediction is not finite; train the model again with lower learning rates";
                return Err(Error::Config(problem.into()));
            }
            Ok(score(&prediction, deviation, &data.image(i)))
        };
        run_stage(self.session.observer, stage, |progress| {
            let mut scores = Vec::with_capacity(links.len());
            for chunk in links.chunks(CHUNK) {
                check_stopped(stop)?;
                let queries = data.queries(chunk);
                let predicted = chunk.par_iter().zip(predictor.predict_many(&queries));
                scores.extend(predicted.map(score_link).collect::<Result<Vec<T>>>()?);
                progress(scores.len(), links.len());
            }
            data.observations.check()?;
            Ok(scores)
        })
    }
}

/// Returns the weight of each link if all `blocks` weigh the same, and 1 together.
fn link_weights(blocks: &[Vec<usize>]) -> BTreeMap<usize, f64> {
    let weight = |block: &[usize]| 1.0 / (blocks.len() * block.len()) as f64;
    blocks.iter().flat_map(|block| block.iter().map(move |link| (*link, weight(block)))).collect()
}

/// Interval of one link against its measurement.
struct MeasuredInterval {
    /// Share of the values inside the interval.
    coverage: f64,
    /// Mean width.
    width: f64,
    /// Lower bound of the SSIM, and 1 if the SSIM is at or above it, otherwise 0; `None` without pixels.
    ssim: Option<[f64; 2]>,
    /// Lower and upper end of the first value.
    ends: [f64; 2],
}

impl MeasuredInterval {
    /// Averages intervals of one `level` by their weights.
    fn mean_scores(level: f64, weighted: &[(f64, &Self)]) -> LevelScores {
        let mean = |value: &dyn Fn(&Self) -> f64| weighted.iter().map(|(w, interval)| w * value(interval)).sum::<f64>();
        let mean_ssim = |c: usize| mean(&|interval| interval.ssim.map_or(0.0, |ssim| ssim[c]));
        let ssim = weighted.iter().any(|(_, interval)| interval.ssim.is_some()).then(|| [mean_ssim(0), mean_ssim(1)]);
        let (coverage, width) = (mean(&|interval| interval.coverage), mean(&|interval| interval.width));
        LevelScores { level, coverage, width, ssim }
    }

    /// Compares an interval with its measurement; `score` is the SSIM of the prediction, `None` without pixels.
    fn of(interval: &Interval, truth: &Image, score: Option<f64>) -> Self {
        let Interval { lower, upper, ssim } = interval;
        let ends = || lower.pixels.iter().zip(&upper.pixels);
        let count = truth.pixels.len() as f64;
        let inside = ends().zip(&truth.pixels).filter(|((lower, upper), t)| (*lower..=*upper).contains(t)).count();
        let ssim = ssim.zip(score).map(|(bound, score)| [bound, f64::from(score >= bound)]);
        let width = ends().map(|(lower, upper)| (*upper - *lower) as f64).sum::<f64>() / count;
        Self { coverage: inside as f64 / count, width, ssim, ends: [lower, upper].map(|end| end.pixels[0] as f64) }
    }
}
