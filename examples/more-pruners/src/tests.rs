//! Tests of the scores, of settings, and that trainings with these pruners reach an exact target and resume.

use super::*;
use pwrfgs::prelude::*;

fn context(round: u64) -> StepContext {
    StepContext { round, rounds: 3, ..StepContext::new(12, Phase::Prune, 3) }
}

/// Gaussians of unit scale on a line, at these places in metres.
fn line(places: &[Real]) -> GaussianCloud {
    let mut cloud = GaussianCloud::zeros(places.len());
    cloud.means = places.iter().map(|x| [*x, 0.0, 0.0]).collect();
    cloud.opacity_logits = (0..places.len()).map(|i| -(i as Real)).collect();
    cloud
}

#[test]
fn fast_gs_removes_what_covers_most_large_errors() {
    let cloud = line(&[0.0, 1.0, 2.0, 3.0]);
    let requested = PassStatistics { high_error: vec![2.0, 10.0, 4.0, 6.0], ..PassStatistics::default() };
    let stats = CloudStats { requested, ..CloudStats::zeros(4) };
    let pruner = FastGs { blame: 0.5, ..FastGs::default() };
    assert_eq!(pruner.score(&cloud, &stats, &context(1)), [1.0, 0.0, 0.75, 0.5]);
    assert_eq!(pruner.keep(&cloud, &stats, &context(1)), [true, false, true, true]);
    assert_eq!(pruner.keep(&cloud, &CloudStats::zeros(4), &context(1)), [true; 4], "nothing is known yet");
}

#[test]
fn reduced_3dgs_removes_faint_half_of_crowd() {
    // Four Gaussians overlap in a crowd, and six are alone.
    let cloud = line(&[0.0, 0.1, 0.2, 0.3, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0]);
    let pruner = Reduced3dgs::default();
    let kept = pruner.keep(&cloud, &CloudStats::zeros(10), &context(1));
    assert_eq!(kept, [true, true, false, false, true, true, true, true, true, true]);
    assert_eq!(pruner.keep(&cloud, &CloudStats::zeros(10), &context(0)), [true; 10]);
    let scores = pruner.score(&cloud, &CloudStats::zeros(10), &context(1));
    assert!(
        scores[..4].iter().all(|score| *score < -2.0) && scores[4..].iter().all(|score| *score > 0.0),
        "{scores:?}"
    );
}

#[test]
fn rejects_values_out_of_range() {
    for (text, field) in [
        ("FastGs(blame: 1.5)", "blame"),
        ("FastGs(high: NaN)", "high"),
        ("Reduced3dgs(neighbours: 0)", "neighbours"),
        ("Reduced3dgs(deviations: inf)", "deviations"),
        ("Reduced3dgs(share: -0.1)", "share"),
    ] {
        let why = Plugin::<dyn Pruner>::parse(text).unwrap_err();
        assert!(why.contains(&format!("`{field}`")), "{text}: {why}");
    }
}

/// Trains 40 Gaussians to a target of 7. Returns the checkpoint after step 14 and the last one, and N at the end.
fn train(pipeline: &Pipeline) -> (Vec<u8>, Vec<u8>, usize) {
    let (data, partition) = data_of(pipeline);
    let mut trainer = pipeline.trainer(&data, &partition).unwrap();
    let (mut middle, mut count) = (Vec::new(), 0);
    while !trainer.finished() {
        count = trainer.step().unwrap().gaussians;
        if trainer.done() == 14 {
            middle = trainer.checkpoint();
        }
    }
    (middle, trainer.checkpoint(), count)
}

fn data_of(pipeline: &Pipeline) -> (Dataset, Partition) {
    let data = pipeline.data.load(std::path::Path::new("."), &|_, _| {}).unwrap();
    let partition = pipeline.partition(&data).unwrap();
    (data, partition)
}

#[test]
fn training_reaches_exact_target_and_resumes_bit_identically() {
    for pruner in ["FastGs()", "Reduced3dgs()"] {
        let text = format!(
            "Pipeline(name: \"small\", seed: 5, data: Teacher(gaussians: 6, samples: 20, width: 60, height: 15),
             initializer: Random(count: 40, std: 3), deformation: Factored(depth: 2, width: 8), pruners: [{pruner}],
             training: (steps: 24, batch: 3, target_count: 7, densify_until: 3, prune_until: 20, prune_every: 4,
                 densify: (every: 0)))"
        );
        let pipeline = Pipeline::parse(&text, std::path::Path::new("small.ron")).unwrap();
        let (middle, end, count) = train(&pipeline);
        assert_eq!(count, 7, "{pruner}");
        let (data, partition) = data_of(&pipeline);
        let mut trainer = Trainer::restore(&pipeline.plan().unwrap(), &data, &partition, &middle).unwrap();
        while !trainer.finished() {
            trainer.step().unwrap();
        }
        assert!(trainer.checkpoint() == end, "{pruner}: another checkpoint after a restart");
    }
}
