//! `Mlp`: the deformation network of P-WRFGS, `(Δs, ΔR, ΔS) = D_Θ(γ(μ), γ(p_tx))` of eq. (5).

use super::mlp_network::{Network, Outputs};
use crate::layers::encoding::{self, MOST_FREQUENCIES};
use crate::layers::plan::{Plan, laid_out, planned};
use crate::layers::trunk::{Trunk, TrunkShape};
use pwrfgs_core::{Cache, Deformation, DeformationInputs, DeformationTraits, Deltas, JsonSchema, Layout, Real};
use serde::{Deserialize, Serialize};

/// The network of P-WRFGS: for each Gaussian and transmitter a change of signal, rotation and scale, to be added.
///
/// The transmitter's encoding γ(p) passes two small layers of its own and joins the encoding γ(μ) of the Gaussian's
/// centre; a stack of ReLU layers follows, in which both enter once more after layer `skip`; linear heads end it. The
/// defaults are those of the released WRF-GS+, on which the paper builds (574,819 weights; its two heads that never
/// reach the picture are left out).
///
/// With `outputs: Signals` only signals depend on the transmitter: a whole batch then shares one projection and one
/// sorting, which is several times faster. Smaller networks are faster too; the cost grows with `depth · width²`.
///
/// Centres are not differentiated through the network (the released code detaches them): `d_means` stays as it is.
///
/// ```
/// use pwrfgs_core::{Deformation, Plugin};
/// # use pwrfgs_model as _;
/// let small = "Mlp(depth: 4, width: 64, skip: None, outputs: Signals, head_init: 0.1)";
/// let small = Plugin::<dyn Deformation>::parse(small).unwrap();
/// assert!(!small.traits().varies_geometry);
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Mlp {
    /// Number of ReLU layers, 1 or more.
    pub depth: usize,
    /// Units per layer.
    pub width: usize,
    /// Frequencies 2⁰…2^(L-1) rad/m in the encoding of the centre; 0 gives the bare coordinates.
    pub position_frequencies: usize,
    /// Frequencies in the encoding of the transmitter, likewise.
    pub tx_frequencies: usize,
    /// Numbers in the hidden layer of the transmitter's branch.
    pub tx_hidden: usize,
    /// Numbers that the transmitter's branch hands to the stack.
    pub tx_features: usize,
    /// Both inputs enter again after this layer (counted from 0); `None` for a plain stack.
    pub skip: Option<usize>,
    /// Outputs of the network, which depend on the transmitter.
    pub outputs: Outputs,
    /// Factor on the initial weights and biases of the heads. 1 is PyTorch's start; with small values training starts
    /// near the undeformed Gaussians.
    pub head_init: f64,
}

impl Default for Mlp {
    fn default() -> Self {
        Self {
            depth: 8,
            width: 256,
            position_frequencies: 10,
            tx_frequencies: 6,
            tx_hidden: 256,
            tx_features: 90,
            skip: Some(4),
            outputs: Outputs::All,
            head_init: 1.0,
        }
    }
}

impl Mlp {
    /// The layers, in the order in which they lie in the weight vector.
    fn network(&self, plan: &mut Plan) -> Network {
        let tx_inputs = encoding::width(self.tx_frequencies);
        let tx =
            [plan.linear("tx.0", tx_inputs, self.tx_hidden), plan.linear("tx.1", self.tx_hidden, self.tx_features)];
        let gamma = encoding::width(self.position_frequencies);
        let &Self { position_frequencies, tx_frequencies, depth, width, skip, outputs, .. } = self;
        let trunk = Trunk::new(plan, TrunkShape { depth, width, skip, gamma, side: self.tx_features });
        let heads: &[(&str, usize)] = match outputs {
            Outputs::All => &[("rotation", 4), ("scaling", 3), ("signal", 2)],
            Outputs::Signals => &[("signal", 2)],
        };
        let heads = plan.heads(heads, width, self.head_init);
        Network { position_frequencies, tx_frequencies, outputs, tx, trunk, heads }
    }
}

#[typetag::serde]
impl Deformation for Mlp {
    fn traits(&self) -> DeformationTraits {
        DeformationTraits { varies_geometry: self.outputs == Outputs::All, ..DeformationTraits::default() }
    }

    fn layout(&self) -> Layout {
        planned(|plan| self.network(plan)).1.layout()
    }

    fn forward(&self, inputs: &DeformationInputs<'_>, _: &Cache) -> Deltas {
        let network = laid_out(inputs.weights, |plan| self.network(plan));
        network.forward(inputs.weights, inputs.means, inputs.txs.positions())
    }

    fn vjp(&self, inputs: &DeformationInputs<'_>, d: &Deltas, d_weights: &mut [Real], _: Option<&mut [[Real; 3]]>) {
        assert_eq!(d_weights.len(), inputs.weights.len(), "a derivative for each weight");
        laid_out(inputs.weights, |plan| self.network(plan)).vjp(inputs, d, d_weights);
    }

    fn check(&self) -> Result<(), String> {
        check_stack(self.depth, self.width, self.skip)?;
        for (name, value) in [("tx_hidden", self.tx_hidden), ("tx_features", self.tx_features)] {
            if !(1..=WIDEST).contains(&value) {
                return Err(format!("{name} is {value}; give a number from 1 to {WIDEST}"));
            }
        }
        check_frequencies("position_frequencies", self.position_frequencies)?;
        check_frequencies("tx_frequencies", self.tx_frequencies)?;
        if !(self.head_init.is_finite() && self.head_init >= 0.0) {
            return Err(format!("head_init is {}; give a finite number that is not negative", self.head_init));
        }
        Ok(())
    }
}

pub(super) const WIDEST: usize = 8192;
const DEEPEST: usize = 256;

/// Refuses a stack that cannot be built.
pub(super) fn check_stack(depth: usize, width: usize, skip: Option<usize>) -> Result<(), String> {
    if !(1..=DEEPEST).contains(&depth) {
        return Err(format!("depth is {depth}; give a number of layers from 1 to {DEEPEST}"));
    }
    if !(1..=WIDEST).contains(&width) {
        return Err(format!("width is {width}; give a number from 1 to {WIDEST}"));
    }
    match skip {
        Some(skip) if skip >= depth - 1 => Err(format!(
            "skip is {skip}, but after that layer none of the {depth} is left to join; give a smaller one or \
             `skip: None`"
        )),
        _ => Ok(()),
    }
}

/// Refuses frequencies beyond what the arithmetic resolves.
pub(super) fn check_frequencies(name: &str, frequencies: usize) -> Result<(), String> {
    if frequencies > MOST_FREQUENCIES {
        return Err(format!("{name} is {frequencies}; give a number from 0 to {MOST_FREQUENCIES}"));
    }
    Ok(())
}
