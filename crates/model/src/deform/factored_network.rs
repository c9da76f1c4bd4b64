//! Forward and backward of [`super::Factored`].
//!
//! ```text
//! (features of the data → tx.white →)
//! γ(p) → tx.0 … tx.{depth-1}, each with ReLU → T ─┐ (once a transmitter)
//! φ(μ) → branch → factors G, constants G₀ ────────┴→ s = G·T + G₀
//! ```

use super::dense::{self, Matrix, MatrixMut, Store, product};
use super::encoding::encode_vjp;
use super::factored::Factored;
use super::layers::Plan;
use super::linear::Linear;
use super::waves::{Encoder, Encoding};
use pwrfgs_core::{Conditions, DeformationInputs, Deltas, LinearPart, Real};
use rayon::prelude::*;

/// Mean magnitude of a sine.
const WAVE_MEAN: f64 = std::f64::consts::FRAC_2_PI;

/// Transmitters that share one pass of the derivative. Depends on nothing, so that threads do not show in the bits.
const GROUP: usize = 32;

/// The layers in the flat weight vector.
pub(super) struct Network {
    tx_encoding: Encoder,
    position_encoding: Encoder,
    /// Makes a position of features of the data, where that is asked for.
    pseudo: Option<Pseudo>,
    /// Makes features of the data uncorrelated; nothing of a position.
    pub(super) white: Option<Linear>,
    pub(super) stack: Vec<Linear>,
    pub(super) branch: Linear,
    /// Numbers of T.
    features: usize,
    /// Of these the last ones, which are the transmitter's own numbers; none of a position.
    direct: usize,
}

/// The Gaussians' side: waves and factors, feature-major `[·, N]`.
pub(super) struct Factors {
    /// φ(μ), scaled; see [`Network::wave_scale`].
    waves: Vec<Real>,
    /// Rows 0 to F: real part, then G₀; the same again for the imaginary part.
    rows: Vec<Real>,
    n: usize,
}

/// Features of the data as a position: 2 tanh of a layer.
struct Pseudo {
    layer: Linear,
    gain: Real,
    octaves: usize,
}

impl Pseudo {
    /// Features `[width, B]`, times the gain.
    fn inputs(&self, txs: Conditions<'_>) -> Vec<Real> {
        let (rows, width) = (txs.len(), self.layer.inputs);
        let value = |i: usize| txs.values()[(i % rows) * width + i / rows] * self.gain;
        (0..rows * width).map(value).collect()
    }

    fn positions(&self, weights: &[Real], txs: Conditions<'_>) -> Vec<[Real; 3]> {
        let rows = txs.len();
        let mut y = vec![0.0; 3 * rows];
        self.layer.whole().apply(weights, &self.inputs(txs), &mut y, Store::Set);
        dense::add_bias(&mut y, self.layer.bias(weights));
        (0..rows).map(|r| std::array::from_fn(|k| 2.0 * y[k * rows + r].tanh())).collect()
    }

    /// Adds to `d_weights`, given the encoding γ and its cotangent.
    fn vjp(&self, weights: &[Real], txs: Conditions<'_>, (gamma, d_gamma): (&[Real], &[Real]), d_weights: &mut [Real]) {
        let (rows, positions) = (txs.len(), self.positions(weights, txs));
        let mut d_positions = vec![[0.0; 3]; rows];
        encode_vjp(gamma, d_gamma, self.octaves, &mut d_positions);
        let slope = |k: usize, r: usize| d_positions[r][k] * 2.0 * (1.0 - (positions[r][k] / 2.0).powi(2));
        let d_y: Vec<Real> = (0..3 * rows).map(|i| slope(i / rows, i % rows)).collect();
        dense::add_bias_vjp(&d_y, self.layer.bias_mut(d_weights));
        self.layer.whole().weight_vjp(d_weights, &self.inputs(txs), &d_y);
    }
}

impl Factors {
    /// G of channel `c`, `[F, N]`, and G₀ `[N]`.
    fn channel(&self, c: usize) -> (&[Real], &[Real]) {
        let rows = self.rows.len() / self.n.max(1) / 2;
        let own = &self.rows[c * rows * self.n..(c + 1) * rows * self.n];
        own.split_at(own.len() - self.n)
    }
}

impl Network {
    pub(super) fn new(settings: &Factored, plan: &mut Plan) -> Self {
        let width = settings.width;
        let tx_encoding = settings.tx_encoding.encoder();
        let own = settings.tx_encoding.width();
        let inputs = |l| if l == 0 { own } else { width };
        let pseudo = match settings.tx_encoding {
            Encoding::PseudoPosition { width, gain, octaves } => {
                Some(Pseudo { layer: plan.linear("tx.pseudo", width, 3), gain: gain as Real, octaves })
            }
            _ => None,
        };
        let white = matches!(tx_encoding, Encoder::Features(..))
            .then(|| plan.unbiased("tx.white", own, own, (3.0 / own as f64).sqrt()));
        let stack = (0..settings.depth).map(|l| plan.relu(&format!("tx.{l}"), inputs(l), width)).collect();
        let waves = settings.position_encoding.width() - 3;
        // Signals begin about as large as one feature: factors have the variance 1/width.
        let bound = WAVE_MEAN * (6.0 * waves as f64 / width as f64).sqrt();
        let direct = if white.is_some() { own } else { 0 };
        let features = width + direct;
        let branch = plan.unbiased("branch", waves, 2 * (features + 1), bound);
        let position_encoding = settings.position_encoding.encoder();
        Self { tx_encoding, position_encoding, pseudo, white, stack, branch, features, direct }
    }

    pub(super) fn factors(&self, weights: &[Real], means: &[[Real; 3]]) -> Factors {
        let n = means.len();
        let mut gamma = vec![0.0; n * (3 + self.branch.inputs)];
        self.position_encoding.encode(means, &mut gamma);
        let mut waves = gamma.split_off(3 * n);
        waves.iter_mut().for_each(|w| *w *= self.wave_scale());
        let mut rows = vec![0.0; n * self.branch.outputs];
        self.branch.whole().apply(weights, &waves, &mut rows, Store::Set);
        dense::add_bias(&mut rows, self.branch.bias(weights));
        Factors { waves, rows, n }
    }

    /// The direct part: T's last numbers are the transmitter's own, and a Gaussian's factors for them linear in its waves.
    pub(super) fn linear_part(&self, weights: &[Real], means: &[[Real; 3]], txs: Conditions<'_>) -> Option<LinearPart> {
        let (inputs, n, rows) = (self.direct, means.len(), txs.len());
        if inputs == 0 || n == 0 || rows == 0 {
            return None;
        }
        let own = self.stack(weights, txs).swap_remove(0); // [inputs, rows]
        let values = (0..rows * inputs).map(|i| own[(i % inputs) * rows + i / inputs]).collect();
        let (waves, functions) = (self.factors(weights, means).waves, self.branch.inputs);
        let basis = (0..n * functions).map(|i| waves[(i % functions) * n + i / functions]).collect();
        let at =
            |channel: usize| self.branch.weight + (channel * (self.features + 1) + self.features - inputs) * functions;
        let cleared = self.branch.weight..self.branch.bias + self.branch.outputs;
        Some(LinearPart { inputs, values, functions, basis, cleared, first: [at(0), at(1)] })
    }

    /// The magnitudes of a Gaussian's waves sum to 1: a step of Adam on `branch` then moves factors as far as a step on
    /// the stack moves weights, and not many times as far.
    fn wave_scale(&self) -> Real {
        (1.0 / (WAVE_MEAN * self.branch.inputs as f64)) as Real
    }

    /// γ(p) and every layer's output, feature-major `[·, B]`; the last is T.
    fn stack(&self, weights: &[Real], txs: Conditions<'_>) -> Vec<Vec<Real>> {
        let mut layers = vec![vec![0.0; txs.len() * self.stack[0].inputs]];
        match &self.pseudo {
            Some(pseudo) => self.tx_encoding.encode(&pseudo.positions(weights, txs), &mut layers[0]),
            None => self.tx_encoding.encode_all(txs, &mut layers[0]),
        }
        if let Some(white) = &self.white {
            let mut x = vec![0.0; layers[0].len()];
            white.whole().apply(weights, &layers[0], &mut x, Store::Set);
            dense::add_bias(&mut x, white.bias(weights));
            layers[0] = x;
        }
        for (l, layer) in self.stack.iter().enumerate() {
            let mut h = vec![0.0; txs.len() * layer.outputs];
            layer.whole().apply(weights, &layers[l], &mut h, Store::Set);
            dense::bias_relu(&mut h, layer.bias(weights));
            layers.push(h);
        }
        if self.direct > 0 {
            let own = layers[0].clone();
            layers.last_mut().expect("a layer or more").extend(own);
        }
        layers
    }

    /// One transmitter at a time: a batch then gives the bits of single calls.
    pub(super) fn forward(&self, weights: &[Real], g: &Factors, txs: Conditions<'_>) -> Deltas {
        let n = g.n;
        let mut signals = vec![[0.0; 2]; txs.len() * n];
        if signals.is_empty() {
            return Deltas { signals, ..Deltas::default() };
        }
        signals.par_chunks_exact_mut(n).enumerate().for_each(|(b, signals)| {
            let layers = self.stack(weights, txs.rows(b..b + 1));
            let t = Matrix::new(&layers[self.stack.len()], self.features, 1);
            for c in 0..2 {
                let (factors, base) = g.channel(c);
                let mut s = base.to_vec();
                product(MatrixMut::new(&mut s, n, 1), Store::Add, Matrix::new(factors, self.features, n).t(), t);
                signals.iter_mut().zip(s).for_each(|(signal, s)| signal[c] = s);
            }
        });
        Deltas { signals, ..Deltas::default() }
    }

    pub(super) fn vjp(
        &self,
        inputs: &DeformationInputs<'_>,
        d: &Deltas,
        d_weights: &mut [Real],
        d_means: Option<&mut [[Real; 3]]>,
    ) {
        let DeformationInputs { weights, means, txs, .. } = *inputs;
        let n = means.len();
        if n == 0 || txs.is_empty() {
            return;
        }
        let g = self.factors(weights, means);
        let groups = d.signals.par_chunks(GROUP * n).enumerate();
        let group = |(k, d_signals): (usize, &[[Real; 2]])| {
            let some = txs.rows(k * GROUP..k * GROUP + d_signals.len() / n);
            self.group_vjp(weights, &g, some, d_signals)
        };
        let sums: Vec<(Vec<Real>, Vec<Real>)> = groups.map(group).collect();
        dense::add_in_order(d_weights, &sums.iter().map(|s| s.0.as_slice()).collect::<Vec<_>>());
        let mut d_factors = vec![0.0; g.rows.len()];
        dense::add_in_order(&mut d_factors, &sums.iter().map(|s| s.1.as_slice()).collect::<Vec<_>>());
        self.branch_vjp(weights, &g, &d_factors, d_weights, d_means);
    }

    /// Derivatives of the weights and of the factors, from some transmitters.
    fn group_vjp(&self, weights: &[Real], g: &Factors, txs: Conditions<'_>, d: &[[Real; 2]]) -> (Vec<Real>, Vec<Real>) {
        let (n, batch, width) = (g.n, txs.len(), self.features);
        let layers = self.stack(weights, txs);
        let (mut d_weights, mut d_factors) = (vec![0.0; weights.len()], vec![0.0; g.rows.len()]);
        let mut d_h = vec![0.0; width * batch];
        let rows = d_factors.len() / 2;
        for (c, d_factors) in d_factors.chunks_exact_mut(rows).enumerate() {
            // Signals of one channel: element (b, i) lies at 2(bN + i) + c.
            let d_s = Matrix::strided(&d.as_flattened()[c..], (batch, n), (2 * n, 2));
            let (d_f, d_base) = d_factors.split_at_mut(rows - n);
            let t = Matrix::new(&layers[self.stack.len()], width, batch);
            product(MatrixMut::new(d_f, width, n), Store::Set, t, d_s);
            for d in d.chunks_exact(n) {
                d_base.iter_mut().zip(d).for_each(|(sum, d)| *sum += d[c]);
            }
            let factors = Matrix::new(g.channel(c).0, width, n);
            product(MatrixMut::new(&mut d_h, width, batch), Store::Add, factors, d_s.t());
        }
        let mut d_own = d_h.split_off((width - self.direct) * batch);
        for (l, layer) in self.stack.iter().enumerate().rev() {
            dense::bias_relu_vjp(&mut d_h, &layers[l + 1][..layer.outputs * batch], layer.bias_mut(&mut d_weights));
            layer.whole().weight_vjp(&mut d_weights, &layers[l], &d_h);
            if l == 0 && self.direct > 0 {
                layer.whole().input_vjp(weights, &d_h, &mut d_own, Store::Add);
            }
            if let (0, Some(pseudo)) = (l, &self.pseudo) {
                let mut d_gamma = vec![0.0; layer.inputs * batch];
                layer.whole().input_vjp(weights, &d_h, &mut d_gamma, Store::Set);
                pseudo.vjp(weights, txs, (&layers[0], &d_gamma), &mut d_weights);
            }
            if l > 0 {
                let mut d_x = vec![0.0; layer.inputs * batch];
                layer.whole().input_vjp(weights, &d_h, &mut d_x, Store::Set);
                d_h = d_x;
            }
        }
        if let Some(white) = &self.white {
            let mut raw = vec![0.0; batch * white.inputs];
            self.tx_encoding.encode_all(txs, &mut raw);
            dense::add_bias_vjp(&d_own, white.bias_mut(&mut d_weights));
            white.whole().weight_vjp(&mut d_weights, &raw, &d_own);
        }
        (d_weights, d_factors)
    }

    /// Back through the Gaussians' side.
    fn branch_vjp(
        &self,
        weights: &[Real],
        g: &Factors,
        d_factors: &[Real],
        d_weights: &mut [Real],
        d_means: Option<&mut [[Real; 3]]>,
    ) {
        dense::add_bias_vjp(d_factors, self.branch.bias_mut(d_weights));
        self.branch.whole().weight_vjp(d_weights, &g.waves, d_factors);
        if let Some(d_means) = d_means {
            let mut d_waves = vec![0.0; g.waves.len()];
            self.branch.whole().input_vjp(weights, d_factors, &mut d_waves, Store::Set);
            // Waves were scaled: so are their slopes, and the encoding's own derivative wants neither.
            let scale = self.wave_scale();
            let unscaled: Vec<Real> = g.waves.iter().map(|w| w / scale).collect();
            d_waves.iter_mut().for_each(|d| *d *= scale);
            self.position_encoding.waves_vjp(&unscaled, &d_waves, d_means);
        }
    }
}
