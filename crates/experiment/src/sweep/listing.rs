//! `sweep.json`: which runs a sweep folder holds, for whoever reads them back.

use pwrfgs_core::files::{self, write_atomically};
use pwrfgs_core::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The file that makes a folder a sweep folder.
pub const LISTING: &str = "sweep.json";

/// All runs of a sweep, in its order.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Listing {
    /// The experiment.
    pub name: String,
    /// Every combination with every seed.
    pub runs: Vec<ListedRun>,
}

/// One run of a sweep.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ListedRun {
    /// Its folder, below that of the sweep.
    pub folder: String,
    /// Axis and label, for each axis.
    pub labels: Vec<(String, String)>,
    /// Its seed.
    pub seed: u64,
}

impl Listing {
    /// The listing of a sweep folder; `None` where it is none.
    ///
    /// # Errors
    /// A file that cannot be read, or is not such a listing.
    pub fn read(folder: &Path) -> Result<Option<Self>> {
        let path = folder.join(LISTING);
        match files::read_string(&path) {
            Ok(text) => serde_json::from_str(&text)
                .map(Some)
                .map_err(|e| Error::at(&path, e.line(), e.column(), format!("not the listing of a sweep: {e}"))),
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(e) => Err(Error::read(&path, e)),
        }
    }

    /// Writes it into the sweep folder.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn write(&self, folder: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self).expect("plain data") + "\n";
        write_atomically(&folder.join(LISTING), text.as_bytes())
    }
}
