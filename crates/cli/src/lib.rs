//! Command line of pwrfgs: arguments, progress, exit codes. [`main`] is the whole program: a program with further
//! plugins is `use my_plugin as _;` and a call.
//!
//! Exit codes: 0 done; 1 failed (disk full, numbers not finite); 2 invalid input; 130 interrupted.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod commands;
mod interrupt;
mod output;
mod program;
mod progress;
mod reference;

use clap::{ArgAction, CommandFactory as _, Parser};
use commands::{Command, set_device};
use output::{FAILED, INTERRUPTED, INVALID, Verbosity};
use pwrfgs_core::device::{self, DeviceChoice};
use pwrfgs_core::threads::parse_count;
use pwrfgs_core::{Error, Result};
use std::ffi::OsString;
use std::process::ExitCode;

#[derive(Debug, Parser)]
#[command(
    name = "pwrfgs",
    version = pwrfgs::experiment::VERSION,
    about = "Predict spatial spectra, received powers or channels with pruned 3D Gaussians (P-WRFGS)",
    after_help = "\
EXAMPLES
  pwrfgs run quickstart                                 # about a minute on two cores
  pwrfgs run quickstart --scale 0.25 --set seed=1 --out runs/short
  pwrfgs predict runs/quickstart --tx 3.5,2.2,1.2 --out predicted
  pwrfgs plugins                                        # plugins and settings of a pipeline

EXIT CODES
  0 done, 1 failed, 2 invalid input, 130 interrupted (repeat the command)"
)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
    /// Number of threads, without effect on results [default: all processors]
    #[arg(long, global = true, value_name = "N", value_parser = parse_count)]
    threads: Option<usize>,
    /// Device for rendering and for the networks `Mlp`, `Wrfgs` and `Nerf2`: cpu, gpu, auto, or a number from `pwrfgs devices`
    /// [default: environment variable `PWRFGS_DEVICE`, or cpu]
    #[arg(long, global = true, value_name = "DEVICE")]
    device: Option<DeviceChoice>,
    /// Print only errors, warnings and results
    #[arg(short, long, global = true, action = ArgAction::SetTrue, conflicts_with = "verbose")]
    quiet: bool,
    /// Print debug output
    #[arg(short, long, global = true, action = ArgAction::SetTrue)]
    verbose: bool,
}

impl Arguments {
    /// Returns the amount of output that `--quiet` and `--verbose` select.
    fn verbosity(&self) -> Verbosity {
        match (self.quiet, self.verbose) {
            (true, _) => Verbosity::Quiet,
            (_, true) => Verbosity::Verbose,
            _ => Verbosity::Normal,
        }
    }
}

/// Runs the program with the command line of the process; returns its exit code.
pub fn main() -> ExitCode {
    ExitCode::from(run(&std::env::args_os().collect::<Vec<_>>()))
}

/// Parses these arguments, of which the first is the path of the program, and runs the command; returns the exit code.
/// Prints one message on failure. Invalid arguments and `--help` end the process.
pub fn run(arguments: &[OsString]) -> u8 {
    keep_freed_memory();
    if let Err(error) = check_utf8(arguments) {
        output::print_error(&error);
        return INVALID;
    }
    program::set_path(arguments.first());
    interrupt::survive_file_limit();
    let arguments = Arguments::parse_from(arguments);
    let (threads, chosen, verbosity) = (arguments.threads, arguments.device, arguments.verbosity());
    output::start_logging(verbosity);
    let outcome = set_threads(threads)
        .and_then(|()| set_device(chosen))
        .and_then(|()| interrupt::start_listener())
        .and_then(|()| arguments.command.execute(threads, verbosity, Arguments::command()))
        .and_then(|code| device::check().map(|()| code));
    interrupt::wait_if_ending();
    outcome.unwrap_or_else(|error| match error {
        Error::Stopped => {
            output::print_note("stopped without output; repeat the command to start again");
            INTERRUPTED
        }
        error => {
            output::print_error(&error);
            if error.is_input() { INVALID } else { FAILED }
        }
    })
}

/// Rejects arguments and a current directory that are not UTF-8: pipelines and run folders store paths as text.
fn check_utf8(arguments: &[OsString]) -> Result<()> {
    let current = std::env::current_dir().unwrap_or_default().into_os_string();
    let mut texts = arguments.iter().skip(1).chain([&current]);
    texts.find(|text| text.to_str().is_none()).map_or(Ok(()), |text| {
        let text = text.to_string_lossy().into_owned();
        Err(Error::Config(format!("{text}: not UTF-8; rename the file or folder")))
    })
}

/// Sets the number of threads of the process to `count`. Without it, checks the environment variable that sets the
/// number, by default all processors.
fn set_threads(count: Option<usize>) -> Result<()> {
    let Some(count) = count else { return pwrfgs_core::threads::check_environment() };
    rayon::ThreadPoolBuilder::new()
        .num_threads(count)
        .build_global()
        .map_err(|e| Error::Config(format!("--threads {count}: {e}")))
}

/// Configures the allocator of glibc on Linux to keep freed memory for the next step; does nothing on other systems.
///
/// A step of 50,000 Gaussians allocates about 100 MB. By default, the C library returns blocks of that size to the
/// system and the kernel clears them again, which takes 15 % of the processor time (measured); with this setting it
/// takes 2 %.
fn keep_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        const BYTES: libc::c_int = 1 << 30; // above every block of a step
        for option in [libc::M_MMAP_THRESHOLD, libc::M_TRIM_THRESHOLD] {
            #[allow(unsafe_code)]
            // SAFETY: two settings of the allocator, made before a thread of this program runs; a refused one changes nothing.
            unsafe {
                libc::mallopt(option, BYTES);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    #[test]
    fn command_line_definition_is_consistent() {
        super::Arguments::command().debug_assert();
    }
}
