//! Adam optimizer: its moments survive clone, split and prune, and each column has its own rate.

use crate::settings::{Optimizer, Schedule, Training};
use pwrfgs_core::{ColumnSpec, GaussianCloud, Real, WeightGroup};
use rayon::prelude::*;

/// Decay rates of the first and the second moment, as in Kingma and Ba, 2015, and in all methods implemented here.
pub(crate) const BETAS: [Real; 2] = [0.9, 0.999];

/// Weights of dead units under L2 decay become 0 below this: it is under one unit in the last place of any weight above 2e-5.
const NEGLIGIBLE: Real = 1e-12;

/// First and second moments of all learned parameters.
#[derive(Clone, Debug)]
pub(crate) struct Adam {
    /// Moments of the cloud.
    pub(crate) cloud: [GaussianCloud; 2],
    /// Moments of the network.
    pub(crate) weights: [Vec<Real>; 2],
}

/// Constants of one update step.
#[derive(Clone, Copy)]
struct Update {
    rate: Real,
    eps: Real,
    /// Bias corrections 1 − βᵏ after k steps.
    unbias: [Real; 2],
    l2: Real,
    decay: Real,
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
    fn update_constants(self, rate: Real, eps: Real) -> Update {
        let unbias = BETAS.map(|b| 1.0 - b.powi(self.step.min(i32::MAX as u64) as i32));
        Update { rate, eps, unbias, l2: 0.0, decay: 0.0 }
    }
}

impl Adam {
    /// Creates moments of zero.
    pub(crate) fn new(cloud: &GaussianCloud, weights: &[Real]) -> Self {
        let zeros = cloud.zeros_like();
        Self { cloud: [zeros.clone(), zeros], weights: [vec![0.0; weights.len()], vec![0.0; weights.len()]] }
    }

    /// Updates the columns of the cloud.
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
        let (n, optimizer) = (cloud.len(), &rates.training.optimizer);
        let [first, second] = &mut self.cloud;
        let columns = cloud.columns_mut().zip(d_cloud.columns()).zip(first.columns_mut().zip(second.columns_mut()));
        for (((name, _, x), (_, _, d)), ((_, _, m), (_, _, v))) in columns {
            let spec = specs.iter().find(|spec| spec.name == name);
            let Some(rate) = column_rate(optimizer, spec, name, |schedule| rates.rate(schedule)) else { continue };
            let stepped = match spec {
                Some(spec) if !spec.adam => descend(x, d, rate * n as Real), // N as in `ColumnSpec::adam`
                _ => rates.update_constants(rate, optimizer.eps).apply(x, d, m, v),
            };
            stepped.map_err(|()| format!("`{name}`"))?;
        }
        Ok(())
    }

    /// Updates the learned weights of the network.
    ///
    /// # Errors
    /// A weight is no longer finite; the message is the name of the network.
    pub(crate) fn step_weights(
        &mut self,
        rates: Rates<'_>,
        groups: &[WeightGroup],
        weights: &mut [Real],
        d_weights: &[Real],
    ) -> Result<(), String> {
        let optimizer = &rates.training.optimizer;
        let warm = (rates.step as f64 / optimizer.network_warmup.max(1) as f64).min(1.0) as Real;
        let update = rates.update_constants(warm * rates.rate(optimizer.network), optimizer.network_eps);
        let decayed = Update { l2: optimizer.network_l2, decay: optimizer.network_decay, ..update };
        let [first, second] = &mut self.weights;
        for WeightGroup { range, decays } in groups {
            let range = || range.clone();
            let (x, m, v) = (&mut weights[range()], &mut first[range()], &mut second[range()]);
            (if *decays { decayed } else { update })
                .apply(x, &d_weights[range()], m, v)
                .map_err(|()| "the network".to_owned())?;
        }
        Ok(())
    }
}

/// Returns the rate of column `name`; `None` for state that is not learned, and for a rate of 0.
fn column_rate(
    optimizer: &Optimizer,
    spec: Option<&ColumnSpec>,
    name: &str,
    rate: impl Fn(Schedule) -> Real,
) -> Option<Real> {
    let rate = match name {
        "means" => rate(optimizer.means),
        "log_scales" => rate(optimizer.log_scales),
        "quats" => rate(optimizer.quats),
        "opacity_logits" => rate(optimizer.opacity_logits),
        "signals" => rate(optimizer.signals),
        // Columns that no pruner requested belong to the method: further signals.
        _ => match spec {
            Some(spec) => spec.learning_rate?,
            None => rate(optimizer.signals),
        },
    };
    (rate != 0.0).then_some(rate)
}

/// Runs a step of gradient descent: x −= rate · d. Returns an error if a value is no longer finite.
fn descend(x: &mut [Real], d: &[Real], rate: Real) -> Result<(), ()> {
    x.iter_mut().zip(d).for_each(|(x, d)| *x -= rate * d);
    if x.iter().all(|x| x.is_finite()) { Ok(()) } else { Err(()) }
}

impl Update {
    /// Runs a step of Adam on values x with gradients d and moments m and v. Returns an error if a value is no longer finite.
    fn apply(self, x: &mut [Real], d: &[Real], m: &mut [Real], v: &mut [Real]) -> Result<(), ()> {
        const CHUNK: usize = 16_384; // values per task
        let parts = (x.par_chunks_mut(CHUNK))
            .zip(d.par_chunks(CHUNK))
            .zip(m.par_chunks_mut(CHUNK))
            .zip(v.par_chunks_mut(CHUNK));
        let finite = parts
            .map(|(((x, d), m), v)| {
                pulp::Arch::new().dispatch(
                    #[inline(always)]
                    || self.apply_to_chunk(x, d, m, v),
                )
            })
            .reduce(|| true, |a, b| a && b);
        if finite { Ok(()) } else { Err(()) }
    }

    /// Updates some values by the rule of Kingma and Ba, with L2 decay added to the gradient and decoupled decay subtracted
    /// from the value. Returns whether all values are finite.
    ///
    /// Moments of weights without a gradient decay to subnormal numbers, which no longer change the weight but slow the
    /// processor down many times; they become 0. So do weights below [`NEGLIGIBLE`] under L2 decay, whose products with
    /// small activations are subnormal.
    #[inline(always)]
    fn apply_to_chunk(self, x: &mut [Real], d: &[Real], m: &mut [Real], v: &mut [Real]) -> bool {
        let [beta1, beta2] = BETAS;
        let mut finite = true;
        for (((x, d), m), v) in x.iter_mut().zip(d).zip(m).zip(v) {
            let g = d + self.l2 * *x;
            let first = beta1 * *m + (1.0 - beta1) * g;
            let second = beta2 * *v + (1.0 - beta2) * g * g;
            let is_idle = first.abs() < Real::MIN_POSITIVE;
            *m = if is_idle { 0.0 } else { first };
            *v = if is_idle && second < Real::MIN_POSITIVE { 0.0 } else { second };
            let step = (*m / self.unbias[0]) / ((*v / self.unbias[1]).sqrt() + self.eps);
            let next = *x - self.rate * (step + self.decay * *x);
            *x = if self.l2 > 0.0 && next.abs() < NEGLIGIBLE { 0.0 } else { next };
            finite &= x.is_finite();
        }
        finite
    }
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

    /// Three steps of PyTorch's Adam (lr 0.1, betas 0.9 and 0.999, eps 1e-8) from x = 1 with gradients 0.5, -1, 2.
    #[test]
    fn adam_matches_pytorch() {
        let update = |step: i32| Update {
            rate: 0.1,
            eps: 1e-8,
            unbias: [1.0 - (0.9 as Real).powi(step), 1.0 - (0.999 as Real).powi(step)],
            l2: 0.0,
            decay: 0.0,
        };
        let (mut x, mut m, mut v) = (vec![1.0], vec![0.0], vec![0.0]);
        // Computed by hand: m̂/√v̂ is 1, -0.36610, 0.41966.
        for (step, (gradient, expected)) in [(0.5, 0.9), (-1.0, 0.936_610), (2.0, 0.894_645)].into_iter().enumerate() {
            update(step as i32 + 1).apply(&mut x, &[gradient], &mut m, &mut v).unwrap();
            assert!((x[0] - expected as Real).abs() < 2e-5, "step {}: {} is not {expected}", step + 1, x[0]);
        }
    }

    #[test]
    fn decoupled_decay_shrinks_and_l2_enters_moments() {
        let quiet = Update { rate: 0.1, eps: 1e-8, unbias: [0.1, 0.001], l2: 0.0, decay: 0.5 };
        let (mut x, mut m, mut v) = (vec![2.0], vec![0.0], vec![0.0]);
        quiet.apply(&mut x, &[0.0], &mut m, &mut v).unwrap();
        assert!((x[0] - 1.9).abs() < 1e-6, "2 - 0.1·0.5·2, found {}", x[0]);
        let (mut x, mut m, mut v) = (vec![2.0], vec![0.0], vec![0.0]);
        Update { l2: 0.5, decay: 0.0, ..quiet }.apply(&mut x, &[0.0], &mut m, &mut v).unwrap();
        assert!((x[0] - 1.9).abs() < 1e-5, "Adam moves by the rate whatever the size of the gradient, found {}", x[0]);
    }

    /// Numbers below the smallest normal one are slow, and half the moments of a network of dead units end as such.
    #[test]
    fn moments_without_gradient_decay_to_zero() {
        let update = Update { rate: 0.1, eps: 1e-15, unbias: [1.0, 1.0], l2: 0.0, decay: 0.0 };
        let (mut x, mut m, mut v) = (vec![2.0, 1.0], vec![1e-3, 1e-3], vec![2.0 * Real::MIN_POSITIVE, 1.0]);
        for _ in 0..if size_of::<Real>() == 4 { 1_000 } else { 8_000 } {
            update.apply(&mut x, &[0.0; 2], &mut m, &mut v).unwrap();
        }
        assert!(m == [0.0; 2] && v[0] == 0.0 && v[1] > 0.0, "{m:?} {v:?}");
    }

    /// WRF-GS trains with L2 decay, and most weights of its first layers lose their gradient.
    #[test]
    fn weights_without_gradient_decay_to_zero_under_l2() {
        let update = Update { rate: 8e-4, eps: 1e-8, unbias: [1.0, 1.0], l2: 5e-5, decay: 0.0 };
        let (mut x, mut m, mut v) = (vec![1e-3, 1e-3], vec![0.0; 2], vec![0.0; 2]);
        for _ in 0..2_000 {
            update.apply(&mut x, &[0.0, 1e-3], &mut m, &mut v).unwrap();
        }
        assert!(x[0] == 0.0 && x[1] < -0.1, "{x:?}");
        let (mut x, mut m, mut v) = (vec![1e-20], vec![0.0], vec![0.0]);
        Update { l2: 0.0, ..update }.apply(&mut x, &[0.0], &mut m, &mut v).unwrap();
        assert_eq!(x, [1e-20], "without L2 no weight changes");
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

    #[test]
    fn gradient_that_is_not_finite_is_an_error() {
        let update = Update { rate: 0.1, eps: 1e-8, unbias: [0.1, 0.001], l2: 0.0, decay: 0.0 };
        assert!(update.apply(&mut [1.0], &[Real::NAN], &mut [0.0], &mut [0.0]).is_err());
    }
}
