//! NeRF2's network on a GPU, with the slots and the trunk of the deformation networks. A chunk of rays has up to 65,536
//! samples; the trunk runs once, the signal network for every pass. Paths and sums along the rays need no matrix products
//! and stay on the CPU.

mod passes;

pub(crate) use passes::GpuNerf2;

use crate::nerf2::group::{Passes, RayGroup};
use crate::nerf2::network::FREQUENCIES;
use crate::nerf2::walk::SharedActivations;
use passes::{ATTENUATION, D_FROM_FEATURE, D_SIDE, FROM_FEATURE, RAW};
use pwrfgs_core::{Real, Result};
use pwrfgs_gpu::KeptBuffer;
use pwrfgs_networks::encoding::encoded_width;
use pwrfgs_networks::trunk::gpu::{D_FOLDED, D_WEIGHTS, chunk_rows};
use rayon::prelude::*;
use std::ops::Range;

/// Maximum number of values that one step reads; further chunks are computed in further steps.
const RESULTS: usize = 1 << 26;

/// Chunk of rays of a group; `ready` is the result of [`GpuNerf2::prepare`] for it.
#[derive(Clone, Debug)]
pub(crate) struct GpuItem<'a> {
    pub(crate) group: usize,
    pub(crate) rays: Range<usize>,
    pub(crate) ready: Option<&'a GpuReady>,
}

/// Part of a chunk that does not depend on the transmitter, for predictions: its paths, and W·feature on the GPU.
#[derive(Debug)]
pub(crate) struct GpuReady {
    shared: SharedActivations,
    from_feature: KeptBuffer,
}

/// Raw values of a chunk for the backward pass, of attenuation, and of the emission per pass for the samples in use.
#[derive(Debug)]
pub(crate) struct GpuActivations {
    pub(crate) group: usize,
    pub(crate) rays: Range<usize>,
    shared: SharedActivations,
    attenuation: Vec<Real>,
    raw: Vec<Vec<Real>>,
}

/// Returns the result of a pass. If the pass failed, records the error and returns a default, which callers must not use.
pub(crate) fn or_default<T: Default>(result: Result<T>) -> T {
    result.unwrap_or_else(|error| {
        pwrfgs_core::device::fail(error);
        T::default()
    })
}

impl GpuNerf2<'_> {
    /// Divides `rays` rays into chunks of at most [`chunk_rows`] samples, or of one ray.
    pub(crate) fn chunks(&self, rays: usize) -> impl Iterator<Item = Range<usize>> + use<> {
        let rows = chunk_rows(self.gpu, self.network.width(), encoded_width(FREQUENCIES));
        let size = (rows / self.samples).max(1);
        (0..rays).step_by(size).map(move |first| first..(first + size).min(rays))
    }

    /// Returns the items of all groups; `ready` has the prepared chunks per receiver.
    pub(crate) fn items<'r>(&self, groups: &[RayGroup<'_>], ready: Option<&'r [Vec<GpuReady>]>) -> Vec<GpuItem<'r>> {
        let group_items = |(index, group): (usize, &RayGroup<'_>)| {
            let ready = ready.map(|ready| &ready[group.receiver]);
            let chunks = self.chunks(group.walk.rays.directions.len()).enumerate();
            chunks.map(move |(c, rays)| GpuItem { group: index, rays, ready: ready.map(|ready| &ready[c]) })
        };
        groups.iter().enumerate().flat_map(group_items).collect()
    }

    /// Runs the forward pass of all `items`; returns the results of `keep` on their activations, and their sums along the rays.
    ///
    /// # Errors
    /// The GPU failed.
    pub(crate) fn forward<K: Send>(
        &self,
        groups: &[RayGroup<'_>],
        items: &[GpuItem<'_>],
        keep: impl Fn(GpuActivations) -> K + Sync,
    ) -> Result<Vec<(K, Passes)>> {
        let mut results = Vec::new();
        let mut remaining = items;
        while !remaining.is_empty() {
            let mut numbers = 0;
            let fits = |item: &&GpuItem<'_>| {
                numbers +=
                    self.network.outputs * item.rays.len() * self.samples * (1 + groups[item.group].links.pass_count());
                numbers <= RESULTS
            };
            let (now, later) = remaining.split_at(remaining.iter().take_while(fits).count().max(1));
            results.extend(self.forward_together(groups, now, &keep)?);
            remaining = later;
        }
        Ok(results)
    }

    /// Runs the forward pass of some items in one step, as [`Self::forward`].
    fn forward_together<K: Send>(
        &self,
        groups: &[RayGroup<'_>],
        items: &[GpuItem<'_>],
        keep: impl Fn(GpuActivations) -> K + Sync,
    ) -> Result<Vec<(K, Passes)>> {
        let mut step = self.begin(items.iter().map(|item| item.rays.len()).max().unwrap_or(0), false)?;
        for GpuItem { group, rays, ready } in items {
            let (group, chunk) = (&groups[*group], self.chunk(rays.len(), false));
            if let Some(ready) = ready {
                step.load(FROM_FEATURE, self.network.width() * chunk.on.rows, &ready.from_feature);
            } else {
                self.run_trunk(&mut step, chunk, &group.walk.rays.points(rays.clone()));
            }
            step.read(ATTENUATION, 0, if ready.is_none() { self.network.outputs * chunk.on.rows } else { 0 });
            Self::upload_views(&mut step, group, rays);
            for pass in 0..group.links.pass_count() {
                let locations = group.links.pass_locations(pass, rays);
                self.run_signal(&mut step, chunk, group.walk.transmitter_terms, &locations);
                step.read(RAW, 0, self.network.outputs * chunk.on.rows);
                step.send();
            }
        }
        let mut results = step.finish()?.into_iter();
        let item_results = |item: &GpuItem<'_>| -> (Vec<Real>, Vec<Vec<Real>>) {
            let attenuation = results.next().unwrap_or_default();
            (attenuation, results.by_ref().take(groups[item.group].links.pass_count()).collect())
        };
        let results: Vec<_> = items.iter().map(item_results).collect();
        let one = |(item, (attenuation, raw)): (&GpuItem<'_>, (Vec<Real>, Vec<Vec<Real>>))| {
            let (walk, rays) = (&groups[item.group].walk, item.rays.clone());
            let shared = item.ready.map_or_else(|| walk.paths(&attenuation, rays.len()), |ready| ready.shared.clone());
            let raw: Vec<Vec<Real>> = raw.iter().map(|raw| shared.select_live(raw, self.samples)).collect();
            let sums = raw.iter().map(|raw| walk.ray_sums(&shared, raw)).collect();
            (keep(GpuActivations { group: item.group, rays, shared, attenuation, raw }), sums)
        };
        Ok(items.par_iter().zip(results).map(one).collect())
    }

    /// Computes the parts of all rays of a group that do not depend on the transmitter, by chunk; `None` if the memory of the
    /// GPU does not suffice to keep them.
    ///
    /// # Errors
    /// The GPU failed.
    pub(crate) fn prepare(&self, group: &RayGroup<'_>) -> Result<Option<Vec<GpuReady>>> {
        let chunks: Vec<Range<usize>> = self.chunks(group.walk.rays.directions.len()).collect();
        let mut step = self.begin(chunks.iter().map(Range::len).max().unwrap_or(0), false)?;
        let mut buffers = Vec::new();
        for rays in &chunks {
            let chunk = self.chunk(rays.len(), false);
            let len = self.network.width() * chunk.on.rows;
            let Some(buffer) = self.gpu.create_kept_buffer(len) else { return Ok(None) };
            self.run_trunk(&mut step, chunk, &group.walk.rays.points(rays.clone()));
            step.read(ATTENUATION, 0, self.network.outputs * chunk.on.rows);
            step.save(FROM_FEATURE, len, &buffer);
            buffers.push(buffer);
        }
        let results = step.finish()?;
        let one = |((rays, attenuation), from_feature): ((&Range<usize>, Vec<Real>), KeptBuffer)| GpuReady {
            shared: group.walk.paths(&attenuation, rays.len()),
            from_feature,
        };
        Ok(Some(chunks.par_iter().zip(results).zip(buffers).map(one).collect()))
    }

    /// Runs the backward pass of [`Self::forward`], given the cotangents `d` per chunk and [pass, ray, band]. Adds to
    /// `d_weights`; returns the cotangents of the contributions of the transmitters, `[B, width]`.
    ///
    /// # Errors
    /// The GPU failed; `d_weights` are then unchanged.
    pub(crate) fn backward(
        &self,
        groups: &[RayGroup<'_>],
        chunks: &[GpuActivations],
        d: impl Fn(&GpuActivations, [usize; 3]) -> [Real; 2] + Sync,
        d_weights: &mut [Real],
    ) -> Result<Vec<Real>> {
        let cotangents: Vec<_> = chunks.par_iter().map(|chunk| self.raw_cotangents(groups, chunk, &d)).collect();
        let width = self.network.width();
        let mut step = self.begin(chunks.iter().map(|chunk| chunk.rays.len()).max().unwrap_or(0), true)?;
        step.clear(D_WEIGHTS, self.weights.len());
        step.clear(D_FOLDED, 2 * width);
        for (GpuActivations { group, rays, .. }, (d_attenuation, d_raw)) in chunks.iter().zip(&cotangents) {
            let (group, chunk) = (&groups[*group], self.chunk(rays.len(), true));
            self.run_trunk(&mut step, chunk, &group.walk.rays.points(rays.clone()));
            Self::upload_views(&mut step, group, rays);
            step.clear(D_FROM_FEATURE, width * chunk.on.rows);
            for (pass, d_raw) in d_raw.iter().enumerate() {
                let locations = group.links.pass_locations(pass, rays);
                self.run_signal(&mut step, chunk, group.walk.transmitter_terms, &locations);
                step.upload(RAW, 0, d_raw);
                self.signal_vjp(&mut step, chunk);
                step.read(D_SIDE, 0, width * rays.len());
                step.send();
            }
            step.upload(ATTENUATION, 0, d_attenuation);
            self.trunk_vjp(&mut step, chunk);
        }
        step.read(D_WEIGHTS, 0, self.weights.len());
        step.read(D_FOLDED, 0, 2 * width);
        let mut results = step.finish()?.into_iter();
        let mut d_terms = vec![0.0; groups.iter().map(|group| group.walk.transmitter_terms.len()).max().unwrap_or(0)];
        for GpuActivations { group, rays, raw, .. } in chunks {
            for (pass, d_side) in results.by_ref().take(raw.len()).enumerate() {
                let locations = groups[*group].links.pass_locations(pass, rays);
                for (feature, d_side) in d_side.chunks_exact(rays.len()).enumerate() {
                    locations.iter().zip(d_side).for_each(|(tx, d)| d_terms[tx * width + feature] += d);
                }
            }
        }
        let (d_network, d_folded) = (results.next().unwrap_or_default(), results.next().unwrap_or_default());
        pwrfgs_networks::dense::add_assign(d_weights, &d_network);
        self.network.trunk.add_joint_biases(d_weights, &self.network.trunk.folded_joints(&d_folded));
        Ok(d_terms)
    }

    /// Returns the cotangents of the raw attenuations of a chunk, and of the raw emissions per pass, `[2 bands, R]` each for R
    /// samples.
    fn raw_cotangents(
        &self,
        groups: &[RayGroup<'_>],
        chunk: &GpuActivations,
        d: impl Fn(&GpuActivations, [usize; 3]) -> [Real; 2],
    ) -> (Vec<Real>, Vec<Vec<Real>>) {
        let (GpuActivations { group, rays, shared, attenuation, raw }, outputs) = (chunk, self.network.outputs);
        let (walk, bands) = (&groups[*group].walk, outputs / 2);
        let (mut d_factors, _) = shared.zero_cotangents();
        let mut d_raw = Vec::with_capacity(raw.len());
        for (pass, raw) in raw.iter().enumerate() {
            let d_sum = |i: usize| d(chunk, [pass, rays.start + i / bands, i % bands]);
            let d_sums: Vec<[Real; 2]> = (0..rays.len() * bands).map(d_sum).collect();
            let d_live = walk.ray_sums_vjp(shared, raw, &d_sums, &mut d_factors);
            d_raw.push(shared.spread_live(&d_live, (outputs, self.samples)));
        }
        (walk.paths_vjp(shared, attenuation, &d_factors), d_raw)
    }
}
