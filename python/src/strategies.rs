//! Strategies written in Python: the host that creates them, and an adapter for each trait.
//!
//! Most methods of those traits cannot return an exception; it then unwinds to the Python bridge, and the run ends as
//! after any failed step, with its checkpoint.

/// Methods that typetag requires of every plugin; a strategy is never written as text.
macro_rules! named_python {
    () => {
        fn typetag_name(&self) -> &'static str {
            "Python"
        }

        fn typetag_deserialize(&self) {}
    };
}

mod deformation;
mod evaluation;
mod initializer;
mod objects;
mod pruner;

use crate::border::{call_strategy, input_error, is_in_strategy_call, reject, throw, to_plugin_error};
pub(crate) use deformation::PythonLoss;
pub(crate) use objects::{cloud_object, read_cloud, stats_object};
use pwrfgs::foreign::{Host, Python as Named, set_host};
use pwrfgs_core::{
    Baseline, ColumnSpec, Deformation, GaussianCloud, Initializer, JsonSchema, Metric, Pruner, Real, Result, Split,
    WeightSpec, did_you_mean, schemars,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};

/// Largest number of values per Gaussian in a column; [`column_fault`] also names it in a message.
const WIDEST: usize = 4096;

/// Registers the interpreter as host of strategies in Python.
pub(crate) fn register_host() {
    set_host(Box::new(Interpreter));
}

/// Host that creates Python objects.
struct Interpreter;

/// Objects of the current run, each created once.
static MADE: Mutex<BTreeMap<(&'static str, Named), Arc<Object>>> = Mutex::new(BTreeMap::new());

/// Removes the objects of the last run, so that the next one creates new objects; does nothing during a strategy call.
pub(crate) fn forget_objects() {
    if !is_in_strategy_call() {
        MADE.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }
}

/// Object of a user class.
#[derive(Debug)]
struct Object {
    instance: Py<PyAny>,
    /// Methods that its class implements: others are not called.
    methods: BTreeSet<String>,
    /// Columns that a pruner requests.
    columns: Vec<ColumnSpec>,
    /// Tensors of a network, and their initial values.
    weights: Vec<(WeightSpec, Vec<Real>)>,
}

/// Returns the object of a strategy in the current run, created if needed.
fn strategy_object(kind: &'static str, which: &Named) -> Result<Arc<Object>> {
    let key = (kind, which.clone());
    if let Some(object) = MADE.lock().unwrap_or_else(PoisonError::into_inner).get(&key) {
        return Ok(Arc::clone(object));
    }
    // Not under the lock: Python may call back.
    let object = Arc::new(Python::attach(|py| Object::create(py, kind, which)).map_err(to_plugin_error)?);
    let mut made = MADE.lock().unwrap_or_else(PoisonError::into_inner);
    Ok(Arc::clone(made.entry(key).or_insert(object)))
}

impl Host for Interpreter {
    fn pruner(&self, which: &Named) -> Result<Arc<dyn Pruner>> {
        Ok(Arc::new(Strategy { object: strategy_object("Pruner", which)?, named: which.clone() }))
    }

    fn initializer(&self, which: &Named) -> Result<Arc<dyn Initializer>> {
        Ok(Arc::new(Strategy { object: strategy_object("Initializer", which)?, named: which.clone() }))
    }

    fn split(&self, which: &Named) -> Result<Arc<dyn Split>> {
        Ok(Arc::new(Strategy { object: strategy_object("Split", which)?, named: which.clone() }))
    }

    fn baseline(&self, which: &Named) -> Result<Arc<dyn Baseline>> {
        Ok(Arc::new(Strategy { object: strategy_object("Baseline", which)?, named: which.clone() }))
    }

    fn deformation(&self, which: &Named) -> Result<Arc<dyn Deformation>> {
        Ok(Arc::new(Strategy { object: strategy_object("Deformation", which)?, named: which.clone() }))
    }

    fn metric(&self, which: &Named) -> Result<Arc<dyn Metric>> {
        Ok(Arc::new(Strategy { object: strategy_object("Metric", which)?, named: which.clone() }))
    }
}

impl Object {
    /// Creates the object of a class, and reads its methods, columns and tensors.
    fn create(py: Python<'_>, kind: &str, which: &Named) -> PyResult<Self> {
        let helpers = py.import("pwrfgs._strategies")?;
        let Named { module, class, settings, source } = which;
        let instance = helpers.getattr("made")?.call1((kind, module, class, settings, source))?;
        let methods: BTreeSet<String> = helpers.getattr("overrides")?.call1((kind, &instance))?.extract()?;
        let columns = || requested_columns(&instance.call_method0("columns")?);
        let columns = methods.contains("columns").then(columns).transpose()?.unwrap_or_default();
        let weights = if kind == "Deformation" { deformation::initial_weights(&instance)? } else { Vec::new() };
        Ok(Self { instance: instance.unbind(), methods, columns, weights })
    }

    /// Returns whether the class implements a method.
    fn implements(&self, method: &str) -> bool {
        self.methods.contains(method)
    }
}

/// Returns the columns that a pruner requests, from `Column` objects.
fn requested_columns(columns: &Bound<'_, PyAny>) -> PyResult<Vec<ColumnSpec>> {
    let one = |column: Bound<'_, PyAny>| {
        Ok(ColumnSpec {
            name: static_name(column.getattr("name")?.extract()?),
            width: column.getattr("width")?.extract()?,
            init: column.getattr("init")?.extract()?,
            learning_rate: column.getattr("learning_rate")?.extract()?,
            adam: column.getattr("adam")?.extract()?,
        })
    };
    let specs =
        columns.try_iter().and_then(|all| all.map(|column| one(column?)).collect::<PyResult<Vec<ColumnSpec>>>());
    let form = "give a list of pwrfgs.Column(name, width=1, init=0.0, learning_rate=None, adam=True)";
    let specs = specs.map_err(|error| input_error(columns.py(), &format!("columns: {error}; {form}")))?;
    match specs.iter().enumerate().find_map(|(i, spec)| column_fault(spec, &specs[..i]).map(|fault| (spec.name, fault)))
    {
        Some((name, fault)) => reject(columns.py(), &format!("columns: `{name}` {fault}")),
        None => Ok(specs),
    }
}

/// Returns an error for a key that is not among `names`; `problem` begins its message.
pub(crate) fn check_keys<'a>(
    problem: &str,
    dict: &Bound<'_, PyDict>,
    names: impl IntoIterator<Item = &'a str> + Clone,
) -> PyResult<()> {
    for key in dict.keys() {
        let key: String = key.str()?.extract()?;
        if names.clone().into_iter().all(|name| name != key) {
            let hint = did_you_mean(&key, names);
            return reject(dict.py(), &format!("{problem} `{key}`{hint}"));
        }
    }
    Ok(())
}

/// Returns the problem of a column, `None` if it is valid; `others` precede it.
fn column_fault(spec: &ColumnSpec, others: &[ColumnSpec]) -> Option<&'static str> {
    let is_name = spec.name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
        && spec.name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    if !is_name {
        return Some("is not a valid name; use letters, digits and underscores");
    }
    if GaussianCloud::zeros(0).columns().any(|(name, ..)| name == spec.name) {
        return Some("is a built-in column; use another name");
    }
    if others.iter().any(|other| other.name == spec.name) {
        return Some("is repeated");
    }
    if !(1..=WIDEST).contains(&spec.width) {
        return Some("has a width outside 1 to 4096");
    }
    if !spec.init.is_finite() {
        return Some("has an initial value that is not finite");
    }
    let positive = |rate: Real| rate.is_finite() && rate > 0.0;
    (!spec.learning_rate.is_none_or(positive))
        .then_some("has a learning rate that is not positive; use None for columns that do not learn")
}

/// Returns the name with static lifetime; each name is allocated once.
fn static_name(name: String) -> &'static str {
    static NAMES: Mutex<BTreeSet<&'static str>> = Mutex::new(BTreeSet::new());
    let mut names = NAMES.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(allocated) = names.get(name.as_str()) {
        return allocated;
    }
    let name: &'static str = Box::leak(name.into_boxed_str());
    names.insert(name);
    name
}

/// Strategy in use. It is never written as text: a pipeline contains [`Named`].
#[derive(Debug, JsonSchema)]
#[schemars(with = "Named")]
struct Strategy {
    object: Arc<Object>,
    named: Named,
}

impl Strategy {
    /// Calls `work` with the object; exceptions unwind.
    fn with<T>(&self, work: impl FnOnce(Python<'_>, &Bound<'_, PyAny>) -> PyResult<T>) -> T {
        self.call(work).unwrap_or_else(|error| throw(error))
    }

    /// Calls `work` with the object; exceptions are returned as errors.
    fn try_with<T>(&self, work: impl FnOnce(Python<'_>, &Bound<'_, PyAny>) -> PyResult<T>) -> Result<T> {
        self.call(work).map_err(to_plugin_error)
    }

    /// Calls `work` with the object as part of a strategy call.
    fn call<T>(&self, work: impl FnOnce(Python<'_>, &Bound<'_, PyAny>) -> PyResult<T>) -> PyResult<T> {
        call_strategy(|| Python::attach(|py| work(py, self.object.instance.bind(py))))
    }
}

// Plugins must be serialisable, but pipelines contain `Named`: this is never called.
impl pwrfgs::prelude::Serialize for Strategy {
    fn serialize<S: serde::Serializer>(&self, s: S) -> std::result::Result<S::Ok, S::Error> {
        self.named.serialize(s)
    }
}
