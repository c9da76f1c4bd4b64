//! Positions of receivers with the largest coverage.

mod measured;
#[cfg(feature = "raytrace")]
mod scene;

use clap::Args;
pub use measured::place_in_data;
use pwrfgs_core::Result;
use pwrfgs_core::files::NewFolder;
use pwrfgs_experiment::text::{Lines, align_columns};
use pwrfgs_report::draw::survey::CoverageMap;
#[cfg(feature = "raytrace")]
pub use scene::place_in_scene;
use schemars::JsonSchema;
use serde::Deserialize;

/// Width of the image in print, millimetres.
const WIDTH_MM: f64 = 120.0;
/// Number of random choices that are averaged.
const RANDOM: usize = 100;

/// Settings of [`place_in_data`] and `place_in_scene`.
#[derive(Clone, Debug, Args, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PlaceSettings {
    /// Number of receivers to select
    #[arg(long, value_name = "N")]
    pub count: usize,
    /// Scenes: grid spacing of transmitters and of receivers in metres
    #[arg(long, value_name = "M", default_value_t = default_step())]
    #[serde(default = "default_step")]
    pub step: f64,
    /// Scenes: height of the transmitters in metres
    #[arg(long, value_name = "M", default_value_t = default_height(), allow_negative_numbers = true)]
    #[serde(default = "default_height")]
    pub height: f64,
    /// Scenes: height of the receivers in metres [default: that of the scene's receiver]
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    #[serde(default)]
    pub mount: Option<f64>,
    /// Scenes: omit the comparison with receivers on a grid, which takes most of the time
    #[arg(long)]
    #[serde(default)]
    pub no_grid: bool,
    /// Random seed of the search in scenes, of the random selections for comparison, and of a random split of data
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    #[serde(default)]
    pub seed: u64,
}

/// Returns the default grid spacing, metres.
fn default_step() -> f64 {
    0.5
}

/// Returns the default height of transmitters, metres.
fn default_height() -> f64 {
    1.2
}

/// Rejects 0 receivers.
fn check_count(count: usize) -> Result<()> {
    if count == 0 { Err(pwrfgs_core::Error::Config("--count 0: give at least 1".into())) } else { Ok(()) }
}

/// Choice of receivers.
#[derive(Clone, Debug)]
pub struct PlacedReceivers {
    /// Name in `place.csv`; empty for averages and for all receivers, which are not written.
    pub short: &'static str,
    /// Name in the table.
    pub name: String,
    /// Names, empty in scenes, and positions in metres; none for choices that are not written.
    pub receivers: Vec<(String, [f64; 3])>,
    /// Coverage, dBm.
    pub coverage: f64,
    /// Further cells of the line, including the coverage.
    cells: Vec<String>,
}

/// Choices of receivers with their coverage.
#[derive(Debug)]
pub struct Placement {
    /// Headings after the first.
    header: Vec<String>,
    /// Choices: the main search first, then others to compare with.
    pub choices: Vec<PlacedReceivers>,
    /// Lines below the table.
    notes: Vec<String>,
    map: CoverageMap,
}

impl Placement {
    /// Formats the table of the choices, with the notes below it.
    pub fn table(&self) -> String {
        let mut lines = vec![[&["choice".to_owned()], &self.header[..]].concat()];
        let line = |choice: &PlacedReceivers| [std::slice::from_ref(&choice.name), &choice.cells[..]].concat();
        lines.extend(self.choices.iter().map(line));
        self.notes.iter().fold(align_columns(&lines, 1) + "\n", |text, note| text + note + "\n")
    }

    /// Writes `place.csv` and `place.png` into `folder`.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn write(&self, folder: &NewFolder) -> Result<()> {
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
