//! `Study`: finished runs read back and put in order, for tables and figures that compare them.
//!
//! Runs on the same data and test set form a *setting*: only within one are scores comparable, and only there floors hold.
//! In a setting, runs that differ in nothing but their seed form a *variant*.
//! A run of a sweep belongs to the variant that its labels name; a run folder named by itself, to that of all such runs
//! whose pipelines differ in seed and name alone.

mod setting;

pub use setting::{Race, Setting, Variant, Way, distinct, one_line};

use crate::Record;
use crate::folder::PIPELINE;
use crate::sweep::{JOINED, LISTING, Listing};
use pwrfgs_core::{Error, Result};
use setting::{Labels, listed, named, setting_key, settings};
use std::path::{Path, PathBuf};

/// Runs to compare.
#[derive(Clone, Debug, Default)]
pub struct Study {
    /// Names of the sweeps or runs, joined.
    pub title: String,
    /// In the order in which they were met; none is empty.
    pub settings: Vec<Setting>,
    /// Runs that were named but have not finished, and so are in none of the settings.
    pub unfinished: Vec<PathBuf>,
    /// Runs that are in none of the settings because they are there already: named twice, or the same seed of the same
    /// variant again.
    pub repeated: Vec<PathBuf>,
}

impl Study {
    /// Reads sweep folders and run folders.
    ///
    /// # Errors
    /// A folder that is neither, a damaged file, or no finished run among them.
    pub fn read(folders: &[PathBuf]) -> Result<Self> {
        let (mut study, mut seen) = (Self::default(), Vec::new());
        let mut titles: Vec<String> = Vec::new();
        let (mut records, mut alone) = (Vec::new(), Vec::new());
        for folder in folders {
            let listing = if folder.is_dir() { Listing::read(folder)? } else { None };
            if let Some(listing) = listing {
                // Two sweeps of one name, on two days say, are two things.
                let taken = titles.contains(&listing.name);
                let name = if taken { folder.display().to_string() } else { listing.name };
                let mut runs: Vec<(PathBuf, Labels)> =
                    listing.runs.into_iter().map(|run| (folder.join(run.folder), run.labels)).collect();
                let joined = folder.join(JOINED);
                if joined.join(PIPELINE).is_file() {
                    runs.push((joined, vec![(String::new(), JOINED.to_owned())]));
                }
                for (place, mut labels) in runs {
                    if folders.len() > 1 {
                        labels.insert(0, (String::new(), name.clone()));
                    }
                    records.extend(study.take(&place, &mut seen)?.map(|record| (labels, record)));
                }
                titles.push(name);
            } else if folder.join(PIPELINE).is_file() {
                alone.extend(study.take(folder, &mut seen)?);
            } else {
                return Err(Error::Config(format!(
                    "{} holds neither a run ({PIPELINE}) nor a sweep ({LISTING}); name a folder that `pwrfgs run` or \
                     `pwrfgs sweep` made",
                    folder.display()
                )));
            }
        }
        for (name, record) in named(study.without_twins(alone)?) {
            titles.push(name.clone());
            records.push((vec![(String::new(), name)], record));
        }
        study.title = listed(titles);
        if records.is_empty() {
            let missing = study.unfinished.len();
            return Err(Error::Config(format!("none of these {missing} runs has finished; run them first")));
        }
        study.settings = settings(records)?;
        Ok(study)
    }

    /// Reads one run folder, or notes that it has not finished or was named before.
    fn take(&mut self, folder: &Path, seen: &mut Vec<PathBuf>) -> Result<Option<Record>> {
        let place = folder.canonicalize().unwrap_or_else(|_| folder.into());
        if seen.contains(&place) {
            self.repeated.push(folder.into());
            return Ok(None);
        }
        seen.push(place);
        let record = Record::read(folder)?;
        if record.is_none() {
            self.unfinished.push(folder.into());
        }
        Ok(record)
    }

    /// Leaves runs out that are equal to one before them: counted twice, they would look like certainty.
    fn without_twins(&mut self, runs: Vec<Record>) -> Result<Vec<Record>> {
        let (mut kept, mut keys) = (Vec::new(), Vec::new());
        for run in runs {
            let key = (setting_key(&run)?, run.variant_key(), run.pipeline.seed);
            if keys.contains(&key) {
                self.repeated.push(run.folder);
            } else {
                keys.push(key);
                kept.push(run);
            }
        }
        Ok(kept)
    }
}
