//! `Study`: finished runs, grouped for comparison in tables and figures.
//!
//! Runs on the same data and test set form a *setting*: scores and baselines are comparable only within a setting. Runs
//! of a setting that differ only in their seed form a *variant*. A run of a sweep belongs to the variant of its labels;
//! other run folders form variants of pipelines that differ only in seed and name.

mod families;
mod setting;

pub use families::{ParetoComparison, VariantFamily};
pub use setting::{Setting, StudyVariant, distinct};

use crate::Record;
use crate::folder::PIPELINE;
use crate::sweep::{JOINED, LISTING, Listing};
use pwrfgs_core::{Error, Result};
use setting::{Labels, group_by_setting, joined_names, name_single_runs, setting_key};
use std::path::{Path, PathBuf};

/// Runs to compare.
#[derive(Clone, Debug, Default)]
pub struct Study {
    /// Names of the sweeps or runs, joined.
    pub title: String,
    /// Settings in order of appearance; none is empty.
    pub settings: Vec<Setting>,
    /// Given runs that have not finished, and belong to no setting.
    pub unfinished: Vec<PathBuf>,
    /// Duplicate runs, which belong to no setting: given twice, or the same seed of the same variant again.
    pub repeated: Vec<PathBuf>,
}

impl Study {
    /// Reads sweep folders and run folders, and groups their runs.
    ///
    /// # Errors
    /// A folder of another kind, a damaged file, or no finished run.
    pub fn read(folders: &[PathBuf]) -> Result<Self> {
        let (mut study, mut seen) = (Self::default(), Vec::new());
        let mut titles: Vec<String> = Vec::new();
        let (mut records, mut single_runs) = (Vec::new(), Vec::new());
        for folder in folders {
            let listing = if folder.is_dir() { Listing::read(folder)? } else { None };
            if let Some(mut listing) = listing {
                // Two sweeps of the same name, such as of two days, are different.
                if titles.contains(&listing.name) {
                    listing.name = folder.display().to_string();
                }
                titles.push(listing.name.clone());
                let sweep = (folders.len() > 1).then(|| (String::new(), listing.name.clone()));
                records.extend(study.read_sweep(folder, listing, sweep.as_slice(), &mut seen)?);
            } else if folder.join(PIPELINE).is_file() {
                single_runs.extend(study.read_run(folder, &mut seen)?);
            } else {
                return Err(Error::Config(format!(
                    "{} holds neither a run ({PIPELINE}) nor a sweep ({LISTING}); name a folder that `pwrfgs run` or \
                     `pwrfgs sweep` made",
                    folder.display()
                )));
            }
        }
        for (name, record) in name_single_runs(study.drop_duplicates(single_runs)?)? {
            titles.push(name.clone());
            records.push((vec![(String::new(), name)], record));
        }
        study.title = joined_names(titles);
        if records.is_empty() {
            let missing = study.unfinished.len();
            return Err(Error::Config(format!("none of these {missing} runs has finished; run them first")));
        }
        study.settings = group_by_setting(records)?;
        Ok(study)
    }

    /// Reads the finished runs of a sweep and its joined model, with the labels `sweep` before those of each run; notes
    /// the others as [`Self::read_run`] does.
    fn read_sweep(
        &mut self,
        folder: &Path,
        listing: Listing,
        sweep: &[(String, String)],
        seen: &mut Vec<PathBuf>,
    ) -> Result<Vec<(Labels, Record)>> {
        let mut runs: Vec<(PathBuf, Labels)> =
            listing.runs.into_iter().map(|run| (folder.join(run.folder), run.labels)).collect();
        let joined = folder.join(JOINED);
        if joined.join(PIPELINE).is_file() {
            runs.push((joined, vec![(String::new(), JOINED.to_owned())]));
        }
        let mut records = Vec::new();
        for (path, labels) in runs {
            records.extend(self.read_run(&path, seen)?.map(|record| ([sweep, &labels].concat(), record)));
        }
        Ok(records)
    }

    /// Reads one run folder and adds its path to `seen`. Returns `None` for an unfinished run or a path in `seen`, and
    /// adds the folder to `unfinished` or `repeated`.
    fn read_run(&mut self, folder: &Path, seen: &mut Vec<PathBuf>) -> Result<Option<Record>> {
        let path = folder.canonicalize().unwrap_or_else(|_| folder.into());
        if seen.contains(&path) {
            self.repeated.push(folder.into());
            return Ok(None);
        }
        seen.push(path);
        let record = Record::read(folder)?;
        if record.is_none() {
            self.unfinished.push(folder.into());
        }
        Ok(record)
    }

    /// Removes runs with setting, variant and seed of an earlier one, and adds their folders to `repeated`: counted twice, they
    /// would narrow the intervals.
    fn drop_duplicates(&mut self, runs: Vec<Record>) -> Result<Vec<Record>> {
        let (mut distinct_runs, mut keys) = (Vec::new(), Vec::new());
        for run in runs {
            let key = (setting_key(&run)?, run.variant_key()?, run.pipeline.seed);
            if keys.contains(&key) {
                self.repeated.push(run.folder);
            } else {
                keys.push(key);
                distinct_runs.push(run);
            }
        }
        Ok(distinct_runs)
    }
}
