//! A class of Python's as a metric.

use super::Strategy;
use crate::arrays::{axes, numbers, observations};
use pwrfgs_core::{Evaluation, Goal, Image, Measurement, Metric, Result, Task, Values};
use pyo3::prelude::*;

impl Metric for Strategy {
    fn typetag_name(&self) -> &'static str {
        "Python"
    }

    fn typetag_deserialize(&self) {}

    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        self.try_with(|py, own| {
            let stack = |images: &[Image]| stacked(py, images, evaluation.task);
            let found = own.call_method1("evaluate", (stack(evaluation.predictions)?, stack(evaluation.truths)?))?;
            let text = |name: &str, none: &str| match own.getattr(name) {
                Ok(own) => own.extract::<String>(),
                Err(_) => Ok(none.to_owned()),
            };
            let higher = own.getattr("higher_is_better").map_or(Ok(true), |own| own.extract::<bool>())?;
            let values = if axes(&found)? == 0 {
                Values::Whole(found.extract()?)
            } else {
                Values::PerSample(numbers::<f64>("what evaluate gave", &found, &[Some(evaluation.truths.len())])?)
            };
            Ok(vec![Measurement {
                key: text("name", &self.named.class)?,
                unit: text("unit", "")?,
                goal: if higher { Goal::Higher } else { Goal::Lower },
                values,
            }])
        })
    }
}

/// Observations as one array.
fn stacked<'py>(py: Python<'py>, images: &[Image], task: Task) -> PyResult<Bound<'py, PyAny>> {
    let rows = images.iter().flat_map(|image| image.pixels.iter().copied()).collect();
    let size = images.first().map_or((0, 0), |image| (image.width, image.height));
    observations(py, task, size, &[images.len()], rows)
}
