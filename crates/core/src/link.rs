//! Who sends, who listens, and which of them were measured together: `Receiver`, `Link`, `Sample`.

use crate::{Pose, Real};

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
