//! `Ensemble`: several models of one scene that predict together.

use crate::{Model, Prepared};

/// Models of one scene, such as runs that differ in their seed. Its picture is the mean of theirs, each clamped to
/// [0, 1] (one alone predicts as it is); where they disagree, nobody should trust it: see [`Prepared::deviation`].
#[derive(Clone, Debug)]
pub struct Ensemble {
    members: Vec<Model>,
}

impl Ensemble {
    /// Of one model or more, on one grid of pixels.
    ///
    /// # Errors
    /// What does not fit together.
    pub fn new(members: Vec<Model>) -> Result<Self, String> {
        let Some(first) = members.first() else { return Err("an ensemble needs a model".into()) };
        let stages = &first.stages;
        match members.iter().position(|m| m.stages.plane != stages.plane || m.stages.receiver() != stages.receiver()) {
            Some(other) => Err(format!(
                "model {} of the ensemble sees other pixels than the first, or from another receiver; take runs on the \
                 same data with the same projector",
                other + 1
            )),
            None => Ok(Self { members }),
        }
    }

    /// The models that take part, one or more.
    pub fn members(&self) -> &[Model] {
        &self.members
    }

    /// All of them, ready to predict.
    pub fn prepare(&self) -> Prepared<'_> {
        Prepared::new(&self.members)
    }
}
