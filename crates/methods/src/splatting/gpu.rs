//! Drawing of [`Splatting`] on a GPU, in the same order of operations as on the CPU. The CPU sorts by depth, once per
//! receiver and step, because the network moves no centre. It also adds the terms of the network to the signals.

use super::{ReceiverView, Splatting};
use crate::groups::{ReceiverGroup, network_vjp};
use crate::{ActivationVjp, Calibration, Readout};
use pwrfgs_core::{
    Call, DeformationInputs, Deltas, MeasurementSetup, MethodVjp, Parameters, Real, RenderVjp, Result, Sampling,
    SpectrumLoss, Splats, WantedInputs, device,
};
use pwrfgs_gpu::draw::{
    CLOUD, D_IMAGE, D_ROWS, D_SPLATS, Drawing, EXISTENCE, GEOMETRY, GpuReadout, IMAGE, LOSS, LOSSES, PIXELS, SIGNALS,
    TERMS, TRUTHS, VIEW, VIEW_LEN, WEIGHT, WIDTHS,
};
use pwrfgs_gpu::{Gpu, GpuStep};
use pwrfgs_raster::{AlphaBlending, Mercator, Support};
use std::any::Any;
use std::sync::Arc;

/// Origin of the cotangents of the observations.
#[derive(Clone, Copy)]
pub(super) enum Cotangents<'a> {
    /// Given, `[L, H·W]`.
    Given(&'a [Real]),
    /// Those of a loss, which the GPU computes too.
    OfLoss(&'a SpectrumLoss<'a>),
}

/// Number of results of a group in a backward pass, in the order of `record_vjp`: lengths of tile lists, losses, derivatives
/// by splats and by Gaussians.
const RESULTS: usize = 4;

/// Values per Gaussian in slot [`D_ROWS`].
const ROW_WIDTH: usize = WIDTHS[3];

/// Links with one geometry.
#[derive(Debug)]
struct DrawnGroup {
    group: ReceiverGroup,
    view: ReceiverView,
    shape: Drawing,
    /// Indices of the Gaussians, nearest first.
    order: Arc<Vec<u32>>,
}

impl Splatting {
    /// Returns the GPU of the process; `None` without a GPU, or if a part has no kernels, which is then recorded.
    pub(super) fn gpu(&self, setup: &MeasurementSetup) -> Option<&'static Gpu> {
        let gpu = pwrfgs_gpu::current()?;
        match self.gpu_parts(setup) {
            Ok(_) => Some(gpu),
            Err(part) => {
                device::set_cpu_part(&part);
                None
            }
        }
    }

    /// Returns projector and readout if the GPU has kernels for all parts; the error names the part without.
    pub(super) fn gpu_parts(&self, setup: &MeasurementSetup) -> Result<(&Mercator, GpuReadout), String> {
        let (projector, rasterizer): (&dyn Any, &dyn Any) = (self.projector.get(), self.rasterizer.get());
        let mercator =
            projector.downcast_ref().ok_or_else(|| format!("projector {}", self.projector.typetag_name()))?;
        let readout = match self.readout {
            Readout::Real => GpuReadout::Real,
            Readout::Magnitude => GpuReadout::Magnitude,
            Readout::Power => GpuReadout::Power,
            Readout::MinMax => GpuReadout::MinMax,
            Readout::ReceivedPower { .. } => return Err("readout ReceivedPower".into()),
        };
        match rasterizer.downcast_ref::<AlphaBlending>().map(|blending| blending.support) {
            Some(Support::Exact) => {}
            Some(Support::TileSquares) => return Err("rasterizer AlphaBlending(support: TileSquares)".into()),
            None => return Err(format!("rasterizer {}", self.rasterizer.typetag_name())),
        }
        if self.calibration == Calibration::AsReleased {
            return Err("calibration AsReleased".into());
        }
        if setup.moving.is_receiver() {
            return Err("drawing for moving receivers".into());
        }
        if !setup.plane.wraps {
            return Err("drawing of images that do not wrap".into());
        }
        Ok((mercator, readout))
    }

    /// Returns the observations `[L, H·W]` of all links.
    ///
    /// # Errors
    /// The GPU failed.
    pub(super) fn gpu_draw(&self, gpu: &Gpu, call: &Call<'_>, deltas: &Deltas) -> Result<Vec<Real>> {
        let groups = self.gpu_groups(call, deltas);
        let mut step = gpu.drawing_step(&sizes_of(&groups, None))?;
        let mut last = None;
        for drawn in &groups {
            self.record_drawing(&mut step, call, deltas, drawn, last.replace(drawn.group.row));
            step.read(IMAGE, 0, drawn.shape.links * drawn.shape.pixels());
            step.send();
        }
        let numbers = call.setup.value_count();
        let mut observations = vec![0.0; call.links.pairs.len() * numbers];
        for (drawn, images) in groups.iter().zip(step.finish()?) {
            drawn.group.scatter_rows(&images, numbers, &mut observations);
        }
        Ok(observations)
    }

    /// Draws all links and runs the backward pass, group by group. Adds to `grads`, and to existence factors and statistics
    /// of `sums`. Returns the loss; 0 for given cotangents.
    ///
    /// # Errors
    /// The GPU failed, or its tile lists would be too long; the sums are then unchanged.
    pub(super) fn gpu_draw_vjp(
        &self,
        gpu: &Gpu,
        call: &Call<'_>,
        (deltas, d): (&Deltas, Cotangents<'_>),
        grads: &mut ActivationVjp,
        sums: &mut MethodVjp,
    ) -> Result<Real> {
        let groups = self.gpu_groups(call, deltas);
        let mut entries = gpu.list_entries();
        let results = loop {
            let mut step = gpu.drawing_step(&sizes_of(&groups, Some(entries)))?;
            self.record_vjp(&mut step, call, (deltas, d), &groups);
            let results = step.finish()?;
            let mut needed = 0;
            for lengths in results.chunks_exact(RESULTS).map(|group_results| &group_results[0]) {
                needed = needed.max(Drawing::entry_count(lengths)?);
            }
            if needed <= entries {
                break results;
            }
            entries = needed; // the lists did not fit, so results are not valid
        };
        let mut loss = 0.0;
        for (drawn, results) in groups.iter().zip(results.chunks_exact(RESULTS)) {
            let [_, losses, d_splats, d_rows] = [0, 1, 2, 3].map(|k| &results[k][..]);
            loss += losses.chunks_exact(2).map(|link| weigh_loss(d, link)).sum::<Real>();
            self.add_group(call, deltas, drawn, [d_splats, d_rows], grads, sums);
            let rows: Vec<usize> = (0..drawn.shape.gaussians).collect();
            let d_render = render_vjp(drawn, d_splats);
            sums.stats.add_render(&rows, &radius_splats(drawn, d_rows), &d_render, &drawn.view.plane, groups.len());
        }
        Ok(loss)
    }

    /// Returns the loss of the predictions and its derivative. If the GPU fails, records the error and returns zeros.
    pub(super) fn gpu_loss_vjp(&self, gpu: &Gpu, call: &Call<'_>, loss: &SpectrumLoss<'_>) -> (Real, MethodVjp) {
        let Call { setup, parameters: p, links, .. } = *call;
        let mut sums = MethodVjp::zeros(call, WantedInputs::default());
        let (deltas, kept) = self.network_terms(call, &None, true);
        let mut grads = ActivationVjp::zeros(p.cloud, &deltas);
        let d = (&deltas, Cotangents::OfLoss(loss));
        let value = self.gpu_draw_vjp(gpu, call, d, &mut grads, &mut sums).unwrap_or_else(|error| {
            device::fail(error);
            0.0
        });
        let (weights, pose) = (self.split_weights(setup, p.weights).0, setup.pose());
        let inputs =
            DeformationInputs { weights, means: &p.cloud.means, txs: links.conditions(), pose: &pose, kept: &kept };
        network_vjp(&*self.deformation, &inputs, &grads, &mut sums);
        (value, sums)
    }

    /// Records the drawing of a group and its readout; `last` is the receiver row whose Gaussians were uploaded last.
    fn record_drawing(
        &self,
        step: &mut GpuStep<'_>,
        call: &Call<'_>,
        deltas: &Deltas,
        drawn: &DrawnGroup,
        last: Option<usize>,
    ) {
        self.upload_group(step, call, deltas, drawn, last);
        drawn.shape.project(step);
        drawn.shape.blend(step);
        drawn.shape.read_out(step);
    }

    /// Records drawing and backward pass of all groups, with [`RESULTS`] results for each.
    fn record_vjp(
        &self,
        step: &mut GpuStep<'_>,
        call: &Call<'_>,
        (deltas, d): (&Deltas, Cotangents<'_>),
        groups: &[DrawnGroup],
    ) {
        if let Cotangents::OfLoss(loss) = d {
            let shares = loss_shares(loss.ssim_weight, loss.truths.len());
            step.upload(LOSS, 0, &[&loss.window.taps()[..], &shares].concat());
        }
        let (mut last, numbers) = (None, call.setup.value_count());
        for drawn in groups {
            let DrawnGroup { shape, group, .. } = drawn;
            self.record_drawing(step, call, deltas, drawn, last.replace(group.row));
            match d {
                Cotangents::Given(d) => step.upload(D_IMAGE, 0, &group.gather_rows(d, numbers)),
                Cotangents::OfLoss(loss) => {
                    step.upload(TRUTHS, 0, &group.gather_rows(loss.truths, numbers));
                    shape.loss(step, loss.is_squared, loss.ssim_weight > 0.0);
                }
            }
            shape.read_out_vjp(step);
            shape.blend_vjp(step);
            shape.project_vjp(step);
            step.read(PIXELS, 2 * shape.links * shape.pixels(), shape.tiles()); // lengths of the tile lists
            step.read(LOSSES, 0, 2 * shape.links);
            step.read(D_SPLATS, 0, shape.gaussians * shape.derivatives());
            step.read(D_ROWS, 0, shape.gaussians * ROW_WIDTH);
            step.send();
        }
    }

    /// Groups the links of `call` by geometry, and sorts the Gaussians of each receiver by depth. Call it before a step
    /// begins: sorting uses threads that could take up work that waits for the GPU.
    fn gpu_groups(&self, call: &Call<'_>, deltas: &Deltas) -> Vec<DrawnGroup> {
        let Call { setup, parameters: p, links, .. } = *call;
        let (plane, has_terms) = (self.sky(setup), !(deltas.scales.is_empty() && deltas.quats.is_empty()));
        // [`Self::gpu`] has checked that there are kernels for all parts.
        let readout = self.gpu_parts(setup).map_or(GpuReadout::Magnitude, |(_, readout)| readout);
        let mut groups: Vec<DrawnGroup> = Vec::new();
        for group in ReceiverGroup::from_links(links, !self.deformation.traits().varies_geometry) {
            let order = groups.last().filter(|last| last.group.row == group.row).map(|last| Arc::clone(&last.order));
            let order = order.unwrap_or_else(|| Mercator::depth_order(&p.cloud.means, &group.state.pose).into());
            let (gaussians, links, size) = (p.cloud.len(), group.links.len(), (plane.width, plane.height));
            let shape = Drawing { gaussians, links, size, channels: self.readout.channel_count(), readout, has_terms };
            let view = ReceiverView { pose: group.state.pose, plane: plane.clone() };
            groups.push(DrawnGroup { group, view, shape, order });
        }
        groups
    }

    /// Uploads the inputs of a group, in depth order; Gaussians and view only if `last`, the receiver row of the previous upload,
    /// differs.
    fn upload_group(
        &self,
        step: &mut GpuStep<'_>,
        call: &Call<'_>,
        deltas: &Deltas,
        drawn: &DrawnGroup,
        last: Option<usize>,
    ) {
        let Call { setup, parameters: Parameters { cloud, gate, existence, .. }, .. } = *call;
        let DrawnGroup { group, view, shape, order, .. } = drawn;
        let n = cloud.len();
        if last != Some(group.row) {
            let mut rows = Vec::with_capacity(WIDTHS[0] * n); // the columns of slot `CLOUD`
            for i in order.iter().map(|&i| i as usize) {
                rows.extend([cloud.means[i], cloud.log_scales[i]].as_flattened());
                rows.extend(cloud.quats[i]);
                let factor = |factors: Option<&[Real]>| factors.map_or(1.0, |factors| factors[i]);
                rows.extend([cloud.opacity_logits[i], factor(gate), factor(existence)]);
            }
            step.upload(CLOUD, 0, &rows);
            if let Ok((mercator, _)) = self.gpu_parts(setup) {
                step.upload(VIEW, 0, &view_constants(mercator, view));
            }
        }
        let (terms, batch) = group.gather_terms(deltas, n);
        if shape.has_terms {
            let mut rows = Vec::with_capacity(WIDTHS[1] * n); // the columns of slot `TERMS`
            for i in order.iter().map(|&i| batch.start * n + i as usize) {
                rows.extend(terms.scales.get(i).copied().unwrap_or_default());
                rows.extend(terms.quats.get(i).copied().unwrap_or_default());
            }
            step.upload(TERMS, 0, &rows);
        }
        let signals = self.activation().signals(cloud, &terms, batch);
        let width = shape.links * shape.channels;
        let sorted = order.iter().flat_map(|&i| &signals[i as usize * width..][..width]);
        step.upload(SIGNALS, 0, &sorted.copied().collect::<Vec<_>>());
    }

    /// Adds the derivatives of a group, given the rows of slots [`D_SPLATS`] and [`D_ROWS`], to `grads`; those by existence
    /// factors to `sums`.
    fn add_group(
        &self,
        call: &Call<'_>,
        deltas: &Deltas,
        DrawnGroup { group, shape, order, .. }: &DrawnGroup,
        [d_splats, d_rows]: [&[Real]; 2],
        grads: &mut ActivationVjp,
        sums: &mut MethodVjp,
    ) {
        let (p, n, width) = (call.parameters, shape.gaussians, shape.derivatives());
        let mut d_signals = vec![0.0; n * shape.links * shape.channels];
        group.gather_terms_vjp(deltas, grads, |terms, batch, grads| {
            for ((&i, splat), row) in
                order.iter().zip(d_splats.chunks_exact(width)).zip(d_rows.as_chunks::<ROW_WIDTH>().0)
            {
                let (i, term) = (i as usize, batch.start * n + i as usize);
                let ActivationVjp { cloud, deltas, gate } = &mut *grads;
                // The columns of slot `D_ROWS`.
                add(&mut cloud.means[i], &row[..3]);
                add(&mut cloud.log_scales[i], &row[3..6]);
                add(&mut cloud.quats[i], &row[6..10]);
                cloud.opacity_logits[i] += row[10];
                gate[i] += row[11];
                deltas.scales.get_mut(term).into_iter().for_each(|sum| add(sum, &row[12..15]));
                deltas.quats.get_mut(term).into_iter().for_each(|sum| add(sum, &row[15..19]));
                let (d_geometry, d_signal) = splat.split_at(GEOMETRY);
                sums.existence[i] += if p.existence.is_some() { d_geometry[EXISTENCE] } else { 0.0 };
                d_signals[i * d_signal.len()..][..d_signal.len()].copy_from_slice(d_signal);
            }
            self.activation().signals_vjp(p.cloud, terms, batch, &d_signals, grads);
        });
    }
}

/// Returns the shares of the error and of 1-SSIM of a pixel in the loss of spectra with so many `pixels` in all.
pub(super) fn loss_shares(ssim_weight: Real, pixels: usize) -> [Real; 2] {
    [(1.0 - ssim_weight) / pixels as Real, ssim_weight / pixels as Real]
}

/// Returns the part of a link in the loss, given its sums of errors and of 1-SSIM; 0 for given cotangents.
fn weigh_loss(d: Cotangents<'_>, sums: &[Real]) -> Real {
    let Cotangents::OfLoss(loss) = d else { return 0.0 };
    loss_shares(loss.ssim_weight, loss.truths.len()).iter().zip(sums).map(|(share, sum)| share * sum).sum()
}

/// Adds numbers to sums.
fn add(sums: &mut [Real], numbers: &[Real]) {
    sums.iter_mut().zip(numbers).for_each(|(sum, number)| *sum += number);
}

/// Returns the sizes of the slots for all groups; see [`Drawing::sizes`].
fn sizes_of(groups: &[DrawnGroup], entries: Option<usize>) -> Vec<usize> {
    let widest = groups.iter().map(|drawn| drawn.shape).max_by_key(|shape| shape.links);
    widest.map_or_else(Vec::new, |shape| shape.sizes(entries))
}

/// Returns the values of slot [`VIEW`].
pub(super) fn view_constants(mercator: &Mercator, view: &ReceiverView) -> [Real; VIEW_LEN] {
    let (whole, Sampling { stride, offset, .. }) = (view.plane.whole(), view.plane.sampling);
    let constants = mercator.constants(&view.pose, &whole);
    let mut values = [0.0; VIEW_LEN];
    let (projection, sampling) = values.split_at_mut(constants.len());
    projection.copy_from_slice(&constants);
    sampling.copy_from_slice(&[stride, offset[0], offset[1], whole.height].map(|number| number as Real));
    values
}

/// Returns splats with radii only, for statistics: the last column of slot [`D_ROWS`], in the order of the Gaussians.
fn radius_splats(DrawnGroup { order, .. }: &DrawnGroup, d_rows: &[Real]) -> Splats {
    let mut radii = vec![0.0; order.len()];
    let rows = d_rows.as_chunks::<ROW_WIDTH>().0;
    order.iter().zip(rows).for_each(|(&i, [.., radius])| radii[i as usize] = *radius);
    Splats { radii, ..Splats::default() }
}

/// Returns the part of the backward pass that statistics use: the cotangents of the centres, the first two columns of slot
/// [`D_SPLATS`], and the blending weights.
fn render_vjp(DrawnGroup { order, shape, .. }: &DrawnGroup, d_splats: &[Real]) -> RenderVjp {
    let (mut means2d, mut weights) = (vec![[0.0; 2]; order.len()], vec![0.0; order.len()]);
    for (&i, row) in order.iter().zip(d_splats.chunks_exact(shape.derivatives())) {
        (means2d[i as usize], weights[i as usize]) = ([row[0], row[1]], row[WEIGHT]);
    }
    RenderVjp { splats: Splats { means2d, ..Splats::default() }, signals: Vec::new(), weights }
}
