//! The model file: `docs/model-format.md` is its description.

use crate::tensors::Tensors;
use crate::{Calibration, Model, Readout, Stages};
use pwrfgs_core::files::{self, write_atomically};
use pwrfgs_core::plugin::{Plugin, PluginKind, ron_options};
use pwrfgs_core::{Error, GaussianCloud, ImagePlane, Pose, Real, Result};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What the file says besides numbers.
#[derive(Serialize, Deserialize)]
struct Note {
    format: String,
    version: u32,
    gaussians: usize,
    deformation: String,
    projector: String,
    rasterizer: String,
    calibration: Calibration,
    readout: Readout,
    pose: Pose,
    plane: ImagePlane,
}

const FORMAT: &str = "pwrfgs-model";
const VERSION: u32 = 1;
/// What the names of the network's tensors begin with.
const NETWORK: &str = "network.";
/// What the names of the numbers begin with that the network has from a seed.
const CONSTANTS: &str = "constants.";

/// Writes `model` to `path`, whole or not at all.
///
/// # Errors
/// [`Error::Write`].
pub fn write(path: &Path, model: &Model) -> Result<()> {
    write_atomically(path, &to_bytes(model))
}

/// The bytes of a model file; the same model gives the same bytes.
pub fn to_bytes(model: &Model) -> Vec<u8> {
    tensors(model).to_bytes()
}

/// The same with the network in 16-bit numbers: about half as long. What is read from it predicts a little differently.
///
/// # Errors
/// Where a number of the network is too large for 16 bits.
pub fn to_bytes_half(model: &Model) -> Result<Vec<u8>> {
    tensors(model).to_bytes_half(NETWORK).map_err(Error::Config)
}

fn tensors(model: &Model) -> Tensors {
    let s = &model.stages;
    let note = Note {
        format: FORMAT.into(),
        version: VERSION,
        gaussians: model.cloud.len(),
        deformation: plugin_text(&s.deformation),
        projector: plugin_text(&s.projector),
        rasterizer: plugin_text(&s.rasterizer),
        calibration: s.calibration,
        readout: s.readout,
        pose: s.pose,
        plane: s.plane.clone(),
    };
    let mut file = Tensors::new(serde_json::to_string(&note).expect("plain data"));
    put_cloud(&mut file, "gaussians.", &model.cloud);
    put_weights(&mut file, NETWORK, &model.weights, s);
    for (spec, values) in s.deformation.constants() {
        file.put(format!("{CONSTANTS}{}", spec.name), spec.shape, values);
    }
    file
}

/// Reads a model file.
///
/// # Errors
/// [`Error::Read`], or [`Error::Input`] for a file that is not a whole model or names plugins not linked here.
pub fn read(path: &Path) -> Result<Model> {
    let bytes = files::read(path).map_err(|e| Error::read(path, e))?;
    from_bytes(&bytes).map_err(|why| Error::input(path, format!("{why}; give the model.safetensors of a finished run")))
}

fn from_bytes(bytes: &[u8]) -> Result<Model, String> {
    let mut file = Tensors::from_bytes(bytes)?;
    let note: Note = serde_json::from_str(&file.note).map_err(|e| format!("not a pwrfgs model ({e})"))?;
    if note.format != FORMAT || note.version != VERSION {
        return Err(format!(
            "a `{}` of version {}, this program reads `{FORMAT}` {VERSION}",
            note.format, note.version
        ));
    }
    let stages = Stages {
        deformation: parse(&note.deformation)?,
        projector: parse(&note.projector)?,
        rasterizer: parse(&note.rasterizer)?,
        calibration: note.calibration,
        readout: note.readout,
        pose: note.pose,
        plane: note.plane,
    };
    let cloud = take_cloud(&mut file, "gaussians.", note.gaussians)?;
    let weights = take_weights(&mut file, NETWORK, &stages)?;
    check_constants(&mut file, &stages)?;
    Ok(Model { stages, cloud, weights })
}

/// Refuses a file whose constants are not those that its deformation draws here: it would predict something else.
fn check_constants(file: &mut Tensors, stages: &Stages) -> Result<(), String> {
    for (spec, drawn) in stages.deformation.constants() {
        let name = format!("{CONSTANTS}{}", spec.name);
        if file.shape(&name).is_none() {
            continue; // written when files did not hold them
        }
        let held = file.take(&name, &spec.shape)?;
        // Another C library or precision may round differently.
        if held.iter().zip(drawn).any(|(held, drawn)| (held - drawn).abs() > 1e-5 * drawn.abs().max(1.0)) {
            return Err(format!("tensor `{name}` holds other numbers than the seed in its deformation gives"));
        }
    }
    Ok(())
}

fn plugin_text<T: ?Sized + erased_serde::Serialize>(plugin: &Plugin<T>) -> String {
    let config = ron::ser::PrettyConfig::new().struct_names(true).compact_structs(true);
    ron_options().to_string_pretty(plugin, config).expect("a plugin is plain data")
}

fn parse<T: ?Sized + PluginKind>(text: &str) -> Result<Plugin<T>, String>
where
    Box<T>: for<'de> Deserialize<'de>,
{
    Plugin::parse(text).map_err(|e| format!("cannot make `{text}`: {e}; use the program that has this plugin"))
}

/// Puts the five fixed columns of a cloud under `prefix`.
pub fn put_cloud(file: &mut Tensors, prefix: &str, cloud: &GaussianCloud) {
    for (name, width, values) in cloud.columns() {
        file.put(format!("{prefix}{name}"), vec![cloud.len(), width], values.to_vec());
    }
}

/// Takes a cloud of `n` Gaussians without extra columns from under `prefix`.
///
/// # Errors
/// What is missing.
pub fn take_cloud(file: &mut Tensors, prefix: &str, n: usize) -> Result<GaussianCloud, String> {
    let mut cloud = GaussianCloud::zeros(n);
    for (name, width, values) in cloud.columns_mut() {
        values.copy_from_slice(&file.take(&format!("{prefix}{name}"), &[n, width])?);
    }
    Ok(cloud)
}

/// Puts the network's tensors under `prefix`, one a layer.
pub fn put_weights(file: &mut Tensors, prefix: &str, weights: &[Real], stages: &Stages) {
    let mut rest = weights;
    for spec in stages.deformation.layout() {
        let (own, tail) = rest.split_at(spec.len());
        file.put(format!("{prefix}{}", spec.name), spec.shape.clone(), own.to_vec());
        rest = tail;
    }
    assert!(rest.is_empty(), "the network is as long as its layout");
}

/// Takes the network's tensors from under `prefix`.
///
/// # Errors
/// What is missing.
pub fn take_weights(file: &mut Tensors, prefix: &str, stages: &Stages) -> Result<Vec<Real>, String> {
    let mut weights = Vec::new();
    for spec in stages.deformation.layout() {
        weights.extend(file.take(&format!("{prefix}{}", spec.name), &spec.shape)?);
    }
    Ok(weights)
}
