//! `Study`: finished runs read back and put in order, for tables and figures that compare them.
//!
//! Runs on the same data and split form a *setting*: only within one are scores comparable, and only there floors hold.
//! In a setting, runs that differ in nothing but their seed form a *variant*.
//! A run of a sweep belongs to the variant that its labels name; a run folder named by itself, to that of all such runs
//! whose pipelines differ in seed and name alone.

mod blocks;
mod comparison;
pub mod figures;
mod format;
mod output;
mod page;
mod record;
mod statistics;
mod tables;

pub use output::{Options, check, write};
pub use record::{Record, Score};

use crate::folder::PIPELINE;
use crate::sweep::{LISTING, Listing};
use pwrfgs_core::{Error, Result, plugin::ron_options};
use std::path::{Path, PathBuf};

/// Axis and label, for each axis.
type Labels = Vec<(String, String)>;

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
    /// Folders read so far.
    seen: Vec<PathBuf>,
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
        let mut study = Self::default();
        let several = folders.len() > 1;
        let mut titles: Vec<String> = Vec::new();
        let (mut records, mut alone) = (Vec::new(), Vec::new());
        for folder in folders {
            if let Some(listing) = Listing::read(folder)? {
                for run in &listing.runs {
                    let mut labels = run.labels.clone();
                    if several {
                        labels.insert(0, (String::new(), listing.name.clone()));
                    }
                    records.extend(study.take(&folder.join(&run.folder))?.map(|record| (labels, record)));
                }
                titles.push(listing.name);
            } else if folder.join(PIPELINE).is_file() {
                alone.extend(study.take(folder)?);
            } else {
                return Err(Error::Config(format!(
                    "{} holds neither a run ({PIPELINE}) nor a sweep ({LISTING}); name a folder that `pwrfgs run` or \
                     `pwrfgs sweep` made",
                    folder.display()
                )));
            }
        }
        for (name, record) in named(alone) {
            titles.push(name.clone());
            records.push((vec![(String::new(), name)], record));
        }
        titles.dedup();
        study.title = titles.join(", ");
        if records.is_empty() {
            let missing = study.unfinished.len();
            return Err(Error::Config(format!("none of these {missing} runs has finished; run them first")));
        }
        study.settings = settings(records);
        study.leave_twins_out();
        Ok(study)
    }

    /// Reads one run folder, or notes that it has not finished or was named before.
    fn take(&mut self, folder: &Path) -> Result<Option<Record>> {
        let place = folder.canonicalize().unwrap_or_else(|_| folder.into());
        if self.seen.contains(&place) {
            self.repeated.push(folder.into());
            return Ok(None);
        }
        self.seen.push(place);
        let record = Record::read(folder)?;
        if record.is_none() {
            self.unfinished.push(folder.into());
        }
        Ok(record)
    }

    /// Keeps one run a seed in each variant: the same run counted twice would look like certainty.
    fn leave_twins_out(&mut self) {
        for variant in self.settings.iter_mut().flat_map(|s| &mut s.variants) {
            let mut seeds = Vec::new();
            let (kept, twins) = std::mem::take(&mut variant.runs).into_iter().partition(|run| {
                let is_new = !seeds.contains(&run.facts.seed);
                seeds.push(run.facts.seed);
                is_new
            });
            variant.runs = kept;
            self.repeated.extend(Vec::<Record>::into_iter(twins).map(|run| run.folder));
        }
    }
}

/// Gives runs that were named one by one the names of their variants: what the folders of all seeds begin with.
fn named(alone: Vec<Record>) -> Vec<(String, Record)> {
    let keys: Vec<String> = alone.iter().map(Record::variant_key).collect();
    let folder = |record: &Record| {
        let whole = record.folder.canonicalize().unwrap_or_else(|_| record.folder.clone());
        whole.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned())
    };
    let mut names: Vec<(&String, String)> = Vec::new();
    for (key, first) in keys.iter().zip(&alone) {
        if names.iter().any(|(known, _)| *known == key) {
            continue;
        }
        let all: Vec<String> = keys.iter().zip(&alone).filter(|(k, _)| *k == key).map(|(_, r)| folder(r)).collect();
        let mut name = if all.len() > 1 { common_start(&all) } else { all[0].clone() };
        if name.is_empty() {
            name.clone_from(&first.pipeline.name);
        }
        if names.iter().any(|(_, known)| *known == name) {
            name = first.folder.display().to_string();
        }
        names.push((key, name));
    }
    let name = |key: &String| names.iter().find(|(k, _)| *k == key).map_or_else(String::new, |(_, name)| name.clone());
    let all: Vec<String> = keys.iter().map(name).collect();
    all.into_iter().zip(alone).collect()
}

/// What all begin with, without the separator, or `seed`, before what differs: `init` of `init-0` and `init-1`.
fn common_start(names: &[String]) -> String {
    let mut start = names[0].clone();
    while !names.iter().all(|name| name.starts_with(&start)) {
        start.pop();
    }
    let is_end = |c: char| c.is_ascii_digit() || " -_.=".contains(c);
    // Digits belong to what differs (`a10`, `a11`), unless nothing differs.
    let start = if names.iter().all(|name| *name == start) { &start } else { start.trim_end_matches(is_end) };
    start.trim_end_matches("seed").trim_end_matches(|c| " -_.=".contains(c)).to_owned()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_share_the_start_of_their_names() {
        let of = |names: &[&str]| common_start(&names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>());
        assert_eq!(of(&["init-cloud-0", "init-cloud-1", "init-cloud-12"]), "init-cloud");
        assert_eq!(of(&["a10", "a11"]), "a");
        assert_eq!(of(&["x_seed=1", "x_seed=2"]), "x");
        assert_eq!(of(&["run7", "run7"]), "run7");
        assert_eq!(of(&["0", "1"]), "");
    }
}
