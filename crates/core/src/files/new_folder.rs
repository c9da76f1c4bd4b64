//! `NewFolder`: atomic creation of a folder.

use super::held::lock_unused;
use super::{parent, refuse_occupied};
use crate::{Error, Result, device};
use std::fs::{self, File, TryLockError};
use std::io::{self, ErrorKind};
use std::mem;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Marker of a folder in progress. The process that fills the folder locks it; killing the process releases the lock.
const LOCK: &str = ".pwrfgs-lock";
/// Name of the marker until it is locked.
const UNLOCKED: &str = ".pwrfgs-lock.new";
/// Maximum length of the target name inside the temporary name; the rest is omitted.
const LONGEST: usize = 60;
/// Maximum number of attempts to create a folder that another process removes, or to remove one that another thread fills.
const ATTEMPTS: usize = 100;
/// Name of a folder that is being removed, in a temporary folder.
const REMOVED: &str = "removed";

/// Folders in progress in this process.
static UNDER_WAY: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// Folder in progress: created next to its target as `.NAME.PID-K.tmp`, renamed when complete, removed if dropped
/// before. The next creation removes folders of the same name that killed programs left.
#[derive(Debug)]
pub struct NewFolder {
    path: PathBuf,
    out: PathBuf,
    /// Lock, held while the folder is in progress; without effect on file systems without locks.
    _lock: File,
}

impl NewFolder {
    /// Begins the folder that will be `out`.
    ///
    /// # Errors
    /// `out` is a file, a link or a folder that is not empty, or has no folder name; writing fails.
    pub fn begin(out: &Path) -> Result<Self> {
        if let Some(_unused) = lock_unused(&out.join(LOCK)) {
            let _ = fs::remove_file(out.join(LOCK)); // the process was killed while it published the folder
        }
        check_target(out)?;
        Self::begin_next_to(out)
    }

    /// Begins a temporary folder next to `out`, whatever `out` contains.
    ///
    /// # Errors
    /// [`Error::Write`] if the temporary folder or a folder above it cannot be created.
    pub fn begin_next_to(out: &Path) -> Result<Self> {
        static COUNT: AtomicUsize = AtomicUsize::new(0); // one process may create the same folder twice concurrently
        let parent = parent(out);
        let name = short_name(out);
        fs::create_dir_all(parent).map_err(|e| Error::write(parent, e))?;
        remove_abandoned(parent, Some(&name));
        let (mut folders, mut attempts) = (lock_under_way(), 0..ATTEMPTS);
        let (path, lock) = loop {
            let k = COUNT.fetch_add(1, Ordering::Relaxed);
            let path = parent.join(format!(".{name}.{}-{k}.tmp", std::process::id()));
            match fs::create_dir(&path).and_then(|()| create_lock(&path)) {
                Ok(lock) => break (path, lock),
                // Another process removed the folder before it had a lock.
                Err(e) if e.kind() == ErrorKind::NotFound && attempts.next().is_some() => {}
                Err(e) => return Err(Error::write(&path, e)),
            }
        };
        folders.push(path.clone());
        Ok(Self { path, out: out.into(), _lock: lock })
    }

    /// Removes a published folder. It is moved into a temporary folder first, so that no process reads a partial folder.
    ///
    /// # Errors
    /// [`Error::Write`] if the temporary folder cannot be created, or the folder cannot be renamed.
    pub fn remove(folder: &Path) -> Result<()> {
        let temporary = Self::begin_next_to(folder)?;
        fs::rename(folder, temporary.path.join(REMOVED)).map_err(|e| Error::write(folder, e))
    }

    /// Removes all folders that killed programs left in `parent`.
    pub fn remove_abandoned(parent: &Path) {
        remove_abandoned(parent, None);
    }

    /// Removes all folders in progress of this process, which must exit next: afterwards, a thread that begins,
    /// publishes or drops a folder blocks for ever.
    pub fn abandon_all() {
        let folders = lock_under_way();
        for path in folders.iter() {
            // Removal fails while another thread writes to the folder, so it is repeated.
            _ = (0..ATTEMPTS).any(|_| fs::remove_dir_all(path).is_ok() || !path.exists());
        }
        mem::forget(folders); // still locked
    }

    /// Returns the path for writing its files.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes one of its files.
    ///
    /// # Errors
    /// [`Error::Write`] if the file cannot be written.
    pub fn put(&self, name: &str, bytes: impl AsRef<[u8]>) -> Result<()> {
        super::write(&self.path.join(name), bytes)
    }

    /// Renames the folder to its target. An empty folder at the target is replaced.
    ///
    /// # Errors
    /// As [`Self::begin`], if something has appeared at the target since; renaming fails; the GPU has failed ([`device::check`]).
    pub fn publish(self) -> Result<()> {
        let _held = lock_under_way(); // a folder emptied by `abandon_all` must not be published
        rename_to_target(&self.path, &self.out, LOCK)
    }
}

impl Drop for NewFolder {
    fn drop(&mut self) {
        lock_under_way().retain(|path| *path != self.path);
        let _ = fs::remove_dir_all(&self.path); // already renamed if published; otherwise the next start retries
    }
}

/// Renames the finished folder `path` to `out`, where an empty folder is replaced, and then removes its `marker`. Fails if the
/// GPU did: numbers in the folder may then be zeros.
pub(super) fn rename_to_target(path: &Path, out: &Path, marker: &str) -> Result<()> {
    device::check()?;
    let write_error = |e| Error::write(out, e);
    let _ = fs::remove_dir(out); // if it is missing or not empty, the rename reports the relevant error
    fs::rename(path, out).map_err(|e| check_target(out).err().unwrap_or_else(|| write_error(e)))?;
    fs::remove_file(out.join(marker)).map_err(write_error)
}

/// Rejects a target that is a file, a link or a folder that is not empty, or has no folder name.
pub(super) fn check_target(out: &Path) -> Result<()> {
    if out.file_name().is_none() || out.is_symlink() {
        return Err(Error::input(out, "is not a valid name for a new folder; choose another"));
    }
    refuse_occupied(out)
}

/// Locks the list of folders in progress of this process.
fn lock_under_way() -> MutexGuard<'static, Vec<PathBuf>> {
    UNDER_WAY.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Creates the lock of a new folder. The file is locked before it gets its name, so that other processes never find it
/// unlocked.
fn create_lock(folder: &Path) -> io::Result<File> {
    let unlocked = folder.join(UNLOCKED);
    let lock = File::create_new(&unlocked)?;
    // File systems without locks are accepted; a lock of another process means that it removes the folder.
    if let Err(TryLockError::WouldBlock) = lock.try_lock() {
        return Err(ErrorKind::NotFound.into());
    }
    fs::rename(&unlocked, folder.join(LOCK))?;
    Ok(lock)
}

/// Returns the first [`LONGEST`] characters of the name of a folder.
fn short_name(out: &Path) -> String {
    out.file_name().unwrap_or_default().to_string_lossy().chars().take(LONGEST).collect()
}

/// Removes folders `.NAME.PID-K.tmp` of one name, or of any, that are not locked.
fn remove_abandoned(parent: &Path, name: Option<&str>) {
    for entry in fs::read_dir(parent).into_iter().flatten().flatten() {
        let path = entry.path();
        if !is_under_way(&entry.file_name().to_string_lossy(), name) || path.is_symlink() {
            continue;
        }
        let marker = [LOCK, UNLOCKED].iter().find_map(|name| lock_unused(&path.join(name)));
        // Failure is harmless. A folder without a marker is removed only if it is empty.
        let _ = if marker.is_some() { fs::remove_dir_all(&path) } else { fs::remove_dir(&path) };
    }
}

/// Returns whether a file name is that of a folder in progress, for one name or any.
fn is_under_way(file: &str, name: Option<&str>) -> bool {
    let parts = || file.strip_prefix('.')?.strip_suffix(".tmp")?.rsplit_once('.');
    parts().is_some_and(|(target, number)| {
        let is_number = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
        let is_ours = number.split_once('-').is_some_and(|(pid, k)| is_number(pid) && is_number(k));
        is_ours && name.is_none_or(|name| name == target)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn new_folder_is_complete_or_absent() {
        let parent = tempfile::tempdir().unwrap();
        let out = parent.path().join("a/data");
        let folder = NewFolder::begin(&out).unwrap();
        fs::write(folder.path().join("x"), "1").unwrap();
        assert!(!out.exists());
        drop(folder);
        assert!(names(&parent.path().join("a")).is_empty());
        fs::create_dir(&out).unwrap(); // empty, so it is replaced
        let folder = NewFolder::begin(&out).unwrap();
        let again = NewFolder::begin(&out).unwrap(); // the same folder, concurrently
        fs::write(folder.path().join("x"), "2").unwrap();
        folder.publish().unwrap();
        assert!(again.publish().unwrap_err().is_input(), "the first is there");
        assert_eq!((names(&parent.path().join("a")), names(&out)), (vec!["data".into()], vec!["x".into()]));
        assert!(NewFolder::begin(&out).unwrap_err().to_string().contains("is not empty (it holds `x`)"));
        assert!(NewFolder::begin(Path::new("/")).is_err());
        NewFolder::remove(&out).unwrap();
        assert!(names(&parent.path().join("a")).is_empty());
        NewFolder::begin(&parent.path().join("x".repeat(250))).unwrap().publish().unwrap();
    }

    /// Runs in a separate process, which no other test shares.
    #[test]
    fn abandoned_folders_are_not_published() {
        const OUT: &str = "PWRFGS_TEST_ABANDONED";
        if let Some(out) = std::env::var_os(OUT) {
            let folder = NewFolder::begin(Path::new(&out)).unwrap();
            let path = folder.path().to_owned();
            NewFolder::abandon_all();
            assert!(!path.exists());
            fs::create_dir(&path).unwrap(); // by a thread that still writes to it
            std::thread::spawn(move || folder.publish());
            std::thread::sleep(std::time::Duration::from_millis(100));
            std::process::exit(i32::from(Path::new(&out).exists()));
        }
        let parent = tempfile::tempdir().unwrap();
        let name = "files::new_folder::tests::abandoned_folders_are_not_published";
        let mut child = std::process::Command::new(std::env::current_exe().unwrap());
        let ended = child.args(["--exact", name]).env(OUT, parent.path().join("data")).status().unwrap();
        assert!(ended.success(), "{ended}");
    }

    #[test]
    fn removes_only_leftovers_of_killed_processes() {
        let parent = tempfile::tempdir().unwrap();
        let left = |name: &str| {
            fs::create_dir(parent.path().join(name)).unwrap();
            fs::write(parent.path().join(name).join(LOCK), "").unwrap();
        };
        [".data.1-0.tmp", ".data.2-0.tmp", ".data.x-0.tmp", ".data.2-0.tmp.txt", ".data.7.tmp", ".other.1-3.tmp"]
            .into_iter()
            .for_each(left);
        fs::create_dir(parent.path().join(".data.4-0.tmp")).unwrap();
        fs::create_dir(parent.path().join(".data.3-0.tmp")).unwrap(); // without a lock its owner is unknown
        fs::write(parent.path().join(".data.3-0.tmp/x"), "").unwrap();
        fs::create_dir(parent.path().join(".data.5-0.tmp")).unwrap();
        fs::write(parent.path().join(".data.5-0.tmp").join(UNLOCKED), "").unwrap();
        let busy = File::open(parent.path().join(".data.2-0.tmp").join(LOCK)).unwrap();
        busy.lock().unwrap();
        NewFolder::begin(&parent.path().join("data")).unwrap().publish().unwrap();
        let kept = [".data.2-0.tmp", ".data.2-0.tmp.txt", ".data.3-0.tmp", ".data.7.tmp", ".data.x-0.tmp"];
        assert_eq!(names(parent.path()), [&kept[..], &[".other.1-3.tmp", "data"]].concat());
        NewFolder::remove_abandoned(parent.path());
        assert_eq!(names(parent.path()), [&kept[..], &["data"]].concat());
    }
}
