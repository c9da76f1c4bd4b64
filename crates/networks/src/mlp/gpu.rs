//! `Mlp` on the GPU: chunks of up to 65,536 Gaussians, transmitter by transmitter.

pub(crate) mod resident;

use super::{MlpLayers, append};
use crate::dense;
use crate::trunk::gpu::{D, D_FOLDED, D_WEIGHTS, GAMMA, GpuTrunk, NETWORK, WEIGHTS, chunk_rows, encode_chunk};
use pwrfgs_core::{DeformationInputs, DeformationVjp, Deltas, Error, Real, Result};
use pwrfgs_gpu::{Epilogue, Gpu, GpuStep};
use std::ops::Range;

/// Slot of the outputs of the heads `[outputs, R]`, and of their cotangents.
const OUT: usize = NETWORK;

/// Number of the step whose activations are still on the GPU.
pub(crate) struct KeptStep(u64);

impl MlpLayers {
    /// Returns the trunk for chunks of `rows` rows; for a backward pass (`is_derived`) each layer has a slot.
    fn gpu_chunk(&self, rows: usize, is_derived: bool) -> GpuTrunk<'_> {
        let slots = if is_derived { self.trunk.depth() } else { 2 };
        GpuTrunk { trunk: &self.trunk, rows, first: OUT + 1, slots }
    }

    /// Returns the sizes of all slots for a trunk with its chunk, so many `weights`, and a `batch` of transmitters.
    fn gpu_sizes(&self, on: GpuTrunk<'_>, weights: usize, batch: usize, is_derived: bool) -> Vec<usize> {
        let mut sizes = on.sizes(weights, batch, self.heads.outputs, is_derived);
        sizes.push(self.heads.outputs * on.rows); // slot [`OUT`]
        sizes.resize(on.first + on.slots, self.trunk.width * on.rows);
        sizes
    }

    /// Returns the maximum number of rows per chunk.
    fn most_rows(&self, gpu: &Gpu) -> usize {
        chunk_rows(gpu, self.trunk.width, crate::encoding::encoded_width(self.position_frequencies))
    }

    /// Uploads γ of the centres of a chunk and computes W·γ, which all transmitters share.
    fn gpu_share_means(&self, step: &mut GpuStep<'_>, on: GpuTrunk<'_>, means: &[[Real; 3]]) {
        step.upload(GAMMA, 0, &encode_chunk(means, self.position_frequencies));
        on.share_gamma(step);
    }

    /// Returns the terms of all Gaussians and transmitters, as [`Self::forward`]; if `is_kept`, the GPU keeps the activations
    /// of the last chunk and transmitter for the derivative.
    ///
    /// # Errors
    /// The GPU failed, or its memory does not suffice.
    pub(crate) fn gpu_forward(
        &self,
        gpu: &Gpu,
        inputs: &DeformationInputs<'_>,
        is_kept: bool,
    ) -> Result<(Deltas, KeptStep)> {
        let DeformationInputs { weights, means, txs, .. } = *inputs;
        let sides = self.branch.tx_sides(weights, &self.trunk, txs);
        let most = self.most_rows(gpu);
        let sizes = self.gpu_sizes(self.gpu_chunk(means.len().min(most), is_kept), weights.len(), sides.len(), is_kept);
        let mut step = gpu.step(&sizes)?;
        let number = step.number();
        step.upload(WEIGHTS, 0, weights);
        for means in means.chunks(most) {
            let on = self.gpu_chunk(means.len(), is_kept);
            self.gpu_share_means(&mut step, on, means);
            for side in &sides {
                on.upload_folded(&mut step, &side.folded);
                on.forward(&mut step);
                let bias = Epilogue { bias: Some((WEIGHTS, self.heads.bias)), ..Epilogue::default() };
                on.apply(&mut step, &self.heads.whole(), on.last(), OUT, bias);
                step.read(OUT, 0, self.heads.outputs * means.len());
                step.send();
            }
        }
        let outputs = step.finish()?; // all transmitters of a chunk, then the next chunk
        let mut terms = Deltas::default();
        for b in 0..sides.len() {
            let tx_chunks = outputs.iter().skip(b).step_by(sides.len());
            tx_chunks.for_each(|out| append(&mut terms, &self.gather_terms(out, out.len() / self.heads.outputs)));
        }
        Ok((terms, KeptStep(number)))
    }

    /// Runs the backward pass of [`Self::gpu_forward`], as [`Self::vjp`]. Begins with the last transmitter, whose
    /// activations may still be on the GPU.
    ///
    /// # Errors
    /// The GPU failed, or its memory does not suffice; `sums` are then unchanged.
    pub(crate) fn gpu_vjp(
        &self,
        gpu: &Gpu,
        inputs: &DeformationInputs<'_>,
        d: &Deltas,
        sums: DeformationVjp<'_>,
    ) -> Result<()> {
        let DeformationInputs { weights, means, txs, .. } = *inputs;
        let kept = inputs.kept.as_ref().and_then(|kept| kept.downcast_ref::<KeptStep>());
        let sides = self.branch.tx_sides(weights, &self.trunk, txs);
        let (most, width, batch) = (self.most_rows(gpu), self.trunk.width, sides.len());
        let sizes = self.gpu_sizes(self.gpu_chunk(means.len().min(most), true), weights.len(), batch, true);
        let mut step = gpu.step(&sizes)?;
        let is_kept = means.len() <= most && kept.is_some_and(|kept| step.follows(kept.0));
        if !is_kept {
            step.upload(WEIGHTS, 0, weights);
        }
        step.clear(D_WEIGHTS, weights.len());
        step.clear(D_FOLDED, 2 * width * batch);
        for (chunk, means) in means.chunks(most).enumerate() {
            let on = self.gpu_chunk(means.len(), true);
            if !is_kept {
                self.gpu_share_means(&mut step, on, means);
            }
            on.clear_shared(&mut step);
            for (b, side) in sides.iter().enumerate().rev() {
                if !(is_kept && b + 1 == batch) {
                    on.upload_folded(&mut step, &side.folded);
                    on.forward(&mut step);
                }
                let start = b * inputs.means.len() + chunk * most;
                self.gpu_heads_vjp(&mut step, on, d, start..start + means.len());
                on.backward(&mut step, [b * width, (batch + b) * width]);
            }
            on.share_gamma_vjp(&mut step, None);
        }
        step.read(D_WEIGHTS, 0, weights.len());
        step.read(D_FOLDED, 0, 2 * width * batch);
        let [d_weights, d_folded]: [Vec<Real>; 2] = step.finish()?.try_into().expect("two results");
        dense::add_assign(sums.weights, &d_weights);
        let d_folded = self.trunk.folded_joints(&d_folded);
        self.branch.vjp(weights, &self.trunk, &sides, &d_folded, sums.weights, sums.positions);
        Ok(())
    }

    /// Runs the backward pass of the heads for a chunk and a transmitter, given the cotangents `d` of all terms `[B, N]` and
    /// the range of `terms` of the chunk. Sets slot [`D`].
    fn gpu_heads_vjp(&self, step: &mut GpuStep<'_>, on: GpuTrunk<'_>, d: &Deltas, terms: Range<usize>) {
        let mut d_out = vec![0.0; self.heads.outputs * on.rows];
        self.scatter_cotangents(d, terms, &mut d_out);
        step.upload(OUT, 0, &d_out);
        on.weight_vjp(step, &self.heads.whole(), on.last(), on.chunk(OUT));
        step.add_row_sums((self.heads.outputs, on.rows), (OUT, 0), (D_WEIGHTS, self.heads.bias));
        let mask = Epilogue { mask: Some(on.last()), ..Epilogue::default() };
        on.input_vjp(step, &self.heads.whole(), on.chunk(OUT), D, mask);
    }

    /// Records the error of a failed pass; returns zeros in place of its terms.
    pub(crate) fn zeros_after(&self, error: Error, inputs: &DeformationInputs<'_>) -> Deltas {
        pwrfgs_core::device::fail(error);
        let terms = inputs.means.len() * inputs.txs.len();
        self.gather_terms(&vec![0.0; self.heads.outputs * terms], terms)
    }
}
