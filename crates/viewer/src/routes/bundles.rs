//! Arrays for the page: room, Gaussians, predictions and measurements.

use super::{QueryParams, RequestError};
use crate::predictor::Predictor;
use crate::side::{LoadedData, ServerState, ViewPane};
use hyper::StatusCode;
use pwrfgs_core::{
    Appearance, Call, Image, LinkSet, MethodTraits, Needs, Origin, Parameters, PixelSubset, Query, Real, Statistic,
    neighbours,
};
use pwrfgs_experiment::folder::{CURVE, snapshots};
use pwrfgs_experiment::{record::read_series, text::grouped};
use pwrfgs_model::{Ensemble, Model, Snapshot};
use pwrfgs_report::live::{self, TensorBundle};
use serde_json::{Value, json};
use std::sync::Arc;

/// Maximum number of surface points on the page.
const POINTS: usize = 8_000;
/// Maximum number of rows of the curve on the page.
const ROWS: usize = 600;
/// Tolerance for positions that the page has rounded, metres.
const SAME_PLACE: f64 = 1e-3;
/// Number of positions along the longer side of a radio map.
const ACROSS: usize = 60;

pub(super) fn bundle(path: &str, parameters: &QueryParams, state: &ServerState) -> Result<TensorBundle, RequestError> {
    let side = state.sides.get(parameters.side).ok_or_else(|| wrong("query parameter `side`: no such side"))?;
    match path {
        "room" => Ok(room(side, state)),
        "gaussians" => gaussians(side, parameters),
        "predict" => predict(side, parameters),
        "link" => link(side, parameters),
        "map" => map(side, parameters),
        "locate" => locate(side, parameters),
        "curve" => Ok(curve(side)),
        _ => Err((StatusCode::NOT_FOUND, "not found".into())),
    }
}

fn wrong(why: &str) -> RequestError {
    (StatusCode::BAD_REQUEST, why.to_owned())
}

fn known(side: &ViewPane) -> Result<&Arc<LoadedData>, RequestError> {
    side.known.as_ref().ok_or_else(|| wrong("no data next to this model"))
}

fn predictor(side: &ViewPane) -> Result<Arc<Predictor>, RequestError> {
    side.predictor().ok_or((StatusCode::SERVICE_UNAVAILABLE, "no model before the first checkpoint".into()))
}

fn room(side: &ViewPane, state: &ServerState) -> TensorBundle {
    let known = side.known.as_deref();
    let links: Vec<usize> = (0..known.map_or(0, |k| k.data.len())).collect();
    let data = known.map(|k| live::PartitionedData {
        data: &k.data,
        partition: &k.partition,
        scores: &k.scores,
        links: &links,
    });
    let predictor = side.predictor();
    let ensemble = predictor.as_ref().and_then(|p| p.ensemble());
    let origin = live::origin(&side.setup, data.map(|d| d.data));
    let means = ensemble.map_or(Vec::new(), |ensemble| ensemble.means_from(origin));
    let mut bundle = live::room(&side.setup, data, &means, POINTS);
    let corners = state.sides.iter().flat_map(|side| side.surfaces.as_flattened());
    let corners: Vec<Real> = corners.flat_map(|corner| origin.local(*corner)).collect();
    bundle.put("surfaces", &[corners.len() / 9, 3, 3], corners);
    bundle.note["sides"] = state.sides.iter().map(about).collect();
    bundle
}

/// Description of a side for the page.
fn about(side: &ViewPane) -> Value {
    let predictor = side.predictor();
    let ensemble = predictor.as_ref().and_then(|predictor| predictor.ensemble());
    let splats = ensemble.is_some_and(|e| e.is_drawn_as(Appearance::Ellipsoids));
    json!({
        "name": side.name,
        "gaussians": ensemble.map(|ensemble| ensemble.gaussians()),
        "members": ensemble.map_or(1, |ensemble| ensemble.members().len()),
        "ellipsoids": splats,
        "by_position": predictor.as_ref().is_none_or(|predictor| predictor.by_position()),
        "baseline": predictor.as_ref().is_some_and(|p| p.ensemble().is_none()),
        "snapshots": saved_snapshots(side).iter()
            .map(|(title, shown)| json!({ "title": title, "step": shown.step, "gaussians": shown.means.len() }))
            .collect::<Vec<_>>(),
        "running": side.folder.as_ref().is_some_and(|folder| !folder.join(pwrfgs_experiment::folder::MODEL_FILE).is_file()),
        "steps": side.known.as_ref().map(|known| known.pipeline.training.steps),
    })
}

fn gaussians(side: &ViewPane, parameters: &QueryParams) -> Result<TensorBundle, RequestError> {
    let origin = live::origin(&side.setup, side.known.as_ref().map(|known| &*known.data));
    if let Some(k) = parameters.snapshot {
        let all = saved_snapshots(side);
        let (_, snapshot) = all.get(k).ok_or_else(|| wrong("query parameter `snapshot`: no such snapshot"))?;
        return Ok(snapshot_bundle(snapshot, origin));
    }
    let predictor = predictor(side)?;
    let ensemble = predictor.ensemble().ok_or_else(|| wrong("baselines have no Gaussians"))?;
    let mut bundle = live::gaussians(ensemble, origin, parameters.tx);
    if let Some(tx) = parameters.tx.filter(|_| parameters.with == "contribution") {
        let all = contributions(ensemble, tx, receiver(side, parameters)?);
        bundle.put("contributions", &[all.len()], all);
    }
    Ok(bundle)
}

/// Contribution of each Gaussian of all members to the observation of a transmitter at `tx` by `receiver`: strength
/// times the sum of blending weights if Gaussians are blended, else strength times opacity.
fn contributions(ensemble: &Ensemble, tx: [f64; 3], receiver: usize) -> Vec<Real> {
    ensemble.members().iter().flat_map(|model| contributions_of(model, tx, receiver)).collect()
}

fn contributions_of(model: &Model, tx: [f64; 3], receiver: usize) -> Vec<Real> {
    let own = model.gaussians(Some(tx));
    let (primitives, strengths) = (&own.primitives, live::strengths(&own));
    let stages = &model.stages;
    let MethodTraits { blends, inputs, .. } = stages.method.traits();
    if !blends {
        return strengths.iter().zip(&primitives.opacities).map(|(s, o)| s * o).collect();
    }
    let links = &stages.setup.inputs(inputs, std::iter::once(Query::at(tx, receiver)));
    let parameters = Parameters { cloud: &model.cloud, gate: None, existence: None, weights: &model.weights };
    let truth = vec![0.0; stages.setup.numbers()];
    let needs = Needs::of(&[Statistic::Weight], 0);
    let call = Call { setup: &stages.setup, parameters, links, pixels: &PixelSubset::All };
    let statistics = stages.method.survey(&call, &truth, &needs);
    strengths.iter().zip(&statistics.weight).map(|(s, w)| s * w).collect()
}

/// Gaussians of a snapshot, metres from `origin`: means and opacities and, if stored, scales, rotations, gates and IDs.
fn snapshot_bundle(snapshot: &Snapshot, origin: Origin) -> TensorBundle {
    let n = snapshot.means.len();
    let mut bundle = TensorBundle::new(json!({ "gaussians": n, "step": snapshot.step }));
    bundle.put("means", &[n, 3], (0..n).flat_map(|i| origin.local(snapshot.place(i))));
    bundle.put("opacities", &[n], snapshot.opacities.iter().copied());
    if snapshot.scales.len() == n {
        bundle.put("scales", &[n, 3], snapshot.scales.as_flattened().iter().copied());
        bundle.put("quats", &[n, 4], snapshot.quats.as_flattened().iter().copied());
    }
    if snapshot.gaussian_ids.len() == n {
        bundle.put_ids("gaussian_ids", &snapshot.gaussian_ids);
    }
    if snapshot.gates.len() == n {
        bundle.put("gates", &[n], snapshot.gates.iter().copied());
    }
    bundle
}

fn receiver(side: &ViewPane, parameters: &QueryParams) -> Result<usize, RequestError> {
    let count = side.setup.receivers.len();
    if parameters.receiver < count {
        Ok(parameters.receiver)
    } else {
        Err(wrong("query parameter `receiver`: no such receiver"))
    }
}

/// Prediction for a transmitter at the requested receiver (powers: at all receivers), and its score against the nearest
/// measurement.
fn predict(side: &ViewPane, parameters: &QueryParams) -> Result<TensorBundle, RequestError> {
    let (predictor, receiver, task) = (predictor(side)?, receiver(side, parameters)?, side.setup.task);
    let known = side.known.as_deref();
    let by_position = predictor.by_position();
    let turns = known.is_some_and(|known| known.data.orientations.is_some()); // a sample has its own pose
    let query = match (parameters.tx, parameters.link, known) {
        (Some(tx), None, _) if by_position => Query::at(tx, receiver),
        (Some(tx), _, _) if by_position && !turns => Query::at(tx, receiver),
        (_, Some(i), Some(known)) if i < known.data.len() => known.data.query(i),
        _ => return Err(wrong("no position; set tx=x,y,z, or link=k of the data")),
    };
    let found = predictor.predict(query);
    let ensemble = predictor.ensemble();
    let (width, height) = (found.image.width, found.image.height);
    // The requested sample, even if another sample has the same position.
    let is_asked = |known: &LoadedData, i: usize| {
        let sample = known.data.sample(i);
        parameters.tx.is_none_or(|tx| sample.receiver == receiver && neighbours::distance(sample.tx, tx) < SAME_PLACE)
    };
    let nearest = match (parameters.link, known) {
        (Some(i), Some(known)) if i < known.data.len() && is_asked(known, i) => Some((i, 0.0)),
        (_, Some(known)) if known.data.placed => nearest(known, query.tx, receiver),
        _ => None,
    };
    let mut bundle = TensorBundle::new(json!({ "ms": found.ms, "strongest": strongest(side, &found.image) }));
    if let Some(training) = ensemble.filter(|_| by_position).and_then(|own| own.training_distances(&[query.tx])) {
        bundle.note["training"] = json!({ "metres": training.metres[0], "limit": training.limit });
    }
    if let (Some((i, metres)), Some(known)) = (nearest, known) {
        let set = known.partition.set_of(i);
        // A baseline stores its training samples: its error on them would be zero.
        let learned = predictor.is_fitted() && matches!(set, LinkSet::Training | LinkSet::Validation);
        let value = (!learned).then(|| task.score(&found.image, &known.data.image(i)));
        bundle.note["nearest"] =
            json!({ "link": i, "metres": metres, "score": value, "part": set as u8, "learned": learned });
    }
    if task.is_scalar {
        let all: Vec<Query<'_>> = (0..side.setup.receivers.len()).map(|r| Query { receiver: r, ..query }).collect();
        let powers = predictor.predict_many(&all);
        bundle.put("powers", &[powers.len()], powers.iter().map(|image| image.pixels[0]));
    }
    if let Some(deviation) = found.deviation {
        let mean = deviation.pixels.iter().sum::<Real>() / deviation.pixels.len().max(1) as Real;
        bundle.note["spread"] = json!(mean);
        bundle.put("deviation", &[height, width], deviation.pixels);
    }
    bundle.put("picture", &[height, width], found.image.pixels);
    Ok(bundle)
}

/// Azimuth and elevation of the strongest pixel, degrees.
fn strongest(side: &ViewPane, image: &Image) -> Value {
    let i = image.argmax();
    let angles = side.setup.plane.azimuth_elevation_deg((i % image.width) as Real, (i / image.width) as Real);
    angles.map_or(Value::Null, |(azimuth, elevation)| json!([azimuth, elevation]))
}

/// Link of the nearest transmitter received by `receiver`, with its distance in metres.
fn nearest(known: &LoadedData, tx: [f64; 3], receiver: usize) -> Option<(usize, f64)> {
    let samples = known.data.samples().enumerate().filter(|(_, sample)| sample.receiver == receiver);
    let all = samples.map(|(i, sample)| (i, neighbours::distance(sample.tx, tx)));
    all.min_by(|a, b| a.1.total_cmp(&b.1))
}

/// Data of a side, and the requested link.
fn known_link<'a>(side: &'a ViewPane, parameters: &QueryParams) -> Result<(&'a LoadedData, usize), RequestError> {
    let known = known(side)?;
    let asked = parameters.link.filter(|i| *i < known.data.len());
    Ok((known, asked.ok_or_else(|| wrong("query parameter `link`: no such link"))?))
}

fn link(side: &ViewPane, parameters: &QueryParams) -> Result<TensorBundle, RequestError> {
    let (known, i) = known_link(side, parameters)?;
    let image = known.data.image(i);
    let mut bundle = TensorBundle::new(json!({ "strongest": strongest(side, &image) }));
    if side.setup.task.is_scalar {
        let mut all = vec![Real::NAN; side.setup.receivers.len()];
        for other in known.data.links_of(&[known.data.links[i].transmitter]) {
            all[known.data.links[other].receiver] = known.data.image(other).pixels[0];
        }
        bundle.put("powers", &[all.len()], all);
    }
    bundle.put("picture", &[image.height, image.width], image.pixels);
    Ok(bundle)
}

/// Radio map on a plane at one receiver: power in dBm, or mean power of a channel in dB.
fn map(side: &ViewPane, parameters: &QueryParams) -> Result<TensorBundle, RequestError> {
    let (predictor, receiver) = (predictor(side)?, receiver(side, parameters)?);
    let z = parameters.z.ok_or_else(|| wrong("no height; set z=1.2"))?;
    if side.setup.task.has_pixels {
        return Err(wrong("maps: not available for spectra, only for powers and channels"));
    }
    let data = &known(side)?.data;
    let corners = [data.scene.bounds.0, data.scene.bounds.1].map(|corner| data.scene.origin.world(corner));
    let [width, height] = [0, 1].map(|k| (corners[1][k] - corners[0][k]).max(0.1));
    let step = width.max(height) / ACROSS as f64;
    let [columns, rows] = [width, height].map(|side| (side / step).round().max(1.0) as usize);
    let place = |k: usize| {
        let at = |cell: usize, axis: usize| corners[0][axis] + step * (cell as f64 + 0.5);
        Query::at([at(k % columns, 0), at(k / columns, 1), z], receiver)
    };
    let queries: Vec<Query<'_>> = (0..rows * columns).map(place).collect();
    let level = |image: &Image| side.setup.task.level(image) as Real;
    let first = data.scene.origin.local([corners[0][0] + step / 2.0, corners[0][1] + step / 2.0, z]);
    let mut bundle = TensorBundle::new(json!({ "first": first, "step": step }));
    bundle.put("map", &[rows, columns], predictor.predict_many(&queries).iter().map(level));
    let places: Vec<[f64; 3]> = queries.iter().map(|query| query.tx).collect();
    if let Some(training) = predictor.ensemble().and_then(|own| own.training_distances(&places)) {
        let beyond = (0..places.len()).map(|k| u8::from(training.is_beyond(k)));
        bundle.put_bytes("extrapolated", &[rows, columns], beyond.collect());
    }
    Ok(bundle)
}

/// Position of the transmitter of a link, located from its observations by all receivers, with the density over the floor.
/// Metres, world frame. A training sample is compared without itself.
fn locate(side: &ViewPane, parameters: &QueryParams) -> Result<TensorBundle, RequestError> {
    let ((known, i), predictor) = (known_link(side, parameters)?, predictor(side)?);
    if !predictor.by_position() {
        return Err(wrong("localisation: this model takes other features than a transmitter position"));
    }
    let fitted = side.locator(known, predictor).map_err(|why| wrong(&why.to_string()))?;
    let (locator, data) = (fitted.borrow_dependent(), &known.data);
    let transmitter = data.links[i].transmitter;
    let truth = data.transmitters[transmitter].position;
    let is_known = data.transmitters_of(&known.partition.train).contains(&transmitter);
    let observation = locator.observations(data, &[transmitter]).concat();
    let located = locator.locate_without(&observation, is_known.then_some(truth));
    let mut bundle = TensorBundle::new(json!({
        "estimate": located.position, "truth": truth, "error_m": neighbours::distance(located.position, truth),
        "misfit": located.misfit, "part": known.partition.set_of(i) as u8, "left_out": is_known,
        "no_region": locator.missing_regions(),
    }));
    if let Some(region) = &located.region {
        bundle.note["region"] = json!({
            "first": region.first(), "step": region.step, "area_m2": region.area(), "outlines": region.outlines(),
            "parts": region.parts(),
            "holds": located.holds(truth),
        });
        let shape = [region.values.len() / region.columns, region.columns];
        bundle.put("density", &shape, region.values.iter().map(|v| Real::from(*v)));
    }
    Ok(bundle)
}

/// Step, loss and N of the training.
fn curve(side: &ViewPane) -> TensorBundle {
    let rows = side.folder.as_ref().map_or(Vec::new(), |folder| read_series(&folder.join(CURVE)));
    let stride = rows.len().div_ceil(ROWS).max(1);
    let shown: Vec<_> =
        rows.iter().enumerate().filter(|(k, _)| (k + 1).is_multiple_of(stride) || k + 1 == rows.len()).collect();
    let field = |row: &[Option<f64>], k: usize| row.get(k).copied().flatten().unwrap_or(f64::NAN) as Real;
    let mut bundle = TensorBundle::new(json!({ "rows": shown.len() }));
    bundle.put("curve", &[shown.len(), 3], shown.iter().flat_map(|(_, row)| [0, 2, 4].map(|k| field(row, k))));
    bundle
}

/// Titles and snapshots; damaged snapshots are omitted.
fn saved_snapshots(side: &ViewPane) -> Vec<(String, Snapshot)> {
    let Some(folder) = &side.folder else { return Vec::new() };
    let found = snapshots().filter_map(|(name, what)| {
        let snapshot = Snapshot::read(&folder.join(name)).ok().flatten()?;
        Some((format!("{what}, step {}", grouped(snapshot.step as i64)), snapshot))
    });
    let mut all: Vec<_> = found.collect();
    all.sort_by_key(|(_, snapshot)| snapshot.step);
    all
}
