//! Atomic writes: through a locked temporary file `.NAME.NUMBER.tmp` in the same folder, which is then renamed.
//!
//! The lock ends with its process. The next write of the same name removes temporary files without a lock, which killed
//! processes left.

use super::held::lock_unused;
use super::{check_file_path, parent};
use crate::{Error, Result};
use std::fs::{self, File, TryLockError};
use std::hash::{BuildHasher as _, RandomState};
use std::io::{self, ErrorKind, Write as _};
use std::path::{Path, PathBuf};

/// Number of bytes of a file name that its temporary file repeats; file systems allow 255.
const LONGEST_NAME: usize = 200;

/// Rejects a path at which no new file can be created: as [`check_file_path`], and the path must not exist. Removes
/// temporary files that killed processes left for this path.
///
/// # Errors
/// [`Error::Config`] if the path exists, else as [`check_file_path`].
pub fn check_new_file(path: &Path) -> Result<()> {
    remove_temporaries(parent(path), &[&short_name(path)]);
    // Includes broken links, which may point anywhere.
    if path.symlink_metadata().is_ok() {
        return Err(exists_error(path));
    }
    check_file_path(path)
}

/// Creates the error for a path that exists.
fn exists_error(path: &Path) -> Error {
    Error::Config(format!("{} exists; choose another name or remove it", path.display()))
}

/// Writes a file atomically: readers see either the old or the complete new content. Uses a synced temporary file in
/// the same folder, which is then renamed.
///
/// # Errors
/// [`Error::Write`]; the old file is then unchanged.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<()> {
    replace(path, bytes).map(drop)
}

/// Writes a file as [`write_atomically`] does and returns it open. The file is locked before it gets its name; file
/// systems without locks are accepted.
///
/// # Errors
/// As [`write_atomically`].
pub fn replace(path: &Path, bytes: &[u8]) -> Result<File> {
    write_beside(path, bytes, |temporary| fs::rename(temporary, path)).map_err(|e| Error::write(path, e))
}

/// Writes a new file as [`write_new`] does.
///
/// # Errors
/// [`Error::Config`] if the path exists, even if it was free a moment ago; [`Error::Write`].
pub fn create(path: &Path, bytes: &[u8]) -> Result<()> {
    if write_new(path, bytes)? { Ok(()) } else { Err(exists_error(path)) }
}

/// Writes a new file atomically. Returns `false` if the path exists and leaves it unchanged: of several processes that
/// write the same file at once, one gets `true`. On file systems without hard links, others may read a part of the file.
///
/// # Errors
/// [`Error::Write`] if the file cannot be written.
pub fn write_new(path: &Path, bytes: &[u8]) -> Result<bool> {
    if path.symlink_metadata().is_ok() {
        return Ok(false);
    }
    let written = write_beside(path, bytes, |temporary| match fs::hard_link(temporary, path) {
        Ok(()) => {
            let _ = fs::remove_file(temporary); // otherwise the next write removes it
            Ok(())
        }
        // The file system has no links: the file is created first, and its content follows.
        Err(e) if [ErrorKind::PermissionDenied, ErrorKind::Unsupported].contains(&e.kind()) => {
            let mut file = File::create_new(path)?;
            let filled = file.write_all(bytes).and_then(|()| file.sync_all());
            let _ = fs::remove_file(if filled.is_ok() { temporary } else { path });
            filled
        }
        Err(e) => Err(e),
    });
    match written {
        Ok(_) => Ok(true),
        Err(e) if e.kind() == ErrorKind::AlreadyExists => Ok(false),
        Err(e) => Err(Error::write(path, e)),
    }
}

/// Writes `bytes` to a synced temporary file next to `path`, which `publish` renames or links; returns the open, locked file.
fn write_beside(path: &Path, bytes: &[u8], publish: impl FnOnce(&Path) -> io::Result<()>) -> io::Result<File> {
    remove_temporaries(parent(path), &[&short_name(path)]);
    let (temporary, mut file) = create_temporary(path)?;
    let written = file.write_all(bytes).and_then(|()| file.sync_all()).and_then(|()| publish(&temporary));
    if let Err(e) = written {
        let _ = fs::remove_file(&temporary);
        return Err(e);
    }
    // The name is durable only after the folder is synced; on file systems without folder sync, the file still has its
    // name.
    #[expect(clippy::disallowed_methods, reason = "a folder of our own")]
    let _ = File::open(parent(path)).and_then(|folder| folder.sync_all());
    Ok(file)
}

/// Creates and locks a temporary file next to `path`.
fn create_temporary(path: &Path) -> io::Result<(PathBuf, File)> {
    loop {
        // Random instead of the process ID: on a shared disk, processes of two machines may have equal IDs.
        let number = RandomState::new().hash_one(std::process::id()) as u32;
        let temporary = path.with_file_name(format!(".{}.{number}.tmp", short_name(path)));
        let file = File::create_new(&temporary)?;
        let is_taken = matches!(file.try_lock(), Err(TryLockError::WouldBlock));
        // Another process may have removed the file before it was locked.
        if !is_taken && temporary.symlink_metadata().is_ok() {
            return Ok((temporary, file));
        }
    }
}

/// Returns the name of a file as its temporary files repeat it: at most [`LONGEST_NAME`] bytes.
fn short_name(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name[..name.floor_char_boundary(LONGEST_NAME)].to_owned()
}

/// Removes a file, if there is one, and temporary files that killed processes left for it. Failures are ignored.
pub fn remove(path: &Path) {
    remove_temporaries(parent(path), &[&short_name(path)]);
    let _ = fs::remove_file(path);
}

/// Removes temporary files of `names` that killed processes left in `folder`, for example `.run.json.123.tmp`. Those of
/// running processes are locked and stay. Files that cannot be removed are ignored.
pub fn remove_temporaries(folder: &Path, names: &[&str]) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let file_name = entry.file_name().to_string_lossy().into_owned();
        let parts = file_name.strip_prefix('.').and_then(|name| name.strip_suffix(".tmp")?.rsplit_once('.'));
        let is_ours = |(name, number): (&str, &str)| {
            names.contains(&name) && !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit())
        };
        if parts.is_some_and(is_ours)
            && let Some(_unused) = lock_unused(&entry.path())
        {
            let _ = fs::remove_file(entry.path());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn replaces_file_atomically_without_temporary_files() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        write_atomically(&path, b"old").unwrap();
        write_atomically(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        assert!(!write_atomically(&folder.path().join("missing/a.txt"), b"").unwrap_err().is_input());
    }

    #[test]
    fn new_file_never_replaces_existing_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        let is_writer: Vec<bool> = std::thread::scope(|scope| {
            let write = |k: u8| write_new(&folder.path().join("a.txt"), &[k; 9]).unwrap();
            let threads: Vec<_> = (0..8).map(|k| scope.spawn(move || write(k))).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        let first = is_writer.iter().position(|is_writer| *is_writer).unwrap() as u8;
        assert_eq!(is_writer.iter().filter(|is_writer| **is_writer).count(), 1, "{is_writer:?}");
        assert_eq!(fs::read(&path).unwrap(), [first; 9]);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file is left");
        assert!(create(&path, b"").unwrap_err().is_input());
        assert!(write_new(&folder.path().join("missing/a.txt"), b"").is_err());
    }

    #[test]
    fn removes_temporary_files_of_killed_processes_only() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let long = "x".repeat(LONGEST_NAME + 9);
        let left = [".a.txt.1.tmp".to_owned(), format!(".{}.2.tmp", &long[..LONGEST_NAME])];
        let kept = [".a.txt.3.tmp", ".a.txt..tmp", ".a.txt.x.tmp", ".b.txt.4.tmp"];
        left.iter().map(String::as_str).chain(kept).for_each(|name| fs::write(path(name), "half").unwrap());
        let busy = File::open(path(".a.txt.3.tmp")).unwrap();
        busy.lock().unwrap();
        write_atomically(&path("a.txt"), b"1").unwrap();
        check_new_file(&path(&long)).unwrap();
        assert!(left.iter().all(|name| !path(name).exists()) && kept.iter().all(|name| path(name).exists()));
    }
}
