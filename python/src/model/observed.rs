//! Predicted observations as arrays, in batches, and with their derivative by the moving end.

use super::Model;
use super::links::Links;
use crate::arrays::{ObservationShape, array, check_memory};
use crate::border::{CHECK_INTERVAL, log_message, reject, to_exception, to_plugin_error, without_gil};
use pwrfgs::tasks::predict::{extrapolation_warning, interval_factors};
use pwrfgs_core::{Error, MeasurementSetup, Predict as _, Query, Real, Result};
use pyo3::prelude::*;
use rayon::prelude::*;
use std::time::Instant;

/// Number of links per library call: one group of `Prepared`, so that results stay in cache.
const CHUNK: usize = 16;

impl Model {
    /// Warns of positions that are far from all training positions, if these are known. Raises an exception in a forked
    /// process.
    pub(super) fn warn_of_extrapolations(&self, py: Python<'_>, links: &Links) -> PyResult<()> {
        if !links.features.is_empty() {
            return Ok(());
        }
        let positions: Vec<[f64; 3]> = links.poses.iter().map(|pose| pose.position).collect();
        let distances = without_gil(py, || Ok(self.ensemble.training_distances(&positions)))?;
        if let Some(warning) = distances.as_ref().and_then(extrapolation_warning) {
            log_message("warning", &warning);
        }
        Ok(())
    }

    /// Returns the predictions of `links` as an array, or with intervals of the level `interval`.
    pub(super) fn predict_links<'py>(
        &self,
        py: Python<'py>,
        links: &Links,
        interval: Option<f64>,
    ) -> PyResult<Bound<'py, PyAny>> {
        if let Some(level) = interval {
            return self.predict_interval(py, links, level);
        }
        // One link is predicted as on the command line, several in groups that share work. The results are
        // bit-identical.
        self.predicted_array(py, links, |queries, numbers| match queries {
            [query] => {
                let (image, _) = self.prepared().predict_timed(*query);
                numbers.copy_from_slice(&image.pixels);
            }
            queries => self.prepared().predict_into(queries, numbers),
        })
    }

    /// Returns an array of predicted observations of `links`; `work` fills the numbers of the queries of a chunk, chunk by
    /// chunk in order.
    pub(super) fn predicted_array<'py>(
        &self,
        py: Python<'py>,
        links: &Links,
        work: impl FnMut(&[Query<'_>], &mut [Real]) + Send,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (lead, count) = (&links.lead, self.stages().setup.value_count());
        check_memory::<Real>(&[&lead[..], &[count]].concat())?;
        let numbers = without_gil(py, || {
            let mut numbers = vec![0.0; lead.iter().product::<usize>() * count];
            self.fill(links, &mut numbers, work).map(|()| numbers)
        })?;
        self.shape(links).array(py, numbers)
    }

    /// Returns the shape of the observations of `links`.
    fn shape<'l>(&self, links: &'l Links) -> ObservationShape<'l> {
        let MeasurementSetup { plane, task, .. } = &self.stages().setup;
        ObservationShape { task: *task, size: (plane.width, plane.height), lead: &links.lead }
    }

    /// Returns the named tuple (prediction, lower, upper) of these links, with intervals of this level.
    fn predict_interval<'py>(&self, py: Python<'py>, links: &Links, level: f64) -> PyResult<Bound<'py, PyAny>> {
        let factors = interval_factors(&self.ensemble, level).map_err(|error| to_exception(py, error))?;
        let (ready, setup) = (self.prepared(), &self.stages().setup);
        let count = setup.value_count();
        let mut ends = [Vec::new(), Vec::new()];
        let work = |queries: &[Query<'_>], numbers: &mut [Real]| {
            let images = ready.predict_many(queries);
            for ((query, image), numbers) in queries.iter().zip(images).zip(numbers.chunks_exact_mut(count)) {
                numbers.copy_from_slice(&image.pixels);
                let deviation = ready.deviation(*query).unwrap_or(1.0); // equal for all, as in the calibration
                let interval = factors.interval(setup.task, &setup.task.shown(image), deviation);
                ends[0].extend(interval.lower.pixels);
                ends[1].extend(interval.upper.pixels);
            }
        };
        let prediction = self.predicted_array(py, links, work)?;
        let [lower, upper] = ends;
        let end = |numbers| self.shape(links).array(py, numbers);
        let fields = (prediction, end(lower)?, end(upper)?);
        py.import("pwrfgs._results")?.getattr("Interval")?.call1(fields)
    }

    /// Fills `all` in chunks by `work`; returns an error for values that are not finite, or after Ctrl-C.
    fn fill(&self, links: &Links, all: &mut [Real], mut work: impl FnMut(&[Query<'_>], &mut [Real])) -> Result<()> {
        let count = self.stages().setup.value_count();
        let mut last_check = Instant::now();
        for (chunk, numbers) in all.chunks_mut(CHUNK * count).enumerate() {
            let queries: Vec<Query<'_>> = (0..numbers.len() / count).map(|k| links.query(chunk * CHUNK + k)).collect();
            work(&queries, numbers);
            if last_check.elapsed() > CHECK_INTERVAL {
                #[allow(clippy::redundant_closure_for_method_calls)] // the method itself is of one lifetime
                Python::attach(|py| py.check_signals()).map_err(to_plugin_error)?;
                last_check = Instant::now();
            }
            // Without an early exit the loop is vectorised.
            let is_finite = |numbers: &[Real]| numbers.iter().fold(true, |all, v| all & v.is_finite());
            if let Some(k) = numbers.par_chunks_exact(count).position_first(|link| !is_finite(link)) {
                return Err(Error::Config(format!(
                    "the prediction at {:?} is not finite: the model overflows there; \
                     leave the position out if it is far from the training positions",
                    queries[k].position()
                )));
            }
        }
        Ok(())
    }

    /// Returns (observations, derivative by positions `[3]` or `[B, 3]` or by poses `[7]` or `[B, 7]`), given the cotangents of
    /// the observations. Raises an exception for a model without derivative.
    pub(super) fn predict_vjp<'py>(
        &self,
        links: &Links,
        cotangents: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (py, ready) = (cotangents.py(), self.prepared());
        if !ready.has_derivative() || !links.features.is_empty() {
            let why = "its network reads link features or is a Python class";
            return reject(py, &format!("vjp: this model has no derivative by the position, since {why}"));
        }
        let is_pose = self.stages().setup.moving.is_receiver();
        if is_pose && !ready.has_orientation_derivative() {
            let problem =
                "vjp: this model has no derivative by the orientation of its receiver; use calibration Physical";
            return reject(py, problem);
        }
        let count = self.stages().setup.value_count();
        let cotangents = self.shape(links).read("vjp", cotangents)?;
        let one = |(query, (cotangent, numbers)): (&Query<'_>, (&[Real], &mut [Real]))| {
            let predicted = ready.predict_vjp(*query, |_| cotangent.to_vec());
            let (image, [x, y, z], orientation) = predicted.expect("a model with a derivative");
            numbers.copy_from_slice(&image.pixels);
            let [qx, qy, qz, qw] = orientation.unwrap_or_default();
            [x, y, z, qx, qy, qz, qw]
        };
        let mut slopes: Vec<[f64; 7]> = Vec::new();
        let work = |queries: &[Query<'_>], numbers: &mut [Real]| {
            // Chunks come in order, so that the next cotangents follow those of the slopes so far.
            let remaining = &cotangents[slopes.len() * count..];
            let rows = remaining.par_chunks_exact(count).zip(numbers.par_chunks_exact_mut(count));
            slopes.par_extend(queries.par_iter().zip(rows).map(one));
        };
        let observed = self.predicted_array(py, links, work)?;
        let (receivers, width) = (links.receivers.len(), if is_pose { 7 } else { 3 });
        let sum = |slopes: &[[f64; 7]]| (0..width).map(|k| slopes.iter().map(|d| d[k]).sum()).collect::<Vec<f64>>();
        let sums: Vec<f64> = slopes.chunks_exact(receivers).flat_map(sum).collect(); // over the receivers of a position
        let has_batch = links.lead.len() > usize::from(receivers > 1);
        let shape = if has_batch { vec![links.poses.len(), width] } else { vec![width] };
        Ok((observed, array(py, sums, &shape)?).into_pyobject(py)?.into_any())
    }
}

/// Iterator over the predictions of many positions, some at a time.
#[pyclass(module = "pwrfgs")]
struct Batches {
    model: Py<Model>,
    links: Links,
    /// Number of positions per batch.
    size: usize,
    /// Number of predicted positions.
    done: usize,
    interval: Option<f64>,
}

impl Model {
    /// Creates an iterator over the predictions of `size` positions each, with intervals of the level `interval` if it
    /// is given. Raises an exception for invalid settings before the first prediction.
    pub(super) fn start_batches<'py>(
        model: &Bound<'py, Self>,
        links: Links,
        size: usize,
        interval: Option<f64>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let py = model.py();
        if size == 0 {
            return reject(py, "batch_size is 0, expected 1 or more");
        }
        if links.lead.len() == usize::from(links.receivers.len() > 1) {
            return reject(py, "batch_size needs one position per row, such as tx [B, 3]");
        }
        if let Some(level) = interval {
            interval_factors(&model.get().ensemble, level).map_err(|error| to_exception(py, error))?;
        }
        let batches = Batches { model: model.clone().unbind(), links, size, done: 0, interval };
        Ok(Bound::new(py, batches)?.into_any())
    }
}

#[pymethods]
impl Batches {
    fn __iter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    fn __next__<'py>(&mut self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let (first, count) = (self.done, self.links.poses.len());
        if first >= count {
            return Ok(None);
        }
        self.done = first.saturating_add(self.size).min(count);
        self.model.get().predict_links(py, &self.links.rows(first..self.done), self.interval).map(Some)
    }
}
