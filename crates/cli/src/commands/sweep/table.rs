//! The runs of a sweep as aligned text.

use pwrfgs::experiment::Facts;
use pwrfgs::experiment::sweep::{JOINED, Plan, State};
use pwrfgs::experiment::text::{aligned, duration, grouped, number};
use pwrfgs_core::Task;
use std::collections::BTreeSet;
use std::fmt::Write as _;

/// How far each of `runs` is; `queued` names those that a scheduler has.
pub(super) fn status(plan: &Plan, runs: &[usize], queued: &BTreeSet<String>) -> String {
    let states: Vec<State> = runs.iter().map(|&run| plan.state(run)).collect();
    let ends = states.iter().filter_map(|state| if let State::Finished(end) = state { Some(end) } else { None });
    let task = ends.clone().next().map_or_else(Task::default, |end| end.0.task);
    let head = ["run", "state", "step", "N", task.headline.short, "eta_0db", "time"];
    let mut lines = vec![head.map(str::to_owned).to_vec()];
    let finished = ends.count();
    for (&run, state) in runs.iter().zip(&states) {
        let (name, steps) = (&plan.runs[run].folder, plan.runs[run].pipeline.training.steps);
        let of = |step: u64| format!("{}/{}", grouped(step as i64), grouped(steps as i64));
        let mut line = vec![String::new(); lines[0].len()];
        line[0].clone_from(name);
        line[1] = state.name().into();
        let waits = queued.contains(name);
        match state {
            State::Waiting if waits => line[1] = "queued".into(),
            State::Waiting => {}
            State::Stopped { step } if waits => (line[1], line[2]) = ("queued again".into(), of(*step)),
            State::Running { step } | State::Stopped { step } => line[2] = of(*step),
            State::Failed(why) => line[1] = format!("failed: {why}"),
            State::Finished(end) => {
                let (scores, facts) = &**end;
                let score = |key| scores.of_model(key).map_or_else(|| "n/a".into(), number);
                (line[2], line[3]) = (of(facts.steps), grouped(facts.gaussians as i64));
                (line[4], line[5], line[6]) =
                    (score(scores.task.headline.key), score("eta_0db"), duration(facts.wall_seconds));
            }
        }
        lines.push(line);
    }
    let head = format!("{}: {finished} of {} runs finished, in {}\n", plan.name, runs.len(), plan.folder.display());
    let joined = plan.joined.as_ref().map_or("", |_| match Facts::finished(&plan.folder.join(JOINED)) {
        Ok(Some(_)) => "their joined model is finished, in joined\n",
        _ => "their models are joined after the last run\n",
    });
    head + joined + &aligned(&lines, 2)
}

/// All runs with the seconds each would take.
pub(super) fn plan(plan: &Plan, runs: &[usize], seconds: &[f64], jobs: usize) -> String {
    let mut lines = vec![["run", "state", "time"].map(str::to_owned).to_vec()];
    for (&run, seconds) in runs.iter().zip(seconds) {
        let time = if *seconds > 0.0 { format!("about {}", duration(*seconds)) } else { String::new() };
        lines.push(vec![plan.runs[run].folder.clone(), plan.state(run).name().into(), time]);
    }
    let combinations = runs.iter().map(|&run| plan.runs[run].combination).collect::<BTreeSet<_>>().len();
    let mut text =
        format!("{}: {} runs of {combinations} combinations, in {}\n", plan.name, runs.len(), plan.folder.display());
    text += &aligned(&lines, 2);
    let all = seconds.iter().sum::<f64>() / jobs as f64;
    _ = writeln!(
        text,
        "about {} in all on this machine with --jobs {jobs}, by the first steps of each combination; pruning makes later \
         steps faster, densification slower",
        duration(all)
    );
    text
}
