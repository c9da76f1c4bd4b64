//! `Group`: links that are drawn together, because they share a receiver and a geometry.

use crate::ActivationVjp;
use pwrfgs_core::{Asked, Deltas, Link, Pose, Real, Vec3};
use std::borrow::Cow;
use std::ops::Range;

/// Links of one receiver.
#[derive(Debug)]
pub(crate) struct Group {
    pub(crate) receiver: usize,
    /// Places in the list of links.
    pub(crate) links: Vec<usize>,
    /// Rows of the transmitters.
    rows: Vec<usize>,
}

impl Group {
    /// All links, receiver by receiver; each alone, where they do not `share` a geometry.
    pub(crate) fn all(links: &[Link], receivers: usize, share: bool) -> Vec<Self> {
        let mut groups: Vec<Self> = Vec::new();
        for receiver in 0..receivers {
            let own: Vec<usize> = (0..links.len()).filter(|&i| links[i].receiver == receiver).collect();
            let together = if share { own.len().max(1) } else { 1 };
            groups.extend(own.chunks(together).map(|part| Self {
                receiver,
                links: part.to_vec(),
                rows: part.iter().map(|&i| links[i].transmitter).collect(),
            }));
        }
        groups
    }

    /// Its links, each as a group of its own.
    pub(crate) fn alone(&self) -> impl Iterator<Item = Self> + '_ {
        let one =
            |(link, row): (&usize, &usize)| Self { receiver: self.receiver, links: vec![*link], rows: vec![*row] };
        self.links.iter().zip(&self.rows).map(one)
    }

    /// The place of its first link.
    pub(crate) fn first(&self) -> usize {
        self.links[0]
    }

    /// From the receiver to the transmitter of each link, metres; nothing where positions are not known.
    pub(crate) fn distances(&self, pose: &Pose, asked: &Asked<'_>) -> Vec<Real> {
        let txs = asked.conditions.positions();
        let distance = |row: &usize| txs.get(*row).map(|tx| (Vec3::from_array(*tx) - pose.origin()).length());
        self.rows.iter().filter_map(distance).collect()
    }

    /// The rows of `numbers` that are its links'.
    pub(crate) fn gather<'a>(&self, all: &'a [Real], numbers: usize) -> Cow<'a, [Real]> {
        if self.links.windows(2).all(|pair| pair[1] == pair[0] + 1) {
            return Cow::Borrowed(&all[self.links[0] * numbers..][..self.links.len() * numbers]);
        }
        Cow::Owned(self.links.iter().flat_map(|link| &all[link * numbers..][..numbers]).copied().collect())
    }

    /// Puts rows where its links are.
    pub(crate) fn scatter(&self, own: &[Real], numbers: usize, all: &mut [Real]) {
        for (own, link) in own.chunks_exact(numbers).zip(&self.links) {
            all[link * numbers..][..numbers].copy_from_slice(own);
        }
    }

    /// The terms of its transmitters: rows of `deltas` as they lie there, or copied to lie side by side.
    pub(crate) fn terms<'a>(&self, deltas: &'a Deltas, n: usize) -> (Cow<'a, Deltas>, Range<usize>) {
        let first = self.rows[0];
        if self.rows.iter().enumerate().all(|(k, row)| *row == first + k) {
            return (Cow::Borrowed(deltas), first..first + self.rows.len());
        }
        (Cow::Owned(self.copy(deltas, n)), 0..self.rows.len())
    }

    /// What `vjp` gives, called with the terms of its transmitters; it adds to the cotangents of these terms, which are then
    /// those of the rows that they were copied from.
    pub(crate) fn terms_vjp<T>(
        &self,
        deltas: &Deltas,
        n: usize,
        own: &mut ActivationVjp,
        vjp: impl FnOnce(&Deltas, Range<usize>, &mut ActivationVjp) -> T,
    ) -> T {
        let (terms, batch) = self.terms(deltas, n);
        // Copied terms have a derivative of their own, which is then added where they came from.
        let copied = matches!(terms, Cow::Owned(_));
        let all = copied.then(|| std::mem::replace(&mut own.deltas, terms.zeros_like()));
        let given = vjp(&terms, batch, own);
        if let Some(all) = all {
            let part = std::mem::replace(&mut own.deltas, all);
            self.add_back(&part, &mut own.deltas, n);
        }
        given
    }

    fn copy(&self, deltas: &Deltas, n: usize) -> Deltas {
        fn rows<T: Copy>(of: &[T], rows: &[usize], n: usize) -> Vec<T> {
            if of.is_empty() {
                Vec::new()
            } else {
                rows.iter().flat_map(|b| of[b * n..][..n].iter().copied()).collect()
            }
        }
        let Deltas { scales, quats, signals } = deltas;
        Deltas {
            scales: rows(scales, &self.rows, n),
            quats: rows(quats, &self.rows, n),
            signals: rows(signals, &self.rows, n),
        }
    }

    /// Adds derivatives of copied terms to the rows that they were copied from.
    fn add_back(&self, own: &Deltas, all: &mut Deltas, n: usize) {
        for (own, all) in own.columns().into_iter().zip(all.columns_mut()) {
            let width = own.len() / (self.rows.len() * n).max(1);
            for (k, b) in self.rows.iter().enumerate() {
                let into = all.iter_mut().skip(b * n * width).take(n * width);
                into.zip(&own[k * n * width..]).for_each(|(sum, d): (&mut Real, &Real)| *sum += d);
            }
        }
    }
}
