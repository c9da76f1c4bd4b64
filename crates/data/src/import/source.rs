//! Readers of positions and spectra: NumPy arrays and archives, tables, folders of images.

use super::Sink;
use crate::nerf2::pictures::{self, Depth};
use crate::nerf2::read_transmitters;
use crate::npy;
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

/// Reads transmitter positions `[M,3]`, metres. If `beside`, they are an array in the archive of the spectra.
pub(super) fn positions(path: &Path, beside: bool) -> Result<Vec<[f64; 3]>> {
    let (file, name) = named(path);
    let txs = match extension(&file) {
        "npz" => in_archive(&file, if beside { None } else { name }, "tx", |path, array, bytes| {
            let header = Header::read(path, array)?;
            npy::positions(&header, path, array, bytes.saturating_sub(header.offset))
        }),
        _ if beside => {
            let what = "name the transmitters with --tx: an array .npy [M, 3], or a table .csv with columns x, y, z";
            return Err(Error::Config(what.into()));
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

/// Passes all spectra to `sink`; their number must equal the `count` of transmitters.
pub(super) fn pictures(path: &Path, count: usize, sink: &mut Sink<'_>) -> Result<()> {
    let (file, name) = named(path);
    if file.is_dir() {
        return folder(&file, count, sink);
    }
    match extension(&file) {
        "npz" => in_archive(&file, name, "spectra", |path, array, bytes| each(path, array, bytes, count, sink)),
        "npy" => {
            let refuse = |e| Error::read(&file, e);
            let array = files::open(&file).map_err(refuse)?;
            let bytes = array.metadata().map_err(refuse)?.len();
            each(&file, &mut BufReader::with_capacity(1 << 20, array), bytes, count, sink)
        }
        _ if !file.exists() => Err(Error::input(&file, format!("no such file or folder; {SPECTRA}"))),
        _ => Err(Error::input(&file, SPECTRA)),
    }
}

/// Passes on the spectra of an array of `bytes` bytes, header included.
fn each(path: &Path, array: &mut dyn Read, bytes: u64, count: usize, sink: &mut Sink<'_>) -> Result<()> {
    let header = Header::read(path, array)?;
    let (number, shape) = npy::spectra(&header, path)?;
    let [m, h, w] = shape;
    let refuse = |what: String| Err(Error::input(path, format!("has shape [{m}, {h}, {w}]{what}")));
    if m != count {
        let what = format!(", so {m} spectra, and there are {count} transmitters; spectra are [M, H, W]");
        let advice = if w == count { "; save numpy.moveaxis(s, 2, 0)" } else { ": give as many of each" };
        return refuse(what + advice);
    }
    if header.bytes(number).and_then(|n| n.checked_add(header.offset)) != Some(bytes) || h * w == 0 {
        return refuse(format!(
            ", which does not fit its {bytes} bytes; the file is truncated or damaged: copy it again"
        ));
    }
    let of_one = h * w * number.bytes();
    if of_one as u64 > pictures::MAX_BYTES {
        let most = pictures::MAX_BYTES;
        return refuse(format!(", so {of_one} bytes per spectrum, more than {most}; make the spectra smaller"));
    }
    sink.begin(path, shape, number)?;
    let mut one = vec![0; of_one];
    for _ in 0..m {
        array.read_exact(&mut one).map_err(|e| Error::read(path, e))?;
        sink.add(&one)?;
    }
    npy::check_end(array).map_err(|e| Error::read(path, e))
}

/// Reads images `NNNNN.png` of a folder: number k, counted from 1, is the spectrum of row k.
fn folder(path: &Path, count: usize, sink: &mut Sink<'_>) -> Result<()> {
    let files = pictures::list(path, SPECTRA)?;
    let missing = (1..=count as u32).find(|id| !files.contains_key(id));
    if let Some(id) = missing {
        let what = format!("holds no image {id:05}.png, but there are {count} transmitters: image k belongs to row k");
        return Err(Error::input(path, what));
    }
    if files.len() > count {
        let what = format!("holds {} images, but there are {count} transmitters; give as many of each", files.len());
        return Err(Error::input(path, what));
    }
    let mut first: Option<((usize, usize), Number, String)> = None;
    for (_, file) in files {
        let picture = pictures::decode(&file, Depth::Sixteen)?;
        let size = (picture.width, picture.height);
        match &first {
            None => {
                sink.begin(&file, [count, size.1, size.0], picture.number)?;
                let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
                first = Some((size, picture.number, name));
            }
            Some((size, number, name)) => {
                picture.is_like(&file, *size, name)?;
                if picture.number != *number {
                    let what = format!("has another depth than {name}; save all with 8 bits, or all with 16");
                    return Err(Error::input(&file, what));
                }
            }
        }
        sink.add(&picture.bytes)?;
    }
    Ok(())
}

/// Reads an array of an archive: `name`, else `usual`, else the only one. `read` gets its bytes and length.
fn in_archive<T>(
    path: &Path,
    name: Option<String>,
    usual: &str,
    read: impl FnOnce(&Path, &mut dyn Read, u64) -> Result<T>,
) -> Result<T> {
    let broken =
        |e: zip::result::ZipError| Error::input(path, format!("is not a NumPy archive ({e}); use numpy.savez"));
    let file: File = files::open(path).map_err(|e| Error::read(path, e))?;
    let mut archive = ZipArchive::new(BufReader::new(file)).map_err(broken)?;
    let names = archive.file_names().collect::<Result<Vec<_>, _>>().map_err(broken)?;
    let names: Vec<String> = names.iter().map(|n| n.strip_suffix(".npy").unwrap_or(n).to_owned()).collect();
    if archive.has_duplicate_names() || names.iter().collect::<BTreeSet<_>>().len() < names.len() {
        let what = "holds two arrays of the same name (NumPy reads only the last); save each under its own name";
        return Err(Error::input(path, what));
    }
    let array_name = match name {
        Some(name) => name,
        None if names.iter().any(|n| n == usual) || names.len() != 1 => usual.to_owned(),
        None => names[0].clone(),
    };
    let Some(known) = names.iter().find(|n| **n == array_name) else {
        let hint = did_you_mean(&array_name, names.iter().map(String::as_str));
        let file = path.file_name().unwrap_or_default().display();
        let what =
            format!("holds no array `{array_name}`{hint}; it holds {}: name one as {file}:NAME", names.join(", "));
        return Err(Error::input(path, what));
    };
    let place = PathBuf::from(format!("{}:{known}", path.display()));
    let mut entry = archive.by_name(&format!("{known}.npy")).map_err(broken)?;
    let bytes = entry.size();
    read(&place, &mut entry, bytes).map_err(|e| match e {
        Error::Read { source, .. } => Error::input(&place, format!("is damaged ({source}); copy the archive again")),
        other => other,
    })
}

/// Splits `FILE.npz:NAME` into file and array name.
fn named(path: &Path) -> (PathBuf, Option<String>) {
    let text = path.to_string_lossy();
    match text.rsplit_once(".npz:") {
        Some((file, name)) if !path.exists() => (format!("{file}.npz").into(), Some(name.into())),
        _ => (path.into(), None),
    }
}

/// Extension; all supported ones are lower case.
fn extension(path: &Path) -> &str {
    path.extension().and_then(OsStr::to_str).unwrap_or_default()
}
