//! Furniture and partitions, and what a surface is made of.

use super::FAR;
use super::room::check_box;
use glam::DVec2;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// What a surface is made of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Finish {
    /// A material of ITU-R P.2040 or of the scene.
    pub material: String,
    /// Thickness of the sheet, metres: waves are reflected by both of its sides and pass it with loss. Left out, the thing
    /// is solid: nothing passes.
    #[serde(default)]
    pub thickness_m: Option<f64>,
    /// Share S of the reflected amplitude that is scattered diffusely, in [0, 1]; default that of the scene.
    #[serde(default)]
    pub roughness: Option<f64>,
}

/// A thing in the room.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Object {
    /// A box between two corners, turned about its upright axis.
    Box {
        /// What it is called.
        name: String,
        /// Smallest corner before it is turned, metres.
        low: [f64; 3],
        /// Largest corner before it is turned, metres.
        high: [f64; 3],
        /// Turned counter-clockwise as seen from above, degrees; default 0.
        #[serde(default)]
        yaw_deg: f64,
        /// What it is made of.
        finish: Finish,
    },
    /// An upright rectangle: a partition, a window, a board.
    Panel {
        /// What it is called.
        name: String,
        /// One lower corner (x, y), metres.
        from: [f64; 2],
        /// The other lower corner (x, y), metres.
        to: [f64; 2],
        /// Heights of its lower and upper rim, metres.
        heights: [f64; 2],
        /// What it is made of; a panel needs a thickness.
        finish: Finish,
    },
    /// An upright rectangular hole in a wall, a panel or the side of a box that stands before it in the file: a doorway, an
    /// open window. What comes after it may close it again, such as a panel for the door.
    Opening {
        /// What it is called.
        name: String,
        /// One lower corner (x, y), metres.
        from: [f64; 2],
        /// The other lower corner (x, y), metres.
        to: [f64; 2],
        /// Heights of its lower and upper rim, metres.
        heights: [f64; 2],
    },
    /// A triangle mesh.
    Mesh {
        /// What it is called.
        name: String,
        /// OBJ or PLY; relative to the scene file.
        file: PathBuf,
        /// Metres a unit of the file; default 1.
        #[serde(default = "one")]
        scale: f64,
        /// Turned counter-clockwise as seen from above, after scaling, degrees; default 0.
        #[serde(default)]
        yaw_deg: f64,
        /// Moved by this, after turning, metres; default nothing.
        #[serde(default)]
        shift: [f64; 3],
        /// What it is made of.
        finish: Finish,
    },
}

fn one() -> f64 {
    1.0
}

impl Object {
    /// What it is called.
    pub fn name(&self) -> &str {
        match self {
            Self::Box { name, .. }
            | Self::Panel { name, .. }
            | Self::Opening { name, .. }
            | Self::Mesh { name, .. } => name,
        }
    }

    /// What it is made of; an opening of nothing.
    pub fn finish(&self) -> Option<&Finish> {
        match self {
            Self::Box { finish, .. } | Self::Panel { finish, .. } | Self::Mesh { finish, .. } => Some(finish),
            Self::Opening { .. } => None,
        }
    }

    pub(crate) fn finish_mut(&mut self) -> Option<&mut Finish> {
        match self {
            Self::Box { finish, .. } | Self::Panel { finish, .. } | Self::Mesh { finish, .. } => Some(finish),
            Self::Opening { .. } => None,
        }
    }

    pub(super) fn check(&self) -> Result<(), String> {
        match self {
            Self::Box { low, high, yaw_deg, .. } => {
                if !yaw_deg.is_finite() {
                    return Err(format!("`yaw_deg` is {yaw_deg}; give degrees"));
                }
                check_box(*low, *high)
            }
            Self::Panel { from, to, heights, finish, .. } => {
                check_upright("panel", from, to, heights)?;
                if finish.thickness_m.is_none() {
                    return Err("a panel has no inside that could be solid; give its finish a `thickness_m`".into());
                }
                Ok(())
            }
            Self::Opening { from, to, heights, .. } => check_upright("opening", from, to, heights),
            Self::Mesh { file, scale, yaw_deg, shift, .. } => {
                if file.as_os_str().is_empty() {
                    return Err("`file` is empty; name an OBJ or PLY file".into());
                }
                let finite = yaw_deg.is_finite() && shift.iter().all(|v| v.is_finite());
                if finite && (1e-9..=1e9).contains(scale) {
                    return Ok(());
                }
                Err("`scale` must lie between 1e-9 and 1e9, `yaw_deg` and `shift` be finite".into())
            }
        }
    }
}

/// Refuses what is not an upright rectangle.
fn check_upright(kind: &str, from: &[f64; 2], to: &[f64; 2], heights: &[f64; 2]) -> Result<(), String> {
    if !from.iter().chain(to).chain(heights).all(|v| v.abs() <= FAR) {
        return Err(format!("`from`, `to` and `heights` must be finite numbers in metres within {:.0} km", FAR / 1e3));
    }
    if DVec2::from(*from).distance(DVec2::from(*to)) > 1e-3 && heights[1] - heights[0] > 1e-3 {
        return Ok(());
    }
    let article = if kind == "opening" { "an" } else { "a" };
    Err(format!("{article} {kind} needs two different lower corners and a lower rim below its upper one"))
}
