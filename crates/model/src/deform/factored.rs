//! `Factored`: signals as products of what depends on the transmitter and what depends on the Gaussian.

use super::dense::{self, Matrix, MatrixMut, Store, product};
use super::layers::{Plan, laid_out};
use super::linear::Linear;
use super::mlp::check_stack;
use super::waves::{Encoder, Encoding};
use pwrfgs_core::{Cache, Deformation, DeformationInputs, Deltas, Pose, Real, WeightSpec, cached, rng::Rng};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A network that runs once a transmitter and not once a Gaussian: `Δsᵢ(p) = G(μᵢ)·T(p) + G₀(μᵢ)`.
///
/// A stack of ReLU layers makes `width` features T of the transmitter's encoded position γ(p); one linear layer on the
/// waves φ(μ) of the encoded centre makes each Gaussian's factors G, two rows (real and imaginary part) of `width` + 1
/// numbers. A signal is then a scalar product. Waves short against the distances of Gaussians make their factors
/// independent, long ones let neighbours agree. The cost of a prediction is that of one pass through the stack, whatever N is, and
/// sixteen Gaussians on a 4 x 4 array can follow all that the network knows of the transmitter: the shape for
/// `ArrayResponse`. Geometry does not depend on the transmitter. Known elsewhere as branch and trunk (`DeepONet`).
///
/// | field | meaning | default |
/// |---|---|---|
/// | `depth`, `width` | ReLU layers of the transmitter's stack, numbers a layer | 4, 256 |
/// | `tx_encoding` | γ(p): `Octaves(5)`, or `Waves(count: 64, reach: 24.0)`; see [`Encoding`] | `Octaves(5)` |
/// | `position_encoding` | φ(μ), the same without the coordinates | `Waves(count: 32, reach: 4.0)` |
///
/// Centres are differentiated through the network.
///
/// ```
/// use pwrfgs_core::{Cache, Deformation, Plugin};
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
    pub tx_encoding: Encoding,
    /// How the centre is encoded; without the coordinates, which would drown the waves.
    pub position_encoding: Encoding,
}

const WAVES: Encoding = Encoding::Waves { count: 32, reach: 4.0, seed: 0 };

impl Default for Factored {
    fn default() -> Self {
        Self { depth: 4, width: 256, tx_encoding: Encoding::default(), position_encoding: WAVES }
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

    fn forward(&self, weights: &[Real], means: &[[Real; 3]], txs: &[[Real; 3]], pose: &Pose) -> Deltas {
        self.forward_prepared(weights, means, txs, pose, &self.prepare(weights, means, pose))
    }

    fn prepare(&self, weights: &[Real], means: &[[Real; 3]], _: &Pose) -> Cache {
        let network = Network::of(self, weights);
        let factors = network.factors(weights, means);
        Some(Arc::new((network, factors)))
    }

    fn forward_prepared(
        &self,
        weights: &[Real],
        _: &[[Real; 3]],
        txs: &[[Real; 3]],
        _: &Pose,
        prepared: &Cache,
    ) -> Deltas {
        let (network, factors): &(Network, Factors) = cached(prepared);
        network.forward(weights, factors, txs)
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
        network.branch.dim(&mut factors, 0, &self.position_encoding.window(share)[3..]);
        Some(factors)
    }

    fn about(&self) -> &'static str {
        "signals as products of features of the transmitter and of the Gaussian: one small network, whatever N is"
    }

    fn check(&self) -> Result<(), String> {
        check_stack(self.depth, self.width, None)?;
        self.tx_encoding.check("tx_encoding")?;
        self.position_encoding.check("position_encoding")?;
        if self.position_encoding.width() == 3 {
            return Err("position_encoding needs a wave: give Waves(count: 32, reach: 4.0) or Octaves(4)".into());
        }
        Ok(())
    }
}

/// Mean magnitude of a sine.
const WAVE_MEAN: f64 = std::f64::consts::FRAC_2_PI;

/// Transmitters that share one pass of the derivative. Depends on nothing, so that threads do not show in the bits.
const GROUP: usize = 32;

/// The layers in the flat weight vector.
struct Network {
    tx_encoding: Encoder,
    position_encoding: Encoder,
    stack: Vec<Linear>,
    branch: Linear,
    /// Numbers of T.
    features: usize,
}

/// The Gaussians' side: waves and factors, feature-major `[·, N]`.
struct Factors {
    /// φ(μ), scaled; see [`Network::wave_scale`].
    waves: Vec<Real>,
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
        let width = settings.width;
        let tx_encoding = settings.tx_encoding.encoder();
        let inputs = |l| if l == 0 { settings.tx_encoding.width() } else { width };
        let stack = (0..settings.depth).map(|l| plan.relu(&format!("tx.{l}"), inputs(l), width)).collect();
        let waves = settings.position_encoding.width() - 3;
        // Signals begin about as large as one feature: factors have the variance 1/width.
        let bound = WAVE_MEAN * (6.0 * waves as f64 / width as f64).sqrt();
        let branch = plan.unbiased("branch", waves, 2 * (width + 1), bound);
        let position_encoding = settings.position_encoding.encoder();
        Self { tx_encoding, position_encoding, stack, branch, features: width }
    }

    fn of(settings: &Factored, weights: &[Real]) -> Self {
        laid_out(weights, |plan| Self::new(settings, plan))
    }

    fn factors(&self, weights: &[Real], means: &[[Real; 3]]) -> Factors {
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

    /// The magnitudes of a Gaussian's waves sum to 1: a step of Adam on `branch` then moves factors as far as a step on
    /// the stack moves weights, and not many times as far.
    fn wave_scale(&self) -> Real {
        (1.0 / (WAVE_MEAN * self.branch.inputs as f64)) as Real
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
    fn forward(&self, weights: &[Real], g: &Factors, txs: &[[Real; 3]]) -> Deltas {
        let n = g.n;
        let mut signals = vec![[0.0; 2]; txs.len() * n];
        if signals.is_empty() {
            return Deltas { signals, ..Deltas::default() };
        }
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
