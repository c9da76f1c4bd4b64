//! Check of the recorded pose: geometric line of sight compared with the strongest direction.
//!
//! If most transmitters are received strongest along the direct path, the strongest directions of spectra are the lines of
//! sight in the receiver's frame, up to one rotation: the error of the recorded orientation. The rotation that fits best
//! is compared with one constant direction, which ignores the transmitter. A moving receiver has an orientation per
//! spectrum: the rotation is then one of the array in the frame that moves, or one of the world.

use super::finding::Finding;
use super::rotation::{DirectionPair, angle, best_rotation, median_direction};
use super::spectra::SpectrumSummary;
use glam::{DQuat, DVec3};
use pwrfgs_core::{AngleAxis, Dataset, ImagePlane, evenly, statistics};

/// Largest number of compared pairs.
const PAIRS: usize = 4_000;
/// Smallest number of pairs for a verdict.
const FEWEST: usize = 20;

/// Comparison of lines of sight with strongest directions; angles in degrees, medians over spectra.
#[derive(Clone, Debug)]
pub struct PoseCheck {
    /// Number of transmitters whose strongest direction was compared.
    pub pairs: usize,
    /// Angle between line of sight and strongest direction, by the recorded pose.
    pub recorded: f64,
    /// Angle after the best rotation.
    pub turned: f64,
    /// Angle between the strongest direction and the constant direction that fits best.
    pub constant: f64,
    /// Angle of the best rotation.
    pub turn: f64,
    /// Orientation x, y, z, w after the best rotation of the recorded one. For a moving receiver: the factor of every
    /// recorded orientation.
    pub orientation: [f64; 4],
    /// Meaning of `orientation`.
    pub correction: Correction,
    /// Angle of lines of sight from their mean direction.
    pub spread: f64,
    /// Alternative interpretations of the recorded numbers, with the angle.
    readings: Vec<(&'static str, f64)>,
    /// Spectra with reversed columns or rows, with the angle after the best rotation.
    flips: Vec<(Flip, f64)>,
    /// Conclusion.
    pub verdict: PoseVerdict,
}

/// Meaning of the orientation that fits best.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Correction {
    /// It replaces the one that is recorded.
    Replaced,
    /// Each orientation of a moving receiver is multiplied by it from the right: a rotation of the array.
    Right,
    /// Each orientation of a moving receiver is multiplied by it from the left: a rotation of the world.
    Left,
}

/// Line of sight in the world, recorded orientation and strongest direction of a spectrum.
#[derive(Clone, Copy)]
struct Sighting {
    sight: DVec3,
    recorded: DQuat,
    strongest: DVec3,
}

impl Sighting {
    /// Returns the line of sight by a `meaning` of the recorded orientation, and the strongest direction, both in the
    /// receiver's frame.
    fn direction_pair(self, meaning: Meaning) -> DirectionPair {
        (meaning(self.recorded).inverse() * self.sight, self.strongest)
    }
}

/// Meaning of recorded numbers: the orientation from receiver to world.
type Meaning = fn(DQuat) -> DQuat;
/// Numbers w, x, y, z that were read as x, y, z, w.
const W_FIRST: Meaning = |q| DQuat::from_xyzw(q.y, q.z, q.w, q.x);

/// Checks the recorded pose; `None` for camera images, without positions of both ends, or if fewer than [`FEWEST`] spectra of
/// the first receiver have a strongest direction.
pub(crate) fn check_pose(data: &Dataset, spectra: &[SpectrumSummary]) -> Option<PoseCheck> {
    if data.camera().is_some() || !data.placed || !data.scene.has_distances() {
        return None;
    }
    let sightings = list_sightings(data, spectra);
    if sightings.len() < FEWEST {
        return None;
    }
    let moves = data.scene.moving.is_receiver();
    let pairs_by =
        |meaning| sightings.iter().map(|sighting| sighting.direction_pair(meaning)).collect::<Vec<DirectionPair>>();
    let pairs = pairs_by(|recorded| recorded);
    let readings: [(_, Meaning); 3] = [
        ("x, y, z, w, turned the other way (receiver from world)", |q| q.inverse()),
        ("w, x, y, z", W_FIRST),
        ("w, x, y, z, turned the other way", |q| W_FIRST(q).inverse()),
    ];
    let (sights, strongest): (Vec<DVec3>, Vec<DVec3>) = pairs.iter().copied().unzip();
    let spread = |directions: &[DVec3]| {
        let middle = median_direction(directions);
        median_degrees(directions.iter().map(|d| angle(middle, *d)))
    };
    let (turned, rotation, correction) = best_correction(&pairs, moves.then_some(&sightings));
    let factor = rotation.inverse();
    let orientation = if moves { factor } else { (sightings[0].recorded * factor).normalize() };
    let mut check = PoseCheck {
        pairs: pairs.len(),
        recorded: median_angle(&pairs, DQuat::IDENTITY),
        turned,
        constant: spread(&strongest),
        turn: rotation.angle_between(DQuat::IDENTITY).to_degrees(),
        orientation: orientation.to_array(),
        correction,
        spread: spread(&sights),
        readings: readings.map(|(name, meaning)| (name, median_angle(&pairs_by(meaning), DQuat::IDENTITY))).into(),
        flips: score_flips(&data.plane(), &pairs),
        verdict: PoseVerdict::Right,
    };
    check.verdict = PoseVerdict::of(&check);
    Some(check)
}

/// Lists the sightings of at most [`PAIRS`] evenly chosen spectra of the first receiver, since each receiver has its own
/// pose; spectra without a strongest direction or a line of sight are omitted.
fn list_sightings(data: &Dataset, spectra: &[SpectrumSummary]) -> Vec<Sighting> {
    let sighting = |spectrum: &SpectrumSummary| {
        let [transmitter, receiver] = data.link_ends(spectrum.sample);
        let sight = (DVec3::from_array(transmitter.position) - DVec3::from_array(receiver.position)).try_normalize()?;
        let recorded = DQuat::from_array(receiver.orientation).normalize();
        (data.links[spectrum.sample].receiver == 0).then_some(Sighting {
            sight,
            recorded,
            strongest: spectrum.strongest?,
        })
    };
    evenly(&spectra.iter().filter_map(sighting).collect::<Vec<_>>(), PAIRS)
}

/// Returns the median angle after the rotation that fits best, degrees, that rotation, and its meaning. `moving` has the
/// sightings of a moving receiver; `None` for a fixed one.
fn best_correction(pairs: &[DirectionPair], moving: Option<&Vec<Sighting>>) -> (f64, DQuat, Correction) {
    let turned = |pairs: &[DirectionPair], correction| {
        let rotation = best_rotation(pairs);
        (median_angle(pairs, rotation), rotation, correction)
    };
    let Some(sightings) = moving else { return turned(pairs, Correction::Replaced) };
    let in_world: Vec<DirectionPair> =
        sightings.iter().map(|sighting| (sighting.sight, sighting.recorded * sighting.strongest)).collect();
    let (right, left) = (turned(pairs, Correction::Right), turned(&in_world, Correction::Left));
    let ((right_angle, ..), (left_angle, ..)) = (right, left);
    if left_angle < right_angle { left } else { right }
}

/// Returns the flips of columns and of rows, with the median angle after the best rotation, degrees; empty if the plane has
/// no angles.
fn score_flips(plane: &ImagePlane, pairs: &[DirectionPair]) -> Vec<(Flip, f64)> {
    let Some((azimuth, elevation)) = plane.angles else { return Vec::new() };
    // A flip exchanges first and last pixel: it maps an angle to the sum of theirs minus the angle.
    let sum = |axis: AngleAxis, count: usize| (2.0 * axis.first + axis.step * (count as f64 - 1.0)).to_radians();
    let (across, up) = (sum(azimuth, plane.width), sum(elevation, plane.height));
    let mirrored = |d: DVec3, is_rows: bool| {
        let (a, e) = (d.y.atan2(d.x), d.z.atan2(d.x.hypot(d.y)));
        let (a, e) = if is_rows { (a, up - e) } else { (across - a, e) };
        DVec3::new(e.cos() * a.cos(), e.cos() * a.sin(), e.sin())
    };
    let score = |flip: Flip, is_rows: bool| {
        let pairs: Vec<DirectionPair> =
            pairs.iter().map(|(sight, strongest)| (*sight, mirrored(*strongest, is_rows))).collect();
        (flip, median_angle(&pairs, best_rotation(&pairs)))
    };
    vec![score(COLUMNS, false), score(ROWS, true)]
}

/// Returns the median angle of `pairs` after rotating the first direction of each, degrees.
fn median_angle(pairs: &[DirectionPair], turn: DQuat) -> f64 {
    median_degrees(pairs.iter().map(|(a, b)| angle(turn * *a, *b)))
}

/// Returns the median, in degrees, of `angles` in radians.
fn median_degrees(angles: impl Iterator<Item = f64>) -> f64 {
    statistics::median(angles.map(f64::to_degrees))
}

/// Conclusion about the recorded pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseVerdict {
    /// A rotation gives no improvement.
    Right,
    /// The strongest direction follows the line of sight, once the receiver is turned.
    Off,
    /// The strongest direction follows the line of sight, once rows or columns of the spectra are reversed.
    Flipped,
    /// A rotation fits better, but hardly better than one constant direction.
    Unclear,
    /// The strongest direction does not follow the line of sight, turned or not.
    NotDirect,
}

/// Largest rotation, or gain of one, within the precision of the strongest pixel, degrees.
const SMALL_DEG: f64 = 2.0;
/// Largest ratio of the recorded angle to that after the best rotation for which the recorded orientation is as good.
const AS_GOOD: f64 = 1.15;
/// Largest ratio of remaining angle to the angle of a constant direction for which the strongest direction follows the
/// line of sight.
pub(super) const FOLLOWS: f64 = 0.6;
/// Ratio of angles below which another meaning of the data fits much better.
pub(super) const MUCH_BETTER: f64 = 0.5;
/// Largest ratio of the angle by another reading to that after the best rotation for which the reading explains the pose.
const EXPLAINS: f64 = 1.5;
/// Angle above which the strongest direction is not the line of sight, degrees.
const WIDE_DEG: f64 = 20.0;
/// Correction of the orientations of a moving receiver.
const POSES: &str = "correct qx, qy, qz, qw in rx_pose.csv";
/// Name of a flip of the spectra, and its correction.
type Flip = (&'static str, &'static str);
const COLUMNS: Flip = ("columns reversed (azimuth the other way)", "save the spectra as s[:, :, ::-1]");
const ROWS: Flip = (
    "rows reversed (elevation counts the other way)",
    "exchange the two numbers of `elevation`, or save the spectra as s[:, ::-1, :]",
);

impl PoseVerdict {
    /// Concludes from the angles: a flip first, then another reading of the numbers, then a rotation.
    fn of(check: &PoseCheck) -> Self {
        if check.best_flip().is_some() {
            return Self::Flipped;
        }
        let agrees = check.turn <= SMALL_DEG || check.recorded <= AS_GOOD * check.turned + SMALL_DEG;
        // No single rotation mends the orientations of a moving receiver that were read in another way.
        let is_misread = |(_, angle)| angle <= FOLLOWS * check.constant && check.recorded - angle > SMALL_DEG;
        if check.better_reading().is_some_and(is_misread) {
            return Self::Off;
        }
        match (check.is_direct(), agrees) {
            (true, true) => Self::Right,
            (true, false) => Self::Off,
            (false, true) if check.recorded <= SMALL_DEG => Self::Right,
            (false, _) if check.turned.min(check.constant) > WIDE_DEG => Self::NotDirect,
            (false, _) => Self::Unclear,
        }
    }

    /// Returns the verdict as one sentence.
    pub fn title(self) -> &'static str {
        match self {
            Self::Right => "The recorded orientation fits the spectra.",
            Self::Off => "The recorded orientation does not fit the spectra; another one does.",
            Self::Flipped => "Rows or columns of the spectra run the other way.",
            Self::Unclear => "The spectra cannot tell whether the recorded orientation is right.",
            Self::NotDirect => {
                "The strongest direction does not follow the transmitter: reflections are stronger than the direct path, or \
                 positions or axes of the spectra are wrong."
            }
        }
    }
}

impl PoseCheck {
    /// Returns whether the strongest direction follows the line of sight after the best rotation.
    fn is_direct(&self) -> bool {
        self.turned <= FOLLOWS * self.constant
    }

    /// Describes angles, conclusion and corrections in sentences.
    pub fn sentences(&self) -> Vec<String> {
        let Self { recorded, turned, constant, turn, spread, pairs, .. } = self;
        let [x, y, z, w] = self.orientation;
        let mut sentences = vec![format!(
            "The strongest direction is {recorded:.1}° from the geometric line of sight (median of {pairs} spectra). The best \
             rotation turns the receiver by {turn:.1}° and leaves {turned:.1}°; one constant direction for all transmitters \
             leaves {constant:.1}°."
        )];
        match self.verdict {
            PoseVerdict::Off if self.is_direct() => {
                let advice = match self.correction {
                    Correction::Replaced => "This orientation fits",
                    Correction::Right => "Orientations fit if each is multiplied from the right by",
                    Correction::Left => "Orientations fit if each is multiplied from the left by",
                };
                sentences.push(format!(
                    "The recorded orientation is wrong or its numbers have another meaning. {advice}: [{x:.6}, {y:.6}, \
                     {z:.6}, {w:.6}] (x, y, z, w)."
                ));
            }
            PoseVerdict::Right | PoseVerdict::Unclear if !self.is_direct() => sentences.push(format!(
                "Transmitters are seen within {spread:.1}° of one direction (median), so a wrong orientation and a strongest \
                 path that is not direct look alike. Spectra of transmitters at known positions, 30° or more apart and in \
                 line of sight, would tell."
            )),
            _ => {}
        }
        if let Some(((name, advice), angle)) = self.best_flip() {
            sentences
                .push(format!("With {name} and the rotation that then fits best the angle is {angle:.1}°: {advice}."));
        }
        if let Some((name, angle)) = self.better_reading() {
            sentences.push(format!("If the recorded numbers are {name}, the angle is {angle:.1}°."));
        }
        sentences
    }

    /// Returns the finding with its correction; `None` if the pose fits or the spectra cannot tell, or for spectra without a
    /// direct path that are simulated without a room.
    pub(crate) fn finding(&self, data: &Dataset) -> Option<Finding> {
        let Self { pairs, recorded, turned, orientation: [x, y, z, w], .. } = self;
        let away =
            format!("the strongest direction is {recorded:.1}° from the line of sight (median of {pairs} spectra)");
        let factor = format!("[{x:.6}, {y:.6}, {z:.6}, {w:.6}] (x, y, z, w)");
        let (name, problem, mend) = match (self.verdict, self.correction, self.better_reading()) {
            (PoseVerdict::Off, Correction::Replaced, reading) => {
                let order = reading.map_or(String::new(), |(name, _)| format!("; the recorded numbers may be {name}"));
                let option = "give it to `import --orientation`, or as `orientation` in gateway_info.yml";
                ("orientation", away, format!("with {factor} it is {turned:.1}°: {option}{order}"))
            }
            (PoseVerdict::Off, _, Some((name, angle))) => {
                let mend = format!("if the recorded numbers are {name}, it is {angle:.1}°: {POSES}");
                ("orientation", away, mend)
            }
            (PoseVerdict::Off, correction, None) => {
                let side = if correction == Correction::Left { "left" } else { "right" };
                let mend = format!("multiplied from the {side} by {factor}, orientations give {turned:.1}°: {POSES}");
                ("orientation", away, mend)
            }
            (PoseVerdict::Flipped, ..) => {
                let ((name, advice), angle) = self.best_flip()?;
                let problem = format!("{away}, and {angle:.1}° with {name} and the rotation that then fits best");
                let mend = format!("{advice}, or correct the positions if two of their axes are exchanged");
                ("mirrored-spectra", problem, mend)
            }
            (PoseVerdict::NotDirect, ..) if has_room(data) => {
                let mend = "if most transmitters are in line of sight, check order, unit and axes of the positions, and the \
                            axes of the spectra";
                ("line-of-sight", format!("{away} and does not follow the transmitter"), mend.to_owned())
            }
            _ => return None,
        };
        Some(Finding::new(name, *pairs, problem, mend))
    }

    /// Returns the interpretation of the recorded numbers that fits best, with its angle in degrees; `None` unless it fits much
    /// better than the recorded pose and about as well as the best rotation.
    fn better_reading(&self) -> Option<(&'static str, f64)> {
        let limit = (MUCH_BETTER * self.recorded).min(EXPLAINS * self.turned);
        self.readings.iter().filter(|(_, angle)| *angle < limit).min_by(|(_, a), (_, b)| a.total_cmp(b)).copied()
    }

    /// Returns the best flip and its angle in degrees; `None` unless it fits much better than any rotation, and the strongest
    /// direction then follows the line of sight.
    fn best_flip(&self) -> Option<&(Flip, f64)> {
        let limit = (MUCH_BETTER * self.turned.min(self.recorded)).min(FOLLOWS * self.constant);
        self.flips.iter().filter(|(_, angle)| *angle < limit).min_by(|(_, a), (_, b)| a.total_cmp(b))
    }
}

/// Returns whether transmitters are in a room, so that direct paths exist; spectra that `Teacher` simulates have no room.
pub(super) fn has_room(data: &Dataset) -> bool {
    data.simulation.as_ref().is_none_or(|simulation| simulation.scene.is_some())
}
