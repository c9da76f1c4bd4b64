//! `Pose`: where a receiver is and how it is turned.

use crate::origin::place_fault;
use crate::{JsonSchema, Mat3, Real, Vec3};
use serde::{Deserialize, Serialize};

/// Position and orientation of the receiver.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Pose {
    /// Metres, world frame.
    pub position: [f64; 3],
    /// Unit quaternion x, y, z, w (the order of the data set) turning receiver axes into world axes.
    pub orientation: [f64; 4],
}

impl Pose {
    /// At the origin, axes along the world's: boresight straight up.
    pub const IDENTITY: Self = Self { position: [0.0; 3], orientation: [0.0, 0.0, 0.0, 1.0] };

    /// `world_from_receiver`: columns are the receiver's x, y and z (boresight) axes in the world.
    pub fn world_from_receiver(&self) -> Mat3 {
        let m = glam::DMat3::from_quat(self.rotation());
        let c = m.to_cols_array().map(|v| v as Real);
        Mat3::from_cols_array(&c)
    }

    /// A place of the world in the receiver's frame, metres.
    pub fn to_receiver(&self, place: [f64; 3]) -> [f64; 3] {
        let way = glam::DVec3::from_array(place) - glam::DVec3::from_array(self.position);
        (self.rotation().inverse() * way).to_array()
    }

    /// A vector of the receiver's frame in the world's.
    pub fn turned(&self, vector: [f64; 3]) -> [f64; 3] {
        (self.rotation() * glam::DVec3::from_array(vector)).to_array()
    }

    fn rotation(&self) -> glam::DQuat {
        let [x, y, z, w] = self.orientation;
        glam::DQuat::from_xyzw(x, y, z, w).normalize()
    }

    /// Position as a vector of the kernels' precision.
    pub fn origin(&self) -> Vec3 {
        let p = self.position.map(|v| v as Real);
        Vec3::from_array(p)
    }

    /// Which field is no place or no rotation, what is wrong with it, and what to do.
    pub fn fault(&self) -> Option<(&'static str, String)> {
        /// How far from 1 the length of a quaternion may be: files carry about eight digits.
        const TOLERANCE: f64 = 1e-3;
        if let Some(fault) = place_fault(self.position) {
            return Some(("position", format!("the position {fault}")));
        }
        let length = self.orientation.iter().map(|v| v * v).sum::<f64>().sqrt();
        let example = "such as [0, 0, 0, 1] for no rotation";
        let fault = match length {
            _ if !length.is_finite() => format!("is not finite; write x, y, z, w, {example}"),
            0.0 => format!("is zero; write x, y, z, w of length 1, {example}"),
            _ if (length - 1.0).abs() > TOLERANCE => {
                format!("has length {length:.6}, further than {TOLERANCE} from 1; divide x, y, z, w by it")
            }
            _ => return None,
        };
        Some(("orientation", format!("the quaternion {fault}")))
    }
}
