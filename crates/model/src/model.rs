//! `Model`: what is saved and predicts.

use crate::{Activation, Calibration, Readout};
use pwrfgs_core::plugin::Plugin;
use pwrfgs_core::{
    Deformation, Deltas, GaussianCloud, Image, ImagePlane, Pose, Predict, Primitives, Projector, Rasterizer, Real,
    StageTimes,
};
use std::time::Instant;

/// Everything between a cloud and a picture.
#[derive(Clone, Debug)]
pub struct Stages {
    /// What the transmitter changes.
    pub deformation: Plugin<dyn Deformation>,
    /// From space to the picture.
    pub projector: Plugin<dyn Projector>,
    /// From splats to pixels.
    pub rasterizer: Plugin<dyn Rasterizer>,
    /// How calibration terms meet the base parameters.
    pub calibration: Calibration,
    /// From blended signals to grey values.
    pub readout: Readout,
    /// The receiver.
    pub pose: Pose,
    /// The picture.
    pub plane: ImagePlane,
}

impl Stages {
    /// How a cloud is activated here.
    pub fn activation(&self) -> Activation {
        Activation {
            calibration: self.calibration,
            replaces_signals: self.deformation.replaces_signals(),
            channels: self.readout.channels(),
        }
    }
}

/// A trained model: predicts, and needs nothing else to do so.
#[derive(Clone, Debug)]
pub struct Model {
    /// The path from cloud to picture.
    pub stages: Stages,
    /// The Gaussians; no extra columns.
    pub cloud: GaussianCloud,
    /// Θ, as long as the deformation's layout says.
    pub weights: Vec<Real>,
}

/// Transmitters that share one projection in [`Model::predict_many`]: enough to make blending cheap, few enough that
/// the pictures of a group stay in cache.
const GROUP: usize = 16;

impl Model {
    /// The spectrum for a transmitter at `tx` (metres, world frame), not clamped.
    pub fn predict(&self, tx: [Real; 3]) -> Image {
        self.predict_timed(tx).0
    }

    /// The same, and how long each stage took.
    pub fn predict_timed(&self, tx: [Real; 3]) -> (Image, StageTimes) {
        let start = Instant::now();
        let deltas = self.deform(&[tx]);
        let deformed = Instant::now();
        let (mut images, mut times) = self.draw(&deltas, 0..1, deformed);
        times.network = (deformed - start).as_secs_f64();
        times.total = start.elapsed().as_secs_f64();
        (images.remove(0), times)
    }

    /// Spectra of many transmitters; where geometry does not depend on the transmitter, groups share one projection.
    pub fn predict_many(&self, txs: &[[Real; 3]]) -> Vec<Image> {
        let group = if self.stages.deformation.varies_geometry() { 1 } else { GROUP };
        let mut images = Vec::with_capacity(txs.len());
        for txs in txs.chunks(group) {
            images.extend(self.draw(&self.deform(txs), 0..txs.len(), Instant::now()).0);
        }
        images
    }

    /// What is drawn for a transmitter at `tx`, or of the base parameters alone: the Gaussians in space, and their
    /// signals `[N, channels]`.
    pub fn gaussians(&self, tx: Option<[Real; 3]>) -> (Primitives, Vec<Real>) {
        let deltas = tx.map_or_else(Deltas::default, |tx| self.deform(&[tx]));
        let activation = self.stages.activation();
        (activation.geometry(&self.cloud, &deltas, 0, None), activation.signals(&self.cloud, &deltas, 0..1))
    }

    fn deform(&self, txs: &[[Real; 3]]) -> Deltas {
        self.stages.deformation.forward(&self.weights, &self.cloud.means, txs, &self.stages.pose)
    }

    /// Pictures of the transmitters `batch` of `deltas`, which share the geometry of the first.
    fn draw(&self, deltas: &Deltas, batch: std::ops::Range<usize>, start: Instant) -> (Vec<Image>, StageTimes) {
        let Stages { projector, rasterizer, readout, pose, plane, .. } = &self.stages;
        let activation = self.stages.activation();
        let geometry = activation.geometry(&self.cloud, deltas, batch.start, None);
        let splats = projector.project(&geometry, pose, plane);
        let channels = activation.channels * batch.len();
        let signals = activation.signals(&self.cloud, deltas, batch);
        let projected = Instant::now();
        let render = rasterizer.forward(&splats, &signals, channels, plane);
        let pixels = plane.width * plane.height;
        let image = |pixels| Image { width: plane.width, height: plane.height, pixels };
        let grey = readout.forward(&render.pixels, pixels);
        let images = match grey.len() / pixels.max(1) {
            1 => vec![image(grey)], // moved, not copied
            _ => grey.chunks_exact(pixels).map(|p| image(p.to_vec())).collect(),
        };
        let times = StageTimes {
            network: 0.0,
            projection: (projected - start).as_secs_f64(),
            sort: render.sort_seconds,
            blending: projected.elapsed().as_secs_f64() - render.sort_seconds,
            total: start.elapsed().as_secs_f64(),
        };
        (images, times)
    }

    /// Bytes of the Gaussians in the model file: 13 numbers each.
    pub fn gaussian_bytes(&self) -> usize {
        self.cloud.columns().map(|(_, _, values)| size_of_val(values)).sum()
    }

    /// Bytes of the network in the model file.
    pub fn network_bytes(&self) -> usize {
        size_of_val(self.weights.as_slice())
    }
}

impl Predict for Model {
    fn predict(&self, tx: [Real; 3]) -> Image {
        Self::predict(self, tx)
    }
}
