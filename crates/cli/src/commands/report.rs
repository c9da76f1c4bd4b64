//! `pwrfgs report`: finished runs become tables and figures.

use crate::args::{Report, Verbosity};
use crate::output;
use crate::progress::Progress;
use pwrfgs::experiment::study::{self, Options, Study};
use pwrfgs_core::Result;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Where the report of a sweep lies, below its folder.
const FOLDER: &str = "report";

pub(crate) fn report(arguments: &Report, verbosity: Verbosity) -> Result<ExitCode> {
    let out = arguments.out.clone().unwrap_or_else(|| arguments.runs[0].join(FOLDER));
    compare(&arguments.runs, &Options { reference: arguments.reference.clone() }, &out, verbosity)?;
    Ok(ExitCode::SUCCESS)
}

/// The report of a whole sweep, as it is written when its last run has ended.
pub(super) fn of_sweep(folder: &Path, verbosity: Verbosity) -> Result<()> {
    compare(&[folder.into()], &Options::default(), &folder.join(FOLDER), verbosity)
}

fn compare(runs: &[PathBuf], options: &Options, out: &Path, verbosity: Verbosity) -> Result<()> {
    let study = Study::read(runs)?;
    let mut progress = Progress::new(verbosity);
    let written = study::write(&study, options, out, &mut progress);
    progress.finish();
    output::result(&format!("{}\nreport: {}\n", written?, out.join("report.html").display()));
    Ok(())
}
