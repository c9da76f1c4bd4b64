//! Adam optimizer: its moments survive clone, split and prune, and each column has its own rate.

use crate::settings::{Optimizer, Schedule, Training};
use pwrfgs_core::{AdamUpdate, ColumnSpec, GaussianCloud, Real, WeightGroup};

/// First and second moments of all learned parameters.
#[derive(Clone, Debug)]
pub(crate) struct Adam {
    /// Moments of the cloud.
    pub(crate) cloud: [GaussianCloud; 2],
    /// Moments of the network.
    pub(crate) weights: [Vec<Real>; 2],
}

/// Learning rates at a step, from 1.
#[derive(Clone, Copy)]
pub(crate) struct Rates<'a> {
    pub(crate) training: &'a Training,
    pub(crate) step: u64,
}

impl Rates<'_> {
    /// Returns the rate of a schedule at this step.
    fn rate(self, schedule: Schedule) -> Real {
        schedule.rate(self.step, self.training.steps)
    }

    /// Returns the constants of an update at this step, without decay.
    fn update_constants(self, rate: Real, eps: Real) -> AdamUpdate {
        let unbias = AdamUpdate::BETAS.map(|b| 1.0 - b.powi(self.step.min(i32::MAX as u64) as i32));
        AdamUpdate { rate, eps, unbias, l2: 0.0, decay: 0.0 }
    }

    /// Returns the update of column `name` of the cloud; `None` if it is not learned, or its rate is 0.
    pub(crate) fn column_update(self, specs: &[ColumnSpec], name: &str) -> Option<AdamUpdate> {
        let (spec, optimizer) = (specs.iter().find(|spec| spec.name == name), &self.training.optimizer);
        let rate = column_rate(optimizer, spec, name, |schedule| self.rate(schedule))?;
        Some(self.update_constants(rate, optimizer.eps))
    }

    /// Returns the update of a group of network weights, with warm-up and, if the group decays, with decay.
    pub(crate) fn weight_update(self, group: &WeightGroup) -> AdamUpdate {
        let optimizer = &self.training.optimizer;
        let warm = (self.step as f64 / optimizer.network_warmup.max(1) as f64).min(1.0) as Real;
        let update = self.update_constants(warm * self.rate(optimizer.network), optimizer.network_eps);
        let decayed = AdamUpdate { l2: optimizer.network_l2, decay: optimizer.network_decay, ..update };
        if group.decays { decayed } else { update }
    }
}

impl Adam {
    /// Creates moments of zero.
    pub(crate) fn new(cloud: &GaussianCloud, weights: &[Real]) -> Self {
        let zeros = cloud.zeros_like();
        Self { cloud: [zeros.clone(), zeros], weights: [vec![0.0; weights.len()], vec![0.0; weights.len()]] }
    }

    /// Updates the learned columns of the cloud by Adam, or by [gradient descent](ColumnSpec::adam) at rate · N.
    ///
    /// # Errors
    /// A column is no longer finite; the message is the name of the first.
    pub(crate) fn step_cloud(
        &mut self,
        rates: Rates<'_>,
        specs: &[ColumnSpec],
        cloud: &mut GaussianCloud,
        d_cloud: &GaussianCloud,
    ) -> Result<(), String> {
        let n = cloud.len();
        let [first, second] = &mut self.cloud;
        let columns = cloud.columns_mut().zip(d_cloud.columns()).zip(first.columns_mut().zip(second.columns_mut()));
        for (((name, _, x), (_, _, d)), ((_, _, m), (_, _, v))) in columns {
            let Some(update) = rates.column_update(specs, name) else { continue };
            let is_plain = specs.iter().any(|spec| spec.name == name && !spec.adam);
            let is_finite = if is_plain { descend(x, d, update.rate * n as Real) } else { update.apply(x, d, m, v) };
            if !is_finite {
                return Err(format!("`{name}`"));
            }
        }
        Ok(())
    }

    /// Updates the learned weights of the network.
    ///
    /// # Errors
    /// A weight is no longer finite; the message is `the network`.
    pub(crate) fn step_weights(
        &mut self,
        rates: Rates<'_>,
        groups: &[WeightGroup],
        weights: &mut [Real],
        d_weights: &[Real],
    ) -> Result<(), String> {
        let [first, second] = &mut self.weights;
        for group in groups {
            let range = || group.range.clone();
            let (x, m, v) = (&mut weights[range()], &mut first[range()], &mut second[range()]);
            if !rates.weight_update(group).apply(x, &d_weights[range()], m, v) {
                return Err("the network".to_owned());
            }
        }
        Ok(())
    }
}

/// Returns the rate of column `name`; `None` for state that is not learned, and for a rate of 0.
fn column_rate(
    optimizer: &Optimizer,
    spec: Option<&ColumnSpec>,
    name: &str,
    rate_of: impl Fn(Schedule) -> Real,
) -> Option<Real> {
    let rate = match name {
        "means" => rate_of(optimizer.means),
        "log_scales" => rate_of(optimizer.log_scales),
        "quats" => rate_of(optimizer.quats),
        "opacity_logits" => rate_of(optimizer.opacity_logits),
        "signals" => rate_of(optimizer.signals),
        // Columns that no pruner requested belong to the method: further signals.
        _ => match spec {
            Some(spec) => spec.learning_rate?,
            None => rate_of(optimizer.signals),
        },
    };
    (rate != 0.0).then_some(rate)
}

/// Runs a step of gradient descent: x −= rate · d. Returns whether all values are finite.
fn descend(x: &mut [Real], d: &[Real], rate: Real) -> bool {
    x.iter_mut().zip(d).for_each(|(x, d)| *x -= rate * d);
    x.iter().all(|x| x.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn column_without_adam_uses_gradient_descent_times_n() {
        let mut cloud = GaussianCloud::zeros(3);
        let column = |values: &[Real]| pwrfgs_core::ExtraColumn { name: "m".into(), width: 1, values: values.to_vec() };
        cloud.extra.push(column(&[1.0, 2.0, 3.0]));
        let mut d_cloud = cloud.zeros_like();
        d_cloud.extra[0] = column(&[0.5, 0.0, -1.0]);
        let specs = [ColumnSpec { adam: false, ..ColumnSpec::learned("m", 0.0, 0.1) }];
        let (settings, mut adam) = (Training::default(), Adam::new(&cloud, &[]));
        for step in 1..=2 {
            adam.step_cloud(Rates { training: &settings, step }, &specs, &mut cloud, &d_cloud).unwrap();
        }
        let expected: [Real; 3] = [0.7, 2.0, 3.6];
        assert!(cloud.extra[0].values.iter().zip(expected).all(|(m, e)| (m - e).abs() < 1e-6), "{:?}", cloud.extra[0]);
    }

    #[test]
    fn weights_outside_groups_and_their_moments_keep_their_values() {
        let (mut weights, cloud) = (vec![1.0; 6], GaussianCloud::zeros(0));
        let mut adam = Adam::new(&cloud, &weights);
        let groups = [WeightGroup { range: 1..3, decays: true }, WeightGroup { range: 4..6, decays: false }];
        let mut training = Training::default();
        (training.optimizer.network, training.optimizer.network_decay) = (Schedule::Constant(0.5), 1.0);
        let rates = Rates { training: &training, step: 1 };
        adam.step_weights(rates, &groups, &mut weights, &[1.0, 0.0, 1.0, 1.0, 0.0, 1.0]).unwrap();
        let expected: [Real; 6] = [1.0, 0.5, 0.0, 1.0, 1.0, 0.5];
        assert!(weights.iter().zip(expected).all(|(w, e)| (w - e).abs() < 1e-6), "{weights:?}");
        let moved: Vec<usize> = (0..6).filter(|&i| adam.weights[0][i] != 0.0).collect();
        assert_eq!(moved, [2, 5]);
    }
}
