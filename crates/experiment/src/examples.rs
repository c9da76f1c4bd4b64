//! `Example`: the best, the median and the worst prediction of a test link, to look at.

use pwrfgs_core::{Dataset, Image, Result};
use pwrfgs_model::Prepared;

/// A test link and what the model predicts of it.
#[derive(Clone, Debug)]
pub struct Example {
    /// `Best`, `Median` or `Worst`.
    pub which: &'static str,
    /// Index of the sample.
    pub sample: usize,
    /// The first metric of the kind, such as SSIM.
    pub score: f64,
    /// What was measured.
    pub truth: Image,
    /// What is predicted, not clamped.
    pub prediction: Image,
}

/// Examples by the `scores` of the links `part`; none of none. They are predicted again, which gives the same bits.
pub(crate) fn choose(
    model: &Prepared<'_>,
    data: &Dataset,
    part: &[usize],
    scores: &[f64],
    higher: bool,
) -> Result<Vec<Example>> {
    let mut order: Vec<usize> = (0..scores.len()).collect();
    let by_score =
        |a: usize, b: usize| if higher { scores[b].total_cmp(&scores[a]) } else { scores[a].total_cmp(&scores[b]) };
    order.sort_by(|&a, &b| by_score(a, b).then(a.cmp(&b)));
    let Some(last) = order.len().checked_sub(1) else { return Ok(Vec::new()) };
    let mut chosen = vec![("Best", order[0]), ("Median", order[last / 2]), ("Worst", order[last])];
    chosen.dedup_by_key(|c| c.1);
    let example = |(which, i): (&'static str, usize)| {
        let (sample, score) = (part[i], scores[i]);
        let prediction = model.predict_timed(data.query(sample)).0;
        Example { which, sample, score, truth: data.image(sample), prediction }
    };
    let examples = chosen.into_iter().map(example).collect();
    data.observations.check()?;
    Ok(examples)
}
