//! `Spectra`: all spectra of a data set as one array `[M,H,W]`, in memory or in an open file.

#[cfg(test)]
mod tests;

use crate::{Error, Image, Real, Result, Sampling};
use std::borrow::Cow;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

/// Storage format of a number; little endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Number {
    /// 8-bit grey: 255 is 1.
    U8,
    /// 16-bit grey: 65,535 is 1.
    U16,
    /// Single precision, 0 to 1.
    F32,
    /// Double precision, 0 to 1; pixels have single precision.
    F64,
}

impl Number {
    /// Returns the size of one number, bytes.
    pub fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 => 2,
            Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Returns the stored value that represents 1.
    pub fn full_scale(self) -> f64 {
        match self {
            Self::U8 => 255.0,
            Self::U16 => 65_535.0,
            Self::F32 | Self::F64 => 1.0,
        }
    }

    /// Returns whether it may be infinite or NaN.
    pub fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }

    /// Calls `visit` with every stored value, of which [`Self::full_scale`] represents 1.
    pub fn for_each_value(self, bytes: &[u8], mut visit: impl FnMut(f64)) {
        match self {
            Self::U8 => bytes.iter().for_each(|v| visit(f64::from(*v))),
            Self::U16 => bytes.as_chunks().0.iter().for_each(|v| visit(f64::from(u16::from_le_bytes(*v)))),
            Self::F32 => bytes.as_chunks().0.iter().for_each(|v| visit(f64::from(f32::from_le_bytes(*v)))),
            Self::F64 => bytes.as_chunks().0.iter().for_each(|v| visit(f64::from_le_bytes(*v))),
        }
    }

    /// Adds `weight` times every stored value, of which [`Self::full_scale`] represents 1, to `sum`.
    fn add_weighted(self, bytes: &[u8], weight: f64, sum: &mut [f64]) {
        match self {
            Self::U8 => add_terms(bytes, sum, |v| weight * f64::from(v)),
            Self::U16 => add_terms(bytes.as_chunks().0, sum, |v| weight * f64::from(u16::from_le_bytes(v))),
            Self::F32 => add_terms(bytes.as_chunks().0, sum, |v| weight * f64::from(f32::from_le_bytes(v))),
            Self::F64 => add_terms(bytes.as_chunks().0, sum, |v| weight * f64::from_le_bytes(v)),
        }
    }

    /// Writes every `stride`-th value to `out` as a pixel, divided by [`Self::full_scale`].
    fn write_pixels(self, bytes: &[u8], stride: usize, out: &mut [Real]) {
        match self {
            Self::U8 => write_strided(bytes, stride, out, |v| Real::from(v) / 255.0),
            Self::U16 => {
                write_strided(bytes.as_chunks().0, stride, out, |v| {
                    Real::from(f32::from(u16::from_le_bytes(v)) / 65_535.0)
                });
            }
            Self::F32 => write_strided(bytes.as_chunks().0, stride, out, |v| Real::from(f32::from_le_bytes(v))),
            Self::F64 => write_strided(bytes.as_chunks().0, stride, out, |v| Real::from(f64::from_le_bytes(v) as f32)),
        }
    }
}

/// Writes every `stride`-th value to `out`, converted by `pixel`.
fn write_strided<T: Copy>(values: &[T], stride: usize, out: &mut [Real], pixel: impl Fn(T) -> Real) {
    out.iter_mut().zip(values.iter().step_by(stride)).for_each(|(out, v)| *out = pixel(*v));
}

/// Adds the term of each value to `sum`.
fn add_terms<T: Copy>(values: &[T], sum: &mut [f64], term: impl Fn(T) -> f64) {
    sum.iter_mut().zip(values).for_each(|(sum, v)| *sum += term(*v));
}

/// Spectra `[M,H,W]`, row-major: a row is an elevation, a column an azimuth, 1 the strongest direction.
///
/// Spectra are in memory, or in an open file from which each is read on demand. The page cache of the system makes
/// repeated reads of small files fast; large files need no memory. The file must not change: replace it only by a new
/// file with a rename.
#[derive(Clone, Debug)]
pub struct Spectra {
    count: usize,
    width: usize,
    height: usize,
    number: Number,
    store: Store,
}

/// Storage of the numbers: in memory or in an open file.
#[derive(Clone, Debug)]
enum Store {
    Memory(Vec<u8>),
    File(Arc<Stored>),
}

impl Spectra {
    /// Creates 8-bit spectra in memory, `width` columns by `height` rows each: 255 is 1.
    ///
    /// # Errors
    /// [`Error::Config`] without a spectrum, or with an incomplete one.
    pub fn grey(size: (usize, usize), pixels: Vec<u8>) -> Result<Self> {
        Self::in_memory(size, Number::U8, pixels)
    }

    /// Creates spectra in memory as numbers from 0 to 1, stored unchanged.
    ///
    /// # Errors
    /// [`Error::Config`] without a spectrum, with an incomplete one, or if a number is not finite.
    pub fn float(size: (usize, usize), pixels: &[f32]) -> Result<Self> {
        if let Some(i) = pixels.iter().position(|v| !v.is_finite()) {
            let (width, spectrum_pixels) = (size.0.max(1), (size.0 * size.1).max(1));
            let [m, y, x] = [i / spectrum_pixels, i % spectrum_pixels / width, i % width];
            return Err(Error::Config(format!("spectra[{m}, {y}, {x}] is {}; give numbers from 0 to 1", pixels[i])));
        }
        Self::in_memory(size, Number::F32, pixels.iter().flat_map(|v| v.to_le_bytes()).collect())
    }

    /// Creates spectra in memory in the format `number`. Floating-point values are not checked.
    ///
    /// # Errors
    /// [`Error::Config`] without a spectrum, or with an incomplete one.
    pub fn in_memory((width, height): (usize, usize), number: Number, bytes: Vec<u8>) -> Result<Self> {
        let spectrum_bytes = width.checked_mul(height).and_then(|n| n.checked_mul(number.bytes())).unwrap_or(0);
        if spectrum_bytes == 0 || bytes.is_empty() || !bytes.len().is_multiple_of(spectrum_bytes) {
            return Err(Error::Config(format!(
                "{} numbers are not a multiple of {width} x {height} pixels; give at least one complete spectrum",
                bytes.len() / number.bytes()
            )));
        }
        Ok(Self { count: bytes.len() / spectrum_bytes, width, height, number, store: Store::Memory(bytes) })
    }

    /// Opens spectra in a file: `shape` `[M,H,W]` numbers, from byte `offset` to the end of the file. Floating-point
    /// values are not checked.
    ///
    /// # Errors
    /// [`Error::Read`]; [`Error::Input`] if the file has another length.
    pub fn open(path: &Path, offset: u64, number: Number, shape: [usize; 3]) -> Result<Self> {
        let stored = Stored::open(path, offset)?;
        let [count, height, width] = shape;
        let bytes = shape.iter().try_fold(number.bytes() as u64, |bytes, n| bytes.checked_mul(*n as u64));
        match bytes {
            Some(bytes) if bytes > 0 && offset.checked_add(bytes) == Some(stored.len) => {
                Ok(Self { count, width, height, number, store: Store::File(Arc::new(stored)) })
            }
            _ => {
                let (length, advice) = (stored.len, "the file is truncated or damaged; copy it again");
                let problem = format!("{count} spectra of {width} x {height} pixels do not fit its {length} bytes");
                Err(Error::input(path, format!("{problem}; {advice}")))
            }
        }
    }

    /// Reads all spectra into memory; later changes of the file have no effect.
    ///
    /// # Errors
    /// [`Error::Read`] if the file cannot be read.
    pub fn into_memory(self) -> Result<Self> {
        let store = match self.store {
            Store::File(stored) => Store::Memory(stored.read_all()?),
            memory @ Store::Memory(_) => memory,
        };
        Ok(Self { store, ..self })
    }

    /// Returns the number of spectra M.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Returns `false`: there is always a spectrum.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Returns the number of columns W.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Returns the number of rows H.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Returns the storage format of pixels.
    pub fn number(&self) -> Number {
        self.number
    }

    /// Returns the number of bytes in memory: 0 for a file.
    pub fn bytes_in_memory(&self) -> usize {
        match &self.store {
            Store::Memory(bytes) => bytes.len(),
            Store::File(_) => 0,
        }
    }

    /// Returns the stored bytes of spectrum `i`; zeros if it cannot be read, which [`Self::check`] reports.
    pub fn raw(&self, i: usize) -> Cow<'_, [u8]> {
        let spectrum_bytes = self.width * self.height * self.number.bytes();
        match &self.store {
            Store::Memory(bytes) => Cow::Borrowed(&bytes[i * spectrum_bytes..][..spectrum_bytes]),
            Store::File(stored) => Cow::Owned(stored.read_part(i as u64 * spectrum_bytes as u64, spectrum_bytes)),
        }
    }

    /// Returns spectrum `i`.
    pub fn image(&self, i: usize) -> Image {
        let mut image = Image::zeros(self.width, self.height);
        self.number.write_pixels(&self.raw(i), 1, &mut image.pixels);
        image
    }

    /// Writes the pixels of spectrum `i` that `sampling` selects to `out`, row-major.
    pub fn sampled(&self, i: usize, sampling: Sampling, out: &mut [Real]) {
        let (bytes, number_bytes, Sampling { stride, offset: [left, top], .. }) =
            (self.raw(i), self.number.bytes(), sampling);
        let rows = bytes.chunks_exact(self.width * number_bytes).skip(top).step_by(stride);
        for (out, row) in out.chunks_exact_mut((self.width - left).div_ceil(stride)).zip(rows) {
            self.number.write_pixels(&row[left * number_bytes..], stride, out);
        }
    }

    /// Writes some of the pixels that [`Self::sampled`] writes for spectrum `i`, by their `indices` in its result.
    pub fn sampled_at(&self, i: usize, sampling: Sampling, indices: &[usize], out: &mut [Real]) {
        let (bytes, number_bytes, Sampling { stride, offset: [left, top], .. }) =
            (self.raw(i), self.number.bytes(), sampling);
        let columns = (self.width - left).div_ceil(stride);
        for (out, index) in out.iter_mut().zip(indices) {
            let (row, column) = (top + index / columns * stride, left + index % columns * stride);
            let start = (row * self.width + column) * number_bytes;
            self.number.write_pixels(&bytes[start..start + number_bytes], 1, std::slice::from_mut(out));
        }
    }

    /// Adds `weight` times the stored values of spectrum `i`, of which [`Number::full_scale`] represents 1, to `sum`.
    pub fn add(&self, i: usize, weight: f64, sum: &mut [f64]) {
        self.number.add_weighted(&self.raw(i), weight, sum);
    }

    /// Checks that all reads so far succeeded. Callers must check before they use results.
    ///
    /// # Errors
    /// [`Error::Read`] if the file cannot be read.
    pub fn check(&self) -> Result<()> {
        match &self.store {
            Store::Memory(_) => Ok(()),
            Store::File(stored) => stored.check(),
        }
    }
}

/// Bytes of a file from an offset, readable at any position from any thread. The file stays open.
///
/// Uses positional reads instead of a memory map. They are as fast (copying a spectrum takes microseconds, processing
/// it milliseconds), need no unsafe code, and do not count as virtual memory. Truncation of the file is an error
/// instead of a fatal signal.
#[derive(Debug)]
struct Stored {
    file: File,
    path: PathBuf,
    offset: u64,
    /// Length of the whole file, bytes.
    len: u64,
    /// First read that failed.
    fault: OnceLock<(io::ErrorKind, String)>,
}

impl Stored {
    /// Opens a file whose numbers begin at byte `offset`.
    fn open(path: &Path, offset: u64) -> Result<Self> {
        let read_error = |e| Error::read(path, e);
        let file = crate::files::open(path).map_err(read_error)?;
        let len = file.metadata().map_err(read_error)?.len();
        Ok(Self { file, path: path.into(), offset, len, fault: OnceLock::new() })
    }

    /// Reads all bytes from the offset.
    fn read_all(&self) -> Result<Vec<u8>> {
        let read = || {
            let (mut bytes, len) = (Vec::new(), (self.len - self.offset) as usize);
            bytes.try_reserve_exact(len)?;
            bytes.resize(len, 0);
            read_exact_at(&self.file, &mut bytes, self.offset).map(|()| bytes)
        };
        read().map_err(|e| Error::read(&self.path, e))
    }

    /// Reads `len` bytes, `start` bytes after the offset; returns zeros if they cannot be read, which [`Self::check`]
    /// reports.
    fn read_part(&self, start: u64, len: usize) -> Vec<u8> {
        let mut bytes = vec![0; len];
        if let Err(e) = read_exact_at(&self.file, &mut bytes, self.offset + start) {
            let _ = self.fault.set((e.kind(), e.to_string())); // only the first error is reported
            bytes.fill(0);
        }
        bytes
    }

    /// Checks that all reads so far succeeded.
    ///
    /// # Errors
    /// [`Error::Read`] of the first read that failed.
    fn check(&self) -> Result<()> {
        match self.fault.get() {
            None => Ok(()),
            Some((kind, fault)) => {
                let problem = format!("{fault}; the file of spectra was changed or removed while open; restore it");
                Err(Error::read(&self.path, io::Error::new(*kind, problem)))
            }
        }
    }
}

/// Reads all of `bytes` from `offset`, without moving the position of the file.
#[cfg(unix)]
fn read_exact_at(file: &File, bytes: &mut [u8], offset: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, bytes, offset)
}

/// Reads all of `bytes` from `offset`.
#[cfg(windows)]
fn read_exact_at(file: &File, mut bytes: &mut [u8], mut offset: u64) -> io::Result<()> {
    while !bytes.is_empty() {
        match std::os::windows::fs::FileExt::seek_read(file, bytes, offset)? {
            0 => return Err(io::ErrorKind::UnexpectedEof.into()),
            n => (bytes, offset) = (&mut bytes[n..], offset + n as u64),
        }
    }
    Ok(())
}
