//! `Projector` and `Rasterizer`: from Gaussians in space to splats on the image plane, and from splats to a picture of signals.

use crate::{Cache, Elevation, ImagePlane, Pose, Primitives, Real, Splats, plugin_kind};

/// Projects Gaussians onto the picture that a receiver sees.
///
/// A new projection needs no covariance algebra: see `pwrfgs_raster::CameraModel`.
#[typetag::serde]
pub trait Projector:
    erased_serde::Serialize + crate::docs::Documented + std::any::Any + std::fmt::Debug + Send + Sync
{
    /// The grid it draws on, for spectra of `width` by `height` pixels.
    fn plane(&self, width: usize, height: usize) -> ImagePlane;

    /// The grid for spectra whose rows are these elevations; [`Self::plane`] for those of the hemisphere in front.
    ///
    /// # Errors
    /// Why it cannot draw them, and what can.
    fn plane_of(&self, width: usize, height: usize, elevation: Elevation) -> Result<ImagePlane, String> {
        let Elevation { first, last } = elevation;
        if elevation == Elevation::UPPER {
            return Ok(self.plane(width, height));
        }
        Err(format!(
            "draws no elevations of {first} to {last} degrees, as these spectra have; use projector: Mercator()"
        ))
    }

    /// Splats `[N]`, row for row; a Gaussian out of sight has radius 0. Opacities may be lowered but never raised: those
    /// that are too faint for the rasterizer are left out before.
    ///
    /// `plane` is a whole image: with a stride, the splats are brought to the coarser pixels afterwards
    /// ([`Splats::sampled`]), so that a projector needs to know nothing of it.
    ///
    /// If [`Sampling::filter`](crate::Sampling::filter) of `plane` is given, it replaces the projector's own low-pass filter:
    /// the sky of `readout: Received` has one. A projector that draws other elevations ([`Self::plane_of`]) must use it.
    fn project(&self, primitives: &Primitives, pose: &Pose, plane: &ImagePlane) -> Splats;

    /// Which Gaussians centred at `means` `[N,3]` may be drawn, whatever their shape: the others need no network. All,
    /// where the projector does not know better.
    fn sees(&self, means: &[[Real; 3]], pose: &Pose, plane: &ImagePlane) -> Vec<bool> {
        let _ = (pose, plane);
        vec![true; means.len()]
    }

    /// Cotangents of the primitives, given those of the splats' `means2d`, `conics`, `depths` and `opacities`.
    fn project_vjp(
        &self,
        primitives: &Primitives,
        pose: &Pose,
        plane: &ImagePlane,
        splats: &Splats,
        d: &Splats,
    ) -> Primitives;

    /// Refuses settings that cannot work, when the pipeline is read.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Projector);

/// Draws splats. One geometry may carry the signals of many transmitters: `channels` numbers a splat.
#[typetag::serde]
pub trait Rasterizer:
    erased_serde::Serialize + crate::docs::Documented + std::any::Any + std::fmt::Debug + Send + Sync
{
    /// Draws `signals`, row-major `[N, channels]`.
    fn forward(&self, splats: &Splats, signals: &[Real], channels: usize, plane: &ImagePlane) -> Render;

    /// What [`Self::forward`] finds before it looks at signals, such as order and tile lists: found once where geometry
    /// stays and signals change. `None` where there is nothing to find.
    fn prepare(&self, splats: &Splats, plane: &ImagePlane) -> Cache {
        let _ = (splats, plane);
        None
    }

    /// [`Self::forward`], bit for bit, given what [`Self::prepare`] found for the same splats and plane.
    fn forward_prepared(
        &self,
        splats: &Splats,
        signals: &[Real],
        channels: usize,
        plane: &ImagePlane,
        prepared: &Cache,
    ) -> Render {
        let _ = prepared;
        self.forward(splats, signals, channels, plane)
    }

    /// Cotangents of splats and signals, given `d_pixels` in the layout of [`Render::pixels`].
    fn backward(
        &self,
        splats: &Splats,
        signals: &[Real],
        channels: usize,
        plane: &ImagePlane,
        render: &Render,
        d_pixels: &[Real],
    ) -> RenderVjp;

    /// Whether it blends, front to back: it then reads [`Splats::presence`] and can [`survey`](Self::survey) its weights.
    fn blends(&self) -> bool {
        false
    }

    /// What each splat has to do with the picture that `render` is; empty where it does not blend.
    fn survey(&self, splats: &Splats, plane: &ImagePlane, render: &Render, survey: &Survey<'_>) -> Vec<Looked> {
        let _ = (splats, plane, render, survey);
        Vec::new()
    }

    /// Refuses a plane it cannot draw on, when the pipeline is checked.
    fn check_plane(&self, plane: &ImagePlane) -> Result<(), String> {
        let _ = plane;
        Ok(())
    }

    /// The opacity below which it draws nothing of a splat; 0 where every splat counts.
    fn faintest(&self) -> Real {
        0.0
    }

    /// Whether it adds up waves: the channels of a transmitter are then the real and the imaginary part of one signal,
    /// and the readout must take both.
    fn coherent(&self) -> bool {
        false
    }

    /// Refuses settings that cannot work, when the pipeline is read.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Rasterizer);

/// What [`Rasterizer::survey`] shall look at besides weights; each is left out where it is empty.
#[derive(Clone, Copy, Debug, Default)]
pub struct Survey<'a> {
    /// Absolute errors of the picture, `[height, width]`.
    pub errors: &'a [Real],
    /// Where the error is high, `[height, width]`.
    pub high: &'a [bool],
    /// How many splats of each pixel are marked as its first, given what was measured `[height, width]` and the splats' own
    /// strengths `[N]`.
    pub top: Option<(usize, &'a [Real], &'a [Real])>,
    /// Signals `[N, channels]` of `render`, and for each pixel the derivative of what is read out there in its own channels,
    /// `[channels, height, width]`.
    pub slopes: Option<(&'a [Real], &'a [Real])>,
    /// Whether the products of geometry's slopes are wanted too.
    pub fisher: bool,
}

/// What a survey finds of one splat.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Looked {
    /// Sum of its blending weights γ·T.
    pub weight: Real,
    /// The largest of them.
    pub largest: Real,
    /// Pixels where it counts.
    pub pixels: Real,
    /// Sum of its weights times the errors.
    pub error: Real,
    /// Pixels of high error where it counts.
    pub high: Real,
    /// Whether it is among the first of some pixel.
    pub top: bool,
    /// Sum of (∂P̂/∂a)² with a factor a on γ.
    pub sensitivity: Real,
    /// Sum of J Jᵀ with J = ∂P̂/∂(mean2d, conic): the upper triangle of 5 × 5, row by row.
    pub fisher: [Real; 15],
}

impl Looked {
    /// Adds what another part of the picture shows of the same splat.
    pub fn add(&mut self, other: &Self) {
        self.weight += other.weight;
        self.largest = self.largest.max(other.largest);
        self.pixels += other.pixels;
        self.error += other.error;
        self.high += other.high;
        self.top |= other.top;
        self.sensitivity += other.sensitivity;
        self.fisher.iter_mut().zip(other.fisher).for_each(|(sum, own)| *sum += own);
    }
}

/// A drawn picture.
#[derive(Clone, Debug)]
pub struct Render {
    /// Blended signals, `[channels, height, width]`.
    pub pixels: Vec<Real>,
    /// Transmittance left behind the last splat, `[height, width]`; empty where nothing hides anything.
    pub transmittance: Vec<Real>,
    /// Whatever the rasterizer wants to find again in `backward` (tile lists).
    pub cache: Cache,
}

/// What [`Rasterizer::backward`] finds.
#[derive(Clone, Debug)]
pub struct RenderVjp {
    /// Cotangents of `means2d`, `conics`, `opacities` and `depths` (0 where depth decides the order only). Radii carry
    /// none.
    pub splats: Splats,
    /// Cotangents of the signals, `[N, channels]`.
    pub signals: Vec<Real>,
    /// How much of the picture is each splat's, `[N]`: the sum of its blending weights γ·T over the pixels.
    pub weights: Vec<Real>,
}
