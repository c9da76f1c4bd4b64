//! Where a measurement took place: `Origin`, `Pose`, who sends and who listens, and which of them were measured together.

use crate::{JsonSchema, Mat3, Real, Vec3};
use serde::{Deserialize, Serialize};

/// Largest coordinate that is taken, metres. A double tells 15 nm apart there, and no map has larger ones.
pub const MAX_COORDINATE_M: f64 = 1e8;
/// Coordinates up to this size count from zero, metres: single precision tells 0.06 mm apart there.
const NEAR_M: f64 = 1e3;

/// The fixed part of a measurement campaign.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The place in the user's frame that all others here count from; zero but for map coordinates.
    pub origin: Origin,
    /// Who listens, one or more, from the origin.
    pub receivers: Vec<Receiver>,
    /// Smallest and largest corner of everything known: cloud, receivers and transmitters; metres from the origin.
    pub bounds: ([Real; 3], [Real; 3]),
    /// Surface points `[P,3]` in metres from the origin, empty where no point cloud was given.
    pub points: Vec<[Real; 3]>,
}

impl Scene {
    /// The pose of the first receiver, which is the only one of a data set of spectra as a rule.
    pub fn pose(&self) -> Pose {
        self.receivers.first().map_or(Pose::IDENTITY, |receiver| receiver.pose)
    }
}

/// One receiver of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Receiver {
    /// What the data call it; unique among the receivers of a scene.
    pub name: String,
    /// Where it is and how it is turned, metres from the scene's origin.
    pub pose: Pose,
    /// Where its antennas are, metres in its own frame; one at the middle where nobody says.
    pub antennas: Vec<[f64; 3]>,
}

impl Receiver {
    /// With one antenna in the middle.
    pub fn new(name: impl Into<String>, pose: Pose) -> Self {
        Self { name: name.into(), pose, antennas: vec![[0.0; 3]] }
    }

    /// Places of the antennas about the receiver's own, along the axes of the world, metres.
    pub fn array(&self) -> Vec<[f64; 3]> {
        self.antennas.iter().map(|antenna| self.pose.turned(*antenna)).collect()
    }
}

/// One transmitter and one receiver; indices into the columns of a data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Link {
    /// Into [`Dataset::transmitters`](crate::Dataset::transmitters).
    pub transmitter: usize,
    /// Into [`Scene::receivers`](crate::Scene::receivers).
    pub receiver: usize,
}

/// One place of the transmitter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transmitter {
    /// The number the data set gives it.
    pub id: u32,
    /// Position `p_tx` as the file has it, metres, user's frame.
    pub position: [f64; 3],
}

/// One link as a row: which transmitter, where, and who listened. A data set keeps columns and makes such a row when asked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// The number the data set gives the transmitter.
    pub id: u32,
    /// Transmitter position `p_tx` as the file has it, metres, user's frame.
    pub tx: [f64; 3],
    /// Who listened: an index into the receivers, 0 where there is one.
    pub receiver: usize,
}

impl Sample {
    /// At the only receiver.
    pub fn new(id: u32, tx: [f64; 3]) -> Self {
        Self { id, tx, receiver: 0 }
    }
}

/// What a prediction is asked for: the link without what was observed of it.
#[derive(Clone, Copy, Debug)]
pub struct Query<'a> {
    /// Transmitter position, metres, user's frame; not to be looked at where there are features.
    pub tx: [f64; 3],
    /// What stands where the position stands elsewhere ([`Features`]); empty where it is the position.
    pub features: &'a [Real],
    /// Who listens: an index into the receivers of the data.
    pub receiver: usize,
}

impl Query<'static> {
    /// A transmitter at `tx`, heard by the receiver of that index.
    pub fn at(tx: [f64; 3], receiver: usize) -> Self {
        Self { tx, features: &[], receiver }
    }
}

/// A vector a link that stands where the transmitter's position stands elsewhere, such as an uplink channel, `[L, width]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Features {
    /// Numbers of one.
    pub width: usize,
    /// Row by row.
    pub values: Vec<Real>,
}

impl Features {
    /// Those of link `i`.
    pub fn of(&self, i: usize) -> &[Real] {
        &self.values[i * self.width..][..self.width]
    }
}

impl From<[f64; 3]> for Query<'static> {
    /// A transmitter there, heard by the only receiver, or the first.
    fn from(tx: [f64; 3]) -> Self {
        Self::at(tx, 0)
    }
}

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
