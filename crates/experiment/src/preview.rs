//! `preview`: what a run will do and take, without doing it; and the refusal of what cannot fit the machine.

use crate::input::prepared;
use crate::inspect::{DataSummary, test_distance};
use crate::load::load;
use crate::memory;
use crate::observed::observed;
use crate::observer::Observer;
use pwrfgs_core::{Error, Result};
use pwrfgs_pipeline::Pipeline;
use pwrfgs_train::{Estimate, Trainer, network_bytes};
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

/// The trainer that `make` gives, and what its next step takes. Refuses what does not fit the machine: the network before it is
/// made, then the step.
///
/// # Errors
/// What does not fit; those of `make`.
pub(crate) fn fitting<'a>(
    pipeline: &Pipeline,
    make: impl FnOnce() -> Result<Trainer<'a>>,
) -> Result<(Trainer<'a>, Estimate)> {
    let needed = if pipeline.method.is_some() { 0 } else { network_bytes(&*pipeline.deformation) };
    refuse_beyond_memory(needed, "the network", "a smaller `width` or `depth` of the deformation")?;
    let trainer = make()?;
    let estimate = trainer.estimate()?;
    let what = format!("a training step with N = {}", estimate.gaussians);
    let advice = "fewer Gaussians (`max_points` of PointCloud, `count` of the others) or a smaller `training.batch`";
    refuse_beyond_memory(estimate.step_bytes, &what, advice)?;
    Ok((trainer, estimate))
}

fn refuse_beyond_memory(needed: u64, what: &str, advice: &str) -> Result<()> {
    match memory::free() {
        Some(free) if needed > free => Err(Error::Config(format!(
            "{what} needs about {:.1} GB of memory, and {:.1} GB are left here; take {advice}",
            needed as f64 / 1e9,
            free as f64 / 1e9
        ))),
        _ => Ok(()),
    }
}
