//! Arrays of channels with named axes.

use crate::import::source::{extension, read_array_file};
use crate::npy::parse_numbers;
use pwrfgs_core::npy::Header;
use pwrfgs_core::{Error, Result};
use std::path::{Path, PathBuf};

const AXES: &str = "--axes names every axis once, in order: m (positions), a (antennas), f (subcarriers), and of real arrays ri or \
                    ir (length 2: real and imaginary part, or imaginary part first), such as --axes m,a,f,ri; save pairs in one row with \
                    a.reshape(len(a), -1, 2)";

/// Array of any number of axes; of complex numbers, the last axis has real and imaginary part.
pub(super) struct ChannelArray {
    /// Path for messages.
    path: PathBuf,
    /// Lengths of the axes, and distances of their elements in `values`.
    axes: Vec<(usize, usize)>,
    is_complex: bool,
    values: Vec<f64>,
}

impl ChannelArray {
    /// Reads the array of a file; `usual` is its name in an archive.
    pub(super) fn read(path: &Path, usual: &str) -> Result<Self> {
        if extension(path) == "mat" {
            let (mat, npy) = (path.display(), path.with_extension("npy"));
            let line = "import numpy, scipy.io; numpy.save";
            let advice = format!("{line}('{}', scipy.io.loadmat('{mat}')['NAME'])", npy.display());
            return Err(Error::input(path, format!("is a MATLAB file; convert it in Python: {advice}")));
        }
        read_array_file(path, usual, "channels are an array .npy or an archive .npz", |path, file, bytes| {
            let header = Header::read(path, file)?;
            let values = parse_numbers(&header, path, file, bytes.saturating_sub(header.offset))?;
            if values.is_empty() {
                return Err(Error::input(path, format!("has shape {} and is empty", header.shape_text())));
            }
            let is_complex = header.descr.contains('c');
            let mut axes: Vec<(usize, usize)> = header.shape.iter().map(|n| (*n, 0)).collect();
            let mut step = 1 + usize::from(is_complex);
            for k in header.fastest_first() {
                axes[k].1 = step;
                step *= axes[k].0;
            }
            axes.extend(is_complex.then_some((2, 1)));
            Ok(Self { path: path.to_owned(), axes, is_complex, values })
        })
    }

    /// Returns the complex array of these real parts and `imaginary` parts. Returns an error unless both are real, of one
    /// shape and in one order.
    pub(super) fn with_imaginary(self, imaginary: Self) -> Result<Self> {
        if self.is_complex || imaginary.is_complex || self.axes != imaginary.axes {
            let advice = "give real arrays of one shape and order for real and imaginary parts";
            return Err(Error::input(&imaginary.path, format!("does not fit {}; {advice}", self.path.display())));
        }
        let doubled = self.axes.into_iter().map(|(length, stride)| (length, 2 * stride));
        let axes = doubled.chain([(2, 1)]).collect();
        let values = self.values.into_iter().zip(imaginary.values).flat_map(|(re, im)| [re, im]).collect();
        Ok(Self { path: self.path, axes, is_complex: true, values })
    }

    /// Appends the gains `[M,A,F]` to `gains`, row-major, and returns M, A and F; `names` are those of the axes, such as
    /// `m,a,f`. Returns an error for names that do not fit the axes.
    pub(super) fn append_to(&self, gains: &mut Vec<[f64; 2]>, names: &str) -> Result<[usize; 3]> {
        let names: Vec<&str> = names.split(',').map(str::trim).chain(self.is_complex.then_some("ri")).collect();
        let is_valid = |(k, name): (usize, &&str)| match *name {
            "m" | "a" | "f" => !names[..k].contains(name),
            "ri" | "ir" => self.axes[k].0 == 2 && !names[..k].iter().any(|name| name.len() == 2),
            _ => false,
        };
        if names.len() != self.axes.len() || !names.iter().enumerate().all(is_valid) {
            let named = self.axes.len() - usize::from(self.is_complex);
            let shape: Vec<usize> = self.axes[..named].iter().map(|(length, _)| *length).collect();
            let number = if self.is_complex { "complex" } else { "real" };
            return Err(Error::input(&self.path, format!("has {number} numbers of shape {shape:?}; {AXES}")));
        }
        let find = |axis: &str| names.iter().position(|name| *name == axis).map_or((1, 0), |k| self.axes[k]);
        let [(m, dm), (a, da), (f, df), (_, re_first), (_, im_first)] = ["m", "a", "f", "ri", "ir"].map(find);
        let is_real = re_first + im_first == 0;
        let cells = (0..m).flat_map(|m| (0..a).flat_map(move |a| (0..f).map(move |f| m * dm + a * da + f * df)));
        let im = |at: usize| if is_real { 0.0 } else { self.values[at + re_first] };
        gains.extend(cells.map(|at| [self.values[at + im_first], im(at)]));
        Ok([m, a, f])
    }
}
