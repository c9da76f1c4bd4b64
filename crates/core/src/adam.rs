//! `AdamUpdate`: the rule by which Adam changes values, given their derivatives and moments.

use crate::Real;
use rayon::prelude::*;

/// Constants of an update step of Adam.
#[derive(Clone, Copy, Debug)]
pub struct AdamUpdate {
    /// Learning rate.
    pub rate: Real,
    /// Addend in the denominator.
    pub eps: Real,
    /// Bias corrections 1 − βᵏ after k steps.
    pub unbias: [Real; 2],
    /// Decay that is added to the gradient.
    pub l2: Real,
    /// Decoupled decay.
    pub decay: Real,
}

impl AdamUpdate {
    /// Decay rates of the first and the second moment, as in Kingma and Ba, 2015, and in all methods implemented here.
    pub const BETAS: [Real; 2] = [0.9, 0.999];

    /// Weights of dead units under L2 decay become 0 below this: it is under one unit in the last place of any weight above
    /// 2e-5.
    pub const NEGLIGIBLE: Real = 1e-12;

    /// Runs a step of Adam on values x with gradients d and moments m and v, all of one length. Returns whether all new
    /// values are finite.
    #[must_use]
    pub fn apply(self, x: &mut [Real], d: &[Real], m: &mut [Real], v: &mut [Real]) -> bool {
        const CHUNK: usize = 16_384; // values per task
        let parts = (x.par_chunks_mut(CHUNK))
            .zip(d.par_chunks(CHUNK))
            .zip(m.par_chunks_mut(CHUNK))
            .zip(v.par_chunks_mut(CHUNK));
        parts
            .map(|(((x, d), m), v)| {
                pulp::Arch::new().dispatch(
                    #[inline(always)]
                    || self.apply_to_chunk(x, d, m, v),
                )
            })
            .reduce(|| true, |a, b| a && b)
    }

    /// Updates some values by the rule of Kingma and Ba, with L2 decay added to the gradient and decoupled decay subtracted
    /// from the value. Returns whether all values are finite.
    ///
    /// Moments of weights without a gradient decay to subnormal numbers, which no longer change the weight but slow the
    /// processor down many times; they become 0. So do weights below [`Self::NEGLIGIBLE`] under L2 decay, whose products with
    /// small activations are subnormal.
    #[inline(always)]
    fn apply_to_chunk(self, x: &mut [Real], d: &[Real], m: &mut [Real], v: &mut [Real]) -> bool {
        let [beta1, beta2] = Self::BETAS;
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
            *x = if self.l2 > 0.0 && next.abs() < Self::NEGLIGIBLE { 0.0 } else { next };
            finite &= x.is_finite();
        }
        finite
    }
}

#[cfg(test)]
mod tests {
    use super::AdamUpdate as Update;
    use crate::Real;

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
            assert!(update(step as i32 + 1).apply(&mut x, &[gradient], &mut m, &mut v));
            assert!((x[0] - expected as Real).abs() < 2e-5, "step {}: {} is not {expected}", step + 1, x[0]);
        }
    }

    #[test]
    fn decoupled_decay_shrinks_and_l2_enters_moments() {
        let quiet = Update { rate: 0.1, eps: 1e-8, unbias: [0.1, 0.001], l2: 0.0, decay: 0.5 };
        let (mut x, mut m, mut v) = (vec![2.0], vec![0.0], vec![0.0]);
        assert!(quiet.apply(&mut x, &[0.0], &mut m, &mut v));
        assert!((x[0] - 1.9).abs() < 1e-6, "2 - 0.1·0.5·2, found {}", x[0]);
        let (mut x, mut m, mut v) = (vec![2.0], vec![0.0], vec![0.0]);
        assert!(Update { l2: 0.5, decay: 0.0, ..quiet }.apply(&mut x, &[0.0], &mut m, &mut v));
        assert!((x[0] - 1.9).abs() < 1e-5, "Adam moves by the rate whatever the size of the gradient, found {}", x[0]);
    }

    /// Numbers below the smallest normal one are slow, and half the moments of a network of dead units end as such.
    #[test]
    fn moments_without_gradient_decay_to_zero() {
        let update = Update { rate: 0.1, eps: 1e-15, unbias: [1.0, 1.0], l2: 0.0, decay: 0.0 };
        let (mut x, mut m, mut v) = (vec![2.0, 1.0], vec![1e-3, 1e-3], vec![2.0 * Real::MIN_POSITIVE, 1.0]);
        for _ in 0..if size_of::<Real>() == 4 { 1_000 } else { 8_000 } {
            assert!(update.apply(&mut x, &[0.0; 2], &mut m, &mut v));
        }
        assert!(m == [0.0; 2] && v[0] == 0.0 && v[1] > 0.0, "{m:?} {v:?}");
    }

    /// WRF-GS trains with L2 decay, and most weights of its first layers lose their gradient.
    #[test]
    fn weights_without_gradient_decay_to_zero_under_l2() {
        let update = Update { rate: 8e-4, eps: 1e-8, unbias: [1.0, 1.0], l2: 5e-5, decay: 0.0 };
        let (mut x, mut m, mut v) = (vec![1e-3, 1e-3], vec![0.0; 2], vec![0.0; 2]);
        for _ in 0..2_000 {
            assert!(update.apply(&mut x, &[0.0, 1e-3], &mut m, &mut v));
        }
        assert!(x[0] == 0.0 && x[1] < -0.1, "{x:?}");
        let (mut x, mut m, mut v) = (vec![1e-20], vec![0.0], vec![0.0]);
        assert!(Update { l2: 0.0, ..update }.apply(&mut x, &[0.0], &mut m, &mut v));
        assert_eq!(x, [1e-20], "without L2 no weight changes");
    }

    #[test]
    fn gradient_that_is_not_finite_is_an_error() {
        let update = Update { rate: 0.1, eps: 1e-8, unbias: [0.1, 0.001], l2: 0.0, decay: 0.0 };
        assert!(!update.apply(&mut [1.0], &[Real::NAN], &mut [0.0], &mut [0.0]));
    }
}
