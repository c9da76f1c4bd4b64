//! `Comparison`: rows of a setting (variants, then baselines) with all their numbers, as in `report.csv`.

use pwrfgs_core::UNSTEADY;
use pwrfgs_experiment::scores::{MODEL, MetricRow};
use pwrfgs_experiment::statistics::{Blocks, Difference, Spread};
use pwrfgs_experiment::{CEILING, Record, Setting, StudyVariant, distinct};
use serde::Serialize;
use std::collections::BTreeMap;

/// Key of the training time in seconds, which is not a metric.
pub(super) const TRAINING: &str = "training_s";

/// Key of the number of training samples, which is not a metric.
pub(super) const TRAINED_ON: &str = "trained_on";

/// Key of the share b of the model in its predictions, which is not a metric.
pub(super) const SHARE: &str = "share";

/// Type of a row, in the order of the rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(super) enum RowKind {
    /// Trained models.
    Variant,
    /// Predictions of another program.
    External,
    /// Baseline.
    Baseline,
    /// Oracle baseline, which uses the scene of simulated data: not ranked.
    Oracle,
    /// Noise ceiling: not ranked, and without per-sample values.
    Ceiling,
}

impl RowKind {
    /// Returns the name of the type in CSV files.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Variant => "variant",
            Self::External => "external",
            Self::Baseline => "baseline",
            Self::Oracle => "oracle",
            Self::Ceiling => "ceiling",
        }
    }
}

/// One predictor over the seeds.
#[derive(Clone, Debug)]
pub(super) struct ComparisonRow<'a> {
    pub(super) label: &'a str,
    /// Axes with the values of a variant.
    pub(super) axes: &'a [(String, String)],
    pub(super) kind: RowKind,
    /// First variant with bit-identical models.
    pub(super) twin: Option<&'a str>,
    /// Name in `scores.csv`.
    predictor: &'a str,
    /// Runs, one per seed.
    pub(super) runs: Vec<&'a Record>,
}

/// Statistic over the samples of one run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SummaryStatistic {
    /// Mean over test samples.
    Mean,
    /// Median over test samples.
    Median,
    /// Percentile at the worse end: the 10th if larger is better, else the 90th.
    Tail10,
    /// Value of the whole model.
    Whole,
}

impl SummaryStatistic {
    /// Returns the name of the statistic in CSV files.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Mean => "mean",
            Self::Median => "median",
            Self::Tail10 => "tail10",
            Self::Whole => "value",
        }
    }

    /// Returns the index of the statistic in [`numbers`](pwrfgs_experiment::scores::ScoreCell::numbers).
    fn index(self) -> usize {
        match self {
            Self::Mean | Self::Whole => 0,
            Self::Median => 1,
            Self::Tail10 => 2,
        }
    }

    /// Returns the heading of a column with this statistic.
    pub(super) fn heading(self, higher_is_better: bool) -> &'static str {
        match self {
            Self::Tail10 if higher_is_better => "10th percentile",
            Self::Tail10 => "90th percentile",
            _ => self.name(),
        }
    }
}

/// Returns the statistics that tables show of a metric.
pub(super) fn statistics(metric: &MetricRow) -> &'static [SummaryStatistic] {
    if metric.is_per_sample() {
        &[SummaryStatistic::Mean, SummaryStatistic::Median, SummaryStatistic::Tail10]
    } else {
        &[SummaryStatistic::Whole]
    }
}

/// Returns whether a metric is a time, which depends on the machine.
pub(super) fn is_time(metric: &MetricRow) -> bool {
    metric.key.starts_with("latency") || metric.key == TRAINING
}

impl ComparisonRow<'_> {
    /// Returns the values of the runs that have one, without NaN; training time and share only of variants, and training sets
    /// only of predictors trained here.
    pub(super) fn values(&self, metric: &MetricRow, statistic: SummaryStatistic) -> Vec<f64> {
        let value = |run: &&Record| match statistic {
            SummaryStatistic::Whole if metric.key == TRAINING => {
                (self.kind == RowKind::Variant).then_some(run.facts.training_seconds)
            }
            SummaryStatistic::Whole if metric.key == SHARE => {
                run.scores.table.share.filter(|_| self.kind == RowKind::Variant)
            }
            SummaryStatistic::Whole if metric.key == TRAINED_ON => {
                let [train, validation, _] = run.facts.samples;
                match self.kind {
                    RowKind::Variant => Some(train as f64),
                    RowKind::Baseline => Some((train + validation) as f64),
                    RowKind::External | RowKind::Oracle | RowKind::Ceiling => None,
                }
            }
            _ => run.scores.table.numbers(self.predictor, &metric.key)?.get(statistic.index()).copied(),
        };
        self.runs.iter().filter_map(value).filter(|v| !v.is_nan()).collect()
    }

    /// Returns the mean and deviation over seeds; `None` if no run has a value. A baseline on a split that is equal for all
    /// seeds has no deviation.
    pub(super) fn spread(&self, metric: &MetricRow, statistic: SummaryStatistic) -> Option<Spread> {
        let spread = Spread::of(&self.values(metric, statistic))?;
        let same = self.kind != RowKind::Variant && spread.deviation == Some(0.0);
        Some(if same { Spread { deviation: None, ..spread } } else { spread })
    }

    /// Returns the scores of the run with a seed by sample; `None` without such a run or per-sample scores.
    fn scores_by_id(&self, seed: u64, metric: &MetricRow) -> Option<BTreeMap<u32, f64>> {
        self.runs.iter().find(|run| run.facts.seed == seed)?.scores.values_by_id(self.predictor, &metric.key)
    }

    /// Returns the difference of this row from `reference`, paired by seed and test sample; pairs without finite
    /// difference are omitted. `None` without pairs.
    pub(super) fn difference_from(&self, reference: &Self, metric: &MetricRow, blocks: &Blocks) -> Option<Difference> {
        let seed_differences = |run: &&Record| {
            let scores = self.scores_by_id(run.facts.seed, metric)?;
            let others = reference.scores_by_id(run.facts.seed, metric)?;
            Some(blocks.block_sums(scores.iter().filter_map(|(id, value)| Some((*id, value - others.get(id)?)))))
        };
        Difference::of(&self.runs.iter().filter_map(seed_differences).collect::<Vec<_>>())
    }
}

/// Rows of a setting.
#[derive(Clone, Debug)]
pub(super) struct Comparison<'a> {
    pub(super) setting: &'a Setting,
    pub(super) rows: Vec<ComparisonRow<'a>>,
    /// Metrics in the order of the runs, then training set, training time and, with residuals, share.
    pub(super) metrics: Vec<MetricRow>,
    pub(super) blocks: Blocks,
}

impl<'a> Comparison<'a> {
    /// Collects the rows and metrics of a setting.
    pub(super) fn new(setting: &'a Setting) -> Self {
        let variant = |(k, v): (usize, &'a StudyVariant)| {
            let twin = setting.earlier_twin(k).map(|first| first.label.as_str());
            ComparisonRow {
                label: &v.label,
                axes: &v.axes,
                kind: RowKind::Variant,
                twin,
                predictor: MODEL,
                runs: v.runs.iter().collect(),
            }
        };
        let mut rows: Vec<ComparisonRow<'a>> = setting.variants.iter().enumerate().map(variant).collect();
        rows.extend(baseline_rows(setting));
        rows.extend(ceiling_row(setting));
        let positions =
            setting.runs().flat_map(|run| run.test.positions.iter().map(|(id, position)| (*id, *position))).collect();
        Self { setting, rows, metrics: all_metrics(setting), blocks: Blocks::new(&positions) }
    }

    /// Returns whether all runs were made on the same machine, so that their times can be compared.
    pub(super) fn has_one_machine(&self) -> bool {
        let mut machines = self.setting.runs().map(|run| &run.facts.machine);
        machines.next().is_none_or(|first| machines.all(|machine| machine == first))
    }

    /// Returns whether the best value of a metric is marked: not for shares, sizes of training sets, and times of several
    /// machines or of a machine with other load.
    pub(super) fn is_ranked(&self, metric: &MetricRow) -> bool {
        let has_fair_times = || self.has_one_machine() && !has_unsteady_times(self.setting);
        ![TRAINED_ON, SHARE].contains(&metric.key.as_str()) && (!is_time(metric) || has_fair_times())
    }

    /// Returns the metric with a key; `None` without one.
    pub(super) fn metric(&self, key: &str) -> Option<&MetricRow> {
        self.metrics.iter().find(|m| m.key == key)
    }

    /// Returns metric and statistic of a column by its name: a key, or a key with `.median` or `.tail10`; `None` if there is
    /// no such number.
    pub(super) fn column(&self, name: &str) -> Option<(&MetricRow, SummaryStatistic)> {
        let named =
            |statistic: &SummaryStatistic| Some((name.strip_suffix(statistic.name())?.strip_suffix('.')?, *statistic));
        let (key, wanted) = match [SummaryStatistic::Median, SummaryStatistic::Tail10].iter().find_map(named) {
            Some((key, statistic)) => (key, Some(statistic)),
            None => (name, None),
        };
        let metric = self.metric(key)?;
        let available = statistics(metric);
        let statistic = wanted.unwrap_or(available[0]);
        available.contains(&statistic).then_some((metric, statistic))
    }

    /// Returns warnings about scores that are NaN, which means omit.
    pub(super) fn missing_score_warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        for (row, metric) in self.rows.iter().flat_map(|row| self.metrics.iter().map(move |metric| (row, metric))) {
            let without = |run: &&&Record| run.scores.value(row.predictor, &metric.key).is_some_and(f64::is_nan);
            let count = row.runs.iter().filter(without).count();
            if count > 0 {
                let (key, label, runs) = (&metric.key, row.label, row.runs.len());
                warnings
                    .push(format!("{key} of {label} is not finite in {count} of {runs} runs; means omit these runs."));
            }
        }
        warnings
    }

    /// Returns warnings about baselines that differ between runs of a seed: a row can show only one of them.
    pub(super) fn ambiguous_baseline_warnings(&self) -> Vec<String> {
        let key = self.setting.headline().key;
        let mut warnings = Vec::new();
        for row in self.rows.iter().filter(|row| [RowKind::Baseline, RowKind::Oracle].contains(&row.kind)) {
            let differs = |run: &&Record| {
                let shown = row.runs.iter().find(|shown| shown.facts.seed == run.facts.seed)?;
                let [a, b] = [run, shown].map(|run| run.scores.value(row.predictor, key));
                // Smaller differences are rounding errors.
                ((a? - b?).abs() > 1e-6).then_some((run.facts.seed, shown.folder.display()))
            };
            if let Some((seed, folder)) = self.setting.runs().find_map(|run| differs(&run)) {
                warnings.push(format!(
                    "{} differs between the runs of seed {seed} (settings or validation set); the tables show the value of \
                     {folder}.",
                    row.label
                ));
            }
        }
        warnings
    }

    /// Warns of times that the runs measured on a machine with other load; `None` without such times.
    pub(super) fn unsteady_times_warning(&self) -> Option<String> {
        let (count, total) = unsteady_runs(self.setting);
        let result = if has_unsteady_times(self.setting) { ", and times are neither ranked nor drawn" } else { "" };
        (count > 0).then(|| {
            format!(
                "Times are unreliable: the machine had other load in {count} of {total} runs{result}. `pwrfgs evaluate RUN` on \
                 an idle machine prints those of predictions anew."
            )
        })
    }

    /// Returns the groups of variants with bit-identical models, by label.
    pub(super) fn twin_groups(&self) -> Vec<String> {
        let group = |first: &ComparisonRow<'a>| {
            let others = self.rows.iter().filter(|row| row.twin == Some(first.label)).map(|row| row.label);
            [first.label].into_iter().chain(others).collect::<Vec<_>>()
        };
        self.rows.iter().map(group).filter(|group| group.len() > 1).map(|group| group.join(" ≡ ")).collect()
    }

    /// Returns the notes of all predictors of the setting, each once, without those of [`Self::unsteady_times_warning`]; notes on
    /// the model of a run name its variant.
    pub(super) fn notes(&self) -> Vec<String> {
        let named = |(label, note): (&'a str, &String)| match note.split_once(" at the coverage of model)") {
            // A baseline has one width per model.
            Some((head, tail)) => format!("{}{tail}", head.rsplit_once(" (").map_or(head, |(head, _)| head)),
            None if note.starts_with("validation ") => format!("{label}: {note}"),
            None => note.replace(" of model", &format!(" of {label}")),
        };
        let notes = self.setting.variants.iter().flat_map(|variant| {
            let of_seeds = variant
                .runs
                .iter()
                .enumerate()
                .flat_map(|(k, run)| run.scores.table.notes.iter().map(move |note| (k, note)))
                .filter(|(_, note)| !is_unsteady_note(note));
            // Intervals of further seeds are similar.
            let first = of_seeds.filter(|(k, note)| *k == 0 || !note.starts_with("90 % intervals"));
            first.map(|(_, note)| (variant.label.as_str(), note))
        });
        distinct(notes.map(named))
    }
}

/// Returns whether a note says that times are not steady: metric and predictor, a colon and [`UNSTEADY`].
fn is_unsteady_note(note: &str) -> bool {
    note.contains(&format!(": {UNSTEADY}"))
}

/// Share of runs with unsteady times from which on the steady times of the others can mislead too.
const BUSY: f64 = 0.25;

/// Returns the number of runs with any time that is not steady, and that of all runs.
fn unsteady_runs(setting: &Setting) -> (usize, usize) {
    let is_unsteady = |run: &&Record| run.scores.table.notes.iter().any(|note| is_unsteady_note(note));
    (setting.runs().filter(is_unsteady).count(), setting.runs().count())
}

/// Returns whether times are not steady in at least [`BUSY`] of the runs.
pub(super) fn has_unsteady_times(setting: &Setting) -> bool {
    let (count, total) = unsteady_runs(setting);
    count > 0 && count as f64 >= BUSY * total as f64
}

/// Returns a row per baseline, sorted by type, with the first run of each seed.
fn baseline_rows(setting: &Setting) -> Vec<ComparisonRow<'_>> {
    let mut rows: Vec<ComparisonRow<'_>> = Vec::new();
    for run in setting.runs() {
        for name in run.scores.table.baselines() {
            match rows.iter_mut().find(|row| row.label == name) {
                Some(row) if row.runs.iter().any(|r| r.facts.seed == run.facts.seed) => {}
                Some(row) => row.runs.push(run),
                None => {
                    let oracle = run.scores.table.oracles.iter().any(|oracle| oracle == name);
                    let ranked = if oracle { RowKind::Oracle } else { RowKind::Baseline };
                    let kind = if setting.is_external(name) { RowKind::External } else { ranked };
                    rows.push(ComparisonRow {
                        label: name,
                        axes: &[],
                        kind,
                        twin: None,
                        predictor: name,
                        runs: vec![run],
                    });
                }
            }
        }
    }
    rows.sort_by_key(|row| row.kind as usize);
    rows
}

/// Returns the row of the noise ceiling; `None` if no run estimated it.
fn ceiling_row(setting: &Setting) -> Option<ComparisonRow<'_>> {
    let mut runs: Vec<&Record> = Vec::new();
    for run in setting.runs().filter(|run| run.scores.table.predictors.iter().any(|name| name == CEILING)) {
        if !runs.iter().any(|other| other.facts.seed == run.facts.seed) {
            runs.push(run);
        }
    }
    let row = ComparisonRow { label: CEILING, axes: &[], kind: RowKind::Ceiling, twin: None, predictor: CEILING, runs };
    (!row.runs.is_empty()).then_some(row)
}

/// Returns the metrics in the order of the runs, then training set, training time and, with residuals, share.
fn all_metrics(setting: &Setting) -> Vec<MetricRow> {
    let mut metrics: Vec<MetricRow> = Vec::new();
    for metric in setting.runs().flat_map(|run| &run.scores.table.metrics) {
        if !metrics.iter().any(|m| m.key == metric.key) {
            metrics.push(metric.clone());
        }
    }
    let has_share = setting.runs().any(|run| run.scores.table.share.is_some());
    let facts = [(TRAINED_ON, setting.task().counted[1], true), (TRAINING, "s", false), (SHARE, "", true)];
    for (key, unit, higher_is_better) in facts.into_iter().filter(|(key, ..)| *key != SHARE || has_share) {
        metrics.push(MetricRow { key: key.into(), unit: unit.into(), higher_is_better, cells: Vec::new() });
    }
    metrics
}
