//! Whether the parts of a pipeline go together: data, method and metrics of one task, and pruners.

use crate::{Pipeline, defaults};
use pwrfgs_core::plugin::{name_of, to_ron};
use pwrfgs_core::{Dataset, Error, Task};
use pwrfgs_methods::Calibration;
use pwrfgs_train::Rays;

/// The first field that does not support the data, and what to do about it; nothing where the source does not know
/// before it loads.
pub(crate) fn mixed(pipeline: &Pipeline) -> Option<(&'static str, String)> {
    let pruners = || pipeline.as_plan().check().err().map(|what| ("pruners", what));
    other_kinds(pipeline).or_else(pruners).or_else(|| unable(pipeline))
}

/// What the method cannot do that the pipeline wants of it.
fn unable(pipeline: &Pipeline) -> Option<(&'static str, String)> {
    let method = pipeline.method();
    let traits = method.traits();
    let chooses = traits.chooses_pixels && pipeline.data.task().is_none_or(|task| task.has_pixels);
    if pipeline.training.rays != Rays::All && !chooses {
        let what = "`rays` wants single pixels of spectra, which Nerf2 draws; leave it out".to_owned();
        return Some(("training", what));
    }
    let nobody_prunes = pipeline.pruners.is_empty() && pipeline.training.target == 0;
    if !traits.has_gaussians() && !nobody_prunes {
        let what = format!("{} has no Gaussians, so there is nothing to prune; leave them out", name_of(&method));
        return Some(("pruners", what));
    }
    None
}

fn other_kinds(pipeline: &Pipeline) -> Option<(&'static str, String)> {
    let task = pipeline.data.task()?;
    let field = if pipeline.method.is_some() { "method" } else { "readout" };
    if let Some(own) = pipeline.method().traits().task.filter(|own| *own != task) {
        let what = format!("it gives {}, and the data are {}; use {}", own.plural, task.plural, task.method);
        return Some((field, what));
    }
    if let Some(field) = unused(pipeline, task) {
        let what = format!("the method of {} has none; leave it out, or at its default", task.plural);
        return Some((field, what));
    }
    if !pipeline.initializer.supports(task) {
        let name = name_of(&pipeline.initializer);
        let what = format!("`{name}` does not search {}; use another, such as Random()", task.plural);
        return Some(("initializer", what));
    }
    pipeline.unsupported(task)
}

/// The first field of splats that is not at its default, although [`Pipeline::method`] takes a method without it.
fn unused(pipeline: &Pipeline, task: Task) -> Option<&'static str> {
    if pipeline.method.is_some() || !task.is_complex {
        return None;
    }
    let Pipeline { projector, rasterizer, calibration, readout, .. } = pipeline;
    let is_default = [
        ("projector", to_ron(projector) == to_ron(&defaults::projector())),
        ("rasterizer", to_ron(rasterizer) == to_ron(&defaults::rasterizer())),
        ("calibration", *calibration == Calibration::default()),
        ("readout", *readout == defaults::readout(task)),
    ];
    is_default.into_iter().find(|(_, is_default)| !is_default).map(|(field, _)| field)
}

impl Pipeline {
    /// The first baseline or metric that does not support observations of `task`: its field, and what to do.
    pub fn unsupported(&self, task: Task) -> Option<(&'static str, String)> {
        let what = |name: String, role: &str| format!("`{name}` is no {role} of {}; leave it out", task.plural);
        let baseline = self.baselines.iter().find(|baseline| !baseline.supports(task));
        let metric = || self.metrics.iter().find(|metric| !metric.supports(task));
        let of_baseline = baseline.map(|baseline| ("baselines", what(name_of(baseline), "baseline")));
        of_baseline.or_else(|| Some(("metrics", what(name_of(metric()?), "metric"))))
    }

    /// Refuses baselines and metrics that cannot work on `data`, before a model is trained for their table.
    ///
    /// # Errors
    /// The first that refuses, by the name of its field.
    pub fn check_data(&self, data: &Dataset) -> Result<(), Error> {
        let named = |field: &str, error: Error| match error {
            Error::Config(_) | Error::Input { .. } | Error::Read { .. } => Error::Config(format!("{field}: {error}")),
            other => other, // an exception of Python's stays one
        };
        for baseline in &self.baselines {
            baseline.check_data(data).map_err(|error| named("baselines", error))?;
        }
        for metric in &self.metrics {
            metric.check_data(data).map_err(|error| named("metrics", error))?;
        }
        match self.unsupported(data.task()) {
            Some((field, what)) => Err(Error::Config(format!("{field}: {what}"))),
            None => Ok(()),
        }
    }
}
