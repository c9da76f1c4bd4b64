//! All methods, baselines and predictions of other programs on one data set.

use crate::init::{DataSurvey, Effort};
use clap::Args;
use pwrfgs_core::plugin::{Checked, name_of as plugin_name, registered};
use pwrfgs_core::threads::{COUNTS, parse_count};
use pwrfgs_core::{Baseline, Dataset, Error, Partition, Plugin, Real, Result, ShippedFile, did_you_mean};
use pwrfgs_data::Predictions;
use pwrfgs_experiment::sweep::{Axis, Experiment, ListedRun, Listing, PlannedRun, SweepPlan};
use pwrfgs_experiment::{CEILING, Observer, scores::MODEL};
use pwrfgs_pipeline::Pipeline;
use pwrfgs_train::{Rays, Trainer, Training};
use schemars::JsonSchema;
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// Settings of [`ComparedRuns::plan`].
#[derive(Clone, Debug, Args, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CompareSettings {
    /// Predictions of other programs, each as `NAME=FOLDER`.
    #[arg(long, value_name = "NAME=FOLDER", help = "Score the predictions in this folder as NAME; repeatable")]
    #[serde(default)]
    pub predictions: Vec<String>,
    /// Methods to train; default: all that can predict the data.
    #[arg(
        long,
        value_name = "NAMES",
        value_delimiter = ',',
        help = "Train only these methods, separated by commas [default: all that can predict the data]"
    )]
    #[serde(default)]
    pub methods: Vec<String>,
    /// Number of seeds per method
    #[arg(long, value_name = "N", default_value_t = default_seeds(), value_parser = parse_count)]
    #[serde(default = "default_seeds")]
    pub seeds: usize,
}

/// Returns the default number of seeds per method.
fn default_seeds() -> usize {
    3
}

/// Settings, names and changes of the runs of a comparison.
#[derive(Clone, Debug)]
pub struct ComparedRuns {
    /// Compared methods, predictions and seeds.
    pub settings: CompareSettings,
    /// Name of the data in the names of the runs.
    pub name: String,
    /// Changes of all pipelines, in the form of `--set`.
    pub changes: Vec<String>,
    /// Output folder; `None` for `runs/compare-NAME`.
    pub out: Option<PathBuf>,
}

/// Runs of a comparison.
#[derive(Debug)]
pub struct Comparison {
    /// All runs; the first method scores the baselines.
    pub plan: SweepPlan,
    /// Split of all runs.
    pub partition: Partition,
    /// Name of the first other program, the reference of the report; `None` without any.
    pub reference: Option<String>,
}

/// Reads the shipped experiment with the methods for the task of `data`, with `data_name` in its name and this number of
/// `seeds`.
fn read_experiment(seeds: usize, data_name: &str, data: &Dataset) -> Result<Experiment> {
    let name = match &data.features {
        Some(_) => "methods-uplink",
        None => data.task().comparison,
    };
    let file = ShippedFile::all(ShippedFile::EXPERIMENTS).into_iter().find(|file| file.name == name);
    let text = file.expect("the facade registers its experiments").source;
    let mut experiment = Experiment::parse(text, Path::new(name))?;
    experiment.name = format!("compare-{data_name}");
    experiment.seeds = (0..seeds as u64).collect();
    Ok(experiment)
}

/// Returns the experiment with one of its methods only. The first axis must hold the methods.
fn restrict_to_method(experiment: &Experiment, method: &str) -> Result<Experiment> {
    let axis = &experiment.axes[0];
    let variants = axis.variants.iter().filter(|variant| variant.label == method).cloned().collect();
    let axis = Checked::new(Axis { variants, ..Axis::clone(axis) }).map_err(Error::Config)?;
    Ok(Experiment { axes: vec![axis], ..experiment.clone() })
}

impl ComparedRuns {
    /// Plans a run per method and seed, all with the same split; the runs of the first method score all baselines and the
    /// predictions of other programs. A method that was not named and cannot predict the data is left out, with a message.
    ///
    /// # Errors
    /// An unknown method, invalid changes, predictions or number of seeds, or data that no method can predict.
    pub fn plan(&self, survey: &DataSurvey, observer: &mut dyn Observer) -> Result<Comparison> {
        let settings = &self.settings;
        if !COUNTS.contains(&settings.seeds) {
            return Err(Error::Config(format!(
                "--seeds {}: expected a number from 1 to {}",
                settings.seeds,
                COUNTS.end()
            )));
        }
        let mut plan = self.plan_methods(survey, observer)?;
        let partition = plan.runs[0].pipeline.partition(&survey.data)?;
        let external = settings.read_predictions(&plan, &survey.data, &partition.test)?;
        // Baselines and predictions are equal for all methods: the runs of the first method score them.
        let first = plan.runs[0].combination;
        for PlannedRun { combination, pipeline, .. } in &mut plan.runs {
            if *combination == first {
                pipeline.baselines.extend(external.iter().cloned());
            } else {
                pipeline.baselines.clear();
            }
        }
        let reference = external.first().map(|baseline| baseline.name());
        Ok(Comparison { plan, partition, reference })
    }

    /// Plans the runs of the methods that support the data, all with the same split. A method that was not named and
    /// cannot predict the data is left out, with a note.
    fn plan_methods(&self, survey: &DataSurvey, observer: &mut dyn Observer) -> Result<SweepPlan> {
        let settings = &self.settings;
        let experiment = read_experiment(settings.seeds, &self.name, &survey.data)?;
        let labels: Vec<&str> = experiment.axes[0].variants.iter().map(|variant| variant.label.as_str()).collect();
        if let Some(name) = settings.methods.iter().find(|name| !labels.contains(&name.as_str())) {
            let near = did_you_mean(name, labels.iter().copied());
            let why = format!("--methods {name}: no such method for these data{near} (methods: {})", labels.join(", "));
            return Err(Error::Config(why));
        }
        let (mut base, _) = survey.suggest_pipeline(&self.name, Effort::Normal, Path::new("compare.ron"))?;
        // Methods are compared by what one model of each learns.
        (base.members, base.residuals) = (1, None);
        (base.split_seed, base.baselines) = (Some(0), applicable_baselines(&survey.data));
        let mut merged: Option<SweepPlan> = None;
        for method in labels {
            let is_named = settings.methods.iter().any(|name| name == method);
            if !is_named && !settings.methods.is_empty() {
                continue;
            }
            let planned = restrict_to_method(&experiment, method)
                .and_then(|experiment| self.plan_runs(&experiment, &base, survey));
            match planned {
                Ok(mut plan) => match &mut merged {
                    Some(merged) => {
                        let combination = merged.runs.last().map_or(0, |run| run.combination + 1);
                        plan.runs.iter_mut().for_each(|run| run.combination = combination);
                        merged.runs.extend(plan.runs);
                    }
                    None => merged = Some(plan),
                },
                Err(error) if !is_named && error.is_input() => {
                    observer.on_message(&format!(
                        "note: {method} is left out, since it cannot predict these data: {error}"
                    ));
                }
                Err(error) => return Err(error),
            }
        }
        merged.ok_or_else(|| {
            Error::Config(format!("{}: no method can predict these data; see docs/data.md", survey.data.title))
        })
    }

    /// Plans the runs of an experiment with a single method, and checks the first with the data: the others differ only in the
    /// seed.
    fn plan_runs(&self, experiment: &Experiment, base: &Pipeline, survey: &DataSurvey) -> Result<SweepPlan> {
        // No text: positions in it would be those of all methods.
        let plan = SweepPlan::of(experiment, (Path::new(""), "()"), Some(base), &self.changes, self.out.as_deref());
        let mut plan = plan.map_err(without_position)?;
        let data = &survey.data;
        for PlannedRun { pipeline, .. } in &mut plan.runs {
            let is_rays = pipeline.method.as_ref().is_some_and(|method| plugin_name(method) == "Nerf2");
            let rays = if is_rays { ray_settings(data, &pipeline.training) } else { Vec::new() };
            pipeline.set_all(&rays)?;
        }
        let pipeline = &plan.runs[0].pipeline;
        pipeline.check_data(data)?;
        Trainer::sketch(&pipeline.plan()?, data, &pipeline.partition(data)?)?;
        Ok(plan)
    }
}

impl CompareSettings {
    /// Reads the predictions of other programs as baselines. Each needs a unique name, and a prediction per link of `test`.
    fn read_predictions(&self, plan: &SweepPlan, data: &Dataset, test: &[usize]) -> Result<Vec<Plugin<dyn Baseline>>> {
        let baselines = plan.runs[0].pipeline.baselines.iter().map(|baseline| baseline.name_for(data.task()));
        let labels = plan.runs.iter().map(|run| run.labels[0].1.clone());
        let mut taken: Vec<String> = baselines.chain(labels).chain([MODEL, CEILING].map(str::to_owned)).collect();
        let mut baselines = Vec::new();
        for text in &self.predictions {
            let refuse = |problem: &str| Error::Config(format!("--predictions {text}: {problem}"));
            let (name, root) = text
                .split_once('=')
                .filter(|(name, root)| !name.trim().is_empty() && !root.is_empty())
                .ok_or_else(|| refuse("expected NAME=FOLDER, such as U-Net=predicted"))?;
            if taken.iter().any(|other| other == name) {
                return Err(refuse(&format!("the table has another row `{name}`; choose another name")));
            }
            taken.push(name.to_owned());
            let root = Path::new(root).canonicalize().ok().filter(|root| root.is_dir());
            let root = root.ok_or_else(|| refuse("no such folder; correct its path"))?;
            let mut predictions = Predictions { name: name.into(), root, ..Predictions::default() };
            predictions.check_test(data, test)?;
            predictions.set_digest(data)?;
            baselines.push(Plugin::from(Box::new(predictions) as Box<dyn Baseline>));
        }
        Ok(baselines)
    }
}

/// Removes the position in the experiment from an error of that file, which is inside the program and has no path.
pub fn without_position(error: Error) -> Error {
    match error {
        Error::Input { path, message, .. } if path.as_os_str().is_empty() => Error::Config(message),
        other => other,
    }
}

/// Rejects an output folder with other runs: their baselines and predictions would remain in the report.
///
/// # Errors
/// The first such run.
pub fn check_earlier_runs(plan: &SweepPlan) -> Result<()> {
    let (planned, earlier) = (plan.listing().runs, Listing::read(&plan.folder)?);
    let other = earlier.iter().flat_map(|listing| &listing.runs).find(|run| !planned.contains(run));
    let why =
        |run: &ListedRun| format!("holds the run `{}`; add its method and seed, or choose another --out", run.folder);
    other.map_or(Ok(()), |run| Err(Error::input(&plan.folder, why(run))))
}

/// Lists settings of NeRF2 for the data. Rays reach across the site, at least 5 m; if that is more than 20 m, it is the unit of
/// length too. Spectra with fewer pixels than rays get a ray per pixel.
fn ray_settings(data: &Dataset, training: &Training) -> Vec<String> {
    let (low, high) = data.scene.bounds;
    let far = (0..3).map(|k| (high[k] - low[k]).powi(2)).sum::<Real>().sqrt().max(5.0).ceil();
    let unit = if far > 20.0 { far } else { 1.0 };
    let pixels = data.width.div_ceil(training.stride) * data.height.div_ceil(training.stride);
    let fewer = match training.rays {
        Rays::Same(count) if count > pixels && data.task().has_pixels => Some(format!("training.rays=Same({pixels})")),
        _ => None,
    };
    [format!("method.Nerf2.far_m={far:?}"), format!("method.Nerf2.unit_m={unit:?}")].into_iter().chain(fewer).collect()
}

/// Lists the registered baselines that support the data, with default settings and further numbers of neighbours.
fn applicable_baselines(data: &Dataset) -> Vec<Plugin<dyn Baseline>> {
    let nearest = ["(k: 1)", "(k: Auto)"].map(|k| format!("NearestNeighbours{k}"));
    let texts = registered::<dyn Baseline>().into_iter().map(|name| format!("{name}()")).chain(nearest);
    let baselines = texts.filter_map(|text| Plugin::<dyn Baseline>::parse(&text).ok());
    let baselines = baselines.filter(|baseline| baseline.tasks().contains(&data.task()) && !baseline.is_external());
    baselines.filter(|baseline| baseline.check_data(data).is_ok()).collect()
}
