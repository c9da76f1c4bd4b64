//! `Predictor`: models or a fitted baseline of one half of the page.

use pwrfgs_core::{Dataset, Image, Predict, Query};
use pwrfgs_model::{Ensemble, Model, Prepared};
use self_cell::self_cell;
use std::sync::Arc;
use std::time::Instant;

self_cell!(
    /// Models with values that are computed once.
    pub(crate) struct PreparedEnsemble {
        owner: Arc<Ensemble>,
        #[covariant]
        dependent: Prepared,
    }
);

type BoxedBaseline<'a> = Box<dyn Predict + 'a>;

self_cell!(
    /// Baseline with the data that it was fitted to.
    pub(crate) struct FittedBaseline {
        owner: Arc<Dataset>,
        #[covariant]
        dependent: BoxedBaseline,
    }
);

/// Model or baseline that predicts.
pub(crate) enum Predictor {
    /// Model or ensemble.
    Model(PreparedEnsemble),
    /// Fitted baseline.
    Baseline(FittedBaseline),
}

/// Predicted observation of a link.
pub(crate) struct PredictedImage {
    pub(crate) image: Image,
    /// Standard deviation over the members of an ensemble.
    pub(crate) deviation: Option<Image>,
    /// Latency of the prediction, milliseconds.
    pub(crate) ms: f64,
}

impl Predictor {
    /// Prepares the models of an ensemble.
    pub(crate) fn new(models: Ensemble) -> Self {
        Self::Model(PreparedEnsemble::new(Arc::new(models), |models| models.prepare()))
    }

    /// Returns the models; `None` for a baseline.
    pub(crate) fn ensemble(&self) -> Option<&Arc<Ensemble>> {
        match self {
            Self::Model(ready) => Some(ready.borrow_owner()),
            Self::Baseline(_) => None,
        }
    }

    /// Returns whether the predictor takes a position, as every baseline does, and not link features.
    pub(crate) fn has_position_input(&self) -> bool {
        let has_position = |model: &Model| model.stages.method.traits().inputs == 3; // x, y, z
        self.ensemble().is_none_or(|ensemble| ensemble.members().iter().all(has_position))
    }

    /// Returns whether this is a baseline that is fitted to training and validation samples, which it may store; an
    /// oracle is not.
    pub(crate) fn is_fitted(&self) -> bool {
        matches!(self, Self::Baseline(baseline) if !baseline.borrow_dependent().is_oracle())
    }

    /// Predicts the observation of a link, with its deviation for an ensemble of several models.
    pub(crate) fn predict(&self, query: Query<'_>) -> PredictedImage {
        let begun = Instant::now();
        let (image, deviation) = match self {
            Self::Baseline(baseline) => (baseline.borrow_dependent().predict(query), None),
            Self::Model(ready) if ready.borrow_owner().members().len() == 1 => {
                (ready.borrow_dependent().predict_timed(query).0, None)
            }
            Self::Model(ready) => {
                let (image, deviation, _) = ready.borrow_dependent().predict_with_deviation(query);
                (image, Some(deviation))
            }
        };
        PredictedImage { image, deviation, ms: begun.elapsed().as_secs_f64() * 1e3 }
    }

    /// Predicts the observations of many links, such as powers over a plane, in their order.
    pub(crate) fn predict_many(&self, queries: &[Query<'_>]) -> Vec<Image> {
        match self {
            Self::Baseline(baseline) => baseline.borrow_dependent().predict_many(queries),
            Self::Model(ready) => ready.borrow_dependent().predict_many(queries),
        }
    }
}
