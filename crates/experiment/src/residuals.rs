//! Fits the residual processes of a trained model, or of an ensemble.

use crate::load::{ActiveRun, SplitData};
use crate::session::staged;
use pwrfgs_core::{Error, Result};
use pwrfgs_model::{Ensemble, KnownLinks, LeftOutBy, Residuals};
use pwrfgs_pipeline::Pipeline;

/// Returns an error if the residuals of a model of `pipeline` cannot be predicted: of one run, or `joined` of several runs.
///
/// # Errors
/// Folds of one run, or as [`check_data`](pwrfgs_model::Kriged::check_data).
pub(crate) fn check_residuals(pipeline: &Pipeline, split: &SplitData, joined: bool) -> Result<()> {
    let Some(residuals) = &pipeline.residuals else { return Ok(()) };
    let is_folded = residuals.folds || pipeline.members > 1;
    if is_folded && !joined && pipeline.members == 1 {
        let advice = "write `Kriged()`, or give the pipeline `members: 4`";
        return Err(Error::Config(format!("residuals: `folds` needs several models; {advice}")));
    }
    residuals.check_data(&split.data, is_folded || !split.partition.validation.is_empty())
}

/// Lists the links that members did not train on: one list per member if each of `folds` members left out a fold,
/// otherwise one list, the validation set, for all members.
///
/// # Errors
/// As [`Pipeline::partition`].
pub(crate) fn left_out_links(pipeline: &Pipeline, split: &SplitData, folds: usize) -> Result<Vec<Vec<usize>>> {
    let is_folded = pipeline.members > 1 || pipeline.residuals.as_ref().is_some_and(|residuals| residuals.folds);
    if folds == 1 || !is_folded {
        return Ok(vec![split.partition.validation.clone()]);
    }
    (0..folds).map(|index| Ok(pipeline.folded(index, folds).partition(&split.data)?.validation)).collect()
}

impl ActiveRun<'_, '_> {
    /// Fits residual processes of the trained ensemble to all known links, if the pipeline selects them and it has
    /// none. `folds` is the number of members of a joined sweep, 1 for a model of one run.
    ///
    /// # Errors
    /// As [`Residuals::fit`].
    pub(crate) fn fit_residuals(&mut self, ensemble: Ensemble, folds: usize) -> Result<Ensemble> {
        let (Some(settings), None) = (&self.pipeline.residuals, ensemble.residuals()) else { return Ok(ensemble) };
        let links = self.split.partition.known().all();
        let mut left_out_by = vec![LeftOutBy::NoMember; links.len()];
        let lists = left_out_links(self.pipeline, self.split, folds)?;
        for (member, left_out) in lists.iter().enumerate() {
            for link in left_out {
                let Ok(k) = links.binary_search(link) else {
                    return Err(Error::Config("residuals: a model left out a test sample; train it again".into()));
                };
                left_out_by[k] = if lists.len() == 1 { LeftOutBy::All } else { LeftOutBy::Member(member) };
            }
        }
        let links = KnownLinks { data: &self.split.data, links: &links, left_out_by: &left_out_by };
        let stop = self.session.stop;
        let fitted = staged(self.session.observer, "fitting residuals", |progress| {
            Residuals::fit(settings, &ensemble, links, stop, progress)
        })?;
        Ok(ensemble.with_residuals(Some(fitted)))
    }
}
