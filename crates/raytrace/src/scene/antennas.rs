//! Receivers and transmitter of a scene.

use super::room::FAR;
use super::transmitters::Transmitters;
use crate::array::{Array, Element};
use glam::{DMat3, DQuat, DVec3};
use pwrfgs_core::Pose;
use pwrfgs_core::plugin::Checked;
use serde::{Deserialize, Serialize};

/// Largest absolute transmit power, dBm.
const MOST_DBM: f64 = 200.0;
/// Name of an unnamed receiver, as of the first receiver in `gateway_info.yml`.
const GATEWAY: &str = "gateway1";
/// Longest receiver name, characters.
const LONGEST: usize = 40;
/// Words that YAML reads as a truth value or null, and that are therefore invalid names.
const WORDS_OF_YAML: [&str; 9] = ["y", "n", "yes", "no", "on", "off", "true", "false", "null"];

/// A receiver.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneReceiver {
    /// Name in files and folders; default `gateway1`. The noise depends on the name, not on the position in the scene
    /// file. The default is not written out, so that data of old scenes keep their key.
    #[serde(default = "default_name", skip_serializing_if = "is_default_name")]
    pub name: String,
    /// Centre of the array, metres.
    pub position: [f64; 3],
    /// Orientation of the array.
    pub orientation: Orientation,
    /// Antenna array.
    #[serde(default)]
    pub array: Checked<Array>,
}

/// Orientation of the receiver.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Orientation {
    /// Unit quaternion x, y, z, w from the axes of the receiver to those of the world, as in `gateway_info.yml`.
    Quaternion(f64, f64, f64, f64),
    /// Boresight towards `direction`; the y axis of the array points up as far as possible (for a vertical boresight:
    /// towards +y of the world).
    Facing {
        /// A direction in the world, of any length.
        direction: [f64; 3],
    },
}

/// The transmitter: one moving antenna.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneTransmitter {
    /// Positions of the transmitter.
    pub positions: Transmitters,
    /// Antenna pattern; default isotropic.
    #[serde(default)]
    pub element: Element,
    /// Polarisation axis, world frame; default vertical.
    #[serde(default = "vertical_axis")]
    pub polarization: [f64; 3],
    /// Transmit power, dBm; default 0. Used for received powers; spectra and channels ignore it. The default is not
    /// written out.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub power_dbm: f64,
}

/// A moving receiver and a fixed transmitter, which stands at the position of `receiver`. The array stands at the positions
/// of `transmitter`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MovingReceiver {
    /// Each orientation is that of `receiver`, turned about the vertical by a uniform angle of up to ± this, degrees;
    /// default 0. Not used if `transmitter` states the orientations.
    #[serde(default)]
    pub turn_deg: f64,
}

impl MovingReceiver {
    /// Returns an error for an invalid angle, or if the scene has further receivers (`has_others`): the problem and the
    /// next step.
    pub(super) fn check(&self, has_others: bool) -> Result<(), String> {
        if has_others {
            return Err("`moving_receiver` needs the only receiver; remove `more_receivers`".into());
        }
        if !(0.0..=180.0).contains(&self.turn_deg) {
            return Err(format!("`turn_deg` is {}; give degrees from 0 to 180", self.turn_deg));
        }
        Ok(())
    }
}

/// Returns the default name of a receiver.
fn default_name() -> String {
    GATEWAY.into()
}

/// Returns whether `name` is the default name of a receiver.
fn is_default_name(name: &str) -> bool {
    name == GATEWAY
}

/// Returns whether a transmit power is the default, which is not written out.
fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// Returns the default polarisation axis of the transmitter.
fn vertical_axis() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}

impl SceneReceiver {
    /// Returns the receiver pose, world frame.
    pub fn pose(&self) -> Pose {
        Pose { position: self.position, orientation: self.orientation.quaternion() }
    }

    /// Returns the rotation from the receiver axes to the world axes.
    pub fn world_from_receiver(&self) -> DMat3 {
        DMat3::from_quat(DQuat::from_array(self.orientation.quaternion()).normalize())
    }

    /// Returns the antenna positions `[A]`, world frame, metres. Their spacing refers to the carrier `wavelength`, metres.
    pub(crate) fn antenna_positions(&self, wavelength: f64) -> Vec<DVec3> {
        let (centre, turn) = (DVec3::from(self.position), self.world_from_receiver());
        self.array.offsets(wavelength).into_iter().map(|offset| centre + turn * offset).collect()
    }

    /// Returns the receiver in words for messages: `noun` and its name, or `noun` alone for an unnamed receiver.
    pub(crate) fn describe(&self, noun: &str) -> String {
        if is_default_name(&self.name) { noun.into() } else { format!("{noun} `{}`", self.name) }
    }

    /// Returns the name of the random stream for `purpose`, unique to this receiver.
    pub(crate) fn stream_name(&self, purpose: &str) -> String {
        if is_default_name(&self.name) { purpose.into() } else { format!("{purpose} of {}", self.name) }
    }

    /// Returns an error for a name that is not valid as folder, column and key on every system.
    pub(super) fn check_name(&self) -> Result<(), String> {
        let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        let begins = self.name.starts_with(|c: char| c.is_ascii_alphabetic());
        let fits = begins && self.name.len() <= LONGEST && self.name.chars().all(is_plain);
        if fits && !WORDS_OF_YAML.contains(&&*self.name.to_ascii_lowercase()) {
            return Ok(());
        }
        let shown: String = self.name.chars().filter(|c| !c.is_control()).take(LONGEST).collect();
        Err(format!(
            "`{shown}` is not a valid receiver name; use a letter and then at most {} letters, digits, `-` and `_`, such as \
             \"north\"",
            LONGEST - 1
        ))
    }

    /// Returns an error for an invalid position or orientation; it names the receiver.
    pub(super) fn check(&self) -> Result<(), String> {
        self.check_pose().map_err(|problem| format!("{}: {problem}", self.describe("receiver")))
    }

    /// Returns an error for a position that is too far or not finite, or an orientation of wrong length.
    fn check_pose(&self) -> Result<(), String> {
        if !self.position.iter().all(|v| v.abs() <= FAR) {
            return Err(format!("`position` is {:?}; give finite metres", self.position));
        }
        match &self.orientation {
            Orientation::Quaternion(x, y, z, w) => {
                let norm = (x * x + y * y + z * z + w * w).sqrt();
                // Numbers in files are rounded.
                if (norm - 1.0).abs() < 0.01 {
                    return Ok(());
                }
                Err(format!("the quaternion has length {norm}; give a unit quaternion x, y, z, w"))
            }
            Orientation::Facing { direction } => {
                if DVec3::from(*direction).try_normalize().is_some() {
                    return Ok(());
                }
                Err(format!("`direction` is {direction:?}; give a direction such as (0, 0, -1)"))
            }
        }
    }
}

impl SceneTransmitter {
    /// Returns an error for an invalid polarisation, power or element: the problem and the next step.
    pub(super) fn check(&self) -> Result<(), String> {
        let axis = self.polarization;
        if DVec3::from(axis).try_normalize().is_none() {
            return Err(format!("`polarization` of the transmitter is {axis:?}; give an axis such as (0, 0, 1)"));
        }
        if self.power_dbm.is_nan() || self.power_dbm.abs() > MOST_DBM {
            let advice = format!("give -{MOST_DBM} to {MOST_DBM} dBm");
            return Err(format!("`power_dbm` of the transmitter is {}; {advice}", self.power_dbm));
        }
        self.element.check().map_err(|why| format!("transmitter: {why}"))
    }
}

impl Orientation {
    /// Returns the unit quaternion x, y, z, w from the receiver axes to the world axes.
    pub fn quaternion(&self) -> [f64; 4] {
        match self {
            Self::Quaternion(x, y, z, w) => {
                let norm = (x * x + y * y + z * z + w * w).sqrt();
                [*x, *y, *z, *w].map(|v| v / norm)
            }
            Self::Facing { direction } => {
                let z = DVec3::from(*direction).normalize();
                let up = if z.x.hypot(z.y) > 1e-9 { DVec3::Z } else { DVec3::Y };
                let y = (up - up.dot(z) * z).normalize();
                DQuat::from_mat3(&DMat3::from_cols(y.cross(z), y, z)).normalize().to_array()
            }
        }
    }
}
