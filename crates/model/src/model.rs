//! `Model`: the saved state that predicts. `Stages`: a method and its frame, which map parameters to observations.

use crate::TrainingPositions;
use pwrfgs_core::plugin::Plugin;
use pwrfgs_core::{
    Activated, Dataset, Deformation, GaussianCloud, ImagePlane, Layout, MeasurementSetup, Method, Misfit, Origin,
    Parameters, Parts, Real, Result, check_compatible, check_receivers, position_fault,
};
use std::any::Any;
use std::ops::{Deref, DerefMut};

/// Trained model, complete for predictions.
#[derive(Clone, Debug)]
pub struct Model {
    /// Method and frame, which map the cloud to observations.
    pub stages: Stages,
    /// Gaussians, without extra columns except those of the method.
    pub cloud: GaussianCloud,
    /// Weights Θ, with the layout of the method.
    pub weights: Vec<Real>,
    /// Thinned transmitter positions `[K,3]` of the training set, metres from the origin; `None` if unknown.
    pub training_positions: Option<TrainingPositions>,
}

impl Model {
    /// Returns the Gaussians as drawn for a transmitter at `tx` (metres, world frame), or without transmitter those of
    /// the base parameters.
    pub fn gaussians(&self, tx: Option<[f64; 3]>) -> Activated {
        let Stages { method, setup } = &self.stages;
        let parameters = Parameters { cloud: &self.cloud, gate: None, existence: None, weights: &self.weights };
        let local = tx.map(|tx| setup.origin.local(tx));
        method.gaussians(setup, &parameters, local)
    }

    /// Returns the centres `[N,3]`, metres from `origin`.
    pub fn means_from(&self, origin: Origin) -> Vec<[Real; 3]> {
        let from = self.stages.origin;
        let moved = |mean: &[Real; 3]| if from == origin { *mean } else { origin.local(from.world(*mean)) };
        self.cloud.means.iter().map(moved).collect()
    }

    /// Returns the size of the Gaussians in an uncompressed model file, bytes: 13 numbers each, and those that the method
    /// adds.
    pub fn gaussian_bytes(&self) -> usize {
        self.cloud.columns().map(|(_, _, values)| size_of_val(values)).sum()
    }

    /// Returns the size of the network in an uncompressed model file, bytes.
    pub fn network_bytes(&self) -> usize {
        size_of_val(self.weights.as_slice())
    }
}

/// Method and measurement setup: everything that maps parameters to observations, except learned parameters.
#[derive(Clone, Debug)]
pub struct Stages {
    /// Method.
    pub method: Plugin<dyn Method>,
    /// Receivers, image plane and type of the observations.
    pub setup: MeasurementSetup,
}

impl Deref for Stages {
    type Target = MeasurementSetup;

    fn deref(&self) -> &MeasurementSetup {
        &self.setup
    }
}

impl DerefMut for Stages {
    fn deref_mut(&mut self) -> &mut MeasurementSetup {
        &mut self.setup
    }
}

/// Maximum number of pixels of an image, to reject files that would exhaust the memory.
pub const MAX_PIXELS: usize = 1 << 24;
/// Maximum number of receivers.
const MAX_RECEIVERS: usize = 1 << 16;

impl Stages {
    /// Creates stages from the settings of a method and its frame.
    pub fn new(method: impl Method, setup: MeasurementSetup) -> Self {
        Self { method: Plugin::from(Box::new(method) as Box<dyn Method>), setup }
    }

    /// Creates stages from a method for `data`, with the whole image as its plane.
    ///
    /// # Errors
    /// The projector does not support the elevations, or the camera, of `data`.
    pub fn of(method: Plugin<dyn Method>, data: &Dataset) -> Result<Self> {
        let mut plane = data.plane();
        if let (true, Some(projector)) = (data.task().has_pixels, method.traits().projector) {
            plane = match data.camera() {
                Some(camera) => projector.plane_of_camera(data.width, data.height, camera),
                None => projector.plane_of(data.width, data.height, data.elevation),
            }
            .map_err(Misfit::error)?;
        }
        Ok(Self { setup: MeasurementSetup::of(data, plane), method })
    }

    /// Returns the deformation of the method; `None` if it has none.
    pub fn deformation(&self) -> Option<&Plugin<dyn Deformation>> {
        self.method.traits().deformation
    }

    /// Returns the settings of the method if it is an `M`; otherwise `None`.
    pub fn settings<M: Method>(&self) -> Option<&M> {
        let method: &dyn Any = self.method.get();
        method.downcast_ref()
    }

    /// Returns stages with changed settings of the method.
    ///
    /// # Panics
    /// If the method is not an `M`.
    #[must_use]
    pub fn with<M: Method + Clone>(&self, change: impl FnOnce(&mut M)) -> Self {
        let mut method = self.settings::<M>().expect("this method").clone();
        change(&mut method);
        Self::new(method, self.setup.clone())
    }

    /// Checks the consistency of stages, for files from other programs.
    ///
    /// # Errors
    /// The number of pixels or receivers is out of range, a position or receiver is invalid, or method and setup do not
    /// fit together; the message names the problem.
    pub fn check(&self) -> Result<(), String> {
        let ImagePlane { width, height, .. } = self.plane;
        let pixels = width.checked_mul(height).filter(|pixels| (1..=MAX_PIXELS).contains(pixels));
        if pixels.is_none() {
            return Err(format!("plane: {width} x {height} pixels, expected 1 to {MAX_PIXELS}"));
        }
        if self.moving.is_receiver() && self.receivers.iter().any(|receiver| receiver.pose.position != [0.0; 3]) {
            return Err("links: receivers that move have a position".into());
        }
        if let Some(fault) = self.transmitter.and_then(position_fault) {
            return Err(format!("links: the transmitter {fault}"));
        }
        if !(1..=MAX_RECEIVERS).contains(&self.receivers.len()) {
            return Err(format!("{} receivers, expected 1 to {MAX_RECEIVERS}", self.receivers.len()));
        }
        check_receivers(&self.receivers)?;
        let (setup, method) = (Some(&self.setup), Some(self.method.get()));
        check_compatible(&Parts { setup, method, ..Parts::default() }).map_err(|why| why.to_string())
    }

    /// Returns names, shapes and initial values of the weights.
    pub fn layout(&self) -> Layout {
        self.method.layout(&self.setup)
    }

    /// Returns the rows of `cloud` that can affect an observation, given the factors `gate` `[N]` of pruners, `None`
    /// for all 1.
    pub fn drawable(&self, cloud: &GaussianCloud, gate: Option<&[Real]>) -> Vec<usize> {
        self.method.drawable(&self.setup, cloud, gate)
    }
}
