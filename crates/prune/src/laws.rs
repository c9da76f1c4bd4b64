//! Laws that every pruner obeys, with its default settings; `tests/pruners.rs` of the root trains with each.

use crate::fixture::{cloud, context, with_column};
use pwrfgs_core::tape::{TracedCloud, values};
use pwrfgs_core::{
    CloudStats, Gate, GaussianCloud, PassStatistics, Phase, Plugin, Pruner, Real, StepContext, best, registered, rng,
};

/// Returns all pruners of this crate.
fn all() -> Vec<(&'static str, Plugin<dyn Pruner>)> {
    let names = registered::<dyn Pruner>();
    assert!(!names.is_empty());
    names.into_iter().map(|name| (name, plugin(&format!("{name}()")))).collect()
}

fn plugin(text: &str) -> Plugin<dyn Pruner> {
    Plugin::parse(text).unwrap()
}

/// Returns the cloud with the columns of a pruner: its initial values times those of `factor` per Gaussian.
fn with_columns(pruner: &dyn Pruner, mut cloud: GaussianCloud, factor: impl Fn(usize) -> Real) -> GaussianCloud {
    for column in pruner.traits().columns {
        assert_eq!(column.width, 1, "these laws create columns of width 1");
        let values: Vec<Real> = (0..cloud.len()).map(|i| column.init * factor(i)).collect();
        cloud = with_column(cloud, &column, &values);
    }
    cloud
}

/// Returns a cloud with random shapes.
fn random_cloud(n: usize, seed: u64) -> GaussianCloud {
    let random = &mut rng::stream(seed, "test cloud", 0);
    let mut cloud = cloud(&vec![0.0; n]);
    for (_, _, values) in cloud.columns_mut() {
        values.iter_mut().for_each(|value| *value += rng::normal(random));
    }
    cloud
}

#[test]
fn returns_mask_and_score_per_gaussian() {
    for (name, pruner) in all() {
        for n in [0, 1, 9] {
            let (cloud, stats) = (with_columns(&*pruner, random_cloud(n, 3), |_| 1.0), CloudStats::zeros(n));
            for context in [Phase::Densify, Phase::Prune].map(context) {
                let keep = pruner.keep(&cloud, &stats, &context);
                assert_eq!(keep.len(), n, "{name}");
                assert_eq!(keep, pruner.keep(&cloud, &stats, &context), "{name}");
                assert_eq!(pruner.score(&cloud, &stats, &context).len(), n, "{name}");
            }
        }
    }
}

/// These decide by the cloud alone; the others by a target, by statistics of training or by chance.
#[test]
fn initial_cloud_is_kept_by_masks_and_thresholds() {
    for name in ["LearnableMask", "OpacityThreshold", "TopK"] {
        let pruner = plugin(&format!("{name}()"));
        for n in [0, 1, 7] {
            let cloud = with_columns(&*pruner, cloud(&vec![0.0; n]), |_| 1.0);
            assert_eq!(pruner.keep(&cloud, &CloudStats::zeros(n), &context(Phase::Prune)), vec![true; n], "{name}");
        }
    }
}

/// A Gaussian that a gate of the whole Gaussian closes is removed, and no other.
#[test]
fn keeps_drawn_gaussians() {
    let n = 400;
    let mut gated = 0;
    for (name, pruner) in all() {
        // From the initial mask logit to −9 times it.
        let cloud = with_columns(&*pruner, random_cloud(n, 5), |i| 1.0 - i as Real / 40.0);
        let Some(gate) = pruner.gate(&TracedCloud::new(&cloud), &context(Phase::Prune)) else { continue };
        let is_whole = matches!(gate, Gate::Whole(_));
        let factors = values(&gate.factor());
        assert!(factors.len() == n && factors.iter().all(|factor| factor.is_finite()), "{name}");
        if is_whole {
            gated += 1;
            let drawn: Vec<bool> = factors.iter().map(|factor| *factor != 0.0).collect();
            assert!(drawn.contains(&true) && drawn.contains(&false), "{name}");
            assert_eq!(pruner.keep(&cloud, &CloudStats::zeros(n), &context(Phase::Prune)), drawn, "{name}");
        }
    }
    assert!(gated > 0);
}

#[test]
fn numbers_that_are_not_finite_do_not_panic() {
    let odd = cloud(&[Real::NAN, 0.0, Real::INFINITY, Real::NEG_INFINITY]);
    for (name, pruner) in all().into_iter().chain([("OpacityVolume", plugin("TopK(score: OpacityVolume)"))]) {
        let cloud = with_columns(&*pruner, odd.clone(), |i| odd.opacity_logits[i]);
        assert_eq!(pruner.keep(&cloud, &CloudStats::zeros(4), &context(Phase::Prune)).len(), 4, "{name}");
    }
}

/// Returns the scores for statistics that all equal `column`.
fn scores(pruner: &Plugin<dyn Pruner>, cloud: &GaussianCloud, column: &[Real]) -> Vec<Real> {
    let fisher = column.iter().map(|v| {
        let mut triangle = [0.0; 21];
        let mut index = 0;
        for i in 0..6 {
            triangle[index] = v + 0.1;
            index += 6 - i;
        }
        triangle
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
    pruner.score(cloud, &CloudStats { requested, ..CloudStats::zeros(cloud.len()) }, &first_round())
}

fn first_round() -> StepContext {
    StepContext { round: 1, rounds: 3, ..context(Phase::Prune) }
}

#[test]
fn deterministic_pruners_ignore_order_of_gaussians() {
    let n = 23;
    let column: Vec<Real> = (0..n).map(|i| ((i * 7 + 3) % n) as Real / n as Real).collect();
    let mut order: Vec<usize> = (0..n).collect();
    rng::shuffle(&mut rng::stream(2, "order", 0), &mut order);
    let turned: Vec<Real> = order.iter().map(|&i| column[i]).collect();
    for (name, pruner) in all().into_iter().filter(|(name, _)| !["RandomReference", "MiniSplatting"].contains(name)) {
        let cloud = with_columns(&*pruner, random_cloud(n, 3), |i| 0.5 + column[i]);
        let straight = scores(&pruner, &cloud, &column);
        let shuffled = scores(&pruner, &cloud.select(&order), &turned);
        for (k, &i) in order.iter().enumerate() {
            assert!((shuffled[k] - straight[i]).abs() <= 1e-4 * straight[i].abs().max(1.0), "{name}, row {i}");
        }
    }
}

#[test]
fn unrelated_gaussians_are_removed_first() {
    let by_statistics = [
        "GreedyElimination",
        "LightGaussian",
        "MiniSplatting",
        "Pup3dgs",
        "RadSplat",
        "SafeguardGs",
        "SignalContribution",
        "SpeedySplat",
    ];
    for name in by_statistics {
        let column = [0.4, 0.0, 0.7, 0.9, 0.0, 0.2];
        let kept = best(4, &scores(&plugin(&format!("{name}()")), &random_cloud(6, 1), &column), |_| true);
        assert_eq!(kept, [true, false, true, true, false, true], "{name}");
    }
}

#[test]
fn equal_scores_keep_order() {
    for name in ["OpacityThreshold", "TopK", "SignalContribution"] {
        let pruner = plugin(&format!("{name}()"));
        let same = random_cloud(1, 1).select(&[0, 0, 0, 0]);
        assert_eq!(best(2, &scores(&pruner, &same, &[0.3; 4]), |_| true), [true, true, false, false], "{name}");
    }
}
