//! Scene files: room, objects, transmitter and receivers.

mod antennas;
mod changes;
mod mitsuba;
mod noise;
mod propagation;
mod room;
mod transmitters;

pub use antennas::{MovingReceiver, Orientation, SceneReceiver, SceneTransmitter};
pub use noise::Noise;
pub(crate) use noise::SNR_RANGE_DB;
pub use propagation::{Propagation, Subcarriers};
pub(crate) use room::THICKEST;
pub use room::{Finish, Object, Outline, Room};
pub use transmitters::Transmitters;

use crate::SPEED_OF_LIGHT;
use crate::material::{self, Material};
use crate::mesh::named_mesh;
use crate::spectrum::SpectrumKind;
use mitsuba::MitsubaScene;
use propagation::check_carriers;
use pwrfgs_core::files::MAX_TEXT;
use pwrfgs_core::plugin::{Checked, read_ron};
use pwrfgs_core::{Error, Result, ShippedFile, carrier_fault, did_you_mean, files};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Longest name, characters.
const LONGEST_NAME: usize = 200;
/// Smallest real part of the relative permittivity: below it, coefficients round.
const LEAST_PERMITTIVITY: f64 = 1e-6;
/// Largest modulus of the relative permittivity: above it, coefficients overflow.
const MOST_PERMITTIVITY: f64 = 1e70;
/// Largest number of the scene's own materials listed in a message.
const LISTED: usize = 20;
/// Scene of a Mitsuba file, before its meshes are known.
const MITSUBA_DEFAULTS: &str = "(name: \"\", carrier_hz: 3.5e9, \
    receiver: (position: (0, 0, 0), orientation: Facing(direction: (1, 0, 0))), \
    transmitter: (positions: Uniform(low: (0, 0, 0), high: (0, 0, 0))))";
/// Largest number of receivers; each has its own images and beams.
const MOST_RECEIVERS: usize = 200;

/// Scene as in `scenes/*.ron`. Metres, hertz, degrees; z is up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    /// Name of the scene.
    pub name: String,
    /// Notes for the reader, in particular assumed values.
    #[serde(default)]
    pub about: String,
    /// Carrier frequency, Hz.
    pub carrier_hz: f64,
    /// Carriers of spectra at one receiver, Hz, ascending; without them, `carrier_hz` alone. Materials and antenna spacing
    /// are those of each carrier.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub carriers_hz: Vec<f64>,
    /// Walls, floor and ceiling; without them, the scene is open, as outdoors.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub room: Option<Room>,
    /// Mitsuba XML file, relative to the scene file: its meshes and radio materials are added to the scene.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mitsuba: Option<PathBuf>,
    /// Materials in addition to those of ITU-R P.2040; equal names replace them.
    #[serde(default)]
    pub materials: BTreeMap<String, Material>,
    /// Furniture and partitions.
    #[serde(default)]
    pub objects: Vec<Object>,
    /// The first receiver.
    pub receiver: SceneReceiver,
    /// Further receivers with unique names. Fields added later are omitted from the written scene if unused, so that
    /// data of older scenes keep their key.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub more_receivers: Vec<SceneReceiver>,
    /// Frequencies of channels and powers; default the carrier alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub subcarriers: Option<Checked<Subcarriers>>,
    /// The transmitter.
    pub transmitter: SceneTransmitter,
    /// Makes the array move about a fixed transmitter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub moving_receiver: Option<MovingReceiver>,
    /// Propagation effects to simulate.
    #[serde(default)]
    pub propagation: Checked<Propagation>,
    /// Quantity in the pixels of a spectrum.
    #[serde(default)]
    pub spectrum: SpectrumKind,
    /// Receiver errors.
    #[serde(default)]
    pub noise: Checked<Noise>,
}

impl SceneFile {
    /// Reads and checks a scene file, or the shipped scene of this name; mesh paths become relative to the current
    /// directory. A Mitsuba XML file is a scene with a default carrier, receiver and transmitter region.
    ///
    /// # Errors
    /// The file cannot be read, or is not a valid scene; the message has line and column.
    pub fn read(path: &Path) -> Result<Self> {
        if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("xml")) {
            return Self::read_mitsuba(path);
        }
        let text = ShippedFile::read(ShippedFile::SCENES, path, MAX_TEXT)?;
        let mut scene: Self = read_ron(&text, path)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        scene.transmitter.positions.read_file(folder, scene.moving_receiver.is_some())?;
        if scene.mitsuba.is_none() {
            scene = scene.validated(path, &text)?; // otherwise its objects may have materials of the XML file
        }
        for object in &mut scene.objects {
            if let Object::Mesh { file, .. } = object
                && named_mesh(file).is_none()
            {
                *file = folder.join(&*file);
            }
        }
        let Some(file) = scene.mitsuba.take() else { return Ok(scene) };
        let meshes = MitsubaScene::read(&folder.join(file), scene.materials.keys())?;
        scene.with_meshes(meshes, (path, &text))
    }

    /// Reads a Mitsuba file as a scene with a default carrier, and isotropic antennas at positions that suit its size. Returns an
    /// error for an invalid file, too many triangles, a mesh that cannot be read, or a single wall.
    fn read_mitsuba(path: &Path) -> Result<Self> {
        let meshes = MitsubaScene::read(path, std::iter::empty())?;
        let mut scene: Self = read_ron(MITSUBA_DEFAULTS, path)?;
        // Sionna RT and Blender name files `scene.xml`.
        let folder =
            path.parent().and_then(Path::file_name).filter(|_| path.file_stem().is_some_and(|stem| stem == "scene"));
        scene.name = folder.or(path.file_stem()).unwrap_or_default().to_string_lossy().into_owned();
        let [receiver, low, high] = meshes.default_antennas()?;
        scene.receiver.position = receiver;
        scene.transmitter.positions = Transmitters::Uniform { low, high };
        scene.with_meshes(meshes, (path, &files::read_text(path)?))
    }

    /// Returns the scene of the file `path` with content `text`, with the meshes and materials of a Mitsuba file; materials
    /// of the scene file have precedence. Returns an error if the scene is then invalid.
    fn with_meshes(mut self, meshes: MitsubaScene, (path, text): (&Path, &str)) -> Result<Self> {
        self.objects.extend(meshes.objects);
        self.materials = meshes.materials.into_iter().chain(self.materials).collect();
        self.validated(path, text)
    }

    /// Parses and checks a scene; `path` is used only in messages.
    ///
    /// # Errors
    /// The text is not a valid scene; the message has line and column.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        read_ron::<Self>(text, path)?.validated(path, text)
    }

    /// Returns the scene if it is valid, otherwise an error for the file `path` with content `text`; line and column
    /// are those of a word near the problem, if the text has it.
    fn validated(self, path: &Path, text: &str) -> Result<Self> {
        self.check_names().and_then(|()| self.check()).map_err(|fault| match word_position(text, &fault.near) {
            Some((line, column)) => Error::at(path, line, column, fault.message),
            None => Error::input(path, fault.message),
        })?;
        Ok(self)
    }

    /// Returns the scene as RON text. Defaults are written out, except for fields that are omitted if unused.
    pub fn to_ron(&self) -> String {
        let config = ron::ser::PrettyConfig::new().struct_names(true);
        pwrfgs_core::plugin::ron_options().to_string_pretty(self, config).expect("a scene is plain data")
    }

    /// Returns the scene with mesh file names instead of paths, independent of the folder.
    pub(crate) fn portable(&self) -> Self {
        let mut scene = self.clone();
        for object in &mut scene.objects {
            if let Object::Mesh { file, .. } = object {
                *file = file.file_name().unwrap_or_default().into();
            }
        }
        scene
    }

    /// Returns the material called `name` of the scene, else of ITU-R P.2040; `None` if both lack it.
    pub fn material(&self, name: &str) -> Option<Material> {
        self.materials.get(name).cloned().or_else(|| material::itu_material(name))
    }

    /// Returns the carrier wavelength, metres.
    pub fn wavelength(&self) -> f64 {
        SPEED_OF_LIGHT / self.carrier_hz
    }

    /// Returns the number of carriers, at least 1.
    pub(crate) fn carrier_count(&self) -> usize {
        self.carriers_hz.len().max(1)
    }

    /// Returns all receivers: `receiver` first, then `more_receivers`.
    pub fn receivers(&self) -> impl Iterator<Item = &SceneReceiver> + Clone {
        std::iter::once(&self.receiver).chain(&self.more_receivers)
    }

    /// Returns the frequencies of channels and powers, Hz, ascending: subcarriers, or the carrier alone.
    pub fn frequencies(&self) -> Vec<f64> {
        self.subcarriers.as_ref().map_or_else(|| vec![self.carrier_hz], |band| band.frequencies(self.carrier_hz))
    }

    /// Returns all finishes, with the names of their objects, in the order of [`World::surfaces`](crate::world::World).
    pub(crate) fn finishes(&self) -> impl Iterator<Item = (&str, &Finish)> {
        let room = self.room.iter();
        let room = room.flat_map(|room| [("walls", &room.walls), ("floor", &room.floor), ("ceiling", &room.ceiling)]);
        room.chain(self.objects.iter().filter_map(|o| Some((o.name(), o.finish()?))))
    }

    /// Returns the first problem of the scene, in words; `None` for a valid scene. Names are not checked again:
    /// [`Self::check_names`] did when the scene was read.
    pub(crate) fn first_fault(&self) -> Option<String> {
        self.check().err().map(|fault| fault.message)
    }

    /// Returns an error unless all names of the scene, its objects and materials are printable and short.
    fn check_names(&self) -> Result<(), SceneFault> {
        let is_plain = |name: &str| !name.chars().any(char::is_control) && name.chars().count() <= LONGEST_NAME;
        let fault = |subject: String| {
            let message =
                format!("{subject} holds control characters or more than {LONGEST_NAME} letters; give a plain name");
            Err(SceneFault::new(message, "name"))
        };
        if self.name.trim().is_empty() {
            return Err(SceneFault::new("`name` is empty; give a plain name", "name"));
        }
        if !is_plain(&self.name) {
            return fault("`name`".into());
        }
        if let Some(i) = self.objects.iter().position(|object| !is_plain(object.name())) {
            return fault(format!("the name of object {}", i + 1));
        }
        let mut materials = self.materials.keys().map(String::as_str).chain(self.finishes().map(|(_, f)| &*f.material));
        if materials.any(|name| !is_plain(name)) {
            return fault("the name of a material".into());
        }
        Ok(())
    }

    /// Returns an error for the first invalid value.
    fn check(&self) -> Result<(), SceneFault> {
        if carrier_fault(self.carrier_hz).is_some() {
            let why = format!("`carrier_hz` is {}; give a frequency in Hz between 1e6 and 1e12", self.carrier_hz);
            return Err(SceneFault::new(why, "carrier_hz"));
        }
        let is_fixed = self.more_receivers.is_empty() && self.moving_receiver.is_none();
        check_carriers(&self.carriers_hz, is_fixed).map_err(|why| SceneFault::new(why, "carriers_hz"))?;
        for (name, material) in &self.materials {
            material
                .check()
                .map_err(|why| SceneFault::new(format!("material `{name}`: {why}"), &format!("\"{name}\"")))?;
        }
        for hz in std::iter::once(self.carrier_hz).chain(self.carriers_hz.iter().copied()) {
            self.finishes().try_for_each(|(owner, finish)| self.check_finish(owner, finish, hz))?;
        }
        if let Some(room) = &self.room {
            room.outline.check().map_err(|why| SceneFault::new(why, "outline"))?;
        } else if self.objects.is_empty() && self.mitsuba.is_none() {
            return Err(SceneFault::new("the scene is empty; give it a `room`, `objects` or `mitsuba`", "receiver"));
        }
        let mut names = BTreeSet::new();
        for object in &self.objects {
            let quoted = format!("\"{}\"", object.name());
            object.check().map_err(|why| SceneFault::new(format!("object `{}`: {why}", object.name()), &quoted))?;
            if !names.insert(object.name()) {
                let why = format!("two objects are called `{}`; give each a unique name", object.name());
                return Err(SceneFault::new(why, &quoted));
            }
        }
        self.check_receivers()?;
        if let Some(band) = &self.subcarriers {
            band.check_band(self.carrier_hz).map_err(|why| SceneFault::new(why, "subcarriers"))?;
        }
        self.transmitter.check().map_err(|why| SceneFault::new(why, "transmitter"))?;
        self.transmitter.positions.check().map_err(|why| SceneFault::new(why, "positions"))
    }

    /// Returns an error for too many receivers, an invalid one, or two with one name.
    fn check_receivers(&self) -> Result<(), SceneFault> {
        if self.receivers().count() > MOST_RECEIVERS {
            let why = format!("{} receivers are too many; give at most {MOST_RECEIVERS}", self.receivers().count());
            return Err(SceneFault::new(why, "more_receivers"));
        }
        // Before the loop: the default name of the first receiver is not in the file.
        self.receiver.check().map_err(|why| SceneFault::new(why, "receiver"))?;
        if let Some(moving) = &self.moving_receiver {
            moving.check(!self.more_receivers.is_empty()).map_err(|why| SceneFault::new(why, "moving_receiver"))?;
        }
        let mut names = BTreeSet::new();
        for receiver in self.receivers() {
            let quoted = format!("\"{}\"", receiver.name);
            receiver.check_name().map_err(|why| SceneFault::new(why, &quoted))?;
            receiver.check().map_err(|why| SceneFault::new(why, &quoted))?;
            // Folder names are not case-sensitive on some systems.
            if !names.insert(receiver.name.to_ascii_lowercase()) {
                let why = format!("two receivers are called `{}`; give each a unique `name`", receiver.name);
                return Err(SceneFault::new(why, "more_receivers"));
            }
        }
        Ok(())
    }

    /// Returns an error for an unknown material, one with an extreme permittivity at this carrier, or an invalid thickness
    /// or roughness. `owner` is the object of the finish.
    fn check_finish(&self, owner: &str, finish: &Finish, carrier_hz: f64) -> Result<(), SceneFault> {
        let name = &finish.material;
        let quoted = format!("\"{name}\"");
        let Some(material) = self.material(name) else {
            let mut names: Vec<&str> = material::itu_material_names();
            names.extend(self.materials.keys().map(String::as_str));
            let hint = did_you_mean(name, names.iter().copied());
            names.truncate(material::itu_material_names().len() + LISTED);
            let why = format!("unknown material `{name}`{hint}; known are {}", names.join(", "));
            return Err(SceneFault::new(why, &quoted));
        };
        let eta = material.permittivity(carrier_hz);
        if !(eta.re >= LEAST_PERMITTIVITY && eta.norm() <= MOST_PERMITTIVITY) {
            let why = format!(
                "material `{name}` has a relative permittivity of {:e} and {:e} at {} GHz; correct its `a`, `b`, `c` and `d`",
                eta.re,
                eta.im,
                carrier_hz / 1e9
            );
            return Err(SceneFault::new(why, &quoted));
        }
        if let Some(thickness) = finish.thickness_m
            && !(thickness > 0.0 && thickness <= THICKEST)
        {
            let advice = format!("give metres between 0 and {THICKEST}, or leave it out");
            let why = format!("{owner}: `thickness_m` is {thickness}; {advice}");
            return Err(SceneFault::new(why, &quoted));
        }
        match finish.roughness {
            Some(s) if !(0.0..=1.0).contains(&s) => {
                Err(SceneFault::new(format!("{owner}: `roughness` is {s}; give a share between 0 and 1"), &quoted))
            }
            _ => Ok(()),
        }
    }
}

/// Problem, with a word of the file near it.
struct SceneFault {
    message: String,
    near: String,
}

impl SceneFault {
    /// Creates the fault; its position is the first `near` in the file.
    fn new(message: impl Into<String>, near: &str) -> Self {
        Self { message: message.into(), near: near.into() }
    }
}

/// Returns the line and column, from 1, of the first occurrence of `word` outside comments; `None` if there is none.
fn word_position(text: &str, word: &str) -> Option<(usize, usize)> {
    text.lines().enumerate().find_map(|(i, line)| {
        let code = line.split("//").next().unwrap_or_default();
        code.find(word).map(|at| (i + 1, code[..at].chars().count() + 1))
    })
}
