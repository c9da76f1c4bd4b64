//! Intermediate forms between a cloud and an image: `Primitives` in space, `Splats` on the image plane.

use crate::{ImagePlane, Pose, Real, Sampling};
use glam::DVec3;
use std::borrow::Cow;

/// Activated and gated Gaussians in space, ready for projection, for one transmitter or for a batch of transmitters
/// with equal geometry.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Primitives {
    /// Centres `[N,3]`, metres, world frame.
    pub means: Vec<[Real; 3]>,
    /// Scales `[N,3]`, metres.
    pub scales: Vec<[Real; 3]>,
    /// Rotations `[N,4]` as w, x, y, z; unit length unless the calibration is `AsReleased`.
    pub quats: Vec<[Real; 4]>,
    /// Opacities `[N]` in [0, 1).
    pub opacities: Vec<Real>,
}

/// Gaussians on the image plane.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Splats {
    /// Centres `[N,2]` in pixels: (column, row); pixel centres have whole coordinates.
    pub means2d: Vec<[Real; 2]>,
    /// Inverse covariances `[N,3]`, px⁻²: (A, B, C) of A·dx² + 2B·dx·dy + C·dy².
    pub conics: Vec<[Real; 3]>,
    /// Distances from the receiver `[N]`, metres: the blending order. They are compared in single precision; ties are
    /// blended in row order.
    pub depths: Vec<Real>,
    /// Standard deviations along columns and rows `[N,2]`, px: the square roots of the diagonal of the inverse conic.
    /// They bound the extent of a splat. Not differentiated.
    pub sigmas2d: Vec<[Real; 2]>,
    /// Radii of three standard deviations `[N]`, px, rounded up; 0 for a Gaussian outside the image.
    pub radii: Vec<Real>,
    /// Opacities `[N]`.
    pub opacities: Vec<Real>,
    /// Factors on γ after the visibility test, `[N]`, as in [`crate::Gate::Existence`]; empty if all are 1. Only a
    /// rasterizer that [`blends`](crate::Rasterizer::blends) receives them.
    pub existence: Vec<Real>,
}

impl Primitives {
    /// Returns the number of Gaussians N.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Returns whether N = 0.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Creates `n` Gaussians with all values zero.
    pub fn zeros(n: usize) -> Self {
        Self { means: vec![[0.0; 3]; n], scales: vec![[0.0; 3]; n], quats: vec![[0.0; 4]; n], opacities: vec![0.0; n] }
    }

    /// Returns the derivatives by position `[3]` (1/metre, world frame) and orientation `[4]` (x, y, z, w) of the receiver at
    /// `pose`, given the derivatives `d` by `means` and `quats` of the Gaussians. They hold for images that depend only on
    /// Gaussians in the frame of the receiver, and for rotations of unit length.
    ///
    /// A movement of the receiver moves all Gaussians the other way. A turn of the receiver by a small vector δ in world axes
    /// turns means about the receiver, and rotations, by −δ. The orientation q changes by ½ δ q, which gives the derivative
    /// across q; the length of q has no effect.
    pub fn pose_vjp(&self, pose: &Pose, d: &Self) -> ([f64; 3], [f64; 4]) {
        let vector = |v: [Real; 3]| DVec3::from(v.map(|v| v as f64));
        let parts = |[w, x, y, z]: [Real; 4]| (w as f64, vector([x, y, z]));
        let (centre, mut position, mut rotation) = (DVec3::from(pose.position), DVec3::ZERO, DVec3::ZERO);
        for (mean, d) in self.means.iter().zip(&d.means) {
            position -= vector(*d);
            rotation -= (vector(*mean) - centre).cross(vector(*d));
        }
        for (q, d) in self.quats.iter().zip(&d.quats) {
            let ((w, v), (d_w, d_v)) = (parts(*q), parts(*d));
            rotation -= 0.5 * (w * d_v - d_w * v + v.cross(d_v));
        }
        (position.into(), pose.rotation_vjp(rotation.into()))
    }
}

/// Splats with the signals of one or several transmitters, on an image plane.
#[derive(Clone, Copy, Debug)]
pub struct SignalSplats<'a> {
    /// Splats `[N]`.
    pub geometry: &'a Splats,
    /// Signals, row-major `[N, channels]`.
    pub signals: &'a [Real],
    /// Number of values per splat.
    pub channels: usize,
    /// Image plane.
    pub plane: &'a ImagePlane,
}

impl Splats {
    /// Returns the splats with `signals`, row-major `[N, channels]`, on an image plane.
    pub fn with_signals<'a>(&'a self, signals: &'a [Real], channels: usize, plane: &'a ImagePlane) -> SignalSplats<'a> {
        SignalSplats { geometry: self, signals, channels, plane }
    }

    /// Returns the number of Gaussians N.
    pub fn len(&self) -> usize {
        self.means2d.len()
    }

    /// Returns whether N = 0.
    pub fn is_empty(&self) -> bool {
        self.means2d.is_empty()
    }

    /// Creates N rows of zeros for gradients, without [`Self::existence`].
    pub fn zeros(n: usize) -> Self {
        Self {
            means2d: vec![[0.0; 2]; n],
            conics: vec![[0.0; 3]; n],
            depths: vec![0.0; n],
            sigmas2d: vec![[0.0; 2]; n],
            radii: vec![0.0; n],
            opacities: vec![0.0; n],
            existence: Vec::new(),
        }
    }

    /// Converts splats `[N]` of a whole image to the pixels of a `plane` that samples it ([`Sampling`]): centres,
    /// conics, standard deviations and radii change their unit.
    #[must_use]
    pub fn sampled(mut self, plane: &ImagePlane) -> Self {
        let Sampling { stride, offset, .. } = plane.sampling;
        if stride > 1 {
            let s = stride as Real;
            for mean in &mut self.means2d {
                *mean = [(mean[0] - offset[0] as Real) / s, (mean[1] - offset[1] as Real) / s];
                if plane.wraps && mean[0] < 0.0 {
                    // Columns before the offset are the last ones of the full circle.
                    mean[0] += plane.width as Real;
                }
            }
            self.conics.as_flattened_mut().iter_mut().for_each(|c| *c *= s * s);
            self.sigmas2d.as_flattened_mut().iter_mut().for_each(|v| *v /= s);
            self.radii.iter_mut().for_each(|r| *r = (*r / s).ceil());
        }
        self
    }

    /// Inverts [`Self::sampled`] `[N]` for the derivative of a projector, without [`Self::existence`]. Radii stay rounded up to
    /// whole strides, and centres that wrapped at the seam a full circle to the right.
    pub fn unsampled(&self, plane: &ImagePlane) -> Cow<'_, Self> {
        let Sampling { stride, offset, .. } = plane.sampling;
        if stride == 1 {
            return Cow::Borrowed(self);
        }
        let (s, [left, top]) = (stride as Real, offset.map(|v| v as Real));
        Cow::Owned(Self {
            means2d: self.means2d.iter().map(|[x, y]| [x * s + left, y * s + top]).collect(),
            conics: self.conics.iter().map(|conic| conic.map(|c| c / (s * s))).collect(),
            depths: self.depths.clone(),
            sigmas2d: self.sigmas2d.iter().map(|sigmas| sigmas.map(|v| v * s)).collect(),
            radii: self.radii.iter().map(|r| r * s).collect(),
            opacities: self.opacities.clone(),
            existence: Vec::new(),
        })
    }

    /// Returns the cotangents `[N]` of the splats on the whole image, given those of the splats on `plane`: the
    /// derivative of [`Self::sampled`]. With a stride above 1, columns without a derivative are empty.
    pub fn sampled_vjp(&self, plane: &ImagePlane) -> Cow<'_, Self> {
        let stride = plane.sampling.stride;
        if stride == 1 {
            return Cow::Borrowed(self);
        }
        let s = stride as Real;
        Cow::Owned(Self {
            means2d: self.means2d.iter().map(|mean| mean.map(|v| v / s)).collect(),
            conics: self.conics.iter().map(|conic| conic.map(|v| v * (s * s))).collect(),
            depths: self.depths.clone(),
            opacities: self.opacities.clone(),
            ..Self::default()
        })
    }
}
