//! Plugins, pipelines and their text.

use crate::border::{input_error, reject, run_stoppable, stop_progress, to_exception, without_gil, without_position};
use pwrfgs::experiment::{read_pipeline_text, rebased};
use pwrfgs::pipeline::Change;
use pwrfgs::pipeline::ron_tree::{RonBody as Parts, RonTree};
use pwrfgs::prelude::Pipeline as Inner;
use pwrfgs_core::Result;
use pwrfgs_core::docs::{DocBody, DocKind, Docs};
use pwrfgs_core::files::{check_new_file, create};
use pwrfgs_core::plugin::{PluginFamily, inventory, ron_options, to_ron};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Pipeline with its text; wrapped by the Python class `Pipeline`.
#[pyclass(frozen, module = "pwrfgs._pwrfgs")]
pub(crate) struct Pipeline {
    inner: Mutex<Inner>,
    /// Base folder of its relative paths.
    base: PathBuf,
}

impl Pipeline {
    /// Returns a copy of the pipeline in its present state.
    pub(crate) fn current(&self) -> Inner {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Returns the folder at which relative paths of the pipeline start.
    pub(crate) fn base(&self) -> &Path {
        &self.base
    }

    /// Changes the pipeline completely or not at all. `by` changes a copy without holding the lock, because checks may
    /// call Python strategies; a concurrent change by another thread is overwritten.
    fn change(&self, py: Python<'_>, by: impl FnOnce(&mut Inner) -> Result<()> + Send) -> PyResult<()> {
        let mut changed = self.current();
        let changed = without_gil(py, || by(&mut changed).map(|()| changed))?;
        *self.inner.lock().unwrap_or_else(PoisonError::into_inner) = changed;
        Ok(())
    }
}

#[pymethods]
impl Pipeline {
    /// Parses RON text; `path` is used in messages, and relative paths start at `folder`. Raises an exception for text
    /// that is not a valid pipeline.
    #[staticmethod]
    fn parse(py: Python<'_>, text: &str, path: PathBuf, folder: PathBuf) -> PyResult<Self> {
        let inner = without_gil(py, || Inner::parse(text, &path))?;
        Ok(Self { inner: Mutex::new(inner), base: folder })
    }

    /// Returns the whole pipeline as RON, with every default written out.
    fn text(&self, py: Python<'_>) -> PyResult<String> {
        self.current().to_ron().map_err(|error| to_exception(py, error))
    }

    #[getter]
    fn folder(&self) -> PathBuf {
        self.base.clone()
    }

    /// Sets values by path from RON texts; all or none.
    fn set(&self, py: Python<'_>, values: Vec<(String, String)>) -> PyResult<()> {
        let changes: Vec<Change> = values.iter().map(|(path, value)| Change::new(path, value)).collect();
        self.change(py, |inner| inner.change(&changes))
    }

    /// Same as `set`, with arguments of `--set`.
    fn set_arguments(&self, py: Python<'_>, arguments: Vec<String>) -> PyResult<()> {
        self.change(py, |inner| inner.set_all(&arguments))
    }

    /// Writes a new pipeline file with adapted relative paths.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        without_gil(py, || {
            check_new_file(&path)?;
            create(&path, rebased(&self.current(), &self.base)?.to_ron()?.as_bytes())
        })
    }

    /// Returns an independent copy.
    fn copied(&self) -> Self {
        Self { inner: Mutex::new(self.current()), base: self.base.clone() }
    }

    /// Loads the data of the pipeline, without warnings about them.
    fn data(&self, py: Python<'_>) -> PyResult<crate::data::Dataset> {
        let (data, source) = run_stoppable(py, |stop| {
            let source = rebased(&self.current(), &self.base)?.data;
            Ok((source.load(&self.base, &stop_progress(stop))?, source))
        })?;
        Ok(crate::data::Dataset::new(data, Some(to_ron(&source))))
    }
}

/// Text of a pipeline file, or of the shipped pipeline of this name.
#[pyfunction]
pub(crate) fn pipeline_text(py: Python<'_>, path: PathBuf) -> PyResult<String> {
    without_gil(py, || read_pipeline_text(&path))
}

/// Parses RON text to nested tuples: ("plain", text), ("text", str), ("fields", name, [(field, value)]), ("list", name, [value])
/// for brackets, ("items", name, [value]) for parentheses. Raises an exception for text that is not a single value.
#[pyfunction]
pub(crate) fn parse_ron<'py>(py: Python<'py>, text: &str) -> PyResult<Bound<'py, PyAny>> {
    let tree = RonTree::parse(text).map_err(|why| input_error(py, &why))?;
    ron_tuples(py, &tree, text)
}

/// Converts a RON tree of `text` to nested tuples, see [`parse_ron`].
fn ron_tuples<'py>(py: Python<'py>, tree: &RonTree, text: &str) -> PyResult<Bound<'py, PyAny>> {
    let source = tree.text_in(text);
    Ok(match &tree.body {
        Parts::Fields(fields) => {
            let fields = fields.iter().map(|(name, value)| Ok((name.as_str(), ron_tuples(py, value, text)?)));
            let fields = PyList::new(py, fields.collect::<PyResult<Vec<_>>>()?)?;
            ("fields", tree.name.as_deref(), fields).into_pyobject(py)?.into_any()
        }
        Parts::Items(items) => {
            let items = items.iter().map(|value| ron_tuples(py, value, text)).collect::<PyResult<Vec<_>>>()?;
            let is_list = source[tree.name.as_ref().map_or(0, String::len)..].trim_start().starts_with('[');
            let kind = if is_list { "list" } else { "items" };
            (kind, tree.name.as_deref(), PyList::new(py, items)?).into_pyobject(py)?.into_any()
        }
        Parts::Plain if tree.quoted => {
            let decoded = ron_options().from_str::<String>(source).map_err(|e| input_error(py, &e.to_string()))?;
            ("text", decoded).into_pyobject(py)?.into_any()
        }
        Parts::Plain => ("plain", source).into_pyobject(py)?.into_any(),
    })
}

/// Plugin of this kind as text, with every default written out.
#[pyfunction]
pub(crate) fn complete(py: Python<'_>, kind: &str, text: &str) -> PyResult<String> {
    let Some(family) = PluginFamily::find(kind) else {
        return reject(py, &format!("unknown plugin kind `{kind}`"));
    };
    without_gil(py, || (family.complete)(text).map_err(without_position))
}

/// All linked plugins, by kind: dicts with kind, name, and docs, fields and text of the default. A plugin with a
/// required field has no docs, fields and text.
#[pyfunction]
pub(crate) fn registry<'py>(py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
    let list = PyList::empty(py);
    let mut families: Vec<&PluginFamily> = inventory::iter::<PluginFamily>().collect();
    families.sort_by_key(|family| family.kind);
    for family in families {
        for member in (family.members)() {
            let entry = PyDict::new(py);
            entry.set_item("kind", family.kind)?;
            entry.set_item("name", member.name)?;
            entry.set_item("text", member.text.clone().ok())?;
            entry.set_item("doc", member.docs.map(|docs| docs.text))?;
            entry.set_item(
                "fields",
                member.docs.map_or_else(|| Ok(PyList::empty(py)), |docs| field_list(py, docs.fields()))?,
            )?;
            list.append(entry)?;
        }
    }
    Ok(list)
}

/// Converts the documentation of fields to tuples (name, type, text, default as JSON text: `None` for a required field).
pub(crate) fn field_list<'py>(py: Python<'py>, fields: &[pwrfgs_core::docs::DocField]) -> PyResult<Bound<'py, PyList>> {
    let list = PyList::empty(py);
    for field in fields {
        let default = field.default.as_ref().map_or_else(|| "null".to_owned(), ToString::to_string);
        list.append((field.name, field.kind.words(), field.text, field.optional.then_some(default)))?;
    }
    Ok(list)
}

/// Structs and enums of a pipeline by name: docs, and fields, or variants as (name, docs, whether fields have names,
/// fields).
#[pyfunction]
pub(crate) fn types<'py>(py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
    let mut docs_by_name: BTreeMap<&'static str, &'static Docs> = BTreeMap::new();
    collect_docs(&DocKind::Of(Docs::of::<Inner>()), &mut docs_by_name);
    for family in inventory::iter::<PluginFamily>() {
        for docs in (family.members)().iter().filter_map(|member| member.docs) {
            docs.fields().iter().for_each(|field| collect_docs(&field.kind, &mut docs_by_name));
        }
    }
    let entries = PyList::empty(py);
    for (name, docs) in docs_by_name {
        let entry = PyDict::new(py);
        entry.set_item("name", name)?;
        entry.set_item("doc", docs.text)?;
        match docs.body {
            DocBody::Fields(fields) => entry.set_item("fields", field_list(py, fields)?)?,
            DocBody::Variants(variants) => {
                let list = PyList::empty(py);
                for variant in variants {
                    list.append((variant.name, variant.text, variant.named, field_list(py, variant.fields)?))?;
                }
                entry.set_item("variants", list)?;
            }
        }
        entries.append(entry)?;
    }
    Ok(entries)
}

/// Adds the structs and enums in a type, at any depth, to `docs_by_name`, by name.
fn collect_docs(kind: &DocKind, docs_by_name: &mut BTreeMap<&'static str, &'static Docs>) {
    match kind {
        DocKind::Of(docs) => {
            if docs_by_name.insert(docs.name, docs).is_none() {
                match docs.body {
                    DocBody::Fields(fields) => fields.iter().for_each(|field| collect_docs(&field.kind, docs_by_name)),
                    DocBody::Variants(variants) => {
                        variants
                            .iter()
                            .flat_map(|v| v.fields)
                            .for_each(|field| collect_docs(&field.kind, docs_by_name));
                    }
                }
            }
        }
        DocKind::Optional(inner) | DocKind::List(inner) | DocKind::Map(inner) => collect_docs(inner, docs_by_name),
        DocKind::Tuple(parts) => parts.iter().for_each(|part| collect_docs(part, docs_by_name)),
        DocKind::Plain(_) | DocKind::Plugin(_) => {}
    }
}
