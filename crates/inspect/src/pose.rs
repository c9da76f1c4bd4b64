//! Whether the recorded pose can be right: the line of sight by geometry against the strongest direction.
//!
//! Where most transmitters are heard best along the direct path, the pictures' strongest directions are the lines of
//! sight in the receiver's frame, up to one rotation: the error of the recorded orientation. What the rotation that fits
//! best is worth is measured against one constant direction, which knows no transmitter.

mod flips;
mod rotation;
mod verdict;

use crate::look::Look;
pub use flips::Flip;
use flips::flips;
use glam::{DQuat, DVec3};
use pwrfgs_core::{Dataset, evenly, rng};
use pwrfgs_experiment::scores::quantile;
use rayon::prelude::*;
use rotation::{Pair, angle, best, middle};
pub use verdict::Verdict;

/// Most pairs that are looked at.
const PAIRS: usize = 4_000;
/// Fewer tell nothing.
const FEWEST: usize = 20;
/// Stretches of the trajectory that are drawn again, and how often: neighbours err alike.
const BLOCKS: usize = 20;
const REPLICATES: usize = 60;
/// Pairs in such a draw.
const DRAWN: usize = 1_000;

/// What was found; angles in degrees.
#[derive(Clone, Debug)]
pub struct Pose {
    /// Transmitters with a strongest direction that were compared.
    pub pairs: usize,
    /// Of them behind the plane of the array by the recorded pose.
    pub behind: usize,
    /// Median angle between line of sight and strongest direction, by the recorded pose.
    pub recorded: f64,
    /// The same after the rotation that fits best.
    pub turned: f64,
    /// The same of the best constant direction in place of the line of sight.
    pub constant: f64,
    /// How far the best rotation turns.
    pub turn: f64,
    /// 95 % of rotations from stretches of the trajectory drawn again lie so near to the best one.
    pub turn_within: f64,
    /// The orientation x, y, z, w that the best rotation makes of the recorded one.
    pub orientation: [f64; 4],
    /// Median angle of lines of sight from their middle.
    pub spread: f64,
    /// The recorded numbers taken otherwise, with the median angle.
    pub readings: Vec<(&'static str, f64)>,
    /// The spectra flipped, with the median angle.
    pub flips: Vec<Flip>,
    /// What follows.
    pub verdict: Verdict,
    /// Azimuth and elevation of line of sight and strongest direction, by the recorded pose.
    pub shown: Vec<[(f64, f64); 2]>,
}

/// What the pictures say of the recorded pose; nothing where fewer than twenty have a strongest direction.
pub(crate) fn pose(data: &Dataset, looks: &[Look]) -> Option<Pose> {
    // Of several receivers the first: each has a pose of its own to be wrong.
    let receiver = data.scene.origin.world_pose(data.scene.pose());
    let place = DVec3::from_array(receiver.position);
    let pair = |look: &Look| {
        let sample = data.sample(look.sample);
        let way = DVec3::from_array(sample.tx) - place;
        if sample.receiver != 0 {
            return None;
        }
        Some((way.try_normalize()?, look.strongest?))
    };
    let in_world: Vec<Pair> = evenly(&looks.iter().filter_map(pair).collect::<Vec<_>>(), PAIRS);
    if in_world.len() < FEWEST {
        return None;
    }
    let [x, y, z, w] = receiver.orientation;
    let recorded = DQuat::from_xyzw(x, y, z, w).normalize();
    let seen_with = |world_from_receiver: DQuat| -> Vec<Pair> {
        in_world.iter().map(|(way, strongest)| (world_from_receiver.inverse() * *way, *strongest)).collect()
    };
    let other_order = DQuat::from_xyzw(y, z, w, x).normalize();
    let readings = [
        ("x, y, z, w, turned the other way (receiver from world)", recorded.inverse()),
        ("w, x, y, z", other_order),
        ("w, x, y, z, turned the other way", other_order.inverse()),
    ];
    let pairs = seen_with(recorded);
    let correction = best(&pairs, &vec![1.0; pairs.len()]);
    let (ways, strongest): (Vec<DVec3>, Vec<DVec3>) = pairs.iter().copied().unzip();
    let (way, heard) = (middle(&ways), middle(&strongest));
    let mut found = Pose {
        pairs: pairs.len(),
        behind: ways.iter().filter(|way| way.z < 0.0).count(),
        recorded: median(&pairs, DQuat::IDENTITY),
        turned: median(&pairs, correction),
        constant: median_deg(strongest.iter().map(|b| angle(heard, *b))),
        turn: correction.angle_between(DQuat::IDENTITY).to_degrees(),
        turn_within: within(&pairs, correction),
        orientation: (recorded * correction.inverse()).normalize().to_array(),
        spread: median_deg(ways.iter().map(|a| angle(way, *a))),
        readings: readings.map(|(name, taken)| (name, median(&seen_with(taken), DQuat::IDENTITY))).into(),
        flips: flips(&data.plane(), &pairs),
        verdict: Verdict::Right,
        shown: pairs.iter().map(|(a, b)| [angles(*a), angles(*b)]).collect(),
    };
    found.verdict = Verdict::of(&found);
    Some(found)
}

/// Degrees within which 95 % of the rotations lie that stretches of the trajectory, drawn with replacement, give.
fn within(pairs: &[Pair], found: DQuat) -> f64 {
    let pairs = evenly(pairs, DRAWN);
    let replicate = |k: usize| {
        let random = &mut rng::stream(0, "inspect pose", k as u64);
        let mut counts = [0.0; BLOCKS];
        (0..BLOCKS).for_each(|_| counts[rng::below(random, BLOCKS)] += 1.0);
        let weights: Vec<f64> = (0..pairs.len()).map(|i| counts[i * BLOCKS / pairs.len()]).collect();
        best(&pairs, &weights).angle_between(found).to_degrees()
    };
    let mut off: Vec<f64> = (0..REPLICATES).into_par_iter().map(replicate).collect();
    off.sort_by(f64::total_cmp);
    quantile(&off, 0.95)
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

/// Azimuth from 0 to 360 and elevation, degrees.
fn angles(d: DVec3) -> (f64, f64) {
    (d.y.atan2(d.x).to_degrees().rem_euclid(360.0), d.z.atan2(d.x.hypot(d.y)).to_degrees())
}

#[cfg(test)]
mod tests;
