//! `pwrfgs report`: compares finished runs in tables and figures.

use crate::output::{self, Verbosity};
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::experiment::folder::{PIPELINE, REPORT};
use pwrfgs::experiment::rebuild_page;
use pwrfgs::report::{ReportOptions, Study, write};
use pwrfgs_core::Result;
use std::path::{Path, PathBuf};

/// Folder of the report, inside the folder of a sweep.
const FOLDER: &str = "report";

#[derive(Clone, Debug, Args)]
#[command(after_help = "\
Runs with different data or test sets get separate tables. Runs that differ only in the seed form a
variant: one row, with mean and standard deviation. Differences from the reference are paired by
test sample, with 95 % bootstrap intervals over seeds and blocks of neighbouring positions.
Unfinished runs are left out; a line names the first and counts the others.
The command writes report.html, report.csv, report.tex with one file per table, and figures as SVG,
PDF and PNG. It replaces the files of an older report. A folder of --out with other files and no
report is an error and stays unchanged. For a single run without --out, the command also rebuilds
report.html in the run folder.

EXAMPLES
  pwrfgs report runs/paper-office
  pwrfgs report runs/paper-office --reference 5-NN
  pwrfgs report runs/quarter runs/quarter-1 --out compared --columns ssim,gaussians,training_s")]
pub(crate) struct Report {
    /// Run folders or sweep folders
    #[arg(value_name = "RUNS", required = true)]
    pub(crate) runs: Vec<PathBuf>,
    /// Output folder [default: report in the first folder]
    #[arg(short, long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// Reference of paired differences.
    #[arg(
        long,
        value_name = "LABEL",
        help = "Row that the others are compared with: a variant (name in the table), a\nbaseline such as 5-NN, or a value on an axis of the experiment, such as Mine\nfor `pruner Mine, target_count 60`: each variant is then compared with the\none that differs only on this axis [default: first variant]"
    )]
    pub(crate) reference: Option<String>,
    /// Columns of the score table in LaTeX, such as ssim,ssim.median,gaussians.
    #[arg(
        long,
        value_name = "KEYS",
        value_delimiter = ',',
        help = "Columns of the score table in LaTeX, such as ssim,ssim.median,gaussians:\nkeys of report.csv [default: those of report.html]"
    )]
    pub(crate) columns: Vec<String>,
    /// Variants or methods in the figures, separated by `;`.
    #[arg(
        long,
        value_name = "NAMES",
        value_delimiter = ';',
        help = "Variants, or methods (variants whose names differ only in numbers),\nwith a curve in the figures, separated by `;`, at most 6\n[default: the best methods, and that of the reference]"
    )]
    pub(crate) variants: Vec<String>,
}

/// Runs `pwrfgs report`: writes the comparison; for a single run without `--out`, also the page of the run.
pub(crate) fn report(arguments: &Report, verbosity: Verbosity) -> Result<()> {
    let out = arguments.out.clone().unwrap_or_else(|| arguments.runs[0].join(FOLDER));
    let study = Study::read(&arguments.runs)?;
    if let ([run], None) = (&arguments.runs[..], &arguments.out)
        && run.join(PIPELINE).is_file()
    {
        rebuild_run_page(run, verbosity)?;
    }
    let Report { reference, columns, variants, .. } = arguments.clone();
    write_comparison(&study, &ReportOptions { reference, columns, variants }, &out, verbosity)
}

/// Writes the report of the sweep in `folder`, and prints its tables.
pub(super) fn report_sweep(folder: &Path, reference: Option<&str>, verbosity: Verbosity) -> Result<()> {
    let options = ReportOptions { reference: reference.map(str::to_owned), ..ReportOptions::default() };
    write_comparison(&Study::read(&[folder.into()])?, &options, &folder.join(FOLDER), verbosity)
}

/// Rebuilds the page of a run. If its input is invalid, such as missing data, it warns and keeps the old page.
fn rebuild_run_page(run: &Path, verbosity: Verbosity) -> Result<()> {
    match RunProgress::observe(verbosity, |progress| rebuild_page(run, pwrfgs::report::page, progress)) {
        Err(error) if error.is_input() => {
            output::print_warning(&format!("{} is not rebuilt: {error}", run.join(REPORT).display()));
            Ok(())
        }
        rebuilt => rebuilt,
    }
}

/// Writes the report of a study and prints its tables.
fn write_comparison(study: &Study, options: &ReportOptions, out: &Path, verbosity: Verbosity) -> Result<()> {
    let written = RunProgress::observe(verbosity, |progress| write(study, options, out, progress))?;
    output::print_result(&format!("{written}\nreport: {}\n", out.join(REPORT).display()))
}
