//! Forward and backward pass of a chunk of rays through the network.

use crate::nerf2::RayBundle;
use crate::nerf2::network::{FREQUENCIES, Nerf2Network};
use crate::nerf2::path::{PropagationLaw, ray_sum, ray_sum_vjp};
use pwrfgs_core::Real;
use pwrfgs_networks::dense::{self, StoreMode};
use pwrfgs_networks::encoding::{encode, encoded_width};
use pwrfgs_networks::trunk::{Joints, TrunkGradient};
use std::ops::Range;

/// Number of points per chunk, rounded to whole rays: see `rows_per_chunk` of the layers.
const ROWS: usize = 192;
/// Number of trunk layers in memory for predictions: input and output of the current layer.
pub(crate) const PREDICTION_SLOTS: usize = 2;

/// Rays of a receiver with the network and the transmitter inputs.
#[derive(Debug)]
pub(crate) struct RayWalk<'a> {
    pub(crate) network: &'a Nerf2Network,
    pub(crate) weights: &'a [Real],
    pub(crate) rays: RayBundle,
    pub(crate) law: PropagationLaw,
    /// Contribution of each transmitter to the signal network, `[B, width]`.
    pub(crate) transmitter_terms: &'a [Real],
}

/// Values of a chunk of rays that do not depend on the transmitter.
#[derive(Clone, Debug, Default)]
pub(crate) struct SharedActivations {
    /// Range of each ray's samples among all samples in use.
    segments: Vec<Range<usize>>,
    /// Factors of the path, `[bands, rays, samples]`.
    factors: Vec<[Real; 2]>,
    /// Contribution of samples and view directions to the first layer of the signal network, with its biases, `[width,
    /// live]`.
    hidden: Vec<Real>,
}

/// Activations of the trunk and the following layers for the backward pass.
#[derive(Debug, Default)]
pub(crate) struct TrunkActivations {
    gamma: Vec<Real>,
    slots: Vec<Vec<Real>>,
    feature: Vec<Real>,
    attenuation: Vec<Real>,
    /// Encoded directions `[63, rays]`.
    views: Vec<Real>,
}

/// Activations of the signal network for one transmitter per ray.
#[derive(Debug, Default)]
pub(crate) struct SignalActivations {
    first: Vec<Real>,
    second: Vec<Real>,
    /// Raw amplitudes and phases `[2 bands, live]`.
    pub(crate) raw: Vec<Real>,
}

/// Derivatives with respect to all learned parameters.
#[derive(Debug)]
pub(crate) struct Sums<'a> {
    pub(crate) weights: &'a mut [Real],
    /// Derivatives with respect to the contributions of the transmitters, `[B, width]`.
    pub(crate) transmitter_terms: Vec<Real>,
}

impl SharedActivations {
    /// Returns zeros for the cotangents of the path factors and of the shared contributions.
    pub(crate) fn zero_cotangents(&self) -> (Vec<[Real; 2]>, Vec<Real>) {
        (vec![[0.0; 2]; self.factors.len()], vec![0.0; self.hidden.len()])
    }

    /// Returns the number of samples in use.
    fn live_count(&self) -> usize {
        self.segments.last().map_or(0, |segment| segment.end)
    }
}

#[cfg(feature = "gpu")]
impl SharedActivations {
    /// Returns the values `[features, live]` of the samples in use, of all `[features, rays, samples]` of a chunk.
    pub(crate) fn select_live(&self, all: &[Real], samples: usize) -> Vec<Real> {
        let rows = all.chunks_exact((self.segments.len() * samples).max(1));
        let live_values = |row: &'_ [Real]| -> Vec<Real> {
            let rays = row.chunks_exact(samples).zip(&self.segments);
            rays.flat_map(|(ray, segment)| &ray[..segment.len()]).copied().collect()
        };
        rows.flat_map(live_values).collect()
    }

    /// Returns values `[features, rays, samples]` of all samples of a chunk, given those `[features, live]` of the samples in
    /// use; the others are 0.
    pub(crate) fn spread_live(&self, live: &[Real], (features, samples): (usize, usize)) -> Vec<Real> {
        let mut all = vec![0.0; features * self.segments.len() * samples];
        let rows = all.chunks_exact_mut((self.segments.len() * samples).max(1));
        for (row, live) in rows.zip(live.chunks_exact(self.live_count().max(1))) {
            for (ray, segment) in row.chunks_exact_mut(samples).zip(&self.segments) {
                ray[..segment.len()].copy_from_slice(&live[segment.clone()]);
            }
        }
        all
    }
}

impl RayWalk<'_> {
    /// Returns the paths of a chunk from its raw attenuations, without the hidden contributions, which the GPU holds.
    #[cfg(feature = "gpu")]
    pub(crate) fn paths(&self, attenuation: &[Real], rays: usize) -> SharedActivations {
        let (factors, segments) = self.path_factors(attenuation, rays);
        SharedActivations { segments, factors, hidden: Vec::new() }
    }

    /// Returns the number of complex outputs per sample.
    fn band_count(&self) -> usize {
        self.network.outputs / 2
    }

    /// Divides the rays into chunks of about [`ROWS`] samples, whatever the number of threads.
    pub(crate) fn chunks(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        let (rays, size) = (self.rays.directions.len(), (ROWS / self.rays.sample_count()).max(1));
        (0..rays).step_by(size).map(move |first| first..(first + size).min(rays))
    }

    /// Returns the values of a chunk that do not depend on the transmitter, and fills `trunk_activations`. `slots` is
    /// [`PREDICTION_SLOTS`], or the number of trunk layers for the backward pass.
    pub(crate) fn shared_activations(
        &self,
        chunk: Range<usize>,
        slots: usize,
        trunk_activations: &mut TrunkActivations,
    ) -> SharedActivations {
        let (network, weights, samples) = (self.network, self.weights, self.rays.sample_count());
        let (rays, points) = (chunk.len(), self.rays.points(chunk.clone()));
        let TrunkActivations { gamma, slots: h, feature, attenuation, views } = trunk_activations;
        gamma.resize(points.len() * encoded_width(FREQUENCIES), 0.0);
        encode(points.into_iter(), FREQUENCIES, gamma);
        let mut shared = Joints::default();
        network.trunk.share_gamma(weights, gamma, &mut shared);
        h.resize_with(slots, Vec::new);
        network.trunk.forward(weights, &shared, &network.trunk.fold_biases(weights, &[]), h);
        let h = &h[network.trunk.last_slot(slots)];
        network.attenuation.apply(weights, h, attenuation);
        network.feature.apply(weights, h, feature);
        let mut hidden = vec![0.0; feature.len()];
        network.feature_columns().apply(weights, feature, &mut hidden, StoreMode::Set);
        views.resize(rays * encoded_width(FREQUENCIES), 0.0);
        encode(self.rays.directions[chunk].iter().copied(), FREQUENCIES, views);
        let mut view_terms = vec![0.0; network.width() * rays];
        network.view_columns().apply(weights, views, &mut view_terms, StoreMode::Set);
        dense::add_bias(&mut view_terms, network.signal[0].bias(weights));

        let (factors, segments) = self.path_factors(attenuation, rays);
        let live = segments.last().map_or(0, |segment| segment.end);
        let mut live_hidden = Vec::with_capacity(network.width() * live);
        for (row, view_terms) in hidden.chunks_exact(rays * samples).zip(view_terms.chunks_exact(rays)) {
            for (ray, segment) in segments.iter().enumerate() {
                let features = &row[ray * samples..][..segment.len()];
                live_hidden.extend(features.iter().map(|x| x + view_terms[ray]));
            }
        }
        SharedActivations { segments, factors, hidden: live_hidden }
    }

    /// Returns the path factors `[bands, rays, samples]` of a chunk from its raw attenuations, and the range of each ray's
    /// samples among all samples in use: those that any band uses.
    fn path_factors(&self, attenuation: &[Real], rays: usize) -> (Vec<[Real; 2]>, Vec<Range<usize>>) {
        let samples = self.rays.sample_count();
        let mut factors = vec![[0.0; 2]; self.band_count() * rays * samples];
        let (mut segments, mut end) = (Vec::with_capacity(rays), 0);
        for ray in 0..rays {
            let mut live = 0;
            for band in 0..self.band_count() {
                let raw = self.ray_attenuations(attenuation, band, ray, rays);
                let factors = &mut factors[(band * rays + ray) * samples..][..samples];
                live = live.max(self.law.fill_factors(&self.rays.samples, raw, factors));
            }
            segments.push(end..end + live);
            end += live;
        }
        (factors, segments)
    }

    /// Returns raw attenuations and phases `[samples]` of a ray in a band, of those `[2 bands, rays, samples]` of a chunk.
    fn ray_attenuations<'a>(&self, all: &'a [Real], band: usize, ray: usize, rays: usize) -> [&'a [Real]; 2] {
        let samples = self.rays.sample_count();
        [band, self.band_count() + band].map(|row| &all[(row * rays + ray) * samples..][..samples])
    }

    /// Fills `signal` with the emission of the samples for the transmitters in the rows `locations`, one per ray.
    pub(crate) fn run_signal_network(
        &self,
        shared: &SharedActivations,
        locations: &[usize],
        signal: &mut SignalActivations,
    ) {
        let (network, weights, width, live) = (self.network, self.weights, self.network.width(), shared.live_count());
        let SignalActivations { first, second, raw } = signal;
        first.clone_from(&shared.hidden);
        for (feature, row) in first.chunks_exact_mut(live.max(1)).enumerate() {
            for (segment, tx) in shared.segments.iter().zip(locations) {
                let term = self.transmitter_terms[tx * width + feature];
                row[segment.clone()].iter_mut().for_each(|x| {
                    let z = *x + term;
                    *x = if z < 0.0 { 0.0 } else { z };
                });
            }
        }
        network.signal[1].apply_relu(weights, first, second);
        network.emission.apply(weights, second, raw);
    }

    /// Returns the received sums over the samples of each ray, `[rays, bands]`.
    pub(crate) fn ray_sums(&self, shared: &SharedActivations, raw: &[Real]) -> Vec<[Real; 2]> {
        let (bands, rays) = (self.band_count(), shared.segments.len());
        let one = |i: usize| {
            let (ray, band) = (i / bands, i % bands);
            let raw = self.emissions(raw, shared, band, ray);
            ray_sum(raw, self.ray_factors(shared, band, ray), self.law.phase_offset())
        };
        (0..rays * bands).map(one).collect()
    }

    /// Returns the path factors of the samples of a ray that are in use.
    fn ray_factors<'a>(&self, shared: &'a SharedActivations, band: usize, ray: usize) -> &'a [[Real; 2]] {
        let at = (band * shared.segments.len() + ray) * self.rays.sample_count();
        &shared.factors[at..at + shared.segments[ray].len()]
    }

    /// Returns the cotangents of the raw values `[2 bands, live]`, given cotangents `d` `[rays, bands]` of
    /// [`Self::ray_sums`]; adds to those of the path factors.
    pub(crate) fn ray_sums_vjp(
        &self,
        shared: &SharedActivations,
        raw: &[Real],
        d: &[[Real; 2]],
        d_factors: &mut [[Real; 2]],
    ) -> Vec<Real> {
        let (bands, rays, live) = (self.band_count(), shared.segments.len(), shared.live_count());
        let mut d_raw = vec![0.0; raw.len()];
        let (d_amplitudes, d_phases) = d_raw.split_at_mut(bands * live);
        for (i, d) in d.iter().enumerate() {
            let (ray, band) = (i / bands, i % bands);
            let segment = shared.segments[ray].clone();
            let ray_samples = band * live + segment.start..band * live + segment.end;
            let on_path = (band * rays + ray) * self.rays.sample_count();
            ray_sum_vjp(
                self.emissions(raw, shared, band, ray),
                self.ray_factors(shared, band, ray),
                self.law.phase_offset(),
                *d,
                [&mut d_amplitudes[ray_samples.clone()], &mut d_phases[ray_samples]],
                &mut d_factors[on_path..on_path + segment.len()],
            );
        }
        d_raw
    }

    /// Runs the backward pass of [`Self::run_signal_network`] and [`Self::ray_sums`], given cotangents `d` `[rays, bands]` of the
    /// sums. Adds to `into`, and to the cotangents of the path factors and shared contributions.
    pub(crate) fn signal_network_vjp(
        &self,
        (shared, signal, locations): (&SharedActivations, &SignalActivations, &[usize]),
        d: &[[Real; 2]],
        (d_factors, d_hidden): (&mut [[Real; 2]], &mut [Real]),
        into: &mut Sums<'_>,
    ) {
        let (network, weights, width, live) = (self.network, self.weights, self.network.width(), shared.live_count());
        let d_raw = self.ray_sums_vjp(shared, &signal.raw, d, d_factors);
        let (second, mut d_second) = (&signal.second, Vec::new());
        network.emission.apply_vjp(weights, (second, &d_raw), into.weights, (&mut d_second, StoreMode::Set));
        let layer = &network.signal[1];
        dense::add_bias_relu_vjp(&mut d_second, second, layer.bias_mut(into.weights));
        layer.whole().weight_vjp(into.weights, &signal.first, &d_second);
        let mut d_first = vec![0.0; signal.first.len()];
        layer.whole().input_vjp(weights, &d_second, &mut d_first, StoreMode::Set);
        let rows = d_first.chunks_exact(live.max(1)).zip(signal.first.chunks_exact(live.max(1)));
        for (feature, ((d, h), d_hidden)) in rows.zip(d_hidden.chunks_exact_mut(live.max(1))).enumerate() {
            for (segment, tx) in shared.segments.iter().zip(locations) {
                let mut sum = 0.0;
                for i in segment.clone() {
                    let d_first = if h[i] > 0.0 { d[i] } else { 0.0 };
                    d_hidden[i] += d_first;
                    sum += d_first;
                }
                into.transmitter_terms[tx * width + feature] += sum;
            }
        }
    }

    /// Runs the backward pass of [`Self::shared_activations`], given the cotangents of the path factors and shared contributions;
    /// adds to the weights in `into`.
    pub(crate) fn shared_activations_vjp(
        &self,
        (shared, trunk_activations): (&SharedActivations, &TrunkActivations),
        (d_factors, d_live): (&[[Real; 2]], &[Real]),
        into: &mut Sums<'_>,
    ) {
        let (network, weights, width) = (self.network, self.weights, self.network.width());
        let (rays, samples, live) = (shared.segments.len(), self.rays.sample_count(), shared.live_count());
        let (mut d_hidden, mut d_views) = (vec![0.0; width * rays * samples], vec![0.0; width * rays]);
        let rows = d_hidden.chunks_exact_mut(rays * samples).zip(d_views.chunks_exact_mut(rays));
        for ((row, d_views), d_row) in rows.zip(d_live.chunks_exact(live.max(1))) {
            for (ray, segment) in shared.segments.iter().enumerate() {
                let d_row = &d_row[segment.clone()];
                row[ray * samples..][..d_row.len()].copy_from_slice(d_row);
                d_views[ray] = d_row.iter().sum();
            }
        }
        dense::add_bias_vjp(&d_views, network.signal[0].bias_mut(into.weights));
        network.view_columns().weight_vjp(into.weights, &trunk_activations.views, &d_views);
        network.feature_columns().weight_vjp(into.weights, &trunk_activations.feature, &d_hidden);
        let mut d_feature = vec![0.0; trunk_activations.feature.len()];
        network.feature_columns().input_vjp(weights, &d_hidden, &mut d_feature, StoreMode::Set);

        let d_attenuation = self.paths_vjp(shared, &trunk_activations.attenuation, d_factors);
        let (h, mut d_h) = (&trunk_activations.slots[network.trunk.depth() - 1], Vec::new());
        network.feature.apply_vjp(weights, (h, &d_feature), into.weights, (&mut d_h, StoreMode::Set));
        network.attenuation.apply_vjp(weights, (h, &d_attenuation), into.weights, (&mut d_h, StoreMode::Add));

        let (mut d_shared, mut d_folded) = (network.trunk.zero_joints(d_h.len()), network.trunk.zero_joints(width));
        let trunk = TrunkGradient { weights: into.weights, shared: &mut d_shared, folded: d_folded.tx_part(0, width) };
        network.trunk.backward(weights, &trunk_activations.slots, &mut d_h, &mut d_feature, trunk);
        network.trunk.add_joint_biases(into.weights, &d_folded);
        network.trunk.share_gamma_vjp(weights, &trunk_activations.gamma, &d_shared, into.weights, None);
    }

    /// Returns the cotangents of the raw attenuations `[2 bands, rays, samples]`, given those of the path factors.
    pub(crate) fn paths_vjp(
        &self,
        shared: &SharedActivations,
        attenuation: &[Real],
        d_factors: &[[Real; 2]],
    ) -> Vec<Real> {
        let (rays, samples) = (shared.segments.len(), self.rays.sample_count());
        let mut d_attenuation = vec![0.0; attenuation.len()];
        let (d_amplitudes, d_phases) = d_attenuation.split_at_mut(self.band_count() * rays * samples);
        for ray in 0..rays {
            for band in 0..self.band_count() {
                let ray_samples = (band * rays + ray) * samples..(band * rays + ray + 1) * samples;
                self.law.fill_factors_vjp(
                    &self.rays.samples,
                    self.ray_attenuations(attenuation, band, ray, rays),
                    &shared.factors[ray_samples.clone()],
                    &d_factors[ray_samples.start..ray_samples.start + shared.segments[ray].len()],
                    [&mut d_amplitudes[ray_samples.clone()], &mut d_phases[ray_samples]],
                );
            }
        }
        d_attenuation
    }

    /// Returns raw amplitudes and phases of the emission in a band, for the samples of a ray that are in use.
    fn emissions<'a>(&self, raw: &'a [Real], shared: &SharedActivations, band: usize, ray: usize) -> [&'a [Real]; 2] {
        let (live, segment) = (shared.live_count(), &shared.segments[ray]);
        [band, self.band_count() + band].map(|row| &raw[row * live + segment.start..row * live + segment.end])
    }
}
