//! The pose check for right and wrong poses and for measured data.

use glam::{DQuat, DVec3};
use pwrfgs::experiment::inspect::{Correction, DataSummary, PoseCheck, PoseVerdict};
use pwrfgs::experiment::{Finding, NoopObserver, collect_findings};
use pwrfgs_core::testing::shared;
use pwrfgs_core::{DataSource, Dataset, Location, Plugin, Pose, Sample, Spectra};
use pwrfgs_data::Nerf2Spectrum;
use std::path::Path;
use std::sync::LazyLock;

fn found(data: &Dataset) -> PoseCheck {
    DataSummary::of(data, 20_000, &mut NoopObserver).unwrap().pose.unwrap()
}

/// The office of the quickstart, a few spectra.
static OFFICE: LazyLock<Dataset> = LazyLock::new(|| simulated("office"));

fn simulated(scene: &str) -> Dataset {
    let source = format!("Simulated(scene: \"scenes/{scene}.ron\", samples: 160, cache: false)");
    let base = Path::new(env!("CARGO_MANIFEST_DIR"));
    Plugin::<dyn DataSource>::parse(&source).unwrap().load(base, &|_, _| {}).unwrap()
}

/// The same with another recorded orientation.
fn recorded_as(data: &Dataset, orientation: DQuat) -> Dataset {
    let mut other = data.clone();
    other.scene.receivers[0].pose.orientation = orientation.to_array();
    other
}

#[test]
fn pose_check_confirms_correct_pose_and_corrects_wrong_pose() {
    let data = &*OFFICE;
    let right = found(data);
    assert_eq!(right.verdict, PoseVerdict::Right, "{right:?}");
    assert!(right.turn < 1.0 && right.recorded < 4.0 && right.constant > 3.0 * right.turned, "{right:?}");
    assert!(right.sentences()[0].contains("; one constant direction for all transmitters leaves "));

    let truth = DQuat::from_array(data.scene.pose().orientation);
    let error = DQuat::from_axis_angle(DVec3::new(1.0, -2.0, 0.5).normalize(), 0.6);
    let wrong = found(&recorded_as(data, (truth * error).normalize()));
    assert_eq!(wrong.verdict, PoseVerdict::Off);
    let mended = DQuat::from_array(wrong.orientation).angle_between(truth).to_degrees();
    assert!(mended < 1.0 && (wrong.turn - 0.6f64.to_degrees()).abs() < 1.0, "{mended}, {wrong:?}");
    assert!(wrong.sentences().iter().any(|s| s.contains("This orientation fits: [")));
}

/// A few transmitters, seen within some degrees: the best rotation gains less than a pixel.
#[test]
fn correct_pose_of_a_narrow_view_gives_no_finding() {
    let data = simulated("lab-s23");
    assert_eq!(collect_findings(&data, None).unwrap(), []);
}

#[test]
fn recognises_quaternion_in_other_order() {
    let data = &*OFFICE;
    let [x, y, z, w] = data.scene.pose().orientation;
    let found = found(&recorded_as(data, DQuat::from_xyzw(w, x, y, z)));
    assert_eq!(found.verdict, PoseVerdict::Off);
    assert!(
        found.sentences().iter().any(|s| s.contains("If the recorded numbers are w, x, y, z, the")),
        "{:?}",
        found.sentences()
    );
}

#[test]
fn recognises_wrong_orientations_of_a_moving_receiver() {
    let data = simulated("office-moving");
    let recorded_as = |change: &dyn Fn(DQuat) -> DQuat| {
        let mut data = data.clone();
        for Location { pose, .. } in &mut data.locations {
            pose.orientation = change(DQuat::from_array(pose.orientation)).normalize().to_array();
        }
        found(&data)
    };
    let right = recorded_as(&|q| q);
    assert!(right.verdict == PoseVerdict::Right && right.recorded < 4.0, "{right:?}");
    let words = |found: &PoseCheck| (found.verdict, found.sentences().concat());
    let conjugate = words(&recorded_as(&|q| q.conjugate()));
    assert!(conjugate.0 == PoseVerdict::Off && conjugate.1.contains("turned the other way"), "{conjugate:?}");
    let order = words(&recorded_as(&|q| DQuat::from_xyzw(q.w, q.x, q.y, q.z)));
    assert!(
        order.0 == PoseVerdict::Off && order.1.contains("If the recorded numbers are w, x, y, z, the"),
        "{order:?}"
    );

    let error = DQuat::from_axis_angle(DVec3::new(1.0, -2.0, 0.5).normalize(), 0.6);
    for (found, correction) in
        [(recorded_as(&|q| q * error), Correction::Right), (recorded_as(&|q| error * q), Correction::Left)]
    {
        assert!(found.verdict == PoseVerdict::Off && found.correction == correction, "{found:?}");
        let left = DQuat::from_array(found.orientation).angle_between(error.inverse()).to_degrees();
        assert!(left < 2.0, "{left}: {found:?}");
    }
}

/// The spectra with rows or columns reversed.
fn flipped(data: &Dataset, flip: impl Fn(&mut [u8], usize)) -> Dataset {
    let (width, mut pixels) = (data.width, Vec::new());
    for i in 0..data.len() {
        let mut own = data.observations.raw(i).into_owned();
        flip(&mut own, width);
        pixels.extend(own);
    }
    Dataset { observations: Spectra::grey((width, data.height), pixels).unwrap().into(), ..data.clone() }
}

#[test]
fn counts_black_spectra_among_others() {
    let number = std::cell::Cell::new(0);
    let data = flipped(&OFFICE, |pixels, _| {
        number.set(number.get() + 1);
        if number.get() % 2 == 0 {
            pixels.fill(0);
        }
    });
    let found = collect_findings(&data, None).unwrap();
    let [Finding { name, count: 80, .. }] = &found[..] else { panic!("{found:?}") };
    assert_eq!(name, "constant-spectra");
}

#[test]
fn reports_mirrored_spectra() {
    let data = &*OFFICE;
    let columns = |pixels: &mut [u8], width| pixels.chunks_exact_mut(width).for_each(<[u8]>::reverse);
    let rows = |pixels: &mut [u8], width| {
        pixels.reverse();
        columns(pixels, width);
    };
    let message = |data: &Dataset| {
        let found = found(data);
        (found.verdict, found.sentences().concat())
    };
    let mirrored = message(&flipped(data, columns));
    assert!(
        mirrored.0 == PoseVerdict::Flipped && mirrored.1.contains("save the spectra as s[:, :, ::-1]"),
        "{mirrored:?}"
    );
    let upside_down = message(&flipped(data, rows));
    assert!(upside_down.0 == PoseVerdict::Flipped && upside_down.1.contains("s[:, ::-1, :]"), "{upside_down:?}");
    // Beside an orientation that is off, too.
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, -2.0, 0.5).normalize(), 0.6);
    let truth = DQuat::from_array(data.scene.pose().orientation);
    let both = message(&recorded_as(&flipped(data, columns), (truth * turn).normalize()));
    assert!(both.0 == PoseVerdict::Flipped && both.1.contains("and the rotation that then fits best"), "{both:?}");
    assert!(!message(data).1.contains("reversed"), "nothing is said of spectra that are right");
}

#[test]
fn pose_check_of_few_or_constant_spectra_is_inconclusive() {
    let samples = (1..=30).map(|id| Sample::new(id, [f64::from(id), 1.0, 1.0])).collect();
    let spectra = Spectra::grey((8, 2), vec![7; 30 * 16]).unwrap();
    let data = Dataset::new("flat", Pose::IDENTITY, vec![], samples, spectra).unwrap();
    assert!(DataSummary::of(&data, 100, &mut NoopObserver).unwrap().pose.is_none());
}

#[test]
fn pose_check_of_s23_is_inconclusive() {
    let Some(root) = shared("data/s23") else { return };
    let data = Nerf2Spectrum { root, ..Nerf2Spectrum::default() }.load(Path::new(""), &|_, _| {}).unwrap();
    let near = |value: f64, expected: f64, by: f64| assert!((value - expected).abs() < by, "{value}, not {expected}");
    let summary = DataSummary::of(&data, 20_000, &mut NoopObserver).unwrap();
    let text = summary.facts.iter().map(|(name, words)| format!("{name}: {words}")).collect::<Vec<_>>().join("\n");
    for words in [
        "10.6 mm from an id to the next",
        "ids follow a trajectory",
        "each spectrum runs from 0 to 1",
        "none constant, none equal to another",
        "1225 positions without a spectrum",
    ] {
        assert!(text.contains(words), "`{words}` is not in {text}");
    }
    let pose = summary.pose.unwrap();
    assert_eq!(pose.verdict, PoseVerdict::Unclear, "{pose:?}");
    near(pose.recorded, 16.0, 0.7);
    near(pose.turned, 4.4, 0.3);
    near(pose.constant, 5.0, 0.3);
    near(pose.turn, 20.0, 5.0);
}
