//! `Model`: the saved state that predicts. `Stages`: a method and its frame, which map parameters to observations.

use crate::TrainingPositions;
use pwrfgs_core::plugin::Plugin;
use pwrfgs_core::{
    Activated, AngleAxis, Dataset, Deformation, Error, GaussianCloud, ImagePlane, Layout, MeasurementSetup, Method,
    Origin, Parameters, Projector, Real, Result, check_receivers, place_fault,
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
    /// Returns the Gaussians as drawn for a transmitter at `tx` (metres, world frame), or of the base parameters.
    pub fn gaussians(&self, tx: Option<[f64; 3]>) -> Activated {
        let Stages { method, setup } = &self.stages;
        let parameters = Parameters { cloud: &self.cloud, gate: None, existence: None, weights: &self.weights };
        let local = tx.map(|tx| setup.origin.local(tx));
        method.gaussians(setup, &parameters, local)
    }

    /// Returns the centres `[N,3]`, metres from `origin`.
    pub fn means_from(&self, origin: Origin) -> Vec<[Real; 3]> {
        let own = self.stages.origin;
        let moved = |mean: &[Real; 3]| if own == origin { *mean } else { origin.local(own.world(*mean)) };
        self.cloud.means.iter().map(moved).collect()
    }

    /// Returns the size of the Gaussians in the model file, bytes: 13 numbers each, and those that the method adds.
    pub fn gaussian_bytes(&self) -> usize {
        self.cloud.columns().map(|(_, _, values)| size_of_val(values)).sum()
    }

    /// Returns the size of the network in the model file, bytes.
    pub fn network_bytes(&self) -> usize {
        size_of_val(self.weights.as_slice())
    }
}

/// Method and measurement setup: everything that maps parameters to observations, except learned parameters.
#[derive(Clone, Debug)]
pub struct Stages {
    /// Method.
    pub method: Plugin<dyn Method>,
    /// Receivers and type of the observations.
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
const MAX_PIXELS: usize = 1 << 24;
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
    /// [`Error::Config`] if splats cannot be drawn on an image of this size.
    pub fn of(method: Plugin<dyn Method>, data: &Dataset) -> Result<Self> {
        let mut plane = data.plane();
        if let (true, Some(projector)) = (data.task().has_pixels, method.traits().projector) {
            let drawn = match data.camera() {
                Some(camera) => projector.plane_of_camera(data.width, data.height, camera),
                None => projector.plane_of(data.width, data.height, data.elevation),
            };
            plane = drawn.map_err(|why| Error::Config(format!("the projector {why}")))?;
        }
        Ok(Self { setup: MeasurementSetup::of(data, plane), method })
    }

    /// Returns the deformation, if the method has one.
    pub fn deformation(&self) -> Option<&Plugin<dyn Deformation>> {
        self.method.traits().deformation
    }

    /// Returns the settings of the method if it is an `M`.
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
    /// The message names the mismatch.
    pub fn check(&self) -> Result<(), String> {
        let ImagePlane { width, height, .. } = self.plane;
        let pixels = width.checked_mul(height).filter(|pixels| (1..=MAX_PIXELS).contains(pixels));
        if pixels.is_none() {
            return Err(format!("plane: {width} x {height} pixels, expected 1 to {MAX_PIXELS}"));
        }
        if let (true, Some(projector)) = (self.task.has_pixels, self.method.traits().projector) {
            check_plane(&self.setup.plane, &**projector)?;
        }
        if self.moving.is_receiver() && self.receivers.iter().any(|receiver| receiver.pose.position != [0.0; 3]) {
            return Err("links: receivers that move have a position".into());
        }
        if let Some(fault) = self.transmitter.and_then(place_fault) {
            return Err(format!("links: the transmitter {fault}"));
        }
        if !(1..=MAX_RECEIVERS).contains(&self.receivers.len()) {
            return Err(format!("{} receivers, expected 1 to {MAX_RECEIVERS}", self.receivers.len()));
        }
        check_receivers(&self.receivers)?;
        let gains = (self.frequencies_hz.len(), 2 * self.receivers[0].antennas.len());
        let expected = if self.task.is_complex { gains } else { (1, 1) };
        if !self.task.has_pixels && (width, height) != expected {
            return Err(format!("plane: {width} x {height} numbers do not match a {}", self.task.singular));
        }
        self.method.layout(&self.setup).map(drop)
    }

    /// Returns names, shapes and initial values of the weights.
    ///
    /// # Panics
    /// If the method does not support the frame, which [`Self::check`] rejects.
    pub fn layout(&self) -> Layout {
        self.method.layout(&self.setup).unwrap_or_else(|why| panic!("{why}"))
    }

    /// Returns the rows of `cloud` that can affect an observation.
    pub fn drawable(&self, cloud: &GaussianCloud, gate: Option<&[Real]>) -> Vec<usize> {
        self.method.drawable(&self.setup, cloud, gate)
    }
}

/// Checks that the projector supports the image plane.
fn check_plane(plane: &ImagePlane, projector: &dyn Projector) -> Result<(), String> {
    let ImagePlane { width, height, .. } = *plane;
    let near = |a: AngleAxis, b: AngleAxis| (a.first - b.first).abs() < 1e-9 && (a.step - b.step).abs() < 1e-9;
    let is_own = |drawn: &ImagePlane| {
        let alike = match (plane.angles, drawn.angles) {
            (Some(a), Some(b)) => near(a.0, b.0) && near(a.1, b.1),
            (a, b) => a == b,
        };
        alike && plane.wraps == drawn.wraps && plane.camera == drawn.camera
    };
    if let Some(camera) = plane.camera {
        let drawn =
            projector.plane_of_camera(width, height, camera).map_err(|why| format!("plane: the projector {why}"))?;
        return if *plane == drawn { Ok(()) } else { Err("plane: has a camera and angles".into()) };
    }
    let elevation = plane.elevation().filter(|elevation| elevation.fault().is_none());
    let stated = elevation.and_then(|elevation| projector.plane_of(width, height, elevation).ok());
    if is_own(&projector.plane(width, height)) || stated.is_some_and(|drawn| is_own(&drawn)) {
        return Ok(());
    }
    Err("plane: the projector does not support its angles".into())
}
