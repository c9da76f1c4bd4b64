//! Geometry of a measurement: `Origin`, `Pose`, receivers, locations of the moving end, and links.

use crate::{Camera, Geodetic, JsonSchema, Mat3, Real, Vec3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Maximum coordinate, metres. Double precision resolves 15 nm at this distance, and no map has larger coordinates.
pub const MAX_COORDINATE_M: f64 = 1e8;
/// Coordinates up to this size have the origin zero, metres: single precision resolves 0.06 mm at this distance.
const NEAR_M: f64 = 1e3;

/// Constant part of a measurement campaign.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Origin of all other positions, in the user's frame; zero except for map coordinates.
    pub origin: Origin,
    /// End of all links that moves.
    pub moving: End,
    /// Position of the fixed transmitter if the receivers move and it is known, metres from the origin.
    pub transmitter: Option<[f64; 3]>,
    /// Receivers, one or more, relative to the origin.
    pub receivers: Vec<Receiver>,
    /// Smallest and largest corner of point cloud, receivers and transmitters; metres from the origin.
    pub bounds: ([Real; 3], [Real; 3]),
    /// Surface points `[P,3]` in metres from the origin, empty without a point cloud.
    pub points: Vec<[Real; 3]>,
    /// Latitude and longitude of the user's frame; `None` if the data have none.
    pub geodetic: Option<Geodetic>,
    /// Height of the moving end on each floor, by its name, metres; empty if the data name no floors.
    pub floors: BTreeMap<String, f64>,
}

impl Scene {
    /// Returns the pose of the first of [`Self::fixed_ends`]; spectra usually have only this one.
    pub fn pose(&self) -> Pose {
        self.fixed_end(0)
    }

    /// Returns the ends of the links, relative to the origin.
    pub fn ends(&self) -> Ends {
        Ends { moving: self.moving, transmitter: self.transmitter, receivers: self.receivers.clone() }
    }

    /// Returns whether the lengths of all links are known: the positions of their fixed ends were measured.
    pub fn has_distances(&self) -> bool {
        match self.moving {
            End::Transmitter => self.receivers.iter().all(|receiver| !receiver.is_estimated),
            End::Receiver => self.transmitter.is_some(),
        }
    }

    /// Returns the poses of the ends that do not move, one or more, relative to the origin: of all receivers, or of the
    /// transmitter if the receivers move. A transmitter of unknown position is at the centre of the bounds. Its orientation is
    /// the usual one of the first receiver.
    pub fn fixed_ends(&self) -> Vec<Pose> {
        let count = if self.moving == End::Transmitter { self.receivers.len() } else { 1 };
        (0..count).map(|receiver| self.fixed_end(receiver)).collect()
    }

    /// Returns the positions of [`Self::fixed_ends`] that the data state, not estimated ones; metres, user's frame.
    pub fn known_ends(&self) -> Vec<[f64; 3]> {
        known_ends(self.origin, self.moving, self.transmitter, &self.receivers)
    }

    /// Returns the pose of the fixed end of links at a receiver, as [`Self::fixed_ends`]; that of the first receiver if there
    /// is none of this index.
    pub fn fixed_end(&self, receiver: usize) -> Pose {
        if self.moving == End::Transmitter {
            return self.receivers.get(receiver).unwrap_or(&self.receivers[0]).pose;
        }
        let (low, high) = self.bounds;
        let centre = || [0, 1, 2].map(|k| f64::midpoint(low[k] as f64, high[k] as f64));
        Pose { position: self.transmitter.unwrap_or_else(centre), ..self.receivers[0].pose }
    }
}

/// Returns the positions of the ends that do not move, without estimated and unknown ones; metres, user's frame. `transmitter`
/// and `receivers` are relative to `origin`.
pub(crate) fn known_ends(
    origin: Origin,
    moving: End,
    transmitter: Option<[f64; 3]>,
    receivers: &[Receiver],
) -> Vec<[f64; 3]> {
    let known = match moving {
        End::Transmitter => receivers.iter().filter(|r| !r.is_estimated).map(|r| r.pose.position).collect(),
        End::Receiver => Vec::from_iter(transmitter),
    };
    known.into_iter().map(|position| origin.world_pose(Pose { position, ..Pose::IDENTITY }).position).collect()
}

/// End of a link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum End {
    /// The sending end.
    #[default]
    Transmitter,
    /// The receiving end. Its antennas turn with it.
    Receiver,
}

impl End {
    /// Returns whether this is the receiver.
    pub fn is_receiver(self) -> bool {
        self == Self::Receiver
    }
}

/// Ends of the links of a scene: one of them moves. Positions are in the user's frame, unless stated otherwise.
#[derive(Clone, Debug)]
pub struct Ends {
    /// End that moves.
    pub moving: End,
    /// Position of the fixed transmitter if the receivers move and it is known, metres.
    pub transmitter: Option<[f64; 3]>,
    /// Receivers, one or more. Receivers that move have one pose, that of each location; here they have their usual
    /// orientation, at the origin.
    pub receivers: Vec<Receiver>,
}

impl Ends {
    /// Returns the ends of links with moving receivers, and a fixed transmitter at a position in metres if it is known.
    pub fn of_moving_receivers(mut receivers: Vec<Receiver>, transmitter: Option<[f64; 3]>) -> Self {
        receivers.iter_mut().for_each(|receiver| receiver.pose.position = [0.0; 3]);
        Self { moving: End::Receiver, transmitter, receivers }
    }
}

impl From<Vec<Receiver>> for Ends {
    /// Returns the ends of links between fixed receivers and moving transmitters.
    fn from(receivers: Vec<Receiver>) -> Self {
        Self { moving: End::Transmitter, transmitter: None, receivers }
    }
}

/// Receiver of a scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Receiver {
    /// Name in the data, unique among the receivers of a scene.
    pub name: String,
    /// Position and orientation, metres from the origin of the scene; the usual orientation, at the origin, if it moves.
    pub pose: Pose,
    /// Antenna positions in the receiver frame, metres; one at zero if not specified.
    pub antennas: Vec<[f64; 3]>,
    /// Carrier of its links, Hz; `None` if the data do not state it. An array that observes several carriers is one
    /// receiver per carrier, at the same position.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub carrier_hz: Option<f64>,
    /// Camera of its images; `None` for spectra over angles and other observations.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<Camera>,
    /// Whether the data do not state the position, and it is an estimate from the strongest observations.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub is_estimated: bool,
    /// Whether its powers are relative, in dB, because it is not calibrated.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub is_relative: bool,
}

impl Receiver {
    /// Creates a receiver with one antenna at its position.
    pub fn new(name: impl Into<String>, pose: Pose) -> Self {
        let (name, antennas) = (name.into(), vec![[0.0; 3]]);
        Self { name, pose, antennas, carrier_hz: None, camera: None, is_estimated: false, is_relative: false }
    }

    /// Returns this receiver at one of several carriers, Hz, with the name of the carrier, such as `2400MHz`.
    #[must_use]
    pub fn at_carrier(&self, carrier_hz: f64) -> Self {
        Self { name: format!("{}MHz", carrier_hz / 1e6), carrier_hz: Some(carrier_hz), ..self.clone() }
    }

    /// Returns whether `receivers` are the carriers of one array: one or more with a carrier, at one pose and with the same
    /// antennas.
    pub fn are_carriers(receivers: &[Self]) -> bool {
        let is_same = |other: &Self| (other.pose, &other.antennas) == (receivers[0].pose, &receivers[0].antennas);
        !receivers.is_empty() && receivers.iter().all(|receiver| receiver.carrier_hz.is_some() && is_same(receiver))
    }

    /// Returns antenna positions relative to the receiver position, along the world axes, metres.
    pub fn array(&self) -> Vec<[f64; 3]> {
        self.antennas.iter().map(|antenna| self.pose.turned(*antenna)).collect()
    }
}

/// Pair of one location of the moving end and one receiver; indices into the columns of a data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Link {
    /// Index into [`Dataset::locations`](crate::Dataset::locations).
    pub location: usize,
    /// Index into [`Scene::receivers`](crate::Scene::receivers).
    pub receiver: usize,
}

/// One location of the [moving end](Scene::moving).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Location {
    /// ID in the data set.
    pub id: u32,
    /// Pose in the file, metres, user's frame; a transmitter has world axes.
    pub pose: Pose,
}

impl Location {
    /// Returns the position, metres, user's frame.
    pub fn position(&self) -> [f64; 3] {
        self.pose.position
    }
}

/// One link as a row: location of the moving end, and receiver. A data set stores columns and creates rows on request.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// ID of the location in the data set.
    pub id: u32,
    /// Pose of the moving end in the file, metres, user's frame. The orientation of a transmitter has no effect.
    pub pose: Pose,
    /// Index of the receiver; 0 for a single receiver.
    pub receiver: usize,
}

impl Sample {
    /// Creates a sample at the only receiver, from the pose of the moving end or the position of a transmitter.
    pub fn new(id: u32, pose: impl Into<Pose>) -> Self {
        Self { id, pose: pose.into(), receiver: 0 }
    }

    /// Returns the position of the moving end, metres, user's frame.
    pub fn position(&self) -> [f64; 3] {
        self.pose.position
    }
}

/// Input of a prediction: a link without its observation.
#[derive(Clone, Copy, Debug)]
pub struct Query<'a> {
    /// Pose of the end that moves in the data, metres, user's frame. The orientation of a transmitter has no effect.
    pub pose: Pose,
    /// Features that replace the position as network input ([`Features`]).
    pub features: Option<&'a [Real]>,
    /// Index of the receiver in the data.
    pub receiver: usize,
    /// Id of the sample in data, which follows time in a trajectory; `None` for other positions. Models do not use it.
    pub id: Option<u32>,
}

impl Query<'static> {
    /// Creates a query for the moving end at a pose, or a transmitter at a position, and the receiver of that index.
    pub fn at(pose: impl Into<Pose>, receiver: usize) -> Self {
        Self { pose: pose.into(), features: None, receiver, id: None }
    }
}

impl Query<'_> {
    /// Returns the position of the moving end, metres, user's frame.
    pub fn position(&self) -> [f64; 3] {
        self.pose.position
    }
}

impl From<[f64; 3]> for Query<'static> {
    /// Creates a query for a transmitter position at the only, or the first, receiver.
    fn from(position: [f64; 3]) -> Self {
        Self::at(position, 0)
    }
}

impl From<Pose> for Query<'static> {
    /// Creates a query for the pose of the only, or the first, moving receiver.
    fn from(pose: Pose) -> Self {
        Self::at(pose, 0)
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
    pub fn row(&self, i: usize) -> &[Real] {
        &self.values[i * self.width..][..self.width]
    }
}

/// Position and orientation of one end of a link.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Pose {
    /// Position, metres, world frame.
    pub position: [f64; 3],
    /// Unit quaternion x, y, z, w (the order of the data set) that rotates receiver axes to world axes.
    pub orientation: [f64; 4],
}

impl From<[f64; 3]> for Pose {
    /// Creates a pose with world axes.
    fn from(position: [f64; 3]) -> Self {
        Self { position, ..Self::IDENTITY }
    }
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
    pub fn to_receiver(&self, position: [f64; 3]) -> [f64; 3] {
        let offset = glam::DVec3::from_array(position) - glam::DVec3::from_array(self.position);
        (self.rotation().inverse() * offset).to_array()
    }

    /// Returns the position followed by the x and z axes, each 1 m long: coordinates in which near poses are near.
    pub fn coordinates(&self) -> [f64; 9] {
        let axes = [self.position, self.turned([1.0, 0.0, 0.0]), self.turned([0.0, 0.0, 1.0])];
        std::array::from_fn(|k| axes.as_flattened()[k])
    }

    /// Rotates a vector from the receiver frame to the world frame.
    pub fn turned(&self, vector: [f64; 3]) -> [f64; 3] {
        (self.rotation() * glam::DVec3::from_array(vector)).to_array()
    }

    /// Returns the derivative by the orientation (x, y, z, w), given that by a small rotation about the world axes, radians.
    pub fn rotation_vjp(&self, d_rotation: [f64; 3]) -> [f64; 4] {
        let (d, q) = (glam::DVec3::from_array(d_rotation), glam::DQuat::from_array(self.orientation));
        let d_axis = q.w * d + d.cross(q.xyz());
        [d_axis.x, d_axis.y, d_axis.z, -d.dot(q.xyz())].map(|d| 2.0 * d / q.length_squared())
    }

    /// Returns the rotation from receiver axes to world axes, of length 1.
    fn rotation(&self) -> glam::DQuat {
        let [x, y, z, w] = self.orientation;
        glam::DQuat::from_xyzw(x, y, z, w).normalize()
    }

    /// Returns the position as a vector of kernel precision.
    pub fn position_vec(&self) -> Vec3 {
        let p = self.position.map(|v| v as Real);
        Vec3::from_array(p)
    }

    /// Describes two poses that differ: `two positions, [..] and [..]`, or the orientations at one position.
    pub(crate) fn describe_difference(&self, other: &Self) -> String {
        if self.position == other.position {
            format!("two orientations, {:?} and {:?}", self.orientation, other.orientation)
        } else {
            format!("two positions, {:?} and {:?}", self.position, other.position)
        }
    }

    /// Returns the name of an invalid field, with problem and next step; `None` if the pose is valid.
    pub fn fault(&self) -> Option<(&'static str, String)> {
        /// Tolerance of the length of a quaternion: files have about eight digits.
        const TOLERANCE: f64 = 1e-3;
        if let Some(fault) = position_fault(self.position) {
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

    /// Chooses the origin for a receiver at `receiver` and all `others`, metres: zero if all coordinates are within 1,000 m,
    /// otherwise the receiver position rounded to whole metres. Its subtraction from the receiver position is exact.
    pub fn for_receiver(receiver: [f64; 3], others: impl IntoIterator<Item = [f64; 3]>) -> Self {
        let mut positions = others.into_iter().chain([receiver]);
        let is_far = positions.any(|position| position.iter().any(|v| v.abs() > NEAR_M));
        if is_far { Self(receiver.map(|v| v.round() + 0.0)) } else { Self::ZERO } // + 0.0: never -0
    }

    /// Returns whether the origin is zero.
    pub fn is_zero(&self) -> bool {
        *self == Self::ZERO
    }

    /// Converts a position from the user's frame to local coordinates.
    pub fn local(&self, position: [f64; 3]) -> [Real; 3] {
        [0, 1, 2].map(|k| (position[k] - self.0[k]) as Real)
    }

    /// Converts a position from local coordinates to the user's frame.
    pub fn world(&self, position: [Real; 3]) -> [f64; 3] {
        [0, 1, 2].map(|k| position[k] as f64 + self.0[k])
    }

    /// Converts a pose from the user's frame to local coordinates.
    pub fn local_pose(&self, pose: Pose) -> Pose {
        Pose { position: [0, 1, 2].map(|k| pose.position[k] - self.0[k]), ..pose }
    }

    /// Converts a pose from local coordinates to the user's frame.
    pub fn world_pose(&self, pose: Pose) -> Pose {
        Pose { position: [0, 1, 2].map(|k| pose.position[k] + self.0[k]), ..pose }
    }

    /// Returns the error in an origin from a file; `None` if it is valid.
    pub fn fault(&self) -> Option<String> {
        position_fault(self.0).map(|fault| format!("the origin {fault}"))
    }
}

/// Returns the error in a position in the user's frame, with the next step; `None` if all coordinates are finite and at
/// most [`MAX_COORDINATE_M`] in size. The text begins with `is`: the caller names the position.
pub fn position_fault(position: [f64; 3]) -> Option<String> {
    position.into_iter().find_map(coordinate_fault)
}

/// Returns the error in a carrier frequency, Hz, with the next step; `None` if it is valid. Other numbers are probably in MHz or
/// GHz.
pub fn carrier_fault(hz: f64) -> Option<String> {
    (!(1e6..=1e12).contains(&hz)).then(|| format!("the carrier is {hz:?} Hz; give a frequency between 1e6 and 1e12 Hz"))
}

/// Returns the error in one coordinate, metres, as [`position_fault`]; `None` if it is valid.
pub fn coordinate_fault(v: f64) -> Option<String> {
    let problem = match v.abs() {
        size if size <= MAX_COORDINATE_M => return None,
        size if size.is_finite() => format!("is {v:e} m, beyond {MAX_COORDINATE_M:e} m"),
        _ => "is not finite".into(),
    };
    Some(format!("{problem}; write three numbers in metres"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn origin_is_zero_in_rooms_and_receiver_on_maps() {
        let near = [[1000.0, -1000.0, 0.0], [-0.3, 0.4, 3.0]];
        assert_eq!(Origin::for_receiver([0.4, 7.0, -0.0], near), Origin::ZERO);
        let far = [500_000.25, 5_399_999.54, -0.3];
        let origin = Origin::for_receiver(far, []);
        assert_eq!(origin.0, [500_000.0, 5_400_000.0, 0.0]);
        assert!(origin.0[2].is_sign_positive(), "files say 0 and not -0");
        assert_eq!(Origin::for_receiver([0.4, 7.6, 1.5], [[0.0, -1000.5, 0.0]]).0, [0.0, 8.0, 2.0]);
        // The receiver position is restored exactly.
        let pose = Pose { position: far, ..Pose::IDENTITY };
        assert_eq!(origin.world_pose(origin.local_pose(pose)), pose);
        let tx = [500_003.125, 5_399_998.25, 101.5];
        assert_eq!(origin.local(tx), [3.125, -1.75, 101.5]);
        assert_eq!(origin.world(origin.local(tx)), tx);
    }

    #[test]
    fn rejects_coordinates_out_of_range() {
        assert_eq!(position_fault([1e8, -1e8, 0.0]), None);
        let message = position_fault([0.0, 1e308, 0.0]).unwrap();
        assert_eq!(message, "is 1e308 m, beyond 1e8 m; write three numbers in metres");
        assert_eq!(position_fault([f64::NAN, 0.0, 0.0]).unwrap(), "is not finite; write three numbers in metres");
    }

    #[test]
    fn known_ends_are_fixed_and_not_estimated() {
        let at = |x: f64| Receiver::new("r", Pose { position: [x, 0.0, 0.0], ..Pose::IDENTITY });
        let receivers = [at(1.0), Receiver { is_estimated: true, ..at(2.0) }];
        let ends = |moving, transmitter| known_ends(Origin([10.0, 0.0, 0.0]), moving, transmitter, &receivers);
        assert_eq!(ends(End::Transmitter, None), [[11.0, 0.0, 0.0]]);
        assert_eq!(ends(End::Receiver, Some([3.0, 1.0, 0.0])), [[13.0, 1.0, 0.0]]);
        assert!(ends(End::Receiver, None).is_empty());
    }
}
