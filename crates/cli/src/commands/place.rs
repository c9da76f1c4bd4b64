//! `pwrfgs place`: positions of receivers with the largest coverage.

mod measured;
#[cfg(feature = "raytrace")]
mod scene;

use crate::interrupt::stop_flag;
use crate::output::{self, Verbosity};
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::experiment::staged;
use pwrfgs::experiment::text::{Lines, aligned};
use pwrfgs::report::draw::survey::CoverageMap;
use pwrfgs_core::files::NewFolder;
use pwrfgs_core::{Error, Result, recognise};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// Width of the image in print, millimetres.
const WIDTH_MM: f64 = 120.0;
/// Number of random choices that are averaged.
const RANDOM: usize = 100;

#[derive(Debug, Args)]
#[command(after_help = "\
Coverage is the 10th percentile, over transmitters, of the power of the strongest receiver.
A scene is simulated: 1 to 3 receivers at any free position, beside the best position on a grid.
A data folder with received powers: the best of its receivers, scored on held-out transmitters.
Writes place.csv (choice, receiver, position, coverage) and place.png.

EXAMPLES
  pwrfgs place office --count 1
  pwrfgs place scenes/conference.ron --count 2 --no-grid --out two
  pwrfgs place data/ble --count 5 --out gateways")]
pub(crate) struct Place {
    /// Scene file or shipped scene, or data folder with received powers
    #[arg(value_name = "SOURCE")]
    pub(crate) source: PathBuf,
    /// Number of receivers
    #[arg(long, value_name = "N")]
    pub(crate) count: usize,
    /// Scenes: grid spacing of transmitters and of receivers in metres
    #[arg(long, value_name = "M", default_value_t = 0.5)]
    pub(crate) step: f64,
    /// Scenes: height of the transmitters in metres
    #[arg(long, value_name = "M", default_value_t = 1.2, allow_negative_numbers = true)]
    pub(crate) height: f64,
    /// Scenes: height of the receivers in metres [default: that of the scene's receiver]
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    pub(crate) mount: Option<f64>,
    /// Scenes: omit the grid of receivers, which takes most of the time
    #[arg(long)]
    pub(crate) no_grid: bool,
    /// Random seed of samples, random choices and random splits
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    pub(crate) seed: u64,
    /// Output folder; must be new or empty
    #[arg(long, value_name = "DIR", default_value = "place")]
    pub(crate) out: PathBuf,
}

/// Runs `pwrfgs place`: prints the table of the choices, and writes their list and map.
pub(crate) fn place(arguments: &Place, verbosity: Verbosity) -> Result<()> {
    if arguments.count == 0 {
        return Err(Error::Config("--count 0: give at least 1".into()));
    }
    let (stop, folder) = (stop_flag(), NewFolder::begin(&arguments.out)?);
    let outcome = RunProgress::observe(verbosity, |progress| match recognise(&arguments.source) {
        Some(source) => {
            let data = staged(progress, "data", |progress| source.load(Path::new(""), progress))?;
            measured::choose_receivers(arguments, &data, progress)
        }
        None => choose_in_scene(arguments, &stop, progress),
    })?;
    outcome.write_files(&folder)?;
    folder.publish()?;
    output::print_result(&outcome.format_table())?;
    verbosity.print_note(&format!("positions and map in {}", arguments.out.display()));
    Ok(())
}

/// Chooses receivers in the scene that the arguments name; a folder is an error.
#[cfg(feature = "raytrace")]
fn choose_in_scene(arguments: &Place, stop: &AtomicBool, progress: &mut RunProgress) -> Result<Outcome> {
    if arguments.source.is_dir() {
        let source = &arguments.source;
        return Err(Error::input(source, "no data found; name a data folder (layouts: docs/data.md), or a scene"));
    }
    scene::choose_receivers(arguments, stop, progress)
}

/// Rejects scenes, which need the feature `raytrace`.
#[cfg(not(feature = "raytrace"))]
fn choose_in_scene(arguments: &Place, _: &AtomicBool, _: &mut RunProgress) -> Result<Outcome> {
    let advice = "name a data folder, or build with the feature `raytrace`";
    Err(Error::input(&arguments.source, format!("no data found, and this build has no scenes; {advice}")))
}

/// Choice of receivers.
struct Choice {
    /// Name in `place.csv`; empty for averages, which are not written.
    short: &'static str,
    /// Name in the table.
    name: String,
    /// Names, empty in scenes, and positions in metres.
    receivers: Vec<(String, [f64; 3])>,
    /// Coverage, dBm.
    coverage: f64,
    /// Further cells of the line, including the coverage.
    cells: Vec<String>,
}

/// Result of a command.
struct Outcome {
    /// Headings after the first.
    header: Vec<String>,
    /// Choices, the best search first.
    choices: Vec<Choice>,
    /// Lines below the table.
    notes: Vec<String>,
    map: CoverageMap,
}

impl Outcome {
    /// Formats the table of the choices, with the notes below it.
    fn format_table(&self) -> String {
        let mut lines = vec![[&["choice".to_owned()], &self.header[..]].concat()];
        let line = |choice: &Choice| [std::slice::from_ref(&choice.name), &choice.cells[..]].concat();
        lines.extend(self.choices.iter().map(line));
        self.notes.iter().fold(aligned(&lines, 1) + "\n", |text, note| text + note + "\n")
    }

    /// Writes `place.csv` and `place.png` into `folder`.
    fn write_files(&self, folder: &NewFolder) -> Result<()> {
        let mut lines = Lines::new(["choice", "order", "receiver", "x", "y", "z", "coverage_dbm"]);
        for choice in self.choices.iter().filter(|choice| !choice.short.is_empty()) {
            for (k, (name, position)) in choice.receivers.iter().enumerate() {
                let [x, y, z] = position.map(|v| v.to_string());
                lines.put([choice.short, &(k + 1).to_string(), name, &x, &y, &z, &format!("{:.3}", choice.coverage)]);
            }
        }
        folder.put("place.csv", lines.text())?;
        folder.put("place.png", self.map.draw().png(WIDTH_MM))
    }
}
