//! Forward and backward pass of a chunk of rays through the network.

use crate::nerf2::Rays;
use crate::nerf2::network::{FREQUENCIES, Network};
use crate::nerf2::path::{Law, sum, sum_vjp};
use pwrfgs_core::Real;
use pwrfgs_networks::dense::{self, Store};
use pwrfgs_networks::encoding::{encode, width};
use pwrfgs_networks::trunk::{Joints, TrunkGradient};
use std::ops::Range;

/// Number of points per chunk, rounded to whole rays: see `rows_per_chunk` of the layers.
const ROWS: usize = 192;

/// Rays of a receiver with the network and the transmitter inputs.
#[derive(Debug)]
pub(crate) struct Walk<'a> {
    pub(crate) network: &'a Network,
    pub(crate) weights: &'a [Real],
    pub(crate) rays: Rays,
    pub(crate) law: Law,
    /// Contribution of each transmitter to the signal network, `[B, width]`.
    pub(crate) told: &'a [Real],
}

/// Values of a chunk of rays that do not depend on the transmitter.
#[derive(Clone, Debug, Default)]
pub(crate) struct Still {
    /// Range of each ray's samples among all samples in use.
    segments: Vec<Range<usize>>,
    /// Factors of the path, `[bands, rays, samples]`.
    factors: Vec<[Real; 2]>,
    /// Contribution of samples and view directions to the first layer of the signal network, with its biases, `[width,
    /// live]`.
    seen: Vec<Real>,
}

/// Activations of the trunk and the following layers for the backward pass.
#[derive(Debug, Default)]
pub(crate) struct Trunked {
    gamma: Vec<Real>,
    slots: Vec<Vec<Real>>,
    feature: Vec<Real>,
    attenuation: Vec<Real>,
    /// Encoded directions `[63, rays]`.
    views: Vec<Real>,
}

/// Activations of the signal network for one transmitter per ray.
#[derive(Debug, Default)]
pub(crate) struct Signal {
    first: Vec<Real>,
    second: Vec<Real>,
    /// Raw amplitudes and phases `[2 bands, live]`.
    raw: Vec<Real>,
}

/// Derivatives with respect to all learned parameters.
#[derive(Debug)]
pub(crate) struct Sums {
    pub(crate) weights: Vec<Real>,
    /// Derivatives with respect to the contributions of the transmitters, `[B, width]`.
    pub(crate) told: Vec<Real>,
}

impl Still {
    /// Returns zeros for the cotangents of the path factors and of the shared contributions.
    pub(crate) fn zeros(&self) -> (Vec<[Real; 2]>, Vec<Real>) {
        (vec![[0.0; 2]; self.factors.len()], vec![0.0; self.seen.len()])
    }

    fn live(&self) -> usize {
        self.segments.last().map_or(0, |segment| segment.end)
    }
}

impl Walk<'_> {
    fn bands(&self) -> usize {
        self.network.outputs / 2
    }

    /// Divides rays into chunks. The chunks depend only on the number of samples and rays.
    pub(crate) fn chunks(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        let (rays, size) = (self.rays.directions.len(), (ROWS / self.rays.samples()).max(1));
        (0..rays).step_by(size).map(move |first| first..(first + size).min(rays))
    }

    /// Computes all values that do not depend on the transmitter. `slots` is 2 for predictions, or the number of trunk
    /// layers for the backward pass.
    pub(crate) fn still(&self, chunk: Range<usize>, slots: usize, trunked: &mut Trunked) -> Still {
        let (network, weights, samples) = (self.network, self.weights, self.rays.samples());
        let (rays, points) = (chunk.len(), self.rays.points(chunk.clone()));
        let Trunked { gamma, slots: h, feature, attenuation, views } = trunked;
        gamma.resize(points.len() * width(FREQUENCIES), 0.0);
        encode(points.into_iter(), FREQUENCIES, gamma);
        let mut shared = Joints::default();
        network.trunk.share(weights, gamma, &mut shared);
        h.resize_with(slots, Vec::new);
        network.trunk.forward(weights, &shared, &network.trunk.fold(weights, &[]), h);
        let h = &h[network.trunk.last(slots)];
        Network::apply(&network.attenuation, weights, h, attenuation);
        Network::apply(&network.feature, weights, h, feature);
        let mut seen = vec![0.0; feature.len()];
        network.of_feature().apply(weights, feature, &mut seen, Store::Set);
        views.resize(rays * width(FREQUENCIES), 0.0);
        encode(self.rays.directions[chunk].iter().copied(), FREQUENCIES, views);
        let mut of_views = vec![0.0; network.width() * rays];
        network.of_view().apply(weights, views, &mut of_views, Store::Set);
        dense::add_bias(&mut of_views, network.signal[0].bias(weights));

        let mut still = Still { factors: vec![[0.0; 2]; self.bands() * rays * samples], ..Still::default() };
        let mut end = 0;
        for ray in 0..rays {
            let live = (0..self.bands()).map(|band| {
                let [raw, phase] = self.attenuations(attenuation, band, ray, rays);
                let factors = &mut still.factors[(band * rays + ray) * samples..][..samples];
                self.law.factors(&self.rays.samples, raw, phase, factors)
            });
            let live = live.max().unwrap_or(0);
            still.segments.push(end..end + live);
            end += live;
        }
        still.seen.reserve_exact(network.width() * end);
        for (row, of_views) in seen.chunks_exact(rays * samples).zip(of_views.chunks_exact(rays)) {
            for (ray, segment) in still.segments.iter().enumerate() {
                let own = &row[ray * samples..][..segment.len()];
                still.seen.extend(own.iter().map(|x| x + of_views[ray]));
            }
        }
        still
    }

    /// Returns raw attenuations and phases of a ray.
    fn attenuations<'a>(&self, all: &'a [Real], band: usize, ray: usize, rays: usize) -> [&'a [Real]; 2] {
        let samples = self.rays.samples();
        [band, self.bands() + band].map(|row| &all[(row * rays + ray) * samples..][..samples])
    }

    /// Computes the emission of the samples for the transmitters `of`, one per ray.
    pub(crate) fn signal(&self, still: &Still, of: &[usize], signal: &mut Signal) {
        let (network, weights, width, live) = (self.network, self.weights, self.network.width(), still.live());
        let Signal { first, second, raw } = signal;
        first.clone_from(&still.seen);
        for (feature, row) in first.chunks_exact_mut(live.max(1)).enumerate() {
            for (segment, tx) in still.segments.iter().zip(of) {
                let told = self.told[tx * width + feature];
                row[segment.clone()].iter_mut().for_each(|x| {
                    let z = *x + told;
                    *x = if z < 0.0 { 0.0 } else { z };
                });
            }
        }
        second.resize(network.signal[1].outputs * live, 0.0);
        network.signal[1].whole().apply(weights, first, second, Store::Set);
        dense::bias_relu(second, network.signal[1].bias(weights));
        Network::apply(&network.emission, weights, second, raw);
    }

    /// Returns the sums over the samples of each ray, `[rays, bands]`.
    pub(crate) fn sums(&self, still: &Still, signal: &Signal) -> Vec<[Real; 2]> {
        let (bands, rays) = (self.bands(), still.segments.len());
        let one = |i: usize| {
            let (ray, band) = (i / bands, i % bands);
            let [raw, phase] = emitted(&signal.raw, still, band, bands, ray);
            sum(raw, phase, self.on_path(still, band, ray), self.law.phase_offset())
        };
        (0..rays * bands).map(one).collect()
    }

    fn on_path<'a>(&self, still: &'a Still, band: usize, ray: usize) -> &'a [[Real; 2]] {
        let at = (band * still.segments.len() + ray) * self.rays.samples();
        &still.factors[at..at + still.segments[ray].len()]
    }

    /// Backward pass of one [`Self::signal`], given cotangents `d` `[rays, bands]` of the sums. Adds to `into` and to
    /// the cotangents of the path factors and shared contributions.
    pub(crate) fn signal_vjp(
        &self,
        (still, signal, of): (&Still, &Signal, &[usize]),
        d: &[[Real; 2]],
        (d_factors, d_seen): (&mut [[Real; 2]], &mut [Real]),
        into: &mut Sums,
    ) {
        let (network, weights, width, live) = (self.network, self.weights, self.network.width(), still.live());
        let (bands, rays, samples) = (self.bands(), still.segments.len(), self.rays.samples());
        let mut d_raw = vec![0.0; signal.raw.len()];
        let (d_amplitudes, d_phases) = d_raw.split_at_mut(bands * live);
        for (i, d) in d.iter().enumerate() {
            let (ray, band) = (i / bands, i % bands);
            let segment = still.segments[ray].clone();
            let own = band * live + segment.start..band * live + segment.end;
            let on_path = (band * rays + ray) * samples;
            sum_vjp(
                emitted(&signal.raw, still, band, bands, ray),
                self.on_path(still, band, ray),
                self.law.phase_offset(),
                *d,
                [&mut d_amplitudes[own.clone()], &mut d_phases[own]],
                &mut d_factors[on_path..on_path + segment.len()],
            );
        }
        let mut d_second = vec![0.0; signal.second.len()];
        let (x, out) = ((signal.second.as_slice(), d_raw.as_slice()), (d_second.as_mut_slice(), Store::Set));
        Network::apply_vjp(&network.emission, weights, x, out, &mut into.weights);
        let layer = &network.signal[1];
        dense::bias_relu_vjp(&mut d_second, &signal.second, layer.bias_mut(&mut into.weights));
        layer.whole().weight_vjp(&mut into.weights, &signal.first, &d_second);
        let mut d_first = vec![0.0; signal.first.len()];
        layer.whole().input_vjp(weights, &d_second, &mut d_first, Store::Set);
        let rows = d_first.chunks_exact(live.max(1)).zip(signal.first.chunks_exact(live.max(1)));
        for (feature, ((d, h), d_seen)) in rows.zip(d_seen.chunks_exact_mut(live.max(1))).enumerate() {
            for (segment, tx) in still.segments.iter().zip(of) {
                let mut sum = 0.0;
                for i in segment.clone() {
                    let own = if h[i] > 0.0 { d[i] } else { 0.0 };
                    d_seen[i] += own;
                    sum += own;
                }
                into.told[tx * width + feature] += sum;
            }
        }
    }

    /// Backward pass of [`Self::still`], given the cotangents of the path factors and shared contributions.
    pub(crate) fn still_vjp(
        &self,
        (still, trunked): (&Still, &Trunked),
        (d_factors, d_live): (&[[Real; 2]], &[Real]),
        into: &mut Sums,
    ) {
        let (network, weights, width) = (self.network, self.weights, self.network.width());
        let (rays, samples, live) = (still.segments.len(), self.rays.samples(), still.live());
        let (mut d_seen, mut d_views) = (vec![0.0; width * rays * samples], vec![0.0; width * rays]);
        let rows = d_seen.chunks_exact_mut(rays * samples).zip(d_views.chunks_exact_mut(rays));
        for ((row, d_views), own) in rows.zip(d_live.chunks_exact(live.max(1))) {
            for (ray, segment) in still.segments.iter().enumerate() {
                let own = &own[segment.clone()];
                row[ray * samples..][..own.len()].copy_from_slice(own);
                d_views[ray] = own.iter().sum();
            }
        }
        dense::add_bias_vjp(&d_views, network.signal[0].bias_mut(&mut into.weights));
        network.of_view().weight_vjp(&mut into.weights, &trunked.views, &d_views);
        network.of_feature().weight_vjp(&mut into.weights, &trunked.feature, &d_seen);
        let mut d_feature = vec![0.0; trunked.feature.len()];
        network.of_feature().input_vjp(weights, &d_seen, &mut d_feature, Store::Set);

        let mut d_attenuation = vec![0.0; trunked.attenuation.len()];
        let (d_amplitudes, d_phases) = d_attenuation.split_at_mut(self.bands() * rays * samples);
        for ray in 0..rays {
            for band in 0..self.bands() {
                let all = (band * rays + ray) * samples..(band * rays + ray + 1) * samples;
                self.law.factors_vjp(
                    &self.rays.samples,
                    self.attenuations(&trunked.attenuation, band, ray, rays),
                    &still.factors[all.clone()],
                    &d_factors[all.start..all.start + still.segments[ray].len()],
                    [&mut d_amplitudes[all.clone()], &mut d_phases[all]],
                );
            }
        }
        let (h, mut d_h) = (&trunked.slots[network.trunk.depth() - 1], vec![0.0; d_feature.len()]);
        let (x, out) = ((h.as_slice(), d_feature.as_slice()), (d_h.as_mut_slice(), Store::Set));
        Network::apply_vjp(&network.feature, weights, x, out, &mut into.weights);
        let (x, out) = ((h.as_slice(), d_attenuation.as_slice()), (d_h.as_mut_slice(), Store::Add));
        Network::apply_vjp(&network.attenuation, weights, x, out, &mut into.weights);

        let (mut d_shared, mut d_folded) = (network.trunk.zero_joints(d_h.len()), network.trunk.zero_joints(width));
        let trunk =
            TrunkGradient { weights: &mut into.weights, shared: &mut d_shared, folded: d_folded.of_tx(0, width) };
        network.trunk.backward(weights, &trunked.slots, &mut d_h, &mut d_feature, trunk);
        network.trunk.add_joint_biases(&mut into.weights, &d_folded);
        network.trunk.share_vjp(weights, &trunked.gamma, &d_shared, &mut into.weights, None);
    }
}

/// Returns raw amplitudes and phases of the emission, for the samples of a ray that are in use.
fn emitted<'a>(raw: &'a [Real], still: &Still, band: usize, bands: usize, ray: usize) -> [&'a [Real]; 2] {
    let (live, segment) = (still.live(), &still.segments[ray]);
    [band, bands + band].map(|row| &raw[row * live + segment.start..row * live + segment.end])
}
