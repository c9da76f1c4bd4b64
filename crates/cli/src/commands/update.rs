//! `pwrfgs update`: adds new measurements to the residual process of a trained model.

use super::options::in_file;
use crate::output::Verbosity;
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::experiment::text::grouped;
use pwrfgs::experiment::{folder::PIPELINE, load_split_data, pipeline_of_model, read_pipeline, run_stage};
use pwrfgs::model::file;
use pwrfgs::tasks::init::unknown_folder_error;
use pwrfgs::tasks::read_models;
use pwrfgs::tasks::update::{UpdatedModel, check_residuals, update as update_model};
use pwrfgs_core::files::{check_new_file, create};
use pwrfgs_core::{Dataset, Error, Result, recognise};
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
#[command(after_help = "\
Kriged residuals correct a prediction by the differences between measurements and predictions at
nearby transmitters. A model file with Kriged residuals stores these differences. The command adds
those of the new data. Nothing is trained: the Gaussians, the network and the correlation function
of Kriging stay unchanged. Without --data, the command adds the test set of the run. Do this after
the model is scored: the new model then predicts from all measurements.
The new data need the kind of observation, the receivers and the frequencies of the model. They are
the finding far-from-model if most of them lie outside the 99 % prediction intervals of the model,
or farther from its training positions than these extend. For a model without calibrated intervals,
the command only prints how well the new data agree with the predictions.

EXAMPLES
  pwrfgs update runs/lab --out final.safetensors
  pwrfgs update runs/lab --data data/today --out today.safetensors")]
pub(crate) struct Update {
    /// Run folder or model file, with Kriged residuals
    #[arg(value_name = "MODEL")]
    pub(crate) model: PathBuf,
    /// Folder of new data (layouts in docs/data.md) [default: test set of the run folder]
    #[arg(long, value_name = "DIR")]
    pub(crate) data: Option<PathBuf>,
    /// Model file to write; must not exist
    #[arg(short, long, value_name = "FILE")]
    pub(crate) out: PathBuf,
    /// Continue despite this finding (a fault in the data that an error names), such as far-from-model; repeatable
    #[arg(long, value_name = "FINDING")]
    pub(crate) accept: Vec<String>,
}

/// Runs `pwrfgs update`: writes the model with the new links. Data with a finding that is not accepted are an error.
pub(crate) fn update(arguments: &Update, verbosity: Verbosity) -> Result<()> {
    check_new_file(&arguments.out)?;
    let model = read_models(std::slice::from_ref(&arguments.model))?;
    check_residuals(&model).map_err(in_file(&arguments.model))?;
    let mut progress = RunProgress::new(verbosity);
    let (data, accepted) = load_new_data(arguments, &mut progress)?;
    let updated = update_model(&model, &data, &accepted, &mut progress);
    let source = arguments.data.as_ref().unwrap_or(&arguments.model);
    let UpdatedModel { ensemble, added, agreement, milliseconds } = updated.map_err(in_file(source))?;
    progress.remove_bar();
    verbosity.print_note(&format!("new data against the model: {agreement}"));
    create(&arguments.out, &file::ensemble_to_bytes(&ensemble))?;
    let things = data.task().counted[usize::from(added != 1)];
    let out = arguments.out.display();
    verbosity.print_note(&format!("{} new {things} in {out}, {milliseconds:.2} ms each", grouped(added as i64)));
    Ok(())
}

/// Loads the data of `--data`, or the test set of the run. Also returns the names of accepted findings.
fn load_new_data(arguments: &Update, progress: &mut RunProgress) -> Result<(Dataset, Vec<String>)> {
    let accepted = arguments.accept.clone();
    let Some(folder) = &arguments.data else {
        let advice = "use the model of a run folder, or give --data DIR";
        let missing = || Error::input(&arguments.model, format!("no {PIPELINE} next to this model; {advice}"));
        let pipeline = read_pipeline(&pipeline_of_model(&arguments.model)?.ok_or_else(missing)?, &[])?;
        let split = load_split_data(&pipeline, progress)?;
        return Ok((split.data.into_subset(&split.partition.test)?, [pipeline.accept, accepted].concat()));
    };
    let source = recognise(folder).ok_or_else(|| unknown_folder_error(folder))?;
    let data = run_stage(progress, "new data", |progress| source.load(Path::new(""), progress))?;
    Ok((data, accepted))
}
