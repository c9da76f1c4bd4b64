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
8   network weights in 8 bits with a scale per row, everything else in 16 bits
16  everything in 16 bits
All commands, the Python package and the pages of `view --save` read the file. The command prints
both file sizes and the mean difference of predictions at up to 200 training positions. Residual
processes are stored unchanged.
The file lacks the calibration for predict --interval, which is valid only for the original model.

EXAMPLES
  pwrfgs compress runs/quickstart --out small.safetensors
  pwrfgs evaluate small.safetensors --pipeline runs/quickstart/pipeline.ron")]
pub(crate) struct Compress {
    /// Run folder, model file or model of the program, such as s23
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
