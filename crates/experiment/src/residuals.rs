//! Fits the residual processes of a trained model, or of an ensemble.

use crate::load::SplitData;
use crate::session::{Session, staged};
use pwrfgs_core::{Error, Result};
use pwrfgs_model::{Ensemble, KnownLinks, LeftOutBy, Residuals};
use pwrfgs_pipeline::Pipeline;

/// Returns an error if the residuals of a model of `pipeline` cannot be predicted: of one run, or `joined` of several.
///
/// # Errors
/// Folds of one run, or as [`check_data`](pwrfgs_model::Kriged::check_data).
pub(crate) fn check_residuals(pipeline: &Pipeline, split: &SplitData, joined: bool) -> Result<()> {
    let Some(residuals) = &pipeline.residuals else { return Ok(()) };
    if residuals.folds && !joined {
        let what = "residuals: `folds` needs an experiment with `join: true`; write `Kriged()`, or join several models";
        return Err(Error::Config(what.into()));
    }
    residuals.check_data(&split.data, residuals.folds || !split.partition.validation.is_empty())
}

/// Links that members did not train on: one list per member if a sweep gave each of `folds` members a fold, otherwise one
/// list, the validation set, for all members.
///
/// # Errors
/// As [`Pipeline::partition`].
pub(crate) fn left_out(pipeline: &Pipeline, split: &SplitData, folds: usize) -> Result<Vec<Vec<usize>>> {
    if folds == 1 || !pipeline.residuals.as_ref().is_some_and(|residuals| residuals.folds) {
        return Ok(vec![split.partition.validation.clone()]);
    }
    (0..folds).map(|index| Ok(pipeline.folded(index, folds).partition(&split.data)?.validation)).collect()
}

/// The trained ensemble with residual processes fitted to all known links, if the pipeline selects them and it has none.
/// `folds` is the number of members of a joined sweep, 1 for a model of one run.
///
/// # Errors
/// As [`Residuals::fit`].
pub(crate) fn with_residuals(
    ensemble: Ensemble,
    pipeline: &Pipeline,
    split: &SplitData,
    folds: usize,
    session: &mut Session<'_>,
) -> Result<Ensemble> {
    let (Some(settings), None) = (&pipeline.residuals, ensemble.residuals()) else { return Ok(ensemble) };
    let links = split.partition.known().all();
    let mut left_out_by = vec![LeftOutBy::NoMember; links.len()];
    let lists = left_out(pipeline, split, folds)?;
    for (member, left_out) in lists.iter().enumerate() {
        for link in left_out {
            let Ok(k) = links.binary_search(link) else {
                return Err(Error::Config("residuals: a model left out a test sample; train it again".into()));
            };
            left_out_by[k] = if lists.len() == 1 { LeftOutBy::All } else { LeftOutBy::Member(member) };
        }
    }
    let known = KnownLinks { data: &split.data, links: &links, left_out_by: &left_out_by };
    let stop = session.stop;
    let fitted = staged(session.observer, "fitting residuals", |progress| {
        Residuals::fit(settings, &ensemble, known, stop, progress)
    })?;
    Ok(ensemble.with_residuals(Some(fitted)))
}
