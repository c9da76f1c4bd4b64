//! What is measured, and where: `Pose`, `Scene`, `Sample`, `Dataset`, `Partition`.

use crate::origin::{Origin, place_fault};
use crate::words::clean;
use crate::{Elevation, Error, Image, Mat3, Real, Result, Vec3};
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

/// The fixed part of a measurement campaign.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The place in the user's frame that all others here count from; zero but for map coordinates.
    pub origin: Origin,
    /// The one receiver, from the origin.
    pub receiver: Pose,
    /// Smallest and largest corner of everything known: cloud, receiver and transmitters; metres from the origin.
    pub bounds: ([Real; 3], [Real; 3]),
    /// Surface points `[P,3]` in metres from the origin, empty where no point cloud was given.
    pub points: Vec<[Real; 3]>,
}

/// One transmitter position and the spectrum measured for it.
#[derive(Clone, Debug)]
pub struct Sample {
    /// The number the data set gives it.
    pub id: u32,
    /// Transmitter position `p_tx` as the file has it, metres, user's frame.
    pub tx: [f64; 3],
    /// Spectrum, row-major 8-bit grey as stored (255 is 1.0).
    pub spectrum: Vec<u8>,
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
    /// What the rows of the spectra are; columns go once around.
    pub elevation: Elevation,
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
    /// Measured spectra from arrays in memory, `width` columns by `height` rows each, with the surface `points` `[P,3]`
    /// that are known (metres; none will do). All places are in the user's frame. The bounds hold the points, the samples and the receiver.
    ///
    /// Rows are elevations from 0 to 90 degrees, there is no official split, and nothing is simulated: who knows better sets
    /// these fields.
    ///
    /// ```
    /// # use pwrfgs_core::{Dataset, Pose, Sample};
    /// let sample = |id: u32| Sample { id, tx: [f64::from(id), 0.0, 1.5], spectrum: vec![id as u8; 90 * 24] };
    /// let data = Dataset::new("my room", Pose::IDENTITY, vec![], (90, 24), (1..=20).map(sample).collect())?;
    /// assert_eq!(data.scene.bounds, ([0.0; 3], [20.0, 0.0, 1.5]));
    /// # Ok::<(), pwrfgs_core::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Config`] where there is no sample, ids do not increase, a spectrum has another size, or a place is not
    /// finite or beyond 1e8 m.
    pub fn new(
        title: impl Into<String>,
        receiver: Pose,
        points: Vec<[f64; 3]>,
        (width, height): (usize, usize),
        samples: Vec<Sample>,
    ) -> Result<Self> {
        let title = clean(&title.into());
        let refuse = |what: String| Err(Error::Config(format!("data set `{title}`: {what}")));
        if let Some((_, fault)) = receiver.fault() {
            return refuse(format!("receiver: {fault}"));
        }
        if samples.is_empty() || width * height == 0 {
            return refuse(format!(
                "{} spectra of {width} x {height} pixels; give at least one of each",
                samples.len()
            ));
        }
        if let Some(pair) = samples.windows(2).find(|pair| pair[0].id >= pair[1].id) {
            return refuse(format!("id {} follows {}; sort the samples by ids that differ", pair[1].id, pair[0].id));
        }
        for Sample { id, tx, spectrum } in &samples {
            if spectrum.len() != width * height {
                let have = spectrum.len();
                return refuse(format!("the spectrum of id {id} has {have} pixels and not {width} x {height}"));
            }
            if let Some(fault) = place_fault(*tx) {
                return refuse(format!("the transmitter of id {id} at {tx:?} {fault}"));
            }
        }
        if let Some((point, fault)) = points.iter().find_map(|point| Some((point, place_fault(*point)?))) {
            return refuse(format!("a point at {point:?} {fault}"));
        }
        let txs = || samples.iter().map(|sample| sample.tx);
        let origin = Origin::of(receiver.position, points.iter().copied().chain(txs()));
        let receiver = origin.local_pose(receiver);
        let points: Vec<[Real; 3]> = points.into_iter().map(|point| origin.local(point)).collect();
        let known = txs().map(|tx| origin.local(tx)).chain(points.iter().copied());
        let bounds = bounds_of(known.chain([receiver.origin().to_array()]));
        let scene = Scene { origin, receiver, bounds, points };
        Ok(Self { title, scene, width, height, elevation: Elevation::UPPER, samples, official: None, simulation: None })
    }

    /// Whether the spectra are simulated, not measured.
    pub fn is_simulated(&self) -> bool {
        self.simulation.is_some()
    }

    /// Spectrum of sample `i` (an index, not an id) as floats.
    pub fn image(&self, i: usize) -> Image {
        Image::from_bytes(self.width, self.height, &self.samples[i].spectrum)
    }
}

/// Smallest and largest corner of the given points.
fn bounds_of(points: impl Iterator<Item = [Real; 3]>) -> ([Real; 3], [Real; 3]) {
    let nothing = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let (low, high) = points.map(Vec3::from_array).fold(nothing, |(low, high), p| (low.min(p), high.max(p)));
    (low.to_array(), high.to_array())
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_data_set_that_cannot_be_is_refused_with_what_is_wrong() {
        let sample = |id, x| Sample { id, tx: [x, 0.0, 0.0], spectrum: vec![0; 6] };
        let new = |receiver, points, size, samples| {
            Dataset::new("room", receiver, points, size, samples).unwrap_err().to_string()
        };
        let turned = |orientation| Pose { orientation, ..Pose::IDENTITY };
        let far = Pose { position: [1e300, 0.0, 0.0], ..Pose::IDENTITY };
        let good = || vec![sample(1, 0.0)];
        let said = [
            new(turned([0.0; 4]), vec![], (3, 2), good()),
            new(turned([0.0, 0.0, 0.0, 1.01]), vec![], (3, 2), good()),
            new(Pose::IDENTITY, vec![], (3, 2), vec![]),
            new(Pose::IDENTITY, vec![], (0, 2), good()),
            new(Pose::IDENTITY, vec![], (2, 2), good()),
            new(Pose::IDENTITY, vec![], (3, 2), vec![sample(2, 0.0), sample(2, 1.0)]),
            new(Pose::IDENTITY, vec![], (3, 2), vec![sample(1, f64::NAN)]),
            new(Pose::IDENTITY, vec![[0.0, f64::INFINITY, 0.0]], (3, 2), good()),
        ];
        let why = ["is zero", "has length 1.01", "0 spectra", "of 0 x 2", "6 pixels", "id 2 follows 2", "NaN", "inf"];
        for (said, why) in said.iter().zip(why) {
            assert!(said.starts_with("data set `room`: ") && said.contains(why), "{said}");
        }
        assert!(new(far, vec![], (3, 2), good()).contains("receiver: the position is 1e300 m, beyond 1e8 m"));
    }

    #[test]
    fn map_coordinates_count_from_the_receiver() {
        let at = |x: f64| Sample { id: 1, tx: [x, 0.25, 0.0], spectrum: vec![0; 6] };
        let receiver = Pose { position: [5.5, 0.0, 0.0], ..Pose::IDENTITY };
        let room = Dataset::new("room", receiver, vec![[1000.0; 3]], (3, 2), vec![at(2.5)]).unwrap().scene;
        assert_eq!((room.origin, room.receiver, room.points), (Origin::ZERO, receiver, vec![[1000.0; 3]]));
        let map = Dataset::new("map", receiver, vec![[1.0, 2.0, 3.0]], (3, 2), vec![at(5_399_999.54)]).unwrap().scene;
        assert_eq!((map.origin.0, map.receiver.position), ([6.0, 0.0, 0.0], [-0.5, 0.0, 0.0]));
        assert_eq!((map.points, map.bounds.1), (vec![[-5.0, 2.0, 3.0]], [5_399_993.54, 2.0, 3.0]));
    }
}
