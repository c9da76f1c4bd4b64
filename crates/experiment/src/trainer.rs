//! The trainer of a run: new or from the checkpoint, and refused if it cannot fit the machine.

use crate::folder::{CHECKPOINT, RunFolder};
use crate::memory;
use crate::observer::staged;
use crate::session::Session;
use pwrfgs_core::files::{self, if_found};
use pwrfgs_core::{Dataset, Error, Partition, Progress, Result};
use pwrfgs_pipeline::Pipeline;
use pwrfgs_train::{Estimate, Trainer, check_available, network_bytes};

/// A trainer at the start, or where the checkpoint in the folder left it, and what a step will take.
///
/// # Errors
/// Settings that cannot work, a damaged checkpoint, what does not fit; [`Error::Stopped`] once the session is.
pub(crate) fn trainer<'a>(
    pipeline: &Pipeline,
    (data, partition): (&'a Dataset, &'a Partition),
    held: Option<&RunFolder>,
    session: &mut Session<'_>,
) -> Result<(Trainer<'a>, Estimate)> {
    // A strategy that cannot be asked is refused before a checkpoint is blamed for it.
    check_available(&pipeline.pruners)?;
    let restored = |folder: &RunFolder| {
        let path = folder.file(CHECKPOINT);
        let Some(bytes) = if_found(&path, files::read(&path))? else { return Ok(None) };
        let restored = Trainer::restore(&pipeline.plan()?, data, partition, &bytes);
        restored.map(Some).map_err(|e| Error::input(&path, format!("{e}; remove it to start again")))
    };
    fitting(pipeline, || {
        if let Some(folder) = held
            && let Some(trainer) = folder.settle(restored(folder))?
        {
            return Ok(trainer);
        }
        let stop = session.stop;
        let begin = |progress: Progress<'_>| Trainer::begin(&pipeline.plan()?, data, partition, progress, stop);
        staged(session.observer, "initialising", begin)
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
