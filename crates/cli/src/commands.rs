//! The commands, one file a verb: what can be said to it, and what it does. The help texts are the first documentation
//! that a user meets.

mod check;
mod completions;
mod evaluate;
mod export;
mod import;
mod init;
#[cfg(feature = "report")]
mod map;
mod options;
mod plugins;
mod predict;
#[cfg(feature = "report")]
mod report;
mod run;
#[cfg(feature = "raytrace")]
mod simulate;
mod sweep;
#[cfg(feature = "viewer")]
mod view;

pub(crate) use options::count;

use crate::output::Verbosity;
use clap::Subcommand;
use pwrfgs_core::Result;
use std::process::ExitCode;

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Train, prune, evaluate and report: everything a pipeline says
    Run(run::Run),
    /// Say what a pipeline would do, and the memory and time it would take; train nothing
    Check(check::Check),
    /// Run every combination of an experiment with every seed: an ablation
    Sweep(sweep::Sweep),
    /// Predict spectra, received powers or channels for transmitter positions with a trained model
    Predict(predict::Predict),
    #[cfg(feature = "report")]
    /// Map what a trained model predicts over a plane: power, level or strongest direction, as pictures and arrays
    Map(map::Map),
    #[cfg(feature = "viewer")]
    /// Open a page where the transmitter can be dragged and the spectrum follows; compare two models
    View(view::View),
    /// Score a trained model, and the baselines beside it, on data of your choice
    Evaluate(evaluate::Evaluate),
    #[cfg(feature = "report")]
    /// Compare finished runs: tables and figures as HTML, CSV and LaTeX
    Report(report::Report),
    /// Write a trained model for other programs: splat viewers, Python
    Export(export::Export),
    /// Make a data set of your own spectra: NumPy arrays or PNG pictures, and positions
    Import(import::Import),
    #[cfg(feature = "raytrace")]
    /// Simulate what is measured in a room that is known exactly, in the layout of measured data
    Simulate(simulate::Simulate),
    /// Show everything that a pipeline may name: plugins, settings, defaults, what each field does
    Plugins(plugins::Plugins),
    /// Look at data before training: pictures, positions, splits with floors and ceiling, whether the pose can be right
    Inspect(check::Inspect),
    /// Write a commented pipeline for the data in a folder
    Init(init::Init),
    /// Print a script that completes commands and options in bash, zsh, fish, elvish or PowerShell
    Completions(completions::Completions),
    /// Print the manual page, or write all of them into a folder
    Man(completions::Man),
}

impl Command {
    /// Does it; `threads` is what `--threads` says, and `program` describes the whole command line.
    pub(crate) fn execute(
        &self,
        threads: Option<usize>,
        verbosity: Verbosity,
        program: impl FnOnce() -> clap::Command,
    ) -> Result<ExitCode> {
        match self {
            Self::Run(run) => return run::run(run, verbosity),
            Self::Sweep(sweep) => return sweep::sweep(sweep, threads, verbosity),
            #[cfg(feature = "raytrace")]
            Self::Simulate(simulate) => return simulate::simulate(simulate, verbosity),
            Self::Check(check) => check::check(check, verbosity),
            Self::Predict(predict) => predict::predict(predict, verbosity),
            #[cfg(feature = "report")]
            Self::Map(map) => map::map(map, verbosity),
            #[cfg(feature = "viewer")]
            Self::View(view) => view::view(view, verbosity),
            Self::Evaluate(evaluate) => evaluate::evaluate(evaluate, verbosity),
            #[cfg(feature = "report")]
            Self::Report(report) => report::report(report, verbosity),
            Self::Export(export) => export::export(export, verbosity),
            Self::Import(import) => import::import(import, verbosity),
            Self::Plugins(plugins) => plugins::plugins(plugins),
            Self::Inspect(inspect) => check::inspect(inspect, verbosity),
            Self::Init(init) => init::init(init, verbosity),
            Self::Completions(completions) => completions::completions(completions, program()),
            Self::Man(man) => completions::man(man, program()),
        }?;
        Ok(ExitCode::SUCCESS)
    }
}
