//! `Scene`: the fixed part of a measurement campaign.

use crate::{Origin, Pose, Real, Receiver};

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
