//! `Nerf2` as a method: from links to observations.

#[cfg(feature = "gpu")]
use crate::nerf2::gpu::{GpuActivations, GpuNerf2, GpuReady, or_default};
use crate::nerf2::group::{GroupLinks, GroupScratch, Passes, RayActivations, RayGroup};
use crate::nerf2::network::Nerf2Network;
use crate::nerf2::path::PropagationLaw;
use crate::nerf2::totals::{band_count, collect_sums, observations, observations_vjp, total_index};
use crate::nerf2::walk::{PREDICTION_SLOTS, RayWalk, SharedActivations, Sums, TrunkActivations};
use crate::nerf2::{Nerf2, RayBundle};
use pwrfgs_core::{
    Appearance, Cache, Call, Cost, ForwardOutput, Layout, MeasurementSetup, Method, MethodTraits, MethodVjp,
    Parameters, PixelSubset, Real, Requirement, SPEED_OF_LIGHT, StageTimes, Task, cached,
};
use pwrfgs_networks::dense::add_in_order;
use pwrfgs_networks::linear::{LayoutBuilder, lay_out, lay_out_for, sum_groups};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

/// Maximum memory for activations per step, bytes; other activations are recomputed.
const KEPT: usize = 1_340_000_000;
/// Maximum size of the cached trunk of a model, bytes; a larger trunk is computed once per call.
const MOST_CACHED: usize = 2_500 << 20;

/// Chunk of a group with its activations.
struct Chunk {
    group: usize,
    rays: Range<usize>,
    activations: Option<RayActivations>,
}

/// State of the forward pass for [`Method::vjp`].
struct Nerf2Cache {
    chunks: Vec<Chunk>,
    /// Instead of `chunks`, on a GPU.
    #[cfg(feature = "gpu")]
    on_gpu: Vec<GpuActivations>,
    /// Sums over the samples `[L, pixels]`, or over the whole sky `[L, bands]`.
    totals: Vec<[Real; 2]>,
}

/// Result of [`Method::prepare`]: the chunks of the sky per receiver.
type Ready = Vec<Vec<SharedActivations>>;

impl Nerf2 {
    /// Returns the propagation law of a task. The wavenumber is per metre, but multiplies lengths in the
    /// network's unit, as released.
    fn propagation_law(&self, task: Task) -> PropagationLaw {
        if task.has_pixels {
            return PropagationLaw::Spectrum;
        }
        PropagationLaw::Wave { wavenumber: (2.0 * std::f64::consts::PI * self.carrier_hz / SPEED_OF_LIGHT) as Real }
    }

    /// Returns the network on the GPU of the process; `None` for the CPU.
    #[cfg(feature = "gpu")]
    fn on_gpu<'a>(&self, network: &'a Nerf2Network, weights: &'a [Real]) -> Option<GpuNerf2<'a>> {
        pwrfgs_gpu::current().map(|gpu| GpuNerf2 { gpu, network, weights, samples: self.samples })
    }

    /// Plans the layers of the network for the setup.
    fn plan_network(&self, setup: &MeasurementSetup, plan: &mut LayoutBuilder) -> Nerf2Network {
        Nerf2Network::new(self, band_count(setup), plan)
    }

    /// Returns the rays of a receiver with the network and the result of [`Nerf2Network::transmitter_terms`].
    fn ray_walk<'a>(
        &self,
        setup: &MeasurementSetup,
        (network, weights): (&'a Nerf2Network, &'a [Real]),
        (receiver, pixels): (usize, &PixelSubset),
        transmitter_terms: &'a [Real],
    ) -> RayWalk<'a> {
        RayWalk {
            network,
            weights,
            rays: RayBundle::new(self, setup, receiver, pixels),
            law: self.propagation_law(setup.task),
            transmitter_terms,
        }
    }

    /// Groups the requested links by receiver, without receivers that have no link.
    fn ray_groups<'a>(
        &self,
        call: &Call<'_>,
        network: (&'a Nerf2Network, &'a [Real]),
        transmitter_terms: &'a [Real],
    ) -> Vec<RayGroup<'a>> {
        let Call { setup, links: inputs, .. } = *call;
        let group = |receiver: usize| {
            let links = inputs.pairs.iter().enumerate().filter(|(_, link)| link.receiver == receiver);
            let links: Vec<(usize, usize)> = links.map(|(k, link)| (k, link.location)).collect();
            if links.is_empty() {
                return None;
            }
            Some(match call.pixels {
                PixelSubset::Each(pixels) => {
                    let pixels = links.iter().map(|(k, _)| pixels[*k]).collect();
                    let walk = self.ray_walk(setup, network, (receiver, &PixelSubset::Each(pixels)), transmitter_terms);
                    RayGroup { receiver, walk, links: GroupLinks::OnePerRay(links) }
                }
                pixels => RayGroup {
                    receiver,
                    walk: self.ray_walk(setup, network, (receiver, pixels), transmitter_terms),
                    links: GroupLinks::All(links),
                },
            })
        };
        (0..setup.receivers.len()).filter_map(group).collect()
    }

    /// Lists all chunks as (group, rays, whether to keep the activations): those that still fit within [`KEPT`].
    fn plan_chunks(&self, network: &Nerf2Network, groups: &[RayGroup<'_>]) -> Vec<(usize, Range<usize>, bool)> {
        let mut free = KEPT;
        let mut chunks = Vec::new();
        for (g, group) in groups.iter().enumerate() {
            for rays in group.walk.chunks() {
                let bytes = network.activation_bytes(self.samples, rays.len(), group.links.pass_count());
                let keep = bytes <= free;
                free -= if keep { bytes } else { 0 };
                chunks.push((g, rays, keep));
            }
        }
        chunks
    }
}

#[typetag::serde]
impl Method for Nerf2 {
    fn traits(&self) -> MethodTraits<'_> {
        use Requirement::{Directions, FixedReceiver, OneAntenna, OneCarrier};
        MethodTraits {
            inputs: if self.features == 0 { 3 } else { self.features },
            appearance: Appearance::Nothing,
            requires: &[OneAntenna, FixedReceiver, OneCarrier, Directions],
            supports_pixel_subset: true,
            differentiates_positions: self.features == 0,
            ..MethodTraits::default()
        }
    }

    fn cost(&self, setup: &MeasurementSetup, links: usize, pixels: usize) -> Cost {
        let network = lay_out(|plan| self.plan_network(setup, plan)).0;
        // Number of rays and of links per ray; with one pixel per link, there are as many rays as links.
        let (rays, passes) = match (setup.task.has_pixels, pixels) {
            (true, 1) => (links, 1),
            (true, pixels) => (pixels, links),
            _ => (self.sky_directions().len() * setup.receivers.len(), links.div_ceil(setup.receivers.len().max(1))),
        };
        Cost {
            pixels,
            bytes: network.activation_bytes(self.samples, rays, passes).min(KEPT) as u64,
            runs_on_gpu: true,
            network_rows: rays * self.samples / passes.max(1),
            links_at_once: (KEPT / network.activation_bytes(self.samples, 1, 1)).max(1),
            ..Cost::default()
        }
    }

    fn layout(&self, setup: &MeasurementSetup) -> Layout {
        lay_out(|plan| self.plan_network(setup, plan)).1.layout()
    }

    fn forward(&self, call: &Call<'_>, _: &Cache) -> ForwardOutput {
        let Call { setup, parameters: p, links, .. } = *call;
        let network = lay_out_for(p.weights, |plan| self.plan_network(setup, plan));
        let transmitter_terms = network.transmitter_terms(p.weights, &links.conditions(), self.unit_m);
        let groups = self.ray_groups(call, (&network, p.weights), &transmitter_terms);
        #[cfg(feature = "gpu")]
        if let Some(on) = self.on_gpu(&network, p.weights) {
            let results = or_default(on.forward(&groups, &on.items(&groups, None), |activations| activations));
            let (on_gpu, sums): (Vec<GpuActivations>, Vec<Passes>) = results.into_iter().unzip();
            let sums = on_gpu.iter().zip(sums).map(|(chunk, sums)| (chunk.group, chunk.rays.clone(), sums));
            let totals = collect_sums(call, &groups, sums);
            let numbers = observations(setup, &totals);
            return ForwardOutput { numbers, cache: Some(Arc::new(Nerf2Cache { chunks: Vec::new(), on_gpu, totals })) };
        }
        let one = |scratch: &mut GroupScratch, (g, rays, keep): (usize, Range<usize>, bool)| {
            let (activations, sums) = if keep {
                let (results, sums) = groups[g].forward_keeping(&rays);
                (Some(results), sums)
            } else {
                (None, groups[g].forward(&rays, None, scratch))
            };
            (Chunk { group: g, rays, activations }, sums)
        };
        let items = self.plan_chunks(&network, &groups);
        let results: Vec<_> = items.into_par_iter().map_init(GroupScratch::default, one).collect();
        let (chunks, sums): (Vec<Chunk>, Vec<Passes>) = results.into_iter().unzip();
        let sums = chunks.iter().zip(sums).map(|(chunk, sums)| (chunk.group, chunk.rays.clone(), sums));
        let totals = collect_sums(call, &groups, sums);
        let numbers = observations(setup, &totals);
        ForwardOutput {
            numbers,
            cache: Some(Arc::new(Nerf2Cache {
                chunks,
                #[cfg(feature = "gpu")]
                on_gpu: Vec::new(),
                totals,
            })),
        }
    }

    fn vjp(&self, call: &Call<'_>, observed: ForwardOutput, d: &[Real], sums: &mut MethodVjp) {
        let Call { setup, parameters: p, links, .. } = *call;
        let Nerf2Cache { chunks, totals, .. } = cached(&observed.cache);
        let network = lay_out_for(p.weights, |plan| self.plan_network(setup, plan));
        let transmitter_terms = network.transmitter_terms(p.weights, &links.conditions(), self.unit_m);
        let groups = self.ray_groups(call, (&network, p.weights), &transmitter_terms);
        let d_totals = observations_vjp(setup, totals, d);
        let width = totals.len() / links.pairs.len().max(1);
        let MethodVjp { weights: d_weights, positions: d_positions, .. } = sums;
        let conditions = links.conditions();
        #[cfg(feature = "gpu")]
        if let Some(on) = self.on_gpu(&network, p.weights) {
            let Nerf2Cache { on_gpu, .. } = cached(&observed.cache);
            let d = |chunk: &GpuActivations, sum: [usize; 3]| {
                d_totals[total_index(setup, &groups[chunk.group].links, width, sum)]
            };
            return match on.backward(&groups, on_gpu, d, d_weights) {
                Ok(d_terms) => {
                    let into = (&mut d_weights[..], d_positions.as_deref_mut());
                    network.transmitter_terms_vjp(p.weights, &conditions, self.unit_m, &d_terms, into);
                }
                Err(error) => pwrfgs_core::device::fail(error),
            };
        }
        let parts = sum_groups(chunks, d_weights, |chunks, weights| {
            let mut into = Sums { weights, transmitter_terms: vec![0.0; transmitter_terms.len()] };
            let mut scratch = GroupScratch::default();
            for Chunk { group, rays, activations } in chunks {
                let group = &groups[*group];
                let d = |pass, ray, band| d_totals[total_index(setup, &group.links, width, [pass, ray, band])];
                group.backward(rays, activations.as_ref(), d, &mut scratch, &mut into);
            }
            into.transmitter_terms
        });
        let mut d_terms = vec![0.0; transmitter_terms.len()];
        add_in_order(&mut d_terms, &parts.iter().map(Vec::as_slice).collect::<Vec<_>>());
        let into = (&mut d_weights[..], d_positions.as_deref_mut());
        network.transmitter_terms_vjp(p.weights, &conditions, self.unit_m, &d_terms, into);
    }

    fn prepare(&self, setup: &MeasurementSetup, p: &Parameters<'_>) -> Cache {
        let network = lay_out_for(p.weights, |plan| self.plan_network(setup, plan));
        let rays = if setup.task.has_pixels { setup.value_count() } else { self.sky_directions().len() };
        let per_sample = network.width() + network.outputs;
        let bytes = setup.receivers.len() * rays * self.samples * per_sample * size_of::<Real>();
        if bytes > MOST_CACHED {
            return None;
        }
        #[cfg(feature = "gpu")]
        if let Some(on) = self.on_gpu(&network, p.weights) {
            let mut ready: Vec<Vec<GpuReady>> = Vec::new();
            for receiver in 0..setup.receivers.len() {
                let walk = self.ray_walk(setup, (&network, p.weights), (receiver, &PixelSubset::All), &[]);
                let prepared = on.prepare(&RayGroup { receiver, walk, links: GroupLinks::All(Vec::new()) });
                ready.push(or_default(prepared)?);
            }
            return Some(Arc::new(ready));
        }
        let chunks_of_sky = |receiver: usize| {
            let walk = self.ray_walk(setup, (&network, p.weights), (receiver, &PixelSubset::All), &[]);
            let chunks: Vec<Range<usize>> = walk.chunks().collect();
            let shared = |trunk_activations: &mut TrunkActivations, rays: &Range<usize>| {
                walk.shared_activations(rays.clone(), PREDICTION_SLOTS, trunk_activations)
            };
            chunks.par_iter().map_init(TrunkActivations::default, shared).collect()
        };
        let ready: Ready = (0..setup.receivers.len()).map(chunks_of_sky).collect();
        Some(Arc::new(ready))
    }

    fn predict(&self, call: &Call<'_>, prepared: &Cache) -> (Vec<Real>, StageTimes) {
        let Call { setup, parameters: p, links, pixels } = *call;
        let start = Instant::now();
        let network = lay_out_for(p.weights, |plan| self.plan_network(setup, plan));
        let transmitter_terms = network.transmitter_terms(p.weights, &links.conditions(), self.unit_m);
        let groups = self.ray_groups(call, (&network, p.weights), &transmitter_terms);
        #[cfg(feature = "gpu")]
        if let Some(on) = self.on_gpu(&network, p.weights) {
            let kept = prepared.as_ref().filter(|_| *pixels == PixelSubset::All);
            let kept = kept.and_then(|kept| kept.downcast_ref::<Vec<Vec<GpuReady>>>());
            let items = on.items(&groups, kept.map(Vec::as_slice));
            let results = or_default(on.forward(&groups, &items, |activations| (activations.group, activations.rays)));
            let totals =
                collect_sums(call, &groups, results.into_iter().map(|((group, rays), sums)| (group, rays, sums)));
            let total = start.elapsed().as_secs_f64();
            return (observations(setup, &totals), StageTimes { network: total, total, ..StageTimes::default() });
        }
        let ready: Option<&Ready> = (prepared.is_some() && *pixels == PixelSubset::All).then(|| cached(prepared));
        let chunks = |g: usize| groups[g].walk.chunks().enumerate().map(move |(c, rays)| (g, c, rays));
        let items: Vec<_> = (0..groups.len()).flat_map(chunks).collect();
        let one = |scratch: &mut GroupScratch, (g, c, rays): (usize, usize, Range<usize>)| {
            let shared = ready.map(|ready| &ready[groups[g].receiver][c]);
            let sums = groups[g].forward(&rays, shared, scratch);
            (g, rays, sums)
        };
        let results: Vec<_> = items.into_par_iter().map_init(GroupScratch::default, one).collect();
        let totals = collect_sums(call, &groups, results.into_iter());
        let numbers = observations(setup, &totals);
        let total = start.elapsed().as_secs_f64();
        (numbers, StageTimes { network: total, total, ..StageTimes::default() })
    }

    fn check(&self) -> Result<(), String> {
        self.check_settings()
    }
}
