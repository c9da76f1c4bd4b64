//! Which ways of the waves count.

use crate::scattering::Lobe;
use pwrfgs_core::plugin::Check;
use serde::{Deserialize, Serialize};

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
