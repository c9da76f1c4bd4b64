//! `pwrfgs compress`: writes a smaller model file.

use super::options::read_models;
use crate::output::Verbosity;
use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser as _};
use pwrfgs::experiment::text::grouped;
use pwrfgs::model::compress::Bits;
use pwrfgs::model::{Model, compress, file};
use pwrfgs_core::files::{check_new_file, create};
use pwrfgs_core::{Error, Query, Result, Task, evenly};
use std::path::PathBuf;

/// Number of training positions at which predictions are compared.
const COMPARED: usize = 200;

#[derive(Debug, Args)]
#[command(after_help = "\
8   network weights in 8 bits with a scale per row, everything else in 16 bits
16  everything in 16 bits
All commands, Python and pages read the file. The command prints both sizes and the mean difference
of predictions at up to 200 training positions. Ensembles are refused: compress each member.
The calibration for predict --interval is left out, since it is that of the exact predictions.

EXAMPLES
  pwrfgs compress runs/quickstart --out small.safetensors
  pwrfgs evaluate small.safetensors --pipeline runs/quickstart/pipeline.ron")]
pub(crate) struct Compress {
    /// Run folder or model file
    #[arg(value_name = "MODEL")]
    pub(crate) model: PathBuf,
    /// Model file to write; must not exist
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,
    /// Bits per network weight
    #[arg(long, default_value = "8", value_parser = PossibleValuesParser::new(["8", "16"]).map(|bits| if bits == "8" { Bits::Eight } else { Bits::Sixteen }))]
    pub(crate) bits: Bits,
}

/// Runs `pwrfgs compress`: writes the smaller model file and prints what changed.
pub(crate) fn compress(arguments: &Compress, verbosity: Verbosity) -> Result<()> {
    check_new_file(&arguments.out)?;
    let ensemble = read_models(std::slice::from_ref(&arguments.model))?;
    if ensemble.residuals().is_some() {
        return Err(Error::input(&arguments.model, "has a residual process, expected a model without one"));
    }
    let before = file::size(&ensemble);
    let count = ensemble.members().len();
    let several = || format!("holds an ensemble of {count} models, expected one; compress the file of each member");
    let model = ensemble.into_only().ok_or_else(|| Error::input(&arguments.model, several()))?;
    let after = compress::to_bytes(&model, arguments.bits)?;
    let small = file::from_bytes(&after).map_err(|why| Error::input(&arguments.model, why))?;
    create(&arguments.out, &after)?;
    let kilobytes = |bytes: usize| grouped((bytes as f64 / 1e3).round() as i64);
    verbosity.print_note(&format!(
        "whole file {} kB instead of {} kB, in {}",
        kilobytes(after.len()),
        kilobytes(before),
        arguments.out.display()
    ));
    if let Some(difference) = describe_difference(&model, &small.members()[0]) {
        verbosity.print_note(&difference);
    }
    Ok(())
}

/// Describes the mean difference of the predictions of two models at training positions, over all receivers; `None` for
/// models without training positions.
fn describe_difference(model: &Model, small: &Model) -> Option<String> {
    let (training, stages) = (model.training_positions.as_ref()?, &model.stages);
    let positions: Vec<[f64; 3]> =
        evenly(training.positions(), COMPARED).into_iter().map(|p| stages.origin.world(p)).collect();
    let receivers = 0..stages.receivers.len();
    let queries: Vec<Query<'_>> =
        positions.iter().flat_map(|&tx| receivers.clone().map(move |r| stages.query(tx, r))).collect();
    let [a, b] = [model, small].map(|model| model.prepare().predict_many(&queries));
    let pairs = a.iter().zip(&b).flat_map(|(a, b)| a.pixels.iter().zip(&b.pixels));
    let differences: Vec<f64> = pairs.map(|(a, b)| f64::from((a - b).abs() as f32)).collect();
    let mean = differences.iter().sum::<f64>() / differences.len().max(1) as f64;
    let unit = if stages.task == Task::Power { " dB" } else { "" };
    Some(format!("mean difference of predictions at {} training positions: {mean:.2e}{unit}", positions.len()))
}
