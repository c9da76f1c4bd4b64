//! What is measured, and where: `Pose`, `Scene`, `Sample`, `Dataset`, `Partition`.

use crate::origin::{Origin, place_fault};
use crate::words::clean;
use crate::{Axis, Documented, Elevation, Error, Image, ImagePlane, Mat3, Real, Result, Spectra, Vec3};
use serde::{Deserialize, Serialize};

/// Position and orientation of the receiver.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Documented)]
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

/// One transmitter position; the spectrum measured for it stands at the same place of [`Dataset::spectra`].
#[derive(Clone, Debug)]
pub struct Sample {
    /// The number the data set gives it.
    pub id: u32,
    /// Transmitter position `p_tx` as the file has it, metres, user's frame.
    pub tx: [f64; 3],
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
    /// The spectrum of every sample, in the same order.
    pub spectra: Spectra,
    /// The split that comes with the data, if any: indices into `samples` for (train, test).
    pub official: Option<(Vec<usize>, Vec<usize>)>,
    /// What the spectra were computed from; `None` where they were measured.
    pub simulation: Option<Simulation>,
    /// What the source holds beside the samples.
    pub unmatched: Unmatched,
}

/// Halves of samples, which a source leaves out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Unmatched {
    /// Positions without a picture.
    pub positions: usize,
    /// Pictures without a position.
    pub pictures: usize,
}

/// Says of a data set that it is simulated.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Simulation {
    /// The room that was simulated, as the RON text of a scene with every setting written out; `None` where the data do
    /// not say, or come from no room.
    pub scene: Option<String>,
}

impl Dataset {
    /// Measured spectra, one a sample, with the surface `points` `[P,3]` that are known (metres; none will do). All places
    /// are in the user's frame. The bounds hold the points, the samples and the receiver.
    ///
    /// Rows are elevations from 0 to 90 degrees, there is no official split, nothing is simulated, and nothing was left
    /// out: who knows better sets these fields.
    ///
    /// ```
    /// # use pwrfgs_core::{Dataset, Pose, Sample, Spectra};
    /// let samples = (1..=20).map(|id| Sample { id, tx: [f64::from(id), 0.0, 1.5] }).collect();
    /// let spectra = Spectra::grey((90, 24), vec![7; 20 * 90 * 24])?;
    /// let data = Dataset::new("my room", Pose::IDENTITY, vec![], samples, spectra)?;
    /// assert_eq!(data.scene.bounds, ([0.0; 3], [20.0, 0.0, 1.5]));
    /// # Ok::<(), pwrfgs_core::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Config`] where ids do not increase, there are more or fewer spectra than samples, or a place is not finite
    /// or beyond 1e8 m.
    pub fn new(
        title: impl Into<String>,
        receiver: Pose,
        points: Vec<[f64; 3]>,
        samples: Vec<Sample>,
        spectra: Spectra,
    ) -> Result<Self> {
        let title = clean(&title.into());
        let refuse = |what: String| Err(Error::Config(format!("data set `{title}`: {what}")));
        if let Some((_, fault)) = receiver.fault() {
            return refuse(format!("receiver: {fault}"));
        }
        if samples.len() != spectra.len() {
            let (have, need) = (spectra.len(), samples.len());
            return refuse(format!("{have} spectra for {need} transmitters; give as many of each"));
        }
        if let Some(pair) = samples.windows(2).find(|pair| pair[0].id >= pair[1].id) {
            return refuse(format!("id {} follows {}; sort the samples by ids that differ", pair[1].id, pair[0].id));
        }
        for Sample { id, tx } in &samples {
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
        let (width, height) = (spectra.width(), spectra.height());
        let elevation = Elevation::UPPER;
        Ok(Self {
            title,
            scene,
            width,
            height,
            elevation,
            samples,
            spectra,
            official: None,
            simulation: None,
            unmatched: Unmatched::default(),
        })
    }

    /// Whether the spectra are simulated, not measured.
    pub fn is_simulated(&self) -> bool {
        self.simulation.is_some()
    }

    /// What a pixel of the spectra is: columns go once around, rows are [`Self::elevation`].
    pub fn plane(&self) -> ImagePlane {
        let azimuth = Axis { first: 0.0, step: 360.0 / self.width as f64 };
        let angles = Some((azimuth, self.elevation.axis(self.height)));
        ImagePlane { width: self.width, height: self.height, wraps: true, angles }
    }

    /// Spectrum of sample `i` (an index, not an id).
    pub fn image(&self, i: usize) -> Image {
        self.spectra.image(i)
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
    /// All but the test part.
    pub fn known(&self) -> Known<'_> {
        Known { train: &self.train, validation: &self.validation }
    }
}

/// The samples that a baseline may learn from; indices into [`Dataset::samples`], two disjoint lists.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Known<'a> {
    /// What a model learns from, too.
    pub train: &'a [usize],
    /// What choices are made on, where there are any to make. Then it is learned from like the rest.
    pub validation: &'a [usize],
}

impl<'a> Known<'a> {
    /// A training part without validation.
    pub fn train(train: &'a [usize]) -> Self {
        Self { train, validation: &[] }
    }

    /// Training and validation together, sorted.
    pub fn all(&self) -> Vec<usize> {
        let mut all = [self.train, self.validation].concat();
        all.sort_unstable();
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_data_set_that_cannot_be_is_refused_with_what_is_wrong() {
        let sample = |id, x| Sample { id, tx: [x, 0.0, 0.0] };
        let new = |receiver, points, count: usize, samples| {
            let spectra = Spectra::grey((3, 2), vec![0; 6 * count]).unwrap();
            Dataset::new("room", receiver, points, samples, spectra).unwrap_err().to_string()
        };
        let turned = |orientation| Pose { orientation, ..Pose::IDENTITY };
        let far = Pose { position: [1e300, 0.0, 0.0], ..Pose::IDENTITY };
        let good = || vec![sample(1, 0.0)];
        let said = [
            new(turned([0.0; 4]), vec![], 1, good()),
            new(turned([0.0, 0.0, 0.0, 1.01]), vec![], 1, good()),
            new(Pose::IDENTITY, vec![], 1, vec![]),
            new(Pose::IDENTITY, vec![], 2, good()),
            new(Pose::IDENTITY, vec![], 2, vec![sample(2, 0.0), sample(2, 1.0)]),
            new(Pose::IDENTITY, vec![], 1, vec![sample(1, f64::NAN)]),
            new(Pose::IDENTITY, vec![[0.0, f64::INFINITY, 0.0]], 1, good()),
        ];
        let why = ["is zero", "has length 1.01", "1 spectra for 0", "2 spectra for 1", "id 2 follows 2", "NaN", "inf"];
        for (said, why) in said.iter().zip(why) {
            assert!(said.starts_with("data set `room`: ") && said.contains(why), "{said}");
        }
        assert!(new(far, vec![], 1, good()).contains("receiver: the position is 1e300 m, beyond 1e8 m"));
    }

    #[test]
    fn map_coordinates_count_from_the_receiver() {
        let one = || Spectra::grey((3, 2), vec![0; 6]).unwrap();
        let at = |x: f64| vec![Sample { id: 1, tx: [x, 0.25, 0.0] }];
        let receiver = Pose { position: [5.5, 0.0, 0.0], ..Pose::IDENTITY };
        let room = Dataset::new("room", receiver, vec![[1000.0; 3]], at(2.5), one()).unwrap().scene;
        assert_eq!((room.origin, room.receiver, room.points), (Origin::ZERO, receiver, vec![[1000.0; 3]]));
        let map = Dataset::new("map", receiver, vec![[1.0, 2.0, 3.0]], at(5_399_999.54), one()).unwrap().scene;
        assert_eq!((map.origin.0, map.receiver.position), ([6.0, 0.0, 0.0], [-0.5, 0.0, 0.0]));
        assert_eq!((map.points, map.bounds.1), (vec![[-5.0, 2.0, 3.0]], [5_399_993.54, 2.0, 3.0]));
    }
}
