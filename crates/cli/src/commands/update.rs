//! `pwrfgs update`: adds new measurements to the residual process of a trained model.

use super::options::in_file;
use crate::output::Verbosity;
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::experiment::run_stage;
use pwrfgs::experiment::text::grouped;
use pwrfgs::model::file;
use pwrfgs::tasks::init::unknown_folder_error;
use pwrfgs::tasks::read_models;
use pwrfgs::tasks::update::{UpdatedModel, check_residuals, update as update_model};
use pwrfgs_core::files::{check_new_file, create};
use pwrfgs_core::{Result, recognise};
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
#[command(after_help = "\
The model needs a residual process (residuals: Kriged() in its pipeline). This process adds all
links of the new data to its measurements. Nothing is trained: the Gaussians, the network and the
correlation stay unchanged. The new data need the kind of observation, receivers and frequencies of
the model. Most links must lie inside its 99 % intervals. A model without calibration of intervals
prints the distances only.

EXAMPLES
  pwrfgs update runs/lab --data data/today --out today.safetensors")]
pub(crate) struct Update {
    /// Run folder or model file, with a residual process
    #[arg(value_name = "MODEL")]
    pub(crate) model: PathBuf,
    /// Folder of new data (layouts in docs/data.md)
    #[arg(long, value_name = "DIR")]
    pub(crate) data: PathBuf,
    /// Model file to write; must not exist
    #[arg(short, long, value_name = "FILE")]
    pub(crate) out: PathBuf,
    /// Accept a finding, such as far-from-model after a change of the room; repeatable
    #[arg(long, value_name = "FINDING")]
    pub(crate) accept: Vec<String>,
}

/// Runs `pwrfgs update`: writes the model with the new links, unless the data are far from it.
pub(crate) fn update(arguments: &Update, verbosity: Verbosity) -> Result<()> {
    check_new_file(&arguments.out)?;
    let model = read_models(std::slice::from_ref(&arguments.model))?;
    check_residuals(&model).map_err(in_file(&arguments.model))?;
    let source = recognise(&arguments.data).ok_or_else(|| unknown_folder_error(&arguments.data))?;
    let mut progress = RunProgress::new(verbosity);
    let data = run_stage(&mut progress, "new data", |progress| source.load(Path::new(""), progress))?;
    let updated = update_model(&model, &data, &arguments.accept, &mut progress);
    let UpdatedModel { ensemble, added, agreement, milliseconds } = updated.map_err(in_file(&arguments.data))?;
    progress.remove_bar();
    verbosity.print_note(&format!("new data against the model: {agreement}"));
    create(&arguments.out, &file::ensemble_to_bytes(&ensemble))?;
    let things = data.task().counted[usize::from(added != 1)];
    let out = arguments.out.display();
    verbosity.print_note(&format!("{} new {things} in {out}, {milliseconds:.2} ms each", grouped(added as i64)));
    Ok(())
}
