//! `Prepared`: models ready to predict, with everything worked out that no transmitter changes.

use crate::Model;
use pwrfgs_core::{
    Asked, Cache, Conditions, GaussianCloud, Image, ImagePlane, Parameters, Pixels, Predict, Query, Real, Receiver,
    StageTimes, Task,
};
use rayon::prelude::*;
use std::borrow::Cow;
use std::time::Instant;

/// One model, or an ensemble, made ready for many predictions.
///
/// Gaussians that no observation can show are left out ([`Stages::drawable`](crate::Stages::drawable)). What follows from the
/// others alone is computed once ([`Method::prepare`]): the network's share of it, and, where geometry does not depend on the transmitter,
/// projection and whatever the rasterizer finds before it sees signals. Every prediction has the bits of
/// [`Model::predict`].
///
/// [`Method::prepare`]: pwrfgs_core::Method::prepare
#[derive(Debug)]
pub struct Prepared<'a> {
    members: Vec<Member<'a>>,
}

/// A model and what it has in hand.
#[derive(Debug)]
struct Member<'a> {
    model: &'a Model,
    /// The Gaussians that observations can show.
    cloud: Cow<'a, GaussianCloud>,
    /// What the method worked out once.
    ready: Cache,
    /// How long that took.
    seconds: f64,
}

/// Transmitters of one call of the network in [`Prepared::predict_many`], and of one projection where geometry stays:
/// enough to make blending cheap, few enough that the pictures of a group stay in cache.
const GROUP: usize = 16;

/// Gaussians from which on a prediction enters the thread pool once, and not stage by stage. With fewer, most of the work
/// is done on the calling thread, which would only wait for the pool to wake.
const POOL: usize = 128;

impl<'a> Prepared<'a> {
    /// Of one model or more on one grid of pixels.
    pub(crate) fn new(models: &'a [Model]) -> Self {
        Self { members: models.iter().map(Member::new).collect() }
    }

    /// The models that take part.
    pub fn models(&self) -> impl Iterator<Item = &'a Model> {
        self.members.iter().map(|member| member.model)
    }

    /// The picture's grid.
    pub fn plane(&self) -> &'a ImagePlane {
        &self.members[0].model.stages.plane
    }

    /// What is observed.
    pub fn task(&self) -> Task {
        self.members[0].model.stages.task
    }

    /// The receivers that it knows, in the order of [`Query::receiver`].
    pub fn receivers(&self) -> &'a [Receiver] {
        &self.members[0].model.stages.frame.receivers
    }

    /// The subcarriers of its channels, Hz; empty for anything else.
    pub fn frequencies(&self) -> &'a [f64] {
        &self.members[0].model.stages.frame.frequencies_hz
    }

    /// What is observed of a link, such as the spectrum for a transmitter at a place (metres, world frame) at the only
    /// receiver, and how long each stage took in all. Of one model it is not clamped; of several it is the mean, spectra each
    /// clamped to [0, 1].
    pub fn predict_timed<'q>(&self, query: impl Into<Query<'q>>) -> (Image, StageTimes) {
        let (pictures, times) = self.pictures(query.into());
        (mean(pictures, self.task()), times)
    }

    /// The same, and the standard deviation of the members' pictures at every pixel (n in the denominator): a picture of
    /// confidence, 0 where there is one model alone.
    pub fn predict_with_deviation<'q>(&self, query: impl Into<Query<'q>>) -> (Image, Image, StageTimes) {
        let (pictures, times) = self.pictures(query.into());
        let count = pictures.len() as Real;
        let clamped: Vec<Image> = pictures.iter().map(|own| self.task().shown(own.clone())).collect();
        let mean = mean(pictures, self.task());
        let mut deviation = Image::zeros(mean.width, mean.height);
        if clamped.len() > 1 {
            for picture in &clamped {
                let squares = picture.pixels.iter().zip(&mean.pixels).map(|(p, m)| (p - m) * (p - m));
                deviation.pixels.iter_mut().zip(squares).for_each(|(sum, square)| *sum += square);
            }
            deviation.pixels.iter_mut().for_each(|sum| *sum = (*sum / count).sqrt());
        }
        (mean, deviation, times)
    }

    /// What each member draws, not clamped, and how long each stage took in all.
    fn pictures(&self, query: Query<'_>) -> (Vec<Image>, StageTimes) {
        let mut pictures = Vec::with_capacity(self.members.len());
        let mut sum = StageTimes::default();
        for member in &self.members {
            let (image, times) = member.predict(query);
            pictures.push(image);
            sum.network += times.network;
            sum.projection += times.projection;
            sum.sort += times.sort;
            sum.blending += times.blending;
            sum.total += times.total;
            sum.prepare += times.prepare;
        }
        (pictures, sum)
    }

    /// Observations of many links; those of a transmitter next to each other are cheapest.
    pub fn predict_many(&self, queries: &[Query<'_>]) -> Vec<Image> {
        let mut of_each: Vec<_> = self.members.iter().map(|m| m.predict_many(queries).into_iter()).collect();
        let of_all = |_| mean(of_each.iter_mut().filter_map(Iterator::next).collect(), self.task());
        queries.iter().map(of_all).collect()
    }

    /// [`Self::predict_many`] into `numbers`, one observation after the other, with nothing in between.
    ///
    /// # Panics
    /// If `numbers` has not as many as the observations.
    pub fn predict_into(&self, queries: &[Query<'_>], numbers: &mut [Real]) {
        let of_each = self.plane().width * self.plane().height;
        assert_eq!(numbers.len(), queries.len() * of_each, "numbers of {} observations", queries.len());
        for (group, numbers) in queries.chunks(GROUP).zip(numbers.chunks_mut(GROUP * of_each)) {
            if let [member] = self.members.as_slice() {
                let (found, _) = member.numbers(group);
                // Where `numbers` are new memory, its first touch takes longer than the copy.
                let copy = |(to, from): (&mut [Real], &[Real])| to.copy_from_slice(from);
                numbers.par_chunks_mut(of_each).zip(found.par_chunks(of_each)).for_each(copy);
                continue;
            }
            for (image, numbers) in self.predict_many(group).iter().zip(numbers.chunks_exact_mut(of_each)) {
                numbers.copy_from_slice(&image.pixels);
            }
        }
    }
}

impl Model {
    /// The spectrum for a transmitter at `tx` (metres, world frame), not clamped. For more than one, [`Self::prepare`].
    pub fn predict<'q>(&self, query: impl Into<Query<'q>>) -> Image {
        self.prepare().predict_timed(query).0
    }

    /// The model with everything worked out that no transmitter changes.
    pub fn prepare(&self) -> Prepared<'_> {
        Prepared::new(std::slice::from_ref(self))
    }
}

impl Predict for Model {
    fn predict(&self, query: Query<'_>) -> Image {
        Self::predict(self, query)
    }
}

impl Predict for Prepared<'_> {
    fn predict(&self, query: Query<'_>) -> Image {
        self.predict_timed(query).0
    }
}

impl<'a> Member<'a> {
    fn new(model: &'a Model) -> Self {
        let start = Instant::now();
        let stages = &model.stages;
        let rows = stages.drawable(&model.cloud, None);
        let all = rows.len() == model.cloud.len();
        let cloud = if all { Cow::Borrowed(&model.cloud) } else { Cow::Owned(model.cloud.select(&rows)) };
        let parameters = Parameters { cloud: &cloud, gate: None, presence: None, weights: &model.weights };
        let ready = stages.method.prepare(&stages.frame, &parameters);
        Self { model, cloud, ready, seconds: start.elapsed().as_secs_f64() }
    }

    fn predict(&self, query: Query<'_>) -> (Image, StageTimes) {
        let start = Instant::now();
        let one = || self.observations(&[query]);
        let (mut images, times) = if self.cloud.len() < POOL { one() } else { rayon::scope(|_| one()) };
        (images.remove(0), StageTimes { total: start.elapsed().as_secs_f64(), prepare: self.seconds, ..times })
    }

    /// A group of links at a time: they share a projection, or at least the network's work, and each its thread.
    fn predict_many(&self, queries: &[Query<'_>]) -> Vec<Image> {
        queries.chunks(GROUP).flat_map(|group| self.observations(group).0).collect()
    }

    /// Links of one call, an observation each.
    fn observations(&self, queries: &[Query<'_>]) -> (Vec<Image>, StageTimes) {
        let ImagePlane { width, height, .. } = self.model.stages.plane;
        let (numbers, times) = self.numbers(queries);
        let image = |pixels| Image { width, height, pixels };
        let images = if queries.len() == 1 {
            vec![image(numbers)] // moved, not copied
        } else {
            numbers.chunks_exact(width * height).map(|p| image(p.to_vec())).collect()
        };
        (images, times)
    }

    /// The numbers of links of one call, one observation after the other.
    fn numbers(&self, queries: &[Query<'_>]) -> (Vec<Real>, StageTimes) {
        let Model { stages, weights, .. } = self.model;
        let inputs = stages.method.traits().inputs;
        let (conditions, links) = stages.frame.conditions(inputs, queries.iter().copied());
        let asked = Asked { conditions: Conditions::new(inputs, &conditions), links: &links, pixels: Pixels::All };
        let parameters = Parameters { cloud: &self.cloud, gate: None, presence: None, weights };
        stages.method.predict(&stages.frame, &parameters, &asked, &self.ready)
    }
}

/// One observation as it is, or the mean of several; pictures each clamped to [0, 1].
fn mean(pictures: Vec<Image>, task: Task) -> Image {
    let share = 1.0 / pictures.len() as Real;
    let mut pictures = pictures.into_iter();
    let mut mean = pictures.next().expect("a model or more");
    if share == 1.0 {
        return mean;
    }
    let sum = mean.pixels.as_mut_slice();
    if !task.has_pixels {
        sum.iter_mut().for_each(|v| *v *= share);
        for other in pictures {
            sum.iter_mut().zip(&other.pixels).for_each(|(sum, v)| *sum += v * share);
        }
        return mean;
    }
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || {
            sum.iter_mut().for_each(|p| *p = p.clamp(0.0, 1.0) * share);
            for picture in pictures {
                sum.iter_mut().zip(&picture.pixels).for_each(|(sum, p)| *sum += p.clamp(0.0, 1.0) * share);
            }
        },
    );
    mean
}
