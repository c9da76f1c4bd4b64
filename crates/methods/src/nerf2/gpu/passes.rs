//! Passes of NeRF2's network on a GPU over a chunk of rays, and the slots of their values.

use crate::nerf2::group::RayGroup;
use crate::nerf2::network::{FREQUENCIES, Nerf2Network};
use pwrfgs_core::{Real, Result};
use pwrfgs_gpu::{Block, Epilogue, Gpu, GpuStep, SCRATCH, scratch_len};
use pwrfgs_networks::encoding::encoded_width;
use pwrfgs_networks::trunk::gpu::{D, D_WEIGHTS, GAMMA, GpuTrunk, NETWORK, SPARE, WEIGHTS, encode_chunk};
use std::ops::Range;

/// Slots of the trunk outputs: feature and W·feature `[width, R]` with its cotangent; raw attenuations `[2 bands, R]`, or their
/// cotangents.
const FEATURE: usize = NETWORK;
pub(super) const FROM_FEATURE: usize = NETWORK + 1;
pub(super) const D_FROM_FEATURE: usize = NETWORK + 2;
pub(super) const ATTENUATION: usize = NETWORK + 3;
/// Slots per ray: γ of the direction `[gamma, rays]`; contributions of the transmitters, and of transmitter and direction with
/// the bias, `[width, rays]`; cotangents of the latter.
const VIEWS: usize = NETWORK + 4;
const TRANSMITTERS: usize = NETWORK + 5;
const SIDE: usize = NETWORK + 6;
pub(super) const D_SIDE: usize = NETWORK + 7;
/// Slots of the signal network: hidden layers, and raw emissions `[2 bands, R]` or their cotangents.
const HIDDEN: [usize; 2] = [NETWORK + 8, NETWORK + 9];
pub(super) const RAW: usize = NETWORK + 10;
const FIRST: usize = NETWORK + 11;

/// Maximum number of workgroups along an axis.
const WORKGROUPS: usize = 65_535;

/// Network on a GPU.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GpuNerf2<'a> {
    pub(crate) gpu: &'a Gpu,
    pub(crate) network: &'a Nerf2Network,
    pub(crate) weights: &'a [Real],
    pub(crate) samples: usize,
}

/// Size of a chunk, whose rows are the samples of its rays.
#[derive(Clone, Copy)]
pub(super) struct Chunk<'a> {
    pub(super) on: GpuTrunk<'a>,
    rays: usize,
}

impl<'a> GpuNerf2<'a> {
    /// Returns a chunk of rays; for a backward pass (`is_derived`) each layer of the trunk has a slot.
    pub(super) fn chunk(&self, rays: usize, is_derived: bool) -> Chunk<'a> {
        let trunk = &self.network.trunk;
        let slots = if is_derived { trunk.depth() } else { 2 };
        Chunk { on: GpuTrunk { trunk, rows: rays * self.samples, first: FIRST, slots }, rays }
    }

    /// Begins a step for chunks of up to `rays` rays, with the weights and the biases of the trunk on the GPU. Returns an
    /// error if its memory does not suffice.
    pub(super) fn begin(&self, rays: usize, is_derived: bool) -> Result<GpuStep<'a>> {
        let Chunk { on, .. } = self.chunk(rays, is_derived);
        let (width, outputs) = (self.network.width(), self.network.outputs);
        let mut sizes = on.sizes(self.weights.len(), 1, outputs, is_derived);
        sizes.resize(FIRST, 1);
        let chunk = width * on.rows;
        (sizes[FEATURE], sizes[FROM_FEATURE], sizes[ATTENUATION]) = (chunk, chunk, outputs * on.rows);
        sizes[VIEWS] = encoded_width(FREQUENCIES) * rays;
        (sizes[TRANSMITTERS], sizes[SIDE]) = (width * rays, width * rays);
        (sizes[HIDDEN[0]], sizes[HIDDEN[1]], sizes[RAW]) = (chunk, width / 2 * on.rows, outputs * on.rows);
        if is_derived {
            (sizes[D_FROM_FEATURE], sizes[D_SIDE]) = (chunk, width * rays);
            sizes[SCRATCH] = sizes[SCRATCH].max(scratch_len(self.samples, WORKGROUPS.min(width * rays)));
        }
        sizes.resize(FIRST + on.slots, chunk);
        let mut step = self.gpu.step(&sizes)?;
        step.upload(WEIGHTS, 0, self.weights);
        on.upload_folded(&mut step, &self.network.trunk.fold_biases(self.weights, &[]));
        Ok(step)
    }

    /// Runs the trunk and the following layers for the samples `points` of a chunk, in the network's unit: sets slots
    /// [`ATTENUATION`], [`FEATURE`] and [`FROM_FEATURE`].
    pub(super) fn run_trunk(&self, step: &mut GpuStep<'_>, Chunk { on, .. }: Chunk<'_>, points: &[[Real; 3]]) {
        let Nerf2Network { attenuation, feature, .. } = self.network;
        step.upload(GAMMA, 0, &encode_chunk(points, FREQUENCIES));
        on.share_gamma(step);
        on.forward(step);
        let bias = |bias| Epilogue { bias: Some((WEIGHTS, bias)), ..Epilogue::default() };
        on.apply(step, &attenuation.whole(), on.last(), ATTENUATION, bias(attenuation.bias));
        on.apply(step, &feature.whole(), on.last(), FEATURE, bias(feature.bias));
        on.apply(step, &self.network.feature_columns(), FEATURE, FROM_FEATURE, Epilogue::default());
    }

    /// Runs the signal network of a chunk for the transmitters in the rows `locations` of `terms`, one per ray: reads slots
    /// [`FROM_FEATURE`] and [`VIEWS`], sets slot [`RAW`].
    pub(super) fn run_signal(&self, step: &mut GpuStep<'_>, chunk: Chunk<'_>, terms: &[Real], locations: &[usize]) {
        let (Nerf2Network { signal, emission: out, .. }, Chunk { on, rays }) = (self.network, chunk);
        let width = self.network.width();
        let ray_terms: Vec<Real> =
            (0..width).flat_map(|feature| locations.iter().map(move |tx| terms[tx * width + feature])).collect();
        step.upload(TRANSMITTERS, 0, &ray_terms);
        let (view, per_ray) = (self.network.view_columns(), |slot| Block::new(slot, 0, rays));
        let side = Epilogue { plus: Some(TRANSMITTERS), bias: Some((WEIGHTS, signal[0].bias)), ..Epilogue::default() };
        let (outputs, inputs) = view.shape();
        step.product((outputs, rays, inputs), view.block(WEIGHTS), per_ray(VIEWS), per_ray(SIDE), side);
        step.bias_relu((width * rays, self.samples), FROM_FEATURE, (SIDE, 0), HIDDEN[0]);
        let hidden = Epilogue { bias: Some((WEIGHTS, signal[1].bias)), relu: true, ..Epilogue::default() };
        on.apply(step, &signal[1].whole(), HIDDEN[0], HIDDEN[1], hidden);
        on.apply(
            step,
            &out.whole(),
            HIDDEN[1],
            RAW,
            Epilogue { bias: Some((WEIGHTS, out.bias)), ..Epilogue::default() },
        );
    }

    /// Uploads γ of the directions of the rays to slot [`VIEWS`].
    pub(super) fn upload_views(step: &mut GpuStep<'_>, group: &RayGroup<'_>, rays: &Range<usize>) {
        step.upload(VIEWS, 0, &encode_chunk(&group.walk.rays.directions[rays.clone()], FREQUENCIES));
    }

    /// Runs the backward pass of [`Self::run_signal`], given the cotangents in slot [`RAW`]: sets slot [`D_SIDE`], adds to
    /// [`D_FROM_FEATURE`] and [`D_WEIGHTS`].
    pub(super) fn signal_vjp(&self, step: &mut GpuStep<'_>, Chunk { on, rays }: Chunk<'_>) {
        let (Nerf2Network { signal, emission: out, outputs, .. }, rows) = (self.network, on.rows);
        let width = self.network.width();
        let mask = |slot| Epilogue { mask: Some(slot), ..Epilogue::default() };
        on.weight_vjp(step, &out.whole(), HIDDEN[1], on.chunk(RAW));
        step.add_row_sums((*outputs, rows), (RAW, 0), (D_WEIGHTS, out.bias));
        on.input_vjp(step, &out.whole(), on.chunk(RAW), SPARE, mask(HIDDEN[1]));
        on.weight_vjp(step, &signal[1].whole(), HIDDEN[0], on.chunk(SPARE));
        step.add_row_sums((width / 2, rows), (SPARE, 0), (D_WEIGHTS, signal[1].bias));
        on.input_vjp(step, &signal[1].whole(), on.chunk(SPARE), D, mask(HIDDEN[0]));
        step.add(width * rows, D, D_FROM_FEATURE);
        step.clear(D_SIDE, width * rays);
        // Each sum over the samples of a ray takes one workgroup: a pass has as many whole features as the limit allows.
        let together = WORKGROUPS / rays * rays;
        for first in (0..width * rays).step_by(together) {
            let features = together.min(width * rays - first);
            step.add_row_sums((features, self.samples), (D, first * self.samples), (D_SIDE, first));
        }
        let (view, d_side) = (self.network.view_columns(), Block::new(D_SIDE, 0, rays));
        step.add_gradient(view.shape(), rays, d_side, Block::new(VIEWS, 0, rays).t(), view.block(D_WEIGHTS));
        step.add_row_sums((width, rays), (D_SIDE, 0), (D_WEIGHTS, signal[0].bias));
    }

    /// Runs the backward pass of [`Self::run_trunk`], given the cotangents in slots [`ATTENUATION`] and [`D_FROM_FEATURE`]:
    /// adds to [`D_WEIGHTS`] and to the slot of the folded biases.
    pub(super) fn trunk_vjp(&self, step: &mut GpuStep<'_>, Chunk { on, .. }: Chunk<'_>) {
        let Nerf2Network { attenuation, feature, outputs, .. } = self.network;
        let (width, columns) = (self.network.width(), self.network.feature_columns());
        let mask = Epilogue { mask: Some(on.last()), ..Epilogue::default() };
        on.weight_vjp(step, &columns, FEATURE, on.chunk(D_FROM_FEATURE));
        on.input_vjp(step, &columns, on.chunk(D_FROM_FEATURE), SPARE, Epilogue::default());
        on.weight_vjp(step, &feature.whole(), on.last(), on.chunk(SPARE));
        step.add_row_sums((width, on.rows), (SPARE, 0), (D_WEIGHTS, feature.bias));
        on.input_vjp(step, &feature.whole(), on.chunk(SPARE), D, mask);
        on.weight_vjp(step, &attenuation.whole(), on.last(), on.chunk(ATTENUATION));
        step.add_row_sums((*outputs, on.rows), (ATTENUATION, 0), (D_WEIGHTS, attenuation.bias));
        on.input_vjp(step, &attenuation.whole(), on.chunk(ATTENUATION), D, Epilogue { add: true, ..mask });
        on.clear_shared(step);
        on.backward(step, [0, width]);
        on.share_gamma_vjp(step, None);
    }
}
