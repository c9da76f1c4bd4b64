//! Images of a moving camera in the format of COLMAP: Gaussians trained on some poses predict the others.

use crate::common::{cloud, pipeline, plugin};
use pwrfgs::core::{Camera, FittingSet, recognise};
use pwrfgs::methods::{Calibration, Readout, Splatting};
use pwrfgs::model::{Model, Stages, file};
use pwrfgs::prelude::*;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

const SIZE: (usize, usize) = (48, 36);
const CAMERA: Camera = Camera { focal: [40.0, 42.0], centre: [24.5, 17.0] };
/// Number of poses; every fourth is tested.
const POSES: usize = 40;

/// Poses on a spiral about the scene. The camera looks at its middle, and its image is upright.
fn poses() -> Vec<Pose> {
    let pose = |k: usize| {
        let (sin, cos) = (k as f64 * 0.37).sin_cos();
        let position = glam::DVec3::new(5.0 * cos, 5.0 * sin, 1.5 + 0.08 * k as f64);
        let forward = (glam::DVec3::new(0.0, 0.0, 2.0) - position).normalize();
        let right = forward.cross(glam::DVec3::Z).normalize();
        let world_from_camera = glam::DMat3::from_cols(right, forward.cross(right), forward);
        let orientation = glam::DQuat::from_mat3(&world_from_camera).to_array();
        Pose { position: position.to_array(), orientation }
    };
    (0..POSES).map(pose).collect()
}

/// A model that draws a known cloud.
fn truth() -> Model {
    let splatting = Splatting {
        deformation: plugin("Fixed()"),
        projector: plugin("Pinhole()"),
        rasterizer: plugin("AlphaBlending()"),
        calibration: Calibration::Physical,
        readout: Readout::Magnitude,
    };
    let plane = splatting.projector.plane_of_camera(SIZE.0, SIZE.1, CAMERA).unwrap();
    let setup =
        MeasurementSetup { moving: End::Receiver, ..MeasurementSetup::spectra(Origin::ZERO, Pose::IDENTITY, plane) };
    let mut cloud = cloud(60, 4);
    cloud.means.as_flattened_mut().iter_mut().for_each(|v| *v *= 0.6);
    cloud.log_scales.as_flattened_mut().iter_mut().for_each(|v| *v -= 0.6);
    cloud.opacity_logits.fill(1.5);
    Model { stages: Stages::new(splatting, setup), cloud, weights: Vec::new(), training_positions: None }
}

/// Writes the images of the model at these poses, their poses as COLMAP has them, and points near the Gaussians.
fn write_folder(root: &Path, model: &Model, poses: &[Pose]) {
    for name in ["sparse/0", "images"] {
        fs::create_dir_all(root.join(name)).unwrap();
    }
    let Camera { focal: [fx, fy], centre: [cx, cy] } = CAMERA;
    let (width, height) = SIZE;
    fs::write(root.join("sparse/0/cameras.txt"), format!("1 PINHOLE {width} {height} {fx} {fy} {cx} {cy}\n")).unwrap();
    let (mut images, mut lists) = (String::new(), [String::new(), String::new()]);
    for (k, pose) in poses.iter().enumerate() {
        let ([x, y, z, w], [tx, ty, tz]) = (pose.orientation, pose.to_receiver([0.0; 3]));
        writeln!(images, "{k} {w} {} {} {} {tx} {ty} {tz} 1 {k:03}.png\n", -x, -y, -z).unwrap();
        writeln!(lists[usize::from(k % 4 == 3)], "{k:03}").unwrap();
        let bytes = model.predict(*pose).to_bytes();
        image::GrayImage::from_raw(width as u32, height as u32, bytes)
            .unwrap()
            .save(root.join(format!("images/{k:03}.png")))
            .unwrap();
    }
    let points =
        model.cloud.means.iter().enumerate().map(|(i, [x, y, z])| format!("{i} {} {y} {z} 9 9 9 0.1\n", x + 0.1));
    fs::write(root.join("sparse/0/images.txt"), images).unwrap();
    fs::write(root.join("sparse/0/points3D.txt"), points.collect::<String>()).unwrap();
    fs::write(root.join("train_index.txt"), &lists[0]).unwrap();
    fs::write(root.join("test_index.txt"), &lists[1]).unwrap();
}

const SETTINGS: &str = "data: Colmap(root: \"none\"), deformation: Fixed(), readout: Magnitude, training: (steps: 400, batch: 4,
    densify_until: 0, prune_until: 0, densify: (every: 0), tx_jitter_m: 0, optimizer: (means: Cosine(first: 0.02, last: 0.002),
    log_scales: Constant(0.02), quats: Constant(0.01), opacity_logits: Constant(0.05), signals: Constant(0.02)))";

#[test]
fn camera_images_train_and_held_out_poses_are_predicted() {
    let folder = tempfile::tempdir().unwrap();
    let (truth, poses) = (truth(), poses());
    write_folder(folder.path(), &truth, &poses);
    let data = recognise(folder.path()).unwrap().load(Path::new(""), &|_, _| {}).unwrap();
    assert_eq!((data.camera(), data.len(), data.scene.points.len()), (Some(CAMERA), POSES, 60));
    for (k, pose) in poses.iter().enumerate() {
        let read = data.query(k).pose;
        let near = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
        assert!(near(&read.coordinates(), &pose.coordinates()), "{read:?} is not {pose:?}");
        let (shown, image) = (truth.predict(data.query(k)).clamped(), data.image(k));
        let error = shown.pixels.iter().zip(&image.pixels).fold(0.0, |most: Real, (a, b)| most.max((a - b).abs()));
        assert!(error < 0.003, "image {k} differs by {error}"); // half a grey level, and the rounding of the pose
    }
    let (train, test) = data.official.clone().unwrap();
    let partition = Partition { train, test, ..Partition::default() };
    let error = |predict: &dyn Fn(usize) -> Image| -> f64 {
        let of = |&i: &usize| {
            let (p, t) = (predict(i).clamped(), data.image(i));
            p.pixels.iter().zip(&t.pixels).map(|(p, t)| f64::from((p - t).abs() as f32)).sum::<f64>()
        };
        partition.test.iter().map(of).sum::<f64>() / (partition.test.len() * SIZE.0 * SIZE.1) as f64
    };
    let baseline = |text: &str| {
        let baseline: Plugin<dyn Baseline> = plugin(text);
        let fitted = baseline.fit(&data, FittingSet::train(&partition.train)).unwrap();
        error(&|i| fitted.predict(data.query(i)))
    };
    let baselines = ["MeanSpectrum()", "NearestNeighbours(k: 1)", "NearestNeighbours(k: 3)"].map(baseline);
    for initializer in ["PointCloud(opacity: 0.3)", "Random(count: 150, std: 1.2, opacity: 0.3)"] {
        let pipeline = pipeline(&format!("{SETTINGS}, projector: Pinhole(), initializer: {initializer}"));
        let trained = || {
            let mut trainer = pipeline.trainer(&data, &partition).unwrap();
            while !trainer.finished() {
                trainer.step().unwrap();
            }
            trainer.model()
        };
        let model = trained();
        let own = error(&|i| model.predict(data.query(i)));
        println!("{initializer}: mean error {own:.4}; mean image, 1-NN, 3-NN {baselines:.4?}");
        assert!(baselines.iter().all(|floor| own < 0.5 * floor), "{own} against {baselines:?}");
        // The file has the camera.
        let path = folder.path().join("model");
        file::write(&path, &model).unwrap();
        let read = file::read(&path).unwrap();
        assert_eq!(read.stages.setup, model.stages.setup);
        assert_eq!(read.predict(data.query(3)), model.predict(data.query(3)));
        assert_eq!(trained().cloud, model.cloud, "the same seed gives the same bits");
    }
}

#[test]
fn projector_and_data_without_matching_camera_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    write_folder(folder.path(), &truth(), &poses()[..4]);
    let data = recognise(folder.path()).unwrap().load(Path::new(""), &|_, _| {}).unwrap();
    let partition = Partition { train: vec![0, 1, 2], test: vec![3], ..Partition::default() };
    let refused = |data: &Dataset, fields: &str| {
        let fields = format!("{SETTINGS}, initializer: PointCloud(), {fields}");
        pipeline(&fields).trainer(data, &partition).err().unwrap().to_string()
    };
    for fields in ["projector: Mercator()", "projector: WrfgsCompat()"] {
        assert!(refused(&data, fields).contains("the data are images of a camera; use projector: Pinhole()"));
    }
    let mut without = data.clone();
    without.scene.receivers[0].camera = None;
    assert!(refused(&without, "projector: Pinhole()").contains("the data have no camera; use projector: Mercator()"));
    // A model file whose camera is damaged, or missing.
    let path = folder.path().join("model");
    for camera in [None, Some(Camera { focal: [0.0; 2], ..CAMERA })] {
        let mut model = truth();
        model.stages.setup.plane.camera = camera;
        // Without a camera, a plane of a moving receiver would have no directions.
        model.stages.setup.moving = if camera.is_some() { End::Receiver } else { End::Transmitter };
        file::write(&path, &model).unwrap();
        let message = file::read(&path).unwrap_err();
        assert!(
            message.is_input() && message.to_string().contains("plane: the projector does not support"),
            "{message}"
        );
    }
}
