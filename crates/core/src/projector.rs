//! `Projector`: from Gaussians in space to splats on the image plane.

use crate::{Elevation, ImagePlane, Pose, Primitives, Real, Splats, plugin_kind};

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
