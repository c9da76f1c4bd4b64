//! What one wants to know of a data set before training: [`inspect`] looks, [`Inspection::text`] says it in a terminal,
//! [`Inspection::page`] on a page, and [`write()`] puts that into a folder.
//!
//! One question a file: where transmitters stand (`trajectory`), how strong powers and channels are (`levels`), what pictures
//! hold (`pictures`), how many numbers they
//! are made of (`freedom`), whether the recorded pose can be right (`pose`), and what each split asks (`splits`).
//! Everything is bounded: of many pictures so many are looked at, evenly chosen, and the page says how many.
#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod ceiling;
mod eigen;
mod freedom;
mod levels;
mod look;
mod output;
mod page;
mod pictures;
mod pose;
mod splits;
mod text;
mod trajectory;
mod words;

pub use freedom::{Array, Components, Freedom, Kind};
pub use output::{claim, write};
pub use pictures::Pictures;
pub use pose::{Flip, Pose, Verdict};
pub use splits::{Divided, Floor, Outcome};
pub use trajectory::Trajectory;

use look::Looks;
use pwrfgs_core::{Dataset, Metric, Plugin, Result, Scope, Task as Observed};
use pwrfgs_experiment::repeatability::{Repeatability, repeatability};
use pwrfgs_experiment::{Observer, staged};
use pwrfgs_pipeline::Pipeline;
use std::sync::atomic::AtomicBool;

/// All that was found.
#[derive(Debug)]
pub struct Inspection<'a> {
    /// The data looked at.
    pub data: &'a Dataset,
    /// Where transmitters stand.
    pub trajectory: Trajectory,
    /// What pictures hold, and how many numbers they are made of; `None` of powers and channels, which are none.
    pub pictures: Option<(Pictures, Freedom)>,
    /// What they say of the recorded pose; `None` where too few have a strongest direction.
    pub pose: Option<Pose>,
    /// What each split asks.
    pub splits: Vec<Divided>,
    /// How alike spectra of one place are.
    pub ceiling: Repeatability,
}

/// Looks at `data`, with the split, baselines, metrics and seed of a pipeline.
///
/// # Errors
/// Where a picture cannot be read, or a baseline or a metric refuses.
pub fn inspect<'a>(pipeline: &Pipeline, data: &'a Dataset, observer: &mut dyn Observer) -> Result<Inspection<'a>> {
    let (mut pictures, mut pose) = (None, None);
    if data.task() == Observed::Spectrum {
        let looks = staged(observer, "looking at the pictures", |progress| Looks::of(data, progress))?;
        observer.on_stage("degrees of freedom", 0, 0);
        pictures = Some((pictures::pictures(data, &looks), freedom::freedom(data, &looks.each)));
        observer.on_stage("the pose", 0, 0);
        pose = pose::pose(data, &looks.each);
    }
    observer.on_stage("repeatability", 0, 0);
    let of = |wanted: &dyn Fn(Scope) -> bool| -> Vec<Plugin<dyn Metric>> {
        pipeline.metrics.iter().filter(|metric| wanted(metric.scope())).cloned().collect()
    };
    let ceiling = repeatability(data, &of(&|scope| scope == Scope::Sample), &AtomicBool::new(false))?;
    data.observations.check()?;
    Ok(Inspection {
        data,
        trajectory: trajectory::trajectory(data),
        pictures,
        pose,
        splits: splits::splits(pipeline, &of(&|scope| scope != Scope::Model), data, observer)?,
        ceiling,
    })
}

#[cfg(test)]
mod tests;
