//! Python classes as networks, and Python functions as losses.

use super::{Strategy, check_keys};
use crate::arrays::{ObservationShape, array, array_shape, check_finite, finite_numbers};
use crate::border::{call_strategy, reject, throw};
use pwrfgs::train::Objective;
use pwrfgs_core::{
    Cache, Conditions, Deformation, DeformationInputs, DeformationTraits, DeformationVjp, Deltas, Layout, Real, Task,
    WeightSpec,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Names and widths of the terms of a network, in the order of [`Deltas::columns`].
const TERMS: [(&str, usize); 3] = [("scales", 3), ("quats", 4), ("signals", 2)];

impl Strategy {
    /// Returns the first arguments of `forward` and `vjp`: weights by name, centres `[N, 3]`, inputs `[B, width]`.
    fn call_arguments<'py>(&self, py: Python<'py>, inputs: &DeformationInputs<'_>) -> PyResult<[Bound<'py, PyAny>; 3]> {
        let weights = PyDict::new(py);
        let mut remaining = inputs.weights;
        for (spec, _) in &self.object.weights {
            let (tensor, tail) = remaining.split_at(spec.len());
            weights.set_item(&spec.name, array(py, tensor.to_vec(), &spec.shape)?)?;
            remaining = tail;
        }
        let means = array(py, inputs.means.as_flattened().to_vec(), &[inputs.means.len(), 3])?;
        let txs = array(py, inputs.txs.values().to_vec(), &[inputs.txs.len(), inputs.txs.width()])?;
        Ok([weights.into_any(), means.into_any(), txs.into_any()])
    }

    /// Returns whether the object has this attribute and it is true.
    fn has_flag(&self, attribute: &str) -> bool {
        self.with(|_, instance| instance.getattr(attribute).map_or(Ok(false), |flag| flag.extract()))
    }
}

/// Returns the tensors of a network and their initial values, from the method `weights` of its object.
pub(super) fn initial_weights(instance: &Bound<'_, PyAny>) -> PyResult<Vec<(WeightSpec, Vec<Real>)>> {
    let py = instance.py();
    let Ok(weights) = instance.call_method0("weights")?.cast_into::<PyDict>() else {
        return reject(py, "weights returned no dict; give a dict of arrays by name");
    };
    let one = |(name, values): (Bound<'_, PyAny>, Bound<'_, PyAny>)| {
        let name: String = name.extract()?;
        let shape = array_shape(&values)?;
        let values = finite_numbers(&format!("weights: `{name}`"), &values, &shape)?;
        Ok((WeightSpec::zeros(name, shape), values))
    };
    weights.iter().map(one).collect()
}

impl Deformation for Strategy {
    named_python!();

    fn traits(&self) -> DeformationTraits {
        DeformationTraits {
            varies_geometry: self.has_flag("varies_geometry"),
            replaces_signals: self.has_flag("replaces_signals"),
            ..DeformationTraits::default()
        }
    }

    fn layout(&self) -> Layout {
        Layout { weights: self.object.weights.iter().map(|(spec, _)| spec.clone()).collect(), constants: Vec::new() }
    }

    fn start(&self, _: Conditions<'_>, weights: &mut [Real]) {
        let mut remaining = weights;
        for (_, values) in &self.object.weights {
            let (tensor, tail) = remaining.split_at_mut(values.len());
            tensor.copy_from_slice(values);
            remaining = tail;
        }
    }

    fn forward(&self, inputs: &DeformationInputs<'_>, _: &Cache) -> Deltas {
        self.with(|py, instance| {
            let [weights, means, txs] = self.call_arguments(py, inputs)?;
            let terms = instance.call_method1("forward", (weights, means, txs))?;
            let Ok(terms) = terms.cast_into::<PyDict>() else {
                return reject(py, "forward returned no dict; give a dict with `signals` [B, N, 2]");
            };
            check_keys("forward: unknown term", &terms, TERMS.map(|(term, _)| term))?;
            let mut deltas = Deltas::default();
            for (name, width) in TERMS {
                let Some(values) = terms.get_item(name)? else { continue };
                let shape = [inputs.txs.len(), inputs.means.len(), width];
                let values = finite_numbers(&format!("forward: `{name}`"), &values, &shape)?;
                match name {
                    "scales" => deltas.scales = values.as_chunks().0.to_vec(),
                    "quats" => deltas.quats = values.as_chunks().0.to_vec(),
                    _ => deltas.signals = values.as_chunks().0.to_vec(),
                }
            }
            let has_geometry = !deltas.scales.is_empty() || !deltas.quats.is_empty();
            if has_geometry && !self.has_flag("varies_geometry") {
                return reject(py, "forward returned scales or quats; set varies_geometry = True in the class");
            }
            Ok(deltas)
        })
    }

    fn vjp(&self, inputs: &DeformationInputs<'_>, d: &Deltas, sums: DeformationVjp<'_>) {
        self.with(|py, instance| {
            let [weights, means, txs] = self.call_arguments(py, inputs)?;
            let cotangents = PyDict::new(py);
            for ((name, width), column) in TERMS.iter().zip(d.columns()) {
                if !column.is_empty() {
                    let shape = [inputs.txs.len(), inputs.means.len(), *width];
                    cotangents.set_item(name, array(py, column.to_vec(), &shape)?)?;
                }
            }
            let derivatives = instance.call_method1("vjp", (weights, means, txs, cotangents))?;
            let form = "vjp: expected ({name: derivative}, derivative in the centres [N, 3] or None)";
            let Ok((d_weights, d_means)) = derivatives.extract::<(Bound<'_, PyDict>, Bound<'_, PyAny>)>() else {
                return reject(py, form);
            };
            let names = || self.object.weights.iter().map(|(spec, _)| spec.name.as_str());
            check_keys("vjp: unknown tensor", &d_weights, names())?;
            let mut remaining = sums.weights;
            for (spec, _) in &self.object.weights {
                let (sum, tail) = remaining.split_at_mut(spec.len());
                let name = format!("vjp: `{}`", spec.name);
                let Some(derivative) = d_weights.get_item(&spec.name)? else {
                    return reject(py, &format!("{name} is missing; give the derivative in every tensor"));
                };
                let derivative = finite_numbers(&name, &derivative, &spec.shape)?;
                sum.iter_mut().zip(derivative).for_each(|(sum, d)| *sum += d);
                remaining = tail;
            }
            if let Some(sums) = sums.means.filter(|_| !d_means.is_none()) {
                let derivative = finite_numbers("vjp: the derivative in the centres", &d_means, &[sums.len(), 3])?;
                sums.as_flattened_mut().iter_mut().zip(derivative).for_each(|(sum, d)| *sum += d);
            }
            Ok(())
        });
    }
}

/// Python function as a loss.
#[derive(Debug)]
pub(crate) struct PythonLoss {
    pub(crate) function: Py<PyAny>,
    pub(crate) task: Task,
}

impl Objective for PythonLoss {
    fn evaluate(&self, predictions: &[Real], truths: &[Real], (width, height): (usize, usize)) -> (Real, Vec<Real>) {
        let links = predictions.len() / (width * height).max(1);
        let call = |py: Python<'_>| {
            let shape = ObservationShape { task: self.task, size: (width, height), lead: &[links] };
            let given = |numbers: &[Real]| shape.array(py, numbers.to_vec());
            let result = self.function.bind(py).call1((given(predictions)?, given(truths)?))?;
            let form = "loss: expected (number, derivative in the predictions)";
            let Ok((value, slope)) = result.extract::<(Bound<'_, PyAny>, Bound<'_, PyAny>)>() else {
                return reject(py, form);
            };
            let name = "loss: the derivative";
            let d = shape.read(name, &slope)?;
            Ok((finite_numbers("loss: the value", &value, &[])?[0], check_finite(name, &slope, d)?))
        };
        call_strategy(|| Python::attach(call)).unwrap_or_else(|error: PyErr| throw(error))
    }
}
