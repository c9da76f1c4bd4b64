//! Spectra of other elevations than 0 to 90 degrees, such as a full sphere.

use crate::common::pipeline;
use pwrfgs::experiment::{ActiveRun, Session, SplitData};
use pwrfgs::model::file;
use pwrfgs::prelude::*;

const SIZE: (usize, usize) = (60, 30);

/// Spectra of one direction each way, all alike: one in front of the receiver, and a stronger one behind.
fn sphere(elevation: Elevation) -> Dataset {
    let axis = elevation.axis(SIZE.1);
    let row = |el: f64| ((el - axis.first) / axis.step).round() as i64;
    let spectrum: Vec<u8> = (0..(SIZE.0 * SIZE.1) as i64)
        .map(|i| {
            let (x, y) = (i % SIZE.0 as i64, i / SIZE.0 as i64);
            let bump =
                |at: (i64, i64), most: f64| most * (-0.15 * ((x - at.0).pow(2) + (y - at.1).pow(2)) as f64).exp();
            (bump((15, row(48.0)), 120.0) + bump((40, row(-36.0)), 255.0)) as u8
        })
        .collect();
    let samples = (1..=6).map(|id| Sample::new(id, [0.1 * f64::from(id), 0.5, 1.0])).collect();
    let spectra = Spectra::grey(SIZE, spectrum.repeat(6)).unwrap();
    let data = Dataset::new("sphere", Pose::IDENTITY, vec![], samples, spectra).unwrap();
    Dataset { elevation, ..data }
}

const SETTINGS: &str = "data: Teacher(), deformation: Fixed(),
    training: (steps: 120, batch: 2, densify_until: 0, prune_until: 120, tx_jitter_m: 0, densify: (every: 0),
        optimizer: (means: Constant(0.02), log_scales: Constant(0.02), opacity_logits: Constant(0.05), signals: Constant(0.03)))";

#[test]
fn full_sphere_trains_front_and_back_in_either_orientation() {
    for initializer in ["Grid(count: 80, distance_m: 3)", "Random(count: 300, std: 3)"] {
        for elevation in [(-90.0, 90.0), (90.0, -90.0)].map(Elevation::from) {
            let pipeline = pipeline(&format!("initializer: {initializer}, {SETTINGS}"));
            let data = sphere(elevation);
            let all: Vec<usize> = (0..6).collect();
            let partition = Partition { train: all, ..Partition::default() };
            let mut trainer = pipeline.trainer(&data, &partition).unwrap();
            let first = trainer.step().unwrap().loss;
            while !trainer.finished() {
                trainer.step().unwrap();
            }
            let model = trainer.model();
            assert_eq!(model.stages.plane.elevation(), Some(elevation));
            let folder = tempfile::tempdir().unwrap();
            file::write(&folder.path().join("m"), &model).unwrap();
            let image = file::read(&folder.path().join("m")).unwrap().predict([0.3, 0.5, 1.0]);
            let loss: f64 = image.pixels.iter().zip(&data.image(0).pixels).map(|(a, b)| f64::from((a - b).abs())).sum();
            println!("{initializer} {elevation:?}: loss {first} at first, mean error {}", loss / 1800.0);
            // Strongest behind, where it is; and something in front as well.
            let (x, y) = ((image.argmax() % SIZE.0) as Real, (image.argmax() / SIZE.0) as Real);
            let (az, el) = model.stages.plane.azimuth_elevation_deg(x, y).unwrap();
            assert!((az - 240.0).abs() <= 12.0 && (el + 36.0).abs() <= 12.0, "{initializer} {elevation:?}: {az} {el}");
            let axis = elevation.axis(SIZE.1);
            let ahead = ((48.0 - axis.first) / axis.step).round() as usize;
            assert!(image.pixels[ahead * SIZE.0 + 15] > 0.2, "in front: {}", image.pixels[ahead * SIZE.0 + 15]);
        }
    }
}

#[test]
fn rejects_elevations_that_model_cannot_draw() {
    let data = sphere((-90.0, 90.0).into());
    let partition = Partition { train: vec![0, 1, 2], test: vec![3, 4], ..Partition::default() };
    let refused = |settings: &str| {
        let pipeline = pipeline(&format!("initializer: Grid(count: 8), {SETTINGS}, {settings}"));
        pipeline.trainer(&data, &partition).err().unwrap().to_string()
    };
    let message = refused("projector: WrfgsCompat()");
    assert!(
        message.contains("the projector does not support the elevations of these spectra, -90 to 90 degrees"),
        "{message}"
    );
    let pipeline = pipeline(&format!("initializer: Grid(count: 8), {SETTINGS}"));
    let half = sphere(Elevation::UPPER);
    let model = pipeline.trainer(&half, &partition).unwrap().model();
    let (ensemble, mut silent) = (Ensemble::of(model.clone()), NoopObserver);
    let session = &mut Session::new(&mut silent);
    let split = SplitData { data, partition };
    let evaluated = ActiveRun::new(&pipeline, &split, session).evaluate(&ensemble).err();
    // As `locate` and `update` check it.
    let compared = pwrfgs::experiment::check_alike(&ensemble.prepare(), &split.data).err();
    for message in [evaluated, compared].map(|error| error.unwrap().to_string()) {
        let words = "draws elevations of 0 to 90 degrees and the spectra of the data are of -90 to 90";
        assert!(message.contains(words), "{message}");
    }
    // A file whose plane is none of its projector's.
    let mut model = model;
    let angles = model.stages.plane.angles.as_mut().unwrap();
    angles.0.step = 1e300;
    let folder = tempfile::tempdir().unwrap();
    file::write(&folder.path().join("m"), &model).unwrap();
    let message = file::read(&folder.path().join("m")).unwrap_err();
    assert!(
        message.is_input() && message.to_string().contains("plane: the projector does not support its angles"),
        "{message}"
    );
}
