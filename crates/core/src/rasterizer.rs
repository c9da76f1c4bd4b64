//! `Projector` and `Rasterizer`: from Gaussians in space to splats on the image plane, and from splats to an image of
//! signals.

use crate::{Cache, Camera, Elevation, ImagePlane, Misfit, Pose, Primitives, Real, SignalSplats, Splats, plugin_kind};

/// Projects Gaussians onto the image plane of a receiver.
///
/// A new projection needs no covariance algebra: see `pwrfgs_raster::CameraModel`.
#[typetag::serde]
#[expect(unused_variables, reason = "the defaults ignore parameters")]
pub trait Projector: crate::plugin::PluginObject {
    /// Returns the image plane for spectra of `width` by `height` pixels.
    fn plane(&self, width: usize, height: usize) -> ImagePlane;

    /// Returns the image plane for spectra with these elevations; [`Self::plane`] for those of the hemisphere in front.
    ///
    /// # Errors
    /// The projector does not support them.
    fn plane_of(&self, width: usize, height: usize, elevation: Elevation) -> Result<ImagePlane, Misfit> {
        let Elevation { first, last } = elevation;
        if elevation == Elevation::UPPER { Ok(self.plane(width, height)) } else { Err(Misfit::Elevations(first, last)) }
    }

    /// Returns the image plane for the images of a camera.
    ///
    /// # Errors
    /// The projector does not draw them.
    fn plane_of_camera(&self, width: usize, height: usize, camera: Camera) -> Result<ImagePlane, Misfit> {
        Err(Misfit::CameraImages)
    }

    /// Returns splats `[N]`, row for row; a Gaussian out of view has radius 0. Opacities may be decreased but not
    /// increased, because Gaussians below the limit of the rasterizer are removed before.
    ///
    /// `plane` is a whole image. With a stride, the splats are converted to the coarser pixels afterwards
    /// ([`Splats::sampled`]), so that projectors need no support for it.
    ///
    /// If [`Sampling::filter`](crate::Sampling::filter) of `plane` is given, it replaces the low-pass filter of the
    /// projector: the sky of `readout: ReceivedPower` has one. A projector that draws other elevations ([`Self::plane_of`])
    /// must use it.
    fn project(&self, primitives: &Primitives, pose: &Pose, plane: &ImagePlane) -> Splats;

    /// Returns which Gaussians centred at `means` `[N,3]` may be visible, whatever their shape; the others skip the
    /// network. All by default.
    fn sees(&self, means: &[[Real; 3]], pose: &Pose, plane: &ImagePlane) -> Vec<bool> {
        vec![true; means.len()]
    }

    /// Returns the cotangents of the primitives, given those of `means2d`, `conics`, `depths` and `opacities` of the
    /// splats.
    fn project_vjp(
        &self,
        primitives: &Primitives,
        pose: &Pose,
        plane: &ImagePlane,
        splats: &Splats,
        d: &Splats,
    ) -> Primitives;

    /// Rejects invalid settings when the pipeline is read; the error says what is wrong and what to do.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Projector);

/// Draws splats. One geometry may carry the signals of several transmitters ([`SignalSplats`]).
#[typetag::serde]
#[expect(unused_variables, reason = "the defaults ignore parameters")]
pub trait Rasterizer: crate::plugin::PluginObject {
    /// Draws splats with their signals.
    fn forward(&self, splats: SignalSplats<'_>) -> Render;

    /// Precomputes the signal-independent part of [`Self::forward`], such as depth order and tile lists, for constant
    /// geometry with varying signals. `None` without such a part.
    fn prepare(&self, splats: &Splats, plane: &ImagePlane) -> Cache {
        None
    }

    /// Runs [`Self::forward`], bit-identical, with the result of [`Self::prepare`] for the same splats and plane.
    fn forward_prepared(&self, splats: SignalSplats<'_>, prepared: &Cache) -> Render {
        self.forward(splats)
    }

    /// Returns the cotangents of splats and signals, given `d_pixels` in the layout of [`Render::pixels`].
    fn backward(&self, splats: SignalSplats<'_>, render: &Render, d_pixels: &[Real]) -> RenderVjp;

    /// Returns whether it blends front to back: it then supports [`Splats::existence`] and a [`survey`](Self::survey) of
    /// its weights.
    fn blends(&self) -> bool {
        false
    }

    /// Returns statistics of each splat for the image `render`; empty without blending.
    fn survey(
        &self,
        splats: &Splats,
        plane: &ImagePlane,
        render: &Render,
        survey: &SurveyInputs<'_>,
    ) -> Vec<SplatStats> {
        Vec::new()
    }

    /// Rejects unsupported image planes when the pipeline is checked.
    ///
    /// # Errors
    /// The rasterizer does not support the plane.
    fn check_plane(&self, plane: &ImagePlane) -> Result<(), Misfit> {
        Ok(())
    }

    /// Returns whether it draws data of several carriers, rather than waves of one wavelength.
    fn supports_carriers(&self) -> bool {
        true
    }

    /// Returns the opacity below which a splat is not drawn; 0 if every splat is drawn.
    fn min_drawn_opacity(&self) -> Real {
        0.0
    }

    /// Returns whether it adds waves: the channels of a transmitter are then the real and the imaginary part of one
    /// signal, and the readout must use both.
    fn is_coherent(&self) -> bool {
        false
    }

    /// Rejects invalid settings when the pipeline is read; the error says what is wrong and what to do.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Rasterizer);

/// Inputs of [`Rasterizer::survey`] in addition to weights; empty ones are skipped.
#[derive(Clone, Copy, Debug, Default)]
pub struct SurveyInputs<'a> {
    /// Absolute errors of the image, `[height, width]`.
    pub errors: &'a [Real],
    /// Pixels with a high error, `[height, width]`.
    pub high: &'a [bool],
    /// Number of top splats to mark per pixel, with the measured spectrum `[height, width]` and the strengths of the
    /// splats `[N]`.
    pub top: Option<(usize, &'a [Real], &'a [Real])>,
    /// Signals `[N, channels]` of `render`, and per pixel the derivative of the readout by its channels, `[channels,
    /// height, width]`.
    pub slopes: Option<(&'a [Real], &'a [Real])>,
    /// Whether [`SplatStats::fisher`] is requested; it needs `slopes`.
    pub fisher: bool,
}

/// Statistics of one splat in an image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SplatStats {
    /// Sum of its blending weights γ·T.
    pub weight: Real,
    /// Maximum of its blending weights.
    pub largest: Real,
    /// Number of pixels in which it is drawn.
    pub pixels: Real,
    /// Sum of its weights times the errors.
    pub error: Real,
    /// Number of high-error pixels in which it is drawn.
    pub high: Real,
    /// Whether it is among the top splats of a pixel.
    pub top: bool,
    /// Sum of (∂P̂/∂a)² with a factor a on γ.
    pub sensitivity: Real,
    /// Sum of J Jᵀ with J = ∂P̂/∂(mean2d, conic): the upper triangle of 5 × 5, row by row.
    pub fisher: [Real; 15],
}

impl SplatStats {
    /// Adds the statistics of the same splat in another part of the image.
    pub fn add(&mut self, other: &Self) {
        self.weight += other.weight;
        self.largest = self.largest.max(other.largest);
        self.pixels += other.pixels;
        self.error += other.error;
        self.high += other.high;
        self.top |= other.top;
        self.sensitivity += other.sensitivity;
        self.fisher.iter_mut().zip(other.fisher).for_each(|(sum, v)| *sum += v);
    }
}

/// Drawn image.
#[derive(Clone, Debug)]
pub struct Render {
    /// Blended signals, `[channels, height, width]`.
    pub pixels: Vec<Real>,
    /// Transmittance behind the last splat, `[height, width]`; empty without occlusion.
    pub transmittance: Vec<Real>,
    /// State of the rasterizer for `backward` (tile lists).
    pub cache: Cache,
}

/// Result of [`Rasterizer::backward`].
#[derive(Clone, Debug)]
pub struct RenderVjp {
    /// Cotangents of `means2d`, `conics`, `opacities` and `depths` (0 if depth affects only the order). Radii have
    /// none.
    pub splats: Splats,
    /// Cotangents of the signals, `[N, channels]`.
    pub signals: Vec<Real>,
    /// Sum of the blending weights γ·T of each splat over the pixels, `[N]`.
    pub weights: Vec<Real>,
}
