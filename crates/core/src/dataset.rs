//! `Dataset`: observations and their positions, in columns.

mod carriers;
mod receivers;

use crate::messages::strip_control;
use crate::{
    Camera, Elevation, End, Ends, Error, Features, Image, ImagePlane, Link, Location, Observations, Origin, Pose,
    Query, Real, Receiver, Result, Sample, Scene, Spectra, Task, Vec3, carrier_fault, position_fault,
};
use std::collections::{BTreeMap, BTreeSet};

/// All data of a source, in columns: locations of the moving end, receivers, links between them, and the observation of
/// each link.
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
    /// Locations of the [moving end](Scene::moving), sorted by ID.
    pub locations: Vec<Location>,
    /// Links, sorted by location, then receiver.
    pub links: Vec<Link>,
    /// Observations of the links, in the same order.
    pub observations: Observations,
    /// Input features per link that replace the transmitter position (for example the uplink channel).
    pub features: Option<Features>,
    /// Whether the data contain the positions of the locations. If not, positions are zero and must not be used.
    pub placed: bool,
    /// Official split of the data, if any: links for (training, test).
    pub official: Option<(Vec<usize>, Vec<usize>)>,
    /// Description of the simulation; `None` for measured data.
    pub simulation: Option<Simulation>,
    /// Positions and spectra without a counterpart in the source.
    pub unmatched: Unmatched,
    /// Names of findings that the user accepted when the data were imported.
    pub accepted: Vec<String>,
}

/// Numbers of incomplete samples, which a source leaves out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Unmatched {
    /// Positions without a spectrum.
    pub positions: usize,
    /// Spectra without a position.
    pub spectra: usize,
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
    #[allow(clippy::needless_pass_by_value)] // callers create the list for this call
    pub fn new(
        title: impl Into<String>,
        receiver: Pose,
        points: Vec<[f64; 3]>,
        samples: Vec<Sample>,
        spectra: Spectra,
    ) -> Result<Self> {
        Self::of_links(title, vec![Receiver::new("receiver", receiver)], points, &samples, spectra.into())
    }

    /// Creates a data set of any observations at any number of receivers, one per sample. Give the samples sorted by ID,
    /// then receiver. The receivers are fixed, or move ([`Ends::of_moving_receivers`]): a sample then has their pose.
    ///
    /// ```
    /// # use pwrfgs_core::{Dataset, Observations, Pose, Receiver, Sample};
    /// let at = |name: &str, x| Receiver::new(name, Pose { position: [x, 0.0, 2.5], ..Pose::IDENTITY });
    /// let first = Sample::new(1, [1.0, 2.0, 1.5]);
    /// let samples = [first, Sample { receiver: 1, ..first }];
    /// let powers = vec![-61.0, -70.5].into();
    /// let data = Dataset::of_links("hall", vec![at("north", 0.0), at("south", 9.0)], vec![], &samples, powers)?;
    /// assert_eq!((data.locations.len(), data.len()), (1, 2));
    /// # Ok::<(), pwrfgs_core::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Config`] for invalid input:
    ///
    /// - IDs decrease, a link occurs twice, or one ID has two poses.
    /// - The numbers of observations and samples differ, or a power or channel is not finite. Spectra are not checked.
    /// - Receivers are invalid ([`check_receivers`]), or a sample has an unknown receiver.
    /// - A position is not finite or beyond 1e8 m, or an orientation is not of length 1.
    pub fn of_links(
        title: impl Into<String>,
        ends: impl Into<Ends>,
        points: Vec<[f64; 3]>,
        samples: &[Sample],
        observations: Observations,
    ) -> Result<Self> {
        let (title, ends) = (strip_control(&title.into()), ends.into());
        let refuse = |fault: String| Error::Config(format!("data set `{title}`: {fault}"));
        if samples.len() != observations.len() {
            let (count, needed, plural) = (observations.len(), samples.len(), observations.task().plural);
            let locations = if ends.moving.is_receiver() { "receiver poses" } else { "transmitters" };
            return Err(refuse(format!("{count} {plural} for {needed} {locations}; give as many of each")));
        }
        let (locations, links) = to_columns(samples, &ends).map_err(refuse)?;
        Self::of_columns(title, ends, points, locations, links, observations)
    }

    /// Creates a data set as [`Self::of_links`] does, from columns: locations of ascending IDs, and links in ascending order,
    /// one per observation.
    ///
    /// # Errors
    /// As [`Self::of_links`], for receivers, transmitter, observations and points. Locations and links are not checked.
    pub fn of_columns(
        title: impl Into<String>,
        ends: Ends,
        points: Vec<[f64; 3]>,
        locations: Vec<Location>,
        links: Vec<Link>,
        observations: Observations,
    ) -> Result<Self> {
        let title = strip_control(&title.into());
        let refuse = |fault: String| Error::Config(format!("data set `{title}`: {fault}"));
        check_receivers(&ends.receivers).map_err(refuse)?;
        if let Some(fault) = observations.fault() {
            return Err(refuse(fault));
        }
        if let Some((point, fault)) = points.iter().find_map(|point| Some((point, position_fault(*point)?))) {
            return Err(refuse(format!("a point at {point:?} {fault}")));
        }
        if let Some(fault) = ends.transmitter.and_then(position_fault) {
            return Err(refuse(format!("the transmitter {fault}")));
        }
        let (width, height) = observations.size();
        Ok(Self {
            title,
            scene: build_scene(ends, points, &locations),
            width,
            height,
            elevation: Elevation::UPPER,
            locations,
            links,
            observations,
            features: None,
            placed: true,
            official: None,
            simulation: None,
            unmatched: Unmatched::default(),
            accepted: Vec::new(),
        })
    }

    /// Returns the data set of these links, in ascending order without repetition. Scene and bounds are those of all
    /// links. The official split is left out if its training or test set would be empty.
    ///
    /// # Errors
    /// [`Error::Config`] if there are no links, they are not in ascending order, or one is not in the data;
    /// [`Error::Read`] if a spectrum cannot be read.
    pub fn subset(&self, links: &[usize]) -> Result<Self> {
        self.check_subset(links)?;
        self.select(links, self.observations.subset(links)?)
    }

    /// Returns the data set of these links as [`Self::subset`] does. Channels are moved, not copied.
    ///
    /// # Errors
    /// As [`Self::subset`].
    pub fn into_subset(mut self, links: &[usize]) -> Result<Self> {
        self.check_subset(links)?;
        let observations = std::mem::replace(&mut self.observations, Observations::Powers(Vec::new()));
        self.select(links, observations.into_subset(links)?)
    }

    /// Returns an error unless there are `links`, in ascending order without repetition and all in the data.
    fn check_subset(&self, links: &[usize]) -> Result<()> {
        if links.is_empty() || !links.is_sorted_by(|a, b| a < b) || links[links.len() - 1] >= self.len() {
            let order = "at least one, in ascending order without repetition";
            return Err(Error::Config(format!("links of a subset: give {order}, each below {}", self.len())));
        }
        Ok(())
    }

    /// Returns the data set of these links, which have the `observations`.
    fn select(&self, links: &[usize], observations: Observations) -> Result<Self> {
        let samples: Vec<Sample> = links.iter().map(|&i| self.sample(i)).collect();
        let subset = Self::of_links(self.title.clone(), self.scene.ends(), Vec::new(), &samples, observations)?;
        let rows = |features: &Features| Features {
            width: features.width,
            values: links.iter().flat_map(|&i| features.row(i)).copied().collect(),
        };
        let selected = |list: &Vec<usize>| list.iter().filter_map(|i| links.binary_search(i).ok()).collect::<Vec<_>>();
        let official = self.official.as_ref().map(|(train, test)| (selected(train), selected(test)));
        Ok(Self {
            scene: self.scene.clone(),
            elevation: self.elevation,
            features: self.features.as_ref().map(rows),
            placed: self.placed,
            official: official.filter(|(train, test)| !train.is_empty() && !test.is_empty()),
            simulation: self.simulation.clone(),
            accepted: self.accepted.clone(),
            ..subset
        })
    }

    /// Returns the number of links L: one per location for a single receiver.
    pub fn len(&self) -> usize {
        self.links.len()
    }

    /// Returns whether there are no links.
    pub fn is_empty(&self) -> bool {
        self.links.is_empty()
    }

    /// Returns link `i` as a row.
    pub fn sample(&self, i: usize) -> Sample {
        let Link { location, receiver } = self.links[i];
        let Location { id, pose } = self.locations[location];
        Sample { id, pose, receiver }
    }

    /// Returns the label of link `i` in tables: the ID of its location for a single receiver, otherwise its number from 1.
    pub fn label(&self, i: usize) -> u32 {
        if self.scene.receivers.len() == 1 { self.sample(i).id } else { i as u32 + 1 }
    }

    /// Returns all links as rows.
    pub fn samples(&self) -> impl ExactSizeIterator<Item = Sample> + Clone + '_ {
        (0..self.len()).map(|i| self.sample(i))
    }

    /// Returns the query for a prediction of link `i`.
    pub fn query(&self, i: usize) -> Query<'_> {
        let Sample { id, pose, receiver } = self.sample(i);
        let features = self.features.as_ref().map(|features| features.row(i));
        Query { pose, features, receiver, id: Some(id) }
    }

    /// Returns the queries for predictions of `links`, in their order.
    pub fn queries(&self, links: &[usize]) -> Vec<Query<'_>> {
        links.iter().map(|&i| self.query(i)).collect()
    }

    /// Returns the poses of transmitter and receiver of link `i` in the user's frame; an end of unknown position has an arbitrary
    /// one.
    pub fn link_ends(&self, i: usize) -> [Pose; 2] {
        let (moved, scene) = (self.locations[self.links[i].location].pose, &self.scene);
        match scene.moving {
            End::Transmitter => [moved, scene.origin.world_pose(scene.receivers[self.links[i].receiver].pose)],
            End::Receiver => [scene.origin.world_pose(scene.transmitter.unwrap_or_default().into()), moved],
        }
    }

    /// Returns the measurement type.
    pub fn task(&self) -> Task {
        self.observations.task()
    }

    /// Returns the locations of these links, each once, in ascending order.
    pub fn locations_of(&self, links: &[usize]) -> Vec<usize> {
        let mut locations: Vec<usize> = links.iter().map(|i| self.links[*i].location).collect();
        locations.sort_unstable();
        locations.dedup();
        locations
    }

    /// Returns the links of these locations, one location after the other: in ascending order if the locations are.
    pub fn links_of(&self, locations: &[usize]) -> Vec<usize> {
        let begin = |l: usize| self.links.partition_point(|link| link.location < l);
        locations.iter().flat_map(|&l| begin(l)..begin(l + 1)).collect()
    }

    /// Groups these links by receiver: one list per receiver, which keeps the order.
    pub fn group_by_receiver(&self, links: impl IntoIterator<Item = usize>) -> Vec<Vec<usize>> {
        let mut groups = vec![Vec::new(); self.scene.receivers.len()];
        links.into_iter().for_each(|i| groups[self.links[i].receiver].push(i));
        groups
    }

    /// Returns the title, followed by "(simulated)" if the data are simulated and the title does not have that word.
    pub fn marked_title(&self) -> String {
        let is_marked = !self.is_simulated() || self.title.to_lowercase().contains("simulated");
        format!("{}{}", self.title, if is_marked { "" } else { " (simulated)" })
    }

    /// Returns whether the data are simulated.
    pub fn is_simulated(&self) -> bool {
        self.simulation.is_some()
    }

    /// Returns the camera of the images, in the frame of the receiver: that of the first, since all receivers have the same.
    /// Elevations do not apply to images. `None` for spectra over angles.
    pub fn camera(&self) -> Option<Camera> {
        self.scene.receivers[0].camera
    }

    /// Returns the image plane of an observation. That of a spectrum is of the camera, or has columns over the full circle and
    /// rows over [`Self::elevation`]. The values of a power or channel have no direction.
    pub fn plane(&self) -> ImagePlane {
        if let Some(camera) = self.camera() {
            return ImagePlane { camera: Some(camera), ..ImagePlane::plain(self.width, self.height) };
        }
        self.task().plane((self.width, self.height), self.elevation)
    }

    /// Returns the observation of link `i` as an array of numbers.
    pub fn image(&self, i: usize) -> Image {
        self.observations.image(i)
    }
}

/// Checks that there is a receiver, that names are unique, and that poses, antennas, carriers and cameras are valid.
///
/// # Errors
/// There is no receiver; one has an invalid pose, antenna, carrier or camera, or no antenna; or two have one name. The
/// message names the receiver.
pub fn check_receivers(receivers: &[Receiver]) -> Result<(), String> {
    if receivers.is_empty() {
        return Err("no receiver; give at least one".into());
    }
    let mut names = BTreeSet::new();
    for Receiver { name, pose, antennas, carrier_hz, camera, .. } in receivers {
        let subject =
            if receivers.len() == 1 { "receiver".to_owned() } else { format!("receiver `{}`", strip_control(name)) };
        if let Some((_, fault)) = pose.fault() {
            return Err(format!("{subject}: {fault}"));
        }
        if let Some(fault) = antennas.iter().find_map(|antenna| position_fault(*antenna)) {
            return Err(format!("{subject}: an antenna {fault}"));
        }
        if let Some(fault) = camera.and_then(|camera| camera.fault()) {
            return Err(format!("{subject} has {fault}"));
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

/// Converts rows to columns: every location once, and the links.
///
/// # Errors
/// A row is out of order, has an unknown receiver or an invalid pose, or gives its ID a second pose; the message names the
/// ID of the first such row.
fn to_columns(samples: &[Sample], ends: &Ends) -> Result<(Vec<Location>, Vec<Link>), String> {
    let (moving, receivers) = (ends.moving, ends.receivers.len());
    let end = if moving.is_receiver() { "receiver" } else { "transmitter" };
    let mut locations: Vec<Location> = Vec::new();
    let mut links: Vec<Link> = Vec::with_capacity(samples.len());
    for &Sample { id, pose, receiver } in samples {
        let pose = if moving.is_receiver() { pose } else { pose.position.into() }; // a transmitter has world axes
        if receiver >= receivers {
            return Err(format!("id {id} has receiver {receiver}, but there are {receivers}"));
        }
        match locations.last() {
            Some(last) if last.id == id => {
                let earlier = links[links.len() - 1].receiver;
                if earlier >= receiver {
                    let order = if receivers == 1 { String::new() } else { " and receivers".into() };
                    return Err(format!("id {id} follows {id}; sort the samples by unique ids{order}"));
                }
                if last.pose != pose {
                    return Err(format!("the {end} of id {id} has {}", last.pose.describe_difference(&pose)));
                }
            }
            Some(last) if last.id > id => {
                return Err(format!("id {id} follows {}; sort the samples by unique ids", last.id));
            }
            _ => {
                if let Some((_, fault)) = pose.fault() {
                    return Err(format!("the {end} of id {id} at {:?}: {fault}", pose.position));
                }
                locations.push(Location { id, pose });
            }
        }
        links.push(Link { location: locations.len() - 1, receiver });
    }
    Ok((locations, links))
}

/// Creates a scene relative to one origin: near the first fixed end, or the first location if none is known.
fn build_scene(ends: Ends, points: Vec<[f64; 3]>, locations: &[Location]) -> Scene {
    let Ends { moving, transmitter, mut receivers } = ends;
    let positions = || locations.iter().map(|location| location.pose.position);
    let fixed: Vec<[f64; 3]> = match moving {
        End::Transmitter => receivers.iter().map(|receiver| receiver.pose.position).collect(),
        End::Receiver => transmitter.into_iter().collect(),
    };
    let first = fixed.first().copied().or_else(|| positions().next()).unwrap_or_default();
    let origin =
        Origin::for_receiver(first, points.iter().copied().chain(positions()).chain(fixed.iter().skip(1).copied()));
    if moving == End::Transmitter {
        receivers.iter_mut().for_each(|receiver| receiver.pose = origin.local_pose(receiver.pose));
    }
    let transmitter = transmitter.map(|position| origin.local_pose(position.into()).position);
    let points: Vec<[Real; 3]> = points.into_iter().map(|point| origin.local(point)).collect();
    let fixed = fixed.into_iter().map(|position| origin.local_pose(position.into()).position_vec().to_array());
    let occupied = positions().map(|position| origin.local(position)).chain(points.iter().copied());
    let bounds = bounding_box(occupied.chain(fixed));
    Scene { origin, moving, transmitter, receivers, bounds, points, geodetic: None, floors: BTreeMap::new() }
}

/// Returns the smallest and largest corner of the box around one or more points.
fn bounding_box(points: impl Iterator<Item = [Real; 3]>) -> ([Real; 3], [Real; 3]) {
    let empty = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let (low, high) = points.map(Vec3::from_array).fold(empty, |(low, high), p| (low.min(p), high.max(p)));
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
    fn rejects_second_orientation_of_an_id() {
        let turned = Pose { orientation: [0.0, 0.0, 1.0, 0.0], ..Pose::IDENTITY };
        let receivers = ["a", "b"].map(|name| Receiver::new(name, Pose::IDENTITY)).to_vec();
        let samples = [Sample::new(1, Pose::IDENTITY), Sample { receiver: 1, ..Sample::new(1, turned) }];
        let ends = Ends::of_moving_receivers(receivers, None);
        let powers = vec![-40.0, -50.0].into();
        let error = Dataset::of_links("hall", ends, vec![], &samples, powers).unwrap_err().to_string();
        assert!(error.ends_with("two orientations, [0.0, 0.0, 0.0, 1.0] and [0.0, 0.0, 1.0, 0.0]"), "{error}");
    }

    #[test]
    fn map_coordinates_are_relative_to_receiver() {
        let spectra = || Spectra::grey((3, 2), vec![0; 6]).unwrap();
        let at = |x: f64| vec![Sample::new(1, [x, 0.25, 0.0])];
        let receiver = Pose { position: [5.5, 0.0, 0.0], ..Pose::IDENTITY };
        let room = Dataset::new("room", receiver, vec![[1000.0; 3]], at(2.5), spectra()).unwrap().scene;
        assert_eq!((room.origin, room.pose(), room.points), (Origin::ZERO, receiver, vec![[1000.0; 3]]));
        let map = Dataset::new("map", receiver, vec![[1.0, 2.0, 3.0]], at(5_399_999.54), spectra()).unwrap().scene;
        assert_eq!((map.origin.0, map.pose().position), ([6.0, 0.0, 0.0], [-0.5, 0.0, 0.0]));
        assert_eq!((map.points, map.bounds.1), (vec![[-5.0, 2.0, 3.0]], [5_399_993.54, 2.0, 3.0]));
    }
}
