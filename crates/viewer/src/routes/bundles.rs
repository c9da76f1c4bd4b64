//! Arrays for the page: room, Gaussians, predictions and measurements.

use super::comparison::describe_comparison;
use super::{QueryParams, RequestError};
use crate::predictor::Predictor;
use crate::side::{LoadedData, ViewPane};
use crate::state::{CURVE_COLUMNS, ServerState};
use hyper::StatusCode;
use pwrfgs_core::{
    Appearance, Call, Image, MethodTraits, Needs, Origin, Parameters, PixelSubset, Query, Real, Statistic, neighbours,
};
use pwrfgs_experiment::folder::{CURVE, MODEL_FILE, snapshots, training_folder};
use pwrfgs_experiment::{record::read_series, text::grouped};
use pwrfgs_model::{Model, Snapshot};
use pwrfgs_report::live::{self, TensorBundle};
use pwrfgs_tasks::map::{MapQuantity, MapRequest, training_layer};
use pwrfgs_tasks::plane::{MapPlane, PlaneBounds, PlaneGrid};
use serde_json::{Value, json};
use std::sync::Arc;

/// Maximum number of surface points on the page.
const POINTS: usize = 8_000;
/// Maximum number of rows of the curve on the page.
const ROWS: usize = 600;
/// Least side of a radio map, metres: positions may lie on a line.
const LEAST_SIDE_M: f64 = 0.1;
/// Number of positions along the longer side of a radio map.
const ACROSS: usize = 60;

type BundleResult = Result<TensorBundle, RequestError>;

/// Creates the bundle of arrays called `path`; an error for another name, or parameters that it does not support.
pub(super) fn create_bundle(path: &str, parameters: &QueryParams, state: &ServerState) -> BundleResult {
    let side = state.sides.get(parameters.side).ok_or_else(|| bad_request("query parameter `side`: no such side"))?;
    match path {
        "room" => Ok(room_bundle(side, state)),
        "gaussians" => gaussian_bundle(side, parameters),
        "predict" => prediction_bundle(side, parameters),
        "link" => link_bundle(side, parameters),
        "map" => map_bundle(side, parameters),
        "locate" => location_bundle(side, parameters),
        "curve" => Ok(curve_bundle(side)),
        _ => Err((StatusCode::NOT_FOUND, "not found".into())),
    }
}

/// Creates the error of an invalid request.
fn bad_request(why: &str) -> RequestError {
    (StatusCode::BAD_REQUEST, why.to_owned())
}

/// Returns the data of a side; an error without a pipeline next to the model.
fn loaded_data(side: &ViewPane) -> Result<&Arc<LoadedData>, RequestError> {
    side.loaded.as_ref().ok_or_else(|| bad_request("no data next to this model"))
}

/// Returns the current predictor of a side; an error before the first checkpoint.
fn current_predictor(side: &ViewPane) -> Result<Arc<Predictor>, RequestError> {
    side.predictor().ok_or((StatusCode::SERVICE_UNAVAILABLE, "no model before the first checkpoint".into()))
}

/// Creates the bundle of the room: receivers, surfaces, links with their scores, and all sides.
fn room_bundle(side: &ViewPane, state: &ServerState) -> TensorBundle {
    let loaded = side.loaded.as_deref();
    let links: Vec<usize> = (0..loaded.map_or(0, |loaded| loaded.data.len())).collect();
    let data = loaded.map(|loaded| live::PartitionedData {
        data: &loaded.data,
        partition: &loaded.partition,
        scores: &loaded.scores,
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
    bundle.note["sides"] = state.sides.iter().map(describe_side).collect();
    bundle
}

/// Describes a side for the page: its kind, numbers of models, Gaussians and steps, and snapshots.
fn describe_side(side: &ViewPane) -> Value {
    let predictor = side.predictor();
    let ensemble = predictor.as_ref().and_then(|predictor| predictor.ensemble());
    let has_ellipsoids = ensemble.is_some_and(|e| e.is_drawn_as(Appearance::Ellipsoids));
    json!({
        "name": side.name,
        "gaussians": ensemble.map(|ensemble| ensemble.gaussians()),
        "members": ensemble.map_or(1, |ensemble| ensemble.members().len()),
        "ellipsoids": has_ellipsoids,
        "by_position": predictor.as_ref().is_none_or(|predictor| predictor.has_position_input()),
        "baseline": predictor.as_ref().is_some_and(|p| p.ensemble().is_none()),
        "snapshots": read_snapshots(side).iter()
            .map(|(title, shown)| json!({ "title": title, "step": shown.step, "gaussians": shown.means.len() }))
            .collect::<Vec<_>>(),
        "running": side.folder.as_ref().is_some_and(|folder| !folder.join(MODEL_FILE).is_file()),
        "steps": side.loaded.as_ref().map(|loaded| loaded.pipeline.training.steps),
    })
}

/// Creates the bundle of the Gaussians of the model or of a snapshot; those of a model on request with their
/// contributions to an observation.
fn gaussian_bundle(side: &ViewPane, parameters: &QueryParams) -> BundleResult {
    let origin = live::origin(&side.setup, side.loaded.as_ref().map(|loaded| &*loaded.data));
    if let Some(k) = parameters.snapshot {
        let stored = read_snapshots(side);
        let (_, snapshot) = stored.get(k).ok_or_else(|| bad_request("query parameter `snapshot`: no such snapshot"))?;
        return Ok(snapshot_bundle(snapshot, origin));
    }
    let predictor = current_predictor(side)?;
    let ensemble = predictor.ensemble().ok_or_else(|| bad_request("baselines have no Gaussians"))?;
    let mut bundle = live::gaussians(ensemble, origin, parameters.tx);
    if let Some(tx) = parameters.tx.filter(|_| parameters.with == "contribution") {
        check_receiver(side, parameters)?;
        let models = ensemble.members().iter();
        let values: Vec<Real> = models.flat_map(|model| contributions(model, tx, parameters.receiver)).collect();
        bundle.put("contributions", &[values.len()], values);
    }
    Ok(bundle)
}

/// Computes the contribution of each Gaussian to the observation of a transmitter at `tx` (metres, world frame) by
/// `receiver`: strength times the sum of blending weights if Gaussians are blended, else strength times opacity.
fn contributions(model: &Model, tx: [f64; 3], receiver: usize) -> Vec<Real> {
    let gaussians = model.gaussians(Some(tx));
    let (primitives, strengths) = (&gaussians.primitives, live::strengths(&gaussians));
    let stages = &model.stages;
    let MethodTraits { blends, inputs, .. } = stages.method.traits();
    if !blends {
        return strengths.iter().zip(&primitives.opacities).map(|(s, o)| s * o).collect();
    }
    let links = &stages.setup.inputs(inputs, std::iter::once(stages.query(tx, receiver)));
    let parameters = Parameters { cloud: &model.cloud, gate: None, existence: None, weights: &model.weights };
    let truth = vec![0.0; stages.setup.value_count()];
    let needs = Needs::of(&[Statistic::Weight], 0); // 0: of all transmitters, here the only one
    let call = Call { setup: &stages.setup, parameters, links, pixels: &PixelSubset::All };
    let statistics = stages.method.survey(&call, &truth, &needs);
    strengths.iter().zip(&statistics.weight).map(|(s, w)| s * w).collect()
}

/// Creates the bundle of the Gaussians of a snapshot, metres from `origin`: means and opacities and, if stored, scales,
/// rotations, gates and IDs.
fn snapshot_bundle(snapshot: &Snapshot, origin: Origin) -> TensorBundle {
    let n = snapshot.means.len();
    let mut bundle = TensorBundle::new(json!({ "gaussians": n, "step": snapshot.step }));
    bundle.put("means", &[n, 3], (0..n).flat_map(|i| origin.local(snapshot.centre(i))));
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

/// Rejects the index of a receiver that is out of range.
fn check_receiver(side: &ViewPane, parameters: &QueryParams) -> Result<(), RequestError> {
    if parameters.receiver >= side.setup.receivers.len() {
        return Err(bad_request("query parameter `receiver`: no such receiver"));
    }
    Ok(())
}

/// Creates the bundle of the prediction for a transmitter at the requested receiver (powers: at all receivers), with
/// its score against the nearest measurement.
fn prediction_bundle(side: &ViewPane, parameters: &QueryParams) -> BundleResult {
    let predictor = current_predictor(side)?;
    check_receiver(side, parameters)?;
    let query = requested_query(side, parameters, &predictor);
    let query = query.ok_or_else(|| bad_request("no position; set tx=x,y,z, or link=k of the data"))?;
    let prediction = predictor.predict(query);
    let (width, height) = (prediction.image.width, prediction.image.height);
    let strongest = strongest_direction(side, &prediction.image);
    let mut bundle = TensorBundle::new(json!({ "ms": prediction.ms, "strongest": strongest }));
    let models = predictor.ensemble().filter(|_| predictor.has_position_input());
    if let Some(training) = models.and_then(|models| models.training_distances(&[query.position()])) {
        bundle.note["training"] = json!({ "metres": training.metres[0], "limit": training.limit });
    }
    if let Some(note) = describe_comparison(side, parameters, &predictor, query, &prediction.image) {
        bundle.note["nearest"] = note;
    }
    if side.setup.task.is_scalar {
        let queries: Vec<Query<'_>> = (0..side.setup.receivers.len()).map(|r| Query { receiver: r, ..query }).collect();
        let powers = predictor.predict_many(&queries);
        bundle.put("powers", &[powers.len()], powers.iter().map(|image| image.pixels[0]));
    }
    if let Some(deviation) = prediction.deviation {
        let mean = deviation.pixels.iter().sum::<Real>() / deviation.pixels.len().max(1) as Real;
        bundle.note["spread"] = json!(mean);
        bundle.put("deviation", &[height, width], deviation.pixels);
    }
    bundle.put("picture", &[height, width], prediction.image.pixels);
    Ok(bundle)
}

/// Returns the query for the requested position, or for the requested link if the model takes other inputs or the
/// receiver moves; `None` without such an input.
fn requested_query<'a>(side: &'a ViewPane, parameters: &QueryParams, predictor: &Predictor) -> Option<Query<'a>> {
    let loaded = side.loaded.as_deref();
    let moves = loaded.is_some_and(|loaded| loaded.data.scene.moving.is_receiver()); // a link has its own pose
    match (parameters.tx.filter(|_| predictor.has_position_input()), parameters.link) {
        (Some(tx), link) if link.is_none() || !moves => Some(side.setup.query(tx, parameters.receiver)),
        (_, link) => loaded.and_then(|loaded| link.filter(|i| *i < loaded.data.len()).map(|i| loaded.data.query(i))),
    }
}

/// Returns azimuth and elevation of the strongest pixel, degrees; null if pixels have no angles.
fn strongest_direction(side: &ViewPane, image: &Image) -> Value {
    let i = image.argmax();
    let angles = side.setup.plane.azimuth_elevation_deg((i % image.width) as Real, (i / image.width) as Real);
    angles.map_or(Value::Null, |(azimuth, elevation)| json!([azimuth, elevation]))
}

/// Returns the data of a side and the index of the requested link; an error without either.
fn loaded_link<'a>(side: &'a ViewPane, parameters: &QueryParams) -> Result<(&'a LoadedData, usize), RequestError> {
    let loaded = loaded_data(side)?;
    let link = parameters.link.filter(|i| *i < loaded.data.len());
    Ok((loaded, link.ok_or_else(|| bad_request("query parameter `link`: no such link"))?))
}

/// Creates the bundle of the measurement of a link; for powers, of those of its transmitter at all receivers.
fn link_bundle(side: &ViewPane, parameters: &QueryParams) -> BundleResult {
    let (loaded, i) = loaded_link(side, parameters)?;
    let image = loaded.data.image(i);
    let mut bundle = TensorBundle::new(json!({ "strongest": strongest_direction(side, &image) }));
    if side.setup.task.is_scalar {
        let mut powers = vec![Real::NAN; side.setup.receivers.len()];
        for other in loaded.data.links_of(&[loaded.data.links[i].location]) {
            powers[loaded.data.links[other].receiver] = loaded.data.image(other).pixels[0];
        }
        bundle.put("powers", &[powers.len()], powers);
    }
    bundle.put("picture", &[image.height, image.width], image.pixels);
    Ok(bundle)
}

/// Creates the bundle of the radio map at one receiver over a horizontal plane: power in dBm, or mean power of a
/// channel in dB; an error for spectra.
fn map_bundle(side: &ViewPane, parameters: &QueryParams) -> BundleResult {
    let predictor = current_predictor(side)?;
    check_receiver(side, parameters)?;
    let z = parameters.z.ok_or_else(|| bad_request("no height; set z=1.2"))?;
    if side.setup.task.has_pixels {
        return Err(bad_request("maps: not available for spectra, only for powers and channels"));
    }
    let data = &loaded_data(side)?.data;
    let corners = [data.scene.bounds.0, data.scene.bounds.1].map(|corner| data.scene.origin.world(corner));
    let [width, height] = [0, 1].map(|k| (corners[1][k] - corners[0][k]).max(LEAST_SIDE_M));
    let step = width.max(height) / ACROSS as f64;
    let centres = |k: usize, length: f64| {
        let count = (length / step).round().max(1.0);
        [corners[0][k] + 0.5 * step, corners[0][k] + (count - 0.5) * step]
    };
    let (bounds, quantities) = (PlaneBounds([centres(0, width), centres(1, height)]), &[MapQuantity::Power]);
    let plane = MapPlane { axis: 2, coordinate: z }; // axis 2 is z
    let grid = PlaneGrid::new(plane, bounds, step, quantities.len()).map_err(|e| bad_request(&e.to_string()))?;
    let predict = |queries: &[Query<'_>]| predictor.predict_many(queries);
    let request = MapRequest { setup: &side.setup, grid: &grid, receivers: &[parameters.receiver], quantities };
    let layers = request.layers(&predict, |_| {});
    let first = data.scene.origin.local(grid.position(0));
    let mut bundle = TensorBundle::new(json!({ "first": first, "step": step }));
    bundle.put("map", &[grid.rows, grid.columns], layers[0].values.iter().map(|v| *v as Real));
    if let Some((_, training)) = predictor.ensemble().and_then(|ensemble| training_layer(ensemble, &grid)) {
        let beyond = training.is_beyond.into_iter().map(u8::from);
        bundle.put_bytes("extrapolated", &[grid.rows, grid.columns], beyond.collect());
    }
    Ok(bundle)
}

/// Creates the bundle of a located transmitter: its position from the observations of all receivers, and the density
/// over the floor. Metres, world frame. A training sample is compared without itself.
fn location_bundle(side: &ViewPane, parameters: &QueryParams) -> BundleResult {
    let ((loaded, i), predictor) = (loaded_link(side, parameters)?, current_predictor(side)?);
    if !predictor.has_position_input() {
        return Err(bad_request("localisation: this model takes other features than a transmitter position"));
    }
    let fitted = side.fit_locator(loaded, predictor).map_err(|why| bad_request(&why.to_string()))?;
    let (locator, data) = (fitted.borrow_dependent(), &loaded.data);
    let transmitter = data.links[i].location;
    let truth = data.locations[transmitter].position();
    let is_training = data.locations_of(&loaded.partition.train).contains(&transmitter);
    let observation = locator.observations(data, &[transmitter]).concat();
    let located = locator.locate_without(&observation, is_training.then_some(truth));
    let mut bundle = TensorBundle::new(json!({
        "estimate": located.position, "truth": truth, "error_m": neighbours::distance(located.position, truth),
        "misfit": located.misfit, "part": loaded.partition.set_of(i) as u8, "left_out": is_training,
        "no_region": locator.missing_regions(),
    }));
    if let Some(region) = &located.region {
        bundle.note["region"] = json!({
            "first": region.first_centre(), "step": region.step, "area_m2": region.area(), "outlines": region.outlines(),
            "parts": region.part_count(),
            "holds": located.holds(truth),
        });
        let shape = [region.values.len() / region.columns, region.columns];
        bundle.put("density", &shape, region.values.iter().map(|v| Real::from(*v)));
    }
    Ok(bundle)
}

/// Creates the bundle of the training curve: steps, losses and numbers of Gaussians, in at most about [`ROWS`] rows.
fn curve_bundle(side: &ViewPane) -> TensorBundle {
    let training = side.folder.as_deref().map(training_folder);
    let rows = training.map_or(Vec::new(), |(_, training)| read_series(&training.join(CURVE)));
    let stride = rows.len().div_ceil(ROWS).max(1);
    let shown: Vec<_> =
        rows.iter().enumerate().filter(|(k, _)| (k + 1).is_multiple_of(stride) || k + 1 == rows.len()).collect();
    let field = |row: &[Option<f64>], k: usize| row.get(k).copied().flatten().unwrap_or(f64::NAN) as Real;
    let mut bundle = TensorBundle::new(json!({ "rows": shown.len() }));
    bundle.put("curve", &[shown.len(), 3], shown.iter().flat_map(|(_, row)| CURVE_COLUMNS.map(|k| field(row, k))));
    bundle
}

/// Reads the snapshots of a run with their titles, by step; damaged snapshots are left out.
fn read_snapshots(side: &ViewPane) -> Vec<(String, Snapshot)> {
    let Some(folder) = &side.folder else { return Vec::new() };
    let readable = snapshots().filter_map(|(name, title)| {
        let snapshot = Snapshot::read(&folder.join(name)).ok().flatten()?;
        Some((format!("{title}, step {}", grouped(snapshot.step as i64)), snapshot))
    });
    let mut stored: Vec<_> = readable.collect();
    stored.sort_by_key(|(_, snapshot)| snapshot.step);
    stored
}
