//! `Origin`: the place that inner coordinates count from, so that map coordinates keep their decimals.

use crate::{Pose, Real};
use serde::{Deserialize, Serialize};

/// Largest coordinate that is taken, metres. A double tells 15 nm apart there, and no map has larger ones.
pub const MAX_COORDINATE_M: f64 = 1e8;
/// Coordinates up to this size count from zero, metres: single precision tells 0.06 mm apart there.
const NEAR_M: f64 = 1e3;

/// A place in the user's frame, metres, in whole numbers. Everything that computes in [`Real`] counts from it:
/// single precision rounds a northing of 5,400,000 m to half a metre. What a user gives or gets is in the user's frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Origin(pub [f64; 3]);

impl Origin {
    /// The user's own.
    pub const ZERO: Self = Self([0.0; 3]);

    /// For a receiver at `receiver` and all `others`, metres: zero unless a coordinate exceeds 1,000 m in size, else the
    /// receiver's position rounded to whole metres. Subtracting it from the receiver's position is then exact.
    pub fn of(receiver: [f64; 3], others: impl IntoIterator<Item = [f64; 3]>) -> Self {
        let mut places = others.into_iter().chain([receiver]);
        let is_far = places.any(|place| place.iter().any(|v| v.abs() > NEAR_M));
        if is_far { Self(receiver.map(|v| v.round() + 0.0)) } else { Self::ZERO } // + 0.0: never -0
    }

    /// Whether it changes nothing.
    pub fn is_zero(&self) -> bool {
        *self == Self::ZERO
    }

    /// A place of the user's frame, counted from here.
    pub fn local(&self, place: [f64; 3]) -> [Real; 3] {
        [0, 1, 2].map(|k| (place[k] - self.0[k]) as Real)
    }

    /// The place of the user's frame that lies at `place` from here.
    pub fn world(&self, place: [Real; 3]) -> [f64; 3] {
        [0, 1, 2].map(|k| place[k] as f64 + self.0[k])
    }

    /// A pose of the user's frame, counted from here.
    pub fn local_pose(&self, pose: Pose) -> Pose {
        Pose { position: [0, 1, 2].map(|k| pose.position[k] - self.0[k]), ..pose }
    }

    /// The pose of the user's frame that is `pose` from here.
    pub fn world_pose(&self, pose: Pose) -> Pose {
        Pose { position: [0, 1, 2].map(|k| pose.position[k] + self.0[k]), ..pose }
    }

    /// What is wrong with one that a file gives.
    pub fn fault(&self) -> Option<String> {
        place_fault(self.0).map(|what| format!("the origin {what}"))
    }
}

/// What is wrong with a place in the user's frame, and what to do: all three are finite and at most
/// [`MAX_COORDINATE_M`] in size.
pub fn place_fault(place: [f64; 3]) -> Option<String> {
    place.into_iter().find_map(coordinate_fault)
}

/// The same of one coordinate.
pub fn coordinate_fault(v: f64) -> Option<String> {
    if v.is_finite() && v.abs() <= MAX_COORDINATE_M {
        return None;
    }
    let what =
        if v.is_finite() { format!("is {v:e} m, beyond {MAX_COORDINATE_M:e} m") } else { "is not finite".into() };
    Some(format!("{what}; write three numbers in metres"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rooms_count_from_zero_and_maps_from_the_receiver() {
        let near = [[1000.0, -1000.0, 0.0], [-0.3, 0.4, 3.0]];
        assert_eq!(Origin::of([0.4, 7.0, -0.0], near), Origin::ZERO);
        let far = [500_000.25, 5_399_999.54, -0.3];
        let origin = Origin::of(far, []);
        assert_eq!(origin.0, [500_000.0, 5_400_000.0, 0.0]);
        assert!(origin.0[2].is_sign_positive(), "files say 0 and not -0");
        assert_eq!(Origin::of([0.4, 7.6, 1.5], [[0.0, -1000.5, 0.0]]).0, [0.0, 8.0, 2.0]);
        // The receiver comes back exactly, and nothing is lost on the way.
        let pose = Pose { position: far, ..Pose::IDENTITY };
        assert_eq!(origin.world_pose(origin.local_pose(pose)), pose);
        let tx = [500_003.125, 5_399_998.25, 101.5];
        assert_eq!(origin.local(tx), [3.125, -1.75, 101.5]);
        assert_eq!(origin.world(origin.local(tx)), tx);
    }

    #[test]
    fn no_coordinate_is_beyond_all_maps() {
        assert_eq!(place_fault([1e8, -1e8, 0.0]), None);
        let said = place_fault([0.0, 1e308, 0.0]).unwrap();
        assert_eq!(said, "is 1e308 m, beyond 1e8 m; write three numbers in metres");
        assert_eq!(place_fault([f64::NAN, 0.0, 0.0]).unwrap(), "is not finite; write three numbers in metres");
    }
}
