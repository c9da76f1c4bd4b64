//! `Batches`: which transmitters a step sees, and the pixels of their spectra that it compares.

use crate::Pipeline;
use crate::graph::Batch;
use pwrfgs_core::{Dataset, Elevation, Error, ImagePlane, Real, Result, rng};
use pwrfgs_model::Stages;
use rayon::prelude::*;

/// The training part: every sample once an epoch, in an order of its own each epoch.
#[derive(Debug)]
pub(crate) struct Batches {
    train: Vec<usize>,
    /// The epoch at hand and its order of samples.
    order: (u64, Vec<usize>),
}

impl Batches {
    /// Of the samples `train`.
    pub(crate) fn new(train: Vec<usize>) -> Self {
        Self { train, order: (u64::MAX, Vec::new()) }
    }

    /// The training part.
    pub(crate) fn train(&self) -> &[usize] {
        &self.train
    }

    /// The transmitters of `step`, each moved a little, and of their spectra the pixels that `stages` draw.
    ///
    /// # Errors
    /// Where a spectrum cannot be read.
    pub(crate) fn of_step(&mut self, step: u64, pipeline: &Pipeline, data: &Dataset, stages: &Stages) -> Result<Batch> {
        let settings = &pipeline.training;
        let (seed, n) = (pipeline.seed, self.train.len() as u64);
        let mut jitter = rng::stream(seed, "jitter", step);
        let mut batch = Batch { txs: Vec::new(), truths: Vec::new() };
        let mut samples = Vec::with_capacity(settings.batch);
        for k in 0..settings.batch as u64 {
            let drawn = (step - 1) * settings.batch as u64 + k;
            if self.order.0 != drawn / n {
                let mut order = self.train.clone();
                rng::shuffle(&mut rng::stream(seed, "batches", drawn / n), &mut order);
                self.order = (drawn / n, order);
            }
            let i = self.order.1[(drawn % n) as usize];
            let tx = data.scene.origin.local(data.samples[i].tx);
            batch.txs.push(tx.map(|x| x + settings.tx_jitter_m * rng::normal(&mut jitter)));
            samples.push(i);
        }
        let ImagePlane { width, height, .. } = stages.plane;
        let (pixels, stride) = (width * height, settings.stride);
        batch.truths.resize(samples.len() * pixels, 0.0);
        batch.truths.par_chunks_exact_mut(pixels).zip(&samples).for_each(|(truth, &i)| {
            data.spectra.coarse(i, stride, truth);
            if stride > 1 {
                stages.readout.restrict(truth);
            }
        });
        data.spectra.check()?;
        Ok(batch)
    }
}

/// The plane of every `stride`-th row and column of `plane`.
pub(crate) fn coarse(plane: &ImagePlane, pipeline: &Pipeline, elevation: Elevation) -> Result<ImagePlane> {
    let (width, height, stride) = (plane.width, plane.height, pipeline.training.stride);
    if stride == 1 {
        return Ok(plane.clone());
    }
    if !(width.is_multiple_of(stride) && height.is_multiple_of(stride)) {
        let fits: Vec<String> = (1..=width.min(height))
            .filter(|s| width.is_multiple_of(*s) && height.is_multiple_of(*s))
            .map(|s| s.to_string())
            .collect();
        return Err(Error::Config(format!(
            "training.stride {stride} does not divide the pictures' {width} columns and {height} rows; use one of {}",
            fits.join(", ")
        )));
    }
    let coarse = pipeline.projector.plane_of(width / stride, height / stride, elevation);
    let coarse = coarse.map_err(|why| Error::Config(format!("the projector {why}")))?;
    let (last_x, last_y) = ((coarse.width - 1) as Real, (coarse.height - 1) as Real);
    let corner = plane.direction(last_x * stride as Real, last_y * stride as Real);
    match (coarse.direction(last_x, last_y), corner) {
        (Some(a), Some(b)) if a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-4) => Ok(coarse),
        _ => Err(Error::Config(
            "training.stride needs a projector that keeps directions on a coarser picture; use projector: Mercator(), or \
             stride: 1"
                .into(),
        )),
    }
}
