//! Predictions with their derivative by the positions of the transmitters.

use super::{Links, Model};
use crate::arrays::{Gain, array, numbers};
use crate::border::wrong;
use pwrfgs_core::{MeasurementSetup, Query, Real, rows_of};
use pyo3::prelude::*;
use rayon::prelude::*;
use std::sync::Mutex;

impl Model {
    /// Returns (observations, derivative by the positions `[3]` or `[B, 3]`), given the cotangents of the observations.
    pub(super) fn differentiated<'py>(
        &self,
        py: Python<'py>,
        links: &Links,
        cotangents: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let ready = self.prepared();
        if !ready.has_derivative() || !links.features.is_empty() {
            let why = "its network reads link features or is a Python class";
            return Err(wrong(py, &format!("vjp: this model has no derivative by the position, since {why}")));
        }
        let MeasurementSetup { plane, task, .. } = &self.stages().setup;
        let (size, of_each) = ((plane.width, plane.height), plane.width * plane.height);
        let shape: Vec<Option<usize>> = links.lead.iter().copied().chain(task.shape(size)).map(Some).collect();
        let d: Vec<Real> = if task.is_complex {
            let gains = numbers::<Gain>("vjp", cotangents, &shape)?;
            rows_of(&gains.iter().map(|d| [d.re, d.im]).collect::<Vec<_>>(), plane.width)
        } else if shape.is_empty() {
            vec![cotangents.extract()?]
        } else {
            numbers("vjp", cotangents, &shape)?
        };
        let slopes: Mutex<Vec<[f64; 3]>> = Mutex::default();
        let work = |queries: &[Query<'_>], numbers: &mut [Real]| {
            let mut slopes = slopes.lock().expect("no other thread has it");
            let all = d[slopes.len() * of_each..].par_chunks_exact(of_each).zip(numbers.par_chunks_exact_mut(of_each));
            let one = |(query, (d, numbers)): (&Query<'_>, (&[Real], &mut [Real]))| {
                let found = ready.predict_vjp(*query, |_| d.to_vec());
                let (image, slope) = found.expect("a model with a derivative");
                numbers.copy_from_slice(&image.pixels);
                slope
            };
            slopes.extend(queries.par_iter().zip(all).map(one).collect::<Vec<_>>());
        };
        let observed = self.observed(py, links, work)?;
        let of_links = slopes.into_inner().expect("no other thread has it");
        let of_tx = |own: &[[f64; 3]]| own.iter().fold([0.0; 3], |sum, d| [0, 1, 2].map(|k| sum[k] + d[k]));
        let receivers = links.receivers.len();
        let all: Vec<f64> = of_links.chunks_exact(receivers).flat_map(of_tx).collect();
        let batch = links.lead.len() > usize::from(receivers > 1);
        let shape = if batch { vec![links.txs.len(), 3] } else { vec![3] };
        Ok((observed, array(py, all, &shape)?).into_pyobject(py)?.into_any())
    }
}
