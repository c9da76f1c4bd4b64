//! What can be said on the command line; each verb's own words stand beside what it does, in `commands`. The help texts are
//! the first documentation that a user meets.

use crate::commands::Inspect;
#[cfg(feature = "raytrace")]
use crate::commands::Simulate;
#[cfg(feature = "viewer")]
use crate::commands::View;
use crate::commands::{Check, Completions, Evaluate, Export, Import, Init, Man, Plugins, Predict, Run, Sweep};
#[cfg(feature = "report")]
use crate::commands::{Map, Report};
use clap::{ArgAction, Parser, Subcommand};
use pwrfgs_core::threads::COUNTS;

/// How much is said.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd)]
pub(crate) enum Verbosity {
    /// Errors and results.
    Quiet,
    /// Progress too.
    Normal,
    /// What happens inside too.
    Verbose,
}

#[derive(Debug, Parser)]
#[command(
    name = "pwrfgs",
    version,
    about = "Pruned 3D Gaussian splatting for wireless radiance fields",
    long_about = "Pruned 3D Gaussian splatting for wireless radiance fields (P-WRFGS).\n\nLearns, from what was \
        measured at known transmitter positions (spatial spectra, received powers or channels), a small set of Gaussians \
        that predicts it at any other position. An experiment is one RON file, a pipeline; a run of it is one folder.",
    after_long_help = "EXAMPLES\n  A first run, without any download, in about a minute:\n      pwrfgs run \
        pipelines/quickstart.ron\n  The same with other settings, elsewhere:\n      pwrfgs run pipelines/quickstart.ron \
        --scale 0.25 --set seed=1 --out runs/short\n  What a transmitter at 3.5, 2.2, 1.2 m would be heard \
        from:\n      pwrfgs predict runs/quickstart/model.safetensors --tx 3.5,2.2,1.2 --out heard\n  Everything that a \
        pipeline may name:\n      pwrfgs plugins\n\nEXIT CODES\n  0 done, 1 failed, 2 wrong input, 130 interrupted \
        (the same command goes on)."
)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    pub(crate) command: Command,
    /// Threads to use [default: all processors]; results do not depend on it
    #[arg(long, global = true, value_name = "N", value_parser = count)]
    pub(crate) threads: Option<usize>,
    /// Say less: errors and results only
    #[arg(short, long, global = true, action = ArgAction::SetTrue, conflicts_with = "verbose")]
    quiet: bool,
    /// Say more: what happens inside
    #[arg(short, long, global = true, action = ArgAction::SetTrue)]
    verbose: bool,
}

/// A number of threads or jobs.
pub(crate) fn count(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(count) if COUNTS.contains(&count) => Ok(count),
        _ => Err(format!("give a number from {} to {}", COUNTS.start(), COUNTS.end())),
    }
}

/// `a,b,c`: as many numbers as are wanted.
pub(crate) fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|t| t.trim().parse().ok()).collect();
    numbers?.try_into().ok()
}

impl Arguments {
    pub(crate) fn verbosity(&self) -> Verbosity {
        match (self.quiet, self.verbose) {
            (true, _) => Verbosity::Quiet,
            (_, true) => Verbosity::Verbose,
            _ => Verbosity::Normal,
        }
    }
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Train, prune, evaluate and report: everything a pipeline says
    Run(Run),
    /// Say what a pipeline would do, and the memory and time it would take; train nothing
    Check(Check),
    /// Run every combination of an experiment with every seed: an ablation
    Sweep(Sweep),
    /// Predict spectra, received powers or channels for transmitter positions with a trained model
    Predict(Predict),
    #[cfg(feature = "report")]
    /// Map what a trained model predicts over a plane: power, level or strongest direction, as pictures and arrays
    Map(Map),
    #[cfg(feature = "viewer")]
    /// Open a page where the transmitter can be dragged and the spectrum follows; compare two models
    View(View),
    /// Score a trained model, and the baselines beside it, on data of your choice
    Evaluate(Evaluate),
    #[cfg(feature = "report")]
    /// Compare finished runs: tables and figures as HTML, CSV and LaTeX
    Report(Report),
    /// Write a trained model for other programs: splat viewers, Python
    Export(Export),
    /// Make a data set of your own spectra: NumPy arrays or PNG pictures, and positions
    Import(Import),
    #[cfg(feature = "raytrace")]
    /// Simulate what is measured in a room that is known exactly, in the layout of measured data
    Simulate(Simulate),
    /// Show everything that a pipeline may name: plugins, settings, defaults, what each field does
    Plugins(Plugins),
    /// Look at data before training: pictures, positions, splits with floors and ceiling, whether the pose can be right
    Inspect(Inspect),
    /// Write a commented pipeline for the data in a folder
    Init(Init),
    /// Print a script that completes commands and options in bash, zsh, fish, elvish or PowerShell
    Completions(Completions),
    /// Print the manual page, or write all of them into a folder
    Man(Man),
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    #[test]
    fn the_command_line_is_consistent() {
        super::Arguments::command().debug_assert();
    }
}
