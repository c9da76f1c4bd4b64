//! `Simulated`: spectra, powers or channels of a scene as a data source, cached on disk.

#[cfg(test)]
mod tests;

use crate::observe::{ObservationKind, SILENT_DBM};
use crate::output::{self, CHANNELS, MANIFEST, POINTS, POSITIONS, POWERS, SPECTRA, is_test_sample};
use crate::recipe::{self, SimulationRecipe};
use crate::scene::{self, SceneFile};
use crate::spectrum::{HEIGHT, WIDTH};
use etcetera::BaseStrategy as _;
use pwrfgs_core::files::{self, NewFolder};
use pwrfgs_core::{
    Channels, DataSource, Dataset, Ends, Error, JsonSchema, Number, Observations, Pose, Progress, Real, Receiver,
    Result, Sample, ShippedFile, Simulation, Spectra, messages::strip_control,
};
use pwrfgs_data::{Arrays, POSES, npy_header, npy_header_as, read_points};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Largest size of spectra in memory, bytes; larger ones stay in the file.
const IN_MEMORY: u64 = 512 << 20;

/// *Simulated* spectra, powers or channels: ray tracing in a scene file.
///
/// Paths are computed with image sources, diffraction at edges and diffuse scattering patches. Their sum at the
/// receiver antennas gives the spectrum in the format of the measured files (`docs/concepts.md`), or another observation
/// set by `observe`. With several receivers, each adds one link per transmitter; links without a signal are left out.
/// The point cloud of the scene is exact, so `PointCloud` initialisation and `Chamfer` are meaningful. Every fifth
/// sample belongs to the test list of [`Official`](pwrfgs_data::Official).
///
/// The data set is simulated once and cached in the user's cache folder (or `$PWRFGS_CACHE`), under a key of the scene,
/// its meshes and all fields; the cache may be deleted at any time. Spectra of more than 512 MB stay on disk and are
/// read one by one. `pwrfgs simulate` writes the same data set to a folder, with every path.
///
/// ```
/// # use pwrfgs_core::{DataSource, Plugin};
/// # use pwrfgs_raytrace as _;
/// Plugin::<dyn DataSource>::parse(r#"Simulated(scene: "../scenes/office.ron", samples: 200)"#)?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Simulated {
    /// Scene file, relative to the pipeline file, or the name of a shipped scene, such as `office`.
    #[schemars(extend("format" = "path"))]
    pub scene: PathBuf,
    /// Number of transmitters; with one receiver, number of spectra. A scene with stated positions has as many as these.
    pub samples: usize,
    /// Random seed of transmitter positions and receiver errors, independent of the seed of the pipeline.
    pub seed: u64,
    /// Number of points of the cloud, spread over all surfaces; 190,000 in the paper.
    pub points: usize,
    /// Observation: `Spectrum`, `Power(noise_db: 3)` or `Channel(snr_db: 30)`.
    pub observe: ObservationKind,
    /// Whether to cache the data set on disk.
    pub cache: bool,
}

impl Default for Simulated {
    fn default() -> Self {
        Self {
            scene: "office".into(),
            samples: 1000,
            seed: 0,
            points: 190_000,
            observe: ObservationKind::Spectrum,
            cache: true,
        }
    }
}

impl Simulated {
    /// Reads the data set in a folder written by [`crate::output::write_links`]. Returns an error if it does not fit
    /// `recipe`.
    fn read_folder(&self, recipe: &SimulationRecipe, folder: &Path) -> Result<Dataset> {
        let points = (self.points > 0).then(|| folder.join(POINTS));
        let is_single = self.observe == ObservationKind::Spectrum && recipe.scene.more_receivers.is_empty();
        let mut data = if is_single {
            Arrays { root: folder.to_owned(), points, elevation: None }.load(Path::new(""), &|_, _| {})?
        } else {
            read_link_dataset(recipe, folder, points)?
        };
        let links = recipe.samples * recipe.scene.carrier_count();
        if (is_single && data.len() != links) || data.scene.points.len() != self.points {
            return Err(Error::input(folder, "holds an unexpected number of spectra or points"));
        }
        data.title = strip_control(&format!("{} (simulated)", recipe.scene.name));
        data.simulation = Some(Simulation { scene: Some(recipe.scene.to_ron()) });
        Ok(data)
    }
}

/// Reads the data set of all received links of all receivers; `points` is the file of the point cloud, if any. Returns an
/// error if there are no such links.
fn read_link_dataset(recipe: &SimulationRecipe, folder: &Path, points: Option<PathBuf>) -> Result<Dataset> {
    let scene = &recipe.scene;
    let receivers: Vec<Receiver> = scene.receivers().map(|receiver| dataset_receiver(scene, receiver)).collect();
    let (poses, mut observations) = read_poses_and_observations(recipe, folder)?;
    let pairs = (1..).zip(&poses).flat_map(|(id, pose)| (0..receivers.len()).map(move |receiver| (id, pose, receiver)));
    let mut samples: Vec<Sample> =
        pairs.map(|(id, pose, receiver)| Sample { receiver, ..Sample::new(id, *pose) }).collect();
    if let Observations::Powers(powers) = &mut observations {
        let is_received = |dbm: &Real| f64::from(*dbm) > SILENT_DBM;
        let mut received = powers.iter().map(is_received);
        samples.retain(|_| received.next().unwrap_or(false));
        powers.retain(is_received);
    }
    if samples.is_empty() {
        let problem = "no receiver receives any transmitter; raise `power_dbm` of its transmitter";
        return Err(Error::Config(format!("scene `{}`: {problem}", scene.name)));
    }
    let (test, train) = (0..samples.len()).partition(|&i| is_test_sample(samples[i].id as usize - 1));
    let points = points.map_or_else(|| Ok(Vec::new()), |path| read_points(&path))?;
    let ends = match scene.moving_receiver {
        None => receivers.into(),
        Some(_) => Ends::of_moving_receivers(receivers, Some(scene.receiver.position)),
    };
    let data = Dataset::of_links(scene.name.clone(), ends, points, &samples, observations)?;
    Ok(Dataset { official: Some((train, test)), ..data })
}

/// Reads the poses of the moving end, `[locations]`, and the observations of all links in a cached folder; the link of a
/// pair has index `location * receivers + receiver`. Returns an error for files that this program version did not write:
/// they count as damaged, and the cache is rebuilt.
fn read_poses_and_observations(recipe: &SimulationRecipe, folder: &Path) -> Result<(Vec<Pose>, Observations)> {
    let (scene, samples) = (&recipe.scene, recipe.samples);
    let receivers = scene.receivers().count();
    let observations = match recipe.observe {
        ObservationKind::Spectrum => open_spectra(&folder.join(SPECTRA), samples * receivers)?.into(),
        ObservationKind::Power { .. } => {
            let powers = read_table(&folder.join(POWERS), samples, receivers)?;
            powers.into_iter().map(|dbm| dbm as Real).collect::<Vec<Real>>().into()
        }
        ObservationKind::Channel { .. } => {
            let (antennas, frequencies_hz) = (scene.receiver.array.element_count(), scene.frequencies());
            let gains = read_channels(&folder.join(CHANNELS), [samples * receivers, antennas, frequencies_hz.len()])?;
            Channels { antennas, frequencies_hz, gains }.into()
        }
    };
    if scene.moving_receiver.is_some() {
        let rows = read_table(&folder.join(POSES), samples, 7)?;
        let pose = |[x, y, z, orientation @ ..]: &[f64; 7]| Pose { position: [*x, *y, *z], orientation: *orientation };
        return Ok((rows.as_chunks().0.iter().map(pose).collect(), observations));
    }
    let positions = read_table(&folder.join(POSITIONS), samples, 3)?;
    Ok((positions.as_chunks().0.iter().map(|position| Pose::from(*position)).collect(), observations))
}

/// Opens the array of `links` spectra; a small one is read into memory. Returns an error for other shapes.
fn open_spectra(path: &Path, links: usize) -> Result<Spectra> {
    let shape = [links, HEIGHT, WIDTH];
    let spectra = Spectra::open(path, npy_header(Number::U8, &shape).len() as u64, Number::U8, shape)?;
    if (links * HEIGHT * WIDTH) as u64 <= IN_MEMORY { spectra.into_memory() } else { Ok(spectra) }
}

/// Reads the channels of an array, flat, as real and imaginary parts. Returns an error unless it has this `shape`,
/// `[links, antennas, subcarriers]`.
fn read_channels(path: &Path, shape: [usize; 3]) -> Result<Vec<[Real; 2]>> {
    let header = npy_header_as("<c8", &shape);
    let length = header.len() + 8 * shape.iter().product::<usize>();
    let bytes = files::read_at_most(path, length as u64).map_err(|e| Error::read(path, e))?;
    match bytes.strip_prefix(&*header) {
        Some(numbers) if bytes.len() == length => {
            let parts = numbers.as_chunks().0.as_chunks().0.iter();
            Ok(parts.map(|part| part.map(|bytes| Real::from(f32::from_le_bytes(bytes)))).collect())
        }
        _ => Err(Error::input(path, "holds unexpected channels")),
    }
}

/// Reads the numbers of a table with a header, flat. Returns an error unless it has this many complete rows and columns.
fn read_table(path: &Path, rows: usize, columns: usize) -> Result<Vec<f64>> {
    let text = files::read_text(path)?;
    let cells = text.lines().skip(1).flat_map(|row| row.split(','));
    let numbers = cells.map(|cell| cell.parse::<f64>().ok().filter(|v| v.is_finite())).collect::<Option<Vec<_>>>();
    // The last number of a truncated file may still be a valid number.
    let complete = numbers.filter(|numbers| numbers.len() == rows * columns && text.ends_with('\n'));
    complete.ok_or_else(|| Error::input(path, "holds an unexpected table"))
}

/// Converts a receiver of a scene to one of a data set.
fn dataset_receiver(scene: &SceneFile, receiver: &scene::SceneReceiver) -> Receiver {
    let antennas = receiver.array.offsets(scene.wavelength()).into_iter().map(|offset| offset.to_array()).collect();
    Receiver { antennas, ..Receiver::new(receiver.name.clone(), receiver.pose()) }
}

#[typetag::serde]
impl DataSource for Simulated {
    fn task(&self) -> Option<pwrfgs_core::Task> {
        Some(self.observe.task())
    }

    fn load(&self, base: &Path, progress: Progress<'_>) -> Result<Dataset> {
        let is_shipped = ShippedFile::find(ShippedFile::SCENES, base, &self.scene).is_some();
        let scene = if is_shipped { self.scene.clone() } else { base.join(&self.scene) };
        let recipe = SimulationRecipe::read(&scene, self.samples, self.seed, self.points)?;
        let recipe = recipe.observing(self.observe)?;
        let root = if self.cache { cache_root() } else { None };
        open_or_make(&recipe, root.as_deref(), progress, |folder| self.read_folder(&recipe, folder))
    }

    fn check(&self) -> Result<(), String> {
        recipe::check_counts(self.samples, self.points)?;
        self.observe.check().map_err(|why| format!("observe: {why}"))
    }
}

/// Returns the cache folder: `$PWRFGS_CACHE`, else `pwrfgs` in the user's cache folder; `None` if there is none.
pub fn cache_root() -> Option<PathBuf> {
    match std::env::var_os("PWRFGS_CACHE") {
        Some(path) if !path.is_empty() => Some(path.into()),
        _ => etcetera::choose_base_strategy().ok().map(|base| base.cache_dir().join("pwrfgs")),
    }
}

/// Returns the result of `read` on the data set of `recipe`, which is simulated or comes from the cache `root`; `None`: no
/// cache.
///
/// An entry is a folder made by `output::write_links`, with one array or table of all links; the receivers of a
/// transmitter are consecutive. It is used only if its manifest equals that of the recipe and `read` succeeds;
/// otherwise it is simulated again. Entries are created by renaming, so they are always complete; remains of killed
/// programs are removed, and concurrent programs share one entry. If the cache is not writable, a temporary folder is
/// used instead and then deleted.
///
/// # Errors
/// Errors of the simulation and of `read`.
pub fn open_or_make<T>(
    recipe: &SimulationRecipe,
    root: Option<&Path>,
    progress: Progress<'_>,
    read: impl Fn(&Path) -> Result<T>,
) -> Result<T> {
    let Some(root) = root else { return simulate_temporarily(recipe, progress, read) };
    NewFolder::remove_abandoned(root);
    let folder = root.join(recipe.folder_name());
    if is_made_by(&folder, recipe) {
        match read(&folder) {
            Ok(data) => return Ok(data),
            Err(e) => tracing::warn!("cached data set {} is damaged ({e}); simulating it again", folder.display()),
        }
    }
    if let Err(e) = files::check_path(&folder) {
        tracing::warn!("cannot cache simulated data: {e}");
        return simulate_temporarily(recipe, progress, read);
    }
    let cleared = if folder.exists() { NewFolder::remove(&folder) } else { Ok(()) }; // a damaged entry
    let result = cleared.and_then(|()| output::write_links(recipe, &folder, progress));
    match result {
        Ok(()) => read(&folder),
        // Another process finished first.
        Err(_) if is_made_by(&folder, recipe) => read(&folder),
        Err(e @ Error::Write { .. }) => {
            tracing::warn!("cannot cache simulated data: {e}");
            simulate_temporarily(recipe, progress, read)
        }
        Err(e) => Err(e),
    }
}

/// Returns whether the manifest of the folder equals that of the recipe.
fn is_made_by(folder: &Path, recipe: &SimulationRecipe) -> bool {
    files::read(folder.join(MANIFEST)).is_ok_and(|bytes| bytes == recipe.to_json().as_bytes())
}

/// Simulates the data set of `recipe` into a temporary folder, returns the result of `read` on it, and deletes the folder.
/// Returns the errors of the simulation and of `read`.
fn simulate_temporarily<T>(
    recipe: &SimulationRecipe,
    progress: Progress<'_>,
    read: impl Fn(&Path) -> Result<T>,
) -> Result<T> {
    let temporary = NewFolder::begin_next_to(&std::env::temp_dir().join("pwrfgs"))?;
    let folder = temporary.path().join("data");
    output::write_links(recipe, &folder, progress)?;
    read(&folder)
}
