//! `run`: from a pipeline to a trained, evaluated, reported model; goes on where an earlier start left off.

use crate::evaluate::{evaluate, validation_baselines};
use crate::facts::Facts;
use crate::folder::MODEL_FILE;
use crate::input::prepared;
use crate::journal::Journal;
use crate::load::load;
use crate::page::conclude;
use crate::run_folder::{RunFolder, RunState};
use crate::scores::ScoreTable;
use crate::session::Session;
use crate::training::{Training, trainer};
use pwrfgs_core::{Error, Result};
use pwrfgs_model::{Ensemble, file};
use pwrfgs_pipeline::Pipeline;
use pwrfgs_train::{Estimate, Trainer};
use std::path::Path;
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
    loop {
        if let Some(end) = attempt(pipeline, (base, out), session, begun)? {
            return Ok(end);
        }
    }
}

/// The end of the run; nothing if another process has begun it meanwhile: then what it left counts.
fn attempt(
    pipeline: &Pipeline,
    (base, out): (&Path, &Path),
    session: &mut Session<'_>,
    begun: Instant,
) -> Result<Option<Outcome>> {
    let pipeline = &prepared(pipeline, base)?;
    let already = |scores| Some(Outcome::Finished { scores, already: true });
    let (state, reported) = (RunFolder::inspect(out, pipeline)?, session.page.is_some());
    if let Some(scores) = state.verified(out, reported)? {
        // What has ended may have been begun since, by another process with another pipeline.
        return RunFolder::inspect(out, pipeline).map(|_| already(scores));
    }
    // What earlier starts left is read by the process that holds it: another one would write on.
    let held = (state != RunState::New).then(|| RunFolder::claim(out, pipeline)).transpose()?;
    if let Some(folder) = &held {
        if let Some(scores) = folder.settle(folder.state().verified(folder.path(), reported))? {
            return Ok(already(scores));
        }
        let facts = Facts::read(folder.path())?.unwrap_or_default();
        if !facts.members.is_empty() {
            return Err(Error::input(out, "holds the joined model of a sweep; repeat `pwrfgs sweep` with its file"));
        }
        if folder.file(MODEL_FILE).is_file() {
            folder.settle(facts.verify_file(folder.path(), MODEL_FILE))?;
        }
    }
    let (data, partition) = load(pipeline, base, session.observer)?;
    pipeline.check_data(&data)?;
    // Made before a new folder is claimed: settings that cannot work must leave nothing behind.
    let trainer = match &held {
        Some(folder) if folder.file(MODEL_FILE).is_file() => None,
        held => match trainer(pipeline, (&data, &partition), held.as_ref(), session) {
            Err(Error::Stopped) => return Ok(Some(Outcome::Interrupted { step: 0 })),
            trainer => Some(trainer?),
        },
    };
    let mut folder = match held {
        Some(folder) => folder,
        None => match RunFolder::claim(out, pipeline)? {
            folder if folder.is_new() => folder,
            _ => return Ok(None), // another process has begun this run since, and may have ended it
        },
    };
    let facts = folder.begin(pipeline, (&data, &partition), Vec::new());
    let facts = folder.settle(facts)?;
    let training = Training { pipeline, data: &data, partition: &partition, session, begun };
    let ended = complete(training, trainer, (&folder, facts));
    folder.settle(ended).map(Some)
}

/// Trains what is left, unless the model is there (then there is no trainer), and scores it.
fn complete<'a>(
    mut training: Training<'a, '_>,
    trainer: Option<(Trainer<'a>, Estimate)>,
    (folder, mut facts): (&RunFolder, Facts),
) -> Result<Outcome> {
    let Training { pipeline, data, partition, .. } = training;
    let model = match trainer {
        None => file::read(&folder.file(MODEL_FILE))?,
        Some((mut trainer, estimate)) => match training.train(&mut trainer, estimate, folder, &mut facts)? {
            Some(model) => model,
            None => return Ok(Outcome::Interrupted { step: trainer.done() }),
        },
    };
    let (session, begun, model) = (training.session, Instant::now(), Ensemble::of(model));
    session.observer.on_message(&format!("scoring {} test {}", partition.test.len(), data.task().counted[1]));
    let scored = evaluate(&model, pipeline, data, partition, session)
        .and_then(|found| Ok((found, validation_baselines(model.plane(), pipeline, data, partition, session)?)));
    let (found, baselines) = match scored {
        Err(Error::Stopped) => return Ok(Outcome::Unscored),
        scored => scored?,
    };
    facts.validation_baselines = baselines;
    facts.steps = pipeline.training.steps;
    facts.wall_seconds += begun.elapsed().as_secs_f64();
    if pipeline.tensorboard {
        Journal::open(folder, pipeline, data.task(), pipeline.training.steps)?.scores(&found.0.table)?;
    }
    let scores = conclude(folder, pipeline, &mut facts, (data, partition, &model), found, session)?;
    Ok(Outcome::Finished { scores, already: false })
}
