//! What can be told of the pose, and what cannot, in words.

use super::{Flip, Pose};

/// What follows from the angles.
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

/// A turn below this is within what the strongest pixel of a picture tells, degrees.
const SMALL_DEG: f64 = 2.0;
/// The strongest direction follows the line of sight where the angle that is left is this part of what a constant
/// direction leaves, or less.
const FOLLOWS: f64 = 0.6;
/// An angle beyond this is no line of sight, degrees.
const WIDE_DEG: f64 = 20.0;

impl Verdict {
    pub(super) fn of(found: &Pose) -> Self {
        if found.certain_flip().is_some() {
            return Self::Flipped;
        }
        // One cannot ask more of a rotation than how well it is known.
        let still = found.turn <= SMALL_DEG.max(found.turn_within);
        let no_gain = found.recorded <= 1.15 * found.turned + 0.5;
        match (found.follows(), still || no_gain) {
            (true, true) => Self::Right,
            (true, false) => Self::Off,
            (false, true) if found.recorded <= SMALL_DEG => Self::Right,
            (false, _) if found.turned.min(found.constant) > WIDE_DEG => Self::NotDirect,
            (false, _) => Self::Unclear,
        }
    }

    /// In a few words.
    pub fn title(self) -> &'static str {
        match self {
            Self::Right => "The recorded orientation fits the pictures.",
            Self::Off => "The recorded orientation does not fit the pictures; another one does.",
            Self::Flipped => "Rows or columns of the spectra run the other way.",
            Self::Unclear => "The pictures cannot tell whether the recorded orientation is right.",
            Self::NotDirect => "The strongest direction does not follow the transmitter.",
        }
    }
}

impl Pose {
    /// Whether the strongest direction follows the line of sight, turned as fits best.
    fn follows(&self) -> bool {
        self.turned <= FOLLOWS * self.constant
    }

    /// What was found and what follows, a sentence each.
    pub fn sentences(&self) -> Vec<String> {
        let Self { recorded, turned, constant, turn, turn_within, spread, .. } = *self;
        let [x, y, z, w] = self.orientation.map(|v| format!("{v:.6}"));
        let mut said = vec![format!(
            "The strongest direction lies {recorded:.1}° from the geometric line of sight in the median of {} spectra. The \
             rotation that fits best turns the receiver by {turn:.1}° (± {turn_within:.1}°, 95 % over stretches of the \
             trajectory) and leaves {turned:.1}°; one constant direction, whatever the transmitter, leaves {constant:.1}°.",
            self.pairs
        )];
        match self.verdict {
            Verdict::Right if self.follows() => said.push(
                "The strongest direction follows the transmitters, and turning the receiver gains nothing beyond what is \
                 uncertain: position and orientation agree with the pictures."
                    .into(),
            ),
            Verdict::Right => said.push(format!(
                "That is as near as a picture can tell. But transmitters are seen within {spread:.1}° of one direction \
                 (median), so a turn about it would hardly show."
            )),
            Verdict::Off => said.push(format!(
                "The strongest direction follows the transmitters once the receiver is turned, so the recorded orientation is \
                 off, or its numbers mean something else. This orientation fits: [{x}, {y}, {z}, {w}] (x, y, z, w)."
            )),
            Verdict::Flipped => {}
            Verdict::Unclear => said.push(format!(
                "A constant direction does nearly as well as the rotation, since transmitters are seen within {spread:.1}° \
                 of one direction (median): there is little to follow. Either the recorded orientation is off, or the \
                 strongest path is not the direct one; both look alike here. Spectra of a few transmitters at known places, \
                 30° apart or more with nothing in the way, would tell."
            )),
            Verdict::NotDirect => said.push(
                "Neither the line of sight nor a rotation of it says where a picture is strongest: reflections win, or \
                 something in the frames is wrong that no rotation mends (positions, axes of the pictures). Nothing can be \
                 told of the orientation."
                    .into(),
            ),
        }
        if self.behind > 0 {
            said.push(format!(
                "{} of {} transmitters stand behind the plane of the array by the recorded pose; a flat array hears them as \
                 their mirror image in front of it.",
                self.behind, self.pairs
            ));
        }
        if let Some(Flip { name, advice, is_turned, angle }) = self.certain_flip().or_else(|| self.likely_flip()) {
            let turned = if *is_turned { " and the rotation that then fits best" } else { "" };
            said.push(format!("With {name}{turned} the angle is {angle:.1}°: {advice}."));
        }
        if let Some((name, angle)) = self.better_reading() {
            said.push(format!("Taken as {name}, the recorded numbers leave {angle:.1}°: that may be what they mean."));
        }
        said
    }

    /// Another meaning of the recorded numbers that fits much better than the documented one.
    fn better_reading(&self) -> Option<(&'static str, f64)> {
        let better =
            self.readings.iter().filter(|(_, angle)| *angle < 0.5 * self.recorded && *angle < 1.5 * self.turned);
        better.min_by(|a, b| a.1.total_cmp(&b.1)).copied()
    }

    /// A flip that fits much better than any rotation does.
    fn certain_flip(&self) -> Option<&Flip> {
        self.flip(|flip| flip.angle < 0.5 * self.turned.min(self.recorded))
    }

    /// A flip that fits much better than the recorded orientation, and hardly worse than the best rotation: where
    /// transmitters are in one plane with the receiver, the two look alike.
    fn likely_flip(&self) -> Option<&Flip> {
        self.flip(|flip| !flip.is_turned && flip.angle < 0.5 * self.recorded && flip.angle < 1.5 * self.turned)
    }

    /// The flip that fits best of those for which `fits` holds and the strongest direction follows the line of sight; one
    /// without a rotation is preferred.
    fn flip(&self, fits: impl Fn(&Flip) -> bool) -> Option<&Flip> {
        let follows = |flip: &&Flip| fits(flip) && flip.angle <= FOLLOWS * self.constant;
        self.flips.iter().filter(follows).min_by(|a, b| a.is_turned.cmp(&b.is_turned).then(a.angle.total_cmp(&b.angle)))
    }
}
