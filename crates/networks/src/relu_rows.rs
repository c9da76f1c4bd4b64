//! `ReluRows`: one layer for several transmitters, whose results do not depend on each other.

use pwrfgs_core::{Lanes, Real};

/// Layer y = relu(W·x + b) for transmitters in rows: x `[B, inputs]`, y `[B, outputs]`. A row of y does not depend, to the
/// bit, on the other transmitters, unlike a [`product`](crate::dense::product); the weights are read once for all of them.
pub(crate) struct ReluRows<'a> {
    /// W `[outputs, inputs]`.
    pub(crate) weights: &'a [Real],
    /// b `[outputs]`.
    pub(crate) bias: &'a [Real],
    /// x.
    pub(crate) x: &'a [Real],
    /// y.
    pub(crate) y: &'a mut [Real],
}

impl ReluRows<'_> {
    /// Computes M outputs, from `output` on, of N transmitters, from `tx` on.
    #[inline(always)]
    fn block<S: pulp::Simd, const M: usize, const N: usize>(&mut self, simd: S, output: usize, tx: usize) {
        let outputs = self.bias.len();
        let inputs = self.weights.len() / outputs;
        let (mut a, mut b): ([&[Real]; M], [&[Real]; N]) = ([&[]; M], [&[]; N]);
        for i in 0..M {
            a[i] = &self.weights[(output + i) * inputs..][..inputs];
        }
        for j in 0..N {
            b[j] = &self.x[(tx + j) * inputs..][..inputs];
        }
        let sums = Real::dots(simd, a, b);
        for i in 0..M {
            for j in 0..N {
                let z = sums[i][j] + self.bias[output + i];
                self.y[(tx + j) * outputs + output + i] = if z < 0.0 { 0.0 } else { z }; // NaN stays NaN
            }
        }
    }

    /// Computes M outputs, from `output` on, of all transmitters, three at a time. The sums of a block, up to 4 × 3, then stay
    /// in registers.
    #[inline(always)]
    fn all_transmitters<S: pulp::Simd, const M: usize>(&mut self, simd: S, output: usize) {
        let (txs, mut tx) = (self.y.len() / self.bias.len(), 0);
        while tx + 3 <= txs {
            self.block::<S, M, 3>(simd, output, tx);
            tx += 3;
        }
        while tx < txs {
            self.block::<S, M, 1>(simd, output, tx);
            tx += 1;
        }
    }
}

impl pulp::WithSimd for ReluRows<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(mut self, simd: S) {
        let (outputs, mut output) = (self.bias.len(), 0);
        while output + 4 <= outputs {
            self.all_transmitters::<S, 4>(simd, output);
            output += 4;
        }
        while output < outputs {
            self.all_transmitters::<S, 1>(simd, output);
            output += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{rng, widest};

    #[test]
    fn rows_of_a_layer_are_right_and_independent_of_each_other() {
        let mut random = rng::stream(7, "rows", 0);
        let mut numbers = |count: usize| -> Vec<Real> { (0..count).map(|_| rng::normal(&mut random)).collect() };
        for (inputs, outputs, txs) in [(1, 1, 1), (3, 5, 2), (16, 4, 3), (37, 9, 5), (130, 6, 7)] {
            let (weights, bias, x) = (numbers(inputs * outputs), numbers(outputs), numbers(inputs * txs));
            let run = |x: &[Real]| {
                let mut y = vec![0.0; x.len() / inputs * outputs];
                widest(ReluRows { weights: &weights, bias: &bias, x, y: &mut y });
                y
            };
            let all = run(&x);
            for (x, y) in x.chunks_exact(inputs).zip(all.chunks_exact(outputs)) {
                assert_eq!(run(x), y, "{inputs}, {outputs}, {txs}");
                for ((w, b), y) in weights.chunks_exact(inputs).zip(&bias).zip(y) {
                    let z = f64::from(*b) + w.iter().zip(x).map(|(w, x)| f64::from(*w) * f64::from(*x)).sum::<f64>();
                    assert!((z.max(0.0) - f64::from(*y)).abs() < 1e-5 * (1.0 + inputs as f64), "{z} {y}");
                }
            }
        }
        let mut y = [0.0];
        widest(ReluRows { weights: &[Real::NAN], bias: &[0.0], x: &[1.0], y: &mut y });
        assert!(y[0].is_nan());
    }
}
