//! `SweepPlan`: every run of an experiment as a resolved pipeline with a separate folder.

use super::experiment::{Axis, Experiment, Slurm, slug};
use super::listing::{ListedRun, Listing};
use crate::input::{apply_arguments, apply_changes, read_base};
use pwrfgs_core::files::MAX_TEXT;
use pwrfgs_core::plugin::to_ron;
use pwrfgs_core::{Error, Result, ShippedFile, did_you_mean};
use pwrfgs_model::file::MOST_MEMBERS;
use pwrfgs_pipeline::ron_tree::RonTree;
use pwrfgs_pipeline::{Change, Pipeline, PipelineEdit};
use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};

/// Run folder of the joined model, relative to the sweep folder.
pub const JOINED: &str = "joined";

/// Longest folder name of common file systems, bytes.
const LONGEST_NAME: usize = 255;

/// Largest number of runs of a sweep.
const MOST_RUNS: usize = 10_000;

/// An experiment with all its runs.
#[derive(Clone, Debug)]
pub struct SweepPlan {
    /// Name of the experiment.
    pub name: String,
    /// The sweep folder.
    pub folder: PathBuf,
    /// All combinations times seeds; runs of one combination are consecutive.
    pub runs: Vec<PlannedRun>,
    /// Pipeline for scoring the joined model, named after the experiment, if the runs are joined.
    pub joined: Option<Pipeline>,
    /// Slurm resources of a run.
    pub slurm: Slurm,
    /// The experiment file, for messages.
    source: PathBuf,
}

/// One run.
#[derive(Clone, Debug)]
pub struct PlannedRun {
    /// Run folder, relative to the sweep folder, such as `init=random,lambda=0.02,seed=1`.
    pub folder: String,
    /// Axis and label, for each axis.
    pub labels: Vec<(String, String)>,
    /// Index of its combination, counted from 0: its runs differ only in their seed.
    pub combination: usize,
    /// Pipeline of the run, with absolute paths.
    pub pipeline: Pipeline,
    /// Last variant that sets the start of the run: base, data, split or initialiser.
    start: Option<VariantStart>,
}

/// Variant that sets the start of a run.
#[derive(Clone, Debug)]
struct VariantStart {
    /// Axis and label, for messages.
    title: String,
    /// Line and column in the experiment file.
    at: Option<(usize, usize)>,
}

impl SweepPlan {
    /// Reads the experiment in `path` and creates all its runs; `set` holds `--set` arguments, which change the base,
    /// so axes override them. The sweep folder is `out`, or `runs/NAME`.
    ///
    /// # Errors
    /// An invalid experiment (with line and column), base, or combination (with axis and label).
    pub fn read(path: &Path, set: &[String], out: Option<&Path>) -> Result<Self> {
        let text = ShippedFile::read(ShippedFile::EXPERIMENTS, path, MAX_TEXT)?;
        Self::of(&Experiment::parse(&text, path)?, (path, &text), None, set, out)
    }

    /// Creates all runs as [`Self::read`] does, for an `experiment` of the file `path` with this `text`; `base`
    /// replaces its base pipeline.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn of(
        experiment: &Experiment,
        (path, text): (&Path, &str),
        base: Option<&Pipeline>,
        set: &[String],
        out: Option<&Path>,
    ) -> Result<Self> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let tree = RonTree::parse(text).map_err(|why| Error::input(path, why))?;
        let source = ExperimentSource { path, folder, experiment, text, tree: &tree, set };
        let read_named_base = || read_base(folder, &experiment.base);
        let draft = source.apply_common(base.map_or_else(read_named_base, PipelineEdit::of)?)?;
        source.refuse_too_many_runs()?;
        let mut combinations = vec![Combination { labels: Vec::new(), start: None, draft }];
        for axis in 0..experiment.axes.len() {
            combinations = source.cross_axis(axis, &combinations)?;
        }
        let pipelines: Vec<Pipeline> = combinations.iter().map(|c| source.finish_pipeline(c)).collect::<Result<_>>()?;
        source.refuse_equal_pipelines(&combinations, &pipelines)?;
        let mut runs = Vec::new();
        for (k, (combination, pipeline)) in combinations.iter().zip(&pipelines).enumerate() {
            for &seed in &experiment.seeds {
                runs.push(source.plan_run(k, combination, pipeline, seed)?);
            }
        }
        let joined = experiment.join.then(|| align_runs(&experiment.name, &mut runs)).transpose();
        Ok(Self {
            joined: joined.map_err(|why| Error::input(path, format!("join: {why}")))?,
            folder: out.map_or_else(|| Path::new("runs").join(&experiment.name), Path::to_path_buf),
            name: experiment.name.clone(),
            runs,
            slurm: Slurm::clone(&experiment.slurm),
            source: path.to_owned(),
        })
    }

    /// Creates the error of a run that cannot start, at the responsible variant. An error of a plugin remains the source of the
    /// new one.
    pub(super) fn start_error(&self, run: usize, error: Error) -> Error {
        let PlannedRun { folder, start, .. } = &self.runs[run];
        let message = format!("{folder}: {error}");
        let named = match start {
            Some(VariantStart { title, at }) => {
                Error::Input { path: self.source.clone(), at: *at, message: format!("{title}: {message}") }
            }
            None => Error::input(&self.source, message),
        };
        match error {
            Error::Plugin(source) => Error::Plugin(Box::new(StartFailure { message: named.to_string(), source })),
            _ => named,
        }
    }

    /// Returns the folder of a run.
    pub fn run_folder(&self, run: usize) -> PathBuf {
        self.folder.join(&self.runs[run].folder)
    }

    /// Creates the content of `sweep.json`.
    pub fn listing(&self) -> Listing {
        let listed =
            |r: &PlannedRun| ListedRun { folder: r.folder.clone(), labels: r.labels.clone(), seed: r.pipeline.seed };
        Listing { name: self.name.clone(), runs: self.runs.iter().map(listed).collect() }
    }

    /// Creates the sweep folder or reuses that of an earlier start, and writes `sweep.json`. Until the returned file is
    /// dropped, other processes wait before they change the list, submit runs or write the report.
    ///
    /// # Errors
    /// The folder holds other content or runs of another experiment, or cannot be written.
    pub fn claim(&self) -> Result<File> {
        self.listing().claim(&self.folder)
    }

    /// Finds the indices of the runs whose folder has all parts of `name`, such as `seed=0` or `init=random,seed=1`.
    ///
    /// # Errors
    /// No such run; the error suggests the nearest folder.
    pub fn find_runs(&self, name: &str) -> Result<Vec<usize>> {
        let has_parts = |folder: &str| name.split(',').all(|part| folder.split(',').any(|other| other == part));
        let runs: Vec<usize> = (0..self.runs.len()).filter(|&run| has_parts(&self.runs[run].folder)).collect();
        if runs.is_empty() {
            let hint = did_you_mean(name, self.runs.iter().map(|r| r.folder.as_str()));
            return Err(Error::Config(format!("unknown run `{name}` of {}{hint}", self.name)));
        }
        Ok(runs)
    }
}

/// Error of a plugin in a run that cannot start.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
struct StartFailure {
    message: String,
    source: Box<dyn std::error::Error + Send + Sync>,
}

/// Combination of variants of some axes.
struct Combination {
    /// Axis and label, for each applied axis.
    labels: Vec<(String, String)>,
    /// Last variant that sets the start of the run.
    start: Option<VariantStart>,
    draft: PipelineEdit,
}

/// The experiment file.
struct ExperimentSource<'a> {
    path: &'a Path,
    /// Folder of the file, to which its paths are relative.
    folder: &'a Path,
    experiment: &'a Experiment,
    text: &'a str,
    tree: &'a RonTree,
    /// `--set` arguments.
    set: &'a [String],
}

impl ExperimentSource<'_> {
    /// Applies the settings of all runs and the `--set` arguments to a base. Values are validated later, together with
    /// those of the axes.
    ///
    /// # Errors
    /// An invalid change, or an argument that sets `name` or `seed`.
    fn apply_common(&self, mut draft: PipelineEdit) -> Result<PipelineEdit> {
        let set = self.experiment.set.located("set", self.tree.field("set"), self.text);
        apply_changes(&mut draft, &set.0, self.folder).map_err(|fault| fault.in_file(self.path))?;
        apply_arguments(&mut draft, self.set)?;
        let is_reserved = |change: Change| ["name", "seed"].contains(&change.field());
        if self.set.iter().any(|argument| Change::parse_argument(argument).is_ok_and(is_reserved)) {
            let problem = "--set: a sweep sets `name` and `seed` itself; change them in the experiment file";
            return Err(Error::Config(problem.into()));
        }
        // Changes that give a valid base are not to blame for faults of an axis.
        draft.finish().map_or(Ok(draft), |base| PipelineEdit::of(&base))
    }

    /// Combines each of `combinations` with each variant of the axis number `axis`, and applies the settings of the variant.
    ///
    /// # Errors
    /// An invalid base or setting of a variant.
    fn cross_axis(&self, axis: usize, combinations: &[Combination]) -> Result<Vec<Combination>> {
        let Axis { name, variants } = &*self.experiment.axes[axis];
        let item = |tree: &RonTree, field: &str, k: usize| Some(tree.field(field)?.items().get(k)?.clone());
        let axis_tree = item(self.tree, "axes", axis);
        let mut crossed = Vec::new();
        for combination in combinations {
            for (k, variant) in variants.iter().enumerate() {
                let title = variant_title(name, &variant.label);
                let tree = axis_tree.as_ref().and_then(|axis| item(axis, "variants", k));
                let set = variant.set.located(&title, tree.as_ref().and_then(|tree| tree.field("set")), self.text);
                let mut draft = match &variant.base {
                    Some(file) => read_base(self.folder, file)
                        .and_then(|base| self.apply_common(base))
                        .map_err(|e| Error::input(self.path, format!("{title}: {e}")))?,
                    None => combination.draft.clone(),
                };
                apply_changes(&mut draft, &set.0, self.folder).map_err(|fault| fault.in_file(self.path))?;
                let starts = |change: &&Change| ["data", "split", "initializer"].contains(&change.field());
                let start = match set.0.iter().rfind(starts) {
                    Some(change) => Some(VariantStart { title, at: change.at }),
                    None if variant.base.is_some() => Some(VariantStart { title, at: None }),
                    None => combination.start.clone(),
                };
                let label = (name.clone(), variant.label.clone());
                let labels = combination.labels.iter().cloned().chain([label]).collect();
                crossed.push(Combination { labels, start, draft });
            }
        }
        Ok(crossed)
    }

    /// Returns an error for too many runs, since axes multiply.
    fn refuse_too_many_runs(&self) -> Result<()> {
        let axes = self.experiment.axes.iter().map(|axis| axis.variants.len());
        let runs = axes.chain([self.experiment.seeds.len()]).try_fold(1, usize::checked_mul);
        if runs.is_some_and(|runs| runs <= MOST_RUNS) {
            return Ok(());
        }
        let why = format!(
            "the axes and seeds make {} runs, more than {MOST_RUNS}; use fewer variants, or several experiments",
            runs.map_or_else(|| "beyond count".into(), |runs| runs.to_string())
        );
        Err(Error::input(self.path, why))
    }

    /// Creates the pipeline of a combination, scaled and validated after all axes.
    fn finish_pipeline(&self, combination: &Combination) -> Result<Pipeline> {
        let pipeline = combination.draft.finish().map_err(|fault| fault.in_file(self.path))?;
        let scaling_fault = |e: Error| combination.draft.field_fault("training", e.to_string()).in_file(self.path);
        pipeline.resolved().map_err(scaling_fault)
    }

    /// Returns an error for two combinations with the same pipeline, which would be compared as if they differed.
    fn refuse_equal_pipelines(&self, combinations: &[Combination], pipelines: &[Pipeline]) -> Result<()> {
        let mut seen: BTreeMap<String, &Combination> = BTreeMap::new();
        for (combination, pipeline) in combinations.iter().zip(pipelines) {
            if let Some(earlier) = seen.insert(pipeline.to_ron()?, combination) {
                let why = format!(
                    "`{}` is the same pipeline as `{}`; check whether a later axis overrides an earlier one",
                    join_labels(&combination.labels),
                    join_labels(&earlier.labels)
                );
                let title = combination.labels.last().map(|(axis, label)| variant_title(axis, label) + ": ");
                return Err(Error::input(self.path, title.unwrap_or_default() + &why));
            }
        }
        Ok(())
    }

    /// Creates the run of combination number `k` with `seed`; folder and name of its pipeline contain all labels.
    ///
    /// # Errors
    /// A folder name that is too long.
    fn plan_run(&self, k: usize, combination: &Combination, pipeline: &Pipeline, seed: u64) -> Result<PlannedRun> {
        let words = combination.labels.iter().map(|(axis, label)| format!("{axis}={}", slug(label)));
        let folder = words.chain([format!("seed={seed}")]).collect::<Vec<_>>().join(",");
        if folder.len() > LONGEST_NAME {
            return Err(Error::input(
                self.path,
                format!("the folder `{folder}` has a name of more than {LONGEST_NAME} bytes; shorten the labels"),
            ));
        }
        let mut pipeline = pipeline.clone();
        pipeline.seed = seed;
        // Characters that the name of a pipeline may not have.
        let plain = |c: char| match c {
            '=' | '+' => '-',
            ',' => '_',
            c => c,
        };
        pipeline.name = format!("{}.{}", self.experiment.name, folder.chars().map(plain).collect::<String>());
        let labels = combination.labels.clone();
        Ok(PlannedRun { folder, labels, combination: k, pipeline, start: combination.start.clone() })
    }
}

/// Names a variant in messages.
fn variant_title(axis: &str, label: &str) -> String {
    format!("axis `{axis}`, variant `{label}`")
}

/// Joins labels, such as `lambda 0.02, init random`.
fn join_labels(labels: &[(String, String)]) -> String {
    labels.iter().map(|(axis, label)| format!("{axis} {label}")).collect::<Vec<_>>().join(", ")
}

impl PlannedRun {
    /// Formats the name of its model in a joined model: labels and seed, such as `waves-0`.
    pub(super) fn member_name(&self) -> String {
        let labels = self.labels.iter().map(|(_, label)| slug(label).replace('+', "-"));
        let words: Vec<String> = labels.chain([self.pipeline.seed.to_string()]).collect();
        if self.labels.is_empty() { format!("seed-{}", self.pipeline.seed) } else { words.join("-") }
    }
}

/// Gives all `runs` the same split, or each a fold of it for residuals with `folds`, and returns the pipeline that
/// scores their joined model `name`. Only that model has residuals and is compared with baselines.
///
/// # Errors
/// Runs whose models cannot be joined.
fn align_runs(name: &str, runs: &mut [PlannedRun]) -> Result<Pipeline, String> {
    if !(2..=MOST_MEMBERS).contains(&runs.len()) {
        return Err(format!("there are {} runs; give variants and seeds that make 2 to {MOST_MEMBERS}", runs.len()));
    }
    let pipelines = || runs.iter().map(|run| &run.pipeline);
    let split_seed = pipelines().find_map(|pipeline| pipeline.split_seed).unwrap_or(runs[0].pipeline.seed);
    if pipelines().any(|pipeline| pipeline.split_seed.is_some_and(|seed| seed != split_seed)) {
        return Err("the runs differ in `split_seed`; give all the same value, or none".into());
    }
    check_joinable(runs)?;
    let scored = Pipeline { name: name.to_owned(), split_seed: Some(split_seed), ..runs[0].pipeline.clone() };
    let count = runs.len();
    for (index, PlannedRun { pipeline, .. }) in runs.iter_mut().enumerate() {
        if scored.residuals.as_ref().is_some_and(|residuals| residuals.folds) {
            *pipeline = pipeline.folded(index, count);
        }
        pipeline.residuals = None;
        pipeline.split_seed = Some(split_seed);
        pipeline.baselines.clear();
    }
    Ok(scored)
}

/// Checks that the models of `runs` have distinct names and settings, and the same data, split, residuals and plane.
///
/// # Errors
/// A run does not fit the earlier ones; the message names the first such run.
fn check_joinable(runs: &[PlannedRun]) -> Result<(), String> {
    let first = &runs[0];
    let settings_of_models: Vec<String> = runs.iter().map(|run| model_settings(&run.pipeline)).collect();
    for (index, run) in runs.iter().enumerate() {
        let PlannedRun { folder, pipeline, .. } = run;
        let model = run.member_name();
        if pipeline.members > 1 {
            return Err(format!("`{folder}` has {} members; join runs of one model each", pipeline.members));
        }
        if runs[..index].iter().any(|other| other.member_name().eq_ignore_ascii_case(&model)) {
            return Err(format!("two models have the name `{model}`; change a label"));
        }
        if let Some(twin) = settings_of_models[..index].iter().position(|other| *other == settings_of_models[index]) {
            let twin = &runs[twin].folder;
            return Err(format!("`{twin}` and `{folder}` train the same model; change a setting of one"));
        }
        let differ =
            |field: &str| Err(format!("`{}` and `{folder}` differ in `{field}`; give it once, in `set`", first.folder));
        if to_ron(&first.pipeline.data) != to_ron(&pipeline.data) {
            return differ("data");
        }
        if to_ron(&first.pipeline.split) != to_ron(&pipeline.split) {
            return differ("split");
        }
        if first.pipeline.residuals != pipeline.residuals {
            return differ("residuals");
        }
        // Projectors with equal planes of one size have equal planes of every size.
        if first.pipeline.projector.plane(360, 90) != pipeline.projector.plane(360, 90) {
            return differ("projector");
        }
    }
    Ok(())
}

/// Formats all settings of a pipeline that affect the model, given a common split.
fn model_settings(pipeline: &Pipeline) -> String {
    let (name, baselines, metrics) = Default::default();
    to_ron(&Pipeline { name, split_seed: None, baselines, metrics, ..pipeline.essential() })
}
