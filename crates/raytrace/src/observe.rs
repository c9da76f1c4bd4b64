//! What is observed of a link: a picture, a power or a channel; and the errors of the receiver, thermal noise and antennas
//! whose phases are not quite calibrated.

#[cfg(test)]
mod tests;

use crate::Complex;
use crate::path::Path;
use crate::scene::Receiver;
use crate::spectrum::Spectrum;
use pwrfgs_core::plugin::Check;
use pwrfgs_core::rng::{self, Rng, normal_f64};
use pwrfgs_core::{JsonSchema, Task};
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_1_SQRT_2;

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

/// Errors of the receiver; none by default.
///
/// Noise is relative to each transmitter's own channel, as if every transmitter had the power for the stated SNR: it
/// does not tell near from far.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Noise {
    /// Signal-to-noise ratio of an element in dB: the mean of |h|² over the elements (and subcarriers) against the variance of the complex
    /// Gaussian noise, drawn anew for each of them and each sample. Left out: no noise.
    pub snr_db: Option<f64>,
    /// Standard deviation of the elements' phase errors, degrees: Gaussian, drawn once, the same in all samples;
    /// default 0.
    pub phase_error_deg: f64,
    /// Which receivers: seed of the phase errors and of the noise; default 0.
    pub seed: u64,
}

impl Check for Noise {
    fn check(&self) -> Result<(), String> {
        if let Some(snr) = self.snr_db
            && !(-100.0..=300.0).contains(&snr)
        {
            return Err(format!("noise: `snr_db` is {snr}; give -100 to 300 dB, or leave it out for no noise"));
        }
        if !(0.0..=180.0).contains(&self.phase_error_deg) {
            return Err(format!("noise: `phase_error_deg` is {}; give 0 to 180 degrees", self.phase_error_deg));
        }
        Ok(())
    }
}

/// Whose errors are drawn, and for which sample. The bits depend on these and on the seed alone, not on what was drawn
/// before.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Draw<'a> {
    /// The receiver.
    pub(crate) receiver: &'a Receiver,
    /// Number of the sample.
    pub(crate) sample: u64,
}

impl Draw<'_> {
    /// The random stream `what` of this receiver and sample.
    pub(crate) fn stream(&self, seed: u64, what: &str) -> Rng {
        rng::stream(seed, &self.receiver.stream(what), self.sample)
    }
}

/// Adds the errors to the channel `[K, subcarriers]` of one sample. An antenna has the same phase error at all subcarriers.
pub(crate) fn add_noise(noise: &Noise, channel: &mut [Complex], subcarriers: usize, draw: Draw<'_>) {
    if noise.phase_error_deg > 0.0 {
        let deviation = noise.phase_error_deg.to_radians();
        let mut random = Draw { sample: 0, ..draw }.stream(noise.seed, "receiver phase errors");
        for antenna in channel.chunks_mut(subcarriers.max(1)) {
            let turn = Complex::cis(deviation * rng::normal(&mut random) as f64);
            antenna.iter_mut().for_each(|h| *h *= turn);
        }
    }
    if let Some(snr) = noise.snr_db {
        let deviation = (mean_power(channel) * 10f64.powf(-snr / 10.0)).sqrt() * FRAC_1_SQRT_2;
        let mut random = draw.stream(noise.seed, "receiver noise");
        let mut normal = || deviation * rng::normal(&mut random) as f64;
        channel.iter_mut().for_each(|h| *h += Complex::new(normal(), normal()));
    }
}

/// Mean of |h|²; 0 of nothing.
pub(crate) fn mean_power(channel: &[Complex]) -> f64 {
    channel.iter().map(Complex::norm_sqr).sum::<f64>() / channel.len().max(1) as f64
}
