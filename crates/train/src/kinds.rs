//! Whether the parts of a pipeline go together: data, method and metrics of one kind of observation.

use crate::Pipeline;
use pwrfgs_core::ron_tree::Tree;
use pwrfgs_core::{Error, Kind, Plugin};
use std::path::Path;

/// The field default that fills in `field` for observations of a kind.
pub(crate) fn default_field(field: &str, kind: Option<Kind>) -> String {
    match kind {
        Some(Kind::Power) => format!("{field} of powers"),
        Some(Kind::Channel) => format!("{field} of channels"),
        Some(Kind::Spectrum) | None => field.to_owned(),
    }
}

/// The first field that is of another kind than the data, and what to do about it; nothing where the source does not know
/// before it loads.
pub(crate) fn mixed(pipeline: &Pipeline) -> Option<(&'static str, String)> {
    let kind = pipeline.data.kind()?;
    let (method, field) = match &pipeline.method {
        Some(method) => (method.kind(), "method"),
        None => (Some(pipeline.readout.kind()), "readout"),
    };
    if let Some(own) = method.filter(|own| *own != kind) {
        let advice = match kind {
            Kind::Spectrum => "readout: Magnitude",
            Kind::Power => "readout: Received(sky_deg: 10)",
            Kind::Channel => "method: VirtualTransmitters()",
        };
        let what = format!("it gives {}, and the data are {}; use {advice}", own.plural(), kind.plural());
        return Some((field, what));
    }
    let other = |metric: &&Plugin<dyn pwrfgs_core::Metric>| metric.kind().is_some_and(|own| own != kind);
    let metric = pipeline.metrics.iter().find(other)?;
    let own = metric.kind().map_or("", Kind::plural);
    Some((
        "metrics",
        format!("`{}` is a metric of {own}, and the data are {}; leave it out", name(metric), kind.plural()),
    ))
}

fn name(plugin: &Plugin<dyn pwrfgs_core::Metric>) -> String {
    let text = pwrfgs_core::plugin::to_ron(plugin);
    text.split(['(', '{']).next().unwrap_or_default().trim().to_owned()
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
