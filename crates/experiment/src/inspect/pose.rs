//! Whether the recorded pose can be right: the line of sight by geometry against the strongest direction.
//!
//! If most transmitters are received strongest along the direct path, the strongest directions of spectra are the lines of
//! sight in the receiver's frame, up to one rotation: the error of the recorded orientation. The rotation that fits best
//! is compared with one constant direction, which ignores the transmitter.

mod rotation;
mod verdict;

use super::spectra::SpectrumSummary;
use crate::scores::quantile;
use glam::{DQuat, DVec3};
use pwrfgs_core::{Axis, Dataset, ImagePlane, evenly};
use rotation::{Pair, angle, best, middle};
pub use verdict::Verdict;
use verdict::{COLUMNS, Flip, ROWS};

/// Most pairs that are compared.
const PAIRS: usize = 4_000;
/// Fewest pairs that decide anything.
const FEWEST: usize = 20;
/// Comparison of lines of sight with strongest directions; angles in degrees, medians over spectra.
#[derive(Clone, Debug)]
pub struct PoseCheck {
    /// Transmitters with a strongest direction that were compared.
    pub pairs: usize,
    /// Angle between line of sight and strongest direction, by the recorded pose.
    pub recorded: f64,
    /// The same after the rotation that fits best.
    pub turned: f64,
    /// Angle between the strongest direction and the constant direction that fits best.
    pub constant: f64,
    /// Angle of the best rotation.
    pub turn: f64,
    /// The orientation x, y, z, w that the best rotation makes of the recorded one.
    pub orientation: [f64; 4],
    /// Angle of lines of sight from their middle.
    pub spread: f64,
    /// Other meanings of the recorded numbers, with the angle.
    readings: Vec<(&'static str, f64)>,
    /// Spectra with reversed columns, and rows, with the angle after the rotation that then fits best.
    flips: Vec<(Flip, f64)>,
    /// Conclusion.
    pub verdict: Verdict,
}

/// Checks the recorded pose; `None` if fewer than twenty spectra have a strongest direction.
pub(super) fn check_pose(data: &Dataset, spectra: &[SpectrumSummary]) -> Option<PoseCheck> {
    // Of several receivers the first: each has a pose of its own to be wrong.
    let receiver = data.scene.origin.world_pose(data.scene.pose());
    let pair = |spectrum: &SpectrumSummary| {
        let sample = data.sample(spectrum.sample);
        let sight = DVec3::from_array(sample.tx) - DVec3::from_array(receiver.position);
        if sample.receiver != 0 {
            return None;
        }
        Some((sight.try_normalize()?, spectrum.strongest?))
    };
    let in_world: Vec<Pair> = evenly(&spectra.iter().filter_map(pair).collect::<Vec<_>>(), PAIRS);
    if in_world.len() < FEWEST {
        return None;
    }
    let [x, y, z, w] = receiver.orientation;
    let recorded = DQuat::from_xyzw(x, y, z, w).normalize();
    let with = |world_from_receiver: DQuat| -> Vec<Pair> {
        in_world.iter().map(|(sight, strongest)| (world_from_receiver.inverse() * *sight, *strongest)).collect()
    };
    let other_order = DQuat::from_xyzw(y, z, w, x).normalize();
    let readings = [
        ("x, y, z, w, turned the other way (receiver from world)", recorded.inverse()),
        ("w, x, y, z", other_order),
        ("w, x, y, z, turned the other way", other_order.inverse()),
    ];
    let pairs = with(recorded);
    let correction = best(&pairs);
    let (sights, strongest): (Vec<DVec3>, Vec<DVec3>) = pairs.iter().copied().unzip();
    let spread = |directions: &[DVec3]| {
        let middle = middle(directions);
        median_deg(directions.iter().map(|d| angle(middle, *d)))
    };
    let mut found = PoseCheck {
        pairs: pairs.len(),
        recorded: median(&pairs, DQuat::IDENTITY),
        turned: median(&pairs, correction),
        constant: spread(&strongest),
        turn: correction.angle_between(DQuat::IDENTITY).to_degrees(),
        orientation: (recorded * correction.inverse()).normalize().to_array(),
        spread: spread(&sights),
        readings: readings.map(|(name, taken)| (name, median(&with(taken), DQuat::IDENTITY))).into(),
        flips: flips(&data.plane(), &pairs),
        verdict: Verdict::Right,
    };
    found.verdict = Verdict::of(&found);
    Some(found)
}

/// Columns and rows reversed, with the orientation that fits best.
fn flips(plane: &ImagePlane, pairs: &[Pair]) -> Vec<(Flip, f64)> {
    let Some((azimuth, elevation)) = plane.angles else { return Vec::new() };
    // The last pixel takes the place of the first.
    let ends = |axis: Axis, count: usize| (2.0 * axis.first + axis.step * (count as f64 - 1.0)).to_radians();
    let (across, up) = (ends(azimuth, plane.width), ends(elevation, plane.height));
    let flip = |d: DVec3, is_rows: bool| {
        let (a, e) = (d.y.atan2(d.x), d.z.atan2(d.x.hypot(d.y)));
        let (a, e) = if is_rows { (a, up - e) } else { (across - a, e) };
        DVec3::new(e.cos() * a.cos(), e.cos() * a.sin(), e.sin())
    };
    let angle = |which: Flip, is_rows: bool| {
        let pairs: Vec<Pair> = pairs.iter().map(|(sight, strongest)| (*sight, flip(*strongest, is_rows))).collect();
        (which, median(&pairs, best(&pairs)))
    };
    vec![angle(COLUMNS, false), angle(ROWS, true)]
}

/// Median angle of `pairs` once the first of each is turned, degrees.
fn median(pairs: &[Pair], turn: DQuat) -> f64 {
    median_deg(pairs.iter().map(|(a, b)| angle(turn * *a, *b)))
}

fn median_deg(angles: impl Iterator<Item = f64>) -> f64 {
    let mut angles: Vec<f64> = angles.map(f64::to_degrees).collect();
    angles.sort_by(f64::total_cmp);
    quantile(&angles, 0.5)
}
