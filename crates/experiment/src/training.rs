//! The training of a run: the loop that writes curve, validation, snapshots and checkpoint.
//!
//! Order at every step: train, validation, curve, checkpoint. Rows reach the disk before the checkpoint that counts
//! them, and a resumed run cuts the series back to its checkpoint: so it ends in the same files as one never stopped.
//! Snapshots are functions of the step, and written before the checkpoint of that step: a resumed run writes them again.

use crate::facts::Facts;
use crate::folder::{CHECKPOINT, MODEL_FILE, RunFolder, START_SNAPSHOT, UNPRUNED_SNAPSHOT, pruned_snapshot};
use crate::journal::Journal;
use crate::observer::Start;
use crate::session::Session;
use crate::validation::validate;
use pwrfgs_core::files::write_atomically;
use pwrfgs_core::{Dataset, GaussianCloud, Partition, Result, evenly};
use pwrfgs_model::Snapshot;
use pwrfgs_model::{Model, file};
use pwrfgs_pipeline::Pipeline;
use pwrfgs_train::{Estimate, Pruned, Trainer};
use std::sync::atomic::Ordering;
use std::time::Instant;

/// What is trained, on what, and who follows it.
pub(crate) struct Training<'a, 's> {
    pub(crate) pipeline: &'a Pipeline,
    pub(crate) data: &'a Dataset,
    pub(crate) partition: &'a Partition,
    pub(crate) session: &'a mut Session<'s>,
    /// When the run was started.
    pub(crate) begun: Instant,
}

impl Training<'_, '_> {
    /// Trains to the end and writes the model, or returns nothing where it was asked to stop.
    pub(crate) fn train(
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
            task: self.data.task(),
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
                let look = settings.validate_every > 0 && report.step.is_multiple_of(settings.validate_every);
                let seen = if look && !looked_at.is_empty() {
                    Some(validate(report.step, &trainer.model(), self.data, &looked_at)?)
                } else {
                    None
                };
                journal.step(&report, seconds)?;
                if let Some(seen) = &seen {
                    journal.validation(seen)?;
                    self.session.observer.on_validation(seen);
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
}
