//! A scene file: the room, what stands in it, who sends, who listens.

use crate::array::{Array, Element};
use crate::material::{self, Material};
use crate::noise::Noise;
use crate::scattering::Lobe;
use crate::spectrum::SpectrumKind;
use crate::transmitters::Transmitters;
use pwrfgs_core::plugin::{Check, Checked, read_ron};
use pwrfgs_core::{Error, Pose, Result};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A scene, as `scenes/*.ron` say it. Metres, hertz, degrees; z is up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// What it is called.
    pub name: String,
    /// What a reader should know, above all what is guessed.
    #[serde(default)]
    pub about: String,
    /// Carrier frequency, Hz.
    pub carrier_hz: f64,
    /// Walls, floor and ceiling.
    pub room: Room,
    /// Materials beside those of ITU-R P.2040, or instead of them.
    #[serde(default)]
    pub materials: BTreeMap<String, Material>,
    /// Furniture and partitions.
    #[serde(default)]
    pub objects: Vec<Object>,
    /// Who listens.
    pub receiver: Receiver,
    /// Who sends.
    pub transmitter: Transmitter,
    /// Which ways of the waves count.
    #[serde(default)]
    pub propagation: Checked<Propagation>,
    /// What a picture holds.
    #[serde(default)]
    pub spectrum: SpectrumKind,
    /// Errors of the receiver.
    #[serde(default)]
    pub noise: Checked<Noise>,
}

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
    /// A triangle mesh.
    Mesh {
        /// What it is called.
        name: String,
        /// OBJ, STL or PLY; relative to the scene file.
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
            Self::Box { name, .. } | Self::Panel { name, .. } | Self::Mesh { name, .. } => name,
        }
    }

    /// What it is made of.
    pub fn finish(&self) -> &Finish {
        match self {
            Self::Box { finish, .. } | Self::Panel { finish, .. } | Self::Mesh { finish, .. } => finish,
        }
    }

    pub(crate) fn finish_mut(&mut self) -> &mut Finish {
        match self {
            Self::Box { finish, .. } | Self::Panel { finish, .. } | Self::Mesh { finish, .. } => finish,
        }
    }
}

/// The receiver.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Receiver {
    /// Centre of the array, metres.
    pub position: [f64; 3],
    /// How it is turned.
    pub orientation: Orientation,
    /// Its antennas.
    #[serde(default)]
    pub array: Checked<Array>,
}

/// How the receiver is turned.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Orientation {
    /// Unit quaternion x, y, z, w from the axes of the receiver to those of the world, as in `gateway_info.yml`.
    Quaternion(f64, f64, f64, f64),
    /// Boresight towards `direction`, the y axis of the array as far up as that allows (for a boresight straight up or
    /// down: towards +y of the world).
    Facing {
        /// A direction in the world, of any length.
        direction: [f64; 3],
    },
}

/// The transmitter: one antenna that moves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Transmitter {
    /// Where it stands.
    pub positions: Transmitters,
    /// Its pattern; default isotropic.
    #[serde(default)]
    pub element: Element,
    /// Axis of its polarisation, world frame; default upright.
    #[serde(default = "upright")]
    pub polarization: [f64; 3],
}

fn upright() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}

/// Which ways of the waves count.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Propagation {
    /// Most specular reflections; default 2.
    pub order: usize,
    /// Most specular reflections of a path that meets the room alone, no object; default 3.
    pub room_order: usize,
    /// Whether waves pass sheets; default yes.
    pub transmission: bool,
    /// Whether waves go around one edge; default yes.
    pub diffraction: bool,
    /// Diffuse scattering: share S of the reflected amplitude where a finish says nothing; default 0, none.
    pub roughness: f64,
    /// Shape of the diffuse lobe; default Lambertian.
    pub lobe: Lobe,
    /// Side of the square patches that scatter, metres; default 0.5.
    pub patch_m: f64,
    /// Seed of the phases that patches add; default 0.
    pub seed: u64,
}

impl Default for Propagation {
    fn default() -> Self {
        Self {
            order: 2,
            room_order: 3,
            transmission: true,
            diffraction: true,
            roughness: 0.0,
            lobe: Lobe::Lambertian,
            patch_m: 0.5,
            seed: 0,
        }
    }
}

impl Check for Propagation {
    fn check(&self) -> Result<(), String> {
        for (field, order) in [("order", self.order), ("room_order", self.room_order)] {
            if order > 10 {
                return Err(format!("propagation: `{field}` is {order}; give at most 10"));
            }
        }
        if !(0.0..=1.0).contains(&self.roughness) {
            return Err(format!("propagation: `roughness` is {}; give a share between 0 and 1", self.roughness));
        }
        if !(0.01..=100.0).contains(&self.patch_m) {
            return Err(format!("propagation: `patch_m` is {}; give 0.01 to 100 metres", self.patch_m));
        }
        self.lobe.check().map_err(|why| format!("propagation: {why}"))
    }
}

impl Scene {
    /// Reads a scene file; paths of meshes become relative to where one stands.
    ///
    /// # Errors
    /// Names the file, line and column of the mistake.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::read(path, e))?;
        let mut scene = Self::parse(&text, path)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        for object in &mut scene.objects {
            if let Object::Mesh { file, .. } = object {
                *file = folder.join(&*file);
            }
        }
        Ok(scene)
    }

    /// Reads a scene; `path` is for messages only.
    ///
    /// # Errors
    /// With line and column of the mistake.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let scene: Self = read_ron(text, path)?;
        scene.check().map_err(|fault| match place(text, &fault.near) {
            Some((line, column)) => Error::at(path, line, column, fault.what),
            None => Error::input(path, fault.what),
        })?;
        Ok(scene)
    }

    /// The scene as RON text, every default written out.
    pub fn to_ron(&self) -> String {
        let config = ron::ser::PrettyConfig::new().struct_names(true);
        pwrfgs_core::plugin::ron_options().to_string_pretty(self, config).expect("a scene is plain data")
    }

    /// The material called `name`: the scene's own, else that of ITU-R P.2040.
    pub fn material(&self, name: &str) -> Option<Material> {
        self.materials.get(name).cloned().or_else(|| material::named(name))
    }

    /// Wavelength of the carrier, metres.
    pub fn wavelength(&self) -> f64 {
        crate::SPEED_OF_LIGHT / self.carrier_hz
    }

    /// Pose of the receiver.
    pub fn pose(&self) -> Pose {
        Pose { position: self.receiver.position, orientation: self.receiver.orientation.quaternion() }
    }

    /// All finishes, with what has them.
    pub(crate) fn finishes(&self) -> impl Iterator<Item = (&str, &Finish)> {
        let room = [("walls", &self.room.walls), ("floor", &self.room.floor), ("ceiling", &self.room.ceiling)];
        room.into_iter().chain(self.objects.iter().map(|o| (o.name(), o.finish())))
    }

    /// Whether the scene can be built, in words.
    pub(crate) fn fault(&self) -> Option<String> {
        self.check().err().map(|fault| fault.what)
    }

    fn check(&self) -> Result<(), Fault> {
        if self.name.trim().is_empty() || self.name.chars().any(char::is_control) {
            return Err(Fault::of("`name` is empty or holds control characters; give a plain name", "name"));
        }
        if !(1e6..=1e12).contains(&self.carrier_hz) {
            let what = format!("`carrier_hz` is {}; give a frequency in Hz between 1e6 and 1e12", self.carrier_hz);
            return Err(Fault::of(what, "carrier_hz"));
        }
        for (name, material) in &self.materials {
            material.check().map_err(|why| Fault::of(format!("material `{name}`: {why}"), &format!("\"{name}\"")))?;
        }
        for (owner, finish) in self.finishes() {
            self.check_finish(owner, finish)?;
        }
        self.room.outline.check().map_err(|what| Fault::of(what, "outline"))?;
        for (i, object) in self.objects.iter().enumerate() {
            let quoted = format!("\"{}\"", object.name());
            object.check().map_err(|why| Fault::of(format!("object `{}`: {why}", object.name()), &quoted))?;
            if self.objects[..i].iter().any(|o| o.name() == object.name()) {
                let what = format!("two objects are called `{}`; give each its own name", object.name());
                return Err(Fault::of(what, &quoted));
            }
        }
        self.receiver.check().map_err(|what| Fault::of(what, "receiver"))?;
        let axis = self.transmitter.polarization;
        if glam::DVec3::from(axis).try_normalize().is_none() {
            let what = format!("`polarization` of the transmitter is {axis:?}; give an axis such as (0, 0, 1)");
            return Err(Fault::of(what, "transmitter"));
        }
        self.transmitter.positions.check().map_err(|what| Fault::of(what, "positions"))
    }

    fn check_finish(&self, owner: &str, finish: &Finish) -> Result<(), Fault> {
        let name = &finish.material;
        let quoted = format!("\"{name}\"");
        if self.material(name).is_none() {
            let mut known: Vec<&str> = material::names();
            known.extend(self.materials.keys().map(String::as_str));
            let nearest = known.iter().map(|k| (strsim::damerau_levenshtein(name, k), k)).min();
            let hint =
                nearest.filter(|(d, _)| *d <= 3).map_or_else(String::new, |(_, k)| format!("; did you mean `{k}`?"));
            let what = format!("unknown material `{name}`{hint}; known are {}", known.join(", "));
            return Err(Fault::of(what, &quoted));
        }
        if let Some(thickness) = finish.thickness_m
            && !(thickness > 0.0 && thickness <= 10.0)
        {
            let what = format!("{owner}: `thickness_m` is {thickness}; give metres between 0 and 10, or leave it out");
            return Err(Fault::of(what, &quoted));
        }
        match finish.roughness {
            Some(s) if !(0.0..=1.0).contains(&s) => {
                Err(Fault::of(format!("{owner}: `roughness` is {s}; give a share between 0 and 1"), &quoted))
            }
            _ => Ok(()),
        }
    }
}

/// What is wrong, and a word of the file near which it stands.
struct Fault {
    what: String,
    near: String,
}

impl Fault {
    fn of(what: impl Into<String>, near: &str) -> Self {
        Self { what: what.into(), near: near.into() }
    }
}

/// Line and column of the first place where `word` stands outside comments.
fn place(text: &str, word: &str) -> Option<(usize, usize)> {
    text.lines().enumerate().find_map(|(i, line)| {
        let code = line.split("//").next().unwrap_or_default();
        code.find(word).map(|at| (i + 1, code[..at].chars().count() + 1))
    })
}

/// Farthest coordinate, metres.
const FAR: f64 = 1e6;

/// Refuses what is not a box with an inside.
fn check_box(low: [f64; 3], high: [f64; 3]) -> Result<(), String> {
    let fine = (0..3).all(|k| low[k].abs() <= FAR && high[k].abs() <= FAR && high[k] - low[k] > 1e-3);
    if fine {
        return Ok(());
    }
    Err(format!(
        "the box from {low:?} to {high:?} has no inside; `high` must exceed `low` by more than 1 mm on each axis, all \
         within 1000 km"
    ))
}

impl Outline {
    fn check(&self) -> Result<(), String> {
        match self {
            Self::Box { low, high } => check_box(*low, *high).map_err(|why| format!("room: {why}")),
            Self::Plan { corners, floor, ceiling } => {
                if corners.len() < 3 || !corners.as_flattened().iter().all(|v| v.abs() <= FAR) {
                    return Err("room: a floor plan needs three corners or more, finite numbers in metres".into());
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

/// Two walls of a plan that are not neighbours and meet, or a wall without length.
fn first_crossing(corners: &[[f64; 2]]) -> Option<(usize, usize)> {
    let n = corners.len();
    let corner = |i: usize| glam::DVec2::from(corners[i % n]);
    let side = |a: glam::DVec2, b: glam::DVec2, c: glam::DVec2| (b - a).perp_dot(c - a);
    for i in 0..n {
        let (a, b) = (corner(i), corner(i + 1));
        if a.distance(b) < 1e-3 {
            return Some((i, (i + 1) % n));
        }
        for j in i + 2..n {
            if (j + 1) % n == i {
                continue;
            }
            let (c, d) = (corner(j), corner(j + 1));
            let sides = [side(a, b, c), side(a, b, d), side(c, d, a), side(c, d, b)];
            if sides == [0.0; 4] {
                // On one line: apart, as the walls beside a niche, or over each other.
                let along = |p: glam::DVec2| (p - a).dot(b - a);
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

impl Object {
    fn check(&self) -> Result<(), String> {
        match self {
            Self::Box { low, high, yaw_deg, .. } => {
                if !yaw_deg.is_finite() {
                    return Err(format!("`yaw_deg` is {yaw_deg}; give degrees"));
                }
                check_box(*low, *high)
            }
            Self::Panel { from, to, heights, finish, .. } => {
                let length = glam::DVec2::from(*from).distance(glam::DVec2::from(*to));
                let near = from.iter().chain(to).chain(heights).all(|v| v.abs() <= FAR);
                if !(near && length > 1e-3 && heights[1] - heights[0] > 1e-3) {
                    return Err("a panel needs two different lower corners and a lower rim below its upper one".into());
                }
                if finish.thickness_m.is_none() {
                    return Err("a panel has no inside that could be solid; give its finish a `thickness_m`".into());
                }
                Ok(())
            }
            Self::Mesh { file, scale, yaw_deg, shift, .. } => {
                if file.as_os_str().is_empty() {
                    return Err("`file` is empty; name an OBJ, STL or PLY file".into());
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

impl Receiver {
    fn check(&self) -> Result<(), String> {
        if !self.position.iter().all(|v| v.abs() <= FAR) {
            return Err(format!("receiver: `position` is {:?}; give finite metres", self.position));
        }
        match &self.orientation {
            Orientation::Quaternion(x, y, z, w) => {
                let norm = (x * x + y * y + z * z + w * w).sqrt();
                if (norm - 1.0).abs() < 0.01 {
                    return Ok(());
                }
                Err(format!("receiver: the quaternion has length {norm}; give a unit quaternion x, y, z, w"))
            }
            Orientation::Facing { direction } => {
                if glam::DVec3::from(*direction).try_normalize().is_some() {
                    return Ok(());
                }
                Err(format!("receiver: `direction` is {direction:?}; give a direction such as (0, 0, -1)"))
            }
        }
    }
}

impl Orientation {
    /// Unit quaternion x, y, z, w from the receiver's axes to the world's.
    pub fn quaternion(&self) -> [f64; 4] {
        match self {
            Self::Quaternion(x, y, z, w) => {
                let norm = (x * x + y * y + z * z + w * w).sqrt();
                [*x, *y, *z, *w].map(|v| v / norm)
            }
            Self::Facing { direction } => {
                use glam::{DMat3, DQuat, DVec3};
                let z = DVec3::from(*direction).normalize();
                let up = if z.x.hypot(z.y) > 1e-9 { DVec3::Z } else { DVec3::Y };
                let y = (up - up.dot(z) * z).normalize();
                DQuat::from_mat3(&DMat3::from_cols(y.cross(z), y, z)).normalize().to_array()
            }
        }
    }
}
