//! `report.html`: one file with nothing outside it; table, curves, spectra beside ground truth.

mod curves;
mod room;
mod tables;

use crate::draw::spectra::{self, Mark, Scale};
use minijinja::value::Serde;
use minijinja::{Environment, context};
use pwrfgs_core::{Error, Image, Result, plugin::ron_options, ssim};
use pwrfgs_experiment::Results;
use pwrfgs_experiment::clock::duration;
use pwrfgs_experiment::samples;
use pwrfgs_experiment::text::grouped;
use rayon::prelude::*;
use serde::Serialize;

const TEMPLATE: &str = include_str!("run_page/page.html");

/// The page of an evaluated model.
///
/// # Errors
/// Where a snapshot of the training is damaged.
pub fn page(results: &Results<'_>) -> Result<String> {
    let scores = results.assessment.scores.table();
    let figures = curves::all(results)?;
    let room = room::figure(results)?;
    let (examples, limit) = examples(results);
    let page = context! {
        name => results.pipeline.name.clone(),
        title => results.data.title.clone(),
        simulated => results.data.is_simulated(),
        facts => facts(results),
        scores => Serde(tables::scores(&scores)),
        notes => scores.notes.clone(),
        whole => Serde(tables::whole(&scores)),
        figures => Serde(figures),
        room => Serde(room),
        examples => Serde(examples),
        power_bar => Scale::Power.bar(),
        error_bar => Scale::Error(limit).bar(),
        angles => results.model.stages.plane.angles.is_some(),
        has_validation => !results.partition.validation.is_empty(),
        pipeline => results.pipeline.to_ron(),
        version => results.facts.version.clone(),
        written => results.facts.finished.clone(),
    };
    let failed = |e: minijinja::Error| Error::Config(format!("the report's template: {e:#}"));
    let mut environment = environment().map_err(failed)?;
    environment.add_template("report.html", TEMPLATE).map_err(failed)?;
    environment.get_template("report.html").and_then(|t| t.render(page)).map_err(failed)
}

/// Templates that find the style all pages share.
pub(crate) fn environment() -> Result<Environment<'static>, minijinja::Error> {
    let mut environment = Environment::new();
    environment.add_template("style.css", include_str!("style.css"))?;
    Ok(environment)
}

/// Name and value of what a reader wants to know first.
fn facts(results: &Results<'_>) -> Vec<(&'static str, String)> {
    let Results { pipeline, model, data, partition, facts, .. } = results;
    let [low, high] = [data.scene.bounds.0, data.scene.bounds.1].map(|p| p.map(|v| (v * 10.0).round() / 10.0));
    let size = |bytes: usize| format!("{} kB", grouped((bytes as f64 / 1000.0).round() as i64));
    let split = ron_options().to_string_pretty(
        &pipeline.split,
        ron_config().depth_limit(0), // on one line
    );
    let mut all = vec![
        ("Gaussians", grouped(model.cloud.len() as i64)),
        ("Model", format!("{} Gaussians, {} network", size(model.gaussian_bytes()), size(model.network_bytes()))),
        ("Training", format!("{} steps in {}", grouped(facts.steps as i64), duration(facts.training_seconds))),
        ("In all", format!("{}, peak memory {} MB", duration(facts.wall_seconds), facts.peak_memory_bytes / 1_000_000)),
        (
            "Spectra",
            format!(
                "{} train, {} validation, {} test; {} × {} pixels",
                grouped(partition.train.len() as i64),
                grouped(partition.validation.len() as i64),
                grouped(partition.test.len() as i64),
                data.width,
                data.height
            ),
        ),
        ("Split", split.unwrap_or_default()),
        ("Scene", format!("from {low:?} to {high:?} m")),
        ("Seed", pipeline.seed.to_string()),
        ("Machine", format!("{}, {} threads", facts.machine.cpu, facts.machine.threads)),
    ];
    let commit = facts.commit.as_ref().map_or_else(String::new, |id| format!(", commit {}", &id[..id.len().min(10)]));
    all.push(("Program", format!("pwrfgs {}{commit}", facts.version)));
    if facts.steps == 0 {
        all.retain(|(name, _)| !["Training", "In all"].contains(name));
    }
    all
}

/// How plugins are written in the report.
fn ron_config() -> ron::ser::PrettyConfig {
    ron::ser::PrettyConfig::new().struct_names(true)
}

/// Ground truth, prediction and error of one test spectrum.
#[derive(Serialize)]
struct Example {
    which: &'static str,
    id: u32,
    ssim: String,
    tx: String,
    nearest: String,
    peaks: String,
    panels: Vec<Panel>,
}

#[derive(Serialize)]
struct Panel {
    name: &'static str,
    map: String,
    sky: Option<String>,
}

/// Best, median and worst test spectrum by SSIM, and the limit of the error scale that they share.
fn examples(results: &Results<'_>) -> (Vec<Example>, f64) {
    let (predictions, truths) = (&results.assessment.predictions, &results.assessment.truths);
    let scores: Vec<f64> = predictions.par_iter().zip(truths).map(|(p, t)| ssim::evaluation(&p.clamped(), t)).collect();
    let mut order: Vec<usize> = (0..scores.len()).collect();
    order.sort_by(|&a, &b| scores[b].total_cmp(&scores[a]).then(a.cmp(&b)));
    let Some(last) = order.len().checked_sub(1) else { return (Vec::new(), 1.0) };
    let mut chosen = vec![("Best", order[0]), ("Median", order[last / 2]), ("Worst", order[last])];
    chosen.dedup_by_key(|c| c.1);
    let errors: Vec<Image> = chosen.iter().map(|&(_, i)| difference(&predictions[i].clamped(), &truths[i])).collect();
    let largest = errors.iter().flat_map(|e| &e.pixels).fold(0.0, |m: f64, e| m.max(e.abs() as f64));
    let limit = ((largest * 10.0).ceil() / 10.0).max(0.1);
    let distances = samples::nearest_train(results.data, results.partition);
    let example = |(&(which, i), error): (&(&'static str, usize), &Image)| {
        let index = results.partition.test[i];
        let sample = &results.data.samples[index];
        let (truth, prediction) = (&truths[i], &predictions[i]);
        let marks = [Mark::Measured(truth.argmax()), Mark::Predicted(prediction.argmax())];
        let plane = &results.model.stages.plane;
        let panel = |name, image: &Image, scale, marks: &[Mark]| Panel {
            name,
            map: spectra::map(image, plane, scale, marks),
            sky: spectra::sky(image, plane, scale, marks),
        };
        Example {
            which,
            id: sample.id,
            ssim: format!("{:.3}", scores[i]),
            tx: sample.tx.map(|v| format!("{v:.2}")).join(", "),
            nearest: if distances[index].is_finite() { format!("{:.2} m", distances[index]) } else { "n/a".into() },
            peaks: peaks(results, truth, prediction),
            panels: vec![
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
    let plane = &results.model.stages.plane;
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
