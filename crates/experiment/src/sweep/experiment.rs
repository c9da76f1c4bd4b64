//! `Experiment`: sweep as one RON file, with axes of changes to a base pipeline and a list of seeds.

use pwrfgs_core::plugin::{Check, Checked, read_ron};
use pwrfgs_core::{JsonSchema, Result};
use pwrfgs_pipeline::Changes;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// A sweep: all combinations of one variant per axis, each with every seed.
///
/// ```
/// # use pwrfgs_experiment::sweep::Experiment;
/// let text = r#"Experiment(
///     name: "short-or-long",
///     base: "../pipelines/quickstart.ron", // relative to this file
///     seeds: [0, 1, 2],
///     set: {"training.batch": 4},          // for all runs; other settings keep the value of the base
///     axes: [
///         Axis(name: "steps", variants: [
///             (label: "short", set: {"training.steps": 500}),
///             (label: "long", set: {"training.steps": 2_000}),
///         ]),
///         Axis(name: "width", variants: [
///             (label: "64", set: {"deformation.Mlp.width": 64}), // one field of a plugin
///             (label: "128", set: {"deformation.Mlp.width": 128}),
///         ]),
///     ],
///     slurm: (cpus: 4, memory: "8G", time: "02:00:00"), // only with --launcher slurm
/// )"#;
/// let experiment = Experiment::parse(text, "short-or-long.ron".as_ref()).unwrap();
/// assert_eq!(experiment.axes[0].variants[1].label, "long");
/// ```
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Experiment {
    /// Name of the sweep folder: letters, digits, `.`, `-` and `_`.
    pub name: String,
    /// Base pipeline of all runs, relative to the experiment file.
    #[schemars(extend("format" = "path"))]
    pub base: PathBuf,
    /// Random seeds; every combination runs with each seed.
    #[serde(default = "default_seeds")]
    pub seeds: Vec<u64>,
    /// Whether to combine the models of all runs into one ensemble that predicts their mean. All runs need the same
    /// data, split and projector.
    #[serde(default)]
    pub join: bool,
    /// Settings of all runs by path, as in `--set`: `{"training.steps": 500, "split": Voxel(size_m: 0.2)}`.
    #[serde(default)]
    pub set: Changes,
    /// Axes of the sweep; if omitted, only the seeds vary. If two axes set the same path, the later axis applies.
    #[serde(default)]
    pub axes: Vec<Checked<Axis>>,
    /// Slurm resources of each run, for `--launcher slurm`.
    #[serde(default)]
    pub slurm: Checked<Slurm>,
}

/// Axis of a sweep: one thing that varies.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Axis {
    /// Name in folders, tables and figures.
    pub name: String,
    /// Variants, each with a label and its changes: `(label: "0.05", set: {"pruners.LearnableMask.lambda": 0.05})`.
    pub variants: Vec<Checked<SweepVariant>>,
}

/// Variant of an axis. A variant with only a label is the unchanged base.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SweepVariant {
    /// Name in folders, tables and figures.
    pub label: String,
    /// Pipeline that replaces the base of the experiment, relative to the experiment file; only in the first axis.
    #[serde(default)]
    #[schemars(extend("format" = "path"))]
    pub base: Option<PathBuf>,
    /// Settings by path, applied in this order.
    #[serde(default)]
    pub set: Changes,
}

/// Resources of one run on a cluster, as `sbatch` names them.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Slurm {
    /// Processors per run, `--cpus-per-task`; also the number of threads.
    pub cpus: usize,
    /// Memory per run, `--mem`, such as `4G`.
    pub memory: String,
    /// Time limit per run, `--time`, at least 5 minutes: a run is warned a minute or two before. A longer run returns
    /// to the queue and resumes.
    pub time: String,
    /// Partition, `--partition`; if omitted, the cluster selects it.
    pub partition: Option<String>,
    /// Account, `--account`.
    pub account: Option<String>,
    /// Maximum number of parallel runs.
    pub at_once: Option<usize>,
    /// More options for `sbatch`, such as `--qos=long`.
    pub options: Vec<String>,
    /// Shell lines before the run, such as `module load gcc`. They run with your permissions: check files from other
    /// people.
    pub setup: Vec<String>,
}

impl Default for Slurm {
    fn default() -> Self {
        Self {
            cpus: 2,
            memory: "4G".into(),
            time: "04:00:00".into(),
            partition: None,
            account: None,
            at_once: None,
            options: Vec::new(),
            setup: Vec::new(),
        }
    }
}

/// Returns the default seeds.
fn default_seeds() -> Vec<u64> {
    vec![0]
}

impl Experiment {
    /// Reads an experiment; `path` is for messages only.
    ///
    /// # Errors
    /// [`Error::Input`](pwrfgs_core::Error::Input) with line and column if the text is not a valid experiment.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        read_ron::<Checked<Self>>(text, path).map(|e| Self::clone(&e))
    }
}

impl Check for SweepVariant {
    fn check(&self) -> Result<(), String> {
        let Self { label, set, .. } = self;
        if slug(label).is_empty() {
            return Err(format!("the label `{label}` cannot name a folder; use some letters"));
        }
        if set.has_field("name") || set.has_field("seed") {
            return Err("a variant cannot set `name` or `seed`; list seeds in `seeds`".into());
        }
        Ok(())
    }
}

/// Converts `text` to a part of a folder name: keeps ASCII letters, digits, `.`, `_` and `+`, with one `-` for all characters
/// between them. The minus sign of a number at the start is kept. Empty if nothing is kept.
pub(super) fn slug(text: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || "._-+".contains(c) { c } else { '-' };
    let plain: String = text.chars().map(plain).collect();
    let words: Vec<&str> = plain.split('-').filter(|w| !w.is_empty()).collect();
    // A sign belongs to the following number.
    let is_signed =
        |sign: &str| text.strip_prefix(sign).is_some_and(|digits| digits.starts_with(|c: char| c.is_ascii_digit()));
    format!("{}{}", if is_signed("-") { "-" } else { "" }, words.join("-"))
}

/// Returns an error for a name that is not valid as a folder name.
fn check_name(name: &str) -> Result<(), String> {
    if slug(name) != *name || name.is_empty() || name.starts_with('.') || name.contains('+') {
        return Err(format!("name: `{name}` cannot name a folder; use letters, digits, `-`, `_` and, not first, `.`"));
    }
    Ok(())
}

/// Returns an error for an empty list of seeds, or a repeated seed.
fn check_seeds(seeds: &[u64]) -> Result<(), String> {
    if seeds.is_empty() {
        return Err("`seeds` is empty; give at least one, such as [0]".into());
    }
    match first_repeated(seeds.iter().map(u64::to_string)) {
        Some(twice) => Err(format!("the seed {twice} comes twice in `seeds`")),
        None => Ok(()),
    }
}

/// Returns the first repeated element of `names`; `None` if they are distinct.
fn first_repeated(names: impl Iterator<Item = String>) -> Option<String> {
    let mut seen = std::collections::BTreeSet::new();
    names.into_iter().find(|name| !seen.insert(name.clone()))
}

impl Check for Axis {
    fn check(&self) -> Result<(), String> {
        let Self { name, variants } = self;
        if slug(name) != *name || name.is_empty() || name == "seed" {
            return Err(format!(
                "the axis `{name}` cannot name a folder; use letters, digits, `.`, `-` and `_`, and not `seed`"
            ));
        }
        if variants.is_empty() {
            return Err(format!("the axis `{name}` has no variant; add at least one"));
        }
        match first_repeated(variants.iter().map(|v| slug(&v.label).to_lowercase())) {
            Some(twice) => Err(format!("two labels of the axis `{name}` name the folder `{twice}`; change one")),
            None => Ok(()),
        }
    }
}

impl Check for Experiment {
    fn check(&self) -> Result<(), String> {
        let Self { name, seeds, set, axes, .. } = self;
        check_name(name)?;
        check_seeds(seeds)?;
        if set.has_field("name") || set.has_field("seed") {
            return Err("`set` applies to all runs and cannot set `name` or `seed`".into());
        }
        if let Some(axis) = axes.iter().skip(1).find(|axis| axis.variants.iter().any(|v| v.base.is_some())) {
            return Err(format!("axis `{}`: only variants of the first axis may have a `base`", axis.name));
        }
        match first_repeated(axes.iter().map(|a| a.name.to_lowercase())) {
            Some(twice) => Err(format!("two axes are called `{twice}`; change one")),
            None => Ok(()),
        }
    }
}

impl Check for Slurm {
    fn check(&self) -> Result<(), String> {
        if self.cpus == 0 || self.at_once == Some(0) {
            return Err("`cpus` and `at_once` must be at least 1".into());
        }
        let words = [Some(&self.memory), Some(&self.time), self.partition.as_ref(), self.account.as_ref()];
        let words = words.into_iter().flatten().chain(&self.options);
        for word in words {
            if word.is_empty() || word.contains(char::is_whitespace) {
                return Err(format!("`{word}`: an option of sbatch is one word, such as \"4G\" or \"--qos=long\""));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::slug;

    #[test]
    fn labels_become_folder_names() {
        let names = ["0.01", "point cloud", "λ = 0.02", "-3 dB", "+3", "a/../b", "λ", "Voxel(0.3 m)"].map(slug);
        assert_eq!(names, ["0.01", "point-cloud", "0.02", "-3-dB", "+3", "a-..-b", "", "Voxel-0.3-m"]);
    }
}
