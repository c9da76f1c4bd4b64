//! Exclusive access of one process: files by a lock, folders by an open descriptor.

use crate::{Error, Result};
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Locks the file at `path` until the returned file is dropped; without effect on file systems without locks. Returns
/// `None` if another process holds the lock for more than 0.2 s.
///
/// # Errors
/// There is no such file, it is not a regular file, or it cannot be opened.
pub fn try_lock(path: &Path) -> io::Result<Option<File>> {
    lock_with(path, |file| {
        for _ in 0..20 {
            match file.try_lock() {
                Err(TryLockError::WouldBlock) => std::thread::sleep(Duration::from_millis(10)),
                other => return other,
            }
        }
        file.try_lock()
    })
}

/// Locks the file at `path` as [`try_lock`] does, but waits for other processes without limit.
///
/// # Errors
/// There is no such file, it is not a regular file, or it cannot be opened.
pub fn lock(path: &Path) -> io::Result<File> {
    let lock = lock_with(path, |file| {
        loop {
            match file.lock() {
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                other => return other.map_err(TryLockError::Error),
            }
        }
    });
    lock.map(|file| file.expect("it waits until the lock is free"))
}

/// Locks the file at `path` if no process holds its lock. Returns `None` otherwise, if there is no such file, and on file
/// systems without locks.
pub(super) fn lock_unused(path: &Path) -> Option<File> {
    lock_with(path, |file| file.try_lock().map_err(|_no_locks| TryLockError::WouldBlock)).ok().flatten()
}

/// Opens the file at `path` and locks it with `take`; `None` if another process holds the lock. Repeats this if the
/// name leads to another file meanwhile. Returns an error if the file is missing, irregular or cannot be opened.
fn lock_with(path: &Path, take: impl Fn(&File) -> Result<(), TryLockError>) -> io::Result<Option<File>> {
    loop {
        super::refuse_irregular(path)?;
        // NFS can lock only writable files.
        let file = match OpenOptions::new().read(true).write(true).open(path) {
            Err(e) if e.kind() == ErrorKind::PermissionDenied => super::open(path)?,
            opened => opened?,
        };
        match take(&file) {
            Err(TryLockError::WouldBlock) => return Ok(None),
            // File systems without locks are accepted.
            Ok(()) | Err(TryLockError::Error(_)) => {}
        }
        // Another file may have taken the name between opening and locking.
        if is_file_at(&file, path)? {
            return Ok(Some(file));
        }
    }
}

/// Returns whether `path` leads to the open `file`.
fn is_file_at(file: &File, path: &Path) -> io::Result<bool> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt as _;
        let (opened, named) = (file.metadata()?, fs::metadata(path)?);
        Ok((opened.dev(), opened.ino()) == (named.dev(), named.ino()))
    }
    // Other systems cannot compare the files: both must exist.
    #[cfg(not(unix))]
    fs::metadata(path).map(|_| file.metadata().is_ok())
}

/// Folder that stays the same if another folder or a link takes its name. On Linux, files are accessed through the open
/// descriptor; on other systems, and on Linux without `/proc`, by name.
#[derive(Debug)]
pub struct HeldFolder {
    name: PathBuf,
    path: PathBuf,
    folder: Option<File>,
}

impl HeldFolder {
    /// Opens the folder at the path `name`.
    ///
    /// # Errors
    /// On Linux, [`Error::Write`] if nothing has this name, or it cannot be opened; other systems do not check it.
    pub fn open(name: &Path) -> Result<Self> {
        let by_name = || Self { name: name.into(), path: name.into(), folder: None };
        #[cfg(target_os = "linux")]
        {
            use std::os::fd::AsRawFd as _;
            #[expect(clippy::disallowed_methods, reason = "a folder, which never waits")]
            let folder = File::open(name).map_err(|e| Error::write(name, e))?;
            let path = PathBuf::from(format!("/proc/self/fd/{}", folder.as_raw_fd()));
            if is_file_at(&folder, &path).unwrap_or(false) {
                return Ok(Self { name: name.into(), path, folder: Some(folder) });
            }
        }
        Ok(by_name())
    }

    /// Returns the path for reading and writing files.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the path that users gave, for messages.
    pub fn name(&self) -> &Path {
        &self.name
    }

    /// Replaces the path of the folder in an error by the name that users gave.
    #[must_use]
    pub fn name_in_error(&self, error: Error) -> Error {
        let path = |path: PathBuf| match path.strip_prefix(&self.path) {
            Ok(relative) if relative.as_os_str().is_empty() => self.name.clone(),
            Ok(relative) => self.name.join(relative),
            Err(_) => path,
        };
        let text = |text: String| text.replace(&*self.path.to_string_lossy(), &self.name.to_string_lossy());
        match error {
            Error::Read { path: at, source } => Error::Read { path: path(at), source },
            Error::Write { path: at, source } => Error::Write { path: path(at), source },
            Error::Input { path: file, at, message } => Error::Input { path: path(file), at, message: text(message) },
            Error::Config(message) => Error::Config(text(message)),
            Error::Busy(at) => Error::Busy(path(at)),
            other => other,
        }
    }

    /// Checks that the name still leads to the folder; without effect if files are accessed by name.
    ///
    /// # Errors
    /// [`Error::Write`] if the name leads elsewhere; the message gives the current path of the files.
    pub fn check_name(&self) -> Result<()> {
        match &self.folder {
            Some(folder) if !is_file_at(folder, &self.name).unwrap_or(false) => {
                let current = fs::read_link(&self.path).unwrap_or_default();
                let problem = "the folder was moved or replaced meanwhile";
                let problem = format!("{problem}; its files are in {}", current.display());
                Err(Error::write(&self.name, io::Error::other(problem)))
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lock_follows_name_of_replaced_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        assert_eq!(try_lock(&path).unwrap_err().kind(), ErrorKind::NotFound);
        fs::write(&path, "1").unwrap();
        let held = try_lock(&path).unwrap().unwrap();
        assert!(try_lock(&path).unwrap().is_none());
        // A process that waits for a replaced file gets the new one.
        let waiting = std::thread::spawn({
            let path = path.clone();
            move || lock(&path).unwrap()
        });
        std::thread::sleep(Duration::from_millis(50));
        super::super::write_atomically(&path, b"2").unwrap();
        drop(held);
        assert!(is_file_at(&waiting.join().unwrap(), &path).unwrap_or(!cfg!(unix)));
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn held_folder_ignores_symlink_replacing_its_name() {
        let (parent, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let (name, moved) = (parent.path().join("a"), parent.path().join("b"));
        fs::create_dir(&name).unwrap();
        let held = HeldFolder::open(&name).unwrap();
        held.check_name().unwrap();
        fs::rename(&name, &moved).unwrap();
        std::os::unix::fs::symlink(elsewhere.path(), &name).unwrap();
        super::super::write_atomically(&held.path().join("x"), b"1").unwrap();
        assert!(super::super::write_new(&held.path().join("y"), b"2").unwrap());
        assert_eq!(fs::read_dir(elsewhere.path()).unwrap().count(), 0);
        assert_eq!(
            (fs::read(moved.join("x")).unwrap(), fs::read(moved.join("y")).unwrap()),
            (b"1".into(), b"2".into())
        );
        let error_text = held.check_name().unwrap_err().to_string();
        assert!(
            error_text.contains(moved.to_str().unwrap()) && error_text.contains(name.to_str().unwrap()),
            "{error_text}"
        );
        let errors = [
            Error::write(&held.path().join("x"), io::Error::other("no")),
            Error::Busy(held.path().into()),
            Error::Config(format!("{} holds something else", held.path().display())),
        ];
        for error in errors {
            let error_text = held.name_in_error(error).to_string();
            assert!(error_text.contains(name.to_str().unwrap()) && !error_text.contains("/proc"), "{error_text}");
        }
    }
}
