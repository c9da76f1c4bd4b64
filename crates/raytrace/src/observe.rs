//! Observations of a link (spectrum, power or channel), and thermal noise and phase errors of the antennas in them.

#[cfg(test)]
mod tests;

use crate::Complex;
use crate::array::mean_power;
use crate::path::PropagationPath;
use crate::scene::{Noise, SNR_RANGE_DB, SceneReceiver};
use crate::spectrum::Spectrum;
use pwrfgs_core::rng::{self, Rng, normal_f64};
use pwrfgs_core::{JsonSchema, Task};
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_1_SQRT_2;

/// Reading without a signal, dBm, as in the files of NeRF2; weaker signals are not received.
pub const SILENT_DBM: f64 = -100.0;
/// Power readings per dB: multiples of 1/1000 dB, so that file decimals are exact.
const GRAINS: f64 = 1e3;

/// Observation of each pair of transmitter and receiver.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub enum ObservationKind {
    /// Spatial spectrum of 360 x 90 pixels at the carrier.
    #[default]
    Spectrum,
    /// Received power in dBm: `power_dbm` of the scene's transmitter times the mean of |h|² over antennas and
    /// subcarriers. Powers below -100 dBm are not received.
    Power {
        /// Standard deviation of the normally distributed error of each reading, dB; 0 for none. About 3.6 dB in
        /// measured BLE readings.
        #[serde(default)]
        noise_db: f64,
    },
    /// Complex channel h of every antenna at every subcarrier of the scene.
    Channel {
        /// Signal-to-noise ratio in dB, in place of the scene's `noise`: mean of |h|² over the antennas and subcarriers
        /// of each snapshot, relative to the variance of its complex Gaussian noise. Without it: the noise of the
        /// scene.
        #[serde(default)]
        snr_db: Option<f64>,
    },
}

impl ObservationKind {
    /// Returns the task of the data set.
    pub fn task(&self) -> Task {
        match self {
            Self::Spectrum => Task::Spectrum,
            Self::Power { .. } => Task::Power,
            Self::Channel { .. } => Task::Channel,
        }
    }

    /// Returns an error for a parameter out of range: the problem and the next step.
    pub fn check(&self) -> Result<(), String> {
        match *self {
            Self::Power { noise_db } if !(0.0..=100.0).contains(&noise_db) => {
                Err(format!("`noise_db` is {noise_db}; give 0 to 100 dB"))
            }
            Self::Channel { snr_db: Some(snr) } if !SNR_RANGE_DB.contains(&snr) => {
                Err(format!("`snr_db` is {snr}; give -100 to 300 dB, or leave it out for the noise of the scene"))
            }
            _ => Ok(()),
        }
    }
}

/// Observation of one transmitter at one receiver.
#[derive(Clone, Debug, PartialEq)]
pub enum SimulatedObservation {
    /// Spatial spectrum.
    Spectrum(Spectrum),
    /// Reading in dBm; [`SILENT_DBM`] without a signal.
    Power(f64),
    /// Channel `[antennas, subcarriers]`.
    Channel(Vec<Complex>),
}

impl SimulatedObservation {
    /// Returns whether all numbers are finite.
    pub(crate) fn is_finite(&self) -> bool {
        match self {
            Self::Spectrum(spectrum) => spectrum.power.is_finite() && spectrum.high.is_finite(),
            Self::Power(dbm) => dbm.is_finite(),
            Self::Channel(channel) => channel.iter().all(|h| h.is_finite()),
        }
    }
}

/// Observation of one transmitter at one receiver, with its paths.
#[derive(Clone, Debug, PartialEq)]
pub struct ReceiverObservation {
    /// The observation.
    pub observed: SimulatedObservation,
    /// Paths to the centre of the array.
    pub paths: Vec<PropagationPath>,
}

/// Returns the power reading of a channel at a transmit power of `sent_dbm`, rounded to 0.001 dB, at least
/// [`SILENT_DBM`]; NaN for a channel with NaN. `draw` selects the random error of `noise_db` dB with its seed; `None`: no
/// error.
pub(crate) fn power_dbm(channel: &[Complex], sent_dbm: f64, noise_db: f64, draw: Option<(u64, NoiseDraw<'_>)>) -> f64 {
    let power = mean_power(channel);
    if power.is_nan() {
        return power; // reported by the caller
    }
    let error = draw.filter(|_| noise_db > 0.0);
    let error = error.map_or(0.0, |(seed, draw)| noise_db * normal_f64(&mut draw.random_stream(seed, "power reading")));
    let exact = sent_dbm + 10.0 * power.log10() + error;
    ((exact * GRAINS).round() / GRAINS).max(SILENT_DBM)
}

/// Receiver and sample of a random draw. Random numbers depend only on these and the seed, not on earlier draws.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NoiseDraw<'a> {
    /// The receiver.
    pub(crate) receiver: &'a SceneReceiver,
    /// Number of the sample.
    pub(crate) sample: u64,
}

impl NoiseDraw<'_> {
    /// Returns the random stream `purpose` of this receiver and sample.
    pub(crate) fn random_stream(&self, seed: u64, purpose: &str) -> Rng {
        rng::stream(seed, &self.receiver.stream_name(purpose), self.sample)
    }
}

/// Adds phase errors and thermal noise to the channel `[K, subcarriers]` of one sample. An antenna has the same phase
/// error at all subcarriers.
pub(crate) fn add_noise(noise: &Noise, channel: &mut [Complex], subcarriers: usize, draw: NoiseDraw<'_>) {
    if noise.phase_error_deg > 0.0 {
        let deviation = noise.phase_error_deg.to_radians();
        // Phase errors are equal in all samples.
        let mut random = NoiseDraw { sample: 0, ..draw }.random_stream(noise.seed, "receiver phase errors");
        for antenna in channel.chunks_mut(subcarriers.max(1)) {
            let turn = Complex::cis(deviation * rng::normal(&mut random) as f64);
            antenna.iter_mut().for_each(|h| *h *= turn);
        }
    }
    if let Some(snr) = noise.snr_db {
        let deviation = (mean_power(channel) * 10f64.powf(-snr / 10.0)).sqrt() * FRAC_1_SQRT_2;
        let mut random = draw.random_stream(noise.seed, "receiver noise");
        let mut normal = || deviation * rng::normal(&mut random) as f64;
        channel.iter_mut().for_each(|h| *h += Complex::new(normal(), normal()));
    }
}
