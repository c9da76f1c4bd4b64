//! A folder that is being made: under another name beside it until it is whole, and cleared away where its maker was killed.
//!
//! Who makes a folder holds a lock on it, which ends with the process however that ends. So what is not locked, has such a
//! name and holds nothing but what is written here was left behind.

use crate::output::{FILES, PICTURES};
use pwrfgs_core::{Error, Result, files};
use std::ffi::OsStr;
use std::fs::{self, File, FileType, Permissions};
use std::io;
use std::path::Path;
use tempfile::TempDir;

/// Letters that make a name of its own.
const RANDOM: usize = 6;
/// Most letters of the name that is being made: the rest of a long one is left out.
const LONGEST: usize = 60;
/// Where a damaged folder goes until it is removed.
const DAMAGED: &str = "damaged";
/// A data set that is made for now only.
pub(crate) const FOR_NOW: &str = "data";

/// A folder in the making; removed when it is dropped.
pub(crate) struct Making {
    folder: TempDir,
    /// `None` where the file system locks no folders; there nobody clears any.
    _lock: Option<File>,
}

impl Making {
    /// A new folder in `parent` for what is to be called `name`; what an earlier process left of that name is cleared.
    pub(crate) fn begin(parent: &Path, name: &OsStr) -> io::Result<Self> {
        let name: String = name.to_string_lossy().chars().take(LONGEST).collect();
        clear(parent, Some(&name));
        loop {
            let folder = temporary(parent, &name)?;
            let lock = files::open(folder.path()).ok();
            match lock.as_ref().map(File::try_lock) {
                Some(Err(fs::TryLockError::WouldBlock)) => {} // somebody took it for left behind
                locked if folder.path().exists() => {
                    return Ok(Self { folder, _lock: lock.filter(|_| matches!(locked, Some(Ok(())))) });
                }
                _ => {}
            }
        }
    }

    /// Where it is until it has its name.
    pub(crate) fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Gives the finished folder its name. An empty folder there gives way.
    pub(crate) fn publish(self, out: &Path) -> Result<()> {
        // Where it does not exist, or is not empty, the rename says what matters.
        let _ = fs::remove_dir(out);
        fs::rename(self.path(), out).map_err(|e| Error::write(out, e))?;
        let _ = self.folder.keep(); // nothing lies there any more
        Ok(())
    }
}

/// Removes a folder that [`Making`] made; it is renamed first, so that nobody finds half of it.
pub(crate) fn remove(folder: &Path) -> io::Result<()> {
    let (Some(parent), Some(name)) = (folder.parent(), folder.file_name()) else {
        return Err(io::ErrorKind::InvalidInput.into());
    };
    let grave = Making::begin(parent, name)?;
    fs::rename(folder, grave.path().join(DAMAGED))?;
    grave.folder.close()
}

/// Removes what killed processes left in `parent`: of one name, or of any.
pub(crate) fn clear(parent: &Path, name: Option<&str>) {
    let Ok(entries) = fs::read_dir(parent) else { return };
    for entry in entries.flatten() {
        let path = entry.path();
        let is_left = is_temporary(&entry.file_name(), name) && entry.file_type().is_ok_and(|t| t.is_dir());
        if !(is_left && is_ours(&path)) {
            continue;
        }
        // The lock is held while the folder goes: who has just made it sees that it is gone.
        if let Ok(lock) = files::open(&path)
            && lock.try_lock().is_ok()
        {
            tracing::debug!("{} was left behind by a process that was killed; it is removed", path.display());
            if let Err(e) = fs::remove_dir_all(&path) {
                tracing::debug!("{} cannot be removed: {e}", path.display());
            }
        }
    }
}

/// Whether a file is called as [`temporary`] calls folders: `.NAME.RANDOM.tmp`.
fn is_temporary(file: &OsStr, name: Option<&str>) -> bool {
    let parts = || file.to_str()?.strip_prefix('.')?.strip_suffix(".tmp")?.rsplit_once('.');
    parts().is_some_and(|(found, random)| {
        let is_random = random.len() == RANDOM && random.bytes().all(|b| b.is_ascii_alphanumeric());
        is_random && name.is_none_or(|name| name == found)
    })
}

/// Whether a folder holds nothing but what is written into such a folder.
fn is_ours(folder: &Path) -> bool {
    let holds = |folder: &Path, fits: &dyn Fn(&str, FileType) -> bool| {
        fs::read_dir(folder).is_ok_and(|mut entries| {
            entries.all(|entry| {
                let entry = entry.ok().and_then(|e| Some((e.file_name().into_string().ok()?, e.file_type().ok()?)));
                entry.is_some_and(|(name, kind)| fits(&name, kind))
            })
        })
    };
    let is_picture = |name: &str, kind: FileType| {
        let number = name.strip_suffix(".png");
        kind.is_file() && number.is_some_and(|n| n.len() == 5 && n.bytes().all(|b| b.is_ascii_digit()))
    };
    holds(folder, &|name, kind| match name {
        PICTURES => kind.is_dir() && holds(&folder.join(name), &is_picture),
        DAMAGED | FOR_NOW => kind.is_dir(),
        _ if kind.is_dir() => is_temporary(OsStr::new(name), Some(FOR_NOW)),
        _ => kind.is_file() && FILES.contains(&name),
    })
}

/// A folder with the permissions of any other new one; temporary folders are for their owner alone otherwise.
fn temporary(parent: &Path, name: &str) -> io::Result<TempDir> {
    let (prefix, mut builder) = (format!(".{name}."), tempfile::Builder::new());
    builder.prefix(&prefix).suffix(".tmp").rand_bytes(RANDOM);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        builder.permissions(Permissions::from_mode(0o777)); // less what the user's mask takes away
    }
    builder.tempdir_in(parent)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_nobody_makes_any_more_is_cleared_and_nothing_else() {
        let root = tempfile::tempdir().unwrap();
        let at = |name: &str| root.path().join(name);
        let left = |name: &str| {
            fs::create_dir_all(at(name).join(PICTURES)).unwrap();
            fs::write(at(name).join("spectrum/00001.png"), "x").unwrap();
            fs::write(at(name).join("tx_pos.csv"), "x").unwrap();
        };
        // Made right now, of another name, a file of the user's, another number of letters.
        let kept =
            [".office.aaaaaa.tmp", ".lab.bbbbbb.tmp", ".office.cccccc.tmp", ".office.short.tmp", "office.dddddd.tmp"];
        kept.iter().chain(&[".office.eeeeee.tmp"]).for_each(|name| left(name));
        let lock = File::open(at(kept[0])).unwrap();
        lock.lock().unwrap();
        fs::write(at(kept[2]).join("thesis.tex"), "x").unwrap();
        let making = Making::begin(root.path(), OsStr::new("office")).unwrap();
        kept.iter().for_each(|name| assert!(at(name).exists(), "{name}"));
        assert!(!at(".office.eeeeee.tmp").exists());
        // Two at a time do not disturb each other, and what is dropped is gone.
        let other = Making::begin(root.path(), OsStr::new("office")).unwrap();
        assert!(making.path().exists());
        drop(making);
        other.publish(&at("office")).unwrap();
        assert_eq!(fs::read_dir(root.path()).unwrap().count(), kept.len() + 1);
        drop(lock);
        clear(root.path(), None);
        assert!(!at(kept[0]).exists() && !at(kept[1]).exists() && at(kept[2]).exists() && at("office").exists());
        remove(&at("office")).unwrap();
        assert_eq!(fs::read_dir(root.path()).unwrap().count(), kept.len() - 2);
    }
}
