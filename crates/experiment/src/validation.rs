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
    let of = |k: usize| match measured.get(k).map(|m| &m.values) {
        Some(Values::PerSample(values)) => Summary::of(values, task.headline.higher),
        Some(Values::Whole(value)) => Summary { mean: *value, median: *value, p10: *value },
        _ => Summary { mean: f64::NAN, median: f64::NAN, p10: f64::NAN },
    };
    let first = of(0);
    let third = if measured.len() > 1 { of(1).mean } else { first.p10 };
    Ok(Validation { step, task, values: [first.mean, first.median, third] })
}
