//! Lists and copies the files of a folder.

use pwrfgs_core::{Error, Result};
use std::fs;
use std::path::{Path, PathBuf};

/// Files in a folder, or the file itself, in order.
pub(crate) fn files(path: &Path) -> Result<Vec<PathBuf>> {
    if !path.is_dir() {
        return Ok(vec![path.into()]);
    }
    let mut all: Vec<_> = fs::read_dir(path).map_err(|e| Error::read(path, e))?.flatten().map(|e| e.path()).collect();
    all.sort();
    Ok(all.iter().map(|path| files(path)).collect::<Result<Vec<_>>>()?.concat())
}

/// Copies all files in a folder without their permissions, since a checkout may be read-only.
pub(crate) fn copy(from: &Path, to: &Path) -> Result<()> {
    for path in files(from)? {
        let copied = to.join(path.strip_prefix(from).unwrap_or(&path));
        let folder = copied.parent().unwrap_or(to);
        let copy = || fs::create_dir_all(folder).and_then(|()| fs::write(&copied, fs::read(&path)?));
        copy().map_err(|e| Error::write(&copied, e))?;
    }
    Ok(())
}
