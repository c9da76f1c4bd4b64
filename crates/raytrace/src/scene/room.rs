//! The outline of the room and what it is made of.

use super::{FAR, Finish};
use glam::DVec2;
use serde::{Deserialize, Serialize};

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
