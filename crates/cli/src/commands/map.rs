//! `pwrfgs map`: radio maps of a model over a plane, as images and arrays.

use super::devices::choose_for_predictions;
use crate::output::{self, Verbosity};
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::experiment::text::grouped;
use pwrfgs::tasks::{MapSettings, map as map_model, read_models};
use pwrfgs_core::Result;
use pwrfgs_core::files::NewFolder;
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "\
QUANTITIES
  powers    power in dBm at each receiver and, for several receivers, at the strongest of them
            (strongest.npy)
  spectra   direction: azimuth and elevation of the strongest direction (degrees, receiver frame;
            arrows on the azimuth map show this direction in world axes); level: pixel value in
            this direction; mean: mean of all pixels
  channels  mean power over antennas and subcarriers in dB
FILES
  power.npy  float32 [rows, columns], lowest row first (power-NAME.npy for several receivers);
             other quantities likewise
  power.png  this array as an image, with receivers as squares
  training_distance.npy, .png  distance to the nearest stored training position (at most 1,024 per
             model), metres
  map.csv    quantity, receiver and grid of each array, and the number of extrapolated positions
Circles are stored training positions near the plane. Hatched areas are extrapolations: positions
farther from all stored training positions than 3 times the spacing of these (95th percentile of
nearest-neighbour distances).
Without --bounds, the map covers all stored training positions and the mapped receivers.

EXAMPLES
  pwrfgs map runs/ble --plane z=0 --step 0.25 --receiver g01 --out g01
  pwrfgs map runs/quickstart --plane z=1.2 --of direction --out directions")]
pub(crate) struct Map {
    /// Run folder, model file or name of a model in `pwrfgs pipelines`, such as s23; several models form
    /// an ensemble
    #[arg(value_name = "MODEL", required = true)]
    pub(crate) models: Vec<PathBuf>,
    #[command(flatten)]
    pub(crate) settings: MapSettings,
    /// Output folder; must be new or empty
    #[arg(short, long, value_name = "DIR")]
    pub(crate) out: PathBuf,
}

/// Runs `pwrfgs map`: writes the arrays and images of all maps.
pub(crate) fn map(arguments: &Map, verbosity: Verbosity) -> Result<()> {
    let ensemble = read_models(&arguments.models)?;
    choose_for_predictions(&ensemble, usize::MAX, verbosity); // a map has many positions
    let folder = NewFolder::begin(&arguments.out)?;
    let map = RunProgress::observe(verbosity, |progress| map_model(&ensemble, &arguments.settings, progress))?;
    map.write(&folder)?;
    folder.publish()?;
    let missing = map.count_missing();
    if missing > 0 {
        let missing = grouped(missing as i64);
        output::print_warning(&format!(
            "{missing} values are not finite because the model overflows there; the images show them in grey"
        ));
    }
    let (columns, rows) = (grouped(map.grid.columns as i64), grouped(map.grid.rows as i64));
    let maps = if map.layers.len() == 1 { "1 map".into() } else { format!("{} maps", map.layers.len()) };
    verbosity.print_note(&format!("{maps} of {columns} x {rows} positions in {}", arguments.out.display()));
    Ok(())
}
