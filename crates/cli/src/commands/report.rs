//! `pwrfgs report`: finished runs become tables and figures.

use crate::output::{self, Verbosity};
use crate::progress::Progress;
use clap::Args;
use pwrfgs::experiment::folder::{PIPELINE, REPORT};
use pwrfgs::experiment::rebuild_page;
use pwrfgs::report::{Study, write};
use pwrfgs_core::Result;
use std::path::{Path, PathBuf};

/// Where the report of a sweep lies, below its folder.
const FOLDER: &str = "report";

#[derive(Debug, Args)]
#[command(
    after_long_help = "Runs on the same data and split form a setting, and are compared within it; those that differ in \
    their seed alone form a variant, and give a mean and a standard deviation. A single run's own page, report.html in its \
    folder, is made again too, unless --out is given.\n\nWrites report.html (one file), \
    report.csv (every number), report.tex with a file for each table (booktabs), and the figures as SVG, PDF and PNG. An \
    older report in the folder is replaced; a folder that holds anything else is never touched. Runs that have not \
    finished are named and left out.\n\nPaired differences from the reference carry a 95 % bootstrap interval over seeds \
    and blocks of space.\n\nEXAMPLES\n  pwrfgs report runs/lambda\n  pwrfgs report runs/cloud-0 runs/cloud-1 \
    runs/random-0 runs/random-1 --out compared\n  pwrfgs report runs/lambda --reference 5-NN"
)]
pub(crate) struct Report {
    /// Run folders, or folders of whole sweeps
    #[arg(value_name = "RUNS", required = true)]
    pub(crate) runs: Vec<PathBuf>,
    /// Where to write the report [default: report in the first of the folders]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// What paired differences are from: a variant as the table calls it, or a floor such as 5-NN [default: the first
    /// variant]
    #[arg(long, value_name = "LABEL")]
    pub(crate) reference: Option<String>,
}

pub(crate) fn report(arguments: &Report, verbosity: Verbosity) -> Result<()> {
    let out = arguments.out.clone().unwrap_or_else(|| arguments.runs[0].join(FOLDER));
    let study = Study::read(&arguments.runs)?;
    if let ([run], None) = (&arguments.runs[..], &arguments.out)
        && run.join(PIPELINE).is_file()
    {
        rebuild(run, verbosity)?;
    }
    compare(&study, arguments.reference.as_deref(), &out, verbosity)
}

/// The report of a whole sweep, as it is written when its last run has ended.
pub(super) fn of_sweep(folder: &Path, verbosity: Verbosity) -> Result<()> {
    compare(&Study::read(&[folder.into()])?, None, &folder.join(FOLDER), verbosity)
}

/// Makes the page of a run again; without its data the tables are worth having still.
fn rebuild(run: &Path, verbosity: Verbosity) -> Result<()> {
    match Progress::during(verbosity, |progress| rebuild_page(run, pwrfgs::report::page, progress)) {
        Err(error) if error.is_input() => {
            output::note(&format!("warning: {} is kept as it is: {error}", run.join(REPORT).display()));
            Ok(())
        }
        rebuilt => rebuilt,
    }
}

fn compare(study: &Study, reference: Option<&str>, out: &Path, verbosity: Verbosity) -> Result<()> {
    let written = Progress::during(verbosity, |progress| write(study, reference, out, progress))?;
    output::result(&format!("{written}\nreport: {}\n", out.join("report.html").display()))
}
