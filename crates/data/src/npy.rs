//! NumPy arrays of spectra, positions and channels. The header is validated against the file length before data are
//! read.

use pwrfgs_core::npy::Header;
use pwrfgs_core::{Error, Number, Real, Result, Spectra, check_memory, files, gain_fault, position_fault};
use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::path::Path;

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
    number.for_each_value(&bytes, |v| {
        let (i, k) = if header.fortran { (done % count, done / count) } else { (done / 3, done % 3) };
        positions[i][k] = v;
        done += 1;
    });
    match positions.iter().enumerate().find_map(|(i, position)| Some((i, position_fault(*position)?))) {
        Some((i, fault)) => refuse(format!("tx[{i}] {fault}")),
        None => Ok(positions),
    }
}

/// Returns an error unless `file` ends here. An entry of an archive compares its checksum when this end is read.
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

/// Opens an array and returns its header, the file at the end of the header, and the number of bytes left in it. Returns an
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
    pub(crate) values: Vec<[Real; 2]>,
}

/// Reads the complex array of a file; `expected` describes its three dimensions in words.
///
/// # Errors
/// Another type, shape or order of the numbers, a truncated file, or a number that is not finite.
pub(crate) fn read_complex_array(path: &Path, expected: &str) -> Result<ComplexArray> {
    let file = ComplexFile::open(path, expected)?;
    Ok(ComplexArray { shape: file.shape, values: read_all(vec![file])? })
}

/// Reads all arrays, at least one, as one list. Returns an error if they do not fit into memory, or for a number that is not
/// finite.
pub(crate) fn read_all(files: Vec<ComplexFile<'_>>) -> Result<Vec<[Real; 2]>> {
    let count = files.iter().map(ComplexFile::count).sum();
    check_gain_memory(files[0].path, count)?;
    let mut values = Vec::with_capacity(count); // growing the list would copy it
    files.into_iter().try_for_each(|file| file.read(&mut values))?;
    Ok(values)
}

/// Open file of a complex array whose header is valid.
pub(crate) struct ComplexFile<'a> {
    pub(crate) path: &'a Path,
    header: Header,
    file: File,
    /// Number of bytes after the header.
    length: u64,
    pub(crate) shape: [usize; 3],
}

impl<'a> ComplexFile<'a> {
    /// Opens the array of a file. Returns the errors of [`read_complex_array`], except for those of the numbers.
    pub(crate) fn open(path: &'a Path, expected: &str) -> Result<Self> {
        let (header, file, length) = open_array(path)?;
        let refuse = |problem: String| Error::input(path, problem);
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        if !matches!(header.descr.as_str(), "<c8" | "<c16") {
            if header.descr.contains(['f', 'i', 'u']) {
                return Err(refuse(real_channels_fault(&header.shape)));
            }
            let advice = "channels are complex64 or complex128, little endian: save a.astype('<c8')";
            return Err(refuse(format!("holds numbers of type `{}`; {advice}", header.descr)));
        }
        let Ok(shape) = <[usize; 3]>::try_from(header.shape.as_slice()) else {
            return Err(refuse(format!("has shape {}; {expected}; use a.reshape", header.shape_text())));
        };
        if header.fortran {
            return Err(refuse(format!("is in Fortran order; save numpy.ascontiguousarray({name})")));
        }
        if shape.contains(&0) {
            return Err(refuse(format!("has shape {} and is empty; {expected}", header.shape_text())));
        }
        NumberReader::begin(&header, path, length)?;
        Ok(Self { path, header, file, length, shape })
    }

    /// Returns the number of gains.
    pub(crate) fn count(&self) -> usize {
        self.shape.iter().product()
    }

    /// Appends the numbers to `values`. Returns the errors of [`NumberReader::read`].
    fn read(mut self, values: &mut Vec<[Real; 2]>) -> Result<()> {
        NumberReader::begin(&self.header, self.path, self.length)?.read(&mut self.file, |piece| {
            values.extend(piece.as_chunks().0.iter().map(|gain: &[f64; 2]| gain.map(|v| v as Real)));
        })
    }
}

/// Returns an error for numbers of an array `[M,A,F]` that are too large to compute with; the message has the index of the
/// first.
pub(crate) fn check_magnitudes(path: &Path, shape: [usize; 3], values: &[[Real; 2]]) -> Result<()> {
    let mut faults = values.iter().map(|gain| gain_fault(gain.map(|v| v as f64))).enumerate();
    let fastest_first = [2, 1, 0]; // row-major
    match faults.find_map(|(i, fault)| Some((i, fault?))) {
        Some((i, fault)) => {
            Err(Error::input(path, format!("{} {fault}", element_name(path, &shape, &fastest_first, i))))
        }
        None => Ok(()),
    }
}

/// Rejects more gains than fit into memory.
pub(crate) fn check_gain_memory(path: &Path, count: usize) -> Result<()> {
    let bytes = size_of::<[Real; 2]>() as u64 * count as u64;
    check_memory(bytes, "give fewer positions, or split the file").map_err(|fault| Error::input(path, fault))
}

/// Returns the problem with channels of real numbers of this shape, with the next step.
pub fn real_channels_fault(shape: &[usize]) -> String {
    let pair = |parts: &str| {
        format!("holds real numbers in pairs; if these are real and imaginary parts, save {parts} as complex64")
    };
    match shape {
        [_, _, .., 2] => pair("a[..., 0] + 1j * a[..., 1]"),
        [2, _, _, _, ..] => pair("a[0] + 1j * a[1]"),
        _ => "holds real numbers; amplitudes and dB have no phase: use powers, \
              `pwrfgs import --channels FILE --powers ..`"
            .into(),
    }
}

/// Numbers of an array whose type and length were checked before the first is read. A complex number is two: real and
/// imaginary part.
#[derive(Debug)]
pub(crate) struct NumberReader<'a> {
    header: &'a Header,
    path: &'a Path,
    /// Type of a part without byte order, such as `f4`, its bytes, and the number of parts of a number.
    part: &'a str,
    bytes: usize,
    parts: usize,
    /// Number of parts in the array.
    pub(crate) count: usize,
}

impl<'a> NumberReader<'a> {
    /// Creates the reader of an array of `size` bytes after the header. Returns an error for another type or length.
    pub(crate) fn begin(header: &'a Header, path: &'a Path, size: u64) -> Result<Self> {
        let refuse = |problem: String| Err(Error::input(path, problem));
        let (parts, part) = match header.descr.get(1..).unwrap_or_default() {
            "c8" => (2, "f4"),
            "c16" => (2, "f8"),
            kind @ ("f4" | "f8" | "i1" | "i2" | "i4" | "u1" | "u2" | "u4") => (1, kind),
            _ => {
                let advice = "give complex numbers, floats of 32 or 64 bits, or integers: save a.astype('<c8') or \
                              a.astype('<f4')";
                return refuse(format!("holds numbers of type `{}`; {advice}", header.descr));
            }
        };
        let bytes = usize::from(part.as_bytes()[1] - b'0');
        if header.shape.iter().try_fold((parts * bytes) as u64, |all, n| all.checked_mul(*n as u64)) != Some(size) {
            let problem = "do not fit its length; the file is truncated or damaged: copy it again";
            return refuse(format!("numbers of shape {} {problem}", header.shape_text()));
        }
        let count = size as usize / bytes;
        Ok(Self { header, path, part, bytes, parts, count })
    }

    /// Reads the numbers from `file`, in its order. `take` gets pieces of them, so that they are not in memory twice; of complex
    /// numbers, real and imaginary parts in turn. Returns an error for a truncated file, or a number that is not finite.
    pub(crate) fn read(self, file: &mut dyn Read, mut take: impl FnMut(&[f64])) -> Result<()> {
        /// Number of parts that are read at a time; even, so that a piece holds whole complex numbers.
        const PIECE: usize = 1 << 16;
        let Self { header, path, part, bytes, parts, count } = self;
        let is_big_endian = header.descr.starts_with('>');
        let number = |raw: &[u8]| {
            let mut word = [0; 8];
            word[..bytes].copy_from_slice(raw);
            if is_big_endian {
                word[..bytes].reverse();
            }
            let word = u64::from_le_bytes(word);
            let unused = 64 - 8 * bytes;
            match part {
                "f4" => f64::from(f32::from_bits(word as u32)),
                "f8" => f64::from_bits(word),
                // The shifts extend the sign.
                _ if part.starts_with('i') => ((word << unused).cast_signed() >> unused) as f64,
                _ => word as f64,
            }
        };
        let (mut content, mut numbers) = (vec![0; PIECE * bytes], Vec::with_capacity(PIECE));
        for start in (0..count).step_by(PIECE) {
            let content = &mut content[..PIECE.min(count - start) * bytes];
            file.read_exact(content).map_err(|e| Error::read(path, e))?;
            numbers.clear();
            numbers.extend(content.chunks_exact(bytes).map(number));
            if let Some(i) = numbers.iter().position(|v| !(*v as Real).is_finite()) {
                let value = &numbers[i / parts * parts..][..parts];
                let value = if let [re, im] = value { format!("{:?}", (re, im)) } else { format!("{:?}", value[0]) };
                let name = element_name(path, &header.shape, &header.fastest_first(), (start + i) / parts);
                return Err(Error::input(path, format!("{name} is {value}; give finite numbers")));
            }
            take(&numbers);
        }
        check_end(file).map_err(|e| Error::read(path, e))
    }
}

/// Returns the name and index of number `i` in the order of the file, in Python notation.
fn element_name(path: &Path, shape: &[usize], fastest_first: &[usize], mut i: usize) -> String {
    let mut index = vec![0; shape.len()];
    for &k in fastest_first {
        index[k] = i % shape[k];
        i /= shape[k];
    }
    format!("{}{index:?}", path.file_stem().unwrap_or_default().to_string_lossy())
}

impl ComplexArray {
    /// Divides all numbers by the largest modulus of the rows `train`, or of all rows. Returns an error if it is zero.
    pub(crate) fn normalise(&mut self, path: &Path, train: Option<&[usize]>) -> Result<()> {
        let modulus = |gain: &[Real; 2]| (gain[0] as f64).hypot(gain[1] as f64);
        let largest_in = |values: &[[Real; 2]]| values.iter().map(modulus).fold(0.0, f64::max);
        let [_, antennas, frequencies] = self.shape;
        let row = |&i: &usize| largest_in(&self.values[i * antennas * frequencies..][..antennas * frequencies]);
        let largest = train.map_or_else(|| largest_in(&self.values), |rows| rows.iter().map(row).fold(0.0, f64::max));
        if largest == 0.0 {
            let part = if train.is_some() { "in its training part" } else { "throughout" };
            return Err(Error::input(path, format!("is zero {part}; give channels that were measured")));
        }
        self.values.iter_mut().flatten().for_each(|v| *v = (*v as f64 / largest) as Real);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::npy_header_as;
    use std::fs::{self, File};

    #[test]
    fn large_channels_are_rejected_by_the_memory_they_need() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("channel.npy");
        let positions = 1 << 30;
        let header = npy_header_as("<c8", &[positions, 16, 64]);
        fs::write(&path, &header).unwrap();
        File::options().write(true).open(&path).unwrap().set_len((header.len() + (positions << 13)) as u64).unwrap();
        let message = read_complex_array(&path, "").unwrap_err().to_string();
        let needed = if size_of::<Real>() == 4 { "8796.1" } else { "17592.2" };
        assert!(message.contains(&format!("channel.npy: needs {needed} GB of memory, more than the ")), "{message}");
        assert!(message.ends_with(" GB that are available; give fewer positions, or split the file"), "{message}");
    }
}
