//! Simulated data sets, kept on disk under a key of everything that decides them.

use crate::output::{self, Layout, MANIFEST};
use crate::recipe::Recipe;
use etcetera::BaseStrategy as _;
use pwrfgs_core::files::{self, NewFolder};
use pwrfgs_core::{Error, Progress, Result};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

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
/// An entry is a folder as [`output::write_as`] makes it, with one array or table of all links: the receivers of a
/// transmitter one after the other. It is used only if its manifest is that of the recipe, word for
/// word, and `read` finds nothing wrong with it; else it is made anew. Entries appear by renaming, so none is half
/// written, what killed programs left is removed, and of two programs that make the same one the second finds it there.
/// Where the disk refuses, the data set is made in the system's folder for temporary files instead, and lost.
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
    NewFolder::clear(root);
    let folder = root.join(recipe.folder_name());
    if is_of(&folder, recipe) {
        match read(&folder) {
            Ok(data) => return Ok(data),
            Err(e) => tracing::warn!("the kept data set {} is damaged ({e}) and made anew", folder.display()),
        }
    }
    if let Err(e) = files::check_place(&folder) {
        tracing::warn!("simulated data are not kept: {e}");
        return make_for_now(recipe, progress, read);
    }
    let made = move_away(&folder).and_then(|()| make(recipe, &folder, progress));
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

/// Removes a damaged entry.
fn move_away(folder: &Path) -> Result<()> {
    if !folder.exists() {
        return Ok(());
    }
    NewFolder::remove(folder)
}

fn make(recipe: &Recipe, folder: &Path, progress: Progress<'_>) -> Result<()> {
    output::write_links(recipe, Layout::of(&recipe.observe), false, folder, progress, &AtomicBool::new(false))
}

fn make_for_now<T>(recipe: &Recipe, progress: Progress<'_>, read: impl Fn(&Path) -> Result<T>) -> Result<T> {
    let making = NewFolder::beside(&std::env::temp_dir().join("pwrfgs"))?;
    let folder = making.path().join("data");
    make(recipe, &folder, progress)?;
    read(&folder)
}
