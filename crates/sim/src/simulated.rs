//! `Simulated`: spectra of a known room as a data source.

use crate::cache;
use crate::observe::Observe;
use crate::output::{PICTURES, POINTS};
use crate::recipe::{self, Recipe};
use pwrfgs_core::{DataSource, Dataset, Documented, Error, Progress, Result, Simulation, words::clean};
use pwrfgs_data::{Arrays, Nerf2Spectrum};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// *Simulated* spectra of a room that is known exactly: ray tracing in a scene file.
///
/// Paths are found by image sources, diffraction at edges and diffuse patches; their sum on the antennas of the receiver
/// gives the spectrum, as the measured files hold it (`docs/math.md`). The point cloud of the scene is exact, so that
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
/// # use pwrfgs_sim as _;
/// Plugin::<dyn DataSource>::parse(r#"Simulated(scene: "../scenes/office.ron", samples: 200)"#)?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, Documented)]
#[serde(default, deny_unknown_fields)]
pub struct Simulated {
    /// The scene file, relative to the pipeline file.
    #[serde(with = "pwrfgs_core::paths")]
    pub scene: PathBuf,
    /// Spectra.
    pub samples: usize,
    /// Which transmitter positions and receiver errors; the pipeline's seed does not change them.
    pub seed: u64,
    /// Points of the cloud, spread over all surfaces; the paper has 190,000.
    pub points: usize,
    /// What is observed: `Spectrum`, `Power(noise_db: 3)` or `Channel(snr_db: 30)`.
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
    /// Reads what [`crate::output::write_as`] wrote.
    fn read(&self, recipe: &Recipe, folder: &Path) -> Result<Dataset> {
        if self.observe != Observe::Spectrum || recipe.scene.receivers().count() > 1 {
            let what = "a data set holds spectra of one receiver; leave `observe` and `more_receivers` out";
            return Err(Error::Config(what.into()));
        }
        let points = (self.points > 0).then(|| POINTS.into());
        let points = points.map(|name: PathBuf| folder.join(name));
        // An entry of an earlier version has a picture each.
        let (root, nobody) = (folder.to_owned(), |_, _| {});
        let mut data = if folder.join(PICTURES).exists() {
            Nerf2Spectrum { root, points, ..Nerf2Spectrum::default() }.load(Path::new(""), &nobody)?
        } else {
            Arrays { root, points, elevation: None }.load(Path::new(""), &nobody)?
        };
        if data.len() != self.samples || data.scene.points.len() != self.points {
            return Err(Error::input(folder, "holds another number of spectra or points than were simulated"));
        }
        data.title = clean(&format!("{} (simulated)", recipe.scene.name));
        data.simulation = Some(Simulation { scene: Some(recipe.scene.to_ron()) });
        Ok(data)
    }
}

#[typetag::serde]
impl DataSource for Simulated {
    fn load(&self, base: &Path, progress: Progress<'_>) -> Result<Dataset> {
        let recipe = Recipe::read(&base.join(&self.scene), self.samples, self.seed, self.points)?;
        let recipe = recipe.observing(self.observe)?;
        let root = if self.cache { cache::root() } else { None };
        cache::open_or_make(&recipe, root.as_deref(), progress, |folder| self.read(&recipe, folder))
    }

    fn rebased(&self, absolute: &dyn Fn(&Path) -> PathBuf) -> Option<Box<dyn DataSource>> {
        Some(Box::new(Self { scene: absolute(&self.scene), ..self.clone() }))
    }

    fn about(&self) -> &'static str {
        "simulated spectra of a room known exactly, by ray tracing"
    }

    fn check(&self) -> Result<(), String> {
        recipe::check(self.samples, self.points)?;
        self.observe.check().map_err(|why| format!("observe: {why}"))
    }
}
