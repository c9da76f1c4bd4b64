//! `Prepared`: models ready to predict, with all transmitter-independent values precomputed.

mod derivative;

use crate::{Model, Residuals, Stages};
use pwrfgs_core::{
    Cache, Call, End, GaussianCloud, Image, ImagePlane, MeasurementSetup, Parameters, PixelSubset, Predict, Query,
    Real, Receiver, StageTimes, Task,
};
use rayon::prelude::*;
use std::borrow::Cow;
use std::time::Instant;

/// Model or ensemble prepared for many predictions.
///
/// Gaussians that cannot affect an observation are left out ([`Stages::drawable`](crate::Stages::drawable)).
/// Transmitter-independent values of the others are computed once ([`Method::prepare`]): part of the network and, if
/// geometry does not depend on the transmitter, projection and the signal-independent part of the rasterizer. Every
/// prediction is bit-identical to [`Model::predict`].
///
/// [`Method::prepare`]: pwrfgs_core::Method::prepare
#[derive(Debug)]
pub struct Prepared<'a> {
    members: Vec<Member<'a>>,
    residuals: Option<&'a Residuals>,
}

/// Model with its precomputed values.
#[derive(Debug)]
struct Member<'a> {
    model: &'a Model,
    /// Gaussians that can affect observations.
    cloud: Cow<'a, GaussianCloud>,
    /// Precomputed values of the method.
    ready: Cache,
    /// Time of the preparation, seconds.
    seconds: f64,
}

/// Number of transmitters per call of the network in [`Prepared::predict_many`], and per projection if geometry is
/// shared: large enough for cheap blending, small enough that the images of a group fit the cache. The Python package has
/// the same number.
const GROUP: usize = 16;

/// Number of Gaussians from which a prediction enters the thread pool once instead of stage by stage. With fewer, most
/// of the work runs on the calling thread, which would only wait for the pool.
const POOL: usize = 128;

impl<'a> Prepared<'a> {
    /// Prepares one or more models with one pixel grid.
    pub(crate) fn new(models: &'a [Model], residuals: Option<&'a Residuals>) -> Self {
        Self { members: models.iter().map(Member::new).collect(), residuals }
    }

    /// Returns the models.
    pub fn models(&self) -> impl Iterator<Item = &'a Model> {
        self.members.iter().map(|member| member.model)
    }

    /// Returns the measurement setup, which all models share.
    pub fn setup(&self) -> &'a MeasurementSetup {
        &self.members[0].model.stages.setup
    }

    /// Returns the image plane.
    pub fn plane(&self) -> &'a ImagePlane {
        &self.setup().plane
    }

    /// Returns the type of the observations.
    pub fn task(&self) -> Task {
        self.setup().task
    }

    /// Returns the receivers, in the order of [`Query::receiver`].
    pub fn receivers(&self) -> &'a [Receiver] {
        &self.setup().receivers
    }

    /// Returns the end that moves.
    pub fn moving(&self) -> End {
        self.setup().moving
    }

    /// Predicts the observation of a link, such as the spectrum for a transmitter position (metres, world frame) at the
    /// only receiver. Also returns the total time of each stage. The prediction of one model is not clamped; that of
    /// several is the mean, with each spectrum clamped to [0, 1]. Residual processes clamp spectra too, and then add
    /// the expected residual.
    pub fn predict_timed<'q>(&self, query: impl Into<Query<'q>>) -> (Image, StageTimes) {
        let (begun, query) = (Instant::now(), query.into());
        let (predictions, times) = self.member_predictions(query);
        let mean = self.corrected(mean_prediction(predictions, self.task()), query);
        let total = if self.residuals.is_some() { begun.elapsed().as_secs_f64() } else { times.total };
        (mean, StageTimes { total, ..times })
    }

    /// Predicts an observation and the standard deviation over the members for every value (n in the denominator); 0
    /// for a single model. The deviation is that of the members, without residual processes. Also returns the total time
    /// of each stage, without that of residual processes.
    pub fn predict_with_deviation<'q>(&self, query: impl Into<Query<'q>>) -> (Image, Image, StageTimes) {
        let query = query.into();
        let (predictions, times) = self.member_predictions(query);
        let (mean, deviation) = mean_and_deviation(predictions, self.task());
        (self.corrected(mean, query), deviation, times)
    }

    /// Runs [`Self::predict_with_deviation`] for many links, without times; it is fastest if links of one transmitter are
    /// adjacent.
    pub fn predict_many_with_deviation(&self, queries: &[Query<'_>]) -> Vec<(Image, Image)> {
        let correct = |(predictions, query): (Vec<Image>, &Query<'_>)| {
            let (mean, deviation) = mean_and_deviation(predictions, self.task());
            (self.corrected(mean, *query), deviation)
        };
        self.predictions_of_many(queries).into_par_iter().zip(queries).map(correct).collect()
    }

    /// Returns the prediction corrected by the residual processes, which first clamps spectra to [0, 1]; unchanged
    /// without these.
    fn corrected(&self, mean: Image, query: Query<'_>) -> Image {
        let Some(residuals) = self.residuals else { return mean };
        let mut image = self.task().shown(mean);
        residuals.correct(&mut image, query, self.setup().origin);
        image
    }

    /// Returns the predictions of all members, not clamped, and the total time of each stage.
    fn member_predictions(&self, query: Query<'_>) -> (Vec<Image>, StageTimes) {
        let mut predictions = Vec::with_capacity(self.members.len());
        let mut sum = StageTimes::default();
        for member in &self.members {
            let (image, times) = member.predict(query);
            predictions.push(image);
            sum.network += times.network;
            sum.projection += times.projection;
            sum.sort += times.sort;
            sum.blending += times.blending;
            sum.total += times.total;
            sum.prepare += times.prepare;
        }
        (predictions, sum)
    }

    /// Predicts many links; it is fastest if links of one transmitter are adjacent.
    pub fn predict_many(&self, queries: &[Query<'_>]) -> Vec<Image> {
        let correct =
            |(images, query): (Vec<Image>, &Query<'_>)| self.corrected(mean_prediction(images, self.task()), *query);
        self.predictions_of_many(queries).into_par_iter().zip(queries).map(correct).collect()
    }

    /// Returns the predictions of all members for each link, not clamped.
    fn predictions_of_many(&self, queries: &[Query<'_>]) -> Vec<Vec<Image>> {
        let mut by_member: Vec<_> = self.members.iter().map(|m| m.predict_many(queries).into_iter()).collect();
        queries.iter().map(|_| by_member.iter_mut().filter_map(Iterator::next).collect()).collect()
    }

    /// Predicts as [`Self::predict_many`] and writes the observations into `numbers`, one after the other.
    ///
    /// # Panics
    /// If the length of `numbers` is not that of the observations.
    pub fn predict_into(&self, queries: &[Query<'_>], numbers: &mut [Real]) {
        let link_values = self.setup().value_count();
        assert_eq!(numbers.len(), queries.len() * link_values, "numbers of {} observations", queries.len());
        for (group, numbers) in queries.chunks(GROUP).zip(numbers.chunks_mut(GROUP * link_values)) {
            if let ([member], None) = (self.members.as_slice(), self.residuals) {
                let (predictions, _) = member.predict_values(group);
                // If `numbers` is new memory, its first access takes longer than the copy.
                let copy = |(to, from): (&mut [Real], &[Real])| to.copy_from_slice(from);
                numbers.par_chunks_mut(link_values).zip(predictions.par_chunks(link_values)).for_each(copy);
                continue;
            }
            for (image, numbers) in self.predict_many(group).iter().zip(numbers.chunks_exact_mut(link_values)) {
                numbers.copy_from_slice(&image.pixels);
            }
        }
    }
}

impl Model {
    /// Predicts the observation of a link, not clamped. Use [`Self::prepare`] for several predictions.
    pub fn predict<'q>(&self, query: impl Into<Query<'q>>) -> Image {
        self.prepare().predict_timed(query).0
    }

    /// Precomputes all transmitter-independent values.
    pub fn prepare(&self) -> Prepared<'_> {
        Prepared::new(std::slice::from_ref(self), None)
    }
}

impl Predict for Model {
    fn predict(&self, query: Query<'_>) -> Image {
        Self::predict(self, query)
    }

    fn predict_vjp(&self, query: Query<'_>, cotangent: &dyn Fn(&Image) -> Vec<Real>) -> Option<(Image, [f64; 3])> {
        Predict::predict_vjp(&self.prepare(), query, cotangent)
    }
}

impl Predict for Prepared<'_> {
    fn predict(&self, query: Query<'_>) -> Image {
        self.predict_timed(query).0
    }

    fn predict_many(&self, queries: &[Query<'_>]) -> Vec<Image> {
        Prepared::predict_many(self, queries)
    }

    fn predict_vjp(&self, query: Query<'_>, cotangent: &dyn Fn(&Image) -> Vec<Real>) -> Option<(Image, [f64; 3])> {
        Prepared::predict_vjp(self, query, cotangent).map(|(image, d_tx, _)| (image, d_tx))
    }

    /// Returns the deviation of the residual process; `None` without residual processes.
    fn deviation(&self, query: Query<'_>) -> Option<f64> {
        self.residuals.map(|residuals| residuals.deviation(query, self.setup().origin))
    }
}

impl<'a> Member<'a> {
    /// Selects the Gaussians that can affect observations, and precomputes transmitter-independent values.
    fn new(model: &'a Model) -> Self {
        let start = Instant::now();
        let stages = &model.stages;
        let rows = stages.drawable(&model.cloud, None);
        let is_whole = rows.len() == model.cloud.len();
        let cloud = if is_whole { Cow::Borrowed(&model.cloud) } else { Cow::Owned(model.cloud.select(&rows)) };
        let parameters = Parameters { cloud: &cloud, gate: None, existence: None, weights: &model.weights };
        let ready = stages.method.prepare(&stages.setup, &parameters);
        Self { model, cloud, ready, seconds: start.elapsed().as_secs_f64() }
    }

    /// Predicts one link, not clamped, with the time of each stage.
    fn predict(&self, query: Query<'_>) -> (Image, StageTimes) {
        let start = Instant::now();
        let (mut images, times) = self.run_in_pool(|| self.predict_group(&[query]));
        (images.remove(0), StageTimes { total: start.elapsed().as_secs_f64(), prepare: self.seconds, ..times })
    }

    /// Runs a prediction in the thread pool if there are at least [`POOL`] Gaussians, otherwise on this thread.
    fn run_in_pool<T: Send>(&self, run: impl FnOnce() -> T + Send) -> T {
        if self.cloud.len() < POOL { run() } else { rayon::scope(|_| run()) }
    }

    /// Predicts one group of links at a time: they share a projection, or at least the network, and each uses one
    /// thread.
    fn predict_many(&self, queries: &[Query<'_>]) -> Vec<Image> {
        queries.chunks(GROUP).flat_map(|group| self.predict_group(group).0).collect()
    }

    /// Predicts the links of one call, one observation each.
    fn predict_group(&self, queries: &[Query<'_>]) -> (Vec<Image>, StageTimes) {
        let ImagePlane { width, height, .. } = self.model.stages.plane;
        let (numbers, times) = self.predict_values(queries);
        let image = |pixels| Image { width, height, pixels };
        let images = if queries.len() == 1 {
            vec![image(numbers)] // moved, not copied
        } else {
            numbers.chunks_exact(width * height).map(|p| image(p.to_vec())).collect()
        };
        (images, times)
    }

    /// Predicts the values of the links of one call, as contiguous observations.
    fn predict_values(&self, queries: &[Query<'_>]) -> (Vec<Real>, StageTimes) {
        let stages = &self.model.stages;
        self.run_call(queries, |call| stages.method.predict(call, &self.ready))
    }

    /// Calls `run` with the parameters and some links.
    fn run_call<T>(&self, queries: &[Query<'_>], run: impl FnOnce(&Call<'_>) -> T) -> T {
        let Model { stages: Stages { method, setup }, weights, .. } = self.model;
        let links = &setup.inputs(method.traits().inputs, queries.iter().copied());
        let parameters = Parameters { cloud: &self.cloud, gate: None, existence: None, weights };
        run(&Call { setup, parameters, links, pixels: &PixelSubset::All })
    }
}

/// Returns the mean of the observations as [`mean_prediction`], and their standard deviation for every value; 0 for one.
fn mean_and_deviation(predictions: Vec<Image>, task: Task) -> (Image, Image) {
    let count = predictions.len() as Real;
    let clamped: Vec<Image> = predictions.iter().map(|prediction| task.shown(prediction.clone())).collect();
    let mean = mean_prediction(predictions, task);
    let mut deviation = Image::zeros(mean.width, mean.height);
    if clamped.len() > 1 {
        for prediction in &clamped {
            let squares = prediction.pixels.iter().zip(&mean.pixels).map(|(p, m)| (p - m) * (p - m));
            deviation.pixels.iter_mut().zip(squares).for_each(|(sum, square)| *sum += square);
        }
        deviation.pixels.iter_mut().for_each(|sum| *sum = (*sum / count).sqrt());
    }
    (mean, deviation)
}

/// Returns a single observation unchanged, or the mean of several; spectra are each clamped to [0, 1].
fn mean_prediction(predictions: Vec<Image>, task: Task) -> Image {
    let share = 1.0 / predictions.len() as Real;
    let mut predictions = predictions.into_iter();
    let mut mean = predictions.next().expect("a model or more");
    if share == 1.0 {
        return mean;
    }
    let sum = mean.pixels.as_mut_slice();
    if !task.has_pixels {
        sum.iter_mut().for_each(|v| *v *= share);
        for prediction in predictions {
            sum.iter_mut().zip(&prediction.pixels).for_each(|(sum, v)| *sum += v * share);
        }
        return mean;
    }
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || {
            sum.iter_mut().for_each(|p| *p = p.clamp(0.0, 1.0) * share);
            for prediction in predictions {
                sum.iter_mut().zip(&prediction.pixels).for_each(|(sum, p)| *sum += p.clamp(0.0, 1.0) * share);
            }
        },
    );
    mean
}
