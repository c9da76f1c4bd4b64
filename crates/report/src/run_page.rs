//! `report.html`: one file with nothing outside it; table, curves, and predictions beside what was observed, as its kind
//! wants them.

mod channels;
mod curves;
mod live;
mod powers;
mod predicted;
mod receivers;
mod room;
mod tables;
mod words;

use crate::draw::spectra::{self, Mark, Scale};
use crate::study::one_line;
use crate::templates::render;
use minijinja::value::Serde;
use minijinja::{Value, context};
use pwrfgs_core::{Image, Result, Task};
use pwrfgs_experiment::{CEILING, Example, Results, ensemble::MEMBERS, folder::REPORT, samples};
use pwrfgs_model::Model;
use words::Words;

/// The page of an evaluated model.
///
/// # Errors
/// Where a snapshot of the training is damaged.
pub fn page(results: &Results<'_>) -> Result<String> {
    let scores = results.assessment.scores.table();
    let (examples, limit) = examples(results);
    let Results { pipeline, model, data, partition, facts, .. } = results;
    let bounds = [data.scene.bounds.0, data.scene.bounds.1]
        .map(|p| data.scene.origin.world(p).map(|v| (v * 10.0).round() / 10.0));
    let draws_splats = model.members().iter().all(|model| model.stages.splatting().is_some());
    let page = context! {
        name => pipeline.name.clone(),
        title => data.title.clone(),
        simulated => data.is_simulated(),
        facts => Serde(facts),
        gaussians => model.gaussians(),
        bytes => [model.gaussian_bytes(), model.network_bytes()],
        samples => [&partition.train, &partition.validation, &partition.test].map(Vec::len),
        kind => format!("{:?}", data.task()),
        words => words(results),
        split => one_line(&pipeline.split),
        bounds => bounds.map(Vec::from),
        seed => pipeline.seed,
        heading => scores.heading(),
        paired => scores.paired.as_ref().map(|pairs| (pairs.lines(&scores.bounds), pairs.note(scores.kind))),
        predictors => scores.predictors.clone(),
        ceiling => CEILING,
        groups => tables::groups(&scores),
        bounds_known => scores.bounds.clone(),
        notes => scores.notes.clone(),
        figures => curves::all(results),
        room => if draws_splats { Some(room::figure(results)?) } else { None },
        powers => (data.task() == Task::Power).then(|| powers::section(results)),
        receivers => receivers::table(results),
        channels => (data.task() == Task::Channel).then(|| channels::section(results)),
        examples,
        power_bar => Scale::Power.bar().svg("bar", "colours of power"),
        error_bar => Scale::Error(limit).bar().svg("bar", "colours of the error"),
        live => live::section(results),
        angles => model.plane().angles.is_some(),
        pipeline => results.settings.clone(),
        members => members(results),
        confidence => curves::confidence(results),
    };
    render("run.html", page)
}

/// What things are called.
fn words(results: &Results<'_>) -> Value {
    let Words { plural, singular, size } = words::words(results.data);
    let (first, rest) = plural.split_at(1);
    let splats = results.model.members().iter().all(|model| model.stages.splatting().is_some());
    let none = results.model.gaussians() == 0;
    let parts = if splats || none { "Gaussians" } else { "Virtual transmitters" };
    context! { plural, singular, size, title => first.to_uppercase() + rest, parts, none }
}

/// Name, seed, Gaussians and page of each member of an ensemble.
fn members(results: &Results<'_>) -> Vec<Value> {
    let names = results.facts.members.iter().zip(results.model.members());
    let member = |(name, model): (&String, &Model)| {
        let page = format!("{MEMBERS}/{name}/{REPORT}");
        context! { name, page, gaussians => model.cloud.len() }
    };
    names.map(member).collect()
}

/// Best, median and worst test spectrum by SSIM, and the limit of the error scale that they share.
fn examples(results: &Results<'_>) -> (Vec<Value>, f64) {
    let chosen: &[Example] = if results.data.task() == Task::Spectrum { &results.assessment.examples } else { &[] };
    let errors: Vec<Image> = chosen.iter().map(|e| difference(&e.prediction.clamped(), &e.truth)).collect();
    let largest = errors.iter().flat_map(|e| &e.pixels).fold(0.0, |m: f64, e| m.max(e.abs() as f64));
    let limit = ((largest * 10.0).ceil() / 10.0).max(0.1);
    let distances = samples::nearest_train(results.data, results.partition);
    let example = |(example, error): (&Example, &Image)| {
        let Example { which, sample: index, score, truth, prediction } = example;
        let sample = &results.data.sample(*index);
        let marks = [Mark::Measured(truth.argmax()), Mark::Predicted(prediction.argmax())];
        let plane = results.model.plane();
        let panel = |name: &str, image: &Image, scale, marks: &[Mark]| {
            let map = spectra::map(image, plane, scale, marks).svg("map", name);
            let sky = spectra::sky(image, plane, scale, marks).map(|canvas| canvas.svg("sky", name));
            context! { name, map, sky }
        };
        context! {
            which => *which,
            id => sample.id,
            ssim => format!("{score:.3}"),
            tx => sample.tx.map(|v| format!("{v:.2}")).join(", "),
            nearest => if distances[*index].is_finite() { format!("{:.2} m", distances[*index]) } else { "n/a".into() },
            peaks => peaks(results, truth, prediction),
            panels => vec![
                panel("Ground truth", truth, Scale::Power, &marks[..1]),
                panel("Predicted", &prediction.clamped(), Scale::Power, &marks),
                panel("Predicted − truth", error, Scale::Error(limit), &[]),
            ],
        }
    };
    (chosen.iter().zip(&errors).map(example).collect(), limit)
}

/// `a` minus `b`.
fn difference(a: &Image, b: &Image) -> Image {
    Image { width: a.width, height: a.height, pixels: a.pixels.iter().zip(&b.pixels).map(|(a, b)| a - b).collect() }
}

/// The strongest directions in words; nothing where the plane has no angles.
fn peaks(results: &Results<'_>, truth: &Image, prediction: &Image) -> String {
    let plane = results.model.plane();
    let direction = |image: &Image| {
        let i = image.argmax();
        plane.azimuth_elevation_deg((i % image.width) as _, (i / image.width) as _)
    };
    match (direction(truth), direction(prediction)) {
        (Some((az, el)), Some((az2, el2))) => {
            format!("strongest at {az:.0}° / {el:.0}°, predicted {az2:.0}° / {el2:.0}°")
        }
        _ => String::new(),
    }
}
