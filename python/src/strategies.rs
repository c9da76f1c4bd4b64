//! Strategies that are written in Python: the host that makes them, and each as the trait that a run knows.
//!
//! An exception has no place in the signatures of those traits; where there is none it unwinds to the border, and the run
//! ends as by any other failed step, its checkpoint kept.

mod baseline;
mod initializer;
mod metric;
mod objects;
mod pruner;
mod split;

use crate::border::{carried, throw};
pub(crate) use objects::{cloud_object, stats_object};
use pwrfgs::foreign::{Host, Python as Named, set_host};
use pwrfgs_core::{Baseline, ColumnSpec, Initializer, Metric, Pruner, Result, Split};
use pyo3::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};

/// Registers the host.
pub(crate) fn begin() {
    set_host(Box::new(Interpreter::default()));
}

/// Makes objects of Python, each once.
#[derive(Default)]
struct Interpreter {
    made: Mutex<BTreeMap<(&'static str, Named), Arc<Object>>>,
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

impl Interpreter {
    fn object(&self, kind: &'static str, which: &Named) -> Result<Arc<Object>> {
        let key = (kind, which.clone());
        if let Some(object) = self.made.lock().unwrap_or_else(PoisonError::into_inner).get(&key) {
            return Ok(Arc::clone(object));
        }
        // Not under the lock: Python may call back.
        let object = Arc::new(Python::attach(|py| Object::make(py, kind, which)).map_err(carried)?);
        let mut made = self.made.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(Arc::clone(made.entry(key).or_insert(object)))
    }
}

impl Host for Interpreter {
    fn pruner(&self, which: &Named) -> Result<Arc<dyn Pruner>> {
        Ok(Arc::new(Strategy { object: self.object("Pruner", which)?, named: which.clone() }))
    }

    fn initializer(&self, which: &Named) -> Result<Arc<dyn Initializer>> {
        Ok(Arc::new(Strategy { object: self.object("Initializer", which)?, named: which.clone() }))
    }

    fn split(&self, which: &Named) -> Result<Arc<dyn Split>> {
        Ok(Arc::new(Strategy { object: self.object("Split", which)?, named: which.clone() }))
    }

    fn baseline(&self, which: &Named) -> Result<Arc<dyn Baseline>> {
        Ok(Arc::new(Strategy { object: self.object("Baseline", which)?, named: which.clone() }))
    }

    fn metric(&self, which: &Named) -> Result<Arc<dyn Metric>> {
        Ok(Arc::new(Strategy { object: self.object("Metric", which)?, named: which.clone() }))
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
    asked.try_iter()?.map(|column| one(column?)).collect()
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
#[derive(Debug)]
struct Strategy {
    object: Arc<Object>,
    named: Named,
}

impl Strategy {
    /// Does `work` with the object; an exception unwinds.
    fn with<T>(&self, work: impl FnOnce(Python<'_>, &Bound<'_, PyAny>) -> PyResult<T>) -> T {
        Python::attach(|py| work(py, self.object.own.bind(py))).unwrap_or_else(|error| throw(error))
    }

    /// The same where an exception is an error.
    fn try_with<T>(&self, work: impl FnOnce(Python<'_>, &Bound<'_, PyAny>) -> PyResult<T>) -> Result<T> {
        Python::attach(|py| work(py, self.object.own.bind(py))).map_err(carried)
    }
}

// What a pipeline holds is `Named`; these two are never written or read.
impl pwrfgs::prelude::Serialize for Strategy {
    fn serialize<S: serde::Serializer>(&self, s: S) -> std::result::Result<S::Ok, S::Error> {
        self.named.serialize(s)
    }
}
