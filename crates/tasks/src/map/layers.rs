//! Quantities of a map and their arrays.

use crate::plane::PlaneGrid;
use clap::ValueEnum;
use pwrfgs_core::{Error, Image, MeasurementSetup, Query, Real, Result, Task, Vec3};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Deserialize;

/// Number of queries per call.
const CALL: usize = 64;
/// Number of queries per step of the progress bar.
const STEP: usize = 2_048;

/// Quantity of a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum MapQuantity {
    /// Received power in dBm, or the mean power of a channel's gains in dB
    Power,
    /// The strongest pixel of a spectrum
    Level,
    /// The mean pixel of a spectrum
    Mean,
    /// Azimuth and elevation of the strongest pixel of a spectrum
    Direction,
}

/// Array of a map.
#[derive(Clone, Debug)]
pub struct MapLayer {
    /// Start of the names of its files.
    pub name: &'static str,
    /// Quantity in words.
    pub words: &'static str,
    /// Unit of the values.
    pub unit: &'static str,
    /// Index of the receiver; `None`: the strongest of the mapped receivers.
    pub receiver: Option<usize>,
    /// Values, row by row, lowest row first.
    pub values: Vec<f32>,
    /// Direction per value, within the plane; only for azimuths.
    pub arrows: Vec<[f32; 2]>,
}

/// Returns the quantities to map: those `requested`, or the default of the model. A requested quantity that the model
/// does not have is an error.
pub(super) fn select_quantities(setup: &MeasurementSetup, requested: &[MapQuantity]) -> Result<Vec<MapQuantity>> {
    let (task, has_angles) = (setup.task, setup.plane.angles.is_some());
    let (available, names): (&[MapQuantity], _) = match (task.has_pixels, has_angles) {
        (true, true) => (&[MapQuantity::Direction, MapQuantity::Level, MapQuantity::Mean], "direction, level or mean"),
        (true, false) => (&[MapQuantity::Level, MapQuantity::Mean], "level or mean (its pixels have no angles)"),
        (false, _) => (&[MapQuantity::Power], "power"),
    };
    if let Some(wrong) = requested.iter().find(|quantity| !available.contains(quantity)) {
        let name = wrong.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned());
        return Err(Error::Config(format!("--of {name}: not available for a model of {}; use {names}", task.plural)));
    }
    // All but the mean.
    let default = if task.has_pixels { &available[..available.len() - 1] } else { available };
    Ok(available
        .iter()
        .copied()
        .filter(|quantity| if requested.is_empty() { default.contains(quantity) } else { requested.contains(quantity) })
        .collect())
}

/// Summary of one observation: level or power, mean, and strongest pixel.
#[derive(Clone, Copy)]
struct Summary {
    level: f64,
    mean: f64,
    strongest: usize,
}

impl Summary {
    /// Summarises the predicted observation `image` of `task`.
    fn of(task: Task, image: &Image) -> Self {
        let strongest = image.argmax();
        let count = image.pixels.len().max(1) as f64;
        let mean = image.pixels.iter().map(|v| *v as f64).sum::<f64>() / count;
        Self { level: task.level(image), mean, strongest }
    }
}

/// Positions, receivers and quantities of a map.
#[derive(Clone, Copy, Debug)]
pub struct MapRequest<'a> {
    /// Setup of the model.
    pub setup: &'a MeasurementSetup,
    /// Positions of the transmitter.
    pub grid: &'a PlaneGrid,
    /// Indices of the receivers.
    pub receivers: &'a [usize],
    /// Quantities per receiver.
    pub quantities: &'a [MapQuantity],
}

impl MapRequest<'_> {
    /// Computes all arrays of the map from the predictions of `predict_many`, one image per query in their order: those of each
    /// receiver, then, for powers at several receivers, the strongest power; `progress` receives the number of finished
    /// positions.
    pub fn layers(
        &self,
        predict_many: &(dyn Fn(&[Query<'_>]) -> Vec<Image> + Sync),
        mut progress: impl FnMut(usize),
    ) -> Vec<MapLayer> {
        let Self { setup, grid, receivers, quantities } = *self;
        let mut layers: Vec<MapLayer> = receivers.iter().flat_map(|&r| empty_layers(setup, r, quantities)).collect();
        let per_receiver = layers.len() / receivers.len().max(1);
        let positions: Vec<usize> = (0..grid.position_count()).collect();
        for chunk in positions.chunks((STEP / receivers.len().max(1)).max(1)) {
            progress(chunk[0]);
            let queries: Vec<Query<'static>> =
                chunk.iter().flat_map(|&k| receivers.iter().map(move |&r| setup.query(grid.position(k), r))).collect();
            let images = queries.par_chunks(CALL).flat_map_iter(predict_many);
            let summaries: Vec<Summary> = images.map(|image| Summary::of(setup.task, &image)).collect();
            for (k, summary) in summaries.into_iter().enumerate() {
                let slot = k % receivers.len();
                self.append_values(receivers[slot], summary, &mut layers[slot * per_receiver..][..per_receiver]);
            }
        }
        layers.extend(strongest_layer(setup.task, &layers, receivers.len()));
        layers
    }

    /// Appends the values at the next position to the arrays of a receiver, by their names in [`empty_layers`].
    fn append_values(&self, receiver: usize, summary: Summary, layers: &mut [MapLayer]) {
        let Self { setup, grid, .. } = *self;
        let plane = &setup.plane;
        let (column, row) = ((summary.strongest % plane.width) as Real, (summary.strongest / plane.width) as Real);
        for layer in layers {
            let angles = || plane.azimuth_elevation_deg(column, row);
            let value = match layer.name {
                "mean" => summary.mean,
                "azimuth" => angles().map_or(f64::NAN, |(azimuth, _)| f64::from(azimuth as f32)),
                "elevation" => angles().map_or(f64::NAN, |(_, elevation)| f64::from(elevation as f32)),
                _ => summary.level,
            };
            layer.values.push(value as f32);
            if layer.name == "azimuth" {
                let turn = setup.receivers[receiver].pose.world_from_receiver();
                let from = plane.direction(column, row).map(|direction| turn * Vec3::from_array(direction));
                let projected = grid.plane.project(from.unwrap_or(Vec3::ZERO).to_array().map(|v| v as f64));
                layer.arrows.push(projected.map(|v| v as f32));
            }
        }
    }
}

/// Creates the arrays of a receiver without values, one per quantity; a direction has two.
fn empty_layers(setup: &MeasurementSetup, receiver: usize, quantities: &[MapQuantity]) -> Vec<MapLayer> {
    let layer = |(name, words, unit)| MapLayer {
        name,
        words,
        unit,
        receiver: Some(receiver),
        values: Vec::new(),
        arrows: Vec::new(),
    };
    let [level, unit] = setup.task.level_name_at(&setup.receivers);
    let names = |quantity: &MapQuantity| match quantity {
        MapQuantity::Power => vec![("power", level, unit)],
        MapQuantity::Level => vec![("level", level, unit)],
        MapQuantity::Mean => vec![("mean", "mean level of the spectrum", "")],
        MapQuantity::Direction => vec![
            ("azimuth", "azimuth of the strongest direction", "degrees"),
            ("elevation", "elevation of the strongest direction", "degrees"),
        ],
    };
    quantities.iter().flat_map(names).map(layer).collect()
}

/// Computes the largest power of all mapped receivers at each position, in the unit of `layers`, one per receiver. `None` for
/// a single receiver or other tasks.
fn strongest_layer(task: Task, layers: &[MapLayer], receivers: usize) -> Option<MapLayer> {
    let first = layers.first().filter(|_| task.is_scalar && receivers > 1)?;
    let largest = |k: usize| layers.iter().map(|layer| layer.values[k]).fold(f32::NAN, f32::max);
    let values = (0..first.values.len()).map(largest).collect();
    Some(MapLayer {
        name: "strongest",
        words: if first.unit == "dB" {
            "relative power at the strongest receiver"
        } else {
            "power at the strongest receiver"
        },
        receiver: None,
        values,
        ..first.clone()
    })
}
