//! Splatting as a [`Method`]: from links to observations, and the backward pass.

use super::backward::{BackwardPass, Drawing};
use super::received::{self, PathLossLaws};
use super::survey::SurveyRequest;
use super::{Geometry, GroupOutput, ReceiverView, Splatting};
use crate::groups::{self, OFFSETS, ReceiverGroup};
use crate::{ActivationVjp, Calibration, Readout};
use pwrfgs_core::{
    Activated, Appearance, Cache, Call, Cost, Dataset, DeformationInputs, Deltas, Elevation, ForwardOutput,
    GaussianCloud, ImagePlane, Layout, MeasurementSetup, Method, MethodTraits, MethodVjp, Misfit, Needs, Parameters,
    PassStatistics, Real, StageTimes, WeightSpec, cached, sigmoid,
};
use rayon::prelude::*;
use std::borrow::Cow;
use std::sync::Arc;
use std::time::Instant;

/// Names of the learned parameters of receivers of powers, in the order of the weights.
const LAW: [&str; 2] = [OFFSETS, "receiver.exponents"];

/// State of the forward pass for [`Method::vjp`].
struct ForwardCache {
    /// Terms of the network, and its state for the backward pass.
    terms: (Deltas, Cache),
    /// Drawings on the CPU.
    drawings: Vec<Drawing>,
}

/// Values that do not depend on the transmitter.
struct Ready {
    deformation: Cache,
    /// Geometry per receiver, if it does not depend on the transmitter.
    shared_geometry: Vec<Arc<Geometry>>,
}

impl Splatting {
    /// Splits the weights into those of the network and those of the receivers, which only powers have.
    pub(super) fn split_weights<'a>(
        &self,
        setup: &MeasurementSetup,
        weights: &'a [Real],
    ) -> (&'a [Real], PathLossLaws<'a>) {
        let (network, laws) = weights.split_at(weights.len() - self.law_parameter_count(setup));
        let (offsets, exponents) = laws.split_at(setup.receivers.len().min(laws.len()));
        (network, PathLossLaws { offsets, exponents })
    }

    /// Returns the number of learned parameters of the receivers; 0 unless the readout is a power.
    pub(super) fn law_parameter_count(&self, setup: &MeasurementSetup) -> usize {
        if matches!(self.readout, Readout::ReceivedPower { .. }) { LAW.len() * setup.receivers.len() } else { 0 }
    }

    /// Returns the blended signals for the readout in training, clamped to [0, 1] if the calibration is as released.
    pub(super) fn clamp_as_released<'a>(&self, blended: &'a [Real]) -> Cow<'a, [Real]> {
        match self.calibration {
            Calibration::AsReleased => blended.iter().map(|v| v.clamp(0.0, 1.0)).collect(),
            Calibration::Physical => Cow::Borrowed(blended),
        }
    }

    /// Converts blended signals `[links, channels, pixels]` of the sky of a receiver to observations `[links, values]`.
    pub(super) fn read_out(
        &self,
        call: &Call<'_>,
        view: &ReceiverView,
        group: &ReceiverGroup,
        blended: &[Real],
    ) -> Vec<Real> {
        let Call { setup, parameters: p, .. } = *call;
        match self.split_weights(setup, p.weights).1.receiver_law(group.state.receiver) {
            Some(law) => received::received_powers(&view.plane, law, &group.distances(call), blended),
            None => self.readout.forward(blended, view.plane.width * view.plane.height),
        }
    }

    /// Returns the cotangents of the blended signals before [`Self::clamp_as_released`], given those `d` of the observations of
    /// [`Self::read_out`]. Only powers have `distances` and `d_law`, to which it adds the cotangents of offset and path-loss
    /// exponent.
    pub(super) fn read_out_vjp(
        &self,
        view: &ReceiverView,
        d_law: Option<&mut [Real; 2]>,
        distances: &[Real],
        blended: &[Real],
        d: &[Real],
    ) -> Vec<Real> {
        if let Some(d_law) = d_law {
            return received::received_powers_vjp(&view.plane, distances, blended, d, d_law);
        }
        let pixels = view.plane.width * view.plane.height;
        if self.calibration != Calibration::AsReleased {
            return self.readout.vjp(blended, pixels, d);
        }
        let mut d_blended = self.readout.vjp(&self.clamp_as_released(blended), pixels, d);
        // The clamp to [0, 1] passes the derivative on the closed interval only.
        let outside = d_blended.iter_mut().zip(blended).filter(|(_, p)| !(0.0..=1.0).contains(*p));
        outside.for_each(|(d, _)| *d = 0.0);
        d_blended
    }

    /// Predicts the links of `call`. In training, keeps the state for the backward pass, and clamps blended signals as
    /// released.
    fn predict_links(&self, call: &Call<'_>, prepared: &Cache, is_training: bool) -> (ForwardOutput, StageTimes) {
        let Call { setup, links, .. } = *call;
        let start = Instant::now();
        let ready: Option<&Ready> = prepared.is_some().then(|| cached(prepared));
        let network_cache = ready.map_or(&None, |ready| &ready.deformation);
        let (deltas, kept) = self.network_terms(call, network_cache, is_training);
        let mut times = StageTimes { network: start.elapsed().as_secs_f64(), ..StageTimes::default() };
        #[cfg(feature = "gpu")]
        if let Some(gpu) = self.gpu(setup) {
            let start = Instant::now();
            let numbers = self.gpu_draw(gpu, call, &deltas).unwrap_or_else(|error| {
                pwrfgs_core::device::fail(error);
                vec![0.0; links.pairs.len() * setup.value_count()]
            });
            times.blending = start.elapsed().as_secs_f64();
            let cache = ForwardCache { terms: (deltas, kept), drawings: Vec::new() };
            return (ForwardOutput { numbers, cache: is_training.then(|| Arc::new(cache) as _) }, times);
        }
        let (sky, numbers) = (self.sky(setup), setup.value_count());
        let one = |group: ReceiverGroup| {
            let shared_geometry = ready.and_then(|ready| ready.shared_geometry.get(group.state.receiver));
            self.draw_group(call, &sky, &deltas, shared_geometry, is_training, group)
        };
        let groups = ReceiverGroup::from_links(links, !self.deformation.traits().varies_geometry);
        let is_alone = groups.len() == 1; // its links are in order
        let drawn: Vec<GroupOutput> =
            if is_alone { groups.into_iter().map(one).collect() } else { groups.into_par_iter().map(one).collect() };
        let mut observed = vec![0.0; if is_alone { 0 } else { links.pairs.len() * numbers }];
        let mut drawings = Vec::new();
        for GroupOutput { group, observations, seconds: [projection, sort, blending], drawing } in drawn {
            times.projection += projection;
            times.sort += sort;
            times.blending += blending;
            if is_alone {
                observed = observations; // moved, not copied
            } else {
                group.scatter_rows(&observations, numbers, &mut observed);
            }
            drawings.extend(drawing.map(|(view, drawing)| (group, view, drawing)));
        }
        let cache = ForwardCache { terms: (deltas, kept), drawings };
        (ForwardOutput { numbers: observed, cache: is_training.then(|| Arc::new(cache) as _) }, times)
    }

    /// Returns the terms of the network, as [`groups::network_terms`].
    pub(super) fn network_terms(&self, call: &Call<'_>, prepared: &Cache, is_training: bool) -> (Deltas, Cache) {
        let Call { setup, parameters: p, links, .. } = *call;
        let (network, pose) = (self.split_weights(setup, p.weights).0, setup.pose());
        let inputs = DeformationInputs::new(network, &p.cloud.means, links.conditions(), &pose);
        groups::network_terms(&*self.deformation, &inputs, prepared, is_training)
    }
}

#[typetag::serde]
impl Method for Splatting {
    fn traits(&self) -> MethodTraits<'_> {
        MethodTraits {
            task: Some(self.readout.task()),
            inputs: self.deformation.traits().inputs,
            appearance: Appearance::Ellipsoids,
            projector: Some(&self.projector),
            rasterizer: Some(&self.rasterizer),
            deformation: Some(&self.deformation),
            channels: self.readout.channel_count(),
            shows_colours: self.calibration == Calibration::AsReleased,
            supports_existence_gate: true,
            blends: self.rasterizer.blends(),
            stretches: self.readout == Readout::MinMax,
            differentiates_positions: self.deformation.traits().differentiates_positions,
            differentiates_orientations: self.calibration == Calibration::Physical,
            ..MethodTraits::default()
        }
    }

    fn cost(&self, setup: &MeasurementSetup, _: usize, _: usize) -> Cost {
        let (sky, deformation) = (self.sky(setup), self.deformation.traits());
        let pixels = sky.width * sky.height;
        Cost {
            per_gaussian: deformation.kept_per_gaussian,
            per_term: deformation.kept_per_term,
            runs_on_gpu: deformation.runs_on_gpu,
            pixels,
            ..Cost::default()
        }
    }

    fn layout(&self, setup: &MeasurementSetup) -> Layout {
        let mut layout = self.deformation.layout();
        if self.law_parameter_count(setup) > 0 {
            let receivers = setup.receivers.len();
            layout
                .weights
                .extend(LAW.map(|name| WeightSpec { decays: false, ..WeightSpec::zeros(name, vec![receivers]) }));
        }
        layout
    }

    fn plane<'a>(&self, setup: &'a MeasurementSetup) -> Result<Cow<'a, ImagePlane>, Misfit> {
        let Readout::ReceivedPower { sky_deg, filter_deg2 } = self.readout else {
            return Ok(Cow::Borrowed(&setup.plane));
        };
        self.readout.check().map_err(Misfit::Plugin)?;
        // Both poles have a row, so that the cells cover the sphere.
        let (width, height, side) = (360 / sky_deg as usize, 180 / sky_deg as usize + 1, f64::from(sky_deg));
        let whole = Elevation { first: -90.0, last: 90.0 + side };
        let mut sky = self.projector.plane_of(width, height, whole).or(Err(Misfit::PartOfSky))?;
        sky.sampling.filter = Some(filter_deg2 / (side * side) as Real);
        Ok(Cow::Owned(sky))
    }

    /// Returns the rows that may be visible for any output of the network: gate open, opacity not below the limit of the
    /// rasterizer, inside the view of a fixed receiver; all rows if the network couples them.
    fn drawable(&self, setup: &MeasurementSetup, cloud: &GaussianCloud, gate: Option<&[Real]>) -> Vec<usize> {
        let open = groups::network_rows(&*self.deformation, cloud, gate);
        if self.deformation.traits().couples_gaussians {
            return open;
        }
        let mut visible = vec![setup.moving.is_receiver(); cloud.len()];
        for ReceiverView { pose, plane } in self.views(setup) {
            let seen = self.projector.sees(&cloud.means, &pose, &plane.whole());
            visible.iter_mut().zip(seen).for_each(|(any, seen)| *any |= seen);
        }
        let min_drawn_opacity = self.rasterizer.min_drawn_opacity();
        let drawn = |i: &usize| {
            let gate = gate.map_or(1.0, |g| g[*i]);
            visible[*i] && gate * sigmoid(cloud.opacity_logits[*i]) >= min_drawn_opacity
        };
        open.into_iter().filter(drawn).collect()
    }

    fn forward(&self, call: &Call<'_>, prepared: &Cache) -> ForwardOutput {
        self.predict_links(call, prepared, true).0
    }

    #[cfg(feature = "gpu")]
    fn loss_vjp(&self, call: &Call<'_>, loss: &pwrfgs_core::SpectrumLoss<'_>) -> Option<(Real, MethodVjp)> {
        self.gpu(call.setup).map(|gpu| self.gpu_loss_vjp(gpu, call, loss))
    }

    #[cfg(feature = "gpu")]
    fn device_stepper<'a>(&'a self, setup: &MeasurementSetup) -> Option<Box<dyn pwrfgs_core::DeviceStepper + 'a>> {
        Some(Box::new(self.resident(setup)?))
    }

    fn vjp(&self, call: &Call<'_>, observed: ForwardOutput, d: &[Real], sums: &mut MethodVjp) {
        let Call { setup, parameters: p, links, .. } = *call;
        let ForwardCache { terms: (deltas, kept), drawings } = cached(&observed.cache);
        let mut grads = ActivationVjp::zeros(p.cloud, deltas);
        #[cfg(feature = "gpu")]
        if let Some(gpu) = self.gpu(setup) {
            let d = (deltas, super::gpu::Cotangents::Given(d));
            self.gpu_draw_vjp(gpu, call, d, &mut grads, sums).map_or_else(pwrfgs_core::device::fail, drop);
        }
        BackwardPass { splatting: self, call, deltas, d }.add(drawings, &mut grads, sums);
        let network = self.split_weights(setup, p.weights).0;
        let (means, txs) = (&p.cloud.means, links.conditions());
        let inputs = DeformationInputs { weights: network, means, txs, pose: &setup.pose(), kept };
        groups::network_vjp(&*self.deformation, &inputs, &grads, sums);
    }

    fn survey(&self, call: &Call<'_>, truths: &[Real], needs: &Needs) -> PassStatistics {
        self.run_survey(&SurveyRequest { call, truths, needs })
    }

    fn prepare(&self, setup: &MeasurementSetup, p: &Parameters<'_>) -> Cache {
        let network = self.split_weights(setup, p.weights).0;
        let shared_geometry = |view: &ReceiverView| Arc::new(self.geometry(view, p, &Deltas::default(), 0));
        Some(Arc::new(Ready {
            deformation: self.deformation.prepare(network, &p.cloud.means, &setup.pose()),
            shared_geometry: if !setup.moving.is_receiver() && !self.deformation.traits().varies_geometry {
                self.views(setup).iter().map(shared_geometry).collect()
            } else {
                Vec::new()
            },
        }))
    }

    fn predict(&self, call: &Call<'_>, prepared: &Cache) -> (Vec<Real>, StageTimes) {
        let (observed, times) = self.predict_links(call, prepared, false);
        (observed.numbers, times)
    }

    fn start(
        &self,
        setup: &MeasurementSetup,
        data: &Dataset,
        train: &[usize],
        cloud: &mut GaussianCloud,
        weights: &mut [Real],
    ) {
        let network = self.split_weights(setup, weights).0.len();
        groups::start_network(&*self.deformation, data, train, &mut weights[..network]);
        if matches!(self.readout, Readout::ReceivedPower { .. }) {
            self.start_law(setup, data, train, cloud, weights);
        }
    }

    fn gaussians(&self, setup: &MeasurementSetup, p: &Parameters<'_>, tx: Option<[Real; 3]>) -> Activated {
        let (n, channels) = (p.cloud.len(), self.readout.channel_count());
        let strengths = |signals: &[Real]| {
            // One image, whose pixels are the Gaussians.
            let planar: Vec<Real> =
                (0..channels).flat_map(|c| signals.iter().skip(c).step_by(channels).copied()).collect();
            if n == 0 { planar } else { self.readout.forward(&planar, n) }
        };
        groups::activated_gaussians(&*self.deformation, self.activation(), setup, p, tx, strengths)
    }
}
