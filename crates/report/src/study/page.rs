//! `StudyPage`: content of the report, independent of the format.

use super::comparison::{Comparison, RowKind};
use super::csv::report_csv;
use super::figures::shown::check_variants;
use super::figures::{self, Figure, FigureSet};
use super::reference::{Reference, RowDifferences};
use super::tables::{self, Table};
use crate::templates::render_sentences;
use minijinja::{Value, context};
use pwrfgs_core::{Error, Result, did_you_mean};
use pwrfgs_experiment::text::{format_duration, grouped};
use pwrfgs_experiment::{Observer, Record, Setting, Study, distinct, run_stage};
use serde::Serialize;
use std::path::PathBuf;

/// Choices for a report.
#[derive(Clone, Debug, Default)]
pub struct ReportOptions {
    /// Reference of paired differences: the label of a variant or baseline, or a value on an axis of a sweep, such as `Mine` for
    /// `pruner Mine, target_count 60`: each variant is then compared with the one that differs only on this axis. `None`: the
    /// first variant of each setting.
    pub reference: Option<String>,
    /// Columns of the LaTeX table of scores, keys of `report.csv`, with `.median` or `.tail10` for a statistic other than
    /// the mean; empty: those of the page.
    pub columns: Vec<String>,
    /// Variants and methods in the figures, at most 6 (the curves of a figure); empty: the best.
    pub variants: Vec<String>,
}

/// Report of a study.
#[derive(Clone, Debug, Default)]
pub(super) struct StudyPage {
    pub(super) title: String,
    /// Sections, one per setting.
    pub(super) sections: Vec<Section>,
    /// All numbers of all settings, as CSV.
    pub(super) csv: String,
    /// Runs that are omitted, with reasons.
    pub(super) left_out: Vec<String>,
}

/// Section of a setting.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct Section {
    /// Stem of its files: `1`, `2`, ..
    pub(super) name: String,
    pub(super) title: String,
    /// Sentence with the numbers of variants, runs, baselines and samples.
    pub(super) lead: String,
    /// Remarks to read before the tables.
    pub(super) warnings: Vec<String>,
    #[serde(skip)]
    pub(super) tables: Vec<Table>,
    /// Table of scores in LaTeX, if its columns are chosen.
    #[serde(skip)]
    pub(super) chosen: Option<Table>,
    pub(super) figures: Vec<Figure>,
    /// Runs of the setting.
    pub(super) runs: Vec<Value>,
    /// Notes of all predictors.
    pub(super) notes: Vec<String>,
}

impl StudyPage {
    /// Creates the page of all settings of a study, and draws its figures; `observer` receives the progress. Returns an error for
    /// an unknown name in `options`, or too many variants.
    pub(super) fn new(study: &Study, options: &ReportOptions, observer: &mut dyn Observer) -> Result<Self> {
        let comparisons: Vec<Comparison<'_>> = study.settings.iter().map(Comparison::new).collect();
        let named: Vec<Option<Reference<'_>>> =
            comparisons.iter().map(|c| Reference::find(c, options.reference.as_deref()?)).collect();
        if let Some(label) = options.reference.as_deref().filter(|_| named.iter().all(Option::is_none)) {
            return Err(unknown_reference(&comparisons, label));
        }
        check_variants(&study.settings, &options.variants)?;
        check_columns(&comparisons, &options.columns)?;
        let mut sections = Vec::new();
        let mut all_differences = Vec::new();
        for (i, (comparison, named)) in comparisons.iter().zip(named).enumerate() {
            let reference = named.unwrap_or_else(|| Reference::first(comparison));
            let drawn = run_stage(observer, "drawing the figures", |p| {
                figures::draw_figures(comparison.setting, &options.variants, &reference.labels(), p)
            });
            let differences = reference.differences(comparison);
            sections.push(Section::new(i, comparison, options, (&reference, &differences), drawn));
            all_differences.push(differences);
        }
        let unfinished = describe_left_out(&study.unfinished, "not finished");
        let repeated = describe_left_out(&study.repeated, "repeated; named before");
        let csv = report_csv(comparisons.iter().zip(all_differences));
        Ok(Self {
            title: study.title.clone(),
            sections,
            csv,
            left_out: unfinished.into_iter().chain(repeated).collect(),
        })
    }
}

/// Describes in a line the folders that are left out for a `reason`: the first, and the number of others; `None` without any.
fn describe_left_out(folders: &[PathBuf], reason: &str) -> Option<String> {
    let (first, others) = folders.split_first()?;
    let more = if others.is_empty() { String::new() } else { format!(" and {} more", others.len()) };
    Some(format!("{}{more}: {reason}", first.display()))
}

/// Returns the error for the `label` of a reference that no setting has.
fn unknown_reference(comparisons: &[Comparison<'_>], label: &str) -> Error {
    let mut labels: Vec<&str> = comparisons.iter().flat_map(|c| &c.rows).map(|row| row.label).collect();
    labels.sort_unstable();
    labels.dedup();
    let hint = did_you_mean(label, labels.iter().copied());
    let labels = labels.join("`, `");
    Error::Config(format!("--reference: no variant or baseline `{label}`{hint} (found `{labels}`)"))
}

/// Rejects names of columns that no setting has.
fn check_columns(comparisons: &[Comparison<'_>], columns: &[String]) -> Result<()> {
    let Some(name) = columns.iter().find(|name| comparisons.iter().all(|c| c.column(name).is_none())) else {
        return Ok(());
    };
    let names = distinct(comparisons.iter().flat_map(|c| c.metrics.iter().map(|metric| metric.key.as_str())));
    let hint = did_you_mean(name, names.iter().copied());
    let names = names.join("`, `");
    let advice = "add `.median` or `.tail10` to a metric of test samples for another statistic than the mean";
    Err(Error::Config(format!("--columns: no column `{name}`{hint} (found `{names}`); {advice}")))
}

impl Section {
    /// Creates the section of a setting, number `index` from 0, with its tables and the figures `drawn`.
    fn new<'a>(
        index: usize,
        comparison: &'a Comparison<'a>,
        options: &ReportOptions,
        (reference, differences): (&Reference<'a>, &[RowDifferences<'a>]),
        drawn: FigureSet,
    ) -> Self {
        let setting = comparison.setting;
        let runs: Vec<&Record> = setting.runs().collect();
        let absent = options.reference.as_deref().filter(|label| *label != reference.label);
        let mut lead = lead_sentences(comparison, absent, reference.label);
        let mut warnings = lead.split_off(1);
        warnings.extend(distinct(runs.iter().flat_map(|run| run.facts.findings.iter().map(ToString::to_string))));
        warnings.extend(comparison.missing_score_warnings());
        warnings.extend(comparison.ambiguous_baseline_warnings());
        warnings.extend(comparison.unsteady_times_warning());
        warnings.extend(drawn.left_out);
        let metrics = tables::compared_metrics(comparison);
        let first = metrics.first().and_then(|metric| {
            let axis = tables::axis_name(metric);
            figures::differences::figure(setting, (&metric.key, &axis), reference, differences)
        });
        let mut figures: Vec<Figure> = first.into_iter().collect();
        figures.extend(drawn.figures);
        let tables = [
            tables::rank_table(setting),
            tables::score_table(comparison),
            tables::difference_table(comparison, reference, &metrics, differences),
            tables::further_table(comparison),
            tables::latency_table(comparison),
        ];
        Self {
            name: (index + 1).to_string(),
            title: setting.title.clone(),
            lead: lead.concat(),
            warnings,
            tables: tables.into_iter().flatten().collect(),
            chosen: tables::chosen_table(comparison, &options.columns),
            figures,
            runs: run_lines(setting),
            notes: comparison.notes(),
        }
    }
}

/// Returns sentences about the data, runs and machines of a setting, and the `reference` in place of an `absent` one; all but the
/// first are warnings.
fn lead_sentences(comparison: &Comparison<'_>, absent: Option<&str>, reference: &str) -> Vec<String> {
    let setting = comparison.setting;
    let runs: Vec<&Record> = setting.runs().collect();
    // Smallest and largest numbers of training, validation and test samples.
    let samples = [0, 1, 2].map(|k| {
        let counts = runs.iter().map(|r| r.facts.samples[k]);
        vec![counts.clone().min(), counts.max()]
    });
    render_sentences(
        "lead.txt",
        context! {
            variants => setting.variants.len(),
            runs => runs.len(),
            baselines => comparison.rows.iter().filter(|row| [RowKind::Baseline, RowKind::Oracle].contains(&row.kind)).count(),
            samples => Vec::from(samples),
            simulated => setting.simulated,
            observations => setting.task().counted[1],
            machines_differ => !comparison.has_one_machine(),
            machines => distinct(setting.runs().map(describe_machine)),
            programs => distinct(setting.runs().map(describe_program)),
            precisions => distinct(setting.runs().map(|r| r.facts.real_bytes)),
            lengths => distinct(setting.runs().map(|r| grouped(r.pipeline.training.steps as i64))),
            absent,
            reference,
            twins => comparison.twin_groups(),
        },
    )
}

/// Describes the machine of a run.
fn describe_machine(record: &Record) -> String {
    let machine = &record.facts.machine;
    let threads = if machine.threads == 1 { "thread" } else { "threads" };
    format!("{}, {} {threads} of {} cores, {}", machine.cpu, machine.threads, machine.cores, machine.system)
}

/// Describes the program of a run: its version and the start of its commit, if known.
fn describe_program(record: &Record) -> String {
    let id = record.facts.commit.as_ref().map(|id| id.chars().take(10).collect::<String>());
    format!("pwrfgs {}{}", record.facts.version, id.map_or_else(String::new, |id| format!(" at {id}")))
}

/// Returns the runs of a setting for the template: variant, seed, training, machine, program, time and folder.
fn run_lines(setting: &Setting) -> Vec<Value> {
    let line = |variant: &str, record: &Record| {
        let facts = &record.facts;
        context! {
            variant => variant.to_owned(),
            seed => facts.seed,
            training => format!("{} steps, {}", grouped(facts.steps as i64), format_duration(facts.training_seconds)),
            machine => describe_machine(record),
            program => describe_program(record),
            finished => facts.finished.clone().unwrap_or_default(),
            folder => record.folder.display().to_string(),
        }
    };
    setting.variants.iter().flat_map(|v| v.runs.iter().map(move |run| line(&v.label, run))).collect()
}
