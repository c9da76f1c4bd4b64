//! `Study`: finished runs read back and put in order, for tables and figures that compare them.
//!
//! Runs on the same data and split form a *setting*: only within one are scores comparable, and only there floors hold.
//! In a setting, runs that differ in nothing but their seed form a *variant*.

pub mod figures;
mod record;

pub use record::{Record, Score};

use crate::folder::PIPELINE;
use crate::sweep::{LISTING, Listing};
use pwrfgs_core::{Error, Result, plugin::ron_options};
use std::path::{Path, PathBuf};

/// Axis and label, for each axis.
type Labels = Vec<(String, String)>;

/// Runs to compare.
#[derive(Clone, Debug)]
pub struct Study {
    /// Names of the sweeps or runs, joined.
    pub title: String,
    /// In the order in which they were met; none is empty.
    pub settings: Vec<Setting>,
    /// Runs that were named but have not finished, and so are in none of the settings.
    pub unfinished: Vec<PathBuf>,
}

/// Runs on the same data and the same split.
#[derive(Clone, Debug)]
pub struct Setting {
    /// What the data call themselves, and the split as RON.
    pub title: String,
    /// Whether the spectra are simulated.
    pub simulated: bool,
    /// In the order of the plan; none is empty.
    pub variants: Vec<Variant>,
}

/// Runs that differ in nothing but their seed.
#[derive(Clone, Debug)]
pub struct Variant {
    /// What tells it from the others of its setting, such as `lambda 0.02`.
    pub label: String,
    /// One a seed, in ascending order of seeds.
    pub runs: Vec<Record>,
}

impl Study {
    /// Reads sweep folders and run folders.
    ///
    /// # Errors
    /// A folder that is neither, a damaged file, or no finished run among them.
    pub fn read(folders: &[PathBuf]) -> Result<Self> {
        let mut study = Self { title: String::new(), settings: Vec::new(), unfinished: Vec::new() };
        let several = folders.len() > 1;
        let mut titles: Vec<String> = Vec::new();
        let mut records: Vec<(Labels, Record)> = Vec::new();
        for folder in folders {
            if let Some(listing) = Listing::read(folder)? {
                for run in &listing.runs {
                    let mut labels = run.labels.clone();
                    if several {
                        labels.insert(0, (String::new(), listing.name.clone()));
                    }
                    study.take(&folder.join(&run.folder), labels, &mut records)?;
                }
                titles.push(listing.name);
            } else if folder.join(PIPELINE).is_file() {
                let name = folder.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
                study.take(folder, vec![(String::new(), name.clone())], &mut records)?;
                titles.push(name);
            } else {
                return Err(Error::Config(format!(
                    "{} holds neither a run ({PIPELINE}) nor a sweep ({LISTING}); name a folder that `pwrfgs run` or \
                     `pwrfgs sweep` made",
                    folder.display()
                )));
            }
        }
        titles.dedup();
        study.title = titles.join(", ");
        if records.is_empty() {
            let missing = study.unfinished.len();
            return Err(Error::Config(format!("none of these {missing} runs has finished; run them first")));
        }
        study.settings = settings(records);
        Ok(study)
    }

    /// Reads one run folder into `records`, or notes that it has not finished.
    fn take(&mut self, folder: &Path, labels: Labels, records: &mut Vec<(Labels, Record)>) -> Result<()> {
        match Record::read(folder)? {
            Some(record) => records.push((labels, record)),
            None => self.unfinished.push(folder.into()),
        }
        Ok(())
    }
}

/// Puts runs in settings and variants.
fn settings(records: Vec<(Labels, Record)>) -> Vec<Setting> {
    let mut found: Vec<(String, Setting)> = Vec::new();
    let mut groups: Vec<Vec<(Labels, Record)>> = Vec::new();
    for (labels, record) in records {
        let key = record.setting_key();
        let place = found.iter().position(|(k, _)| *k == key).unwrap_or_else(|| {
            let setting =
                Setting { title: record.setting_title(), simulated: record.is_simulated(), variants: Vec::new() };
            found.push((key, setting));
            groups.push(Vec::new());
            found.len() - 1
        });
        groups[place].push((labels, record));
    }
    for ((_, setting), group) in found.iter_mut().zip(groups) {
        setting.variants = variants(group);
    }
    found.into_iter().map(|(_, setting)| setting).collect()
}

/// Groups the runs of one setting; axes whose label is the same for all are left out of the names.
fn variants(group: Vec<(Labels, Record)>) -> Vec<Variant> {
    let first = group[0].0.clone();
    let varies: Vec<String> = first
        .iter()
        .enumerate()
        .filter(|(k, label)| group.iter().any(|(labels, _)| labels.get(*k) != Some(label)))
        .map(|(_, (axis, _))| axis.clone())
        .collect();
    let mut all: Vec<Variant> = Vec::new();
    for (labels, record) in group {
        let words = labels.iter().filter(|(axis, _)| varies.is_empty() || varies.contains(axis));
        let words: Vec<String> = words.map(|(axis, label)| format!("{axis} {label}").trim().to_owned()).collect();
        let label = words.join(", ");
        match all.iter_mut().find(|v| v.label == label) {
            Some(variant) => variant.runs.push(record),
            None => all.push(Variant { label, runs: vec![record] }),
        }
    }
    for variant in &mut all {
        variant.runs.sort_by_key(|r| r.facts.seed);
    }
    all
}

/// A value as RON on one line.
pub(crate) fn one_line(value: &impl serde::Serialize) -> String {
    let config = ron::ser::PrettyConfig::new().struct_names(true).depth_limit(0);
    ron_options().to_string_pretty(value, config).unwrap_or_default()
}
