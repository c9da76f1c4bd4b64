//! What follows from the angles, in words.

use super::PoseCheck;

/// Conclusion about the recorded pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Turning the receiver gains nothing.
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

/// A turn below this is within the precision of the strongest pixel, degrees.
const SMALL_DEG: f64 = 2.0;
/// The strongest direction follows the line of sight if the remaining angle is at most this part of that which a constant
/// direction leaves.
const FOLLOWS: f64 = 0.6;
/// An angle beyond this is no line of sight, degrees.
const WIDE_DEG: f64 = 20.0;
/// Name of a flip of the spectra, and how to undo it.
pub(super) type Flip = (&'static str, &'static str);
pub(super) const COLUMNS: Flip = ("columns reversed (azimuth the other way)", "save the spectra as s[:, :, ::-1]");
pub(super) const ROWS: Flip = (
    "rows reversed (elevation counts the other way)",
    "exchange the two numbers of `elevation`, or save the spectra as s[:, ::-1, :]",
);

impl Verdict {
    pub(super) fn of(found: &PoseCheck) -> Self {
        if found.flip().is_some() {
            return Self::Flipped;
        }
        let agrees = found.turn <= SMALL_DEG || found.recorded <= 1.15 * found.turned + 0.5;
        match (found.follows(), agrees) {
            (true, true) => Self::Right,
            (true, false) => Self::Off,
            (false, true) if found.recorded <= SMALL_DEG => Self::Right,
            (false, _) if found.turned.min(found.constant) > WIDE_DEG => Self::NotDirect,
            (false, _) => Self::Unclear,
        }
    }

    /// One sentence.
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
    fn follows(&self) -> bool {
        self.turned <= FOLLOWS * self.constant
    }

    /// The angles and what follows from them.
    pub fn sentences(&self) -> Vec<String> {
        let Self { recorded, turned, constant, turn, spread, pairs, .. } = self;
        let [x, y, z, w] = self.orientation;
        let mut all = vec![format!(
            "The strongest direction is {recorded:.1}° from the geometric line of sight (median of {pairs} spectra). The best \
             rotation turns the receiver by {turn:.1}° and leaves {turned:.1}°; one constant direction for all transmitters leaves {constant:.1}°."
        )];
        match self.verdict {
            Verdict::Off => all.push(format!(
                "The recorded orientation is wrong or its numbers have another meaning. This orientation fits: [{x:.6}, \
                 {y:.6}, {z:.6}, {w:.6}] (x, y, z, w)."
            )),
            Verdict::Right | Verdict::Unclear if !self.follows() => all.push(format!(
                "Transmitters are seen within {spread:.1}° of one direction (median), so a wrong orientation and a strongest \
                 path that is not direct look alike. Spectra of transmitters at known positions, 30° or more apart and in \
                 line of sight, would tell."
            )),
            _ => {}
        }
        if let Some(((name, advice), angle)) = self.flip() {
            all.push(format!("With {name} and the rotation that then fits best the angle is {angle:.1}°: {advice}."));
        }
        if let Some((name, angle)) = self.better_reading() {
            all.push(format!("If the recorded numbers are {name}, the angle is {angle:.1}°."));
        }
        all
    }

    /// Another meaning of the recorded numbers that fits much better than the documented one.
    fn better_reading(&self) -> Option<(&'static str, f64)> {
        let limit = (0.5 * self.recorded).min(1.5 * self.turned);
        self.readings.iter().filter(|(_, angle)| *angle < limit).min_by(|a, b| a.1.total_cmp(&b.1)).copied()
    }

    /// The flip that fits best, if it fits much better than any rotation does.
    fn flip(&self) -> Option<&(Flip, f64)> {
        let limit = (0.5 * self.turned.min(self.recorded)).min(FOLLOWS * self.constant);
        self.flips.iter().filter(|(_, angle)| *angle < limit).min_by(|a, b| a.1.total_cmp(&b.1))
    }
}
