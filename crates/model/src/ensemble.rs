//! `Ensemble`: several models of one scene that predict together.

use crate::{IntervalCalibration, Model, Prepared, Residuals, TrainingDistances};
use pwrfgs_core::{Appearance, ImagePlane, Origin, Real, Result};
use std::collections::HashSet;

/// Models of one scene, such as runs with different seeds. The prediction of a spectrum is the mean over the models,
/// each clamped to [0, 1]; a single model predicts without clamping. The deviation between models measures uncertainty:
/// see [`Prepared::predict_with_deviation`]. [`Residuals`] can correct the mean.
#[derive(Clone, Debug)]
pub struct Ensemble {
    names: Vec<String>,
    members: Vec<Model>,
    residuals: Option<Residuals>,
    calibration: Option<IntervalCalibration>,
    /// Size of the file that was read, bytes.
    read_bytes: Option<usize>,
}

impl Ensemble {
    /// Creates an ensemble of one model.
    pub fn of(model: Model) -> Self {
        Self { names: vec!["1".into()], members: vec![model], residuals: None, calibration: None, read_bytes: None }
    }

    /// Creates an ensemble of one or more models with one measurement setup, named by their numbers from 1.
    ///
    /// # Errors
    /// There is no model, or one has another image plane or receiver than the first; the message gives its number.
    pub fn new(members: Vec<Model>) -> Result<Self, String> {
        Self::named((1..).map(|number: usize| number.to_string()).zip(members).collect())
    }

    /// Creates an ensemble of named models.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn named(members: Vec<(String, Model)>) -> Result<Self, String> {
        let Some((_, first)) = members.first() else { return Err("an ensemble needs at least one model".into()) };
        let other = members.iter().position(|(_, model)| model.stages.setup != first.stages.setup);
        if let Some(other) = other {
            return Err(format!(
                "model {} of the ensemble has another image plane or receiver than the first; use runs on the same \
                 data with the same projector",
                other + 1
            ));
        }
        let (names, members) = members.into_iter().unzip();
        Ok(Self { names, members, residuals: None, calibration: None, read_bytes: None })
    }

    /// Returns the ensemble if all models differ: equal models have no deviation and count twice in the mean.
    ///
    /// # Errors
    /// Two models are equal; the message gives the numbers of the first two.
    pub fn distinct(self) -> Result<Self, String> {
        let is_same = |a: &Model, b: &Model| {
            let method = |model: &Model| serde_json::to_string(&*model.stages.method).ok();
            a.weights == b.weights && a.cloud == b.cloud && method(a) == method(b)
        };
        for (k, model) in self.members.iter().enumerate() {
            if let Some(first) = self.members[..k].iter().position(|other| is_same(other, model)) {
                return Err(format!(
                    "models {} and {} of the ensemble are the same model; give each model once",
                    first + 1,
                    k + 1
                ));
            }
        }
        Ok(self)
    }

    /// Returns the ensemble with residual processes that correct its prediction, or without. Its calibration is that of
    /// other predictions and is removed.
    #[must_use]
    pub fn with_residuals(self, residuals: Option<Residuals>) -> Self {
        Self { residuals, calibration: None, read_bytes: None, ..self }
    }

    /// Returns the ensemble with a calibration for prediction intervals, or without.
    #[must_use]
    pub fn with_calibration(self, calibration: Option<IntervalCalibration>) -> Self {
        Self { calibration, read_bytes: None, ..self }
    }

    /// Returns the calibration for prediction intervals; `None` without one.
    pub fn calibration(&self) -> Option<&IntervalCalibration> {
        self.calibration.as_ref()
    }

    /// Returns the residual processes; `None` if the models predict alone.
    pub fn residuals(&self) -> Option<&Residuals> {
        self.residuals.as_ref()
    }

    /// Returns the models, one or more.
    pub fn members(&self) -> &[Model] {
        &self.members
    }

    /// Returns whether all models have this appearance in a 3D view.
    pub fn is_drawn_as(&self, appearance: Appearance) -> bool {
        self.members.iter().all(|model| model.stages.method.traits().appearance == appearance)
    }

    /// Returns the names of the models.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Returns the model if there is only one, otherwise `None`; without its residual processes and calibration.
    pub fn into_only(mut self) -> Option<Model> {
        self.members.pop().filter(|_| self.members.is_empty())
    }

    /// Returns the image plane.
    pub fn plane(&self) -> &ImagePlane {
        &self.members[0].stages.plane
    }

    /// Returns the number of Gaussians of all members together.
    pub fn gaussians(&self) -> usize {
        self.members.iter().map(|model| model.cloud.len()).sum()
    }

    /// Returns the size of the Gaussians of all members in an uncompressed file, bytes.
    pub fn gaussian_bytes(&self) -> usize {
        self.members.iter().map(Model::gaussian_bytes).sum()
    }

    /// Returns the size of the networks of all members in an uncompressed file, bytes.
    pub fn network_bytes(&self) -> usize {
        self.members.iter().map(Model::network_bytes).sum()
    }

    /// Returns the size of the file that was read, bytes; `None` for an ensemble that differs from its file.
    pub(crate) fn read_bytes(&self) -> Option<usize> {
        self.read_bytes
    }

    /// Returns the ensemble with the size of the file that was read, bytes.
    pub(crate) fn with_read_bytes(self, bytes: usize) -> Self {
        Self { read_bytes: Some(bytes), ..self }
    }

    /// Returns the centres of all members, metres from `origin`.
    pub fn means_from(&self, origin: Origin) -> Vec<[Real; 3]> {
        self.members.iter().flat_map(|model| model.means_from(origin)).collect()
    }

    /// Returns how far the transmitter positions `txs` `[K,3]` (metres, world frame) are from the nearest training position
    /// of any member. `None` if a member has no training positions.
    pub fn training_distances(&self, txs: &[[f64; 3]]) -> Option<TrainingDistances> {
        let mut metres = vec![f64::INFINITY; txs.len()];
        for Model { stages, training_positions, .. } in &self.members {
            let local: Vec<[Real; 3]> = txs.iter().map(|tx| stages.origin.local(*tx)).collect();
            let distances = training_positions.as_ref()?.distances(&local);
            metres.iter_mut().zip(distances).for_each(|(least, distance)| *least = least.min(distance as f64));
        }
        Some(TrainingDistances { metres, limit: self.training_limit()? })
    }

    /// Returns the training distance in metres beyond which a prediction is an extrapolation: the smallest limit of the
    /// members ([`TrainingPositions::limit`](crate::TrainingPositions::limit)). `None` if a member has no training positions.
    pub fn training_limit(&self) -> Option<f64> {
        let limits = self.members.iter().map(|model| Some(model.training_positions.as_ref()?.limit() as f64));
        limits.reduce(|a, b| Some(a?.min(b?)))?
    }

    /// Returns the thinned training positions of all members `[K,3]`, metres, world frame: each once, also if members share it;
    /// empty if unknown.
    pub fn training_positions(&self) -> Vec<[f64; 3]> {
        let mut seen = HashSet::new();
        let positions = |model: &Model| {
            model.training_positions.as_ref().map_or(Vec::new(), |training| training.positions().to_vec())
        };
        let in_world = |model| positions(model).into_iter().map(|position| model.stages.origin.world(position));
        let all = self.members.iter().flat_map(in_world);
        all.filter(|position| seen.insert(position.map(|x| (x + 0.0).to_bits()))).collect()
    }

    /// Prepares all members for predictions.
    pub fn prepare(&self) -> Prepared<'_> {
        Prepared::new(&self.members, self.residuals.as_ref())
    }
}
