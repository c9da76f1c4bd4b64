//! Smaller model files.

use pwrfgs_core::{Error, Query, Result, Task, evenly};
use pwrfgs_experiment::text::grouped;
use pwrfgs_model::compress::{self, Bits};
use pwrfgs_model::{Ensemble, file};

/// Number of training positions at which predictions are compared.
const COMPARED: usize = 200;

/// Result of [`compress()`].
#[derive(Debug)]
pub struct CompressedModel {
    /// Content of the model file.
    pub bytes: Vec<u8>,
    /// Model of this file.
    pub ensemble: Ensemble,
    /// First the sizes of both files, then the mean difference of predictions if the model has training positions; one line each.
    pub notes: Vec<String>,
}

/// Stores a model with 8 or 16 bits per network weight and 16 bits per other number; a residual process stays exact. Omits the
/// calibration of intervals, since it is that of the exact predictions.
///
/// # Errors
/// A number exceeds the range of 16 bits.
pub fn compress(ensemble: &Ensemble, bits: Bits) -> Result<CompressedModel> {
    let before = file::size(ensemble);
    let bytes = compress::to_bytes(ensemble, bits)?;
    let small = file::from_bytes(&bytes).map_err(Error::Config)?;
    let kilobytes = |bytes: usize| grouped((bytes as f64 / 1e3).round() as i64);
    let sizes = format!("whole file {} kB instead of {} kB", kilobytes(bytes.len()), kilobytes(before));
    let notes = std::iter::once(sizes).chain(describe_difference(ensemble, &small)).collect();
    Ok(CompressedModel { bytes, ensemble: small, notes })
}

/// Describes the mean absolute difference of the predictions of two models at up to [`COMPARED`] training positions, over
/// all receivers; `None` for models without training positions.
fn describe_difference(model: &Ensemble, small: &Ensemble) -> Option<String> {
    let stages = &model.members()[0].stages;
    let positions = evenly(&model.training_positions(), COMPARED);
    if positions.is_empty() {
        return None;
    }
    let receivers = 0..stages.receivers.len();
    let queries: Vec<Query<'_>> =
        positions.iter().flat_map(|&tx| receivers.clone().map(move |r| stages.query(tx, r))).collect();
    let [a, b] = [model, small].map(|model| model.prepare().predict_many(&queries));
    let pairs = a.iter().zip(&b).flat_map(|(a, b)| a.pixels.iter().zip(&b.pixels));
    let differences: Vec<f64> = pairs.map(|(a, b)| f64::from((a - b).abs() as f32)).collect();
    let mean = differences.iter().sum::<f64>() / differences.len().max(1) as f64;
    let unit = if stages.task == Task::Power { " dB" } else { "" };
    Some(format!("mean difference of predictions at {} training positions: {mean:.2e}{unit}", positions.len()))
}
