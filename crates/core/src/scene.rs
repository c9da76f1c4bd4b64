//! Geometry of a measurement: `Origin`, `Pose`, transmitters, receivers and links.

use crate::{JsonSchema, Mat3, Real, Vec3};
use serde::{Deserialize, Serialize};

/// Maximum coordinate, metres. Double precision resolves 15 nm at this distance, and no map has larger coordinates.
pub const MAX_COORDINATE_M: f64 = 1e8;
/// Coordinates up to this size have the origin zero, metres: single precision resolves 0.06 mm at this distance.
const NEAR_M: f64 = 1e3;

/// Constant part of a measurement campaign.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Origin of all other positions, in the user's frame; zero except for map coordinates.
    pub origin: Origin,
    /// Receivers, one or more, relative to the origin.
    pub receivers: Vec<Receiver>,
    /// Smallest and largest corner of point cloud, receivers and transmitters; metres from the origin.
    pub bounds: ([Real; 3], [Real; 3]),
    /// Surface points `[P,3]` in metres from the origin, empty without a point cloud.
    pub points: Vec<[Real; 3]>,
}

impl Scene {
    /// Returns the pose of the first receiver, usually the only one for spectra.
    pub fn pose(&self) -> Pose {
        self.receivers.first().map_or(Pose::IDENTITY, |receiver| receiver.pose)
    }
}

/// Receiver of a scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Receiver {
    /// Name in the data, unique among the receivers of a scene.
    pub name: String,
    /// Position and orientation, metres from the origin of the scene.
    pub pose: Pose,
    /// Antenna positions in the receiver frame, metres; one at zero if not specified.
    pub antennas: Vec<[f64; 3]>,
    /// Carrier of its links, Hz; `None` if the data do not state it. An array that observes several carriers is one
    /// receiver per carrier, at the same position.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub carrier_hz: Option<f64>,
}

impl Receiver {
    /// Creates a receiver with one antenna at its position.
    pub fn new(name: impl Into<String>, pose: Pose) -> Self {
        Self { name: name.into(), pose, antennas: vec![[0.0; 3]], carrier_hz: None }
    }

    /// Creates the receiver of one of several carriers, Hz, with the name of the carrier, such as `2400MHz`.
    pub fn of_carrier(pose: Pose, carrier_hz: f64) -> Self {
        Self { carrier_hz: Some(carrier_hz), ..Self::new(format!("{}MHz", carrier_hz / 1e6), pose) }
    }

    /// Returns whether `receivers` are the carriers of one array: one or more with a carrier, at one pose and with the same
    /// antennas.
    pub fn are_carriers(receivers: &[Self]) -> bool {
        let same = |own: &Self| (own.pose, &own.antennas) == (receivers[0].pose, &receivers[0].antennas);
        !receivers.is_empty() && receivers.iter().all(|own| own.carrier_hz.is_some() && same(own))
    }

    /// Returns antenna positions relative to the receiver position, along the world axes, metres.
    pub fn array(&self) -> Vec<[f64; 3]> {
        self.antennas.iter().map(|antenna| self.pose.turned(*antenna)).collect()
    }
}

/// Pair of one transmitter and one receiver; indices into the columns of a data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Link {
    /// Index into [`Dataset::transmitters`](crate::Dataset::transmitters).
    pub transmitter: usize,
    /// Index into [`Scene::receivers`](crate::Scene::receivers).
    pub receiver: usize,
}

/// One transmitter position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transmitter {
    /// ID in the data set.
    pub id: u32,
    /// Position `p_tx` in the file, metres, user's frame.
    pub position: [f64; 3],
}

/// One link as a row: transmitter, its position, and receiver. A data set stores columns and creates rows on request.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// ID of the transmitter in the data set.
    pub id: u32,
    /// Transmitter position `p_tx` in the file, metres, user's frame.
    pub tx: [f64; 3],
    /// Index of the receiver; 0 for a single receiver.
    pub receiver: usize,
}

impl Sample {
    /// Creates a sample at the only receiver.
    pub fn new(id: u32, tx: [f64; 3]) -> Self {
        Self { id, tx, receiver: 0 }
    }
}

/// Input of a prediction: a link without its observation.
#[derive(Clone, Copy, Debug)]
pub struct Query<'a> {
    /// Transmitter position, metres, user's frame; unused if there are features.
    pub tx: [f64; 3],
    /// Features that replace the position ([`Features`]); empty if the position is used.
    pub features: &'a [Real],
    /// Index of the receiver in the data.
    pub receiver: usize,
    /// Id of the sample in data, which follows time in a trajectory; `None` for other positions. Models do not use it.
    pub id: Option<u32>,
    /// Orientation of a moving receiver, as in [`Pose`]: it stands at `tx`. `None` for a fixed receiver.
    pub orientation: Option<[f64; 4]>,
}

impl Query<'static> {
    /// Creates a query for a transmitter at `tx` and the receiver of that index.
    pub fn at(tx: [f64; 3], receiver: usize) -> Self {
        Self { tx, features: &[], receiver, id: None, orientation: None }
    }
}

impl Query<'_> {
    /// Returns the position, followed by the x and z axes of a moving receiver, each 1 m long.
    pub fn coordinates(&self) -> Vec<f64> {
        let axes = self.orientation.map(|orientation| {
            let pose = Pose { orientation, ..Pose::IDENTITY };
            [pose.turned([1.0, 0.0, 0.0]), pose.turned([0.0, 0.0, 1.0])].concat()
        });
        [self.tx.to_vec(), axes.unwrap_or_default()].concat()
    }
}

/// Feature vector per link that replaces the transmitter position, such as an uplink channel, `[L, width]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Features {
    /// Number of features per link.
    pub width: usize,
    /// Values, row by row.
    pub values: Vec<Real>,
}

impl Features {
    /// Returns the features of link `i`.
    pub fn of(&self, i: usize) -> &[Real] {
        &self.values[i * self.width..][..self.width]
    }
}

impl From<[f64; 3]> for Query<'static> {
    /// Creates a query for a transmitter position at the only, or the first, receiver.
    fn from(tx: [f64; 3]) -> Self {
        Self::at(tx, 0)
    }
}

/// Position and orientation of the receiver.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Pose {
    /// Position, metres, world frame.
    pub position: [f64; 3],
    /// Unit quaternion x, y, z, w (the order of the data set) that rotates receiver axes to world axes.
    pub orientation: [f64; 4],
}

impl Pose {
    /// Pose at the origin with world axes: the boresight points up.
    pub const IDENTITY: Self = Self { position: [0.0; 3], orientation: [0.0, 0.0, 0.0, 1.0] };

    /// Returns `world_from_receiver`: columns are the x, y and z (boresight) axes of the receiver in the world.
    pub fn world_from_receiver(&self) -> Mat3 {
        let m = glam::DMat3::from_quat(self.rotation());
        let c = m.to_cols_array().map(|v| v as Real);
        Mat3::from_cols_array(&c)
    }

    /// Transforms a world position to the receiver frame, metres.
    pub fn to_receiver(&self, place: [f64; 3]) -> [f64; 3] {
        let way = glam::DVec3::from_array(place) - glam::DVec3::from_array(self.position);
        (self.rotation().inverse() * way).to_array()
    }

    /// Rotates a vector from the receiver frame to the world frame.
    pub fn turned(&self, vector: [f64; 3]) -> [f64; 3] {
        (self.rotation() * glam::DVec3::from_array(vector)).to_array()
    }

    fn rotation(&self) -> glam::DQuat {
        let [x, y, z, w] = self.orientation;
        glam::DQuat::from_xyzw(x, y, z, w).normalize()
    }

    /// Returns the position as a vector of kernel precision.
    pub fn origin(&self) -> Vec3 {
        let p = self.position.map(|v| v as Real);
        Vec3::from_array(p)
    }

    /// Returns the name of an invalid field, with problem and next step.
    pub fn fault(&self) -> Option<(&'static str, String)> {
        /// Tolerance of the length of a quaternion: files have about eight digits.
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
                format!("has length {length:.6}, expected 1 within {TOLERANCE}; divide x, y, z, w by it")
            }
            _ => return None,
        };
        Some(("orientation", format!("the quaternion {fault}")))
    }
}

/// Origin of local coordinates, metres in the user's frame, in whole numbers. All computations in [`Real`] are relative
/// to it, because single precision rounds a northing of 5,400,000 m to half a metre. Inputs and outputs for users are
/// in the user's frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Origin(pub [f64; 3]);

impl Origin {
    /// Origin of the user's frame.
    pub const ZERO: Self = Self([0.0; 3]);

    /// Chooses the origin for a receiver at `receiver` and all `others`, metres: zero unless a coordinate exceeds 1,000
    /// m, otherwise the receiver position rounded to whole metres. Its subtraction from the receiver position is exact.
    pub fn of(receiver: [f64; 3], others: impl IntoIterator<Item = [f64; 3]>) -> Self {
        let mut places = others.into_iter().chain([receiver]);
        let is_far = places.any(|place| place.iter().any(|v| v.abs() > NEAR_M));
        if is_far { Self(receiver.map(|v| v.round() + 0.0)) } else { Self::ZERO } // + 0.0: never -0
    }

    /// Returns whether the origin is zero.
    pub fn is_zero(&self) -> bool {
        *self == Self::ZERO
    }

    /// Converts a position from the user's frame to local coordinates.
    pub fn local(&self, place: [f64; 3]) -> [Real; 3] {
        [0, 1, 2].map(|k| (place[k] - self.0[k]) as Real)
    }

    /// Converts a position from local coordinates to the user's frame.
    pub fn world(&self, place: [Real; 3]) -> [f64; 3] {
        [0, 1, 2].map(|k| place[k] as f64 + self.0[k])
    }

    /// Converts a pose from the user's frame to local coordinates.
    pub fn local_pose(&self, pose: Pose) -> Pose {
        Pose { position: [0, 1, 2].map(|k| pose.position[k] - self.0[k]), ..pose }
    }

    /// Converts a pose from local coordinates to the user's frame.
    pub fn world_pose(&self, pose: Pose) -> Pose {
        Pose { position: [0, 1, 2].map(|k| pose.position[k] + self.0[k]), ..pose }
    }

    /// Returns the error in an origin from a file.
    pub fn fault(&self) -> Option<String> {
        place_fault(self.0).map(|what| format!("the origin {what}"))
    }
}

/// Returns the error in a position in the user's frame, with the next step: all coordinates must be finite and at most
/// [`MAX_COORDINATE_M`] in size.
pub fn place_fault(place: [f64; 3]) -> Option<String> {
    place.into_iter().find_map(coordinate_fault)
}

/// Returns the error in a carrier frequency, Hz.
pub fn carrier_fault(hz: f64) -> Option<String> {
    (!(1e6..=1e12).contains(&hz)).then(|| format!("the carrier is {hz:?} Hz; give a frequency between 1e6 and 1e12 Hz"))
}

/// Returns the error in one coordinate.
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
    fn origin_is_zero_in_rooms_and_receiver_on_maps() {
        let near = [[1000.0, -1000.0, 0.0], [-0.3, 0.4, 3.0]];
        assert_eq!(Origin::of([0.4, 7.0, -0.0], near), Origin::ZERO);
        let far = [500_000.25, 5_399_999.54, -0.3];
        let origin = Origin::of(far, []);
        assert_eq!(origin.0, [500_000.0, 5_400_000.0, 0.0]);
        assert!(origin.0[2].is_sign_positive(), "files say 0 and not -0");
        assert_eq!(Origin::of([0.4, 7.6, 1.5], [[0.0, -1000.5, 0.0]]).0, [0.0, 8.0, 2.0]);
        // The receiver position is restored exactly.
        let pose = Pose { position: far, ..Pose::IDENTITY };
        assert_eq!(origin.world_pose(origin.local_pose(pose)), pose);
        let tx = [500_003.125, 5_399_998.25, 101.5];
        assert_eq!(origin.local(tx), [3.125, -1.75, 101.5]);
        assert_eq!(origin.world(origin.local(tx)), tx);
    }

    #[test]
    fn rejects_coordinates_out_of_range() {
        assert_eq!(place_fault([1e8, -1e8, 0.0]), None);
        let message = place_fault([0.0, 1e308, 0.0]).unwrap();
        assert_eq!(message, "is 1e308 m, beyond 1e8 m; write three numbers in metres");
        assert_eq!(place_fault([f64::NAN, 0.0, 0.0]).unwrap(), "is not finite; write three numbers in metres");
    }
}
