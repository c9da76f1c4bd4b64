//! `Dataset`: observations and their positions, in columns.

mod carriers;

use crate::messages::strip_control;
use crate::{
    Camera, Elevation, Error, Features, Image, ImagePlane, Link, Observations, Origin, Pose, Query, Real, Receiver,
    Result, Sample, Scene, Spectra, Task, Transmitter, Vec3, carrier_fault, place_fault,
};
use std::collections::BTreeSet;

/// All data of a source, in columns: transmitters, receivers, links between them, and the observation of each link.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// Display name.
    pub title: String,
    /// Receivers, bounds and points.
    pub scene: Scene,
    /// Number of columns of every observation.
    pub width: usize,
    /// Number of rows of every observation.
    pub height: usize,
    /// Elevations of the rows of spectra; columns cover the full circle.
    pub elevation: Elevation,
    /// Transmitter positions, sorted by ID.
    pub transmitters: Vec<Transmitter>,
    /// Links, sorted by transmitter, then receiver.
    pub links: Vec<Link>,
    /// Observations of the links, in the same order.
    pub observations: Observations,
    /// Input features per link that replace the transmitter position (for example the uplink channel).
    pub features: Option<Features>,
    /// Orientations `[T,4]` of a moving receiver, as in [`Pose`]. The receiver then stands at the position of each
    /// "transmitter", and the one receiver of the scene is the fixed transmitter (channels are reciprocal). `None` for fixed
    /// receivers.
    pub orientations: Option<Vec<[f64; 4]>>,
    /// Camera of the images, in the frame of the receiver; the elevations then do not apply. `None` for spectra over angles.
    pub camera: Option<Camera>,
    /// Whether the data contain transmitter positions. If not, positions are zero and must not be used.
    pub placed: bool,
    /// Official split of the data, if any: links for (training, test).
    pub official: Option<(Vec<usize>, Vec<usize>)>,
    /// Description of the simulation; `None` for measured data.
    pub simulation: Option<Simulation>,
    /// Positions and spectra without a counterpart in the source.
    pub unmatched: Unmatched,
}

/// Numbers of incomplete samples, which a source leaves out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Unmatched {
    /// Positions without a spectrum.
    pub positions: usize,
    /// Spectra without a position.
    pub pictures: usize,
}

/// Description of simulated data.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Simulation {
    /// Simulated room, as the RON text of a scene with all settings; `None` if the data do not state it or have no
    /// room.
    pub scene: Option<String>,
}

impl Dataset {
    /// Creates a data set of measured spectra at one receiver, one per sample, with surface `points` `[P,3]` in metres
    /// (may be empty). Positions are in the user's frame. The bounds contain the points, the samples and the receiver.
    ///
    /// Rows are elevations from 0 to 90 degrees; there is no official split, no simulation and no unmatched sample. Set
    /// these fields afterwards if they differ.
    ///
    /// ```
    /// # use pwrfgs_core::{Dataset, Pose, Sample, Spectra};
    /// let samples = (1..=20).map(|id| Sample::new(id, [f64::from(id), 0.0, 1.5])).collect();
    /// let spectra = Spectra::grey((90, 24), vec![7; 20 * 90 * 24])?;
    /// let data = Dataset::new("my room", Pose::IDENTITY, vec![], samples, spectra)?;
    /// assert_eq!(data.scene.bounds, ([0.0; 3], [20.0, 0.0, 1.5]));
    /// # Ok::<(), pwrfgs_core::Error>(())
    /// ```
    ///
    /// # Errors
    /// As [`Self::of_links`].
    #[allow(clippy::needless_pass_by_value)] // who has a list of samples made it for this
    pub fn new(
        title: impl Into<String>,
        receiver: Pose,
        points: Vec<[f64; 3]>,
        samples: Vec<Sample>,
        spectra: Spectra,
    ) -> Result<Self> {
        Self::of_links(title, vec![Receiver::new("receiver", receiver)], points, &samples, spectra.into())
    }

    /// Creates a data set of any observations at any number of receivers, one per sample; samples are sorted by ID,
    /// then receiver.
    ///
    /// ```
    /// # use pwrfgs_core::{Dataset, Observations, Pose, Receiver, Sample};
    /// let at = |name: &str, x| Receiver::new(name, Pose { position: [x, 0.0, 2.5], ..Pose::IDENTITY });
    /// let tx = [1.0, 2.0, 1.5];
    /// let samples = [Sample { id: 1, tx, receiver: 0 }, Sample { id: 1, tx, receiver: 1 }];
    /// let powers = vec![-61.0, -70.5].into();
    /// let data = Dataset::of_links("hall", vec![at("north", 0.0), at("south", 9.0)], vec![], &samples, powers)?;
    /// assert_eq!((data.transmitters.len(), data.len()), (1, 2));
    /// # Ok::<(), pwrfgs_core::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Config`] for invalid input:
    ///
    /// - IDs decrease, a link occurs twice, or one ID has two positions.
    /// - The numbers of observations and samples differ, or an observation is not finite.
    /// - Two receivers have one name, or a sample has an unknown receiver.
    /// - A position is not finite or beyond 1e8 m.
    pub fn of_links(
        title: impl Into<String>,
        receivers: Vec<Receiver>,
        points: Vec<[f64; 3]>,
        samples: &[Sample],
        observations: Observations,
    ) -> Result<Self> {
        let title = strip_control(&title.into());
        let refuse = |what: String| Error::Config(format!("data set `{title}`: {what}"));
        check_receivers(&receivers).map_err(refuse)?;
        if let Some(fault) = observations.fault() {
            return Err(refuse(fault));
        }
        if samples.len() != observations.len() {
            let (have, need, what) = (observations.len(), samples.len(), observations.task().plural);
            return Err(refuse(format!("{have} {what} for {need} transmitters; give as many of each")));
        }
        let (transmitters, links) = columns(samples, &receivers).map_err(refuse)?;
        if let Some((point, fault)) = points.iter().find_map(|point| Some((point, place_fault(*point)?))) {
            return Err(refuse(format!("a point at {point:?} {fault}")));
        }
        let (width, height) = observations.size();
        Ok(Self {
            title,
            scene: scene(receivers, points, &transmitters),
            width,
            height,
            elevation: Elevation::UPPER,
            transmitters,
            links,
            observations,
            features: None,
            orientations: None,
            camera: None,
            placed: true,
            official: None,
            simulation: None,
            unmatched: Unmatched::default(),
        })
    }

    /// Turns measured spectra at moving transmitters into those of a moving receiver with these orientations, one per
    /// position.
    ///
    /// # Errors
    /// Another task, several receivers, another number of orientations, or one that is not of length 1.
    pub fn with_moving_receiver(self, orientations: Vec<[f64; 4]>) -> Result<Self> {
        let refuse = |what: String| Err(Error::Config(format!("data set `{}`: {what}", self.title)));
        if !self.task().has_pixels || self.scene.receivers.len() > 1 {
            return refuse("only spectra of one receiver may have a moving receiver".into());
        }
        if orientations.len() != self.transmitters.len() {
            let (have, need) = (orientations.len(), self.transmitters.len());
            return refuse(format!("{have} orientations for {need} positions; give as many of each"));
        }
        let fault = |orientation: &[f64; 4]| Pose { orientation: *orientation, ..Pose::IDENTITY }.fault();
        if let Some((i, (_, fault))) = orientations.iter().enumerate().find_map(|(i, own)| Some((i, fault(own)?))) {
            return refuse(format!("pose {}: {fault}", i + 1));
        }
        Ok(Self { orientations: Some(orientations), ..self })
    }

    /// Returns the data set of these links, in ascending order without repetition. Scene and bounds are those of all
    /// links.
    ///
    /// # Errors
    /// [`Error::Config`] if there are no links, or they are not in ascending order; [`Error::Read`] of a spectrum.
    pub fn subset(&self, links: &[usize]) -> Result<Self> {
        if links.is_empty() || !links.is_sorted_by(|a, b| a < b) || links[links.len() - 1] >= self.len() {
            let what = "links of a subset: give at least one, in ascending order without repetition";
            return Err(Error::Config(what.into()));
        }
        let samples: Vec<Sample> = links.iter().map(|&i| self.sample(i)).collect();
        let observations = self.observations.subset(links)?;
        let receivers = self.scene.receivers.clone();
        let features = self
            .features
            .as_ref()
            .map(|own| Features { width: own.width, values: links.iter().flat_map(|&i| own.of(i)).copied().collect() });
        let turned = |all: &Vec<_>| links.iter().map(|&i| all[self.links[i].transmitter]).collect();
        let place = |all: &Vec<usize>| all.iter().filter_map(|i| links.binary_search(i).ok()).collect::<Vec<_>>();
        let official = self.official.as_ref().map(|(train, test)| (place(train), place(test)));
        Ok(Self {
            scene: self.scene.clone(),
            elevation: self.elevation,
            features,
            orientations: self.orientations.as_ref().map(turned),
            camera: self.camera,
            placed: self.placed,
            official: official.filter(|(train, test)| !train.is_empty() && !test.is_empty()),
            simulation: self.simulation.clone(),
            ..Self::of_links(self.title.clone(), receivers, vec![], &samples, observations)?
        })
    }

    /// Returns the number of links L: one per transmitter for a single receiver.
    pub fn len(&self) -> usize {
        self.links.len()
    }

    /// Returns whether there are no links.
    pub fn is_empty(&self) -> bool {
        self.links.is_empty()
    }

    /// Returns link `i` as a row.
    pub fn sample(&self, i: usize) -> Sample {
        let Link { transmitter, receiver } = self.links[i];
        let Transmitter { id, position } = self.transmitters[transmitter];
        Sample { id, tx: position, receiver }
    }

    /// Returns the label of link `i` in tables: the ID of its transmitter for a single receiver, otherwise its number
    /// from 1.
    pub fn label(&self, i: usize) -> u32 {
        if self.scene.receivers.len() == 1 { self.sample(i).id } else { i as u32 + 1 }
    }

    /// Returns all links as rows.
    pub fn samples(&self) -> impl ExactSizeIterator<Item = Sample> + Clone + '_ {
        (0..self.len()).map(|i| self.sample(i))
    }

    /// Returns the query for a prediction of link `i`.
    pub fn query(&self, i: usize) -> Query<'_> {
        let Sample { id, tx, receiver } = self.sample(i);
        let orientation = self.orientations.as_ref().map(|all| all[self.links[i].transmitter]);
        let features = self.features.as_ref().map_or(&[][..], |features| features.of(i));
        Query { tx, receiver, features, id: Some(id), orientation }
    }

    /// Returns the measurement type.
    pub fn task(&self) -> Task {
        self.observations.task()
    }

    /// Returns the transmitters of these links, each once, in ascending order.
    pub fn transmitters_of(&self, links: &[usize]) -> Vec<usize> {
        let mut all: Vec<usize> = links.iter().map(|i| self.links[*i].transmitter).collect();
        all.sort_unstable();
        all.dedup();
        all
    }

    /// Returns the links of these transmitters; both lists are in ascending order.
    pub fn links_of(&self, transmitters: &[usize]) -> Vec<usize> {
        let begin = |t: usize| self.links.partition_point(|link| link.transmitter < t);
        transmitters.iter().flat_map(|&t| begin(t)..begin(t + 1)).collect()
    }

    /// Returns these links by receiver.
    pub fn by_receiver(&self, links: impl IntoIterator<Item = usize>) -> Vec<Vec<usize>> {
        let mut all = vec![Vec::new(); self.scene.receivers.len()];
        links.into_iter().for_each(|i| all[self.links[i].receiver].push(i));
        all
    }

    /// Returns whether the data are simulated.
    pub fn is_simulated(&self) -> bool {
        self.simulation.is_some()
    }

    /// Returns the image plane of the spectra: that of the camera, or columns cover the full circle and rows are
    /// [`Self::elevation`]. The values of a power or channel have no direction.
    pub fn plane(&self) -> ImagePlane {
        if self.camera.is_some() {
            return ImagePlane { camera: self.camera, ..ImagePlane::plain(self.width, self.height) };
        }
        self.task().plane((self.width, self.height), self.elevation)
    }

    /// Returns the observation of link `i` as an array of numbers.
    pub fn image(&self, i: usize) -> Image {
        self.observations.image(i)
    }
}

/// Checks for at least one receiver, valid positions, unique names, antennas and carriers.
///
/// # Errors
/// The message names the receiver and its fault.
pub fn check_receivers(receivers: &[Receiver]) -> Result<(), String> {
    if receivers.is_empty() {
        return Err("no receiver; give at least one".into());
    }
    let mut names = BTreeSet::new();
    for Receiver { name, pose, antennas, carrier_hz } in receivers {
        let subject =
            if receivers.len() == 1 { "receiver".to_owned() } else { format!("receiver `{}`", strip_control(name)) };
        if let Some((_, fault)) = pose.fault() {
            return Err(format!("{subject}: {fault}"));
        }
        if let Some(fault) = antennas.iter().find_map(|place| place_fault(*place)) {
            return Err(format!("{subject}: an antenna {fault}"));
        }
        if antennas.is_empty() {
            return Err(format!(
                "{subject} has no antenna; give its position in the receiver frame, such as [0, 0, 0]"
            ));
        }
        if let Some(fault) = carrier_hz.and_then(carrier_fault) {
            return Err(format!("{subject}: {fault}"));
        }
        if !names.insert(name) {
            return Err(format!("two receivers have the name `{}`; give each a unique name", strip_control(name)));
        }
    }
    Ok(())
}

/// Converts rows to columns: every transmitter once, and the links.
fn columns(samples: &[Sample], receivers: &[Receiver]) -> Result<(Vec<Transmitter>, Vec<Link>), String> {
    let mut transmitters: Vec<Transmitter> = Vec::new();
    let mut links: Vec<Link> = Vec::with_capacity(samples.len());
    for Sample { id, tx, receiver } in samples {
        if *receiver >= receivers.len() {
            return Err(format!("id {id} has receiver {receiver}, but there are {}", receivers.len()));
        }
        match transmitters.last() {
            Some(last) if last.id == *id => {
                let earlier = links[links.len() - 1].receiver;
                if earlier >= *receiver {
                    let order = if receivers.len() == 1 { String::new() } else { " and receivers".into() };
                    return Err(format!("id {id} follows {id}; sort the samples by unique ids{order}"));
                }
                if last.position != *tx {
                    return Err(format!(
                        "the transmitter of id {id} has two positions, {:?} and {tx:?}",
                        last.position
                    ));
                }
            }
            Some(last) if last.id > *id => {
                return Err(format!("id {id} follows {}; sort the samples by unique ids", last.id));
            }
            _ => {
                if let Some(fault) = place_fault(*tx) {
                    return Err(format!("the transmitter of id {id} at {tx:?} {fault}"));
                }
                transmitters.push(Transmitter { id: *id, position: *tx });
            }
        }
        links.push(Link { transmitter: transmitters.len() - 1, receiver: *receiver });
    }
    Ok((transmitters, links))
}

/// Creates a scene relative to one origin.
fn scene(mut receivers: Vec<Receiver>, points: Vec<[f64; 3]>, transmitters: &[Transmitter]) -> Scene {
    let txs = || transmitters.iter().map(|transmitter| transmitter.position);
    let others: Vec<[f64; 3]> = receivers[1..].iter().map(|receiver| receiver.pose.position).collect();
    let origin = Origin::of(receivers[0].pose.position, points.iter().copied().chain(txs()).chain(others));
    receivers.iter_mut().for_each(|receiver| receiver.pose = origin.local_pose(receiver.pose));
    let points: Vec<[Real; 3]> = points.into_iter().map(|point| origin.local(point)).collect();
    let known = txs().map(|tx| origin.local(tx)).chain(points.iter().copied());
    let bounds = bounds_of(known.chain(receivers.iter().map(|receiver| receiver.pose.origin().to_array())));
    Scene { origin, receivers, bounds, points }
}

/// Returns the smallest and largest corner of the given points.
fn bounds_of(points: impl Iterator<Item = [Real; 3]>) -> ([Real; 3], [Real; 3]) {
    let nothing = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let (low, high) = points.map(Vec3::from_array).fold(nothing, |(low, high), p| (low.min(p), high.max(p)));
    (low.to_array(), high.to_array())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rejects_inconsistent_data_set_with_reason() {
        let sample = |id, x| Sample::new(id, [x, 0.0, 0.0]);
        let new = |receiver, points, count: usize, samples| {
            let spectra = Spectra::grey((3, 2), vec![0; 6 * count]).unwrap();
            Dataset::new("room", receiver, points, samples, spectra).unwrap_err().to_string()
        };
        let turned = |orientation| Pose { orientation, ..Pose::IDENTITY };
        let far = Pose { position: [1e300, 0.0, 0.0], ..Pose::IDENTITY };
        let good = || vec![sample(1, 0.0)];
        let message = [
            new(turned([0.0; 4]), vec![], 1, good()),
            new(turned([0.0, 0.0, 0.0, 1.01]), vec![], 1, good()),
            new(Pose::IDENTITY, vec![], 1, vec![]),
            new(Pose::IDENTITY, vec![], 2, good()),
            new(Pose::IDENTITY, vec![], 2, vec![sample(2, 0.0), sample(2, 1.0)]),
            new(Pose::IDENTITY, vec![], 1, vec![sample(1, f64::NAN)]),
            new(Pose::IDENTITY, vec![[0.0, f64::INFINITY, 0.0]], 1, good()),
        ];
        let why = ["is zero", "has length 1.01", "1 spectra for 0", "2 spectra for 1", "id 2 follows 2", "NaN", "inf"];
        for (message, why) in message.iter().zip(why) {
            assert!(message.starts_with("data set `room`: ") && message.contains(why), "{message}");
        }
        assert!(new(far, vec![], 1, good()).contains("receiver: the position is 1e300 m, beyond 1e8 m"));
    }

    #[test]
    fn map_coordinates_are_relative_to_receiver() {
        let one = || Spectra::grey((3, 2), vec![0; 6]).unwrap();
        let at = |x: f64| vec![Sample::new(1, [x, 0.25, 0.0])];
        let receiver = Pose { position: [5.5, 0.0, 0.0], ..Pose::IDENTITY };
        let room = Dataset::new("room", receiver, vec![[1000.0; 3]], at(2.5), one()).unwrap().scene;
        assert_eq!((room.origin, room.pose(), room.points), (Origin::ZERO, receiver, vec![[1000.0; 3]]));
        let map = Dataset::new("map", receiver, vec![[1.0, 2.0, 3.0]], at(5_399_999.54), one()).unwrap().scene;
        assert_eq!((map.origin.0, map.pose().position), ([6.0, 0.0, 0.0], [-0.5, 0.0, 0.0]));
        assert_eq!((map.points, map.bounds.1), (vec![[-5.0, 2.0, 3.0]], [5_399_993.54, 2.0, 3.0]));
    }
}
