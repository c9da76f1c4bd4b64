//! `run`: trains, evaluates and reports a pipeline; resumes earlier starts.

use crate::evaluate::check_alike;
use crate::facts::Facts;
use crate::folder::{CURVE, MODEL_FILE, member_folder};
use crate::input::resolve_pipeline;
use crate::journal::Journal;
use crate::load::{ActiveRun, load_split_data, load_with_findings};
use crate::partial_scores::PartialScores;
use crate::record::{VALIDATION_MEAN, read_validation, series_column};
use crate::residuals::check_residuals;
use crate::run_folder::{RunFolder, RunState};
use crate::scores::ScoreTable;
use crate::session::Session;
use crate::text::{grouped, number};
use crate::training::is_better;
use pwrfgs_core::{Error, Result, Task, files};
use pwrfgs_model::{Ensemble, file};
use pwrfgs_pipeline::Pipeline;
use pwrfgs_train::{Keep, Trainer, Training};
use std::path::Path;
use std::time::Instant;

/// Outcome of a run.
#[derive(Clone, Debug, PartialEq)]
pub enum RunOutcome {
    /// All results are written.
    Finished {
        /// Summary of all scores.
        scores: Box<ScoreTable>,
        /// Whether the run was already finished.
        already: bool,
    },
    /// Stopped during training, with a checkpoint at this step; the same command resumes.
    Interrupted {
        /// Number of completed steps.
        step: u64,
    },
    /// Stopped during scoring; the same command scores the model.
    Unscored,
}

/// Runs `pipeline`, with paths relative to `base`, in the folder `out`. Once the session is stopped, it ends at the
/// next step, or during scoring at the next chunk of predictions or the next baseline.
///
/// # Errors
/// Invalid input, before files are written; a folder that cannot be written; values that are not finite. Files written
/// so far stay intact.
pub fn run(pipeline: &Pipeline, base: &Path, out: &Path, session: &mut Session<'_>) -> Result<RunOutcome> {
    let pipeline = resolve_pipeline(pipeline, base)?;
    loop {
        if let Some(end) = start_or_resume(&pipeline, out, session)? {
            return Ok(end);
        }
    }
}

/// Scores a `model` that no run has trained, as a run of `pipeline` in the folder `out`, which is new or of an earlier call:
/// with scores and report, but without a training curve.
///
/// # Errors
/// As [`run`]; a folder that holds another run.
pub fn score_model(
    model: &Ensemble,
    pipeline: &Pipeline,
    base: &Path,
    out: &Path,
    session: &mut Session<'_>,
) -> Result<RunOutcome> {
    let resolved = resolve_pipeline(pipeline, base)?;
    check_alike(&model.prepare(), &load_split_data(&resolved, session.observer)?.data)?; // before files are written
    let folder = RunFolder::claim(out, &resolved)?;
    let path = folder.file(MODEL_FILE);
    if folder.is_new() {
        folder.settle(file::write_ensemble(&path, model))?;
    } else if !folder.settle(holds_model(&path, model, resolved.residuals.is_some()))? {
        let problem = "holds another run; choose another folder or remove it";
        return Err(Error::input(out, problem));
    }
    drop(folder);
    run(pipeline, base, out, session)
}

/// Returns whether the file at `path` holds `model`, or, if the run `fits_residuals`, that model with residuals of an earlier
/// call.
fn holds_model(path: &Path, model: &Ensemble, fits_residuals: bool) -> Result<bool> {
    let Some(bytes) = files::if_found(path, files::read(path))? else { return Ok(false) };
    let unfitted_bytes = |ensemble: Ensemble| file::ensemble_to_bytes(&ensemble.with_residuals(None));
    let may_be_fitted = fits_residuals && model.residuals().is_none();
    let is_fitted = |stored| unfitted_bytes(stored) == unfitted_bytes(model.clone());
    let is_same = bytes == file::ensemble_to_bytes(model);
    Ok(is_same || may_be_fitted && file::from_bytes(&bytes).is_ok_and(is_fitted))
}

/// Runs or resumes the pipeline; `None` if another process has claimed it meanwhile, and the state must be read again.
fn start_or_resume(pipeline: &Pipeline, out: &Path, session: &mut Session<'_>) -> Result<Option<RunOutcome>> {
    let begun = Instant::now();
    let already = |scores: ScoreTable| Some(RunOutcome::Finished { scores: scores.into(), already: true });
    let (state, reported) = (RunFolder::inspect(out, pipeline)?, session.page.is_some());
    if let Some(scores) = state.read_verified(out, reported)? {
        // A finished run may have been restarted since, by another process with another pipeline.
        return RunFolder::inspect(out, pipeline).map(|_| already(scores));
    }
    // Earlier results are read under the lock, since another process could still write.
    let claimed = (state != RunState::New).then(|| RunFolder::claim(out, pipeline)).transpose()?;
    if let Some(folder) = &claimed {
        if let Some(scores) = folder.settle(folder.state().read_verified(folder.path(), reported))? {
            return Ok(already(scores));
        }
        check_resumable(folder, pipeline, out)?;
    }
    // A run that has begun has accepted its data.
    let accepted = claimed.is_none().then_some(&pipeline.accept[..]);
    let (split, findings) = load_with_findings(pipeline, accepted, session.observer)?;
    pipeline.check_data(&split.data)?;
    check_residuals(pipeline, &split, false)?;
    let mut run = ActiveRun { pipeline, split: &split, session, begun };
    // Before a new folder is claimed: invalid settings must not leave files.
    let trainer = match &claimed {
        Some(folder) if folder.file(MODEL_FILE).is_file() => None,
        _ if pipeline.members > 1 => run.check_members().map(|()| None)?,
        claimed => match run.start_trainer(claimed.as_ref()) {
            Err(Error::Stopped) => return Ok(Some(RunOutcome::Interrupted { step: 0 })),
            trainer => Some(trainer?),
        },
    };
    let mut folder = match claimed {
        Some(folder) => folder,
        None => match RunFolder::claim(out, pipeline)? {
            folder if folder.is_new() => folder,
            _ => return Ok(None), // another process has begun this run since, and may have ended it
        },
    };
    let members = (0..pipeline.members).filter(|_| pipeline.members > 1).map(member_folder).collect();
    let facts = folder.begin(pipeline, &split, Facts { findings, members, ..Facts::default() });
    let facts = folder.settle(facts)?;
    let ended = run.complete(trainer, &folder, facts);
    folder.settle(ended).map(Some)
}

/// Checks that a run of `pipeline` can resume in the claimed `folder`, which messages call `out`.
///
/// # Errors
/// The joined model of a sweep, or a damaged `run.json` or model file.
fn check_resumable(folder: &RunFolder, pipeline: &Pipeline, out: &Path) -> Result<()> {
    let facts = Facts::read(folder.path())?.unwrap_or_default();
    if pipeline.members == 1 && !facts.members.is_empty() {
        return Err(Error::input(out, "holds the joined model of a sweep; repeat `pwrfgs sweep` with its file"));
    }
    if folder.file(MODEL_FILE).is_file() {
        folder.settle(facts.verify_file(folder.path(), MODEL_FILE))?;
    }
    Ok(())
}

/// Describes the step with the best validation in `rows`, the rows of `validation.csv`; `None` unless its value differs from the
/// last by more than a hundredth.
fn best_step_note(rows: &[Vec<Option<f64>>], training: &Training, task: Task) -> Option<String> {
    let values = series_column(rows, VALIDATION_MEAN);
    let (_, end) = *values.last()?;
    let best = values.iter().copied().reduce(|best, next| if is_better(task, next.1, best.1) { next } else { best });
    let (step, value) = best.filter(|(_, value)| (value - end).abs() > 0.01 * end.abs())?;
    let kept = if training.keep == Keep::Best { "; the model is the best one after pruning" } else { "" };
    let (name, step, [value, end]) = (task.headline.name, grouped(step as i64), [value, end].map(number));
    Some(format!("validation {name} was best at step {step} ({value}), at the end {end}{kept}"))
}

impl<'a> ActiveRun<'a, '_> {
    /// Completes training, unless the model exists, and scores the model. Without a trainer, it trains all members. The
    /// outcome is `Interrupted` or `Unscored` if the session is stopped.
    fn complete(mut self, trainer: Option<Trainer<'a>>, folder: &RunFolder, mut facts: Facts) -> Result<RunOutcome> {
        let model = match trainer {
            Some(trainer) => self.train(trainer, folder, &mut facts)?.map(Ensemble::of),
            None if folder.file(MODEL_FILE).is_file() => Some(file::read_ensemble(&folder.file(MODEL_FILE))?),
            None => self.train_members(folder, &mut facts)?,
        };
        let Some(model) = model else { return Ok(RunOutcome::Interrupted { step: facts.steps }) };
        match self.score(model, folder, facts) {
            Err(Error::Stopped) => Ok(RunOutcome::Unscored),
            scores => Ok(RunOutcome::Finished { scores: scores?.into(), already: false }),
        }
    }

    /// Fits residuals and intervals to the model, scores it, and writes all results. Returns the scores.
    pub(crate) fn score(&mut self, mut model: Ensemble, folder: &RunFolder, mut facts: Facts) -> Result<ScoreTable> {
        let (pipeline, split, begun) = (self.pipeline, self.split, Instant::now());
        let (is_ensemble, count) = (!facts.members.is_empty(), facts.members.len().max(1));
        // The links that a model of `score_model` was trained on are unknown, so it is not calibrated.
        let is_trained_here = is_ensemble || folder.file(CURVE).is_file();
        // Written one after the other: a stopped start keeps what it has fitted.
        let write = |model: &Ensemble| file::write_ensemble(&folder.file(MODEL_FILE), model);
        if pipeline.residuals.is_some() && model.residuals().is_none() {
            model = self.fit_residuals(model, count)?;
            write(&model)?;
        }
        if is_trained_here && model.calibration().is_none() {
            model = self.calibrate(model)?;
            model.calibration().map_or(Ok(()), |_| write(&model))?;
        }
        let (task, test) = (split.data.task(), split.partition.test.len());
        self.session.observer.on_message(&format!("scoring {test} test {}", task.counted[1]));
        let mut partial = PartialScores::open(folder.path(), &model, pipeline, split)?;
        let mut result = self.evaluate_parts(&model, &mut partial)?;
        // Each model of an ensemble has its own validation, and its steps are sums.
        if !is_ensemble {
            facts.validation_baselines = self.validation_baselines(model.plane(), &mut partial)?;
        }
        if !is_trained_here {
            // `score_model`: nothing is known of the training.
            let table = &mut result.scores.table;
            (table.samples[0], table.trained_elsewhere) = (0, true);
            table.notes.push("the model was trained outside of this run, not with the settings of its pipeline".into());
        } else if !is_ensemble {
            facts.steps = pipeline.training.steps;
        }
        if is_trained_here && (!is_ensemble || pipeline.members > 1) {
            let rows = read_validation(folder.path(), &facts);
            result.scores.table.notes.extend(best_step_note(&rows, &pipeline.training, task));
        }
        facts.wall_seconds += begun.elapsed().as_secs_f64();
        if pipeline.tensorboard && !is_ensemble {
            Journal::open(folder, pipeline, task, pipeline.training.steps)?.record_scores(&result.scores.table)?;
        }
        self.conclude(folder, facts, &model, result)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Some rows of a training on 197 transmitters that fits noise after 500 steps.
    #[test]
    fn states_the_best_step_of_an_overfitted_training() {
        let series = [(100, 2.3693), (500, 2.0783), (1_000, 2.3492), (4_000, 2.4719)];
        let rows: Vec<_> = series.map(|(step, error)| vec![Some(f64::from(step)), Some(error)]).to_vec();
        let note = |rows, keep| best_step_note(rows, &Training { keep, ..Training::default() }, Task::Power);
        let sentence = "validation error [dB] was best at step 500 (2.078), at the end 2.472";
        assert_eq!(note(&rows, Keep::Last).as_deref(), Some(sentence));
        assert_eq!(note(&rows, Keep::Best).unwrap(), format!("{sentence}; the model is the best one after pruning"));
        assert_eq!(note(&rows[..2], Keep::Last), None);
        assert_eq!(note(&[], Keep::Last), None);
    }

    #[test]
    fn any_number_is_better_than_nan() {
        for task in Task::ALL {
            assert!(is_better(task, 0.5, f64::NAN) && !is_better(task, f64::NAN, 0.5) && !is_better(task, 0.5, 0.5));
        }
        assert!(is_better(Task::Spectrum, 0.9, 0.8) && is_better(Task::Power, 0.8, 0.9));
    }
}
