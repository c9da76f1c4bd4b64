//! Training steps of [`Splatting`] with [`Mlp`] whose parameters stay on the GPU: the host passes batches, and receives losses
//! and the state after the last step.

use super::gpu::{loss_shares, view_constants};
use super::{ReceiverView, Splatting};
use pwrfgs_core::{DeviceStep, DeviceStepper, GaussianCloud, MeasurementSetup, Real, Result, TrainingState};
use pwrfgs_gpu::draw::{Drawing, GpuReadout, LISTS, LOSS, LOSS_LEN, LOSSES, TRUTHS, VIEW, VIEW_LEN};
use pwrfgs_gpu::resident::{D_HEADS, D_STATE, HEADS, INPUTS, Resident, STATE, STATS};
use pwrfgs_gpu::{Gpu, GpuStep};
use pwrfgs_networks::{Mlp, ResidentMlp, ResidentSlots};
use pwrfgs_raster::Mercator;
use std::any::Any;

/// Splatting whose parameters stay on the GPU.
pub(super) struct ResidentSplatting<'a> {
    pub(super) gpu: &'a Gpu,
    pub(super) mercator: &'a Mercator,
    pub(super) readout: GpuReadout,
    pub(super) mlp: &'a Mlp,
    pub(super) channels: usize,
    /// Maximum number of Gaussians per chunk of the network.
    pub(super) most: usize,
}

/// Buffers of some steps, and the offsets of their inputs.
struct Plan<'a> {
    network: ResidentMlp,
    resident: Resident,
    steps: &'a [DeviceStep],
    inputs: Vec<Real>,
    /// Offsets of the inputs of each step.
    offsets: Vec<StepOffsets>,
}

/// Offsets in the inputs.
struct StepOffsets {
    /// Constants of the projection, then those of the loss.
    constants: usize,
    /// Encoded transmitters, one after the other.
    transmitters: usize,
    /// Measured spectra, one after the other.
    truths: usize,
}

impl Splatting {
    /// Returns the steps on the GPU of the process; `None` without a GPU, or if a part of the method or of the setup has no
    /// kernels for them.
    pub(super) fn resident(&self, setup: &MeasurementSetup) -> Option<ResidentSplatting<'_>> {
        self.resident_on(self.gpu(setup)?, setup)
    }

    /// Returns the steps on `gpu`, as [`Self::resident`].
    pub(super) fn resident_on<'a>(&'a self, gpu: &'a Gpu, setup: &MeasurementSetup) -> Option<ResidentSplatting<'a>> {
        let (mercator, readout) = self.gpu_parts(setup).ok()?;
        let deformation: &dyn Any = self.deformation.get();
        let mlp: &Mlp = deformation.downcast_ref().filter(|mlp| ResidentMlp::supports(mlp))?;
        let (channels, most) = (self.readout.channel_count(), ResidentMlp::most_rows(mlp, gpu));
        (setup.receivers.len() == 1).then_some(ResidentSplatting { gpu, mercator, readout, mlp, channels, most })
    }
}

impl DeviceStepper for ResidentSplatting<'_> {
    fn run(&self, state: TrainingState<'_>, steps: &[DeviceStep]) -> Result<Vec<Real>> {
        let plan = self.plan(state.cloud, steps);
        let mut entries = self.gpu.resident_list_entries(plan.resident.drawing);
        loop {
            let mut step = self.gpu.training_step(&self.sizes(&plan, entries))?;
            upload_state(&mut step, &plan.resident, &state);
            step.upload(plan.resident.slot(INPUTS), 0, &plan.inputs);
            (0..steps.len()).for_each(|index| self.record(&mut step, &plan, index));
            read_state(&mut step, &plan.resident, &state);
            let mut results = step.finish()?;
            let after = results.split_off(results.len() - STATE_READS);
            // Results after lists that did not fit are not valid.
            let overflow = results.chunks_exact(LINK_READS).find(|link| link[0][0] > entries as Real);
            let Some(link) = overflow else {
                write_state(&after, state);
                return Ok(plan.losses(&results));
            };
            entries = Drawing::entry_count(&link[0])?;
        }
    }
}

/// Number of results per link: length of the tile lists, and losses.
const LINK_READS: usize = 2;
/// Number of results at the end: values and moments of the Gaussians, then of the weights, and statistics.
const STATE_READS: usize = 3;

impl ResidentSplatting<'_> {
    /// Lays out the buffers of `steps`, and collects their inputs.
    fn plan<'a>(&self, cloud: &GaussianCloud, steps: &'a [DeviceStep]) -> Plan<'a> {
        let gaussians = cloud.len();
        let drawing = ResidentMlp::slot_count(self.mlp);
        let state = drawing + LOSSES + 1; // `LOSSES` is the last slot of the drawing
        let resident = Resident { gaussians, channels: self.channels, drawing, state };
        let slots = ResidentSlots {
            means: resident.slot(STATE),
            heads: resident.slot(HEADS),
            d_heads: resident.slot(D_HEADS),
            inputs: resident.slot(INPUTS),
        };
        let network = ResidentMlp::new(self.mlp, gaussians, self.most, slots);
        let (mut inputs, mut offsets) = (Vec::new(), Vec::new());
        for step in steps {
            let constants = inputs.len();
            inputs.extend(view_constants(self.mercator, &view_of(step)));
            inputs.extend(step.ssim.1.taps());
            inputs.extend(loss_shares(step.ssim.0, step.truths.len()));
            let transmitters = inputs.len();
            let positions = step.links.conditions();
            for link in &step.links.pairs {
                inputs.extend(network.encode_transmitter(positions.positions()[link.location]));
            }
            offsets.push(StepOffsets { constants, transmitters, truths: inputs.len() });
            inputs.extend(&step.truths);
        }
        Plan { network, resident, steps, inputs, offsets }
    }

    /// Returns the sizes of all slots, with `entries` entries of the tile lists.
    fn sizes(&self, plan: &Plan<'_>, entries: usize) -> Vec<usize> {
        let mut sizes = plan.network.sizes();
        let mut drawing = Vec::new();
        for step in plan.steps {
            let step_sizes = self.shape(&plan.resident, step).sizes(Some(entries));
            drawing.resize(step_sizes.len(), 0);
            drawing.iter_mut().zip(step_sizes).for_each(|(most, size)| *most = size.max(*most));
        }
        sizes.extend(drawing);
        sizes.extend(plan.resident.sizes(plan.inputs.len()));
        sizes
    }

    /// Returns the drawing of a link in `step`.
    fn shape(&self, resident: &Resident, step: &DeviceStep) -> Drawing {
        let plane = &step.setup.plane;
        let (gaussians, size, channels) = (resident.gaussians, (plane.width, plane.height), self.channels);
        Drawing { gaussians, links: 1, size, channels, readout: self.readout, has_terms: true }
    }

    /// Records the `index`-th step, with [`LINK_READS`] results per link, and sends it to the GPU.
    fn record(&self, step: &mut GpuStep<'_>, plan: &Plan<'_>, index: usize) {
        let Plan { network, resident, steps, offsets, .. } = plan;
        let (device_step, offsets) = (&steps[index], &offsets[index]);
        let (shape, links) = (self.shape(resident, device_step), device_step.links.pairs.len());
        let (inputs, drawing) = (resident.slot(INPUTS), resident.drawing);
        step.clear(resident.slot(D_STATE), resident.parameters());
        step.copy_numbers((inputs, offsets.constants), drawing + VIEW, VIEW_LEN);
        step.copy_numbers((inputs, offsets.constants + VIEW_LEN), drawing + LOSS, LOSS_LEN);
        resident.sort(step, view_of(device_step).pose.position.map(|x| x as Real));
        resident.arrange_cloud(step);
        network.begin(step);
        for link in 0..links {
            let tx = offsets.transmitters + link * network.encoded_width();
            network.forward(step, tx);
            resident.arrange_heads(step);
            step.copy_numbers((inputs, offsets.truths + link * shape.pixels()), drawing + TRUTHS, shape.pixels());
            step.with_base(drawing, |step| draw_and_differentiate(step, &shape, device_step));
            resident.scatter(step, shape.size, links);
            network.backward(step, tx);
        }
        network.end(step);
        plan.update(step, device_step);
        step.send();
    }
}

impl Plan<'_> {
    /// Records the updates of all columns of the Gaussians and of the weights.
    fn update(&self, step: &mut GpuStep<'_>, device_step: &DeviceStep) {
        let Self { resident, network, .. } = self;
        let mut start = 0;
        // Widths of means, log scales, rotations, opacity logits and signals.
        for (update, width) in device_step.columns.iter().zip([3, 3, 4, 1, 2]) {
            let end = start + width * resident.gaussians;
            if let Some(update) = update {
                let state = (resident.slot(STATE), resident.parameters());
                step.adam(state, resident.slot(D_STATE), start..end, update);
            }
            start = end;
        }
        for (range, update) in &device_step.weights {
            let weights = (ResidentMlp::WEIGHTS, network.weight_count());
            step.adam(weights, ResidentMlp::D_WEIGHTS, range.clone(), update);
        }
    }

    /// Returns the loss of each step, given the results of all links.
    fn losses(&self, results: &[Vec<Real>]) -> Vec<Real> {
        let mut links = results.chunks_exact(LINK_READS);
        let one = |(step, offsets): (&DeviceStep, &StepOffsets)| {
            let shares = &self.inputs[offsets.transmitters - 2..]; // of `loss_shares`, the last constants
            let sums = links.by_ref().take(step.links.pairs.len());
            sums.map(|link| shares[0] * link[1][0] + shares[1] * link[1][1]).sum()
        };
        self.steps.iter().zip(&self.offsets).map(one).collect()
    }
}

/// Returns the view of the receiver in a step.
fn view_of(step: &DeviceStep) -> ReceiverView {
    ReceiverView { pose: step.setup.pose(), plane: step.setup.plane.clone() }
}

/// Records drawing, loss and their derivatives for a link, and requests the [`LINK_READS`] results.
fn draw_and_differentiate(step: &mut GpuStep<'_>, shape: &Drawing, device_step: &DeviceStep) {
    shape.project(step);
    shape.blend(step);
    shape.read_out(step);
    shape.loss(step, device_step.is_squared, device_step.ssim.0 > 0.0);
    shape.read_out_vjp(step);
    shape.blend_vjp(step);
    shape.project_vjp(step);
    step.read(LISTS, shape.tiles(), 1);
    step.read(LOSSES, 0, 2);
}

/// Uploads values and moments of Gaussians and weights, and the statistics.
fn upload_state(step: &mut GpuStep<'_>, resident: &Resident, state: &TrainingState<'_>) {
    let [first, second] = &*state.cloud_moments;
    let clouds = [&*state.cloud, first, second];
    let columns = clouds.iter().flat_map(|cloud| cloud.columns()).flat_map(|(_, _, values)| values);
    step.upload(resident.slot(STATE), 0, &columns.copied().collect::<Vec<_>>());
    let [first, second] = &*state.weight_moments;
    step.upload(ResidentMlp::WEIGHTS, 0, &[&*state.weights, first, second].concat());
    step.upload(resident.slot(STATS), 0, &state.stats.columns().map(|(_, column)| column).concat());
}

/// Requests the [`STATE_READS`] results at the end, in the layout of [`upload_state`].
fn read_state(step: &mut GpuStep<'_>, resident: &Resident, state: &TrainingState<'_>) {
    // Each value has two moments.
    step.read(resident.slot(STATE), 0, 3 * resident.parameters());
    step.read(ResidentMlp::WEIGHTS, 0, 3 * state.weights.len());
    step.read(resident.slot(STATS), 0, state.stats.columns().len() * resident.gaussians);
}

/// Writes the results that [`read_state`] requested to `state`.
fn write_state(results: &[Vec<Real>], state: TrainingState<'_>) {
    let mut numbers = &results[0][..];
    let [first, second] = state.cloud_moments;
    for cloud in [state.cloud, first, second] {
        cloud.columns_mut().for_each(|(_, _, column)| take(&mut numbers, column));
    }
    let mut numbers = &results[1][..];
    let [first, second] = state.weight_moments;
    for values in [state.weights, first, second] {
        take(&mut numbers, values);
    }
    let mut numbers = &results[2][..];
    state.stats.columns_mut().into_iter().for_each(|(_, column)| take(&mut numbers, column));
}

/// Moves the first of `numbers` to `values`.
fn take(numbers: &mut &[Real], values: &mut [Real]) {
    let (first, rest) = numbers.split_at(values.len());
    values.copy_from_slice(first);
    *numbers = rest;
}
