//! Every pruning strategy: the exact number it is asked for, the same bytes after a stop, and what defines its score.

use crate::common::{built_in, cloud, pipeline, plugin, with_column};
use pwrfgs::core::{best, rng};
use pwrfgs::prelude::*;
use std::path::Path;

/// Settings that make a strategy remove Gaussians within a few steps, where its defaults do not.
fn settings(name: &str) -> &'static str {
    match name {
        "ControlGs" => "lambda: 0.03, epsilon: 0.05",
        "GaussianSpa" => "every: 2, share: 0.5",
        "GreedyElimination" => "most: 20, transmitters: 4",
        "LearnableMask" | "Lp3dgs" => "lambda: 0.05, learning_rate: 0.8",
        "MaskGaussian" => "lambda: 0.1, learning_rate: 0.4",
        "Mcmc" => "noise: 0.1, dead: 0.1",
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

/// Without a number to reach, unless the strategy does nothing without one.
fn small(pruner: &str) -> Pipeline {
    let budget = plugin::<dyn Pruner>(pruner).traits().budget;
    targeted(pruner, if budget == Some(Budget::UpperBound) { 9 } else { 0 })
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

/// Statistics as a pass would give them, one column for all, and what a score makes of them.
fn scores(pruner: &Plugin<dyn Pruner>, cloud: &GaussianCloud, column: &[Real]) -> Vec<Real> {
    let fisher = column.iter().map(|v| {
        let mut own = [0.0; 21];
        let mut place = 0;
        for i in 0..6 {
            own[place] = v + 0.1;
            place += 6 - i;
        }
        own
    });
    let requested = PassStatistics {
        links: 1,
        weight: column.to_vec(),
        largest_weight: column.to_vec(),
        weight_per_area: column.to_vec(),
        signal_mean: column.to_vec(),
        signal_max: column.to_vec(),
        error: column.to_vec(),
        high_error: column.iter().map(|v| 1.0 - v).collect(),
        top: column.iter().map(|v| *v > 0.5).collect(),
        sensitivity: column.to_vec(),
        fisher: fisher.collect(),
        elimination: column.to_vec(),
    };
    pruner.score(cloud, &CloudStats { requested, ..CloudStats::zeros(cloud.len()) }, &context())
}

fn context() -> StepContext {
    StepContext { round: 1, rounds: 3, ..StepContext::new(12, Phase::Prune, 3) }
}

#[test]
fn deterministic_pruners_ignore_order_of_gaussians() {
    let n = 23;
    let column: Vec<Real> = (0..n).map(|i| ((i * 7 + 3) % n) as Real / n as Real).collect();
    let mut order: Vec<usize> = (0..n).collect();
    rng::shuffle(&mut rng::stream(2, "order", 0), &mut order);
    let turned: Vec<Real> = order.iter().map(|&i| column[i]).collect();
    for (name, text) in all().into_iter().filter(|(name, _)| !["RandomReference", "MiniSplatting"].contains(name)) {
        let pruner: Plugin<dyn Pruner> = plugin(&text);
        let mut cloud = cloud(n, 3);
        for spec in pruner.traits().columns {
            cloud = with_column(cloud, spec.name, column.iter().map(|v| spec.init * (0.5 + v)).collect());
        }
        let straight = scores(&pruner, &cloud, &column);
        let shuffled = scores(&pruner, &cloud.select(&order), &turned);
        for (k, &i) in order.iter().enumerate() {
            assert!((shuffled[k] - straight[i]).abs() <= 1e-4 * straight[i].abs().max(1.0), "{name}, row {i}");
        }
    }
}

#[test]
fn unrelated_gaussians_are_removed_first() {
    let by_pictures = [
        "GreedyElimination",
        "LightGaussian",
        "MiniSplatting",
        "Pup3dgs",
        "RadSplat",
        "SafeguardGs",
        "SignalContribution",
        "SpeedySplat",
    ];
    for name in by_pictures {
        let pruner: Plugin<dyn Pruner> = plugin(&format!("{name}()"));
        let column = [0.4, 0.0, 0.7, 0.9, 0.0, 0.2];
        let kept = best(4, &scores(&pruner, &cloud(6, 1), &column), |_| true);
        assert_eq!(kept, [true, false, true, true, false, true], "{name}");
    }
}

#[test]
fn equal_scores_keep_order() {
    for (name, settings) in [("OpacityThreshold", ""), ("TopK", ""), ("SignalContribution", "shares: [0.5]")] {
        let pruner: Plugin<dyn Pruner> = plugin(&format!("{name}({settings})"));
        let same = cloud(1, 1).select(&[0, 0, 0, 0]);
        assert_eq!(best(2, &scores(&pruner, &same, &[0.3; 4]), |_| true), [true, true, false, false], "{name}");
    }
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
        (50, "pruners: [LightGaussian(shares: [0.5, 1.5])]", "a.ron:3:", "`shares` contains 1.5"),
        (50, "pruners: [RadSplat(threshold: 1.5)]", "a.ron:3:", "`threshold` is 1.5"),
        (50, "rasterizer: ArrayResponse(), pruners: [RadSplat()]", "a.ron:3:", "this method does not blend"),
    ] {
        let message = written(start, pruners).unwrap_err();
        assert!(message.starts_with(line) && message.contains(words), "{pruners}: {message}");
    }
    // What masks and the true loss say needs no blending.
    for pruner in ["LearnableMask()", "GreedyElimination()", "MaskGaussian()", "RandomReference()"] {
        written(50, &format!("rasterizer: ArrayResponse(), pruners: [{pruner}]")).unwrap();
    }
    let mut pipeline = small("LightGaussian()");
    pipeline.set("training.target_count=5").unwrap();
    assert_eq!(train(&pipeline).2[23], 5, "one word in the pipeline");
    let message =
        small("RadSplat(threshold: 0.1)").set_all(&["pruners=[]", "training.target_count=5"]).unwrap_err().to_string();
    assert!(message.contains("no pruner supports a target"), "{message}");
}
