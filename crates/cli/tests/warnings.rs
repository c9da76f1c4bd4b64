//! Data in wrong units or in a wrong order can be read: every command that loads them warns once, with what to do.

use crate::common::{stderr, succeed, write};
use pwrfgs::data::{npy_header, save};
use pwrfgs_core::{Dataset, Number, Observations, Pose, Real, Receiver, Sample};
use std::path::Path;

const COUNT: usize = 60;

/// A hall of 10 m by 6 m, metres and dBm.
fn hall() -> (Vec<[f64; 3]>, Vec<f64>) {
    let positions: Vec<[f64; 3]> =
        (0..COUNT).map(|k| [(k * 7 % 60) as f64 / 6.0, (k * 11 % 60) as f64 / 10.0, 1.0]).collect();
    let power = |p: &[f64; 3]| -40.0 - 10.0 * (1.0 + p[0] * p[0] + p[1] * p[1]).log10();
    let powers = positions.iter().map(power).collect();
    (positions, powers)
}

/// A folder of powers, a third of them the test set, and a pipeline beside it.
fn powers(here: &Path, name: &str, (positions, powers): (Vec<[f64; 3]>, Vec<f64>), is_swapped: bool) {
    let samples: Vec<Sample> = (0..).zip(positions).map(|(id, tx)| Sample::new(id, tx)).collect();
    let receivers = vec![Receiver::new("hall", Pose { position: [0.0, 0.0, 2.5], ..Pose::IDENTITY })];
    let observations = Observations::Powers(powers.into_iter().map(|dbm| dbm as Real).collect());
    let data = Dataset::of_links(name, receivers, vec![], &samples, observations).unwrap();
    let (test, train) = (0..COUNT).partition(|k| k % 3 == 0);
    let official = Some(if is_swapped { (test, train) } else { (train, test) });
    save(&Dataset { official, ..data }, &here.join(name)).unwrap();
    let text = format!(
        "Pipeline(name: \"p\", data: Nerf2Rssi(root: \"{name}\"), initializer: Grid(count: 12), readout: \
         ReceivedPower(sky_deg: 30), deformation: Factored(depth: 1, width: 8, tx_encoding: Octaves(1)), training: (steps: 4, \
         batch: 4, densify_until: 2, prune_until: 3, prune_every: 1, validate_every: 0, densify: (every: 0)), baselines: \
         [NearestNeighbours(k: 1)], metrics: [PowerError()])"
    );
    write(&here.join(format!("{name}.ron")), text);
}

/// All warnings of a command that succeeds.
fn warned(here: &Path, arguments: &[&str]) -> Vec<String> {
    let message = stderr(&succeed(here, arguments));
    message.lines().filter(|line| line.starts_with("warning: ")).map(str::to_owned).collect()
}

#[test]
fn warns_once_of_wrong_units_and_axis_order() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let with_positions = |change: &dyn Fn([f64; 3]) -> [f64; 3]| (hall().0.into_iter().map(change).collect(), hall().1);
    let with_powers = |change: &dyn Fn(f64) -> f64| (hall().0, hall().1.into_iter().map(change).collect());
    for (name, data, is_swapped, words) in [
        ("right", hall(), false, ""),
        ("centimetres", with_positions(&|p| p.map(|v| 100.0 * v)), false, "convert them to metres"),
        ("alike", with_positions(&|_| [1.0, 2.0, 1.0]), false, "all 60 transmitters are at [1.0, 2.0, 1.0]"),
        ("milliwatts", with_powers(&|dbm| 10_f64.powf(dbm / 10.0)), false, "all lie within 0.1 of zero"),
        ("strong", with_powers(&|dbm| dbm + 91.0), false, "give 10 * log10(mW)"),
        ("equal", with_powers(&|_| -60.0), false, "all 60 are equal"),
        ("swapped", hall(), true, "exchange train_index.txt and test_index.txt"),
    ] {
        powers(here, name, data, is_swapped);
        let (pipeline, written) = (format!("{name}.ron"), format!("{name}-new.ron"));
        let run = format!("run-{name}");
        for arguments in [
            &["init", name, "--out", &written][..],
            &["inspect", name],
            &["check", &pipeline],
            &["run", &pipeline, "--out", &run],
        ] {
            let found = warned(here, arguments);
            let expected = usize::from(!words.is_empty());
            assert!(found.len() == expected && found.iter().all(|one| one.contains(words)), "{arguments:?}: {found:?}");
        }
    }
    // A small training set may be what is asked for; warnings are also printed with -q.
    assert!(warned(here, &["check", "right.ron", "--set", "split=Sparse(train: 20)"]).is_empty());
    assert_eq!(warned(here, &["check", "right.ron", "--set", "split=Random(test: 0.8)"]).len(), 1);
    assert_eq!(warned(here, &["check", "swapped.ron", "-q"]).len(), 1);
    // The runs of a sweep load the same data.
    write(&here.join("e.ron"), "Experiment(name: \"e\", join: true, base: \"swapped.ron\", seeds: [0, 1])");
    assert_eq!(warned(here, &["sweep", "e.ron", "--dry-run"]).len(), 1);
    assert_eq!(warned(here, &["sweep", "e.ron"]).len(), 1);
}

#[test]
fn import_warns_of_wrong_units() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let array = |number, shape: &[usize], bytes: Vec<u8>| -> Vec<u8> { [npy_header(number, shape), bytes].concat() };
    let positions = hall().0.into_iter().flat_map(|p| p.map(|v| 100.0 * v)).flat_map(f64::to_le_bytes).collect();
    write(&here.join("tx.npy"), array(Number::F64, &[COUNT, 3], positions));
    write(&here.join("s.npy"), array(Number::U8, &[COUNT, 6, 24], vec![200; COUNT * 24 * 6]));
    let pose = ["--receiver", "0,0,1", "--orientation", "0,0,0,1", "--out", "mine", "-q"];
    let found = warned(here, &[&["import", "--spectra", "s.npy", "--tx", "tx.npy"][..], &pose].concat());
    let words = ["convert them to metres", "all 60 are equal"];
    assert!(found.len() == 2 && found.iter().zip(words).all(|(one, words)| one.contains(words)), "{found:?}");
}
