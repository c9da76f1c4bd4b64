//! The Gaussians as a PLY file in the layout of 3D Gaussian splatting, which viewers of splats open.

use crate::{Ensemble, Model};
use pwrfgs_core::colour::sequential;
use pwrfgs_core::{Activated, Error, Origin, Primitives, Real, Result};

/// Properties in the order in which viewers expect them, all of them `float`. Normals are there for the layout, and 0.
const PROPERTIES: [&str; 17] = [
    "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0",
    "rot_1", "rot_2", "rot_3",
];
/// Y₀₀, the constant spherical harmonic: a viewer shows 0.5 + Y₀₀ · `f_dc`.
const SH_C0: f64 = 0.282_094_791_773_878_14;

/// The PLY file of `model`, one or several, as it is for a transmitter at `tx` (metres, world frame), or of its base
/// parameters.
///
/// The Gaussians of an ensemble stand one member after the other; `member` says whose each is, counted from 0.
///
/// Centres count from the model's origin, which a comment of the header names where it is not zero.
///
/// Colour tells how strong the signal of a Gaussian is: the pixel that it would give alone, were it opaque, from dark
/// violet at 0 to yellow at 1, the full scale of the spectra. Mid-grey where the signals exist for a transmitter only.
///
/// # Errors
/// A number that is not finite.
pub fn ply(model: &Ensemble, tx: Option<[f64; 3]>) -> Result<Vec<u8>> {
    let several = model.members().len() > 1;
    let mut out = header(model.gaussians(), model.members()[0].stages.origin, several).into_bytes();
    for (place, member) in model.members().iter().enumerate() {
        let marked = several.then_some(place as f32);
        put_rows(&mut out, member, tx, marked)?;
    }
    Ok(out)
}

/// The rows of one model, each with the number of the member at its end where there are several.
fn put_rows(out: &mut Vec<u8>, model: &Model, tx: Option<[f64; 3]>, member: Option<f32>) -> Result<()> {
    let Activated { primitives, strengths, .. } = model.gaussians(tx);
    for i in 0..primitives.len() {
        let colour = strengths.as_ref().map_or([0.0; 3], |strengths| colour(strengths[i]));
        let row = row(&primitives, i, model.cloud.opacity_logits[i], colour);
        if let Some(k) = row.iter().position(|v| !v.is_finite()) {
            return Err(Error::Config(format!(
                "`{}` of Gaussian {i} is not finite: training went wrong, or the transmitter is far from all it was trained on",
                PROPERTIES[k]
            )));
        }
        out.extend(row.into_iter().chain(member).flat_map(f32::to_le_bytes));
    }
    Ok(())
}

/// Viewers of splats compute in single precision, so centres stay near zero: a comment says what they count from.
fn header(n: usize, origin: Origin, several: bool) -> String {
    let [x, y, z] = origin.0;
    let comment = if origin.is_zero() { String::new() } else { format!("comment origin {x} {y} {z}\n") };
    let properties = PROPERTIES.into_iter().chain(several.then_some("member"));
    let properties = properties.map(|name| format!("property float {name}\n")).collect::<Vec<_>>().concat();
    format!("ply\nformat binary_little_endian 1.0\n{comment}element vertex {n}\n{properties}end_header\n")
}

/// `f_dc` of a strength.
fn colour(strength: Real) -> [f32; 3] {
    sequential(strength as f64).map(|c| ((f64::from(c) / 255.0 - 0.5) / SH_C0) as f32)
}

fn row(p: &Primitives, i: usize, opacity_logit: Real, colour: [f32; 3]) -> [f32; PROPERTIES.len()] {
    // The sign of a scale changes no ellipsoid; the released calibration may give a negative one.
    let log_scales = p.scales[i].map(|s| s.abs().max(Real::MIN_POSITIVE).ln());
    let values = [&p.means[i][..], &[0.0; 3], &colour.map(Real::from), &[opacity_logit], &log_scales, &p.quats[i]];
    let mut row = [0.0; PROPERTIES.len()];
    row.iter_mut().zip(values.concat()).for_each(|(to, from)| *to = from as f32);
    row
}
