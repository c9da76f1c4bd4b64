//! `Kriged`: settings of residual processes.

use pwrfgs_core::plugin::Check;
use pwrfgs_core::{Dataset, Demand, Error, JsonSchema, Misfit, Parts, Requirement, Result, check_compatible};
use serde::{Deserialize, Serialize};

/// Kriging of residuals: after training, a Gaussian process over the transmitter position predicts the difference between
/// measurements and predictions, per receiver. The model file contains it.
///
/// The prediction is b times that of the model, plus a weighted sum of residuals of the nearest known links. For received
/// powers, 1 - b times a path-loss model is added, to which predictions far from all known links revert. With b = 0, the
/// prediction is that of the baseline `Kriging()`.
///
/// The share b of 0, 0.25, 0.5, 0.75 or 1 is the one with the smallest error at links that the model did not train on: its
/// validation set, so the split needs one. It is above 0 only if the gain over Kriging exceeds one standard error over blocks:
/// those of the split, or cubes of places. An experiment with `join: true` gives all models the same validation set. With
/// `folds`, it divides all known links into as many folds as there are models, and each model leaves one fold out. The
/// correlation is that of the baseline. If b is above 0, its noise is multiplied by 1 to 256, by the same errors: residuals
/// of a good model are mostly noise.
///
/// Data need transmitter positions. A receiver without known links keeps the prediction of the model. All receivers share b.
///
/// ```
/// # use pwrfgs_core::{Checked, plugin::ron_options};
/// # use pwrfgs_model::Kriged;
/// let read = |text: &str| ron_options().from_str::<Checked<Kriged>>(text);
/// assert_eq!(read("Kriged()").unwrap().stride, 4);
/// assert!(read("Kriged(stride: 0)").is_err());
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Kriged {
    /// Largest number of rows and columns per stored pixel, 1 to 64. With 1, residuals are exact; otherwise they have 8
    /// bits, and cubic interpolation restores the other pixels. If that loses more than 0.1 % of the variance of the
    /// spectra, the stride is halved until it does not.
    pub stride: usize,
    /// Number of known links per prediction, 2 to 512; time grows with its cube.
    pub neighbours: usize,
    /// Whether each model of an experiment with `join: true` leaves out its own fold, instead of the validation set.
    /// Every link is then left out once, and the share b is that of a single model.
    pub folds: bool,
}

impl Default for Kriged {
    fn default() -> Self {
        Self { stride: 4, neighbours: 48, folds: false }
    }
}

impl Check for Kriged {
    fn check(&self) -> Result<(), String> {
        if !(1..=64).contains(&self.stride) {
            return Err(format!("`stride` is {}; give a number from 1 (exact) to 64, such as 4", self.stride));
        }
        if !(2..=512).contains(&self.neighbours) {
            return Err(format!("`neighbours` is {}; give a number from 2 to 512, such as 48", self.neighbours));
        }
        Ok(())
    }
}

impl Kriged {
    /// Checks that residuals of `data` can be predicted. `is_left_out` states whether a member did not train on some known
    /// link.
    ///
    /// # Errors
    /// [`Error::Config`]: the data have no positions, links with features or moving receivers, or all members trained on all
    /// links.
    pub fn check_data(&self, data: &Dataset, is_left_out: bool) -> Result<()> {
        let requires = &[Requirement::Positions, Requirement::NoFeatures, Requirement::FixedReceiver];
        let demands = &[Demand::of("residuals", "Kriged", requires)];
        check_compatible(&Parts { data: Some(data), demands, ..Parts::default() }).map_err(Misfit::error)?;
        if is_left_out {
            return Ok(());
        }
        let problem = "residuals: the model trains on all known links, so its residuals are too small; give the split a \
                    `validation` share, such as 0.1, or in an experiment with `join: true` write `Kriged(folds: true)`";
        Err(Error::Config(problem.into()))
    }
}
