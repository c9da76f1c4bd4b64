//! `join: true`: the models of all runs of a sweep as one model, which predicts their mean.

use super::experiment::slug;
use super::plan::{Plan, PlannedRun};
use super::status::State;
use crate::evaluate::evaluate;
use crate::facts::{Facts, Mark};
use crate::folder::{MODEL_FILE, RunFolder};
use crate::load::load;
use crate::page::conclude;
use crate::runner::Outcome;
use crate::scores::ScoreTable;
use crate::session::Session;
use pwrfgs_core::files::write_atomically;
use pwrfgs_core::plugin::to_ron;
use pwrfgs_core::{Dataset, Error, Partition, Result};
use pwrfgs_model::Ensemble;
use pwrfgs_model::file::{self, MOST_MEMBERS};
use pwrfgs_pipeline::Pipeline;
use std::path::Path;
use std::time::Instant;

/// The run folder of the joined model, below the sweep folder.
pub const JOINED: &str = "joined";

impl PlannedRun {
    /// Name of its model within a joined model: labels and seed, such as `waves-0`.
    fn member_name(&self) -> String {
        let labels = self.labels.iter().map(|(_, label)| slug(label).replace('+', "-"));
        let words: Vec<String> = labels.chain([self.pipeline.seed.to_string()]).collect();
        if self.labels.is_empty() { format!("seed-{}", self.pipeline.seed) } else { words.join("-") }
    }
}

/// Gives all `runs` the same split and returns the pipeline that scores their joined model, called `name`. Baselines are
/// scored with that model alone.
///
/// # Errors
/// Runs that cannot predict together.
pub(super) fn align(name: &str, runs: &mut [PlannedRun]) -> Result<Pipeline, String> {
    if !(2..=MOST_MEMBERS).contains(&runs.len()) {
        return Err(format!("there are {} runs; give variants and seeds that make 2 to {MOST_MEMBERS}", runs.len()));
    }
    let pipelines = || runs.iter().map(|run| &run.pipeline);
    let split_seed = pipelines().find_map(|own| own.split_seed).unwrap_or(runs[0].pipeline.seed);
    if pipelines().any(|own| own.split_seed.is_some_and(|own| own != split_seed)) {
        return Err("the runs differ in `split_seed`; give all the same value, or none".into());
    }
    let first = &runs[0];
    let trained: Vec<String> = pipelines().map(trained).collect();
    for (place, run) in runs.iter().enumerate() {
        let PlannedRun { folder, pipeline, .. } = run;
        let called = run.member_name();
        if runs[..place].iter().any(|other| other.member_name().eq_ignore_ascii_case(&called)) {
            return Err(format!("two models are called `{called}`; change a label"));
        }
        if let Some(twin) = trained[..place].iter().position(|other| *other == trained[place]) {
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
        if first.pipeline.projector.plane(360, 90) != pipeline.projector.plane(360, 90) {
            return differ("projector");
        }
    }
    let scored = Pipeline { name: name.to_owned(), split_seed: Some(split_seed), ..first.pipeline.clone() };
    for PlannedRun { pipeline, .. } in runs {
        pipeline.split_seed = Some(split_seed);
        pipeline.baselines.clear();
    }
    Ok(scored)
}

/// Everything of a pipeline that decides the model, once all have the same split.
fn trained(pipeline: &Pipeline) -> String {
    let (name, baselines, metrics) = Default::default();
    to_ron(&Pipeline { name, split_seed: None, baselines, metrics, ..pipeline.essential() })
}

/// Joins the models of a plan with `join: true` in the folder [`JOINED`] and scores the result. Returns `None` if the plan
/// joins nothing, a run has not finished, or another process joins them.
///
/// # Errors
/// As [`crate::run`].
pub(super) fn join(plan: &Plan, session: &mut Session<'_>) -> Result<Option<Outcome>> {
    let Some(pipeline) = &plan.joined else { return Ok(None) };
    if !plan.states().iter().all(|state| matches!(state, State::Finished(_))) {
        return Ok(None);
    }
    let out = plan.folder.join(JOINED);
    let mut folder = match RunFolder::claim(&out, pipeline) {
        Err(Error::Busy(_)) => return Ok(None),
        folder => folder?,
    };
    let ended = Join { plan, pipeline, session, begun: Instant::now() }.end(&mut folder);
    folder.settle(ended).map(Some)
}

/// The work of [`join`] in a claimed folder.
struct Join<'a, 's> {
    plan: &'a Plan,
    pipeline: &'a Pipeline,
    session: &'a mut Session<'s>,
    begun: Instant,
}

impl Join<'_, '_> {
    /// Writes and scores the model, unless that very model lies there with these scores.
    fn end(&mut self, folder: &mut RunFolder) -> Result<Outcome> {
        let ensemble = self.assemble()?;
        let bytes = file::ensemble_to_bytes(&ensemble);
        let is_joined = |earlier: Facts| earlier.files.get(MODEL_FILE) == Some(&Mark::of(&bytes));
        if Facts::read(folder.path())?.is_some_and(is_joined)
            && let Some(scores) = folder.state().verified(folder.path(), self.session.page.is_some())?
        {
            return Ok(Outcome::Finished { scores, already: true });
        }
        let (data, partition) = load(self.pipeline, Path::new(""), self.session.observer)?;
        self.pipeline.check_data(&data)?;
        let members = self.plan.runs.iter().map(|run| run.folder.clone()).collect();
        let facts = folder.begin(self.pipeline, (&data, &partition), members)?;
        write_atomically(&folder.file(MODEL_FILE), &bytes)?;
        match self.assess(&ensemble, (&data, &partition), folder, facts) {
            Ok(scores) => Ok(Outcome::Finished { scores, already: false }),
            Err(Error::Stopped) => Ok(Outcome::Unscored),
            Err(error) => Err(error),
        }
    }

    /// The trained models, in the order of the plan.
    fn assemble(&self) -> Result<Ensemble> {
        let member = |(place, run): (usize, &PlannedRun)| {
            let folder = self.plan.folder_of(place);
            if let Some(facts) = Facts::read(&folder)? {
                facts.verify_file(&folder, MODEL_FILE)?;
            }
            Ok((run.member_name(), file::read(&folder.join(MODEL_FILE))?))
        };
        let members = self.plan.runs.iter().enumerate().map(member).collect::<Result<_>>()?;
        Ensemble::named(members).map_err(Error::Config)
    }

    /// Scores the model on the test set and writes scores, samples, report and facts.
    fn assess(
        &mut self,
        ensemble: &Ensemble,
        (data, partition): (&Dataset, &Partition),
        folder: &RunFolder,
        mut facts: Facts,
    ) -> Result<ScoreTable> {
        let counted = data.task().counted[1];
        self.session.observer.on_message(&format!("scoring {} test {counted}", partition.test.len()));
        let (scores, confidence) = evaluate(ensemble, self.pipeline, data, partition, self.session)?;
        (facts.steps, facts.training_seconds) = (0, 0.0);
        for place in 0..self.plan.runs.len() {
            let own = Facts::read(&self.plan.folder_of(place))?.unwrap_or_default();
            facts.steps += own.steps;
            facts.training_seconds += own.training_seconds;
            facts.peak_memory_bytes = facts.peak_memory_bytes.max(own.peak_memory_bytes);
        }
        facts.wall_seconds += self.begun.elapsed().as_secs_f64();
        conclude(folder, self.pipeline, &mut facts, (data, partition, ensemble), (scores, confidence), self.session)
    }
}
