//! `Residuals`: a Gaussian process over the transmitter position that predicts the residuals of a model.
//!
//! The prediction is y(x) = b f(x) + Σ wᵢ (yᵢ − b f(xᵢ)): the prediction f of the model times a share b, plus kriging of
//! the residuals of the nearest known observations (regression kriging: Hengl, Heuvelink and Rossiter, Computers and
//! Geosciences 33, 2007). The weights w add up to 1. For received powers, (1 − b) times a path-loss model is added to
//! b f(x), and the weights are those of a process with mean zero: far from all known links, they vanish.
//!
//! With b = 0, the process is the Kriging baseline. Residuals of a model at positions that it trained on are too small. Whether
//! a share is better is therefore decided by the errors at links that a model did not train on, each predicted from the
//! residuals of the same model at other links (`residual_fit.rs`).

mod file;
mod grid;
mod kriged;
#[cfg(test)]
mod tests;

pub(crate) use file::{RESIDUALS, ResidualsNote};
pub(crate) use grid::CoarseGrid;
pub use kriged::Kriged;

use crate::tensors::quantise;
use pwrfgs_core::kriging::{LocalKriging, Place, ProcessFit, spatial_place};
use pwrfgs_core::{Image, Origin, Query, Real, Task, statistics};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Residual processes of a model, one per receiver.
#[derive(Clone, Debug)]
pub struct Residuals {
    pub(crate) grid: CoarseGrid,
    /// Number of known links per prediction.
    pub(crate) neighbours: usize,
    /// Processes in the order of the receivers; `None` for a receiver that the model predicts alone.
    pub(crate) processes: Vec<Option<ResidualProcess>>,
    /// Gain of the best share above 0; `None` in files without it.
    pub(crate) gain: Option<ShareGain>,
}

/// Reduction of the mean absolute error of held-out blocks by the best share of the model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ShareGain {
    /// Mean over the blocks, in the unit of the observations; negative if the model raises the error.
    pub mean: f64,
    /// Standard error of the mean over the blocks.
    pub standard_error: f64,
    /// Number of blocks.
    pub blocks: usize,
}

impl ShareGain {
    /// Computes mean and standard error of the gains of blocks; the error of a single block is 0.
    pub(crate) fn of(gains: &[f64]) -> Self {
        let (blocks, mean) = (gains.len(), statistics::mean(gains.iter().copied()));
        let squares = gains.iter().map(|gain| (gain - mean).powi(2)).sum::<f64>();
        Self { mean, standard_error: (squares / (blocks * blocks.saturating_sub(1)).max(1) as f64).sqrt(), blocks }
    }
}

/// Residual process at one receiver.
#[derive(Clone, Debug)]
pub struct ResidualProcess {
    /// Trend, variance and correlation.
    pub fit: ProcessFit,
    /// Positions `[n,3]` of the known links, metres from the origin of the model.
    pub(crate) places: Vec<[Real; 3]>,
    pub(crate) values: ResidualValues,
    kriging: LocalKriging,
}

/// Residuals `[n, values]` on the coarse grid.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum ResidualValues {
    /// Exact numbers.
    Exact(Vec<Real>),
    /// Numbers rounded to 8 bits, from -127 to 127, and the unit of each link.
    Rounded(Vec<i8>, Vec<Real>),
}

impl ResidualValues {
    /// Appends residuals `[n, link_values]`, rounded to 8 bits if the others are.
    pub(crate) fn extend(&mut self, residuals: &[Real], link_values: usize) {
        match self {
            Self::Exact(values) => values.extend_from_slice(residuals),
            Self::Rounded(values, units) => {
                let (new_values, new_units) = quantise(residuals, link_values);
                values.extend(new_values);
                units.extend(new_units);
            }
        }
    }

    /// Creates residuals of no links, exact or rounded as these.
    pub(crate) fn empty_like(&self) -> Self {
        match self {
            Self::Exact(_) => Self::Exact(Vec::new()),
            Self::Rounded(..) => Self::Rounded(Vec::new(), Vec::new()),
        }
    }

    /// Returns the residuals of a range of links.
    fn rows(&self, links: Range<usize>, link_values: usize) -> Self {
        let numbers = links.start * link_values..links.end * link_values;
        match self {
            Self::Exact(values) => Self::Exact(values[numbers].to_vec()),
            Self::Rounded(values, units) => Self::Rounded(values[numbers].to_vec(), units[links].to_vec()),
        }
    }

    /// Adds `weight` times the residuals of link `i` to `sum`.
    fn add_weighted(&self, i: usize, weight: f64, sum: &mut [f64]) {
        let n = sum.len();
        match self {
            Self::Exact(values) => {
                sum.iter_mut().zip(&values[i * n..][..n]).for_each(|(sum, v)| *sum += weight * *v as f64);
            }
            Self::Rounded(values, units) => {
                let weight = weight * units[i] as f64;
                sum.iter_mut().zip(&values[i * n..][..n]).for_each(|(sum, v)| *sum += weight * f64::from(*v));
            }
        }
    }

    /// Returns Σ d·residual of link `i`.
    fn dot(&self, i: usize, d: &[Real]) -> f64 {
        let (n, wide) = (d.len(), |v: Real, d: &Real| v as f64 * *d as f64);
        match self {
            Self::Exact(values) => values[i * n..][..n].iter().zip(d).map(|(v, d)| wide(*v, d)).sum(),
            Self::Rounded(values, units) => {
                let sum: f64 = values[i * n..][..n].iter().zip(d).map(|(v, d)| wide(Real::from(*v), d)).sum();
                units[i] as f64 * sum
            }
        }
    }
}

impl ResidualProcess {
    /// Creates the process from residuals at known links; their mean is zero with a path-loss model, otherwise unknown.
    pub(crate) fn new(fit: ProcessFit, places: Vec<[Real; 3]>, values: ResidualValues) -> Self {
        let kriging = fit.process(places.iter().map(|&at| place(at)));
        Self { fit, places, values, kriging }
    }

    /// Returns the number of known links.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// Returns whether there is no known link.
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }
}

/// Returns the place for kriging of a position in metres from the origin.
pub(crate) fn place(at: [Real; 3]) -> Place {
    spatial_place(at.map(|v| v as f64))
}

impl Residuals {
    /// Returns the processes in the order of the receivers; `None` for a receiver that the model predicts alone.
    pub fn processes(&self) -> &[Option<ResidualProcess>] {
        &self.processes
    }

    /// Returns the distance between stored pixels, in pixels; 1 for exact residuals.
    pub fn stride(&self) -> usize {
        self.grid.stride
    }

    /// Returns the share of the prediction of the model; `None` without a process.
    pub fn share(&self) -> Option<f64> {
        self.processes.iter().flatten().map(|process| process.fit.trend.share).next()
    }

    /// Describes the share for observations of `task`: `share 0.5: the network lowers the error by 0.15 dB [..]`. `None`
    /// without a process.
    pub fn describe_share(&self, task: Task) -> Option<String> {
        let share = self.share()?;
        let Some(ShareGain { mean, standard_error, blocks }) = self.gain else {
            return Some(format!("share {share}: the part of the network in the prediction"));
        };
        if share == 0.0 {
            let pixels = match self.stride() {
                1 => String::new(),
                stride => format!(" at one pixel per {stride} by {stride}, interpolated"),
            };
            return Some(format!("share 0: the network adds nothing here; this is Kriging{pixels}"));
        }
        let (digits, unit) = if task.has_path_loss { (2, " dB") } else { (4, "") };
        // A 95 % interval of the normal distribution.
        let [low, high] = [-1.96, 1.96].map(|z| mean + z * standard_error);
        Some(format!(
            "share {share}: the network lowers the error by {mean:.digits$}{unit} [{low:.digits$}, {high:.digits$}] \
             ({blocks} held-out blocks)"
        ))
    }

    /// Returns the process of a receiver; `None` if the model predicts alone.
    pub(crate) fn process(&self, receiver: usize) -> Option<&ResidualProcess> {
        self.processes.get(receiver)?.as_ref()
    }

    /// Replaces the prediction `image` of the model by its trend plus the expected residual, from the nearest known links.
    /// Unchanged at a receiver without a process.
    pub(crate) fn correct(&self, image: &mut Image, query: Query<'_>, origin: Origin) {
        let Some(process) = self.process(query.receiver) else { return };
        let (at, trend) = (place(origin.local(query.position())), &process.fit.trend);
        let add = |i: usize, weight: f64, sum: &mut [f64]| process.values.add_weighted(i, weight, sum);
        let sum = process.kriging.weighted_sum(at, self.neighbours, self.grid.len(), add);
        if self.grid.stride == 1 {
            // As the Kriging baseline rounds: with a share of 0, both predict the same bits.
            let exact = |(pixel, sum): (&mut Real, f64)| *pixel = (trend.expected(*pixel, at) + sum) as Real;
            return image.pixels.iter_mut().zip(sum).for_each(exact);
        }
        image.pixels.iter_mut().for_each(|pixel| *pixel = trend.expected(*pixel, at) as Real);
        self.grid.add_interpolated(&sum.into_iter().map(|v| v as Real).collect::<Vec<_>>(), &mut image.pixels);
    }

    /// Backward pass of [`Self::correct`]: returns the cotangent of the position, given the cotangents `d` of the corrected
    /// values, and replaces `d` by the cotangents of the prediction of the model.
    pub(crate) fn correct_vjp(&self, d: &mut [Real], query: Query<'_>, origin: Origin) -> [f64; 3] {
        let Some(process) = self.process(query.receiver) else { return [0.0; 3] };
        let (at, trend) = (place(origin.local(query.position())), &process.fit.trend);
        let d_sum = self.grid.add_interpolated_vjp(d);
        let mut d_at = process.kriging.solve_vjp(at, self.neighbours, |i| process.values.dot(i, &d_sum));
        let d_path_loss = trend.path_loss_vjp(d.iter().map(|d| *d as f64).sum(), at);
        (0..3).for_each(|k| d_at[k] += d_path_loss[k]);
        d.iter_mut().for_each(|d| *d *= trend.share as Real);
        d_at
    }

    /// Returns the standard deviation of a measurement of a link about the prediction, per value. Without a process, it
    /// is the largest of all receivers, far from their known links.
    pub(crate) fn deviation(&self, query: Query<'_>, origin: Origin) -> f64 {
        let far = |process: &ResidualProcess| process.fit.variance * (1.0 + process.fit.correlation.noise);
        let variance = match self.process(query.receiver) {
            Some(process) => {
                let at = place(origin.local(query.position()));
                let (_, solution) = process.kriging.solve(at, self.neighbours);
                process.fit.variance * solution.variance
            }
            None => self.processes.iter().flatten().map(far).fold(0.0, f64::max),
        };
        variance.sqrt()
    }
}
