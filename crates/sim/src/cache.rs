//! Simulated data sets, kept on disk under a key of everything that decides them.

use crate::output::{self, MANIFEST};
use crate::recipe::Recipe;
use etcetera::BaseStrategy as _;
use pwrfgs_core::{Error, Progress, Result, files};
use std::path::{Path, PathBuf};

/// The folder of all kept data sets: `$PWRFGS_CACHE`, else `pwrfgs` in the user's cache folder; `None` where there is no
/// such thing.
pub fn root() -> Option<PathBuf> {
    match std::env::var_os("PWRFGS_CACHE") {
        Some(path) if !path.is_empty() => Some(path.into()),
        _ => etcetera::choose_base_strategy().ok().map(|base| base.cache_dir().join("pwrfgs")),
    }
}

/// What `read` makes of the data set of `recipe`, simulated now or taken from the folder `root`.
///
/// An entry is a folder as [`output::write`] makes it. It is used only if its manifest is that of the recipe, word for
/// word, and `read` finds nothing wrong with it; else it is made anew. Entries appear by renaming, so none is half
/// written, and of two programs that make the same one the second finds it there. Where the disk refuses, the data set is
/// made in the system's folder for temporary files instead, and lost.
///
/// # Errors
/// Those of the simulation and of `read`.
pub fn open_or_make<T>(
    recipe: &Recipe,
    root: Option<&Path>,
    progress: Progress<'_>,
    read: impl Fn(&Path) -> Result<T>,
) -> Result<T> {
    let Some(root) = root else { return make_for_now(recipe, progress, read) };
    let folder = root.join(recipe.folder_name());
    if is_of(&folder, recipe) {
        match read(&folder) {
            Ok(data) => return Ok(data),
            Err(e) => tracing::warn!("the kept data set {} is damaged ({e}) and made anew", folder.display()),
        }
    }
    let made = move_away(&folder).and_then(|()| output::write(recipe, false, &folder, progress));
    match made {
        Ok(()) => read(&folder),
        // Somebody else was faster.
        Err(_) if is_of(&folder, recipe) => read(&folder),
        Err(e @ Error::Write { .. }) => {
            tracing::warn!("simulated data are not kept: {e}");
            make_for_now(recipe, progress, read)
        }
        Err(e) => Err(e),
    }
}

/// Whether the folder holds the data set of the recipe, as far as its manifest says.
fn is_of(folder: &Path, recipe: &Recipe) -> bool {
    files::read(folder.join(MANIFEST)).is_ok_and(|bytes| bytes == recipe.to_json().as_bytes())
}

/// Removes a damaged entry; it is renamed first, so that nobody finds half of it.
fn move_away(folder: &Path) -> Result<()> {
    if !folder.exists() {
        return Ok(());
    }
    let grave = folder.with_extension(format!("damaged-{}", std::process::id()));
    let moved = std::fs::rename(folder, &grave).and_then(|()| std::fs::remove_dir_all(&grave));
    moved.map_err(|e| Error::write(folder, e))
}

fn make_for_now<T>(recipe: &Recipe, progress: Progress<'_>, read: impl Fn(&Path) -> Result<T>) -> Result<T> {
    let temporary = tempfile::tempdir().map_err(|e| Error::write(&std::env::temp_dir(), e))?;
    let folder = temporary.path().join(recipe.folder_name());
    output::write(recipe, false, &folder, progress)?;
    read(&folder)
}
