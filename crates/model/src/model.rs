//! `Model`: what is saved and predicts; `Stages`: a method and its frame, the whole way from parameters to observations.

use pwrfgs_core::plugin::Plugin;
use pwrfgs_core::{
    Activated, Axis, Dataset, Deformation, Error, Frame, GaussianCloud, ImagePlane, Layout, Method, Origin, Parameters,
    Projector, Real, Receiver, Result, WeightSpec,
};
use std::any::Any;
use std::ops::{Deref, DerefMut};

/// A trained model: predicts, and needs nothing else to do so.
#[derive(Clone, Debug)]
pub struct Model {
    /// The path from cloud to picture.
    pub stages: Stages,
    /// The Gaussians; no extra columns but the method's.
    pub cloud: GaussianCloud,
    /// Θ, as long as the method's layout says.
    pub weights: Vec<Real>,
}

impl Model {
    /// What is drawn for a transmitter at `tx` (metres, world frame), or of the base parameters alone.
    pub fn gaussians(&self, tx: Option<[f64; 3]>) -> Activated {
        let Stages { method, frame } = &self.stages;
        let parameters = Parameters { cloud: &self.cloud, gate: None, presence: None, weights: &self.weights };
        let local = tx.map(|tx| frame.origin.local(tx));
        method.gaussians(frame, &parameters, local)
    }

    /// The centres `[N,3]`, metres from `origin`.
    pub fn means_from(&self, origin: Origin) -> Vec<[Real; 3]> {
        let own = self.stages.origin;
        let moved = |mean: &[Real; 3]| if own == origin { *mean } else { origin.local(own.world(*mean)) };
        self.cloud.means.iter().map(moved).collect()
    }

    /// Bytes of the Gaussians in the model file: 13 numbers each, and those that the method adds.
    pub fn gaussian_bytes(&self) -> usize {
        self.cloud.columns().map(|(_, _, values)| size_of_val(values)).sum()
    }

    /// Bytes of the network in the model file.
    pub fn network_bytes(&self) -> usize {
        size_of_val(self.weights.as_slice())
    }
}

/// How observations are made of parameters: by which method, and seen from where. Everything but what is learned.
#[derive(Clone, Debug)]
pub struct Stages {
    /// The way.
    pub method: Plugin<dyn Method>,
    /// Receivers, and what is observed.
    pub frame: Frame,
}

impl Deref for Stages {
    type Target = Frame;

    fn deref(&self) -> &Frame {
        &self.frame
    }
}

impl DerefMut for Stages {
    fn deref_mut(&mut self) -> &mut Frame {
        &mut self.frame
    }
}

/// The most pixels of a picture: a file may promise more than memory holds.
const MAX_PIXELS: usize = 1 << 24;
/// The most receivers of a frame.
const MAX_RECEIVERS: usize = 1 << 16;
/// What the names of weights begin with that belong to receivers: they come last, and decay does not touch them.
const RECEIVERS: &str = "receiver.";

impl Stages {
    /// Settings of a method, and its frame.
    pub fn new(method: impl Method, frame: Frame) -> Self {
        Self { method: Plugin::from(Box::new(method) as Box<dyn Method>), frame }
    }

    /// A method for `data`, with the whole image as its plane.
    ///
    /// # Errors
    /// [`Error::Config`] where splats cannot be drawn on an image of this size.
    pub fn of(method: Plugin<dyn Method>, data: &Dataset) -> Result<Self> {
        let mut plane = data.plane();
        if let (true, Some(projector)) = (data.task().has_pixels, method.traits().projector) {
            let drawn = projector.plane_of(data.width, data.height, data.elevation);
            plane = drawn.map_err(|why| Error::Config(format!("the projector {why}")))?;
        }
        Ok(Self { frame: Frame::of(data, plane), method })
    }

    /// What the transmitter changes, where the method has Gaussians that a network changes.
    pub fn deformation(&self) -> Option<&Plugin<dyn Deformation>> {
        self.method.traits().deformation
    }

    /// The settings of the method, where it is an `M`.
    pub fn settings<M: Method>(&self) -> Option<&M> {
        let method: &dyn Any = self.method.get();
        method.downcast_ref()
    }

    /// The same with other settings of the method.
    ///
    /// # Panics
    /// Where the method is no `M`.
    #[must_use]
    pub fn with<M: Method + Clone>(&self, change: impl FnOnce(&mut M)) -> Self {
        let mut method = self.settings::<M>().expect("this method").clone();
        change(&mut method);
        Self::new(method, self.frame.clone())
    }

    /// Holds together what a file says that need not come from this program.
    ///
    /// # Errors
    /// What does not fit.
    pub fn check(&self) -> Result<(), String> {
        let ImagePlane { width, height, .. } = self.plane;
        let pixels = width.checked_mul(height).filter(|pixels| (1..=MAX_PIXELS).contains(pixels));
        if pixels.is_none() {
            return Err(format!("plane: {width} x {height} pixels; there are 1 to {MAX_PIXELS}"));
        }
        if let (true, Some(projector)) = (self.task.has_pixels, self.method.traits().projector) {
            check_plane(&self.frame.plane, &**projector)?;
        }
        if !(1..=MAX_RECEIVERS).contains(&self.receivers.len()) {
            return Err(format!("{} receivers; there are 1 to {MAX_RECEIVERS}", self.receivers.len()));
        }
        for Receiver { pose, antennas, .. } in &self.receivers {
            pose.fault().map_or(Ok(()), |(field, why)| Err(format!("pose, {field}: {why}")))?;
            if antennas.is_empty() || antennas.as_flattened().iter().any(|v| !v.is_finite()) {
                return Err("a receiver without antennas, or with one that is nowhere".into());
            }
        }
        let gains = (self.frequencies_hz.len(), 2 * self.receivers[0].antennas.len());
        let expected = if self.task.is_complex { gains } else { (1, 1) };
        if !self.task.has_pixels && (width, height) != expected {
            return Err(format!("plane: {width} x {height} numbers are no {}", self.task.singular));
        }
        self.method.layout(&self.frame).map(drop)
    }

    /// Names, shapes and initial values of the weights.
    ///
    /// # Panics
    /// Where the method cannot serve the frame, which [`Self::check`] refuses.
    pub fn layout(&self) -> Layout {
        self.method.layout(&self.frame).unwrap_or_else(|why| panic!("{why}"))
    }

    /// How many of the weights are a network's: what is learned of receivers comes behind them.
    pub fn network_weights(&self) -> usize {
        self.layout().weights.iter().take_while(|spec| !spec.name.starts_with(RECEIVERS)).map(WeightSpec::len).sum()
    }

    /// The rows of `cloud` that can count in an observation.
    pub fn drawable(&self, cloud: &GaussianCloud, gate: Option<&[Real]>) -> Vec<usize> {
        self.method.drawable(&self.frame, cloud, gate)
    }
}

/// Whether the projector draws such a picture.
fn check_plane(plane: &ImagePlane, projector: &dyn Projector) -> Result<(), String> {
    let ImagePlane { width, height, .. } = *plane;
    let near = |a: Axis, b: Axis| (a.first - b.first).abs() < 1e-9 && (a.step - b.step).abs() < 1e-9;
    let is_own = |drawn: &ImagePlane| {
        let alike = match (plane.angles, drawn.angles) {
            (Some(a), Some(b)) => near(a.0, b.0) && near(a.1, b.1),
            (a, b) => a == b,
        };
        alike && plane.wraps == drawn.wraps
    };
    let elevation = plane.elevation().filter(|elevation| elevation.fault().is_none());
    let stated = elevation.and_then(|elevation| projector.plane_of(width, height, elevation).ok());
    if is_own(&projector.plane(width, height)) || stated.is_some_and(|drawn| is_own(&drawn)) {
        return Ok(());
    }
    Err("plane: its angles are none that the projector draws".into())
}
