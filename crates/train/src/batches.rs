//! `Batches`: the transmitters of each step and the observations of their links. Also the image plane of each step.

use crate::graph::Batch;
use crate::plan::TrainingPlan;
use crate::settings::Rays;
use pwrfgs_core::{Dataset, ImagePlane, LinkInputs, PixelSubset, Pose, Real, Result, Task, rng, stretch::stretch};
use pwrfgs_model::Stages;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;

/// Training set: every transmitter once per epoch with all its links, in a new random order per epoch.
#[derive(Debug)]
pub(crate) struct Batches {
    train: Vec<usize>,
    /// Links of each transmitter, as indices into `train`.
    transmitters: Vec<Range<usize>>,
    /// Epoch to which `order` belongs; `u64::MAX` before the first.
    epoch: u64,
    /// Order of the transmitters, as indices into `transmitters`.
    order: Vec<usize>,
}

impl Batches {
    /// Creates batches of the links `train` of `data`; they must ascend, so that links of one location are adjacent.
    pub(crate) fn new(data: &Dataset, train: Vec<usize>) -> Self {
        let same = |a: &usize, b: &usize| data.links[*a].location == data.links[*b].location;
        let mut transmitters: Vec<Range<usize>> = Vec::new();
        for links in train.chunk_by(same) {
            let begin = transmitters.last().map_or(0, |links| links.end);
            transmitters.push(begin..begin + links.len());
        }
        Self { transmitters, train, epoch: u64::MAX, order: Vec::new() }
    }

    /// Returns the links of the training set.
    pub(crate) fn train(&self) -> &[usize] {
        &self.train
    }

    /// Returns the number of transmitters in the training set.
    pub(crate) fn transmitter_count(&self) -> usize {
        self.transmitters.len()
    }

    /// Creates the batch of `step` (from 1): transmitters with their random shifts, and the observations of their links; of
    /// spectra only the pixels that `stages` draws and [`Rays`] selects. Draws a new order of transmitters if an epoch
    /// begins. With [`Rays::Each`], draws random links with one pixel each in place of transmitters, without epochs.
    ///
    /// # Errors
    /// A spectrum cannot be read.
    pub(crate) fn draw_batch(
        &mut self,
        step: u64,
        plan: &TrainingPlan,
        data: &Dataset,
        stages: &Stages,
    ) -> Result<Batch> {
        let settings = &plan.training;
        let (seed, n) = (plan.seed, self.transmitters.len() as u64);
        let mut jitter = rng::stream(seed, "jitter", step);
        let mut shift = |x: Real| x + settings.tx_jitter_m * rng::normal(&mut jitter);
        let random = &mut rng::stream(seed, "rays", step);
        let pixels = match settings.rays {
            Rays::All => PixelSubset::All,
            Rays::Same(count) => PixelSubset::Same(draw_rays(count, stages.value_count(), random)),
            Rays::Each(count) => {
                let mut links: Vec<usize> =
                    (0..count).map(|_| self.train[rng::below(random, self.train.len())]).collect();
                links.sort_unstable();
                let pixels = PixelSubset::Each(draw_rays(count, stages.value_count(), random));
                return build_batch(&links, data, stages, pixels, &mut shift);
            }
        };
        let mut transmitters = Vec::with_capacity(settings.batch);
        for k in 0..settings.batch as u64 {
            let drawn = (step - 1) * settings.batch as u64 + k;
            if self.epoch != drawn / n {
                self.epoch = drawn / n;
                self.order = (0..self.transmitters.len()).collect();
                rng::shuffle(&mut rng::stream(seed, "batches", self.epoch), &mut self.order);
            }
            transmitters.push(self.order[(drawn % n) as usize]);
        }
        build_batch(&self.links_of(&transmitters), data, stages, pixels, &mut shift)
    }

    /// Returns the training links of `transmitters`, indices into `self.transmitters`.
    fn links_of(&self, transmitters: &[usize]) -> Vec<usize> {
        transmitters.iter().flat_map(|&t| &self.train[self.transmitters[t].clone()]).copied().collect()
    }

    /// Returns the batches of a pass over some `transmitters`, without shifts: groups of at most [`AT_ONCE`], each with
    /// the stages that `stages_of` returns for the number of the group, from 0.
    ///
    /// # Errors
    /// A spectrum cannot be read.
    pub(crate) fn pass_batches(
        &self,
        transmitters: Vec<usize>,
        data: &Dataset,
        stages_of: impl Fn(u64) -> Stages,
    ) -> impl Iterator<Item = Result<(Stages, Batch)>> {
        let mut remaining = transmitters.into_iter().peekable();
        let mut groups = 0..;
        std::iter::from_fn(move || {
            remaining.peek()?;
            let group: Vec<usize> = remaining.by_ref().take(AT_ONCE).collect();
            let stages = stages_of(groups.next()?);
            let batch = build_batch(&self.links_of(&group), data, &stages, PixelSubset::All, &mut |x| x);
            Some(batch.map(|batch| (stages, batch)))
        })
    }
}

/// Draws `count` uniform indices below `value_count`, which may repeat.
fn draw_rays(count: usize, value_count: usize, random: &mut rng::Rng) -> Arc<[usize]> {
    (0..count).map(|_| rng::below(random, value_count)).collect()
}

/// Function from a coordinate of the moving end to its shifted coordinate, metres.
type Shift<'a> = &'a mut dyn FnMut(Real) -> Real;

/// Creates the batch of some links, grouped by location, with shifted positions of the moving end.
///
/// # Errors
/// A spectrum cannot be read.
fn build_batch(
    links: &[usize],
    data: &Dataset,
    stages: &Stages,
    pixels: PixelSubset,
    shift: Shift<'_>,
) -> Result<Batch> {
    let inputs = network_inputs(links, data, stages, matches!(pixels, PixelSubset::Each(_)), shift);
    let truths = read_truths(links, data, stages, &pixels);
    data.observations.check()?;
    Ok(Batch { inputs, pixels, truths })
}

/// Returns the network inputs of some links: features per link, or a shifted position that links of one location and
/// carrier share. A link out of ascending order begins another draw of its location, with another shift: a batch may
/// contain a transmitter twice. If `each` is true, links are single draws, which may repeat and share the shift.
fn network_inputs(links: &[usize], data: &Dataset, stages: &Stages, each: bool, shift: Shift<'_>) -> LinkInputs {
    let (mut inputs, mut last_link) = (LinkInputs::of(stages.method.traits().inputs, &stages.setup), None);
    let (carriers, mut last_carrier, mut pose) = (stages.carriers(), None, Pose::IDENTITY);
    for &i in links {
        let (query, location) = (data.query(i), data.links[i].location);
        let carrier = carriers.get(query.receiver);
        if let Some(features) = query.features {
            pose = stages.origin.local_pose(query.pose);
            inputs.values.extend_from_slice(features); // one per link
            inputs.carriers.extend(carrier);
        } else if last_link.is_none_or(|(l, j)| l != location || j >= i && !each) || carrier != last_carrier {
            pose = stages.origin.local_pose(query.pose);
            let (shifted, exact) = (pose.position_vec().to_array().map(&mut *shift), pose.position_vec().to_array());
            // Adds the shift alone: `exact` is rounded to [`Real`].
            (0..3).for_each(|k| pose.position[k] += (shifted[k] - exact[k]) as f64);
            inputs.values.extend(shifted);
            inputs.carriers.extend(carrier);
        }
        last_carrier = carrier;
        last_link = Some((location, i));
        inputs.add_link(&stages.setup, query.receiver, pose);
    }
    inputs
}

/// Reads the selected values of the observations of some links, `[L, values]`, on the image plane of `stages`.
/// Whole spectra of a stride above 1 are stretched if the method does so. `data.observations.check` reports failed reads.
fn read_truths(links: &[usize], data: &Dataset, stages: &Stages, pixels: &PixelSubset) -> Vec<Real> {
    let link_values = pixels.count_per_link(stages.value_count());
    let sampling = stages.plane.sampling;
    let stretches = sampling.stride > 1 && stages.method.traits().stretches;
    let mut truths = vec![0.0; links.len() * link_values];
    let by_link = truths.par_chunks_exact_mut(link_values).zip(links).enumerate();
    by_link.for_each(|(k, (truth, &i))| match (pixels, data.observations.spectra()) {
        (PixelSubset::Same(indices), Some(spectra)) => spectra.sampled_at(i, sampling, indices, truth),
        (PixelSubset::Each(indices), Some(spectra)) => {
            spectra.sampled_at(i, sampling, &indices[k..=k], truth);
        }
        _ => {
            data.observations.sampled(i, sampling, truth);
            if stretches {
                stretch(truth);
            }
        }
    });
    truths
}

/// Number of transmitters that a pass holds in memory at once.
const AT_ONCE: usize = 64;

/// Returns the image plane of `step`: every `stride`-th row and column of the whole image, from the first one or from a
/// random offset for this step.
pub(crate) fn plane_of_step(whole: &ImagePlane, plan: &TrainingPlan, task: Task, step: u64) -> ImagePlane {
    strided_plane(whole, plan, task, plan.training.moving_stride.then_some(("stride", step)))
}

/// Returns the image plane for part `part` of the pass at prune step `step`, with a random offset for this part: predictions
/// also use the pixels that the stride of training skips.
pub(crate) fn plane_of_pass(
    whole: &ImagePlane,
    plan: &TrainingPlan,
    task: Task,
    (step, part): (u64, u64),
) -> ImagePlane {
    // A pass has fewer than 2^24 parts.
    strided_plane(whole, plan, task, Some(("stride of a pass", step << 24 | part)))
}

/// Returns every `stride`-th row and column, from an offset drawn by the random stream of this name and number (without a
/// stream: from the first ones); all values if the data are not spectra.
fn strided_plane(whole: &ImagePlane, plan: &TrainingPlan, task: Task, stream: Option<(&str, u64)>) -> ImagePlane {
    let stride = task.stride(plan.training.stride);
    if stride == 1 {
        return whole.clone();
    }
    let offset = stream.map_or([0, 0], |(name, number)| {
        let random = &mut rng::stream(plan.seed, name, number);
        [(); 2].map(|()| rng::below(random, stride))
    });
    whole.strided(stride, offset)
}
