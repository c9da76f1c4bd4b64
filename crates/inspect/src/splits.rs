//! The splits of the toolkit on these data: how far test transmitters stand from training ones, and what predictors
//! without a model reach there.

use pwrfgs_core::plugin::to_ron;
use pwrfgs_core::{Dataset, Goal, Metric, Partition, Plugin, Result, Split, Values, evenly, registered, rng};
use pwrfgs_experiment::repeatability::Lapse;
use pwrfgs_experiment::samples::nearest_train;
use pwrfgs_experiment::scores::{Summary, quantile};
use pwrfgs_experiment::{Bench, Observer, Session, lapse_of};
use pwrfgs_pipeline::Pipeline;

/// Most test samples that floors are scored on.
const TESTED: usize = 300;

/// One split.
#[derive(Clone, Debug)]
pub struct Divided {
    /// As a pipeline has it, such as `Random()`.
    pub name: String,
    /// Whether it is the pipeline's own.
    pub own: bool,
    /// What it gives, or why it cannot.
    pub outcome: Result<Outcome, String>,
}

/// What a split gives.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Training, validation and test samples.
    pub samples: [usize; 3],
    /// Metres from each test sample to the nearest training sample, ascending.
    pub distances: Vec<f64>,
    /// Predictors without a model.
    pub floors: Vec<Floor>,
    /// Test samples they were scored on.
    pub tested: usize,
    /// The pairs whose ceiling is theirs.
    pub lapse: Lapse,
}

/// What one predictor reaches.
#[derive(Clone, Debug)]
pub struct Floor {
    /// As tables name it.
    pub name: String,
    /// Whether it knows the scene that made the data: then it is a bound.
    pub knows_scene: bool,
    /// By metric: its key, whether larger is better, and the numbers.
    pub scores: Vec<(String, bool, Summary)>,
}

/// All splits that are registered with their defaults, and before them the pipeline's own where it is another.
///
/// # Errors
/// Where a baseline or a metric refuses, or a picture cannot be read.
pub(crate) fn splits(
    pipeline: &Pipeline,
    metrics: &[Plugin<dyn Metric>],
    data: &Dataset,
    observer: &mut dyn Observer,
) -> Result<Vec<Divided>> {
    let standard = registered::<dyn Split>().into_iter().filter_map(|name| {
        let name = format!("{name}()");
        let split = Plugin::<dyn Split>::parse(&name).ok()?;
        split.ready().is_ok().then_some((split, name))
    });
    let standard: Vec<(Plugin<dyn Split>, String)> = standard.collect();
    let own = to_ron(&pipeline.split);
    let mut all: Vec<(Plugin<dyn Split>, String, bool)> = Vec::new();
    if !standard.iter().any(|(split, _)| to_ron(split) == own) {
        let name = own.split_whitespace().collect::<Vec<_>>().join(" ").replace("( ", "(").replace(", )", ")");
        all.push((pipeline.split.clone(), name, true));
    }
    all.extend(standard.into_iter().map(|(split, name)| {
        let same = to_ron(&split) == own;
        (split, name, same)
    }));
    let mut divided = Vec::new();
    let seed = pipeline.split_seed.unwrap_or(pipeline.seed);
    for (split, name, own) in all {
        let outcome = match split.split(data, &mut rng::stream(seed, "split", 0)) {
            Ok(partition) => Ok(outcome(pipeline, metrics, data, &partition, observer)?),
            Err(refused) => Err(refused.to_string()),
        };
        divided.push(Divided { name, own, outcome });
    }
    Ok(divided)
}

fn outcome(
    pipeline: &Pipeline,
    metrics: &[Plugin<dyn Metric>],
    data: &Dataset,
    partition: &Partition,
    observer: &mut dyn Observer,
) -> Result<Outcome> {
    let nearest = nearest_train(data, partition);
    let mut distances: Vec<f64> = partition.test.iter().map(|&i| nearest[i] as f64).collect();
    distances.sort_by(f64::total_cmp);
    let tested = evenly(&partition.test, TESTED);
    Ok(Outcome {
        samples: [&partition.train, &partition.validation, &partition.test].map(Vec::len),
        distances,
        floors: floors(pipeline, metrics, data, partition, &tested, observer)?,
        tested: tested.len(),
        lapse: lapse_of(data, partition),
    })
}

/// The pipeline's baselines by `metrics`, which look at one sample each.
fn floors(
    pipeline: &Pipeline,
    metrics: &[Plugin<dyn Metric>],
    data: &Dataset,
    partition: &Partition,
    tested: &[usize],
    observer: &mut dyn Observer,
) -> Result<Vec<Floor>> {
    let plane = data.plane();
    let bench = Bench::new(data, tested, &plane);
    let mut floors = Vec::new();
    for baseline in &pipeline.baselines {
        let fitted = baseline.fit(data, partition.known())?;
        let name = baseline.name_for(data.task()); // the same for all splits, whatever it chooses in each
        let mut scores = Vec::new();
        for m in bench.baseline(&name, &*fitted, metrics, &mut Session::new(observer))? {
            if let Values::PerSample(values) = m.values {
                let higher = m.goal == Goal::Higher;
                scores.push((m.key, higher, Summary::of(&values, higher)));
            }
        }
        floors.push(Floor { name, knows_scene: fitted.knows_scene(), scores });
    }
    Ok(floors)
}

impl Outcome {
    /// The `q` quantile of the distance to the nearest training transmitter, metres.
    pub fn distance(&self, q: f64) -> f64 {
        quantile(&self.distances, q)
    }
}
