//! `pwrfgs place`: positions of receivers with the largest coverage.

mod choice;
mod measured;
#[cfg(feature = "raytrace")]
mod scene;

pub(crate) use choice::Place;

use crate::interrupt::stop_flag;
use crate::output::{self, Verbosity};
use crate::progress::RunProgress;
use choice::Outcome;
use pwrfgs_core::files::NewFolder;
use pwrfgs_core::{Error, Result, recognise};
use std::sync::atomic::AtomicBool;

pub(crate) fn place(arguments: &Place, verbosity: Verbosity) -> Result<()> {
    if arguments.count == 0 {
        return Err(Error::Config("--count 0: give at least 1".into()));
    }
    let (stop, folder) = (stop_flag(), NewFolder::begin(&arguments.out)?);
    let outcome = RunProgress::during(verbosity, |progress| match recognise(&arguments.source) {
        Some(source) => measured::choose(arguments, &source, progress),
        None => simulated(arguments, &stop, progress),
    })?;
    outcome.write(&folder)?;
    folder.publish()?;
    output::result(&outcome.table())?;
    verbosity.note(&format!("positions and map in {}", arguments.out.display()));
    Ok(())
}

#[cfg(feature = "raytrace")]
fn simulated(arguments: &Place, stop: &AtomicBool, progress: &mut RunProgress) -> Result<Outcome> {
    if arguments.source.is_dir() {
        let what = "no data found; name a data folder (layouts: docs/data.md), or a scene";
        return Err(Error::input(&arguments.source, what));
    }
    scene::choose(arguments, stop, progress)
}

#[cfg(not(feature = "raytrace"))]
fn simulated(arguments: &Place, _: &AtomicBool, _: &mut RunProgress) -> Result<Outcome> {
    let what = "no data found, and this build has no scenes; name a data folder, or build with the feature `raytrace`";
    Err(Error::input(&arguments.source, what))
}
