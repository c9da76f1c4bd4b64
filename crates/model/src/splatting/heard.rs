//! Channels as observations: [`Waves`] for every receiver, signals for every link.

use super::Splatting;
use super::channel::Waves;
use super::groups::Group;
use crate::ActivationVjp;
use pwrfgs_core::{
    Asked, Cache, Conditions, Dataset, DeformationInputs, Deltas, Frame, GaussianCloud, Link, Method, MethodVjp,
    Observed, Parameters, Pixels, Real, StageTimes, cached, consts, evenly,
};
use std::borrow::Cow;
use std::sync::Arc;
use std::time::Instant;

/// What no transmitter changes.
pub(super) struct ReadyWaves {
    pub(super) deformation: Cache,
    /// Of each receiver.
    pub(super) waves: Vec<Waves>,
}

/// What the derivative finds again.
struct Kept {
    deltas: Deltas,
    /// Of each group: its waves, and signals `[N, links, 2]`.
    heard: Vec<(Group, Waves, Vec<Real>)>,
}

/// Links that the level is set by, at most.
const LOOKED_AT: usize = 256;

/// What a receiver multiplies every channel by: its offset is a decimal logarithm.
fn level(offsets: &[Real], receiver: usize) -> Real {
    offsets.get(receiver).map_or(1.0, |offset| (offset * consts::LN_10).exp())
}

impl Splatting {
    /// What describes the transmitters of the links `part`, one after the other, and the links.
    pub(super) fn asked_of(frame: &Frame, data: &Dataset, part: &[usize]) -> (Vec<Real>, Vec<Link>) {
        let (mut conditions, mut links) = (Vec::new(), Vec::with_capacity(part.len()));
        for (transmitter, &i) in part.iter().enumerate() {
            let query = data.query(i);
            match query.features {
                [] => conditions.extend(frame.origin.local(query.tx)),
                own => conditions.extend_from_slice(own),
            }
            links.push(Link { transmitter, receiver: query.receiver });
        }
        (conditions, links)
    }

    /// Begins with channels as strong as the measured ones, whatever unit these have.
    pub(super) fn start_level(
        &self,
        frame: &Frame,
        data: &Dataset,
        train: &[usize],
        cloud: &GaussianCloud,
        weights: &mut [Real],
    ) {
        let part = evenly(train, LOOKED_AT);
        let (conditions, links) = Self::asked_of(frame, data, &part);
        let asked =
            Asked { conditions: Conditions::new(self.inputs(), &conditions), links: &links, pixels: Pixels::All };
        let numbers = self.forward(frame, &Parameters { cloud, gate: None, presence: None, weights }, &asked).numbers;
        let energy = |values: &[Real]| values.iter().map(|v| (*v as f64).powi(2)).sum::<f64>();
        let measured: f64 = part.iter().map(|&i| energy(&data.image(i).pixels)).sum();
        let ratio = measured / energy(&numbers);
        let network = self.parts(frame, weights).0.len();
        if ratio.is_finite() && ratio > 0.0 {
            weights[network..].iter_mut().for_each(|level| *level += (0.5 * ratio.log10()) as Real);
        }
    }

    /// Channels of the links asked for.
    pub(super) fn heard(&self, frame: &Frame, p: &Parameters<'_>, asked: &Asked<'_>) -> Observed {
        let deltas = self.terms(frame, p, asked.conditions);
        let laws = self.parts(frame, p.weights).1;
        let mut numbers = vec![0.0; asked.links.len() * frame.numbers()];
        let mut heard = Vec::new();
        for group in Group::all(asked.links, frame.receivers.len(), true) {
            let waves = Waves::new(frame, &frame.receivers[group.receiver], p.cloud, p.gate);
            let signals = self.signals_of(p, &deltas, &group);
            let mut own = waves.heard(&signals, group.links.len());
            let level = level(laws.offsets, group.receiver);
            own.iter_mut().for_each(|v| *v *= level);
            group.scatter(&own, frame.numbers(), &mut numbers);
            heard.push((group, waves, signals));
        }
        Observed { numbers, cache: Some(Arc::new(Kept { deltas, heard })) }
    }

    fn signals_of(&self, p: &Parameters<'_>, deltas: &Deltas, group: &Group) -> Vec<Real> {
        let (terms, batch) = group.terms(deltas, p.cloud.len());
        self.activation().signals(p.cloud, &terms, batch)
    }

    /// Adds to `sums`, given the cotangents `d` of the channels.
    pub(super) fn heard_vjp(
        &self,
        frame: &Frame,
        p: &Parameters<'_>,
        asked: &Asked<'_>,
        observed: &Observed,
        d: &[Real],
        sums: &mut MethodVjp,
    ) {
        let Kept { deltas, heard } = cached(&observed.cache);
        let (n, activation) = (p.cloud.len(), self.activation());
        let mut own = ActivationVjp::zeros(p.cloud, deltas);
        let (network, laws) = self.parts(frame, p.weights);
        for (group, waves, signals) in heard {
            let level = level(laws.offsets, group.receiver);
            let d: Vec<Real> = group.gather(d, frame.numbers()).iter().map(|d| level * d).collect();
            let heard = waves.heard(signals, group.links.len());
            let along: Real = heard.iter().zip(&d).map(|(v, d)| v * d).sum();
            sums.weights[network.len() + group.receiver] += consts::LN_10 * along;
            let (d_signals, d_waves) = waves.heard_vjp(signals, group.links.len(), &d);
            let receiver = &frame.receivers[group.receiver];
            Waves::vjp(frame, receiver, p.cloud, p.gate, &d_waves, (&mut own.cloud.means, &mut own.gate));
            let (terms, batch) = group.terms(deltas, n);
            let copied = matches!(terms, Cow::Owned(_));
            let all = copied.then(|| std::mem::replace(&mut own.deltas, terms.zeros_like()));
            activation.signals_vjp(p.cloud, &terms, batch, &d_signals, &mut own);
            for (i, signals) in signals.chunks_exact((2 * group.links.len()).max(1)).enumerate() {
                let mean = signals.iter().map(|s| s * s).sum::<Real>() / group.links.len().max(1) as Real;
                sums.seen.visible[i] += 1.0;
                sums.seen.weight[i] += p.gate.map_or(1.0, |gate| gate[i]) * mean.sqrt();
            }
            if let Some(all) = all {
                let part = std::mem::replace(&mut own.deltas, all);
                group.add_back(&part, &mut own.deltas, n);
            }
        }
        self.finish(frame, p, asked, &own, sums);
    }

    /// The same channels, with the waves at hand.
    pub(super) fn heard_prepared(
        &self,
        frame: &Frame,
        p: &Parameters<'_>,
        asked: &Asked<'_>,
        ready: &ReadyWaves,
        start: Instant,
    ) -> (Vec<Real>, StageTimes) {
        let (network, laws) = self.parts(frame, p.weights);
        let pose = frame.pose();
        let inputs = DeformationInputs::new(network, &p.cloud.means, asked.conditions, &pose);
        let deltas = self.deformation.forward(&inputs, &ready.deformation);
        let network = start.elapsed().as_secs_f64();
        let mut numbers = vec![0.0; asked.links.len() * frame.numbers()];
        for group in Group::all(asked.links, frame.receivers.len(), true) {
            let signals = self.signals_of(p, &deltas, &group);
            let level = level(laws.offsets, group.receiver);
            let mut heard = ready.waves[group.receiver].heard(&signals, group.links.len());
            heard.iter_mut().for_each(|v| *v *= level);
            group.scatter(&heard, frame.numbers(), &mut numbers);
        }
        let blending = start.elapsed().as_secs_f64() - network;
        (numbers, StageTimes { network, blending, ..StageTimes::default() })
    }
}
