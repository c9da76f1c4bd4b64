//! What several of these tests share: small scenes, and pipelines on a small teacher.

use pwrfgs::core::plugin::PluginKind;
use pwrfgs::core::{
    ExtraColumn, GaussianCloud, Link, LinkInputs, Mat3, MeasurementSetup, Origin, Phase, Plugin, Pose, Real,
    StepContext, registered, rng,
};
use pwrfgs::methods::{Calibration, Readout, Splatting};
use pwrfgs::model::Stages;
use pwrfgs::pipeline::Pipeline;
use pwrfgs::train::Batch;
use std::path::Path;
use std::sync::Arc;

/// A step of the densification phase.
pub(crate) const MOMENT: StepContext =
    StepContext { step: 1, phase: Phase::Densify, seed: 0, round: 0, passed: 0, rounds: 0, target: None };

/// A plugin from its text.
pub(crate) fn plugin<T: ?Sized + PluginKind>(text: &str) -> Plugin<T>
where
    Box<T>: for<'de> serde::Deserialize<'de>,
{
    Plugin::parse(text).unwrap_or_else(|e| panic!("{text}: {e}"))
}

/// Plugins of these tests themselves.
pub(crate) const OF_TESTS: [&str; 7] = ["Counted", "Factor", "GreyOfAFile", "Literal", "Terms", "There", "WorstPixel"];

/// What another language has to fill (`src/foreign.rs`).
pub(crate) const FOREIGN: &str = "Python";

/// The linked plugins of a kind without those of these tests and of other languages.
pub(crate) fn built_in<T: ?Sized + PluginKind>() -> Vec<&'static str>
where
    Box<T>: for<'de> serde::Deserialize<'de>,
{
    registered::<T>().into_iter().filter(|name| !OF_TESTS.contains(name) && *name != FOREIGN).collect()
}

/// Unit quaternion x, y, z, w of a rotation matrix.
pub(crate) fn quaternion(rotation: &Mat3) -> [f64; 4] {
    let c = rotation.to_cols_array().map(|v| v as f64);
    glam::DQuat::from_mat3(&glam::DMat3::from_cols_array(&c)).normalize().to_array()
}

/// Stages that draw 90 × 24 pictures for a receiver at the origin.
pub(crate) fn stages(deformation: &str, readout: Readout) -> Arc<Stages> {
    let projector: Plugin<dyn pwrfgs::core::Projector> = plugin("Mercator()");
    let plane = projector.plane(90, 24);
    let splatting = Splatting {
        deformation: plugin(deformation),
        projector,
        rasterizer: plugin("AlphaBlending()"),
        calibration: Calibration::Physical,
        readout,
    };
    Arc::new(Stages::new(splatting, MeasurementSetup::spectra(Origin::ZERO, Pose::IDENTITY, plane)))
}

/// `n` Gaussians in front of that receiver, of all shapes.
pub(crate) fn cloud(n: usize, seed: u64) -> GaussianCloud {
    let random = &mut rng::stream(seed, "test cloud", 0);
    let mut cloud = GaussianCloud::default();
    for _ in 0..n {
        let [x, y, z] = [(); 3].map(|()| 2.0 * rng::normal(random));
        cloud.means.push([x, y, 1.0 + z.abs()]);
        cloud.log_scales.push([(); 3].map(|()| 0.4 * rng::normal(random) - 1.0));
        cloud.quats.push([(); 4].map(|()| rng::normal(random)));
        cloud.opacity_logits.push(rng::normal(random));
        cloud.signals.push([(); 2].map(|()| 0.3 + 0.3 * rng::normal(random)));
    }
    cloud
}

/// The cloud with one more column of one number a Gaussian.
pub(crate) fn with_column(mut cloud: GaussianCloud, name: &str, values: Vec<Real>) -> GaussianCloud {
    cloud.extra.push(ExtraColumn { name: name.into(), width: 1, values });
    cloud
}

/// `count` transmitters and random spectra for them.
pub(crate) fn batch(count: usize, stages: &Stages) -> Batch {
    let random = &mut rng::stream(7, "test batch", 0);
    let pixels = stages.plane.width * stages.plane.height;
    let txs: Vec<[Real; 3]> = (0..count).map(|_| [(); 3].map(|()| rng::normal(random))).collect();
    batch_at(&txs, (0..count * pixels).map(|_| rng::uniform(random)).collect(), stages)
}

/// Transmitters at `txs` that the first receiver receives.
pub(crate) fn batch_at(txs: &[[Real; 3]], truths: Vec<Real>, stages: &Stages) -> Batch {
    let links = (0..txs.len()).map(|location| Link { location, receiver: 0 }).collect();
    let inputs = LinkInputs { values: txs.as_flattened().to_vec(), pairs: links, ..LinkInputs::of(3, &stages.setup) };
    Batch { inputs, truths, ..Batch::default() }
}

/// A pipeline from its fields.
pub(crate) fn pipeline(fields: &str) -> Pipeline {
    let text = format!("Pipeline(name: \"test\", {fields})");
    Pipeline::parse(&text, Path::new("test.ron")).unwrap_or_else(|e| panic!("{e}: {text}"))
}
