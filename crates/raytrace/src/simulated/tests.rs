use super::*;
use crate::observe::SimulatedObservation;
use crate::scene::Noise;
use crate::simulator::{SimulationRequest, Simulator, simulate_links};
use pwrfgs_core::plugin::Checked;
use std::fs;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

const SCENE: &str = r#"(
    name: "small", carrier_hz: 2.4e9,
    room: (outline: Box(low: (0, 0, 0), high: (4, 3, 2.5)), walls: (material: "brick"), floor: (material: "concrete"),
        ceiling: (material: "wood")),
    receiver: (position: (0.2, 1.5, 1.5), orientation: Facing(direction: (1, 0, 0)), array: (rows: 2, columns: 3)),
    more_receivers: [(name: "b", position: (3.7, 1, 2), orientation: Facing(direction: (-1, 0, 0)),
        array: (rows: 3, columns: 2))],
    subcarriers: (count: 4, bandwidth_hz: 20e6),
    transmitter: (positions: Uniform(low: (0.9, 0.9, 0.4), high: (3.5, 2.5, 1.5))),
)"#;

/// Returns the observations as numbers, one row per link.
fn rows(observations: &Observations, links: usize) -> Vec<Vec<f64>> {
    let flat: Vec<f64> = match observations {
        Observations::Spectra(all) => (0..all.len()).flat_map(|i| all.raw(i).into_owned()).map(f64::from).collect(),
        Observations::Powers(all) => all.iter().map(|v| *v as f64).collect(),
        Observations::Channels(all) => all.gains.as_flattened().iter().map(|v| *v as f64).collect(),
    };
    flat.chunks(flat.len() / links).map(<[f64]>::to_vec).collect()
}

#[test]
fn caches_every_observation_kind_and_remakes_damaged_entries() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("small.ron");
    fs::write(&scene, SCENE).unwrap();
    let noises = [
        ObservationKind::Spectrum,
        ObservationKind::Power { noise_db: 3.0 },
        ObservationKind::Channel { snr_db: Some(20.0) },
    ];
    for (observe, file) in noises.into_iter().zip([SPECTRA, POWERS, CHANNELS]) {
        let recipe = SimulationRecipe::read(&scene, 6, 3, 10).unwrap().observing(observe).unwrap();
        let root = folder.path().join("cache");
        let load = || {
            let made = AtomicUsize::new(0);
            let count = |done, _| made.store(done, Ordering::Relaxed);
            let read = |folder: &Path| read_poses_and_observations(&recipe, folder);
            let (poses, observations) = open_or_make(&recipe, Some(&root), &count, read).unwrap();
            ((poses, rows(&observations, 12)), made.into_inner() > 0)
        };
        let (truth, made) = load();
        assert!(made && load() == (truth.clone(), false), "{observe:?}");
        let entry = root.join(recipe.folder_name()).join(file);
        let bytes = fs::read(&entry).unwrap();
        fs::write(&entry, &bytes[..bytes.len() - 5]).unwrap();
        assert!(load() == (truth.clone(), true) && load() == (truth.clone(), false), "{observe:?}");
        assert_eq!(truth, received(&recipe), "{observe:?}");
    }
}

/// Returns the same data, simulated without a folder.
fn received(recipe: &SimulationRecipe) -> (Vec<Pose>, Vec<Vec<f64>>) {
    let (mut poses, mut rows) = (Vec::new(), Vec::new());
    let simulator = Simulator::new(&recipe.scene).unwrap();
    let request = SimulationRequest { kind: recipe.observe, samples: recipe.samples, seed: recipe.seed };
    simulate_links(&simulator, &request, &AtomicBool::new(false), |_, tx, received| {
        poses.push(Pose::from(tx.to_array()));
        rows.extend(received.into_iter().map(|received| match received.observed {
            SimulatedObservation::Spectrum(spectrum) => spectrum.pixels.into_iter().map(f64::from).collect(),
            SimulatedObservation::Power(dbm) => vec![dbm as Real as f64],
            SimulatedObservation::Channel(h) => {
                h.iter().flat_map(|h| [h.re as f32, h.im as f32]).map(f64::from).collect()
            }
        }));
        Ok(())
    })
    .unwrap();
    (poses, rows)
}

#[test]
fn observation_without_noise_ignores_seed() {
    let scene = crate::SceneFile::parse(SCENE, Path::new("small.ron")).unwrap();
    let other =
        crate::SceneFile { noise: Checked::new(Noise { seed: 5, ..Noise::default() }).unwrap(), ..scene.clone() };
    let readings = [scene, other].map(|scene| {
        let simulator = Simulator::new(&scene).unwrap();
        simulator.receivers()[1]
            .observe([2.0, 2.0, 1.0].into(), &ObservationKind::Power { noise_db: 0.0 }, Some(1))
            .observed
    });
    assert_eq!(readings[0], readings[1]);
}
