//! The look at the validation set while training.

use crate::bench::Bench;
use crate::observer::{Silent, Validation};
use crate::scores::Summary;
use crate::session::Session;
use pwrfgs_core::{Dataset, Result, Values};
use pwrfgs_model::Model;
use pwrfgs_pipeline::defaults;

/// Scores the samples `part`: mean and median of the first metric, then the mean of the second, or the bad tail of the first if
/// there is no second.
pub(crate) fn validate(step: u64, model: &Model, data: &Dataset, part: &[usize]) -> Result<Validation> {
    let bench = Bench::new(data, part, &model.stages.plane);
    let (task, model, metrics) = (data.task(), &model.prepare(), defaults::validation(data.task()));
    let measured = bench.model("the model", model, None, &metrics, &mut Session::new(&mut Silent))?;
    let Summary { mean, median, p10 } = match measured.first().map(|m| &m.values) {
        Some(Values::PerSample(values)) => Summary::of(values, task.headline.higher),
        other => {
            let mean = other.map_or(f64::NAN, Values::mean);
            Summary { mean, median: mean, p10: mean }
        }
    };
    let third = measured.get(1).map_or(p10, |m| m.values.mean());
    Ok(Validation { step, task, values: [mean, median, third] })
}
