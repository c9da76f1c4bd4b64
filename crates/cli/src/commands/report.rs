//! `pwrfgs report`: finished runs become tables and figures.

use crate::args::{Report, Verbosity};
use crate::output;
use crate::progress::Progress;
use pwrfgs::experiment::study::{self, Options, Study};
use pwrfgs_core::Result;
use std::process::ExitCode;

pub(crate) fn report(arguments: &Report, verbosity: Verbosity) -> Result<ExitCode> {
    let out = arguments.out.clone().unwrap_or_else(|| arguments.runs[0].join("report"));
    study::check(&out)?;
    let study = Study::read(&arguments.runs)?;
    let options = Options { reference: arguments.reference.clone() };
    let mut progress = Progress::new(verbosity);
    let written = study::write(&study, &options, &out, &mut progress);
    progress.finish();
    output::result(&format!("{}\nreport: {}\n", written?, out.join("report.html").display()));
    Ok(ExitCode::SUCCESS)
}
