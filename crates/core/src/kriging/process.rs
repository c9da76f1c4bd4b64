//! Fits of Kriging to the known links of a data set: those of the baseline, and of residuals without a share of a model.

use super::{
    Correlation, LocalKriging, Mean, PathLoss, Place, PowerLink, StopCheck, fit_pooled, fit_spectra, log_distance,
};
use crate::{Dataset, Real, Result, Sampling};

/// Approximate number of values per observation in the fit: every n-th row and column.
const VALUES: usize = 2_000;

/// Expected value, from which residuals are differences. With a path-loss model, it is the prediction far from all known links.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidualTrend {
    /// Share b of the prediction of a model, 0 to 1; 0 without a model.
    pub share: f64,
    /// For received powers, the path-loss model with share 1 − b, and the position of the fixed end, metres from the origin.
    pub path_loss: Option<(PathLoss, [f64; 3])>,
}

impl ResidualTrend {
    /// Returns the expected value for the value `predicted` by a model, with the moving end at a place, metres from the origin.
    pub fn expected(&self, predicted: Real, [x, y, z, _]: Place) -> f64 {
        let power = |(path_loss, end): (PathLoss, _)| path_loss.power(log_distance([x, y, z], end));
        self.share * predicted as f64 + (1.0 - self.share) * self.path_loss.map_or(0.0, power)
    }

    /// Returns the derivative of the path loss in [`Self::expected`] by the place, times `d`; 0 without a path-loss model.
    pub fn path_loss_vjp(&self, d: f64, [x, y, z, _]: Place) -> [f64; 3] {
        let slope = self.path_loss.map_or([0.0; 3], |(path_loss, end)| path_loss.power_gradient([x, y, z], end));
        slope.map(|slope| (1.0 - self.share) * d * slope)
    }
}

/// Fit of a process to the known links of a receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProcessFit {
    /// Expected value that residuals are differences from.
    pub trend: ResidualTrend,
    /// Process variance of a value; NaN if no link could be predicted from others.
    pub variance: f64,
    /// Correlation of the residuals.
    pub correlation: Correlation,
}

impl ProcessFit {
    /// Creates the predictor of the process from the places of known links (metres from the origin). The mean of their residuals is zero with a
    /// path-loss model, otherwise unknown.
    pub fn process(&self, places: impl Iterator<Item = Place>) -> LocalKriging {
        let mean = if self.trend.path_loss.is_some() { Mean::Zero } else { Mean::Unknown };
        LocalKriging::new(self.correlation, mean, places)
    }
}

/// Returns the place of the moving end of link `i`, metres from the origin in the precision of model files; its time is its id.
pub fn link_place(data: &Dataset, i: usize) -> Place {
    let sample = data.sample(i);
    let [x, y, z] = data.scene.origin.local(sample.position()).map(|v| v as f64);
    [x, y, z, f64::from(sample.id)]
}

/// Fits Kriging to observations of many values: the known `links` of one receiver. `time` adds a time scale.
///
/// # Errors
/// An error of `check`.
pub fn fit_observations(data: &Dataset, links: &[usize], time: bool, check: StopCheck<'_>) -> Result<ProcessFit> {
    let stride = ((data.width * data.height) as f64 / VALUES as f64).sqrt().ceil().max(1.0) as usize;
    let values = |k: usize| {
        let mut values = vec![0.0; data.width.div_ceil(stride) * data.height.div_ceil(stride)];
        data.observations.sampled(links[k], Sampling::every(stride), &mut values);
        values
    };
    let (correlation, variance) = fit_spectra(links.len(), |k| link_place(data, links[k]), values, time, check)?;
    Ok(ProcessFit { trend: ResidualTrend { share: 0.0, path_loss: None }, variance, correlation })
}

/// Fits Kriging to the known `links` of received powers: one fit per receiver, with a common correlation and variance. A
/// receiver without links has the path-loss model that all share.
///
/// # Errors
/// An error of `check`.
pub fn fit_powers(data: &Dataset, links: &[usize], check: StopCheck<'_>) -> Result<Vec<ProcessFit>> {
    let has_distances = data.scene.has_distances();
    let end = |receiver: usize| data.scene.fixed_end(receiver).position;
    let power = |&i: &usize| {
        let (receiver, [x, y, z, _]) = (data.links[i].receiver, link_place(data, i));
        let log_distance = has_distances.then(|| log_distance([x, y, z], end(receiver)));
        PowerLink { receiver, place: [x, y, z, 0.0], log_distance, value: data.image(i).pixels[0] as f64 }
    };
    let powers: Vec<PowerLink> = links.iter().map(power).collect();
    let fit = fit_pooled(&powers, data.scene.receivers.len(), check)?;
    let process = |(receiver, path_loss): (usize, &PathLoss)| ProcessFit {
        trend: ResidualTrend { share: 0.0, path_loss: Some((*path_loss, end(receiver))) },
        variance: fit.variance,
        correlation: fit.correlation,
    };
    Ok(fit.path_losses.iter().enumerate().map(process).collect())
}
