//! What is measured, and where: `Pose`, `Scene`, `Sample`, `Dataset`, `Partition`.

use crate::{Image, Mat3, Real, Vec3};
use serde::{Deserialize, Serialize};

/// Position and orientation of the receiver.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
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
        let [x, y, z, w] = self.orientation;
        let m = glam::DMat3::from_quat(glam::DQuat::from_xyzw(x, y, z, w).normalize());
        let c = m.to_cols_array().map(|v| v as Real);
        Mat3::from_cols_array(&c)
    }

    /// Position as a vector of the kernels' precision.
    pub fn origin(&self) -> Vec3 {
        let p = self.position.map(|v| v as Real);
        Vec3::from_array(p)
    }
}

/// The fixed part of a measurement campaign.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The one receiver.
    pub receiver: Pose,
    /// Smallest and largest corner of everything known: cloud, receiver and transmitters; metres.
    pub bounds: ([Real; 3], [Real; 3]),
    /// Surface points `[P,3]` in metres, empty where no point cloud was given.
    pub points: Vec<[Real; 3]>,
}

/// One transmitter position and the spectrum measured for it.
#[derive(Clone, Debug)]
pub struct Sample {
    /// The number the data set gives it.
    pub id: u32,
    /// Transmitter position `p_tx` as the file has it, metres, world frame.
    pub tx: [f64; 3],
    /// Spectrum, row-major 8-bit grey as stored (255 is 1.0).
    pub spectrum: Vec<u8>,
}

impl Sample {
    /// Transmitter position at the kernels' precision.
    pub fn tx_real(&self) -> [Real; 3] {
        self.tx.map(|v| v as Real)
    }
}

/// Everything a data source gives.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// What a person should call it.
    pub title: String,
    /// Receiver, bounds and points.
    pub scene: Scene,
    /// Columns of every spectrum.
    pub width: usize,
    /// Rows of every spectrum.
    pub height: usize,
    /// Samples, sorted by id.
    pub samples: Vec<Sample>,
    /// The split that comes with the data, if any: indices into `samples` for (train, test).
    pub official: Option<(Vec<usize>, Vec<usize>)>,
    /// What the spectra were computed from; `None` where they were measured.
    pub simulation: Option<Simulation>,
}

/// Says of a data set that it is simulated.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Simulation {
    /// The room that was simulated, as the RON text of a scene with every setting written out; `None` where the data do
    /// not say, or come from no room.
    pub scene: Option<String>,
}

impl Dataset {
    /// Whether the spectra are simulated, not measured.
    pub fn is_simulated(&self) -> bool {
        self.simulation.is_some()
    }

    /// Spectrum of sample `i` (an index, not an id) as floats.
    pub fn image(&self, i: usize) -> Image {
        Image::from_bytes(self.width, self.height, &self.samples[i].spectrum)
    }

    /// Smallest and largest corner of the given points; zeros for none.
    pub fn bounds_of(points: impl IntoIterator<Item = [Real; 3]>) -> ([Real; 3], [Real; 3]) {
        let mut points = points.into_iter();
        let Some(first) = points.next() else { return ([0.0; 3], [0.0; 3]) };
        points.fold((first, first), |(mut low, mut high), p| {
            for k in 0..3 {
                low[k] = low[k].min(p[k]);
                high[k] = high[k].max(p[k]);
            }
            (low, high)
        })
    }
}

/// Which samples serve what; indices into [`Dataset::samples`], each list sorted, the lists disjoint.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Partition {
    /// What the model learns from.
    pub train: Vec<usize>,
    /// What curves and choices look at.
    pub validation: Vec<usize>,
    /// Read once, at the end.
    pub test: Vec<usize>,
}

impl Partition {
    /// Training and validation together, sorted: what baselines learn from, for they make no choices.
    pub fn known(&self) -> Vec<usize> {
        let mut known = [self.train.as_slice(), &self.validation].concat();
        known.sort_unstable();
        known
    }
}
