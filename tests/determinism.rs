//! The same seed gives the same bits: at any thread count, and interrupted or not.

use crate::common::pipeline;
use pwrfgs::core::rng;
use pwrfgs::model::tensors::Tensors;
use pwrfgs::prelude::*;
use std::path::Path;
use std::sync::OnceLock;

const STEPS: u64 = 30;

/// Every kind of edit within thirty steps: clone, split, removal, opacity reset, prune, end of the masks.
fn busy() -> Pipeline {
    pipeline(
        "seed: 5, data: Teacher(gaussians: 6, samples: 20, width: 90, height: 24),
         initializer: Random(count: 60, std: 3),
         deformation: Mlp(depth: 3, width: 16, skip: Some(0), tx_hidden: 8, tx_features: 4),
         pruners: [LearnableMask(lambda: 0.1, learning_rate: 0.6), OpacityThreshold(epsilon: 0.02)],
         training: (steps: 30, batch: 3, target_count: 70, tx_jitter_m: 0.02, densify_until: 15, prune_until: 25, prune_every: 4,
             densify: (from: 2, every: 4, gradient_threshold: 0, clone_below: 0.2, large_above: 0.6,
                       large_after: 8, reset_every: 9, reset_opacity: 0.05))",
    )
}

fn data_of(pipeline: &Pipeline) -> (Dataset, Partition) {
    let data = pipeline.data.load(Path::new("."), &|_, _| {}).unwrap();
    let partition = pipeline.split.split(&data, &mut rng::stream(5, "split", 0)).unwrap();
    (data, partition)
}

/// Checkpoints after 0, 1, … steps, and N after each step.
fn train(pipeline: &Pipeline) -> (Vec<Vec<u8>>, Vec<usize>) {
    let (data, partition) = data_of(pipeline);
    let mut trainer = pipeline.trainer(&data, &partition).unwrap();
    let (mut checkpoints, mut counts) = (vec![trainer.checkpoint()], Vec::new());
    while !trainer.finished() {
        counts.push(trainer.step().unwrap().gaussians);
        checkpoints.push(trainer.checkpoint());
    }
    (checkpoints, counts)
}

fn train_on(threads: usize) -> (Vec<Vec<u8>>, Vec<usize>) {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| train(&busy()))
}

/// [`train`] of [`busy`] by one thread.
fn on_one() -> &'static (Vec<Vec<u8>>, Vec<usize>) {
    static TRAINED: OnceLock<(Vec<Vec<u8>>, Vec<usize>)> = OnceLock::new();
    TRAINED.get_or_init(|| train_on(1))
}

#[test]
fn training_is_bit_identical_with_one_and_two_threads() {
    let ((one, counts), (two, _)) = (on_one(), train_on(2));
    println!("N: {counts:?}");
    assert!(counts.windows(2).any(|w| w[1] > w[0]), "densification added something: {counts:?}");
    assert!(counts.windows(2).any(|w| w[1] < w[0]), "pruning took something: {counts:?}");
    for (step, (one, two)) in one.iter().zip(&two).enumerate() {
        assert!(one == two, "bits differ after step {step}");
    }
}

#[test]
fn restored_training_is_bit_identical() {
    let pipeline = busy();
    let (checkpoints, _) = on_one();
    let (data, partition) = data_of(&pipeline);
    for (at, bytes) in checkpoints.iter().enumerate() {
        let mut trainer = Trainer::restore(&pipeline.plan().unwrap(), &data, &partition, bytes).unwrap();
        assert_eq!(trainer.done(), at as u64);
        assert!(trainer.checkpoint() == *bytes, "a checkpoint of step {at} survives reading");
        // Far enough to see the next edit, and the end once.
        let until = if at % 10 == 0 { STEPS } else { STEPS.min(at as u64 + 5) };
        while trainer.done() < until {
            trainer.step().unwrap();
        }
        assert!(trainer.checkpoint() == checkpoints[until as usize], "restored at step {at}, bits differ at {until}");
    }
}

#[test]
fn rejects_damaged_checkpoint() {
    let pipeline = busy();
    let (data, partition) = data_of(&pipeline);
    let good = pipeline.trainer(&data, &partition).unwrap().checkpoint();
    for bytes in [&good[..0], &good[..7], &good[..good.len() / 2], &good[..good.len() - 1], b"not a checkpoint at all"]
    {
        let refused = Trainer::restore(&pipeline.plan().unwrap(), &data, &partition, bytes).unwrap_err().to_string();
        assert!(refused.contains("unusable checkpoint"), "{refused}");
    }
}

#[test]
fn rejects_checkpoint_of_other_version() {
    let pipeline = busy();
    let (data, partition) = data_of(&pipeline);
    let mut file = Tensors::from_bytes(&pipeline.trainer(&data, &partition).unwrap().checkpoint()).unwrap();
    let (_, note) = file.note.split_once("\"note\":").unwrap();
    file.note = note.strip_suffix('}').unwrap().replace("\"version\":8", "\"version\":4");
    file.note = format!("{{\"digest\":\"{}\",\"note\":{}}}", file.digest(), file.note);
    let refused =
        Trainer::restore(&pipeline.plan().unwrap(), &data, &partition, &file.to_bytes()).unwrap_err().to_string();
    assert!(refused.contains("of version 4, expected 8; remove it"), "{refused}");
}

#[test]
fn different_seed_gives_different_result() {
    let mut other = busy();
    other.set("seed=6").unwrap();
    let (data, partition) = data_of(&other);
    let mut trainer = other.trainer(&data, &partition).unwrap();
    trainer.step().unwrap();
    assert!(trainer.checkpoint() != on_one().0[1]);
}
