//! Check of the point cloud: its extent against that of the transmitters, which are inside the room that it describes.

use super::finding::Finding;
use pwrfgs_core::Dataset;

/// Smallest number of points that describe a room.
const FEWEST: usize = 20;
/// Distance from the cloud, as a share of its longest side, within which a position counts as inside.
const MARGIN: f64 = 0.1;
/// Share of positions outside that another meaning of the coordinates must explain.
const OUTSIDE: f64 = 0.1;
/// Ratio of the longest sides of cloud and positions above which one of them is in another unit.
const RATIO: f64 = 50.0;

/// Another meaning of the coordinates of a cloud, its correction, and the point that it then means.
type Meaning = (&'static str, &'static str, fn([f64; 3]) -> [f64; 3]);
const MEANINGS: [Meaning; 5] = [
    ("in millimetres", "divide its coordinates by 1000", |p| p.map(|v| v / 1000.0)),
    ("in centimetres", "divide its coordinates by 100", |p| p.map(|v| v / 100.0)),
    ("in inches", "multiply its coordinates by 0.0254", |p| p.map(|v| 0.0254 * v)),
    ("one with y up", "save its columns as x, -z, y", |[x, y, z]| [x, -z, y]),
    ("one with y up, left-handed", "save its columns as x, z, y", |[x, y, z]| [x, z, y]),
];

/// Smallest and largest corner.
pub(crate) type Extent = [[f64; 3]; 2];

/// Returns the extent of points; `None` without a point.
pub(crate) fn extent(points: impl IntoIterator<Item = [f64; 3]>) -> Option<Extent> {
    let corners = points.into_iter().map(|p| [p, p]);
    corners.reduce(|[a, b], [p, q]| [[0, 1, 2].map(|k| a[k].min(p[k])), [0, 1, 2].map(|k| b[k].max(q[k]))])
}

/// Formats an extent: `x 0.10 to 4.90, y 0.00 to 5.00, z 0.00 to 2.98 m`.
pub(crate) fn format_extent([low, high]: Extent) -> String {
    // Adding 0 turns -0 into 0.
    let axis = |k: usize| format!("{} {:.2} to {:.2}", ["x", "y", "z"][k], low[k] + 0.0, high[k] + 0.0);
    format!("{} m", [0, 1, 2].map(axis).join(", "))
}

/// Returns the longest side, in the unit of the extent.
pub(crate) fn longest_side([low, high]: Extent) -> f64 {
    (0..3).map(|k| high[k] - low[k]).fold(0.0, f64::max)
}

/// Finds a point cloud that does not contain the transmitters, and the unit or axes by which it would. `None` for a cloud
/// with less than the share [`OUTSIDE`] of them outside, with few points, or of a part of the room.
pub(super) fn check_cloud(data: &Dataset) -> Option<Finding> {
    let origin = data.scene.origin;
    let points: Vec<[f64; 3]> = data.scene.points.iter().map(|point| origin.world(*point)).collect();
    let transmitters: Vec<[f64; 3]> = data.locations.iter().map(pwrfgs_core::Location::position).collect();
    let fixed = data.scene.fixed_ends().into_iter().map(|pose| origin.world_pose(pose).position);
    let positions: Vec<[f64; 3]> = transmitters.iter().copied().chain(fixed).collect();
    let (cloud, of_transmitters) = (extent(points.iter().copied())?, extent(transmitters.iter().copied())?);
    let site = longest_side(extent(positions.iter().copied())?);
    // Number of transmitters outside; `None` if the units differ.
    let outside = |cloud: Extent| {
        let (margin, ratio) = (MARGIN * longest_side(cloud), longest_side(cloud) / site);
        let is_outside = |p: &&[f64; 3]| (0..3).any(|k| !(cloud[0][k] - margin..=cloud[1][k] + margin).contains(&p[k]));
        (site == 0.0 || (1.0 / RATIO..RATIO).contains(&ratio)).then(|| transmitters.iter().filter(is_outside).count())
    };
    let recorded = outside(cloud);
    if points.len() < FEWEST || recorded.is_some_and(|count| (count as f64) < OUTSIDE * transmitters.len() as f64) {
        return None;
    }
    let fits = |(.., corrected): &&Meaning| {
        let moved = extent(points.iter().map(|point| corrected(*point)));
        moved.and_then(outside).is_some_and(|count| count == 0)
    };
    let mend = match MEANINGS.iter().find(fits) {
        Some((name, advice, _)) => format!("if the cloud is {name}, {advice}"),
        // A cloud of a part of the room.
        None if recorded.is_some_and(|count| count < transmitters.len()) => return None,
        None => "give both in metres, in one frame".into(),
    };
    let count = recorded.unwrap_or(transmitters.len());
    let subject = if data.scene.moving.is_receiver() { "receiver" } else { "transmitters" };
    let (cloud, of_transmitters) = (format_extent(cloud), format_extent(of_transmitters));
    let problem = format!("cloud and {subject} differ in unit or frame: cloud {cloud}; {subject} {of_transmitters}");
    Some(Finding::new("point-cloud", count, problem, mend))
}
