//! `pwrfgs evaluate`: scores of a trained model on a data set.

use super::devices::choose_for_predictions;
use super::run::format_scores;
use crate::interrupt::stop_flag;
use crate::output::{self, INTERRUPTED, SUCCESS, Verbosity};
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::experiment::folder::{PARTIAL_SCORES, PIPELINE, REPORT};
use pwrfgs::experiment::samples::data_key;
use pwrfgs::experiment::text::{join_names, number};
use pwrfgs::experiment::{
    ActiveRun, EvaluationResult, Facts, Machine, Session, load_with_findings, pipeline_of_model, read_pipeline,
};
use pwrfgs::model::{Ensemble, file};
use pwrfgs::pipeline::Pipeline;
use pwrfgs::tasks::read_models;
use pwrfgs_core::files::{PartialFolder, digest};
use pwrfgs_core::messages::strip_control;
use pwrfgs_core::{Dataset, Error, Receiver, Result, files};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Largest number of names in a warning.
const LISTED: usize = 8;

#[derive(Debug, Args)]
#[command(after_help = "\
Data, split, metrics and baselines are those of pipeline.ron next to the first model or, for a model
in the program, of a pipeline in the program. --set changes them.
The command prints the score table. With --out, it also writes scores.csv, samples.csv and
report.html, and a stopped command resumes after the last scored model or baseline when repeated.
Several models are scored as an ensemble: the mean of their predictions, spectra clamped to [0, 1].
The models need a common test set: use runs whose split does not depend on the seed.

EXAMPLES
  pwrfgs evaluate runs/quickstart
  pwrfgs evaluate runs/quickstart --set 'metrics=[Ssim(), L1()]' --out scored
  pwrfgs evaluate runs/s23-laptop --set data.root=data/s23
  pwrfgs evaluate s23 --set data.root=data/s23
  pwrfgs evaluate runs/blocks/seed-0 runs/blocks/seed-1")]
pub(crate) struct Evaluate {
    /// Run folder, model file or name of a model in `pwrfgs pipelines`, such as s23; several models form
    /// an ensemble
    #[arg(value_name = "MODEL", required = true)]
    pub(crate) models: Vec<PathBuf>,
    /// Pipeline file [default: pipeline of the first model]
    #[arg(long, value_name = "FILE")]
    pub(crate) pipeline: Option<PathBuf>,
    /// Change a setting of the pipeline, such as data.root=data/other; repeatable
    #[arg(long = "set", value_name = "FIELD=VALUE")]
    pub(crate) set: Vec<String>,
    /// Output folder for scores and report [default: write no files]
    #[arg(short, long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// Print all metrics, with median and 10th percentile (90th for errors)
    #[arg(long)]
    pub(crate) all: bool,
}

/// Runs `pwrfgs evaluate`: prints the score table and writes the files of `--out`; returns the exit code.
pub(crate) fn evaluate(arguments: &Evaluate, verbosity: Verbosity) -> Result<u8> {
    let models = &arguments.models;
    let ensemble = read_numbered_models(models)?;
    let path = arguments.pipeline.clone().map_or_else(|| pipeline_of_model(&models[0]), |path| Ok(Some(path)))?;
    let missing = || Error::input(&models[0], format!("no {PIPELINE} next to this model; set --pipeline FILE"));
    let pipeline = read_pipeline(&path.ok_or_else(missing)?, &arguments.set)?;
    let folder = arguments.out.as_ref().map(|out| begin_folder(out, &ensemble, &pipeline, verbosity)).transpose()?;
    let text = score(models, &ensemble, &pipeline, folder.as_ref(), arguments.all, verbosity);
    match (folder, text) {
        (Some(folder), Err(Error::Stopped)) => {
            let partial = folder.path().display();
            output::print_note(&format!("stopped; the scores so far are in {partial}; repeat the command to resume"));
            return Ok(INTERRUPTED);
        }
        (Some(folder), Err(error)) if error.is_input() => {
            folder.discard(); // another command is the remedy
            return Err(error);
        }
        (Some(folder), text) => {
            let mut text = text?;
            folder.publish()?;
            let report = arguments.out.iter().map(|out| out.join(REPORT)).find(|report| report.is_file());
            report.iter().for_each(|report| _ = writeln!(text, "\nreport: {}", report.display()));
            output::print_result(&text)?;
        }
        (None, text) => output::print_result(&text?)?,
    }
    Ok(SUCCESS)
}

/// Scores the ensemble that was read from `models`, writes its results to `folder`, and returns the score table with `all`
/// metrics or the main ones.
fn score(
    models: &[PathBuf],
    ensemble: &Ensemble,
    pipeline: &Pipeline,
    folder: Option<&PartialFolder>,
    all: bool,
    verbosity: Verbosity,
) -> Result<String> {
    let stop = folder.map(|_| stop_flag()).unwrap_or_default(); // without a folder, nothing can resume
    let mut progress = RunProgress::new(verbosity);
    let (split, findings) = load_with_findings(pipeline, Some(&pipeline.accept), &mut progress)?;
    if verbosity != Verbosity::Quiet {
        let (data, test) = (&split.data, split.partition.test.len());
        output::print_note(&format!("{}: scoring {test} test {}", data.title, data.task().counted[1]));
    }
    choose_for_predictions(ensemble, split.data.locations_of(&split.partition.test).len(), verbosity);
    warn_of_moved_receivers(&split.data, ensemble);
    let session = &mut Session { stop: &stop, ..Session::new(&mut progress) };
    let mut run = ActiveRun::new(pipeline, &split, session);
    let scored = match folder {
        Some(folder) => run.evaluate_into(folder.path(), ensemble),
        None => run.evaluate(ensemble),
    };
    progress.remove_bar();
    let mut result = scored?;
    let table = &mut result.scores.table;
    table.samples[0] = count_training_samples(models); // those of the model
    table.trained_elsewhere = !models.iter().all(|model| has_same_data(model, pipeline));
    let text = format_result(&result, ensemble, all);
    if let Some(folder) = folder {
        let facts = Facts {
            version: env!("CARGO_PKG_VERSION").into(),
            machine: Machine::current(),
            gaussians: ensemble.gaussians(),
            findings,
            scores: Some(result.scores.table.clone()),
            ..Facts::default()
        };
        let session = &mut Session { page: pwrfgs::PAGE, ..Session::new(&mut progress) };
        ActiveRun::new(pipeline, &split, session).write_results(folder.path(), &facts, ensemble, &result)?;
        files::remove(&folder.path().join(PARTIAL_SCORES));
    }
    Ok(text)
}

/// Formats the score table, for several models with the correlation of their spread with the error.
fn format_result(result: &EvaluationResult, ensemble: &Ensemble, all: bool) -> String {
    let mut text = format_scores(&result.scores.table, all);
    if let Some(confidence) = &result.confidence {
        let members = ensemble.members().len();
        let rank = number(confidence.rank_correlation());
        _ = writeln!(text, "\nmodel: mean of {members} models; rank correlation of spread and error {rank}");
    }
    text
}

/// Creates the partial folder of `out`, or continues that of a stopped command, with a note.
fn begin_folder(out: &Path, model: &Ensemble, pipeline: &Pipeline, verbosity: Verbosity) -> Result<PartialFolder> {
    let settings = digest(pipeline.to_ron()?.as_bytes());
    let request = [("models", digest(&file::ensemble_to_bytes(model))), ("settings", settings)];
    let is_resumed = PartialFolder::path_for(out).exists();
    let folder = PartialFolder::begin(out, &request)?;
    if is_resumed {
        verbosity.print_note(&format!("resuming the scoring in {}", folder.path().display()));
    }
    Ok(folder)
}

/// Reads the models as one ensemble. Members of several files have numbers as names, since paths are wide in a table.
fn read_numbered_models(paths: &[PathBuf]) -> Result<Ensemble> {
    let ensemble = read_models(paths)?;
    if paths.len() == 1 {
        return Ok(ensemble);
    }
    Ensemble::new(ensemble.members().to_vec()).map_err(Error::Config)
}

/// Returns the number of training samples of the models, from their run folders; 0 if unknown or different.
fn count_training_samples(models: &[PathBuf]) -> usize {
    let samples_of = |model: &PathBuf| {
        let pipeline = pipeline_of_model(model).ok().flatten().filter(|path| path.is_file());
        let facts = pipeline.and_then(|path| Facts::read(path.parent()?).ok().flatten());
        facts.map_or(0, |facts| facts.samples[0])
    };
    let first = samples_of(&models[0]);
    if models.iter().all(|model| samples_of(model) == first) { first } else { 0 }
}

/// Returns whether the pipeline of `model` is readable and has the data and split of `pipeline`.
fn has_same_data(model: &Path, pipeline: &Pipeline) -> bool {
    let trained = pipeline_of_model(model).ok().flatten().and_then(|path| read_pipeline(&path, &[]).ok());
    trained.is_some_and(|trained| data_key(&trained) == data_key(pipeline))
}

/// Warns of receivers whose name or pose differs from those of the model; of a single one, only of the pose.
fn warn_of_moved_receivers(data: &Dataset, ensemble: &Ensemble) {
    let setup = &ensemble.members()[0].stages.setup;
    let (expected, measured) = (&setup.receivers, &data.scene.receivers);
    let is_moved = |(receiver, other): &(&Receiver, &Receiver)| {
        setup.origin.world_pose(receiver.pose) != data.scene.origin.world_pose(other.pose)
    };
    let mut pairs = expected.iter().zip(measured);
    if expected.len() == 1 && measured.len() == 1 {
        if pairs.any(|pair| is_moved(&pair)) {
            output::print_warning("the receiver pose of the data differs from that of the model");
        }
        return;
    }
    if expected.len() != measured.len() {
        return; // reported as an error elsewhere
    }
    let moved = pairs.filter(|pair| pair.0.name != pair.1.name || is_moved(pair));
    let names: Vec<String> = moved.map(|(_, other)| strip_control(&other.name)).collect();
    if !names.is_empty() {
        let names = join_names(names.iter(), LISTED);
        output::print_warning(&format!("name or pose of receivers differs from that of the model: {names}"));
    }
}
