//! `Inspection`: properties of data, and the scores of baselines by split.

use super::floor::describe_floor;
use super::{DataSummary, PoseCheck, test_distance};
use crate::evaluation_set::{EvaluationSet, Predictor, ScoredPredictor};
use crate::load::describe_observations;
use crate::repeatability::CeilingEstimator;
use crate::scores::CEILING;
use crate::session::{NoopObserver, Session, run_stage};
use crate::statistics::Summary;
use crate::text::{align_columns, format_length, number, wrap_words};
use pwrfgs_core::plugin::ron_line;
use pwrfgs_core::{Baseline, Dataset, Metric, Plugin, Result, Scope, Split, Values, evenly, registered, rng};
use pwrfgs_pipeline::Pipeline;
use std::sync::atomic::AtomicBool;

/// Largest number of spectra that are read.
const INSPECTED: usize = 20_000;
/// Width of text lines, and of the names in front.
const WIDTH: usize = 100;
const INDENT: usize = 15;
/// Largest number of test samples for the scores of baselines.
const TESTED: usize = 300;

/// Properties of data, and the scores of baselines by split.
#[derive(Clone, Debug)]
pub struct Inspection {
    /// Title of the data, which says whether they are simulated.
    pub title: String,
    /// Names of the properties, and their texts.
    pub facts: Vec<(&'static str, String)>,
    /// Check of the recorded pose; `None` without spectra, or with too few.
    pub pose: Option<PoseCheck>,
    /// Names of the baselines.
    pub baselines: Vec<String>,
    /// Metric of the scores, such as `ssim`.
    pub metric: String,
    /// Names of observations, such as `spectra`.
    pub plural: &'static str,
    /// Splits; the first is that of the pipeline, unless the data do not support it.
    pub splits: Vec<SplitScores>,
    /// Splits that the data do not support, and the reasons.
    pub refused: Vec<(String, String)>,
}

/// Sizes of a split, and scores of the baselines on its test set.
#[derive(Clone, Debug)]
pub struct SplitScores {
    /// Split as RON; that of the pipeline ends in ` *`.
    pub name: String,
    /// Number of training samples.
    pub train: usize,
    /// Number of test samples.
    pub test: usize,
    /// Median distance of test transmitters to the nearest training transmitter, metres; NaN if positions are unknown.
    pub nearest_m: f64,
    /// Mean score of each baseline; NaN if the metric does not apply.
    pub means: Vec<f64>,
    /// Noise ceiling; NaN if it cannot be estimated.
    pub ceiling: f64,
}

/// What the scores of all splits share.
struct SplitScorer<'a> {
    pipeline: &'a Pipeline,
    data: &'a Dataset,
    metrics: &'a [Plugin<dyn Metric>],
    stop: &'a AtomicBool,
    ceilings: CeilingEstimator<'a>,
}

impl Inspection {
    /// Inspects `data` with split, baselines, first metric of predictions, and seed of `pipeline`.
    ///
    /// # Errors
    /// If a baseline or the metric does not support the data, or a spectrum cannot be read;
    /// [`Error::Stopped`](pwrfgs_core::Error::Stopped) once the session is stopped.
    pub fn of(pipeline: &Pipeline, data: &Dataset, session: &mut Session<'_>) -> Result<Self> {
        let summary = DataSummary::of(data, INSPECTED, session.observer)?;
        let ids = [data.locations.first(), data.locations.last()].map(|t| t.map_or(0, |t| t.id));
        let floor = describe_floor(data)?;
        let samples = ("samples", format!("{}, ids {} to {}", describe_observations(data), ids[0], ids[1]));
        let of_predictions = |m: &&Plugin<dyn Metric>| m.scope() != Scope::Model;
        let metrics: Vec<_> = pipeline.metrics.iter().filter(of_predictions).take(1).cloned().collect();
        let mut inspection = Self {
            title: data.marked_title(),
            facts: [samples].into_iter().chain(summary.facts).chain(floor).collect(),
            pose: summary.pose,
            baselines: fitted_baselines(pipeline).map(|baseline| baseline.name_for(data.task())).collect(),
            metric: String::new(),
            plural: data.task().counted[1],
            splits: Vec::new(),
            refused: Vec::new(),
        };
        let splits = list_splits(pipeline);
        // A unit of progress per baseline, and one for the noise ceiling.
        let (stop, units) = (session.stop, inspection.baselines.len() + 1);
        let ceilings = CeilingEstimator::new(data, &metrics, stop);
        let mut scorer = SplitScorer { pipeline, data, metrics: &metrics, stop, ceilings };
        run_stage(session.observer, "scoring baselines by split", |progress| {
            for (k, (split, name)) in splits.iter().enumerate() {
                let scored = |baselines| progress(k * units + baselines, splits.len() * units);
                inspection.add_split(&mut scorer, (split, name.clone()), &scored)?;
                scored(units);
            }
            Ok(inspection)
        })
    }

    /// Adds the sizes of a split and its scores, or the reason why the data do not support it. Calls `scored` with the number of
    /// scored baselines after each.
    fn add_split(
        &mut self,
        scorer: &mut SplitScorer<'_>,
        (split, name): (&Plugin<dyn Split>, String),
        scored: &dyn Fn(usize),
    ) -> Result<()> {
        let &mut SplitScorer { pipeline, data, metrics, stop, .. } = scorer;
        let mut session = Session { observer: &mut NoopObserver, stop, page: None, keep_checkpoint: false };
        let seed = pipeline.split_seed.unwrap_or(pipeline.seed);
        let partition = match split.split(data, &mut rng::stream(seed, "split", 0)) {
            Ok(partition) => partition,
            Err(why) => {
                self.refused.push((name, why.to_string()));
                return Ok(());
            }
        };
        let plane = data.plane();
        let test = EvaluationSet::new(data, &evenly(&partition.test, TESTED), &plane);
        let mut means = Vec::new();
        for (baseline, name) in fitted_baselines(pipeline).zip(&self.baselines) {
            let fitted = baseline.fit(data, partition.known().stopped_by(stop))?;
            let measurements =
                test.score(ScoredPredictor { name, predictor: Predictor::Baseline(&*fitted), metrics }, &mut session)?;
            measurements.first().into_iter().for_each(|measurement| self.metric.clone_from(&measurement.key));
            means.push(match measurements.first().map(|measurement| &measurement.values) {
                Some(Values::PerSample(values)) => Summary::of(values, true).mean,
                _ => f64::NAN,
            });
            scored(means.len());
        }
        let ceiling = scorer.ceilings.estimate(&partition)?;
        self.splits.push(SplitScores {
            name,
            train: partition.train.len(),
            test: partition.test.len(),
            nearest_m: test_distance(data, &partition),
            means,
            ceiling: ceiling.metrics.first().map_or(f64::NAN, |(_, at_zero)| at_zero.summary.mean),
        });
        Ok(())
    }

    /// Formats the properties as lines, then a table with one line per split, and the refused splits.
    pub fn to_text(&self) -> String {
        let mut text = format!("{}\n\n", self.title);
        self.facts.iter().for_each(|(name, words)| text += &format_entry(name, words));
        if let Some(pose) = &self.pose {
            text += &format_entry("pose", pose.verdict.title());
            pose.sentences().iter().for_each(|sentence| text += &format_entry("", sentence));
        }
        let head = ["split", "train", "test", "nearest training"].map(str::to_owned).into_iter();
        let mut lines: Vec<Vec<String>> =
            vec![head.chain(self.baselines.clone()).chain([CEILING.to_owned()]).collect()];
        lines.extend(self.splits.iter().map(|split| {
            let sizes = [split.name.clone(), split.train.to_string(), split.test.to_string()].into_iter();
            let scores = split.means.iter().chain([&split.ceiling]).map(|score| number(*score));
            sizes.chain([format_length(split.nearest_m)]).chain(scores).collect()
        }));
        let refused: String = self.refused.iter().flat_map(|(name, why)| [name, ": ", why, "\n"]).collect();
        format!(
            "{text}\n{}{refused}note: mean {} of baselines on up to {TESTED} test {}; nearest training: median distance from a \
             test transmitter; *: the split of the pipeline, or of `pwrfgs init` for a folder of data\n",
            align_columns(&lines, 1),
            self.metric,
            self.plural
        )
    }
}

/// Lists the baselines of `pipeline` except for those of other programs.
fn fitted_baselines(pipeline: &Pipeline) -> impl Iterator<Item = &Plugin<dyn Baseline>> {
    pipeline.baselines.iter().filter(|baseline| !baseline.is_external())
}

/// Wraps `words` into lines; `name` starts the first, and the others are indented.
fn format_entry(name: &str, words: &str) -> String {
    wrap_words(words, [&format!("{name:<INDENT$}"), &" ".repeat(INDENT)], WIDTH)
}

/// Lists the split of `pipeline`, marked `*`, and all other registered splits that need no settings, with their names.
fn list_splits(pipeline: &Pipeline) -> Vec<(Plugin<dyn Split>, String)> {
    let name = ron_line(&pipeline.split);
    // A fold has the test set of another split.
    let others = registered::<dyn Split>().into_iter().filter(|name| *name != "Fold").filter_map(|name| {
        let split = Plugin::<dyn Split>::parse(&format!("{name}()")).ok()?;
        (split.check_ready().is_ok() && ron_line(&split) != name).then(|| (split, format!("{name}()")))
    });
    [(pipeline.split.clone(), format!("{name} *"))].into_iter().chain(others).collect()
}
