//! `Spectra`: all pictures of a data set as one array `[M,H,W]`, in memory or in a file that stays open.

#[cfg(test)]
mod tests;

use crate::{Error, Image, Real, Result, Sampling};
use std::borrow::Cow;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

/// How a number is stored; little endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Number {
    /// 8-bit grey: 255 is 1.
    U8,
    /// 16-bit grey: 65,535 is 1.
    U16,
    /// As it is, 0 to 1.
    F32,
    /// As it is, 0 to 1; read in single precision.
    F64,
}

impl Number {
    /// Bytes of one.
    pub fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 => 2,
            Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// What stands for 1.
    pub fn full_scale(self) -> f64 {
        match self {
            Self::U8 => 255.0,
            Self::U16 => 65_535.0,
            Self::F32 | Self::F64 => 1.0,
        }
    }

    /// Whether it may be infinite, or no number at all.
    pub fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }

    /// Shows every value, in units of which [`Self::full_scale`] are 1.
    pub fn each(self, bytes: &[u8], mut show: impl FnMut(f64)) {
        match self {
            Self::U8 => bytes.iter().for_each(|v| show(f64::from(*v))),
            Self::U16 => bytes.as_chunks().0.iter().for_each(|v| show(f64::from(u16::from_le_bytes(*v)))),
            Self::F32 => bytes.as_chunks().0.iter().for_each(|v| show(f64::from(f32::from_le_bytes(*v)))),
            Self::F64 => bytes.as_chunks().0.iter().for_each(|v| show(f64::from_le_bytes(*v))),
        }
    }

    /// Adds `weight` times every value, in the same units.
    fn add(self, bytes: &[u8], weight: f64, sum: &mut [f64]) {
        match self {
            Self::U8 => add(bytes, sum, |v| weight * f64::from(v)),
            Self::U16 => add(bytes.as_chunks().0, sum, |v| weight * f64::from(u16::from_le_bytes(v))),
            Self::F32 => add(bytes.as_chunks().0, sum, |v| weight * f64::from(f32::from_le_bytes(v))),
            Self::F64 => add(bytes.as_chunks().0, sum, |v| weight * f64::from_le_bytes(v)),
        }
    }

    /// Every `stride`-th value as a pixel, 1 the strongest.
    fn pixels(self, bytes: &[u8], stride: usize, out: &mut [Real]) {
        match self {
            Self::U8 => put(bytes, stride, out, |v| Real::from(v) / 255.0),
            Self::U16 => {
                put(bytes.as_chunks().0, stride, out, |v| Real::from(f32::from(u16::from_le_bytes(v)) / 65_535.0));
            }
            Self::F32 => put(bytes.as_chunks().0, stride, out, |v| Real::from(f32::from_le_bytes(v))),
            Self::F64 => put(bytes.as_chunks().0, stride, out, |v| Real::from(f64::from_le_bytes(v) as f32)),
        }
    }
}

fn put<T: Copy>(values: &[T], stride: usize, out: &mut [Real], pixel: impl Fn(T) -> Real) {
    out.iter_mut().zip(values.iter().step_by(stride)).for_each(|(out, v)| *out = pixel(*v));
}

fn add<T: Copy>(values: &[T], sum: &mut [f64], term: impl Fn(T) -> f64) {
    sum.iter_mut().zip(values).for_each(|(sum, v)| *sum += term(*v));
}

/// Spectra `[M,H,W]`, row-major: a row is an elevation, a column an azimuth, 1 the strongest direction.
///
/// In memory, or in a file that stays open and of which a picture is read when it is wanted. The system keeps what it has
/// memory for, so that a small file is read once; a large one needs no memory at all. The file must stay as it is:
/// whoever replaces it does so under another name.
#[derive(Clone, Debug)]
pub struct Spectra {
    count: usize,
    width: usize,
    height: usize,
    number: Number,
    store: Store,
}

#[derive(Clone, Debug)]
enum Store {
    Memory(Vec<u8>),
    File(Arc<Stored>),
}

impl Spectra {
    /// 8-bit grey pictures in memory, `width` columns by `height` rows each: 255 is 1.
    ///
    /// # Errors
    /// [`Error::Config`] where there is no picture, or half of one.
    pub fn grey(size: (usize, usize), pixels: Vec<u8>) -> Result<Self> {
        Self::in_memory(size, Number::U8, pixels)
    }

    /// Pictures in memory as numbers from 0 to 1, kept as they are.
    ///
    /// # Errors
    /// [`Error::Config`] where there is no picture, half of one, or a number is not finite.
    pub fn float(size: (usize, usize), pixels: &[f32]) -> Result<Self> {
        if let Some(i) = pixels.iter().position(|v| !v.is_finite()) {
            let (width, of_one) = (size.0.max(1), (size.0 * size.1).max(1));
            let [m, y, x] = [i / of_one, i % of_one / width, i % width];
            return Err(Error::Config(format!("spectra[{m}, {y}, {x}] is {}; give numbers from 0 to 1", pixels[i])));
        }
        Self::in_memory(size, Number::F32, pixels.iter().flat_map(|v| v.to_le_bytes()).collect())
    }

    /// Pictures in memory as `number`s.
    ///
    /// # Errors
    /// [`Error::Config`] where there is no picture, or half of one.
    pub fn in_memory((width, height): (usize, usize), number: Number, bytes: Vec<u8>) -> Result<Self> {
        let of_one = width.checked_mul(height).and_then(|n| n.checked_mul(number.bytes())).unwrap_or(0);
        if of_one == 0 || bytes.is_empty() || !bytes.len().is_multiple_of(of_one) {
            return Err(Error::Config(format!(
                "{} numbers are no spectra of {width} x {height} pixels; give at least one, and whole ones",
                bytes.len() / number.bytes()
            )));
        }
        Ok(Self { count: bytes.len() / of_one, width, height, number, store: Store::Memory(bytes) })
    }

    /// Pictures in a file: `shape` `[M,H,W]` numbers, from byte `offset` to the end of the file. Floats are not looked at.
    ///
    /// # Errors
    /// [`Error::Read`]; [`Error::Input`] where the file has another length.
    pub fn open(path: &Path, offset: u64, number: Number, shape: [usize; 3]) -> Result<Self> {
        let stored = Stored::open(path, offset)?;
        let [count, height, width] = shape;
        let bytes = shape.iter().try_fold(number.bytes() as u64, |all, n| all.checked_mul(*n as u64));
        match bytes {
            Some(bytes) if bytes > 0 && offset.checked_add(bytes) == Some(stored.len) => {
                Ok(Self { count, width, height, number, store: Store::File(Arc::new(stored)) })
            }
            _ => Err(Error::input(
                path,
                format!(
                    "{count} spectra of {width} x {height} pixels do not fit its {} bytes; it is cut short or \
                     damaged: copy it anew",
                    stored.len
                ),
            )),
        }
    }

    /// The same in memory: what happens to the file no longer matters.
    ///
    /// # Errors
    /// [`Error::Read`].
    pub fn into_memory(self) -> Result<Self> {
        let store = match self.store {
            Store::File(stored) => Store::Memory(stored.all()?),
            memory @ Store::Memory(_) => memory,
        };
        Ok(Self { store, ..self })
    }

    /// M, pictures.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Never.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// W, columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// H, rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// How a pixel is stored.
    pub fn number(&self) -> Number {
        self.number
    }

    /// Bytes held in memory: none of a file.
    pub fn bytes_in_memory(&self) -> usize {
        match &self.store {
            Store::Memory(bytes) => bytes.len(),
            Store::File(_) => 0,
        }
    }

    /// Picture `i` as it is stored. Where it cannot be read it is black, and [`Self::check`] tells.
    pub fn raw(&self, i: usize) -> Cow<'_, [u8]> {
        let of_one = self.width * self.height * self.number.bytes();
        match &self.store {
            Store::Memory(bytes) => Cow::Borrowed(&bytes[i * of_one..][..of_one]),
            Store::File(stored) => Cow::Owned(stored.part(i as u64 * of_one as u64, of_one)),
        }
    }

    /// Picture `i`.
    pub fn image(&self, i: usize) -> Image {
        let mut image = Image::zeros(self.width, self.height);
        self.number.pixels(&self.raw(i), 1, &mut image.pixels);
        image
    }

    /// The pixels of picture `i` that `sampling` names, row-major.
    pub fn sampled(&self, i: usize, sampling: Sampling, out: &mut [Real]) {
        let (bytes, of_one, Sampling { stride, offset: [left, top], .. }) =
            (self.raw(i), self.number.bytes(), sampling);
        let rows = bytes.chunks_exact(self.width * of_one).skip(top).step_by(stride);
        for (out, row) in out.chunks_exact_mut((self.width - left).div_ceil(stride)).zip(rows) {
            self.number.pixels(&row[left * of_one..], stride, out);
        }
    }

    /// Some of the pixels that [`Self::sampled`] gives of picture `i`.
    pub fn sampled_at(&self, i: usize, sampling: Sampling, places: &[usize], out: &mut [Real]) {
        let (bytes, of_one, Sampling { stride, offset: [left, top], .. }) =
            (self.raw(i), self.number.bytes(), sampling);
        let columns = (self.width - left).div_ceil(stride);
        for (out, place) in out.iter_mut().zip(places) {
            let (row, column) = (top + place / columns * stride, left + place % columns * stride);
            let at = (row * self.width + column) * of_one;
            self.number.pixels(&bytes[at..at + of_one], 1, std::slice::from_mut(out));
        }
    }

    /// Adds `weight` times picture `i`, in units of which [`Number::full_scale`] are 1, to `sum`.
    pub fn add(&self, i: usize, weight: f64, sum: &mut [f64]) {
        self.number.add(&self.raw(i), weight, sum);
    }

    /// Whether all that was read so far could be read. Whoever has read asks, before a number made of it counts.
    ///
    /// # Errors
    /// [`Error::Read`] of the file.
    pub fn check(&self) -> Result<()> {
        match &self.store {
            Store::Memory(_) => Ok(()),
            Store::File(stored) => stored.check(),
        }
    }
}

/// The bytes of a file from an offset on, read at any place from any thread. The file stays open.
///
/// Reads at a position, and no memory map: as fast (a picture is copied once, in microseconds, and then worked on for
/// milliseconds), without unsafe code, not counted as virtual memory, and a file that is cut short is an error and not a
/// signal that kills.
#[derive(Debug)]
struct Stored {
    file: File,
    path: PathBuf,
    offset: u64,
    /// Of the whole file, bytes.
    len: u64,
    /// The first read that failed.
    fault: OnceLock<(io::ErrorKind, String)>,
}

impl Stored {
    fn open(path: &Path, offset: u64) -> Result<Self> {
        let refuse = |e| Error::read(path, e);
        let file = crate::files::open(path).map_err(refuse)?;
        let len = file.metadata().map_err(refuse)?.len();
        Ok(Self { file, path: path.into(), offset, len, fault: OnceLock::new() })
    }

    /// All of it.
    fn all(&self) -> Result<Vec<u8>> {
        let read = || {
            let (mut bytes, len) = (Vec::new(), (self.len - self.offset) as usize);
            bytes.try_reserve_exact(len)?;
            bytes.resize(len, 0);
            read_exact_at(&self.file, &mut bytes, self.offset).map(|()| bytes)
        };
        read().map_err(|e| Error::read(&self.path, e))
    }

    /// `len` bytes from `start` on; zeros where they cannot be read, which [`Self::check`] tells.
    fn part(&self, start: u64, len: usize) -> Vec<u8> {
        let mut bytes = vec![0; len];
        if let Err(e) = read_exact_at(&self.file, &mut bytes, self.offset + start) {
            let _ = self.fault.set((e.kind(), e.to_string())); // only the first is told
            bytes.fill(0);
        }
        bytes
    }

    fn check(&self) -> Result<()> {
        match self.fault.get() {
            None => Ok(()),
            Some((kind, why)) => {
                let why = format!("{why}; the spectra have changed or gone since they were opened: put them back");
                Err(Error::read(&self.path, io::Error::new(*kind, why)))
            }
        }
    }
}

#[cfg(unix)]
fn read_exact_at(file: &File, bytes: &mut [u8], offset: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, bytes, offset)
}

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
