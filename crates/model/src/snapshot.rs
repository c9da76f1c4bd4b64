//! `Snapshot`: the Gaussians at one training step, for figures. `docs/model-format.md` describes the file.

use crate::{Ensemble, tensors::Tensors};
use pwrfgs_core::files::{self, write_atomically};
use pwrfgs_core::{Error, GaussianCloud, Origin, Real, Result, sigmoid};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// N Gaussians at one training step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Snapshot {
    /// Number of completed steps, including the step of this snapshot.
    pub step: u64,
    /// Origin of the centres in the user's frame.
    pub origin: Origin,
    /// Centres `[N,3]`, metres from the origin.
    pub means: Vec<[Real; 3]>,
    /// Opacities `[N]` in (0, 1), without the gates of pruners.
    pub opacities: Vec<Real>,
    /// Learned scales `[N,3]` in metres and rotations `[N,4]` (w, x, y, z), without transmitter-dependent terms; empty if
    /// unknown.
    pub scales: Vec<[Real; 3]>,
    /// Learned rotations, see [`Self::scales`].
    pub quats: Vec<[Real; 4]>,
    /// Persistent ID per Gaussian `[N]`, constant over snapshots; empty if unknown.
    pub gaussian_ids: Vec<u32>,
    /// Gates of pruners `[N]`, from 0 (closed) to 1; empty without gates.
    pub gates: Vec<Real>,
}

/// Metadata of the file.
#[derive(Serialize, Deserialize)]
struct Note {
    format: String,
    version: u32,
    step: u64,
    gaussians: usize,
    #[serde(default, skip_serializing_if = "Origin::is_zero")]
    origin: Origin,
}

const FORMAT: &str = "pwrfgs-snapshot";
const VERSION: u32 = 3;

impl Snapshot {
    /// Creates a snapshot of `cloud`, relative to `origin`, at `step`.
    pub fn of(step: u64, cloud: &GaussianCloud, origin: Origin) -> Self {
        let opacities = cloud.opacity_logits.iter().copied().map(sigmoid).collect();
        let scales = cloud.log_scales.iter().map(|s| s.map(Real::exp)).collect();
        let (means, quats) = (cloud.means.clone(), cloud.quats.clone());
        Self { step, origin, means, opacities, scales, quats, gaussian_ids: Vec::new(), gates: Vec::new() }
    }

    /// Returns the snapshot with the IDs of the Gaussians, and their gates if there are any.
    #[must_use]
    pub fn with_ids_and_gates(self, gaussian_ids: &[u32], gates: Option<Vec<Real>>) -> Self {
        Self { gaussian_ids: gaussian_ids.to_vec(), gates: gates.unwrap_or_default(), ..self }
    }

    /// Creates a snapshot of all members of an ensemble together: centres and opacities alone.
    pub fn of_ensemble(step: u64, ensemble: &Ensemble) -> Self {
        let origin = ensemble.members()[0].stages.origin;
        let logits = ensemble.members().iter().flat_map(|model| model.cloud.opacity_logits.iter().copied());
        let opacities = logits.map(sigmoid).collect();
        Self { step, origin, means: ensemble.means_from(origin), opacities, ..Self::default() }
    }

    /// Returns centre `i` in the user's frame, metres.
    pub fn centre(&self, i: usize) -> [f64; 3] {
        self.origin.world(self.means[i])
    }

    /// Writes the snapshot to `path` atomically; equal snapshots give equal bytes.
    ///
    /// # Errors
    /// [`Error::Write`] if the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let n = self.means.len();
        let note = Note { format: FORMAT.into(), version: VERSION, step: self.step, gaussians: n, origin: self.origin };
        let mut file = Tensors::new(&note);
        file.put("means", vec![n, 3], self.means.as_flattened().to_vec());
        file.put("opacities", vec![n], self.opacities.clone());
        let scales = self.scales.as_flattened().to_vec();
        let quats = self.quats.as_flattened().to_vec();
        for (name, width, values) in [("scales", 3, scales), ("quats", 4, quats), ("gates", 1, self.gates.clone())] {
            if !values.is_empty() {
                file.put(name, vec![n, width], values);
            }
        }
        if !self.gaussian_ids.is_empty() {
            file.put_ids("gaussian_ids", &self.gaussian_ids);
        }
        write_atomically(path, &file.to_bytes())
    }

    /// Reads a snapshot; `None` if the file does not exist.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::Input`] for an incomplete or damaged snapshot.
    pub fn read(path: &Path) -> Result<Option<Self>> {
        let bytes = files::if_found(path, files::read(path))?;
        bytes.map(|bytes| Self::from_bytes(&bytes).map_err(|why| Error::input(path, why))).transpose()
    }

    /// Reads the bytes of a snapshot.
    ///
    /// # Errors
    /// The bytes are damaged or of another format or version, a tensor is missing or has another shape or type, a number is
    /// not finite, or an opacity is not between 0 and 1.
    fn from_bytes(bytes: &[u8]) -> Result<Self, String> {
        let mut file = Tensors::from_bytes(bytes)?;
        let note: Note = serde_json::from_str(&file.note).map_err(|e| format!("not a snapshot of pwrfgs ({e})"))?;
        if (&*note.format, note.version) != (FORMAT, VERSION) {
            return Err(format!(
                "a `{}` of version {}, expected `{FORMAT}` of version {VERSION}",
                note.format, note.version
            ));
        }
        let means = file.take("means", &[note.gaussians, 3])?;
        let opacities = file.take("opacities", &[note.gaussians])?;
        if let Some(wrong) = opacities.iter().find(|o| !(0.0..=1.0).contains(*o)) {
            return Err(format!("a damaged snapshot: an opacity is {wrong}"));
        }
        let n = note.gaussians;
        let mut column = |name: &str, width: usize| match file.shape(name) {
            Some(_) => file.take(name, &[n, width]),
            None => Ok(Vec::new()),
        };
        let (scales, quats) = (column("scales", 3)?, column("quats", 4)?);
        let gates = column("gates", 1)?;
        let gaussian_ids =
            if file.shape("gaussian_ids").is_some() { file.take_ids("gaussian_ids", n)? } else { Vec::new() };
        Ok(Self {
            step: note.step,
            origin: note.origin,
            means: split_rows(&means),
            opacities,
            scales: split_rows(&scales),
            quats: split_rows(&quats),
            gaussian_ids,
            gates,
        })
    }
}

/// Divides values into rows of K.
fn split_rows<const K: usize>(values: &[Real]) -> Vec<[Real; K]> {
    values.as_chunks().0.to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn snapshot_round_trips_and_missing_file_is_none() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("start.safetensors");
        assert_eq!(Snapshot::read(&path).unwrap(), None);
        let mut cloud = GaussianCloud::zeros(3);
        cloud.means[1] = [1.0, -2.0, 0.5];
        cloud.opacity_logits = vec![0.0, 3.0, -3.0];
        let snapshot = Snapshot::of(250, &cloud, Origin([5e5, 54e5, 1e2]))
            .with_ids_and_gates(&[4, 0, u32::MAX], Some(vec![1.0, 0.0, 0.5]));
        assert_eq!(snapshot.centre(1), [500_001.0, 5_399_998.0, 100.5]);
        assert!((snapshot.opacities[1] + snapshot.opacities[2] - 1.0).abs() < 1e-6);
        snapshot.write(&path).unwrap();
        assert_eq!(Snapshot::read(&path).unwrap(), Some(snapshot));
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() - 5]).unwrap();
        assert!(Snapshot::read(&path).unwrap_err().is_input());
        Snapshot { step: 0, origin: Origin::ZERO, means: vec![[0.0; 3]], opacities: vec![1.5], ..Snapshot::default() }
            .write(&path)
            .unwrap();
        assert!(Snapshot::read(&path).unwrap_err().to_string().ends_with("an opacity is 1.5"));
    }
}
