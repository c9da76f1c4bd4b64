//! `pwrfgs update`: adds new measurements to the residual process of a trained model.

use super::init::unknown_folder_error;
use super::options::read_models;
use crate::output::Verbosity;
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::experiment::text::grouped;
use pwrfgs::experiment::{Agreement, check_alike, staged, warn_of_findings};
use pwrfgs::model::file;
use pwrfgs_core::files::{check_new_file, create};
use pwrfgs_core::messages::strip_control;
use pwrfgs_core::{Dataset, Error, MeasurementSetup, Receiver, Result, recognise};
use std::path::{Path, PathBuf};
use std::time::Instant;

#[derive(Debug, Args)]
#[command(after_help = "\
The model needs a residual process (residuals: Kriged() in its pipeline). All links of the new data
become known links. Nothing is trained: the Gaussians, the network and the correlation stay.
The data need the observations, receivers and frequencies of the model, and most links must lie
inside its 99 % intervals. A model without calibration of intervals prints the distances only.

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
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,
    /// Accept data that are far from the model, such as after a change of the room
    #[arg(long, value_name = "FINDING", value_parser = [FAR])]
    pub(crate) accept: Vec<String>,
}

/// Name of the finding that most links lie outside the intervals of the model.
const FAR: &str = "far-from-model";

/// Runs `pwrfgs update`: writes the model with the new links, unless the data are far from it.
pub(crate) fn update(arguments: &Update, verbosity: Verbosity) -> Result<()> {
    check_new_file(&arguments.out)?;
    let model = read_models(std::slice::from_ref(&arguments.model))?;
    let Some(residuals) = model.residuals() else {
        let problem = "has no residual process; set `residuals: Kriged()` in its pipeline and run it again";
        return Err(Error::input(&arguments.model, problem));
    };
    let source = recognise(&arguments.data).ok_or_else(|| unknown_folder_error(&arguments.data))?;
    let mut progress = RunProgress::new(verbosity);
    let data = staged(&mut progress, "new data", |progress| source.load(Path::new(""), progress))?;
    let ready = model.prepare();
    check_alike(&ready, &data)?;
    if !data.placed || data.features.is_some() {
        return Err(Error::input(&arguments.data, "no transmitter positions; give data with positions"));
    }
    check_poses(ready.setup(), &data).map_err(|problem| Error::input(&arguments.data, problem))?;
    warn_of_findings(&data, None, &mut progress)?;
    let agreement = Agreement::measure(&model, &data, &mut progress)?;
    if agreement.is_far() && arguments.accept.is_empty() {
        let problem = format!(
            "new data are far from the model: {agreement}; check the order, units, axes and poses of the data, or add \
             `--accept {FAR}` if the room has changed"
        );
        return Err(Error::input(&arguments.data, problem));
    }
    verbosity.print_note(&format!("new data against the model: {agreement}"));
    let begun = Instant::now();
    let (updated, added) = residuals.updated(&model, &data)?;
    let updated = model.clone().with_residuals(Some(updated)).with_calibration(model.calibration().cloned());
    progress.remove_bar();
    if added == 0 {
        return Err(Error::input(&arguments.data, "no link at a receiver with a residual process"));
    }
    let milliseconds = 1e3 * begun.elapsed().as_secs_f64() / added as f64;
    create(&arguments.out, &file::ensemble_to_bytes(&updated))?;
    let things = data.task().counted[usize::from(added != 1)];
    let out = arguments.out.display();
    verbosity.print_note(&format!("{} new {things} in {out}, {milliseconds:.2} ms each", grouped(added as i64)));
    Ok(())
}

/// Rejects data in which a receiver has another pose than in the model; the error names the first one.
fn check_poses(setup: &MeasurementSetup, data: &Dataset) -> Result<(), String> {
    let mut pairs = setup.receivers.iter().zip(&data.scene.receivers);
    let is_moved = |(receiver, other): &(&Receiver, &Receiver)| {
        setup.origin.world_pose(receiver.pose) != data.scene.origin.world_pose(other.pose)
    };
    pairs.find(is_moved).map_or(Ok(()), |(_, receiver)| {
        let name = strip_control(&receiver.name);
        Err(format!("receiver `{name}` has another pose than in the model; give data of the same receivers"))
    })
}
