//! Radio maps of a model over a plane, as arrays and images.

mod layers;

use crate::models::{check_positions, select_receivers};
use crate::plane::{MapPlane, PlaneBounds, PlaneGrid};
use clap::Args;
use layers::select_quantities;
pub use layers::{MapLayer, MapQuantity, MapRequest};
use pwrfgs_core::files::NewFolder;
use pwrfgs_core::messages::{join_names, strip_control};
use pwrfgs_core::statistics::sorted;
use pwrfgs_core::{Error, Geodetic, Number, Pose, Query, Receiver, Result};
use pwrfgs_data::npy_header;
use pwrfgs_experiment::{Observer, text::csv_field};
use pwrfgs_model::Ensemble;
use pwrfgs_report::draw::plan::{Heatmap, Palette, TrainingMap};
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::BTreeSet;
use std::fmt::Write as _;

/// Width of an image in print, millimetres.
const WIDTH_MM: f64 = 120.0;
/// Difference of height between positions of one floor and of another, metres.
const FLOOR_GAP_M: f64 = 2.0;
/// Columns of `map.csv`, before those of degrees.
const HEADER: &str = "array,image,quantity,unit,receiver,columns_axis,first_column_m,columns,rows_axis,first_row_m,rows,\
                      step_m,plane,smallest,largest,training_limit_m,extrapolated";

/// Settings of [`map`].
#[derive(Clone, Debug, Args, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MapSettings {
    /// Plane, by its fixed coordinate in metres: z=1.2, x=0.5 or y=-3
    #[arg(long, value_name = "AXIS=M")]
    pub plane: String,
    /// Grid spacing in metres [default: 0.1, or more for a large site]
    #[arg(long, value_name = "M")]
    #[serde(default)]
    pub step: Option<f64>,
    /// Extent of the two free coordinates in metres, or of latitude and longitude in degrees
    #[arg(long, value_name = "X0,X1,Y0,Y1", allow_hyphen_values = true)]
    #[serde(default)]
    pub bounds: Option<String>,
    /// Map only this receiver (name in the data set); repeatable
    #[arg(long, value_name = "NAME")]
    #[serde(default)]
    pub receiver: Vec<String>,
    /// Quantity: power, level, mean or direction; repeatable.
    #[arg(
        long,
        value_enum,
        value_name = "QUANTITY",
        hide_possible_values = true,
        help = "Quantity: power, level, mean or direction; repeatable\n[default: power, or direction and level for spectra]"
    )]
    #[serde(default)]
    pub of: Vec<MapQuantity>,
}

/// Maps of a model over a plane.
#[derive(Debug)]
pub struct RadioMap {
    /// Positions of all maps.
    pub grid: PlaneGrid,
    /// Maps of each receiver, then of all receivers together, then the distance to the training positions.
    pub layers: Vec<MapLayer>,
    /// Extrapolations, and the training positions near the plane; `None` if the model has no training positions.
    pub training: Option<TrainingMap>,
    /// Receivers of the model.
    pub receivers: Vec<Receiver>,
    /// Poses of all receivers, world frame.
    poses: Vec<Pose>,
    /// Indices of the mapped receivers.
    mapped: Vec<usize>,
    /// Latitude and longitude of the frame.
    geodetic: Option<Geodetic>,
}

/// Maps the predictions of a model over a plane; `observer` receives the progress, descriptions of default bounds and spacing,
/// and a warning of estimated receiver positions.
///
/// # Errors
/// Invalid settings, a model whose input is not a position, or no `bounds` for a model that suggests none.
pub fn map(ensemble: &Ensemble, settings: &MapSettings, observer: &mut dyn Observer) -> Result<RadioMap> {
    let plane = MapPlane::parse(&settings.plane)?;
    let names = plane.axis_names();
    let bounds = settings.bounds.as_ref().map(|text| PlaneBounds::parse("--bounds", text, names)).transpose()?;
    check_positions(ensemble)?;
    let model = ensemble.prepare();
    let setup = &ensemble.members()[0].stages.setup;
    let quantities = select_quantities(setup, &settings.of)?;
    let mapped = select_receivers(model.receivers(), &settings.receiver)?;
    warn_of_estimated(model.receivers(), &mapped, observer);
    let origin = ensemble.members()[0].stages.origin;
    let poses: Vec<Pose> = model.receivers().iter().map(|receiver| origin.world_pose(receiver.pose)).collect();
    let bounds = bounds.map(|bounds| bounds.in_metres(setup.geodetic.filter(|_| names == ["x", "y"])));
    let receivers = mapped.iter().map(|&r| plane.project(poses[r].position)).collect();
    let grid = choose_grid(ensemble, plane, (bounds, settings.step), receivers, observer)?;
    let (predict, total) = (|queries: &[Query<'_>]| model.predict_many(queries), grid.position_count());
    let request = MapRequest { setup, grid: &grid, receivers: &mapped, quantities: &quantities };
    let mut layers = request.layers(&predict, |done| observer.on_stage("mapping", done, total));
    let (layer, training) = training_layer(ensemble, &grid).unzip();
    layers.extend(layer);
    let receivers = model.receivers().to_vec();
    Ok(RadioMap { grid, layers, training, receivers, poses, mapped, geodetic: setup.geodetic })
}

/// Maximum number of names in a warning.
const LISTED: usize = 8;

/// Warns of powers near mapped receivers whose positions are estimated.
fn warn_of_estimated(receivers: &[Receiver], mapped: &[usize], observer: &mut dyn Observer) {
    let estimated = mapped.iter().map(|&r| &receivers[r]).filter(|receiver| receiver.is_estimated);
    let names: Vec<String> = estimated.map(|receiver| strip_control(&receiver.name)).collect();
    if !names.is_empty() {
        let names = join_names(names.iter(), LISTED);
        observer.on_warning(&format!(
            "estimated receiver positions ({names}): powers within some metres of them are unreliable; import the data with \
             `--receivers FILE` if they are known"
        ));
    }
}

/// Returns the grid with these bounds and step, each by default chosen for the model and its `receivers` (metres in the plane).
/// `observer` receives a description of defaults.
///
/// # Errors
/// An invalid step, too many positions, or a model that suggests no bounds.
fn choose_grid(
    ensemble: &Ensemble,
    plane: MapPlane,
    (bounds, step): (Option<PlaneBounds>, Option<f64>),
    receivers: Vec<[f64; 2]>,
    observer: &mut dyn Observer,
) -> Result<PlaneGrid> {
    let count = receivers.len();
    let (bounds, source) = match bounds {
        Some(bounds) => (bounds, None),
        None => default_bounds(ensemble, plane, receivers).map(|(bounds, source)| (bounds, Some(source)))?,
    };
    let default_step = bounds.default_step(count);
    if step.is_none() && default_step > PlaneBounds::STEP {
        let advice = "chosen for the size of the map; set --step to change this";
        observer.on_message(&format!("grid spacing {default_step} m, {advice}"));
    }
    let step = step.unwrap_or(default_step);
    let Some(source) = source else { return PlaneGrid::new(plane, bounds, step, count) };
    let bounds = bounds.rounded_outwards(step);
    observer.on_message(&describe_bounds(plane, bounds, source));
    PlaneGrid::new(plane, bounds, step, count)
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
        return Ok((PlaneBounds::around(Vec::new(), &points), "all training positions and mapped receivers"));
    }
    let origin = model.members()[0].stages.origin;
    let means = model.means_from(origin).into_iter().map(|mean| plane.project(origin.world(mean)));
    let means: Vec<[f64; 2]> = means.collect();
    if means.is_empty() {
        let problem = "--bounds: required for a model without training positions and Gaussians";
        return Err(Error::Config(problem.into()));
    }
    Ok((PlaneBounds::around(means, &receivers), "central 90 % of the Gaussians, and mapped receivers"))
}

/// Describes the default bounds; `source` names what they contain.
fn describe_bounds(plane: MapPlane, PlaneBounds([across, up]): PlaneBounds, source: &str) -> String {
    let ([a, b], rounded) = (plane.axis_names(), |v: f64| (v * 100.0).round() / 100.0);
    format!(
        "{a} from {} to {} m, {b} from {} to {} m ({source}); set --bounds to change this",
        rounded(across[0]),
        rounded(across[1]),
        rounded(up[0]),
        rounded(up[1])
    )
}

/// Computes the distances from the grid to the nearest training position as a layer. Also returns which positions are
/// extrapolations, and the training positions near the plane. `None` for models without training positions.
pub fn training_layer(ensemble: &Ensemble, grid: &PlaneGrid) -> Option<(MapLayer, TrainingMap)> {
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
    let (plane, training) = (grid.plane, ensemble.training_positions());
    let [low, high] = shown_floor(plane, &training);
    let near = |position: &&[f64; 3]| {
        let at = position[plane.axis];
        (at - plane.coordinate).abs() <= limit && (low..=high).contains(&at)
    };
    let positions = training.iter().filter(near).map(|position| plane.project(*position)).collect();
    Some((layer, TrainingMap { is_beyond, limit, positions }))
}

/// Returns the lowest and highest of the `positions` on the floor that a horizontal `plane` shows, metres. Gaps in height of
/// [`FLOOR_GAP_M`] separate floors; the nearest to the plane is shown. Unlimited for other planes, or without positions.
fn shown_floor(plane: MapPlane, positions: &[[f64; 3]]) -> [f64; 2] {
    let heights = sorted(positions.iter().map(|position| position[2]));
    let floors = heights.chunk_by(|a, b| b - a < FLOOR_GAP_M).map(|floor| [floor[0], floor[floor.len() - 1]]);
    let distance = |[low, high]: &[f64; 2]| (low - plane.coordinate).max(plane.coordinate - high).max(0.0);
    let shown = floors.filter(|_| plane.axis == 2).min_by(|a, b| distance(a).total_cmp(&distance(b)));
    shown.unwrap_or([f64::NEG_INFINITY, f64::INFINITY])
}

impl RadioMap {
    /// Writes array and image of each layer, and the list `map.csv`, into `folder`.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn write(&self, folder: &NewFolder) -> Result<()> {
        let extrapolated = self.training.as_ref().map_or_else(
            || ",".into(),
            |TrainingMap { is_beyond, limit, .. }| {
                format!("{limit:.4},{}", is_beyond.iter().filter(|is_beyond| **is_beyond).count())
            },
        );
        let mut list = HEADER.to_owned();
        // Degrees of a horizontal map, at its first and last position.
        let geodetic = self.geodetic.filter(|_| self.grid.plane.axis_names() == ["x", "y"]);
        list += if geodetic.is_some() { ",first_latitude,first_longitude,last_latitude,last_longitude" } else { "" };
        list.push('\n');
        let corner = |k: usize| geodetic.map(|geodetic| geodetic.cells(self.grid.position(k)));
        let degrees = [0, self.grid.position_count() - 1].map(corner).into_iter().flatten().collect::<String>();
        for (layer, name) in self.layers.iter().zip(self.names()) {
            let receiver = layer.receiver.map(|r| self.receivers[r].name.as_str());
            folder.put(&format!("{name}.npy"), self.encode_npy(&layer.values))?;
            folder.put(&format!("{name}.png"), self.draw_png(layer, receiver))?;
            _ = writeln!(list, "{},{extrapolated}{degrees}", self.csv_line(layer, &name, receiver.unwrap_or("")));
        }
        folder.put("map.csv", list)
    }

    /// Returns a unique name for each layer and its files: the quantity and, if the model has several receivers, the receiver.
    pub fn names(&self) -> Vec<String> {
        let mut taken = BTreeSet::new();
        let receiver = |layer: &MapLayer| layer.receiver.filter(|_| self.receivers.len() > 1);
        let name = |layer: &MapLayer| {
            unique_file_name(layer.name, receiver(layer).map(|r| self.receivers[r].name.as_str()), &mut taken)
        };
        self.layers.iter().map(name).collect()
    }

    /// Returns the number of values that are not finite.
    pub fn count_missing(&self) -> usize {
        self.layers.iter().flat_map(|layer| &layer.values).filter(|v| !v.is_finite()).count()
    }

    /// Encodes `values` as NPY, float32 `[rows, columns]`, lowest row first.
    fn encode_npy(&self, values: &[f32]) -> Vec<u8> {
        let mut npy = npy_header(Number::F32, &[self.grid.rows, self.grid.columns]);
        npy.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        npy
    }

    /// Draws a layer as PNG with its receiver, of name `receiver`, or with all mapped receivers. Receivers with an estimated
    /// position are omitted; the title counts them.
    fn draw_png(&self, layer: &MapLayer, receiver: Option<&str>) -> Vec<u8> {
        let grid = &self.grid;
        let suffix = receiver.map_or_else(String::new, |name| format!(" at {name}"));
        let shown = layer.receiver.map_or_else(|| self.mapped.clone(), |r| vec![r]);
        let (estimated, measured): (Vec<usize>, Vec<usize>) =
            shown.into_iter().partition(|r| self.receivers[*r].is_estimated);
        let doubt = match estimated.len() {
            0 => String::new(),
            1 => " (1 estimated position)".into(),
            count => format!(" ({count} estimated positions)"),
        };
        let heat = Heatmap {
            title: format!("{}{suffix}{doubt}, {}", layer.words, grid.plane.describe()),
            unit: layer.unit.into(),
            names: grid.plane.axis_names(),
            first: grid.first,
            step: grid.step,
            columns: grid.columns,
            values: &layer.values,
            colours: if layer.name == "azimuth" { Palette::Cyclic } else { Palette::Sequential },
            receivers: measured.into_iter().map(|r| grid.plane.project(self.poses[r].position)).collect(),
            arrows: &layer.arrows,
            training: self.training.as_ref(),
        };
        heat.draw().png(WIDTH_MM)
    }

    /// Formats the line of a layer in `map.csv` up to `largest`, in the order of [`HEADER`].
    fn csv_line(&self, layer: &MapLayer, name: &str, receiver: &str) -> String {
        let PlaneGrid { plane, first, step, columns, rows } = &self.grid;
        let [across, up] = plane.axis_names();
        let finite = || layer.values.iter().copied().filter(|v| v.is_finite());
        let ends = [finite().reduce(f32::min), finite().reduce(f32::max)];
        let [low, high] = ends.map(|end| end.map_or_else(String::new, |v| v.to_string()));
        let quantity = format!("{name}.npy,{name}.png,{},{},{}", layer.words, layer.unit, csv_field(receiver));
        let grid = format!("{across},{},{columns},{up},{},{rows},{step},{}", first[0], first[1], plane.describe());
        format!("{quantity},{grid},{low},{high}")
    }
}

/// Returns a file name without extension that is not in `taken`, apart from case, and adds it there in lower case. Of the
/// name of the receiver, 60 characters are kept; other signs than `-`, `_` and `.` become `_`.
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
    fn shown_floor_ends_at_gaps() {
        let positions = [1.0, 1.2, 4.5, 4.6, 8.0].map(|z| [0.0, 0.0, z]);
        let floor = |axis, coordinate| shown_floor(MapPlane { axis, coordinate }, &positions);
        assert_eq!(
            (floor(2, 1.1), floor(2, 4.0), floor(2, 6.0), floor(2, 90.0)),
            ([1.0, 1.2], [4.5, 4.6], [4.5, 4.6], [8.0, 8.0])
        );
        assert_eq!(floor(0, 4.5), [f64::NEG_INFINITY, f64::INFINITY]);
        assert_eq!(shown_floor(MapPlane { axis: 2, coordinate: 0.0 }, &[]), [f64::NEG_INFINITY, f64::INFINITY]);
    }

    #[test]
    fn map_file_names_are_plain_and_unique() {
        let mut taken = BTreeSet::new();
        let mut name = |receiver| unique_file_name("power", receiver, &mut taken);
        let names = [name(Some("../a b")), name(Some("../a/b")), name(None), name(Some(&"x".repeat(500)))];
        assert_eq!(names[..3], ["power-.._a_b", "power-.._a_b-2", "power"].map(str::to_owned));
        assert!(names[3].len() < 80);
    }
}
