//! `Near`: correlations of the transmitter with training positions, as features of [`crate::Factored`].

use crate::dense::{self, Matrix, MatrixMut, StoreMode, product};
use crate::linear::LayoutBuilder;
use pwrfgs_core::{Conditions, JsonSchema, Real, evenly};
use serde::{Deserialize, Serialize};

/// Correlations 6 exp(−|p − z| / length) of the transmitter p with training positions z.
///
/// The layers of the network learn what varies over the room. Correlations add what differs from one position to the
/// next, as Kriging does, and are 0 far from all training positions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Near {
    /// Maximum number of training positions; more are thinned evenly.
    pub count: usize,
    /// Distance at which a correlation is 1/e, metres; a few times the distance between training positions.
    pub length_m: f64,
}

/// Largest number of positions.
const MOST: usize = 65_536;
/// Correlations end at this multiple of the length, where they are 1e-7.
const END: Real = 16.0;
/// Factor on the correlations. Few of them act at a position; with the factor, a step of Adam on their weights moves a signal
/// by more than a step on the other layers.
const GAIN: Real = 6.0;
/// Coordinate of a position that is not used, metres; finite in 16 bits too.
const UNUSED: Real = 1e4;

impl Near {
    /// Rejects invalid settings.
    pub(super) fn check(&self) -> Result<(), String> {
        if !(1..=MOST).contains(&self.count) {
            return Err(format!("near: count is {}; give a number from 1 to {MOST}", self.count));
        }
        if !(self.length_m > 0.0 && self.length_m.is_finite()) {
            return Err(format!("near: length_m is {}; give metres above 0, such as 0.03", self.length_m));
        }
        Ok(())
    }

    /// Plans the positions `[count, 3]`, which do not learn, and the weights `[2 · count, waves]`, initially 0: channel by
    /// channel, see `channel_offset`.
    pub(super) fn plan_layer(&self, plan: &mut LayoutBuilder, waves: usize) -> NearLayer {
        let positions = plan.fixed("near.positions", vec![self.count, 3]);
        let weight = plan.zeros("near.weight", vec![2 * self.count, waves]);
        NearLayer { count: self.count, length: self.length_m as Real, positions, weight, waves }
    }
}

/// Positions and weights in the flat weight vector.
#[derive(Clone, Copy, Debug)]
pub(super) struct NearLayer {
    count: usize,
    length: Real,
    positions: usize,
    weight: usize,
    waves: usize,
}

impl NearLayer {
    /// Sets the positions of the layer to those of the training set, thinned evenly to `count`; those left over to
    /// [`UNUSED`].
    pub(super) fn set_positions(&self, training: &[[Real; 3]], weights: &mut [Real]) {
        let positions = weights[self.positions..][..3 * self.count].as_chunks_mut::<3>().0;
        positions.fill([UNUSED; 3]);
        positions.iter_mut().zip(evenly(training, self.count)).for_each(|(position, z)| *position = z);
    }

    /// Returns the positions of the layer in the flat vector.
    fn layer_positions<'a>(&self, weights: &'a [Real]) -> &'a [[Real; 3]] {
        weights[self.positions..][..3 * self.count].as_chunks::<3>().0
    }

    /// Returns the correlation of a transmitter with a position of the layer, times [`GAIN`]; 0 from [`END`] lengths on.
    fn correlation(&self, tx: &[Real; 3], z: &[Real; 3]) -> Real {
        let square: Real = (0..3).map(|k| (tx[k] - z[k]) * (tx[k] - z[k])).sum();
        if square < (END * self.length) * (END * self.length) {
            GAIN * (-square.sqrt() / self.length).exp()
        } else {
            0.0
        }
    }

    /// Returns the correlations `[count, B]`, times [`GAIN`].
    pub(super) fn correlations(&self, weights: &[Real], txs: Conditions<'_>) -> Vec<Real> {
        let batch = txs.len();
        let mut correlations = vec![0.0; self.count * batch];
        for (row, z) in correlations.chunks_exact_mut(batch.max(1)).zip(self.layer_positions(weights)) {
            for (value, p) in row.iter_mut().zip(txs.positions()) {
                *value = self.correlation(p, z);
            }
        }
        correlations
    }

    /// Adds the contributions of the correlations of the transmitter at `tx` to the wave coefficients `out`, `[waves]` per
    /// channel.
    pub(super) fn add_wave_coefficients(&self, weights: &[Real], tx: &[Real; 3], out: &mut [Vec<Real>; 2]) {
        let correlations = self.layer_positions(weights).iter().map(|z| self.correlation(tx, z)).enumerate();
        let correlations: Vec<(usize, Real)> = correlations.filter(|(_, value)| *value != 0.0).collect();
        for (c, out) in out.iter_mut().enumerate() {
            let table = &weights[self.channel_offset(c)..][..self.count * self.waves];
            let rows = correlations.iter().map(|&(k, value)| (value, &table[k * self.waves..][..self.waves]));
            dense::add_scaled_rows(out, &rows);
        }
    }

    /// Adds the derivatives of the weights of channel `c` to `d_weights`, given the result of [`Self::correlations`] and the
    /// cotangents `d_waves` `[waves, B]` of the wave coefficients.
    pub(super) fn weight_vjp(&self, c: usize, correlations: &[Real], d_waves: &[Real], d_weights: &mut [Real]) {
        let batch = correlations.len() / self.count;
        let d_table = &mut d_weights[self.channel_offset(c)..][..self.count * self.waves];
        let d_waves = Matrix::new(d_waves, self.waves, batch);
        let correlations = Matrix::new(correlations, self.count, batch);
        product(MatrixMut::new(d_table, self.count, self.waves), StoreMode::Add, correlations, d_waves.t());
    }

    /// Adds the derivatives by the transmitter positions to `d_txs`, given the same as [`Self::weight_vjp`]. That of a
    /// correlation is 0 at its position, where it has none, and from [`END`] lengths on.
    pub(super) fn position_vjp(
        &self,
        weights: &[Real],
        c: usize,
        txs: Conditions<'_>,
        correlations: &[Real],
        d_waves: &[Real],
        d_txs: &mut [[Real; 3]],
    ) {
        let batch = txs.len();
        let table = Matrix::new(&weights[self.channel_offset(c)..][..self.count * self.waves], self.count, self.waves);
        let mut d_correlations = vec![0.0; self.count * batch];
        let d_waves = Matrix::new(d_waves, self.waves, batch);
        product(MatrixMut::new(&mut d_correlations, self.count, batch), StoreMode::Set, table, d_waves);
        let rows = d_correlations.chunks_exact(batch).zip(correlations.chunks_exact(batch));
        let rows = rows.zip(self.layer_positions(weights));
        for ((d, values), z) in rows {
            for (((d, value), p), d_tx) in d.iter().zip(values).zip(txs.positions()).zip(d_txs.iter_mut()) {
                let offset: [Real; 3] = std::array::from_fn(|k| p[k] - z[k]);
                let distance = offset.iter().map(|v| v * v).sum::<Real>().sqrt();
                if *value > 0.0 && distance > 0.0 {
                    let slope = -d * value / (self.length * distance);
                    d_tx.iter_mut().zip(offset).for_each(|(sum, v)| *sum += slope * v);
                }
            }
        }
    }

    /// Returns the offset of the weights of channel `c` in the flat vector.
    fn channel_offset(&self, c: usize) -> usize {
        self.weight + c * self.count * self.waves
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linear::lay_out;

    #[test]
    fn correlations_fall_with_distance_and_unused_positions_have_none() {
        let (layer, plan) = lay_out(|plan| Near { count: 3, length_m: 0.1 }.plan_layer(plan, 4));
        let mut weights = vec![0.0; plan.weight_count()];
        layer.set_positions(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], &mut weights);
        let txs = [[0.0, 0.3, 0.4], [1.0, 0.0, 0.1], [9.0, 0.0, 0.0]];
        let computed = layer.correlations(&weights, Conditions::from(&txs[..]));
        let expected = [(-5.0 as Real).exp(), (-(1.01 as Real).sqrt() / 0.1).exp(), 0.0];
        for (computed, expected) in computed[..3].iter().zip(expected) {
            assert!((computed - GAIN * expected).abs() < 1e-6, "{computed} instead of {GAIN} times {expected}");
        }
        assert!((computed[4] - GAIN * (-1.0 as Real).exp()).abs() < 1e-5);
        assert_eq!(computed[6..], [0.0; 3]);
        assert_eq!(plan.layout().groups()[0].range.start, 9, "positions do not learn");
    }

    #[test]
    fn correlation_has_no_derivative_at_its_position() {
        let (layer, plan) = lay_out(|plan| Near { count: 1, length_m: 0.1 }.plan_layer(plan, 1));
        let mut weights = vec![1.0; plan.weight_count()];
        layer.set_positions(&[[0.5, 0.0, 0.0]], &mut weights);
        let (txs, mut d_txs) = ([[0.5, 0.0, 0.0], [9.0, 0.0, 0.0]], [[0.0; 3]; 2]);
        let correlations = layer.correlations(&weights, Conditions::from(&txs));
        layer.position_vjp(&weights, 0, Conditions::from(&txs), &correlations, &[1.0; 2], &mut d_txs);
        assert_eq!(d_txs, [[0.0; 3]; 2]);
    }

    #[test]
    fn more_training_positions_are_thinned() {
        let (layer, plan) = lay_out(|plan| Near { count: 2, length_m: 0.1 }.plan_layer(plan, 1));
        let mut weights = vec![0.0; plan.weight_count()];
        layer.set_positions(&(0..10).map(|i| [i as Real, 0.0, 0.0]).collect::<Vec<_>>(), &mut weights);
        assert!(weights[..6].iter().all(|x| *x < 10.0) && weights[0] != weights[3]);
        assert_eq!(weights[6..], [0.0; 4]);
    }
}
