//! `Residuals`: a Gaussian process over the transmitter position that predicts what a model leaves.
//!
//! The prediction is y(x) = b f(x) + Σ wᵢ (yᵢ − b f(xᵢ)): the prediction f of the model times a share b, plus kriging of
//! the residuals of the nearest known observations (regression kriging: Hengl, Heuvelink and Rossiter, Computers and
//! Geosciences 33, 2007). The weights w add up to 1. For received powers, (1 − b) times a path-loss model is added to
//! b f(x), and the weights are those of a process with mean zero: far from all known links, they vanish.
//!
//! Residuals of a model at positions that it trained on are too small. The share and the variance therefore maximise the
//! likelihood of links that a model did not train on, each given the residuals of the same model at other links (`residual_fit.rs`).

mod file;
mod grid;
mod kriged;
#[cfg(test)]
mod tests;

pub(crate) use file::{RESIDUALS, ResidualsNote};
pub(crate) use grid::CoarseGrid;
pub use kriged::Kriged;

use crate::tensors::quantise;
use pwrfgs_core::kriging::{Correlation, LocalKriging, Mean, PathLoss, Place, in_space, log_distance};
use pwrfgs_core::{Image, Origin, Query, Real};
use std::ops::Range;

/// Residual processes of a model, one per receiver.
#[derive(Clone, Debug)]
pub struct Residuals {
    pub(crate) grid: CoarseGrid,
    /// Number of known links per prediction.
    pub(crate) neighbours: usize,
    /// Processes in the order of the receivers; `None` for a receiver that the model predicts alone.
    pub(crate) processes: Vec<Option<ResidualProcess>>,
}

/// What residuals are differences from. With a path-loss model, it is the prediction far from all known links.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidualTrend {
    /// Share b of the prediction of the model, 0 to 1.
    pub share: f64,
    /// For received powers, the path-loss model with share 1 − b, and the position of the receiver, metres from the origin.
    pub path_loss: Option<(PathLoss, [f64; 3])>,
}

impl ResidualTrend {
    /// Returns the expected value for `predicted` by the model and a transmitter `at` a position (metres from the
    /// origin).
    pub(crate) fn expected(&self, predicted: Real, at: [Real; 3]) -> Real {
        let law = |(law, receiver): (PathLoss, _)| law.power(log_distance(at.map(|v| v as f64), receiver));
        self.share as Real * predicted + ((1.0 - self.share) * self.path_loss.map_or(0.0, law)) as Real
    }
}

/// Settings of a residual process, learned from links that the model did not train on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProcessFit {
    /// Expected value that residuals are differences from.
    pub trend: ResidualTrend,
    /// Process variance of a value at a position that the model did not train on.
    pub variance: f64,
    /// Correlation of the residuals.
    pub correlation: Correlation,
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
    /// 8-bit numbers from -127 to 127, and the unit of each link.
    Short(Vec<i8>, Vec<Real>),
}

impl ResidualValues {
    /// Appends residuals `[n, link_values]`, rounded to 8 bits if the others are.
    pub(crate) fn extend(&mut self, residuals: &[Real], link_values: usize) {
        match self {
            Self::Exact(values) => values.extend_from_slice(residuals),
            Self::Short(values, units) => {
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
            Self::Short(..) => Self::Short(Vec::new(), Vec::new()),
        }
    }

    /// Returns the residuals of a range of links.
    fn rows(&self, links: Range<usize>, link_values: usize) -> Self {
        let numbers = links.start * link_values..links.end * link_values;
        match self {
            Self::Exact(values) => Self::Exact(values[numbers].to_vec()),
            Self::Short(values, units) => Self::Short(values[numbers].to_vec(), units[links].to_vec()),
        }
    }

    /// Adds `weight` times the residuals of link `i` to `sum`.
    fn add_weighted(&self, i: usize, weight: f64, sum: &mut [Real]) {
        let n = sum.len();
        match self {
            Self::Exact(values) => {
                let weight = weight as Real;
                sum.iter_mut().zip(&values[i * n..][..n]).for_each(|(sum, v)| *sum += weight * v);
            }
            Self::Short(values, units) => {
                let weight = weight as Real * units[i];
                sum.iter_mut().zip(&values[i * n..][..n]).for_each(|(sum, v)| *sum += weight * Real::from(*v));
            }
        }
    }

    /// Returns Σ d·residual of link `i`.
    fn dot(&self, i: usize, d: &[Real]) -> f64 {
        let (n, wide) = (d.len(), |v: Real, d: &Real| v as f64 * *d as f64);
        match self {
            Self::Exact(values) => values[i * n..][..n].iter().zip(d).map(|(v, d)| wide(*v, d)).sum(),
            Self::Short(values, units) => {
                let sum: f64 = values[i * n..][..n].iter().zip(d).map(|(v, d)| wide(Real::from(*v), d)).sum();
                units[i] as f64 * sum
            }
        }
    }
}

impl ResidualProcess {
    /// Creates the process from residuals at known links; their mean is zero with a path-loss model, otherwise unknown.
    pub(crate) fn new(fit: ProcessFit, places: Vec<[Real; 3]>, values: ResidualValues) -> Self {
        let mean = if fit.trend.path_loss.is_some() { Mean::Zero } else { Mean::Unknown };
        let kriging = LocalKriging::new(fit.correlation, mean, places.iter().map(|&at| place(at)));
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
    in_space(at.map(|v| v as f64))
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

    /// Returns the process of a receiver; `None` if the model predicts alone.
    pub(crate) fn process(&self, receiver: usize) -> Option<&ResidualProcess> {
        self.processes.get(receiver)?.as_ref()
    }

    /// Adds the expected residual of a link to the prediction `image` of the model, from the nearest known links.
    pub(crate) fn correct(&self, image: &mut Image, query: Query<'_>, origin: Origin) {
        let Some(process) = self.process(query.receiver) else { return };
        let at = origin.local(query.position());
        let (near, solution) = process.kriging.solve(place(at), self.neighbours);
        let mut sum = vec![0.0; self.grid.len()];
        near.iter().zip(&solution.weights).for_each(|(&i, weight)| process.values.add_weighted(i, *weight, &mut sum));
        image.pixels.iter_mut().for_each(|pixel| *pixel = process.fit.trend.expected(*pixel, at));
        self.grid.add_interpolated(&sum, &mut image.pixels);
    }

    /// Backward pass of [`Self::correct`]: returns the cotangent of the position, given those of the corrected values,
    /// which become those of the prediction of the model.
    pub(crate) fn correct_vjp(&self, d: &mut [Real], query: Query<'_>, origin: Origin) -> [f64; 3] {
        let Some(process) = self.process(query.receiver) else { return [0.0; 3] };
        let (at, trend) = (origin.local(query.position()), &process.fit.trend);
        let d_sum = self.grid.add_interpolated_vjp(d);
        let mut d_at = process.kriging.solve_vjp(place(at), self.neighbours, |i| process.values.dot(i, &d_sum));
        if let Some((law, receiver)) = trend.path_loss {
            let d_power = (1.0 - trend.share) * d.iter().map(|d| *d as f64).sum::<f64>();
            let slope = law.power_gradient(at.map(|v| v as f64), receiver);
            (0..3).for_each(|k| d_at[k] += d_power * slope[k]);
        }
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
                process.fit.variance * process.kriging.solve(at, self.neighbours).1.variance
            }
            None => self.processes.iter().flatten().map(far).fold(0.0, f64::max),
        };
        variance.sqrt()
    }
}
