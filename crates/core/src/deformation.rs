//! `Deformation`: what the transmitter's position changes, `D_Θ` of eq. (5).

use crate::{Cache, Layout, Pose, Real, plugin_kind};
use std::ops::Range;

/// The calibration terms ΔS, ΔR, Δs as functions of centre and transmitter. The weights Θ live outside the plugin.
///
/// A batch of B transmitters is one call. All outputs are `[B, N, ·]`: transmitter by transmitter.
#[typetag::serde]
pub trait Deformation:
    erased_serde::Serialize + crate::docs::Documented + std::any::Any + std::fmt::Debug + Send + Sync
{
    /// What does not depend on weights.
    fn traits(&self) -> DeformationTraits;

    /// Names, shapes and initial values of the weights Θ.
    fn layout(&self) -> Layout {
        Layout::default()
    }

    /// Calibration terms of all Gaussians and transmitters. `prepared` is what [`Self::prepare`] made of the same weights,
    /// centres and pose, or `None`; the result has the same bits.
    fn forward(&self, inputs: &DeformationInputs<'_>, prepared: &Cache) -> Deltas;

    /// What [`Self::forward`] makes of weights and centres without knowing the transmitter, for a trained model to
    /// work out once and not at every prediction. `None` where everything waits for the transmitter.
    fn prepare(&self, weights: &[Real], means: &[[Real; 3]], pose: &Pose) -> Cache {
        let _ = (weights, means, pose);
        None
    }

    /// Adds to `d_weights` (as long as `weights`), and to `d_means` where given, given the cotangents `d` of the output.
    fn vjp(
        &self,
        inputs: &DeformationInputs<'_>,
        d: &Deltas,
        d_weights: &mut [Real],
        d_means: Option<&mut [[Real; 3]]>,
    );

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

/// What a [`Deformation`] depends on, and what it gives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(clippy::struct_excessive_bools)] // independent properties
pub struct DeformationTraits {
    /// Numbers that it reads of a transmitter: 3, its position, or the width of the features of the data
    /// ([`Features`](crate::Features)).
    pub inputs: usize,
    /// Whether scales or rotations depend on the transmitter. If not, a batch shares one projection and one sorting.
    pub varies_geometry: bool,
    /// Whether the signals it gives replace the cloud's own (WRF-GS) instead of being added (P-WRFGS).
    pub replaces_signals: bool,
    /// Whether its terms depend on where the receiver is, so that it can serve only one.
    pub reads_receiver: bool,
    /// Whether a Gaussian's terms depend on the centres of all (the released gain of WRF-GS does). Gaussians whose gate
    /// is closed then stay among the inputs; otherwise they are left out.
    pub couples_gaussians: bool,
    /// Numbers that [`Deformation::forward`] and its derivative keep for each Gaussian, whatever the number of transmitters,
    /// beside the terms themselves: for an estimate of memory before training starts. 0 where they work in small pieces.
    pub kept_per_gaussian: usize,
}

impl Default for DeformationTraits {
    /// Those of a network that reads positions and adds signals.
    fn default() -> Self {
        Self {
            inputs: 3,
            varies_geometry: false,
            replaces_signals: false,
            reads_receiver: false,
            couples_gaussians: false,
            kept_per_gaussian: 0,
        }
    }
}

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

/// What [`Deformation::forward`] and its derivative read.
#[derive(Clone, Copy, Debug)]
pub struct DeformationInputs<'a> {
    /// Θ.
    pub weights: &'a [Real],
    /// Centres `[N,3]`, metres.
    pub means: &'a [[Real; 3]],
    /// Transmitters: positions `[B,3]` in metres, or as many numbers each as [`DeformationTraits::inputs`] says.
    pub txs: Conditions<'a>,
    /// Receiver.
    pub pose: &'a Pose,
}

impl<'a> DeformationInputs<'a> {
    /// The inputs of these transmitters.
    pub fn new(weights: &'a [Real], means: &'a [[Real; 3]], txs: impl Into<Conditions<'a>>, pose: &'a Pose) -> Self {
        Self { weights, means, txs: txs.into(), pose }
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

    /// Whether the deformation leaves every quantity alone.
    pub fn is_empty(&self) -> bool {
        self.columns().iter().all(|column| column.is_empty())
    }

    /// Zeros of the same shape.
    pub fn zeros_like(&self) -> Self {
        let (scales, quats) = (vec![[0.0; 3]; self.scales.len()], vec![[0.0; 4]; self.quats.len()]);
        Self { scales, quats, signals: vec![[0.0; 2]; self.signals.len()] }
    }
}

/// A vector for each of B transmitters, `[B, width]`: its position as a rule, metres from the origin; whatever stands in
/// its place otherwise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conditions<'a> {
    width: usize,
    values: &'a [Real],
}

impl<'a> Conditions<'a> {
    /// Rows of `width` numbers; half a row at the end is left out.
    pub fn new(width: usize, values: &'a [Real]) -> Self {
        let whole = values.len() - values.len() % width.max(1);
        Self { width, values: &values[..whole] }
    }

    /// B, transmitters.
    pub fn len(&self) -> usize {
        self.values.len() / self.width.max(1)
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Numbers of each.
    pub fn width(&self) -> usize {
        self.width
    }

    /// All numbers, row by row.
    pub fn values(&self) -> &'a [Real] {
        self.values
    }

    /// Some of the transmitters.
    pub fn rows(&self, range: Range<usize>) -> Self {
        Self { width: self.width, values: &self.values[range.start * self.width..range.end * self.width] }
    }

    /// The positions `[B,3]`; nothing where they are something else. A deformation that asks for positions says so by
    /// [`DeformationTraits::inputs`](crate::DeformationTraits::inputs), and is given nothing else.
    pub fn positions(&self) -> &'a [[Real; 3]] {
        if self.width == 3 { self.values.as_chunks().0 } else { &[] }
    }
}

impl<'a> From<&'a [[Real; 3]]> for Conditions<'a> {
    fn from(positions: &'a [[Real; 3]]) -> Self {
        Self { width: 3, values: positions.as_flattened() }
    }
}

impl<'a> From<&'a Vec<[Real; 3]>> for Conditions<'a> {
    fn from(positions: &'a Vec<[Real; 3]>) -> Self {
        positions.as_slice().into()
    }
}

impl<'a, const B: usize> From<&'a [[Real; 3]; B]> for Conditions<'a> {
    fn from(positions: &'a [[Real; 3]; B]) -> Self {
        positions.as_slice().into()
    }
}
