//! EWA projection: a 3D Gaussian becomes, to first order, a Gaussian on the image plane.
//!
//! With v = A x + t the centre in the receiver frame, π the camera model and J its Jacobian at v, Σ′ = J A Σ Aᵀ Jᵀ +
//! blur·I, Σ = R(q) S Sᵀ R(q)ᵀ (eq. 4), and the conic is Σ′⁻¹. A new projection needs three functions of
//! [`CameraModel`]: `pixel`, `jacobian` and `jacobian_vjp`. It is monomorphised into [`project`] and [`project_vjp`].

use pwrfgs_core::{ImagePlane, Mat3, Pose, Primitives, Real, Splats, Vec3};
use rayon::prelude::*;

/// Transformation to receiver coordinates v = `rotation` · x + `offset`.
#[derive(Clone, Copy, Debug)]
pub struct ViewTransform {
    /// Rotation `receiver_from_world`.
    pub rotation: Mat3,
    /// Offset, metres.
    pub offset: Vec3,
}

/// Distance in standard deviations at which the most opaque Gaussian falls below 1/255: √(2 ln 255); also in
/// `gpu/src/draw/project.wgsl`.
const REACH: Real = 3.329_042_1;

/// Projection of receiver coordinates (metres) to pixels: pixel position, its Jacobian J, and the derivative of J. The
/// other functions follow from these by default. They run once per Gaussian: use `#[inline]`.
pub trait CameraModel: Sync {
    /// Returns column and row of `v`.
    fn pixel(&self, v: Vec3) -> [Real; 2];

    /// Returns the rows of J used for the covariance, pixels per metre.
    fn jacobian(&self, v: Vec3) -> [Vec3; 2];

    /// Returns the cotangent of `v`, given that of [`Self::jacobian`].
    fn jacobian_vjp(&self, v: Vec3, d: [Vec3; 2]) -> Vec3;

    /// Returns the cotangent of `v`, given that of [`Self::pixel`]: Jᵀd if J is the derivative of the pixel everywhere.
    fn pixel_vjp(&self, v: Vec3, d: [Real; 2]) -> Vec3 {
        let [column, row] = self.jacobian(v);
        column * d[0] + row * d[1]
    }

    /// Returns the transformation from world coordinates to those of the model: the receiver frame, from its pose.
    fn view(&self, pose: &Pose) -> ViewTransform {
        let rotation = pose.world_from_receiver().transpose();
        ViewTransform { rotation, offset: -(rotation * pose.position_vec()) }
    }

    /// Returns the depth of a Gaussian with this mean, metres: the distance from the receiver. Computed in double
    /// precision and rounded once, so that rounding of `v` does not affect the depth order.
    fn depth(&self, mean: [Real; 3], pose: &Pose) -> Real {
        distance(mean, pose.position)
    }

    /// Returns whether a Gaussian centred at `v` is drawn: its pixel must be finite.
    fn is_visible(&self, v: Vec3) -> bool {
        self.pixel(v).iter().all(|x| x.is_finite())
    }

    /// Returns the variance added to both diagonal entries of Σ′, px², so that no splat is thinner than a pixel. 0.3,
    /// as in 3DGS.
    fn blur(&self) -> Real {
        0.3
    }

    /// Returns whether a splat reaches the image, that is, some pixel may have a γ of at least 1/255: `centre` in px,
    /// covariance `cov` (a, b, c) in px², `radius` in px. On an image that wraps, every column is inside. The default
    /// uses the covariance and ignores `radius`, which is for overrides.
    fn is_on_image(&self, centre: [Real; 2], cov: [Real; 3], radius: Real, plane: &ImagePlane) -> bool {
        let _ = radius;
        let inside = |at: Real, variance: Real, pixels: usize| {
            let half = REACH * variance.sqrt();
            at + half >= 0.0 && at - half <= pixels as Real - 1.0
        };
        (plane.wraps || inside(centre[0], cov[0], plane.width)) && inside(centre[1], cov[2], plane.height)
    }
}

/// Rejects a `blur` that is not positive and finite.
pub(crate) fn check_blur(blur: Real) -> Result<(), String> {
    let is_valid = blur > 0.0 && blur.is_finite();
    if is_valid { Ok(()) } else { Err("`blur` must be above 0 px²; give 0.3, for example".into()) }
}

/// Returns the distance of a mean from a position, metres, computed in double precision and rounded once.
pub(crate) fn distance(mean: [Real; 3], from: [f64; 3]) -> Real {
    let square = |k: usize| (mean[k] as f64 - from[k]).powi(2);
    (square(0) + square(1) + square(2)).sqrt() as Real
}

/// Intermediate values of one Gaussian for the forward and backward pass.
struct Projected {
    /// Centre in receiver coordinates, metres.
    v: Vec3,
    /// Rows of J A, the Jacobian by world coordinates.
    t: [Vec3; 2],
    /// Rows of J A R S, whose products are the covariance.
    u: [Vec3; 2],
    /// R.
    rotation: Mat3,
    /// R S.
    scaled: Mat3,
    /// Σ′ as (a, b, c), px², and its determinant.
    cov: [Real; 3],
    det: Real,
}

/// Projects Gaussian `i`: centre, square root of the covariance on the image, and covariance.
fn project_gaussian(model: &impl CameraModel, view: &ViewTransform, p: &Primitives, i: usize) -> Projected {
    let v = view.rotation * Vec3::from_array(p.means[i]) + view.offset;
    let rotation = rotation_matrix(p.quats[i]);
    let [sx, sy, sz] = p.scales[i];
    let scaled = Mat3::from_cols(rotation.x_axis * sx, rotation.y_axis * sy, rotation.z_axis * sz);
    let to_world = view.rotation.transpose();
    let [column, row] = model.jacobian(v);
    let t = [to_world * column, to_world * row];
    let m = scaled.transpose();
    let u = [m * t[0], m * t[1]];
    let blur = model.blur();
    let (aa, bb, cc) = (u[0].dot(u[0]), u[0].dot(u[1]), u[1].dot(u[1]));
    // Sum of squares: a·c − b² would cancel for long thin splats.
    let cross = u[0].cross(u[1]);
    let det = cross.dot(cross) + blur * (aa + cc) + blur * blur;
    Projected { v, t, u, rotation, scaled, cov: [aa + blur, bb, cc + blur], det }
}

/// Returns the radius of three standard deviations along the longest axis, pixels, rounded up, as in 3DGS.
fn splat_radius([a, _, c]: [Real; 3], det: Real) -> Real {
    let mid = 0.5 * (a + c);
    (3.0 * (mid + (mid * mid - det).max(0.1).sqrt()).sqrt()).ceil()
}

/// Projects all primitives to splats, row for row; those that are not drawn have radius 0.
pub fn project(model: &impl CameraModel, p: &Primitives, pose: &Pose, plane: &ImagePlane) -> Splats {
    let n = p.len();
    let view = model.view(pose);
    let mut out = Splats::zeros(n);
    let rows = (out.means2d.par_iter_mut())
        .zip(out.conics.par_iter_mut())
        .zip(out.depths.par_iter_mut())
        .zip(out.sigmas2d.par_iter_mut())
        .zip(out.radii.par_iter_mut())
        .zip(out.opacities.par_iter_mut());
    rows.enumerate().with_min_len(256).for_each(|(i, (((((mean, conic), depth), sigma), radius), opacity))| {
        let g = project_gaussian(model, &view, p, i);
        *opacity = p.opacities[i];
        *depth = model.depth(p.means[i], pose);
        if !(model.is_visible(g.v) && g.det > 0.0 && g.det.is_finite()) {
            return;
        }
        let [a, b, c] = g.cov;
        *mean = model.pixel(g.v);
        *conic = [c / g.det, -b / g.det, a / g.det];
        *sigma = [a.sqrt(), c.sqrt()];
        let r = splat_radius(g.cov, g.det);
        if r.is_finite()
            && mean.iter().chain(conic.iter()).all(|x| x.is_finite())
            && model.is_on_image(*mean, g.cov, r, plane)
        {
            *radius = r;
        }
    });
    out
}

/// Returns whether the centre of each Gaussian is in view, given the means `[N,3]`; the image may still miss it.
pub fn visible_centres(model: &impl CameraModel, means: &[[Real; 3]], pose: &Pose) -> Vec<bool> {
    let view = model.view(pose);
    means.iter().map(|x| model.is_visible(view.rotation * Vec3::from_array(*x) + view.offset)).collect()
}

/// Returns the cotangents of the primitives, given the result of [`project`] and its cotangents `d`; zeros for Gaussians
/// with radius 0.
pub fn project_vjp(model: &impl CameraModel, p: &Primitives, pose: &Pose, splats: &Splats, d: &Splats) -> Primitives {
    let view = model.view(pose);
    let mut out = Primitives::zeros(p.len());
    let rows = (out.means.par_iter_mut())
        .zip(out.scales.par_iter_mut())
        .zip(out.quats.par_iter_mut())
        .zip(out.opacities.par_iter_mut());
    rows.enumerate().with_min_len(256).for_each(|(i, (((mean, scale), quat), opacity))| {
        if splats.radii[i] == 0.0 {
            return;
        }
        *opacity = d.opacities[i];
        let g = project_gaussian(model, &view, p, i);
        let [d_a, d_b, d_c] = symmetric_inverse_vjp(splats.conics[i], d.conics[i]);
        let d_u = [g.u[0] * (2.0 * d_a) + g.u[1] * d_b, g.u[1] * (2.0 * d_c) + g.u[0] * d_b];
        let d_j = [view.rotation * (g.scaled * d_u[0]), view.rotation * (g.scaled * d_u[1])];
        let d_v =
            model.jacobian_vjp(g.v, d_j) + model.pixel_vjp(g.v, d.means2d[i]) + g.v * (d.depths[i] / g.v.length());
        *mean = (view.rotation.transpose() * d_v).to_array();
        // uᵣ = Mᵀ tᵣ with M = R S: column k of ∂L/∂M is Σᵣ tᵣ (∂L/∂uᵣ)ₖ.
        let d_m = Mat3::from_cols(
            g.t[0] * d_u[0].x + g.t[1] * d_u[1].x,
            g.t[0] * d_u[0].y + g.t[1] * d_u[1].y,
            g.t[0] * d_u[0].z + g.t[1] * d_u[1].z,
        );
        *scale =
            [g.rotation.x_axis.dot(d_m.x_axis), g.rotation.y_axis.dot(d_m.y_axis), g.rotation.z_axis.dot(d_m.z_axis)];
        let [sx, sy, sz] = p.scales[i];
        *quat = rotation_matrix_vjp(p.quats[i], Mat3::from_cols(d_m.x_axis * sx, d_m.y_axis * sy, d_m.z_axis * sz));
    });
    out
}

/// Returns the cotangents of (a, b, c) of a symmetric matrix, given its inverse (A, B, C) and the cotangents of the
/// inverse.
#[inline]
pub(crate) fn symmetric_inverse_vjp([a, b, c]: [Real; 3], [d_a, d_b, d_c]: [Real; 3]) -> [Real; 3] {
    let h = 0.5 * d_b;
    // −Q G Q with Q the conic and G the symmetric cotangent.
    let (p, q, r, s) = (a * d_a + b * h, a * h + b * d_c, b * d_a + c * h, b * h + c * d_c);
    [-(p * a + q * b), -((p * b + q * c) + (r * a + s * b)), -(r * b + s * c)]
}

/// Returns the rotation matrix of a quaternion w, x, y, z by the formula for unit quaternions, whatever its length (as
/// released).
fn rotation_matrix([w, x, y, z]: [Real; 4]) -> Mat3 {
    Mat3::from_cols_array(&[
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y + w * z),
        2.0 * (x * z - w * y),
        2.0 * (x * y - w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z + w * x),
        2.0 * (x * z + w * y),
        2.0 * (y * z - w * x),
        1.0 - 2.0 * (x * x + y * y),
    ])
}

/// Returns the cotangent of the quaternion, given that of [`rotation_matrix`].
fn rotation_matrix_vjp([w, x, y, z]: [Real; 4], d: Mat3) -> [Real; 4] {
    let (c0, c1, c2) = (d.x_axis, d.y_axis, d.z_axis); // cᵢ is column i: cᵢ.y is row 1
    [
        2.0 * (z * (c0.y - c1.x) + y * (c2.x - c0.z) + x * (c1.z - c2.y)),
        2.0 * (y * (c1.x + c0.y) + z * (c2.x + c0.z) + w * (c1.z - c2.y) - 2.0 * x * (c1.y + c2.z)),
        2.0 * (x * (c1.x + c0.y) + z * (c2.y + c1.z) + w * (c2.x - c0.z) - 2.0 * y * (c0.x + c2.z)),
        2.0 * (x * (c2.x + c0.z) + y * (c2.y + c1.z) + w * (c0.y - c1.x) - 2.0 * z * (c0.x + c1.y)),
    ]
}

#[cfg(test)]
pub(crate) mod tests {
    use super::{CameraModel, Real, Vec3};
    use pwrfgs_core::testing::check_vjp;

    /// Compares the derivatives of the pixel and of the Jacobian at `v` with central differences.
    pub(crate) fn check_derivatives(model: &impl CameraModel, v: Vec3) {
        let flat = |j: [Vec3; 2]| [j[0].to_array(), j[1].to_array()].concat();
        check_vjp(
            "pixel",
            &v.to_array(),
            |x| model.pixel(Vec3::from_slice(x)).to_vec(),
            |x, d| model.pixel_vjp(Vec3::from_slice(x), [d[0], d[1]]).to_array().to_vec(),
            1e-7,
            1e-5,
        );
        check_vjp(
            "jacobian",
            &v.to_array(),
            |x| flat(model.jacobian(Vec3::from_slice(x))),
            |x: &[Real], d| {
                let d = [Vec3::from_slice(&d[..3]), Vec3::from_slice(&d[3..])];
                model.jacobian_vjp(Vec3::from_slice(x), d).to_array().to_vec()
            },
            1e-7,
            1e-5,
        );
    }
}
