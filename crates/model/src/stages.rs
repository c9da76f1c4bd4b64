//! `Stages`: the one way from a cloud to a picture, for prediction and training alike, and its derivative.
//!
//! ```text
//! means, p_tx ─► deform ─► ΔS, ΔR, Δs
//! cloud, Δ, M ─► activate ─► project ─► prepare the rasterizer      (Geometry)
//!                 signals ─► rasterize                              (Drawing) ─► read out ─► P̂
//! ```

use crate::{Activation, ActivationVjp, Calibration, Readout};
use pwrfgs_core::plugin::Plugin;
use pwrfgs_core::{
    Axis, Cache, Deformation, Deltas, GaussianCloud, ImagePlane, Origin, Pose, Primitives, Projector, Rasterizer, Real,
    Render, RenderVjp, Splats, sigmoid,
};
use std::ops::Range;
use std::sync::Arc;
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
    /// The place in the user's frame that everything here counts from.
    pub origin: Origin,
    /// The receiver, from the origin.
    pub pose: Pose,
    /// The picture.
    pub plane: ImagePlane,
}

/// Gaussians in space and on the picture, before their signals are looked at.
#[derive(Debug)]
pub struct Geometry {
    /// In space.
    pub primitives: Primitives,
    /// On the picture.
    pub splats: Splats,
    /// What the rasterizer found of them.
    pub cache: Cache,
    /// Seconds that activation and projection took, and the rasterizer.
    pub seconds: [f64; 2],
}

/// Blended signals of transmitters that share one geometry, and what the way back needs.
#[derive(Debug)]
pub struct Drawing {
    /// Which transmitters of the batch.
    pub batch: Range<usize>,
    /// What is drawn.
    pub geometry: Arc<Geometry>,
    /// Signals `[N, batch · channels]`.
    pub signals: Vec<Real>,
    /// What is seen of it.
    pub render: Render,
}

/// The most pixels of a picture: a file may promise more than memory holds.
const MAX_PIXELS: usize = 1 << 24;

/// What rasterizer, readout, calibration and plane cannot see of each other: one check for pipelines and model files.
///
/// # Errors
/// Which of them does not suit, and what to do.
pub fn check_together(
    rasterizer: &dyn Rasterizer,
    readout: Readout,
    calibration: Calibration,
    plane: &ImagePlane,
) -> Result<(), String> {
    rasterizer.check_plane(plane).map_err(|why| format!("rasterizer: {why}"))?;
    if rasterizer.coherent() && readout.channels() < 2 {
        return Err(
            "readout: this rasterizer adds up waves, and Real takes one channel of each; use MinMax, Magnitude \
                    or Power"
                .into(),
        );
    }
    if rasterizer.coherent() && calibration == Calibration::AsReleased {
        return Err(
            "calibration: AsReleased makes colours of signals, and this rasterizer adds up waves; use Physical".into(),
        );
    }
    Ok(())
}

impl Stages {
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
        let near = |a: Axis, b: Axis| (a.first - b.first).abs() < 1e-9 && (a.step - b.step).abs() < 1e-9;
        let is_own = |drawn: &ImagePlane| {
            let alike = match (self.plane.angles, drawn.angles) {
                (Some(a), Some(b)) => near(a.0, b.0) && near(a.1, b.1),
                (a, b) => a == b,
            };
            alike && self.plane.wraps == drawn.wraps
        };
        let elevation = self.plane.elevation().filter(|elevation| elevation.fault().is_none());
        let stated = elevation.and_then(|elevation| self.projector.plane_of(width, height, elevation).ok());
        if !is_own(&self.projector.plane(width, height)) && !stated.is_some_and(|drawn| is_own(&drawn)) {
            return Err("plane: its angles are none that the projector draws".into());
        }
        self.pose.fault().map_or(Ok(()), |(field, why)| Err(format!("pose, {field}: {why}")))?;
        check_together(&*self.rasterizer, self.readout, self.calibration, &self.plane)
    }

    /// The receiver in the user's frame.
    pub fn receiver(&self) -> Pose {
        self.origin.world_pose(self.pose)
    }

    /// How a cloud is activated here.
    pub fn activation(&self) -> Activation {
        Activation {
            calibration: self.calibration,
            replaces_signals: self.deformation.replaces_signals(),
            channels: self.readout.channels(),
        }
    }

    /// The rows of `cloud` that can show in a picture, whatever the network says: gate open, not too faint for the
    /// rasterizer, seen by the projector. Only they need to pass the network; all, where it couples them.
    pub fn drawable(&self, cloud: &GaussianCloud, gate: Option<&[Real]>) -> Vec<usize> {
        if self.deformation.couples_gaussians() {
            return (0..cloud.len()).collect();
        }
        let seen = self.projector.sees(&cloud.means, &self.pose, &self.plane);
        let faintest = self.rasterizer.faintest();
        let drawn = |i: &usize| {
            let gate = gate.map_or(1.0, |g| g[*i]);
            gate != 0.0 && seen[*i] && gate * sigmoid(cloud.opacity_logits[*i]) >= faintest
        };
        (0..cloud.len()).filter(drawn).collect()
    }

    /// The geometry of transmitter `b` of the batch in `deltas`, gated by `gate` `[N]` (`None`: all open).
    pub fn geometry(&self, cloud: &GaussianCloud, deltas: &Deltas, b: usize, gate: Option<&[Real]>) -> Geometry {
        let start = Instant::now();
        let primitives = self.activation().geometry(cloud, deltas, b, gate);
        let splats = self.projector.project(&primitives, &self.pose, &self.plane);
        let projected = Instant::now();
        let cache = self.rasterizer.prepare(&splats, &self.plane);
        let seconds = [projected - start, projected.elapsed()].map(|time| time.as_secs_f64());
        Geometry { primitives, splats, cache, seconds }
    }

    /// Draws the transmitters `batch` of `deltas`, which share the geometry of the first; `still` is that geometry where
    /// it is known.
    pub fn draw(
        &self,
        cloud: &GaussianCloud,
        deltas: &Deltas,
        batch: Range<usize>,
        gate: Option<&[Real]>,
        still: Option<&Arc<Geometry>>,
    ) -> Drawing {
        let geometry = still.cloned().unwrap_or_else(|| Arc::new(self.geometry(cloud, deltas, batch.start, gate)));
        let signals = self.activation().signals(cloud, deltas, batch.clone());
        let (channels, Geometry { splats, cache, .. }) = (self.readout.channels() * batch.len(), &*geometry);
        let render = self.rasterizer.forward_prepared(splats, &signals, channels, &self.plane, cache);
        Drawing { batch, geometry, signals, render }
    }

    /// The derivative of [`Self::draw`]: adds to `sums`, given the cotangents of the blended signals, and gives those of
    /// the splats.
    pub fn draw_vjp(
        &self,
        drawing: &Drawing,
        cloud: &GaussianCloud,
        deltas: &Deltas,
        gate: Option<&[Real]>,
        d_pixels: &[Real],
        sums: &mut ActivationVjp,
    ) -> RenderVjp {
        let Drawing { batch, geometry, signals, render } = drawing;
        let (activation, splats) = (self.activation(), &geometry.splats);
        let channels = activation.channels * batch.len();
        let d = self.rasterizer.backward(splats, signals, channels, &self.plane, render, d_pixels);
        let d_primitives = self.projector.project_vjp(&geometry.primitives, &self.pose, &self.plane, splats, &d.splats);
        activation.geometry_vjp(cloud, deltas, batch.start, gate, &d_primitives, sums);
        activation.signals_vjp(cloud, deltas, batch.clone(), &d.signals, sums);
        d
    }
}
