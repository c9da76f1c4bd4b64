//! Training of a run: trainer with memory check, and the loop that writes curve, validation, snapshots and checkpoint.
//!
//! Order in every step: train, validation, curve, checkpoint. Rows are flushed before the checkpoint that counts them,
//! and a resumed run truncates the series to its checkpoint, so its files equal those of an uninterrupted run.
//! Snapshots depend only on the step and are written before its checkpoint; a resumed run rewrites them.

use crate::evaluation_set::EvaluationSet;
use crate::facts::{Facts, free_memory};
use crate::folder::{CHECKPOINT, MODEL_FILE, START_SNAPSHOT, UNPRUNED_SNAPSHOT, pruned_snapshot};
use crate::journal::Journal;
use crate::load::SplitData;
use crate::run_folder::RunFolder;
use crate::session::{NoopObserver, Session, Start, Validation, staged};
use crate::statistics::Summary;
use pwrfgs_core::files::{self, if_found, write_atomically};
use pwrfgs_core::{Dataset, Error, GaussianCloud, Progress, Result, Values, evenly};
use pwrfgs_model::Snapshot;
use pwrfgs_model::{Model, file};
use pwrfgs_pipeline::{Pipeline, defaults};
use pwrfgs_train::{PruneStepState, Trainer, check_available, network_bytes};
use std::sync::atomic::Ordering;
use std::time::Instant;

/// Trainer at the start or at the checkpoint of the folder.
///
/// # Errors
/// Invalid settings, a damaged checkpoint, too little memory; [`Error::Stopped`] once the session is stopped.
pub(crate) fn trainer<'a>(
    pipeline: &Pipeline,
    SplitData { data, partition }: &'a SplitData,
    held: Option<&RunFolder>,
    session: &mut Session<'_>,
) -> Result<Trainer<'a>> {
    // Invalid strategies are reported before an error of the checkpoint.
    check_available(&pipeline.pruners)?;
    let restored = |folder: &RunFolder| {
        let path = folder.file(CHECKPOINT);
        let Some(bytes) = if_found(&path, files::read(&path))? else { return Ok(None) };
        let restored = Trainer::restore(&pipeline.plan()?, data, partition, &bytes);
        restored.map(Some).map_err(|e| Error::input(&path, format!("{e}; remove it to start again")))
    };
    fitting(pipeline, || {
        if let Some(folder) = held
            && let Some(trainer) = folder.settle(restored(folder))?
        {
            return Ok(trainer);
        }
        let stop = session.stop;
        let begin = |progress: Progress<'_>| Trainer::begin(&pipeline.plan()?, data, partition, progress, stop);
        staged(session.observer, "initialising", begin)
    })
}

/// Trainer created by `make`. Checks the memory for the network before it is created,
/// then for the step.
///
/// # Errors
/// Too little memory, or errors of `make`.
pub(crate) fn fitting<'a>(pipeline: &Pipeline, make: impl FnOnce() -> Result<Trainer<'a>>) -> Result<Trainer<'a>> {
    let needed = if pipeline.method.is_some() { 0 } else { network_bytes(&*pipeline.deformation) };
    refuse_beyond_memory(needed, "the network", "a smaller `width` or `depth` of the deformation")?;
    let trainer = make()?;
    let what = format!("a training step with N = {}", trainer.cloud().len());
    let advice = "fewer Gaussians (`max_points` of PointCloud, `count` of the others) or a smaller `training.batch`";
    refuse_beyond_memory(trainer.step_bytes(), &what, advice)?;
    Ok(trainer)
}

fn refuse_beyond_memory(needed: u64, what: &str, advice: &str) -> Result<()> {
    match free_memory() {
        Some(free) if needed > free => Err(Error::Config(format!(
            "{what} needs about {:.1} GB of memory, and {:.1} GB are left here; take {advice}",
            needed as f64 / 1e9,
            free as f64 / 1e9
        ))),
        _ => Ok(()),
    }
}

/// Training in progress: data, trainer, session and files.
pub(crate) struct Training<'a, 's> {
    pub(crate) pipeline: &'a Pipeline,
    pub(crate) split: &'a SplitData,
    pub(crate) session: &'a mut Session<'s>,
    /// Start time of the run.
    pub(crate) begun: Instant,
}

impl Training<'_, '_> {
    /// Trains to the end and writes the model; returns `None` if stopped.
    pub(crate) fn train(
        &mut self,
        trainer: &mut Trainer<'_>,
        folder: &RunFolder,
        facts: &mut Facts,
    ) -> Result<Option<Model>> {
        let (settings, SplitData { data, partition }) = (&self.pipeline.training, self.split);
        let (steps, earlier) = (settings.steps, facts.wall_seconds);
        let mut journal = Journal::open(folder, self.pipeline, data.task(), trainer.done())?;
        let looked_at = evenly(&partition.validation, settings.validation_samples);
        self.session.observer.on_start(&Start {
            folder: folder.name(),
            title: &data.title,
            task: data.task(),
            samples: facts.samples,
            done: trainer.done(),
            steps,
            gaussians: trainer.cloud().len(),
            step_bytes: trainer.step_bytes(),
        });
        let origin = data.scene.origin;
        let write = |name, step, cloud: &GaussianCloud, gaussian_ids: &[u32], gates| {
            Snapshot::of(step, cloud, origin).known(gaussian_ids, gates).write(&folder.file(name))
        };
        if trainer.done() == 0 {
            let named = |warning: &String| format!("{}: {warning}", folder.name().display());
            trainer.warnings().iter().for_each(|warning| self.session.observer.on_warning(&named(warning)));
            write(START_SNAPSHOT, 0, trainer.cloud(), trainer.gaussian_ids(), trainer.gates())?;
        }
        // The event file of an earlier start has the same events, so it needs no separate checkpoint.
        let mut fullest = Snapshot::read(&folder.file(UNPRUNED_SNAPSHOT))?.map_or(0, |before| before.means.len());
        while !trainer.finished() {
            let stopped = self.session.stop.load(Ordering::Relaxed);
            if !stopped {
                let begun = Instant::now();
                let report = trainer.step().inspect_err(|_| self.report_last_checkpoint(folder))?;
                let seconds = begun.elapsed().as_secs_f64();
                if let Some(PruneStepState { cloud, gaussian_ids, gates, round }) = &report.pruned {
                    if cloud.len() > fullest {
                        fullest = cloud.len();
                        write(UNPRUNED_SNAPSHOT, report.step, cloud, gaussian_ids, gates.clone())?;
                    }
                    if let Some(name) = pruned_snapshot(*round) {
                        write(name, report.step, trainer.cloud(), trainer.gaussian_ids(), trainer.gates())?;
                    }
                }
                let validates = settings.validate_every > 0 && report.step.is_multiple_of(settings.validate_every);
                let scored = if validates && !looked_at.is_empty() {
                    Some(validate(report.step, &trainer.validated_model(), data, &looked_at)?)
                } else {
                    None
                };
                journal.step(&report, seconds)?;
                if let Some(scored) = &scored {
                    journal.validation(scored)?;
                    self.session.observer.on_validation(scored);
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
        let prunes =
            !self.pipeline.pruners.is_empty() && !self.pipeline.pruners.iter().any(|pruner| pruner.traits().grows);
        let mut warn = |what: String| {
            self.session.observer.on_warning(&format!("{}: {what}", folder.name().display()));
        };
        if prunes && fullest == 0 && !model.cloud.is_empty() {
            let n = model.cloud.len();
            warn(format!("nothing was pruned: {n} Gaussians remain, and no pruner has removed any"));
        }
        trainer.idle_masks().into_iter().chain(trainer.lone_gaussian()).for_each(warn);
        file::write(&folder.file(MODEL_FILE), &model)?;
        Ok(Some(model))
    }

    /// Reports that the last checkpoint outlives a failed step.
    fn report_last_checkpoint(&mut self, folder: &RunFolder) {
        if folder.file(CHECKPOINT).is_file() {
            let path = folder.name().join(CHECKPOINT);
            self.session.observer.on_message(&format!("the last checkpoint is kept in {}", path.display()));
        }
    }
}

/// Scores the samples `part`: mean and median of the first metric, then the mean of the second metric, or the tail
/// of the first if there is no second.
fn validate(step: u64, model: &Model, data: &Dataset, part: &[usize]) -> Result<Validation> {
    let bench = EvaluationSet::new(data, part, &model.stages.plane);
    let (task, model, metrics) = (data.task(), &model.prepare(), defaults::validation(data.task()));
    let measured = bench.model("the model", model, None, &metrics, &mut Session::new(&mut NoopObserver))?;
    let Summary { mean, median, tail10 } = match measured.first().map(|m| &m.values) {
        Some(Values::PerSample(values)) => Summary::of(values, task.headline.higher),
        other => {
            let mean = other.map_or(f64::NAN, Values::mean);
            Summary { mean, median: mean, tail10: mean }
        }
    };
    let third = measured.get(1).map_or(tail10, |m| m.values.mean());
    Ok(Validation { step, task, values: [mean, median, third] })
}
