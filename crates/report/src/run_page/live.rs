//! The part of the page that moves: the room to turn, samples to step through, and where it is one small model a transmitter to
//! drag. Everything lies in the page; without scripts it is not there.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use minijinja::{Value, context};
use pwrfgs_core::files::digest;
use pwrfgs_core::{Image, Query, Task, evenly};
use pwrfgs_experiment::Results;
use pwrfgs_experiment::headline::headline;
use pwrfgs_experiment::scores::MODEL;
use pwrfgs_live::{Known, Pack, STAGE, STYLE, bundle, gaussians, origin, room};
use pwrfgs_model::{Ensemble, file};
use serde_json::json;

/// Most spectra in a page, and most bytes of them.
const SPECTRA: usize = 50;
const BYTES: usize = 2_400_000;
/// Surface points in a page.
const POINTS: usize = 3_000;
/// Most Gaussians in a page.
const GAUSSIANS: usize = 20_000;
/// Links whose transmitters a page shows at most, besides those whose spectra lie in it.
const LINKS: usize = 5_000;
/// Largest model that predicts in the page, bytes.
const MODEL_BYTES: usize = 1 << 20;
/// Names of deformations that `web/predict.js` knows.
const PREDICTED_IN_PAGE: [&str; 3] = ["Fixed", "Mlp", "Factored"];
/// What the script does last.
const START: &str = "startReport();\n";

/// What the template needs: the script always, for tables are sorted too; the stage where positions are known.
pub(super) fn section(results: &Results<'_>) -> Value {
    let script = bundle(START);
    let digest = hash(&script);
    if !results.data.placed || results.partition.test.is_empty() {
        return context! { script, digest };
    }
    let spectra = results.data.task() == Task::Spectrum;
    let model = model_bytes(results);
    let gaussians = shows(results.model).then(|| {
        let origin = origin(&results.model.members()[0].stages.frame, Some(results.data));
        gaussians(results.model, origin, None).to_bytes()
    });
    let chosen = if spectra { chosen(results, model.is_some()) } else { Vec::new() };
    let links = shown(results, &chosen);
    context! {
        script,
        digest,
        stage => STAGE,
        style => STYLE,
        room => base64(&room_pack(results, &links).to_bytes()),
        gaussians => gaussians.as_deref().map(base64),
        spectra => spectra.then(|| base64(&spectra_pack(results, &links, &chosen, model.is_none()).to_bytes())),
        model => model.as_deref().map(base64),
    }
}

/// As a page's policy names the one script that may run.
fn hash(script: &str) -> String {
    let digits = digest(script.as_bytes());
    let byte = |k: usize| u8::from_str_radix(&digits[2 * k..2 * k + 2], 16).unwrap_or_default();
    base64(&(0..digits.len() / 2).map(byte).collect::<Vec<_>>())
}

fn base64(bytes: &[u8]) -> String {
    STANDARD.encode(bytes)
}

/// Whether its Gaussians are few enough for a page.
fn shows(model: &Ensemble) -> bool {
    (1..=GAUSSIANS).contains(&model.gaussians())
}

/// The model file, where it is one model that the page can predict.
fn model_bytes(results: &Results<'_>) -> Option<Vec<u8>> {
    let [only] = results.model.members() else { return None };
    let splatting = only.stages.splatting()?;
    let name = pwrfgs_core::plugin::to_ron(&splatting.deformation);
    let known = PREDICTED_IN_PAGE.iter().any(|own| name.starts_with(own));
    let drawn = only.stages.frame.receivers.len() == 1 && results.data.task() == Task::Spectrum;
    let small = only.gaussian_bytes() + only.network_bytes() <= MODEL_BYTES;
    (known && drawn && small).then(|| file::to_bytes(only))
}

/// Test links whose spectra lie in the page: evenly from the best to the worst, as many as there is room for.
fn chosen(results: &Results<'_>, alone: bool) -> Vec<usize> {
    let of_one = results.data.width * results.data.height * if alone { 1 } else { 2 };
    let most = SPECTRA.min(BYTES / of_one.max(1)).max(1);
    let mut test: Vec<(usize, f64)> = scored(results).collect();
    test.sort_by(|a, b| a.1.total_cmp(&b.1));
    let all: Vec<usize> = test.into_iter().map(|(i, _)| i).collect();
    let mut chosen = evenly(&all, most);
    chosen.sort_unstable();
    chosen
}

/// The links that the page knows, sorted: the chosen ones, and others evenly.
fn shown(results: &Results<'_>, chosen: &[usize]) -> Vec<usize> {
    let all: Vec<usize> = (0..results.data.len()).collect();
    let mut shown = [&evenly(&all, LINKS)[..], chosen].concat();
    shown.sort_unstable();
    shown.dedup();
    shown
}

/// Test links with their score.
fn scored<'a>(results: &'a Results<'_>) -> impl Iterator<Item = (usize, f64)> + 'a {
    let key = headline(results.data.task()).key;
    let values = results.assessment.scores.samples(MODEL, key).unwrap_or_default();
    let score = |k: usize| values.get(k).copied().unwrap_or(f64::NAN);
    results.partition.test.iter().enumerate().map(move |(k, &i)| (i, score(k)))
}

fn room_pack(results: &Results<'_>, links: &[usize]) -> Pack {
    let mut scores = vec![f64::NAN; results.data.len()];
    scored(results).for_each(|(i, score)| scores[i] = score);
    let known = Known { data: results.data, partition: results.partition, scores: &scores, links };
    let mut pack = room(&results.model.members()[0].stages.frame, Some(known), &[], POINTS);
    let ellipsoids = results.model.members().iter().all(|model| model.stages.splatting().is_some());
    pack.note["sides"] = json!([{
        "name": results.pipeline.name,
        "gaussians": shows(results.model).then(|| results.model.gaussians()),
        "members": results.model.members().len(),
        "ellipsoids": ellipsoids,
        "moments": [],
    }]);
    pack
}

/// What was observed of each chosen link and, where the page does not predict, what was predicted; 8 bits a pixel. Called by
/// their places among `links`.
fn spectra_pack(results: &Results<'_>, links: &[usize], chosen: &[usize], predicted: bool) -> Pack {
    let places: Vec<usize> = chosen.iter().filter_map(|link| links.binary_search(link).ok()).collect();
    let mut pack = Pack::new(json!({ "links": places }));
    let put = |pack: &mut Pack, name: String, image: &Image| {
        pack.put_bytes(&name, &[image.height, image.width], image.to_bytes());
    };
    let queries: Vec<Query<'_>> = chosen.iter().map(|&i| results.data.query(i)).collect();
    let pictures = if predicted { results.model.prepare().predict_many(&queries) } else { Vec::new() };
    for (k, (place, &i)) in places.iter().zip(chosen).enumerate() {
        put(&mut pack, format!("truth.{place}"), &results.data.image(i));
        if let Some(picture) = pictures.get(k) {
            put(&mut pack, format!("predicted.{place}"), picture);
        }
    }
    pack
}
