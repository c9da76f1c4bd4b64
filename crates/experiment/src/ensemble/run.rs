//! Trains the members of an ensemble, each in a folder of its own, and makes one model of theirs.

use super::Team;
use crate::evaluate::evaluate;
use crate::facts::Facts;
use crate::folder::{MODEL_FILE, RunFolder};
use crate::load::{check_scoring, load};
use crate::recipe::Recipe;
use crate::record::conclude;
use crate::runner::Outcome;
use crate::scores::ScoreTable;
use crate::session::Session;
use crate::sweep::{Board, Fate, Plan, State, check, execute};
use pwrfgs_core::{Error, Result};
use pwrfgs_model::{Ensemble, file};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Below the run folder of an ensemble: the run folders of its members.
pub const MEMBERS: &str = "members";

/// Trains what is left of `team` in the folder `out`, `jobs` members at a time, and scores their mean; a killed run goes on
/// and ends in the same files. `board` hears of the members, `observer` of the rest.
///
/// # Errors
/// As [`crate::run`]; the first member that fails, by its name.
pub fn run_team(team: &Team, out: &Path, jobs: usize, board: &dyn Board, session: &mut Session<'_>) -> Result<Outcome> {
    let begun = Instant::now();
    team.check_text()?;
    let recipe = Recipe::Ensemble(team.clone());
    let state = RunFolder::inspect(out, &recipe)?;
    let reported = session.page.is_some();
    let already = |scores| Outcome::Finished { scores, already: true };
    if let Some(scores) = state.verified(out, reported)? {
        // What has ended may have been begun since, by another process with another recipe.
        return RunFolder::inspect(out, &recipe).map(|_| already(scores));
    }
    let plan = team.plan(&out.join(MEMBERS));
    let all: Vec<usize> = (0..plan.runs.len()).collect();
    // Members are scored without baselines; the first that is left to train is asked for those of the ensemble.
    let mut asked = plan.clone();
    if let Some(&first) = all.iter().find(|&&run| !matches!(plan.state(run), State::Finished(_))) {
        asked.runs[first].pipeline.baselines = team.pipeline().baselines;
    }
    let open = check(&asked, &all, session.observer)?;
    let mut folder = RunFolder::claim(out, &recipe)?;
    // Another process may have ended it since.
    if let Some(scores) = folder.settle(folder.state().verified(folder.path(), reported))? {
        return Ok(already(scores));
    }
    let mut work = || {
        let (mut facts, _) = Facts::open(folder.path(), team.members()[0].seed)?;
        facts.write(folder.path())?;
        folder.renew(&recipe)?;
        if let Some(end) = train(&plan, &open, jobs, board, session)? {
            return Ok(end);
        }
        let ensemble = assemble(&plan)?;
        file::write_ensemble(&folder.file(MODEL_FILE), &ensemble)?;
        match assess(team, &plan, &ensemble, &folder, (&mut facts, begun), session) {
            Ok(scores) => Ok(Outcome::Finished { scores, already: false }),
            Err(Error::Stopped) => Ok(Outcome::Unscored),
            Err(error) => Err(error),
        }
    };
    let ended = work();
    folder.settle(ended)
}

/// Does the runs `open` of the plan; an outcome where they did not all end well.
fn train(
    plan: &Plan,
    open: &[usize],
    jobs: usize,
    board: &dyn Board,
    session: &Session<'_>,
) -> Result<Option<Outcome>> {
    if open.is_empty() {
        return Ok(None);
    }
    let ends = execute(plan, open, jobs, board, session)?;
    let mut interrupted = (ends.len() < open.len()).then_some(Outcome::Interrupted { step: 0 });
    for (run, fate) in ends {
        match fate {
            Fate::Finished { .. } => {}
            Fate::Failed(error) => {
                return Err(Error::Member { name: plan.runs[run].folder.clone(), source: Box::new(error) });
            }
            Fate::Busy => return Err(Error::Busy(plan.folder_of(run))),
            Fate::Unscored => interrupted = interrupted.or(Some(Outcome::Unscored)),
            Fate::Interrupted { step } => interrupted = Some(Outcome::Interrupted { step }),
        }
    }
    Ok(interrupted)
}

/// The trained members as one model.
fn assemble(plan: &Plan) -> Result<Ensemble> {
    let member = |run: usize| -> Result<(String, pwrfgs_model::Model)> {
        let folder = plan.folder_of(run);
        if let Some(facts) = Facts::read(&folder)? {
            facts.verify_file(&folder, MODEL_FILE)?;
        }
        Ok((plan.runs[run].folder.clone(), file::read(&folder.join(MODEL_FILE))?))
    };
    let members = (0..plan.runs.len()).map(member).collect::<Result<_>>()?;
    Ensemble::named(members).map_err(Error::Config)
}

/// Scores the ensemble on the test part and writes scores, samples, report and facts.
fn assess(
    team: &Team,
    plan: &Plan,
    ensemble: &Ensemble,
    folder: &RunFolder,
    (facts, begun): (&mut Facts, Instant),
    session: &mut Session<'_>,
) -> Result<ScoreTable> {
    let pipeline = team.pipeline();
    let (data, partition) = load(&pipeline, Path::new(""), session.observer)?;
    check_scoring(&pipeline, &data)?;
    session.observer.on_message(&format!("scoring {} test {}", partition.test.len(), data.task().counted[1]));
    let (scores, confidence) = evaluate(ensemble, &pipeline, &data, &partition, session)?;
    let members: Vec<PathBuf> = (0..plan.runs.len()).map(|run| plan.folder_of(run)).collect();
    facts.data.clone_from(&data.title);
    facts.simulated = data.is_simulated();
    facts.samples = [partition.train.len(), partition.validation.len(), partition.test.len()];
    (facts.steps, facts.training_seconds) = (0, 0.0);
    for member in &members {
        let own = Facts::read(member)?.unwrap_or_default();
        facts.steps += own.steps;
        facts.training_seconds += own.training_seconds;
        facts.peak_memory_bytes = facts.peak_memory_bytes.max(own.peak_memory_bytes);
    }
    facts.members = ensemble.names().to_vec();
    facts.wall_seconds += begun.elapsed().as_secs_f64();
    let recipe = Recipe::Ensemble(team.clone());
    conclude(folder, &recipe, facts, (&data, &partition, ensemble), (scores, confidence), session)
}
