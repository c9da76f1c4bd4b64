//! `NewFolder`: a folder that is whole or not there.

use super::refuse_occupied;
use crate::{Error, Result};
use std::ffi::OsString;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

/// Locked by whoever fills the folder: a killed program no longer holds it.
const LOCK: &str = ".lock";

/// A folder under way: made beside its place as `.NAME.PID.tmp`, renamed when it is whole, removed when it is dropped
/// before. What a killed program left of the same name is removed when the next one begins.
#[derive(Debug)]
pub struct NewFolder {
    path: PathBuf,
    out: PathBuf,
    lock: Option<File>,
}

impl NewFolder {
    /// Begins the folder that will be `out`.
    ///
    /// # Errors
    /// Where `out` holds something or is no name for a folder, or the disk refuses.
    pub fn begin(out: &Path) -> Result<Self> {
        let Some(name) = out.file_name().filter(|_| !out.is_symlink()) else {
            return Err(Error::input(out, "is no name for a new folder; choose another"));
        };
        refuse_occupied(out)?;
        let parent = out.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        fs::create_dir_all(parent).map_err(|e| Error::write(parent, e))?;
        let hidden = |middle: &str| [".".as_ref(), name, middle.as_ref()].into_iter().collect::<OsString>();
        remove_left(parent, &hidden("."));
        let path = parent.join(hidden(&format!(".{}.tmp", std::process::id())));
        let made = fs::create_dir(&path).and_then(|()| File::create(path.join(LOCK)));
        let lock = made.and_then(|lock| lock.lock().map(|()| lock)).map_err(|e| Error::write(&path, e))?;
        Ok(Self { path, out: out.into(), lock: Some(lock) })
    }

    /// Where its files are written.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Gives it its name. An empty folder there gives way.
    ///
    /// # Errors
    /// Where the disk refuses.
    pub fn publish(mut self) -> Result<()> {
        let refuse = |e| Error::write(&self.out, e);
        fs::remove_file(self.path.join(LOCK)).map_err(refuse)?;
        // Where it does not exist, or is not empty, the rename says what matters.
        let _ = fs::remove_dir(&self.out);
        fs::rename(&self.path, &self.out).map_err(refuse)?;
        self.lock = None;
        Ok(())
    }
}

impl Drop for NewFolder {
    fn drop(&mut self) {
        if self.lock.take().is_some() {
            let _ = fs::remove_dir_all(&self.path); // nothing can be said here, and the next start tries again
        }
    }
}

/// Removes folders `PREFIX*.tmp` whose lock nobody holds.
fn remove_left(parent: &Path, prefix: &OsString) {
    for entry in fs::read_dir(parent).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let (name, prefix) = (name.as_encoded_bytes(), prefix.as_encoded_bytes());
        let middle = name.strip_prefix(prefix).and_then(|rest| rest.strip_suffix(b".tmp"));
        let ours = middle.is_some_and(|pid| !pid.is_empty() && pid.iter().all(u8::is_ascii_digit));
        let lock = entry.path().join(LOCK);
        let left = ours && super::open(&lock).is_ok_and(|lock| lock.try_lock().is_ok());
        if left {
            let _ = fs::remove_dir_all(entry.path()); // in the way of nobody
        }
    }
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
    fn it_is_whole_or_not_there() {
        let here = tempfile::tempdir().unwrap();
        let out = here.path().join("a/data");
        let folder = NewFolder::begin(&out).unwrap();
        fs::write(folder.path().join("x"), "1").unwrap();
        assert!(!out.exists());
        drop(folder);
        assert!(names(&here.path().join("a")).is_empty());
        fs::create_dir(&out).unwrap(); // empty: it gives way
        let folder = NewFolder::begin(&out).unwrap();
        fs::write(folder.path().join("x"), "2").unwrap();
        folder.publish().unwrap();
        assert_eq!((names(&here.path().join("a")), names(&out)), (vec!["data".into()], vec!["x".into()]));
        assert!(NewFolder::begin(&out).unwrap_err().to_string().contains("is not empty (it holds `x`)"));
        assert!(NewFolder::begin(Path::new("/")).is_err());
    }

    #[test]
    fn what_a_killed_program_left_is_removed_and_nothing_else() {
        let here = tempfile::tempdir().unwrap();
        for name in [".data.1.tmp", ".data.2.tmp", ".data.x.tmp", ".data.2.tmp.txt", ".other.1.tmp"] {
            fs::create_dir(here.path().join(name)).unwrap();
            fs::write(here.path().join(name).join(LOCK), "").unwrap();
        }
        fs::create_dir(here.path().join(".data.3.tmp")).unwrap(); // without a lock it is not known to be ours
        let busy = File::open(here.path().join(".data.2.tmp").join(LOCK)).unwrap();
        busy.lock().unwrap();
        NewFolder::begin(&here.path().join("data")).unwrap().publish().unwrap();
        let left = [".data.2.tmp", ".data.2.tmp.txt", ".data.3.tmp", ".data.x.tmp", ".other.1.tmp", "data"];
        assert_eq!(names(here.path()), left);
    }
}
