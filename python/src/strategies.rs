//! Strategies that are written in Python: the host that makes them, and each as the trait that a run knows.
//!
//! An exception has no place in the signatures of those traits; where there is none it unwinds to the border, and the run
//! ends as by any other failed step, its checkpoint kept.

/// What typetag asks of every plugin; a strategy is never written as text.
macro_rules! named_python {
    () => {
        fn typetag_name(&self) -> &'static str {
            "Python"
        }

        fn typetag_deserialize(&self) {}
    };
}

mod evaluation;
mod initializer;
mod objects;
mod pruner;

use crate::border::{asked, asking, carried, throw, wrong};
pub(crate) use objects::{cloud_object, stats_object};
use pwrfgs::foreign::{Host, Python as Named, set_host};
use pwrfgs_core::{
    Baseline, ColumnSpec, GaussianCloud, Initializer, JsonSchema, Metric, Pruner, Real, Result, Split, schemars,
};
use pyo3::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};

/// Numbers of a column that a Gaussian may have.
const WIDEST: usize = 4096;

/// Registers the host.
pub(crate) fn begin() {
    set_host(Box::new(Interpreter));
}

/// Makes objects of Python.
struct Interpreter;

/// The objects of what goes on, each made once.
static MADE: Mutex<BTreeMap<(&'static str, Named), Arc<Object>>> = Mutex::new(BTreeMap::new());

/// Begins something that has objects of its own: what others remember outside of columns and state is not there.
pub(crate) fn forget() {
    if !asked() {
        MADE.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }
}

/// An object of a user's class.
#[derive(Debug)]
struct Object {
    own: Py<PyAny>,
    /// The methods that its class has beside what every strategy has: the others are not called.
    has: BTreeSet<String>,
    /// Of a pruner, what it asks for.
    columns: Vec<ColumnSpec>,
}

/// The object of a strategy that goes on, made where it is not there yet.
fn object(kind: &'static str, which: &Named) -> Result<Arc<Object>> {
    let key = (kind, which.clone());
    if let Some(object) = MADE.lock().unwrap_or_else(PoisonError::into_inner).get(&key) {
        return Ok(Arc::clone(object));
    }
    // Not under the lock: Python may call back.
    let object = Arc::new(Python::attach(|py| Object::make(py, kind, which)).map_err(carried)?);
    let mut made = MADE.lock().unwrap_or_else(PoisonError::into_inner);
    Ok(Arc::clone(made.entry(key).or_insert(object)))
}

impl Host for Interpreter {
    fn pruner(&self, which: &Named) -> Result<Arc<dyn Pruner>> {
        Ok(Arc::new(Strategy { object: object("Pruner", which)?, named: which.clone() }))
    }

    fn initializer(&self, which: &Named) -> Result<Arc<dyn Initializer>> {
        Ok(Arc::new(Strategy { object: object("Initializer", which)?, named: which.clone() }))
    }

    fn split(&self, which: &Named) -> Result<Arc<dyn Split>> {
        Ok(Arc::new(Strategy { object: object("Split", which)?, named: which.clone() }))
    }

    fn baseline(&self, which: &Named) -> Result<Arc<dyn Baseline>> {
        Ok(Arc::new(Strategy { object: object("Baseline", which)?, named: which.clone() }))
    }

    fn metric(&self, which: &Named) -> Result<Arc<dyn Metric>> {
        Ok(Arc::new(Strategy { object: object("Metric", which)?, named: which.clone() }))
    }
}

impl Object {
    fn make(py: Python<'_>, kind: &str, which: &Named) -> PyResult<Self> {
        let helpers = py.import("pwrfgs._strategies")?;
        let Named { module, class, settings, source } = which;
        let own = helpers.getattr("made")?.call1((kind, module, class, settings, source))?;
        let has: BTreeSet<String> = helpers.getattr("overrides")?.call1((kind, &own))?.extract()?;
        let columns = if has.contains("columns") { columns(&own.call_method0("columns")?)? } else { Vec::new() };
        Ok(Self { own: own.unbind(), has, columns })
    }

    fn has(&self, method: &str) -> bool {
        self.has.contains(method)
    }
}

/// What a pruner asks for, as `Column`s.
fn columns(asked: &Bound<'_, PyAny>) -> PyResult<Vec<ColumnSpec>> {
    let one = |column: Bound<'_, PyAny>| {
        Ok(ColumnSpec {
            name: lasting(column.getattr("name")?.extract()?),
            width: column.getattr("width")?.extract()?,
            init: column.getattr("init")?.extract()?,
            learning_rate: column.getattr("learning_rate")?.extract()?,
            adam: column.getattr("adam")?.extract()?,
        })
    };
    let all = asked.try_iter().and_then(|all| all.map(|column| one(column?)).collect::<PyResult<Vec<ColumnSpec>>>());
    let form = "give a list of pwrfgs.Column(name, width=1, init=0.0, learning_rate=None, adam=True)";
    let all = all.map_err(|error| wrong(asked.py(), &format!("columns: {error}; {form}")))?;
    match all.iter().enumerate().find_map(|(i, spec)| fault(spec, &all[..i]).map(|what| (spec.name, what))) {
        Some((name, what)) => Err(wrong(asked.py(), &format!("columns: `{name}` {what}"))),
        None => Ok(all),
    }
}

/// What is wrong with a column; `others` come before it.
fn fault(spec: &ColumnSpec, others: &[ColumnSpec]) -> Option<&'static str> {
    let is_name = spec.name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
        && spec.name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    if !is_name {
        return Some("is no name; take letters, digits and underscores");
    }
    if GaussianCloud::zeros(0).columns().any(|(own, ..)| own == spec.name) {
        return Some("is a column that every Gaussian has; take another name");
    }
    if others.iter().any(|other| other.name == spec.name) {
        return Some("is there twice");
    }
    if !(1..=WIDEST).contains(&spec.width) {
        return Some("has a width that is not from 1 to 4096");
    }
    if !spec.init.is_finite() {
        return Some("begins with a number that is not finite");
    }
    let positive = |rate: Real| rate.is_finite() && rate > 0.0;
    (!spec.learning_rate.is_none_or(positive))
        .then_some("has a learning rate that is no positive number; None is for columns that do not learn")
}

/// A name that lasts as long as the process; each once.
fn lasting(name: String) -> &'static str {
    static NAMES: Mutex<BTreeSet<&'static str>> = Mutex::new(BTreeSet::new());
    let mut names = NAMES.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(known) = names.get(name.as_str()) {
        return known;
    }
    let name: &'static str = Box::leak(name.into_boxed_str());
    names.insert(name);
    name
}

/// A strategy in use. It is never written as text: what a pipeline holds is [`Named`].
#[derive(Debug, JsonSchema)]
#[schemars(with = "Named")]
struct Strategy {
    object: Arc<Object>,
    named: Named,
}

impl Strategy {
    /// Does `work` with the object; an exception unwinds.
    fn with<T>(&self, work: impl FnOnce(Python<'_>, &Bound<'_, PyAny>) -> PyResult<T>) -> T {
        self.ask(work).unwrap_or_else(|error| throw(error))
    }

    /// The same where an exception is an error.
    fn try_with<T>(&self, work: impl FnOnce(Python<'_>, &Bound<'_, PyAny>) -> PyResult<T>) -> Result<T> {
        self.ask(work).map_err(carried)
    }

    fn ask<T>(&self, work: impl FnOnce(Python<'_>, &Bound<'_, PyAny>) -> PyResult<T>) -> PyResult<T> {
        asking(|| Python::attach(|py| work(py, self.object.own.bind(py))))
    }
}

// What a pipeline holds is `Named`; these two are never written or read.
impl pwrfgs::prelude::Serialize for Strategy {
    fn serialize<S: serde::Serializer>(&self, s: S) -> std::result::Result<S::Ok, S::Error> {
        self.named.serialize(s)
    }
}
