//! `Deformation`: what the transmitter's position changes, `D_Θ` of eq. (5).

use crate::{Cache, Conditions, Pose, Real, plugin_kind, rng::Rng};

/// The calibration terms ΔS, ΔR, Δs as functions of centre and transmitter. The weights Θ live outside the plugin.
///
/// A batch of B transmitters is one call. All outputs are `[B, N, ·]`: transmitter by transmitter.
#[typetag::serde]
pub trait Deformation: erased_serde::Serialize + std::any::Any + std::fmt::Debug + Send + Sync {
    /// Names and shapes of the weight tensors, in the order in which they lie in the flat vector Θ.
    fn layout(&self) -> Vec<WeightSpec> {
        Vec::new()
    }

    /// Fresh weights, as long as [`Self::layout`] says.
    fn init(&self, rng: &mut Rng) -> Vec<Real> {
        let _ = rng;
        Vec::new()
    }

    /// Numbers that the network reads besides settings and weights: drawn from a seed and never learned. A model file
    /// holds them, because its other readers cannot draw them again.
    fn constants(&self) -> Vec<(WeightSpec, Vec<Real>)> {
        Vec::new()
    }

    /// Whether scales or rotations depend on the transmitter. If not, a batch shares one projection and one sorting.
    fn varies_geometry(&self) -> bool;

    /// Whether the signals it gives replace the cloud's own (WRF-GS) instead of being added (P-WRFGS).
    fn replaces_signals(&self) -> bool {
        false
    }

    /// Numbers that it wants to know of a transmitter: 3, its position, or the width of the features of the data
    /// ([`Features`](crate::Features)).
    fn inputs(&self) -> usize {
        3
    }

    /// Whether its terms depend on where the receiver is, so that it can serve only one.
    fn reads_receiver(&self) -> bool {
        false
    }

    /// Whether a Gaussian's terms depend on the centres of all (the released gain of WRF-GS does). Gaussians whose gate
    /// is closed then stay among the inputs; otherwise they are left out.
    fn couples_gaussians(&self) -> bool {
        false
    }

    /// Calibration terms for `means` `[N,3]` and the B transmitters `txs`: `txs.positions()` gives `[B,3]`.
    fn forward(&self, weights: &[Real], means: &[[Real; 3]], txs: Conditions<'_>, pose: &Pose) -> Deltas;

    /// What [`Self::forward`] makes of weights and centres without knowing the transmitter, for a trained model to
    /// work out once and not at every prediction. `None` where everything waits for the transmitter.
    fn prepare(&self, weights: &[Real], means: &[[Real; 3]], pose: &Pose) -> Cache {
        let _ = (weights, means, pose);
        None
    }

    /// [`Self::forward`], bit for bit, given what [`Self::prepare`] made of the same weights, centres and pose.
    fn forward_prepared(
        &self,
        weights: &[Real],
        means: &[[Real; 3]],
        txs: Conditions<'_>,
        pose: &Pose,
        prepared: &Cache,
    ) -> Deltas {
        let _ = prepared;
        self.forward(weights, means, txs, pose)
    }

    /// Adds to `d_weights` (as long as `weights`), and to `d_means` where given, given the cotangents `d` of the output.
    fn vjp(
        &self,
        inputs: &DeformationInputs<'_>,
        d: &Deltas,
        d_weights: &mut [Real],
        d_means: Option<&mut [[Real; 3]]>,
    );

    /// Numbers that [`Self::forward`] and its derivative keep for each Gaussian, whatever the number of transmitters,
    /// beside the terms themselves: for an estimate of memory before training starts. 0 where they work in small pieces.
    fn kept_per_gaussian(&self) -> usize {
        0
    }

    /// Factors `[as many as weights]` that let the lowest frequencies of positional encodings through, when a `share` of
    /// the annealing, 0 to 1, is done: what multiplies an input may as well multiply the weights that read it. `None`
    /// where nothing is encoded.
    fn frequency_window(&self, share: f64) -> Option<Vec<Real>> {
        let _ = share;
        None
    }

    /// Factors `[as many as weights]` that silence a share `rate` of the hidden units, drawn anew each step, and make the
    /// others louder by as much: dropout, with one draw for all transmitters of the step. `None` where it has no hidden
    /// units that could do without each other.
    fn dropout(&self, rate: Real, rng: &mut Rng) -> Option<Vec<Real>> {
        let _ = (rate, rng);
        None
    }

    /// The part of the signals that is linear in the transmitter's numbers, for a start in closed form; `None` where there
    /// is none.
    fn linear_part(&self, weights: &[Real], means: &[[Real; 3]], training: Conditions<'_>) -> Option<LinearPart> {
        let _ = (weights, means, training);
        None
    }

    /// Sets what can be told from the conditions of the training part before the first step.
    fn start(&self, training: Conditions<'_>, weights: &mut [Real]) {
        let _ = (training, weights);
    }

    /// Refuses settings that cannot work, when the pipeline is read.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Deformation);

/// Signals s of channel c that are linear in D numbers x of the transmitter and in J functions φ of the centre:
/// s(c) = Σ φⱼ B(c, k, j) xₖ.
#[derive(Clone, Debug)]
pub struct LinearPart {
    /// D.
    pub inputs: usize,
    /// x of the training part, `[n, D]`.
    pub values: Vec<Real>,
    /// J.
    pub functions: usize,
    /// φ of every Gaussian, `[N, J]`.
    pub basis: Vec<Real>,
    /// The weights that make signals of anything: set to 0, nothing but the linear part is left.
    pub cleared: std::ops::Range<usize>,
    /// Where B(c, 0, 0) lies in the weights, for both channels.
    pub first: [usize; 2],
}

impl LinearPart {
    /// Where B(c, k, j) lies in the weights.
    pub fn place(&self, channel: usize, input: usize, function: usize) -> usize {
        self.first[channel] + input * self.functions + function
    }
}

/// The arguments of [`Deformation::forward`], once more for its derivative.
#[derive(Clone, Copy, Debug)]
pub struct DeformationInputs<'a> {
    /// Θ.
    pub weights: &'a [Real],
    /// Centres `[N,3]`, metres.
    pub means: &'a [[Real; 3]],
    /// Transmitters: positions `[B,3]` in metres, or as many numbers each as [`Deformation::inputs`] says.
    pub txs: Conditions<'a>,
    /// Receiver.
    pub pose: &'a Pose,
}

/// Name and shape of a tensor, such as those inside the flat weight vector.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WeightSpec {
    /// Such as `trunk.0.weight`.
    pub name: String,
    /// Shape, row-major; a linear layer's weight is `[out, in]`.
    pub shape: Vec<usize>,
}

impl WeightSpec {
    /// Numbers in it.
    pub fn len(&self) -> usize {
        self.shape.iter().product()
    }

    /// Whether it holds no number.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Calibration terms, each `[B, N]` rows or empty where the deformation leaves that quantity alone.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Deltas {
    /// Added to the scales, metres.
    pub scales: Vec<[Real; 3]>,
    /// Added to the unit quaternions.
    pub quats: Vec<[Real; 4]>,
    /// Added to (or replacing) the signals.
    pub signals: Vec<[Real; 2]>,
}

impl Deltas {
    /// Scales, quaternions and signals, row-major.
    pub fn columns(&self) -> [&[Real]; 3] {
        [self.scales.as_flattened(), self.quats.as_flattened(), self.signals.as_flattened()]
    }

    /// The same, to be changed.
    pub fn columns_mut(&mut self) -> [&mut [Real]; 3] {
        [self.scales.as_flattened_mut(), self.quats.as_flattened_mut(), self.signals.as_flattened_mut()]
    }

    /// The columns that are not empty, one after the other.
    pub fn to_columns(&self) -> impl Iterator<Item = Vec<Real>> {
        self.columns().into_iter().filter(|column| !column.is_empty()).map(<[Real]>::to_vec)
    }

    /// Terms of the same shape from what [`Self::to_columns`] gives.
    pub fn from_columns(&self, columns: Vec<Vec<Real>>) -> Self {
        let mut deltas = self.zeros_like();
        let own = deltas.columns_mut().into_iter().filter(|column| !column.is_empty());
        own.zip(columns).for_each(|(own, column)| own.copy_from_slice(&column));
        deltas
    }

    /// Zeros of the same shape.
    pub fn zeros_like(&self) -> Self {
        let (scales, quats) = (vec![[0.0; 3]; self.scales.len()], vec![[0.0; 4]; self.quats.len()]);
        Self { scales, quats, signals: vec![[0.0; 2]; self.signals.len()] }
    }
}
