//! The measurement that a prediction on the page is compared with.

use super::QueryParams;
use crate::predictor::Predictor;
use crate::side::{LoadedData, ViewPane};
use pwrfgs_core::{Image, LinkSet, Query, neighbours};
use serde_json::{Value, json};

/// Tolerance for positions that the page has rounded, metres.
const SAME_POSITION: f64 = 1e-3;

/// Describes the measurement that the prediction `image` is compared with: link, distance in metres, set, and score, which is
/// null if a baseline was fitted to the link; `None` without a measurement.
pub(super) fn describe_comparison(
    side: &ViewPane,
    parameters: &QueryParams,
    predictor: &Predictor,
    query: Query<'_>,
    image: &Image,
) -> Option<Value> {
    let loaded = side.loaded.as_deref()?;
    let (i, metres) = compared_link(loaded, parameters, query)?;
    let set = loaded.partition.set_of(i);
    // A baseline stores its training samples: its error on them would be zero.
    let is_fitted = predictor.is_fitted() && matches!(set, LinkSet::Training | LinkSet::Validation);
    let value = (!is_fitted).then(|| side.setup.task.score(image, &loaded.data.image(i)));
    Some(json!({ "link": i, "metres": metres, "score": value, "part": set as u8, "fitted": is_fitted }))
}

/// Returns the link whose measurement the prediction is compared with, and its distance from the query in metres. It is
/// the requested link (at distance 0) unless `tx` is elsewhere or the receiver is another; otherwise the nearest link at
/// the receiver, if the data have positions. `None` without either.
fn compared_link(loaded: &LoadedData, parameters: &QueryParams, query: Query<'_>) -> Option<(usize, f64)> {
    let is_requested = |i: &usize| {
        let sample = loaded.data.sample(*i);
        let is_near = |tx: [f64; 3]| neighbours::distance(sample.position(), tx) < SAME_POSITION;
        parameters.tx.is_none_or(|tx| sample.receiver == parameters.receiver && is_near(tx))
    };
    let requested = parameters.link.filter(|i| *i < loaded.data.len()).filter(is_requested);
    let nearest = || nearest_link(loaded, query.position(), parameters.receiver).filter(|_| loaded.data.placed);
    requested.map(|i| (i, 0.0)).or_else(nearest)
}

/// Returns the link at `receiver` whose transmitter is nearest to `tx`, with the distance in metres; `None` without
/// links.
fn nearest_link(loaded: &LoadedData, tx: [f64; 3], receiver: usize) -> Option<(usize, f64)> {
    let samples = loaded.data.samples().enumerate().filter(|(_, sample)| sample.receiver == receiver);
    let distances = samples.map(|(i, sample)| (i, neighbours::distance(sample.position(), tx)));
    distances.min_by(|a, b| a.1.total_cmp(&b.1))
}
