//! Python classes as splits, baselines and metrics.

use super::Strategy;
use super::objects::{links_object, numpy_generator};
use crate::arrays::{ObservationShape, array, axis_count, link_indices, numbers, observation_array};
use crate::border::{reject, throw};
use pwrfgs_core::{
    Baseline, Dataset, Error, Evaluation, FittingSet, Goal, Image, Measurement, Metric, Partition, Predict, Query,
    Result, Split, Task, Values, rng,
};
use pyo3::prelude::*;

impl Split for Strategy {
    named_python!();

    fn split(&self, data: &Dataset, random: &mut rng::Rng) -> Result<Partition> {
        let count = data.len();
        let lists = self.try_with(|py, instance| {
            let links = links_object(py, data, &(0..count).collect::<Vec<_>>())?;
            let parts = instance.call_method1("split", (links, numpy_generator(py, random)?))?;
            let lists = parts.try_iter()?.map(|part| read_part(&part?, count)).collect::<PyResult<Vec<_>>>()?;
            match lists.len() {
                2 | 3 => Ok(lists),
                n => {
                    let form = "(train, test) or (train, validation, test)";
                    reject(py, &format!("split returned {n} parts, expected {form}"))
                }
            }
        })?;
        let mut lists = lists.into_iter();
        let train = lists.next().unwrap_or_default();
        let (validation, test) = match (lists.next(), lists.next()) {
            (Some(validation), Some(test)) => (validation, test),
            (Some(test), None) => (Vec::new(), test),
            _ => Default::default(),
        };
        let mut links: Vec<usize> = [&train, &validation, &test].into_iter().flatten().copied().collect();
        links.sort_unstable();
        if let Some([twice, _]) = links.array_windows().find(|[a, b]| a == b) {
            return Err(Error::Config(format!("split: link {twice} is in two sets")));
        }
        Ok(Partition { train, validation, test })
    }
}

/// Reads a set of a split, link indices or a mask, as sorted indices below `count`.
fn read_part(part: &Bound<'_, PyAny>, count: usize) -> PyResult<Vec<usize>> {
    let mut links = link_indices("a set of a split (link indices or a mask)", part, count)?;
    links.sort_unstable();
    Ok(links)
}

impl Baseline for Strategy {
    named_python!();

    fn name(&self) -> String {
        self.with(|_, instance| match instance.getattr("name") {
            Ok(name) => name.extract(),
            Err(_) => Ok(self.named.class.clone()),
        })
    }

    fn fit<'a>(&self, data: &'a Dataset, fitting: FittingSet<'_>) -> Result<Box<dyn Predict + 'a>> {
        let instance = self.try_with(|py, instance| {
            let links = fitting.all();
            let observations = observation_array(py, data, &links)?;
            let predictor = instance.call_method1("fit", (links_object(py, data, &links)?, observations))?;
            Ok(if predictor.is_none() { instance.clone().unbind() } else { predictor.unbind() })
        })?;
        Ok(Box::new(Predictor { instance, task: data.task(), size: (data.width, data.height) }))
    }
}

/// Object that predicts for a Python baseline.
struct Predictor {
    instance: Py<PyAny>,
    task: Task,
    /// Columns and rows of an observation.
    size: (usize, usize),
}

impl Predict for Predictor {
    fn predict(&self, query: Query<'_>) -> Image {
        let (width, height) = self.size;
        let call = |py: Python<'_>| {
            let tx = array(py, query.position().to_vec(), &[3])?;
            let observation = self.instance.bind(py).call_method1("predict", (tx, query.receiver))?;
            let pixels = ObservationShape { task: self.task, size: self.size, lead: &[] }
                .read("the result of predict", &observation)?;
            Ok(Image { width, height, pixels })
        };
        Python::attach(call).unwrap_or_else(|error: PyErr| throw(error))
    }
}

impl Metric for Strategy {
    named_python!();

    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        self.try_with(|py, instance| {
            let stack = |images: &[Image]| stack_images(py, images, evaluation.task);
            let score =
                instance.call_method1("evaluate", (stack(evaluation.predictions)?, stack(evaluation.truths)?))?;
            let text = |name: &str, default: &str| match instance.getattr(name) {
                Ok(value) => value.extract::<String>(),
                Err(_) => Ok(default.to_owned()),
            };
            let is_higher_better =
                instance.getattr("higher_is_better").map_or(Ok(true), |value| value.extract::<bool>())?;
            let values = if axis_count(&score)? == 0 {
                Values::Whole(score.extract()?)
            } else {
                Values::PerSample(numbers::<f64>("the result of evaluate", &score, &[Some(evaluation.truths.len())])?)
            };
            Ok(vec![Measurement {
                key: text("name", &self.named.class)?,
                unit: text("unit", "")?,
                goal: if is_higher_better { Goal::Higher } else { Goal::Lower },
                values,
                note: None,
            }])
        })
    }
}

/// Converts observations of one size to an array `[images, axes of one]`.
fn stack_images<'py>(py: Python<'py>, images: &[Image], task: Task) -> PyResult<Bound<'py, PyAny>> {
    let rows = images.iter().flat_map(|image| image.pixels.iter().copied()).collect();
    let size = images.first().map_or((0, 0), |image| (image.width, image.height));
    ObservationShape { task, size, lead: &[images.len()] }.array(py, rows)
}
