//! `sweep.json`: the runs of a sweep folder.

use crate::folder::DATA;
use crate::text::join_names;
use pwrfgs_core::files::{self, refuse_foreign, write_atomically, write_new};
use pwrfgs_core::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::fs::File;
use std::io::ErrorKind;
use std::path::{Component, Path};

/// File that marks a sweep folder.
pub const LISTING: &str = "sweep.json";
/// Maximum number of runs in a message.
const NAMED: usize = 8;

/// All runs of a sweep, in order.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Listing {
    /// Name of the experiment.
    pub name: String,
    /// Runs of every combination with every seed.
    pub runs: Vec<ListedRun>,
}

/// One run of a sweep.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct ListedRun {
    /// Run folder, relative to the sweep folder.
    pub folder: String,
    /// Axis and label, for each axis.
    pub labels: Vec<(String, String)>,
    /// Random seed of the run.
    pub seed: u64,
}

impl ListedRun {
    /// Returns whether the run folder is inside the sweep folder: a foreign listing must not lead elsewhere.
    fn is_inside(&self, sweep: &Path) -> bool {
        let below = Path::new(&self.folder);
        let descends = below.components().all(|part| matches!(part, Component::Normal(_)));
        let real = |path: &Path| path.canonicalize().ok();
        // A run that has not started has no folder yet.
        let resolves_inside = match (real(sweep), real(&sweep.join(below))) {
            (Some(sweep), Some(run)) => run.starts_with(sweep),
            _ => true,
        };
        descends && resolves_inside
    }
}

impl Listing {
    /// Reads the listing of a sweep folder; `None` if it is not one.
    ///
    /// # Errors
    /// A file that cannot be read, is not a valid listing, or names a folder outside the sweep folder.
    pub fn read(folder: &Path) -> Result<Option<Self>> {
        let path = folder.join(LISTING);
        let Some(text) = files::if_found(&path, files::read_string(&path))? else { return Ok(None) };
        let listing: Self = serde_json::from_str(&text)
            .map_err(|e| Error::at(&path, e.line(), e.column(), format!("not the listing of a sweep: {e}")))?;
        match listing.runs.iter().find(|run| !run.is_inside(folder)) {
            None => Ok(Some(listing)),
            Some(run) => {
                let problem = "is not inside the sweep folder; pass runs of other folders separately";
                Err(Error::input(&path, format!("`{}` {problem}", run.folder)))
            }
        }
    }

    /// Writes the listing into the sweep folder.
    ///
    /// # Errors
    /// [`Error::Write`] if the file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<()> {
        write_atomically(&folder.join(LISTING), self.to_json().as_bytes())
    }

    /// Joins the names of the first eight runs and the number of the others, for messages.
    pub fn run_names(&self) -> String {
        join_names(self.runs.iter().map(|run| run.folder.as_str()), NAMED)
    }

    /// Checks that `folder` can hold this sweep; read-only. Returns the existing listing; `None` without one.
    ///
    /// # Errors
    /// Other content, or runs of another experiment: two listings of one sweep must contain one another.
    pub(super) fn inspect(&self, folder: &Path) -> Result<Option<Self>> {
        let path = folder.join(LISTING);
        let with_advice = |error| match error {
            Error::Input { path, at, message } => {
                Error::Input { path, at, message: format!("{message}; choose another --out") }
            }
            other => other,
        };
        let Some(existing) = Self::read(folder).map_err(with_advice)? else {
            return match refuse_foreign(folder, "a sweep folder", DATA) {
                // Another process has created it since.
                Err(_) if path.is_file() => self.inspect(folder),
                foreign => foreign.map(|()| None),
            };
        };
        let refuse = |problem: String| Err(Error::input(&path, format!("{problem}; choose another --out")));
        match (existing.first_missing_in(self), self.first_missing_in(&existing)) {
            _ if existing.name != self.name => {
                refuse(format!("lists the runs of `{}`, not of `{}`", existing.name, self.name))
            }
            (Some(theirs), Some(ours)) => refuse(format!(
                "lists the runs of another experiment called `{}`: it has `{}` and lacks `{}`",
                self.name, theirs.folder, ours.folder
            )),
            _ => Ok(Some(existing)),
        }
    }

    /// Creates `folder` or reuses that of an earlier start, and adds the runs to its listing. Returns the locked
    /// listing.
    ///
    /// # Errors
    /// Errors of [`Self::inspect`], or a folder that cannot be written.
    pub(super) fn claim(&self, folder: &Path) -> Result<File> {
        let path = folder.join(LISTING);
        loop {
            self.inspect(folder)?;
            std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
            write_new(&path, self.to_json().as_bytes())?;
            let lock = match files::lock(&path) {
                Err(e) if e.kind() == ErrorKind::NotFound => continue, // removed since it was written
                lock => lock.map_err(|e| Error::read(&path, e))?,
            };
            match self.inspect(folder)? {
                // The lock belongs to the replaced file: the next round locks the new one.
                Some(existing) if existing != *self && existing.first_missing_in(self).is_none() => {
                    self.write(folder)?;
                }
                Some(_) => {
                    files::remove_temporaries(folder, &[LISTING]);
                    return Ok(lock);
                }
                None => {}
            }
        }
    }

    /// Returns the first of its runs that is missing in `other`; `None` if `other` has all.
    fn first_missing_in(&self, other: &Self) -> Option<&ListedRun> {
        let others: BTreeSet<&ListedRun> = other.runs.iter().collect();
        self.runs.iter().find(|run| !others.contains(run))
    }

    /// Formats the content of `sweep.json`.
    fn to_json(&self) -> String {
        serde_json::to_string_pretty(self).expect("plain data") + "\n"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn removes_temporary_files_of_killed_processes() {
        let sweep = tempfile::tempdir().unwrap();
        let listing = Listing { name: "lambda".into(), runs: vec![] };
        drop(listing.claim(sweep.path()).unwrap());
        let others = [".sweep.json.tmp", ".sweep.json.x.tmp", ".other.json.1.tmp", "sweep.json.1.tmp"];
        for name in [&[".sweep.json.1.tmp", ".sweep.json.4294967295.tmp"], &others[..]].concat() {
            std::fs::write(sweep.path().join(name), "half").unwrap();
        }
        let _lock = listing.claim(sweep.path()).unwrap();
        let names = std::fs::read_dir(sweep.path()).unwrap().map(|entry| entry.unwrap().file_name());
        let names: BTreeSet<_> = names.map(|name| name.into_string().unwrap()).collect();
        assert_eq!(names, others.into_iter().chain([LISTING]).map(String::from).collect());
    }

    #[test]
    fn rejects_listing_with_folder_outside_sweep() {
        let (sweep, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let read = |folder: &str| {
            let run = ListedRun { folder: folder.into(), labels: vec![], seed: 0 };
            Listing { name: "lambda".into(), runs: vec![run] }.write(sweep.path()).unwrap();
            Listing::read(sweep.path())
        };
        std::fs::create_dir_all(sweep.path().join("a-0")).unwrap();
        assert!(read("a-0").is_ok() && read("not/begun").is_ok());
        let outside = elsewhere.path().to_str().unwrap();
        #[cfg(unix)]
        std::os::unix::fs::symlink(outside, sweep.path().join("link")).unwrap();
        for folder in [
            "../x",
            "a-0/../../x",
            outside,
            #[cfg(unix)]
            "link",
        ] {
            let error = read(folder).unwrap_err();
            assert!(
                error.is_input() && error.to_string().contains("is not inside the sweep folder"),
                "{folder}: {error}"
            );
        }
    }
}
