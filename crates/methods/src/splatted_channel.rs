//! `SplattedChannel`: Gaussians as sources of spherical waves, and the derivative.
//!
//! ```text
//! means, p_tx ─► deform ─► Δs ─► signals of every link ─┐
//! means, gate ─► Waves (once a receiver) ───────────────┴─► Σ ─► level of the receiver ─► h
//! ```

mod linear_start;
mod waves;

use crate::groups::{self, Group, OFFSETS};
use crate::readout::magnitudes;
use crate::{Activation, ActivationVjp, Calibration};
use pwrfgs_core::{
    Activated, Appearance, Asked, Cache, Cost, Dataset, Deformation, DeformationInputs, Deltas, Frame, GaussianCloud,
    JsonSchema, Layout, Method, MethodTraits, MethodVjp, Observed, Parameters, Plugin, Real, StageTimes, Task,
    WeightSpec, cached, consts, evenly,
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
        let deformation: Box<dyn Deformation> = Box::new(Mlp::default());
        Self { deformation: deformation.into() }
    }
}

/// Values that do not depend on the transmitter.
struct Ready {
    deformation: Cache,
    /// Waves per receiver.
    waves: Vec<Waves>,
}

/// Results of the forward pass for the backward pass.
struct Kept {
    deltas: Deltas,
    /// Per group: its links, its waves, and signals `[N, links, 2]`.
    received: Vec<(Group, Waves, Vec<Real>)>,
}

/// Maximum number of links from which the level is initialised.
const LEVEL_LINKS: usize = 256;

/// Numbers per Gaussian and complex channel value: waves and their derivatives.
const PER_WAVE: usize = 4;

/// Returns the factor on all channels of a receiver; its offset is a decimal logarithm.
fn level(offsets: &[Real], receiver: usize) -> Real {
    offsets.get(receiver).map_or(1.0, |offset| (offset * consts::LN_10).exp())
}

impl SplattedChannel {
    fn activation(&self) -> Activation {
        let replaces_signals = self.deformation.traits().replaces_signals;
        Activation { calibration: Calibration::Physical, replaces_signals, channels: 2 }
    }

    /// Returns the channels `[links, numbers]` of a group, from the level of its receiver and signals `[N, links, 2]`.
    fn sum(
        &self,
        p: &Parameters<'_>,
        deltas: &Deltas,
        group: &Group,
        (waves, level): (&Waves, Real),
    ) -> (Vec<Real>, Vec<Real>) {
        let (terms, batch) = group.terms(deltas, p.cloud.len());
        let signals = self.activation().signals(p.cloud, &terms, batch);
        let mut numbers = waves.sum(&signals, group.links.len());
        numbers.iter_mut().for_each(|v| *v *= level);
        (numbers, signals)
    }

    /// Initialises the levels so that predicted channels are as strong as the measured ones, in any unit.
    fn start_level(&self, frame: &Frame, data: &Dataset, train: &[usize], cloud: &GaussianCloud, weights: &mut [Real]) {
        let part = evenly(train, LEVEL_LINKS);
        let numbers = groups::untrained(self, frame, data, &part, (cloud, weights));
        let energy = |values: &[Real]| values.iter().map(|v| (*v as f64).powi(2)).sum::<f64>();
        let measured: f64 = part.iter().map(|&i| energy(&data.image(i).pixels)).sum();
        let ratio = measured / energy(&numbers);
        if ratio.is_finite() && ratio > 0.0 {
            offsets_mut(frame, weights).iter_mut().for_each(|level| *level += (0.5 * ratio.log10()) as Real);
        }
    }
}

/// Splits the weights into those of the network and the offsets of the receivers.
fn parts<'a>(frame: &Frame, weights: &'a [Real]) -> (&'a [Real], &'a [Real]) {
    weights.split_at(weights.len() - frame.receivers.len())
}

fn offsets_mut<'a>(frame: &Frame, weights: &'a mut [Real]) -> &'a mut [Real] {
    let network = weights.len() - frame.receivers.len();
    &mut weights[network..]
}

#[typetag::serde]
impl Method for SplattedChannel {
    fn traits(&self) -> MethodTraits<'_> {
        let (task, inputs) = (Some(Task::Channel), self.deformation.traits().inputs);
        // `Points` are virtual transmitters in the viewer; these are Gaussians with their initial scales and rotations.
        let deformation = Some(&self.deformation);
        MethodTraits { task, inputs, appearance: Appearance::Ellipsoids, deformation, ..MethodTraits::default() }
    }

    fn cost(&self, frame: &Frame, _: usize, _: usize) -> Cost {
        let per_gaussian = self.deformation.traits().kept_per_gaussian + PER_WAVE * frame.numbers() / 2;
        Cost { per_gaussian, pixels: frame.numbers(), ..Cost::default() }
    }

    fn layout(&self, frame: &Frame) -> Result<Layout, String> {
        if !frame.task.is_complex {
            return Err(format!("method: SplattedChannel predicts channels, but the data are {}", frame.task.plural));
        }
        groups::check_receivers(&*self.deformation, frame)?;
        if frame.receivers.iter().any(|own| own.antennas.len() != frame.receivers[0].antennas.len()) {
            return Err("receivers have different numbers of antennas; give all of them the same number".into());
        }
        let mut layout = self.deformation.layout();
        layout.weights.push(WeightSpec::zeros(OFFSETS, vec![frame.receivers.len()]));
        Ok(layout)
    }

    fn drawable(&self, _: &Frame, cloud: &GaussianCloud, gate: Option<&[Real]>) -> Vec<usize> {
        groups::rows(&*self.deformation, cloud, gate)
    }

    fn forward(&self, frame: &Frame, p: &Parameters<'_>, asked: &Asked<'_>) -> Observed {
        let (network, offsets) = parts(frame, p.weights);
        let pose = frame.pose();
        let inputs = DeformationInputs::new(network, &p.cloud.means, asked.conditions, &pose);
        let deltas = self.deformation.forward(&inputs, &None);
        let mut numbers = vec![0.0; asked.links.len() * frame.numbers()];
        let mut received = Vec::new();
        for group in Group::all(asked.links, frame.receivers.len(), true) {
            let waves = Waves::new(frame, &frame.receivers[group.receiver], p.cloud, p.gate);
            let (own, signals) = self.sum(p, &deltas, &group, (&waves, level(offsets, group.receiver)));
            group.scatter(&own, frame.numbers(), &mut numbers);
            received.push((group, waves, signals));
        }
        Observed { numbers, cache: Some(Arc::new(Kept { deltas, received })) }
    }

    fn vjp(
        &self,
        frame: &Frame,
        p: &Parameters<'_>,
        asked: &Asked<'_>,
        observed: Observed,
        d: &[Real],
        sums: &mut MethodVjp,
    ) {
        let Kept { deltas, received } = cached(&observed.cache);
        let (n, activation) = (p.cloud.len(), self.activation());
        let mut own = ActivationVjp::zeros(p.cloud, deltas);
        let (network, offsets) = parts(frame, p.weights);
        for (group, waves, signals) in received {
            let links = group.links.len();
            let level = level(offsets, group.receiver);
            let d: Vec<Real> = group.gather(d, frame.numbers()).iter().map(|d| level * d).collect();
            let along: Real = waves.sum(signals, links).iter().zip(&d).map(|(v, d)| v * d).sum();
            sums.weights[network.len() + group.receiver] += consts::LN_10 * along;
            let (d_signals, d_waves) = waves.sum_vjp(signals, links, &d);
            let receiver = &frame.receivers[group.receiver];
            Waves::vjp(frame, receiver, p.cloud, p.gate, &d_waves, (&mut own.cloud.means, &mut own.gate));
            group.terms_vjp(deltas, n, &mut own, |terms, batch, own| {
                activation.signals_vjp(p.cloud, terms, batch, &d_signals, own);
            });
            for (i, signals) in signals.chunks_exact((2 * links).max(1)).enumerate() {
                let mean = signals.iter().map(|s| s * s).sum::<Real>() / links.max(1) as Real;
                sums.seen.visible[i] += 1.0;
                sums.seen.weight[i] += p.gate.map_or(1.0, |gate| gate[i]) * mean.sqrt();
            }
        }
        let pose = frame.pose();
        let inputs = DeformationInputs::new(network, &p.cloud.means, asked.conditions, &pose);
        groups::vjp(&*self.deformation, &inputs, &own, sums);
    }

    fn prepare(&self, frame: &Frame, p: &Parameters<'_>) -> Cache {
        let deformation = self.deformation.prepare(parts(frame, p.weights).0, &p.cloud.means, &frame.pose());
        let waves = frame.receivers.iter().map(|receiver| Waves::new(frame, receiver, p.cloud, p.gate)).collect();
        Some(Arc::new(Ready { deformation, waves }))
    }

    fn predict(
        &self,
        frame: &Frame,
        p: &Parameters<'_>,
        asked: &Asked<'_>,
        prepared: &Cache,
    ) -> (Vec<Real>, StageTimes) {
        let start = Instant::now();
        let Ready { deformation, waves } = cached(prepared);
        let (network, offsets) = parts(frame, p.weights);
        let pose = frame.pose();
        let inputs = DeformationInputs::new(network, &p.cloud.means, asked.conditions, &pose);
        let deltas = self.deformation.forward(&inputs, deformation);
        let network = start.elapsed().as_secs_f64();
        let mut numbers = vec![0.0; asked.links.len() * frame.numbers()];
        for group in Group::all(asked.links, frame.receivers.len(), true) {
            let (own, _) = self.sum(p, &deltas, &group, (&waves[group.receiver], level(offsets, group.receiver)));
            group.scatter(&own, frame.numbers(), &mut numbers);
        }
        let blending = start.elapsed().as_secs_f64() - network;
        (numbers, StageTimes { network, blending, ..StageTimes::default() })
    }

    fn start(&self, frame: &Frame, data: &Dataset, train: &[usize], cloud: &mut GaussianCloud, weights: &mut [Real]) {
        let network = parts(frame, weights).0.len();
        groups::start(&*self.deformation, data, train, &mut weights[..network]);
        if !self.start_linear(frame, data, train, cloud, weights) {
            self.start_level(frame, data, train, cloud, weights);
        }
    }

    fn gaussians(&self, frame: &Frame, p: &Parameters<'_>, tx: Option<[Real; 3]>) -> Activated {
        groups::gaussians(&*self.deformation, self.activation(), frame, p, tx, magnitudes)
    }
}
