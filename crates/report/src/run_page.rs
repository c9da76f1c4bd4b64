//! `report.html`: one file with nothing outside it; table, curves, and predictions beside what was observed, as its kind
//! wants them.

mod channels;
mod curves;
mod examples;
mod live;
mod powers;
mod predicted;
mod receivers;
mod room;
mod tables;

use crate::draw::spectra::{self, Mark, Scale};
use crate::study::one_line;
use crate::templates::render;
use examples::Example;
use minijinja::value::Serde;
use minijinja::{Value, context};
use pwrfgs_core::{Appearance, Image, Result};
use pwrfgs_experiment::{CEILING, LoadedRun, folder::REPORT};
use pwrfgs_model::Model;

/// The page of a run, from what lies in its folder.
///
/// # Errors
/// A snapshot of the training is damaged, or an observation cannot be read.
pub fn page(run: &LoadedRun<'_>) -> Result<String> {
    let LoadedRun { record, model, data, partition } = run;
    let (scores, facts, pipeline) = (&record.scores.table, &record.facts, &record.pipeline);
    let chosen = examples::examples(run)?;
    let (examples, limit) = spectra_of(run, &chosen);
    let bounds = [data.scene.bounds.0, data.scene.bounds.1]
        .map(|p| data.scene.origin.world(p).map(|v| (v * 10.0).round() / 10.0));
    let draws_splats = model.is_drawn_as(Appearance::Ellipsoids);
    let page = context! {
        name => pipeline.name.clone(),
        title => data.title.clone(),
        simulated => data.is_simulated(),
        facts => Serde(facts),
        gaussians => model.gaussians(),
        bytes => [model.gaussian_bytes(), model.network_bytes()],
        samples => partition.sizes(),
        has_pixels => data.task().has_pixels,
        words => words(run),
        split => one_line(&pipeline.split),
        bounds => bounds.map(Vec::from),
        seed => pipeline.seed,
        heading => scores.heading(),
        paired => scores.paired.as_ref().map(|pairs| (pairs.lines(&scores.bounds), pairs.note(scores.task))),
        predictors => scores.predictors.clone(),
        ceiling => CEILING,
        groups => tables::groups(scores),
        bounds_known => scores.bounds.clone(),
        notes => scores.notes.clone(),
        figures => curves::all(run),
        room => if draws_splats { Some(room::figure(run)?) } else { None },
        powers => data.task().is_scalar.then(|| powers::section(run, &chosen)),
        receivers => receivers::table(run),
        channels => data.task().is_complex.then(|| channels::section(run, &chosen)),
        examples,
        power_bar => Scale::Power.bar().svg("bar", "colours of power"),
        error_bar => Scale::Error(limit).bar().svg("bar", "colours of the error"),
        live => live::section(run),
        angles => model.plane().angles.is_some(),
        pipeline => settings(run),
        members => members(run),
        confidence => curves::confidence(run),
    };
    render("run.html", page)
}

/// What things are called.
fn words(run: &LoadedRun<'_>) -> Value {
    let task = run.data.task();
    let [singular, plural] = task.counted;
    let size = task.size_text((run.data.width, run.data.height)).map(|size| size.replace(" x ", " × "));
    let (first, rest) = plural.split_at(1);
    let splats = run.model.is_drawn_as(Appearance::Ellipsoids);
    let none = run.model.gaussians() == 0;
    let parts = if splats || none { "Gaussians" } else { "Virtual transmitters" };
    context! { plural, singular, size, title => first.to_uppercase() + rest, parts, none }
}

/// The pipeline; of several models the one that scores them.
fn settings(run: &LoadedRun<'_>) -> String {
    let is_joined = run.model.members().len() > 1;
    let note = "// each run has its own pipeline; this one scores the mean of their predictions:\n";
    if is_joined { note } else { "" }.to_owned() + &run.record.pipeline.to_ron()
}

/// Name, Gaussians and page of each model of a joined model.
fn members(run: &LoadedRun<'_>) -> Vec<Value> {
    let models = run.model.names().iter().zip(run.model.members());
    let member = |(folder, (name, model)): (&String, (&String, &Model))| {
        let page = format!("../{folder}/{REPORT}");
        context! { name, page, gaussians => model.cloud.len() }
    };
    run.record.facts.members.iter().zip(models).map(member).collect()
}

/// Best, median and worst test spectrum by SSIM, and the limit of the error scale that they share.
fn spectra_of(run: &LoadedRun<'_>, chosen: &[Example]) -> (Vec<Value>, f64) {
    let chosen = if run.data.task().has_pixels { chosen } else { &[] };
    let errors: Vec<Image> = chosen.iter().map(|e| difference(&e.prediction.clamped(), &e.truth)).collect();
    let largest = errors.iter().flat_map(|e| &e.pixels).fold(0.0, |m: f64, e| m.max(e.abs() as f64));
    let limit = ((largest * 10.0).ceil() / 10.0).max(0.1);
    let example = |(example, error): (&Example, &Image)| {
        let Example { which, sample: index, score, nearest_m, truth, prediction } = example;
        let sample = &run.data.sample(*index);
        let marks = [Mark::Measured(truth.argmax()), Mark::Predicted(prediction.argmax())];
        let plane = run.model.plane();
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
            nearest => nearest_m.map_or("n/a".into(), |distance| format!("{distance:.2} m")),
            peaks => peaks(run, truth, prediction),
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
fn peaks(run: &LoadedRun<'_>, truth: &Image, prediction: &Image) -> String {
    let plane = run.model.plane();
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
