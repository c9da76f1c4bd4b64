//! `Deformation`: effect of the transmitter position on the Gaussians, `D_Θ` of eq. (5).

use crate::{Cache, Layout, Pose, Real, plugin_kind};
use std::ops::Range;

/// Calibration terms ΔS, ΔR, Δs as functions of centre and transmitter. The weights Θ are stored outside the plugin.
///
/// A batch of B transmitters is one call. All outputs are `[B, N, ·]`, transmitter by transmitter.
#[typetag::serde]
#[expect(unused_variables, reason = "the defaults ignore parameters")]
pub trait Deformation: crate::plugin::PluginObject {
    /// Returns properties that do not depend on weights.
    fn traits(&self) -> DeformationTraits;

    /// Returns names, shapes and initial values of the weights Θ.
    fn layout(&self) -> Layout {
        Layout::default()
    }

    /// Computes calibration terms of all Gaussians and transmitters. `prepared` is the result of [`Self::prepare`] for
    /// the same weights, centres and pose, or `None`; both give bit-identical results.
    fn forward(&self, inputs: &DeformationInputs<'_>, prepared: &Cache) -> Deltas;

    /// Computes [`Self::forward`] without preparation, and values that [`Self::vjp`] reuses ([`DeformationInputs::kept`]).
    /// Those of each Gaussian and transmitter take at most [`KEPT_BYTES`] together. `None` if nothing is kept.
    fn forward_for_vjp(&self, inputs: &DeformationInputs<'_>) -> (Deltas, Cache) {
        (self.forward(inputs, &None), None)
    }

    /// Precomputes the transmitter-independent part of [`Self::forward`] from weights, centres and pose, for repeated
    /// predictions. `None` if nothing is precomputed.
    fn prepare(&self, weights: &[Real], means: &[[Real; 3]], pose: &Pose) -> Cache {
        None
    }

    /// Adds the derivatives to `sums`, for the cotangents `d` of the output.
    fn vjp(&self, inputs: &DeformationInputs<'_>, d: &Deltas, sums: DeformationVjp<'_>);

    /// Returns the part of the signals that is linear in the transmitter inputs, for an initialisation in closed form;
    /// `None` without such a part.
    fn linear_part(&self, weights: &[Real], means: &[[Real; 3]], training: Conditions<'_>) -> Option<LinearPart> {
        None
    }

    /// Initialises the parameters that depend on the conditions of the training set, before the first step.
    fn start(&self, training: Conditions<'_>, weights: &mut [Real]) {}

    /// Rejects invalid settings when the pipeline is read; the error says what is wrong and what to do.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Deformation);

/// Maximum of the bytes that a forward pass keeps for the derivative: the activations of about 30,000 Gaussians of the
/// network of the paper. Those of further Gaussians are computed again.
pub const KEPT_BYTES: usize = 256 << 20;

/// Inputs and properties of a [`Deformation`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(clippy::struct_excessive_bools)] // independent properties
pub struct DeformationTraits {
    /// Number of inputs per transmitter: 3 for its position, or the width of the features of the data
    /// ([`Features`](crate::Features)).
    pub inputs: usize,
    /// Whether scales or rotations depend on the transmitter. If not, a batch shares one projection and one depth sort.
    pub varies_geometry: bool,
    /// Whether its signals replace those of the cloud (WRF-GS) instead of being added (P-WRFGS).
    pub replaces_signals: bool,
    /// Whether its terms depend on the carrier ([`Conditions::carrier`]).
    pub reads_carrier: bool,
    /// Whether its terms depend on the receiver position, so that it supports only one receiver.
    pub reads_receiver: bool,
    /// Whether the terms of a Gaussian depend on the centres of all (as the released gain of WRF-GS does). Closed
    /// Gaussians then remain inputs; otherwise they are left out.
    pub couples_gaussians: bool,
    /// Number of values per Gaussian, independent of the number of transmitters, that [`Deformation::forward`] and its
    /// derivative store in addition to the terms. Used for memory estimates; 0 if they work in small chunks.
    pub kept_per_gaussian: usize,
    /// Number of values per Gaussian and transmitter that [`Deformation::forward_for_vjp`] keeps within [`KEPT_BYTES`].
    pub kept_per_term: usize,
    /// Whether [`Deformation::vjp`] supports the derivative by the positions of the transmitters.
    pub differentiates_positions: bool,
    /// Whether it runs on a GPU, in programs that support one.
    pub runs_on_gpu: bool,
}

impl Default for DeformationTraits {
    /// Returns the properties of a network that reads positions and adds signals.
    fn default() -> Self {
        Self {
            inputs: 3,
            varies_geometry: false,
            replaces_signals: false,
            reads_carrier: false,
            reads_receiver: false,
            couples_gaussians: false,
            kept_per_gaussian: 0,
            kept_per_term: 0,
            differentiates_positions: false,
            runs_on_gpu: false,
        }
    }
}

/// Signals s of channel c that are linear in D inputs x of the transmitter and in J functions φ of the centre: s(c) = Σ
/// φⱼ B(c, k, j) xₖ.
#[derive(Clone, Debug)]
pub struct LinearPart {
    /// Number of inputs D.
    pub inputs: usize,
    /// Inputs x of the training set, `[n, D]`.
    pub values: Vec<Real>,
    /// Number of functions J.
    pub functions: usize,
    /// Functions φ of every Gaussian, `[N, J]`.
    pub basis: Vec<Real>,
    /// Range of weights that produce the signals: set it to 0 before setting B, so that only the linear part is left.
    pub cleared: Range<usize>,
    /// Indices of B(c, 0, 0) in the weights, for both channels.
    pub first: [usize; 2],
}

impl LinearPart {
    /// Returns the index of B(c, k, j) in the weights.
    pub fn weight_index(&self, channel: usize, input: usize, function: usize) -> usize {
        self.first[channel] + input * self.functions + function
    }
}

/// Inputs of [`Deformation::forward`] and its derivative.
#[derive(Clone, Copy, Debug)]
pub struct DeformationInputs<'a> {
    /// Weights Θ.
    pub weights: &'a [Real],
    /// Centres `[N,3]`, metres.
    pub means: &'a [[Real; 3]],
    /// Transmitters: positions `[B,3]` in metres, or features of width [`DeformationTraits::inputs`].
    pub txs: Conditions<'a>,
    /// Pose of the receiver.
    pub pose: &'a Pose,
    /// For [`Deformation::vjp`]: result of [`Deformation::forward_for_vjp`] for the same inputs, or `None`; both give
    /// bit-identical results.
    pub kept: &'a Cache,
}

impl<'a> DeformationInputs<'a> {
    /// Creates the inputs for some transmitters; [`Self::kept`] is `None`.
    pub fn new(weights: &'a [Real], means: &'a [[Real; 3]], txs: impl Into<Conditions<'a>>, pose: &'a Pose) -> Self {
        Self { weights, means, txs: txs.into(), pose, kept: &None }
    }
}

/// Sums to which [`Deformation::vjp`] adds derivatives.
#[derive(Debug)]
pub struct DeformationVjp<'a> {
    /// Derivatives by the weights.
    pub weights: &'a mut [Real],
    /// Derivatives by the centres `[N, 3]`, if wanted.
    pub means: Option<&'a mut [[Real; 3]]>,
    /// Derivatives by the transmitter positions `[B, 3]`, if wanted: only of a deformation that
    /// [differentiates](DeformationTraits::differentiates_positions) them.
    pub positions: Option<&'a mut [[Real; 3]]>,
}

impl<'a> DeformationVjp<'a> {
    /// Creates the sums for the weights only.
    pub fn of_weights(weights: &'a mut [Real]) -> Self {
        Self { weights, means: None, positions: None }
    }
}

/// Calibration terms, each `[B, N]` rows, or empty if the deformation does not change that quantity.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Deltas {
    /// Terms added to the scales, metres.
    pub scales: Vec<[Real; 3]>,
    /// Terms added to the unit quaternions.
    pub quats: Vec<[Real; 4]>,
    /// Terms added to (or replacing) the signals.
    pub signals: Vec<[Real; 2]>,
}

impl Deltas {
    /// Returns scales, quaternions and signals, row-major.
    pub fn columns(&self) -> [&[Real]; 3] {
        [self.scales.as_flattened(), self.quats.as_flattened(), self.signals.as_flattened()]
    }

    /// Returns scales, quaternions and signals, mutable.
    pub fn columns_mut(&mut self) -> [&mut [Real]; 3] {
        [self.scales.as_flattened_mut(), self.quats.as_flattened_mut(), self.signals.as_flattened_mut()]
    }

    /// Returns whether there are no terms.
    pub fn is_empty(&self) -> bool {
        self.columns().iter().all(|column| column.is_empty())
    }

    /// Creates zeros of the same shape.
    pub fn zeros_like(&self) -> Self {
        let (scales, quats) = (vec![[0.0; 3]; self.scales.len()], vec![[0.0; 4]; self.quats.len()]);
        Self { scales, quats, signals: vec![[0.0; 2]; self.signals.len()] }
    }
}

/// Network input per transmitter, `[B, width]`: its position in metres from the origin, or the features that replace
/// it. For a moving receiver: its position. For data with several carriers: the carrier beside each row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conditions<'a> {
    width: usize,
    values: &'a [Real],
    carriers: &'a [Real],
}

impl<'a> Conditions<'a> {
    /// Creates rows of `width` numbers; an incomplete last row is left out.
    pub fn new(width: usize, values: &'a [Real]) -> Self {
        let whole = values.len() - values.len() % width.max(1);
        Self { width, values: &values[..whole], carriers: &[] }
    }

    /// Returns the inputs with the `carriers` of the rows `[B]`, from -1 to 1
    /// ([`MeasurementSetup::carriers`](crate::MeasurementSetup::carriers)); none if the data have one carrier.
    #[must_use]
    pub fn at_carriers(self, carriers: &'a [Real]) -> Self {
        Self { carriers, ..self }
    }

    /// Returns the carrier of row `b`, from -1 to 1; 0 if the data have one carrier.
    pub fn carrier(&self, b: usize) -> Real {
        self.carriers.get(b).copied().unwrap_or(0.0)
    }

    /// Returns the number of transmitters B.
    pub fn len(&self) -> usize {
        self.values.len() / self.width.max(1)
    }

    /// Returns whether there are no transmitters.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Returns the number of inputs per transmitter.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Returns all inputs, row by row.
    pub fn values(&self) -> &'a [Real] {
        self.values
    }

    /// Returns the inputs of a range of the transmitters.
    pub fn rows(&self, range: Range<usize>) -> Self {
        let values = &self.values[range.start * self.width..range.end * self.width];
        let carriers = self.carriers.get(range).unwrap_or_default();
        Self { width: self.width, values, carriers }
    }

    /// Returns the positions `[B,3]`; empty if the inputs are features. A deformation that requests positions by
    /// [`DeformationTraits::inputs`](crate::DeformationTraits::inputs) always receives positions.
    pub fn positions(&self) -> &'a [[Real; 3]] {
        if self.width == 3 { self.values.as_chunks().0 } else { &[] }
    }
}

impl<'a> From<&'a [[Real; 3]]> for Conditions<'a> {
    fn from(positions: &'a [[Real; 3]]) -> Self {
        Self::new(3, positions.as_flattened())
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
