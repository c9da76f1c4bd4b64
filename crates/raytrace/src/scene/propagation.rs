//! Which ways of the waves count, and at which frequencies.

use crate::scattering::Lobe;
use pwrfgs_core::plugin::Check;
use serde::{Deserialize, Serialize};

/// Most subcarriers.
const MOST_SUBCARRIERS: usize = 4096;

/// Which ways of the waves count.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Propagation {
    /// Most specular reflections; default 2.
    pub order: usize,
    /// Most specular reflections of a path that meets the room alone, no object; default 3.
    pub room_order: usize,
    /// Whether waves pass sheets; default yes.
    pub transmission: bool,
    /// Whether waves go around one edge; default yes.
    pub diffraction: bool,
    /// Diffuse scattering: share S of the reflected amplitude where a finish says nothing; default 0, none.
    pub roughness: f64,
    /// Shape of the diffuse lobe; default Lambertian.
    pub lobe: Lobe,
    /// Side of the square patches that scatter, metres; default 0.5.
    pub patch_m: f64,
    /// Seed of the phases that patches add; default 0.
    pub seed: u64,
}

impl Default for Propagation {
    fn default() -> Self {
        Self {
            order: 2,
            room_order: 3,
            transmission: true,
            diffraction: true,
            roughness: 0.0,
            lobe: Lobe::Lambertian,
            patch_m: 0.5,
            seed: 0,
        }
    }
}

impl Check for Propagation {
    fn check(&self) -> Result<(), String> {
        for (field, order) in [("order", self.order), ("room_order", self.room_order)] {
            if order > 10 {
                return Err(format!("propagation: `{field}` is {order}; give at most 10"));
            }
        }
        if !(0.0..=1.0).contains(&self.roughness) {
            return Err(format!("propagation: `roughness` is {}; give a share between 0 and 1", self.roughness));
        }
        if !(0.01..=100.0).contains(&self.patch_m) {
            return Err(format!("propagation: `patch_m` is {}; give 0.01 to 100 metres", self.patch_m));
        }
        self.lobe.check().map_err(|why| format!("propagation: {why}"))
    }
}

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
        if !(1..=MOST_SUBCARRIERS).contains(&self.count) {
            return Err(format!("subcarriers: `count` is {}; give 1 to {MOST_SUBCARRIERS}", self.count));
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
