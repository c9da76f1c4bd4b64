//! A class of Python's as a pruner.

use super::Strategy;
use super::objects::{cloud_object, given_flat, moment_object, stats_object, traced_object};
use crate::arrays::{array, numbers};
use crate::border::wrong;
use dfdx::tensor_ops::SumTo as _;
use pwrfgs_core::tape::{Trace, TraceScalar, Traced, op};
use pwrfgs_core::{CloudStats, ColumnSpec, Gate, GaussianCloud, Moment, Needs, Pruner, Real, Statistic};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

/// What a pruner may ask for, by name.
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

/// The derivatives that come with a gate or a penalty: of each column that is named.
struct Slopes {
    columns: Vec<Trace>,
    slopes: Vec<Vec<Real>>,
}

impl Slopes {
    fn of(given: &Bound<'_, PyAny>, cloud: &Traced, what: &str) -> PyResult<Self> {
        let (mut columns, mut slopes) = (Vec::new(), Vec::new());
        for item in given.cast::<PyDict>().map_err(PyErr::from)?.iter() {
            let (name, values): (String, _) = (item.0.extract()?, item.1);
            if !cloud.names().any(|own| own == name) {
                let hint = pwrfgs_core::did_you_mean(&name, cloud.names());
                return Err(wrong(given.py(), &format!("{what}: there is no column `{name}`{hint}")));
            }
            let trace = cloud.column(&name);
            let length = pwrfgs_core::tape::values(cloud.leaf(&name)).len();
            let flat = given_flat(&format!("{what}: the derivative in `{name}`"), &values, length)?;
            columns.push(trace);
            slopes.push(flat);
        }
        if columns.is_empty() {
            return Err(wrong(given.py(), &format!("{what}: give the derivative in one column at least")));
        }
        Ok(Self { columns, slopes })
    }
}

impl Pruner for Strategy {
    fn typetag_name(&self) -> &'static str {
        "Python"
    }

    fn typetag_deserialize(&self) {}

    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, moment: &Moment) -> Vec<bool> {
        self.with(|py, own| {
            let arguments = (cloud_object(py, cloud, false)?, stats_object(py, stats)?, moment_object(py, moment)?);
            let keep = own.call_method1("keep", arguments)?;
            numbers::<bool>("what keep gave", &keep, &[Some(cloud.len())])
        })
    }

    fn needs(&self, cloud: &GaussianCloud, moment: &Moment) -> Needs {
        if !self.object.has("needs") {
            return Needs::nothing();
        }
        self.with(|py, own| {
            let asked = own.call_method1("needs", (cloud_object(py, cloud, false)?, moment_object(py, moment)?))?;
            let mut needs = Needs::nothing();
            for name in asked.try_iter()? {
                let name: String = name?.extract()?;
                let Some((_, statistic)) = STATISTICS.iter().find(|(own, _)| *own == name) else {
                    let names = STATISTICS.map(|(own, _)| own);
                    let hint = pwrfgs_core::did_you_mean(&name, names);
                    let what = format!("needs: there is no statistic `{name}`{hint} (there are {})", names.join(", "));
                    return Err(wrong(py, &what));
                };
                needs.statistics.push(*statistic);
            }
            Ok(needs)
        })
    }

    fn columns(&self) -> Vec<ColumnSpec> {
        self.object.columns.clone()
    }

    fn gate(&self, cloud: &Traced, moment: &Moment) -> Option<Gate> {
        if !self.object.has("gate") {
            return None;
        }
        self.with(|py, own| {
            let arguments = (traced_object(py, cloud)?, moment_object(py, moment)?);
            let found = own.call_method1("gate", arguments)?;
            if found.is_none() {
                return Ok(None);
            }
            let parts = found.cast::<PyTuple>().map_err(PyErr::from)?;
            let factor = given_flat("the gate", &parts.get_item(0)?, cloud.len())?;
            let Slopes { columns, slopes } = Slopes::of(&parts.get_item(1)?, cloud, "gate")?;
            let n = cloud.len();
            let vjp = move |cotangents: Vec<Vec<Real>>| {
                let rows = |slopes: &Vec<Real>| {
                    let width = slopes.len().checked_div(n).unwrap_or(1).max(1);
                    slopes.iter().enumerate().map(|(k, slope)| slope * cotangents[0][k / width]).collect()
                };
                slopes.iter().map(rows).collect()
            };
            let gate = op(columns, vec![factor], vjp).remove(0);
            let presence = parts.len() > 2 && parts.get_item(2)?.extract::<String>()? == "presence";
            Ok(Some(if presence { Gate::Presence(gate) } else { Gate::Whole(gate) }))
        })
    }

    fn penalty(&self, cloud: &Traced, moment: &Moment) -> Option<TraceScalar> {
        if !self.object.has("penalty") {
            return None;
        }
        self.with(|py, own| {
            let arguments = (traced_object(py, cloud)?, moment_object(py, moment)?);
            let found = own.call_method1("penalty", arguments)?;
            if found.is_none() {
                return Ok(None);
            }
            let (value, slopes): (Real, Bound<'_, PyAny>) = found.extract()?;
            let Slopes { columns, slopes } = Slopes::of(&slopes, cloud, "penalty")?;
            let vjp = move |cotangents: Vec<Vec<Real>>| {
                slopes.iter().map(|slopes| slopes.iter().map(|slope| slope * cotangents[0][0]).collect()).collect()
            };
            Ok(Some(op(columns, vec![vec![value]], vjp).remove(0).sum()))
        })
    }

    fn update(&self, cloud: &mut GaussianCloud, stats: &CloudStats, moment: &Moment) {
        if !self.object.has("update") {
            return;
        }
        self.with(|py, own| {
            let object = cloud_object(py, cloud, true)?;
            own.call_method1("update", (&object, stats_object(py, stats)?, moment_object(py, moment)?))?;
            let columns = object.getattr("columns")?;
            for (name, _, values) in cloud.columns_mut() {
                let column = columns.get_item(name)?;
                values.copy_from_slice(&given_flat(&format!("update: `{name}`"), &column, values.len())?);
            }
            Ok(())
        });
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, moment: &Moment) -> Vec<Real> {
        if !self.object.has("score") {
            return cloud.opacity_logits.clone();
        }
        self.with(|py, own| {
            let arguments = (cloud_object(py, cloud, false)?, stats_object(py, stats)?, moment_object(py, moment)?);
            given_flat("the score", &own.call_method1("score", arguments)?, cloud.len())
        })
    }

    fn state(&self) -> Option<Vec<Real>> {
        let has = self.object.has("state");
        has.then(|| self.with(|_, own| numbers::<Real>("state", &own.call_method0("state")?, &[None])))
    }

    fn advance(&self, state: &mut [Real], n: usize, cloud: &GaussianCloud, moment: &Moment) {
        if !self.object.has("advance") {
            return;
        }
        self.with(|py, own| {
            let before = array(py, state.to_vec(), &[state.len()])?;
            let arguments = (before, n, cloud_object(py, cloud, false)?, moment_object(py, moment)?);
            let after = own.call_method1("advance", arguments)?;
            state.copy_from_slice(&numbers::<Real>("what advance gave", &after, &[Some(state.len())])?);
            Ok(())
        });
    }
}
