//! Whether the parts of a pipeline go together: data, method and metrics of one kind of observation, and pruners.

use crate::Pipeline;
use crate::ron_tree::Tree;
use pwrfgs_core::plugin::name_of;
use pwrfgs_core::{Error, Task};
use pwrfgs_train::Rays;
use std::path::Path;

/// The first field that is of another kind than the data, and what to do about it; nothing where the source does not know
/// before it loads.
pub(crate) fn mixed(pipeline: &Pipeline) -> Option<(&'static str, String)> {
    let pruners = || pipeline.as_plan().check().err().map(|what| ("pruners", what));
    other_kinds(pipeline).or_else(pruners).or_else(|| unable(pipeline))
}

/// What the method cannot do that the pipeline wants of it.
fn unable(pipeline: &Pipeline) -> Option<(&'static str, String)> {
    let method = pipeline.method();
    let chooses = method.chooses_pixels() && pipeline.data.task().is_none_or(|kind| kind == Task::Spectrum);
    if pipeline.training.rays != Rays::All && !chooses {
        let what = "`rays` wants single pixels of spectra, which Nerf2 draws; leave it out".to_owned();
        return Some(("training", what));
    }
    let nobody_prunes = pipeline.pruners.is_empty() && pipeline.training.target == 0;
    if !method.has_gaussians() && !nobody_prunes {
        let what = format!("{} has no Gaussians, so there is nothing to prune; leave them out", name_of(&method));
        return Some(("pruners", what));
    }
    None
}

fn other_kinds(pipeline: &Pipeline) -> Option<(&'static str, String)> {
    let kind = pipeline.data.task()?;
    let (method, field) = match &pipeline.method {
        Some(method) => (method.task(), "method"),
        None => (Some(pipeline.readout.task()), "readout"),
    };
    if let Some(own) = method.filter(|own| *own != kind) {
        let advice = match kind {
            Task::Spectrum => "readout: Magnitude",
            Task::Power => "readout: Received(sky_deg: 10)",
            Task::Channel => "method: VirtualTransmitters(), or readout: Channel",
        };
        let what = format!("it gives {}, and the data are {}; use {advice}", own.plural, kind.plural);
        return Some((field, what));
    }
    let other = |own: Option<Task>| own.filter(|own| *own != kind);
    let what = |name: String, role: &str, own: Task, advice: &str| {
        format!("`{name}` {role} {}, and the data are {}; {advice}", own.plural, kind.plural)
    };
    if let Some(own) = other(pipeline.initializer.task()) {
        let name = name_of(&pipeline.initializer);
        return Some(("initializer", what(name, "searches", own, "use another, such as Random()")));
    }
    if let Some((baseline, own)) = pipeline.baselines.iter().find_map(|b| Some((b, other(b.task())?))) {
        return Some(("baselines", what(name_of(baseline), "is a floor of", own, "leave it out")));
    }
    let metric = pipeline.metrics.iter().find_map(|metric| Some((metric, other(metric.task())?)));
    metric.map(|(metric, own)| ("metrics", what(name_of(metric), "is a metric of", own, "leave it out")))
}

/// The same as an error at the field's place in `text`, or at that of the data where the field was left out.
pub(crate) fn refuse_mixed(pipeline: &Pipeline, text: &str, path: &Path) -> Result<(), Error> {
    let Some((field, what)) = mixed(pipeline) else { return Ok(()) };
    let tree = Tree::parse(text).ok();
    let place = tree.as_ref().and_then(|tree| tree.field(field).or_else(|| tree.field("data")));
    let Some(place) = place else { return Err(Error::input(path, format!("{field}: {what}"))) };
    let before = &text[..place.span.start];
    let line = before.matches('\n').count() + 1;
    let column = before.chars().rev().take_while(|c| *c != '\n').count() + 1;
    Err(Error::at(path, line, column, format!("{field}: {what}")))
}
