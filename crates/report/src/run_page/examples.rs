//! `Example`: the best, the median and the worst prediction of a test link, to look at.

use super::predicted::each;
use pwrfgs_core::{Image, Result};
use pwrfgs_experiment::LoadedRun;
use pwrfgs_experiment::scores::MODEL;

/// A test link and what the model predicts of it.
pub(super) struct Example {
    /// `Best`, `Median` or `Worst`.
    pub(super) which: &'static str,
    /// Index of the sample.
    pub(super) sample: usize,
    /// The first metric of the kind, such as SSIM.
    pub(super) score: f64,
    /// Distance to the nearest training transmitter, metres; `None` if there is none.
    pub(super) nearest_m: Option<f64>,
    /// What was measured.
    pub(super) truth: Image,
    /// What is predicted, not clamped.
    pub(super) prediction: Image,
}

/// The examples of a run, as far as they are different; none of no test sample. They are predicted again, which gives the
/// same bits.
pub(super) fn examples(run: &LoadedRun<'_>) -> Result<Vec<Example>> {
    let (data, part, model) = (run.data, &run.partition.test, run.model.prepare());
    let headline = data.task().headline;
    let scores = if let Some(scores) = run.record.scores.samples(MODEL, headline.key) {
        scores.to_vec()
    } else {
        // The pipeline does not name this metric.
        let mut scores = Vec::with_capacity(part.len());
        each(run, part, |_, truth, prediction| scores.push(data.task().score(prediction, truth)));
        scores
    };
    let mut order: Vec<usize> = (0..scores.len()).collect();
    let by_score = |a: usize, b: usize| {
        if headline.higher { scores[b].total_cmp(&scores[a]) } else { scores[a].total_cmp(&scores[b]) }
    };
    order.sort_by(|&a, &b| by_score(a, b).then(a.cmp(&b)));
    let Some(last) = order.len().checked_sub(1) else { return Ok(Vec::new()) };
    let mut chosen = vec![("Best", order[0]), ("Median", order[last / 2]), ("Worst", order[last])];
    chosen.dedup_by_key(|c| c.1);
    let example = |(which, i): (&'static str, usize)| {
        let (sample, score) = (part[i], scores[i]);
        let nearest = run.record.test.nearest_train_m.get(&data.label(sample)).copied();
        let nearest_m = nearest.filter(|distance| distance.is_finite());
        let prediction = model.predict_timed(data.query(sample)).0;
        Example { which, sample, score, nearest_m, truth: data.image(sample), prediction }
    };
    let examples = chosen.into_iter().map(example).collect();
    data.observations.check()?;
    Ok(examples)
}
