//! Names of the files in a run folder: which are sealed, which are made again, and the snapshots.

/// The file that names the run and makes a folder a run folder.
pub const PIPELINE: &str = "pipeline.ron";
/// Everything needed to go on.
pub const CHECKPOINT: &str = "checkpoint.safetensors";
/// The trained model.
pub const MODEL_FILE: &str = "model.safetensors";
/// The Gaussians before the first step.
pub const START_SNAPSHOT: &str = "start.safetensors";
/// The Gaussians before pruning, when they were most.
pub const UNPRUNED_SNAPSHOT: &str = "unpruned.safetensors";
/// The Gaussians after prune steps: spread evenly over all of them, so many at most.
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
/// Step, phase, loss, penalty, Gaussians, seconds.
pub const CURVE: &str = "curve.csv";
/// Step, SSIM and η on the validation part.
pub const VALIDATION: &str = "validation.csv";
/// Loss, N, validation and scores for TensorBoard, where the pipeline asks for it.
pub const EVENTS: &str = "events.out.tfevents.pwrfgs";
/// Every score.
pub const SCORES: &str = "scores.csv";
/// Every transmitter.
pub const SAMPLES: &str = "samples.csv";
/// Spread and error of every test sample, of an ensemble.
pub const CONFIDENCE: &str = "confidence.csv";
/// Circumstances: machine, seed, times.
pub const FACTS: &str = "run.json";
/// The report.
pub const REPORT: &str = "report.html";

/// Sealed files that the run makes again where they are missing.
pub(crate) const REMADE: [&str; 5] = [MODEL_FILE, SCORES, SAMPLES, CONFIDENCE, REPORT];

/// Files that `run.json` seals; TensorBoard's events grow, and nothing but TensorBoard reads them.
pub(crate) fn sealed() -> impl Iterator<Item = &'static str> {
    let written_once = [CURVE, VALIDATION, START_SNAPSHOT, UNPRUNED_SNAPSHOT];
    REMADE.into_iter().chain(written_once).chain(PRUNED_SNAPSHOTS)
}

/// Every snapshot that a training may leave, in the order of their steps, and what it shows.
pub fn snapshots() -> impl Iterator<Item = (&'static str, &'static str)> {
    let first = [(START_SNAPSHOT, "At the start"), (UNPRUNED_SNAPSHOT, "Before pruning")];
    first.into_iter().chain(PRUNED_SNAPSHOTS.map(|name| (name, "Pruned")))
}

/// The snapshot after prune step `round` of `rounds`, counted from 1; nothing for those that are left out.
pub(crate) fn pruned_snapshot((round, rounds): (u64, u64)) -> Option<&'static str> {
    let most = rounds.min(PRUNED_SNAPSHOTS.len() as u64);
    let place = |round: u64| (round * most).checked_div(rounds).unwrap_or(0);
    let is_next = round > 0 && place(round) > place(round - 1);
    is_next.then(|| PRUNED_SNAPSHOTS[place(round) as usize - 1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn snapshots_of_prune_steps_are_spread_over_all_of_them() {
        let all = |rounds: u64| (1..=rounds).filter_map(|k| pruned_snapshot((k, rounds))).collect::<Vec<_>>();
        assert_eq!(all(3), PRUNED_SNAPSHOTS[..3]);
        assert_eq!(all(100), PRUNED_SNAPSHOTS);
        assert_eq!(pruned_snapshot((100, 100)), Some("pruned-12.safetensors"), "the last is always among them");
        assert_eq!(pruned_snapshot((0, 0)), None, "densification's are not");
    }
}
