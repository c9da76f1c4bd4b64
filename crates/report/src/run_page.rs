//! `report.html`: one self-contained file with tables, curves, and predictions next to measurements.

mod channels;
mod curves;
mod examples;
mod live;
mod maps;
mod powers;
mod tables;

use crate::draw::charts::Symbol;
use crate::draw::room::{Panel, RoomFigure};
use crate::draw::spectra::ColourScale;
use crate::live::PAGE_STYLE;
use crate::templates::render;
use minijinja::value::Serde;
use minijinja::{Value, context};
use pwrfgs_core::plugin::ron_line;
use pwrfgs_core::{Appearance, Dataset, Error, Result};
use pwrfgs_experiment::folder::{REPORT, START_SNAPSHOT, UNPRUNED_SNAPSHOT};
use pwrfgs_experiment::{CEILING, LoadedRun, text::grouped};
use pwrfgs_model::{Model, Snapshot};

/// Creates the page of a run; reads the snapshots in its folder.
///
/// # Errors
/// A damaged snapshot, or an observation that cannot be read.
pub fn page(run: &LoadedRun<'_>) -> Result<String> {
    let LoadedRun { record, model, data, partition } = run;
    let (scores, facts, pipeline) = (&record.scores.table, &record.facts, &record.pipeline);
    let chosen = examples::choose_examples(run)?;
    let (examples, limit) = examples::spectra_panels(run, &chosen);
    let page = context! {
        name => pipeline.name.clone(),
        title => data.title.clone(),
        simulated => data.is_simulated(),
        facts => Serde(facts),
        gaussians => model.gaussians(),
        bytes => [model.gaussian_bytes(), model.network_bytes()],
        samples => partition.sizes(),
        has_pixels => data.task().has_pixels,
        words => task_words(run),
        split => ron_line(&pipeline.split),
        bounds => scene_corners(data),
        seed => pipeline.seed,
        heading => scores.heading(),
        verdict => scores.verdict(),
        share => model.residuals().and_then(|residuals| residuals.describe_share(data.task())),
        paired => scores.paired.as_ref().map(|pairs| (pairs.lines(&scores.oracles), pairs.note(scores.task))),
        predictors => scores.predictors.clone(),
        ceiling => CEILING,
        tables => tables::score_tables(scores),
        whole => tables::whole_values(scores),
        oracles_known => scores.oracles.clone(),
        notes => scores.notes.clone(),
        figures => curves::figures(run),
        room => model.is_drawn_as(Appearance::Ellipsoids).then(|| room_panels(run)).transpose()?,
        powers => data.task().is_scalar.then(|| powers::section(run, &chosen)),
        error_maps => maps::spectrum_error_maps(run),
        receivers => tables::receiver_table(run),
        channels => data.task().is_complex.then(|| channels::section(run, &chosen)),
        examples,
        power_bar => ColourScale::Power.draw_bar().svg("bar", "colour scale of power"),
        error_bar => ColourScale::Error(limit).draw_bar().svg("bar", "colour scale of the error"),
        live => live::section(run),
        angles => model.plane().angles.is_some(),
        pipeline => pipeline_text(run)?,
        members => member_pages(run),
        confidence => curves::confidence_chart(run),
    };
    render("run.html", page)
}

/// Returns the low and high corner of the scene, metres in the world frame, rounded to one decimal.
fn scene_corners(data: &Dataset) -> [Vec<f64>; 2] {
    let rounded = |v: f64| (v * 10.0).round() / 10.0;
    [data.scene.bounds.0, data.scene.bounds.1].map(|corner| data.scene.origin.world(corner).map(rounded).into())
}

/// Creates a self-contained page with only the interactive room of a run. Also returns whether its model predicts in
/// the page.
///
/// # Errors
/// Data without transmitter positions or without a test set, which a room cannot show.
pub fn room_page(run: &LoadedRun<'_>) -> Result<(String, bool)> {
    let live = live::section(run);
    let has = |part: &str| live.get_attr(part).is_ok_and(|value| value.is_true());
    if !has("stage") {
        let problem = "no transmitter positions or no test set, which the page of a room needs";
        return Err(Error::Config(format!("{}: {problem}", run.record.folder.display())));
    }
    let predicts = has("model");
    let context = context! { name => run.record.pipeline.name.clone(), style => PAGE_STYLE, live };
    Ok((render("room.html", context)?, predicts))
}

/// Returns the words that the template uses for the parts of the model and the observations.
fn task_words(run: &LoadedRun<'_>) -> Value {
    let task = run.data.task();
    let [singular, plural] = task.counted;
    let size = task.size_text((run.data.width, run.data.height)).map(|size| size.replace(" x ", " × "));
    let (first, rest) = plural.split_at(1);
    let draws_splats = run.model.is_drawn_as(Appearance::Ellipsoids);
    let none = run.model.gaussians() == 0;
    let parts = if draws_splats || none { "Gaussians" } else { "Virtual transmitters" };
    context! { plural, singular, size, title => first.to_uppercase() + rest, parts, none }
}

/// Returns the pipeline of the run as RON. For an ensemble of separate runs, a comment says that each has its own pipeline.
fn pipeline_text(run: &LoadedRun<'_>) -> Result<String> {
    let is_joined = run.record.pipeline.members == 1 && run.model.members().len() > 1;
    let note = "// pipeline that scores the ensemble; each member has its own pipeline:\n";
    Ok(if is_joined { note } else { "" }.to_owned() + &run.record.pipeline.to_ron()?)
}

/// Returns the name, folder and number of Gaussians of each member of an ensemble; if members are runs of a sweep, also the path
/// of their page. None for a single model.
fn member_pages(run: &LoadedRun<'_>) -> Vec<Value> {
    let models = run.model.names().iter().zip(run.model.members());
    let member = |(folder, (name, model)): (&String, (&String, &Model))| {
        let page = (run.record.pipeline.members == 1).then(|| format!("../{folder}/{REPORT}"));
        context! { name, page, folder, gaussians => model.cloud.len() }
    };
    run.record.facts.members.iter().zip(models).map(member).collect()
}

/// Text height on the axes.
const TEXT: f64 = 10.5;

/// Draws the room with the Gaussians at the start, before pruning and at the end, with legend and note; only the last panel
/// if no snapshots of the training exist.
fn room_panels(run: &LoadedRun<'_>) -> Result<Value> {
    let last = Snapshot::of_ensemble(run.record.facts.steps, run.model);
    let read = |name: &str| Snapshot::read(&run.record.folder.join(name));
    let step = |s: &Snapshot| grouped(s.step as i64);
    let mut snapshots: Vec<(String, Snapshot)> = Vec::new();
    snapshots.extend(read(START_SNAPSHOT)?.map(|s| ("At the start".into(), s)));
    snapshots.extend(read(UNPRUNED_SNAPSHOT)?.map(|s| (format!("Before pruning, step {}", step(&s)), s)));
    snapshots.push((if snapshots.is_empty() { "Gaussians".into() } else { "Final".into() }, last));
    let clouds: Vec<&Snapshot> = snapshots.iter().map(|(_, snapshot)| snapshot).collect();
    let room = RoomFigure::new(run.data, run.partition, &clouds, TEXT);
    let panel = |(title, snapshot): &(String, Snapshot)| {
        let Panel { title, numbers, drawing, caption } = room.draw_panel(title, snapshot, run.data);
        let svg = drawing.svg("room", &title);
        context! { title, numbers, svg, caption }
    };
    let panels: Vec<Value> = snapshots.iter().map(panel).collect();
    let symbol = |s: Symbol| (s.drawing.svg("symbol", &s.meaning), s.meaning);
    let legend: Vec<(String, String)> = room.legend().into_iter().map(symbol).collect();
    Ok(context! { panels, legend, note => room.note(run.data) })
}
