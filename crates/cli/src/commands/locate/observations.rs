//! Observations of unknown transmitters: NumPy arrays, tables of powers, images.

use pwrfgs::data::read_powers;
use pwrfgs::localise::FingerprintFeatures;
use pwrfgs_core::npy::Header;
use pwrfgs_core::{Error, Image, Number, Real, Receiver, Result, files, rows_of};
use std::path::Path;

/// Largest array that is read, bytes.
const MOST: u64 = 1 << 30;

/// Features `[receivers, count]` of every transmitter in a file; NaN for unknown values.
pub(super) fn read(path: &Path, features: &FingerprintFeatures, receivers: &[Receiver]) -> Result<Vec<Vec<f32>>> {
    let task = features.task();
    match path.extension().and_then(|e| e.to_str()).map(str::to_lowercase).as_deref() {
        Some("npy") if task.is_scalar => powers(path, &real(path, &[receivers.len()], false)?, receivers.len()),
        Some("npy") if task.is_complex => images(path, features, receivers, &complex(path, features)?),
        Some("npy") => {
            let (width, height) = features.size();
            images(path, features, receivers, &real(path, &[height, width], true)?)
        }
        Some("csv") if task.is_scalar => {
            let names: Vec<String> = receivers.iter().map(|receiver| receiver.name.clone()).collect();
            powers(path, &read_powers(path, &names)?.concat(), names.len())
        }
        Some("png") if task.has_pixels => images(path, features, receivers, &picture(path, features)?),
        _ => {
            let what = match (task.has_pixels, task.is_scalar) {
                (true, _) => "a PNG image, or an array [B, height, width] (.npy)",
                (_, true) => "a CSV table with a column per receiver, or an array [B, receivers] (.npy)",
                _ => "an array [B, antennas, subcarriers] of complex numbers (.npy)",
            };
            Err(Error::input(path, format!("is no file of {}; give {what}", task.plural)))
        }
    }
}

/// Numbers of a real array `[B, ..inner]`. Only pixels may be integers.
fn real(path: &Path, inner: &[usize], has_pixels: bool) -> Result<Vec<Real>> {
    let (header, bytes) = open(path)?;
    let Some(number) = header.number().filter(|number| has_pixels || number.is_float()) else {
        let what = format!("holds numbers of type `{}`; save real numbers, such as a.astype('<f4')", header.descr);
        return Err(Error::input(path, what));
    };
    check_shape(path, &header, inner)?;
    let bytes = numbers(path, &header, &bytes, header.bytes(number))?;
    let mut values = Vec::with_capacity(bytes.len() / number.bytes());
    number.each(bytes, |v| values.push((v / number.full_scale()) as Real));
    Ok(values)
}

/// Observations of a complex array `[B, A, F]`, as rows of real and imaginary parts.
fn complex(path: &Path, features: &FingerprintFeatures) -> Result<Vec<Real>> {
    let (width, height) = features.size();
    let (header, bytes) = open(path)?;
    check_shape(path, &header, &[height / 2, width])?;
    let number = match header.descr.as_str() {
        "<c8" => Number::F32,
        "<c16" => Number::F64,
        other => {
            let what = format!("holds numbers of type `{other}`; channels are complex: save a.astype('<c8')");
            return Err(Error::input(path, what));
        }
    };
    let bytes = numbers(path, &header, &bytes, header.bytes(number).and_then(|half| half.checked_mul(2)))?;
    let mut parts: Vec<Real> = Vec::with_capacity(bytes.len() / number.bytes());
    number.each(bytes, |v| parts.push(v as Real));
    let gains = parts.as_chunks::<2>().0;
    Ok(gains.chunks_exact((height / 2 * width).max(1)).flat_map(|one| rows_of(one, width)).collect())
}

/// Header of an array file, and all its bytes.
fn open(path: &Path) -> Result<(Header, Vec<u8>)> {
    let bytes = files::read_at_most(path, MOST).map_err(|e| Error::read(path, e))?;
    Ok((Header::read(path, &mut bytes.as_slice())?, bytes))
}

/// The numbers of an array file; an error if they are not as many bytes as `expected`.
fn numbers<'b>(path: &Path, header: &Header, bytes: &'b [u8], expected: Option<u64>) -> Result<&'b [u8]> {
    let numbers = bytes.get(header.offset as usize..).unwrap_or_default();
    if expected == Some(numbers.len() as u64) {
        return Ok(numbers);
    }
    let shape = header.shape_text();
    Err(Error::input(path, format!("has shape {shape}, but not its length; it is truncated or damaged: copy it again")))
}

/// Rejects arrays of another shape than `[B, ..inner]`.
fn check_shape(path: &Path, header: &Header, inner: &[usize]) -> Result<()> {
    let expected = inner.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
    if header.shape.len() != inner.len() + 1 || header.shape[1..] != *inner || header.fortran {
        let order = if header.fortran { " in Fortran order" } else { "" };
        let what = format!("has shape {}{order}; the model observes [B, {expected}] in C order", header.shape_text());
        return Err(Error::input(path, what));
    }
    if header.shape[0] == 0 {
        return Err(Error::input(path, "holds no observation; give one row or more"));
    }
    Ok(())
}

fn picture(path: &Path, features: &FingerprintFeatures) -> Result<Vec<Real>> {
    let bytes = files::read_at_most(path, MOST).map_err(|e| Error::read(path, e))?;
    let image = image::load_from_memory(&bytes).map_err(|e| Error::input(path, format!("is no PNG image: {e}")))?;
    let (width, height) = features.size();
    if (image.width() as usize, image.height() as usize) != (width, height) {
        let what = format!(
            "has {} x {} pixels; the model observes {width} x {height} (width x height)",
            image.width(),
            image.height()
        );
        return Err(Error::input(path, what));
    }
    Ok(image.to_luma8().into_raw().iter().map(|v| Real::from(*v) / 255.0).collect())
}

/// Features of spectra or channels at one receiver.
fn images(
    path: &Path,
    features: &FingerprintFeatures,
    receivers: &[Receiver],
    values: &[Real],
) -> Result<Vec<Vec<f32>>> {
    if receivers.len() != 1 {
        let what = format!(
            "an array has the {} of one receiver, the model has {}; localise samples of its data set instead (leave out the file)",
            features.task().plural,
            receivers.len()
        );
        return Err(Error::input(path, what));
    }
    let (width, height) = features.size();
    let numbers = width * height;
    if !values.len().is_multiple_of(numbers) || values.is_empty() {
        return Err(Error::input(path, "is truncated or damaged; copy it again"));
    }
    if let Some(at) = values.iter().position(|v| !v.is_finite()) {
        let what = format!("observation {} has a value that is not finite; leave it out", at / numbers + 1);
        return Err(Error::input(path, what));
    }
    let of = |pixels: &[Real]| features.of(&Image { width, height, pixels: pixels.to_vec() });
    Ok(values.chunks_exact(numbers).map(of).collect())
}

/// Rows of powers; NaN for receivers that are not known.
fn powers(path: &Path, values: &[Real], receivers: usize) -> Result<Vec<Vec<f32>>> {
    let rows: Vec<Vec<f32>> =
        values.chunks_exact(receivers.max(1)).map(|row| row.iter().map(|v| *v as f32).collect()).collect();
    for (k, row) in rows.iter().enumerate() {
        if row.iter().all(|v| v.is_nan()) {
            return Err(Error::input(path, format!("row {}: no receiver has a power; give at least one", k + 1)));
        }
        if let Some(v) = row.iter().find(|v| v.is_infinite()) {
            let what = format!("row {}: {v}; give dBm, or leave the value out (NaN or an empty cell)", k + 1);
            return Err(Error::input(path, what));
        }
    }
    Ok(rows)
}
