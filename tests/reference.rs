//! The reference renders of WRF-GS, loss and every derivative, from one step of the training graph in compat mode.
//!
//! The references are double precision (a dense implementation elsewhere). In single precision the network's angles
//! 2⁹·x are known to 1e-3 rad only, and now and then a pixel crosses 1/255: tolerances of that build say so.
//! Their world-to-camera matrix is a rotation to 2.5e-8 only, which moves splats by 4e-5 px: the comparison in full
//! precision takes that matrix literally ([`Literal`]), and one with the pose and the plugin itself follows.

#[path = "common/npy.rs"]
mod npy;

use crate::common::{MOMENT, batch_at, plugin};
use npy::Reference;
use pwrfgs::core::{DeformationInputs, ExtraColumn, Mat3, MeasurementSetup, Origin, Vec3};
use pwrfgs::methods::{Calibration, Readout, Splatting};
use pwrfgs::prelude::*;
use pwrfgs::raster::{self, CameraModel, FullSphere, ViewTransform};
use pwrfgs::train::{Batch, LossAndGradients, RenderingLoss, loss_and_gradients};
use std::sync::Arc;

const DOUBLE: bool = size_of::<Real>() == 8;
const NAMES: [&str; 3] = ["n8", "n64", "n64_mask"];
/// λ is 0: the references' loss has no penalty.
const MASK: &str = "LearnableMask(lambda: 0)";

/// The released projection with a world-to-camera matrix taken as it is.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
struct Literal {
    /// First nine of a row-major 4 × 4 matrix and its translation.
    rows: [[Real; 4]; 3],
}

/// A camera model that stands where [`Literal`] says.
struct Placed {
    model: FullSphere,
    view: ViewTransform,
}

impl CameraModel for Placed {
    fn view(&self, _: &Pose) -> ViewTransform {
        self.view
    }
    fn depth(&self, mean: [Real; 3], _: &Pose) -> Real {
        (self.view.rotation * Vec3::from_array(mean) + self.view.offset).length()
    }
    fn is_visible(&self, v: Vec3) -> bool {
        self.model.is_visible(v)
    }
    fn pixel(&self, v: Vec3) -> [Real; 2] {
        self.model.pixel(v)
    }
    fn pixel_vjp(&self, v: Vec3, d: [Real; 2]) -> Vec3 {
        self.model.pixel_vjp(v, d)
    }
    fn jacobian(&self, v: Vec3) -> [Vec3; 2] {
        self.model.jacobian(v)
    }
    fn jacobian_vjp(&self, v: Vec3, d: [Vec3; 2]) -> Vec3 {
        self.model.jacobian_vjp(v, d)
    }
    fn blur(&self) -> Real {
        self.model.blur()
    }
    fn is_on_image(&self, centre: [Real; 2], cov: [Real; 3], radius: Real, plane: &ImagePlane) -> bool {
        self.model.is_on_image(centre, cov, radius, plane)
    }
}

impl Literal {
    fn placed(&self, plane: &ImagePlane) -> Placed {
        let column = |k: usize| Vec3::new(self.rows[0][k], self.rows[1][k], self.rows[2][k]);
        let view = ViewTransform { rotation: Mat3::from_cols(column(0), column(1), column(2)), offset: column(3) };
        Placed { model: FullSphere::new(plane), view }
    }
}

#[typetag::serde]
impl Projector for Literal {
    fn plane(&self, width: usize, height: usize) -> ImagePlane {
        plugin::<dyn Projector>("WrfgsCompat()").plane(width, height)
    }
    fn project(&self, p: &Primitives, pose: &Pose, plane: &ImagePlane) -> Splats {
        raster::project(&self.placed(plane), p, pose, plane)
    }
    fn project_vjp(&self, p: &Primitives, pose: &Pose, plane: &ImagePlane, splats: &Splats, d: &Splats) -> Primitives {
        raster::project_vjp(&self.placed(plane), p, pose, splats, d)
    }
}

/// What a reference render starts from.
struct Start {
    stages: Arc<Stages>,
    cloud: GaussianCloud,
    weights: Vec<Real>,
    batch: Batch,
    pruners: Vec<Plugin<dyn Pruner>>,
}

impl Start {
    fn of(reference: &Reference, projector: Plugin<dyn Projector>) -> Self {
        let deformation = plugin::<dyn Deformation>("Wrfgs()");
        let weights = deformation
            .layout()
            .weights
            .iter()
            .flat_map(|spec| reference.array(&format!("net_{}", spec.name)))
            .collect();
        let plane = projector.plane(360, 90);
        let splatting = Splatting {
            deformation,
            projector,
            rasterizer: plugin("AlphaBlending(support: TileSquares)"),
            calibration: Calibration::AsReleased,
            readout: Readout::Real,
        };
        let stages = Stages::new(splatting, MeasurementSetup::spectra(Origin::ZERO, pose(reference), plane));
        let means = reference.rows("in_xyz");
        let mask = reference.optional("in_mask_logit");
        let pruners = mask.iter().map(|_| plugin(MASK)).collect();
        let column = |values| ExtraColumn { name: "mask_logits".into(), width: 1, values };
        let cloud = GaussianCloud {
            signals: vec![[0.0; 2]; means.len()],
            means,
            log_scales: reference.rows("in_log_scale"),
            quats: reference.rows("in_quat"),
            opacity_logits: reference.array("in_opacity_logit"),
            extra: mask.map(column).into_iter().collect(),
        };
        let batch = batch_at(&reference.rows("in_tx"), reference.array("in_gt"), &stages);
        Self { stages: Arc::new(stages), cloud, weights, batch, pruners }
    }

    fn step(&self) -> LossAndGradients {
        let Self { stages, cloud, weights, batch, pruners } = self;
        loss_and_gradients(stages, cloud, &Arc::new(weights.clone()), batch, &RenderingLoss::new(0.2), pruners, &MOMENT)
            .unwrap()
    }

    /// The picture's stages by hand: what is projected, what it becomes, and what is blended (not clamped).
    fn draw(&self) -> (Primitives, Splats, Vec<Real>, Vec<Real>) {
        let splatting = self.stages.settings::<Splatting>().unwrap();
        let Splatting { deformation, projector, rasterizer, .. } = splatting;
        let (pose, plane) = (&self.stages.pose(), &self.stages.plane);
        let gate = self
            .pruners
            .first()
            .and_then(|p| p.gate(&TracedCloud::new(&self.cloud), &MOMENT))
            .map(|g| g.factor().as_vec());
        let activation = splatting.activation();
        let txs = self.batch.inputs.conditions();
        let deltas = deformation.forward(&DeformationInputs::new(&self.weights, &self.cloud.means, txs, pose), &None);
        let geometry = activation.geometry(&self.cloud, &deltas, 0, gate.as_deref());
        let splats = projector.project(&geometry, pose, plane);
        let render = rasterizer.forward(splats.with_signals(&activation.signals(&self.cloud, &deltas, 0..1), 1, plane));
        (geometry, splats, render.pixels, render.transmittance)
    }
}

/// The pose whose released projection has the reference's world-to-camera matrix: rotation Rᵀ, translation `r_o` itself.
fn pose(reference: &Reference) -> Pose {
    let m = reference.array("in_w2c");
    let position = reference.array("in_r_o");
    let (row, last) = (|i: usize| [m[4 * i], m[4 * i + 1], m[4 * i + 2]], [3, 7, 11].map(|k| m[k]));
    assert_eq!(last.to_vec(), position, "the released code takes the receiver's position for the translation");
    // Columns of R are the rows of Rᵀ.
    let rotation = Mat3::from_cols_array_2d(&[row(0), row(1), row(2)]);
    let orientation = crate::common::quaternion(&rotation);
    let pose = Pose { position: [0, 1, 2].map(|k| f64::from(position[k])), orientation };
    let found = pose.world_from_receiver().to_cols_array();
    let off = found.iter().zip(rotation.to_cols_array()).fold(0.0, |m: Real, (a, b)| m.max((a - b).abs()));
    assert!(off < 1e-6, "{found:?}");
    pose
}

/// Largest difference as a share of the largest number expected.
fn largest(found: &[Real], expected: &[Real]) -> Real {
    assert_eq!(found.len(), expected.len());
    let size = expected.iter().fold(1e-30, |m: Real, e| m.max(e.abs()));
    found.iter().zip(expected).fold(0.0, |m: Real, (f, e)| m.max((f - e).abs())) / size
}

/// Root mean square of the differences as a share of that of the numbers expected.
fn overall(found: &[Real], expected: &[Real]) -> Real {
    assert_eq!(found.len(), expected.len());
    let square = |x: Real| x * x;
    let of = expected.iter().map(|e| square(*e)).sum::<Real>().max(1e-30);
    (found.iter().zip(expected).map(|(f, e)| square(f - e)).sum::<Real>() / of).sqrt()
}

/// Prints and holds one comparison: `double` bounds the largest difference, `single` the overall one.
fn hold(what: &str, found: &[Real], expected: &[Real], double: Real, single: Real) {
    let (most, rms) = (largest(found, expected), overall(found, expected));
    println!("{what}: largest {most:.1e}, overall {rms:.1e}");
    let ok = if DOUBLE { most <= double } else { rms <= single };
    assert!(ok, "{what}: differs by {most:.2e} at most, {rms:.2e} overall");
}

/// Every reference at hand, and its start with the matrix taken literally.
fn references() -> impl Iterator<Item = (Reference, Start)> {
    NAMES.iter().filter_map(|name| Reference::open(name)).map(|reference| {
        let rows = reference.rows("in_w2c")[..3].try_into().unwrap();
        let literal: Box<dyn Projector> = Box::new(Literal { rows });
        let start = Start::of(&reference, literal.into());
        (reference, start)
    })
}

#[test]
fn splats_match_released_projection() {
    for (reference, start) in references() {
        let (_, splats, ..) = start.draw();
        let seen: Vec<Real> = splats.radii.iter().map(|r| Real::from(u8::from(*r > 0.0))).collect();
        assert_eq!(seen, reference.array("geo_visible"), "{}", reference.name);
        let rows: Vec<usize> = (0..seen.len()).filter(|&i| seen[i] > 0.0).collect();
        let held = |what: &str, found: Vec<Real>, width: usize, single: Real| {
            let expected = reference.array(what);
            let pick = |values: &[Real]| -> Vec<Real> {
                rows.iter().flat_map(|&i| values[i * width..(i + 1) * width].to_vec()).collect()
            };
            hold(&format!("{} {what}", reference.name), &pick(&found), &pick(&expected), 1e-14, single);
        };
        held("geo_pix", splats.means2d.as_flattened().to_vec(), 2, 2e-6);
        held("geo_conic", splats.conics.as_flattened().to_vec(), 3, 2e-6);
        held("geo_radius", splats.radii.clone(), 1, 2e-6);
        held("geo_depth", splats.depths.clone(), 1, 2e-6);
        let variances = splats.conics.iter().flat_map(|[a, b, c]| {
            let det = a * c - b * b;
            [c / det, -b / det, a / det]
        });
        held("geo_cov2d", variances.collect(), 3, 1e-4);
    }
}

#[test]
fn images_match_reference() {
    for (reference, start) in references() {
        let (geometry, _, pixels, transmittance) = start.draw();
        let name = &reference.name;
        hold(&format!("{name} out_opacity"), &geometry.opacities, &reference.array("out_opacity"), 1e-14, 1e-6);
        hold(&format!("{name} out_unclamped"), &pixels, &reference.array("out_unclamped"), 1e-12, 1e-2);
        hold(&format!("{name} out_T"), &transmittance, &reference.array("out_T"), 1e-12, 1e-3);
        let clamped: Vec<Real> = pixels.iter().map(|p| p.clamp(0.0, 1.0)).collect();
        hold(&format!("{name} out_image"), &clamped, &reference.array("out_image"), 1e-12, 1e-2);
    }
}

#[test]
fn loss_and_every_derivative_match_reference() {
    for (reference, start) in references() {
        let outcome = start.step();
        let name = &reference.name;
        hold(&format!("{name} loss"), &[outcome.loss], &[reference.number("loss")], 1e-12, 1e-5);
        let check = |what: &str, found: &[Real]| {
            hold(&format!("{name} {what}"), found, &reference.array(what), 1e-11, 5e-2);
        };
        let d = &outcome.d_cloud;
        check("grad_xyz", d.means.as_flattened());
        check("grad_log_scale", d.log_scales.as_flattened());
        check("grad_quat", d.quats.as_flattened());
        check("grad_opacity_logit", &d.opacity_logits);
        if let Some(mask) = d.extra("mask_logits") {
            check("grad_mask_logit", &mask.values);
        }
        let norms: Vec<Real> = reference.array("grad_ndc").chunks_exact(2).map(|d| d[0].hypot(d[1])).collect();
        hold(&format!("{name} grad_ndc"), &outcome.stats.gradient, &norms, 1e-11, 5e-2);
        assert_eq!(outcome.stats.visible, reference.array("geo_visible"), "{name}");
        assert!(d.signals.as_flattened().iter().all(|d| *d == 0.0), "the network replaces the cloud's signals");
        let mut rest = outcome.d_weights.as_slice();
        for spec in start.stages.layout().weights {
            let (these, after) = rest.split_at(spec.len());
            rest = after;
            check(&format!("gradnet_{}", spec.name), these);
        }
        assert!(rest.is_empty());
    }
}

#[test]
fn released_projection_matches_reference_to_pose_precision() {
    for (reference, literal) in references() {
        let (found, exact) = (Start::of(&reference, plugin("WrfgsCompat()")).step(), literal.step());
        let name = &reference.name;
        hold(&format!("{name} loss"), &[found.loss], &[reference.number("loss")], 1e-7, 1e-5);
        for ((column, _, found), (_, _, exact)) in found.d_cloud.columns().zip(exact.d_cloud.columns()) {
            hold(&format!("{name} derivative in {column}"), found, exact, 1e-4, 5e-2);
        }
        hold(&format!("{name} derivative in the network"), &found.d_weights, &exact.d_weights, 1e-4, 5e-2);
    }
}
