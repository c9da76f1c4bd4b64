//! NumPy arrays of spectra, positions and channels. The header is validated against the file length before data are
//! read.

use pwrfgs_core::npy::Header;
use pwrfgs_core::{Error, Number, Real, Result, Spectra, files, gain_fault, place_fault};
use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::path::Path;

/// Largest array that is read into memory, bytes.
pub(crate) const MAX_BYTES: u64 = 1 << 30;
/// Largest number of positions in an array: an archive of a megabyte may expand to a gigabyte.
pub(crate) const MOST_POSITIONS: usize = 2_000_000;

/// Returns the number type and the shape `[M,H,W]` of an array of spectra. Returns an error for another type, shape or
/// order.
pub(crate) fn spectra_shape(header: &Header, path: &Path) -> Result<(Number, [usize; 3])> {
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    let Some(number) = header.number() else {
        let advice = match header.descr.get(1..2) {
            Some("c") => "a spectrum is real: save the amplitude, numpy.abs(..)".to_owned(),
            _ => "spectra are uint8 (255 is 1), uint16 (65535 is 1), or float32 and float64 from 0 to 1, all \
                  little endian: save a.astype('<f4')"
                .to_owned(),
        };
        return Err(Error::input(path, format!("holds numbers of type `{}`; {advice}", header.descr)));
    };
    let Ok(shape) = <[usize; 3]>::try_from(header.shape.as_slice()) else {
        let advice = "spectra are [M, H, W]: M spectra of H rows (elevation) and W columns (azimuth); use a.reshape";
        return Err(Error::input(path, format!("has shape {}; {advice}", header.shape_text())));
    };
    if header.fortran {
        let problem = format!("is in Fortran order; save numpy.ascontiguousarray({name})");
        return Err(Error::input(path, problem));
    }
    Ok((number, shape))
}

/// Reads positions `[M,3]`, metres, from the `size` bytes of `file` after the header. Returns an error for another type,
/// shape or length, or an invalid position.
pub(crate) fn parse_positions(header: &Header, path: &Path, file: &mut dyn Read, size: u64) -> Result<Vec<[f64; 3]>> {
    let refuse = |problem: String| Err(Error::input(path, problem));
    let Some(number) = header.number().filter(|number| number.is_float()) else {
        let advice = "positions are float64 or float32, little endian: save tx.astype('<f8')";
        return refuse(format!("holds numbers of type `{}`; {advice}", header.descr));
    };
    let &[count, 3] = header.shape.as_slice() else {
        let transposed = if let [3, _] = header.shape[..] { "; save tx.T" } else { "" };
        let advice = format!("positions are [M, 3]: x, y and z of each transmitter in metres{transposed}");
        return refuse(format!("has shape {}; {advice}", header.shape_text()));
    };
    if header.bytes(number) != Some(size) {
        return refuse(format!(
            "{count} positions do not fit its length; the file is truncated or damaged: copy it again"
        ));
    }
    if count > MOST_POSITIONS {
        return refuse(format!("holds {count} positions, more than {MOST_POSITIONS}; give parts"));
    }
    let mut bytes = vec![0; size as usize];
    file.read_exact(&mut bytes).and_then(|()| check_end(file)).map_err(|e| Error::read(path, e))?;
    let (mut positions, mut done) = (vec![[0.0; 3]; count], 0);
    number.each(&bytes, |v| {
        let (i, k) = if header.fortran { (done % count, done / count) } else { (done / 3, done % 3) };
        positions[i][k] = v;
        done += 1;
    });
    match positions.iter().enumerate().find_map(|(i, position)| Some((i, place_fault(*position)?))) {
        Some((i, fault)) => refuse(format!("tx[{i}] {fault}")),
        None => Ok(positions),
    }
}

/// Returns an error unless `file` ends here. At its end, an archive compares the checksum of an entry.
pub(crate) fn check_end(file: &mut dyn Read) -> io::Result<()> {
    match file.read(&mut [0])? {
        0 => Ok(()),
        _ => Err(io::Error::new(ErrorKind::InvalidData, "it is longer than its header states")),
    }
}

/// Opens the spectra of a file for later reading; floats are not validated. Returns an error for another type or shape.
pub(crate) fn open_spectra(path: &Path) -> Result<Spectra> {
    let mut file = files::open(path).map_err(|e| Error::read(path, e))?;
    let header = Header::read(path, &mut file)?;
    let (number, shape) = spectra_shape(&header, path)?;
    Spectra::open(path, header.offset, number, shape)
}

/// Opens an array and returns its header, the file behind the header, and the number of bytes left in it. Returns an
/// error for a missing file, or one that is no array.
fn open_array(path: &Path) -> Result<(Header, File, u64)> {
    let refuse = |e| Error::read(path, e);
    let mut file = files::open(path).map_err(refuse)?;
    let header = Header::read(path, &mut file)?;
    let length = file.metadata().map_err(refuse)?.len().saturating_sub(header.offset);
    Ok((header, file, length))
}

/// Reads transmitter positions, `[M,3]` in metres, from a file. Returns an error for a missing or damaged file, another
/// type or shape, or an invalid position.
pub(crate) fn read_positions(path: &Path) -> Result<Vec<[f64; 3]>> {
    let (header, mut file, length) = open_array(path)?;
    parse_positions(&header, path, &mut file, length)
}

/// Complex array `[M,A,F]`, row-major.
#[derive(Debug, PartialEq)]
pub(crate) struct ComplexArray {
    pub(crate) shape: [usize; 3],
    /// Real and imaginary parts.
    pub(crate) values: Vec<[f64; 2]>,
}

/// Reads the complex array of a file; `expected` describes its three dimensions in words.
///
/// # Errors
/// Another type, shape or order of the numbers, a truncated file, or a number that is not finite.
pub(crate) fn read_complex_array(path: &Path, expected: &str) -> Result<ComplexArray> {
    let (header, mut file, length) = open_array(path)?;
    let refuse = |problem: String| Error::input(path, problem);
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    let is_double = match header.descr.as_str() {
        "<c8" => false,
        "<c16" => true,
        other => {
            let advice = "channels are complex64 or complex128, little endian: save a.astype('<c8')";
            return Err(refuse(format!("holds numbers of type `{other}`; {advice}")));
        }
    };
    let Ok(shape) = <[usize; 3]>::try_from(header.shape.as_slice()) else {
        return Err(refuse(format!("has shape {}; {expected}; use a.reshape", header.shape_text())));
    };
    if header.fortran {
        return Err(refuse(format!("is in Fortran order; save numpy.ascontiguousarray({name})")));
    }
    if shape.contains(&0) {
        return Err(refuse(format!("has shape {} and is empty; {expected}", header.shape_text())));
    }
    let number_bytes = if is_double { 16_u64 } else { 8 };
    if header.shape.iter().try_fold(number_bytes, |bytes, n| bytes.checked_mul(*n as u64)) != Some(length) {
        let problem = "do not fit its length; the file is truncated or damaged: copy it again";
        return Err(refuse(format!("numbers of shape {} {problem}", header.shape_text())));
    }
    if length > MAX_BYTES {
        return Err(refuse(format!("holds {length} bytes, more than {MAX_BYTES}; give fewer channels")));
    }
    let mut bytes = vec![0; length as usize];
    file.read_exact(&mut bytes).map_err(|e| Error::read(path, e))?;
    let single = |b: &[u8; 4]| f64::from(f32::from_le_bytes(*b));
    let parts: Vec<f64> = if is_double {
        bytes.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect()
    } else {
        bytes.as_chunks().0.iter().map(single).collect()
    };
    let array = ComplexArray { shape, values: parts.as_chunks().0.to_vec() };
    if let Some(i) = parts.iter().position(|v| !(*v as Real).is_finite()) {
        let [re, im] = array.values[i / 2];
        return Err(refuse(format!("{} is {:?}; give finite numbers", array.element_name(path, i / 2), (re, im))));
    }
    Ok(array)
}

impl ComplexArray {
    /// Returns an error for numbers that are too large to compute with.
    pub(crate) fn check_size(&self, path: &Path) -> Result<()> {
        let mut faults = self.values.iter().map(|gain| gain_fault(*gain)).enumerate();
        match faults.find_map(|(i, fault)| Some((i, fault?))) {
            Some((i, fault)) => Err(Error::input(path, format!("{} {fault}", self.element_name(path, i)))),
            None => Ok(()),
        }
    }

    /// Returns the name and index of number `i` in Python notation.
    fn element_name(&self, path: &Path, i: usize) -> String {
        let [_, a, f] = self.shape;
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        format!("{name}[{}, {}, {}]", i / (a * f), i / f % a, i % f)
    }

    /// Divides all numbers by the largest modulus of the rows `train`, or of all rows. Returns an error if it is zero.
    pub(crate) fn normalise(&mut self, path: &Path, train: Option<&[usize]>) -> Result<()> {
        let largest_in = |values: &[[f64; 2]]| values.iter().map(|[re, im]| re.hypot(*im)).fold(0.0, f64::max);
        let [_, antennas, frequencies] = self.shape;
        let row = |&i: &usize| largest_in(&self.values[i * antennas * frequencies..][..antennas * frequencies]);
        let largest = train.map_or_else(|| largest_in(&self.values), |rows| rows.iter().map(row).fold(0.0, f64::max));
        if largest == 0.0 {
            let part = if train.is_some() { "in its training part" } else { "throughout" };
            return Err(Error::input(path, format!("is zero {part}; give channels that were measured")));
        }
        self.values.iter_mut().flatten().for_each(|v| *v /= largest);
        Ok(())
    }
}
