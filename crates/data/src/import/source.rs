//! Readers of positions and spectra: NumPy arrays and archives, tables, folders of images.

use super::Sink;
use crate::colormap::Colormap;
use crate::nerf2::read_transmitters;
use crate::npy;
use crate::pictures::{self, Depth};
use pwrfgs_core::npy::Header;
use pwrfgs_core::{Error, Number, Result, did_you_mean, files};
use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use zip::ZipArchive;

/// Supported formats of spectra.
const SPECTRA: &str = "spectra are an array .npy, an archive .npz, or a folder of images 00001.png ..";

/// Reads transmitter positions `[M,3]`, metres, from an array, archive or table. If `with_spectra`, they are an array in the
/// archive of the spectra. Returns an error for an invalid file, or if there are none.
pub(super) fn read_positions(path: &Path, with_spectra: bool) -> Result<Vec<[f64; 3]>> {
    let (file, name) = split_array_name(path);
    let txs = match extension(&file) {
        "npz" => {
            read_archive(&file, if with_spectra { None } else { name }, "tx", |OpenArray { path, file, length }| {
                let header = Header::read(path, file)?;
                npy::parse_positions(&header, path, file, length.saturating_sub(header.offset))
            })
        }
        _ if with_spectra => {
            let advice = "name the transmitters with --tx: an array .npy [M, 3], or a table .csv with columns x, y, z";
            return Err(Error::Config(advice.into()));
        }
        "npy" => npy::read_positions(path),
        "csv" | "txt" => read_transmitters(path),
        _ => Err(Error::input(path, "positions are an array .npy, an archive .npz, or a table .csv")),
    }?;
    if txs.is_empty() {
        return Err(Error::input(path, "holds no position; give one per spectrum"));
    }
    Ok(txs)
}

/// Passes all spectra to `sink`; images have colours of `map`, if any. Returns an error unless their number equals the
/// `count` of transmitters.
pub(super) fn read_spectra(path: &Path, count: usize, map: Option<Colormap>, sink: &mut Sink<'_>) -> Result<()> {
    if path.is_dir() {
        return read_images(path, count, map, sink);
    }
    if map.is_some() {
        return Err(Error::input(path, "has numbers, not colours; remove --colormap"));
    }
    read_array_file(path, "spectra", SPECTRA, |array| read_array(array, count, sink))
}

/// Open array: a file, or an entry of an archive.
pub(super) struct OpenArray<'a> {
    /// Path in messages: `FILE.npz:NAME` in an archive.
    pub(super) path: &'a Path,
    /// Bytes from the header on.
    pub(super) file: &'a mut dyn Read,
    /// Number of bytes, header included.
    pub(super) length: u64,
}

/// Returns the result of `read` on an array `.npy`, or on one of an archive `.npz`, as [`read_archive`] does. Returns an error
/// with the `expected` formats for another file.
pub(super) fn read_array_file<T>(
    path: &Path,
    usual: &str,
    expected: &str,
    read: impl FnOnce(OpenArray<'_>) -> Result<T>,
) -> Result<T> {
    let (file, name) = split_array_name(path);
    match extension(&file) {
        "npz" => read_archive(&file, name, usual, read),
        "npy" => {
            let refuse = |e| Error::read(&file, e);
            let opened = files::open(&file).map_err(refuse)?;
            let length = opened.metadata().map_err(refuse)?.len();
            read(OpenArray { path: &file, file: &mut BufReader::with_capacity(1 << 20, opened), length })
        }
        _ if !file.exists() => Err(Error::input(&file, format!("no such file or folder; {expected}"))),
        _ => Err(Error::input(&file, expected)),
    }
}

/// Passes the spectra of an array to `sink`. Returns an error unless their number is `count` and they fill the file.
fn read_array(OpenArray { path, file, length }: OpenArray<'_>, count: usize, sink: &mut Sink<'_>) -> Result<()> {
    let header = Header::read(path, file)?;
    let (number, shape) = npy::spectra_shape(&header, path)?;
    let [m, h, w] = shape;
    let refuse = |problem: String| Err(Error::input(path, format!("has shape [{m}, {h}, {w}]{problem}")));
    if m != count {
        let problem = format!(", so {m} spectra, and there are {count} transmitters; spectra are [M, H, W]");
        let advice = if w == count { "; save numpy.moveaxis(s, 2, 0)" } else { ": give as many of each" };
        return refuse(problem + advice);
    }
    if header.bytes(number).and_then(|n| n.checked_add(header.offset)) != Some(length) || h * w == 0 {
        return refuse(format!(
            ", which does not fit its {length} bytes; the file is truncated or damaged: copy it again"
        ));
    }
    let (size, limit) = (h * w * number.bytes(), pictures::MAX_BYTES);
    if size as u64 > limit {
        return refuse(format!(", so {size} bytes per spectrum, more than {limit}; make the spectra smaller"));
    }
    sink.begin(path, shape, number)?;
    let mut spectrum = vec![0; size];
    for _ in 0..m {
        file.read_exact(&mut spectrum).map_err(|e| Error::read(path, e))?;
        sink.add_spectrum(&spectrum)?;
    }
    npy::check_end(file).map_err(|e| Error::read(path, e))
}

/// Passes the images `NNNNN.png` of a folder to `sink`: number k, counted from 1, is the spectrum of row k. Returns an error
/// unless there are `count` images of one size and depth.
fn read_images(path: &Path, count: usize, map: Option<Colormap>, sink: &mut Sink<'_>) -> Result<()> {
    let files = pictures::list_images(path, SPECTRA)?;
    let missing = (1..=count as u32).find(|id| !files.contains_key(id));
    if let Some(id) = missing {
        let problem = format!("holds no image {id:05}.png, but there are {count} transmitters");
        return Err(Error::input(path, format!("{problem}: image k belongs to row k")));
    }
    if files.len() > count {
        let problem = format!("holds {} images, but there are {count} transmitters", files.len());
        return Err(Error::input(path, format!("{problem}; give as many of each")));
    }
    let mut first: Option<((usize, usize), Number, String)> = None;
    for (_, file) in files {
        let image = pictures::decode_grey_png(&file, Depth::Sixteen, map)?;
        let size = (image.width, image.height);
        match &first {
            None => {
                sink.begin(&file, [count, size.1, size.0], image.number)?;
                let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
                first = Some((size, image.number, name));
            }
            Some((size, number, name)) => {
                image.check_size(&file, *size, name)?;
                if image.number != *number {
                    let problem = format!("has another depth than {name}; save all with 8 bits, or all with 16");
                    return Err(Error::input(&file, problem));
                }
            }
        }
        sink.add_spectrum(&image.bytes)?;
    }
    Ok(())
}

/// Returns the result of `read` on an array of an archive: the array `name`, else `usual`, else the only one. Returns an error
/// for a damaged archive, repeated names, or no such array.
fn read_archive<T>(
    path: &Path,
    name: Option<String>,
    usual: &str,
    read: impl FnOnce(OpenArray<'_>) -> Result<T>,
) -> Result<T> {
    let broken =
        |e: zip::result::ZipError| Error::input(path, format!("is not a NumPy archive ({e}); use numpy.savez"));
    let file: File = files::open(path).map_err(|e| Error::read(path, e))?;
    let mut archive = ZipArchive::new(BufReader::new(file)).map_err(broken)?;
    let names = archive.file_names().collect::<Result<Vec<_>, _>>().map_err(broken)?;
    let names: Vec<String> = names.iter().map(|n| n.strip_suffix(".npy").unwrap_or(n).to_owned()).collect();
    if archive.has_duplicate_names() || names.iter().collect::<BTreeSet<_>>().len() < names.len() {
        let problem = "holds two arrays of the same name (NumPy reads only the last); save each under its own name";
        return Err(Error::input(path, problem));
    }
    let name = match name {
        Some(name) => name,
        None if names.iter().any(|n| n == usual) || names.len() != 1 => usual.to_owned(),
        None => names[0].clone(),
    };
    if !names.contains(&name) {
        let hint = did_you_mean(&name, names.iter().map(String::as_str));
        let file = path.file_name().unwrap_or_default().display();
        let advice = format!("it holds {}: name one as {file}:NAME", names.join(", "));
        return Err(Error::input(path, format!("holds no array `{name}`{hint}; {advice}")));
    }
    let array_path = PathBuf::from(format!("{}:{name}", path.display()));
    let mut entry = archive.by_name(&format!("{name}.npy")).map_err(broken)?;
    let length = entry.size();
    read(OpenArray { path: &array_path, file: &mut entry, length }).map_err(|e| match e {
        Error::Read { source, .. } => {
            Error::input(&array_path, format!("is damaged ({source}); copy the archive again"))
        }
        other => other,
    })
}

/// Splits `FILE.npz:NAME` into file and array name; the name is `None` for other paths.
fn split_array_name(path: &Path) -> (PathBuf, Option<String>) {
    let text = path.to_string_lossy();
    match text.rsplit_once(".npz:") {
        Some((file, name)) if !path.exists() => (format!("{file}.npz").into(), Some(name.into())),
        _ => (path.into(), None),
    }
}

/// Returns the extension of a file, empty without one; all supported ones are lower case.
pub(super) fn extension(path: &Path) -> &str {
    path.extension().and_then(OsStr::to_str).unwrap_or_default()
}
