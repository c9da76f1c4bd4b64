//! Errors of the receiver: thermal noise, and antennas whose phases are not quite calibrated.

#[cfg(test)]
mod tests;

use crate::Complex;
use crate::scene::Receiver;
use pwrfgs_core::plugin::Check;
use pwrfgs_core::rng::{self, Rng};
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_1_SQRT_2;

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
pub struct Draw<'a> {
    /// The receiver.
    pub receiver: &'a Receiver,
    /// Number of the sample.
    pub sample: u64,
}

impl Draw<'_> {
    /// The random stream `what` of this receiver and sample.
    pub(crate) fn stream(&self, seed: u64, what: &str) -> Rng {
        rng::stream(seed, &self.receiver.stream(what), self.sample)
    }
}

/// Adds the errors to the channel `[K, subcarriers]` of one sample. An antenna has the same phase error at all subcarriers.
pub fn add(noise: &Noise, channel: &mut [Complex], subcarriers: usize, draw: Draw<'_>) {
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
