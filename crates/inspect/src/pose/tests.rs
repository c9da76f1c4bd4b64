//! Poses that are known, one that is wrong, and the measured one.

use super::*;
use crate::look::Looks;
use glam::DVec3;
use pwrfgs_core::{DataSource, Plugin, Sample, Spectra};
use pwrfgs_data as _;
use pwrfgs_sim as _;
use std::path::Path;

fn found(data: &Dataset) -> Pose {
    pose(data, &Looks::of(data, &|_, _| {}).unwrap().each).unwrap()
}

fn load(source: &str) -> Dataset {
    let base = Path::new(env!("CARGO_MANIFEST_DIR"));
    Plugin::<dyn DataSource>::parse(source).unwrap().load(base, &|_, _| {}).unwrap()
}

/// The office of the quickstart, a few spectra.
fn office() -> Dataset {
    load(r#"Simulated(scene: "../../scenes/office.ron", samples: 160, cache: false)"#)
}

/// The same with another recorded orientation.
fn recorded_as(data: &Dataset, orientation: DQuat) -> Dataset {
    let mut other = data.clone();
    other.scene.receivers[0].pose.orientation = orientation.to_array();
    other
}

#[test]
fn the_pose_of_a_simulated_office_comes_out_right_and_a_wrong_one_is_mended() {
    let data = office();
    let right = found(&data);
    assert_eq!(right.verdict, Verdict::Right, "{right:?}");
    assert!(right.turn < 1.0 && right.recorded < 4.0 && right.constant > 3.0 * right.turned, "{right:?}");

    let truth = DQuat::from_array(data.scene.pose().orientation);
    let error = DQuat::from_axis_angle(DVec3::new(1.0, -2.0, 0.5).normalize(), 0.6);
    let wrong = found(&recorded_as(&data, (truth * error).normalize()));
    assert_eq!(wrong.verdict, Verdict::Off);
    let mended = DQuat::from_array(wrong.orientation).angle_between(truth).to_degrees();
    assert!(mended < 1.0 && (wrong.turn - 0.6f64.to_degrees()).abs() < 1.0, "{mended}, {wrong:?}");
    assert!(wrong.sentences().iter().any(|s| s.contains("This orientation fits: [")));
}

#[test]
fn a_quaternion_in_another_order_is_recognised() {
    let data = office();
    let [x, y, z, w] = data.scene.pose().orientation;
    let found = found(&recorded_as(&data, DQuat::from_xyzw(w, x, y, z)));
    assert_eq!(found.verdict, Verdict::Off);
    assert!(found.sentences().iter().any(|s| s.contains("Taken as w, x, y, z, the")), "{:?}", found.readings);
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
    let data = office();
    let columns = |pixels: &mut [u8], width| pixels.chunks_exact_mut(width).for_each(<[u8]>::reverse);
    let rows = |pixels: &mut [u8], width| {
        pixels.reverse();
        columns(pixels, width);
    };
    let said = |data: &Dataset| (found(data).verdict, found(data).sentences().concat());
    let mirrored = said(&flipped(&data, columns));
    assert!(mirrored.0 == Verdict::Flipped && mirrored.1.contains("save the spectra as s[:, :, ::-1]"), "{mirrored:?}");
    let upside_down = said(&flipped(&data, rows));
    assert!(upside_down.0 == Verdict::Flipped && upside_down.1.contains("s[:, ::-1, :]"), "{upside_down:?}");
    // Beside an orientation that is off, too.
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, -2.0, 0.5).normalize(), 0.6);
    let truth = DQuat::from_array(data.scene.pose().orientation);
    let both = said(&recorded_as(&flipped(&data, columns), (truth * turn).normalize()));
    assert!(both.0 == Verdict::Flipped && both.1.contains("and the rotation that then fits best"), "{both:?}");
    assert!(!said(&data).1.contains("reversed"), "nothing is said of spectra that are right");
}

#[test]
fn few_or_constant_pictures_say_nothing() {
    let samples = (1..=30).map(|id| Sample::new(id, [f64::from(id), 1.0, 1.0])).collect();
    let spectra = Spectra::grey((8, 2), vec![7; 30 * 16]).unwrap();
    let data = Dataset::new("flat", pwrfgs_core::Pose::IDENTITY, vec![], samples, spectra).unwrap();
    assert!(pose(&data, &Looks::of(&data, &|_, _| {}).unwrap().each).is_none());
}
