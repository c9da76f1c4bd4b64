//! The folder of a prediction: never taken from somebody else, never an earlier one overwritten.
//!
//! `.predictions.partial` stands in it while a prediction is under way, and says of how many positions; `predictions.csv`
//! comes last, and says that all is there. So a killed command can be given again, and what it left is known by name.

use image::{ExtendedColorType, ImageEncoder as _, codecs::png::PngEncoder};
use pwrfgs::data::{npy_header, npy_header_as};
use pwrfgs_core::files::{read_text, refuse_foreign, write_atomically};
use pwrfgs_core::{Error, Image, Number, Real, Result};
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

/// Rows of the positions, written when everything else is.
pub(super) const LIST: &str = "predictions.csv";
const PARTIAL: &str = ".predictions.partial";
/// What NumPy calls pairs of 32-bit numbers.
const COMPLEX: &str = "<c8";
/// What the pictures of an ensemble's disagreement are called besides their row.
pub(super) const SPREAD: &str = "-spread";
/// Everything in one array, and all disagreements.
const STACKS: [&str; 3] = ["spectra.npy", "channels.npy", "spread.npy"];

/// A folder that is being filled.
pub(super) struct Folder<'a> {
    path: &'a Path,
    has_png: bool,
}

impl<'a> Folder<'a> {
    /// Takes `path` for a prediction of `count` positions.
    ///
    /// # Errors
    /// Where it holds anything but what a killed prediction left.
    pub(super) fn claim(path: &'a Path, count: usize, has_png: bool) -> Result<Self> {
        if path.join(LIST).symlink_metadata().is_ok() {
            let why = format!("{} holds a prediction already; choose another --out, or remove it", path.display());
            return Err(Error::Config(why));
        }
        match read_text(&path.join(PARTIAL)).ok().and_then(|text| text.trim().parse().ok()) {
            Some(earlier) => remove_leftovers(path, earlier)?,
            None => refuse_foreign(path, "a folder of predictions")?,
        }
        std::fs::create_dir_all(path).map_err(|e| Error::write(path, e))?;
        write_atomically(&path.join(PARTIAL), format!("{count}\n").as_bytes())?;
        Ok(Self { path, has_png })
    }

    /// Writes the list, which says that all is there.
    pub(super) fn finish(self, list: &str) -> Result<()> {
        write_atomically(&self.path.join(LIST), list.as_bytes())?;
        let partial = self.path.join(PARTIAL);
        std::fs::remove_file(&partial).map_err(|e| Error::write(&partial, e))
    }

    /// `NAME.npy` (as it is), where it is not stacked.
    pub(super) fn array(&self, name: &str, image: &Image) -> Result<()> {
        let path = self.path.join(format!("{name}.npy"));
        let mut npy = npy_header(Number::F32, &[image.height, image.width]);
        npy.extend(floats(image));
        put(&path, &npy)
    }

    /// `NAME.npy` of complex gains `[A, F]`.
    pub(super) fn gains(&self, name: &str, shape: [usize; 2], gains: &[[Real; 2]]) -> Result<()> {
        let mut npy = npy_header_as(COMPLEX, &shape);
        npy.extend(pairs(gains));
        put(&self.path.join(format!("{name}.npy")), &npy)
    }

    /// `NAME.png` (times `gain`, clamped to [0, 1]), where pictures are wanted.
    pub(super) fn picture(&self, name: &str, image: &Image, gain: Real) -> Result<()> {
        if !self.has_png {
            return Ok(());
        }
        let (path, mut png) = (self.path.join(format!("{name}.png")), Vec::new());
        let shown = Image { pixels: image.pixels.iter().map(|p| gain * p).collect(), ..*image };
        PngEncoder::new(&mut png)
            .write_image(&shown.to_bytes(), image.width as u32, image.height as u32, ExtendedColorType::L8)
            .map_err(|e| Error::write(&path, std::io::Error::other(e)))?;
        put(&path, &png)
    }
}

pub(super) fn name(row: usize) -> String {
    format!("{row:05}")
}

/// One array `[M, height, width]` of 32-bit or complex numbers, written row by row: it may be larger than memory.
pub(super) struct Stack {
    path: PathBuf,
    beside: PathBuf,
    file: BufWriter<File>,
}

impl Stack {
    /// Of pictures.
    pub(super) fn floats(folder: &Folder<'_>, name: &str, shape: [usize; 3]) -> Result<Self> {
        Self::create(folder, name, &npy_header(Number::F32, &shape))
    }

    /// Of channels.
    pub(super) fn complex(folder: &Folder<'_>, name: &str, shape: [usize; 3]) -> Result<Self> {
        Self::create(folder, name, &npy_header_as(COMPLEX, &shape))
    }

    fn create(folder: &Folder<'_>, name: &str, header: &[u8]) -> Result<Self> {
        let path = folder.path.join(name);
        let beside = path.with_added_extension("tmp");
        let file = File::create(&beside).map_err(|e| Error::write(&path, e))?;
        let mut stack = Self { path, beside, file: BufWriter::new(file) };
        stack.write(header)?;
        Ok(stack)
    }

    /// The next picture.
    pub(super) fn push_floats(&mut self, image: &Image) -> Result<()> {
        self.write(&floats(image).collect::<Vec<u8>>())
    }

    /// The next channel.
    pub(super) fn push_complex(&mut self, gains: &[[Real; 2]]) -> Result<()> {
        self.write(&pairs(gains).collect::<Vec<u8>>())
    }

    /// All is there.
    pub(super) fn finish(self) -> Result<()> {
        let Self { path, beside, file } = self;
        let file = file.into_inner().map_err(|e| Error::write(&path, e.into_error()))?;
        let renamed = file.sync_all().and_then(|()| std::fs::rename(&beside, &path));
        renamed.map_err(|e| Error::write(&path, e))
    }

    fn write(&mut self, bytes: &[u8]) -> Result<()> {
        self.file.write_all(bytes).map_err(|e| Error::write(&self.path, e))
    }
}

/// Removes what a killed prediction of `count` positions left; refuses where anything else is there.
fn remove_leftovers(folder: &Path, count: usize) -> Result<()> {
    let found = std::fs::read_dir(folder).map_err(|e| Error::read(folder, e))?;
    let found: BTreeSet<PathBuf> = found.flatten().map(|entry| entry.path()).collect();
    if let Some(foreign) = found.iter().find(|path| !is_own(path, count)) {
        return Err(Error::Config(format!(
            "{} holds a prediction that was stopped, and `{}`, which is none of it; choose another --out",
            folder.display(),
            foreign.file_name().unwrap_or_default().to_string_lossy()
        )));
    }
    found.iter().try_for_each(|path| std::fs::remove_file(path).map_err(|e| Error::write(path, e)))
}

/// Whether a prediction of `count` positions writes a file of this name; `.tmp` is added while it is written.
fn is_own(path: &Path, count: usize) -> bool {
    let Some(file) = path.file_name().and_then(|name| name.to_str()) else { return false };
    let is_ours = |temporary: &str| [LIST, PARTIAL].iter().any(|own| temporary.starts_with(&format!(".{own}.")));
    let file = match file.strip_suffix(".tmp") {
        Some(temporary) if is_ours(temporary) => return true,
        Some(rest) => rest,
        None => file,
    };
    if file == PARTIAL || STACKS.contains(&file) {
        return true;
    }
    let stem = file.strip_suffix(".npy").or_else(|| file.strip_suffix(".png")).unwrap_or_default();
    let stem = stem.strip_suffix(SPREAD).unwrap_or(stem);
    stem.parse().is_ok_and(|row: usize| (1..=count).contains(&row) && name(row) == stem)
}

/// The pixels as 32-bit numbers.
fn floats(image: &Image) -> impl Iterator<Item = u8> {
    image.pixels.iter().flat_map(|p| (*p as f32).to_le_bytes())
}

/// Complex numbers of 32 bits a part.
fn pairs(gains: &[[Real; 2]]) -> impl Iterator<Item = u8> {
    gains.as_flattened().iter().flat_map(|v| (*v as f32).to_le_bytes())
}

/// Writes beside and renames: a file is whole or absent. Not synced, since the command can be given again.
fn put(path: &Path, bytes: &[u8]) -> Result<()> {
    let beside = path.with_added_extension("tmp");
    std::fs::write(&beside, bytes).and_then(|()| std::fs::rename(&beside, path)).map_err(|e| {
        _ = std::fs::remove_file(&beside);
        Error::write(path, e)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_a_prediction_writes_is_its_own() {
        for own in ["00001.png", "00012-spread.npy", "00003.npy.tmp", "spectra.npy", ".predictions.csv.77.tmp"] {
            assert!(is_own(Path::new(own), 12), "{own}");
        }
        for other in ["00013.png", "1.png", "00001.jpg", "20240101.png", "notes.tmp", "00001-spread-x.npy"] {
            assert!(!is_own(Path::new(other), 12), "{other}");
        }
    }
}
