//! The look at the validation part while training, and the floors on the very same samples.

use crate::bench::Bench;
use crate::headline::headline;
use crate::observer::{Silent, Validation};
use crate::scores::Summary;
use crate::session::Session;
use pwrfgs_core::{Dataset, ImagePlane, Known, Measurement, Partition, Plugin, Result, Task, Values, evenly};
use pwrfgs_model::Model;
use pwrfgs_pipeline::{Pipeline, defaults};

/// Header of `validation.csv`.
pub(crate) fn header(kind: Task) -> String {
    format!("step,{}", headline(kind).columns.join(","))
}

impl Validation {
    /// A row of `validation.csv`.
    pub(crate) fn row(&self) -> String {
        let [mean, median, third] = self.values;
        format!("{},{mean},{median},{third}", self.step)
    }
}

/// One row of `validation.csv` from the measurements: mean and median of the first; of spectra the mean of the second, of
/// powers the bad tail of the first, of channels the ratio over all.
fn row(step: u64, kind: Task, measured: &[Measurement]) -> Validation {
    let of = |k: usize| match measured.get(k).map(|m| &m.values) {
        Some(Values::PerSample(values)) => Summary::of(values, headline(kind).higher),
        Some(Values::Whole(value)) => Summary { mean: *value, median: *value, p10: *value },
        _ => Summary { mean: f64::NAN, median: f64::NAN, p10: f64::NAN },
    };
    let third = if kind == Task::Power { of(0).p10 } else { of(1).mean };
    Validation { step, kind, values: [of(0).mean, of(0).median, third] }
}

/// Looks at the samples `part`.
pub(crate) fn validate(step: u64, model: &Model, data: &Dataset, part: &[usize]) -> Result<Validation> {
    let bench = Bench::new(data, part, &model.stages.plane);
    let (kind, model) = (data.task(), &model.prepare());
    Ok(row(
        step,
        kind,
        &bench.model("the model", model, None, &defaults::validation(kind), &mut Session::new(&mut Silent))?,
    ))
}

/// Mean of the first metric that each baseline, fitted on the training set alone, reaches on the samples that validation
/// looks at.
///
/// # Errors
/// Where a baseline or a metric refuses; [`pwrfgs_core::Error::Stopped`] once the session is.
pub(crate) fn floors(
    pipeline: &Pipeline,
    plane: &ImagePlane,
    data: &Dataset,
    partition: &Partition,
    session: &mut Session<'_>,
) -> Result<Vec<(String, f64)>> {
    let part = evenly(&partition.validation, pipeline.training.validation_samples);
    if part.is_empty() || pipeline.training.validate_every == 0 {
        return Ok(Vec::new());
    }
    let bench = Bench::new(data, &part, plane);
    let metrics = defaults::validation(data.task());
    let floor = |b: &Plugin<dyn pwrfgs_core::Baseline>| {
        session.check_stopped()?;
        let fitted = b.fit(data, Known::train(&partition.train))?;
        let name = b.name_for(data.task());
        let measured = bench.baseline(&name, &*fitted, &metrics, session)?;
        Ok((name, row(0, data.task(), &measured).values[0]))
    };
    let all = pipeline.baselines.iter().map(floor).collect::<Result<Vec<_>>>()?;
    Ok(all.into_iter().filter(|(_, mean)| mean.is_finite()).collect())
}
