//! `import`: converts positions and spectra of other programs to a folder that [`Arrays`](crate::Arrays) reads.
//!
//! Spectra are converted one at a time, so memory use does not depend on their number. 8-bit and 16-bit values are
//! kept unless they are scaled; all others are stored as floats of 32 bits. Implausible input is an error with the next step.

mod channels;
mod source;
#[cfg(test)]
mod tests;

pub use channels::ChannelImport;

use crate::checks::{ROUNDING, shape_fault};
use crate::colormap::Colormap;
use crate::folder::gateway_yaml;
use crate::npy_header;
use pwrfgs_core::files::NewFolder;
use pwrfgs_core::{Elevation, Error, Number, Pose, Progress, Result};
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

/// Input files and settings of an import.
#[derive(Clone, Debug)]
pub struct Import {
    /// Spectra: `.npy`, `.npz` (`FILE.npz:NAME` selects an array) or a folder of PNG images 00001.png ..
    pub spectra: PathBuf,
    /// Transmitter positions: `.npy`, `.npz` or `.csv` with columns x, y, z; `None`: the array `tx` in the `.npz` of
    /// the spectra.
    pub tx: Option<PathBuf>,
    /// Receiver pose.
    pub receiver: Pose,
    /// Elevations of the upper edge of the top row and the lower edge of the bottom row, degrees; `None`: 0 and 90.
    pub elevation: Option<Elevation>,
    /// Name of the data set.
    pub name: String,
    /// Factor applied to every value, so that all are between 0 and 1; `None`: 1.
    pub scale: Option<f64>,
    /// Colour map of the images of a folder; values are then those of its colours.
    pub colormap: Option<Colormap>,
    /// Whether the spectra are simulated, not measured.
    pub simulated: bool,
}

/// Summary of a finished import.
#[derive(Clone, Debug, PartialEq)]
pub struct Imported {
    /// Numbers of spectra, rows and columns: M, H, W.
    pub shape: [usize; 3],
    /// Storage type of a pixel.
    pub number: Number,
    /// Smallest and largest value after scaling.
    pub range: (f64, f64),
}

impl Import {
    /// Converts the input files to the new folder `out`, complete or not at all. `progress` counts spectra.
    ///
    /// # Errors
    /// Invalid input files, a folder `out` that is not empty, or a failed write.
    pub fn write(&self, out: &Path, progress: Progress<'_>) -> Result<Imported> {
        if let Some((field, fault)) = self.receiver.fault() {
            return Err(Error::Config(format!("{field} of the receiver: {fault}")));
        }
        if let Some(fault) = self.elevation.and_then(Elevation::fault) {
            return Err(Error::Config(format!("--elevation: {fault}")));
        }
        if let Some(scale) = self.scale.filter(|s| !(s.is_finite() && *s > 0.0)) {
            return Err(Error::Config(format!("--scale {scale}: give a finite number above 0")));
        }
        let txs = source::read_positions(self.tx.as_deref().unwrap_or(&self.spectra), self.tx.is_none())?;
        let folder = NewFolder::begin(out)?;
        let mut sink = Sink::new(self, folder.path().join("spectra.npy"), progress);
        source::read_spectra(&self.spectra, txs.len(), self.colormap, &mut sink)?;
        let imported = sink.finish(&self.spectra)?;
        let numbers = txs.as_flattened().iter().flat_map(|v| v.to_le_bytes());
        folder
            .put("tx.npy", npy_header(Number::F64, &[txs.len(), 3]).into_iter().chain(numbers).collect::<Vec<u8>>())?;
        let angles = |e: Elevation| format!("elevation: [{:?}, {:?}]\n", e.first, e.last);
        let elevation = self.elevation.map_or_else(String::new, angles);
        folder.put("gateway_info.yml", gateway_yaml(&self.name, &self.receiver) + &elevation)?;
        let manifest = serde_json::json!({
            "program": concat!("pwrfgs ", env!("CARGO_PKG_VERSION")),
            "simulated": self.simulated,
            "name": self.name,
            "title": self.name,
            "scale": self.scale,
            "colormap": self.colormap,
        });
        folder.put("manifest.json", format!("{manifest:#}\n"))?;
        folder.publish()?;
        Ok(imported)
    }
}

/// Writer that takes one spectrum at a time.
struct Sink<'a> {
    scale: Option<f64>,
    elevation: Option<Elevation>,
    path: PathBuf,
    progress: Progress<'a>,
    /// Output file; `None` before [`Self::begin`].
    file: Option<BufWriter<File>>,
    shape: [usize; 3],
    /// Input type and output type.
    numbers: (Number, Number),
    /// Number of spectra so far.
    done: usize,
    range: Range,
    /// Pixels of one spectrum as floats: a work buffer.
    bytes: Vec<u8>,
}

impl<'a> Sink<'a> {
    /// Creates the writer of the new file `path`, which [`Self::begin`] creates.
    fn new(&Import { scale, elevation, .. }: &Import, path: PathBuf, progress: Progress<'a>) -> Self {
        let numbers = (Number::U8, Number::U8); // until `begin`
        let (range, bytes) = (Range::default(), Vec::new());
        Self { scale, elevation, path, progress, file: None, shape: [0; 3], numbers, done: 0, range, bytes }
    }

    /// Creates the file before the first spectrum, which comes from `from` as values of type `number`. Returns an error if the
    /// shape `[M,H,W]` does not fit the elevations, or if the file cannot be created.
    fn begin(&mut self, from: &Path, shape: [usize; 3], number: Number) -> Result<()> {
        let (elevation, advice) = (self.elevation.unwrap_or(Elevation::UPPER), "--elevation -90,90 for a full sphere");
        if let Some(fault) = shape_fault(elevation, self.elevation.is_some(), (shape[2], shape[1]), advice) {
            return Err(Error::input(from, fault));
        }
        let stored = if number.is_float() || self.scale.is_some() { Number::F32 } else { number };
        (self.shape, self.numbers) = (shape, (number, stored));
        let file = File::create(&self.path).and_then(|file| {
            let mut file = BufWriter::with_capacity(1 << 20, file);
            file.write_all(&npy_header(stored, &shape)).map(|()| file)
        });
        self.file = Some(file.map_err(|e| Error::write(&self.path, e))?);
        Ok(())
    }

    /// Converts and writes the pixels of the next spectrum, and extends the range of values. Returns an error if the write
    /// failed.
    fn add_spectrum(&mut self, bytes: &[u8]) -> Result<()> {
        let (number, stored) = self.numbers;
        let factor = self.scale.unwrap_or(1.0) / number.full_scale();
        let (range, width, i) = (&mut self.range, self.shape[2], self.done);
        let mut pixel = 0;
        self.bytes.clear();
        number.for_each_value(bytes, |v| {
            let value = v * factor;
            range.extend_to([i, pixel / width, pixel % width], value);
            pixel += 1;
            if stored == Number::F32 {
                self.bytes.extend((value as f32).to_le_bytes());
            }
        });
        // Skip writing if the final check of the largest value will fail.
        let written = if self.range.is_linear() {
            let bytes = if stored == number && stored != Number::F32 { bytes } else { &self.bytes };
            self.file.as_mut().map_or(Ok(()), |file| file.write_all(bytes))
        } else {
            Ok(())
        };
        written.map_err(|e| Error::write(&self.path, e))?;
        self.done += 1;
        (self.progress)(self.done, self.shape[0]);
        Ok(())
    }

    /// Flushes the file and returns the summary; `from` is the input. Returns an error if the range of values is invalid, or
    /// if the write failed.
    fn finish(self, from: &Path) -> Result<Imported> {
        self.range.check(from, self.scale)?;
        let file = self.file.map(|mut file| file.flush().and_then(|()| file.get_ref().sync_all()));
        file.transpose().map_err(|e| Error::write(&self.path, e))?;
        Ok(Imported { shape: self.shape, number: self.numbers.1, range: self.range.ends() })
    }
}

/// Largest values below this are implausible: quality metrics assume 1 in the strongest direction.
const FAINT: f64 = 0.01;

/// Smaller values are decibels, not linear values with an offset.
const DECIBELS: f64 = -3.0;

/// Index of a value (spectrum, row, column), and the value.
type Element = ([usize; 3], f64);

/// Range of the values so far.
#[derive(Debug, Default)]
pub(super) struct Range {
    /// Smallest and largest value; `None` without values.
    extremes: Option<[Element; 2]>,
    /// First value that is not finite.
    not_finite: Option<Element>,
}

impl Range {
    /// Extends the range to `value` at `index`: spectrum, row, column.
    pub(super) fn extend_to(&mut self, index: [usize; 3], value: f64) {
        let element = (index, value);
        if !value.is_finite() {
            self.not_finite.get_or_insert(element);
        }
        let [low, high] = self.extremes.get_or_insert([element; 2]);
        if value < low.1 {
            *low = element;
        }
        if value > high.1 {
            *high = element;
        }
    }

    /// Returns the smallest and largest value; NaN without values.
    pub(super) fn ends(&self) -> (f64, f64) {
        self.extremes.map_or((f64::NAN, f64::NAN), |[(_, low), (_, high)]| (low, high))
    }

    /// Returns whether all values are between 0 and 1, up to rounding; false without values.
    pub(super) fn is_linear(&self) -> bool {
        let (low, high) = self.ends();
        low >= -ROUNDING && high <= 1.0 + ROUNDING
    }

    /// Returns an error for values of `path` that are not finite, outside 0 to 1 after multiplication by `scale`, all zero, or
    /// implausibly small. Called after the last spectrum, so that the error for a damaged file comes first.
    pub(super) fn check(&self, path: &Path, scale: Option<f64>) -> Result<()> {
        let refuse = |problem: String| Err(Error::input(path, problem));
        if let Some((index, value)) = self.not_finite {
            let advice = "a spectrum has a finite value in every direction; leave out what was not measured";
            return refuse(format!("{} is {value}; {advice}", element_name(index)));
        }
        let Some([(low_index, low), (high_index, high)]) = self.extremes else { return Ok(()) };
        let suited = format!("--scale {}", scale.unwrap_or(1.0) / high);
        if low < -ROUNDING {
            let problem = format!("values are from {low} ({}) to {high}", element_name(low_index));
            return refuse(if low < DECIBELS {
                format!(
                    "{problem}, as decibels are; spectra are linear, 0 to 1: save 10 ** ((s - s.max()) / 20), the \
                     amplitude, or / 10, the power"
                )
            } else {
                format!("{problem}; spectra are amplitudes or powers from 0 to 1: save numpy.abs(s) or (s - s.min())")
            });
        }
        if high > 1.0 + ROUNDING {
            let problem =
                format!("the largest value is {high} ({}) and spectra are from 0 to 1", element_name(high_index));
            return refuse(format!("{problem}; give {suited}"));
        }
        if high <= 0.0 {
            return refuse("every value is 0; is this the right file?".into());
        }
        if high < f64::from(f32::MIN_POSITIVE) {
            let limit = f32::MIN_POSITIVE;
            let problem =
                format!("the largest value becomes {high:e}, below the smallest number of 32 bits, {limit:e}");
            return refuse(format!("{problem}; give {suited}"));
        }
        if high < FAINT && scale.is_none() {
            let problem = format!("the largest value is {high}, and 1 stands for the strongest direction");
            return refuse(format!("{problem}; give {suited}, or --scale 1 where this is meant"));
        }
        Ok(())
    }
}

/// Returns the index of a value in Python notation.
fn element_name([m, y, x]: [usize; 3]) -> String {
    format!("spectra[{m}, {y}, {x}]")
}
