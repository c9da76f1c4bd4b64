//! Checkpoints: everything needed to go on as if nothing had happened, in one safetensors file.
//!
//! Random streams are functions of (seed, name, step), so a step number is all the state they have.

use crate::trainer::Trainer;
use crate::{TrainingPlan, adam::Adam, births::Births};
use pwrfgs_core::{CloudStats, Dataset, Error, Partition, Real, Result};
use pwrfgs_model::file::{put_weights, take_columns, take_weights};
use pwrfgs_model::tensors::Tensors;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What the file says besides numbers, and the digest of all of it.
#[derive(Serialize, Deserialize)]
struct Sealed {
    digest: String,
    note: Note,
}

#[derive(Serialize, Deserialize)]
struct Note {
    format: String,
    version: u32,
    /// Of plan and data.
    fingerprint: String,
    done: u64,
    gaussians: usize,
    /// Extra columns and their widths.
    extra: Vec<(String, usize)>,
    /// How many Gaussians there have been.
    born: u32,
}

const FORMAT: &str = "pwrfgs-checkpoint";
const VERSION: u32 = 6;

impl<'a> Trainer<'a> {
    /// Everything needed to go on, as bytes.
    pub fn checkpoint(&self) -> Vec<u8> {
        let note = Note {
            format: FORMAT.into(),
            version: VERSION,
            fingerprint: self.fingerprint().to_owned(),
            done: self.done,
            gaussians: self.cloud.len(),
            extra: self.cloud.extra.iter().map(|c| (c.name.clone(), c.width)).collect(),
            born: self.births.next,
        };
        let mut file = Tensors::new(json(&note));
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
        let births = self.births.of.iter().map(|birth| *birth as Real).collect();
        file.put("births", vec![self.cloud.len()], births);
        file.note = json(&Sealed { digest: file.digest(), note });
        file.to_bytes()
    }

    /// The trainer that wrote `bytes`, for the same plan and data.
    ///
    /// # Errors
    /// [`Error::Config`] where the bytes are not such a checkpoint: damaged, or of another training.
    pub fn restore(plan: &TrainingPlan, data: &'a Dataset, partition: &Partition, bytes: &[u8]) -> Result<Self> {
        let mut trainer = Self::blank(plan, data, partition)?;
        trainer.read(bytes).map_err(|why| {
            Error::Config(format!("the checkpoint cannot be used: {why}; remove it to start again from step 1"))
        })?;
        Ok(trainer)
    }

    fn read(&mut self, bytes: &[u8]) -> Result<(), String> {
        let mut file = Tensors::from_bytes(bytes)?;
        let Sealed { digest, note } = serde_json::from_str(&file.note)
            .map_err(|e| format!("it is damaged, or of another version of pwrfgs ({e})"))?;
        file.note = json(&note);
        if file.digest() != digest {
            return Err("it is damaged: what it holds is not what was written".into());
        }
        if (&*note.format, note.version) != (FORMAT, VERSION) {
            return Err(format!("it is a `{}` of version {}, expected {VERSION}", note.format, note.version));
        }
        if note.fingerprint != self.fingerprint() {
            return Err("it was written with other settings, other data or another split".into());
        }
        let n = note.gaussians;
        let mut cloud = |prefix: &str| take_columns(&mut file, &format!("{prefix}."), n, &note.extra);
        self.cloud = cloud("value")?;
        let moments = [cloud("first")?, cloud("second")?];
        let mut network = |prefix: &str| take_weights(&mut file, &format!("{prefix}.network."), &self.stages);
        self.weights = Arc::new(network("value")?);
        self.adam = Adam { cloud: moments, weights: [network("first")?, network("second")?] };
        self.stats = CloudStats::zeros(n);
        for (name, values) in self.stats.columns_mut() {
            *values = file.take(&format!("stats.{name}"), &[n])?;
        }
        let births = file.take("births", &[n])?;
        self.births = Births { of: births.into_iter().map(|birth| birth as u32).collect(), next: note.born };
        self.done = note.done;
        Ok(())
    }
}

fn json(note: &impl Serialize) -> String {
    serde_json::to_string(note).expect("plain data")
}
