//! The command line of pwrfgs: arguments, progress, exit codes. [`main`] is the whole program, so that a toolkit with
//! plugins of its own is `use my_plugin as _;` and a call.
//!
//! Exit codes: 0 done; 1 failed (disk full, numbers not finite); 2 wrong input; 130 interrupted.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod args;
mod commands;
mod interrupt;
mod memory;
mod output;
mod progress;
mod reference;

use args::{Arguments, Command};
use clap::Parser as _;
use std::process::ExitCode;

/// Reads the command line and does what it says; prints one message on failure.
pub fn main() -> ExitCode {
    memory::keep();
    if let Err(error) = check_utf8() {
        output::error(&error);
        return ExitCode::from(2);
    }
    interrupt::survive_file_limit();
    let arguments = Arguments::parse();
    output::start_logging(arguments.verbosity());
    let done = threads(arguments.threads).and_then(|()| interrupt::listen()).and_then(|()| match &arguments.command {
        Command::Run(run) => commands::run(run, arguments.verbosity()),
        Command::Check(check) => commands::check(check, arguments.verbosity()),
        Command::Sweep(sweep) => commands::sweep(sweep, arguments.threads, arguments.verbosity()),
        Command::Predict(predict) => commands::predict(predict, arguments.verbosity()),
        #[cfg(feature = "report")]
        Command::Map(map) => commands::map(map, arguments.verbosity()),
        #[cfg(feature = "viewer")]
        Command::View(view) => commands::view(view, arguments.verbosity()),
        Command::Evaluate(evaluate) => commands::evaluate(evaluate, arguments.verbosity()),
        #[cfg(feature = "report")]
        Command::Report(report) => commands::report(report, arguments.verbosity()),
        Command::Export(export) => commands::export(export, arguments.verbosity()),
        Command::Import(import) => commands::import(import, arguments.verbosity()),
        #[cfg(feature = "raytrace")]
        Command::Simulate(simulate) => commands::simulate(simulate, arguments.verbosity()),
        Command::Plugins(plugins) => commands::plugins(plugins),
        Command::Inspect(inspect) => commands::inspect(inspect, arguments.verbosity()),
        Command::Init(init) => commands::init(init, arguments.verbosity()),
        Command::Completions(completions) => commands::completions(completions),
        Command::Man(man) => commands::man(man),
    });
    interrupt::wait_if_ending();
    done.unwrap_or_else(|error| {
        output::error(&error);
        ExitCode::from(if error.is_input() { 2 } else { 1 })
    })
}

/// Refuses arguments and a current directory that are not UTF-8: pipelines and run folders store paths as text.
fn check_utf8() -> pwrfgs_core::Result<()> {
    let here = std::env::current_dir().unwrap_or_default().into_os_string();
    let mut all = std::env::args_os().skip(1).chain([here]);
    all.find(|text| text.to_str().is_none()).map_or(Ok(()), |text| {
        let text = text.to_string_lossy().into_owned();
        Err(pwrfgs_core::Error::Config(format!("{text}: not UTF-8; rename the file or folder")))
    })
}

/// Sets how many threads everything uses; without `count` the environment decides, or all processors are used.
fn threads(count: Option<usize>) -> pwrfgs_core::Result<()> {
    let Some(count) = count else { return pwrfgs_core::threads::check_environment() };
    rayon::ThreadPoolBuilder::new()
        .num_threads(count)
        .build_global()
        .map_err(|e| pwrfgs_core::Error::Config(format!("--threads {count}: {e}")))
}
