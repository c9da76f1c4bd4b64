//! Observations of unknown transmitters: NumPy arrays, tables of powers, images.

use pwrfgs_core::npy::Header;
use pwrfgs_core::{Dataset, Error, Image, Number, Real, Result, files, gain_fault, rows_of};
use pwrfgs_data::{is_linear, power_fault, read_image, read_powers, real_channels_fault};
use pwrfgs_experiment::{check_observed, reject_findings};
use pwrfgs_localise::FingerprintFeatures;
use std::path::Path;

/// Observations of unknown transmitters, in a file or an array.
#[derive(Clone, Copy, Debug)]
pub struct UnlocatedObservations<'a> {
    /// The file, or the name of the array in messages.
    pub path: &'a Path,
    /// Features of the observations of the model.
    pub features: &'a FingerprintFeatures,
    /// Known data of the model.
    pub data: &'a Dataset,
    /// Names of accepted findings.
    pub accepted: &'a [String],
}

impl UnlocatedObservations<'_> {
    /// Computes the features of the observations in an array, after the checks of a file: powers `[B, receivers]` in dBm, NaN
    /// if unknown; spectra `[B, height, width]`, or channels as rows of real and imaginary parts, at one receiver.
    ///
    /// # Errors
    /// An invalid value, with its row; spectra or channels at several receivers; powers far from those of the known data, unless
    /// the finding is accepted.
    pub fn array_features(&self, values: &[Real]) -> Result<Vec<Vec<f32>>> {
        if self.features.task().is_scalar { self.power_features(values) } else { self.image_features(values) }
    }

    /// Reads the features `[receivers, count]` of each transmitter in the file; NaN for unknown values.
    ///
    /// # Errors
    /// A file of another kind or shape than the observations of the model, or as [`Self::array_features`].
    pub fn read_features(&self) -> Result<Vec<Vec<f32>>> {
        let (path, task) = (self.path, self.features.task());
        match path.extension().and_then(|e| e.to_str()).map(str::to_lowercase).as_deref() {
            Some("npy") if task.is_scalar => {
                self.power_features(&read_real_array(path, &[self.data.scene.receivers.len()], false)?)
            }
            Some("npy") if task.is_complex => self.image_features(&self.read_channels()?),
            Some("npy") => {
                let (width, height) = self.features.size();
                self.image_features(&read_real_array(path, &[height, width], true)?)
            }
            Some("csv") if task.is_scalar => {
                let names: Vec<String> =
                    self.data.scene.receivers.iter().map(|receiver| receiver.name.clone()).collect();
                self.power_features(&read_powers(path, &names)?.concat())
            }
            Some("png") if task.has_pixels => self.image_features(&self.read_image_pixels()?),
            _ => {
                let expected = match (task.has_pixels, task.is_scalar) {
                    (true, _) => "a PNG image, or an array [B, height, width] (.npy)",
                    (_, true) => "a CSV table with a column per receiver, or an array [B, receivers] (.npy)",
                    _ => "an array [B, antennas, subcarriers] of complex numbers (.npy)",
                };
                Err(self.error(format!("is no file of {}; give {expected}", task.plural)))
            }
        }
    }

    /// Reads a complex array `[B, A, F]` as numbers `[B, 2 A, F]`: rows of real and imaginary parts.
    fn read_channels(&self) -> Result<Vec<Real>> {
        let (width, height) = self.features.size();
        let (header, bytes) = read_array_file(self.path)?;
        check_shape(self.path, &header, &[height / 2, width])?;
        let number = match header.descr.as_str() {
            "<c8" => Number::F32,
            "<c16" => Number::F64,
            other if other.contains('c') => {
                let problem = format!("holds numbers of type `{other}`; channels are complex64: save a.astype('<c8')");
                return Err(self.error(problem));
            }
            _ => return Err(self.error(real_channels_fault(&header.shape))),
        };
        let bytes = array_body(self.path, &header, &bytes, header.bytes(number).and_then(|half| half.checked_mul(2)))?;
        let mut parts: Vec<Real> = Vec::with_capacity(bytes.len() / number.bytes());
        number.for_each_value(bytes, |v| parts.push(v as Real));
        let gains = parts.as_chunks::<2>().0;
        Ok(gains.chunks_exact((height / 2 * width).max(1)).flat_map(|channel| rows_of(channel, width)).collect())
    }

    /// Reads the pixels of an image; an error if its size is not that of the spectra of the model.
    fn read_image_pixels(&self) -> Result<Vec<Real>> {
        let Image { width, height, pixels } = read_image(self.path)?;
        let size = self.features.size();
        if (width, height) != size {
            return Err(self.error(format!(
                "has {width} x {height} pixels; the model observes {} x {} (width x height)",
                size.0, size.1
            )));
        }
        Ok(pixels)
    }

    /// Computes the features of each spectrum or channel at the only receiver, from the concatenated `values`. Returns an error
    /// for several receivers, for no or incomplete observations, and for values that are not finite or out of range.
    fn image_features(&self, values: &[Real]) -> Result<Vec<Vec<f32>>> {
        if self.data.scene.receivers.len() != 1 {
            let (plural, receivers) = (self.features.task().plural, self.data.scene.receivers.len());
            let advice = "localise samples of its data set instead (leave out the file)";
            let problem = format!("an array has the {plural} of one receiver, the model has {receivers}; {advice}");
            return Err(self.error(problem));
        }
        let (width, height) = self.features.size();
        let numbers = width * height;
        if !values.len().is_multiple_of(numbers) || values.is_empty() {
            return Err(self.error("is truncated or damaged; copy it again".into()));
        }
        if let Some(at) = values.iter().position(|v| !v.is_finite()) {
            let row = at / numbers + 1;
            return Err(self.error(format!("observation {row} has a value that is not finite; leave it out")));
        }
        let has_pixels = self.features.task().has_pixels;
        // In words, the limits of `is_far`.
        let range = if has_pixels { "linear, from 0 to 1" } else { "up to 1e9" };
        let is_far = |v: &Real| if has_pixels { !is_linear(*v as f64) } else { gain_fault([*v as f64, 0.0]).is_some() };
        if let Some(at) = values.iter().position(is_far) {
            let row = at / numbers + 1;
            return Err(self.error(format!("observation {row} has the value {:e}; give numbers {range}", values[at])));
        }
        let features = |pixels: &[Real]| self.features.extract(&Image { width, height, pixels: pixels.to_vec() });
        Ok(values.chunks_exact(numbers).map(features).collect())
    }

    /// Returns the powers `[B, receivers]`, dBm, as features; NaN for unknown ones. A row without any known power or with an
    /// invalid one is an error, and so are powers far from those of the known data, unless the finding is accepted.
    fn power_features(&self, values: &[Real]) -> Result<Vec<Vec<f32>>> {
        let rows = values.chunks_exact(self.data.scene.receivers.len().max(1));
        let rows: Vec<Vec<f32>> = rows.map(|row| row.iter().map(|v| *v as f32).collect()).collect();
        for (row, number) in rows.iter().zip(1..) {
            if row.iter().all(|v| v.is_nan()) {
                return Err(self.error(format!("row {number}: no receiver has a power; give at least one")));
            }
            // Not NaN, which is unknown; -100 is a level here, not a missing link.
            let is_stated = |dbm: &&f32| !dbm.is_nan() && **dbm != -100.0;
            if let Some(fault) = row.iter().filter(is_stated).find_map(|dbm| power_fault(f64::from(*dbm))) {
                let advice = "or leave the value out (NaN or an empty cell)";
                return Err(self.error(format!("row {number}: a power {fault}, {advice}")));
            }
        }
        let finding: Vec<_> = check_observed(self.data, values).into_iter().collect();
        reject_findings(&finding, self.accepted).map_err(|refused| self.error(refused.to_string()))?;
        Ok(rows)
    }

    /// Creates an error at the file.
    fn error(&self, problem: String) -> Error {
        Error::input(self.path, problem)
    }
}

/// Reads the numbers of a real array `[B, ..inner]`, divided by the full scale of their type. Only pixels may be
/// integers.
fn read_real_array(path: &Path, inner: &[usize], has_pixels: bool) -> Result<Vec<Real>> {
    let (header, bytes) = read_array_file(path)?;
    let Some(number) = header.number().filter(|number| has_pixels || number.is_float()) else {
        let problem = format!("holds numbers of type `{}`; save real numbers, such as a.astype('<f4')", header.descr);
        return Err(Error::input(path, problem));
    };
    check_shape(path, &header, inner)?;
    let bytes = array_body(path, &header, &bytes, header.bytes(number))?;
    let mut values = Vec::with_capacity(bytes.len() / number.bytes());
    number.for_each_value(bytes, |v| values.push((v / number.full_scale()) as Real));
    Ok(values)
}

/// Reads the header of an array file, and all its bytes.
fn read_array_file(path: &Path) -> Result<(Header, Vec<u8>)> {
    let bytes = files::read(path).map_err(|e| Error::read(path, e))?;
    Ok((Header::read(path, &mut bytes.as_slice())?, bytes))
}

/// Returns the bytes after the header of an array file; an error if they are not as many as `expected`.
fn array_body<'b>(path: &Path, header: &Header, bytes: &'b [u8], expected: Option<u64>) -> Result<&'b [u8]> {
    let body = bytes.get(header.offset as usize..).unwrap_or_default();
    if expected == Some(body.len() as u64) {
        return Ok(body);
    }
    let shape = header.shape_text();
    Err(Error::input(path, format!("has shape {shape}, but not its length; it is truncated or damaged: copy it again")))
}

/// Rejects arrays of another shape than `[B, ..inner]`.
fn check_shape(path: &Path, header: &Header, inner: &[usize]) -> Result<()> {
    let expected = inner.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
    if header.shape.len() != inner.len() + 1 || header.shape[1..] != *inner || header.fortran {
        let order = if header.fortran { " in Fortran order" } else { "" };
        let shape = header.shape_text() + order;
        return Err(Error::input(path, format!("has shape {shape}; the model observes [B, {expected}] in C order")));
    }
    if header.shape[0] == 0 {
        return Err(Error::input(path, "holds no observation; give one row or more"));
    }
    Ok(())
}
