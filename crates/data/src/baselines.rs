//! Baselines: predictors without Gaussians, to compare models with.
//!
//! This file holds the mean, the zero channel, `ByReceiver`, which fits one predictor per receiver, and functions that several
//! baselines share.

mod kriging;
#[cfg(test)]
mod link_tests;
mod log_distance;
mod neighbours;
mod pooled_kriging;
mod predictions;
mod ridge;
#[cfg(test)]
mod tests;

pub use kriging::{Kriging, Trend, vecchia_cases};
pub use log_distance::LogDistance;
pub use neighbours::{NearestCarrier, NearestNeighbours, Neighbours};
pub use predictions::Predictions;
pub use ridge::Ridge;

use pwrfgs_core::messages::{join_names, strip_control};
use pwrfgs_core::{Baseline, Dataset, Error, FittingSet, Image, JsonSchema, Predict, Query, Real, Result, Task};
use serde::{Deserialize, Serialize};

/// Largest number of receivers that a note lists, so that a line stays readable.
const LISTED: usize = 24;

/// Mean of the training spectra of each receiver, independent of the transmitter: the lower reference for every score.
/// For received powers and channels it is called "mean of the receiver". A receiver without training links gets the
/// mean of all links.
///
/// ```
/// # use pwrfgs_core::{Baseline, Plugin};
/// # use pwrfgs_data as _;
/// assert_eq!(Plugin::<dyn Baseline>::parse("MeanSpectrum()").unwrap().name(), "mean spectrum");
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MeanSpectrum {}

#[typetag::serde]
impl Baseline for MeanSpectrum {
    fn name(&self) -> String {
        "mean spectrum".into()
    }

    fn name_for(&self, task: Task) -> String {
        task.mean_name.into()
    }

    fn fit<'a>(&self, data: &'a Dataset, fitting: FittingSet<'_>) -> Result<Box<dyn Predict + 'a>> {
        let fit = |fitting: FittingSet<'_>| {
            let weighted: Vec<(usize, f64)> = fitting_samples(fitting)?.into_iter().map(|i| (i, 1.0)).collect();
            Ok(Constant(weighted_mean(data, &weighted)))
        };
        Ok(Box::new(ByReceiver::fit(data, fitting, fit)?))
    }
}

/// Returns all samples to fit to, sorted, or an error if there are none.
fn fitting_samples(fitting: FittingSet<'_>) -> Result<Vec<usize>> {
    let samples = fitting.all();
    if samples.is_empty() {
        return Err(Error::Config("a baseline needs at least one training sample; change the split".into()));
    }
    Ok(samples)
}

/// Predictor that returns the same image for every query.
struct Constant(Image);

impl Predict for Constant {
    fn predict(&self, _: Query<'_>) -> Image {
        self.0.clone()
    }

    fn predict_vjp(&self, _: Query<'_>, _: &dyn Fn(&Image) -> Vec<Real>) -> Option<(Image, [f64; 3])> {
        Some((self.0.clone(), [0.0; 3]))
    }
}

impl ReceiverPredictor for Constant {
    fn combined_note(_: &[(&str, &Self)]) -> Option<String> {
        None
    }
}

/// Returns the weighted mean of observations; `weighted` has the index and the weight of each sample, at least one. Weights
/// need not sum to one.
fn weighted_mean(data: &Dataset, weighted: &[(usize, f64)]) -> Image {
    let mut sum = vec![0.0; data.width * data.height];
    for &(i, weight) in weighted {
        data.observations.add(i, weight, &mut sum);
    }
    let total: f64 = data.observations.full_scale() * weighted.iter().map(|(_, w)| w).sum::<f64>();
    let pixels = sum.iter().map(|s| (s / total) as Real).collect();
    Image { width: data.width, height: data.height, pixels }
}

/// Predictor fitted to the links of one receiver.
#[expect(unused_variables, reason = "the defaults ignore parameters")]
pub(super) trait ReceiverPredictor: Predict + Sized {
    /// Returns the note below a table of scores for the predictors of all receivers with training links, each after the name
    /// of its receiver; `None` without a note.
    fn combined_note(predictors: &[(&str, &Self)]) -> Option<String>;

    /// Returns the predictor without these links, as [`Predict::without`]; `None` also if no sample remains.
    fn leaving_out(&self, links: &[usize]) -> Option<Self> {
        None
    }
}

/// One predictor per receiver.
pub(super) struct ByReceiver<P> {
    /// Receiver names with their predictors; `None` if the receiver has no training link.
    predictors: Vec<(String, Option<P>)>,
    /// Predictor fitted to all links, for receivers without training links.
    pooled: Option<P>,
}

impl<P: ReceiverPredictor> ByReceiver<P> {
    /// Fits one predictor with `fit` to the links of each receiver, and one to all links if a receiver has none. Returns an
    /// error of `fit`, or if the flag of `fitting` ends the fit.
    fn fit(data: &Dataset, fitting: FittingSet<'_>, fit: impl Fn(FittingSet<'_>) -> Result<P>) -> Result<Self> {
        let receivers = &data.scene.receivers;
        let by_receiver =
            [fitting.train, fitting.validation].map(|links| data.group_by_receiver(links.iter().copied()));
        let fit_receiver = |r: usize| {
            fitting.check_stopped()?;
            let links = FittingSet { train: &by_receiver[0][r], validation: &by_receiver[1][r], ..fitting };
            // If the only receiver has no links, `fit` returns the error.
            let is_unlinked = links.train.is_empty() && links.validation.is_empty() && receivers.len() > 1;
            Ok((strip_control(&receivers[r].name), if is_unlinked { None } else { Some(fit(links)?) }))
        };
        let predictors = (0..receivers.len()).map(fit_receiver).collect::<Result<Vec<_>>>()?;
        let pooled = if predictors.iter().any(|(_, fitted)| fitted.is_none()) { Some(fit(fitting)?) } else { None };
        Ok(Self { predictors, pooled })
    }

    /// Returns the predictor of a receiver; without one, that of all links, else that of the first receiver with one. The last
    /// applies to an unknown receiver, and after [`Predict::without`].
    fn predictor_for(&self, receiver: usize) -> &P {
        let fitted = self.predictors.get(receiver).and_then(|(_, fitted)| fitted.as_ref());
        let any = || self.predictors.iter().find_map(|(_, fitted)| fitted.as_ref());
        fitted.or(self.pooled.as_ref()).or_else(any).expect("one predictor was fitted at least")
    }
}

impl<P: ReceiverPredictor> Predict for ByReceiver<P> {
    fn predict(&self, query: Query<'_>) -> Image {
        self.predictor_for(query.receiver).predict(query)
    }

    fn predict_vjp(&self, query: Query<'_>, cotangent: &dyn Fn(&Image) -> Vec<Real>) -> Option<(Image, [f64; 3])> {
        self.predictor_for(query.receiver).predict_vjp(query, cotangent)
    }

    fn deviation(&self, query: Query<'_>) -> Option<f64> {
        self.predictor_for(query.receiver).deviation(query)
    }

    fn without(&self, links: &[usize]) -> Option<Box<dyn Predict + '_>> {
        let leave_out = |fitted: &Option<P>| fitted.as_ref()?.leaving_out(links);
        let predictors: Vec<_> =
            self.predictors.iter().map(|(name, fitted)| (name.clone(), leave_out(fitted))).collect();
        let pooled = leave_out(&self.pooled);
        let is_fitted = pooled.is_some() || predictors.iter().any(|(_, fitted)| fitted.is_some());
        is_fitted.then(|| Box::new(Self { predictors, pooled }) as Box<dyn Predict + '_>)
    }

    fn is_oracle(&self) -> bool {
        let fitted = self.predictors.iter().filter_map(|(_, fitted)| fitted.as_ref()).chain(&self.pooled).next();
        fitted.is_some_and(Predict::is_oracle)
    }

    fn note(&self) -> Option<String> {
        let predictors: Vec<(&str, &P)> =
            self.predictors.iter().filter_map(|(name, fitted)| Some((name.as_str(), fitted.as_ref()?))).collect();
        let unlinked: Vec<&str> =
            self.predictors.iter().filter(|(_, fitted)| fitted.is_none()).map(|(name, _)| name.as_str()).collect();
        let pooled = (!unlinked.is_empty()).then(|| {
            format!(
                "{} has no training link and is predicted from those of all receivers",
                join_names(unlinked.iter(), LISTED)
            )
        });
        let notes: Vec<String> = P::combined_note(&predictors).into_iter().chain(pooled).collect();
        (!notes.is_empty()).then(|| notes.join("; "))
    }
}

/// Zero channel, SNR 0 dB. A prediction with wrong phases scores lower.
///
/// ```
/// # use pwrfgs_core::{Baseline, Plugin};
/// # use pwrfgs_data as _;
/// assert_eq!(Plugin::<dyn Baseline>::parse("Zero()").unwrap().name(), "zero");
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Zero {}

#[typetag::serde]
impl Baseline for Zero {
    fn name(&self) -> String {
        "zero".into()
    }

    fn fit<'a>(&self, data: &'a Dataset, fitting: FittingSet<'_>) -> Result<Box<dyn Predict + 'a>> {
        self.check_data(data)?;
        fitting_samples(fitting)?;
        Ok(Box::new(Constant(Image::zeros(data.width, data.height))))
    }

    fn tasks(&self) -> &'static [Task] {
        &[Task::Channel]
    }
}
