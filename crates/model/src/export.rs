//! Exports of a trained model for other programs: an NPZ file for `numpy.load`, and a PLY file in the layout of 3D
//! Gaussian splatting. `docs/model-format.md` describes the fields.

use crate::{Ensemble, Model};
use pwrfgs_core::colour::sequential;
use pwrfgs_core::npy::npy_header_as;
use pwrfgs_core::{Activated, Error, Origin, Pose, Primitives, Real, Result};
use std::io::{self, Cursor, Write as _};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// Returns the NPZ file of `model`: Gaussians, networks, receivers and plane, but not training positions, residuals and
/// calibration. If `tx` (metres, world frame) is given, it also contains the Gaussians for a transmitter at that position.
/// Arrays of several models are called `members.0.means` and so on. Positions are in the world frame. Centres and `tx` are
/// in double precision only if the model has an origin. Equal models give equal bytes.
///
/// # Errors
/// An array of more than 4 GiB.
pub fn npz(model: &Ensemble, tx: Option<[f64; 3]>) -> Result<Vec<u8>> {
    let mut file = Npz { archive: ZipWriter::new(Cursor::new(Vec::new())), prefix: String::new() };
    let whole = file.add_members(model, tx).and_then(|()| Ok(file.archive.finish()?.into_inner()));
    whole.map_err(|why| Error::Config(format!("cannot export this model as NPZ: {why}")))
}

/// NPZ archive in progress.
struct Npz {
    archive: ZipWriter<Cursor<Vec<u8>>>,
    /// Prefix of the array names.
    prefix: String,
}

impl Npz {
    /// Adds one model, or several with a prefix each.
    fn add_members(&mut self, ensemble: &Ensemble, tx: Option<[f64; 3]>) -> io::Result<()> {
        for (k, model) in ensemble.members().iter().enumerate() {
            if ensemble.members().len() > 1 {
                self.prefix = format!("members.{k}.");
            }
            self.add_model(model)?;
            tx.map_or(Ok(()), |tx| self.add_transmitter(model, tx))?;
        }
        Ok(())
    }

    /// Adds Gaussians, network, pose and plane of a model and, unless it is of spectra at one receiver, its links.
    fn add_model(&mut self, model: &Model) -> io::Result<()> {
        let n = model.cloud.len();
        let origin = model.stages.origin;
        for (name, width, values) in model.cloud.columns() {
            let shape = if width == 1 { vec![n] } else { vec![n, width] };
            if name == "means" && !origin.is_zero() {
                let centres: Vec<[f64; 3]> = model.cloud.means.iter().map(|mean| origin.world(*mean)).collect();
                self.put(name, &shape, encode_doubles(centres.as_flattened()))?;
                self.put("origin", &[3], encode_doubles(&origin.0))?;
            } else {
                self.put(name, &shape, encode_reals(values))?;
            }
        }
        let mut remaining = model.weights.as_slice();
        for spec in model.stages.layout().weights {
            let (weights, tail) = remaining.split_at(spec.len());
            self.put(&format!("network.{}", spec.name), &spec.shape, encode_reals(weights))?;
            remaining = tail;
        }
        for (spec, values) in model.stages.layout().constants {
            self.put(&format!("constants.{}", spec.name), &spec.shape, encode_reals(&values))?;
        }
        let (pose, plane) = (&model.stages.world_pose(), &model.stages.plane);
        self.put("pose.position", &[3], encode_doubles(&pose.position))?;
        self.put("pose.orientation", &[4], encode_doubles(&pose.orientation))?;
        if !model.stages.task.has_pixels || model.stages.receivers.len() > 1 {
            self.add_links(model)?;
        }
        self.put("plane.size", &[2], encode_counts(&[plane.width, plane.height]))?;
        self.put("plane.wraps", &[], ("|b1", vec![u8::from(plane.wraps)]))?;
        let Some((azimuth, elevation)) = plane.angles else { return Ok(()) };
        self.put("plane.azimuth_deg", &[2], encode_doubles(&[azimuth.first, azimuth.step]))?;
        self.put("plane.elevation_deg", &[2], encode_doubles(&[elevation.first, elevation.step]))
    }

    /// Adds the links: observations and receivers. Names are stored as bytes of UTF-8, since arrays cannot hold text of
    /// variable length.
    fn add_links(&mut self, model: &Model) -> io::Result<()> {
        let setup = &model.stages.setup;
        let text =
            |file: &mut Self, name: &str, text: &str| file.put(name, &[text.len()], ("|u1", text.as_bytes().to_vec()));
        text(self, "kind", setup.task.name)?;
        let names = setup.receivers.iter().map(|receiver| receiver.name.as_str()).collect::<Vec<_>>().join("\n");
        text(self, "receivers.names", &names)?;
        let poses: Vec<Pose> = setup.receivers.iter().map(|receiver| setup.origin.world_pose(receiver.pose)).collect();
        let [positions, orientations]: [Vec<f64>; 2] = [
            poses.iter().flat_map(|pose| pose.position).collect(),
            poses.iter().flat_map(|pose| pose.orientation).collect(),
        ];
        self.put("receivers.positions", &[poses.len(), 3], encode_doubles(&positions))?;
        self.put("receivers.orientations", &[poses.len(), 4], encode_doubles(&orientations))?;
        let counts: Vec<usize> = setup.receivers.iter().map(|receiver| receiver.antennas.len()).collect();
        let antennas: Vec<[f64; 3]> =
            setup.receivers.iter().flat_map(|receiver| receiver.antennas.iter().copied()).collect();
        self.put("receivers.antenna_counts", &[counts.len()], encode_counts(&counts))?;
        self.put("receivers.antennas", &[antennas.len(), 3], encode_doubles(antennas.as_flattened()))?;
        if setup.frequencies_hz.is_empty() {
            return Ok(());
        }
        self.put("frequencies_hz", &[setup.frequencies_hz.len()], encode_doubles(&setup.frequencies_hz))
    }

    /// Adds the Gaussians for a transmitter at `tx` (metres, world frame).
    fn add_transmitter(&mut self, model: &Model, tx: [f64; 3]) -> io::Result<()> {
        let Activated { primitives: p, signals, .. } = model.gaussians(Some(tx));
        let n = p.len();
        let is_local = model.stages.origin.is_zero();
        let position = if is_local { encode_reals(&tx.map(|v| v as Real)) } else { encode_doubles(&tx) };
        self.put("tx.position", &[3], position)?;
        self.put("tx.scales", &[n, 3], encode_reals(p.scales.as_flattened()))?;
        self.put("tx.quats", &[n, 4], encode_reals(p.quats.as_flattened()))?;
        self.put("tx.opacities", &[n], encode_reals(&p.opacities))?;
        self.put("tx.signals", &[n, signals.len() / n.max(1)], encode_reals(&signals))
    }

    /// Adds an array, given the NumPy name of its type and its bytes.
    fn put(&mut self, name: &str, shape: &[usize], (descr, bytes): (&str, Vec<u8>)) -> io::Result<()> {
        // Stored without compression, as `numpy.savez` does, and with a fixed date (the earliest of the format), so
        // that bytes are reproducible.
        let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
        let name = format!("{}{name}", self.prefix);
        self.archive.start_file(format!("{name}.npy"), options)?;
        self.archive.write_all(&npy_header_as(descr, shape))?;
        self.archive.write_all(&bytes)
    }
}

/// Returns the NumPy name of the type of [`Real`], and the bytes of `values`.
fn encode_reals(values: &[Real]) -> (&'static str, Vec<u8>) {
    let descr = if size_of::<Real>() == 8 { "<f8" } else { "<f4" };
    (descr, values.iter().flat_map(|v| v.to_le_bytes()).collect())
}

/// Returns the NumPy name of double precision, and the bytes of `values`.
fn encode_doubles(values: &[f64]) -> (&'static str, Vec<u8>) {
    ("<f8", values.iter().flat_map(|v| v.to_le_bytes()).collect())
}

/// Returns the NumPy name of 64-bit integers without sign, and the bytes of `values`.
fn encode_counts(values: &[usize]) -> (&'static str, Vec<u8>) {
    ("<u8", values.iter().flat_map(|v| (*v as u64).to_le_bytes()).collect())
}

/// Properties in the order that viewers expect, all of them `float`. Normals are part of the layout, and 0.
const PROPERTIES: [&str; 17] = [
    "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0",
    "rot_1", "rot_2", "rot_3",
];
/// Constant spherical harmonic Y₀₀: a viewer shows 0.5 + Y₀₀ · `f_dc`.
const SH_C0: f64 = 0.282_094_791_773_878_14;

/// Returns the PLY file of `model` for a transmitter at `tx` (metres, world frame), or of its base parameters without `tx`.
///
/// The Gaussians of an ensemble follow member by member; their property `member` is the index of the member, from 0.
/// Centres are relative to the origin of the model, which a comment of the header gives if it is not zero.
///
/// The colour shows the strength of the signal of a Gaussian: the pixel value that it would give alone if it were
/// opaque, from dark violet at 0 to yellow at 1, the full scale of the spectra. It is mid-grey if signals exist only
/// for a given transmitter.
///
/// # Errors
/// A value that is not finite.
pub fn ply(model: &Ensemble, tx: Option<[f64; 3]>) -> Result<Vec<u8>> {
    let several = model.members().len() > 1;
    let mut out = ply_header(model.gaussians(), model.members()[0].stages.origin, several).into_bytes();
    for (k, member) in model.members().iter().enumerate() {
        append_rows(&mut out, member, tx, several.then_some(k as f32))?;
    }
    Ok(out)
}

/// Appends the rows of one model, each with the index of the `member` if it is given. Returns an error for a value that is not
/// finite.
fn append_rows(out: &mut Vec<u8>, model: &Model, tx: Option<[f64; 3]>, member: Option<f32>) -> Result<()> {
    let Activated { primitives, strengths, .. } = model.gaussians(tx);
    for i in 0..primitives.len() {
        let colour = strengths.as_ref().map_or([0.0; 3], |strengths| harmonic_colour(strengths[i]));
        let row = ply_row(&primitives, i, model.cloud.opacity_logits[i], colour);
        if let Some(k) = row.iter().position(|v| !v.is_finite()) {
            return Err(Error::Config(format!(
                "`{}` of Gaussian {i} is not finite: training diverged, or the transmitter is far from training positions",
                PROPERTIES[k]
            )));
        }
        out.extend(row.into_iter().chain(member).flat_map(f32::to_le_bytes));
    }
    Ok(())
}

/// Returns the header of a PLY file of `n` Gaussians; `several` adds the property `member`. Viewers of splats use single
/// precision, so centres are close to zero and a comment gives their origin.
fn ply_header(n: usize, origin: Origin, several: bool) -> String {
    let [x, y, z] = origin.0;
    let comment = if origin.is_zero() { String::new() } else { format!("comment origin {x} {y} {z}\n") };
    let properties = PROPERTIES.into_iter().chain(several.then_some("member"));
    let properties = properties.map(|name| format!("property float {name}\n")).collect::<Vec<_>>().concat();
    format!("ply\nformat binary_little_endian 1.0\n{comment}element vertex {n}\n{properties}end_header\n")
}

/// Returns the colour of a strength as coefficients `f_dc` of spherical harmonics.
fn harmonic_colour(strength: Real) -> [f32; 3] {
    sequential(strength as f64).map(|c| ((f64::from(c) / 255.0 - 0.5) / SH_C0) as f32)
}

/// Returns the properties of Gaussian `i`, in the order of [`PROPERTIES`].
fn ply_row(p: &Primitives, i: usize, opacity_logit: Real, colour: [f32; 3]) -> [f32; PROPERTIES.len()] {
    // The sign of a scale does not change the ellipsoid; the released calibration may give negative scales.
    let log_scales = p.scales[i].map(|s| s.abs().max(Real::MIN_POSITIVE).ln());
    let values = [&p.means[i][..], &[0.0; 3], &colour.map(Real::from), &[opacity_logit], &log_scales, &p.quats[i]];
    let mut row = [0.0; PROPERTIES.len()];
    row.iter_mut().zip(values.concat()).for_each(|(to, from)| *to = from as f32);
    row
}
