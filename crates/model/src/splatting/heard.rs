//! Channels as observations: [`Waves`] for every receiver, signals for every link.

use super::Splatting;
use super::channel::Waves;
use super::groups::Group;
use crate::ActivationVjp;
use pwrfgs_core::{Asked, Cache, Deltas, Frame, MethodVjp, Observed, Parameters, Real, StageTimes, cached};
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

impl Splatting {
    /// Channels of the links asked for.
    pub(super) fn heard(&self, frame: &Frame, p: &Parameters<'_>, asked: &Asked<'_>) -> Observed {
        let deltas = self.terms(frame, p, asked.conditions);
        let mut numbers = vec![0.0; asked.links.len() * frame.numbers()];
        let mut heard = Vec::new();
        for group in Group::all(asked.links, frame.receivers.len(), true) {
            let waves = Waves::new(frame, &frame.receivers[group.receiver], p.cloud, p.gate);
            let signals = self.signals_of(p, &deltas, &group);
            group.scatter(&waves.heard(&signals, group.links.len()), frame.numbers(), &mut numbers);
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
        for (group, waves, signals) in heard {
            let d = group.gather(d, frame.numbers());
            let (d_signals, d_waves) = waves.heard_vjp(signals, group.links.len(), &d);
            let receiver = &frame.receivers[group.receiver];
            Waves::vjp(frame, receiver, p.cloud, p.gate, &d_waves, (&mut own.cloud.means, &mut own.gate));
            let (terms, batch) = group.terms(deltas, n);
            let copied = matches!(terms, Cow::Owned(_));
            let all = copied.then(|| std::mem::replace(&mut own.deltas, terms.zeros_like()));
            activation.signals_vjp(p.cloud, &terms, batch, &d_signals, &mut own);
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
        let network = self.parts(frame, p.weights).0;
        let (means, pose) = (&p.cloud.means, frame.pose());
        let deltas = self.deformation.forward_prepared(network, means, asked.conditions, &pose, &ready.deformation);
        let network = start.elapsed().as_secs_f64();
        let mut numbers = vec![0.0; asked.links.len() * frame.numbers()];
        for group in Group::all(asked.links, frame.receivers.len(), true) {
            let signals = self.signals_of(p, &deltas, &group);
            let heard = ready.waves[group.receiver].heard(&signals, group.links.len());
            group.scatter(&heard, frame.numbers(), &mut numbers);
        }
        let blending = start.elapsed().as_secs_f64() - network;
        (numbers, StageTimes { network, blending, ..StageTimes::default() })
    }
}
