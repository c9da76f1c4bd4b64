//! `Group`: links with equal rays, chunk by chunk through the network and back.

use crate::nerf2::walk::{Signal, Still, Sums, Trunked, Walk};
use pwrfgs_core::Real;
use std::ops::Range;

/// Links with equal rays.
#[derive(Debug)]
pub(crate) struct Group<'a> {
    pub(crate) receiver: usize,
    pub(crate) walk: Walk<'a>,
    pub(crate) links: Links,
}

/// Links along the rays of a group: indices of requested links, and rows of transmitters.
#[derive(Debug)]
pub(crate) enum Links {
    /// Every link uses all rays.
    All(Vec<(usize, usize)>),
    /// One link per ray.
    Own(Vec<(usize, usize)>),
}

/// Sums over the samples of the rays of a chunk, per pass `[rays, bands]`.
pub(crate) type Passes = Vec<Vec<[Real; 2]>>;

/// Activations of a chunk for the backward pass.
#[derive(Debug)]
pub(crate) struct Walked {
    still: Still,
    trunked: Trunked,
    signals: Vec<Signal>,
}

/// Work buffers, reused for all chunks.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    trunked: Trunked,
    signal: Signal,
}

impl Links {
    /// Returns the number of passes over a chunk.
    pub(crate) fn passes(&self) -> usize {
        match self {
            Self::All(links) => links.len(),
            Self::Own(_) => 1,
        }
    }

    /// Returns the transmitters of a pass over a chunk, one per ray.
    fn of_pass(&self, pass: usize, chunk: &Range<usize>) -> Vec<usize> {
        match self {
            Self::All(links) => vec![links[pass].1; chunk.len()],
            Self::Own(links) => links[chunk.clone()].iter().map(|(_, tx)| *tx).collect(),
        }
    }

    /// Returns the link of a pass and a ray.
    pub(crate) fn link(&self, pass: usize, ray: usize) -> usize {
        match self {
            Self::All(links) => links[pass].0,
            Self::Own(links) => links[ray].0,
        }
    }
}

impl Group<'_> {
    /// Runs a chunk and stores its activations for the backward pass.
    pub(crate) fn keep(&self, rays: &Range<usize>) -> (Walked, Passes) {
        let mut trunked = Trunked::default();
        let still = self.walk.still(rays.clone(), self.walk.network.trunk.depth(), &mut trunked);
        let one = |pass: usize| {
            let mut signal = Signal::default();
            self.walk.signal(&still, &self.links.of_pass(pass, rays), &mut signal);
            let sums = self.walk.sums(&still, &signal);
            (signal, sums)
        };
        let (signals, sums) = (0..self.links.passes()).map(one).unzip();
        (Walked { still, trunked, signals }, sums)
    }

    /// Runs a chunk without storing activations; `ready` is its precomputed part.
    pub(crate) fn pass(&self, rays: &Range<usize>, ready: Option<&Still>, scratch: &mut Scratch) -> Passes {
        let Scratch { trunked, signal } = scratch;
        let made = ready.is_none().then(|| self.walk.still(rays.clone(), 2, trunked));
        let Some(still) = ready.or(made.as_ref()) else { return Passes::new() };
        let one = |pass: usize| {
            self.walk.signal(still, &self.links.of_pass(pass, rays), signal);
            self.walk.sums(still, signal)
        };
        (0..self.links.passes()).map(one).collect()
    }

    /// Backward pass of a chunk, given the cotangents `d` per pass, ray and band.
    pub(crate) fn back(
        &self,
        rays: &Range<usize>,
        kept: Option<&Walked>,
        d: impl Fn(usize, usize, usize) -> [Real; 2],
        scratch: &mut Scratch,
        into: &mut Sums,
    ) {
        let (walk, bands) = (&self.walk, self.walk.network.outputs / 2);
        let Scratch { trunked, signal } = scratch;
        let depth = walk.network.trunk.depth();
        let made = kept.is_none().then(|| walk.still(rays.clone(), depth, trunked));
        let (still, trunked) = match (kept, &made) {
            (Some(kept), _) => (&kept.still, &kept.trunked),
            (None, Some(made)) => (made, &*trunked),
            (None, None) => return,
        };
        let (mut d_factors, mut d_seen) = still.zeros();
        for pass in 0..self.links.passes() {
            let of = self.links.of_pass(pass, rays);
            if kept.is_none() {
                walk.signal(still, &of, signal);
            }
            let signal = kept.map_or(&*signal, |kept| &kept.signals[pass]);
            let d: Vec<[Real; 2]> =
                (0..rays.len() * bands).map(|i| d(pass, rays.start + i / bands, i % bands)).collect();
            walk.signal_vjp((still, signal, &of), &d, (&mut d_factors, &mut d_seen), into);
        }
        walk.still_vjp((still, trunked), (&d_factors, &d_seen), into);
    }
}
