//! `Setting` and `StudyVariant`: group runs and name the groups.

use crate::folder::MODEL_FILE;
use crate::scores::MODEL;
use crate::statistics::Spread;
use crate::{FileDigest, Record};
use pwrfgs_core::{Error, Headline, Result, Task, plugin::ron_line};
use pwrfgs_pipeline::Pipeline;
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;

/// Runs on the same data and the same split.
#[derive(Clone, Debug)]
pub struct Setting {
    /// Title of the data, and the split as RON; all splits if runs differ in `validation`.
    pub title: String,
    /// Whether the spectra are simulated.
    pub simulated: bool,
    /// Variants in the order of the plan; none is empty.
    pub variants: Vec<StudyVariant>,
}

/// Runs that differ only in their seed.
#[derive(Clone, Debug)]
pub struct StudyVariant {
    /// Label that distinguishes it in its setting, such as `lambda 0.02`.
    pub label: String,
    /// Axes of its sweep, each with the value of the variant; the axis without a name has that of the sweep or run.
    pub axes: Vec<(String, String)>,
    /// One run per seed, in ascending order of seeds.
    pub runs: Vec<Record>,
}

impl Setting {
    /// Lists all runs.
    pub fn runs(&self) -> impl Iterator<Item = &Record> {
        self.variants.iter().flat_map(|v| &v.runs)
    }

    /// Lists the names of the baselines, without repetition.
    pub fn baselines(&self) -> Vec<&str> {
        distinct(self.runs().flat_map(|run| run.scores.table.baselines()))
    }

    /// Returns whether a baseline has its predictions from another program.
    pub fn is_external(&self, name: &str) -> bool {
        let mut baselines = self.runs().flat_map(|run| &run.pipeline.baselines);
        baselines.any(|baseline| baseline.is_external() && baseline.name() == name)
    }

    /// Returns the score of a baseline by a metric, as the mean over all runs; `None` if no run has it.
    pub fn baseline_score(&self, name: &str, key: &str) -> Option<f64> {
        let values: Vec<f64> = self.runs().filter_map(|run| run.scores.value(name, key)).collect();
        Some(Spread::of(&values)?.mean)
    }

    /// Finds the first variant before variant `k` with the same models, seed by seed: the difference in settings has no
    /// effect. `None` without such a variant, or if `run.json` lacks the checksum of a model.
    pub fn earlier_twin(&self, k: usize) -> Option<&StudyVariant> {
        let models = self.variants[k].model_files()?;
        self.variants[..k].iter().find(|other| other.model_files().as_ref() == Some(&models))
    }

    /// Returns the task, common to all runs; the default without runs.
    pub fn task(&self) -> Task {
        self.runs().next().map_or_else(Task::default, |run| run.scores.table.task)
    }

    /// Returns the headline metric of the task.
    pub fn headline(&self) -> Headline {
        self.task().headline
    }

    /// Returns the smallest and largest number of seeds of a variant; 0 without variants.
    pub fn seed_counts(&self) -> (usize, usize) {
        let counts = || self.variants.iter().map(|v| v.runs.len());
        (counts().min().unwrap_or(0), counts().max().unwrap_or(0))
    }
}

impl StudyVariant {
    /// Computes mean and deviation of `value` over the runs that have it; `None` if none has.
    pub fn spread(&self, value: impl Fn(&Record) -> Option<f64>) -> Option<Spread> {
        Spread::of(&self.runs.iter().filter_map(value).collect::<Vec<_>>())
    }

    /// Computes mean and deviation of the scores of the models by a metric; `None` if no run has it.
    pub fn score(&self, key: &str) -> Option<Spread> {
        self.spread(|run| run.scores.value(MODEL, key))
    }

    /// Returns the number of training steps, common to all runs; `None` without runs.
    pub(super) fn steps(&self) -> Option<u64> {
        self.runs.first().map(|run| run.pipeline.training.steps)
    }

    /// Lists seeds and checksums of the models of all runs; `None` if `run.json` of a run lacks the checksum.
    fn model_files(&self) -> Option<Vec<(u64, &FileDigest)>> {
        self.runs.iter().map(|run| Some((run.pipeline.seed, run.facts.files.get(MODEL_FILE)?))).collect()
    }
}

/// Largest number of names in a title, if more than one is left out.
const TITLES: usize = 4;

/// Axis and label, for each axis.
pub(super) type Labels = Vec<(String, String)>;

/// Joins names by commas, without repetition. Of those beyond [`TITLES`], it gives the number, unless it is a single one.
pub(super) fn joined_names(names: Vec<String>) -> String {
    let unique = distinct(names);
    let more = unique.len().saturating_sub(TITLES);
    if more > 1 { format!("{} and {more} more", unique[..TITLES].join(", ")) } else { unique.join(", ") }
}

/// Returns separately given runs with the name of their variant: the common start of the folder names of all seeds. If there
/// is none, the name of the pipeline; if another variant has that name, the path of the first folder.
pub(super) fn name_single_runs(runs: Vec<Record>) -> Result<Vec<(String, Record)>> {
    let keys: Vec<String> = runs.iter().map(Record::variant_key).collect::<Result<_>>()?;
    let folder = |record: &Record| {
        let whole = record.folder.canonicalize().unwrap_or_else(|_| record.folder.clone());
        whole.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned())
    };
    let mut names: BTreeMap<&String, String> = BTreeMap::new();
    for (key, first) in keys.iter().zip(&runs) {
        if names.contains_key(key) {
            continue;
        }
        let folders: Vec<String> = keys.iter().zip(&runs).filter(|(k, _)| *k == key).map(|(_, r)| folder(r)).collect();
        let mut name = if folders.len() > 1 { common_prefix(&folders) } else { folders[0].clone() };
        if name.is_empty() {
            name.clone_from(&first.pipeline.name);
        }
        if names.values().any(|other| *other == name) {
            name = first.folder.display().to_string();
        }
        names.insert(key, name);
    }
    Ok(keys.iter().map(|key| names[key].clone()).zip(runs).collect())
}

/// Returns the common start of at least one name, without the separator or `seed` before the difference: `init` of
/// `init-0` and `init-1`.
fn common_prefix(names: &[String]) -> String {
    let mut start = names[0].clone();
    while !names.iter().all(|name| name.starts_with(&start)) {
        start.pop();
    }
    let is_separator = |c: char| " -_.=,".contains(c);
    // The first digits of a number belong to the difference (`a10`, `a11`), unless nothing differs.
    let start = match start.chars().last() {
        Some(c) if c.is_ascii_digit() && names.iter().any(|name| *name != start) => {
            start.trim_end_matches(|c: char| c.is_ascii_digit())
        }
        _ => &start,
    };
    let start = start.trim_end_matches(is_separator);
    start.strip_suffix("seed").unwrap_or(start).trim_end_matches(is_separator).to_owned()
}

/// Returns a key of data and split: equal for runs whose scores are comparable. It excludes the validation share of the
/// split, which does not affect the test set.
///
/// # Errors
/// Data or a split without JSON form.
pub(super) fn setting_key(record: &Record) -> Result<Value> {
    let failed = |e| Error::input(&record.folder, format!("data and split cannot be compared: {e}"));
    let Pipeline { data, split, .. } = &record.pipeline;
    let [data, mut split] = [named_fields(data).map_err(failed)?, named_fields(split).map_err(failed)?];
    let (_, fields) = &mut split;
    if let Some(fields) = fields.as_object_mut() {
        fields.remove("validation");
    }
    Ok([data, split].into_iter().map(|(name, fields)| Value::from_iter([(name, fields)])).collect())
}

/// Returns name and fields of a plugin; the JSON of a plugin has no name.
fn named_fields(plugin: &impl Serialize) -> serde_json::Result<(String, Value)> {
    let name = ron_line(plugin).split('(').next().unwrap_or_default().to_owned();
    // Through text, so that single-precision numbers keep the digits of the file.
    Ok((name, serde_json::from_str(&serde_json::to_string(plugin)?)?))
}

/// Groups runs by setting and variant, in order of appearance, and titles the settings.
pub(super) fn group_by_setting(records: Vec<(Labels, Record)>) -> Result<Vec<Setting>> {
    let mut groups: Vec<(Value, Vec<(Labels, Record)>)> = Vec::new();
    for (labels, record) in records {
        let key = setting_key(&record)?;
        match groups.iter_mut().find(|(other, _)| *other == key) {
            Some((_, group)) => group.push((labels, record)),
            None => groups.push((key, vec![(labels, record)])),
        }
    }
    let mut settings: Vec<(Value, Setting)> = Vec::new();
    for (key, group) in groups {
        let splits = distinct(group.iter().map(|(_, record)| ron_line(&record.pipeline.split)));
        let (_, Record { facts, .. }) = &group[0];
        let simulated = facts.simulated;
        // Of measured data, `Official` is a published split.
        let is_own = simulated && splits.iter().any(|split| split.starts_with("Official"));
        let title =
            format!("{}; {}{}", facts.data, splits.join(" and "), if is_own { " of the simulation" } else { "" });
        settings.push((key, Setting { title, simulated, variants: group_by_variant(group)? }));
    }
    distinguish_titles(&mut settings);
    Ok(settings.into_iter().map(|(_, setting)| setting).collect())
}

/// Adds the differing fields of data and split, such as `samples: 200`, to the titles of settings with equal titles.
fn distinguish_titles(settings: &mut [(Value, Setting)]) {
    let titles: Vec<(String, Vec<String>)> =
        settings.iter().map(|(key, s)| (s.title.clone(), list_fields(key))).collect();
    for ((_, setting), (title, fields)) in settings.iter_mut().zip(&titles) {
        let twins = || titles.iter().filter(|(other, _)| other == title);
        let differ = |field: &&String| !twins().all(|(_, fields)| fields.contains(field));
        let differ: Vec<&str> = fields.iter().filter(differ).map(String::as_str).collect();
        if !differ.is_empty() {
            setting.title = format!("{title}; {}", differ.join(", "));
        }
    }
}

/// Lists the fields of plugins with their values, including nested plugins; the name of a plugin is a separate field.
fn list_fields(value: &Value) -> Vec<String> {
    let named = |(name, value): (&String, &Value)| match value {
        Value::Object(_) | Value::Array(_) => [vec![name.clone()], list_fields(value)].concat(),
        plain => vec![format!("{name}: {plain}")],
    };
    match value {
        Value::Object(map) => map.iter().flat_map(named).collect(),
        Value::Array(items) => items.iter().flat_map(list_fields).collect(),
        plain => vec![plain.to_string()],
    }
}

/// Groups the runs of one setting by pipeline, independent of names. Of runs with the same seed, the first is kept.
fn group_by_variant(group: Vec<(Labels, Record)>) -> Result<Vec<StudyVariant>> {
    let mut variants: Vec<(String, Labels, Vec<Record>)> = Vec::new();
    for (labels, record) in group {
        let key = record.variant_key()?;
        match variants.iter_mut().find(|(other, ..)| *other == key) {
            Some((.., runs)) if runs.iter().any(|r| r.pipeline.seed == record.pipeline.seed) => {}
            Some((.., runs)) => runs.push(record),
            None => variants.push((key, labels, vec![record])),
        }
    }
    let names = variant_names(&variants.iter().map(|(_, labels, _)| labels).collect::<Vec<_>>());
    let variant = |((_, axes, mut runs), label): ((String, Labels, Vec<Record>), String)| {
        runs.sort_by_key(|r| r.facts.seed);
        StudyVariant { label, axes, runs }
    };
    Ok(variants.into_iter().zip(names).map(variant).collect())
}

/// Names the variants by the axes on which they differ, and the sweep if needed. Words on a single axis need no name of it.
fn variant_names(variants: &[&Labels]) -> Vec<String> {
    let label_on = |labels: &Labels, axis: &str| labels.iter().find(|(a, _)| a == axis).map(|(_, label)| label.clone());
    let differ = |axis: &str| variants.iter().any(|labels| label_on(labels, axis) != label_on(variants[0], axis));
    let axes = distinct(variants.iter().flat_map(|labels| labels.iter().map(|(axis, _)| axis.as_str())));
    let differing: Vec<&str> = axes.into_iter().filter(|axis| !axis.is_empty() && differ(axis)).collect();
    if let [axis] = differing[..] {
        let words: Vec<String> = variants.iter().filter_map(|labels| label_on(labels, axis)).collect();
        let is_word = |word: &String| word.starts_with(char::is_alphabetic);
        if words.len() == variants.len() && words.iter().all(is_word) && distinct(&words).len() == words.len() {
            return words;
        }
    }
    let name = |labels: &Labels, is_wanted: &dyn Fn(&str) -> bool| {
        let words = labels.iter().filter(|(axis, _)| is_wanted(axis));
        words.map(|(axis, label)| format!("{axis} {label}").trim().to_owned()).collect::<Vec<_>>().join(", ")
    };
    // A name that is empty or not unique is replaced by all labels, among them the name of the sweep.
    let short: Vec<String> = variants.iter().map(|l| name(l, &|axis| differing.contains(&axis))).collect();
    let clear = |k: usize| !short[k].is_empty() && short.iter().filter(|other| **other == short[k]).count() == 1;
    (0..short.len()).map(|k| if clear(k) { short[k].clone() } else { name(variants[k], &|_| true) }).collect()
}

/// Removes repeated items, keeping the first of each; in the order of `items`.
pub fn distinct<T: PartialEq>(items: impl IntoIterator<Item = T>) -> Vec<T> {
    let mut unique = Vec::new();
    for item in items {
        if !unique.contains(&item) {
            unique.push(item);
        }
    }
    unique
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn equal_titles_are_distinguished_by_differing_setting() {
        let setting = |samples: u32, split: Value, title: &str| {
            let key = json!([{"Simulated": {"samples": samples, "seed": 0}}, split]);
            (key, Setting { title: title.into(), simulated: true, variants: Vec::new() })
        };
        let random = json!({"Random": {"test": 0.2, "place": {"inner": [1, 2]}}});
        let mut settings = [
            setting(200, json!({"Official": {}}), "office"),
            setting(1000, json!({"Official": {}}), "office"),
            setting(200, random, "office; Random(test: 0.2)"),
        ];
        distinguish_titles(&mut settings);
        let titles = settings.map(|(_, setting)| setting.title);
        assert_eq!(titles, ["office; samples: 200", "office; samples: 1000", "office; Random(test: 0.2)"]);
    }

    #[test]
    fn variant_labels_name_differing_settings() {
        let labels = |all: &[(&str, &str)]| all.iter().map(|(a, l)| ((*a).to_owned(), (*l).to_owned())).collect();
        let names_of = |all: &[&[(&str, &str)]]| {
            let all: Vec<Labels> = all.iter().map(|l| labels(l)).collect();
            variant_names(&all.iter().collect::<Vec<_>>())
        };
        let (lambda, epsilon) = (("", "lambda"), ("", "epsilon"));
        let two = names_of(&[&[lambda, ("lambda", "0")], &[lambda, ("lambda", "1")], &[epsilon, ("epsilon", "0.1")]]);
        assert_eq!(two, ["lambda 0", "lambda 1", "epsilon 0.1"]);
        let axes = names_of(&[&[("a", "x"), ("b", "1"), ("c", "z")], &[("a", "y"), ("b", "1"), ("c", "z")]]);
        assert_eq!(axes, ["x", "y"]);
        let twins = names_of(&[&[("", "p"), ("a", "x")], &[("", "q"), ("a", "x")], &[("", "q"), ("a", "y")]]);
        assert_eq!(twins, ["p, a x", "q, a x", "a y"]);
        assert_eq!(names_of(&[&[("a", "x")]]), ["a x"]);
    }

    #[test]
    fn title_lists_unique_names_and_limits_count() {
        let title = |names: &[&str]| joined_names(names.iter().map(|n| (*n).to_owned()).collect());
        assert_eq!(title(&["a", "b", "a"]), "a, b");
        assert_eq!(title(&["a", "b", "c", "d", "e"]), "a, b, c, d, e");
        assert_eq!(title(&["a", "b", "c", "d", "e", "f"]), "a, b, c, d and 2 more");
    }

    #[test]
    fn runs_of_one_variant_share_name_prefix() {
        let start = |names: &[&str]| common_prefix(&names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>());
        assert_eq!(start(&["init-cloud-0", "init-cloud-1", "init-cloud-12"]), "init-cloud");
        assert_eq!(start(&["random10-0", "random10-1"]), "random10");
        assert_eq!(start(&["a10", "a11"]), "a");
        assert_eq!(start(&["x_seed=1", "x_seed=2"]), "x");
        assert_eq!(start(&["run7", "run7"]), "run7");
        assert_eq!(start(&["0", "1"]), "");
    }
}
