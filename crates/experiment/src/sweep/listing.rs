//! `sweep.json`: which runs a sweep folder holds, for whoever reads them back.

use pwrfgs_core::files::{self, write_atomically};
use pwrfgs_core::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::{Component, Path};

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
        let text = match files::read_string(&path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(Error::read(&path, e)),
        };
        let listing: Self = serde_json::from_str(&text)
            .map_err(|e| Error::at(&path, e.line(), e.column(), format!("not the listing of a sweep: {e}")))?;
        match listing.runs.iter().find(|run| !is_name(&run.folder)) {
            None => Ok(Some(listing)),
            Some(run) => {
                let what = format!("the run `{}` is no folder in this one; name the runs one by one", run.folder);
                Err(Error::input(&path, what))
            }
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

/// Whether `text` names something in a folder, and leads nowhere else.
fn is_name(text: &str) -> bool {
    let mut parts = Path::new(text).components();
    matches!((parts.next(), parts.next()), (Some(Component::Normal(name)), None) if name == text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_that_lies_elsewhere_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let listing = |name: &str| Listing {
            name: "sweep".into(),
            runs: vec![ListedRun { folder: name.into(), labels: vec![("a".into(), "b".into())], seed: 1 }],
        };
        assert_eq!(Listing::read(folder.path()).unwrap(), None);
        let good = listing("a=b,seed=1");
        good.write(folder.path()).unwrap();
        assert_eq!(Listing::read(folder.path()).unwrap(), Some(good));
        for name in ["../other", "..", ".", "", "/etc", "a/b", "a/../../b", "a/"] {
            listing(name).write(folder.path()).unwrap();
            let said = Listing::read(folder.path()).unwrap_err();
            assert!(said.is_input() && said.to_string().contains("is no folder in this one"), "{name}: {said}");
        }
    }
}
