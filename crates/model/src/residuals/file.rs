//! Residual processes in the model file: settings in the note, positions and residuals in tensors.

use super::{CoarseGrid, ResidualProcess, ResidualValues, Residuals, ShareGain};
use crate::tensors::Tensors;
use pwrfgs_core::kriging::{Correlation, CorrelationKind, PathLoss, ProcessFit, ResidualTrend};
use pwrfgs_core::plugin::Check as _;
use pwrfgs_core::{MAX_COORDINATE_M, MeasurementSetup, Real, Receiver, Task};
use serde::{Deserialize, Serialize};

/// Prefix of the names of the tensors.
pub(crate) const RESIDUALS: &str = "residuals.";
/// Names of the tensors.
const PLACES: &str = "residuals.places";
const VALUES: &str = "residuals.values";
const UNITS: &str = "residuals.units";

/// Smallest length scale (metres) and noise: distances relative to it stay finite.
const LEAST: f64 = 1e-12;

/// Largest level (dBm) and slope (dB per decade) of a path-loss model.
const MOST_DB: f64 = 1e4;

/// Settings of residual processes.
#[derive(Serialize, Deserialize)]
pub(crate) struct ResidualsNote {
    stride: usize,
    neighbours: usize,
    /// Processes in the order of the receivers.
    receivers: Vec<Option<ProcessNote>>,
    /// Gain of the best share of the model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    gain: Option<ShareGain>,
}

#[derive(Serialize, Deserialize)]
struct ProcessNote {
    /// Number of known links: rows of the tensors.
    links: usize,
    share: f64,
    variance: f64,
    correlation: CorrelationKind,
    /// Length scales of x, y and z, metres.
    scales_m: [f64; 3],
    /// Noise variance, relative to the process variance.
    noise: f64,
    /// For received powers, the path-loss model: dBm at 1 m, and dB per decade of distance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    path_loss: Option<[f64; 2]>,
}

impl ResidualsNote {
    /// Returns the settings of residual processes.
    pub(crate) fn of(residuals: &Residuals) -> Self {
        let process = |process: &ResidualProcess| {
            let ProcessFit { trend, variance, correlation } = process.fit;
            let Correlation { kind, scales: [x, y, z, _], noise } = correlation;
            let path_loss = trend.path_loss.map(|(model, _)| [model.level, model.slope]);
            let (links, share) = (process.len(), trend.share);
            ProcessNote { links, share, variance, correlation: kind, scales_m: [x, y, z], noise, path_loss }
        };
        Self {
            stride: residuals.grid.stride,
            neighbours: residuals.neighbours,
            receivers: residuals.processes.iter().map(|fitted| fitted.as_ref().map(process)).collect(),
            gain: residuals.gain,
        }
    }

    /// Takes the residual processes of a model for `setup` out of its file.
    ///
    /// # Errors
    /// The settings do not fit `setup`, a value is out of range, or a tensor is missing or has another shape or type.
    pub(crate) fn take(self, file: &mut Tensors, setup: &MeasurementSetup) -> Result<Residuals, String> {
        let links = self.count_links(setup)?;
        let Self { stride, neighbours, receivers, gain } = self;
        let grid = CoarseGrid::new(&setup.plane, stride);
        let link_values = grid.len();
        let places = file.take(PLACES, &[links, 3])?;
        if places.iter().any(|v| f64::from(v.abs() as f32) > MAX_COORDINATE_M) {
            return Err(format!("tensor `{PLACES}` holds a position beyond {MAX_COORDINATE_M:e} m"));
        }
        let places: Vec<[Real; 3]> = places.as_chunks().0.to_vec();
        let values = if stride == 1 {
            ResidualValues::Exact(file.take(VALUES, &[links, link_values])?)
        } else {
            ResidualValues::Rounded(file.take_i8(VALUES, &[links, link_values])?, file.take(UNITS, &[links])?)
        };
        let mut first = 0;
        let mut process = |(note, receiver): (Option<ProcessNote>, &Receiver)| -> Result<_, String> {
            let Some(note) = note else { return Ok(None) };
            let rows = first..first + note.links;
            first = rows.end;
            let (fit, values) = (note.process_fit(setup.task, receiver)?, values.rows(rows.clone(), link_values));
            Ok(Some(ResidualProcess::new(fit, places[rows].to_vec(), values)))
        };
        let processes = receivers.into_iter().zip(&setup.receivers).map(&mut process).collect::<Result<_, _>>()?;
        Ok(Residuals { grid, neighbours, processes, gain })
    }

    /// Checks the settings against `setup`, and returns the number of known links of all processes.
    fn count_links(&self, setup: &MeasurementSetup) -> Result<usize, String> {
        let Self { stride, neighbours, ref receivers, .. } = *self;
        super::Kriged { stride, neighbours, folds: false }.check().map_err(|why| format!("residuals: {why}"))?;
        if setup.task.stride(stride) != stride {
            return Err(format!("residuals: a stride of {stride} for {}, expected 1", setup.task.plural));
        }
        if setup.moving.is_receiver() {
            return Err("residuals of a moving receiver, which are not supported".into());
        }
        if receivers.len() != setup.receivers.len() {
            let (have, need) = (receivers.len(), setup.receivers.len());
            return Err(format!("residuals of {have} receivers for a model of {need}"));
        }
        let mut counts = receivers.iter().flatten().map(|note| note.links);
        let links = counts.try_fold(0_usize, |sum, n| sum.checked_add(n).filter(|_| n > 0));
        links.ok_or("residuals: each process needs a link or more".into())
    }
}

impl ProcessNote {
    /// Returns the trend, variance and correlation at a `receiver`.
    ///
    /// # Errors
    /// A value is out of range; the message states it.
    fn process_fit(&self, task: Task, receiver: &Receiver) -> Result<ProcessFit, String> {
        let Self { share, variance, correlation, scales_m, noise, path_loss, .. } = *self;
        let is_scale = |v: &f64| v.is_finite() && *v >= LEAST;
        if !((0.0..=1.0).contains(&share) && variance.is_finite() && variance >= 0.0) {
            return Err(format!("residuals: a share of {share} and a variance of {variance}"));
        }
        if !(scales_m.iter().all(is_scale) && is_scale(&noise)) {
            return Err(format!(
                "residuals: length scales of {scales_m:?} m and noise of {noise}, expected at least {LEAST:e}"
            ));
        }
        if path_loss.is_some_and(|model| !task.has_path_loss || !model.iter().all(|v| v.abs() <= MOST_DB)) {
            return Err(format!("residuals: a path loss of {path_loss:?} for {}", task.plural));
        }
        let [x, y, z] = scales_m;
        let path_loss = path_loss.map(|[level, slope]| (PathLoss { level, slope }, receiver.pose.position));
        // Time has no effect: its scale is infinite.
        let correlation = Correlation { kind: correlation, scales: [x, y, z, f64::INFINITY], noise };
        Ok(ProcessFit { trend: ResidualTrend { share, path_loss }, variance, correlation })
    }
}

impl Residuals {
    /// Adds the positions and residuals of all processes to the file.
    pub(crate) fn put(&self, file: &mut Tensors) {
        let (mut places, mut exact, mut short, mut units) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for process in self.processes.iter().flatten() {
            places.extend_from_slice(process.places.as_flattened());
            match &process.values {
                ResidualValues::Exact(values) => exact.extend_from_slice(values),
                ResidualValues::Rounded(values, link_units) => {
                    short.extend_from_slice(values);
                    units.extend_from_slice(link_units);
                }
            }
        }
        let (links, link_values) = (places.len() / 3, self.grid.len());
        file.put(PLACES, vec![links, 3], places);
        if self.grid.stride == 1 {
            file.put(VALUES, vec![links, link_values], exact);
        } else {
            file.put_i8(VALUES, vec![links, link_values], short);
            file.put(UNITS, vec![links], units);
        }
    }
}
