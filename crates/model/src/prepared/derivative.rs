//! Derivative of a prediction by the position of the transmitter or the pose of a moving receiver: backward through residual
//! processes, mean and method.

use super::{Member, Prepared, mean_prediction};
use pwrfgs_core::{Call, ForwardOutput, Image, MethodVjp, Query, Real, WantedInputs};

impl Prepared<'_> {
    /// Returns whether [`Self::predict_vjp`] has a derivative: every model differentiates positions.
    pub fn has_derivative(&self) -> bool {
        self.models().all(|model| model.stages.method.traits().differentiates_positions)
    }

    /// Returns whether [`Self::predict_vjp`] has a derivative by the orientation of a moving receiver.
    pub fn has_orientation_derivative(&self) -> bool {
        self.models().all(|model| {
            model.stages.setup.moving.is_receiver() && model.stages.method.traits().differentiates_orientations
        })
    }

    /// Predicts the observation of a link as [`Self::predict_timed`], with the derivatives of Σ d·observation by the
    /// position of the transmitter (metres, world frame) and by the orientation (x, y, z, w) of a moving receiver, if
    /// [available](Self::has_orientation_derivative). `cotangent` returns d from the observation.
    ///
    /// For a moving receiver, the first is the derivative by its position at constant orientation. The length of the
    /// orientation has no effect. The derivative of a value that is clamped to [0, 1] is 0 outside. Images with the
    /// calibration `AsReleased` are clamped as in training.
    ///
    /// `None` without [a derivative](Self::has_derivative), and for links with features.
    ///
    /// # Panics
    /// If `cotangent` does not return one number per value of the observation.
    pub fn predict_vjp<'q>(
        &self,
        query: impl Into<Query<'q>>,
        cotangent: impl Fn(&Image) -> Vec<Real>,
    ) -> Option<(Image, [f64; 3], Option<[f64; 4]>)> {
        let (query, task) = (query.into(), self.task());
        if !self.has_derivative() || query.features.is_some() {
            return None;
        }
        let observed: Vec<ForwardOutput> = self.members.iter().map(|member| member.forward(query)).collect();
        let image = |output: &ForwardOutput| {
            let (width, height) = (self.plane().width, self.plane().height);
            Image { width, height, pixels: output.numbers.clone() }
        };
        let predicted = mean_prediction(observed.iter().map(image).collect(), task);
        let corrected = self.corrected(predicted.clone(), query);
        let mut d = cotangent(&corrected);
        assert_eq!(d.len(), corrected.pixels.len(), "a cotangent for each value");
        let (mut d_tx, mut d_orientation) = ([0.0; 3], [0.0; 4]);
        if let Some(residuals) = self.residuals {
            d_tx = residuals.correct_vjp(&mut d, query, self.setup().origin);
            task.shown_vjp(&predicted.pixels, &mut d);
        }
        let (several, share) = (self.members.len() > 1, 1.0 / self.members.len() as Real);
        for (member, output) in self.members.iter().zip(observed) {
            let mut d: Vec<Real> = d.iter().map(|d| share * d).collect();
            if several {
                task.shown_vjp(&output.numbers, &mut d);
            }
            let (d_position, d_turn) = member.vjp(query, output, &d);
            (0..3).for_each(|k| d_tx[k] += d_position[k]);
            (0..4).for_each(|k| d_orientation[k] += d_turn[k]);
        }
        Some((corrected, d_tx, self.has_orientation_derivative().then_some(d_orientation)))
    }
}

impl Member<'_> {
    /// Predicts one link, with the state for [`Self::vjp`].
    fn forward(&self, query: Query<'_>) -> ForwardOutput {
        let method = &self.model.stages.method;
        self.run_in_pool(|| self.run_call(&[query], |call| method.forward(call, &self.ready)))
    }

    /// Returns the derivatives by position and orientation, given the cotangents `d` of the observation; 0 by an
    /// orientation that the method does not differentiate.
    fn vjp(&self, query: Query<'_>, observed: ForwardOutput, d: &[Real]) -> ([f64; 3], [f64; 4]) {
        let method = &self.model.stages.method;
        let orientations = method.traits().differentiates_orientations;
        let run = |call: &Call<'_>| {
            let mut sums = MethodVjp::zeros(call, WantedInputs { positions: true, orientations });
            method.vjp(call, observed, d, &mut sums);
            let position = sums.positions.expect("wanted")[0].map(|d| d as f64);
            (position, sums.orientations.map_or([0.0; 4], |d| d[0]))
        };
        self.run_in_pool(|| self.run_call(&[query], run))
    }
}
