//! Path of this program, for command lines that start it again.

use pwrfgs_core::{Error, Result};
use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::OnceLock;

/// Path by which the program was called.
static PROGRAM: OnceLock<PathBuf> = OnceLock::new();

/// Sets the path by which the program was called; a path without a folder is ignored, since the shell searched for it.
pub(crate) fn set_path(path: Option<&OsString>) {
    let has_folder = |path: &PathBuf| path.parent().is_some_and(|folder| !folder.as_os_str().is_empty());
    if let Some(path) = path.map(PathBuf::from).filter(has_folder) {
        _ = PROGRAM.set(path);
    }
}

/// Returns the path of the program, for a command line that starts it again: that of the call if it has a folder,
/// else that of the executable. In the Python package, the executable would be the interpreter.
pub(crate) fn path() -> Result<PathBuf> {
    let failed = |e| Error::Config(format!("cannot find the path of this program: {e}"));
    PROGRAM.get().map_or_else(|| std::env::current_exe().map_err(failed), |called| Ok(called.clone()))
}
