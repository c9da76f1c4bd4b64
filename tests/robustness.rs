//! NaN and infinite numbers, and clouds of no and of one Gaussian: no panic, and other Gaussians keep their results.

use crate::common::{MOMENT, batch, cloud, plugin, stages, with_column};
use proptest::prelude::*;
use pwrfgs::core::{Query, rng};
use pwrfgs::methods::{Readout, Splatting};
use pwrfgs::prelude::*;
use pwrfgs::train::{RenderingLoss, loss_and_gradients};
use std::sync::Arc;

const N: usize = 6;

/// What goes wrong with a number.
const ODD: [Real; 9] =
    [Real::NAN, Real::INFINITY, Real::NEG_INFINITY, 0.0, -0.0, 1e30, -1e30, Real::MIN_POSITIVE, Real::MAX];

fn finite(values: &[Real]) -> bool {
    values.iter().all(|v| v.is_finite())
}

/// Geometry of N Gaussians.
fn geometry(seed: u64) -> Primitives {
    stages("Fixed()", Readout::Real).settings::<Splatting>().unwrap().activation().geometry(
        &cloud(N, seed),
        &Deltas::default(),
        0,
        None,
    )
}

/// The picture of `p`, and the derivative of its square in the geometry.
fn draw(projector: &str, rasterizer: &str, p: &Primitives) -> (Vec<Real>, Primitives) {
    let projector = plugin::<dyn Projector>(projector);
    let rasterizer = plugin::<dyn Rasterizer>(rasterizer);
    let plane = projector.plane(90, 24);
    let splats = projector.project(p, &Pose::IDENTITY, &plane);
    let signals: Vec<Real> = (0..p.len()).map(|i| 0.2 + 0.1 * i as Real).collect();
    let render = rasterizer.forward(splats.with_signals(&signals, 1, &plane));
    let d = rasterizer.backward(splats.with_signals(&signals, 1, &plane), &render, &render.pixels);
    let d = projector.project_vjp(p, &Pose::IDENTITY, &plane, &splats, &d.splats);
    (render.pixels, d)
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(200) })]

    #[test]
    fn extreme_values_keep_image_finite(
        seed in 0u64..50, row in 0..N, at in 0usize..10, odd in 0..ODD.len(), compat: bool,
    ) {
        let mut p = geometry(seed);
        let slot = match at {
            0..3 => &mut p.means[row][at],
            3..6 => &mut p.scales[row][at - 3],
            _ => &mut p.quats[row][at - 6],
        };
        *slot = ODD[odd];
        let (projector, rasterizer) =
            if compat { ("WrfgsCompat()", "AlphaBlending(support: TileSquares)") } else { ("Mercator()", "AlphaBlending()") };
        let (picture, d) = draw(projector, rasterizer, &p);
        prop_assert!(finite(&picture));
        for other in (0..N).filter(|i| *i != row) {
            prop_assert!(finite(&d.means[other]) && finite(&d.scales[other]) && finite(&d.quats[other]));
            prop_assert!(d.opacities[other].is_finite());
        }
        if !ODD[odd].is_finite() {
            // What has no place or no size is not drawn: the others look as if it were absent.
            let mut without = geometry(seed);
            without.opacities[row] = 0.0;
            prop_assert_eq!(picture, draw(projector, rasterizer, &without).0);
        }
    }

    #[test]
    fn every_finite_cloud_has_finite_loss(
        seed in 0u64..50, row in 0..N, column in 0usize..4, magnitude in -30i32..30, sign: bool,
    ) {
        let value = (10.0 as Real).powi(magnitude) * if sign { 1.0 } else { -1.0 };
        let mut cloud = cloud(N, seed);
        let (_, width, values) = cloud.columns_mut().nth(column).unwrap();
        values[row * width..(row + 1) * width].fill(value);
        let stages = stages("Fixed()", Readout::Magnitude);
        let outcome = loss_and_gradients(&stages, &cloud, &Arc::default(), &batch(1, &stages), &RenderingLoss::new(0.2), &[], &MOMENT);
        prop_assert!(outcome.is_ok_and(|outcome| outcome.loss.is_finite()));
    }
}

#[test]
fn zero_quaternion_is_identity_rotation() {
    let stages = stages("Fixed()", Readout::Magnitude);
    let with = |quat: [Real; 4]| {
        let mut cloud = cloud(N, 1);
        cloud.quats[2] = quat;
        loss_and_gradients(&stages, &cloud, &Arc::default(), &batch(1, &stages), &RenderingLoss::new(0.2), &[], &MOMENT)
            .unwrap()
    };
    let (zero, identity) = (with([0.0; 4]), with([1.0, 0.0, 0.0, 0.0]));
    assert_eq!(zero.loss, identity.loss);
    assert_eq!(zero.d_cloud.quats[2], [0.0; 4], "a direction that is not there cannot turn");
    assert!(zero.d_cloud.columns().all(|(_, _, d)| finite(d)));
}

#[test]
fn reports_step_of_non_finite_loss() {
    let stages = stages("Fixed()", Readout::Magnitude);
    let mut cloud = cloud(N, 1);
    cloud.signals.fill([Real::NAN; 2]);
    let error = loss_and_gradients(
        &stages,
        &cloud,
        &Arc::default(),
        &batch(1, &stages),
        &RenderingLoss::new(0.2),
        &[],
        &MOMENT,
    )
    .unwrap_err();
    assert!(matches!(error, Error::NonFinite { step: 1, .. }), "{error}");
}

#[test]
fn zero_and_one_gaussian_predict_and_differentiate() {
    for deformation in ["Fixed()", "Mlp(depth: 2, width: 8, skip: None)", "Wrfgs(depth: 2, width: 8, skip: None)"] {
        let stages = stages(deformation, Readout::Magnitude);
        let weights = stages.layout().init(&mut rng::stream(1, "network", 0));
        for n in [0, 1] {
            let cloud = cloud(n, 1);
            let model = Model {
                stages: Stages::clone(&stages),
                cloud: cloud.clone(),
                weights: weights.clone(),
                training_positions: None,
            };
            let pictures = model.prepare().predict_many(&[[0.1, 0.2, 0.3], [0.5, 0.0, 0.9]].map(Query::from));
            assert!(pictures.iter().all(|p| p.pixels.len() == 90 * 24 && finite(&p.pixels)), "{deformation}");
            assert!(n > 0 || pictures[0].pixels.iter().all(|p| *p == 0.0));
            let masked = with_column(cloud, "mask_logits", vec![1.0; n]);
            let pruners = [plugin("LearnableMask()")];
            let outcome = loss_and_gradients(
                &Arc::clone(&stages),
                &masked,
                &Arc::new(weights.clone()),
                &batch(2, &stages),
                &RenderingLoss::new(0.2),
                &pruners,
                &MOMENT,
            );
            let outcome = outcome.unwrap();
            assert!(outcome.loss.is_finite() && finite(&outcome.d_weights), "{deformation}, N = {n}");
            assert!(outcome.d_cloud.columns().all(|(_, _, d)| finite(d)), "{deformation}, N = {n}");
        }
    }
}
