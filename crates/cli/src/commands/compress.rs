//! `pwrfgs compress`: writes a smaller model file.

use super::options::in_file;
use crate::output::Verbosity;
use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser as _};
use pwrfgs::model::compress::Bits;
use pwrfgs::tasks::compress::{CompressedModel, compress as compress_model};
use pwrfgs::tasks::read_models;
use pwrfgs_core::Result;
use pwrfgs_core::files::{check_new_file, create};
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "\
8   weight matrices of networks in 8 bits with a scale per row, everything else as with 16
16  everything in 16 bits, except Kriged residuals and constants
Kriged residuals (`residuals: Kriged()`) and constants keep their full precision.
All commands that read a model file, and the Python package, read the new file. The command prints
both file sizes and the mean absolute difference of predictions at up to 200 training positions.
The new file lacks the calibration that `predict --interval` needs, because this calibration is
valid only for the original model.

EXAMPLES
  pwrfgs compress runs/quickstart --out small.safetensors
  pwrfgs evaluate small.safetensors --pipeline runs/quickstart/pipeline.ron")]
pub(crate) struct Compress {
    /// Run folder, model file or name of a model in `pwrfgs pipelines`, such as s23
    #[arg(value_name = "MODEL")]
    pub(crate) model: PathBuf,
    /// Model file to write; must not exist
    #[arg(short, long, value_name = "FILE")]
    pub(crate) out: PathBuf,
    /// Bits per network weight
    #[arg(long, default_value = "8", value_parser = PossibleValuesParser::new(["8", "16"]).map(|bits| parse_bits(&bits)))]
    pub(crate) bits: Bits,
}

/// Converts one of the texts 8 and 16.
fn parse_bits(text: &str) -> Bits {
    if text == "8" { Bits::Eight } else { Bits::Sixteen }
}

/// Runs `pwrfgs compress`: writes the smaller model file, and prints the sizes and the change of predictions.
pub(crate) fn compress(arguments: &Compress, verbosity: Verbosity) -> Result<()> {
    check_new_file(&arguments.out)?;
    let ensemble = read_models(std::slice::from_ref(&arguments.model))?;
    let CompressedModel { bytes, mut notes, .. } =
        compress_model(&ensemble, arguments.bits).map_err(in_file(&arguments.model))?;
    create(&arguments.out, &bytes)?;
    notes[0] = format!("{}, in {}", notes[0], arguments.out.display());
    notes.iter().for_each(|note| verbosity.print_note(note));
    Ok(())
}
