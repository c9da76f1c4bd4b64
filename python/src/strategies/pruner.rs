//! Python classes as pruners.

use super::Strategy;
use super::objects::{cloud_object, context_object, stats_object, traced_object};
use crate::arrays::{column_shape, finite_numbers, numbers};
use crate::border::{input_error, reject};
use dfdx::tensor_ops::SumTo as _;
use pwrfgs_core::tape::{Trace, TraceScalar, TracedCloud, op};
use pwrfgs_core::{Budget, CloudStats, Gate, GaussianCloud, Needs, Pruner, PrunerTraits, Real, Statistic, StepContext};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

/// Statistics that a pruner may request, by name, with fixed settings; `Pruner.needs` in Python describes them. Above
/// `most` Gaussians, the elimination is not computed, since its cost grows with the square of their number.
const STATISTICS: [(&str, Statistic); 9] = [
    ("weight", Statistic::Weight),
    ("largest_weight", Statistic::LargestWeight),
    ("weight_per_area", Statistic::WeightPerArea),
    ("signal_weight", Statistic::SignalWeight),
    ("error", Statistic::Error { high: 0.5 }),
    ("top", Statistic::Top { count: 1 }),
    ("sensitivity", Statistic::Sensitivity),
    ("fisher", Statistic::Fisher),
    ("elimination", Statistic::Elimination { most: 4_096 }),
];

/// Result of `gate` or `penalty`: numbers, and their derivatives by column.
struct Curve<'py> {
    value: Bound<'py, PyAny>,
    columns: Vec<Trace>,
    slopes: Vec<Vec<Real>>,
    /// Optional third entry: the kind of a gate.
    word: Option<String>,
}

impl Strategy {
    /// Calls `method`, which returns a value with derivatives, and then `then` with its result. `None` if the class does
    /// not implement the method, or if it returns None. `form` describes the expected result.
    fn call_differentiable<T>(
        &self,
        method: &'static str,
        form: &str,
        (cloud, context): (&TracedCloud, &StepContext),
        then: impl FnOnce(Curve<'_>) -> PyResult<T>,
    ) -> Option<T> {
        if !self.object.implements(method) {
            return None;
        }
        self.with(|py, instance| {
            let result = instance.call_method1(method, (traced_object(py, cloud)?, context_object(py, context)?))?;
            if result.is_none() {
                return Ok(None);
            }
            let refuse = |given: &str| input_error(py, &format!("{method} returned {given}, expected {form}, or None"));
            let Ok(parts) = result.cast::<PyTuple>() else { return Err(refuse(&describe_class(&result))) };
            if !(2..=3).contains(&parts.len()) {
                return Err(refuse(&format!("{} entries", parts.len())));
            }
            let slopes = parts.get_item(1)?;
            let Ok(slopes) = slopes.cast::<PyDict>() else {
                return Err(refuse(&format!("{} as its derivatives", describe_class(&slopes))));
            };
            let (columns, slopes) = self.read_slopes(slopes, cloud, method)?;
            let word = parts.get_item(2).and_then(|word| word.extract()).ok();
            then(Curve { value: parts.get_item(0)?, columns, slopes, word }).map(Some)
        })
    }

    /// Reads a dict of derivatives by column; returns the columns on the tape and the derivatives. Raises an exception
    /// for an unknown column, one that does not learn, another shape, or an empty dict.
    fn read_slopes(
        &self,
        derivatives: &Bound<'_, PyDict>,
        cloud: &TracedCloud,
        method: &str,
    ) -> PyResult<(Vec<Trace>, Vec<Vec<Real>>)> {
        let (mut columns, mut slopes) = (Vec::new(), Vec::new());
        for (name, values) in derivatives {
            let name: String = name.extract()?;
            let refuse = |problem: &str| reject(derivatives.py(), &format!("{method}: {problem}"));
            if !cloud.names().any(|column| column == name) {
                let hint = pwrfgs_core::did_you_mean(&name, cloud.names());
                return refuse(&format!("unknown column `{name}`{hint}"));
            }
            if self.object.columns.iter().any(|column| column.name == name && column.learning_rate.is_none()) {
                return refuse(&format!("column `{name}` has no learning_rate, so its derivative has no effect"));
            }
            let width = pwrfgs_core::tape::values(cloud.leaf(&name)).len() / cloud.len().max(1);
            let shape = column_shape(cloud.len(), width);
            slopes.push(finite_numbers(&format!("{method}: the derivative in `{name}`"), &values, &shape)?);
            columns.push(cloud.column(&name));
        }
        if columns.is_empty() {
            return reject(derivatives.py(), &format!("{method}: expected the derivative in at least one column"));
        }
        Ok((columns, slopes))
    }
}

/// Describes the class of a value for a message.
fn describe_class(value: &Bound<'_, PyAny>) -> String {
    value.get_type().name().map_or_else(|_| "something else".into(), |name| format!("a value of {name}"))
}

/// Returns the cotangents of columns, given the cotangents `d_values` of values, and the derivatives `slopes` of value
/// i by row i of each column, or of a single value by all rows.
fn columns_vjp(slopes: &[Vec<Real>], d_values: &[Real]) -> Vec<Vec<Real>> {
    let column = |slopes: &Vec<Real>| {
        let width = slopes.len().checked_div(d_values.len()).unwrap_or(1).max(1);
        slopes.iter().enumerate().map(|(k, slope)| slope * d_values[k / width]).collect()
    };
    slopes.iter().map(column).collect()
}

impl Pruner for Strategy {
    named_python!();

    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, context: &StepContext) -> Vec<bool> {
        if !self.object.implements("keep") {
            return self
                .gate(&TracedCloud::new(cloud), context)
                .map_or_else(|| vec![true; cloud.len()], Gate::open_mask);
        }
        self.with(|py, instance| {
            let arguments = (cloud_object(py, cloud, false)?, stats_object(py, stats)?, context_object(py, context)?);
            let keep = instance.call_method1("keep", arguments)?;
            numbers::<bool>("the result of keep", &keep, &[Some(cloud.len())])
        })
    }

    fn needs(&self, cloud: &GaussianCloud, context: &StepContext) -> Needs {
        if !self.object.implements("needs") {
            return Needs::default();
        }
        self.with(|py, instance| {
            let requested =
                instance.call_method1("needs", (cloud_object(py, cloud, false)?, context_object(py, context)?))?;
            let mut needs = Needs::default();
            for name in requested.try_iter()? {
                let name: String = name?.extract()?;
                let Some((_, statistic)) = STATISTICS.iter().find(|(key, _)| *key == name) else {
                    let names = STATISTICS.map(|(key, _)| key);
                    let hint = pwrfgs_core::did_you_mean(&name, names);
                    let names = names.join(", ");
                    return reject(py, &format!("needs: unknown statistic `{name}`{hint} (expected one of {names})"));
                };
                needs.statistics.push(*statistic);
            }
            Ok(needs)
        })
    }

    fn traits(&self) -> PrunerTraits {
        // A class with only a score ranks Gaussians: the target decides how many are kept.
        let has_score_alone =
            self.object.implements("score") && !["keep", "gate"].iter().any(|method| self.object.implements(method));
        PrunerTraits {
            columns: self.object.columns.clone(),
            budget: has_score_alone.then_some(Budget::Gradual),
            requires_target: has_score_alone,
            ..PrunerTraits::default()
        }
    }

    fn gate(&self, cloud: &TracedCloud, context: &StepContext) -> Option<Gate> {
        let n = cloud.len();
        self.call_differentiable("gate", "(factor [N], {column: derivative})", (cloud, context), |curve| {
            let Curve { value, columns, slopes, word } = curve;
            let factor = finite_numbers("gate: the factor", &value, &[n])?;
            if let Some(bad) = factor.iter().find(|v| **v < 0.0) {
                return reject(value.py(), &format!("gate: a factor is {bad}; give numbers from 0 to 1"));
            }
            let vjp = move |cotangents: Vec<Vec<Real>>| columns_vjp(&slopes, &cotangents[0]);
            let gate = op(columns, vec![factor], vjp).remove(0);
            match word.as_deref() {
                None => Ok(Gate::Whole(gate)),
                Some("existence") => Ok(Gate::Existence(gate)),
                Some(other) => {
                    reject(value.py(), &format!("gate: unknown third entry {other:?} (expected \"existence\")"))
                }
            }
        })
    }

    fn penalty(&self, cloud: &TracedCloud, context: &StepContext) -> Option<TraceScalar> {
        self.call_differentiable("penalty", "(number, {column: derivative})", (cloud, context), |curve| {
            let Curve { value, columns, slopes, .. } = curve;
            let number = finite_numbers("penalty: the value", &value, &[])?;
            let vjp = move |cotangents: Vec<Vec<Real>>| columns_vjp(&slopes, &cotangents[0]);
            Ok(op(columns, vec![number], vjp).remove(0).sum())
        })
    }

    fn update(&self, cloud: &mut GaussianCloud, stats: &CloudStats, context: &StepContext) {
        if !self.object.implements("update") {
            return;
        }
        self.with(|py, instance| {
            let object = cloud_object(py, cloud, true)?;
            instance.call_method1("update", (&object, stats_object(py, stats)?, context_object(py, context)?))?;
            let (columns, n) = (object.getattr("columns")?, cloud.len());
            for (name, width, values) in cloud.columns_mut() {
                let column = columns.get_item(name)?;
                let column = finite_numbers(&format!("update: `{name}`"), &column, &column_shape(n, width))?;
                values.copy_from_slice(&column);
            }
            Ok(())
        });
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, context: &StepContext) -> Vec<Real> {
        if !self.object.implements("score") {
            return cloud.opacity_logits.clone();
        }
        self.with(|py, instance| {
            let arguments = (cloud_object(py, cloud, false)?, stats_object(py, stats)?, context_object(py, context)?);
            finite_numbers("the score", &instance.call_method1("score", arguments)?, &[cloud.len()])
        })
    }
}
