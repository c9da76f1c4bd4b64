//! Checks of the positions: equal ones, their unit, degrees, and an index or a time in place of a coordinate.

use super::cloud::{extent, longest_side};
use super::finding::{Finding, moving_end};
use pwrfgs_core::neighbours::{distance, nearest_others};
use pwrfgs_core::statistics::{deviation, mean, median};
use pwrfgs_core::{Dataset, Real};

/// Largest and smallest plausible site and largest spacing of transmitters in metres; other positions are probably in
/// another unit.
const SITE_M: f64 = 100.0;
const SPACING_M: f64 = 3.0;
const SMALL_SITE_M: f64 = 0.05;
/// Longest side of a site in degrees, largest spacing there, and smallest ratio of distance from zero to the longest side.
const SITE_DEG: f64 = 1.0;
const SPACING_DEG: f64 = 0.002;
const OFFSET: f64 = 20.0;
/// Difference of the heights of both ends above which these are not in metres, and its ratio to the site.
const HEIGHT_M: f64 = 50.0;
const STEEP: f64 = 0.08;
/// Largest median of power plus free-space loss over the distance at 433 MHz: 4 W are received with 11 dBm at 1 m.
const STRONGEST_DBM: f64 = 11.0;
/// Longest side of a site above which positions without distances may be in another unit, metres.
const WIDE_M: f64 = 5e3;
/// Distance of all receivers from all transmitters above which they are in different frames, metres.
const APART_M: f64 = 1e5;
/// Smallest number of rows in which a coordinate may be an index, largest deviation of its steps from their mean as a share, and
/// number of rows per turn of another coordinate.
const ROWS: usize = 20;
const UNEVEN: f64 = 0.5;
const TURNS: usize = 5;
/// Standard deviation of the steps of a coordinate that changes, metres.
const MOVED_M: f64 = 1e-3;

/// Finds positions that are probably not in metres, far from the fixed ends, all equal, or with an index or a time as a
/// coordinate.
pub(super) fn check_positions(data: &Dataset) -> Vec<Finding> {
    let positions: Vec<[f64; 3]> = data.locations.iter().map(pwrfgs_core::Location::position).collect();
    let Some(first) = positions.first().filter(|_| positions.len() > 1) else { return Vec::new() };
    let count = positions.len();
    if positions.iter().all(|position| position == first) {
        let end = moving_end(data);
        let problem = format!("all {count} {end}s are at {first:?}");
        return vec![Finding::new("equal-positions", count, problem, format!("give each {end} its own position"))];
    }
    let unit = if data.camera().is_some() {
        None
    } else {
        check_apart(data, &positions).or_else(|| check_unit(data, &positions))
    };
    check_index(data, &positions).into_iter().chain(unit).collect()
}

/// Finds fixed ends that are far from all positions, such as those with latitude and longitude exchanged; `None` if one is near,
/// or if their positions are unknown.
fn check_apart(data: &Dataset, positions: &[[f64; 3]]) -> Option<Finding> {
    let fixed = data.scene.fixed_ends().into_iter().map(|pose| data.scene.origin.world_pose(pose).position);
    let apart = fixed.flat_map(|end| positions.iter().map(move |at| distance(end, *at))).fold(f64::INFINITY, f64::min);
    let problem = format!("the fixed ends of the links are {:.0} km from all positions", apart / 1e3);
    let mend = "give both in one frame; latitude and longitude of one may be exchanged";
    (data.scene.has_distances() && apart > APART_M)
        .then(|| Finding::new("position-unit", positions.len(), problem, mend))
}

/// Finds a coordinate that rises evenly with the row, as an index or a time does, while another coordinate changes
/// independently of it; `None` without such a coordinate, or for fewer than [`ROWS`] positions.
fn check_index(data: &Dataset, positions: &[[f64; 3]]) -> Option<Finding> {
    let steps = |k: usize| positions.windows(2).map(|pair| pair[1][k] - pair[0][k]).collect::<Vec<f64>>();
    let steps = [steps(0), steps(1), steps(2)];
    let middle = |k: usize| mean(steps[k].iter().copied());
    let is_whole = |k: usize| positions.iter().all(|position| position[k].fract() == 0.0);
    let is_index = |k: &usize| {
        let step = middle(*k);
        let is_counted = steps[*k].iter().all(|value| *value == 1.0) && is_whole(*k);
        let is_even = step > 0.0 && steps[*k].iter().all(|value| (value - step).abs() <= UNEVEN * step);
        // Steps of exactly 1 are evidence enough beside a coordinate that varies: metres have fractions.
        let is_independent = |other: usize| {
            is_to_and_fro(&steps[other], step) || is_counted && !is_whole(other) && deviation(&steps[other]) > MOVED_M
        };
        is_even && (0..3).any(|other| other != *k && is_independent(other))
    };
    let axis = (0..3).find(is_index).filter(|_| positions.len() >= ROWS)?;
    let (name, step, at, id) = (["x", "y", "z"][axis], middle(axis), positions[0][axis], data.locations[0].id);
    let end = moving_end(data);
    let problem = format!(
        "{name} rises by {step:.3} from row to row, as an index or a time does (for example {at} at {end} {id})"
    );
    Some(Finding::new("index-coordinate", positions.len(), problem, "give x, y and z in metres"))
}

/// Returns whether a coordinate with these `steps` turns back often and in steps of varying length, compared with `step`, the
/// mean step of a coordinate that rises evenly.
fn is_to_and_fro(steps: &[f64], step: f64) -> bool {
    let turns = steps.windows(2).filter(|pair| pair[0] * pair[1] < 0.0).count();
    TURNS * turns > steps.len() + 1 && deviation(steps) > UNEVEN * step
}

/// Finds positions that are probably in degrees or in another unit of length; `None` if metres are plausible.
fn check_unit(data: &Dataset, positions: &[[f64; 3]]) -> Option<Finding> {
    let [low, high] = extent(positions.iter().copied())?.map(round);
    let (site, end, id) = (longest_side([low, high]), moving_end(data), data.locations[0].id);
    let spacing = median_spacing(positions);
    let finding = |name: &str, problem: String, mend: &str| {
        let problem = format!("{problem} (for example {end} {id} at {:?})", round(positions[0]));
        Some(Finding::new(name, positions.len(), problem, mend))
    };
    let horizontal = (high[0] - low[0]).max(high[1] - low[1]);
    let is_angle = low[0].abs().max(high[0].abs()) <= 180.0 && low[1].abs().max(high[1].abs()) <= 180.0;
    let horizontal_spacing = median_spacing(&positions.iter().map(|p| [p[0], p[1], 0.0]).collect::<Vec<_>>());
    let is_site = horizontal > 0.0 && horizontal < SITE_DEG && horizontal_spacing < SPACING_DEG;
    if is_angle && is_site && low[0].hypot(low[1]) > OFFSET * horizontal {
        let problem = format!("x and y look like degrees: x {} to {}, y {} to {}", low[0], high[0], low[1], high[1]);
        let mend = "convert latitude and longitude to metres (`--lat-lon` of `pwrfgs import --table`)";
        return finding("position-unit", problem, mend);
    }
    if site < SMALL_SITE_M {
        let problem = format!("the site is only {:.3} mm long", 1e3 * site);
        return finding("position-unit", problem, "if these are kilometres or degrees, convert them to metres");
    }
    if site <= SITE_M || spacing <= SPACING_M {
        return None;
    }
    let problem =
        format!("the site is {site:.0} m long and the median distance to the nearest {end} is {spacing:.1} m");
    let mend = "if these are millimetres or centimetres, convert them to metres";
    match data.observations.powers() {
        Some(powers) => finding("large-site", format!("{problem}, {}", large_site_fault(data, powers, site)?), mend),
        None => finding("large-site", problem, mend),
    }
}

/// Rounds a position to 1e-7, a centimetre in degrees.
pub(super) fn round(position: [f64; 3]) -> [f64; 3] {
    position.map(|v| (v * 1e7).round() / 1e7)
}

/// Returns the median distance to the nearest other position, in the unit of the positions.
fn median_spacing(positions: &[[f64; 3]]) -> f64 {
    median(nearest_others(positions).into_iter().flatten().map(|(distance, _)| distance))
}

/// Describes what contradicts a large `site` of this length in metres: heights, links stronger than free space allows, or its
/// size if distances are unknown. `None` if nothing does, as for a campus.
fn large_site_fault(data: &Dataset, powers: &[Real], site: f64) -> Option<String> {
    if !data.scene.has_distances() {
        return (site > WIDE_M).then(|| "and the positions of the receivers are unknown".into());
    }
    let ends = |i: usize| data.link_ends(i).map(|pose| pose.position);
    let height = median((0..data.len()).map(|i| (ends(i)[0][2] - ends(i)[1][2]).abs()));
    let loss = |i: usize| 20.0 * distance(ends(i)[0], ends(i)[1]).max(1.0).log10();
    let strength = median((0..data.len()).map(|i| powers[i] as f64 + loss(i)));
    if height > HEIGHT_M.max(STEEP * site) {
        return Some(format!("and the heights of both ends differ by {height:.0} m"));
    }
    let limit =
        format!("and the links are {:.0} dB stronger than those of 4 W in free space", strength - STRONGEST_DBM);
    (strength > STRONGEST_DBM).then_some(limit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Ends, Pose, Receiver, Sample};

    #[test]
    fn finding_names_the_end_that_moves() {
        let ends = Ends::of_moving_receivers(vec![Receiver::new("array", Pose::IDENTITY)], None);
        let samples = [1, 2].map(|id| Sample::new(id, Pose::IDENTITY));
        let powers = vec![-40.0, -50.0].into();
        let data = Dataset::of_links("hall", ends, vec![], &samples, powers).unwrap();
        assert_eq!(check_positions(&data)[0].problem, "all 2 receiver poses are at [0.0, 0.0, 0.0]");
    }
}
