//! NumPy array files: parsing and writing of the header.
//!
//! The header is a Python dictionary: `{'descr': '<f4', 'fortran_order': False, 'shape': (3, 90, 360), }`. This module
//! parses only these three entries. The crate `npyz` parses all Python literals recursively, does not validate the
//! header length, and depends on a parser generator.

use crate::{Error, Number, Result};
use std::io::Read;
use std::path::Path;

const MAGIC: &[u8] = b"\x93NUMPY";
/// Maximum header length, bytes; NumPy's own limit is 10,000.
const MAX_HEADER: usize = 1 << 16;

/// Header of an array file.
#[derive(Debug, PartialEq)]
pub struct Header {
    /// Type, such as `<f4`.
    pub descr: String,
    /// Whether the first index varies fastest.
    pub fortran: bool,
    /// Sizes along every axis.
    pub shape: Vec<usize>,
    /// Offset of the numbers in the file, bytes.
    pub offset: u64,
}

impl Header {
    /// Reads the header from the beginning of a file; `path` is for messages.
    ///
    /// # Errors
    /// [`Error::Input`] for a file that is not a NumPy array, is truncated, or has an invalid header.
    pub fn read(path: &Path, file: &mut dyn Read) -> Result<Self> {
        let damaged = |problem: &str| Error::input(path, format!("{problem}; write it with numpy.save"));
        let short = |_| damaged("is not a NumPy array, or is truncated");
        let mut start = [0; 8]; // magic and version
        file.read_exact(&mut start).map_err(short)?;
        if !start.starts_with(MAGIC) {
            return Err(damaged("is not a NumPy array"));
        }
        // Version 1 of the format has two bytes of length, later ones four.
        let mut length = vec![0; if start[6] == 1 { 2 } else { 4 }];
        file.read_exact(&mut length).map_err(short)?;
        let bytes = length.iter().rev().fold(0, |n, byte| n << 8 | usize::from(*byte));
        if bytes > MAX_HEADER {
            return Err(damaged(&format!("has a header of {bytes} bytes, expected at most {MAX_HEADER}")));
        }
        let mut text = vec![0; bytes];
        file.read_exact(&mut text).map_err(short)?;
        let offset = (start.len() + length.len() + bytes) as u64;
        let parsed = Self::parse_dictionary(&String::from_utf8_lossy(&text));
        let (descr, fortran, shape) = parsed.ok_or_else(|| damaged("has an invalid header"))?;
        Ok(Self { descr, fortran, shape, offset })
    }

    /// Parses the dictionary of the header: type, order and shape. `None` for text that is not such a dictionary.
    fn parse_dictionary(text: &str) -> Option<(String, bool, Vec<usize>)> {
        let value = |key: &str| {
            let (_, value) = text.split_once(&format!("'{key}'"))?;
            value.trim_start().strip_prefix(':').map(str::trim_start)
        };
        // A list would be a table with named columns.
        let descr = value("descr")?.strip_prefix('\'')?.split_once('\'')?.0;
        let fortran = value("fortran_order")?.starts_with("True");
        let list = value("shape")?.strip_prefix('(')?.split_once(')')?.0;
        let sizes = list.split(',').map(str::trim).filter(|n| !n.is_empty());
        Some((descr.into(), fortran, sizes.map(|n| n.parse().ok()).collect::<Option<_>>()?))
    }

    /// Returns the number format; `None` if spectra do not support it.
    pub fn number(&self) -> Option<Number> {
        match self.descr.as_str() {
            "|u1" | "<u1" => Some(Number::U8),
            "<u2" => Some(Number::U16),
            "<f4" => Some(Number::F32),
            "<f8" => Some(Number::F64),
            _ => None,
        }
    }

    /// Returns the size of all numbers, bytes; `None` if it exceeds 64 bits.
    pub fn bytes(&self, number: Number) -> Option<u64> {
        self.shape.iter().try_fold(number.bytes() as u64, |bytes, n| bytes.checked_mul(*n as u64))
    }

    /// Returns the axes in the order of the file, the one that varies fastest first.
    pub fn fastest_first(&self) -> Vec<usize> {
        let axes = 0..self.shape.len();
        if self.fortran { axes.collect() } else { axes.rev().collect() }
    }

    /// Returns the shape in Python notation, such as `[3, 90, 360]`.
    pub fn shape_text(&self) -> String {
        format!("[{}]", self.shape.iter().map(ToString::to_string).collect::<Vec<_>>().join(", "))
    }
}

/// Returns the header of a file of `number`s, to which their bytes are appended, row-major and little endian. The types are
/// those that [`Header::number`] reads.
pub fn npy_header(number: Number, shape: &[usize]) -> Vec<u8> {
    let descr = match number {
        Number::U8 => "|u1",
        Number::U16 => "<u2",
        Number::F32 => "<f4",
        Number::F64 => "<f8",
    };
    npy_header_as(descr, shape)
}

/// Returns the header for numbers of any NumPy type: `<c8` is complex in single precision.
pub fn npy_header_as(descr: &str, shape: &[usize]) -> Vec<u8> {
    let sizes: Vec<String> = shape.iter().map(ToString::to_string).collect();
    let comma = if sizes.len() == 1 { "," } else { "" }; // a Python tuple with one element
    let text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({}{comma}), }}", sizes.join(", "));
    // Numbers begin at a multiple of 64 bytes, as the format requires, after 10 bytes of magic, version and length. The header
    // ends with a newline.
    let length = (10 + text.len() + 1).next_multiple_of(64) - 10;
    let mut bytes = MAGIC.to_vec();
    bytes.extend([1, 0]); // version 1.0
    bytes.extend((length as u16).to_le_bytes());
    bytes.extend(format!("{text:<width$}\n", width = length - 1).into_bytes());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> Result<Header, String> {
        Header::read(Path::new("a.npy"), &mut &bytes[..]).map_err(|e| e.to_string())
    }

    #[test]
    fn reads_written_array_back() {
        for (number, shape) in [(Number::U8, vec![3, 90, 360]), (Number::F64, vec![7]), (Number::U16, vec![])] {
            let bytes = npy_header(number, &shape);
            assert!(bytes.len().is_multiple_of(64) && bytes.ends_with(b"\n"));
            let header = read(&bytes).unwrap();
            assert_eq!((header.number(), &header.shape, header.fortran), (Some(number), &shape, false));
            assert_eq!(header.offset, bytes.len() as u64);
        }
    }

    #[test]
    fn rejects_damaged_npy_headers() {
        let good = npy_header(Number::F32, &[2, 3]);
        for end in 0..good.len() {
            assert!(read(&good[..end]).unwrap_err().contains("is truncated"), "{end}");
        }
        let with = |from: &str, to: &str| read(String::from_utf8_lossy(&good).replace(from, to).as_bytes());
        assert!(read(b"PK\x03\x04........").unwrap_err().contains("not a NumPy array"));
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
            assert!(text(wrong).unwrap_err().contains("has an invalid header"), "{wrong}");
        }
        let long = [MAGIC, &[2, 0], &[255; 4], &[0; 100]].concat();
        assert!(read(&long).unwrap_err().contains("header of 4294967295 bytes"));
    }
}
