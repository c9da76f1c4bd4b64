//! The ceiling in words: what spectra measured at one place have in common.

use crate::page::similarity;
use crate::words::count;
use crate::{Inspection, Outcome};
use minijinja::{Value, context};
use pwrfgs_experiment::repeatability::{Lapse, Likeness, Similarity};
use pwrfgs_experiment::text::number;

impl Inspection<'_> {
    /// What the metric `key` comes to at distance zero, near in time and far apart.
    pub(crate) fn ceiling_words(&self, key: &str) -> Vec<String> {
        let kinds = [(&self.ceiling.near, "near in time"), (&self.ceiling.far, "far apart in time")];
        let one = |(likeness, name): (&Likeness, &str)| {
            let similarity = likeness.metrics.iter().find(|m| m.key == key)?;
            Some(format!("Ceiling (repeatability), pairs {name}: {}.", at_zero(likeness, similarity)))
        };
        kinds.into_iter().filter_map(one).collect()
    }

    /// Mean and median of it for the samples that a split holds out.
    pub(crate) fn ceiling_of(&self, key: &str, outcome: &Outcome) -> Option<[f64; 2]> {
        let likeness = if outcome.lapse == Lapse::Near { &self.ceiling.near } else { &self.ceiling.far };
        let similarity = likeness.metrics.iter().find(|m| m.key == key)?;
        similarity.at_zero.as_ref().ok().map(|zero| [zero.mean, zero.median])
    }

    /// Figures and how to read them.
    pub(crate) fn ceiling_page(&self) -> Value {
        let notes = [
            "A measurement as the prediction of another, against the distance of their transmitters. What pairs at no \
             distance have in common no function of the position can exceed by much: the rest is noise, or something other \
             than the position that changed between the two. It is an estimate from pairs; a perfect predictor of the mean \
             would reach a little more.",
            "Ids count as time. Where pairs far apart in time are less alike than pairs near in time, a split that mixes times \
             (`Random`) measures interpolation along the walk, and its floors and scores say little of another day: there \
             the lower ceiling counts.",
        ];
        context! { figures => similarity(&self.ceiling), notes }
    }
}

fn at_zero(likeness: &Likeness, similarity: &Similarity) -> String {
    match &similarity.at_zero {
        Ok(zero) => format!(
            "{} in the mean ({} to {} with 95 % confidence), {} in the median, of {} pairs within {:.1} mm, followed to \
             distance zero",
            number(zero.mean),
            number(zero.interval[0]),
            number(zero.interval[1]),
            number(zero.median),
            count(likeness.closest),
            1e3 * likeness.reach_m
        ),
        Err(why) => format!("not known, {why}"),
    }
}
