//! Recipe of a simulated data set, and its cache key.

use crate::mesh;
use crate::observe::ObservationKind;
use crate::scene::{Object, SceneFile, SceneReceiver};
use pwrfgs_core::{Error, Result, check_memory, files};
use std::collections::BTreeMap;
use std::path::Path;

/// Version of the simulator output; increased whenever the same recipe gives other bytes.
const EDITION: u32 = 3;
/// Largest number of links of a data set: 32 GB of spectra as an array. Fewer are allowed as images
/// ([`crate::output::DatasetWriter::write`]).
const MOST_SAMPLES: usize = 1_000_000;
/// Largest number of points of a cloud.
const MOST_POINTS: usize = 50_000_000;

/// Recipe of a simulation.
#[derive(Clone, Debug)]
pub struct SimulationRecipe {
    /// The parsed scene.
    pub scene: SceneFile,
    /// Number of transmitters, or of poses of a moving receiver.
    pub samples: usize,
    /// Random seed of transmitter positions and receiver errors.
    pub seed: u64,
    /// Number of points of the cloud.
    pub points: usize,
    /// Observation type.
    pub observe: ObservationKind,
    /// Hash of every mesh file, in the order of the objects.
    meshes: Vec<String>,
}

impl SimulationRecipe {
    /// Creates a recipe of spectra: reads the scene file, and hashes its meshes.
    ///
    /// # Errors
    /// Numbers out of range, an invalid scene, with line and column, a mesh that cannot be read, or too many links.
    pub fn read(scene: &Path, samples: usize, seed: u64, points: usize) -> Result<Self> {
        check_counts(samples, points).map_err(Error::Config)?;
        let scene = SceneFile::read(scene)?;
        let file = |object: &Object| match object {
            Object::Mesh { file, .. } if mesh::named_mesh(file).is_none() => Some(file.clone()),
            _ => None,
        };
        let mut hashes = BTreeMap::new(); // many objects may have one mesh
        let hash = |file: std::path::PathBuf| {
            if let Some(hash) = hashes.get(&file) {
                return Ok(String::clone(hash));
            }
            let bytes = files::read(&file).map_err(|e| Error::read(&file, e))?;
            Ok(hashes.entry(file).or_insert(format!("{:016x}", fnv1a_hash(&bytes))).clone())
        };
        let meshes = scene.objects.iter().filter_map(file).map(hash).collect::<Result<Vec<_>>>()?;
        Self { scene, samples, seed, points, observe: ObservationKind::Spectrum, meshes }.checked()
    }

    /// Returns the recipe with a changed `scene` of the same meshes; stated positions set the number of samples.
    ///
    /// # Errors
    /// Too many links.
    pub fn with_scene(self, scene: SceneFile) -> Result<Self> {
        Self { scene, ..self }.checked()
    }

    /// Returns the recipe with as many samples as the scene lists positions, if it lists any. Returns an error for too
    /// many links.
    fn checked(mut self) -> Result<Self> {
        self.samples = self.scene.transmitter.positions.listed_count().unwrap_or(self.samples);
        let (samples, receivers) = (self.samples, self.scene.receivers().count() * self.scene.carrier_count());
        if samples * receivers > MOST_SAMPLES {
            let problem = format!("more than {MOST_SAMPLES} links; give fewer samples");
            let subject = format!("{samples} samples at {receivers} receivers");
            return Err(Error::Config(format!("scene `{}`: {subject} are {problem}", self.scene.name)));
        }
        Ok(self)
    }

    /// Returns the recipe with another observation type.
    ///
    /// # Errors
    /// A parameter is out of range, the scene does not support the type, or its channels take too much memory.
    pub fn observing(self, observe: ObservationKind) -> Result<Self> {
        observe.check().map_err(Error::Config)?;
        if !self.scene.carriers_hz.is_empty() && observe != ObservationKind::Spectrum {
            let problem =
                "it has several carriers, which only spectra support; remove `carriers_hz` or set --carrier-hz";
            return Err(Error::Config(format!("scene `{}`: {problem}", self.scene.name)));
        }
        if let ObservationKind::Channel { .. } = observe {
            check_channels(&self.scene, self.samples)?;
        }
        Ok(Self { observe, ..self })
    }

    /// Returns the recipe with `receiver` as its only receiver.
    pub(crate) fn with_receiver(&self, receiver: &SceneReceiver) -> Self {
        Self { scene: self.scene.with_receiver(receiver), ..self.clone() }
    }

    /// Returns the manifest as JSON: recipes with equal manifests give equal data sets.
    pub fn to_json(&self) -> String {
        let mut manifest = serde_json::json!({
            "program": concat!("pwrfgs ", env!("CARGO_PKG_VERSION")),
            "edition": EDITION,
            "simulated": true,
            "name": self.scene.name,
            "carrier_hz": self.scene.carrier_hz,
            "samples": self.samples,
            "seed": self.seed,
            "points": self.points,
            "mesh_hashes": self.meshes,
            "scene": self.scene.portable().to_ron(), // the hashes identify the meshes
        });
        if self.observe != ObservationKind::Spectrum {
            // Without the field, data sets of spectra keep their folder name.
            manifest["observe"] = serde_json::json!(self.observe);
        }
        serde_json::to_string_pretty(&manifest).expect("a manifest is plain data") + "\n"
    }

    /// Returns the folder name in the cache, unique per manifest: the beginning of the scene name, and a hash.
    pub fn folder_name(&self) -> String {
        let plain = |c: char| if c.is_ascii_alphanumeric() || c == '-' { c } else { '-' };
        let name: String = self.scene.name.chars().map(plain).take(40).collect();
        format!("{name}-{:016x}", fnv1a_hash(self.to_json().as_bytes()))
    }
}

/// Returns an error for a number of samples or points out of range.
pub(crate) fn check_counts(samples: usize, points: usize) -> Result<(), String> {
    // Five samples have one test sample.
    if !(5..=MOST_SAMPLES).contains(&samples) {
        return Err(format!("`samples` is {samples}; give 5 to {MOST_SAMPLES}"));
    }
    if points > MOST_POINTS {
        return Err(format!("`points` is {points}; give at most {MOST_POINTS}"));
    }
    Ok(())
}

/// Returns an error if receivers have different numbers of antennas, or all channels do not fit into memory.
fn check_channels(scene: &SceneFile, samples: usize) -> Result<()> {
    let elements = |receiver: &SceneReceiver| receiver.array.element_count();
    let (first, count) = (&scene.receiver, elements(&scene.receiver));
    if let Some(other) = scene.receivers().find(|receiver| elements(receiver) != count) {
        return Err(Error::Config(format!(
            "scene `{}`: the receiver `{}` has {count} antennas and `{}` has {}, and channels need as many of each; change \
             their arrays",
            scene.name,
            first.name,
            other.name,
            elements(other)
        )));
    }
    let numbers = [scene.receivers().count(), count, scene.frequencies().len()].into_iter().product::<usize>();
    let bytes = numbers.saturating_mul(samples).saturating_mul(8); // single precision, complex
    // Training needs them in memory.
    check_memory(bytes as u64, "give fewer samples, antennas or subcarriers").map_err(|fault| {
        Error::Config(format!("scene `{}`: training with channels of {samples} transmitters {fault}", scene.name))
    })
}

/// Returns the 64-bit FNV-1a hash: equal on every machine and in every version.
fn fnv1a_hash(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(*b)).wrapping_mul(0x0100_0000_01b3))
}
