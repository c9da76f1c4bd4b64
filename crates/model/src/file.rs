//! Model file; `docs/model-format.md` describes it.

use crate::residuals::ResidualsNote;
use crate::tensors::Tensors;
use crate::{Ensemble, IntervalCalibration, Model, Stages, TrainingPositions};
use pwrfgs_core::files::{self, write_atomically};
use pwrfgs_core::plugin::{Plugin, ron_options};
use pwrfgs_core::{
    COLUMN_NAMES, End, Error, ExtraColumn, GaussianCloud, Geodetic, ImagePlane, MeasurementSetup, Method, Origin, Pose,
    Real, Receiver, Result, Task,
};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Metadata of a file with several models; the tensors of each have a prefix.
#[derive(Serialize, Deserialize)]
struct EnsembleNote {
    format: String,
    version: u32,
    members: Vec<MemberNote>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    residuals: Option<ResidualsNote>,
}

#[derive(Serialize, Deserialize)]
struct MemberNote {
    name: String,
    model: Note,
}

/// Common first fields of all metadata.
#[derive(Deserialize)]
struct Head {
    format: String,
    version: u32,
}

/// Metadata of a file with one model.
#[derive(Serialize, Deserialize)]
struct Note {
    format: String,
    version: u32,
    gaussians: usize,
    /// Method as in a pipeline, with all fields.
    method: String,
    links: LinksNote,
    /// Origin of the tensors; absent if zero.
    #[serde(default, skip_serializing_if = "Origin::is_zero")]
    origin: Origin,
    plane: ImagePlane,
}

/// Observations and ends of links.
#[derive(Clone, Serialize, Deserialize)]
struct LinksNote {
    kind: Task,
    /// End that moves; absent if it is the transmitter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    moving: Option<End>,
    /// Position of the fixed transmitter of moving receivers, user's frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    transmitter: Option<[f64; 3]>,
    /// Receivers with poses in the user's frame.
    receivers: Vec<Receiver>,
    /// Subcarrier frequencies, Hz.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    frequencies_hz: Vec<f64>,
    /// Latitude and longitude of the user's frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    geodetic: Option<Geodetic>,
}

const FORMAT: &str = "pwrfgs-model";
const ENSEMBLE_FORMAT: &str = "pwrfgs-ensemble";
/// Version of a file with several models.
const ENSEMBLE_VERSION: u32 = 2;
/// Version of a file with residual processes: programs that ignore them must not predict from it.
const RESIDUALS_VERSION: u32 = 3;
/// Maximum number of members in a file, and maximum length of their names.
pub const MOST_MEMBERS: usize = 100;
const LONGEST_NAME: usize = 255;
/// Version of a model of one carrier and fixed receivers.
const VERSION: u32 = 5;
/// Version of a model of several carriers: programs that ignore them must not predict from it.
const CARRIERS_VERSION: u32 = 7;
/// Version of a model whose receivers move. Version 6 stored the transmitter as the receiver.
const MOVING_VERSION: u32 = 8;
/// Prefix of the names of network tensors.
pub(crate) const NETWORK: &str = "network.";
/// Prefix of the names of constants that the network derives from a seed.
pub(crate) const CONSTANTS: &str = "constants.";
/// Name of the tensor of training positions.
const TRAINING: &str = "training_positions";

/// Writes `model` to `path` atomically.
///
/// # Errors
/// [`Error::Write`] if the file cannot be written.
pub fn write(path: &Path, model: &Model) -> Result<()> {
    write_atomically(path, &to_bytes(model))
}

/// Returns the bytes of a model file; equal models give equal bytes.
pub fn to_bytes(model: &Model) -> Vec<u8> {
    ensemble_to_bytes(&Ensemble::of(model.clone()))
}

/// Writes several models that predict together, with their residuals and calibration, to one file, atomically.
///
/// # Errors
/// [`Error::Write`] if the file cannot be written.
pub fn write_ensemble(path: &Path, ensemble: &Ensemble) -> Result<()> {
    write_atomically(path, &ensemble_to_bytes(ensemble))
}

/// Returns the bytes of [`write_ensemble`].
pub fn ensemble_to_bytes(ensemble: &Ensemble) -> Vec<u8> {
    ensemble_tensors(ensemble).to_bytes()
}

/// Returns the bytes of the file with 16-bit network weights, about half the size. Predictions from this file differ
/// slightly.
///
/// # Errors
/// A network weight exceeds the range of 16 bits.
pub fn to_bytes_half(ensemble: &Ensemble) -> Result<Vec<u8>> {
    let inner = format!(".{NETWORK}");
    let is_network = |name: &str| name.starts_with(NETWORK) || name.contains(&inner);
    ensemble_tensors(ensemble).to_bytes_half(is_network).map_err(Error::Config)
}

/// Returns the size of the model file that was read, or that would be written, bytes.
pub fn size(ensemble: &Ensemble) -> usize {
    ensemble.read_bytes().unwrap_or_else(|| ensemble_to_bytes(ensemble).len())
}

/// Returns the tensors of a file of all models, with residuals and calibration.
fn ensemble_tensors(ensemble: &Ensemble) -> Tensors {
    let mut file = predictor_tensors(ensemble);
    ensemble.calibration().into_iter().for_each(|calibration| calibration.put(&mut file));
    file
}

/// Returns the tensors of a file of all models with their residuals.
pub(crate) fn predictor_tensors(ensemble: &Ensemble) -> Tensors {
    let named = || ensemble.names().iter().zip(ensemble.members());
    let member = |(name, model): (&String, &Model)| MemberNote { name: name.clone(), model: create_note(model) };
    let mut file = match (ensemble.members(), ensemble.residuals()) {
        ([model], None) => Tensors::new(&create_note(model)),
        (_, residuals) => {
            let version = if residuals.is_some() { RESIDUALS_VERSION } else { ENSEMBLE_VERSION };
            let (members, residuals) = (named().map(member).collect(), residuals.map(ResidualsNote::of));
            Tensors::new(&EnsembleNote { format: ENSEMBLE_FORMAT.into(), version, members, residuals })
        }
    };
    ensemble.residuals().into_iter().for_each(|residuals| residuals.put(&mut file));
    model_prefixes(ensemble).for_each(|(prefix, model)| put_model(&mut file, &prefix, model));
    file
}

/// Returns the models with the prefixes of their tensor names: none for a single model without residuals.
pub(crate) fn model_prefixes(ensemble: &Ensemble) -> impl Iterator<Item = (String, &Model)> {
    let is_plain = ensemble.members().len() == 1 && ensemble.residuals().is_none();
    let prefix = move |k: usize| if is_plain { String::new() } else { member_prefix(k) };
    ensemble.members().iter().enumerate().map(move |(k, model)| (prefix(k), model))
}

/// Returns the prefix of the tensor names of a member.
fn member_prefix(member: usize) -> String {
    format!("members.{member}.")
}

/// Creates the metadata of a model, with the lowest version of the format that supports it. Poses are in the user's frame; a
/// moving receiver has its pose in the query, so the stored one is not converted.
fn create_note(model: &Model) -> Note {
    let stages = &model.stages;
    let world = |pose: Pose| if stages.moving.is_receiver() { pose } else { stages.origin.world_pose(pose) };
    let receiver = |r: &Receiver| Receiver { pose: world(r.pose), ..r.clone() };
    Note {
        format: FORMAT.into(),
        version: match (stages.moving.is_receiver(), stages.carriers().is_empty()) {
            (true, _) => MOVING_VERSION,
            (false, true) => VERSION,
            (false, false) => CARRIERS_VERSION,
        },
        gaussians: model.cloud.len(),
        method: plugin_text(&stages.method),
        links: LinksNote {
            kind: stages.task,
            moving: stages.moving.is_receiver().then_some(End::Receiver),
            transmitter: stages.transmitter.map(|position| stages.origin.world_pose(position.into()).position),
            receivers: stages.receivers.iter().map(receiver).collect(),
            frequencies_hz: stages.frequencies_hz.clone(),
            geodetic: stages.geodetic,
        },
        origin: stages.origin,
        plane: stages.plane.clone(),
    }
}

/// Adds the tensors of a model, with `prefix` before their names.
fn put_model(file: &mut Tensors, prefix: &str, model: &Model) {
    put_cloud(file, &format!("{prefix}gaussians."), &model.cloud);
    put_weights(file, &format!("{prefix}{NETWORK}"), &model.weights, &model.stages);
    for (spec, values) in model.stages.layout().constants {
        file.put(format!("{prefix}{CONSTANTS}{}", spec.name), spec.shape, values);
    }
    if let Some(training) = &model.training_positions {
        let positions = training.positions();
        file.put(format!("{prefix}{TRAINING}"), vec![positions.len(), 3], positions.as_flattened().to_vec());
    }
}

/// Reads a file with one model, without its residual processes and calibration.
///
/// # Errors
/// [`Error::Read`], or [`Error::Input`] for a file that is incomplete, holds several models, or names plugins that are
/// not linked.
pub fn read(path: &Path) -> Result<Model> {
    let ensemble = read_ensemble(path)?;
    let count = ensemble.members().len();
    let several = || Error::input(path, format!("holds an ensemble of {count} models; use the file of one member"));
    ensemble.into_only().ok_or_else(several)
}

/// Reads a file with one model, or with several that predict together.
///
/// # Errors
/// As [`read`], but not for several models.
pub fn read_ensemble(path: &Path) -> Result<Ensemble> {
    let bytes = files::read(path).map_err(|e| Error::read(path, e))?;
    from_bytes(&bytes).map_err(|why| Error::input(path, format!("{why}; give the model.safetensors of a finished run")))
}

/// Reads the bytes of a model file.
///
/// # Errors
/// The bytes are damaged or of another format or version, a tensor is missing or has another shape or type, a value is
/// invalid, or a plugin is not linked.
pub fn from_bytes(bytes: &[u8]) -> Result<Ensemble, String> {
    let mut file = Tensors::from_bytes(bytes)?;
    let ensemble = take_predictor(&mut file)?;
    let calibration = IntervalCalibration::take(&mut file, ensemble.members()[0].stages.task)?;
    Ok(ensemble.with_calibration(calibration).with_read_bytes(bytes.len()))
}

/// Takes the models of a file and their residuals, without calibration.
///
/// # Errors
/// As [`from_bytes`]; the message names the member with the fault.
fn take_predictor(file: &mut Tensors) -> Result<Ensemble, String> {
    let unreadable = |e: serde_json::Error| format!("not a pwrfgs model ({e})");
    let Head { format, version } = serde_json::from_str(&file.note).map_err(unreadable)?;
    if format != ENSEMBLE_FORMAT {
        check_version(&format, version)?;
        let note = serde_json::from_str(&file.note).map_err(unreadable)?;
        return Ok(Ensemble::of(take_model(file, "", &note)?));
    }
    if ![ENSEMBLE_VERSION, RESIDUALS_VERSION].contains(&version) {
        return Err(format!(
            "a `{format}` of version {version}, expected version {ENSEMBLE_VERSION} or {RESIDUALS_VERSION}"
        ));
    }
    let EnsembleNote { members, residuals, .. } = serde_json::from_str(&file.note).map_err(unreadable)?;
    if residuals.is_some() != (version == RESIDUALS_VERSION) {
        return Err(format!("version {RESIDUALS_VERSION} has `residuals`, and version {ENSEMBLE_VERSION} has none"));
    }
    if members.len() > MOST_MEMBERS {
        return Err(format!("an ensemble of {} members, expected at most {MOST_MEMBERS}", members.len()));
    }
    let mut models: Vec<(String, Model)> = Vec::new();
    for (k, MemberNote { name, model }) in members.into_iter().enumerate() {
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
        if name.is_empty() || name.len() > LONGEST_NAME || !name.chars().all(is_plain) {
            return Err(format!("member {k} has an invalid name; use letters, digits, `.`, `-` and `_`"));
        }
        if models.iter().any(|(other, _)| *other == name) {
            return Err(format!("two members have the name `{name}`"));
        }
        let model = take_model(file, &member_prefix(k), &model).map_err(|why| format!("member {k}: {why}"))?;
        models.push((name, model));
    }
    let ensemble = Ensemble::named(models)?;
    let residuals = residuals.map(|note| note.take(file, &ensemble.members()[0].stages.setup)).transpose()?;
    Ok(ensemble.with_residuals(residuals))
}

/// Checks that this program reads a model of this format and version.
fn check_version(format: &str, version: u32) -> Result<(), String> {
    if format == FORMAT && [VERSION, CARRIERS_VERSION, MOVING_VERSION].contains(&version) {
        return Ok(());
    }
    let expected = format!("`{FORMAT}` of version {VERSION}, {CARRIERS_VERSION} or {MOVING_VERSION}");
    Err(format!("a `{format}` of version {version}, expected {expected}; train it again"))
}

/// Takes a model from the tensors with `prefix` before their names, and checks that it can predict.
///
/// # Errors
/// The version or the plugin is unknown, settings do not fit together, or a tensor is missing or invalid.
fn take_model(file: &mut Tensors, prefix: &str, note: &Note) -> Result<Model, String> {
    check_version(&note.format, note.version)?;
    if let Some(fault) = note.origin.fault() {
        return Err(fault);
    }
    let stages = Stages { method: parse_method(&note.method)?, setup: setup_of_note(note) };
    stages.check()?;
    let cloud = take_cloud(file, &format!("{prefix}gaussians."), note.gaussians, &stages.method.traits().columns)?;
    let weights = take_weights(file, &format!("{prefix}{NETWORK}"), &stages)?;
    check_constants(file, prefix, &stages)?;
    let training_positions = take_training_positions(file, &format!("{prefix}{TRAINING}"))?;
    Ok(Model { stages, cloud, weights, training_positions })
}

/// Takes the training positions; `None` if the file has none. Returns an error for a tensor of another shape or type, or
/// with a number that is not finite.
fn take_training_positions(file: &mut Tensors, name: &str) -> Result<Option<TrainingPositions>, String> {
    let Some(count) = file.shape(name).map(|shape| shape.first().copied().unwrap_or(0)) else { return Ok(None) };
    let positions = file.take(name, &[count.max(1), 3])?; // rejects an empty tensor
    Ok(TrainingPositions::of(positions.as_chunks().0.to_vec()))
}

/// Returns the measurement setup of a model file, with poses relative to the origin.
fn setup_of_note(note: &Note) -> MeasurementSetup {
    let (origin, plane) = (note.origin, note.plane.clone());
    let LinksNote { kind, moving, transmitter, receivers, frequencies_hz, geodetic } = note.links.clone();
    let moving = moving.unwrap_or_default();
    let local = |pose: Pose| if moving.is_receiver() { pose } else { origin.local_pose(pose) };
    let receivers = receivers.into_iter().map(|r| Receiver { pose: local(r.pose), ..r }).collect();
    let transmitter = transmitter.map(|position| origin.local_pose(position.into()).position);
    MeasurementSetup { origin, moving, transmitter, receivers, task: kind, plane, frequencies_hz, geodetic }
}

/// Rejects a file whose constants differ from those that its deformation computes here, because predictions would
/// differ.
fn check_constants(file: &mut Tensors, prefix: &str, stages: &Stages) -> Result<(), String> {
    for (spec, drawn) in stages.layout().constants {
        let name = format!("{prefix}{CONSTANTS}{}", spec.name);
        if file.shape(&name).is_none() {
            continue; // file of an earlier version without constants
        }
        let stored = file.take(&name, &spec.shape)?;
        // Another C library or precision may round differently.
        if stored.iter().zip(drawn).any(|(stored, drawn)| (stored - drawn).abs() > 1e-5 * drawn.abs().max(1.0)) {
            return Err(format!("tensor `{name}` differs from the values of the seed of its deformation"));
        }
    }
    Ok(())
}

/// Writes a plugin as RON with all fields, structs on one line.
fn plugin_text<T: ?Sized + erased_serde::Serialize>(plugin: &Plugin<T>) -> String {
    let config = ron::ser::PrettyConfig::new().struct_names(true).compact_structs(true);
    ron_options().to_string_pretty(plugin, config).expect("a plugin is plain data")
}

/// Creates the method that a model file names. Returns an error for invalid text or a plugin that is not linked.
fn parse_method(text: &str) -> Result<Plugin<dyn Method>, String> {
    Plugin::parse(text).map_err(|e| format!("cannot create `{text}`: {e}; use a program with this plugin"))
}

/// Adds the columns of a cloud, with `prefix` before their names.
pub fn put_cloud(file: &mut Tensors, prefix: &str, cloud: &GaussianCloud) {
    for (name, width, values) in cloud.columns() {
        file.put(format!("{prefix}{name}"), vec![cloud.len(), width], values.to_vec());
    }
}

/// Takes a cloud of `n` Gaussians with the extra columns `extra` (name and width) from the tensors under `prefix`.
/// Checks centres and extra columns before allocating memory, because `n` may be any number.
///
/// # Errors
/// A tensor is missing, has another shape or type, or holds a number that is not finite; the message names it.
pub fn take_cloud(
    file: &mut Tensors,
    prefix: &str,
    n: usize,
    extra: &[(impl AsRef<str>, usize)],
) -> Result<GaussianCloud, String> {
    file.check_shape(&format!("{prefix}{}", COLUMN_NAMES[0]), &[n, 3])?;
    let extra_column = |name: &str, width: usize| -> Result<ExtraColumn, String> {
        file.check_shape(&format!("{prefix}{name}"), &[n, width])?;
        Ok(ExtraColumn { name: name.into(), width, values: vec![0.0; n * width] })
    };
    let extra = extra.iter().map(|(name, width)| extra_column(name.as_ref(), *width)).collect::<Result<_, _>>()?;
    let mut cloud = GaussianCloud { extra, ..GaussianCloud::zeros(n) };
    for (name, width, values) in cloud.columns_mut() {
        values.copy_from_slice(&file.take(&format!("{prefix}{name}"), &[n, width])?);
    }
    Ok(cloud)
}

/// Adds the tensors of the network with `prefix` before their names.
///
/// # Panics
/// If `weights` do not have the length of the layout of `stages`.
pub fn put_weights(file: &mut Tensors, prefix: &str, weights: &[Real], stages: &Stages) {
    let mut remaining = weights;
    for spec in stages.layout().weights {
        let (weights, tail) = remaining.split_at(spec.len());
        file.put(format!("{prefix}{}", spec.name), spec.shape.clone(), weights.to_vec());
        remaining = tail;
    }
    assert!(remaining.is_empty(), "the network is as long as its layout");
}

/// Takes the tensors of the network under `prefix`, and returns them as a flat weight vector.
///
/// # Errors
/// A tensor is missing, has another shape or type, or holds a number that is not finite; the message names it.
pub fn take_weights(file: &mut Tensors, prefix: &str, stages: &Stages) -> Result<Vec<Real>, String> {
    let mut weights = Vec::new();
    for spec in stages.layout().weights {
        weights.extend(file.take(&format!("{prefix}{}", spec.name), &spec.shape)?);
    }
    Ok(weights)
}
