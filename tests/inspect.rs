//! The pose check on poses that are right, on one that is wrong, and on the measured set.

use glam::{DQuat, DVec3};
use pwrfgs::experiment::Silent;
use pwrfgs::experiment::inspect::{DataSummary, PoseCheck, Verdict};
use pwrfgs_core::testing::shared;
use pwrfgs_core::{DataSource, Dataset, Plugin, Pose, Sample, Spectra};
use pwrfgs_data::Nerf2Spectrum;
use std::path::Path;
use std::sync::LazyLock;

fn found(data: &Dataset) -> PoseCheck {
    DataSummary::of(data, 20_000, &mut Silent).unwrap().pose.unwrap()
}

/// The office of the quickstart, a few spectra.
static OFFICE: LazyLock<Dataset> = LazyLock::new(|| {
    let source = r#"Simulated(scene: "scenes/office.ron", samples: 160, cache: false)"#;
    let base = Path::new(env!("CARGO_MANIFEST_DIR"));
    Plugin::<dyn DataSource>::parse(source).unwrap().load(base, &|_, _| {}).unwrap()
});

/// The same with another recorded orientation.
fn recorded_as(data: &Dataset, orientation: DQuat) -> Dataset {
    let mut other = data.clone();
    other.scene.receivers[0].pose.orientation = orientation.to_array();
    other
}

#[test]
fn the_pose_of_a_simulated_office_comes_out_right_and_a_wrong_one_is_mended() {
    let data = &*OFFICE;
    let right = found(data);
    assert_eq!(right.verdict, Verdict::Right, "{right:?}");
    assert!(right.turn < 1.0 && right.recorded < 4.0 && right.constant > 3.0 * right.turned, "{right:?}");

    let truth = DQuat::from_array(data.scene.pose().orientation);
    let error = DQuat::from_axis_angle(DVec3::new(1.0, -2.0, 0.5).normalize(), 0.6);
    let wrong = found(&recorded_as(data, (truth * error).normalize()));
    assert_eq!(wrong.verdict, Verdict::Off);
    let mended = DQuat::from_array(wrong.orientation).angle_between(truth).to_degrees();
    assert!(mended < 1.0 && (wrong.turn - 0.6f64.to_degrees()).abs() < 1.0, "{mended}, {wrong:?}");
    assert!(wrong.sentences().iter().any(|s| s.contains("This orientation fits: [")));
}

#[test]
fn a_quaternion_in_another_order_is_recognised() {
    let data = &*OFFICE;
    let [x, y, z, w] = data.scene.pose().orientation;
    let found = found(&recorded_as(data, DQuat::from_xyzw(w, x, y, z)));
    assert_eq!(found.verdict, Verdict::Off);
    assert!(
        found.sentences().iter().any(|s| s.contains("If the recorded numbers are w, x, y, z, the")),
        "{:?}",
        found.sentences()
    );
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
fn spectra_that_run_the_other_way_are_named() {
    let data = &*OFFICE;
    let columns = |pixels: &mut [u8], width| pixels.chunks_exact_mut(width).for_each(<[u8]>::reverse);
    let rows = |pixels: &mut [u8], width| {
        pixels.reverse();
        columns(pixels, width);
    };
    let said = |data: &Dataset| {
        let found = found(data);
        (found.verdict, found.sentences().concat())
    };
    let mirrored = said(&flipped(data, columns));
    assert!(mirrored.0 == Verdict::Flipped && mirrored.1.contains("save the spectra as s[:, :, ::-1]"), "{mirrored:?}");
    let upside_down = said(&flipped(data, rows));
    assert!(upside_down.0 == Verdict::Flipped && upside_down.1.contains("s[:, ::-1, :]"), "{upside_down:?}");
    // Beside an orientation that is off, too.
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, -2.0, 0.5).normalize(), 0.6);
    let truth = DQuat::from_array(data.scene.pose().orientation);
    let both = said(&recorded_as(&flipped(data, columns), (truth * turn).normalize()));
    assert!(both.0 == Verdict::Flipped && both.1.contains("and the rotation that then fits best"), "{both:?}");
    assert!(!said(data).1.contains("reversed"), "nothing is said of spectra that are right");
}

#[test]
fn few_or_constant_pictures_say_nothing() {
    let samples = (1..=30).map(|id| Sample::new(id, [f64::from(id), 1.0, 1.0])).collect();
    let spectra = Spectra::grey((8, 2), vec![7; 30 * 16]).unwrap();
    let data = Dataset::new("flat", Pose::IDENTITY, vec![], samples, spectra).unwrap();
    assert!(DataSummary::of(&data, 100, &mut Silent).unwrap().pose.is_none());
}

#[test]
fn the_pose_of_the_measured_set_cannot_be_told() {
    let Some(root) = shared("data/s23") else { return };
    let data = Nerf2Spectrum { root, ..Nerf2Spectrum::default() }.load(Path::new(""), &|_, _| {}).unwrap();
    let near = |value: f64, expected: f64, by: f64| assert!((value - expected).abs() < by, "{value}, not {expected}");
    let summary = DataSummary::of(&data, 20_000, &mut Silent).unwrap();
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
    assert_eq!(pose.verdict, Verdict::Unclear, "{pose:?}");
    near(pose.recorded, 16.0, 0.7);
    near(pose.turned, 4.4, 0.3);
    near(pose.constant, 5.0, 0.3);
    near(pose.turn, 20.0, 5.0);
}
