//! `preview`: what a run will do and take, without doing it.

use crate::input::prepared;
use crate::inspect::{DataSummary, test_distance};
use crate::load::load;
use crate::memory;
use crate::observed::observed;
use crate::observer::Observer;
use crate::trainer::fitting;
use pwrfgs_core::Result;
use pwrfgs_pipeline::Pipeline;
use pwrfgs_train::{Estimate, Trainer};
use std::path::Path;

/// Most spectra that a preview reads for its summary.
const SUMMARIZED: usize = 1_000;

/// What a run will do and take.
#[derive(Clone, Debug)]
pub struct Preview {
    /// The pipeline, with every default and its scale.
    pub pipeline: Pipeline,
    /// What the data call themselves.
    pub title: String,
    /// How much of what they hold.
    pub observed: String,
    /// Samples for training, validation, test.
    pub samples: [usize; 3],
    /// Points of the cloud.
    pub points: usize,
    /// Numbers of the network.
    pub weights: usize,
    /// Warnings of settings without effect.
    pub warnings: Vec<String>,
    /// What a step takes, with the Gaussians it starts from.
    pub estimate: Estimate,
    /// Positions, values and pose of the data.
    pub summary: DataSummary,
    /// Median distance from a test transmitter to the nearest training transmitter, metres.
    pub test_distance: f64,
    /// Memory that the process has taken with all data loaded, bytes; 0 where the system does not tell.
    pub loaded_bytes: u64,
    /// Memory that is left beyond that, bytes; `None` where the system does not tell.
    pub free_bytes: Option<u64>,
}

/// Reads, loads and initialises everything that a run of `pipeline` would, and tries a step.
///
/// # Errors
/// Whatever [`crate::run`] would refuse before its first step.
pub fn preview(pipeline: &Pipeline, base: &Path, observer: &mut dyn Observer) -> Result<Preview> {
    let pipeline = prepared(pipeline, base)?;
    let (data, partition) = load(&pipeline, base, observer)?;
    pipeline.check_data(&data)?;
    let mut loaded_bytes = 0;
    let (trainer, estimate) = fitting(&pipeline, || {
        let trainer = Trainer::sketch(&pipeline.plan()?, &data, &partition)?;
        loaded_bytes = memory::peak(); // before a step is tried, which is counted by itself
        Ok(trainer)
    })?;
    let weights = trainer.weights();
    Ok(Preview {
        title: data.title.clone(),
        observed: observed(&data),
        samples: partition.sizes(),
        points: data.scene.points.len(),
        weights,
        summary: DataSummary::of(&data, SUMMARIZED, observer)?,
        test_distance: test_distance(&data, &partition),
        warnings: trainer.warnings(),
        estimate,
        loaded_bytes,
        free_bytes: memory::free(),
        pipeline,
    })
}
