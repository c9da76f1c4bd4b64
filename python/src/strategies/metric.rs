//! A class of Python's as a metric.

use super::Strategy;
use crate::arrays::{Gain, array, axes, complex, numbers};
use pwrfgs_core::{Evaluation, Goal, Image, Measurement, Metric, Real, Result, Task, Values, gains_of};
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
fn stacked<'py>(py: Python<'py>, images: &[Image], kind: Task) -> PyResult<Bound<'py, PyAny>> {
    let (count, all) = (images.len(), images.iter().flat_map(|image| image.pixels.iter().copied()));
    let (height, width) = images.first().map_or((0, 0), |image| (image.height, image.width));
    match kind {
        Task::Spectrum => array(py, all.collect::<Vec<Real>>(), &[count, height, width]).map(Bound::into_any),
        Task::Power => array(py, all.collect::<Vec<Real>>(), &[count]).map(Bound::into_any),
        Task::Channel => {
            let gains: Vec<Gain> = images.iter().flat_map(|image| complex(&gains_of(&image.pixels, width))).collect();
            array(py, gains, &[count, height / 2, width]).map(Bound::into_any)
        }
    }
}
