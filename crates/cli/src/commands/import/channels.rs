//! `pwrfgs import --channels`: converts arrays of channels into a data folder of channels or of powers.

use crate::output::Verbosity;
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::data::import::ChannelImport;
use pwrfgs::data::save;
use pwrfgs::experiment::{check_findings, observed};
use pwrfgs_core::{Pose, Result};
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
#[command(next_help_heading = "Channels")]
pub(crate) struct ChannelOptions {
    /// Channels (CSI): .npy, .npz or .npz:NAME; several are concatenated
    #[arg(long, value_name = "FILE", num_args = 1.., requires = "receiver", conflicts_with_all = ["elevation", "scale"])]
    pub(crate) channels: Vec<PathBuf>,
    /// Imaginary parts, if they are in files of their own
    #[arg(long, value_name = "FILE", num_args = 1.., requires = "channels")]
    pub(crate) imag: Vec<PathBuf>,
    /// Axes: positions m, antennas a, subcarriers f, parts ri or ir
    #[arg(long, value_name = "NAMES", default_value = "m,a,f", requires = "channels")]
    pub(crate) axes: String,
    /// Antenna positions in the receiver's frame, metres: as --tx
    #[arg(long, value_name = "FILE", requires = "channels")]
    pub(crate) antennas: Option<PathBuf>,
    /// Centre frequency of the subcarriers, Hz
    #[arg(long, value_name = "HZ", requires = "channels", allow_hyphen_values = true)]
    pub(crate) carrier_hz: Option<f64>,
    /// Subcarrier spacing, Hz
    #[arg(long, value_name = "HZ", requires = "channels", allow_hyphen_values = true)]
    pub(crate) spacing_hz: Option<f64>,
    /// Write powers, relative dB: a receiver per subcarrier (or antenna)
    #[arg(long, requires = "channels")]
    pub(crate) powers: bool,
}

impl ChannelOptions {
    /// Returns these settings, with a receiver at the origin and without positions and name.
    pub(super) fn settings(&self) -> ChannelImport {
        ChannelImport {
            channels: self.channels.clone(),
            imag: self.imag.clone(),
            axes: self.axes.clone(),
            tx: None,
            receiver: Pose::IDENTITY,
            antennas: self.antennas.clone(),
            carrier_hz: self.carrier_hz,
            spacing_hz: self.spacing_hz,
            powers: self.powers,
            name: String::new(),
            simulated: false,
        }
    }
}

/// Converts channels into the data folder `out`, unless findings on its data are errors that are not `accepted`.
pub(super) fn import_channels(
    import: &ChannelImport,
    out: &Path,
    accepted: &[String],
    verbosity: Verbosity,
) -> Result<()> {
    let (mut data, notes) = import.read()?;
    notes.iter().for_each(|note| verbosity.print_note(note));
    check_findings(&data, None, Some(accepted), &mut RunProgress::new(verbosity))?;
    data.accepted = accepted.to_vec();
    save(&data, out)?;
    let out = out.display();
    verbosity.print_note(&format!("{} in {out}; next: `pwrfgs init {out}`", observed(&data)));
    Ok(())
}
