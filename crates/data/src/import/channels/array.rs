//! Arrays of channels with named axes.

use crate::import::source::{OpenArray, extension, read_array_file};
use crate::npy::{NumberReader, check_gain_memory};
use pwrfgs_core::npy::Header;
use pwrfgs_core::{Error, Real, Result};
use std::path::Path;

const AXES: &str = "--axes names every axis once, in order: m (positions), a (antennas), f (subcarriers), and of real \
                    arrays ri or ir (length 2: real and imaginary part, or imaginary part first), such as \
                    --axes m,a,f,ri; save pairs in one row with a.reshape(len(a), -1, 2)";

/// Numbers of a file of channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    /// Both parts, or real numbers.
    Whole,
    /// Real parts.
    Real,
    /// Imaginary parts of the real parts `[M,A,F]` that were read last.
    Imaginary([usize; 3]),
}

/// Axis of an array.
struct Axis {
    /// Index of the next number.
    index: usize,
    length: usize,
    /// Distance of neighbours in the list of gains, in numbers.
    step: usize,
}

/// Position of the next number of a file in the list of gains.
struct Cursor {
    at: usize,
    /// Axes of the file, the one that varies fastest first.
    axes: Vec<Axis>,
}

impl Cursor {
    /// Creates a cursor at `at` from the names and lengths of the axes, the one that varies fastest first, for gains `[M,A,F]` of
    /// this size.
    fn new(at: usize, axes: &[(&str, usize)], [_, a, f]: [usize; 3]) -> Self {
        let step = |name: &str| match name {
            "m" => 2 * a * f,
            "a" => 2 * f,
            "f" => 2,
            "ri" => 1,
            _ => usize::MAX, // -1: the first part of `ir` is the second of a gain
        };
        let axes = axes.iter().map(|&(name, length)| Axis { index: 0, length, step: step(name) }).collect();
        Self { at, axes }
    }

    /// Moves to the position of the following number.
    fn advance(&mut self) {
        for Axis { index, length, step } in &mut self.axes {
            (*index, self.at) = (*index + 1, self.at.wrapping_add(*step));
            if *index < *length {
                break;
            }
            self.at = self.at.wrapping_sub(step.wrapping_mul(*length));
            *index = 0;
        }
    }
}

impl Part {
    /// Appends the gains of a file to `gains`, row-major, and returns M, A and F; writes imaginary parts into the gains that
    /// were read last. `names` are those of the axes of the file, such as `m,a,f`. Returns an error for a file that is no
    /// array, names that do not fit the axes, or imaginary parts that do not fit the real ones.
    pub(super) fn read(self, path: &Path, names: &str, gains: &mut Vec<[Real; 2]>) -> Result<[usize; 3]> {
        if extension(path) == "mat" {
            let (mat, npy) = (path.display(), path.with_extension("npy"));
            let line = "import numpy, scipy.io; numpy.save";
            let advice = format!("{line}('{}', scipy.io.loadmat('{mat}')['NAME'])", npy.display());
            return Err(Error::input(path, format!("is a MATLAB file; convert it in Python: {advice}")));
        }
        let usual = match self {
            Self::Whole => "channels",
            Self::Real => "real",
            Self::Imaginary(_) => "imag",
        };
        read_array_file(path, usual, "channels are an array .npy or an archive .npz", |array| {
            self.read_array(array, names, gains)
        })
    }

    /// Appends the gains of an open array. Arguments, result and errors as of [`Self::read`].
    fn read_array(self, array: OpenArray<'_>, names: &str, gains: &mut Vec<[Real; 2]>) -> Result<[usize; 3]> {
        let OpenArray { path, file, length } = array;
        let header = Header::read(path, file)?;
        let numbers = NumberReader::begin(&header, path, length.saturating_sub(header.offset))?;
        if numbers.count == 0 {
            return Err(Error::input(path, format!("has shape {} and is empty", header.shape_text())));
        }
        let is_complex = header.descr.contains('c');
        if self != Self::Whole && is_complex {
            return Err(Error::input(path, "holds complex numbers; give real arrays of one shape, or remove --imag"));
        }
        let axes = self.axes(path, &header, names)?;
        let length = |name: &str| axes.iter().find(|axis| axis.0 == name).map_or(1, |axis| axis.1);
        let size @ [m, a, f] = ["m", "a", "f"].map(length);
        let mut at = 2 * gains.len();
        if let Self::Imaginary(real) = self {
            if size != real {
                let problem = format!("has shape {}, unlike the real parts", header.shape_text());
                return Err(Error::input(path, format!("{problem}; give real arrays of one shape")));
            }
            at = at + 1 - 2 * m * a * f; // imaginary part of the first gain read last
        } else {
            let count = gains.len() + m * a * f;
            check_gain_memory(path, count)?;
            gains.reserve_exact(m * a * f);
            gains.resize(count, [0.0; 2]);
        }
        at += usize::from(axes.iter().any(|axis| axis.0 == "ir"));
        let (mut cursor, gains) = (Cursor::new(at, &axes, size), gains.as_flattened_mut());
        numbers.read(file, |piece| {
            for value in piece {
                gains[cursor.at] = *value as Real;
                cursor.advance();
            }
        })?;
        Ok(size)
    }

    /// Returns the names and lengths of the axes, the one that varies fastest first; the parts of complex numbers are an axis.
    /// Returns an error for `names` that do not fit.
    fn axes<'n>(self, path: &Path, header: &Header, names: &'n str) -> Result<Vec<(&'n str, usize)>> {
        let is_complex = header.descr.contains('c');
        let names: Vec<&str> = names.split(',').map(str::trim).collect();
        let is_valid = |(k, name): (usize, &&str)| match *name {
            "m" | "a" | "f" => !names[..k].contains(name),
            "ri" | "ir" if self == Self::Whole && !is_complex => {
                header.shape[k] == 2 && !names[..k].iter().any(|name| name.len() == 2)
            }
            _ => false,
        };
        if names.len() != header.shape.len() || !names.iter().enumerate().all(is_valid) {
            let number = if is_complex { "complex" } else { "real" };
            return Err(Error::input(path, format!("has {number} numbers of shape {}; {AXES}", header.shape_text())));
        }
        let parts = is_complex.then_some(("ri", 2));
        Ok(parts.into_iter().chain(header.fastest_first().into_iter().map(|k| (names[k], header.shape[k]))).collect())
    }
}
