//! Names of the files in a run folder: sealed files, files that can be recreated, and snapshots.

use pwrfgs_model::file::MOST_MEMBERS;
use std::path::{Path, PathBuf};

/// Pipeline file; its presence marks a run folder.
pub const PIPELINE: &str = "pipeline.ron";
/// Folder of data sets that were in memory when a run or sweep began; it may exist before the run.
pub const DATA: &str = "data";
/// Checkpoint for resuming.
pub const CHECKPOINT: &str = "checkpoint.safetensors";
/// Model of the best validation so far, with `keep: Best`.
pub const BEST_MODEL: &str = "best.safetensors";
/// Files that only a resumed training reads. A run removes them with its scores complete, unless the session keeps them.
pub const RESUME_ONLY: [&str; 2] = [CHECKPOINT, BEST_MODEL];
/// The trained model.
pub const MODEL_FILE: &str = "model.safetensors";
/// Gaussians before the first step.
pub const START_SNAPSHOT: &str = "start.safetensors";
/// Gaussians before pruning, at their largest number.
pub const UNPRUNED_SNAPSHOT: &str = "unpruned.safetensors";
/// Gaussians after prune steps, spread evenly over all of them.
pub const PRUNED_SNAPSHOTS: [&str; 12] = [
    "pruned-01.safetensors",
    "pruned-02.safetensors",
    "pruned-03.safetensors",
    "pruned-04.safetensors",
    "pruned-05.safetensors",
    "pruned-06.safetensors",
    "pruned-07.safetensors",
    "pruned-08.safetensors",
    "pruned-09.safetensors",
    "pruned-10.safetensors",
    "pruned-11.safetensors",
    "pruned-12.safetensors",
];
/// Training curve: step, phase, loss, penalty, Gaussians, seconds.
pub const CURVE: &str = "curve.csv";
/// Header of the training curve, whose rows `Journal::record_step` writes in this order.
pub(crate) const CURVE_HEADER: &str = "step,phase,loss,penalty,gaussians,seconds";
/// Column of the loss in the training curve, counted from 0.
pub const CURVE_LOSS: usize = 2;
/// Column of the number of Gaussians in the training curve, counted from 0.
pub const CURVE_GAUSSIANS: usize = 4;
/// Validation scores: step, and the columns of the [headline metric](pwrfgs_core::Headline) on the validation set.
pub const VALIDATION: &str = "validation.csv";
/// TensorBoard file of loss, N, validation and scores, if the pipeline sets `tensorboard`.
pub const EVENTS: &str = "events.out.tfevents.pwrfgs";

/// Returns the folder of model `index`, counted from 0, of a run with several models, relative to the run folder. Its name counts
/// from 1.
pub fn member_folder(index: usize) -> String {
    format!("members/{}", index + 1)
}

/// Returns the number of models of the run in `run` that were trained before the last one, and the folder of the last one,
/// which holds its training curve. For a run of one model, or without a model yet, returns 0 and `run`.
pub fn training_folder(run: &Path) -> (usize, PathBuf) {
    let begun = |index: &usize| run.join(member_folder(*index)).is_dir();
    let index = (0..MOST_MEMBERS).take_while(begun).last();
    (index.unwrap_or(0), index.map_or_else(|| run.to_owned(), |index| run.join(member_folder(index))))
}

/// Results of a scoring in progress; removed with its scores complete.
pub const PARTIAL_SCORES: &str = "scoring.partial";
/// All scores.
pub const SCORES: &str = "scores.csv";
/// All transmitters.
pub const SAMPLES: &str = "samples.csv";
/// Spread and error of every test sample of an ensemble.
pub const CONFIDENCE: &str = "confidence.csv";
/// Facts of the run: machine, seed, times.
pub const FACTS: &str = "run.json";
/// Report of the run.
pub const REPORT: &str = "report.html";

/// Sealed files that a run recreates if they are missing.
pub(crate) const REMADE: [&str; 5] = [MODEL_FILE, SCORES, SAMPLES, CONFIDENCE, REPORT];

/// Lists the files sealed in `run.json`. The TensorBoard file is excluded, since it grows and no command reads it.
pub(crate) fn sealed_files() -> impl Iterator<Item = &'static str> {
    let written_once = [CURVE, VALIDATION, START_SNAPSHOT, UNPRUNED_SNAPSHOT];
    REMADE.into_iter().chain(written_once).chain(PRUNED_SNAPSHOTS)
}

/// Lists all possible snapshots of a training, in the order of their steps, with captions.
pub fn snapshots() -> impl Iterator<Item = (&'static str, &'static str)> {
    let first = [(START_SNAPSHOT, "At the start"), (UNPRUNED_SNAPSHOT, "Before pruning")];
    first.into_iter().chain(PRUNED_SNAPSHOTS.map(|name| (name, "Pruned")))
}

/// Returns the name of the snapshot after prune step `round` of `rounds`, counted from 1; `None` if it is not saved, or if
/// `round` is 0, which is no prune step.
pub(crate) fn pruned_snapshot((round, rounds): (u64, u64)) -> Option<&'static str> {
    let most = rounds.min(PRUNED_SNAPSHOTS.len() as u64);
    let saved_until = |round: u64| (round * most).checked_div(rounds).unwrap_or(0);
    let is_next = round > 0 && saved_until(round) > saved_until(round - 1);
    is_next.then(|| PRUNED_SNAPSHOTS[saved_until(round) as usize - 1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prune_snapshots_are_spread_over_all_prune_steps() {
        let saved = |rounds: u64| (1..=rounds).filter_map(|k| pruned_snapshot((k, rounds))).collect::<Vec<_>>();
        assert_eq!(saved(3), PRUNED_SNAPSHOTS[..3]);
        assert_eq!(saved(100), PRUNED_SNAPSHOTS);
        assert_eq!(pruned_snapshot((100, 100)), Some("pruned-12.safetensors"), "the last is always among them");
        assert_eq!(pruned_snapshot((0, 0)), None, "densification's are not");
    }
}
