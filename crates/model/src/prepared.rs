//! `Prepared`: models ready to predict, with everything worked out that no transmitter changes.

use crate::stages::Geometry;
use crate::{Model, Stages};
use pwrfgs_core::{Cache, Deltas, GaussianCloud, Image, ImagePlane, Predict, Real, StageTimes};
use rayon::prelude::*;
use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

/// One model, or an ensemble, made ready for many predictions.
///
/// Gaussians that no picture can show are left out ([`Stages::drawable`]). What follows from the others alone is
/// computed once: the network's share of it ([`Deformation::prepare`]), and,
/// where geometry does not depend on the transmitter, projection and whatever the rasterizer finds before it sees
/// signals. Every prediction has the bits of [`Model::predict`].
///
/// [`Deformation::prepare`]: pwrfgs_core::Deformation::prepare
#[derive(Debug)]
pub struct Prepared<'a> {
    members: Vec<Member<'a>>,
}

/// A model and what it has in hand.
#[derive(Debug)]
struct Member<'a> {
    model: &'a Model,
    /// The Gaussians that pictures can show.
    cloud: Cow<'a, GaussianCloud>,
    /// The network's.
    deformation: Cache,
    /// The geometry, where no transmitter changes it.
    still: Option<Arc<Geometry>>,
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

    /// The spectrum for a transmitter at `tx` (metres, world frame), and how long each stage took in all. Of one model
    /// it is not clamped; of several it is the mean, each clamped to [0, 1].
    pub fn predict_timed(&self, tx: [f64; 3]) -> (Image, StageTimes) {
        let (pictures, times) = self.pictures(tx);
        (mean(pictures), times)
    }

    /// The same, and the standard deviation of the members' pictures at every pixel (n in the denominator): a picture of
    /// confidence, 0 where there is one model alone.
    pub fn predict_with_deviation(&self, tx: [f64; 3]) -> (Image, Image, StageTimes) {
        let (pictures, times) = self.pictures(tx);
        let count = pictures.len() as Real;
        let clamped: Vec<Image> = pictures.iter().map(Image::clamped).collect();
        let mean = mean(pictures);
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
    fn pictures(&self, tx: [f64; 3]) -> (Vec<Image>, StageTimes) {
        let mut pictures = Vec::with_capacity(self.members.len());
        let mut sum = StageTimes::default();
        for member in &self.members {
            let (image, times) = member.predict(tx);
            pictures.push(image);
            sum.network += times.network;
            sum.projection += times.projection;
            sum.sort += times.sort;
            sum.blending += times.blending;
            sum.total += times.total;
        }
        (pictures, sum)
    }

    /// Spectra of many transmitters.
    pub fn predict_many(&self, txs: &[[f64; 3]]) -> Vec<Image> {
        let mut of_each: Vec<_> = self.members.iter().map(|m| m.predict_many(txs).into_iter()).collect();
        txs.iter().map(|_| mean(of_each.iter_mut().filter_map(Iterator::next).collect())).collect()
    }
}

impl Model {
    /// The spectrum for a transmitter at `tx` (metres, world frame), not clamped. For more than one, [`Self::prepare`].
    pub fn predict(&self, tx: [f64; 3]) -> Image {
        self.prepare().predict(tx)
    }

    /// The model with everything worked out that no transmitter changes.
    pub fn prepare(&self) -> Prepared<'_> {
        Prepared::new(std::slice::from_ref(self))
    }
}

impl Predict for Model {
    fn predict(&self, tx: [f64; 3]) -> Image {
        Self::predict(self, tx)
    }
}

impl Predict for Prepared<'_> {
    fn predict(&self, tx: [f64; 3]) -> Image {
        self.predict_timed(tx).0
    }
}

impl<'a> Member<'a> {
    fn new(model: &'a Model) -> Self {
        let stages = &model.stages;
        let rows = stages.drawable(&model.cloud, None);
        let all = rows.len() == model.cloud.len();
        let cloud = if all { Cow::Borrowed(&model.cloud) } else { Cow::Owned(model.cloud.select(&rows)) };
        let deformation = stages.deformation.prepare(&model.weights, &cloud.means, &stages.pose);
        let still = (!stages.deformation.varies_geometry())
            .then(|| Arc::new(stages.geometry(&cloud, &Deltas::default(), 0, None)));
        Self { model, cloud, deformation, still }
    }

    fn predict(&self, tx: [f64; 3]) -> (Image, StageTimes) {
        let start = Instant::now();
        let (image, times) = if self.cloud.len() < POOL { self.stages(tx) } else { rayon::scope(|_| self.stages(tx)) };
        (image, StageTimes { total: start.elapsed().as_secs_f64(), ..times })
    }

    /// Network, projection, blending, readout.
    fn stages(&self, tx: [f64; 3]) -> (Image, StageTimes) {
        let start = Instant::now();
        let deltas = self.deform(&[tx]);
        let network = start.elapsed().as_secs_f64();
        let (mut images, times) = self.draw(&deltas, 0..1);
        (images.remove(0), StageTimes { network, ..times })
    }

    /// A group of transmitters at a time: they share a projection, or at least the network's work, and each its thread.
    fn predict_many(&self, txs: &[[f64; 3]]) -> Vec<Image> {
        let group = |txs: &[[f64; 3]]| {
            let deltas = self.deform(txs);
            let draw = |batch: Range<usize>| self.draw(&deltas, batch).0;
            match self.still {
                Some(_) => draw(0..txs.len()),
                None => (0..txs.len()).into_par_iter().flat_map_iter(|b| draw(b..b + 1)).collect(),
            }
        };
        txs.chunks(GROUP).flat_map(group).collect()
    }

    fn deform(&self, txs: &[[f64; 3]]) -> Deltas {
        let Model { stages, weights, .. } = self.model;
        let txs: Vec<[Real; 3]> = txs.iter().map(|tx| stages.origin.local(*tx)).collect();
        stages.deformation.forward_prepared(weights, &self.cloud.means, &txs, &stages.pose, &self.deformation)
    }

    /// Pictures of the transmitters `batch` of `deltas`, which share the geometry of the first.
    fn draw(&self, deltas: &Deltas, batch: Range<usize>) -> (Vec<Image>, StageTimes) {
        let start = Instant::now();
        let Stages { readout, plane, .. } = &self.model.stages;
        let drawing = self.model.stages.draw(&self.cloud, deltas, batch, None, self.still.as_ref());
        let pixels = plane.width * plane.height;
        let image = |pixels| Image { width: plane.width, height: plane.height, pixels };
        let grey = readout.forward(&drawing.render.pixels, pixels);
        let images = match grey.len() / pixels.max(1) {
            1 => vec![image(grey)], // moved, not copied
            _ => grey.chunks_exact(pixels).map(|p| image(p.to_vec())).collect(),
        };
        let [projection, sort] = if self.still.is_some() { [0.0; 2] } else { drawing.geometry.seconds };
        let blending = start.elapsed().as_secs_f64() - projection - sort;
        (images, StageTimes { projection, sort, blending, ..StageTimes::default() })
    }
}

/// One picture as it is, or the mean of several, each clamped to [0, 1].
fn mean(pictures: Vec<Image>) -> Image {
    let share = 1.0 / pictures.len() as Real;
    let mut pictures = pictures.into_iter();
    let mut mean = pictures.next().expect("a model or more");
    if share == 1.0 {
        return mean;
    }
    let sum = mean.pixels.as_mut_slice();
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
