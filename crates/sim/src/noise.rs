//! Errors of the receiver: thermal noise, and antennas whose phases are not quite calibrated.

#[cfg(test)]
mod tests;

use crate::wave::Complex;
use pwrfgs_core::plugin::Check;
use pwrfgs_core::rng;
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_1_SQRT_2;

/// Errors of the receiver; none by default.
///
/// Noise is relative to each transmitter's own channel, as if every transmitter had the power for the stated SNR: it
/// does not tell near from far.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Noise {
    /// Signal-to-noise ratio of an element in dB: the mean of |h|² over the elements against the variance of the complex
    /// Gaussian noise, drawn anew for each element and sample. Left out: no noise.
    pub snr_db: Option<f64>,
    /// Standard deviation of the elements' phase errors, degrees: Gaussian, drawn once, the same in all samples;
    /// default 0.
    pub phase_error_deg: f64,
    /// Which receiver: seed of the phase errors and of the noise; default 0.
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

/// Adds the errors to the channel `[K]` of one sample. `draw` is the sample's number: the bits depend on it and on the
/// seed alone, not on what was drawn before.
pub fn add(noise: &Noise, channel: &mut [Complex], draw: u64) {
    if noise.phase_error_deg > 0.0 {
        let deviation = noise.phase_error_deg.to_radians();
        let mut random = rng::stream(noise.seed, "receiver phase errors", 0);
        channel.iter_mut().for_each(|h| *h *= Complex::cis(deviation * rng::normal(&mut random) as f64));
    }
    if let Some(snr) = noise.snr_db {
        let power = channel.iter().map(Complex::norm_sqr).sum::<f64>() / channel.len().max(1) as f64;
        let deviation = (power * 10f64.powf(-snr / 10.0)).sqrt() * FRAC_1_SQRT_2;
        let mut random = rng::stream(noise.seed, "receiver noise", draw);
        let mut normal = || deviation * rng::normal(&mut random) as f64;
        channel.iter_mut().for_each(|h| *h += Complex::new(normal(), normal()));
    }
}
