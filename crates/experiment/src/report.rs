//! `report.html`: one file with nothing outside it; table, curves, spectra beside ground truth.

mod charts;
mod colour;
mod curves;
mod spectra;

use crate::clock::duration;
use crate::runner::Subject;
use crate::scores::{Cell, MetricRow, ScoreTable, grouped, number};
use crate::{samples, validation};
use minijinja::value::Serde;
use minijinja::{Environment, context};
use pwrfgs_core::{Error, Image, Result, plugin::ron_options, ssim};
use rayon::prelude::*;
use serde::Serialize;
use spectra::{Mark, Scale};
use std::path::Path;

const TEMPLATE: &str = include_str!("report/template.html");

/// The report of an evaluated model; `curves` is the folder with `curve.csv` and `validation.csv`, if there is one.
pub(crate) fn of(subject: &Subject<'_>, curves: Option<&Path>) -> Result<String> {
    let scores = subject.assessment.scores.table();
    let floors = match curves {
        Some(_) => validation::floors(subject.pipeline, &subject.model.stages.plane, subject.data, subject.partition)?,
        None => Vec::new(),
    };
    let figures = curves::all(subject, curves, &floors)?;
    let (examples, limit) = examples(subject);
    let page = context! {
        name => subject.pipeline.name.clone(),
        title => subject.data.title.clone(),
        facts => facts(subject),
        per_sample => Serde(per_sample(&scores)),
        notes => scores.notes.clone(),
        whole => Serde(whole(&scores)),
        figures => Serde(figures),
        examples => Serde(examples),
        power_bar => Scale::Power.bar(),
        error_bar => Scale::Error(limit).bar(),
        angles => subject.model.stages.plane.angles.is_some(),
        has_validation => !subject.partition.validation.is_empty(),
        pipeline => subject.pipeline.to_ron(),
        version => subject.facts.version.clone(),
        written => subject.facts.finished.clone(),
    };
    let mut environment = Environment::new();
    let failed = |e: minijinja::Error| Error::Config(format!("the report's template: {e:#}"));
    environment.add_template("report.html", TEMPLATE).map_err(failed)?;
    environment.get_template("report.html").and_then(|t| t.render(page)).map_err(failed)
}

/// Name and value of what a reader wants to know first.
fn facts(subject: &Subject<'_>) -> Vec<(&'static str, String)> {
    let Subject { pipeline, model, data, partition, facts, .. } = subject;
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

/// A column group of the score table.
#[derive(Serialize)]
struct Group {
    key: String,
    unit: String,
    arrow: &'static str,
}

/// A predictor's line.
#[derive(Serialize)]
struct Row {
    name: String,
    cells: Vec<Shown>,
}

/// A number and whether it is `best` or `second`.
#[derive(Serialize)]
struct Shown {
    text: String,
    class: &'static str,
}

fn group(row: &MetricRow) -> Group {
    Group { key: row.key.clone(), unit: row.unit.clone(), arrow: if row.higher_is_better { "↑" } else { "↓" } }
}

/// The table of metrics with a number a sample: a line each predictor, three columns each metric.
fn per_sample(scores: &ScoreTable) -> (Vec<Group>, Vec<Row>) {
    let metrics: Vec<&MetricRow> = scores.metrics.iter().filter(|m| m.is_per_sample()).collect();
    let ranks: Vec<[Vec<Option<usize>>; 3]> = metrics.iter().map(|m| [0, 1, 2].map(|k| m.ranks(k))).collect();
    let line = |p: usize| {
        let cell = |(m, k): (usize, usize)| match metrics[m].cells[p].numbers().get(k) {
            None => Shown { text: "n/a".into(), class: "none" },
            Some(value) => Shown {
                text: number(*value),
                class: match ranks[m][k][p] {
                    Some(0) => "best",
                    Some(1) => "second",
                    _ => "",
                },
            },
        };
        (0..metrics.len()).flat_map(|m| (0..3).map(move |k| (m, k))).map(cell).collect()
    };
    let rows =
        scores.predictors.iter().enumerate().map(|(p, name)| Row { name: name.clone(), cells: line(p) }).collect();
    (metrics.into_iter().map(group).collect(), rows)
}

/// The numbers about the whole model, one each metric.
fn whole(scores: &ScoreTable) -> Vec<(Group, String)> {
    let text = |cell: &Cell, unit: &str| match cell {
        Cell::NotApplicable(why) => format!("n/a: {why}"),
        cell => format!("{} {unit}", cell.numbers().first().map_or_else(String::new, |v| number(*v))),
    };
    let rows = scores.metrics.iter().filter(|m| !m.is_per_sample());
    rows.filter_map(|m| m.cells.first().map(|cell| (group(m), text(cell, &m.unit)))).collect()
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
fn examples(subject: &Subject<'_>) -> (Vec<Example>, f64) {
    let (predictions, truths) = (&subject.assessment.predictions, &subject.assessment.truths);
    let scores: Vec<f64> = predictions.par_iter().zip(truths).map(|(p, t)| ssim::evaluation(&p.clamped(), t)).collect();
    let mut order: Vec<usize> = (0..scores.len()).collect();
    order.sort_by(|&a, &b| scores[b].total_cmp(&scores[a]).then(a.cmp(&b)));
    let Some(last) = order.len().checked_sub(1) else { return (Vec::new(), 1.0) };
    let mut chosen = vec![("Best", order[0]), ("Median", order[last / 2]), ("Worst", order[last])];
    chosen.dedup_by_key(|c| c.1);
    let errors: Vec<Image> = chosen.iter().map(|&(_, i)| difference(&predictions[i].clamped(), &truths[i])).collect();
    let largest = errors.iter().flat_map(|e| &e.pixels).fold(0.0, |m: f64, e| m.max(e.abs() as f64));
    let limit = ((largest * 10.0).ceil() / 10.0).max(0.1);
    let distances = samples::nearest_train(subject.data, subject.partition);
    let example = |(&(which, i), error): (&(&'static str, usize), &Image)| {
        let index = subject.partition.test[i];
        let sample = &subject.data.samples[index];
        let (truth, prediction) = (&truths[i], &predictions[i]);
        let marks = [Mark::Measured(truth.argmax()), Mark::Predicted(prediction.argmax())];
        let plane = &subject.model.stages.plane;
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
            peaks: peaks(subject, truth, prediction),
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
fn peaks(subject: &Subject<'_>, truth: &Image, prediction: &Image) -> String {
    let plane = &subject.model.stages.plane;
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
