//! What is observed of a link: a picture, a power or a channel.

use crate::Complex;
use crate::noise::{Draw, mean_power};
use crate::path::Path;
use crate::spectrum::Spectrum;
use pwrfgs_core::rng::normal_f64;
use pwrfgs_core::{JsonSchema, Task};
use serde::{Deserialize, Serialize};

/// What is not heard has this, dBm, as in the files of NeRF2; nothing weaker is heard.
pub const SILENT_DBM: f64 = -100.0;
/// Readings of a power are multiples of this, dB, so that the decimals of a file are the same numbers.
const GRAINS: f64 = 1e3;

/// Observation of each pair of transmitter and receiver.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub enum Observe {
    /// The spatial spectrum, a picture of 360 x 90 pixels, at the carrier.
    #[default]
    Spectrum,
    /// The received power in dBm: `power_dbm` of the scene's transmitter and the mean of |h|² over antennas and subcarriers.
    /// What is weaker than -100 dBm is not heard.
    Power {
        /// Standard deviation of a reading in dB: normal, drawn anew for each; 0 for none. Measured BLE readings have
        /// about 3.6.
        #[serde(default)]
        noise_db: f64,
    },
    /// The channel h, complex, of every antenna at every subcarrier of the scene.
    Channel {
        /// Signal-to-noise ratio in dB, in place of that of the scene's `noise`: the mean of |h|² over the antennas and
        /// subcarriers of this one snapshot against the variance of complex Gaussian noise, drawn anew for each of them.
        /// Left out: that of the scene.
        #[serde(default)]
        snr_db: Option<f64>,
    },
}

impl Observe {
    /// What the data set observes.
    pub fn task(&self) -> Task {
        match self {
            Self::Spectrum => Task::Spectrum,
            Self::Power { .. } => Task::Power,
            Self::Channel { .. } => Task::Channel,
        }
    }

    /// Whether it can be drawn; says what is wrong and what to do otherwise.
    ///
    /// # Errors
    /// That sentence.
    pub fn check(&self) -> Result<(), String> {
        match *self {
            Self::Power { noise_db } if !(0.0..=100.0).contains(&noise_db) => {
                Err(format!("`noise_db` is {noise_db}; give 0 to 100 dB"))
            }
            Self::Channel { snr_db: Some(snr) } if !(-100.0..=300.0).contains(&snr) => {
                Err(format!("`snr_db` is {snr}; give -100 to 300 dB, or leave it out for the noise of the scene"))
            }
            _ => Ok(()),
        }
    }
}

/// What one receiver observes of one transmitter.
#[derive(Clone, Debug, PartialEq)]
pub enum Observed {
    /// A picture.
    Spectrum(Spectrum),
    /// A reading in dBm; [`SILENT_DBM`] where nothing was heard.
    Power(f64),
    /// The channel `[antennas, subcarriers]`.
    Channel(Vec<Complex>),
}

impl Observed {
    /// Whether all numbers are finite.
    pub(crate) fn is_finite(&self) -> bool {
        match self {
            Self::Spectrum(spectrum) => spectrum.power.is_finite() && spectrum.high.is_finite(),
            Self::Power(dbm) => dbm.is_finite(),
            Self::Channel(channel) => channel.iter().all(|h| h.is_finite()),
        }
    }
}

/// What one receiver observes of one transmitter, and why.
#[derive(Clone, Debug, PartialEq)]
pub struct Heard {
    /// What is observed.
    pub observed: Observed,
    /// Paths to the centre of the array.
    pub paths: Vec<Path>,
}

/// The reading in dBm of a channel, of which `sent_dbm` was sent. `draw` is that of the error of `noise_db` and its seed;
/// `None`: without.
pub(crate) fn reading(channel: &[Complex], sent_dbm: f64, noise_db: f64, draw: Option<(u64, Draw<'_>)>) -> f64 {
    let power = mean_power(channel);
    if power.is_nan() {
        return power; // told by who asks
    }
    let error = draw.filter(|_| noise_db > 0.0);
    let error = error.map_or(0.0, |(seed, draw)| noise_db * normal_f64(&mut draw.stream(seed, "power reading")));
    let exact = sent_dbm + 10.0 * power.log10() + error;
    ((exact * GRAINS).round() / GRAINS).max(SILENT_DBM)
}
