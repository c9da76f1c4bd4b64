//! What follows from the angles, in words.

use super::{Flip, PoseCheck};

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
/// Names of flips, and how to undo them.
const COLUMNS: (&str, &str) = ("columns reversed (azimuth counts the other way)", "save the spectra as s[:, :, ::-1]");
const ROWS: (&str, &str) = (
    "rows reversed (elevation counts the other way)",
    "exchange the two numbers of `elevation`, or save the spectra as s[:, ::-1, :]",
);

impl Verdict {
    pub(super) fn of(found: &PoseCheck) -> Self {
        if found.certain_flip().is_some() {
            return Self::Flipped;
        }
        // One cannot ask more of a rotation than how well it is known.
        let is_small = found.turn <= SMALL_DEG.max(found.turn_within);
        let no_gain = found.recorded <= 1.15 * found.turned + 0.5;
        match (found.follows(), is_small || no_gain) {
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
        let Self { recorded, turned, constant, turn, turn_within, spread, pairs, .. } = self;
        let [x, y, z, w] = self.orientation;
        let mut all = vec![format!(
            "The strongest direction is {recorded:.1}° from the geometric line of sight (median of {pairs} spectra). The best \
             rotation turns the receiver by {turn:.1}° (± {turn_within:.1}°, 95 % over blocks of the trajectory) and leaves \
             {turned:.1}°; one constant direction for all transmitters leaves {constant:.1}°."
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
        if let Some(Flip { is_rows, is_turned, angle }) = self.certain_flip().or_else(|| self.likely_flip()) {
            let (name, advice) = if *is_rows { ROWS } else { COLUMNS };
            let turned = if *is_turned { " and the rotation that then fits best" } else { "" };
            all.push(format!("With {name}{turned} the angle is {angle:.1}°: {advice}."));
        }
        if let Some((name, angle)) = self.better_reading() {
            all.push(format!("If the recorded numbers are {name}, the angle is {angle:.1}°."));
        }
        all
    }

    /// Another meaning of the recorded numbers that fits much better than the documented one.
    fn better_reading(&self) -> Option<(&'static str, f64)> {
        let is_better = |angle: f64| angle < 0.5 * self.recorded && angle < 1.5 * self.turned;
        let better = self.readings.iter().filter(|(_, angle)| is_better(*angle));
        better.min_by(|a, b| a.1.total_cmp(&b.1)).copied()
    }

    /// A flip that fits much better than any rotation does.
    fn certain_flip(&self) -> Option<&Flip> {
        self.flip(|flip| flip.angle < 0.5 * self.turned.min(self.recorded))
    }

    /// A flip that fits much better than the recorded orientation, and hardly worse than the best rotation: if
    /// transmitters are in one plane with the receiver, the two look alike.
    fn likely_flip(&self) -> Option<&Flip> {
        self.flip(|flip| !flip.is_turned && flip.angle < 0.5 * self.recorded && flip.angle < 1.5 * self.turned)
    }

    /// The flip that fits best of those that `fits` accepts and that follow the line of sight; without a rotation first.
    fn flip(&self, fits: impl Fn(&Flip) -> bool) -> Option<&Flip> {
        let follows = |flip: &&Flip| fits(flip) && flip.angle <= FOLLOWS * self.constant;
        self.flips.iter().filter(follows).min_by(|a, b| a.is_turned.cmp(&b.is_turned).then(a.angle.total_cmp(&b.angle)))
    }
}
