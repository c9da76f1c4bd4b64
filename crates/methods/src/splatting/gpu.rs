//! Drawing of [`Splatting`] on a GPU, in the same order of operations as on the CPU. The CPU sorts by depth, once per receiver
//! and step, because the network moves no centre; it also adds the terms of the network to the signals.

use super::{ReceiverView, Splatting};
use crate::groups::ReceiverGroup;
use crate::{ActivationVjp, Calibration, Readout};
use pwrfgs_core::{
    Call, Deltas, MeasurementSetup, MethodVjp, Parameters, Real, RenderVjp, Result, Sampling, Splats, device,
};
use pwrfgs_gpu::draw::{
    CLOUD, D_IMAGE, D_ROWS, D_SPLATS, Drawing, GpuReadout, IMAGE, PIXELS, SIGNALS, TERMS, VIEW, VIEW_LEN, WIDTHS,
};
use pwrfgs_gpu::{Gpu, GpuStep};
use pwrfgs_raster::{AlphaBlending, Mercator, Support};
use std::any::Any;
use std::sync::Arc;

/// State of drawings on the GPU for the backward pass.
#[derive(Debug)]
pub(super) struct GpuDrawing {
    /// Number of the step, whose last group may still be on the GPU.
    step: u64,
    groups: Vec<DrawnGroup>,
}

/// Links with one geometry.
#[derive(Debug)]
struct DrawnGroup {
    group: ReceiverGroup,
    view: ReceiverView,
    shape: Drawing,
    /// Indices of the Gaussians, nearest first.
    order: Arc<Vec<u32>>,
    /// Lengths of the tile lists.
    lengths: Vec<Real>,
}

impl Splatting {
    /// Returns the GPU of the process if it draws for this setup; records the part that has no kernels.
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

    /// Returns projector and readout if the GPU has kernels for all parts; otherwise the part without.
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
        match setup {
            _ if setup.moving.is_receiver() => Err("drawing for moving receivers".into()),
            _ if !setup.plane.wraps => Err("drawing of images that do not wrap".into()),
            _ => Ok((mercator, readout)),
        }
    }

    /// Draws all links; returns the observations, and the state for the backward pass. If the GPU fails, records the error
    /// and returns zeros.
    pub(super) fn gpu_draw(&self, gpu: &Gpu, call: &Call<'_>, deltas: &Deltas) -> (Vec<Real>, Option<GpuDrawing>) {
        match self.gpu_observations(gpu, call, deltas) {
            Ok((numbers, drawing)) => (numbers, Some(drawing)),
            Err(error) => {
                device::fail(error);
                (vec![0.0; call.links.pairs.len() * call.setup.value_count()], None)
            }
        }
    }

    /// Draws as [`Self::gpu_draw`].
    ///
    /// # Errors
    /// The GPU failed.
    pub(super) fn gpu_observations(
        &self,
        gpu: &Gpu,
        call: &Call<'_>,
        deltas: &Deltas,
    ) -> Result<(Vec<Real>, GpuDrawing)> {
        let mut groups = self.gpu_groups(call, deltas);
        let mut step = gpu.drawing_step(&sizes_of(&groups, None))?;
        let number = step.number();
        let mut last = None;
        for drawn in &groups {
            self.upload_group(&mut step, call, deltas, drawn, last.replace(drawn.group.row));
            let DrawnGroup { shape, .. } = drawn;
            shape.project(&mut step);
            shape.blend(&mut step);
            shape.read_out(&mut step);
            let images = shape.links * shape.pixels();
            step.read(IMAGE, 0, images);
            step.read(PIXELS, 2 * images, shape.tiles());
            step.send();
        }
        let numbers = call.setup.value_count();
        let mut all = vec![0.0; call.links.pairs.len() * numbers];
        for (drawn, results) in groups.iter_mut().zip(step.finish()?.chunks_exact_mut(2)) {
            drawn.group.scatter_rows(&results[0], numbers, &mut all);
            drawn.lengths = std::mem::take(&mut results[1]);
        }
        Ok((all, GpuDrawing { step: number, groups }))
    }

    /// Runs the backward pass of [`Self::gpu_draw`], given the cotangents `d` of the observations; adds to `grads` and to
    /// existence factors and statistics of `sums`. Begins with the last group, which may still be on the GPU.
    ///
    /// # Errors
    /// The GPU failed; the sums are then unchanged.
    pub(super) fn gpu_draw_vjp(
        &self,
        gpu: &Gpu,
        call: &Call<'_>,
        GpuDrawing { step: number, groups }: &GpuDrawing,
        (deltas, d): (&Deltas, &[Real]),
        grads: &mut ActivationVjp,
        sums: &mut MethodVjp,
    ) -> Result<()> {
        let mut entries = 0;
        for drawn in groups {
            entries = entries.max(Drawing::entries(&drawn.lengths)?);
        }
        let mut step = gpu.drawing_step(&sizes_of(groups, Some(entries)))?;
        let mut is_kept = step.follows(*number);
        let mut last = None;
        for drawn in groups.iter().rev() {
            let DrawnGroup { shape, .. } = drawn;
            let uploaded = last.replace(drawn.group.row);
            if !std::mem::take(&mut is_kept) {
                self.upload_group(&mut step, call, deltas, drawn, uploaded);
                shape.project(&mut step);
                shape.blend(&mut step);
            }
            step.upload(D_IMAGE, 0, &drawn.group.gather_rows(d, call.setup.value_count()));
            shape.read_out_vjp(&mut step);
            shape.blend_vjp(&mut step, &drawn.lengths);
            shape.project_vjp(&mut step);
            step.read(D_SPLATS, 0, shape.gaussians * shape.derivatives());
            step.read(D_ROWS, 0, shape.gaussians * WIDTHS[3]);
            step.send();
        }
        let results = step.finish()?;
        for (drawn, results) in groups.iter().rev().zip(results.chunks_exact(2)) {
            self.add_group(call, deltas, drawn, [&results[0], &results[1]], grads, sums);
            sums.stats.add_render(
                &(0..drawn.shape.gaussians).collect::<Vec<_>>(),
                &radii_of(drawn, &results[1]),
                &render_vjp(drawn, &results[0]),
                &drawn.view.plane,
                groups.len(),
            );
        }
        Ok(())
    }

    /// Returns the links of `call` by geometry, without tile lists. Sorts before a step begins: sorting uses threads that
    /// could take up work that waits for the GPU.
    fn gpu_groups(&self, call: &Call<'_>, deltas: &Deltas) -> Vec<DrawnGroup> {
        let Call { setup, parameters: p, links, .. } = *call;
        let (plane, has_terms) = (self.sky(setup), !(deltas.scales.is_empty() && deltas.quats.is_empty()));
        let readout = self.gpu_parts(setup).map_or(GpuReadout::Magnitude, |(_, readout)| readout);
        let mut all: Vec<DrawnGroup> = Vec::new();
        for group in ReceiverGroup::from_links(links, !self.deformation.traits().varies_geometry) {
            let order = all.last().filter(|last| last.group.row == group.row).map(|last| Arc::clone(&last.order));
            let order = order.unwrap_or_else(|| Mercator::depth_order(&p.cloud.means, &group.state.pose).into());
            let (gaussians, size) = (p.cloud.len(), (plane.width, plane.height));
            let (links, channels) = (group.links.len(), self.readout.channel_count());
            let shape = Drawing { gaussians, links, size, channels, readout, has_terms };
            let view = ReceiverView { pose: group.state.pose, plane: plane.clone() };
            all.push(DrawnGroup { group, view, shape, order, lengths: Vec::new() });
        }
        all
    }

    /// Writes the inputs of a group, in depth order; Gaussians and view only if those of another receiver were written
    /// last.
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
            let mut rows = Vec::with_capacity(WIDTHS[0] * n);
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
            let mut rows = Vec::with_capacity(WIDTHS[1] * n);
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

    /// Adds the derivatives of a group by splats and by Gaussians.
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
                order.iter().zip(d_splats.chunks_exact(width)).zip(d_rows.as_chunks::<{ WIDTHS[3] }>().0)
            {
                let (i, term) = (i as usize, batch.start * n + i as usize);
                let ActivationVjp { cloud, deltas, gate } = &mut *grads;
                add(&mut cloud.means[i], &row[..3]);
                add(&mut cloud.log_scales[i], &row[3..6]);
                add(&mut cloud.quats[i], &row[6..10]);
                cloud.opacity_logits[i] += row[10];
                gate[i] += row[11];
                deltas.scales.get_mut(term).into_iter().for_each(|sum| add(sum, &row[12..15]));
                deltas.quats.get_mut(term).into_iter().for_each(|sum| add(sum, &row[15..19]));
                let [.., d_existence] = splat[..8] else { continue };
                sums.existence[i] += if p.existence.is_some() { d_existence } else { 0.0 };
                d_signals[i * (width - 8)..][..width - 8].copy_from_slice(&splat[8..]);
            }
            self.activation().signals_vjp(p.cloud, terms, batch, &d_signals, grads);
        });
    }
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
    let mut all = [0.0; VIEW_LEN];
    all[..19].copy_from_slice(&mercator.constants(&view.pose, &whole));
    all[19..].copy_from_slice(&[stride, offset[0], offset[1], whole.height].map(|number| number as Real));
    all
}

/// Returns splats with radii only, for statistics.
fn radii_of(DrawnGroup { order, .. }: &DrawnGroup, d_rows: &[Real]) -> Splats {
    let mut radii = vec![0.0; order.len()];
    let rows = d_rows.as_chunks::<{ WIDTHS[3] }>().0;
    order.iter().zip(rows).for_each(|(&i, [.., radius])| radii[i as usize] = *radius);
    Splats { radii, ..Splats::default() }
}

/// Returns the cotangents that statistics use: those of the centres, and the weights.
fn render_vjp(DrawnGroup { order, shape, .. }: &DrawnGroup, d_splats: &[Real]) -> RenderVjp {
    let (mut means2d, mut weights) = (vec![[0.0; 2]; order.len()], vec![0.0; order.len()]);
    for (&i, row) in order.iter().zip(d_splats.chunks_exact(shape.derivatives())) {
        (means2d[i as usize], weights[i as usize]) = ([row[0], row[1]], row[6]);
    }
    RenderVjp { splats: Splats { means2d, ..Splats::default() }, signals: Vec::new(), weights }
}
