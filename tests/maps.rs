//! Map coordinates: a scene far from zero is the same scene.

use crate::common::pipeline;
use pwrfgs::core::MAX_COORDINATE_M;
use pwrfgs::core::rng;
use pwrfgs::model::file;
use pwrfgs::prelude::*;
use std::path::Path;

/// Easting, northing and height of a place in Central Europe, whole metres.
const SHIFT: [f64; 3] = [500_000.0, 5_400_000.0, 100.0];

/// Every place in 1/1024 m, which doubles hold exactly at either end.
fn exact(place: [f64; 3]) -> [f64; 3] {
    place.map(|v| (v * 1024.0).round() / 1024.0)
}

fn moved(place: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|k| place[k] + SHIFT[k])
}

/// The pipeline's data, whose receiver stands within half a metre of zero; shifted where asked.
fn data_of(pipeline: &Pipeline, shifted: bool) -> Dataset {
    let data = pipeline.data.load(Path::new("."), &|_, _| {}).unwrap();
    let place = |p| if shifted { moved(exact(p)) } else { exact(p) };
    let points = data.scene.points.iter().map(|p| place(p.map(f64::from))).collect();
    let samples = data.samples().map(|s| Sample { pose: place(s.position()).into(), ..s }).collect();
    let receiver = Pose { position: place(data.scene.pose().position), ..data.scene.pose() };
    Dataset::new("shifted", receiver, points, samples, data.observations.spectra().unwrap().clone()).unwrap()
}

fn trained(pipeline: &Pipeline, data: &Dataset) -> Model {
    let partition = pipeline.split.split(data, &mut rng::stream(5, "split", 0)).unwrap();
    let mut trainer = pipeline.trainer(data, &partition).unwrap();
    while !trainer.finished() {
        trainer.step().unwrap();
    }
    trainer.model()
}

#[test]
fn training_and_predictions_are_shift_invariant() {
    let deformations = ["Mlp(depth: 2, width: 16, skip: None)", "Wrfgs(depth: 2, width: 8, skip: None)"];
    for (initializer, deformation) in ["PointCloud()", "Random(count: 60, std: 3)"].into_iter().zip(deformations) {
        let pipeline = pipeline(&format!(
            "seed: 5, data: Teacher(gaussians: 6, samples: 20, width: 90, height: 24,
                 receiver: (position: (0.25, -0.375, 0.125), orientation: (0, 0, 0, 1))),
             split: Random(test: 0.2), initializer: {initializer}, deformation: {deformation},
             training: (steps: 12, batch: 3, tx_jitter_m: 0.02, densify_until: 8, prune_until: 10, prune_every: 2,
                 densify: (from: 2, every: 3, gradient_threshold: 0))",
        ));
        let (near, far) = (data_of(&pipeline, false), data_of(&pipeline, true));
        assert_eq!((near.scene.origin.0, far.scene.origin.0), ([0.0; 3], SHIFT));
        let [here, there] = [&near, &far].map(|data| trained(&pipeline, data));
        assert!(here.cloud == there.cloud && here.weights == there.weights, "{initializer}: bits differ");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m.safetensors");
        file::write(&path, &there).unwrap();
        let read = file::read(&path).unwrap();
        assert_eq!(read.stages.world_pose(), Pose { position: moved([0.25, -0.375, 0.125]), ..near.scene.pose() });
        for sample in near.samples() {
            assert_eq!(read.predict(moved(sample.position())).pixels, here.predict(sample.position()).pixels);
        }
        assert_eq!(read.means_from(near.scene.origin).len(), here.cloud.len());
    }
}

#[test]
fn teacher_is_shift_invariant() {
    let teacher = |[x, y, z]: [f64; 3]| {
        let text = format!(
            "data: Teacher(gaussians: 6, samples: 8, width: 90, height: 24,
                 receiver: (position: ({x}, {y}, {z}), orientation: (0, 0, 0, 1)),
                 tx_box: (({}, {}, {z}), ({}, {}, {}))), initializer: Grid(count: 4), training: (steps: 3)",
            x - 1.0,
            y - 1.0,
            x + 1.0,
            y + 1.0,
            z + 2.0
        );
        pipeline(&text).data.load(Path::new("."), &|_, _| {}).unwrap()
    };
    let (here, there) = (teacher([0.0; 3]), teacher(SHIFT));
    assert_eq!(there.scene.origin.0, SHIFT);
    // Through the user's frame, whose doubles end at a nanometre there: single precision does not see it.
    let rounding = if size_of::<Real>() == 4 { 0.0 } else { 1e-8 };
    let (there_points, here_points) = (there.scene.points.as_flattened(), here.scene.points.as_flattened());
    assert!(there_points.iter().zip(here_points).all(|(a, b)| (a - b).abs() <= rounding));
    assert_eq!(there.observations.raw(3), here.observations.raw(3));
}

#[test]
fn model_without_origin_round_trips_and_extreme_origin_is_rejected() {
    let pipeline = pipeline(
        "data: Teacher(gaussians: 4, samples: 8, width: 48, height: 12), initializer: Grid(count: 4), training: (steps: 3)",
    );
    let data = pipeline.data.load(Path::new("."), &|_, _| {}).unwrap();
    let mut model = trained(&pipeline, &data);
    let text = |model: &Model| String::from_utf8_lossy(&file::to_bytes(model)).into_owned();
    assert!(!text(&model).contains("origin"));
    model.stages.origin = pwrfgs::core::Origin([7e6, 0.0, 0.0]);
    assert!(text(&model).contains(r#"\"origin\":[7000000.0,0.0,0.0]"#));
    model.stages.origin.0[0] = 10.0 * MAX_COORDINATE_M;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.safetensors");
    file::write(&path, &model).unwrap();
    let message = file::read(&path).unwrap_err();
    assert!(message.is_input() && message.to_string().contains("the origin is 1e9 m, beyond 1e8 m"), "{message}");
}
