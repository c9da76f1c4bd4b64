//! `pwrfgs place`: positions of receivers with the largest coverage.

use super::options::in_file;
use crate::interrupt::stop_flag;
use crate::output::{self, Verbosity};
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::experiment::{Session, run_stage};
use pwrfgs::tasks::place::{PlaceSettings, Placement, place_in_data};
use pwrfgs_core::files::NewFolder;
use pwrfgs_core::{Error, Result, recognise};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

#[derive(Debug, Args)]
#[command(after_help = "\
Coverage is the 10th percentile, over transmitters, of the power at the strongest receiver.
In a scene, the command simulates received powers. It searches positions outside objects for 1 to 3
receivers, and compares them with receivers on a grid, the best selection and random ones. In a data
folder with received powers, it selects among the measured receivers, and scores the selection on
held-out transmitters: the test set of the index files, or a random fifth of the transmitters.
The command writes place.csv (choice, receiver, position, coverage) and place.png.

EXAMPLES
  pwrfgs place office --count 1
  pwrfgs place scenes/conference.ron --count 2 --no-grid --out two
  pwrfgs place data/ble --count 5 --out gateways")]
pub(crate) struct Place {
    /// Scene file, name of a scene in `pwrfgs pipelines`, or data folder with received powers
    #[arg(value_name = "SOURCE")]
    pub(crate) source: PathBuf,
    #[command(flatten)]
    pub(crate) settings: PlaceSettings,
    /// Output folder; must be new or empty
    #[arg(short, long, value_name = "DIR", default_value = "place")]
    pub(crate) out: PathBuf,
}

/// Runs `pwrfgs place`: prints the table of the choices, and writes their list and map.
pub(crate) fn place(arguments: &Place, verbosity: Verbosity) -> Result<()> {
    let (stop, folder) = (stop_flag(), NewFolder::begin(&arguments.out)?);
    let placement = RunProgress::observe(verbosity, |progress| match recognise(&arguments.source) {
        Some(source) => {
            let data = run_stage(progress, "data", |progress| source.load(Path::new(""), progress))?;
            place_in_data(&data, &arguments.settings, progress).map_err(in_file(&arguments.source))
        }
        None => choose_in_scene(arguments, &stop, progress),
    })?;
    placement.write(&folder)?;
    folder.publish()?;
    output::print_result(&placement.table())?;
    verbosity.print_note(&format!("positions and map in {}", arguments.out.display()));
    Ok(())
}

/// Chooses receivers in the scene that the arguments name; a folder is an error.
#[cfg(feature = "raytrace")]
fn choose_in_scene(arguments: &Place, stop: &AtomicBool, progress: &mut RunProgress) -> Result<Placement> {
    if arguments.source.is_dir() {
        let source = &arguments.source;
        return Err(Error::input(source, "no data found; name a data folder (layouts: docs/data.md), or a scene"));
    }
    let scene = pwrfgs::raytrace::SceneFile::read(&arguments.source)?;
    let session = &mut Session { stop, ..Session::new(progress) };
    pwrfgs::tasks::place::place_in_scene(&scene, &arguments.settings, session)
}

/// Rejects scenes, which need the feature `raytrace`.
#[cfg(not(feature = "raytrace"))]
fn choose_in_scene(arguments: &Place, _: &AtomicBool, _: &mut RunProgress) -> Result<Placement> {
    let advice = "name a data folder, or build with the feature `raytrace`";
    Err(Error::input(&arguments.source, format!("no data found, and this build has no scenes; {advice}")))
}
