//! Interactive part of the page: a room to rotate, samples to browse and, for one small model, a transmitter to
//! move. All data are in the page; without scripts, this part is not shown.

use crate::live::{PartitionedData, STAGE, STYLE, TensorBundle, bundle, gaussians, origin, room};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use minijinja::{Value, context};
use pwrfgs_core::{Appearance, Dataset, Image, Query, Real, evenly, files::digest, plugin::name_of};
use pwrfgs_experiment::{LoadedRun, scores::MODEL};
use pwrfgs_model::{Ensemble, compress, file};
use serde_json::json;

/// Maximum number of test observations in a page, and their maximum bytes.
const OBSERVATIONS: usize = 50;
const BYTES: usize = 2_400_000;
/// Maximum number of surface points in a page.
const POINTS: usize = 3_000;
/// Maximum number of Gaussians in a page.
const GAUSSIANS: usize = 20_000;
/// Maximum number of links with a shown transmitter, besides those whose observations are in the page.
const LINKS: usize = 5_000;
/// Maximum size of a model that predicts in the page, bytes.
const MODEL_BYTES: usize = 1 << 20;
/// Largest file of a model in 8 bits, which the page holds if the model is larger than [`MODEL_BYTES`].
const COMPRESSED_BYTES: usize = 3 << 19;
/// Deformations that `web/predict.js` supports.
const PREDICTED_IN_PAGE: [&str; 3] = ["Fixed", "Mlp", "Factored"];
/// Last statement of the script.
const START: &str = "startReport();\n";

/// Returns the values of the interactive part for `live.html`: always the script, which also sorts tables, and its hash; the
/// stage with its data only with transmitter positions and a test set.
pub(super) fn section(run: &LoadedRun<'_>) -> Value {
    let script = bundle(START);
    let digest = script_hash(&script);
    if !run.data.placed || run.partition.test.is_empty() {
        return context! { script, digest };
    }
    let model = model_bytes(run);
    let gaussians = has_few_gaussians(run.model).then(|| {
        let origin = origin(&run.model.members()[0].stages.setup, Some(run.data));
        gaussians(run.model, origin, None).to_bytes()
    });
    let chosen = choose_links(run, model.is_some());
    let links = page_links(run, &chosen);
    context! {
        script,
        digest,
        stage => STAGE,
        style => STYLE,
        room => encode_base64(&room_tensors(run, &links).to_bytes()),
        gaussians => gaussians.as_deref().map(encode_base64),
        observations => encode_base64(&observation_tensors(run, &links, &chosen, model.is_none()).to_bytes()),
        model => model.as_deref().map(encode_base64),
    }
}

/// Returns the SHA-256 of the only permitted script as Base64, for the content security policy.
fn script_hash(script: &str) -> String {
    let digits = digest(script.as_bytes());
    let byte = |k: usize| u8::from_str_radix(&digits[2 * k..2 * k + 2], 16).unwrap_or_default();
    encode_base64(&(0..digits.len() / 2).map(byte).collect::<Vec<_>>())
}

/// Encodes bytes as Base64.
fn encode_base64(bytes: &[u8]) -> String {
    STANDARD.encode(bytes)
}

/// Returns whether there are Gaussians, and few enough for a page.
fn has_few_gaussians(model: &Ensemble) -> bool {
    (1..=GAUSSIANS).contains(&model.gaussians())
}

/// Returns the model file, whole or in 8 bits; `None` unless it is one model that the page can predict, and small enough.
fn model_bytes(run: &LoadedRun<'_>) -> Option<Vec<u8>> {
    let ([only], None) = (run.model.members(), run.model.residuals()) else { return None };
    let deformation = only.stages.deformation()?;
    let name = name_of(deformation);
    let is_match = |supported: &&str| name.starts_with(*supported) && !deformation.traits().reads_carrier;
    let is_supported = PREDICTED_IN_PAGE.iter().any(is_match);
    let setup = &only.stages.setup;
    let is_fixed = setup.receivers.len() == 1 && !setup.moving.is_receiver() && setup.plane.camera.is_none();
    let has_fixed_spectra = is_fixed && run.data.task().has_pixels;
    if !(is_supported && has_fixed_spectra) {
        return None;
    }
    if only.gaussian_bytes() + only.network_bytes() <= MODEL_BYTES {
        return Some(file::to_bytes(only));
    }
    compress::to_bytes(run.model, compress::Bits::Eight).ok().filter(|bytes| bytes.len() <= COMPRESSED_BYTES)
}

/// Chooses the test links whose observations are in the page, ascending: as many as fit, evenly from best to worst, and the
/// median link. Observations are `alone`, or with a prediction of the same size.
fn choose_links(run: &LoadedRun<'_>, alone: bool) -> Vec<usize> {
    let task = run.data.task();
    let numbers = if task.is_scalar { run.data.scene.receivers.len() } else { run.data.width * run.data.height };
    let bytes_per_link = numbers * if task.has_pixels { 1 } else { size_of::<f32>() } * if alone { 1 } else { 2 };
    let most = OBSERVATIONS.min(BYTES / bytes_per_link.max(1)).max(1);
    let mut test: Vec<(usize, f64)> = scored_links(run).collect();
    test.sort_by(|a, b| a.1.total_cmp(&b.1));
    let sorted: Vec<usize> = test.into_iter().map(|(i, _)| i).collect();
    let mut chosen = evenly(&sorted, most);
    chosen.extend(median_link(run));
    chosen.sort_unstable();
    chosen.dedup();
    chosen
}

/// Returns the test link with the median score, with which the page opens; `None` if no link has a score.
fn median_link(run: &LoadedRun<'_>) -> Option<usize> {
    let mut scored: Vec<(usize, f64)> = scored_links(run).filter(|(_, score)| !score.is_nan()).collect();
    let headline = run.data.task().headline;
    scored.sort_by(|a, b| headline.cost(a.1).total_cmp(&headline.cost(b.1)).then(a.0.cmp(&b.0)));
    Some(scored.get(scored.len().checked_sub(1)? / 2)?.0)
}

/// Returns the links on the page, ascending: the `chosen` ones, and others evenly.
fn page_links(run: &LoadedRun<'_>, chosen: &[usize]) -> Vec<usize> {
    let links: Vec<usize> = (0..run.data.len()).collect();
    let mut shown = [&evenly(&links, LINKS)[..], chosen].concat();
    shown.sort_unstable();
    shown.dedup();
    shown
}

/// Returns the test links with their scores by the first metric, NaN if unknown.
fn scored_links<'a>(run: &'a LoadedRun<'_>) -> impl Iterator<Item = (usize, f64)> + 'a {
    let key = run.data.task().headline.key;
    let values = run.record.scores.sample_values(MODEL, key).unwrap_or_default();
    let score = |k: usize| values.get(k).copied().unwrap_or(f64::NAN);
    run.partition.test.iter().enumerate().map(move |(k, &i)| (i, score(k)))
}

/// Returns the room with `links` and the properties of the model, as the viewer describes a side, for the page.
fn room_tensors(run: &LoadedRun<'_>, links: &[usize]) -> TensorBundle {
    let mut scores = vec![f64::NAN; run.data.len()];
    scored_links(run).for_each(|(i, score)| scores[i] = score);
    let measured = PartitionedData { data: run.data, partition: run.partition, scores: &scores, links };
    let mut tensors = room(&run.model.members()[0].stages.setup, Some(measured), &[], POINTS);
    let ellipsoids = run.model.is_drawn_as(Appearance::Ellipsoids);
    tensors.note["median"] = json!(median_link(run).and_then(|link| links.binary_search(&link).ok()));
    tensors.note["sides"] = json!([{
        "name": run.record.pipeline.name,
        "gaussians": has_few_gaussians(run.model).then(|| run.model.gaussians()),
        "members": run.model.members().len(),
        "ellipsoids": ellipsoids,
        "training_limit_m": run.model.training_limit(),
        "snapshots": [],
    }]);
    tensors
}

/// Returns the measurement of each `chosen` link and, if `predicted`, its prediction: `truth.K` and `predicted.K`, where K is its
/// index in `links`. Spectra have 8 bits per pixel; powers are those of all receivers.
fn observation_tensors(run: &LoadedRun<'_>, links: &[usize], chosen: &[usize], predicted: bool) -> TensorBundle {
    let LoadedRun { data, model, .. } = run;
    let indices: Vec<usize> = chosen.iter().filter_map(|link| links.binary_search(link).ok()).collect();
    let mut tensors = TensorBundle::new(json!({ "links": indices }));
    let is_scalar = data.task().is_scalar;
    let mut put = |name: &str, index: usize, images: &[Image]| match images {
        [image] if data.task().has_pixels => {
            tensors.put_bytes(&format!("{name}.{index}"), &[image.height, image.width], image.to_bytes());
        }
        images => {
            let values: Vec<Real> = images.iter().flat_map(|image| image.pixels.iter().copied()).collect();
            tensors.put(&format!("{name}.{index}"), &[values.len()], values);
        }
    };
    let receivers = if is_scalar { data.scene.receivers.len() } else { 1 };
    let queries_of = |&i: &usize| {
        let query = data.query(i);
        (0..receivers).map(move |r| if is_scalar { Query { receiver: r, ..query } } else { query })
    };
    let queries: Vec<Query<'_>> = chosen.iter().flat_map(queries_of).collect();
    let predictions = if predicted { model.prepare().predict_many(&queries) } else { Vec::new() };
    for (k, (index, &i)) in indices.iter().zip(chosen).enumerate() {
        put("truth", *index, &measured_images(data, i));
        if predicted {
            put("predicted", *index, &predictions[k * receivers..][..receivers]);
        }
    }
    tensors
}

/// Returns the observation of a link; for a power, those of its transmitter at all receivers, NaN without one.
fn measured_images(data: &Dataset, link: usize) -> Vec<Image> {
    if !data.task().is_scalar {
        return vec![data.image(link)];
    }
    let mut images = vec![Image { pixels: vec![Real::NAN], ..data.image(link) }; data.scene.receivers.len()];
    for other in data.links_of(&[data.links[link].location]) {
        images[data.links[other].receiver] = data.image(other);
    }
    images
}
