//! Receiver errors of a scene.

use pwrfgs_core::plugin::Check;
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;

/// Accepted signal-to-noise ratios of scenes and channels, dB.
pub(crate) const SNR_RANGE_DB: RangeInclusive<f64> = -100.0..=300.0;

/// Receiver errors; none by default.
///
/// Noise is relative to the channel of each transmitter, as if its power were set for the stated SNR: it does not
/// depend on the distance.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Noise {
    /// Signal-to-noise ratio per element in dB: mean of |h|² over elements (and subcarriers), relative to the variance
    /// of complex Gaussian noise, which is independent per element and sample. Without it: no noise.
    pub snr_db: Option<f64>,
    /// Standard deviation of the phase errors of the elements, degrees: Gaussian, equal in all samples; default 0.
    pub phase_error_deg: f64,
    /// Random seed of the phase errors and of the noise; default 0.
    pub seed: u64,
}

impl Check for Noise {
    fn check(&self) -> Result<(), String> {
        if let Some(snr) = self.snr_db
            && !SNR_RANGE_DB.contains(&snr)
        {
            return Err(format!("noise: `snr_db` is {snr}; give -100 to 300 dB, or leave it out for no noise"));
        }
        if !(0.0..=180.0).contains(&self.phase_error_deg) {
            return Err(format!("noise: `phase_error_deg` is {}; give 0 to 180 degrees", self.phase_error_deg));
        }
        Ok(())
    }
}
