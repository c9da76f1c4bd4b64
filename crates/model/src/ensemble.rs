//! `Ensemble`: several models of one scene that predict together, and how far they differ.

use crate::Model;
use pwrfgs_core::{Image, ImagePlane, Predict, Real, StageTimes};

/// What can be scored like a model: one [`Model`], or an [`Ensemble`] of them.
pub trait Predictor: Predict {
    /// The models that take part.
    fn members(&self) -> &[Model];

    /// The spectrum for a transmitter at `tx` (metres, world frame), and how long each stage took in all.
    fn predict_timed(&self, tx: [Real; 3]) -> (Image, StageTimes);

    /// Spectra of many transmitters.
    fn predict_many(&self, txs: &[[Real; 3]]) -> Vec<Image>;

    /// The picture's grid.
    fn plane(&self) -> &ImagePlane {
        &self.members()[0].stages.plane
    }
}

impl Predictor for Model {
    fn members(&self) -> &[Model] {
        std::slice::from_ref(self)
    }

    fn predict_timed(&self, tx: [Real; 3]) -> (Image, StageTimes) {
        Self::predict_timed(self, tx)
    }

    fn predict_many(&self, txs: &[[Real; 3]]) -> Vec<Image> {
        Self::predict_many(self, txs)
    }
}

/// Models of one scene, such as runs that differ in their seed. Its picture is the mean of theirs, each clamped to
/// [0, 1]; where they disagree, nobody should trust it: see [`Ensemble::spread`].
#[derive(Clone, Debug)]
pub struct Ensemble {
    members: Vec<Model>,
}

impl Ensemble {
    /// Of one model or more, on one grid of pixels.
    ///
    /// # Errors
    /// What does not fit together.
    pub fn new(members: Vec<Model>) -> Result<Self, String> {
        let Some(first) = members.first() else { return Err("an ensemble needs a model".into()) };
        let stages = &first.stages;
        match members.iter().position(|m| m.stages.plane != stages.plane || m.stages.pose != stages.pose) {
            Some(other) => Err(format!(
                "model {} of the ensemble sees other pixels than the first, or from another receiver; take runs on the \
                 same data with the same projector",
                other + 1
            )),
            None => Ok(Self { members }),
        }
    }

    /// The standard deviation of the members' pictures at every pixel (n in the denominator): a picture of confidence.
    pub fn spread(&self, tx: [Real; 3]) -> Image {
        let pictures: Vec<Image> = self.members.iter().map(|m| m.predict(tx).clamped()).collect();
        let mean = mean(&pictures);
        let mut spread = Image::zeros(mean.width, mean.height);
        for picture in &pictures {
            let deviations = picture.pixels.iter().zip(&mean.pixels).map(|(p, m)| (p - m) * (p - m));
            spread.pixels.iter_mut().zip(deviations).for_each(|(sum, d)| *sum += d);
        }
        let count = pictures.len() as Real;
        spread.pixels.iter_mut().for_each(|sum| *sum = (*sum / count).sqrt());
        spread
    }
}

impl Predict for Ensemble {
    fn predict(&self, tx: [Real; 3]) -> Image {
        Predictor::predict_timed(self, tx).0
    }
}

impl Predictor for Ensemble {
    fn members(&self) -> &[Model] {
        &self.members
    }

    fn predict_timed(&self, tx: [Real; 3]) -> (Image, StageTimes) {
        let mut pictures = Vec::with_capacity(self.members.len());
        let mut sum = StageTimes::default();
        for member in &self.members {
            let (image, times) = member.predict_timed(tx);
            pictures.push(image.clamped());
            sum.network += times.network;
            sum.projection += times.projection;
            sum.sort += times.sort;
            sum.blending += times.blending;
            sum.total += times.total;
        }
        (mean(&pictures), sum)
    }

    fn predict_many(&self, txs: &[[Real; 3]]) -> Vec<Image> {
        let of_each: Vec<Vec<Image>> = self.members.iter().map(|m| m.predict_many(txs)).collect();
        let of = |i: usize| of_each.iter().map(|pictures| pictures[i].clamped()).collect::<Vec<_>>();
        (0..txs.len()).map(|i| mean(&of(i))).collect()
    }
}

/// The mean of pictures of one size, of which there is at least one.
fn mean(pictures: &[Image]) -> Image {
    let mut mean = pictures[0].clone();
    for picture in &pictures[1..] {
        mean.pixels.iter_mut().zip(&picture.pixels).for_each(|(sum, p)| *sum += p);
    }
    let count = pictures.len() as Real;
    mean.pixels.iter_mut().for_each(|sum| *sum /= count);
    mean
}
