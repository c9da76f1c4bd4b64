//! `Pinhole`: the projector of camera images; slopes are linear in the pixel.

use crate::ewa::{self, CameraModel};
use pwrfgs_core::{Camera, Elevation, ImagePlane, JsonSchema, Misfit, Pose, Primitives, Projector, Real, Splats, Vec3};
use serde::{Deserialize, Serialize};

/// Image of a pinhole camera, for data with a camera such as `Colmap(..)`.
///
/// Focal lengths and principal point are those of the data, and the model file stores them. The receiver frame is that of the
/// camera: x points right, y down and z forward. A point (x, y, z) is at column fx·x/z + cx and row fy·y/z + cy of an image
/// whose upper left pixel covers (0, 0) to (1, 1). Each image has its own pose. Gaussians are blended in the order of their
/// distance from the camera. Pixels have no azimuth and elevation, so metrics of angles are `n/a`.
///
/// *Differentiable* in means, scales, rotations and opacities. *Discontinuous* if a Gaussian crosses `near_m`.
///
/// The covariance is that of the first-order image at the centre of the Gaussian. Far outside the image this image is
/// much too wide. The slopes x/z and y/z in its derivative are therefore limited at `margin` outside the image.
///
/// ```
/// use pwrfgs_core::{Plugin, Projector};
/// # use pwrfgs_raster as _;
/// Plugin::<dyn Projector>::parse("Pinhole(blur: 0.3, near_m: 0.2, margin: 0.15)").unwrap();
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Pinhole {
    /// Variance added to both diagonal entries of the 2-D covariance, px² of the whole image, independent of
    /// `training.stride`.
    pub blur: Real,
    /// Gaussians whose centre is less than this in front of the camera are not drawn, metres.
    pub near_m: Real,
    /// Distance outside the image from which the shape of a splat no longer changes, as a share of width and height.
    pub margin: Real,
}

impl Default for Pinhole {
    fn default() -> Self {
        Self { blur: 0.3, near_m: 0.2, margin: 0.15 }
    }
}

#[typetag::serde]
impl Projector for Pinhole {
    /// Returns the plane of a camera with a horizontal field of view of 90 degrees.
    fn plane(&self, width: usize, height: usize) -> ImagePlane {
        let centre = [width as f64 / 2.0, height as f64 / 2.0];
        let camera = Camera { focal: [centre[0]; 2], centre };
        ImagePlane { camera: Some(camera), ..ImagePlane::plain(width, height) }
    }

    fn plane_of(&self, _: usize, _: usize, _: Elevation) -> Result<ImagePlane, Misfit> {
        Err(Misfit::NoCamera)
    }

    fn plane_of_camera(&self, width: usize, height: usize, camera: Camera) -> Result<ImagePlane, Misfit> {
        let plane = ImagePlane { camera: Some(camera), ..ImagePlane::plain(width, height) };
        camera
            .fault()
            .map_or(Ok(plane), |why| Err(Misfit::Plugin(format!("plane: the projector does not support {why}"))))
    }

    fn project(&self, primitives: &Primitives, pose: &Pose, plane: &ImagePlane) -> Splats {
        ewa::project(&Lens::new(self, plane), primitives, pose, plane)
    }

    fn sees(&self, means: &[[Real; 3]], pose: &Pose, plane: &ImagePlane) -> Vec<bool> {
        ewa::visible_centres(&Lens::new(self, plane), means, pose)
    }

    fn project_vjp(&self, p: &Primitives, pose: &Pose, plane: &ImagePlane, splats: &Splats, d: &Splats) -> Primitives {
        ewa::project_vjp(&Lens::new(self, plane), p, pose, splats, d)
    }

    fn check(&self) -> Result<(), String> {
        ewa::check_blur(self.blur)?;
        if !(self.near_m > 0.0 && self.near_m.is_finite() && (0.0..=10.0).contains(&self.margin)) {
            return Err("`near_m` must be above 0 m and `margin` must lie between 0 and 10".into());
        }
        Ok(())
    }
}

/// Camera model with precomputed constants.
struct Lens {
    focal: [Real; 2],
    /// Column and row of the principal point; pixel centres have whole coordinates.
    centre: [Real; 2],
    /// Smallest and largest slopes x/z and y/z of the Jacobian.
    limits: [[Real; 2]; 2],
    blur: Real,
    near: Real,
}

impl Lens {
    /// Computes the constants for an image plane; without camera, those of focal lengths of 1 px and the corner as centre.
    fn new(plugin: &Pinhole, plane: &ImagePlane) -> Self {
        let Camera { focal, centre } = plane.camera.unwrap_or(Camera { focal: [1.0; 2], centre: [0.0; 2] });
        let (size, margin) = ([plane.width, plane.height], plugin.margin as f64);
        let slope = |k: usize, share: f64| ((share * size[k] as f64 - centre[k]) / focal[k]) as Real;
        Self {
            focal: focal.map(|f| f as Real),
            centre: centre.map(|c| (c - 0.5) as Real),
            limits: [-margin, 1.0 + margin].map(|share| [slope(0, share), slope(1, share)]),
            blur: plane.sampling.filter.unwrap_or(plugin.blur),
            near: plugin.near_m,
        }
    }

    /// Returns the slopes x/z and y/z of `v`, and the same limited at the margin.
    #[inline]
    fn slopes(&self, v: Vec3) -> [[Real; 2]; 2] {
        let ([low, high], slope) = (self.limits, [v.x / v.z, v.y / v.z]);
        [slope, [0, 1].map(|k| slope[k].max(low[k]).min(high[k]))]
    }

    /// Returns the rows of the derivative of the pixel at depth `z` (metres) and slopes x/z and y/z.
    #[inline]
    fn jacobian_rows(&self, z: Real, [across, down]: [Real; 2]) -> [Vec3; 2] {
        [Vec3::new(1.0, 0.0, -across) * (self.focal[0] / z), Vec3::new(0.0, 1.0, -down) * (self.focal[1] / z)]
    }
}

impl CameraModel for Lens {
    #[inline]
    fn is_visible(&self, v: Vec3) -> bool {
        v.z >= self.near
    }

    #[inline]
    fn pixel(&self, v: Vec3) -> [Real; 2] {
        let [slope, _] = self.slopes(v);
        [0, 1].map(|k| self.focal[k] * slope[k] + self.centre[k])
    }

    #[inline]
    fn pixel_vjp(&self, v: Vec3, d: [Real; 2]) -> Vec3 {
        let [slope, _] = self.slopes(v);
        let [column, row] = self.jacobian_rows(v.z, slope);
        column * d[0] + row * d[1]
    }

    #[inline]
    fn jacobian(&self, v: Vec3) -> [Vec3; 2] {
        let [_, limited] = self.slopes(v);
        self.jacobian_rows(v.z, limited)
    }

    #[inline]
    fn jacobian_vjp(&self, v: Vec3, d: [Vec3; 2]) -> Vec3 {
        let [slope, limited] = self.slopes(v);
        let mut out = Vec3::ZERO;
        for (k, along) in [d[0].x, d[1].y].into_iter().enumerate() {
            // f/z · (along − s d.z), with s constant outside the limits.
            let over = self.focal[k] / (v.z * v.z);
            out.z -= over * (along - limited[k] * d[k].z);
            if slope[k] == limited[k] {
                out[k] -= over * d[k].z;
                out.z += over * slope[k] * d[k].z;
            }
        }
        out
    }

    fn blur(&self) -> Real {
        self.blur
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ewa::tests::check_derivatives;
    use pwrfgs_core::Sampling;

    const CAMERA: Camera = Camera { focal: [80.0, 90.0], centre: [50.5, 38.0] };

    fn lens() -> Lens {
        let plugin = Pinhole::default();
        Lens::new(&plugin, &plugin.plane_of_camera(96, 72, CAMERA).unwrap())
    }

    #[test]
    fn pixels_follow_the_convention_of_colmap() {
        let lens = lens();
        // The optical axis is at (50.5, 38), the centre of column 50 and the upper edge of row 38.
        assert_eq!(lens.pixel(Vec3::Z * 2.0), [50.0, 37.5]);
        assert_eq!(lens.pixel(Vec3::new(0.5, -0.5, 2.0)), [70.0, 15.0]);
        // Stride and offset keep the camera, so that the whole image is projected.
        let plane = Pinhole::default().plane_of_camera(96, 72, CAMERA).unwrap();
        let part = ImagePlane { sampling: Sampling::every(3), ..plane.strided(3, [0, 0]) };
        assert_eq!((part.width, part.whole().into_owned()), (32, plane));
    }

    #[test]
    fn gaussians_behind_the_near_plane_are_not_drawn() {
        let z = [3.0, 0.21, 0.19, 0.0, -3.0];
        let p = Primitives {
            means: z.map(|z| [0.01, 0.02, z]).to_vec(),
            scales: vec![[0.1, 0.2, 0.05]; 5],
            quats: vec![[0.9, 0.1, 0.3, 0.2]; 5],
            opacities: vec![0.7; 5],
        };
        let projector = Pinhole::default();
        let plane = projector.plane_of_camera(96, 72, CAMERA).unwrap();
        let splats = projector.project(&p, &Pose::IDENTITY, &plane);
        assert_eq!(splats.radii.iter().map(|r| *r > 0.0).collect::<Vec<_>>(), [true, true, false, false, false]);
        assert_eq!(projector.sees(&p.means, &Pose::IDENTITY, &plane), [true, true, false, false, false]);
        let ones = Splats { means2d: vec![[1.0; 2]; 5], conics: vec![[1.0; 3]; 5], ..Splats::zeros(5) };
        let d = projector.project_vjp(&p, &Pose::IDENTITY, &plane, &splats, &ones);
        assert!(d.means[..2].iter().flatten().all(|v| v.is_finite() && *v != 0.0));
        assert!(d.means[2..].iter().chain(&d.scales[2..]).flatten().all(|v| *v == 0.0));
    }

    #[test]
    #[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
    fn derivatives_agree_with_differences_beyond_the_margin() {
        // Near the axis, near a corner, and outside the margin on one side and on both.
        for at in [[0.1, -0.2, 2.0], [1.4, 1.1, 2.5], [5.0, 0.3, 2.0], [-0.2, 8.0, 3.0], [-9.0, -7.0, 1.0]] {
            check_derivatives(&lens(), at.into());
        }
        let outside = lens().slopes(Vec3::new(5.0, 0.3, 2.0));
        assert!(outside[0][0] > outside[1][0] && outside[0][1] == outside[1][1], "{outside:?}");
    }

    #[test]
    fn invalid_cameras_and_data_without_camera_are_refused() {
        let plane = |camera| Pinhole::default().plane_of_camera(96, 72, camera).unwrap_err().to_string();
        assert!(plane(Camera { focal: [0.0, 1.0], ..CAMERA }).contains("give focal lengths above 0"));
        assert!(plane(Camera { centre: [f64::NAN, 1.0], ..CAMERA }).contains("principal point [NaN, 1.0]"));
        assert_eq!(Pinhole::default().plane_of(96, 72, Elevation::UPPER), Err(Misfit::NoCamera));
        assert_eq!(crate::Mercator::default().plane_of_camera(96, 72, CAMERA), Err(Misfit::CameraImages));
    }
}
