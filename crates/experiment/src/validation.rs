//! The look at the validation set while training.

use crate::bench::Bench;
use crate::observer::{Silent, Validation};
use crate::scores::Summary;
use crate::session::Session;
use pwrfgs_core::{Dataset, Result, Task, Values};
use pwrfgs_model::Model;
use pwrfgs_pipeline::defaults;

/// Scores the samples `part`: mean and median of the first metric; of spectra the mean of the second, of powers the bad tail
/// of the first, of channels the ratio over all.
pub(crate) fn validate(step: u64, model: &Model, data: &Dataset, part: &[usize]) -> Result<Validation> {
    let bench = Bench::new(data, part, &model.stages.plane);
    let (kind, model, metrics) = (data.task(), &model.prepare(), defaults::validation(data.task()));
    let measured = bench.model("the model", model, None, &metrics, &mut Session::new(&mut Silent))?;
    let of = |k: usize| match measured.get(k).map(|m| &m.values) {
        Some(Values::PerSample(values)) => Summary::of(values, kind.headline.higher),
        Some(Values::Whole(value)) => Summary { mean: *value, median: *value, p10: *value },
        _ => Summary { mean: f64::NAN, median: f64::NAN, p10: f64::NAN },
    };
    let first = of(0);
    let third = if kind == Task::Power { first.p10 } else { of(1).mean };
    Ok(Validation { step, kind, values: [first.mean, first.median, third] })
}
