//! `Page`: everything that the report says, before it takes the form of a format.

use super::comparison::{Comparison, Kind, Row};
use super::figures::{self, Figure};
use super::tables::{self, Table};
use super::{Record, Setting, Study};
use pwrfgs_core::{Error, Result, did_you_mean};
use pwrfgs_experiment::clock::duration;
use pwrfgs_experiment::text::grouped;
use pwrfgs_experiment::{Observer, staged};
use serde::Serialize;

/// The report of a study.
#[derive(Clone, Debug)]
pub(super) struct Page {
    pub(super) title: String,
    /// One a setting.
    pub(super) sections: Vec<Section>,
    /// Runs that are not in it, and why.
    pub(super) left_out: Vec<String>,
}

/// What is said of a setting.
#[derive(Clone, Debug, Default)]
pub(super) struct Section {
    /// Stem of its files: `1`, `2`, ..
    pub(super) name: String,
    pub(super) title: String,
    /// A few words about the data.
    pub(super) lead: String,
    /// Label of the row that differences are from.
    pub(super) reference: String,
    /// What a reader must know before looking at a number.
    pub(super) warnings: Vec<String>,
    pub(super) tables: Vec<Table>,
    pub(super) figures: Vec<Figure>,
    pub(super) runs: Vec<RunLine>,
    /// What baselines say of themselves.
    pub(super) notes: Vec<String>,
}

/// A run in the list of runs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct RunLine {
    pub(super) variant: String,
    pub(super) seed: u64,
    pub(super) training: String,
    pub(super) machine: String,
    pub(super) program: String,
    pub(super) finished: String,
    pub(super) folder: String,
}

impl Page {
    /// Of all settings of a study, compared with the reference of this label, or each with its first variant.
    pub(super) fn new(study: &Study, reference: Option<&str>, observer: &mut dyn Observer) -> Result<Self> {
        let comparisons: Vec<Comparison<'_>> = study.settings.iter().map(Comparison::new).collect();
        if let Some(label) = reference {
            check_reference(&comparisons, label)?;
        }
        let mut sections = Vec::new();
        for (i, comparison) in comparisons.iter().enumerate() {
            let figures = staged(observer, "drawing the figures", |p| figures::all(study, comparison.setting, p))?;
            sections.push(Section::new(i, comparison, reference, figures));
        }
        let unfinished = study.unfinished.iter().map(|path| format!("{}: has not finished", path.display()));
        let repeated = study.repeated.iter().map(|path| format!("{}: a run named before, or its twin", path.display()));
        Ok(Self { title: study.title.clone(), sections, left_out: unfinished.chain(repeated).collect() })
    }
}

/// Refuses a label that no setting has.
fn check_reference(comparisons: &[Comparison<'_>], label: &str) -> Result<()> {
    if comparisons.iter().any(|c| c.row(label).is_some()) {
        return Ok(());
    }
    let mut known: Vec<&str> = comparisons.iter().flat_map(|c| &c.rows).map(|row| row.label).collect();
    known.sort_unstable();
    known.dedup();
    let hint = did_you_mean(label, known.iter().copied());
    let known = known.join("`, `");
    Err(Error::Config(format!("--reference: no variant and no floor is called `{label}`{hint} (there are `{known}`)")))
}

impl Section {
    /// The tables, each with what its legend says that no table above it has said.
    pub(super) fn tables(&self) -> impl Iterator<Item = (&Table, Vec<&str>)> {
        let mut said: Vec<&str> = Vec::new();
        self.tables.iter().map(move |table| {
            let fresh: Vec<&str> = table.legend.iter().map(String::as_str).filter(|s| !said.contains(s)).collect();
            said.extend(&fresh);
            (table, fresh)
        })
    }

    fn new(index: usize, comparison: &Comparison<'_>, reference: Option<&str>, figures: Vec<Figure>) -> Self {
        let setting = comparison.setting;
        let named = reference.and_then(|label| comparison.row(label));
        let compared: &Row<'_> = named.unwrap_or(&comparison.rows[0]);
        let runs: Vec<&Record> = setting.variants.iter().flat_map(|v| &v.runs).collect();
        let same_machine = runs.iter().all(|r| r.facts.machine == runs[0].facts.machine);
        let mut warnings = warnings(&runs, same_machine);
        if let (Some(label), None) = (reference, named) {
            warnings.push(format!("{label} is not in this setting: differences are from {} instead.", compared.label));
        }
        let tables = [
            tables::scores(comparison, same_machine),
            tables::differences(comparison, compared),
            tables::further(comparison, same_machine),
            tables::latency(comparison, same_machine),
        ];
        Self {
            name: (index + 1).to_string(),
            title: setting.title.clone(),
            lead: lead(comparison, &runs),
            reference: compared.label.to_owned(),
            warnings,
            tables: tables.into_iter().flatten().collect(),
            figures,
            runs: run_lines(setting),
            notes: comparison.notes(),
        }
    }
}

/// Variants, seeds and spectra in words.
fn lead(comparison: &Comparison<'_>, runs: &[&Record]) -> String {
    let floors = comparison.rows.iter().filter(|row| row.kind != Kind::Variant).count();
    let count = |n: usize, one: &str, many: &str| format!("{} {}", grouped(n as i64), if n == 1 { one } else { many });
    let range = |k: usize| {
        let of = || runs.iter().map(|r| r.facts.samples[k]);
        match (of().min().unwrap_or(0), of().max().unwrap_or(0)) {
            (low, high) if low == high => grouped(low as i64),
            (low, high) => format!("{} to {}", grouped(low as i64), grouped(high as i64)),
        }
    };
    let kind = if comparison.setting.simulated { "simulated" } else { "measured" };
    format!(
        "{}, {}, {}; {} training, {} validation and {} test spectra, all {kind}.",
        count(comparison.setting.variants.len(), "variant", "variants"),
        count(runs.len(), "run", "runs"),
        count(floors, "baseline", "baselines"),
        range(0),
        range(1),
        range(2)
    )
}

/// Circumstances that differ between the runs of one comparison.
fn warnings(runs: &[&Record], same_machine: bool) -> Vec<String> {
    let differ = |of: &dyn Fn(&Record) -> String| {
        let mut all: Vec<String> = runs.iter().map(|r| of(r)).collect();
        all.sort();
        all.dedup();
        (all.len() > 1).then(|| all.join(", "))
    };
    let mut warnings = Vec::new();
    if !same_machine {
        let machines = differ(&|r| machine(r)).unwrap_or_default();
        warnings.push(format!("These runs are from different machines ({machines}): their times are not comparable."));
    }
    if let Some(programs) = differ(&program) {
        warnings.push(format!("These runs are from different programs ({programs}): differences may come from that."));
    }
    if differ(&|r| r.facts.real_bytes.to_string()).is_some() {
        warnings.push("Some of these runs are in single precision, some in double precision.".into());
    }
    warnings
}

fn machine(record: &Record) -> String {
    let machine = &record.facts.machine;
    let threads = if machine.threads == 1 { "thread" } else { "threads" };
    format!("{}, {} {threads} of {} cores, {}", machine.cpu, machine.threads, machine.cores, machine.system)
}

fn program(record: &Record) -> String {
    let id = record.facts.commit.as_ref().map(|id| id.chars().take(10).collect::<String>());
    format!("pwrfgs {}{}", record.facts.version, id.map_or_else(String::new, |id| format!(" at {id}")))
}

fn run_lines(setting: &Setting) -> Vec<RunLine> {
    let line = |variant: &str, record: &Record| RunLine {
        variant: variant.to_owned(),
        seed: record.facts.seed,
        training: format!("{} steps, {}", grouped(record.facts.steps as i64), duration(record.facts.training_seconds)),
        machine: machine(record),
        program: program(record),
        finished: record.facts.finished.clone().unwrap_or_default(),
        folder: record.folder.display().to_string(),
    };
    setting.variants.iter().flat_map(|v| v.runs.iter().map(move |run| line(&v.label, run))).collect()
}
