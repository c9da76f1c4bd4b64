//! Checkpoints: the full state of a training in one safetensors file, for a bit-identical resume.
//!
//! Random streams are functions of (seed, name, step), so the step number is their whole state. A [`fingerprint`] binds
//! a checkpoint to its training.

use crate::adam::Adam;
use crate::edit::GaussianIds;
use crate::plan::{TrainingPlan, requested_columns};
use crate::trainer::Trainer;
use pwrfgs_core::files::digest;
use pwrfgs_core::plugin::to_ron;
use pwrfgs_core::{CloudStats, Dataset, Error, Partition, Real, Result, Sample};
use pwrfgs_model::file::{put_weights, take_cloud, take_weights};
use pwrfgs_model::tensors::Tensors;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Metadata of the file, with a digest of the whole file.
#[derive(Serialize, Deserialize)]
struct Sealed {
    digest: String,
    note: Note,
}

/// Metadata without the digest.
#[derive(Serialize, Deserialize)]
struct Note {
    format: String,
    version: u32,
    /// Fingerprint of plan and data.
    fingerprint: String,
    done: u64,
    gaussians: usize,
    /// Names and widths of the extra columns.
    extra: Vec<(String, usize)>,
    /// Number of Gaussians created so far.
    next_gaussian_id: u32,
    /// Numbers of closed masks and of Gaussians before pruning.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    masks: Option<(usize, usize)>,
    /// Name of the GPU; `None` for the CPU.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    device: Option<String>,
}

const FORMAT: &str = "pwrfgs-checkpoint";
const VERSION: u32 = 8;

impl<'a> Trainer<'a> {
    /// Returns the fingerprint of plan and data.
    pub(crate) fn fingerprint(&self) -> &str {
        self.fingerprint.get_or_init(|| fingerprint(&self.plan, self.data, self.batches.train()))
    }

    /// Serialises the full state of the training.
    pub fn checkpoint(&self) -> Vec<u8> {
        let note = Note {
            format: FORMAT.into(),
            version: VERSION,
            fingerprint: self.fingerprint().to_owned(),
            done: self.done,
            gaussians: self.cloud.len(),
            extra: self.cloud.extra.iter().map(|c| (c.name.clone(), c.width)).collect(),
            next_gaussian_id: self.gaussian_ids.next,
            masks: self.masks,
            device: self.device.clone(),
        };
        let mut file = Tensors::new(&note);
        let clouds = [("value", &self.cloud), ("first", &self.adam.cloud[0]), ("second", &self.adam.cloud[1])];
        for (prefix, cloud) in clouds {
            for (name, width, values) in cloud.columns() {
                file.put(format!("{prefix}.{name}"), vec![cloud.len(), width], values.to_vec());
            }
        }
        let networks = [("value", &*self.weights), ("first", &self.adam.weights[0]), ("second", &self.adam.weights[1])];
        for (prefix, weights) in networks {
            put_weights(&mut file, &format!("{prefix}.network."), weights, &self.stages);
        }
        for (name, values) in self.stats.columns() {
            file.put(format!("stats.{name}"), vec![values.len()], values.to_vec());
        }
        file.put_ids("gaussian_ids", &self.gaussian_ids.rows);
        file.note = to_json(&Sealed { digest: file.digest(), note });
        file.to_bytes()
    }

    /// Restores the trainer from `bytes`, for the same plan and data.
    ///
    /// # Errors
    /// [`Error::Config`] if the bytes are damaged or belong to another training, and as [`Self::new`] for plan and data.
    pub fn restore(plan: &TrainingPlan, data: &'a Dataset, partition: &Partition, bytes: &[u8]) -> Result<Self> {
        let mut trainer = Self::blank(plan, data, partition)?;
        trainer
            .read_checkpoint(bytes)
            .map_err(|why| Error::Config(format!("unusable checkpoint: {why}; remove it to restart from step 1")))?;
        Ok(trainer)
    }

    /// Reads the state from the bytes of a checkpoint: the tensors that [`Self::checkpoint`] puts, by the same names.
    ///
    /// # Errors
    /// The bytes are damaged, are of another version, or belong to another training; the message states the difference.
    fn read_checkpoint(&mut self, bytes: &[u8]) -> Result<(), String> {
        let mut file = Tensors::from_bytes(bytes)?;
        let Sealed { digest, note } = serde_json::from_str(&file.note)
            .map_err(|e| format!("it is damaged, or of another version of pwrfgs ({e})"))?;
        file.note = to_json(&note);
        if file.digest() != digest {
            return Err("it is damaged: its digest does not match its content".into());
        }
        if (&*note.format, note.version) != (FORMAT, VERSION) {
            return Err(format!("it is a `{}` of version {}, expected {VERSION}", note.format, note.version));
        }
        if note.fingerprint != self.fingerprint() {
            return Err("it was written with other settings, other data or another split".into());
        }
        let n = note.gaussians;
        let mut cloud = |prefix: &str| take_cloud(&mut file, &format!("{prefix}."), n, &note.extra);
        self.cloud = cloud("value")?;
        let moments = [cloud("first")?, cloud("second")?];
        let mut network = |prefix: &str| take_weights(&mut file, &format!("{prefix}.network."), &self.stages);
        self.weights = Arc::new(network("value")?);
        self.adam = Adam { cloud: moments, weights: [network("first")?, network("second")?] };
        self.stats = CloudStats::zeros(n);
        for (name, values) in self.stats.columns_mut() {
            *values = file.take(&format!("stats.{name}"), &[n])?;
        }
        self.gaussian_ids = GaussianIds { rows: file.take_ids("gaussian_ids", n)?, next: note.next_gaussian_id };
        (self.done, self.masks, self.device) = (note.done, note.masks, note.device);
        Ok(())
    }
}

/// Returns plain data as JSON text.
fn to_json(data: &impl Serialize) -> String {
    serde_json::to_string(data).expect("plain data")
}

/// Number of samples per digest; the digests are computed in parallel.
const CHUNK: usize = 64;

/// Returns a digest of all parts of `plan` that affect training, of `data`, and of the training links. It excludes the
/// name, the interval of checkpoints, and the validation unless it chooses the step.
pub(crate) fn fingerprint(plan: &TrainingPlan, data: &Dataset, train: &[usize]) -> String {
    // The destructuring is complete on purpose: a new field of a plan must be hashed or listed here as irrelevant.
    let TrainingPlan { name: _, seed, method, initializer, pruners, training } = plan;
    let message = to_ron(&(seed, initializer, method, pruners, training.of_model()));
    let columns: Vec<_> = requested_columns(plan).into_iter().map(|spec| (spec.name, spec.width)).collect();
    let parts = [message, format!("{columns:?} {train:?} {}", size_of::<Real>()), describe_data(data)];
    digest(parts.join("\n").as_bytes())
}

/// Returns a digest of the values of `data`: scene, poses, features, links and observations. It reads all observations.
pub fn data_digest(data: &Dataset) -> String {
    digest(describe_data(data).as_bytes())
}

/// Returns task, scene, image size and frequencies of the data as text, with digests of points, links, and every [`CHUNK`]
/// samples.
fn describe_data(data: &Dataset) -> String {
    let digest_samples = |samples: &[(usize, Sample)]| {
        let mut bytes = Vec::new();
        for (i, sample) in samples {
            bytes.extend(sample.position().iter().flat_map(|v| v.to_le_bytes()));
            bytes.extend(data.query(*i).features.iter().copied().flatten().flat_map(|v| v.to_le_bytes()));
            bytes.extend(sample.pose.orientation.iter().flat_map(|v| v.to_le_bytes()));
            bytes.extend_from_slice(&data.observations.raw(*i));
        }
        digest(&bytes)
    };
    let samples: Vec<(usize, Sample)> = data.samples().enumerate().collect();
    let parts: Vec<String> = samples.par_chunks(CHUNK).map(digest_samples).collect();
    let points: Vec<u8> = data.scene.points.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
    let links = data.links.iter().flat_map(|link| [link.location, link.receiver]);
    let links: Vec<u8> = links.flat_map(|index| (index as u64).to_le_bytes()).collect();
    let Dataset { scene, width, height, elevation, .. } = data;
    let setup = to_json(&(
        data.task().name,
        (scene.moving, scene.transmitter, &scene.receivers),
        scene.origin,
        (width, height, elevation),
        data.observations.frequencies_hz(),
    ));
    [setup, digest(&points), digest(&links), parts.join(" ")].join("\n")
}
