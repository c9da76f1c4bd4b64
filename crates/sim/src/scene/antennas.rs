//! Who listens and who sends.

use super::FAR;
use crate::array::{Array, Element};
use crate::transmitters::Transmitters;
use glam::{DMat3, DQuat, DVec3};
use pwrfgs_core::plugin::Checked;
use serde::{Deserialize, Serialize};

/// The receiver.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Receiver {
    /// Centre of the array, metres.
    pub position: [f64; 3],
    /// How it is turned.
    pub orientation: Orientation,
    /// Its antennas.
    #[serde(default)]
    pub array: Checked<Array>,
}

/// How the receiver is turned.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Orientation {
    /// Unit quaternion x, y, z, w from the axes of the receiver to those of the world, as in `gateway_info.yml`.
    Quaternion(f64, f64, f64, f64),
    /// Boresight towards `direction`, the y axis of the array as far up as that allows (for a boresight straight up or
    /// down: towards +y of the world).
    Facing {
        /// A direction in the world, of any length.
        direction: [f64; 3],
    },
}

/// The transmitter: one antenna that moves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Transmitter {
    /// Where it stands.
    pub positions: Transmitters,
    /// Its pattern; default isotropic.
    #[serde(default)]
    pub element: Element,
    /// Axis of its polarisation, world frame; default upright.
    #[serde(default = "upright")]
    pub polarization: [f64; 3],
}

fn upright() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}

impl Receiver {
    pub(super) fn check(&self) -> Result<(), String> {
        if !self.position.iter().all(|v| v.abs() <= FAR) {
            return Err(format!("receiver: `position` is {:?}; give finite metres", self.position));
        }
        match &self.orientation {
            Orientation::Quaternion(x, y, z, w) => {
                let norm = (x * x + y * y + z * z + w * w).sqrt();
                if (norm - 1.0).abs() < 0.01 {
                    return Ok(());
                }
                Err(format!("receiver: the quaternion has length {norm}; give a unit quaternion x, y, z, w"))
            }
            Orientation::Facing { direction } => {
                if DVec3::from(*direction).try_normalize().is_some() {
                    return Ok(());
                }
                Err(format!("receiver: `direction` is {direction:?}; give a direction such as (0, 0, -1)"))
            }
        }
    }
}

impl Orientation {
    /// Unit quaternion x, y, z, w from the receiver's axes to the world's.
    pub fn quaternion(&self) -> [f64; 4] {
        match self {
            Self::Quaternion(x, y, z, w) => {
                let norm = (x * x + y * y + z * z + w * w).sqrt();
                [*x, *y, *z, *w].map(|v| v / norm)
            }
            Self::Facing { direction } => {
                let z = DVec3::from(*direction).normalize();
                let up = if z.x.hypot(z.y) > 1e-9 { DVec3::Z } else { DVec3::Y };
                let y = (up - up.dot(z) * z).normalize();
                DQuat::from_mat3(&DMat3::from_cols(y.cross(z), y, z)).normalize().to_array()
            }
        }
    }
}
