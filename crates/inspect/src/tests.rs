//! The measured set, of which the answers are known.

use super::*;
use pwrfgs_core::DataSource as _;
use pwrfgs_core::testing::shared;
use pwrfgs_data::Nerf2Spectrum;
use std::path::Path;

#[test]
fn the_measured_set_is_that_of_a_small_array_and_its_pose_cannot_be_told() {
    let Some(root) = shared("data/s23") else { return };
    let data = Nerf2Spectrum { root, ..Nerf2Spectrum::default() }.load(Path::new(""), &|_, _| {}).unwrap();
    let looks = Looks::of(&data, &|_, _| {}).unwrap();
    let near = |value: f64, expected: f64, by: f64| assert!((value - expected).abs() < by, "{value}, not {expected}");

    let trajectory = trajectory::trajectory(&data);
    assert_eq!((trajectory.samples, trajectory.shared, trajectory.unmatched.positions), (4898, 0, 1225));
    near(trajectory.step(0.5), 0.0106, 0.001);
    let pictures = pictures::pictures(&data, &looks);
    assert_eq!((pictures.stretched, pictures.constant.len(), pictures.twins.len()), (4898, 0, 0));

    let array = freedom::freedom(&data, &looks.each).array.unwrap();
    assert_eq!((array.rows, array.columns, array.kind), (4, 4, Kind::Stretched), "{array:?}");
    assert!(array.explains());
    near(array.spacing, 0.16 * 920e6 / 299_792_458.0, 0.002); // 0.16 m at 920 MHz

    let pose = pose::pose(&data, &looks.each).unwrap();
    assert_eq!(pose.verdict, Verdict::Unclear, "{pose:?}");
    near(pose.recorded, 16.0, 0.7);
    near(pose.turned, 4.4, 0.3);
    near(pose.constant, 5.0, 0.3);
    near(pose.turn, 20.0, 5.0);
}
