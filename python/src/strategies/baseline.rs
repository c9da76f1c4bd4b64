//! A class of Python's as a baseline.

use super::Strategy;
use super::objects::links_object;
use crate::arrays::{Gain, array, numbers};
use crate::border::throw;
use pwrfgs_core::{Baseline, Dataset, Image, Known, Predict, Query, Real, Result, Task, rows_of};
use pyo3::prelude::*;

impl Baseline for Strategy {
    fn typetag_name(&self) -> &'static str {
        "Python"
    }

    fn typetag_deserialize(&self) {}

    fn name(&self) -> String {
        self.with(|_, own| match own.getattr("name") {
            Ok(name) => name.extract(),
            Err(_) => Ok(self.named.class.clone()),
        })
    }

    fn fit<'a>(&self, data: &'a Dataset, known: Known<'_>) -> Result<Box<dyn Predict + 'a>> {
        let own = self.try_with(|py, own| {
            let links = known.all();
            let seen = crate::data::observed(py, data, &links)?;
            let predictor = own.call_method1("fit", (links_object(py, data, &links)?, seen))?;
            Ok(if predictor.is_none() { own.clone().unbind() } else { predictor.unbind() })
        })?;
        Ok(Box::new(Predictor { own, task: data.task(), size: (data.width, data.height) }))
    }
}

/// What a baseline of Python's predicts with.
struct Predictor {
    own: Py<PyAny>,
    task: Task,
    size: (usize, usize),
}

impl Predict for Predictor {
    fn predict(&self, query: Query<'_>) -> Image {
        let (width, height) = self.size;
        let asked = |py: Python<'_>| {
            let tx = array(py, query.tx.to_vec(), &[3])?;
            let found = self.own.bind(py).call_method1("predict", (tx, query.receiver))?;
            let what = "what predict gave";
            let shape: Vec<Option<usize>> = self.task.shape(self.size).into_iter().map(Some).collect();
            let pixels = if self.task.is_complex {
                let gains = numbers::<Gain>(what, &found, &shape)?;
                rows_of(&gains.iter().map(|gain| [gain.re, gain.im]).collect::<Vec<_>>(), width)
            } else if shape.is_empty() {
                vec![found.extract::<Real>()?]
            } else {
                numbers::<Real>(what, &found, &shape)?
            };
            Ok(Image { width, height, pixels })
        };
        Python::attach(asked).unwrap_or_else(|error: PyErr| throw(error))
    }
}
