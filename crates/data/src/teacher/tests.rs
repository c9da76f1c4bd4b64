//! Tests of the documented properties of `Teacher`.

use super::*;
use crate::baselines::{MeanSpectrum, NearestNeighbours};
use crate::splits::Official;
use pwrfgs_core::{Baseline, FittingSet, Image, Split, ssim};
use pwrfgs_raster as _;

fn small() -> Teacher {
    Teacher { samples: 20, width: 90, height: 24, ..Teacher::default() }
}

fn load(teacher: &Teacher) -> Dataset {
    teacher.load(Path::new("."), &|_, _| {}).unwrap()
}

#[test]
fn teacher_data_are_complete_and_marked_simulated() {
    let data = load(&small());
    assert_eq!(data.title, "20 simulated spectra of 12 Gaussians (Teacher, seed 0)");
    assert!(data.is_simulated());
    assert_eq!((data.width, data.height, data.len(), data.scene.points.len()), (90, 24, 20, 12));
    assert_eq!(data.official.as_ref().unwrap().1, [4, 9, 14, 19]);
    assert_eq!((0..20).flat_map(|i| data.observations.raw(i).into_owned()).max(), Some(255));
    let (low, high) = data.scene.bounds;
    for sample in data.samples() {
        let tx = sample.position().map(|v| v as Real);
        assert!((0..3).all(|k| low[k] <= tx[k] && tx[k] <= high[k]));
    }
    let ids: Vec<u32> = data.samples().map(|s| s.id).collect();
    assert_eq!(ids, (1..=20).collect::<Vec<_>>());
}

#[test]
fn teacher_is_bit_identical_at_any_thread_count() {
    let spectra = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let data = pool.install(|| load(&Teacher { seed, ..small() }));
        (0..20).map(|i| (data.sample(i).position(), data.observations.raw(i).into_owned())).collect::<Vec<_>>()
    };
    assert_eq!(spectra(1, 0), spectra(3, 0));
    assert_ne!(spectra(1, 0), spectra(1, 1));
}

#[test]
fn teacher_gaussians_are_within_stated_distance_and_elevation() {
    let wall = Pose { position: [5.0, 0.26, 0.0], orientation: [0.5, -0.5, -0.5, 0.5] };
    for receiver in [Pose::IDENTITY, wall] {
        let teacher = Teacher { receiver, gaussians: 50, ..small() };
        let cloud = teacher.cloud();
        assert_eq!(cloud.len(), 50);
        let receiver_from_world = receiver.world_from_receiver().transpose();
        for mean in &cloud.means {
            let seen = receiver_from_world * (pwrfgs_core::Vec3::from_array(*mean) - receiver.position_vec());
            let elevation = (seen.z / seen.length()).asin().to_degrees();
            assert!((2.0..6.001).contains(&seen.length()) && (9.99..75.01).contains(&elevation), "{seen} {elevation}");
        }
        assert_eq!(load(&teacher).scene.points, cloud.means);
    }
}

#[test]
fn teacher_signals_vary_smoothly_with_transmitter() {
    let teacher = small();
    let means = teacher.cloud().signals;
    for (signals, (nearby, mean)) in
        teacher.signals([0.1, 0.2, 1.0]).iter().zip(teacher.signals([0.1, 0.201, 1.0]).iter().zip(&means))
    {
        for k in 0..2 {
            assert!(signals[k] >= 0.0 && signals[k] <= mean[k] / 0.55 * 1.0001);
            // A millimetre changes a wave of 1 m by at most 0.45 · 2π/1000.
            assert!((signals[k] - nearby[k]).abs() <= 0.003);
        }
    }
}

#[test]
fn teacher_is_learnable_and_not_trivial() {
    let data = load(&Teacher::default());
    let partition = Official { validation: 0.0 }.split(&data, &mut rng::stream(0, "split", 0)).unwrap();
    let score = |baseline: &dyn Baseline| {
        let fitted = baseline.fit(&data, FittingSet::train(&partition.train)).unwrap();
        let similarity = |&i: &usize| ssim::evaluation(&fitted.predict(data.query(i)), &data.image(i));
        partition.test.iter().map(similarity).sum::<f64>() / partition.test.len() as f64
    };
    let (mean, nearest) = (score(&MeanSpectrum {}), score(&NearestNeighbours { k: 3.into() }));
    println!("mean SSIM: mean spectrum {mean:.4}, 3-NN {nearest:.4}");
    assert!((0.7..0.9).contains(&mean) && (0.95..0.99).contains(&nearest), "{mean} {nearest}");
}

#[test]
fn teacher_with_every_field_round_trips() {
    let text = "Teacher(gaussians: 3, samples: 7, seed: 5, width: 60, height: 20, tx_box: ((0, 0, 0), (1, 1, 1)), \
                receiver: (position: (1, 2, 3), orientation: (0, 0, 0, 1)), \
                projector: Mercator())";
    let plugin = Plugin::<dyn DataSource>::parse(text).unwrap();
    let written = ron::ser::to_string_pretty(&plugin, ron::ser::PrettyConfig::default().struct_names(true)).unwrap();
    let again = Plugin::<dyn DataSource>::parse(&written).unwrap();
    assert_eq!(format!("{plugin:?}"), format!("{again:?}"));
    let image =
        |plugin: &Plugin<dyn DataSource>| -> Image { plugin.load(Path::new("."), &|_, _| {}).unwrap().image(6) };
    assert_eq!(image(&plugin), image(&again));
}

#[test]
fn rejects_settings_out_of_range_when_read() {
    let texts = [
        "gaussians: 0",
        "samples: 0",
        "width: 0",
        "height: 2000000",
        "samples: 1000000, width: 1000000",
        "tx_box: ((0, 0, 0), (1, -1, 1))",
        "tx_box: ((0, 0, NaN), (1, 1, 1))",
        "receiver: (position: (0, 0, 0), orientation: (0, 0, 0, 0))",
        "receiver: (position: (NaN, 0, 0), orientation: (0, 0, 0, 1))",
        "samples: 5, colour: 3",
    ];
    for text in texts {
        assert!(Plugin::<dyn DataSource>::parse(&format!("Teacher({text})")).is_err(), "{text}");
    }
}

#[test]
fn rejects_projector_that_is_not_linked() {
    let message = linked_plugin::<dyn Projector>("Gnomonic").unwrap_err().to_string();
    assert_eq!(message, "Teacher draws with Gnomonic, which is not linked into this program; link pwrfgs-raster");
}
