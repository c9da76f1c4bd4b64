//! Checks whether the strongest directions of spectra depend on the recorded positions: another unit, or another order of rows.

use super::finding::{Finding, moving_end};
use super::pose::{FOLLOWS, MUCH_BETTER, PoseCheck, PoseVerdict, has_room};
use super::positions::round;
use super::relation::{MEANINGS, Meaning, check_rows};
use super::rotation::angle;
use super::spectra::SpectrumSummary;
use glam::{DQuat, DVec3};
use pwrfgs_core::{Dataset, statistics::median};

/// Median angle of the lines of sight from their middle below which neighbours need not differ from random pairs, degrees.
const WIDE_DEG: f64 = 10.0;

/// Returns the angle between the `strongest` direction of a sample and its line of sight, with a `meaning` of the position of
/// the moving end, degrees.
fn sight_angle(data: &Dataset, sample: usize, strongest: DVec3, meaning: fn([f64; 3]) -> [f64; 3]) -> f64 {
    let mut ends = data.link_ends(sample);
    let moved = &mut ends[usize::from(data.scene.moving.is_receiver())].position;
    *moved = meaning(*moved);
    let [transmitter, receiver] = ends.map(|end| DVec3::from_array(end.position));
    let orientation = DQuat::from_array(ends[1].orientation).normalize();
    angle(orientation.inverse() * (transmitter - receiver).normalize_or_zero(), strongest).to_degrees()
}

/// Finds positions in another unit, or in another order than the spectra, if the recorded pose does not fit; `None` if neither
/// explains the directions.
pub(super) fn check_directions(data: &Dataset, spectra: &[SpectrumSummary], pose: &PoseCheck) -> Option<Finding> {
    if pose.verdict == PoseVerdict::Right || !has_room(data) {
        return None;
    }
    let directions: Vec<(usize, DVec3)> = spectra.iter().filter_map(|s| Some((s.sample, s.strongest?))).collect();
    let angle_by = |meaning: fn([f64; 3]) -> [f64; 3]| {
        let at_first = directions.iter().filter(|(sample, _)| data.sample(*sample).receiver == 0);
        median(at_first.map(|(sample, strongest)| sight_angle(data, *sample, *strongest, meaning)))
    };
    let units = MEANINGS.iter().filter(|meaning| meaning.finding == "position-unit");
    let angles = units.map(|meaning| (angle_by(meaning.position), meaning));
    let (degrees, Meaning { finding, words, mend, .. }) = angles.min_by(|(a, _), (b, _)| a.total_cmp(b))?;
    if degrees < (MUCH_BETTER * pose.recorded).min(pose.turned).min(FOLLOWS * pose.constant) {
        let (first, _) = directions[0];
        let problem = format!(
            "the strongest direction is {:.1}° from the line of sight, and {degrees:.1}° if positions are {words} (for example \
             {} {} at {:?})",
            pose.recorded,
            moving_end(data),
            data.sample(first).id,
            round(data.sample(first).position())
        );
        return Some(Finding::new(finding, pose.pairs, problem, *mend));
    }
    let is_open = matches!(pose.verdict, PoseVerdict::NotDirect | PoseVerdict::Unclear) && pose.spread >= WIDE_DEG;
    let rows: Vec<usize> = directions.iter().map(|(sample, _)| data.links[*sample].location).collect();
    let strongest: Vec<DVec3> = directions.iter().map(|(_, strongest)| *strongest).collect();
    let has_rows = is_open && data.scene.receivers.len() == 1 && !data.scene.moving.is_receiver();
    has_rows.then(|| check_rows(data, &rows, &|a, b| angle(strongest[a], strongest[b]))).flatten()
}
