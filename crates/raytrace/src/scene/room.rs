//! The room: outline, objects, and finishes of surfaces.

use crate::mesh::{self, Mesh};
use glam::{DMat4, DVec2, DVec3};
use pwrfgs_core::Error;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Largest thickness of a sheet, metres.
pub(crate) const THICKEST: f64 = 10.0;

/// Largest absolute coordinate, metres.
pub(crate) const FAR: f64 = 1e6;

/// Smallest side, metres.
const SHORTEST: f64 = 1e-3;

/// Room shape and finishes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Room {
    /// Shape of the room.
    pub outline: Outline,
    /// Finish of the walls.
    pub walls: Finish,
    /// Finish of the floor.
    pub floor: Finish,
    /// Finish of the ceiling.
    pub ceiling: Finish,
}

/// Largest number of corners of a floor plan.
const MOST_CORNERS: usize = 1000;

/// The outline of the room.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Outline {
    /// A box between two corners, metres.
    Box {
        /// Smallest corner, metres.
        low: [f64; 3],
        /// Largest corner, metres.
        high: [f64; 3],
    },
    /// Vertical walls over a floor plan.
    Plan {
        /// Corners (x, y) of the floor in order, metres; wall k goes from corner k to the next.
        corners: Vec<[f64; 2]>,
        /// Height of the floor, metres; default 0.
        #[serde(default)]
        floor: f64,
        /// Height of the ceiling, metres.
        ceiling: f64,
    },
}

impl Outline {
    /// Returns an error for an outline without an inside, with crossing walls, or that is too large: the problem and the
    /// next step.
    pub(super) fn check(&self) -> Result<(), String> {
        match self {
            Self::Box { low, high } => check_box(*low, *high).map_err(|why| format!("room: {why}")),
            Self::Plan { corners, floor, ceiling } => {
                if corners.len() < 3 || !corners.as_flattened().iter().all(|v| v.abs() <= FAR) {
                    return Err("room: a floor plan needs three corners or more, finite numbers in metres".into());
                }
                if corners.len() > MOST_CORNERS {
                    let count = corners.len();
                    return Err(format!("room: the floor plan has {count} corners; give at most {MOST_CORNERS}"));
                }
                if !(ceiling - floor > SHORTEST && ceiling.abs() <= FAR && floor.abs() <= FAR) {
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

/// Returns the indices of the first two walls of a plan that cross, touch or overlap, or of a wall of zero length and the next;
/// `None` for a valid plan. Adjacent walls may touch in their common corner. Wall k goes from corner k to the next.
fn first_crossing(corners: &[[f64; 2]]) -> Option<(usize, usize)> {
    let n = corners.len();
    let corner = |i: usize| DVec2::from(corners[i % n]);
    let side = |a: DVec2, b: DVec2, c: DVec2| (b - a).perp_dot(c - a);
    for i in 0..n {
        let (a, b) = (corner(i), corner(i + 1));
        if a.distance(b) < SHORTEST {
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
                // On one line: separate, like the walls beside a niche, or overlapping.
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

/// Returns an error unless the box between two corners, metres, has an inside.
pub(super) fn check_box(low: [f64; 3], high: [f64; 3]) -> Result<(), String> {
    let is_valid = (0..3).all(|k| low[k].abs() <= FAR && high[k].abs() <= FAR && high[k] - low[k] > SHORTEST);
    if is_valid {
        return Ok(());
    }
    Err(format!(
        "the box from {low:?} to {high:?} has no inside; `high` must exceed `low` by more than 1 mm on each axis, all \
         within 1000 km"
    ))
}

/// Material and thickness of a surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Finish {
    /// Name of a material of ITU-R P.2040 or of the scene.
    pub material: String,
    /// Thickness of the sheet, metres: waves reflect at both sides and pass through with loss. Without it, the object
    /// is an opaque solid.
    #[serde(default)]
    pub thickness_m: Option<f64>,
    /// Share S of the reflected amplitude that is scattered diffusely, in [0, 1]; default: that of the scene.
    #[serde(default)]
    pub roughness: Option<f64>,
}

/// Object in the room.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Object {
    /// Box between two corners, rotated about its vertical axis.
    Box {
        /// Name of the object.
        name: String,
        /// Smallest corner before rotation, metres.
        low: [f64; 3],
        /// Largest corner before rotation, metres.
        high: [f64; 3],
        /// Rotation, counter-clockwise as seen from above, degrees; default 0.
        #[serde(default)]
        yaw_deg: f64,
        /// Finish of its surface.
        finish: Finish,
    },
    /// Vertical rectangle: a partition, a window, a board.
    Panel {
        /// Name of the object.
        name: String,
        /// One lower corner (x, y), metres.
        from: [f64; 2],
        /// The other lower corner (x, y), metres.
        to: [f64; 2],
        /// Heights of its lower and upper edge, metres.
        heights: [f64; 2],
        /// Finish of its surface; a panel needs a thickness.
        finish: Finish,
    },
    /// Vertical rectangular hole in a wall, a panel or the side of a box that precedes it in the file: a doorway or an
    /// open window. A later object may close it, such as a panel for the door.
    Opening {
        /// Name of the opening.
        name: String,
        /// One lower corner (x, y), metres.
        from: [f64; 2],
        /// The other lower corner (x, y), metres.
        to: [f64; 2],
        /// Heights of its lower and upper edge, metres.
        heights: [f64; 2],
    },
    /// Triangle mesh.
    Mesh {
        /// Name of the object.
        name: String,
        /// OBJ or PLY file, relative to the scene file; or `cube`, from -1 to 1 on each axis; or `rectangle`, from -1 to 1
        /// in x and y.
        file: PathBuf,
        /// Affine map before scaling, rotation and shift: the first three rows of a 4 x 4 matrix; default none.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        matrix: Option<[[f64; 4]; 3]>,
        /// Metres per unit of the file; default 1.
        #[serde(default = "unit_scale")]
        scale: f64,
        /// Rotation after scaling, counter-clockwise as seen from above, degrees; default 0.
        #[serde(default)]
        yaw_deg: f64,
        /// Translation after rotation, metres; default zero.
        #[serde(default)]
        shift: [f64; 3],
        /// Whether antennas may be inside a closed mesh, as in a room or a building; default no. A hollow mesh consists
        /// of sheets and needs a thickness.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        hollow: bool,
        /// Finish of its surface.
        finish: Finish,
    },
}

/// Returns the default scale of a mesh.
fn unit_scale() -> f64 {
    1.0
}

impl Object {
    /// Returns the name of the object.
    pub fn name(&self) -> &str {
        match self {
            Self::Box { name, .. }
            | Self::Panel { name, .. }
            | Self::Opening { name, .. }
            | Self::Mesh { name, .. } => name,
        }
    }

    /// Returns the finish of the object; `None` for an opening.
    pub fn finish(&self) -> Option<&Finish> {
        match self {
            Self::Box { finish, .. } | Self::Panel { finish, .. } | Self::Mesh { finish, .. } => Some(finish),
            Self::Opening { .. } => None,
        }
    }

    /// Returns the finish of the object for a change; `None` for an opening.
    pub(crate) fn finish_mut(&mut self) -> Option<&mut Finish> {
        match self {
            Self::Box { finish, .. } | Self::Panel { finish, .. } | Self::Mesh { finish, .. } => Some(finish),
            Self::Opening { .. } => None,
        }
    }

    /// Reads the mesh and returns it at its position in the world, metres; empty for an object without a file. `solid`: the
    /// mesh must be closed.
    ///
    /// # Errors
    /// Errors of [`mesh::read_object_mesh`], or a vertex farther than 1000 km away.
    pub(crate) fn placed_mesh(&self, solid: bool) -> pwrfgs_core::Result<Mesh> {
        let Self::Mesh { name, file, matrix, scale, yaw_deg, shift, .. } = self else { return Ok(Mesh::default()) };
        let matrix = matrix.map_or(DMat4::IDENTITY, |[x, y, z]| {
            DMat4::from_cols_array_2d(&[x, y, z, [0.0, 0.0, 0.0, 1.0]]).transpose()
        });
        let mesh =
            mesh::read_object_mesh(file, matrix, solid, name)?.transformed(*scale, *yaw_deg, DVec3::from(*shift));
        mesh.check(file)?;
        if mesh.vertices.iter().any(|v| v.abs().max_element() > FAR) {
            let problem = format!("puts `{name}` farther than 1000 km away; correct its `scale`, `shift` and `matrix`");
            return Err(Error::input(file, problem));
        }
        Ok(mesh)
    }

    /// Returns an error for invalid dimensions, or a missing thickness or file: the problem and the next step.
    pub(super) fn check(&self) -> Result<(), String> {
        match self {
            Self::Box { low, high, yaw_deg, .. } => {
                if !yaw_deg.is_finite() {
                    return Err(format!("`yaw_deg` is {yaw_deg}; give degrees"));
                }
                check_box(*low, *high)
            }
            Self::Panel { from, to, heights, finish, .. } => {
                check_vertical_rectangle("panel", from, to, heights)?;
                if finish.thickness_m.is_none() {
                    return Err("a panel needs a sheet material; give its finish a `thickness_m`".into());
                }
                Ok(())
            }
            Self::Opening { from, to, heights, .. } => check_vertical_rectangle("opening", from, to, heights),
            Self::Mesh { file, matrix, scale, yaw_deg, shift, hollow, finish, .. } => {
                if *hollow && finish.thickness_m.is_none() {
                    return Err("a hollow mesh needs a sheet material; give its finish a `thickness_m`".into());
                }
                if file.as_os_str().is_empty() {
                    return Err("`file` is empty; name an OBJ or PLY file".into());
                }
                let mut numbers = matrix.iter().flatten().flatten().chain(shift);
                let is_finite = yaw_deg.is_finite() && numbers.all(|v| v.is_finite());
                if is_finite && (1e-9..=1e9).contains(scale) {
                    return Ok(());
                }
                Err("`scale` must lie between 1e-9 and 1e9, `yaw_deg`, `shift` and `matrix` be finite".into())
            }
        }
    }
}

/// Returns an error unless lower corners and heights, metres, give a vertical rectangle. `kind` of object, for the error:
/// `panel` or `opening`.
fn check_vertical_rectangle(kind: &str, from: &[f64; 2], to: &[f64; 2], heights: &[f64; 2]) -> Result<(), String> {
    if !from.iter().chain(to).chain(heights).all(|v| v.abs() <= FAR) {
        return Err(format!("`from`, `to` and `heights` must be finite numbers in metres within {:.0} km", FAR / 1e3));
    }
    if DVec2::from(*from).distance(DVec2::from(*to)) > SHORTEST && heights[1] - heights[0] > SHORTEST {
        return Ok(());
    }
    let article = if kind == "opening" { "an" } else { "a" };
    Err(format!("{article} {kind} needs two different lower corners and a lower edge below its upper edge"))
}
