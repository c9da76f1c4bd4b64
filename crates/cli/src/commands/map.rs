//! `pwrfgs map`: radio maps of a model over a plane, as images and arrays.

mod layers;
mod plane;

use super::options::{check_position_input, read_models, select_receivers};
use crate::output::{self, Verbosity};
use crate::progress::RunProgress;
use clap::Args;
use layers::{MapLayer, MapQuantity, compute_layers, select_quantities};
pub(super) use plane::PlaneBounds;
use plane::{MapPlane, PlaneGrid};
use pwrfgs::data::npy_header;
use pwrfgs::experiment::Observer as _;
use pwrfgs::experiment::text::{field, grouped};
use pwrfgs::model::Ensemble;
use pwrfgs::report::draw::plan::{Heatmap, Palette, TrainingMap};
use pwrfgs_core::files::NewFolder;
use pwrfgs_core::{Error, Number, Pose, Receiver, Result};
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::PathBuf;

/// Width of an image in print, millimetres.
const WIDTH_MM: f64 = 120.0;
const HEADER: &str = "array,image,quantity,unit,receiver,columns_axis,first_column_m,columns,rows_axis,first_row_m,rows,\
                      step_m,plane,smallest,largest,training_limit_m,extrapolated\n";

#[derive(Debug, Args)]
#[command(after_help = "\
QUANTITIES
  powers    power in dBm at each receiver, and at the strongest receiver
  spectra   direction: azimuth and elevation of the strongest direction (degrees, receiver frame;
            arrows show it in the room); level: its value; mean: the mean pixel
  channels  mean power over antennas and subcarriers in dB
FILES
  power.npy  float32 [rows, columns], lowest row first (power-NAME.npy for several receivers)
  power.png  the same array as an image, with receivers as squares
  training_distance.npy, .png  distance to the nearest training position, metres
  map.csv    quantity, receiver and grid of each array, and the number of extrapolated positions
Images show training positions near the plane as circles. They hatch extrapolations: positions
farther from all training positions than 3 times their spacing (95th percentile of
nearest-neighbour distances).
Without --bounds, the map covers all training positions and receivers.

EXAMPLES
  pwrfgs map runs/ble --plane z=0 --step 0.25 --receiver g01 --out g01
  pwrfgs map runs/quickstart --plane z=1.2 --of direction --out directions")]
pub(crate) struct Map {
    /// Run folder or model file; several form an ensemble
    #[arg(value_name = "MODEL", required = true)]
    pub(crate) models: Vec<PathBuf>,
    /// Plane, by its fixed coordinate in metres: z=1.2, x=0.5 or y=-3
    #[arg(long, value_name = "AXIS=M")]
    pub(crate) plane: String,
    /// Grid spacing in metres
    #[arg(long, value_name = "M", default_value_t = 0.1)]
    pub(crate) step: f64,
    /// Extent in metres of the first and second free coordinate
    #[arg(long, value_name = "X0,X1,Y0,Y1", allow_hyphen_values = true)]
    pub(crate) bounds: Option<String>,
    /// Map only this receiver (name in the data set); repeatable
    #[arg(long, value_name = "NAME")]
    pub(crate) receiver: Vec<String>,
    /// Quantity: power, level, mean or direction; repeatable.
    #[arg(
        long,
        value_enum,
        value_name = "QUANTITY",
        hide_possible_values = true,
        help = "Quantity: power, level, mean or direction; repeatable\n[default: power, or direction and level for spectra]"
    )]
    pub(crate) of: Vec<MapQuantity>,
    /// Output folder; must be new or empty
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
}

/// Runs `pwrfgs map`: writes the arrays and images of all maps.
pub(crate) fn map(arguments: &Map, verbosity: Verbosity) -> Result<()> {
    let plane = MapPlane::parse(&arguments.plane)?;
    let bounds =
        arguments.bounds.as_ref().map(|text| PlaneBounds::parse("--bounds", text, plane.axis_names())).transpose()?;
    let ensemble = read_models(&arguments.models)?;
    check_position_input(&ensemble)?;
    let model = ensemble.prepare();
    let quantities = select_quantities(&model, &arguments.of)?;
    let receivers = select_receivers(model.receivers(), &arguments.receiver)?;
    let origin = ensemble.members()[0].stages.origin;
    let poses: Vec<Pose> = model.receivers().iter().map(|receiver| origin.world_pose(receiver.pose)).collect();
    let (bounds, note) = if let Some(bounds) = bounds {
        (bounds, None)
    } else {
        let positions: Vec<[f64; 2]> = receivers.iter().map(|&r| plane.project(poses[r].position)).collect();
        let (bounds, source) = default_bounds(&ensemble, plane, positions)?;
        let bounds = bounds.rounded_outwards(arguments.step);
        (bounds, Some(describe_bounds(plane, bounds, source)))
    };
    let grid = PlaneGrid::new(plane, bounds, arguments.step, receivers.len())?;
    note.iter().for_each(|note| verbosity.print_note(note));
    let folder = NewFolder::begin(&arguments.out)?;
    let mut layers = RunProgress::observe(verbosity, |progress| {
        let total = grid.position_count();
        compute_layers(&model, &grid, &receivers, &quantities, |done| progress.on_stage("mapping", done, total))
    });
    let (layer, training) = training_layer(&ensemble, &grid).unzip();
    layers.extend(layer);
    MapWriter { grid, training, receivers: model.receivers(), poses, mapped: receivers }.write(&folder, &layers)?;
    folder.publish()?;
    let missing = layers.iter().flat_map(|layer| &layer.values).filter(|v| !v.is_finite()).count();
    if missing > 0 {
        let missing = grouped(missing as i64);
        output::print_warning(&format!(
            "{missing} values are not finite because the model overflows there; the images show them in grey"
        ));
    }
    let (columns, rows) = (grouped(grid.columns as i64), grouped(grid.rows as i64));
    let maps = if layers.len() == 1 { "1 map".into() } else { format!("{} maps", layers.len()) };
    verbosity.print_note(&format!("{maps} of {columns} x {rows} positions in {}", arguments.out.display()));
    Ok(())
}

/// Returns bounds around all training positions and `receivers` (metres in the plane), and their description. A model
/// of an earlier version has no training positions: the central 90 % of its Gaussians take their place.
///
/// # Errors
/// The model has neither training positions nor Gaussians.
fn default_bounds(model: &Ensemble, plane: MapPlane, receivers: Vec<[f64; 2]>) -> Result<(PlaneBounds, &'static str)> {
    let training = model.training_positions();
    if !training.is_empty() {
        let points: Vec<[f64; 2]> =
            training.into_iter().map(|position| plane.project(position)).chain(receivers).collect();
        return Ok((PlaneBounds::around(Vec::new(), &points), "all training positions and receivers"));
    }
    let origin = model.members()[0].stages.origin;
    let means = model.means_from(origin).into_iter().map(|mean| plane.project(origin.world(mean)));
    let means: Vec<[f64; 2]> = means.collect();
    if means.is_empty() {
        let problem = "--bounds: required for a model without training positions and Gaussians";
        return Err(Error::Config(problem.into()));
    }
    Ok((PlaneBounds::around(means, &receivers), "central 90 % of the Gaussians, and all receivers"))
}

/// Describes the default bounds; `source` names what they contain.
fn describe_bounds(plane: MapPlane, PlaneBounds([across, up]): PlaneBounds, source: &str) -> String {
    let ([a, b], short) = (plane.axis_names(), |v: f64| (v * 100.0).round() / 100.0);
    format!(
        "{a} from {} to {} m, {b} from {} to {} m ({source}); set --bounds to change this",
        short(across[0]),
        short(across[1]),
        short(up[0]),
        short(up[1])
    )
}

/// Computes the distances from the grid to the nearest training position as a layer. Also returns which positions are
/// extrapolations, and the training positions near the plane. `None` for models without training positions.
fn training_layer(ensemble: &Ensemble, grid: &PlaneGrid) -> Option<(MapLayer, TrainingMap)> {
    let positions: Vec<[f64; 3]> = (0..grid.position_count()).map(|k| grid.position(k)).collect();
    let distances = ensemble.training_distances(&positions)?;
    let (is_beyond, limit) = ((0..positions.len()).map(|k| distances.is_beyond(k)).collect(), distances.limit);
    let layer = MapLayer {
        name: "training_distance",
        words: "distance to the nearest training position",
        unit: "m",
        receiver: None,
        values: distances.metres.into_iter().map(|metres| metres as f32).collect(),
        arrows: Vec::new(),
    };
    let plane = grid.plane;
    let near = |position: &[f64; 3]| (position[plane.axis] - plane.coordinate).abs() <= limit;
    let positions =
        ensemble.training_positions().into_iter().filter(near).map(|position| plane.project(position)).collect();
    Some((layer, TrainingMap { is_beyond, limit, positions }))
}

/// Writer of the files of a map.
struct MapWriter<'a> {
    grid: PlaneGrid,
    training: Option<TrainingMap>,
    receivers: &'a [Receiver],
    /// Poses of all receivers, world frame.
    poses: Vec<Pose>,
    /// Indices of the mapped receivers.
    mapped: Vec<usize>,
}

impl MapWriter<'_> {
    /// Writes array and image of each layer, and the list `map.csv`, into `folder`.
    fn write(&self, folder: &NewFolder, layers: &[MapLayer]) -> Result<()> {
        let extrapolated = self.training.as_ref().map_or_else(
            || ",".into(),
            |TrainingMap { is_beyond, limit, .. }| {
                format!("{limit:.4},{}", is_beyond.iter().filter(|is_beyond| **is_beyond).count())
            },
        );
        let mut list = HEADER.to_owned();
        let mut taken = BTreeSet::new();
        for layer in layers {
            let receiver = layer.receiver.map(|r| self.receivers[r].name.as_str());
            let name = unique_file_name(layer.name, receiver.filter(|_| self.receivers.len() > 1), &mut taken);
            folder.put(&format!("{name}.npy"), self.encode_npy(&layer.values))?;
            folder.put(&format!("{name}.png"), self.draw_png(layer, receiver))?;
            _ = writeln!(list, "{},{extrapolated}", self.csv_line(layer, &name, receiver.unwrap_or("")));
        }
        folder.put("map.csv", list)
    }

    /// Encodes `values` as NPY, float32 `[rows, columns]`, lowest row first.
    fn encode_npy(&self, values: &[f32]) -> Vec<u8> {
        let mut npy = npy_header(Number::F32, &[self.grid.rows, self.grid.columns]);
        npy.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        npy
    }

    /// Draws a layer as PNG, with its receiver, which is called `receiver`, or with all mapped receivers.
    fn draw_png(&self, layer: &MapLayer, receiver: Option<&str>) -> Vec<u8> {
        let grid = &self.grid;
        let suffix = receiver.map_or_else(String::new, |name| format!(" at {name}"));
        let shown = layer.receiver.map_or_else(|| self.mapped.clone(), |r| vec![r]);
        let heat = Heatmap {
            title: format!("{}{suffix}, {}", layer.words, grid.plane.describe()),
            unit: layer.unit.into(),
            names: grid.plane.axis_names(),
            first: grid.first,
            step: grid.step,
            columns: grid.columns,
            values: &layer.values,
            colours: if layer.name == "azimuth" { Palette::Cyclic } else { Palette::Sequential },
            receivers: shown.iter().map(|&r| grid.plane.project(self.poses[r].position)).collect(),
            arrows: &layer.arrows,
            training: self.training.as_ref(),
        };
        heat.draw().png(WIDTH_MM)
    }

    /// Formats the line of a layer in `map.csv`, without its last two columns.
    fn csv_line(&self, layer: &MapLayer, name: &str, receiver: &str) -> String {
        let PlaneGrid { plane, first, step, columns, rows } = &self.grid;
        let [across, up] = plane.axis_names();
        let finite = || layer.values.iter().copied().filter(|v| v.is_finite());
        let ends = [finite().reduce(f32::min), finite().reduce(f32::max)];
        let [low, high] = ends.map(|end| end.map_or_else(String::new, |v| v.to_string()));
        let quantity = format!("{name}.npy,{name}.png,{},{},{}", layer.words, layer.unit, field(receiver));
        let grid = format!("{across},{},{columns},{up},{},{rows},{step},{}", first[0], first[1], plane.describe());
        format!("{quantity},{grid},{low},{high}")
    }
}

/// Returns a file name that is not in `taken`, apart from case, and adds it there. Only letters, digits, points and
/// dashes of the name of the receiver are kept.
fn unique_file_name(layer: &str, receiver: Option<&str>, taken: &mut BTreeSet<String>) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '_' };
    let suffix = receiver.map(|name| name.chars().take(60).map(plain).collect::<String>());
    let name = suffix.map_or_else(|| layer.to_owned(), |suffix| format!("{layer}-{suffix}"));
    let numbered = (1..).map(|k| if k == 1 { name.clone() } else { format!("{name}-{k}") });
    numbered.into_iter().find(|name| taken.insert(name.to_lowercase())).unwrap_or(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn map_file_names_are_plain_and_unique() {
        let mut taken = BTreeSet::new();
        let mut name = |receiver| unique_file_name("power", receiver, &mut taken);
        let names = [name(Some("../a b")), name(Some("../a/b")), name(None), name(Some(&"x".repeat(500)))];
        assert_eq!(names[..3], ["power-.._a_b", "power-.._a_b-2", "power"].map(str::to_owned));
        assert!(names[3].len() < 80);
    }
}
