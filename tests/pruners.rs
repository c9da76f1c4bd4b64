//! Trainings with every pruner: exact target, bit-identical resume. Laws of scores: `crates/prune/src/laws.rs`.

use crate::common::{built_in, pipeline, plugin};
use pwrfgs::core::rng;
use pwrfgs::prelude::*;
use std::path::Path;

/// Settings that make a strategy remove Gaussians within a few steps, where its defaults do not.
fn settings(name: &str) -> &'static str {
    match name {
        "ControlGs" => "lambda: 0.03, epsilon: 0.05",
        "GaussianSpa" => "every: 2",
        "GreedyElimination" => "most: 20, transmitters: 4",
        "LearnableMask" | "Lp3dgs" => "lambda: 0.05, learning_rate: 0.8",
        "MaskGaussian" => "lambda: 0.1, learning_rate: 0.4",
        "Mcmc" => "noise: 0.1",
        "MiniSplatting" => "rule: Above(0.2)",
        "NaturalSelection" => "pressure: 0.05, epsilon: 0.2",
        "OpacityThreshold" => "epsilon: 0.1",
        "RadSplat" => "threshold: 0.05",
        "TrimmingTheFat" => "opacity_quantile: 0.5, gradient_quantile: 0.9",
        _ => "",
    }
}

/// The name of every strategy, with its text.
fn all() -> Vec<(&'static str, String)> {
    built_in::<dyn Pruner>().into_iter().map(|name| (name, format!("{name}({})", settings(name)))).collect()
}

/// Without a number to reach, unless the strategy requires one.
fn small(pruner: &str) -> Pipeline {
    targeted(pruner, if plugin::<dyn Pruner>(pruner).traits().requires_target { 9 } else { 0 })
}

fn targeted(pruner: &str, target: usize) -> Pipeline {
    pipeline(&format!(
        "seed: 5, data: Teacher(gaussians: 6, samples: 20, width: 60, height: 15),
         initializer: Random(count: 40, std: 3),
         deformation: Factored(depth: 2, width: 8),
         pruners: [{pruner}],
         training: (steps: 24, batch: 3, target_count: {target}, densify_until: 3, prune_until: 20, prune_every: 4, densify: (every: 0),
             optimizer: (opacity_logits: Constant(0.1)))"
    ))
}

fn data_of(pipeline: &Pipeline) -> (Dataset, Partition) {
    let data = pipeline.data.load(Path::new("."), &|_, _| {}).unwrap();
    let partition = pipeline.split.split(&data, &mut rng::stream(5, "split", 0)).unwrap();
    (data, partition)
}

/// The checkpoint in the middle, the one at the end, and N after each step.
fn train(pipeline: &Pipeline) -> (Vec<u8>, Vec<u8>, Vec<usize>) {
    let (data, partition) = data_of(pipeline);
    let mut trainer = pipeline.trainer(&data, &partition).unwrap();
    let (mut middle, mut counts) = (Vec::new(), Vec::new());
    while !trainer.finished() {
        counts.push(trainer.step().unwrap().gaussians);
        if trainer.done() == 14 {
            middle = trainer.checkpoint();
        }
    }
    (middle, trainer.checkpoint(), counts)
}

#[test]
fn every_pruner_removes_some_and_resumes_bit_identically() {
    for (name, text) in all() {
        let pipeline = small(&text);
        let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (middle, end, counts) = pool(2).install(|| train(&pipeline));
        // 3DGS-MCMC moves Gaussians.
        assert!(counts[23] < 40 || name == "Mcmc", "{name} takes nothing: {counts:?}");
        assert!(counts[23] > 0);
        let (data, partition) = data_of(&pipeline);
        let mut trainer = Trainer::restore(&pipeline.plan().unwrap(), &data, &partition, &middle).unwrap();
        pool(1).install(|| {
            while !trainer.finished() {
                trainer.step().unwrap();
            }
        });
        assert!(trainer.checkpoint() == end, "{name}: bits differ after a stop");
    }
}

#[test]
fn pruners_reach_exact_target() {
    for (name, text) in all() {
        if plugin::<dyn Pruner>(&text).traits().budget == Some(Budget::UpperBound) {
            continue;
        }
        let (_, _, counts) = train(&targeted(&text, 7));
        assert_eq!(counts[23], 7, "{name}: {counts:?}");
        // Beside others too, which take more or less.
        let both = format!("{text}, OpacityThreshold(epsilon: 0.3)");
        let counts = train(&targeted(&both, 7)).2;
        assert_eq!(counts[23], 7, "{both}: {counts:?}");
    }
}

#[test]
fn weight_rules_agree_with_target() {
    let gaussian_ids = |rule: &str| {
        let pipeline = targeted(&format!("MiniSplatting(rule: {rule})"), 7);
        let (data, partition) = data_of(&pipeline);
        let mut trainer = pipeline.trainer(&data, &partition).unwrap();
        while !trainer.finished() {
            trainer.step().unwrap();
        }
        trainer.gaussian_ids().to_vec()
    };
    assert_eq!(gaussian_ids("Above(0.05)"), gaussian_ids("Cumulated(0.99)"));
    assert_ne!(gaussian_ids("Above(0.05)"), gaussian_ids("Sampled(0.5)"));
}

#[test]
fn prune_rounds_remove_equal_fractions() {
    let (_, _, counts) = train(&targeted("RandomReference()", 5));
    // Five prune steps from 40 to 5: 8^(1/5) each.
    assert_eq!([4, 8, 12, 16, 20].map(|step: usize| counts[step - 1]), [26, 17, 11, 7, 5]);
}

#[test]
fn reports_position_of_impossible_targets() {
    let written = |start: usize, rest: &str| {
        let target = rest.split_once(" to ").map_or("0", |(_, target)| target);
        let pruners = rest.split(" to ").next().unwrap_or_default();
        let text = format!(
            "Pipeline(name: \"a\", data: Teacher(),\n initializer: Random(count: {start}),\n {pruners},\n \
             training: (steps: 9, target_count: {target}, densify_until: 2, prune_until: 6, densify: (every: 0)))"
        );
        Pipeline::parse(&text, Path::new("a.ron")).map_err(|e| e.to_string())
    };
    assert!(written(50, "pruners: [SpeedySplat()] to 50").is_ok());
    assert!(written(50, "pruners: [TopK(), RadSplat()] to 8").is_ok());
    for (start, pruners, line, words) in [
        (50, "pruners: [SpeedySplat()] to 51", "a.ron:", "training.target_count is 51, but training starts with 50"),
        (50, "pruners: [RadSplat(), TopK()] to 8", "a.ron:", "list `TopK` first"),
        (50, "pruners: [TopK()]", "a.ron:", "set it, for example to 157"),
        (50, "pruners: [] to 8", "a.ron:", "no pruner supports a target"),
        (50, "pruners: [RadSplat(target: 9)]", "a.ron:3:", "target"),
        (50, "pruners: [LightGaussian()]", "a.ron:", "`LightGaussian` needs training.target_count, which is not set"),
        (
            50,
            "pruners: [LearnableMask(), MergeByMoments()] to 8",
            "a.ron:",
            "list `MergeByMoments` first, or remove it",
        ),
        (50, "pruners: [RadSplat(threshold: 1.5)]", "a.ron:3:", "`threshold` is 1.5"),
        (50, "rasterizer: ArrayResponse(), pruners: [RadSplat()]", "a.ron:3:", "this method does not blend"),
    ] {
        let message = written(start, pruners).unwrap_err();
        assert!(message.starts_with(line) && message.contains(words), "{pruners}: {message}");
    }
    // What masks and the true loss say needs no blending.
    for pruner in ["LearnableMask()", "GreedyElimination()", "MaskGaussian()", "RandomReference()"] {
        written(50, &format!("rasterizer: ArrayResponse(), pruners: [{pruner}] to 8")).unwrap();
    }
    let mut pipeline = small("LightGaussian()");
    pipeline.set("training.target_count=5").unwrap();
    assert_eq!(train(&pipeline).2[23], 5, "one word in the pipeline");
    let message =
        small("RadSplat(threshold: 0.1)").set_all(&["pruners=[]", "training.target_count=5"]).unwrap_err().to_string();
    assert!(message.contains("no pruner supports a target"), "{message}");
}
