//! `RayTracing`: baseline that uses the scene.

use crate::observe::{ObservationKind, SimulatedObservation};
use crate::perturb::{SceneErrors, perturbed};
use crate::scene::SceneFile;
use crate::simulator::Simulator;
use crate::spectrum::{HEIGHT, WIDTH};
use glam::DVec3;
use pwrfgs_core::{
    Baseline, Channels, Dataset, Elevation, Error, FittingSet, Image, JsonSchema, Observations, Predict, Query, Real,
    Result, Task,
};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Largest number of random draws of errors.
const DRAWS: u64 = 100;
/// Relative tolerance between equal frequencies that were rounded in a file.
const SAME_FREQUENCY: f64 = 1e-7;

/// Ray tracing in a known scene, as a baseline.
///
/// It ignores the training set. With the scene of simulated data it is their generator: an oracle baseline and upper
/// bound, marked as such in tables; only receiver errors reduce its score. `material_error` and `position_error_m`
/// perturb the scene, as in a realistic scene model.
///
/// ```
/// # use pwrfgs_core::{Baseline, Plugin};
/// # use pwrfgs_raytrace as _;
/// Plugin::<dyn Baseline>::parse("RayTracing(material_error: 0.2, position_error_m: 0.05)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RayTracing {
    /// Scene file, relative to the pipeline file, or the name of a shipped scene; `None` for the scene of the data, which
    /// must be `Simulated` or a folder of `pwrfgs simulate`. Scenes with meshes must be named for such folders, which do
    /// not store meshes.
    #[schemars(extend("format" = "path"))]
    pub scene: Option<PathBuf>,
    /// Whether to draw the receiver errors of the scene again.
    pub noise: bool,
    /// Standard deviation of the logarithm of every permittivity, conductivity and thickness; 0.2 is about 20 %.
    pub material_error: f64,
    /// Standard deviation of the position of every wall and object along each horizontal axis, metres.
    pub position_error_m: f64,
    /// Random seed of the errors.
    pub seed: u64,
}

impl RayTracing {
    /// Describes the scene of the baseline and its errors in a note below a table of this task. `is_oracle`: the scene is
    /// that of the data.
    fn describe_scene(&self, is_oracle: bool, task: Task) -> String {
        let plural = task.plural;
        let content = match (&self.scene, self.is_exact() && is_oracle) {
            (_, true) => {
                let errors = if self.noise {
                    "with the phase errors of the antennas, and with new random noise"
                } else {
                    "without receiver errors"
                };
                format!("the generator of these simulated {plural}, {errors}: an oracle baseline and upper bound")
            }
            (scene, false) => {
                let scene = scene
                    .as_ref()
                    .map_or_else(|| format!("the scene of these simulated {plural}"), |p| p.display().to_string());
                format!(
                    "ray tracing in {scene}, material constants off by {:.0} % and positions by {:.0} cm (one standard \
                     deviation, one draw)",
                    self.material_error * 100.0,
                    self.position_error_m * 100.0
                )
            }
        };
        format!("«{}» is {content}", self.name())
    }

    /// Returns whether the scene is used without errors of materials and positions.
    fn is_exact(&self) -> bool {
        self.material_error == 0.0 && self.position_error_m == 0.0
    }

    /// Returns the scene of this baseline, read from its file or else from the data, and whether it is that of the data.
    /// Returns an error if the file cannot be read, or without a file if the data have no valid scene.
    fn resolve_scene(&self, data: &Dataset) -> Result<(SceneFile, bool)> {
        let data_scene = data.simulation.as_ref().and_then(|simulation| simulation.scene.as_deref());
        let data_scene = data_scene.and_then(|text| SceneFile::parse(text, Path::new("scene of the data")).ok());
        match (&self.scene, data_scene) {
            (Some(path), data_scene) => {
                let scene = SceneFile::read(path)?;
                let is_oracle = data_scene.is_some_and(|data_scene| data_scene.portable() == scene.portable());
                Ok((scene, is_oracle))
            }
            (None, Some(scene)) => Ok((scene, true)),
            (None, None) => {
                let problem = "RayTracing: these data are not simulated from a scene; name one in `scene`, such as \
                            \"scenes/lab-s23.ron\"";
                Err(Error::Config(problem.into()))
            }
        }
    }

    /// Prepares a simulator of the scene with random errors. If an error moves a wall past the receiver, another draw is
    /// used. Returns the error of the last draw after [`DRAWS`] failed.
    fn prepare_simulator(&self, scene: &SceneFile) -> Result<Simulator> {
        if self.is_exact() {
            return Simulator::new(scene);
        }
        let attempt = |draw| {
            let errors = SceneErrors {
                materials: self.material_error,
                positions_m: self.position_error_m,
                seed: self.seed,
                draw,
            };
            let scene = perturbed(scene, &errors);
            match scene.first_fault() {
                Some(fault) => Err(Error::Config(format!("RayTracing: {fault}; lower its errors"))),
                None => Simulator::new(&scene),
            }
        };
        (0..DRAWS).find_map(|draw| attempt(draw).ok()).map_or_else(|| attempt(DRAWS), Ok)
    }
}

#[typetag::serde]
impl Baseline for RayTracing {
    fn name(&self) -> String {
        let mut words = vec!["RT".to_owned()];
        words.extend(self.scene.iter().map(|path| path.file_stem().unwrap_or_default().to_string_lossy().into_owned()));
        if self.is_exact() && self.scene.is_none() {
            words.push("exact".into());
        }
        if self.material_error > 0.0 {
            words.push(format!("±{:.0}%", self.material_error * 100.0));
        }
        if self.position_error_m > 0.0 {
            words.push(format!("±{:.0}cm", self.position_error_m * 100.0));
        }
        if self.noise {
            words.push("noisy".into());
        }
        words.join(" ")
    }

    fn check_data(&self, data: &Dataset) -> Result<()> {
        self.fit(data, FittingSet::train(&[])).map(|_| ()) // it learns nothing, but reads every file that may be missing
    }

    fn fit<'a>(&self, data: &'a Dataset, _: FittingSet<'_>) -> Result<Box<dyn Predict + 'a>> {
        let (scene, is_oracle) = self.resolve_scene(data)?;
        let kind = required_observation(data, &scene)?;
        let receivers = receiver_indices(data, &scene)?;
        let (simulator, note) = (self.prepare_simulator(&scene)?, self.describe_scene(is_oracle, data.task()));
        Ok(Box::new(TracedBaseline { simulator, receivers, kind, noise: self.noise, seed: self.seed, note, is_oracle }))
    }

    fn check(&self) -> Result<(), String> {
        for (field, value) in [("material_error", self.material_error), ("position_error_m", self.position_error_m)] {
            if !(0.0..=2.0).contains(&value) {
                return Err(format!("`{field}` is {value}; give a number from 0 to 2, such as 0.05"));
            }
        }
        Ok(())
    }
}

/// Returns the observation type of the data, without noise. Returns an error if this scene cannot provide it.
fn required_observation(data: &Dataset, scene: &SceneFile) -> Result<ObservationKind> {
    let refuse = |problem: String| Err(Error::Config(format!("RayTracing: {problem}; leave it out")));
    if data.scene.moving.is_receiver() {
        return refuse("the receiver of these data moves".into());
    }
    let Some(channels) = data.observations.channels() else {
        if data.observations.powers().is_some() {
            return Ok(ObservationKind::Power { noise_db: 0.0 });
        }
        let (width, height) = (data.width, data.height);
        if (width, height) != (WIDTH, HEIGHT) {
            let problem = format!("have {width}x{height} pixels, but RayTracing makes {WIDTH}x{HEIGHT}");
            return refuse(format!("spectra of this data set {problem}"));
        }
        if data.elevation != Elevation::UPPER {
            let Elevation { first, last } = data.elevation;
            let problem =
                format!("spectra of this data set cover elevations {first} to {last}, but RayTracing makes 0 to 90");
            return refuse(problem);
        }
        return Ok(ObservationKind::Spectrum);
    };
    let (hz, antennas) = (scene.frequencies(), channels.antennas);
    if let Some(other) = scene.receivers().find(|receiver| receiver.array.element_count() != antennas) {
        let count = other.array.element_count();
        return refuse(format!("channels of this data set have {antennas} antennas, and `{}` has {count}", other.name));
    }
    let is_same = |(a, b): (&f64, &f64)| is_same_frequency(*a, *b);
    if hz.len() != channels.frequencies_hz.len() || !hz.iter().zip(&channels.frequencies_hz).all(is_same) {
        return refuse("channels of this data set have other subcarriers than the scene".into());
    }
    Ok(ObservationKind::Channel { snr_db: None })
}

/// Returns whether two frequencies, Hz, are equal up to the rounding in a file.
fn is_same_frequency(a: f64, b: f64) -> bool {
    (a / b - 1.0).abs() < SAME_FREQUENCY
}

/// Returns the index in the scene of each receiver of the data: by carrier, else by name. A single receiver without its
/// name in the scene is the first. Returns an error if one is missing or has another carrier.
fn receiver_indices(data: &Dataset, scene: &SceneFile) -> Result<Vec<usize>> {
    let data_receivers = &data.scene.receivers;
    if !scene.carriers_hz.is_empty() {
        let find = |hz: f64| scene.carriers_hz.iter().position(|carrier| is_same_frequency(*carrier, hz));
        let absent =
            || Error::Config("RayTracing: a carrier of the data is not in `carriers_hz` of the scene; add it".into());
        return data_receivers.iter().map(|receiver| receiver.carrier_hz.and_then(find).ok_or_else(absent)).collect();
    }
    let carrier = scene.carrier_hz;
    let mut carriers = data_receivers.iter().filter_map(|receiver| receiver.carrier_hz);
    if let Some(hz) = carriers.find(|hz| !is_same_frequency(*hz, carrier)) {
        return Err(Error::Config(format!(
            "RayTracing: the carrier of the data is {hz} Hz, and that of the scene {carrier} Hz; correct one of them"
        )));
    }
    let find = |name: &str| scene.receivers().position(|receiver| receiver.name == name);
    let only = (data_receivers.len() == 1).then_some(0);
    let index_of = |name: &str| {
        find(name).or(only).ok_or_else(|| {
            Error::Config(format!("RayTracing: the scene has no receiver `{name}`; name its receivers as the data do"))
        })
    };
    data_receivers.iter().map(|receiver| index_of(&receiver.name)).collect()
}

/// Prepared scene of a baseline.
struct TracedBaseline {
    simulator: Simulator,
    /// Index in the simulator of each receiver of the data.
    receivers: Vec<usize>,
    kind: ObservationKind,
    noise: bool,
    seed: u64,
    note: String,
    is_oracle: bool,
}

impl TracedBaseline {
    /// Returns the noise draw of a position: a hash of its coordinates in single precision, in the manner of FNV-1a. The highest
    /// bit separates it from the draws of data with a seed below 2³¹.
    fn noise_draw(&self, tx: [f64; 3]) -> u64 {
        let add = |hash: u64, v: &f64| (hash ^ u64::from((*v as f32).to_bits())).wrapping_mul(0x0100_0000_01b3);
        tx.iter().fold(!self.seed, add) | 1 << 63
    }
}

impl Predict for TracedBaseline {
    fn predict(&self, query: Query<'_>) -> Image {
        let tx = query.position();
        let draw = self.noise.then(|| self.noise_draw(tx));
        // A receiver that the data lack is the first of the scene.
        let index = self.receivers.get(query.receiver).copied().unwrap_or(0);
        let receiver = &self.simulator.receivers()[index];
        match receiver.observe(DVec3::from(tx), &self.kind, draw).observed {
            SimulatedObservation::Spectrum(spectrum) => Image::from_bytes(WIDTH, HEIGHT, &spectrum.pixels),
            SimulatedObservation::Power(dbm) => Image { width: 1, height: 1, pixels: vec![dbm as Real] },
            SimulatedObservation::Channel(channel) => {
                let gains = channel.iter().map(|h| [h.re as Real, h.im as Real]).collect();
                let frequencies_hz = self.simulator.scene().frequencies();
                let antennas = receiver.receiver().array.element_count();
                Observations::from(Channels { antennas, frequencies_hz, gains }).image(0)
            }
        }
    }

    fn note(&self) -> Option<String> {
        Some(self.note.clone())
    }

    fn is_oracle(&self) -> bool {
        self.is_oracle
    }
}
