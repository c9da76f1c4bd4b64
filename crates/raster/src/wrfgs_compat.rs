//! `WrfgsCompat`: the projection of the released WRF-GS code, including its errors.

use crate::ewa::{self, CameraModel, ViewTransform};
use crate::tiles::square_tiles;
use pwrfgs_core::{ImagePlane, JsonSchema, Pose, Primitives, Projector, Real, Splats, Vec3, consts::PI};
use serde::{Deserialize, Serialize};

/// The released WRF-GS projection, for comparison with published code only.
///
/// It differs from [`crate::Mercator`] in its geometry:
///
/// - The position of the receiver is used as the translation of the camera (`v = Rᵀx + r_o`), so that the centre is at
///   `-R r_o`.
/// - The polar axis is the y axis of the receiver.
/// - The rows cover the *full* sphere (2° per row for 90 rows).
/// - Azimuth does not wrap around.
///
/// Pixels have no angle in the receiver frame; plugins that need angles reject this image plane. Combine it with
/// `AlphaBlending(support: TileSquares)` and `calibration: AsReleased`.
///
/// ```
/// use pwrfgs_core::{Plugin, Projector};
/// # use pwrfgs_raster as _;
/// Plugin::<dyn Projector>::parse("WrfgsCompat()").unwrap();
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WrfgsCompat {}

#[typetag::serde]
impl Projector for WrfgsCompat {
    fn plane(&self, width: usize, height: usize) -> ImagePlane {
        ImagePlane::plain(width, height)
    }

    fn project(&self, primitives: &Primitives, pose: &Pose, plane: &ImagePlane) -> Splats {
        ewa::project(&FullSphere::new(plane), primitives, pose, plane)
    }

    fn sees(&self, means: &[[Real; 3]], pose: &Pose, plane: &ImagePlane) -> Vec<bool> {
        ewa::visible_centres(&FullSphere::new(plane), means, pose)
    }

    fn project_vjp(&self, p: &Primitives, pose: &Pose, plane: &ImagePlane, splats: &Splats, d: &Splats) -> Primitives {
        ewa::project_vjp(&FullSphere::new(plane), p, pose, splats, d)
    }
}

/// Constant that the released kernel adds to denominators.
const EPS: Real = 1e-7;
/// Square of the distance up to which the released code draws no Gaussian, 0.2 m; m².
const NEAREST2: Real = 0.04;
/// Lower limit of squares that vanish on the polar axis, where angles have no derivative.
const LEAST: Real = 1e-14;

/// Camera model of [`WrfgsCompat`]: longitude about the y axis of the receiver, full sphere on the image.
#[derive(Clone, Copy, Debug)]
pub struct FullSphere {
    width: Real,
    height: Real,
}

impl FullSphere {
    /// Creates the camera model for an image plane.
    pub fn new(plane: &ImagePlane) -> Self {
        Self { width: plane.width as Real, height: plane.height as Real }
    }
}

impl CameraModel for FullSphere {
    fn view(&self, pose: &Pose) -> ViewTransform {
        ViewTransform { rotation: pose.world_from_receiver().transpose(), offset: pose.position_vec() }
    }

    /// Returns the distance from −R·r, where v is 0.
    fn depth(&self, mean: [Real; 3], pose: &Pose) -> Real {
        ewa::distance(mean, pose.turned(pose.position).map(|v| -v))
    }

    #[inline]
    fn is_visible(&self, v: Vec3) -> bool {
        v.length_squared() > NEAREST2
    }

    #[inline]
    fn pixel(&self, v: Vec3) -> [Real; 2] {
        let longitude = v.x.atan2(v.z);
        let latitude = (v.y / (v.length() + EPS)).clamp(-1.0, 1.0).asin();
        [((longitude / PI + 1.0) * self.width - 1.0) / 2.0, ((2.0 * latitude / PI + 1.0) * self.height - 1.0) / 2.0]
    }

    #[inline]
    fn pixel_vjp(&self, v: Vec3, d: [Real; 2]) -> Vec3 {
        let (rho2, r) = (v.x * v.x + v.z * v.z, v.length());
        let longitude = Vec3::new(v.z, 0.0, -v.x) / rho2.max(LEAST);
        let sine = v.y / (r + EPS);
        let d_sine = (Vec3::Y - v * (sine / r)) / (r + EPS);
        let latitude = d_sine / (1.0 - sine * sine).max(LEAST).sqrt();
        longitude * (d[0] * self.width / (2.0 * PI)) + latitude * (d[1] * self.height / PI)
    }

    #[inline]
    fn jacobian(&self, v: Vec3) -> [Vec3; 2] {
        let [rho, a, p, q] = guarded_reciprocals(v);
        [
            Vec3::new(v.z * a, 0.0, -v.x * a) * (self.width / (2.0 * PI)),
            Vec3::new(-v.x * v.y * p * q, rho * q, -v.z * v.y * p * q) * (self.height / PI),
        ]
    }

    #[inline]
    fn jacobian_vjp(&self, v: Vec3, d: [Vec3; 2]) -> Vec3 {
        let [rho, a, p, q] = guarded_reciprocals(v);
        let level = Vec3::new(v.x, 0.0, v.z);
        let d_rho = level / rho.max(Real::MIN_POSITIVE);
        // (z dx − x dz) a
        let g = v.z * d[0].x - v.x * d[0].z;
        let around = Vec3::new(-d[0].z, 0.0, d[0].x) * a - level * (2.0 * g * a * a);
        // −y h p q + ρ dy q with h = x dx + z dz.
        let h = v.x * d[1].x + v.z * d[1].z;
        let d_h = Vec3::new(d[1].x, 0.0, d[1].z);
        let up = (Vec3::Y * h + d_h * v.y) * (-p * q)
            + d_rho * (v.y * h * p * p * q + d[1].y * q)
            + v * (2.0 * (v.y * h * p - rho * d[1].y) * q * q);
        around * (self.width / (2.0 * PI)) + up * (self.height / PI)
    }

    #[inline]
    fn is_on_image(&self, centre: [Real; 2], _cov: [Real; 3], radius: Real, plane: &ImagePlane) -> bool {
        let (columns, rows) = square_tiles(centre, radius, plane);
        !columns.is_empty() && !rows.is_empty()
    }
}

/// Returns ρ = √(x² + z²), and the reciprocals of ρ², ρ and |v|² with the guards of the released kernel.
fn guarded_reciprocals(v: Vec3) -> [Real; 4] {
    let rho2 = v.x * v.x + v.z * v.z;
    let rho = rho2.sqrt();
    [rho, 1.0 / (rho2 + EPS), 1.0 / (rho + EPS), 1.0 / (v.length_squared() + EPS)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_project_as_in_released_code() {
        let model = FullSphere { width: 360.0, height: 90.0 };
        let near = |a: Real, b: Real, tolerance: Real| assert!((a - b).abs() < tolerance, "{a} is not {b}");
        let [x, y] = model.pixel(Vec3::Z);
        near(x, 179.5, 1e-4);
        near(y, 44.5, 1e-4);
        near(model.pixel(Vec3::X)[0], 269.5, 1e-4);
        near(model.pixel(Vec3::Y)[1], 89.487, 2e-2);
    }
}
