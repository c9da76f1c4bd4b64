//! `Table`: content of a table for all formats of the report, with best values marked.

mod scores;

pub(super) use scores::{
    axis_name, chosen_table, compared_metrics, difference_table, further_table, latency_table, score_table,
};

use super::comparison::{ComparisonRow, RowKind};
use crate::templates::render_sentences;
use minijinja::context;
use pwrfgs_experiment::text::{grouped, number};
use pwrfgs_experiment::{ParetoComparison, Setting, statistics::Spread};
use serde::Serialize;

/// Table of numbers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Table {
    /// Stem of its file and label.
    pub(super) name: &'static str,
    /// Title, which marks simulated data.
    pub(super) title: String,
    pub(super) columns: Vec<TableColumn>,
    pub(super) lines: Vec<TableLine>,
    /// Sentences below the table.
    pub(super) legend: Vec<String>,
}

/// Head of a column.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(super) struct TableColumn {
    /// Quantity; neighbouring columns with the same quantity are joined.
    pub(super) title: String,
    /// Statistic and unit.
    pub(super) detail: String,
    /// Direction of better values, or empty.
    pub(super) arrow: &'static str,
}

/// Row of a table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct TableLine {
    pub(super) label: String,
    /// Type of the row; rows of one type are adjacent.
    pub(super) kind: RowKind,
    /// Cells, one per column.
    pub(super) cells: Vec<FormattedValue>,
}

/// Printed number; empty if there is none.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(super) struct FormattedValue {
    pub(super) value: String,
    /// Deviation, or empty.
    pub(super) deviation: String,
    /// Ends of the interval, if any.
    pub(super) interval: Option<(String, String)>,
    pub(super) mark: RankMark,
}

/// Mark of a number, never by colour alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum RankMark {
    #[default]
    None,
    /// Best of its column.
    Best,
    /// Second best of its column.
    Second,
    /// Interval without 0.
    Clear,
}

/// Returns the title of a table: `words`, with a mark if the data are simulated.
fn table_title(words: &str, setting: &Setting) -> String {
    format!(
        "{words}{}",
        if setting.simulated { format!(" (simulated {})", setting.task().counted[1]) } else { String::new() }
    )
}

impl TableLine {
    /// Creates a row. The label marks external predictions, baselines, oracle baselines (with a dagger) and variants
    /// whose models are bit-identical to those of an earlier variant.
    fn new(row: &ComparisonRow<'_>, cells: Vec<FormattedValue>) -> Self {
        let ComparisonRow { label, kind, .. } = *row;
        let label = match (kind, row.twin) {
            (_, Some(twin)) => format!("{label} ≡ {twin}"),
            (RowKind::Variant | RowKind::Ceiling, None) => label.to_owned(),
            (RowKind::External, None) => format!("{label} (external)"),
            (RowKind::Baseline, None) => format!("{label} (baseline)"),
            (RowKind::Oracle, None) => format!("{label} †"),
        };
        Self { label, kind, cells }
    }
}

impl Table {
    /// Returns whether any number is marked as best.
    pub(super) fn is_marked(&self) -> bool {
        self.lines.iter().flat_map(|line| &line.cells).any(|cell| cell.mark == RankMark::Best)
    }

    /// Returns whether the table has a row of this type.
    fn has_row_of(&self, kind: RowKind) -> bool {
        self.lines.iter().any(|line| line.kind == kind)
    }
}

/// Formats score and rank of a method at one number of Gaussians; empty if the method does not reach it.
fn rank_cell(result: Option<(Spread, usize)>) -> FormattedValue {
    let Some((score, rank)) = result else { return FormattedValue::default() };
    FormattedValue {
        value: format!("{} ({rank})", number(score.mean)),
        deviation: score.deviation.map_or_else(String::new, number),
        mark: match rank {
            1 => RankMark::Best,
            2 => RankMark::Second,
            _ => RankMark::None,
        },
        ..FormattedValue::default()
    }
}

/// Returns the table of score and rank of each method at each number of Gaussians, best mean rank first; `None` if
/// [`ParetoComparison::of`] finds too few methods with equal numbers.
pub(super) fn rank_table(setting: &Setting) -> Option<Table> {
    let pareto = ParetoComparison::of(setting)?;
    let headline = setting.headline();
    let arrow = if headline.higher { "↑" } else { "↓" };
    let column = |n: &usize| TableColumn {
        title: format!("N = {}", grouped(*n as i64)),
        detail: format!("{} (rank)", headline.name),
        arrow,
    };
    let mut columns: Vec<TableColumn> = pareto.numbers.iter().map(column).collect();
    columns.push(TableColumn { title: "mean rank".into(), detail: String::new(), arrow: "↓" });
    let lines = pareto.families.iter().map(|family| {
        let mut cells: Vec<FormattedValue> = family.results.iter().copied().map(rank_cell).collect();
        let mean = family.mean_rank();
        let value = if mean.is_finite() { format!("{mean:.1}") } else { String::new() };
        cells.push(FormattedValue { value, ..FormattedValue::default() });
        TableLine { label: family.name.clone(), kind: RowKind::Variant, cells }
    });
    let lines: Vec<TableLine> = lines.collect();
    let mut table =
        Table { name: "ranks", title: table_title("Ranks at equal N", setting), columns, lines, legend: Vec::new() };
    let (least, most) = setting.seed_counts();
    let (families, several) = (pareto.families.len(), pareto.has_several_at_one);
    table.legend = render_sentences("legend.txt", context! { name => "ranks", families, least, most, several });
    Some(table)
}
