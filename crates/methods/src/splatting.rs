//! `Splatting`: Gaussians drawn as splats, for prediction and training alike, and the derivative.
//!
//! ```text
//! means, p_tx ─► deform ─► ΔS, ΔR, Δs
//! cloud, Δ, M ─► activate ─► project ─► prepare the rasterizer      (Geometry, once per receiver)
//!                 signals ─► rasterize                              (BlendedSignals) ─► read out ─► P̂
//! ```

mod backward;
#[cfg(feature = "gpu")]
mod gpu;
#[cfg(feature = "gpu")]
#[cfg(test)]
mod gpu_tests;
mod method;
mod received;
#[cfg(feature = "gpu")]
mod resident;
#[cfg(feature = "gpu")]
#[cfg(test)]
mod resident_tests;
mod survey;

use crate::groups::ReceiverGroup;
use crate::{Activation, Calibration, Readout};
use pwrfgs_core::plugin::Plugin;
use pwrfgs_core::{
    Cache, Call, Deformation, Deltas, ImagePlane, JsonSchema, MeasurementSetup, Method, Parameters, Pose, Primitives,
    Projector, Rasterizer, Real, Render, RenderVjp, Splats,
};
use pwrfgs_networks::Mlp;
use pwrfgs_raster::{AlphaBlending, Mercator};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

/// Gaussian splatting with the projector, rasterizer, deformation, calibration and readout of the pipeline. A pipeline
/// without `method` uses it.
///
/// ```ron
/// Splatting(calibration: Physical, readout: Magnitude)
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Splatting {
    /// Effect of the transmitter on the Gaussians, usually a network.
    pub deformation: Plugin<dyn Deformation>,
    /// Projection of Gaussians to the image plane.
    pub projector: Plugin<dyn Projector>,
    /// Blending of projected Gaussians into pixels.
    pub rasterizer: Plugin<dyn Rasterizer>,
    /// How outputs of the deformation network are combined with the learned parameters.
    pub calibration: Calibration,
    /// Conversion of the blended signals to pixel values or a received power.
    pub readout: Readout,
}

impl Default for Splatting {
    fn default() -> Self {
        Self {
            deformation: Plugin::from(Box::new(Mlp::default()) as Box<dyn Deformation>),
            projector: Plugin::from(Box::new(Mercator::default()) as Box<dyn Projector>),
            rasterizer: Plugin::from(Box::new(AlphaBlending::default()) as Box<dyn Rasterizer>),
            calibration: Calibration::default(),
            readout: Readout::default(),
        }
    }
}

/// Viewpoint and image plane of a receiver.
#[derive(Clone, Debug, PartialEq)]
pub struct ReceiverView {
    /// Pose of the receiver, relative to the origin of the frame.
    pub pose: Pose,
    /// Image plane of the sky.
    pub plane: ImagePlane,
}

/// Gaussians in space and on the image, without their signals.
#[derive(Debug)]
pub struct Geometry {
    /// Gaussians in space.
    pub primitives: Primitives,
    /// Gaussians on the image.
    pub splats: Splats,
    /// Opacities `[N]` before the existence factor, if the rasterizer does not support it and it was multiplied into
    /// them.
    pub opacities_without_existence: Vec<Real>,
    /// Cache of the rasterizer for these splats.
    pub cache: Cache,
    /// Seconds of activation and projection, and of the rasterizer.
    pub seconds: [f64; 2],
}

/// Blended signals of transmitters with a common geometry, and the state for the backward pass.
#[derive(Debug)]
struct BlendedSignals {
    /// Range of transmitters in the batch.
    pub batch: Range<usize>,
    /// Geometry of the splats.
    pub geometry: Arc<Geometry>,
    /// Signals `[N, batch · channels]`.
    pub signals: Vec<Real>,
    /// Output of the rasterizer.
    pub render: Render,
}

/// Group of links after drawing and readout.
struct GroupOutput {
    group: ReceiverGroup,
    observations: Vec<Real>,
    /// Seconds of projection, sort and blending.
    seconds: [f64; 3],
    /// State for the backward pass, in training.
    drawing: Option<(ReceiverView, BlendedSignals)>,
}

impl Splatting {
    /// Returns the image plane of a receiver: the spectrum, or a coarse sky that is integrated to a power.
    ///
    /// # Panics
    /// If the projector does not draw the whole sky, which [`Method::plane`] reports as an error.
    pub fn sky(&self, setup: &MeasurementSetup) -> ImagePlane {
        self.plane(setup).expect("a compatible projector draws the whole sky").into_owned()
    }

    /// Returns the activation settings of this method.
    pub fn activation(&self) -> Activation {
        Activation {
            calibration: self.calibration,
            replaces_signals: self.deformation.traits().replaces_signals,
            channels: self.readout.channel_count(),
        }
    }

    /// Returns the view of each receiver of the setup; that of a moving one is at the origin.
    pub fn views(&self, setup: &MeasurementSetup) -> Vec<ReceiverView> {
        let plane = self.sky(setup);
        setup.receivers.iter().map(|receiver| ReceiverView { pose: receiver.pose, plane: plane.clone() }).collect()
    }

    /// Returns the gated geometry of transmitter `b` of the batch in `deltas`, in a view. The existence factors remain
    /// separate if the rasterizer supports them; otherwise the opacities contain them.
    pub fn geometry(&self, view: &ReceiverView, p: &Parameters<'_>, deltas: &Deltas, b: usize) -> Geometry {
        let start = Instant::now();
        let primitives = self.activation().geometry(p.cloud, deltas, b, p.gate);
        let whole = view.plane.whole();
        let mut splats = self.projector.project(&primitives, &view.pose, &whole).sampled(&view.plane);
        let mut opacities_without_existence = Vec::new();
        match p.existence {
            Some(existence) if self.rasterizer.blends() => splats.existence = existence.to_vec(),
            Some(existence) => {
                opacities_without_existence.clone_from(&splats.opacities);
                splats.opacities.iter_mut().zip(existence).for_each(|(o, m)| *o *= m);
            }
            None => {}
        }
        let projected = Instant::now();
        let cache = self.rasterizer.prepare(&splats, &view.plane);
        let seconds = [projected - start, projected.elapsed()].map(|time| time.as_secs_f64());
        Geometry { primitives, splats, opacities_without_existence, cache, seconds }
    }

    /// Draws the transmitters `batch` of `deltas`, which share the geometry of the first; `shared_geometry` is that
    /// geometry if it is available.
    fn draw(
        &self,
        view: &ReceiverView,
        p: &Parameters<'_>,
        deltas: &Deltas,
        batch: Range<usize>,
        shared_geometry: Option<&Arc<Geometry>>,
    ) -> BlendedSignals {
        let fresh = || Arc::new(self.geometry(view, p, deltas, batch.start));
        let geometry = shared_geometry.cloned().unwrap_or_else(fresh);
        let signals = self.activation().signals(p.cloud, deltas, batch.clone());
        let (channels, Geometry { splats, cache, .. }) = (self.readout.channel_count() * batch.len(), &*geometry);
        let render = self.rasterizer.forward_prepared(splats.with_signals(&signals, channels, &view.plane), cache);
        BlendedSignals { batch, geometry, signals, render }
    }

    /// Draws a group of links and reads it out. If `is_training`, keeps the drawing and clamps blended signals as released.
    fn draw_group(
        &self,
        call: &Call<'_>,
        sky: &ImagePlane,
        deltas: &Deltas,
        shared_geometry: Option<&Arc<Geometry>>,
        is_training: bool,
        group: ReceiverGroup,
    ) -> GroupOutput {
        let (start, p) = (Instant::now(), &call.parameters);
        let view = ReceiverView { pose: group.state.pose, plane: sky.clone() };
        let (terms, batch) = group.gather_terms(deltas, p.cloud.len());
        let drawing = self.draw(&view, p, &terms, batch, shared_geometry);
        let blended = &drawing.render.pixels;
        let blended = if is_training { self.clamp_as_released(blended) } else { Cow::Borrowed(blended.as_slice()) };
        let observations = self.read_out(call, &view, &group, &blended);
        let [projection, sort] = if shared_geometry.is_some() { [0.0; 2] } else { drawing.geometry.seconds };
        let seconds = [projection, sort, start.elapsed().as_secs_f64() - projection - sort];
        GroupOutput { group, observations, seconds, drawing: is_training.then_some((view, drawing)) }
    }

    /// Computes the derivative of blending and projection in [`Self::draw`]: returns the cotangents of the splats and of the
    /// primitives, given those of the blended signals.
    fn draw_vjp(
        &self,
        view: &ReceiverView,
        drawing: &BlendedSignals,
        p: &Parameters<'_>,
        d_pixels: &[Real],
    ) -> (RenderVjp, Primitives) {
        let BlendedSignals { batch, geometry, signals, render } = drawing;
        let (splats, channels) = (&geometry.splats, self.readout.channel_count() * batch.len());
        let mut d = self.rasterizer.backward(splats.with_signals(signals, channels, &view.plane), render, d_pixels);
        if let Some(existence) = p.existence.filter(|_| !geometry.opacities_without_existence.is_empty()) {
            d.splats.existence =
                d.splats.opacities.iter().zip(&geometry.opacities_without_existence).map(|(d, o)| d * o).collect();
            d.splats.opacities.iter_mut().zip(existence).for_each(|(d, m)| *d *= m);
        }
        let d_primitives = self.project_vjp(view, geometry, &d.splats);
        (d, d_primitives)
    }

    /// Returns the cotangents of the primitives, given those of the splats in pixels of the view's plane.
    pub(crate) fn project_vjp(&self, view: &ReceiverView, geometry: &Geometry, d: &Splats) -> Primitives {
        let Geometry { primitives, splats, .. } = geometry;
        let (splats, d) = (splats.unsampled(&view.plane), d.sampled_vjp(&view.plane));
        self.projector.project_vjp(primitives, &view.pose, &view.plane.whole(), &splats, &d)
    }
}
