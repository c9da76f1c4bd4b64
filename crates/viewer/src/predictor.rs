//! `Predictor`: models or a fitted baseline of one half of the page.

use pwrfgs_core::{Dataset, Image, Predict, Query};
use pwrfgs_model::{Ensemble, Prepared};
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

/// Prediction.
pub(crate) struct PredictedImage {
    pub(crate) image: Image,
    /// Standard deviation over the members of an ensemble.
    pub(crate) deviation: Option<Image>,
    /// Latency of the prediction, milliseconds.
    pub(crate) ms: f64,
}

impl Predictor {
    /// Returns the predictor of prepared models.
    pub(crate) fn of(models: Ensemble) -> Self {
        Self::Model(PreparedEnsemble::new(Arc::new(models), |models| models.prepare()))
    }

    /// Returns the models, unless it is a baseline.
    pub(crate) fn ensemble(&self) -> Option<&Arc<Ensemble>> {
        match self {
            Self::Model(ready) => Some(ready.borrow_owner()),
            Self::Baseline(_) => None,
        }
    }

    /// Returns whether the input is a transmitter position, not other features.
    pub(crate) fn has_position_input(&self) -> bool {
        self.ensemble()
            .is_none_or(|ensemble| ensemble.members().iter().all(|model| model.stages.method.traits().inputs == 3))
    }

    /// Returns whether it is a baseline fitted to training and validation samples, which it may store.
    pub(crate) fn is_fitted(&self) -> bool {
        matches!(self, Self::Baseline(baseline) if !baseline.borrow_dependent().is_oracle())
    }

    /// Predicts the observation of a link.
    pub(crate) fn predict(&self, query: Query<'_>) -> PredictedImage {
        let begun = Instant::now();
        let ms = |begun: Instant| begun.elapsed().as_secs_f64() * 1e3;
        match self {
            Self::Baseline(baseline) => {
                let image = baseline.borrow_dependent().predict(query);
                PredictedImage { image, deviation: None, ms: ms(begun) }
            }
            Self::Model(ready) if ready.borrow_owner().members().len() == 1 => {
                let (image, _) = ready.borrow_dependent().predict_timed(query);
                PredictedImage { image, deviation: None, ms: ms(begun) }
            }
            Self::Model(ready) => {
                let (image, deviation, _) = ready.borrow_dependent().predict_with_deviation(query);
                PredictedImage { image, deviation: Some(deviation), ms: ms(begun) }
            }
        }
    }

    /// Predicts many links, such as powers over a plane.
    pub(crate) fn predict_many(&self, queries: &[Query<'_>]) -> Vec<Image> {
        match self {
            Self::Baseline(baseline) => {
                queries.iter().map(|query| baseline.borrow_dependent().predict(*query)).collect()
            }
            Self::Model(ready) => ready.borrow_dependent().predict_many(queries),
        }
    }
}
