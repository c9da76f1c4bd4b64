//! `Simulated`: spectra, powers or channels of a known room as a data source, kept on disk under a key of everything that
//! decides them.

#[cfg(test)]
mod tests;

use crate::observe::{Observe, SILENT_DBM};
use crate::output::{self, CHANNELS, MANIFEST, POINTS, POSITIONS, POWERS, SPECTRA, is_test};
use crate::recipe::{self, Recipe};
use crate::scene::{self, Scene};
use crate::spectrum::{HEIGHT, WIDTH};
use etcetera::BaseStrategy as _;
use pwrfgs_core::files::{self, NewFolder};
use pwrfgs_core::{
    Channels, DataSource, Dataset, Error, JsonSchema, Number, Observations, Progress, Real, Receiver, Result, Sample,
    Simulation, Spectra, words::clean,
};
use pwrfgs_data::{Arrays, npy_header, npy_header_as, read_points};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Most bytes of spectra that memory holds; more stay in the file.
const IN_MEMORY: u64 = 512 << 20;

/// *Simulated* spectra, powers or channels of a room that is known exactly: ray tracing in a scene file.
///
/// Paths are found by image sources, diffraction at edges and diffuse patches; their sum on the antennas of the receiver
/// gives the spectrum, as the measured files hold it (`docs/math.md`), or what `observe` says. A scene with several receivers
/// gives a link each; one at which nothing is heard is left out. The point cloud of the scene is exact, so that
/// `PointCloud` initialisation and `Chamfer` mean something here. Every fifth sample belongs to the test list of
/// [`Official`](pwrfgs_data::Official).
///
/// The data set is simulated once and kept in the user's cache folder (`$PWRFGS_CACHE` names another) under a key of the
/// scene, its meshes and all fields; it can be removed at any time. More than 512 MB of spectra stay there, and a picture is
/// read when it is wanted. `pwrfgs simulate` writes the same data set where you
/// want it, with every path.
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
    /// The scene file, relative to the pipeline file.
    #[schemars(extend("format" = "path"))]
    pub scene: PathBuf,
    /// Number of transmitters; with one receiver, of spectra.
    pub samples: usize,
    /// Random seed of transmitter positions and receiver errors, independent of the seed of the pipeline.
    pub seed: u64,
    /// Points of the cloud, spread over all surfaces; the paper has 190,000.
    pub points: usize,
    /// Observation: `Spectrum`, `Power(noise_db: 3)` or `Channel(snr_db: 30)`.
    pub observe: Observe,
    /// Whether the data set is kept on disk.
    pub cache: bool,
}

impl Default for Simulated {
    fn default() -> Self {
        Self {
            scene: "scenes/office.ron".into(),
            samples: 1000,
            seed: 0,
            points: 190_000,
            observe: Observe::Spectrum,
            cache: true,
        }
    }
}

impl Simulated {
    /// Reads what [`crate::output::write_links`] wrote.
    fn read(&self, recipe: &Recipe, folder: &Path) -> Result<Dataset> {
        let points = (self.points > 0).then(|| folder.join(POINTS));
        let one = self.observe == Observe::Spectrum && recipe.scene.more_receivers.is_empty();
        let mut data = if one {
            Arrays { root: folder.to_owned(), points, elevation: None }.load(Path::new(""), &|_, _| {})?
        } else {
            links(recipe, folder, points)?
        };
        if (one && data.len() != self.samples) || data.scene.points.len() != self.points {
            return Err(Error::input(folder, "holds another number of spectra or points than were simulated"));
        }
        data.title = clean(&format!("{} (simulated)", recipe.scene.name));
        data.simulation = Some(Simulation { scene: Some(recipe.scene.to_ron()) });
        Ok(data)
    }
}

/// Anything else: all links of all receivers. Who is not heard has no link.
fn links(recipe: &Recipe, folder: &Path, points: Option<PathBuf>) -> Result<Dataset> {
    let scene = &recipe.scene;
    let receivers: Vec<Receiver> = scene.receivers().map(|receiver| of_data(scene, receiver)).collect();
    let (transmitters, mut observations) = read_links(recipe, folder)?;
    let pairs = transmitters.iter().enumerate().flat_map(|(t, tx)| (0..receivers.len()).map(move |r| (t, *tx, r)));
    let mut samples: Vec<Sample> = pairs.map(|(t, tx, receiver)| Sample { id: t as u32 + 1, tx, receiver }).collect();
    if let Observations::Powers(all) = &mut observations {
        let is_heard = |dbm: &Real| f64::from(*dbm) > SILENT_DBM;
        let mut heard = all.iter().map(is_heard);
        samples.retain(|_| heard.next().unwrap_or(false));
        all.retain(is_heard);
    }
    if samples.is_empty() {
        let what = "no receiver hears any transmitter; raise `power_dbm` of its transmitter";
        return Err(Error::Config(format!("scene `{}`: {what}", scene.name)));
    }
    let (test, train) = (0..samples.len()).partition(|&i| is_test(samples[i].id as usize - 1));
    let points = points.map_or_else(|| Ok(Vec::new()), |path| read_points(&path))?;
    let data = Dataset::of_links(scene.name.clone(), receivers, points, &samples, observations)?;
    Ok(Dataset { official: Some((train, test)), ..data })
}

/// Positions of the transmitters and what was observed of every link of a folder that the cache keeps; link
/// `transmitter * receivers + receiver` is that of this pair. Only what this very program wrote is read here: anything else
/// is damage, and the cache makes it anew.
fn read_links(recipe: &Recipe, folder: &Path) -> Result<(Vec<[f64; 3]>, Observations)> {
    let (scene, samples) = (&recipe.scene, recipe.samples);
    let receivers = scene.receivers().count();
    let observations = match recipe.observe {
        Observe::Spectrum => spectra(&folder.join(SPECTRA), samples * receivers)?.into(),
        Observe::Power { .. } => {
            let powers = table(&folder.join(POWERS), samples, receivers)?;
            powers.into_iter().map(|dbm| dbm as Real).collect::<Vec<Real>>().into()
        }
        Observe::Channel { .. } => {
            let (antennas, frequencies_hz) = (scene.receiver.array.elements(), scene.frequencies());
            let gains = channels(&folder.join(CHANNELS), [samples * receivers, antennas, frequencies_hz.len()])?;
            Channels { antennas, frequencies_hz, gains }.into()
        }
    };
    let places = table(&folder.join(POSITIONS), samples, 3)?;
    Ok((places.as_chunks().0.to_vec(), observations))
}

fn spectra(path: &Path, links: usize) -> Result<Spectra> {
    let shape = [links, HEIGHT, WIDTH];
    let spectra = Spectra::open(path, npy_header(Number::U8, &shape).len() as u64, Number::U8, shape)?;
    if (links * HEIGHT * WIDTH) as u64 <= IN_MEMORY { spectra.into_memory() } else { Ok(spectra) }
}

fn channels(path: &Path, shape: [usize; 3]) -> Result<Vec<[Real; 2]>> {
    let header = npy_header_as("<c8", &shape);
    let length = header.len() + 8 * shape.iter().product::<usize>();
    let bytes = files::read_at_most(path, length as u64).map_err(|e| Error::read(path, e))?;
    match bytes.strip_prefix(&*header) {
        Some(numbers) if bytes.len() == length => {
            let parts = numbers.as_chunks().0.as_chunks().0.iter();
            Ok(parts.map(|part| part.map(|bytes| Real::from(f32::from_le_bytes(bytes)))).collect())
        }
        _ => Err(Error::input(path, "holds other channels than were simulated")),
    }
}

/// The numbers `[rows, columns]` of a table with a header.
fn table(path: &Path, rows: usize, columns: usize) -> Result<Vec<f64>> {
    let text = files::read_text(path)?;
    let cells = text.lines().skip(1).flat_map(|row| row.split(','));
    let numbers = cells.map(|cell| cell.parse::<f64>().ok().filter(|v| v.is_finite())).collect::<Option<Vec<_>>>();
    // The last number of a file that is cut short may still be one.
    let whole = numbers.filter(|numbers| numbers.len() == rows * columns && text.ends_with('\n'));
    whole.ok_or_else(|| Error::input(path, "holds another table than was simulated"))
}

/// A receiver as data sets have it.
fn of_data(scene: &Scene, receiver: &scene::Receiver) -> Receiver {
    let antennas = receiver.array.offsets(scene.wavelength()).into_iter().map(|place| place.to_array()).collect();
    Receiver { antennas, ..Receiver::new(receiver.name.clone(), receiver.pose()) }
}

#[typetag::serde]
impl DataSource for Simulated {
    fn task(&self) -> Option<pwrfgs_core::Task> {
        Some(self.observe.task())
    }

    fn load(&self, base: &Path, progress: Progress<'_>) -> Result<Dataset> {
        let recipe = Recipe::read(&base.join(&self.scene), self.samples, self.seed, self.points)?;
        let recipe = recipe.observing(self.observe)?;
        let root = if self.cache { cache_root() } else { None };
        open_or_make(&recipe, root.as_deref(), progress, |folder| self.read(&recipe, folder))
    }

    fn check(&self) -> Result<(), String> {
        recipe::check(self.samples, self.points)?;
        self.observe.check().map_err(|why| format!("observe: {why}"))
    }
}

/// The folder of all kept data sets: `$PWRFGS_CACHE`, else `pwrfgs` in the user's cache folder; `None` where there is no
/// such thing.
pub fn cache_root() -> Option<PathBuf> {
    match std::env::var_os("PWRFGS_CACHE") {
        Some(path) if !path.is_empty() => Some(path.into()),
        _ => etcetera::choose_base_strategy().ok().map(|base| base.cache_dir().join("pwrfgs")),
    }
}

/// What `read` makes of the data set of `recipe`, simulated now or taken from the folder `root`.
///
/// An entry is a folder as [`output::write_as`] makes it, with one array or table of all links: the receivers of a
/// transmitter one after the other. It is used only if its manifest is that of the recipe, word for
/// word, and `read` finds nothing wrong with it; else it is made anew. Entries appear by renaming, so none is half
/// written, what killed programs left is removed, and of two programs that make the same one the second finds it there.
/// Where the disk refuses, the data set is made in the system's folder for temporary files instead, and lost.
///
/// # Errors
/// Those of the simulation and of `read`.
pub fn open_or_make<T>(
    recipe: &Recipe,
    root: Option<&Path>,
    progress: Progress<'_>,
    read: impl Fn(&Path) -> Result<T>,
) -> Result<T> {
    let Some(root) = root else { return make_for_now(recipe, progress, read) };
    NewFolder::clear(root);
    let folder = root.join(recipe.folder_name());
    if is_of(&folder, recipe) {
        match read(&folder) {
            Ok(data) => return Ok(data),
            Err(e) => tracing::warn!("the kept data set {} is damaged ({e}) and made anew", folder.display()),
        }
    }
    if let Err(e) = files::check_place(&folder) {
        tracing::warn!("simulated data are not kept: {e}");
        return make_for_now(recipe, progress, read);
    }
    let cleared = if folder.exists() { NewFolder::remove(&folder) } else { Ok(()) }; // a damaged entry
    let made = cleared.and_then(|()| output::write_links(recipe, &folder, progress));
    match made {
        Ok(()) => read(&folder),
        // Somebody else was faster.
        Err(_) if is_of(&folder, recipe) => read(&folder),
        Err(e @ Error::Write { .. }) => {
            tracing::warn!("simulated data are not kept: {e}");
            make_for_now(recipe, progress, read)
        }
        Err(e) => Err(e),
    }
}

/// Whether the folder holds the data set of the recipe, as far as its manifest says.
fn is_of(folder: &Path, recipe: &Recipe) -> bool {
    files::read(folder.join(MANIFEST)).is_ok_and(|bytes| bytes == recipe.to_json().as_bytes())
}

fn make_for_now<T>(recipe: &Recipe, progress: Progress<'_>, read: impl Fn(&Path) -> Result<T>) -> Result<T> {
    let making = NewFolder::beside(&std::env::temp_dir().join("pwrfgs"))?;
    let folder = making.path().join("data");
    output::write_links(recipe, &folder, progress)?;
    read(&folder)
}
