//! `MeasurementSetup`: receivers and measurement type of data, as a model needs them. `LinkInputs`: links as a method
//! reads them.

use crate::scene::known_ends;
use crate::{
    Conditions, Dataset, Elevation, End, Geodetic, ImagePlane, Link, Origin, Pose, Query, Real, Receiver, Scene, Task,
    Vec3,
};

/// Receivers and measurement type: all properties of a data set that a trained model needs.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasurementSetup {
    /// Origin of all positions, in the user's frame.
    pub origin: Origin,
    /// End of all links that moves.
    pub moving: End,
    /// Position of the fixed transmitter if the receivers move and it is known, metres from `origin`.
    pub transmitter: Option<[f64; 3]>,
    /// Receivers, with poses relative to `origin`.
    pub receivers: Vec<Receiver>,
    /// Measurement type.
    pub task: Task,
    /// Grid of the values of one observation; for a spectrum, its image plane.
    pub plane: ImagePlane,
    /// Subcarrier frequencies of a channel, Hz; otherwise empty.
    pub frequencies_hz: Vec<f64>,
    /// Latitude and longitude of the user's frame; `None` if the data have none.
    pub geodetic: Option<Geodetic>,
}

impl MeasurementSetup {
    /// Creates the setup for `data` on the image plane `plane`.
    pub fn of(data: &Dataset, plane: ImagePlane) -> Self {
        let frequencies_hz = data.observations.frequencies_hz().to_vec();
        let Scene { origin, moving, transmitter, receivers, geodetic, .. } = data.scene.clone();
        Self { origin, moving, transmitter, receivers, task: data.task(), plane, frequencies_hz, geodetic }
    }

    /// Creates the setup for spectra at one receiver.
    pub fn spectra(origin: Origin, pose: Pose, plane: ImagePlane) -> Self {
        let receivers = vec![Receiver::new("receiver", pose)];
        let (moving, transmitter, task) = (End::Transmitter, None, Task::default());
        Self { origin, moving, transmitter, receivers, task, plane, frequencies_hz: Vec::new(), geodetic: None }
    }

    /// Returns the number of values per observation.
    pub fn value_count(&self) -> usize {
        self.plane.width * self.plane.height
    }

    /// Returns the pose of the first receiver, relative to the origin: if it moves, its usual orientation at the origin. Without
    /// receivers, it is [`Pose::IDENTITY`].
    pub fn pose(&self) -> Pose {
        self.receivers.first().map_or(Pose::IDENTITY, |receiver| receiver.pose)
    }

    /// Returns the positions of the ends that do not move, without estimated and unknown ones; metres, user's frame.
    pub fn known_ends(&self) -> Vec<[f64; 3]> {
        known_ends(self.origin, self.moving, self.transmitter, &self.receivers)
    }

    /// Returns the position of the fixed end of links with a receiver, metres from the origin; `None` if it is a transmitter of
    /// unknown position.
    pub fn fixed_end(&self, receiver: usize) -> Option<Vec3> {
        match self.moving {
            End::Transmitter => Some(self.receivers[receiver].pose.position_vec()),
            End::Receiver => self.transmitter.map(|position| Pose::from(position).position_vec()),
        }
    }

    /// Returns the query for the moving end at a position in the user's frame and the receiver of an index. A receiver that moves
    /// has its usual orientation.
    pub fn query(&self, position: [f64; 3], receiver: usize) -> Query<'static> {
        let orientation = match self.moving {
            End::Transmitter => Pose::IDENTITY.orientation,
            End::Receiver => self.receivers[receiver].pose.orientation,
        };
        Query::at(Pose { position, orientation }, receiver)
    }

    /// Returns the pose of the first receiver in the user's frame.
    pub fn world_pose(&self) -> Pose {
        self.origin.world_pose(self.pose())
    }

    /// Returns the elevations of the rows of a spectrum; those of the upper hemisphere if pixels have no angles.
    pub fn elevation(&self) -> Elevation {
        self.plane.elevation().unwrap_or(Elevation::UPPER)
    }

    /// Returns the carrier of each receiver as a network input: the logarithm of its frequency, scaled to the range -1 to
    /// 1 over all receivers. Empty unless all receivers state a carrier and at least two differ.
    pub fn carriers(&self) -> Vec<Real> {
        let logs: Option<Vec<f64>> = self.receivers.iter().map(|receiver| Some(receiver.carrier_hz?.ln())).collect();
        let logs = logs.unwrap_or_default();
        let (low, high) = logs.iter().fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(*v), high.max(*v)));
        if low >= high {
            return Vec::new();
        }
        logs.iter().map(|v| (2.0 * (v - low) / (high - low) - 1.0) as Real).collect()
    }

    /// Returns the subcarrier frequencies of a receiver, Hz: `frequencies_hz`, moved so that their mean is its carrier if it has
    /// one.
    pub fn frequencies_of(&self, receiver: usize) -> Vec<f64> {
        let (common, carrier) = (&self.frequencies_hz, self.receivers[receiver].carrier_hz);
        let middle = common.iter().sum::<f64>() / common.len().max(1) as f64;
        let moved = |hz: &f64| carrier.map_or(*hz, |carrier| carrier + (hz - middle));
        common.iter().map(moved).collect()
    }

    /// Returns the network inputs of the links `queries`, with `width` numbers per location. Consecutive links share them if
    /// pose, features and carrier are equal.
    ///
    /// # Panics
    /// If there is no receiver of the index of a query.
    pub fn inputs<'q>(&self, width: usize, queries: impl Iterator<Item = Query<'q>>) -> LinkInputs {
        let (mut inputs, carriers, mut last) = (LinkInputs::of(width, self), self.carriers(), None);
        for query in queries {
            let receiver = query.receiver;
            assert!(receiver < self.receivers.len(), "receiver {receiver} of {}", self.receivers.len());
            let carrier = carriers.get(receiver);
            let input = (query.pose, query.features, carrier);
            let pose = self.origin.local_pose(query.pose);
            if last != Some(input) {
                inputs.carriers.extend(carrier);
                inputs.values.extend_from_slice(query.features.unwrap_or(&pose.position_vec().to_array()));
            }
            inputs.add_link(self, receiver, pose);
            last = Some(input);
        }
        inputs
    }
}

/// Links with the network inputs of their locations and the poses of their receivers, from
/// [`MeasurementSetup::inputs`].
#[derive(Clone, Debug, Default)]
pub struct LinkInputs {
    /// Number of network inputs per location.
    pub width: usize,
    /// Network inputs `[T, width]` of T locations: the position of the moving end, metres from the origin, or features.
    pub values: Vec<Real>,
    /// Carriers `[T]` ([`MeasurementSetup::carriers`]); empty for one carrier.
    pub carriers: Vec<Real>,
    /// Receivers: all of the setup, or moving ones at one pose after another.
    pub receivers: Vec<ReceiverState>,
    /// Links: pairs of a row of `values` and a row of `receivers`.
    pub pairs: Vec<Link>,
}

/// A receiver at a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReceiverState {
    /// Index of the receiver in the setup.
    pub receiver: usize,
    /// Its pose, relative to the origin.
    pub pose: Pose,
}

impl LinkInputs {
    /// Creates the inputs of no links, at the fixed receivers of `setup`.
    pub fn of(width: usize, setup: &MeasurementSetup) -> Self {
        let fixed = setup.receivers.iter().enumerate().filter(|_| setup.moving == End::Transmitter);
        let receivers = fixed.map(|(receiver, state)| ReceiverState { receiver, pose: state.pose }).collect();
        Self { width, receivers, ..Self::default() }
    }

    /// Adds the link of the last network inputs, which must exist, with a receiver of `setup`; a receiver that moves is at `pose`
    /// (metres from the origin).
    pub fn add_link(&mut self, setup: &MeasurementSetup, receiver: usize, pose: Pose) {
        let mut row = receiver;
        if setup.moving.is_receiver() {
            let state = ReceiverState { receiver, pose };
            if self.receivers.last() != Some(&state) {
                self.receivers.push(state);
            }
            row = self.receivers.len() - 1;
        }
        self.pairs.push(Link { location: self.values.len() / self.width.max(1) - 1, receiver: row });
    }

    /// Borrows the network inputs.
    pub fn conditions(&self) -> Conditions<'_> {
        Conditions::new(self.width, &self.values).at_carriers(&self.carriers)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[should_panic(expected = "receiver 1 of 1")]
    fn receiver_out_of_range_is_not_replaced_by_another() {
        let setup = MeasurementSetup::spectra(Origin::ZERO, Pose::IDENTITY, ImagePlane::plain(1, 1));
        setup.inputs(3, std::iter::once(Query::at([0.0; 3], 1)));
    }

    #[test]
    fn moving_receiver_has_a_pose_in_links_with_features_too() {
        let plane = ImagePlane::plain(1, 1);
        let fixed = MeasurementSetup::spectra(Origin::ZERO, Pose::IDENTITY, plane);
        let setup = MeasurementSetup { moving: End::Receiver, ..fixed };
        for features in [None, Some(&[0.5, 1.0, 2.0][..])] {
            let links = setup.inputs(3, std::iter::once(Query { features, ..Query::at([1.0; 3], 0) }));
            let pose = Pose { position: [1.0; 3], ..Pose::IDENTITY };
            assert_eq!(links.receivers, [ReceiverState { receiver: 0, pose }]);
            assert_eq!(links.pairs, [Link { location: 0, receiver: 0 }]);
        }
    }
}
