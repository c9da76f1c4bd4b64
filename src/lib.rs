//! pwrfgs: pruned 3D Gaussian splatting for wireless radiance fields.
//!
//! This crate combines the others and links the built-in plugins: programs that use it can read every name that `pwrfgs
//! plugins` prints. A custom plugin is a struct, a trait and a two-line program:
//!
//! ```no_run
//! use pwrfgs::prelude::*;
//! # fn main() -> Result<()> {
//! let text = std::fs::read_to_string("pipelines/quickstart.ron").expect("run in the checkout");
//! let pipeline = Pipeline::parse(&text, "pipelines/quickstart.ron".as_ref())?;
//! let stop = std::sync::atomic::AtomicBool::new(false);
//! let outcome = pwrfgs::run(&pipeline, "pipelines".as_ref(), "runs/first".as_ref(), &mut NoopObserver, &stop)?;
//! println!("{outcome:?}");
//! # Ok(())
//! # }
//! ```

pub use pwrfgs_core as core;
pub use pwrfgs_data as data;
pub use pwrfgs_experiment as experiment;
pub use pwrfgs_init as init;
pub use pwrfgs_localise as localise;
pub use pwrfgs_methods as methods;
pub use pwrfgs_metrics as metrics;
pub use pwrfgs_model as model;
pub use pwrfgs_networks as networks;
pub use pwrfgs_pipeline as pipeline;
pub use pwrfgs_planning as planning;
pub use pwrfgs_prune as prune;
pub use pwrfgs_raster as raster;
#[cfg(feature = "raytrace")]
pub use pwrfgs_raytrace as raytrace;
#[cfg(feature = "report")]
pub use pwrfgs_report as report;
pub use pwrfgs_tasks as tasks;
pub use pwrfgs_train as train;
#[cfg(feature = "viewer")]
pub use pwrfgs_viewer as viewer;

pub mod device;
pub mod foreign;
mod shipped;

use prelude::{Observer, Pipeline, Result};
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// Function that creates the report of a run; `None` without the feature `report`.
#[cfg(feature = "report")]
pub const PAGE: Option<experiment::PageBuilder> = Some(report::page);
/// Function that creates the report of a run; `None` without the feature `report`.
#[cfg(not(feature = "report"))]
pub const PAGE: Option<experiment::PageBuilder> = None;

/// Runs a pipeline, see [`experiment::run`], with the report of this build. The finished run keeps no checkpoint.
///
/// # Errors
/// Same as [`experiment::run`].
pub fn run(
    pipeline: &Pipeline,
    base: &Path,
    out: &Path,
    observer: &mut dyn Observer,
    stop: &AtomicBool,
) -> Result<experiment::RunOutcome> {
    let session = experiment::Session::new(observer);
    experiment::run(pipeline, base, out, &mut experiment::Session { stop, page: PAGE, ..session })
}

/// Imports for plugins and small programs.
pub mod prelude {
    pub use pwrfgs_core::schemars;
    pub use pwrfgs_core::tape::{Trace, TraceScalar, TracedCloud};
    pub use pwrfgs_core::{
        Baseline, Budget, CloudEdit, CloudStats, ColumnSpec, DataSource, Dataset, Deformation, Deltas, Elevation, End,
        Ends, Error, Evaluation, FittingSet, Gate, GaussianCloud, Goal, Image, ImagePlane, Initializer, JsonSchema,
        Link, Location, Measurement, MeasurementSetup, Method, Metric, Needs, Observations, Origin, Partition,
        PassStatistics, Phase, Plugin, Pose, Predict, Primitives, Progress, Projector, Pruner, PrunerTraits, Query,
        Rasterizer, Real, Receiver, Render, Result, RowOrigin, Sample, Sampling, Scene, Scope, Simulation, Spectra,
        Splats, Split, Statistic, StepContext, Task, Values, rng,
    };
    pub use pwrfgs_experiment::{NoopObserver, Observer};
    pub use pwrfgs_methods::Readout;
    pub use pwrfgs_model::{Ensemble, Model, Prepared, Stages};
    pub use pwrfgs_pipeline::Pipeline;
    pub use pwrfgs_train::{StepReport, Trainer};
    pub use serde::{Deserialize, Serialize};
    pub use typetag;
}

/// Examples of the plugin page, compiled and run as tests.
#[cfg(doctest)]
#[doc = include_str!("../docs/plugins.md")]
mod plugins_page {}
