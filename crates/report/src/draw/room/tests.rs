//! Tests of the figure of the room.

use super::*;
use crate::canvas::{Shape, Step};
use pwrfgs_core::{GaussianCloud, Origin, Pose, Sample, Spectra};

/// Returns the room of 4 x 3 x 2 m with `points` points and one transmitter per set.
fn room(points: usize) -> (Dataset, Partition) {
    let sample = |id| Sample::new(id, [1.0, 1.0, f64::from(id) / 2.0]);
    let spectra = Spectra::grey((1, 1), vec![0; 2]).unwrap();
    let mut data = Dataset::new("room", Pose::IDENTITY, vec![], vec![sample(1), sample(2)], spectra).unwrap();
    data.scene.bounds = ([0.0; 3], [4.0, 3.0, 2.0]);
    data.scene.points = (0..points).map(|k| [4.0 * k as Real / points as Real, 2.0, 0.0]).collect();
    (data, Partition { train: vec![0], validation: vec![], test: vec![1] })
}

/// Returns a snapshot with these means.
fn snapshot(means: impl IntoIterator<Item = [Real; 3]>) -> Snapshot {
    let means: Vec<_> = means.into_iter().collect();
    let rest = GaussianCloud::zeros(means.len());
    Snapshot::of(0, &GaussianCloud { means, ..rest }, Origin::ZERO)
}

/// Returns the SVG of a panel.
fn svg(panel: &Panel) -> String {
    panel.drawing.svg("room", "")
}

/// Returns the number of drawn circles.
fn circles(panel: &Panel) -> usize {
    svg(panel).matches("<circle").count()
}

#[test]
fn gaussians_outside_frame_are_counted_and_not_drawn() {
    let (data, partition) = room(5);
    let cloud = snapshot([[1.0, 1.0, 1.0], [3.9, 0.1, 1.9], [9.0, 1.0, 1.0], [1.0, 1.0, -7.0]]);
    let panel = RoomFigure::new(&data, &partition, &[&cloud], 10.5).draw_panel("At the start", &cloud, &data);
    assert_eq!(circles(&panel), 2);
    assert_eq!(panel.caption, "2 of 4 are outside the frame");
    assert!(panel.numbers.starts_with("N = 4"));
}

#[test]
fn frame_includes_near_gaussians_and_excludes_outliers() {
    let (data, partition) = room(5);
    let cloud = snapshot([[1.0, 1.0, 1.0], [7.9, 1.0, 1.0], [1.0, -3.9, 5.9]]);
    let panel = RoomFigure::new(&data, &partition, &[&cloud], 10.5).draw_panel("At the start", &cloud, &data);
    assert_eq!((circles(&panel), panel.caption.as_str()), (3, ""));
    // Positions that are not finite are counted and do not change the frame.
    let cloud = snapshot([[1.0, 1.0, 1.0], [Real::NAN, 1.0, 1.0], [1.0, Real::INFINITY, 1.0], [1e30, 1.0, 1.0]]);
    for points in [0, 5] {
        let (data, partition) = room(points);
        let panel = RoomFigure::new(&data, &partition, &[&cloud], 10.5).draw_panel("At the start", &cloud, &data);
        assert_eq!((circles(&panel), panel.caption.as_str()), (1, "3 of 4 are outside the frame"));
        assert!(!svg(&panel).contains("NaN") && !svg(&panel).contains("inf"));
    }
}

#[test]
fn frame_without_points_excludes_isolated_gaussian() {
    let (data, partition) = room(0);
    let cloud = snapshot((0..200).map(|i| [i as Real, 0.0, 0.0]).chain([[1e4, 0.0, 0.0]]));
    let panel = RoomFigure::new(&data, &partition, &[&cloud], 10.5).draw_panel("Final", &cloud, &data);
    assert_eq!((circles(&panel), panel.caption.as_str()), (200, "1 of 201 are outside the frame"));
}

#[test]
fn room_figure_limits_drawn_gaussians_and_file_size() {
    let (data, partition) = room(20_000);
    let cloud = snapshot((0..65_000).map(|i| [i as Real / 16_250.0, 1.0, 1.0]));
    let panel = RoomFigure::new(&data, &partition, &[&cloud], 10.5).draw_panel("At the start", &cloud, &data);
    assert!(svg(&panel).len() < 300_000, "{} bytes", svg(&panel).len());
    assert_eq!(panel.caption, "only the 3,000 most opaque are drawn");
    // Among equal Gaussians, the drawn ones are spread over the whole room.
    let quarter = |k: usize| scattered_order(65_000)[..GAUSSIANS].iter().filter(|i| **i / 16_250 == k).count();
    assert!((0..4).all(|k| (700..800).contains(&quarter(k))));
}

#[test]
fn draws_flat_scene_and_empty_cloud() {
    let (mut data, partition) = room(1);
    data.scene.bounds = ([1.0; 3], [1.0; 3]);
    let panel = RoomFigure::new(&data, &partition, &[], 10.5).draw_panel("At the start", &snapshot([]), &data);
    let svg = svg(&panel);
    assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
}

/// Returns the receiver whose boresight is rotated by an angle, degrees, about an axis of the world.
fn turned(axis: [f64; 3], degrees: f64) -> Pose {
    let (sin, cos) = (degrees.to_radians() / 2.0).sin_cos();
    Pose { position: [2.0, 1.0, 1.0], orientation: [axis[0] * sin, axis[1] * sin, axis[2] * sin, cos] }
}

#[test]
fn arrow_points_along_boresight() {
    let view = RoomView::new([0.0; 3], [4.0, 3.0, 2.0], 10.0);
    // Up, down, along x, against x, along y, against y.
    let poses = [([1.0, 0.0, 0.0], 0.0), ([1.0, 0.0, 0.0], 180.0), ([0.0, 1.0, 0.0], 90.0), ([0.0, 1.0, 0.0], -90.0)];
    let sides = [([1.0, 0.0, 0.0], -90.0), ([1.0, 0.0, 0.0], 90.0)];
    let ahead =
        [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]];
    for ((axis, degrees), ahead) in poses.into_iter().chain(sides).zip(ahead) {
        let pose = turned(axis, degrees);
        let at = view.project(pose.position);
        let [x, y] = view.project([0, 1, 2].map(|k| pose.position[k] + ahead[k]));
        let mut canvas = Canvas::new(10.0, 10.0);
        ReceiverArrow::new(&pose, &view, 0.5).draw(&mut canvas, at);
        let Shape::Path(head, _) = &canvas.shapes[1] else { panic!("no arrow for {ahead:?}") };
        let Step::Move(tip) = head.0[0] else { panic!("{head:?}") };
        let (expected, drawn) = ((y - at[1]).atan2(x - at[0]), (tip[1] - at[1]).atan2(tip[0] - at[0]));
        assert!((expected - drawn).abs() < 1e-5, "{ahead:?}: {expected} {drawn}");
    }
}

#[test]
fn arrow_along_line_of_sight_is_a_ring() {
    let view = RoomView::new([0.0; 3], [4.0, 3.0, 2.0], 10.0);
    // From straight up, turned by 63 degrees in the vertical plane of the viewer.
    let axis = [58f64.to_radians().sin(), 58f64.to_radians().cos(), 0.0];
    for (degrees, shapes, meaning) in [(63.0, 2, "towards"), (63.0 - 180.0, 2, "away"), (20.0, 3, "boresight")] {
        let receiver = ReceiverArrow::new(&turned(axis, degrees), &view, 0.5);
        let mut canvas = Canvas::new(10.0, 10.0);
        receiver.draw(&mut canvas, [5.0, 5.0]);
        assert_eq!(canvas.shapes.len(), shapes, "{degrees}: {receiver:?}");
        assert!(receiver.symbol().meaning.contains(meaning), "{degrees}: {receiver:?}");
    }
}
