//! `Nerf2` as a method: from links to observations.

use crate::nerf2::group::{Group, Links, Passes, Scratch, Walked};
use crate::nerf2::network::Network;
use crate::nerf2::path::Law;
use crate::nerf2::walk::{Still, Sums, Trunked, Walk};
use crate::nerf2::{Nerf2, Rays};
use pwrfgs_core::{
    Appearance, Asked, Cache, Cost, Frame, Layout, Method, MethodTraits, MethodVjp, Observed, Parameters, Pixels, Real,
    SPEED_OF_LIGHT, StageTimes, Task, cached,
};
use pwrfgs_networks::dense::add_in_order;
use pwrfgs_networks::linear::{Plan, items_per_sum, laid_out, planned};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

/// Maximum memory for activations per step, bytes; other activations are recomputed.
const KEPT: usize = 1_340_000_000;
/// Chunk of a group with its activations.
struct Chunk {
    group: usize,
    rays: Range<usize>,
    kept: Option<Walked>,
}

/// State of the forward pass for [`Method::vjp`].
struct Forward {
    chunks: Vec<Chunk>,
    /// Sums over the samples `[L, pixels]`, or over the whole sky `[L, bands]`.
    totals: Vec<[Real; 2]>,
}

/// Result of [`Method::prepare`]: the chunks of the sky per receiver.
type Ready = Vec<Vec<Still>>;

impl Nerf2 {
    fn law(&self, task: Task) -> Law {
        if task.has_pixels {
            return Law::Spectrum;
        }
        Law::Wave { wavenumber: (2.0 * std::f64::consts::PI * self.carrier_hz / SPEED_OF_LIGHT) as Real }
    }

    fn network(&self, frame: &Frame, plan: &mut Plan) -> Network {
        Network::new(self, bands(frame), plan)
    }

    fn walk<'a>(
        &self,
        frame: &Frame,
        (network, weights): (&'a Network, &'a [Real]),
        (receiver, pixels): (usize, &Pixels<'_>),
        told: &'a [Real],
    ) -> Walk<'a> {
        Walk { network, weights, rays: Rays::of(self, frame, receiver, pixels), law: self.law(frame.task), told }
    }

    /// Groups the requested links by receiver.
    fn groups<'a>(
        &self,
        frame: &Frame,
        network: (&'a Network, &'a [Real]),
        asked: &Asked<'_>,
        told: &'a [Real],
    ) -> Vec<Group<'a>> {
        let of = |receiver: usize| {
            let links = asked.links.iter().enumerate().filter(|(_, link)| link.receiver == receiver);
            let links: Vec<(usize, usize)> = links.map(|(k, link)| (k, link.transmitter)).collect();
            if links.is_empty() {
                return None;
            }
            Some(match asked.pixels {
                Pixels::Own(places) => {
                    let own: Vec<usize> = links.iter().map(|(k, _)| places[*k]).collect();
                    let walk = self.walk(frame, network, (receiver, &Pixels::Own(&own)), told);
                    Group { receiver, walk, links: Links::Own(links) }
                }
                pixels => Group {
                    receiver,
                    walk: self.walk(frame, network, (receiver, &pixels), told),
                    links: Links::All(links),
                },
            })
        };
        (0..frame.receivers.len()).filter_map(of).collect()
    }

    /// Converts sums `[L, pixels or bands]` to observations.
    fn observations(frame: &Frame, totals: &[[Real; 2]]) -> Vec<Real> {
        if frame.task.is_complex {
            return pwrfgs_core::rows_of(totals, bands(frame));
        }
        let size = totals.iter().map(|[re, im]| re.hypot(*im));
        if frame.task.is_scalar { size.map(|size| 100.0 * size - 100.0).collect() } else { size.collect() }
    }

    /// Returns the cotangents of the sums, given those of the observations.
    fn observations_vjp(frame: &Frame, totals: &[[Real; 2]], d: &[Real]) -> Vec<[Real; 2]> {
        let along = |([re, im], d): (&[Real; 2], &Real)| {
            let size = re.hypot(*im);
            if size > 0.0 { [d * re / size, d * im / size] } else { [0.0; 2] }
        };
        if frame.task.is_complex {
            return pwrfgs_core::gains_of(d, bands(frame));
        }
        let each = totals.iter().zip(d).map(along);
        if frame.task.is_scalar { each.map(|d| d.map(|d| 100.0 * d)).collect() } else { each.collect() }
    }

    /// Collects the sums of chunks, in order, `[L, pixels or bands]`.
    fn gather(
        frame: &Frame,
        asked: &Asked<'_>,
        groups: &[Group<'_>],
        chunks: impl Iterator<Item = (usize, Range<usize>, Passes)>,
    ) -> Vec<[Real; 2]> {
        let of_link = if frame.task.has_pixels { asked.pixels.of_link(frame.numbers()) } else { bands(frame) };
        let mut totals = vec![[0.0; 2]; asked.links.len() * of_link];
        for (group, rays, passes) in chunks {
            let bands = bands(frame);
            for (pass, sums) in passes.into_iter().enumerate() {
                for (i, sum) in sums.into_iter().enumerate() {
                    let (ray, band) = (rays.start + i / bands, i % bands);
                    let total = &mut totals[place(frame, &groups[group].links, of_link, (pass, ray, band))];
                    total[0] += sum[0];
                    total[1] += sum[1];
                }
            }
        }
        totals
    }
}

/// Returns the index at which the sum of a ray is stored.
fn place(frame: &Frame, links: &Links, of_link: usize, (pass, ray, band): (usize, usize, usize)) -> usize {
    let link = links.link(pass, ray);
    match (frame.task.has_pixels, links) {
        (true, Links::All(_)) => link * of_link + ray,
        (true, Links::Own(_)) => link,
        _ => link * of_link + band,
    }
}

/// Returns the number of complex outputs per sample.
fn bands(frame: &Frame) -> usize {
    frame.frequencies_hz.len().max(1)
}

/// Returns the memory of the stored activations of a chunk, bytes.
fn bytes_of(network: &Network, samples: usize, rays: usize, passes: usize) -> usize {
    let of_sample =
        (network.trunk.depth() + 2) * network.width() + passes * (3 * network.width() / 2 + network.outputs);
    rays * samples * of_sample * size_of::<Real>()
}

#[typetag::serde]
impl Method for Nerf2 {
    fn traits(&self) -> MethodTraits<'_> {
        MethodTraits {
            inputs: if self.features == 0 { 3 } else { self.features },
            appearance: Appearance::Nothing,
            chooses_pixels: true,
            ..MethodTraits::default()
        }
    }

    fn cost(&self, frame: &Frame, links: usize, pixels: usize) -> Cost {
        let network = planned(|plan| self.network(frame, plan)).0;
        // Number of rays and of links per ray; with one pixel per link, there are as many rays as links.
        let (rays, passes) = match (frame.task.has_pixels, pixels) {
            (true, 1) => (links, 1),
            (true, pixels) => (pixels, links),
            _ => (self.sky().len() * frame.receivers.len(), links.div_ceil(frame.receivers.len().max(1))),
        };
        Cost {
            pixels,
            bytes: bytes_of(&network, self.samples, rays, passes).min(KEPT) as u64,
            links_at_once: (KEPT / bytes_of(&network, self.samples, 1, 1)).max(1),
            ..Cost::default()
        }
    }

    fn layout(&self, frame: &Frame) -> Result<Layout, String> {
        if frame.task.is_complex && frame.receivers.iter().any(|receiver| receiver.antennas.len() > 1) {
            return Err("method: Nerf2 hears one antenna at a time, and a receiver of these data has more; \
                 make each antenna a receiver, as Nerf2Csi does with together: false"
                .into());
        }
        if frame.task.has_pixels && frame.plane.direction(0.0, 0.0).is_none() {
            return Err("method: Nerf2 needs the directions of pixels, which these data do not contain".into());
        }
        Ok(planned(|plan| self.network(frame, plan)).1.layout())
    }

    fn forward(&self, frame: &Frame, p: &Parameters<'_>, asked: &Asked<'_>) -> Observed {
        let network = laid_out(p.weights, |plan| self.network(frame, plan));
        let told = network.tell(p.weights, &asked.conditions, self.unit_m);
        let groups = self.groups(frame, (&network, p.weights), asked, &told);
        let mut room = KEPT;
        let mut items = Vec::new();
        for (g, group) in groups.iter().enumerate() {
            for rays in group.walk.chunks() {
                let bytes = bytes_of(&network, self.samples, rays.len(), group.links.passes());
                let keep = bytes <= room;
                room -= if keep { bytes } else { 0 };
                items.push((g, rays, keep));
            }
        }
        let one = |scratch: &mut Scratch, (g, rays, keep): (usize, Range<usize>, bool)| {
            let (kept, sums) = if keep {
                let (walked, sums) = groups[g].keep(&rays);
                (Some(walked), sums)
            } else {
                (None, groups[g].pass(&rays, None, scratch))
            };
            (Chunk { group: g, rays, kept }, sums)
        };
        let walked: Vec<_> = items.into_par_iter().map_init(Scratch::default, one).collect();
        let (chunks, sums): (Vec<Chunk>, Vec<Passes>) = walked.into_iter().unzip();
        let sums = chunks.iter().zip(sums).map(|(chunk, sums)| (chunk.group, chunk.rays.clone(), sums));
        let totals = Self::gather(frame, asked, &groups, sums);
        let numbers = Self::observations(frame, &totals);
        Observed { numbers, cache: Some(Arc::new(Forward { chunks, totals })) }
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
        let Forward { chunks, totals } = cached(&observed.cache);
        let network = laid_out(p.weights, |plan| self.network(frame, plan));
        let told = network.tell(p.weights, &asked.conditions, self.unit_m);
        let groups = self.groups(frame, (&network, p.weights), asked, &told);
        let d_totals = Self::observations_vjp(frame, totals, d);
        let of_link = totals.len() / asked.links.len().max(1);
        let parts: Vec<Sums> = chunks
            .par_chunks(items_per_sum(chunks.len()))
            .map(|chunks| {
                let mut into = Sums { weights: vec![0.0; p.weights.len()], told: vec![0.0; told.len()] };
                let mut scratch = Scratch::default();
                for Chunk { group, rays, kept } in chunks {
                    let group = &groups[*group];
                    let d = |pass, ray, band| d_totals[place(frame, &group.links, of_link, (pass, ray, band))];
                    group.back(rays, kept.as_ref(), d, &mut scratch, &mut into);
                }
                into
            })
            .collect();
        add_in_order(&mut sums.weights, &parts.iter().map(|part| part.weights.as_slice()).collect::<Vec<_>>());
        let mut d_told = vec![0.0; told.len()];
        add_in_order(&mut d_told, &parts.iter().map(|part| part.told.as_slice()).collect::<Vec<_>>());
        network.tell_vjp(&asked.conditions, self.unit_m, &d_told, &mut sums.weights);
    }

    fn prepare(&self, frame: &Frame, p: &Parameters<'_>) -> Cache {
        let network = laid_out(p.weights, |plan| self.network(frame, plan));
        let rays = if frame.task.has_pixels { frame.numbers() } else { self.sky().len() };
        let of_sample = network.width() + network.outputs;
        let bytes = frame.receivers.len() * rays * self.samples * of_sample * size_of::<Real>();
        if bytes > self.cache_mb << 20 {
            return None;
        }
        let of = |receiver: usize| {
            let walk = self.walk(frame, (&network, p.weights), (receiver, &Pixels::All), &[]);
            let chunks: Vec<Range<usize>> = walk.chunks().collect();
            let still = |trunked: &mut Trunked, rays: &Range<usize>| walk.still(rays.clone(), 2, trunked);
            chunks.par_iter().map_init(Trunked::default, still).collect()
        };
        let ready: Ready = (0..frame.receivers.len()).map(of).collect();
        Some(Arc::new(ready))
    }

    fn predict(
        &self,
        frame: &Frame,
        p: &Parameters<'_>,
        asked: &Asked<'_>,
        prepared: &Cache,
    ) -> (Vec<Real>, StageTimes) {
        let start = Instant::now();
        let network = laid_out(p.weights, |plan| self.network(frame, plan));
        let told = network.tell(p.weights, &asked.conditions, self.unit_m);
        let groups = self.groups(frame, (&network, p.weights), asked, &told);
        let ready: Option<&Ready> = (prepared.is_some() && asked.pixels == Pixels::All).then(|| cached(prepared));
        let chunks = |g: usize| groups[g].walk.chunks().enumerate().map(move |(c, rays)| (g, c, rays));
        let items: Vec<_> = (0..groups.len()).flat_map(chunks).collect();
        let one = |scratch: &mut Scratch, (g, c, rays): (usize, usize, Range<usize>)| {
            let still = ready.map(|ready| &ready[groups[g].receiver][c]);
            let sums = groups[g].pass(&rays, still, scratch);
            (g, rays, sums)
        };
        let walked: Vec<_> = items.into_par_iter().map_init(Scratch::default, one).collect();
        let totals = Self::gather(frame, asked, &groups, walked.into_iter());
        let numbers = Self::observations(frame, &totals);
        let total = start.elapsed().as_secs_f64();
        (numbers, StageTimes { network: total, total, ..StageTimes::default() })
    }

    fn check(&self) -> Result<(), String> {
        self.check_settings()
    }
}
