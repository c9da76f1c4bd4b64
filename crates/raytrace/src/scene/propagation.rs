//! Propagation effects and frequencies of a scene.

use crate::scattering::Lobe;
use pwrfgs_core::carrier_fault;
use pwrfgs_core::plugin::Check;
use serde::{Deserialize, Serialize};

/// Largest number of reflections of a path.
const MOST_REFLECTIONS: usize = 10;
/// Largest number of subcarriers.
const MOST_SUBCARRIERS: usize = 4096;
/// Largest number of carriers; each has its own images and beams.
const MOST_CARRIERS: usize = 200;

/// Propagation effects to simulate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Propagation {
    /// Largest number of specular reflections; default 2.
    pub order: usize,
    /// Largest number of specular reflections of a path with all reflections at the room and none at an object; default 3.
    pub room_order: usize,
    /// Whether waves pass through sheets; default yes.
    pub transmission: bool,
    /// Whether waves diffract at an edge, once per path; default yes.
    pub diffraction: bool,
    /// Diffuse scattering: share S of the reflected amplitude of finishes without `roughness`; default 0, none.
    pub roughness: f64,
    /// Shape of the diffuse lobe; default Lambertian.
    pub lobe: Lobe,
    /// Side of the square scattering patches, metres; default 0.5.
    pub patch_m: f64,
    /// Random seed of the patch phases; default 0.
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
            if order > MOST_REFLECTIONS {
                return Err(format!("propagation: `{field}` is {order}; give at most {MOST_REFLECTIONS}"));
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

/// Subcarriers about the carrier, evenly spaced, as in OFDM: subcarrier i of n has the frequency carrier + (i -
/// (n-1)/2) · bandwidth/n. The carrier is the centre of the band; for odd n it is one of the subcarriers.
///
/// Delays are exact: every subcarrier has its own wavenumber. Materials, edges and antenna patterns are evaluated at
/// the carrier for the whole band.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Subcarriers {
    /// Number of subcarriers.
    pub count: usize,
    /// Bandwidth, `count` times the subcarrier spacing, Hz.
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
    /// Returns the subcarrier spacing, Hz.
    pub fn spacing_hz(&self) -> f64 {
        self.bandwidth_hz / self.count as f64
    }

    /// Returns the subcarrier frequencies about a carrier, Hz, ascending.
    pub fn frequencies(&self, carrier_hz: f64) -> Vec<f64> {
        let middle = (self.count as f64 - 1.0) / 2.0;
        (0..self.count).map(|i| carrier_hz + (i as f64 - middle) * self.spacing_hz()).collect()
    }

    /// Returns an error if the bandwidth exceeds the carrier frequency.
    pub(super) fn check_band(&self, carrier_hz: f64) -> Result<(), String> {
        if self.bandwidth_hz <= carrier_hz {
            return Ok(());
        }
        let wide = self.bandwidth_hz;
        Err(format!(
            "subcarriers: `bandwidth_hz` is {wide}, more than the carrier of {carrier_hz} Hz; give a narrower band"
        ))
    }
}

/// Returns an error for carriers that are out of range, not in order or too many, or unless the scene has a single,
/// fixed receiver (`is_fixed`); none for an empty list.
pub(super) fn check_carriers(carriers_hz: &[f64], is_fixed: bool) -> Result<(), String> {
    if let Some(fault) = carriers_hz.iter().find_map(|hz| carrier_fault(*hz)) {
        return Err(format!("`carriers_hz`: {fault}"));
    }
    if !carriers_hz.is_sorted_by(|a, b| a < b) || carriers_hz.len() > MOST_CARRIERS {
        return Err(format!("`carriers_hz` must ascend; give at most {MOST_CARRIERS} different frequencies in order"));
    }
    if !carriers_hz.is_empty() && !is_fixed {
        return Err("`carriers_hz` needs one fixed receiver; remove `more_receivers` and `moving_receiver`".into());
    }
    Ok(())
}
