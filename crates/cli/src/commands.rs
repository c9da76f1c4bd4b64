//! The commands, one file each: arguments, help text and action.

mod check;
mod compare;
mod completions;
mod compress;
mod data;
mod devices;
mod evaluate;
mod export;
mod import;
mod init;
#[cfg(feature = "report")]
mod locate;
#[cfg(feature = "report")]
mod map;
mod options;
mod pipelines;
#[cfg(feature = "report")]
mod place;
#[cfg(feature = "report")]
mod plan;
mod plugins;
mod predict;
#[cfg(feature = "report")]
mod report;
mod run;
#[cfg(feature = "raytrace")]
mod simulate;
mod sweep;
mod update;
#[cfg(feature = "viewer")]
mod view;

pub(crate) use devices::set_device;

use crate::output::{SUCCESS, Verbosity};
use clap::Subcommand;
use pwrfgs_core::Result;

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Train, prune and evaluate a pipeline
    Run(run::Run),
    /// List the pipelines and models in the program, or copy a pipeline
    Pipelines(pipelines::Pipelines),
    /// Validate a pipeline and estimate its memory and time
    Check(check::Check),
    /// Run all combinations and seeds of an experiment
    Sweep(sweep::Sweep),
    /// Compare all methods, baselines and your predictions on a data folder
    Compare(compare::Compare),
    /// Predict spectra, received powers or channels at transmitter positions
    Predict(predict::Predict),
    #[cfg(feature = "report")]
    /// Draw radio maps over a plane, as images and arrays
    Map(map::Map),
    #[cfg(feature = "report")]
    /// Locate transmitters from their spectra, received powers or channels
    Locate(locate::Locate),
    #[cfg(feature = "report")]
    /// Select positions to measure next
    Plan(plan::Plan),
    #[cfg(feature = "report")]
    /// Select positions of receivers with the largest coverage
    Place(place::Place),
    #[cfg(feature = "viewer")]
    /// Show predictions in a browser while you move the transmitter
    View(view::View),
    /// Score a trained model and the baselines on a data set
    Evaluate(evaluate::Evaluate),
    #[cfg(feature = "report")]
    /// Compare finished runs in tables and figures (HTML, CSV, LaTeX)
    Report(report::Report),
    /// Add new measurements to a model with Kriged residuals (`residuals: Kriged()`), without training
    Update(update::Update),
    /// Write a smaller model file, with 8 or 16 bits per number
    Compress(compress::Compress),
    /// Convert a trained model for splat viewers or Python
    Export(export::Export),
    /// Import spectra, received powers or channels from NumPy, PNG or CSV
    Import(Box<import::Import>),
    #[cfg(feature = "raytrace")]
    /// Simulate a data set in a room by ray tracing
    Simulate(simulate::Simulate),
    #[cfg(feature = "raytrace")]
    /// Write a scene as Mitsuba XML and PLY for Sionna RT
    ExportScene(simulate::ExportScene),
    /// List plugins and settings, or describe one of them
    Plugins(plugins::Plugins),
    /// List public data sets, or check a downloaded one
    Data(data::Data),
    /// List the GPUs of this machine for `--device`
    Devices,
    /// Check a data set before training, with splits and baselines
    Inspect(check::Inspect),
    /// Write a commented pipeline for the data in a folder
    Init(init::Init),
    /// Print a completion script for a shell
    Completions(completions::Completions),
    /// Print the manual page, or write all manual pages to a folder
    Man(completions::Man),
}

impl Command {
    /// Runs the command and returns the exit code of the program. `threads` is the value of `--threads`; `program`
    /// describes the whole command line.
    pub(crate) fn execute(&self, threads: Option<usize>, verbosity: Verbosity, program: clap::Command) -> Result<u8> {
        match self {
            Self::Run(run) => return run::run(run, verbosity),
            Self::Sweep(sweep) => return sweep::sweep(sweep, threads, verbosity),
            #[cfg(feature = "report")]
            Self::Plan(plan) => plan::plan(plan, verbosity),
            #[cfg(feature = "report")]
            Self::Place(place) => place::place(place, verbosity),
            Self::Compare(compare) => return compare::compare(compare, verbosity),
            #[cfg(feature = "raytrace")]
            Self::Simulate(simulate) => simulate::simulate(simulate, verbosity),
            #[cfg(feature = "raytrace")]
            Self::ExportScene(export) => simulate::export_scene(export, verbosity),
            Self::Check(check) => check::check(check, verbosity),
            Self::Predict(predict) => return predict::predict(predict, verbosity),
            #[cfg(feature = "report")]
            Self::Map(map) => map::map(map, verbosity),
            #[cfg(feature = "report")]
            Self::Locate(locate) => locate::locate(locate, verbosity),
            #[cfg(feature = "viewer")]
            Self::View(view) => view::view(view, verbosity),
            Self::Evaluate(evaluate) => return evaluate::evaluate(evaluate, verbosity),
            #[cfg(feature = "report")]
            Self::Report(report) => report::report(report, verbosity),
            Self::Update(update) => update::update(update, verbosity),
            Self::Compress(compress) => compress::compress(compress, verbosity),
            Self::Export(export) => export::export(export, verbosity),
            Self::Import(import) => import::import(import, verbosity),
            Self::Pipelines(pipelines) => pipelines::list_or_copy_pipelines(pipelines),
            Self::Plugins(plugins) => plugins::print_reference(plugins),
            Self::Data(data) => data::print_data(data, verbosity),
            Self::Devices => devices::print_devices(),
            Self::Inspect(inspect) => check::inspect(inspect, verbosity),
            Self::Init(init) => init::init(init, verbosity),
            Self::Completions(completions) => completions::print_completions(completions, program),
            Self::Man(man) => completions::write_manual(man, program),
        }?;
        Ok(SUCCESS)
    }
}
