//! `Ensemble`: several models of one scene that predict together.

use crate::{Model, Prepared};
use pwrfgs_core::{Appearance, ImagePlane, Origin, Real};

/// Models of one scene, such as runs that differ in their seed. Its picture is the mean of theirs, each clamped to
/// [0, 1] (one alone predicts as it is); where they disagree, nobody should trust it: see [`Prepared::predict_with_deviation`].
#[derive(Clone, Debug)]
pub struct Ensemble {
    names: Vec<String>,
    members: Vec<Model>,
}

impl Ensemble {
    /// Of one model alone.
    pub fn of(model: Model) -> Self {
        Self { names: vec!["1".into()], members: vec![model] }
    }

    /// Of one model or more, on one grid of pixels; they are called by their numbers, from 1.
    ///
    /// # Errors
    /// What does not fit together.
    pub fn new(members: Vec<Model>) -> Result<Self, String> {
        Self::named((1..).map(|place: usize| place.to_string()).zip(members).collect())
    }

    /// The same, each with a name.
    ///
    /// # Errors
    /// What does not fit together.
    pub fn named(members: Vec<(String, Model)>) -> Result<Self, String> {
        let Some((_, first)) = members.first() else { return Err("an ensemble needs a model".into()) };
        let other = members.iter().position(|(_, model)| model.stages.frame != first.stages.frame);
        if let Some(other) = other {
            return Err(format!(
                "model {} of the ensemble sees other pixels than the first, or from another receiver; take runs on the \
                 same data with the same projector",
                other + 1
            ));
        }
        let (names, members) = members.into_iter().unzip();
        Ok(Self { names, members })
    }

    /// The same ensemble, if no model takes part twice: two equal models have no spread, and count double in the mean.
    ///
    /// # Errors
    /// The first two that are equal.
    pub fn distinct(self) -> Result<Self, String> {
        let is_same = |a: &Model, b: &Model| {
            let method = |model: &Model| serde_json::to_string(&*model.stages.method).ok();
            a.weights == b.weights && a.cloud == b.cloud && method(a) == method(b)
        };
        for (place, model) in self.members.iter().enumerate() {
            if let Some(first) = self.members[..place].iter().position(|other| is_same(other, model)) {
                return Err(format!(
                    "models {} and {} of the ensemble are the same model; give each model once",
                    first + 1,
                    place + 1
                ));
            }
        }
        Ok(self)
    }

    /// The models that take part, one or more.
    pub fn members(&self) -> &[Model] {
        &self.members
    }

    /// Whether all of them look like this in a room.
    pub fn is_drawn_as(&self, appearance: Appearance) -> bool {
        self.members.iter().all(|model| model.stages.method.traits().appearance == appearance)
    }

    /// What they are called.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// The model, where there is only one.
    pub fn into_only(mut self) -> Option<Model> {
        self.members.pop().filter(|_| self.members.is_empty())
    }

    /// The picture's grid.
    pub fn plane(&self) -> &ImagePlane {
        &self.members[0].stages.plane
    }

    /// Gaussians of all members together.
    pub fn gaussians(&self) -> usize {
        self.members.iter().map(|model| model.cloud.len()).sum()
    }

    /// Bytes of the Gaussians of all members in the file.
    pub fn gaussian_bytes(&self) -> usize {
        self.members.iter().map(Model::gaussian_bytes).sum()
    }

    /// Bytes of the networks of all members in the file.
    pub fn network_bytes(&self) -> usize {
        self.members.iter().map(Model::network_bytes).sum()
    }

    /// The centres of all members, metres from `origin`.
    pub fn means_from(&self, origin: Origin) -> Vec<[Real; 3]> {
        self.members.iter().flat_map(|model| model.means_from(origin)).collect()
    }

    /// All of them, ready to predict.
    pub fn prepare(&self) -> Prepared<'_> {
        Prepared::new(&self.members)
    }
}
