//! Fits the residual processes of a trained model, or of an ensemble.

use crate::session::{Session, staged};
use pwrfgs_core::{Dataset, Error, Partition, Result};
use pwrfgs_model::{Ensemble, KnownLinks, Kriged, Residuals};
use pwrfgs_pipeline::Pipeline;

/// Returns an error if a run of `pipeline` cannot predict the residuals of its model.
///
/// # Errors
/// As [`Kriged::check_data`].
pub(crate) fn check_residuals(pipeline: &Pipeline, data: &Dataset, partition: &Partition) -> Result<()> {
    let residuals = pipeline.residuals.as_ref();
    residuals.map_or(Ok(()), |residuals| residuals.check_data(data, !partition.validation.is_empty()))
}

/// The ensemble with residual processes fitted to all known links. `left_out` lists, for each member, the links that it did
/// not train on.
///
/// # Errors
/// As [`Residuals::fit`].
pub(crate) fn with_residuals(
    ensemble: Ensemble,
    settings: &Kriged,
    (data, partition): (&Dataset, &Partition),
    left_out: &[Vec<usize>],
    session: &mut Session<'_>,
) -> Result<Ensemble> {
    let links = partition.known().all();
    let mut left_out_by = vec![None; links.len()];
    for (member, left_out) in left_out.iter().enumerate() {
        for link in left_out {
            let Ok(k) = links.binary_search(link) else {
                return Err(Error::Config("residuals: a model left out a test sample; train it again".into()));
            };
            left_out_by[k] = Some(member);
        }
    }
    let known = KnownLinks { data, links: &links, left_out_by: &left_out_by };
    let stop = session.stop;
    let fitted = staged(session.observer, "fitting residuals", |progress| {
        Residuals::fit(settings, &ensemble, known, stop, progress)
    })?;
    Ok(ensemble.with_residuals(Some(fitted)))
}
