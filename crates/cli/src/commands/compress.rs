//! `pwrfgs compress`: writes a smaller model file.

use crate::output::Verbosity;
use clap::{Args, ValueEnum};
use pwrfgs::experiment::text::grouped;
use pwrfgs::model::{Model, compress, file};
use pwrfgs_core::files::{check_new_file, write_atomically};
use pwrfgs_core::{Error, Query, Result, rng::evenly};
use std::path::PathBuf;

/// Number of training positions at which predictions are compared.
const COMPARED: usize = 200;

#[derive(Debug, Args)]
#[command(after_help = "\
8   network weights in 8 bits with a scale per row, everything else in 16 bits
16  everything in 16 bits
All commands, Python and pages read the file. The command prints both sizes and the mean difference
of predictions at up to 200 training positions. Ensembles are refused: compress each member.

EXAMPLES
  pwrfgs compress runs/quickstart/model.safetensors --out small.safetensors
  pwrfgs evaluate small.safetensors --pipeline runs/quickstart/pipeline.ron")]
pub(crate) struct Compress {
    /// Trained model (model.safetensors of a run)
    #[arg(value_name = "MODEL")]
    pub(crate) model: PathBuf,
    /// Model file to write; must not exist
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,
    /// Bits per network weight
    #[arg(long, default_value = "8")]
    pub(crate) bits: Bits,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Bits {
    #[value(name = "8")]
    Eight,
    #[value(name = "16")]
    Sixteen,
}

pub(crate) fn compress(arguments: &Compress, verbosity: Verbosity) -> Result<()> {
    check_new_file(&arguments.out)?;
    let ensemble = file::read_ensemble(&arguments.model)?;
    if ensemble.residuals().is_some() {
        return Err(Error::input(&arguments.model, "has a residual process, expected a model without one"));
    }
    let count = ensemble.members().len();
    let several = || format!("holds an ensemble of {count} models, expected one; compress the file of each member");
    let model = ensemble.into_only().ok_or_else(|| Error::input(&arguments.model, several()))?;
    let bits = match arguments.bits {
        Bits::Eight => compress::Bits::Eight,
        Bits::Sixteen => compress::Bits::Sixteen,
    };
    let (before, after) = (file::to_bytes(&model), compress::to_bytes(&model, bits)?);
    let small = file::from_bytes(&after).map_err(|why| Error::input(&arguments.model, why))?;
    write_atomically(&arguments.out, &after)?;
    let kilobytes = |bytes: usize| grouped(bytes.div_ceil(1000) as i64);
    verbosity.note(&format!(
        "whole file {} kB instead of {} kB, in {}",
        kilobytes(after.len()),
        kilobytes(before.len()),
        arguments.out.display()
    ));
    if let Some(difference) = difference(&model, &small.members()[0]) {
        verbosity.note(&difference);
    }
    Ok(())
}

/// Returns a line on the mean difference of predictions at training positions, if the model has any.
fn difference(model: &Model, small: &Model) -> Option<String> {
    let training = model.training_positions.as_ref()?;
    let origin = model.stages.origin;
    let places: Vec<[f64; 3]> = evenly(training.positions(), COMPARED).into_iter().map(|p| origin.world(p)).collect();
    let queries: Vec<Query<'_>> = places.iter().map(|place| (*place).into()).collect();
    let [a, b] = [model, small].map(|model| model.prepare().predict_many(&queries));
    let pairs = a.iter().zip(&b).flat_map(|(a, b)| a.pixels.iter().zip(&b.pixels));
    let (sum, count) =
        pairs.fold((0.0, 0usize), |(sum, count), (a, b)| (sum + f64::from((a - b).abs() as f32), count + 1));
    Some(format!(
        "mean difference of predictions at {} training positions: {:.2e}",
        places.len(),
        sum / count.max(1) as f64
    ))
}
