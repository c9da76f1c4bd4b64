//! The room: its outline, what stands in it, and what surfaces are made of.

use glam::DVec2;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Farthest coordinate, metres.
pub(crate) const FAR: f64 = 1e6;

/// The room.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Room {
    /// Its shape.
    pub outline: Outline,
    /// What its walls are made of.
    pub walls: Finish,
    /// What its floor is made of.
    pub floor: Finish,
    /// What its ceiling is made of.
    pub ceiling: Finish,
}

/// Most corners of a floor plan.
const MOST_CORNERS: usize = 1000;

/// The outline of the room.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Outline {
    /// A box between two corners, metres.
    Box {
        /// Smallest corner.
        low: [f64; 3],
        /// Largest corner.
        high: [f64; 3],
    },
    /// Upright walls over a floor plan.
    Plan {
        /// Corners (x, y) of the floor in order, metres; wall k goes from corner k to the next.
        corners: Vec<[f64; 2]>,
        /// Height of the floor; default 0.
        #[serde(default)]
        floor: f64,
        /// Height of the ceiling.
        ceiling: f64,
    },
}

impl Outline {
    pub(super) fn check(&self) -> Result<(), String> {
        match self {
            Self::Box { low, high } => check_box(*low, *high).map_err(|why| format!("room: {why}")),
            Self::Plan { corners, floor, ceiling } => {
                if corners.len() < 3 || !corners.as_flattened().iter().all(|v| v.abs() <= FAR) {
                    return Err("room: a floor plan needs three corners or more, finite numbers in metres".into());
                }
                if corners.len() > MOST_CORNERS {
                    let found = corners.len();
                    return Err(format!("room: the floor plan has {found} corners; give at most {MOST_CORNERS}"));
                }
                if !(ceiling - floor > 1e-3 && ceiling.abs() <= FAR && floor.abs() <= FAR) {
                    return Err(format!("room: the ceiling at {ceiling} m must lie above the floor at {floor} m"));
                }
                match first_crossing(corners) {
                    None => Ok(()),
                    Some((i, j)) => {
                        Err(format!("room: walls {} and {} of the floor plan cross or touch", i + 1, j + 1))
                    }
                }
            }
        }
    }
}

/// Two walls of a plan that are not neighbours and meet, or neighbours on each other, or a wall without length.
fn first_crossing(corners: &[[f64; 2]]) -> Option<(usize, usize)> {
    let n = corners.len();
    let corner = |i: usize| DVec2::from(corners[i % n]);
    let side = |a: DVec2, b: DVec2, c: DVec2| (b - a).perp_dot(c - a);
    for i in 0..n {
        let (a, b) = (corner(i), corner(i + 1));
        if a.distance(b) < 1e-3 {
            return Some((i, (i + 1) % n));
        }
        let c = corner(i + 2);
        if side(a, b, c) == 0.0 && (b - a).dot(c - b) < 0.0 {
            return Some((i, (i + 1) % n)); // it runs back
        }
        for j in i + 2..n {
            if (j + 1) % n == i {
                continue;
            }
            let (c, d) = (corner(j), corner(j + 1));
            let sides = [side(a, b, c), side(a, b, d), side(c, d, a), side(c, d, b)];
            if sides == [0.0; 4] {
                // On one line: apart, as the walls beside a niche, or over each other.
                let along = |p: DVec2| (p - a).dot(b - a);
                let (low, high) = (along(c).min(along(d)), along(c).max(along(d)));
                if low <= (b - a).length_squared() && high >= 0.0 {
                    return Some((i, j));
                }
            } else if sides[0] * sides[1] <= 0.0 && sides[2] * sides[3] <= 0.0 {
                return Some((i, j));
            }
        }
    }
    None
}

/// Refuses what is not a box with an inside.
pub(super) fn check_box(low: [f64; 3], high: [f64; 3]) -> Result<(), String> {
    let fine = (0..3).all(|k| low[k].abs() <= FAR && high[k].abs() <= FAR && high[k] - low[k] > 1e-3);
    if fine {
        return Ok(());
    }
    Err(format!(
        "the box from {low:?} to {high:?} has no inside; `high` must exceed `low` by more than 1 mm on each axis, all \
         within 1000 km"
    ))
}

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
