//! Training of a run: trainer with memory check, and the loop that writes curve, validation, snapshots and checkpoint.
//!
//! Order in every step: train, validation, curve, checkpoint. Rows are flushed before the checkpoint that counts them,
//! and a resumed run truncates the series to its checkpoint, so its files equal those of an uninterrupted run.
//! Snapshots depend only on the step and are written before its checkpoint; a resumed run rewrites them.

use crate::evaluation_set::{EvaluationSet, Predictor, ScoredPredictor};
use crate::facts::Facts;
use crate::folder::{
    BEST_MODEL, CHECKPOINT, MODEL_FILE, START_SNAPSHOT, UNPRUNED_SNAPSHOT, VALIDATION, pruned_snapshot,
};
use crate::journal::Journal;
use crate::load::{ActiveRun, SplitData};
use crate::record::{VALIDATION_MEAN, read_series, series_column};
use crate::run_folder::RunFolder;
use crate::session::{NoopObserver, Session, Start, Validation, run_stage};
use crate::statistics::Summary;
use pwrfgs_core::files::{self, if_found, write_atomically};
use pwrfgs_core::{Dataset, Error, Progress, Result, Task, Values, device, evenly, free_memory};
use pwrfgs_model::Snapshot;
use pwrfgs_model::{Model, file};
use pwrfgs_pipeline::{Pipeline, defaults};
use pwrfgs_train::{Keep, PruneStepState, StepReport, Trainer, check_available, network_bytes};
use std::sync::atomic::Ordering;
use std::time::Instant;

/// Number of Gaussians below which a step on a GPU is expected to take as long as on the CPU: starting the passes takes longer
/// than they do. An estimate, not measured on a GPU.
const FEW_GAUSSIANS: usize = 1000;

/// Returns warnings of a GPU without effect, or with little, after a step with `n` Gaussians; empty without a GPU.
pub(crate) fn device_warnings(n: usize) -> Vec<String> {
    let Some(name) = device::name() else { return Vec::new() };
    if !device::is_used() {
        let parts = "drawing with `Mercator` and `AlphaBlending`, and the networks `Mlp`, `Wrfgs` and that of `Nerf2`";
        return vec![format!("no part of this pipeline runs on {name}; only {parts} do")];
    }
    let on_cpu = device::cpu_part().map(|part| format!("{part} runs on the CPU; the network runs on {name}"));
    let is_small = (1..FEW_GAUSSIANS).contains(&n); // a network without Gaussians has many rows
    let little = is_small.then(|| format!("N = {n}: a step on a GPU is probably not faster than on the CPU"));
    on_cpu.into_iter().chain(little).collect()
}

impl<'a> ActiveRun<'a, '_> {
    /// Creates the trainer, from the checkpoint in the folder `claimed` if there is one, otherwise before the first step.
    ///
    /// # Errors
    /// Invalid settings, a checkpoint that is damaged or of another device, too little memory; [`Error::Stopped`] once the
    /// session is stopped.
    pub(crate) fn start_trainer(&mut self, claimed: Option<&RunFolder>) -> Result<Trainer<'a>> {
        let (pipeline, SplitData { data, partition }) = (self.pipeline, self.split);
        // Invalid strategies are reported before an error of the checkpoint.
        check_available(&pipeline.pruners)?;
        if pipeline.training.keep == Keep::Best && partition.validation.is_empty() {
            let problem =
                "training.keep: `Best` needs a validation set; give the split a `validation` share, such as 0.1";
            return Err(Error::Config(problem.into()));
        }
        let restored = |folder: &RunFolder| {
            let path = folder.file(CHECKPOINT);
            let Some(bytes) = if_found(&path, files::read(&path))? else { return Ok(None) };
            let restored = Trainer::restore(&pipeline.plan()?, data, partition, &bytes);
            restored.map(Some).map_err(|e| Error::input(&path, format!("{e}; remove it to start again")))
        };
        new_trainer(pipeline, || {
            if let Some(folder) = claimed
                && let Some(trainer) = folder.settle(restored(folder))?
            {
                trainer.check_device()?;
                return Ok(trainer);
            }
            let stop = self.session.stop;
            let begin = |progress: Progress<'_>| Trainer::begin(&pipeline.plan()?, data, partition, progress, stop);
            run_stage(self.session.observer, "initialising", begin)
        })
    }

    /// Trains to the end and writes the model; returns `None` if stopped, with a checkpoint at step `facts.steps`.
    pub(crate) fn train(
        &mut self,
        trainer: Trainer<'a>,
        folder: &RunFolder,
        facts: &mut Facts,
    ) -> Result<Option<Model>> {
        let (settings, SplitData { data, partition }) = (&self.pipeline.training, self.split);
        let mut training = Training {
            journal: Journal::open(folder, self.pipeline, data.task(), trainer.done())?,
            validation: evenly(&partition.validation, settings.validation_samples),
            most_gaussians: 0,
            // Read after the journal has dropped the rows of later steps.
            best: best_value(&read_series(&folder.file(VALIDATION)), settings.prune_until, data.task()),
            earlier_seconds: facts.wall_seconds,
            at_once: 1,
            run: self,
            trainer,
            folder,
            facts,
        };
        training.announce_start()?;
        while !training.trainer.finished() {
            let stopped = training.run.session.stop.load(Ordering::Relaxed);
            if !stopped {
                training.step()?;
            }
            let is_due = training.trainer.done().is_multiple_of(settings.checkpoint_every);
            if stopped || is_due || training.trainer.finished() {
                training.write_checkpoint()?;
            }
            if stopped {
                return Ok(None);
            }
        }
        training.finish().map(Some)
    }
}

/// Creates a trainer by `make`. Checks the memory for the network before it is created, then for the step.
///
/// # Errors
/// Too little memory, or errors of `make`.
pub(crate) fn new_trainer<'a>(pipeline: &Pipeline, make: impl FnOnce() -> Result<Trainer<'a>>) -> Result<Trainer<'a>> {
    let needed = if pipeline.method.is_some() { 0 } else { network_bytes(&*pipeline.deformation) };
    refuse_beyond_memory(needed, "the network", "a smaller `width` or `depth` of the deformation")?;
    let trainer = make()?;
    let step = format!("a training step with N = {}", trainer.cloud().len());
    let advice = "fewer Gaussians (`max_points` of PointCloud, `count` of the others) or a smaller `training.batch`";
    refuse_beyond_memory(trainer.step_bytes(), &step, advice)?;
    Ok(trainer)
}

/// Returns an error if `purpose` needs more bytes than are free; `advice` says how to need less.
fn refuse_beyond_memory(needed: u64, purpose: &str, advice: &str) -> Result<()> {
    match free_memory() {
        Some(free) if needed > free => Err(Error::Config(format!(
            "{purpose} needs about {:.1} GB of memory, and {:.1} GB are left here; take {advice}",
            needed as f64 / 1e9,
            free as f64 / 1e9
        ))),
        _ => Ok(()),
    }
}

/// Seconds after which steps on a device report, so that a bar moves and Ctrl-C acts.
const SECONDS_AT_ONCE: f64 = 0.5;

/// Training in progress: the trainer, and the files that it writes.
struct Training<'r, 'a, 's> {
    run: &'r mut ActiveRun<'a, 's>,
    trainer: Trainer<'a>,
    folder: &'r RunFolder,
    facts: &'r mut Facts,
    journal: Journal,
    /// Validation samples that are scored during training.
    validation: Vec<usize>,
    /// Largest number of Gaussians before a prune step; 0 until the first removal.
    most_gaussians: usize,
    /// Best value of the validations after pruning; `None` before the first.
    best: Option<f64>,
    /// Seconds of earlier starts.
    earlier_seconds: f64,
    /// Number of steps that a device runs before it reports; results do not depend on it.
    at_once: u64,
}

impl Training<'_, '_, '_> {
    /// Announces the start to the observer, with the warnings and the first snapshot of a new run. Reads the largest number
    /// of Gaussians of earlier starts.
    fn announce_start(&mut self) -> Result<()> {
        let (trainer, data) = (&self.trainer, &self.run.split.data);
        self.run.session.observer.on_start(&Start {
            folder: self.folder.name(),
            title: &data.title,
            task: data.task(),
            samples: self.facts.samples,
            done: trainer.done(),
            steps: self.run.pipeline.training.steps,
            gaussians: trainer.cloud().len(),
            step_bytes: trainer.step_bytes(),
        });
        if trainer.done() == 0 {
            trainer.warnings().iter().for_each(|warning| self.warn(warning));
            self.write_snapshot(START_SNAPSHOT, 0)?;
        }
        // The snapshot of an earlier start holds the largest number so far, so the checkpoint need not store it.
        let unpruned = Snapshot::read(&self.folder.file(UNPRUNED_SNAPSHOT))?;
        self.most_gaussians = unpruned.map_or(0, |snapshot| snapshot.means.len());
        Ok(())
    }

    /// Performs some training steps, up to the next checkpoint or validation, and writes what they report.
    fn step(&mut self) -> Result<()> {
        let begun = Instant::now();
        let most = self.at_once.min(self.steps_to_record());
        let reports = self.trainer.run_steps(most).inspect_err(|_| self.report_last_checkpoint())?;
        let seconds = begun.elapsed().as_secs_f64();
        let done = reports.len() as u64; // 1 on the CPU
        self.at_once = if seconds < SECONDS_AT_ONCE { self.at_once.max(2 * done) } else { done.div_ceil(2) };
        reports.iter().try_for_each(|report| self.record(report, seconds / reports.len() as f64))
    }

    /// Returns the number of steps until the next checkpoint or validation.
    fn steps_to_record(&self) -> u64 {
        let (settings, done) = (&self.run.pipeline.training, self.trainer.done());
        let until = |every: u64| if every > 0 { every - done % every } else { u64::MAX };
        until(settings.checkpoint_every).min(until(settings.validate_every))
    }

    /// Writes snapshots, validation and row of the curve of a step that took `seconds`, and reports it to the observer.
    fn record(&mut self, report: &StepReport, seconds: f64) -> Result<()> {
        if report.step == 1 {
            self.warn_of_device();
        }
        if let Some(PruneStepState { cloud, gaussian_ids, gates, round }) = &report.pruned {
            if cloud.len() > self.most_gaussians {
                self.most_gaussians = cloud.len();
                let unpruned = Snapshot::of(report.step, cloud, self.run.split.data.scene.origin);
                unpruned.with_ids_and_gates(gaussian_ids, gates.clone()).write(&self.folder.file(UNPRUNED_SNAPSHOT))?;
            }
            pruned_snapshot(*round).map_or(Ok(()), |name| self.write_snapshot(name, report.step))?;
        }
        let (every, data) = (self.run.pipeline.training.validate_every, &self.run.split.data);
        let validates = every > 0 && report.step.is_multiple_of(every) && !self.validation.is_empty();
        let validated = validates.then(|| self.trainer.validated_model());
        let score = |model: &Model| validate(report.step, model, data, &self.validation);
        let validation = validated.as_ref().map(score).transpose()?;
        self.journal.record_step(report, seconds)?;
        if let (Some(validation), Some(model)) = (&validation, &validated) {
            self.keep_best(validation, model)?;
            self.journal.record_validation(validation)?;
            self.run.session.observer.on_validation(validation);
        }
        self.run.session.observer.on_step(report);
        self.facts.gaussians = report.gaussians;
        Ok(())
    }

    /// Writes the validated model if it is to be kept and is the best so far after pruning. A resumed run writes it again
    /// at the same step.
    fn keep_best(&mut self, validation: &Validation, model: &Model) -> Result<()> {
        let settings = &self.run.pipeline.training;
        let value = validation.values[0];
        let is_better = |best: f64| is_better(validation.task, value, best);
        if settings.keep == Keep::Last || validation.step <= settings.prune_until || !self.best.is_none_or(is_better) {
            return Ok(());
        }
        self.best = Some(value);
        file::write(&self.folder.file(BEST_MODEL), model)
    }

    /// Writes the current Gaussians, with their ids and gates, as the snapshot `name` after `step`.
    fn write_snapshot(&self, name: &str, step: u64) -> Result<()> {
        let snapshot = Snapshot::of(step, self.trainer.cloud(), self.run.split.data.scene.origin);
        snapshot.with_ids_and_gates(self.trainer.gaussian_ids(), self.trainer.gates()).write(&self.folder.file(name))
    }

    /// Warns of a GPU without effect, or with little, after the first step.
    fn warn_of_device(&mut self) {
        device_warnings(self.trainer.cloud().len()).iter().for_each(|warning| self.warn(warning));
    }

    /// Writes the checkpoint, after the rows that it counts, and then `run.json`.
    fn write_checkpoint(&mut self) -> Result<()> {
        self.journal.sync()?;
        write_atomically(&self.folder.file(CHECKPOINT), &self.trainer.checkpoint())?;
        (self.facts.steps, self.facts.training_seconds) = (self.trainer.done(), self.journal.seconds());
        self.facts.wall_seconds = self.earlier_seconds + self.run.begun.elapsed().as_secs_f64();
        self.facts.update_peak_memory();
        self.facts.write(self.folder.path())
    }

    /// Writes the trained model, or the best of the validations if it is to be kept, and warns of pruners without effect.
    fn finish(mut self) -> Result<Model> {
        let model = match self.best {
            Some(_) if self.run.pipeline.training.keep == Keep::Best => file::read(&self.folder.file(BEST_MODEL))?,
            _ => self.trainer.model(),
        };
        let pruners = &self.run.pipeline.pruners;
        let prunes = !pruners.is_empty() && !pruners.iter().any(|pruner| pruner.traits().grows);
        if prunes && self.most_gaussians == 0 && !model.cloud.is_empty() {
            let n = model.cloud.len();
            self.warn(&format!("nothing was pruned: {n} Gaussians remain, and no pruner has removed any"));
        }
        let warnings = self.trainer.idle_masks_warning().into_iter().chain(self.trainer.lone_gaussian_warning());
        warnings.for_each(|warning| self.warn(&warning));
        file::write(&self.folder.file(MODEL_FILE), &model)?;
        Ok(model)
    }

    /// Passes a warning about the run to the observer.
    fn warn(&mut self, warning: &str) {
        self.run.session.observer.on_warning(&format!("{}: {warning}", self.folder.name().display()));
    }

    /// Reports to the observer that the last checkpoint, if there is one, outlives a failed step.
    fn report_last_checkpoint(&mut self) {
        if self.folder.file(CHECKPOINT).is_file() {
            let path = self.folder.name().join(CHECKPOINT);
            self.run.session.observer.on_message(&format!("the last checkpoint is kept in {}", path.display()));
        }
    }
}

/// Returns whether a validation `value` is better than `other`. NaN is worse than any number.
pub(crate) fn is_better(task: Task, value: f64, other: f64) -> bool {
    task.headline.cost(value) < task.headline.cost(other)
}

/// Returns the best mean of the validations in `rows` after step `from`; `None` without one.
fn best_value(rows: &[Vec<Option<f64>>], from: u64, task: Task) -> Option<f64> {
    let late = series_column(rows, VALIDATION_MEAN).into_iter().filter(|(step, _)| *step > from as f64);
    late.map(|(_, value)| value).reduce(|best, value| if is_better(task, value, best) { value } else { best })
}

/// Scores `samples` (indices of links): mean and median of the first metric, then the mean of the second metric, or the tail
/// of the first if there is no second.
fn validate(step: u64, model: &Model, data: &Dataset, samples: &[usize]) -> Result<Validation> {
    let set = EvaluationSet::new(data, samples, &model.stages.plane);
    let (task, model, metrics) = (data.task(), &model.prepare(), defaults::validation_metrics(data.task()));
    let scored = ScoredPredictor { name: "the model", predictor: Predictor::Model(model, None), metrics: &metrics };
    let measured = set.score(scored, &mut Session::new(&mut NoopObserver))?;
    let Summary { mean, median, tail10 } = match measured.first().map(|m| &m.values) {
        Some(Values::PerSample(values)) => Summary::of(values, task.headline.higher),
        whole => {
            let mean = whole.map_or(f64::NAN, Values::mean);
            Summary { mean, median: mean, tail10: mean }
        }
    };
    let third = measured.get(1).map_or(tail10, |m| m.values.mean());
    Ok(Validation { step, task, values: [mean, median, third] })
}
