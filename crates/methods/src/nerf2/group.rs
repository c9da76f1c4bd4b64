//! `RayGroup`: links with equal rays, chunk by chunk through the network and back.

use crate::nerf2::walk::{PREDICTION_SLOTS, RayWalk, SharedActivations, SignalActivations, Sums, TrunkActivations};
use pwrfgs_core::Real;
use std::ops::Range;

/// Links with equal rays.
#[derive(Debug)]
pub(crate) struct RayGroup<'a> {
    pub(crate) receiver: usize,
    pub(crate) walk: RayWalk<'a>,
    pub(crate) links: GroupLinks,
}

/// Links along the rays of a group: indices of requested links, and rows of transmitters.
#[derive(Debug)]
pub(crate) enum GroupLinks {
    /// Every link uses all rays.
    All(Vec<(usize, usize)>),
    /// One link per ray.
    OnePerRay(Vec<(usize, usize)>),
}

/// Sums over the samples of the rays of a chunk, per pass `[rays, bands]`.
pub(crate) type Passes = Vec<Vec<[Real; 2]>>;

/// Activations of a chunk for the backward pass.
#[derive(Debug)]
pub(crate) struct RayActivations {
    shared: SharedActivations,
    trunk_activations: TrunkActivations,
    signals: Vec<SignalActivations>,
}

/// Work buffers, reused for all chunks.
#[derive(Debug, Default)]
pub(crate) struct GroupScratch {
    trunk_activations: TrunkActivations,
    signal: SignalActivations,
}

impl GroupLinks {
    /// Returns the number of passes over a chunk: runs of the signal network with one link per ray.
    pub(crate) fn pass_count(&self) -> usize {
        match self {
            Self::All(links) => links.len(),
            Self::OnePerRay(_) => 1,
        }
    }

    /// Returns the row of the transmitter per ray of a chunk, in a pass.
    pub(crate) fn pass_locations(&self, pass: usize, chunk: &Range<usize>) -> Vec<usize> {
        match self {
            Self::All(links) => vec![links[pass].1; chunk.len()],
            Self::OnePerRay(links) => links[chunk.clone()].iter().map(|(_, tx)| *tx).collect(),
        }
    }

    /// Returns the index, among the requested links, of the link of a ray of the group in a pass.
    pub(crate) fn link_index(&self, pass: usize, ray: usize) -> usize {
        match self {
            Self::All(links) => links[pass].0,
            Self::OnePerRay(links) => links[ray].0,
        }
    }
}

impl RayGroup<'_> {
    /// Runs the forward pass of a chunk of rays; also returns its activations for the backward pass.
    pub(crate) fn forward_keeping(&self, rays: &Range<usize>) -> (RayActivations, Passes) {
        let mut trunk_activations = TrunkActivations::default();
        let shared =
            self.walk.shared_activations(rays.clone(), self.walk.network.trunk.depth(), &mut trunk_activations);
        let one = |pass: usize| {
            let mut signal = SignalActivations::default();
            self.walk.run_signal_network(&shared, &self.links.pass_locations(pass, rays), &mut signal);
            let sums = self.walk.ray_sums(&shared, &signal.raw);
            (signal, sums)
        };
        let (signals, sums) = (0..self.links.pass_count()).map(one).unzip();
        (RayActivations { shared, trunk_activations, signals }, sums)
    }

    /// Runs the forward pass of a chunk of rays; `ready` is the part that does not depend on the transmitter, if it is
    /// available.
    pub(crate) fn forward(
        &self,
        rays: &Range<usize>,
        ready: Option<&SharedActivations>,
        scratch: &mut GroupScratch,
    ) -> Passes {
        let GroupScratch { trunk_activations, signal } = scratch;
        let made =
            ready.is_none().then(|| self.walk.shared_activations(rays.clone(), PREDICTION_SLOTS, trunk_activations));
        let Some(shared) = ready.or(made.as_ref()) else { return Passes::new() };
        let one = |pass: usize| {
            self.walk.run_signal_network(shared, &self.links.pass_locations(pass, rays), signal);
            self.walk.ray_sums(shared, &signal.raw)
        };
        (0..self.links.pass_count()).map(one).collect()
    }

    /// Runs the backward pass of a chunk of rays, given the cotangents `d` per pass, ray of the group and band; adds to
    /// `into`. Without stored `activations` it repeats the forward pass.
    pub(crate) fn backward(
        &self,
        rays: &Range<usize>,
        activations: Option<&RayActivations>,
        d: impl Fn(usize, usize, usize) -> [Real; 2],
        scratch: &mut GroupScratch,
        into: &mut Sums<'_>,
    ) {
        let (walk, bands) = (&self.walk, self.walk.network.outputs / 2);
        let GroupScratch { trunk_activations, signal } = scratch;
        let depth = walk.network.trunk.depth();
        let made = activations.is_none().then(|| walk.shared_activations(rays.clone(), depth, trunk_activations));
        let (shared, trunk_activations) = match (activations, &made) {
            (Some(activations), _) => (&activations.shared, &activations.trunk_activations),
            (None, Some(made)) => (made, &*trunk_activations),
            (None, None) => return,
        };
        let (mut d_factors, mut d_hidden) = shared.zero_cotangents();
        for pass in 0..self.links.pass_count() {
            let locations = self.links.pass_locations(pass, rays);
            if activations.is_none() {
                walk.run_signal_network(shared, &locations, signal);
            }
            let signal = activations.map_or(&*signal, |activations| &activations.signals[pass]);
            let d: Vec<[Real; 2]> =
                (0..rays.len() * bands).map(|i| d(pass, rays.start + i / bands, i % bands)).collect();
            walk.signal_network_vjp((shared, signal, &locations), &d, (&mut d_factors, &mut d_hidden), into);
        }
        walk.shared_activations_vjp((shared, trunk_activations), (&d_factors, &d_hidden), into);
    }
}
