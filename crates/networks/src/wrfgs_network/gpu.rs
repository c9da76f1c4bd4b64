//! `Wrfgs` on the GPU: chunks of up to 65,536 Gaussians; the trunk once, the signal branch for each transmitter.

use super::WrfgsLayers;
use crate::dense::{self, amplitude};
use crate::encoding::encoded_width;
use crate::linear::LayerPart;
use crate::trunk::gpu::{D, D_FOLDED, D_WEIGHTS, GAMMA, GpuTrunk, NETWORK, SPARE, WEIGHTS, chunk_rows, encode_chunk};
use crate::wrfgs_branch::TxSide;
use pwrfgs_core::{DeformationInputs, DeformationVjp, Real, Result};
use pwrfgs_gpu::{Block, Epilogue, Gpu, GpuStep, KeptBuffer};

/// Slots of the trunk outputs: attenuation before |lrelu| `[R]`, feature and W·feature `[width, R]`, with the cotangent.
const ATTENUATION: usize = NETWORK;
const FEATURE: usize = NETWORK + 1;
const FROM_FEATURE: usize = NETWORK + 2;
const D_FROM_FEATURE: usize = NETWORK + 3;
/// Slots of the branch: γ(X - p) `[gamma, R]`, folded bias `[width]`, hidden layers, signal before |lrelu| `[R]`.
const OFFSET: usize = NETWORK + 4;
const SIDE: usize = NETWORK + 5;
const HIDDEN: [usize; 2] = [NETWORK + 6, NETWORK + 7];
const SIGNAL: usize = NETWORK + 8;
/// Slots of cotangents: the output `[R]`; `[3, R]` of signal, attenuation and logarithm of the gain; folded biases `[B, width]`.
const D_OUT: usize = NETWORK + 9;
const D_AMPLITUDES: usize = NETWORK + 10;
const D_SIDES: usize = NETWORK + 11;
/// Slots of cotangents of an encoding `[gamma, R]`, of the offsets and the centres `[3, R]`, and of the transmitters `[B, 3]`.
const D_GAMMA: usize = NETWORK + 12;
const D_OFFSETS: usize = NETWORK + 13;
const D_MEANS: usize = NETWORK + 14;
const D_TXS: usize = NETWORK + 15;
const FIRST: usize = NETWORK + 16;

/// Trunk outputs that all predictions share, chunk by chunk: attenuations before |lrelu|, and W·feature on the GPU.
pub(crate) struct GpuTrunkOutput(Vec<(Vec<Real>, KeptBuffer)>);

/// Requested derivatives by positions.
#[derive(Clone, Copy)]
struct Wanted {
    means: bool,
    txs: bool,
}

impl WrfgsLayers {
    /// Returns the trunk for chunks of `rows` rows; for a backward pass (`is_derived`) each layer has a slot.
    fn gpu_chunk(&self, rows: usize, is_derived: bool) -> GpuTrunk<'_> {
        GpuTrunk { trunk: &self.trunk, rows, first: FIRST, slots: if is_derived { self.trunk.depth() } else { 2 } }
    }

    /// Returns the number of components of every encoding.
    fn encoded_width(&self) -> usize {
        encoded_width(self.branch.frequencies)
    }

    /// Returns the maximum number of rows per chunk.
    fn most_rows(&self, gpu: &Gpu) -> usize {
        chunk_rows(gpu, self.trunk.width, self.encoded_width())
    }

    /// Returns the heads of attenuation and signal with their first output, which alone is used.
    fn first_outputs(&self) -> [LayerPart; 2] {
        [&self.attenuation, &self.branch.out].map(|layer| layer.with_outputs(1).whole())
    }

    /// Begins a step for N centres and B transmitters with the weights and the biases of the trunk on the GPU. `derived` adds the
    /// slots of the backward pass, with those of the derivatives by positions that it requests; `None` for predictions. A slot
    /// that is not used has size 1. Returns an error if the memory of the GPU does not suffice.
    fn begin_step<'g>(
        &self,
        gpu: &'g Gpu,
        weights: &[Real],
        (n, batch): (usize, usize),
        derived: Option<Wanted>,
    ) -> Result<GpuStep<'g>> {
        let width = self.trunk.width;
        let rows = n.min(self.most_rows(gpu));
        let on = self.gpu_chunk(rows, derived.is_some());
        // Sums of the three rows of offsets need as much of slot `SCRATCH` as heads with three outputs.
        let mut sizes = on.sizes(weights.len(), 1, 3, derived.is_some());
        sizes.resize(FIRST, 1);
        let (chunk, encoded) = (width * rows, self.encoded_width() * rows);
        (sizes[ATTENUATION], sizes[SIGNAL], sizes[SIDE]) = (rows, rows, width);
        (sizes[FEATURE], sizes[FROM_FEATURE], sizes[OFFSET]) = (chunk, chunk, encoded);
        [sizes[HIDDEN[0]], sizes[HIDDEN[1]]] = [chunk, width / 2 * rows];
        if let Some(wanted) = derived {
            (sizes[D_FROM_FEATURE], sizes[D_OUT], sizes[D_AMPLITUDES]) = (chunk, rows, 3 * rows);
            sizes[D_SIDES] = width * batch;
            if wanted.means || wanted.txs {
                (sizes[D_GAMMA], sizes[D_OFFSETS], sizes[D_MEANS], sizes[D_TXS]) =
                    (encoded, 3 * rows, 3 * rows, 3 * batch);
            }
        }
        sizes.resize(FIRST + on.slots, chunk);
        let mut step = gpu.step(&sizes)?;
        step.upload(WEIGHTS, 0, weights);
        on.upload_folded(&mut step, &self.trunk.fold_biases(weights, &[]));
        Ok(step)
    }

    /// Computes the trunk outputs for predictions; `None` if the memory of the GPU does not suffice to keep them.
    ///
    /// # Errors
    /// The GPU failed, or its memory does not suffice for a step.
    pub(crate) fn gpu_prepare(
        &self,
        gpu: &Gpu,
        weights: &[Real],
        means: &[[Real; 3]],
    ) -> Result<Option<GpuTrunkOutput>> {
        let mut step = self.begin_step(gpu, weights, (means.len(), 0), None)?;
        let mut buffers = Vec::new();
        for means in means.chunks(self.most_rows(gpu)) {
            let (on, len) = (self.gpu_chunk(means.len(), false), self.trunk.width * means.len());
            let Some(buffer) = gpu.create_kept_buffer(len) else { return Ok(None) };
            self.gpu_trunk(&mut step, on, means);
            step.read(ATTENUATION, 0, means.len());
            step.save(FROM_FEATURE, len, &buffer);
            buffers.push(buffer);
        }
        Ok(Some(GpuTrunkOutput(step.finish()?.into_iter().zip(buffers).collect())))
    }

    /// Runs the trunk for the centres of a chunk: sets slots [`ATTENUATION`], [`FEATURE`] and [`FROM_FEATURE`].
    fn gpu_trunk(&self, step: &mut GpuStep<'_>, on: GpuTrunk<'_>, means: &[[Real; 3]]) {
        step.upload(GAMMA, 0, &encode_chunk(means, self.branch.frequencies));
        on.share_gamma(step);
        on.forward(step);
        let bias = |bias| Epilogue { bias: Some((WEIGHTS, bias)), ..Epilogue::default() };
        on.apply(step, &self.first_outputs()[0], on.last(), ATTENUATION, bias(self.attenuation.bias));
        on.apply(step, &self.feature.whole(), on.last(), FEATURE, bias(self.feature.bias));
        on.apply(step, &self.branch.first_layer_parts()[0], FEATURE, FROM_FEATURE, Epilogue::default());
    }

    /// Runs the signal branch of a chunk for a transmitter, from slot [`FROM_FEATURE`]: sets slot [`SIGNAL`].
    fn gpu_branch(&self, step: &mut GpuStep<'_>, on: GpuTrunk<'_>, means: &[[Real; 3]], tx: [Real; 3], side: &TxSide) {
        let offsets: Vec<[Real; 3]> = means.iter().map(|x| std::array::from_fn(|k| x[k] - tx[k])).collect();
        step.upload(OFFSET, 0, &encode_chunk(&offsets, self.branch.frequencies));
        step.upload(SIDE, 0, &side.folded);
        let with = Epilogue { relu: true, ..Epilogue::default() };
        let first = Epilogue { plus: Some(FROM_FEATURE), bias: Some((SIDE, 0)), ..with };
        on.apply(step, &self.branch.first_layer_parts()[2], OFFSET, HIDDEN[0], first);
        let second = &self.branch.signal[1];
        on.apply(step, &second.whole(), HIDDEN[0], HIDDEN[1], Epilogue { bias: Some((WEIGHTS, second.bias)), ..with });
        let bias = Epilogue { bias: Some((WEIGHTS, self.branch.out.bias)), ..Epilogue::default() };
        on.apply(step, &self.first_outputs()[1], HIDDEN[1], SIGNAL, bias);
    }

    /// Returns S·A, `[B, N]`, as [`Self::forward`], from the result of [`Self::gpu_prepare`] if given.
    ///
    /// # Errors
    /// The GPU failed, or its memory does not suffice.
    pub(crate) fn gpu_forward(
        &self,
        gpu: &Gpu,
        inputs: &DeformationInputs<'_>,
        prepared: Option<&GpuTrunkOutput>,
    ) -> Result<Vec<Real>> {
        let (means, txs) = (inputs.means, inputs.txs.positions());
        let sides = self.branch.tx_sides(inputs.weights, txs);
        let mut step = self.begin_step(gpu, inputs.weights, (means.len(), txs.len()), None)?;
        for (chunk, means) in means.chunks(self.most_rows(gpu)).enumerate() {
            let on = self.gpu_chunk(means.len(), false);
            if let Some(GpuTrunkOutput(chunks)) = prepared {
                step.load(FROM_FEATURE, self.trunk.width * means.len(), &chunks[chunk].1);
            } else {
                self.gpu_trunk(&mut step, on, means);
            }
            step.read(ATTENUATION, 0, if prepared.is_none() { means.len() } else { 0 });
            for (tx, side) in txs.iter().zip(&sides) {
                self.gpu_branch(&mut step, on, means, *tx, side);
                step.read(SIGNAL, 0, means.len());
                step.send();
            }
        }
        // Per chunk: attenuations, none if they are prepared, then the signals of each transmitter.
        let results = step.finish()?;
        let mut products = Vec::with_capacity(means.len() * txs.len());
        for b in 1..=txs.len() {
            for (c, chunk) in results.chunks_exact(1 + txs.len()).enumerate() {
                let attenuation = prepared.map_or(&chunk[0], |GpuTrunkOutput(chunks)| &chunks[c].0);
                products.extend(chunk[b].iter().zip(attenuation).map(|(&s, &a)| amplitude(s) * amplitude(a)));
            }
        }
        Ok(products)
    }

    /// Runs the backward pass of [`Self::gpu_forward`], as [`Self::vjp`]; returns Σ d·S·A.
    ///
    /// # Errors
    /// The GPU failed, or its memory does not suffice; `sums` are then unchanged.
    pub(crate) fn gpu_vjp(
        &self,
        gpu: &Gpu,
        inputs: &DeformationInputs<'_>,
        d: &[Real],
        sums: &mut DeformationVjp<'_>,
    ) -> Result<f64> {
        let (n, txs, width) = (inputs.means.len(), inputs.txs.positions(), self.trunk.width);
        let wanted = Wanted { means: sums.means.is_some(), txs: sums.positions.is_some() };
        let sides = self.branch.tx_sides(inputs.weights, txs);
        let mut step = self.begin_step(gpu, inputs.weights, (n, txs.len()), Some(wanted))?;
        step.clear(D_WEIGHTS, inputs.weights.len());
        step.clear(D_FOLDED, 2 * width);
        step.clear(D_SIDES, width * txs.len());
        step.clear(D_TXS, if wanted.txs { 3 * txs.len() } else { 0 });
        let mut first = 0;
        for means in inputs.means.chunks(self.most_rows(gpu)) {
            let (on, rows) = (self.gpu_chunk(means.len(), true), means.len());
            self.gpu_trunk(&mut step, on, means);
            step.clear(D_FROM_FEATURE, width * rows);
            step.clear(D_AMPLITUDES, 3 * rows);
            step.clear(D_MEANS, if wanted.means { 3 * rows } else { 0 });
            for (b, (tx, side)) in txs.iter().zip(&sides).enumerate() {
                self.gpu_branch(&mut step, on, means, *tx, side);
                step.upload(D_OUT, 0, &d[b * n + first..][..rows]);
                self.gpu_branch_vjp(&mut step, on, b, wanted);
                step.send();
            }
            self.gpu_trunk_vjp(&mut step, on, wanted);
            step.read(D_AMPLITUDES, 2 * rows, rows);
            step.read(D_MEANS, 0, if wanted.means { 3 * rows } else { 0 });
            first += rows;
        }
        step.read(D_WEIGHTS, 0, inputs.weights.len());
        step.read(D_FOLDED, 0, 2 * width);
        step.read(D_SIDES, 0, width * txs.len());
        step.read(D_TXS, 0, if wanted.txs { 3 * txs.len() } else { 0 });
        Ok(self.add_results(inputs, &sides, step.finish()?, self.most_rows(gpu), sums))
    }

    /// Adds the `results` of [`Self::gpu_vjp`] to `sums`: two per chunk of `most_rows` centres, d·S·A and derivatives by
    /// the centres, then four of all chunks. Returns Σ d·S·A.
    fn add_results(
        &self,
        inputs: &DeformationInputs<'_>,
        sides: &[TxSide],
        mut results: Vec<Vec<Real>>,
        most_rows: usize,
        sums: &mut DeformationVjp<'_>,
    ) -> f64 {
        let [d_weights, d_folded, d_sides, d_txs]: [Vec<Real>; 4] =
            results.split_off(results.len() - 4).try_into().expect("four results");
        dense::add_assign(sums.weights, &d_weights);
        self.trunk.add_joint_biases(sums.weights, &self.trunk.folded_joints(&d_folded));
        let positions = sums.positions.as_deref_mut();
        self.branch.tx_sides_vjp(inputs.weights, sides, &d_sides, sums.weights, positions);
        if let Some(positions) = &mut sums.positions {
            // Those by the offsets X - p.
            positions.as_flattened_mut().iter_mut().zip(&d_txs).for_each(|(sum, d)| *sum -= d);
        }
        if let Some(d_means) = &mut sums.means {
            let chunks = d_means.chunks_mut(most_rows).zip(results.chunks_exact(2));
            for (d_means, results) in chunks {
                let rows = d_means.len();
                (d_means.iter_mut().enumerate())
                    .for_each(|(r, d)| (0..3).for_each(|k| d[k] += results[1][k * rows + r]));
            }
        }
        results.iter().step_by(2).flatten().map(|&d| f64::from(d)).sum()
    }

    /// Runs the backward pass of [`Self::gpu_branch`] for transmitter `b`, given the cotangents in slot [`D_OUT`].
    fn gpu_branch_vjp(&self, step: &mut GpuStep<'_>, on: GpuTrunk<'_>, b: usize, wanted: Wanted) {
        let (rows, width, second) = (on.rows, self.trunk.width, &self.branch.signal[1]);
        let (out, [_, _, offset_part]) = (&self.first_outputs()[1], self.branch.first_layer_parts());
        let mask = |slot| Epilogue { mask: Some(slot), ..Epilogue::default() };
        step.amplitudes_vjp(rows, [SIGNAL, ATTENUATION, D_OUT, D_AMPLITUDES]);
        on.weight_vjp(step, out, HIDDEN[1], on.chunk(D_AMPLITUDES));
        step.add_row_sums((1, rows), (D_AMPLITUDES, 0), (D_WEIGHTS, self.branch.out.bias));
        on.input_vjp(step, out, on.chunk(D_AMPLITUDES), SPARE, mask(HIDDEN[1]));
        on.weight_vjp(step, &second.whole(), HIDDEN[0], on.chunk(SPARE));
        step.add_row_sums((width / 2, rows), (SPARE, 0), (D_WEIGHTS, second.bias));
        on.input_vjp(step, &second.whole(), on.chunk(SPARE), D, mask(HIDDEN[0]));
        step.add_row_sums((width, rows), (D, 0), (D_SIDES, b * width));
        step.add(width * rows, D, D_FROM_FEATURE);
        on.weight_vjp(step, &offset_part, OFFSET, on.chunk(D));
        if !(wanted.means || wanted.txs) {
            return;
        }
        on.input_vjp(step, &offset_part, on.chunk(D), D_GAMMA, Epilogue::default());
        step.clear(D_OFFSETS, 3 * rows);
        step.encode_vjp((self.branch.frequencies, rows), [OFFSET, D_GAMMA, D_OFFSETS]);
        if wanted.means {
            step.add(3 * rows, D_OFFSETS, D_MEANS);
        }
        if wanted.txs {
            step.add_row_sums((3, rows), (D_OFFSETS, 0), (D_TXS, 3 * b));
        }
    }

    /// Runs the backward pass of [`Self::gpu_trunk`], given the cotangents in [`D_AMPLITUDES`] and [`D_FROM_FEATURE`].
    fn gpu_trunk_vjp(&self, step: &mut GpuStep<'_>, on: GpuTrunk<'_>, wanted: Wanted) {
        let (rows, width) = (on.rows, self.trunk.width);
        let ([feature_part, ..], feature) = (self.branch.first_layer_parts(), self.feature.whole());
        let mask = Epilogue { mask: Some(on.last()), ..Epilogue::default() };
        on.weight_vjp(step, &feature_part, FEATURE, on.chunk(D_FROM_FEATURE));
        on.input_vjp(step, &feature_part, on.chunk(D_FROM_FEATURE), SPARE, Epilogue::default());
        on.weight_vjp(step, &feature, on.last(), on.chunk(SPARE));
        step.add_row_sums((width, rows), (SPARE, 0), (D_WEIGHTS, self.feature.bias));
        on.input_vjp(step, &feature, on.chunk(SPARE), D, mask);
        let (attenuation, d_attenuation) = (&self.first_outputs()[0], Block::new(D_AMPLITUDES, rows, rows));
        on.weight_vjp(step, attenuation, on.last(), d_attenuation);
        step.add_row_sums((1, rows), (D_AMPLITUDES, rows), (D_WEIGHTS, self.attenuation.bias));
        on.input_vjp(step, attenuation, d_attenuation, D, Epilogue { add: true, ..mask });
        on.clear_shared(step);
        on.backward(step, [0, width]);
        on.share_gamma_vjp(step, wanted.means.then_some(D_GAMMA));
        if wanted.means {
            step.encode_vjp((self.branch.frequencies, rows), [GAMMA, D_GAMMA, D_MEANS]);
        }
    }
}
