//! `Factored`: signals as products of what depends on the transmitter and what depends on the Gaussian.

use super::dense::{self, Matrix, MatrixMut, Store, product};
use super::encoding::{self, encode, encode_vjp};
use super::layers::Plan;
use super::linear::Linear;
use super::mlp::{WIDEST, check_frequencies, check_stack};
use super::waves::{Encoder, TxEncoding};
use pwrfgs_core::{Deformation, DeformationInputs, Deltas, Pose, Real, WeightSpec, rng::Rng};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// A network that runs once a transmitter and not once a Gaussian: `Δsᵢ(p) = G(μᵢ)·T(p) + G₀(μᵢ)`.
///
/// A stack of ReLU layers makes `width` features T of the transmitter's encoded position γ(p); a small network, γ(μ) →
/// `branch` ReLU → heads, makes each Gaussian's factors G, two rows (real and imaginary part) of `width` + 1 numbers.
/// A signal is then a scalar product. The cost of a prediction is that of one pass through the stack, whatever N is, and
/// sixteen Gaussians on a 4 x 4 array can follow all that the network knows of the transmitter: the shape for
/// `ArrayResponse`. Geometry does not depend on the transmitter. Known elsewhere as branch and trunk (`DeepONet`).
///
/// | field | meaning | default |
/// |---|---|---|
/// | `depth`, `width` | ReLU layers of the transmitter's stack, numbers a layer | 4, 256 |
/// | `tx_encoding` | γ(p): `Octaves(5)`, or `Waves(count: 64, reach: 24.0)`; see [`TxEncoding`] | `Octaves(5)` |
/// | `position_frequencies` | the same in γ(μ) | 4 |
/// | `branch` | hidden numbers on the Gaussian's side | 32 |
///
/// Centres are differentiated through the network.
///
/// ```
/// use pwrfgs_core::{Deformation, Plugin};
/// # use pwrfgs_model as _;
/// let small = Plugin::<dyn Deformation>::parse("Factored(depth: 3, width: 128, tx_encoding: Waves(count: 64, reach: 24.0))").unwrap();
/// assert!(!small.varies_geometry());
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Factored {
    /// ReLU layers of the transmitter's stack, 1 or more.
    pub depth: usize,
    /// Numbers a layer, and features.
    pub width: usize,
    /// How the transmitter's position is encoded.
    pub tx_encoding: TxEncoding,
    /// Frequencies in the encoding of the centre.
    pub position_frequencies: usize,
    /// Hidden numbers on the Gaussian's side.
    pub branch: usize,
}

impl Default for Factored {
    fn default() -> Self {
        Self { depth: 4, width: 256, tx_encoding: TxEncoding::default(), position_frequencies: 4, branch: 32 }
    }
}

#[typetag::serde]
impl Deformation for Factored {
    fn layout(&self) -> Vec<WeightSpec> {
        let mut plan = Plan::default();
        Network::new(self, &mut plan);
        plan.layout()
    }

    fn init(&self, rng: &mut Rng) -> Vec<Real> {
        let mut plan = Plan::default();
        Network::new(self, &mut plan);
        plan.init(rng)
    }

    fn varies_geometry(&self) -> bool {
        false
    }

    fn forward(&self, weights: &[Real], means: &[[Real; 3]], txs: &[[Real; 3]], _: &Pose) -> Deltas {
        Network::of(self, weights).forward(weights, means, txs)
    }

    fn vjp(
        &self,
        inputs: &DeformationInputs<'_>,
        d: &Deltas,
        d_weights: &mut [Real],
        d_means: Option<&mut [[Real; 3]]>,
    ) {
        Network::of(self, inputs.weights).vjp(inputs, d, d_weights, d_means);
    }

    fn frequency_window(&self, share: f64) -> Option<Vec<Real>> {
        let mut plan = Plan::default();
        let network = Network::new(self, &mut plan);
        let mut factors = vec![1.0; plan.len()];
        network.stack[0].dim(&mut factors, 0, &self.tx_encoding.window(share));
        network.branch[0].dim(&mut factors, 0, &encoding::window(self.position_frequencies, share));
        Some(factors)
    }

    fn about(&self) -> &'static str {
        "signals as products of features of the transmitter and of the Gaussian: one small network, whatever N is"
    }

    fn check(&self) -> Result<(), String> {
        check_stack(self.depth, self.width, None)?;
        if !(1..=WIDEST).contains(&self.branch) {
            return Err(format!("branch is {}; give a number from 1 to {WIDEST}", self.branch));
        }
        self.tx_encoding.check()?;
        check_frequencies("position_frequencies", self.position_frequencies)
    }
}

/// Transmitters that share one pass of the derivative. Depends on nothing, so that threads do not show in the bits.
const GROUP: usize = 32;

/// The layers in the flat weight vector.
struct Network {
    tx_encoding: Encoder,
    position_frequencies: usize,
    stack: Vec<Linear>,
    branch: [Linear; 2],
    /// Numbers of T.
    features: usize,
}

/// The Gaussians' side: γ(μ), hidden numbers and factors, all feature-major `[·, N]`.
struct Factors {
    gamma: Vec<Real>,
    hidden: Vec<Real>,
    /// Rows 0 to F: real part, then G₀; the same again for the imaginary part.
    rows: Vec<Real>,
    n: usize,
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
    fn new(settings: &Factored, plan: &mut Plan) -> Self {
        let (width, branch) = (settings.width, settings.branch);
        let tx_encoding = settings.tx_encoding.encoder();
        let inputs = |l| if l == 0 { settings.tx_encoding.width() } else { width };
        let stack = (0..settings.depth).map(|l| plan.relu(&format!("tx.{l}"), inputs(l), width)).collect();
        // Signals begin about as large as one feature.
        let size = (3.0 / width as f64).sqrt();
        let branch = [
            plan.relu("branch.0", encoding::width(settings.position_frequencies), branch),
            plan.heads(&[("branch.1", 2 * (width + 1))], branch, size),
        ];
        Self { tx_encoding, position_frequencies: settings.position_frequencies, stack, branch, features: width }
    }

    fn of(settings: &Factored, weights: &[Real]) -> Self {
        let mut plan = Plan::default();
        let network = Self::new(settings, &mut plan);
        assert_eq!(weights.len(), plan.len(), "as many weights as the layout says");
        network
    }

    fn factors(&self, weights: &[Real], means: &[[Real; 3]]) -> Factors {
        let n = means.len();
        let [first, second] = &self.branch;
        let mut gamma = vec![0.0; n * first.inputs];
        encode(means.iter().copied(), self.position_frequencies, &mut gamma);
        let mut hidden = vec![0.0; n * first.outputs];
        first.whole().apply(weights, &gamma, &mut hidden, Store::Set);
        dense::bias_relu(&mut hidden, first.bias(weights));
        let mut factors = vec![0.0; n * second.outputs];
        second.whole().apply(weights, &hidden, &mut factors, Store::Set);
        dense::add_bias(&mut factors, second.bias(weights));
        Factors { gamma, hidden, rows: factors, n }
    }

    /// γ(p) and every layer's output, feature-major `[·, B]`; the last is T.
    fn stack(&self, weights: &[Real], txs: &[[Real; 3]]) -> Vec<Vec<Real>> {
        let mut layers = vec![vec![0.0; txs.len() * self.stack[0].inputs]];
        self.tx_encoding.encode(txs, &mut layers[0]);
        for (l, layer) in self.stack.iter().enumerate() {
            let mut h = vec![0.0; txs.len() * layer.outputs];
            layer.whole().apply(weights, &layers[l], &mut h, Store::Set);
            dense::bias_relu(&mut h, layer.bias(weights));
            layers.push(h);
        }
        layers
    }

    /// One transmitter at a time: a batch then gives the bits of single calls.
    fn forward(&self, weights: &[Real], means: &[[Real; 3]], txs: &[[Real; 3]]) -> Deltas {
        let n = means.len();
        let mut signals = vec![[0.0; 2]; txs.len() * n];
        if signals.is_empty() {
            return Deltas { signals, ..Deltas::default() };
        }
        let g = self.factors(weights, means);
        signals.par_chunks_exact_mut(n).zip(txs).for_each(|(signals, tx)| {
            let layers = self.stack(weights, &[*tx]);
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

    fn vjp(
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
        let groups = txs.par_chunks(GROUP).zip(d.signals.par_chunks(GROUP * n));
        let sums: Vec<(Vec<Real>, Vec<Real>)> =
            groups.map(|(txs, d_signals)| self.group_vjp(weights, &g, txs, d_signals)).collect();
        dense::add_in_order(d_weights, &sums.iter().map(|s| s.0.as_slice()).collect::<Vec<_>>());
        let mut d_factors = vec![0.0; g.rows.len()];
        dense::add_in_order(&mut d_factors, &sums.iter().map(|s| s.1.as_slice()).collect::<Vec<_>>());
        self.branch_vjp(weights, &g, &d_factors, d_weights, d_means);
    }

    /// Derivatives of the weights and of the factors, from some transmitters.
    fn group_vjp(&self, weights: &[Real], g: &Factors, txs: &[[Real; 3]], d: &[[Real; 2]]) -> (Vec<Real>, Vec<Real>) {
        let (n, batch, width) = (g.n, txs.len(), self.features);
        let layers = self.stack(weights, txs);
        let (mut d_weights, mut d_factors) = (vec![0.0; weights.len()], vec![0.0; g.rows.len()]);
        let mut d_h = vec![0.0; width * batch];
        let rows = d_factors.len() / 2;
        for (c, d_factors) in d_factors.chunks_exact_mut(rows).enumerate() {
            // Signals of one channel: element (b, i) lies at 2(bN + i) + c.
            let d_s = Matrix::strided(&d.as_flattened()[c..], (batch, n), (2 * n, 2));
            let (d_f, d_base) = d_factors.split_at_mut(rows - n);
            product(
                MatrixMut::new(d_f, width, n),
                Store::Set,
                Matrix::new(&layers[self.stack.len()], width, batch),
                d_s,
            );
            for d in d.chunks_exact(n) {
                d_base.iter_mut().zip(d).for_each(|(sum, d)| *sum += d[c]);
            }
            let factors = Matrix::new(g.channel(c).0, width, n);
            product(MatrixMut::new(&mut d_h, width, batch), Store::Add, factors, d_s.t());
        }
        for (l, layer) in self.stack.iter().enumerate().rev() {
            dense::bias_relu_vjp(&mut d_h, &layers[l + 1], layer.bias_mut(&mut d_weights));
            layer.whole().weight_vjp(&mut d_weights, &layers[l], &d_h);
            if l > 0 {
                let mut d_x = vec![0.0; layer.inputs * batch];
                layer.whole().input_vjp(weights, &d_h, &mut d_x, Store::Set);
                d_h = d_x;
            }
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
        let [first, second] = &self.branch;
        dense::add_bias_vjp(d_factors, second.bias_mut(d_weights));
        second.whole().weight_vjp(d_weights, &g.hidden, d_factors);
        let mut d_hidden = vec![0.0; g.hidden.len()];
        second.whole().input_vjp(weights, d_factors, &mut d_hidden, Store::Set);
        dense::bias_relu_vjp(&mut d_hidden, &g.hidden, first.bias_mut(d_weights));
        first.whole().weight_vjp(d_weights, &g.gamma, &d_hidden);
        if let Some(d_means) = d_means {
            let mut d_gamma = vec![0.0; g.gamma.len()];
            first.whole().input_vjp(weights, &d_hidden, &mut d_gamma, Store::Set);
            encode_vjp(&g.gamma, &d_gamma, self.position_frequencies, d_means);
        }
    }
}
