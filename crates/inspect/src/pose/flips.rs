//! Spectra whose rows or columns run the other way: no rotation of the receiver mends that.

use super::rotation::{Pair, best};
use super::{angles, median};
use glam::{DQuat, DVec3};
use pwrfgs_core::ImagePlane;

/// What flipped spectra come to.
#[derive(Clone, Copy, Debug)]
pub struct Flip {
    /// What is flipped.
    pub name: &'static str,
    /// How to flip it back.
    pub advice: &'static str,
    /// Whether the receiver is turned by the rotation that then fits best.
    pub is_turned: bool,
    /// Median angle between line of sight and strongest direction, degrees.
    pub angle: f64,
}

const COLUMNS: &str = "columns reversed (azimuth counts the other way)";
const ROWS: &str = "rows reversed (elevation counts the other way)";
const MEND_COLUMNS: &str = "save the spectra as s[:, :, ::-1]";
const MEND_ROWS: &str = "exchange the two numbers of `elevation`, or save the spectra as s[:, ::-1, :]";

/// Columns and rows reversed, with the recorded orientation and with the one that fits best.
pub(super) fn flips(plane: &ImagePlane, pairs: &[Pair]) -> Vec<Flip> {
    let Some((azimuth, elevation)) = plane.angles else { return Vec::new() };
    // The last pixel takes the place of the first.
    let [across, up] = [(azimuth, plane.width), (elevation, plane.height)]
        .map(|(axis, count)| 2.0 * axis.first + axis.step * (count as f64 - 1.0));
    let columns = |(azimuth, elevation)| (across - azimuth, elevation);
    let rows = |(azimuth, elevation)| (azimuth, up - elevation);
    let flipped = |name, advice, flip: &dyn Fn((f64, f64)) -> (f64, f64)| {
        let pairs: Vec<Pair> =
            pairs.iter().map(|(way, strongest)| (*way, direction(flip(angles(*strongest))))).collect();
        let turn = best(&pairs, &vec![1.0; pairs.len()]);
        [(DQuat::IDENTITY, false), (turn, true)].map(|(turn, is_turned)| Flip {
            name,
            advice,
            is_turned,
            angle: median(&pairs, turn),
        })
    };
    [flipped(COLUMNS, MEND_COLUMNS, &columns), flipped(ROWS, MEND_ROWS, &rows)].concat()
}

/// The direction of an azimuth and an elevation in degrees.
fn direction((azimuth, elevation): (f64, f64)) -> DVec3 {
    let ((sin, cos), (up, across)) = (azimuth.to_radians().sin_cos(), elevation.to_radians().sin_cos());
    DVec3::new(across * cos, across * sin, up)
}
