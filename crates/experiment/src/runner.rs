//! `run`: from a pipeline to a trained, evaluated, reported model; goes on where an earlier start left off.
//!
//! Order at every step: train, curve, validation, checkpoint. Rows reach the disk before the checkpoint that counts
//! them, and a resumed run cuts the series back to its checkpoint: so it ends in the same files as one never stopped.
//! Snapshots are functions of the step, and written before the checkpoint of that step: a resumed run writes them again.

use crate::data_warnings::data_warnings;
use crate::evaluate::evaluate;
use crate::facts::Facts;
use crate::folder::{CHECKPOINT, MODEL_FILE, PIPELINE, RunFolder, START_SNAPSHOT, UNPRUNED_SNAPSHOT, pruned_snapshot};
use crate::journal::{Journal, note_scores};
use crate::observer::{Observer, Start, staged};
use crate::preview::{fitting, fitting_network};
use crate::recipe::Recipe;
use crate::record::{LoadedRun, Record, write_page, write_scores};
use crate::scores::ScoreTable;
use crate::session::Session;
use crate::snapshot::Snapshot;
use crate::{clock, validation};
use pwrfgs_core::files::{self, write_atomically};
use pwrfgs_core::{Dataset, Error, GaussianCloud, Partition, Result, evenly};
use pwrfgs_model::{Ensemble, Model, file};
use pwrfgs_pipeline::Pipeline;
use pwrfgs_train::{Estimate, Pruned, Trainer};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Instant;

/// How a run ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// Everything is written.
    Finished {
        /// Summaries of all scores.
        scores: ScoreTable,
        /// Whether nothing was left to do.
        already: bool,
    },
    /// It was asked to stop in training; the checkpoint is of this step, and the same command goes on.
    Interrupted {
        /// Steps done.
        step: u64,
    },
    /// It was asked to stop while the trained model was scored; the same command scores it.
    Unscored,
}

/// Runs `pipeline`, whose relative paths are relative to `base`, in the folder `out`; stops at the next step
/// once the session is stopped, or, trained, before the next chunk of predictions, before scoring them, or at the next
/// baseline.
///
/// # Errors
/// Wrong input, before anything is written; a folder that cannot be written; numbers that leave the finite range. Files
/// written so far stay intact.
pub fn run(pipeline: &Pipeline, base: &Path, out: &Path, session: &mut Session<'_>) -> Result<Outcome> {
    let begun = Instant::now();
    let mut pipeline = pipeline.clone();
    rebase(&mut pipeline, base);
    let pipeline = pipeline.resolved()?;
    pipeline.check_text()?;
    let recipe = Recipe::Pipeline(Box::new(pipeline.clone()));
    loop {
        let mut attempt = Attempt { pipeline: &pipeline, recipe: &recipe, base, out, session, begun };
        if let Some(end) = attempt.run()? {
            return Ok(end);
        }
    }
}

/// A run in a folder that other processes may claim too.
struct Attempt<'a, 's> {
    pipeline: &'a Pipeline,
    recipe: &'a Recipe,
    base: &'a Path,
    out: &'a Path,
    session: &'a mut Session<'s>,
    begun: Instant,
}

impl Attempt<'_, '_> {
    /// The end of the run; nothing if another process has begun it meanwhile: then what it left counts.
    fn run(&mut self) -> Result<Option<Outcome>> {
        let Self { pipeline, recipe, out, begun, .. } = *self;
        let reported = self.session.page.is_some();
        RunFolder::inspect(out, recipe)?;
        if let Some(end) = ended(out, recipe, reported)? {
            // What has ended may have been begun since, by another process with another pipeline.
            return RunFolder::inspect(out, recipe).map(|()| Some(end));
        }
        // What earlier starts left is read by the process that holds it: another one would write on.
        let held = out.join(PIPELINE).exists().then(|| RunFolder::claim(out, recipe)).transpose()?;
        if let Some(folder) = &held
            && let Some(end) = folder.settle(ended(folder.path(), recipe, reported))?
        {
            return Ok(Some(end));
        }
        let (data, partition) = load(pipeline, self.base, self.session.observer)?;
        check_scoring(pipeline, &data)?;
        let mut work = Run { pipeline, data: &data, partition: &partition, session: self.session, begun };
        // Made before a new folder is claimed: settings that cannot work must leave nothing behind.
        let trainer = match &held {
            Some(folder) if folder.file(MODEL_FILE).is_file() => None,
            held => match work.trainer(held.as_ref()) {
                Err(Error::Stopped) => return Ok(Some(Outcome::Interrupted { step: 0 })),
                trainer => Some(trainer?),
            },
        };
        let mut folder = match held {
            Some(folder) => folder,
            None => match RunFolder::claim(out, recipe)? {
                folder if folder.is_new() => folder,
                _ => return Ok(None), // another process has begun this run since, and may have ended it
            },
        };
        let ended = work.end(trainer, &mut folder, recipe);
        folder.settle(ended).map(Some)
    }
}

/// The end of the run of `recipe` in `out`, if nothing is left to do, its files held against their marks.
///
/// # Errors
/// A file that is damaged or missing.
pub(crate) fn ended(out: &Path, recipe: &Recipe, reported: bool) -> Result<Option<Outcome>> {
    let Some((scores, facts)) = finished(out, recipe, reported)? else { return Ok(None) };
    facts.verify(out)?;
    Ok(Some(Outcome::Finished { scores, already: true }))
}

/// Loads the data of a pipeline and divides them.
///
/// # Errors
/// Whatever is wrong with the data, or a split that leaves nothing to train on or to test.
pub fn load(pipeline: &Pipeline, base: &Path, observer: &mut dyn Observer) -> Result<(Dataset, Partition)> {
    let data = staged(observer, "spectra", |progress| pipeline.data.load(base, progress))?;
    let partition = pipeline.partition(&data)?;
    for (part, name) in [(&partition.train, "training"), (&partition.test, "test")] {
        if part.is_empty() {
            return Err(Error::Config(format!("split: no sample is left for the {name} part; change `split`")));
        }
    }
    let judged = (!pipeline.split.is_sparse()).then_some(&partition);
    data_warnings(&data, judged).iter().for_each(|warning| observer.on_warning(warning));
    Ok((data, partition))
}

/// Scores and facts of the run of `recipe` in `out`, if nothing is left to do: trained, scored as the recipe says, and
/// `reported` if that is asked for.
pub(crate) fn finished(out: &Path, recipe: &Recipe, reported: bool) -> Result<Option<(ScoreTable, Facts)>> {
    let done = Facts::finished(out)?.filter(|(_, facts)| facts.report || !reported);
    Ok(done.filter(|_| RunFolder::is_scored_as(out, recipe)))
}

/// Refuses baselines and metrics that cannot work on `data`, before a model is trained for their table.
///
/// # Errors
/// The first that refuses, by the name of its field.
pub(crate) fn check_scoring(pipeline: &Pipeline, data: &Dataset) -> Result<()> {
    let named = |field: &str, error: Error| match error {
        Error::Config(_) | Error::Input { .. } | Error::Read { .. } => Error::Config(format!("{field}: {error}")),
        other => other, // an exception of Python's stays one
    };
    for baseline in &pipeline.baselines {
        baseline.check_data(data).map_err(|error| named("baselines", error))?;
    }
    for metric in &pipeline.metrics {
        metric.check_data(data).map_err(|error| named("metrics", error))?;
    }
    match pipeline.unsupported(data.task()) {
        Some((field, what)) => Err(Error::Config(format!("{field}: {what}"))),
        None => Ok(()),
    }
}

/// Takes every relative path of the pipeline from `base` and makes it absolute.
pub fn rebase(pipeline: &mut Pipeline, base: &Path) {
    if let Some(rebased) = pipeline.data.rebased(&|path| absolute(base, path)) {
        pipeline.data = rebased.into();
    }
    if let Some(rebased) = pipeline.initializer.rebased(&|path| absolute(base, path)) {
        pipeline.initializer = rebased.into();
    }
    for baseline in &mut pipeline.baselines {
        if let Some(rebased) = baseline.rebased(&|path| absolute(base, path)) {
            *baseline = rebased.into();
        }
    }
}

/// `path`, relative to `base`, as one that holds everywhere.
pub(crate) fn absolute(base: &Path, path: &Path) -> PathBuf {
    let joined = base.join(path);
    joined.canonicalize().or_else(|_| std::path::absolute(&joined)).unwrap_or(joined)
}

struct Run<'a, 's> {
    pipeline: &'a Pipeline,
    data: &'a Dataset,
    partition: &'a Partition,
    session: &'a mut Session<'s>,
    begun: Instant,
}

impl<'a> Run<'a, '_> {
    /// Trains what is left, unless the model is there (then there is no trainer), and scores it.
    fn end(
        &mut self,
        trainer: Option<(Trainer<'a>, Estimate)>,
        folder: &mut RunFolder,
        recipe: &Recipe,
    ) -> Result<Outcome> {
        let (mut facts, earlier) = Facts::open(folder.path(), self.pipeline.seed)?;
        facts.data.clone_from(&self.data.title);
        facts.simulated = self.data.is_simulated();
        facts.samples = [&self.partition.train, &self.partition.validation, &self.partition.test].map(Vec::len);
        if trainer.is_none() {
            earlier.verify_file(folder.path(), MODEL_FILE)?;
        }
        // It is not finished any more: what an earlier end says of files, and of baselines, is about to be wrong.
        facts.write(folder.path())?;
        folder.renew(recipe)?;
        let model = match trainer {
            None => file::read(&folder.file(MODEL_FILE))?,
            Some((mut trainer, estimate)) => match self.train(&mut trainer, estimate, folder, &mut facts)? {
                Some(model) => model,
                None => return Ok(Outcome::Interrupted { step: trainer.done() }),
            },
        };
        match self.assess(&model, folder, &mut facts) {
            Ok(scores) => Ok(Outcome::Finished { scores, already: false }),
            Err(Error::Stopped) => Ok(Outcome::Unscored),
            Err(error) => Err(error),
        }
    }

    /// A trainer at the start, or where the checkpoint in the folder left it, and what a step will take.
    fn trainer(&mut self, held: Option<&RunFolder>) -> Result<(Trainer<'a>, Estimate)> {
        // A strategy that cannot be asked is refused before a checkpoint is blamed for it.
        self.pipeline.pruners.iter().try_for_each(|pruner| pruner.ready())?;
        fitting_network(self.pipeline)?;
        let restored = match held {
            Some(folder) => folder.settle(self.restored(&folder.file(CHECKPOINT)))?,
            None => None,
        };
        let trainer = match restored {
            Some(trainer) => trainer,
            None => staged(self.session.observer, "initialising", |progress| {
                Trainer::begin(&self.pipeline.plan()?, self.data, self.partition, progress, self.session.stop)
            })?,
        };
        let estimate = fitting(&trainer)?;
        Ok((trainer, estimate))
    }

    /// The trainer of the checkpoint at `path`, if there is one.
    fn restored(&self, path: &Path) -> Result<Option<Trainer<'a>>> {
        let bytes = match files::read(path) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(Error::read(path, e)),
        };
        let restored = Trainer::restore(&self.pipeline.plan()?, self.data, self.partition, &bytes);
        restored.map(Some).map_err(|e| Error::input(path, format!("{e}; remove it to start again")))
    }

    /// Trains to the end and writes the model, or returns nothing where it was asked to stop.
    fn train(
        &mut self,
        trainer: &mut Trainer<'_>,
        estimate: Estimate,
        folder: &RunFolder,
        facts: &mut Facts,
    ) -> Result<Option<Model>> {
        let settings = &self.pipeline.training;
        let (steps, earlier) = (settings.steps, facts.wall_seconds);
        let mut journal = Journal::open(folder, self.pipeline, self.data.task(), trainer.done())?;
        let looked_at = evenly(&self.partition.validation, settings.validation_samples);
        self.session.observer.on_start(&Start {
            folder: folder.name(),
            title: &self.data.title,
            kind: self.data.task(),
            samples: facts.samples,
            done: trainer.done(),
            steps,
            estimate,
        });
        let origin = self.data.scene.origin;
        let write = |name, step, cloud: &GaussianCloud, births: &[u32], gates| {
            Snapshot::of(step, cloud, origin).known(births, gates).write(&folder.file(name))
        };
        if trainer.done() == 0 {
            let named = |warning: &String| format!("{}: {warning}", folder.name().display());
            trainer.warnings().iter().for_each(|warning| self.session.observer.on_warning(&named(warning)));
            write(START_SNAPSHOT, 0, trainer.cloud(), trainer.births(), trainer.gates())?;
        }
        // A file that an earlier start left is of the same events: nothing smaller is worth another.
        let mut fullest = Snapshot::read(&folder.file(UNPRUNED_SNAPSHOT))?.map_or(0, |before| before.means.len());
        while !trainer.finished() {
            let stopped = self.session.stop.load(Ordering::Relaxed);
            if !stopped {
                let begun = Instant::now();
                let report = trainer.step().inspect_err(|_| self.kept(folder))?;
                let seconds = begun.elapsed().as_secs_f64();
                if let Some(Pruned { cloud, births, gates, round }) = &report.pruned {
                    if cloud.len() > fullest {
                        fullest = cloud.len();
                        write(UNPRUNED_SNAPSHOT, report.step, cloud, births, gates.clone())?;
                    }
                    if let Some(name) = pruned_snapshot(*round) {
                        write(name, report.step, trainer.cloud(), trainer.births(), trainer.gates())?;
                    }
                }
                journal.step(&report, seconds)?;
                let look = settings.validate_every > 0 && report.step.is_multiple_of(settings.validate_every);
                if look && !looked_at.is_empty() {
                    let seen = validation::validate(report.step, &trainer.model(), self.data, &looked_at)?;
                    journal.validation(&seen)?;
                    self.session.observer.on_validation(&seen);
                }
                self.session.observer.on_step(&report);
                facts.gaussians = report.gaussians;
            }
            let step = trainer.done();
            if stopped || step.is_multiple_of(settings.checkpoint_every) || trainer.finished() {
                journal.sync()?;
                write_atomically(&folder.file(CHECKPOINT), &trainer.checkpoint())?;
                (facts.steps, facts.training_seconds) = (step, journal.seconds());
                facts.wall_seconds = earlier + self.begun.elapsed().as_secs_f64();
                facts.note_memory();
                facts.write(folder.path())?;
            }
            if stopped {
                return Ok(None);
            }
        }
        let model = trainer.model();
        let prunes = !self.pipeline.pruners.is_empty() && !self.pipeline.pruners.iter().any(|pruner| pruner.grows());
        if prunes && fullest == 0 && !model.cloud.is_empty() {
            let (folder, n) = (folder.name().display(), model.cloud.len());
            let what = format!("{folder}: nothing was pruned: {n} Gaussians remain, and no pruner has removed any");
            self.session.observer.on_warning(&what);
        }
        file::write(&folder.file(MODEL_FILE), &model)?;
        Ok(Some(model))
    }

    /// Says that the last checkpoint outlives a failed step.
    fn kept(&mut self, folder: &RunFolder) {
        if folder.file(CHECKPOINT).is_file() {
            let path = folder.name().join(CHECKPOINT);
            self.session.observer.on_message(&format!("the last checkpoint is kept in {}", path.display()));
        }
    }

    /// Scores the model on the test part (unless it is asked to stop) and writes scores, samples, report and facts.
    fn assess(&mut self, model: &Model, folder: &RunFolder, facts: &mut Facts) -> Result<ScoreTable> {
        let (earlier, begun) = (facts.wall_seconds, Instant::now());
        self.session.observer.on_message(&format!(
            "scoring {} test {}",
            self.partition.test.len(),
            self.data.task().counted[1]
        ));
        let ensemble = Ensemble::of(model.clone());
        let (scores, confidence) = evaluate(&ensemble, self.pipeline, self.data, self.partition, self.session)?;
        let plane = &model.stages.plane;
        facts.validation_baselines = validation::floors(self.pipeline, plane, self.data, self.partition, self.session)?;
        facts.steps = self.pipeline.training.steps;
        facts.gaussians = model.cloud.len();
        facts.scores = Some(scores.table.clone());
        facts.wall_seconds = earlier + begun.elapsed().as_secs_f64();
        facts.finished = Some(clock::now());
        facts.report = self.session.page.is_some();
        facts.note_memory(); // here, so that the report tells what run.json tells
        write_scores(folder.path(), (&scores, confidence.as_ref()), self.data, self.partition)?;
        if let Some(page) = self.session.page {
            let record = Record::of(folder.path(), &Recipe::Pipeline(Box::new(self.pipeline.clone())), facts.clone())?;
            let (data, partition) = (self.data, self.partition);
            write_page(&LoadedRun { record: &record, data, partition, model: &ensemble }, page)?;
        }
        let scores = scores.table;
        note_scores(folder, self.pipeline, &scores)?;
        facts.seal(folder.path())?;
        facts.write(folder.path())?;
        self.session.observer.on_evaluation(&scores);
        Ok(scores)
    }
}
