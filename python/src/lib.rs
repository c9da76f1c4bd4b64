//! Compiled part of the Python package: `pwrfgs._pwrfgs`. The public interface is in `python/pwrfgs`; this crate has
//! the classes and functions that it wraps, one file each.
//!
//! Three rules: work runs without the interpreter lock (`border::without_gil`), errors become exceptions with their text,
//! and panics never cross into Python.

#![allow(clippy::needless_pass_by_value)] // arguments come out of Python by value
#![allow(clippy::doc_markdown)] // comments on what Python sees are its docstrings
#![allow(rustdoc::broken_intra_doc_links)] // [N] is a shape
#![allow(clippy::elidable_lifetime_names)] // 'py is the interpreter's, by the library's own custom

mod arrays;
mod border;
mod compare;
mod data;
mod device;
mod inspect;
mod kernels;
mod looped;
mod model;
mod preview;
mod run;
mod scores;
mod settings;
mod strategies;
mod sweep;
mod tasks;
mod view;

use pyo3::prelude::*;

#[pymodule]
mod _pwrfgs {
    #[pymodule_export]
    use super::compare::compare;
    #[pymodule_export]
    use super::data::Dataset;
    #[pymodule_export]
    use super::device::{devices, use_device};
    #[pymodule_export]
    use super::inspect::{default_pipeline, inspect};
    #[pymodule_export]
    use super::kernels::{Drawing, draw, project};
    #[pymodule_export]
    use super::looped::Trainer;
    #[pymodule_export]
    use super::model::Model;
    #[pymodule_export]
    use super::model::made::model_of;
    #[pymodule_export]
    use super::preview::check;
    #[pymodule_export]
    use super::run::{export_scene, facts, program, report, run, score, simulate};
    #[pymodule_export]
    use super::scores::{chamfer, measure, predict_baseline, repeatability};
    #[pymodule_export]
    use super::settings::{Pipeline, complete, parse_ron, pipeline_text, registry, types};
    #[pymodule_export]
    use super::sweep::{prepare_sweep, sweep};
    #[pymodule_export]
    use super::tasks::{
        calibrate, compress, findings, locate, place, plan, radio_map, suggest_pipeline, task_settings, update,
    };
    #[pymodule_export]
    use super::view::{View, view};
    use pyo3::prelude::*;

    // Records the process, registers the host of Python strategies, forwards warnings, and adds the constants of the
    // build.
    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        super::border::record_process(module.py())?;
        super::strategies::register_host();
        super::border::log_warnings();
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        module.add("real_bytes", size_of::<pwrfgs_core::Real>())
    }
}
