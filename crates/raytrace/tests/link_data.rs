//! `Simulated` and `RayTracing` with several receivers, powers and channels.

use crate::common::{CSI, small_room};
use pwrfgs_core::{Baseline, DataSource, Dataset, FittingSet, Link, Observations, Plugin, Real, Split, Task, rng};
use pwrfgs_data as _;
use pwrfgs_raytrace::SceneFile;
use std::fs;
use std::path::Path;

const QUIET: &str = "noise: (snr_db: 20, phase_error_deg: 3),";

/// Simulates 10 samples of the scene `s.ron` in `folder`; `observe` is a further setting.
fn load(folder: &Path, observe: &str) -> pwrfgs_core::Result<Dataset> {
    let text = format!("Simulated(scene: \"s.ron\", samples: 10, points: 20, cache: false{observe})");
    Plugin::<dyn DataSource>::parse(&text).unwrap().load(folder, &|_, _| {})
}

#[test]
fn data_set_has_one_link_per_transmitter_and_receiver() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("s.ron"), small_room(CSI)).unwrap();
    let scene = SceneFile::read(&folder.path().join("s.ron")).unwrap();
    for (observe, kind, size) in [
        ("", Task::Spectrum, (360, 90)),
        (", observe: Power(noise_db: 2)", Task::Power, (1, 1)),
        (", observe: Power()", Task::Power, (1, 1)),
        (", observe: Channel(snr_db: 30)", Task::Channel, (6, 16)),
    ] {
        let data = load(folder.path(), observe).unwrap();
        assert_eq!((data.task(), (data.width, data.height), data.len()), (kind, size, 20), "{observe}");
        assert_eq!((data.locations.len(), data.locations[9].id, data.placed), (10, 10, true));
        assert_eq!(data.links[5], Link { location: 2, receiver: 1 });
        let names: Vec<&str> = data.scene.receivers.iter().map(|receiver| &*receiver.name).collect();
        assert_eq!(names, ["gateway1", "b"]);
        for (loaded, receiver) in data.scene.receivers.iter().zip(scene.receivers()) {
            assert!(loaded.pose == receiver.pose() && loaded.antennas.len() == 8);
        }
        assert!(data.is_simulated() && data.title == "small (simulated)" && data.scene.points.len() == 20);
        let split = Plugin::<dyn Split>::parse("Official(validation: 0)").unwrap();
        let parts = split.split(&data, &mut rng::stream(0, "test", 0)).unwrap();
        assert_eq!(parts.test, [8, 9, 18, 19]);
        if let Observations::Channels(channels) = &data.observations {
            assert_eq!(channels.frequencies_hz, scene.frequencies());
        }
    }
}

#[test]
fn unreceived_transmitters_have_no_link() {
    let folder = tempfile::tempdir().unwrap();
    let data_at = |dbm: f64| {
        let text = small_room("").replace("transmitter: (", &format!("transmitter: (power_dbm: {dbm}, "));
        fs::write(folder.path().join("s.ron"), text).unwrap();
        load(folder.path(), ", observe: Power(noise_db: 2)")
    };
    let (all, some) = (data_at(0.0).unwrap(), data_at(-50.0).unwrap());
    assert!(all.len() == 20 && (1..20).contains(&some.len()), "{}", some.len());
    for i in 0..some.len() {
        let received = some.sample(i);
        let j =
            (0..20).find(|&j| (all.sample(j).id, all.sample(j).receiver) == (received.id, received.receiver)).unwrap();
        let (loud, quiet) = (all.image(j).pixels[0], some.image(i).pixels[0]);
        assert!(quiet > -100.0 && (loud - quiet - 50.0).abs() < 0.01);
    }
    let message = data_at(-190.0).unwrap_err().to_string();
    assert!(message.contains("no receiver receives any transmitter; raise `power_dbm`"), "{message}");
}

#[test]
fn ray_tracing_reproduces_every_observation_kind() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("s.ron"), small_room(CSI).replace(QUIET, "")).unwrap();
    let fit = |data: &Dataset, text: &str| -> pwrfgs_core::Result<_> {
        let baseline = Plugin::<dyn Baseline>::parse(text).unwrap();
        let predictor = baseline.fit(data, FittingSet::default())?;
        let predicted: Vec<_> = (0..data.len()).map(|i| predictor.predict(data.query(i))).collect();
        Ok((predicted, predictor.note().unwrap()))
    };
    for (observe, things) in
        [("", "spectra"), (", observe: Power()", "received powers"), (", observe: Channel()", "channels")]
    {
        let data = load(folder.path(), observe).unwrap();
        let (exact, note) = fit(&data, "RayTracing()").unwrap();
        assert!(note.contains(&format!("the generator of these simulated {things}, ")), "{note}");
        let (wrong, _) = fit(&data, "RayTracing(material_error: 0.3, position_error_m: 0.05)").unwrap();
        for (i, exact) in exact.iter().enumerate() {
            let truth = data.image(i);
            let scale = truth.pixels.iter().map(|v| v.abs()).fold(0.0, Real::max);
            let near = exact.pixels.iter().zip(&truth.pixels).all(|(a, b)| (a - b).abs() <= 1e-6 * scale);
            assert!((exact.width, exact.height) == (truth.width, truth.height) && near, "{observe} {i}");
            assert!(wrong[i] != truth);
        }
    }
    // Another scene must have the same receivers, antennas and subcarriers.
    let data = load(folder.path(), ", observe: Channel()").unwrap();
    let other = |from: &str, to: &str| {
        let path = folder.path().join("other.ron");
        fs::write(&path, small_room(CSI).replacen(from, to, 1)).unwrap();
        fit(&data, &format!("RayTracing(scene: {path:?})")).unwrap_err().to_string()
    };
    assert!(other("\"b\"", "\"c\"").contains("the scene has no receiver `b`; name its receivers as the data do"));
    assert!(other("rows: 4", "rows: 2").contains("channels of this data set have 8 antennas, and `b` has 4"));
    assert!(other("20e6", "10e6").contains("other subcarriers than the scene; leave it out"));
}

#[test]
fn reports_invalid_observe_setting() {
    let error_of = |observe: &str| {
        let text = format!("Simulated(scene: \"s.ron\", observe: {observe})");
        Plugin::<dyn DataSource>::parse(&text).unwrap_err()
    };
    for (observe, expected) in [
        ("Power(noise_db: -1)", "observe: `noise_db` is -1"),
        ("Channel(snr_db: 1e9)", "observe: `snr_db` is 1000000000"),
        ("Chanel()", "1:"),
    ] {
        let message = error_of(observe);
        assert!(message.contains(expected), "{message}");
    }
}
