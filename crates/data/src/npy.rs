//! NumPy's array files: what the header says, held against the length of the file before anything is read.
//!
//! The header is a Python dictionary: `{'descr': '<f4', 'fortran_order': False, 'shape': (3, 90, 360), }`. The crate
//! `npyz` reads the whole of Python's literals with recursion and believes the header's length; these three are enough.

use pwrfgs_core::{Error, Number, Real, Result, Spectra, files, gain_fault};
use std::io::Read;
use std::path::Path;

const MAGIC: &[u8] = b"\x93NUMPY";
/// Longest header that is read, bytes; NumPy's own limit is 10,000.
const MAX_HEADER: usize = 1 << 16;
/// Largest array that is read whole, bytes.
pub(crate) const MAX_BYTES: u64 = 1 << 30;

/// What an array file says of itself.
#[derive(Debug, PartialEq)]
pub(crate) struct Header {
    /// Such as `<f4`.
    pub(crate) descr: String,
    /// Whether the first index runs fastest.
    pub(crate) fortran: bool,
    pub(crate) shape: Vec<usize>,
    /// Where the numbers begin, bytes.
    pub(crate) offset: u64,
}

impl Header {
    /// Reads the header from the beginning of a file.
    pub(crate) fn read(path: &Path, file: &mut dyn Read) -> Result<Self> {
        let damaged = |what: &str| Error::input(path, format!("{what}; write it with numpy.save"));
        let short = |_| damaged("is no array of NumPy, or cut short");
        let mut start = [0; 8];
        file.read_exact(&mut start).map_err(short)?;
        if !start.starts_with(MAGIC) {
            return Err(damaged("is no array of NumPy"));
        }
        let mut length = vec![0; if start[6] == 1 { 2 } else { 4 }];
        file.read_exact(&mut length).map_err(short)?;
        let bytes = length.iter().rev().fold(0, |n, byte| n << 8 | usize::from(*byte));
        if bytes > MAX_HEADER {
            return Err(damaged(&format!("has a header of {bytes} bytes, more than {MAX_HEADER}")));
        }
        let mut text = vec![0; bytes];
        file.read_exact(&mut text).map_err(short)?;
        let offset = (start.len() + length.len() + bytes) as u64;
        let parsed = Self::parse(&String::from_utf8_lossy(&text));
        let (descr, fortran, shape) = parsed.ok_or_else(|| damaged("has a header that is not understood"))?;
        Ok(Self { descr, fortran, shape, offset })
    }

    fn parse(text: &str) -> Option<(String, bool, Vec<usize>)> {
        let value = |key: &str| {
            let (_, rest) = text.split_once(&format!("'{key}'"))?;
            rest.trim_start().strip_prefix(':').map(str::trim_start)
        };
        // A list would be a table with named columns.
        let descr = value("descr")?.strip_prefix('\'')?.split_once('\'')?.0;
        let fortran = value("fortran_order")?.starts_with("True");
        let list = value("shape")?.strip_prefix('(')?.split_once(')')?.0;
        let sizes = list.split(',').map(str::trim).filter(|n| !n.is_empty());
        Some((descr.into(), fortran, sizes.map(|n| n.parse().ok()).collect::<Option<_>>()?))
    }

    /// How a number is stored, where it is one of those that spectra can be.
    pub(crate) fn number(&self) -> Option<Number> {
        match self.descr.as_str() {
            "|u1" | "<u1" => Some(Number::U8),
            "<u2" => Some(Number::U16),
            "<f4" => Some(Number::F32),
            "<f8" => Some(Number::F64),
            _ => None,
        }
    }

    /// Bytes of all numbers.
    pub(crate) fn bytes(&self, number: Number) -> Option<u64> {
        self.shape.iter().try_fold(number.bytes() as u64, |all, n| all.checked_mul(*n as u64))
    }

    /// As Python prints it.
    pub(crate) fn shape_text(&self) -> String {
        format!("[{}]", self.shape.iter().map(ToString::to_string).collect::<Vec<_>>().join(", "))
    }

    /// Number and shape `[M,H,W]` of an array of spectra.
    pub(crate) fn spectra(&self, path: &Path) -> Result<(Number, [usize; 3])> {
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let Some(number) = self.number() else {
            let what = match self.descr.get(1..2) {
                Some("c") => "a spectrum is real: save the amplitude, numpy.abs(..)".to_owned(),
                _ => "spectra are uint8 (255 is 1), uint16 (65535 is 1), or float32 and float64 from 0 to 1, all \
                      little endian: save a.astype('<f4')"
                    .to_owned(),
            };
            return Err(Error::input(path, format!("holds numbers of type `{}`; {what}", self.descr)));
        };
        let Ok(shape) = <[usize; 3]>::try_from(self.shape.as_slice()) else {
            let what = "spectra are [M, H, W]: M pictures of H rows (elevation) and W columns (azimuth); use a.reshape";
            return Err(Error::input(path, format!("has shape {}; {what}", self.shape_text())));
        };
        if self.fortran {
            let what = format!("is in Fortran order; save numpy.ascontiguousarray({name})");
            return Err(Error::input(path, what));
        }
        Ok((number, shape))
    }

    /// Positions `[M,3]`, metres, from the numbers behind the header, `left` bytes of them.
    pub(crate) fn positions(&self, path: &Path, file: &mut dyn Read, left: u64) -> Result<Vec<[f64; 3]>> {
        let refuse = |what: String| Err(Error::input(path, what));
        let number = self.number().filter(|n| n.is_float());
        let Some(number) = number else {
            let what = "positions are float64 or float32, little endian: save tx.astype('<f8')";
            return refuse(format!("holds numbers of type `{}`; {what}", self.descr));
        };
        let &[count, 3] = self.shape.as_slice() else {
            let turned = if let [3, _] = self.shape[..] { "; save tx.T" } else { "" };
            let what = format!("positions are [M, 3]: x, y and z of each transmitter in metres{turned}");
            return refuse(format!("has shape {}; {what}", self.shape_text()));
        };
        if self.bytes(number) != Some(left) || left > MAX_BYTES {
            return refuse(format!(
                "{count} positions do not fit its length; it is cut short or damaged: copy it anew"
            ));
        }
        let mut bytes = vec![0; left as usize];
        file.read_exact(&mut bytes).map_err(|e| Error::read(path, e))?;
        let mut values = Vec::with_capacity(3 * count);
        number.each(&bytes, |v| values.push(v));
        let at = |i: usize, k: usize| if self.fortran { values[k * count + i] } else { values[3 * i + k] };
        let positions: Vec<[f64; 3]> = (0..count).map(|i| [0, 1, 2].map(|k| at(i, k))).collect();
        match positions.iter().position(|p| !p.iter().all(|v| v.is_finite())) {
            Some(i) => refuse(format!("tx[{i}] is {:?}; give finite metres", positions[i])),
            None => Ok(positions),
        }
    }
}

/// The spectra of a file, which stays open; floats are not looked at.
pub(crate) fn open_spectra(path: &Path) -> Result<Spectra> {
    let mut file = files::open(path).map_err(|e| Error::read(path, e))?;
    let header = Header::read(path, &mut file)?;
    let (number, shape) = header.spectra(path)?;
    Spectra::open(path, header.offset, number, shape)
}

/// The transmitters of a file, `[M,3]` in metres.
pub(crate) fn read_positions(path: &Path) -> Result<Vec<[f64; 3]>> {
    let refuse = |e| Error::read(path, e);
    let mut file = files::open(path).map_err(refuse)?;
    let header = Header::read(path, &mut file)?;
    let left = file.metadata().map_err(refuse)?.len().saturating_sub(header.offset);
    header.positions(path, &mut file, left)
}

/// The header of a file of `number`s, to which their bytes are appended, row-major and little endian.
pub fn npy_header(number: Number, shape: &[usize]) -> Vec<u8> {
    let descr = match number {
        Number::U8 => "|u1",
        Number::U16 => "<u2",
        Number::F32 => "<f4",
        Number::F64 => "<f8",
    };
    npy_header_as(descr, shape)
}

/// The same for numbers of any type, as NumPy calls it: `<c8` is complex, in single precision.
pub fn npy_header_as(descr: &str, shape: &[usize]) -> Vec<u8> {
    let sizes: Vec<String> = shape.iter().map(ToString::to_string).collect();
    let comma = if sizes.len() == 1 { "," } else { "" }; // Python's tuple of one
    let text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({}{comma}), }}", sizes.join(", "));
    // Numbers begin at a multiple of 64 bytes, as the format asks; the header ends in a line end.
    let length = (10 + text.len() + 1).next_multiple_of(64) - 10;
    let mut bytes = MAGIC.to_vec();
    bytes.extend([1, 0]);
    bytes.extend((length as u16).to_le_bytes());
    bytes.extend(format!("{text:<width$}\n", width = length - 1).into_bytes());
    bytes
}

/// A complex array `[M,A,F]`, row-major.
#[derive(Debug, PartialEq)]
pub(crate) struct Complex {
    pub(crate) shape: [usize; 3],
    /// Real and imaginary part of every number.
    pub(crate) values: Vec<[f64; 2]>,
}

/// The complex array of a file; `shape` says in words what its three sizes are.
pub(crate) fn read_complex(path: &Path, shape: &str) -> Result<Complex> {
    let refuse = |e| Error::read(path, e);
    let mut file = files::open(path).map_err(refuse)?;
    let header = Header::read(path, &mut file)?;
    let left = file.metadata().map_err(refuse)?.len().saturating_sub(header.offset);
    header.complex(path, &mut file, left, shape)
}

impl Header {
    /// The numbers behind the header, `left` bytes of them.
    fn complex(&self, path: &Path, file: &mut dyn Read, left: u64, words: &str) -> Result<Complex> {
        let refuse = |what: String| Error::input(path, what);
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let double = match self.descr.as_str() {
            "<c8" => false,
            "<c16" => true,
            other => {
                let what = "channels are complex64 or complex128, little endian: save a.astype('<c8')";
                return Err(refuse(format!("holds numbers of type `{other}`; {what}")));
            }
        };
        let Ok(shape) = <[usize; 3]>::try_from(self.shape.as_slice()) else {
            return Err(refuse(format!("has shape {}; {words}; use a.reshape", self.shape_text())));
        };
        if self.fortran {
            return Err(refuse(format!("is in Fortran order; save numpy.ascontiguousarray({name})")));
        }
        if shape.contains(&0) {
            return Err(refuse(format!("has shape {} and holds nothing; {words}", self.shape_text())));
        }
        let of_one = if double { 16_u64 } else { 8 };
        if self.shape.iter().try_fold(of_one, |all, n| all.checked_mul(*n as u64)) != Some(left) {
            let what = "do not fit its length; it is cut short or damaged: copy it anew";
            return Err(refuse(format!("numbers of shape {} {what}", self.shape_text())));
        }
        if left > MAX_BYTES {
            return Err(refuse(format!("holds {left} bytes, more than {MAX_BYTES}; give fewer channels")));
        }
        let mut bytes = vec![0; left as usize];
        file.read_exact(&mut bytes).map_err(|e| Error::read(path, e))?;
        let single = |b: &[u8; 4]| f64::from(f32::from_le_bytes(*b));
        let parts: Vec<f64> = if double {
            bytes.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect()
        } else {
            bytes.as_chunks().0.iter().map(single).collect()
        };
        let all = Complex { shape, values: parts.as_chunks().0.to_vec() };
        if let Some(i) = parts.iter().position(|v| !(*v as Real).is_finite()) {
            let [re, im] = all.values[i / 2];
            return Err(refuse(format!("{} is {:?}; give finite numbers", all.place(path, i / 2), (re, im))));
        }
        Ok(all)
    }
}

impl Complex {
    /// Refuses numbers that are too large to compute with.
    pub(crate) fn check_size(&self, path: &Path) -> Result<()> {
        let mut faults = self.values.iter().map(|gain| gain_fault(*gain)).enumerate();
        match faults.find_map(|(i, fault)| Some((i, fault?))) {
            Some((i, fault)) => Err(Error::input(path, format!("{} {fault}", self.place(path, i)))),
            None => Ok(()),
        }
    }

    /// Number `i` as Python writes it.
    fn place(&self, path: &Path, i: usize) -> String {
        let [_, a, f] = self.shape;
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        format!("{name}[{}, {}, {}]", i / (a * f), i / f % a, i % f)
    }

    /// Divides all by the largest modulus of the rows `seen`, or of all where none are named; refuses what is zero there.
    pub(crate) fn normalise(&mut self, path: &Path, seen: Option<&[usize]>) -> Result<()> {
        let largest_of = |values: &[[f64; 2]]| values.iter().map(|[re, im]| re.hypot(*im)).fold(0.0, f64::max);
        let [_, antennas, frequencies] = self.shape;
        let row = |&i: &usize| largest_of(&self.values[i * antennas * frequencies..][..antennas * frequencies]);
        let largest = seen.map_or_else(|| largest_of(&self.values), |rows| rows.iter().map(row).fold(0.0, f64::max));
        if largest == 0.0 {
            let part = if seen.is_some() { "in its training part" } else { "throughout" };
            return Err(Error::input(path, format!("is zero {part}; give channels that were measured")));
        }
        self.values.iter_mut().flatten().for_each(|v| *v /= largest);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> Result<Header, String> {
        Header::read(Path::new("a.npy"), &mut &bytes[..]).map_err(|e| e.to_string())
    }

    #[test]
    fn what_is_written_is_read() {
        for (number, shape) in [(Number::U8, vec![3, 90, 360]), (Number::F64, vec![7]), (Number::U16, vec![])] {
            let bytes = npy_header(number, &shape);
            assert!(bytes.len().is_multiple_of(64) && bytes.ends_with(b"\n"));
            let header = read(&bytes).unwrap();
            assert_eq!((header.number(), &header.shape, header.fortran), (Some(number), &shape, false));
            assert_eq!(header.offset, bytes.len() as u64);
        }
    }

    #[test]
    fn damaged_headers_are_refused() {
        let good = npy_header(Number::F32, &[2, 3]);
        for end in 0..good.len() {
            assert!(read(&good[..end]).unwrap_err().contains("cut short"), "{end}");
        }
        let with = |from: &str, to: &str| read(String::from_utf8_lossy(&good).replace(from, to).as_bytes());
        assert!(read(b"PK\x03\x04........").unwrap_err().contains("no array of NumPy"));
        let text = |text: &str| {
            let length = (text.len() as u16).to_le_bytes();
            read(&[MAGIC, &[1, 0], &length, text.as_bytes()].concat())
        };
        assert!(with("\u{93}", "x").is_err());
        for wrong in [
            "{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (3,), }",
            "{'descr': '<f4', 'fortran_order': False, 'shape': (3, -1), }",
            "{'descr': '<f4', 'fortran_order': False, 'shape': (99999999999999999999999,), }",
            "{'descr': '<f4', 'fortran_order': False, }",
            "((((((((((((((((",
        ] {
            assert!(text(wrong).unwrap_err().contains("is not understood"), "{wrong}");
        }
        let long = [MAGIC, &[2, 0], &[255; 4], &[0; 100]].concat();
        assert!(read(&long).unwrap_err().contains("header of 4294967295 bytes"));
    }
}
