//! `SplattedChannel`: Gaussians as sources of spherical waves, and the derivative.
//!
//! ```text
//! means, p_tx ─► deform ─► Δs ─► signals of every link ─┐
//! means, gate ─► Waves (once per receiver) ─────────────┴─► Σ ─► level of the receiver ─► h
//! ```

mod linear_start;
mod waves;

use crate::groups::{self, OFFSETS, ReceiverGroup};
use crate::readout::magnitudes;
use crate::{Activation, ActivationVjp, Calibration};
use pwrfgs_core::{
    Activated, Appearance, Cache, Call, Cost, Dataset, Deformation, DeformationInputs, Deltas, ForwardOutput,
    GaussianCloud, JsonSchema, Layout, LinkInputs, MeasurementSetup, Method, MethodTraits, MethodVjp, Parameters,
    Plugin, Real, ReceiverState, StageTimes, Task, WeightSpec, cached, consts, evenly,
};
use pwrfgs_networks::Mlp;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::time::Instant;
use waves::Waves;

/// Channels as sums over Gaussians. Each Gaussian emits a spherical wave with its complex signal; the waves are summed
/// per antenna and subcarrier and multiplied by a learned level per receiver.
///
/// Nothing is projected: scales, rotations and opacities are ignored. A pipeline for channels without `method` uses
/// this method with its `deformation`.
///
/// ```
/// use pwrfgs_core::{Method, Plugin};
/// # use pwrfgs_methods as _;
/// let method = "SplattedChannel(deformation: Factored(tx_encoding: Features(width: 416)))";
/// let method = Plugin::<dyn Method>::parse(method).unwrap();
/// assert_eq!(method.traits().inputs, 416);
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SplattedChannel {
    /// Effect of the transmitter on the Gaussians, usually a network.
    pub deformation: Plugin<dyn Deformation>,
}

impl Default for SplattedChannel {
    fn default() -> Self {
        Self { deformation: Plugin::from(Box::new(Mlp::default()) as Box<dyn Deformation>) }
    }
}

/// Values that do not depend on the transmitter.
struct Ready {
    deformation: Cache,
    /// Waves per receiver.
    waves: Vec<Arc<Waves>>,
}

/// Results of the forward pass for the backward pass.
struct ForwardCache {
    /// Terms of the network, and its state for the backward pass.
    terms: (Deltas, Cache),
    /// Per group: its links, its waves, and signals `[N, links, 2]`.
    received: Vec<(ReceiverGroup, Arc<Waves>, Vec<Real>)>,
}

/// Maximum number of links from which the level is initialised.
const LEVEL_LINKS: usize = 256;

/// Numbers per Gaussian and complex channel value: waves and their derivatives.
const PER_WAVE: usize = 4;

/// Returns the factor 10^offset on all channels of a receiver; 1 without an offset.
fn receiver_level(offsets: &[Real], receiver: usize) -> Real {
    offsets.get(receiver).map_or(1.0, |offset| (offset * consts::LN_10).exp())
}

impl SplattedChannel {
    /// Returns the settings of the activation: complex signals, physical calibration.
    fn activation(&self) -> Activation {
        let replaces_signals = self.deformation.traits().replaces_signals;
        Activation { calibration: Calibration::Physical, replaces_signals, channels: 2 }
    }

    /// Predicts the links of `call`; keeps the state for the backward pass if `is_training`.
    fn predict_links(&self, call: &Call<'_>, prepared: &Cache, is_training: bool) -> (ForwardOutput, StageTimes) {
        let Call { setup, parameters: p, links, .. } = *call;
        let start = Instant::now();
        let ready: Option<&Ready> = prepared.is_some().then(|| cached(prepared));
        let (network, offsets) = split_weights(setup, p.weights);
        let pose = setup.pose();
        let inputs = DeformationInputs::new(network, &p.cloud.means, links.conditions(), &pose);
        let network_cache = ready.map_or(&None, |ready| &ready.deformation);
        let (deltas, kept) = groups::network_terms(&*self.deformation, &inputs, network_cache, is_training);
        let network = start.elapsed().as_secs_f64();
        let mut numbers = vec![0.0; links.pairs.len() * setup.value_count()];
        let mut received = Vec::new();
        for group in ReceiverGroup::from_links(links, true) {
            let fresh = || Arc::new(Waves::new(setup, group.state, &p));
            let waves = ready.and_then(|ready| ready.waves.get(group.state.receiver).cloned()).unwrap_or_else(fresh);
            let (terms, batch) = group.gather_terms(&deltas, p.cloud.len());
            let signals = self.activation().signals(p.cloud, &terms, batch);
            let (mut channels, level) =
                (waves.superpose(&signals, group.links.len()), receiver_level(offsets, group.state.receiver));
            channels.iter_mut().for_each(|v| *v *= level);
            group.scatter_rows(&channels, setup.value_count(), &mut numbers);
            received.extend(is_training.then_some((group, waves, signals)));
        }
        let blending = start.elapsed().as_secs_f64() - network;
        let cache = is_training.then(|| Arc::new(ForwardCache { terms: (deltas, kept), received }) as _);
        (ForwardOutput { numbers, cache }, StageTimes { network, blending, ..StageTimes::default() })
    }

    /// Multiplies all levels by the factor that makes predicted channels as strong as the measured ones, in any unit.
    fn start_level(
        &self,
        setup: &MeasurementSetup,
        data: &Dataset,
        train: &[usize],
        cloud: &GaussianCloud,
        weights: &mut [Real],
    ) {
        let part = evenly(train, LEVEL_LINKS);
        let numbers = groups::untrained_predictions(self, setup, data, &part, (cloud, weights));
        let energy = |values: &[Real]| values.iter().map(|v| (*v as f64).powi(2)).sum::<f64>();
        let measured: f64 = part.iter().map(|&i| energy(&data.image(i).pixels)).sum();
        let ratio = measured / energy(&numbers);
        if ratio.is_finite() && ratio > 0.0 {
            // Half, because energies are squares.
            offsets_mut(setup, weights).iter_mut().for_each(|offset| *offset += (0.5 * ratio.log10()) as Real);
        }
    }
}

/// Splits the weights into those of the network and the offsets of the receivers.
fn split_weights<'a>(setup: &MeasurementSetup, weights: &'a [Real]) -> (&'a [Real], &'a [Real]) {
    weights.split_at(weights.len() - setup.receivers.len())
}

/// Returns the offsets of the receivers among the weights.
fn offsets_mut<'a>(setup: &MeasurementSetup, weights: &'a mut [Real]) -> &'a mut [Real] {
    let network = split_weights(setup, weights).0.len();
    &mut weights[network..]
}

#[typetag::serde]
impl Method for SplattedChannel {
    fn traits(&self) -> MethodTraits<'_> {
        let task = Some(Task::Channel);
        // `Points` are virtual transmitters in the viewer; these are Gaussians with their initial scales and rotations.
        let (appearance, deformation) = (Appearance::Ellipsoids, Some(&self.deformation));
        let differentiates_positions = self.deformation.traits().differentiates_positions;
        MethodTraits {
            task,
            inputs: self.deformation.traits().inputs,
            appearance,
            deformation,
            differentiates_positions,
            differentiates_orientations: true,
            ..MethodTraits::default()
        }
    }

    fn cost(&self, setup: &MeasurementSetup, _: usize, _: usize) -> Cost {
        let deformation = self.deformation.traits();
        let per_gaussian = deformation.kept_per_gaussian + PER_WAVE * setup.value_count() / 2;
        let runs_on_gpu = deformation.runs_on_gpu;
        let pixels = setup.value_count();
        Cost { per_gaussian, per_term: deformation.kept_per_term, pixels, runs_on_gpu, ..Cost::default() }
    }

    fn layout(&self, setup: &MeasurementSetup) -> Layout {
        let mut layout = self.deformation.layout();
        layout.weights.push(WeightSpec { decays: false, ..WeightSpec::zeros(OFFSETS, vec![setup.receivers.len()]) });
        layout
    }

    fn drawable(&self, _: &MeasurementSetup, cloud: &GaussianCloud, gate: Option<&[Real]>) -> Vec<usize> {
        groups::network_rows(&*self.deformation, cloud, gate)
    }

    fn forward(&self, call: &Call<'_>, prepared: &Cache) -> ForwardOutput {
        self.predict_links(call, prepared, true).0
    }

    fn vjp(&self, call: &Call<'_>, observed: ForwardOutput, d: &[Real], sums: &mut MethodVjp) {
        let Call { setup, parameters: p, links, .. } = *call;
        let ForwardCache { terms: (deltas, kept), received } = cached(&observed.cache);
        let activation = self.activation();
        let mut grads = ActivationVjp::zeros(p.cloud, deltas);
        let (network, offsets) = split_weights(setup, p.weights);
        for (group, waves, signals) in received {
            let links = group.links.len();
            let level = receiver_level(offsets, group.state.receiver);
            let d: Vec<Real> = group.gather_rows(d, setup.value_count()).iter().map(|d| level * d).collect();
            let along: Real = waves.superpose(signals, links).iter().zip(&d).map(|(v, d)| v * d).sum();
            sums.weights[network.len() + group.state.receiver] += consts::LN_10 * along;
            let (d_signals, d_waves) = waves.superpose_vjp(signals, links, &d);
            Waves::vjp(call, group.state, &d_waves, &mut grads);
            if setup.moving.is_receiver() {
                let pose_vjp = || Waves::pose_vjp(call, group.state, &d_waves);
                group.add_pose_vjp(sums, pose_vjp);
            }
            group.gather_terms_vjp(deltas, &mut grads, |terms, batch, grads| {
                activation.signals_vjp(p.cloud, terms, batch, &d_signals, grads);
            });
            // Root mean square of each signal over the links, for pruners by blending weight.
            for (i, signals) in signals.chunks_exact((2 * links).max(1)).enumerate() {
                let mean = signals.iter().map(|s| s * s).sum::<Real>() / links.max(1) as Real;
                sums.stats.visible[i] += 1.0;
                sums.stats.weight[i] += p.gate.map_or(1.0, |gate| gate[i]) * mean.sqrt();
            }
        }
        let (means, txs) = (&p.cloud.means, links.conditions());
        let inputs = DeformationInputs { weights: network, means, txs, pose: &setup.pose(), kept };
        groups::network_vjp(&*self.deformation, &inputs, &grads, sums);
    }

    fn prepare(&self, setup: &MeasurementSetup, p: &Parameters<'_>) -> Cache {
        let deformation = self.deformation.prepare(split_weights(setup, p.weights).0, &p.cloud.means, &setup.pose());
        let waves = |state: &ReceiverState| Arc::new(Waves::new(setup, *state, p));
        // None for moving receivers.
        let waves = LinkInputs::of(0, setup).receivers.iter().map(waves).collect();
        Some(Arc::new(Ready { deformation, waves }))
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
        let network = split_weights(setup, weights).0.len();
        groups::start_network(&*self.deformation, data, train, &mut weights[..network]);
        if !self.start_linear(setup, data, train, cloud, weights) {
            self.start_level(setup, data, train, cloud, weights);
        }
    }

    fn gaussians(&self, setup: &MeasurementSetup, p: &Parameters<'_>, tx: Option<[Real; 3]>) -> Activated {
        groups::activated_gaussians(&*self.deformation, self.activation(), setup, p, tx, magnitudes)
    }
}
