//! `Mercator`: the projector of the paper; azimuth and elevation are linear in the pixel.

use crate::ewa::{self, CameraModel};
use crate::tiles::nearest_first;
use pwrfgs_core::{
    Elevation, ImagePlane, JsonSchema, Misfit, Pose, Primitives, Projector, Real, Splats, Vec3, consts::DEG,
};
use serde::{Deserialize, Serialize};

/// Lower limit of cos(elevation) in the Jacobian: cos 89.5°. `gpu/src/draw/project.wgsl` has the same limits.
const COS_FLOOR: Real = 0.008_726_535_498_373_935;
/// Smallest ratio of distance from the axis to range for which azimuth is defined; below it azimuth is 0.
const ON_AXIS: Real = 1e-6;

/// Equirectangular image of the hemisphere in front of the receiver, the paper's «Mercator» projection. If the data
/// define other elevations, the image covers those, also behind the receiver.
///
/// Column c is azimuth c·360/W degrees; row r is elevation r·90/H degrees above the array plane. The measured 360 × 90
/// spectra have one degree per pixel: row 0 is the horizon of the array, row 89 is almost its boresight. The projector
/// uses the true pose of the receiver. Azimuth wraps around: a splat at the seam is drawn once on both sides of it.
///
/// *Differentiable* in means, scales, rotations and opacities. *Discontinuous* if a Gaussian crosses `near_m`, the
/// margin, or the axis of the array.
///
/// # Near the zenith
/// The measured line of sight has an elevation of 70 to 81 degrees. A linear map of a sphere onto a plane stretches
/// azimuth by 1/cos(elevation). This factor is limited at cos 89.5°, and its derivative includes the limit; a splat
/// wider than the circle covers every column once. The table compares the first-order image of a round Gaussian of 5°
/// (opacity 0.99, a single splat) with the exact one on the sphere, exp(-angle²/(2·5²)). The relative error is the mean
/// of |difference| divided by the mean of the exact image, both weighted by cos(elevation):
///
/// | elevation of the centre | relative error | largest error |
/// |---|---|---|
/// | 45° | 0.041 | 0.022 |
/// | 75° | 0.134 | 0.090 |
/// | 88° | 0.292 | 0.384 |
///
/// (The test `relative_error_near_zenith_matches_documented_table` prints and checks these values.)
///
/// ```
/// use pwrfgs_core::{Plugin, Projector};
/// # use pwrfgs_raster as _;
/// Plugin::<dyn Projector>::parse("Mercator(blur: 0.3, near_m: 0.2, margin_deg: 15)").unwrap();
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Mercator {
    /// Variance added to both diagonal entries of the 2-D covariance, px² of the whole spectrum, independent of
    /// `training.stride`. `readout: ReceivedPower` has its own filter.
    pub blur: Real,
    /// Gaussians nearer to the receiver than this are not drawn, metres.
    pub near_m: Real,
    /// Gaussians centred further below the horizon than this are not drawn, degrees.
    pub margin_deg: Real,
}

impl Default for Mercator {
    fn default() -> Self {
        Self { blur: 0.3, near_m: 0.2, margin_deg: 15.0 }
    }
}

#[typetag::serde]
impl Projector for Mercator {
    fn plane(&self, width: usize, height: usize) -> ImagePlane {
        ImagePlane::around(width, height, Elevation::UPPER)
    }

    fn plane_of(&self, width: usize, height: usize, elevation: Elevation) -> Result<ImagePlane, Misfit> {
        Ok(ImagePlane::around(width, height, elevation))
    }

    fn project(&self, primitives: &Primitives, pose: &Pose, plane: &ImagePlane) -> Splats {
        ewa::project(&Hemisphere::new(self, plane), primitives, pose, plane)
    }

    fn sees(&self, means: &[[Real; 3]], pose: &Pose, plane: &ImagePlane) -> Vec<bool> {
        ewa::visible_centres(&Hemisphere::new(self, plane), means, pose)
    }

    fn project_vjp(&self, p: &Primitives, pose: &Pose, plane: &ImagePlane, splats: &Splats, d: &Splats) -> Primitives {
        ewa::project_vjp(&Hemisphere::new(self, plane), p, pose, splats, d)
    }

    fn check(&self) -> Result<(), String> {
        ewa::check_blur(self.blur)?;
        let is_length = self.near_m.is_finite() && self.near_m >= 0.0;
        if !is_length || !(0.0..=90.0).contains(&self.margin_deg) {
            return Err("`near_m` must not be negative and `margin_deg` must lie between 0 and 90".into());
        }
        Ok(())
    }
}

impl Mercator {
    /// Returns the constants of the projection to a whole image, in the order of `gpu/src/draw/project.wgsl`: the rotation
    /// `receiver_from_world` row by row (9), the offset (3, metres), columns and rows per radian, columns, rows between
    /// elevation 0 and row 0, filter (px²), nearest distance (metres), and the sine of the lowest elevation.
    pub fn constants(&self, pose: &Pose, plane: &ImagePlane) -> [Real; 19] {
        let model = Hemisphere::new(self, plane);
        let (view, [across, up]) = (model.view(pose), model.per_radian);
        let mut constants = [0.0; 19];
        constants[..9].copy_from_slice(&view.rotation.transpose().to_cols_array());
        constants[9..12].copy_from_slice(&view.offset.to_array());
        let scalars = [across, up, model.width, model.above, model.blur, model.near, model.lowest];
        constants[12..].copy_from_slice(&scalars);
        constants
    }

    /// Returns the indices of means `[N,3]` in the order of blending: nearest to the receiver first.
    pub fn depth_order(means: &[[Real; 3]], pose: &Pose) -> Vec<u32> {
        nearest_first(means.iter().map(|mean| ewa::distance(*mean, pose.position)).zip(0..))
    }
}

/// Camera model with precomputed constants.
struct Hemisphere {
    /// Columns and rows per radian.
    per_radian: [Real; 2],
    width: Real,
    /// Number of rows between elevation 0 and row 0.
    above: Real,
    blur: Real,
    near: Real,
    /// Sine of the lowest drawn elevation.
    lowest: Real,
}

impl Hemisphere {
    /// Computes the constants for an image plane.
    fn new(plugin: &Mercator, plane: &ImagePlane) -> Self {
        let Elevation { first, last } = plane.elevation().unwrap_or(Elevation::UPPER);
        let per_radian = [plane.width as Real / 360.0 * DEG, plane.height as Real / (last - first) as Real * DEG];
        let below = plugin.margin_deg - first.min(last) as Real;
        let lowest = if below < 90.0 { -(below / DEG).sin() } else { -2.0 }; // below every sine
        let above = first as Real / DEG * per_radian[1];
        let blur = plane.sampling.filter.unwrap_or(plugin.blur);
        Self { per_radian, width: plane.width as Real, above, blur, near: plugin.near_m, lowest }
    }
}

/// Returns the distances of `v` from the axis and from the receiver, metres, and whether its azimuth is defined.
fn axial_distances(v: Vec3) -> (Real, Real, bool) {
    let (rho, r) = ((v.x * v.x + v.y * v.y).sqrt(), v.length());
    (rho, r, rho > ON_AXIS * r)
}

impl CameraModel for Hemisphere {
    #[inline]
    fn is_visible(&self, v: Vec3) -> bool {
        let r = v.length();
        r > self.near && r > 0.0 && v.z >= self.lowest * r
    }

    #[inline]
    fn pixel(&self, v: Vec3) -> [Real; 2] {
        let (rho, _, off_axis) = axial_distances(v);
        let elevation = v.z.atan2(if off_axis { rho } else { 0.0 }) * self.per_radian[1] - self.above;
        let column = if off_axis { v.y.atan2(v.x) * self.per_radian[0] } else { 0.0 };
        let column = if column < 0.0 { column + self.width } else { column };
        [if column >= self.width { 0.0 } else { column }, elevation]
    }

    #[inline]
    fn pixel_vjp(&self, v: Vec3, d: [Real; 2]) -> Vec3 {
        let (rho, r, off_axis) = axial_distances(v);
        if !off_axis {
            return Vec3::ZERO;
        }
        let (rho2, r2) = (rho * rho, r * r);
        let around = Vec3::new(-v.y, v.x, 0.0) / rho2;
        let up = Vec3::new(-v.z * v.x / rho, -v.z * v.y / rho, rho) / r2;
        around * (d[0] * self.per_radian[0]) + up * (d[1] * self.per_radian[1])
    }

    #[inline]
    fn jacobian(&self, v: Vec3) -> [Vec3; 2] {
        let (rho, r, off_axis) = axial_distances(v);
        if !off_axis {
            // On the axis azimuth counts as 0: columns vary along y, and rows along x.
            let rows = [Vec3::Y / COS_FLOOR, -Vec3::X * v.z.signum()];
            return [rows[0] * (self.per_radian[0] / r), rows[1] * (self.per_radian[1] / r)];
        }
        let around = Vec3::new(-v.y, v.x, 0.0) / (rho * rho.max(COS_FLOOR * r));
        let up = Vec3::new(-v.z * v.x / rho, -v.z * v.y / rho, rho) / (r * r);
        [around * self.per_radian[0], up * self.per_radian[1]]
    }

    #[inline]
    fn jacobian_vjp(&self, v: Vec3, d: [Vec3; 2]) -> Vec3 {
        let (rho, r, off_axis) = axial_distances(v);
        let [kx, ky] = self.per_radian;
        let (r2, r3) = (r * r, r * r * r);
        if !off_axis {
            return v * ((ky * v.z.signum() * d[1].x - kx / COS_FLOOR * d[0].y) / r3);
        }
        let rho2 = rho * rho;
        let g = v.x * d[0].y - v.y * d[0].x;
        let d_g = Vec3::new(d[0].y, -d[0].x, 0.0);
        let d_rho = Vec3::new(v.x, v.y, 0.0) / rho;
        let d_r = v / r;
        let around = if rho >= COS_FLOOR * r {
            d_g / rho2 - d_rho * (2.0 * g / (rho2 * rho))
        } else {
            (d_g / (rho * r) - d_rho * (g / (rho2 * r)) - d_r * (g / (rho * r2))) / COS_FLOOR
        };
        // −z h/(ρ r²) + ρ dz/r² with h = x dx + y dy.
        let h = v.x * d[1].x + v.y * d[1].y;
        let d_h = Vec3::new(d[1].x, d[1].y, 0.0);
        let up = (Vec3::Z * h + d_h * v.z) * (-1.0 / (rho * r2))
            + d_rho * (v.z * h / (rho2 * r2) + d[1].z / r2)
            + d_r * (2.0 * v.z * h / (rho * r3) - 2.0 * rho * d[1].z / r3);
        around * kx + up * ky
    }

    fn blur(&self) -> Real {
        self.blur
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ewa::tests::check_derivatives;

    fn model() -> Hemisphere {
        of((0.0, 90.0)).1
    }

    /// Creates a plane of one degree per pixel.
    fn of(elevation: (f64, f64)) -> (ImagePlane, Hemisphere) {
        let plugin = Mercator::default();
        let plane = plugin.plane_of(360, (elevation.1 - elevation.0).abs() as usize, elevation.into()).unwrap();
        let model = Hemisphere::new(&plugin, &plane);
        (plane, model)
    }

    #[test]
    fn planes_below_horizon_show_gaussians_behind() {
        for elevation in [(-90.0, 90.0), (90.0, -90.0), (-30.0, 60.0)] {
            let (plane, model) = of(elevation);
            for (px, py) in [(33.0, 15.0), (359.0, 70.0), (180.0, 89.0)] {
                let v = Vec3::from_array(plane.direction(px, py).unwrap()) * 3.0;
                let [x, y] = model.pixel(v);
                assert!(
                    (x - px).abs() < 2e-3 && (y - py).abs() < 1e-3,
                    "{elevation:?}: ({px}, {py}) became ({x}, {y})"
                );
                assert!(model.is_visible(v));
            }
            let straight_back = Vec3::new(0.1, 0.0, -3.0);
            assert_eq!(model.is_visible(straight_back), elevation.0.min(elevation.1) < -60.0);
        }
    }

    #[test]
    fn mercator_pixel_spans_one_degree() {
        let plane = Mercator::default().plane(360, 90);
        for (az, el) in [(0.0, 0.0), (33.0, 45.0), (359.0, 10.0), (180.0, 89.0)] {
            let v = Vec3::from_array(plane.direction(az, el).unwrap()) * 3.0;
            let [px, py] = model().pixel(v);
            let around = (px - az).abs().min(360.0 - (px - az).abs());
            assert!(around < 2e-3 && (py - el).abs() < 1e-4, "({az}, {el}) became ({px}, {py})");
        }
    }

    #[test]
    #[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
    fn derivatives_agree_with_differences_up_to_the_zenith() {
        // Elevations of 10°, 45°, 88°, and 89.7° (inside the limit); also behind the receiver, and with the zenith in
        // row 0.
        let up = |el| (el, (0.0, 90.0));
        for (el, elevation) in [up(10.0), up(45.0), up(88.0), up(89.7), (-45.0, (-90.0, 90.0)), (-88.0, (90.0, -90.0))]
        {
            let v = Vec3::from_array(Mercator::default().plane(360, 90).direction(37.0, el).unwrap()) * 4.0;
            check_derivatives(&of(elevation).1, v);
        }
    }

    #[test]
    fn projection_is_finite_on_axis_and_at_receiver() {
        for v in [Vec3::Z * 3.0, Vec3::ZERO, Vec3::new(1e-9, 0.0, 2.0), -Vec3::Z] {
            let p = Primitives {
                means: vec![v.to_array()],
                scales: vec![[0.3, 0.2, 0.1]],
                quats: vec![[0.9, 0.1, 0.3, 0.2]],
                opacities: vec![0.7],
            };
            let projector = Mercator::default();
            let plane = projector.plane(360, 90);
            let splats = projector.project(&p, &Pose::IDENTITY, &plane);
            let mut d = Splats::zeros(1);
            d.means2d[0] = [1.0, -2.0];
            d.conics[0] = [0.5, 0.4, 0.3];
            d.opacities[0] = 1.0;
            let g = projector.project_vjp(&p, &Pose::IDENTITY, &plane, &splats, &d);
            let all = [splats.means2d.as_flattened(), splats.conics.as_flattened(), g.means.as_flattened()];
            assert!(all.iter().all(|c| c.iter().all(|x| x.is_finite())), "{v}: {splats:?} {g:?}");
            assert!(g.scales.as_flattened().iter().chain(g.quats.as_flattened()).all(|x| x.is_finite()));
        }
    }
}
