//! Known samples of a localisation: the data of a pipeline, or predictions of the model at its training positions.

use pwrfgs_core::{
    Channels, Dataset, Ends, Error, Link, Location, Observations, Partition, Progress, Query, Real, Receiver, Result,
    ShippedModel, Spectra, gains_of,
};
use pwrfgs_experiment::{SplitData, folder::PIPELINE, pipeline_of_model, read_pipeline};
use pwrfgs_model::Ensemble;
use pwrfgs_pipeline::Pipeline;
use std::path::Path;

/// Number of links that are predicted between two reports of progress.
const CHUNK: usize = 256;

/// Reads the pipeline with the known data of the model that `path` names, with the changes of `set`; a model without a file has
/// no `path`. Returns `None` if observations are compared with predictions instead: given observations and no `set`, for a
/// shipped model or a model without pipeline.
///
/// # Errors
/// An invalid pipeline; or none, and there are no observations or `set` has changes.
pub fn read_known_pipeline(path: Option<&Path>, set: &[String], has_observations: bool) -> Result<Option<Pipeline>> {
    let can_predict = has_observations && set.is_empty();
    let path = path.filter(|path| !can_predict || ShippedModel::find(path).is_none());
    match path.map(pipeline_of_model).transpose()?.flatten() {
        Some(pipeline) => read_pipeline(&pipeline, set).map(Some),
        None if can_predict => Ok(None),
        None => {
            let problem =
                format!("no {PIPELINE} next to this model; use the model of a run folder, or give only observations");
            Err(match path {
                Some(path) => Error::input(path, problem),
                None => Error::Config(problem),
            })
        }
    }
}

/// Creates known samples from the predictions of `ensemble` at its training positions, all in the training set; spectra have 8
/// bits. `progress` counts links.
///
/// # Errors
/// A model without training positions, or whose receivers move.
pub(super) fn predicted_samples(ensemble: &Ensemble, progress: Progress<'_>) -> Result<SplitData> {
    let setup = &ensemble.members()[0].stages.setup;
    if setup.moving.is_receiver() {
        return Err(Error::Config("the receiver of this model moves; localisation needs fixed receivers".into()));
    }
    let mut positions = ensemble.training_positions();
    positions.sort_by(|a, b| a.partial_cmp(b).expect("finite positions"));
    if positions.is_empty() {
        let problem = "the model file has no training positions to compare with; name a run folder";
        return Err(Error::Config(problem.into()));
    }
    let count = setup.receivers.len();
    let links: Vec<Link> =
        (0..positions.len() * count).map(|i| Link { location: i / count, receiver: i % count }).collect();
    let observations = predict_links(ensemble, &positions, &links, progress)?;
    let world = |r: &Receiver| Receiver { pose: setup.origin.world_pose(r.pose), ..r.clone() };
    let ends = Ends::from(setup.receivers.iter().map(world).collect::<Vec<_>>());
    let locations = (1..).zip(&positions).map(|(id, at)| Location { id, pose: (*at).into() }).collect();
    let mut data = Dataset::of_columns("predictions", ends, Vec::new(), locations, links, observations)?;
    data.scene.geodetic = setup.geodetic;
    let partition = Partition { train: (0..data.len()).collect(), ..Partition::default() };
    Ok(SplitData { data, partition })
}

/// Predicts the observations of `links` between `positions` and the receivers of the model; spectra are rounded to 8 bits.
fn predict_links(
    ensemble: &Ensemble,
    positions: &[[f64; 3]],
    links: &[Link],
    progress: Progress<'_>,
) -> Result<Observations> {
    let (model, setup) = (ensemble.prepare(), &ensemble.members()[0].stages.setup);
    let (width, height) = (setup.plane.width, setup.plane.height);
    let images = links.chunks(CHUNK).enumerate().flat_map(|(k, chunk)| {
        progress(k * CHUNK, links.len());
        let query = |link: &Link| Query::at(positions[link.location], link.receiver);
        model.predict_many(&chunk.iter().map(query).collect::<Vec<_>>())
    });
    if setup.task.has_pixels {
        return Ok(Spectra::grey((width, height), images.flat_map(|image| image.to_bytes()).collect())?.into());
    }
    let rows: Vec<Real> = images.flat_map(|image| image.pixels).collect();
    if setup.task.is_scalar {
        return Ok(rows.into());
    }
    let gains = gains_of(&rows, width);
    Ok(Channels { antennas: height / 2, frequencies_hz: setup.frequencies_hz.clone(), gains }.into())
}
