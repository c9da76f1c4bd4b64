//! The splits on a data set: distance from test to training transmitters, and what baselines reach there.

use crate::observer::Observer;
use crate::samples::nearest_train;
use crate::scores::{Summary, quantile};
use crate::text::{aligned, number};
use crate::{Bench, CEILING, Session, ceiling};
use pwrfgs_core::plugin::to_ron;
use pwrfgs_core::{Dataset, Metric, Partition, Plugin, Result, Scope, Split, Values, evenly, registered, rng};
use pwrfgs_pipeline::Pipeline;
use std::fmt::Write as _;
use std::sync::atomic::AtomicBool;

/// Most test samples that baselines are scored on.
const TESTED: usize = 300;

/// Median distance from a test transmitter to the nearest training transmitter, metres.
pub fn test_distance(data: &Dataset, partition: &Partition) -> f64 {
    let nearest = nearest_train(data, partition);
    let mut distances: Vec<f64> = partition.test.iter().map(|&i| nearest[i] as f64).collect();
    distances.sort_by(f64::total_cmp);
    quantile(&distances, 0.5)
}

/// A length in the unit that suits it.
pub fn length(metres: f64) -> String {
    match metres {
        m if !m.is_finite() => "n/a".into(),
        m if m < 0.1 => format!("{:.1} mm", m * 1e3),
        m if m < 1.0 => format!("{:.0} cm", m * 1e2),
        m => format!("{m:.2} m"),
    }
}

/// The split of `pipeline`, marked, and all other registered splits with their defaults.
fn splits(pipeline: &Pipeline) -> Vec<(Plugin<dyn Split>, String)> {
    let own = to_ron(&pipeline.split);
    let name = own.split_whitespace().collect::<Vec<_>>().join(" ").replace("( ", "(").replace(", )", ")");
    let others = registered::<dyn Split>().into_iter().filter_map(|name| {
        let split = Plugin::<dyn Split>::parse(&format!("{name}()")).ok()?;
        (split.ready().is_ok() && to_ron(&split) != own).then(|| (split, format!("{name}()")))
    });
    [(pipeline.split.clone(), name + " *")].into_iter().chain(others).collect()
}

/// One line per split: sizes, distance and the mean of the first metric of every baseline, then the noise ceiling.
///
/// # Errors
/// If a baseline or a metric refuses, or a spectrum cannot be read.
pub(super) fn table(pipeline: &Pipeline, data: &Dataset, observer: &mut dyn Observer) -> Result<String> {
    let of_predictions = |m: &&Plugin<dyn Metric>| m.scope() != Scope::Model;
    let metrics: Vec<Plugin<dyn Metric>> = pipeline.metrics.iter().filter(of_predictions).take(1).cloned().collect();
    let names: Vec<String> = pipeline.baselines.iter().map(|baseline| baseline.name_for(data.task())).collect();
    let head = ["split", "train", "test", "nearest training"].map(str::to_owned).into_iter();
    let mut lines: Vec<Vec<String>> = vec![head.chain(names.clone()).chain([CEILING.to_owned()]).collect()];
    let (mut refused, mut key, plane) = (String::new(), String::new(), data.plane());
    for (split, name) in splits(pipeline) {
        let seed = pipeline.split_seed.unwrap_or(pipeline.seed);
        let partition = match split.split(data, &mut rng::stream(seed, "split", 0)) {
            Ok(partition) => partition,
            Err(why) => {
                _ = writeln!(refused, "{name}: {why}");
                continue;
            }
        };
        let mut line = vec![name, partition.train.len().to_string(), partition.test.len().to_string()];
        line.push(length(test_distance(data, &partition)));
        let bench = Bench::new(data, &evenly(&partition.test, TESTED), &plane);
        for (baseline, name) in pipeline.baselines.iter().zip(&names) {
            let fitted = baseline.fit(data, partition.known())?;
            let found = bench.baseline(name, &*fitted, &metrics, &mut Session::new(observer))?;
            found.first().into_iter().for_each(|measurement| key.clone_from(&measurement.key));
            line.push(match found.first().map(|measurement| &measurement.values) {
                Some(Values::PerSample(values)) => number(Summary::of(values, true).mean),
                _ => "n/a".into(),
            });
        }
        let limit = ceiling(data, &partition, &metrics, &AtomicBool::new(false))?;
        line.push(limit.of.first().map_or_else(|| "n/a".into(), |(_, at_zero)| number(at_zero.summary.mean)));
        lines.push(line);
    }
    Ok(format!(
        "{}{refused}note: mean {key} of baselines on up to {TESTED} test {}; nearest training: median distance from a test \
         transmitter; *: the split of the pipeline, or the default for a folder of data\n",
        aligned(&lines, 1),
        data.task().counted[1]
    ))
}
