//! The look at the validation part while training, and the floors on the very same samples.

use crate::bench::Bench;
use crate::evaluate::go_on;
use crate::observer::{Observer, Silent, Validation};
use crate::scores::Summary;
use pwrfgs_core::plugin::default_of;
use pwrfgs_core::{Dataset, Error, ImagePlane, Known, Measurement, Metric, Partition, Plugin, Result, Values, evenly};
use pwrfgs_model::Model;
use pwrfgs_train::Pipeline;
use std::sync::atomic::AtomicBool;

/// Header of `validation.csv`.
pub(crate) const HEADER: &str = "step,ssim_mean,ssim_median,eta_0db";

impl Validation {
    /// A row of `validation.csv`.
    pub(crate) fn row(&self) -> String {
        format!("{},{},{},{}", self.step, self.ssim_mean, self.ssim_median, self.eta_0db)
    }
}

/// SSIM and η(0 dB), as the program that links the metrics defines them.
pub(crate) fn metrics() -> Result<Vec<Plugin<dyn Metric>>> {
    default_of("validation").map_err(Error::Config)
}

/// One row of `validation.csv` from the two measurements.
fn row(step: u64, measured: &[Measurement]) -> Validation {
    let of = |k: usize| match measured.get(k).map(|m| &m.values) {
        Some(Values::PerSample(values)) => Summary::of(values, true),
        _ => Summary { mean: f64::NAN, median: f64::NAN, p10: f64::NAN },
    };
    Validation { step, ssim_mean: of(0).mean, ssim_median: of(0).median, eta_0db: of(1).mean }
}

/// Looks at the samples `part`.
pub(crate) fn validate(step: u64, model: &Model, data: &Dataset, part: &[usize]) -> Result<Validation> {
    let bench = Bench::new(data, part, &model.stages.plane);
    let never = AtomicBool::new(false);
    Ok(row(step, &bench.model("the model", &model.prepare(), None, &metrics()?, &mut Silent, &never)?))
}

/// What each baseline, having seen the training part alone, reaches on the samples that validation looks at.
///
/// # Errors
/// Where a baseline or a metric refuses; [`pwrfgs_core::Error::Stopped`] once `stop` is set.
pub(crate) fn floors(
    pipeline: &Pipeline,
    plane: &ImagePlane,
    data: &Dataset,
    partition: &Partition,
    observer: &mut dyn Observer,
    stop: &AtomicBool,
) -> Result<Vec<(String, Validation)>> {
    let part = evenly(&partition.validation, pipeline.training.validation_samples);
    if part.is_empty() || pipeline.training.validate_every == 0 {
        return Ok(Vec::new());
    }
    let bench = Bench::new(data, &part, plane);
    let metrics = metrics()?;
    let floor = |b: &Plugin<dyn pwrfgs_core::Baseline>| {
        go_on(stop)?;
        let fitted = b.fit(data, Known::train(&partition.train))?;
        let name = b.name();
        let measured = bench.baseline(&name, &*fitted, &metrics, observer, stop)?;
        Ok((name, row(0, &measured)))
    };
    pipeline.baselines.iter().map(floor).collect()
}
