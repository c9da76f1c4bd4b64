//! The frequencies at which a channel is observed.

use pwrfgs_core::plugin::Check;
use serde::{Deserialize, Serialize};

/// Most subcarriers.
const MOST: usize = 4096;

/// Subcarriers about the carrier, evenly spaced, as those of OFDM: subcarrier i of n stands at
/// carrier + (i - (n-1)/2) · bandwidth/n. The carrier is the middle of the band, and one of them where n is odd.
///
/// Delays are exact: every subcarrier has a wavenumber of its own. What materials, edges and patterns do to a wave is that
/// at the carrier, over the whole band.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Subcarriers {
    /// How many.
    pub count: usize,
    /// `count` times their spacing, Hz.
    pub bandwidth_hz: f64,
}

impl Check for Subcarriers {
    fn check(&self) -> Result<(), String> {
        if !(1..=MOST).contains(&self.count) {
            return Err(format!("subcarriers: `count` is {}; give 1 to {MOST}", self.count));
        }
        if !(self.bandwidth_hz > 0.0 && self.bandwidth_hz.is_finite()) {
            return Err(format!("subcarriers: `bandwidth_hz` is {}; give a bandwidth such as 20e6", self.bandwidth_hz));
        }
        Ok(())
    }
}

impl Subcarriers {
    /// Distance between neighbours, Hz.
    pub fn spacing_hz(&self) -> f64 {
        self.bandwidth_hz / self.count as f64
    }

    /// The frequencies, Hz, rising.
    pub fn frequencies(&self, carrier_hz: f64) -> Vec<f64> {
        let middle = (self.count as f64 - 1.0) / 2.0;
        (0..self.count).map(|i| carrier_hz + (i as f64 - middle) * self.spacing_hz()).collect()
    }

    /// Refuses a band that reaches to no frequency at all.
    pub(super) fn check_around(&self, carrier_hz: f64) -> Result<(), String> {
        if self.bandwidth_hz <= carrier_hz {
            return Ok(());
        }
        let wide = self.bandwidth_hz;
        Err(format!(
            "subcarriers: `bandwidth_hz` is {wide}, more than the carrier of {carrier_hz} Hz; give a narrower band"
        ))
    }
}
