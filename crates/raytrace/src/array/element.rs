//! The pattern of one antenna: how strong, and which way the field points.

use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Pattern of an antenna, relative to its strongest direction: no directivity is added, |gain|² of the line of sight
/// between two antennas that face each other is always that of Friis for isotropic ones.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Element {
    /// The same in all directions.
    #[default]
    Isotropic,
    /// A short dipole along the axis of polarisation: |sin| of the angle from the axis, in amplitude.
    Dipole,
    /// A patch: cosᵠ of the angle from boresight (z) in amplitude, nothing behind.
    Patch {
        /// The exponent q; 1 is usual, 0 a half-space.
        exponent: f64,
    },
}

impl Element {
    /// Whether the numbers can be used.
    ///
    /// # Errors
    /// What is wrong and what to do.
    pub fn check(&self) -> Result<(), String> {
        match self {
            Self::Patch { exponent } if !(0.0..=100.0).contains(exponent) => {
                Err(format!("`exponent` of Patch is {exponent}; give 0 to 100, usually 1"))
            }
            _ => Ok(()),
        }
    }
}

/// Amplitude of an antenna towards `direction`, and the unit vector of its electric field there.
///
/// `axis` is its axis of polarisation ê and `direction` is r, away from the antenna, both unit vectors in its own frame.
/// The field points along -(ê - (ê·r)r), made unit: for ê = z that is θ̂ of spherical coordinates, down the meridian. On
/// the axis itself, where no such vector is singled out, it is one of those perpendicular to r.
pub fn response(element: &Element, axis: DVec3, direction: DVec3) -> (f64, DVec3) {
    let across = axis.cross(direction);
    let amplitude = match element {
        Element::Isotropic => 1.0,
        Element::Dipole => across.length(),
        Element::Patch { .. } if direction.z <= 0.0 => 0.0,
        Element::Patch { exponent } => direction.z.powf(*exponent),
    };
    // (ê×r)×r = -(ê - (ê·r)r), perpendicular to r even where ê and r all but agree.
    let field = across.try_normalize().unwrap_or_else(|| direction.any_orthonormal_vector()).cross(direction);
    (amplitude, field)
}
