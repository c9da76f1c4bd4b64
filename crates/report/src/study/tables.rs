//! `Table`: what every format of the report writes, with the marks already made.

mod differences;
mod scores;

pub(super) use differences::differences;
pub(super) use scores::{further, latency, scores};

use super::comparison::{Kind, Row};
use crate::templates::sentences;
use minijinja::context;
use pwrfgs_experiment::text::{grouped, number};
use pwrfgs_experiment::{Race, Setting, statistics::Spread};
use serde::Serialize;

/// A table of numbers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Table {
    /// Stem of its file and its label.
    pub(super) name: &'static str,
    /// What it is of, and whether that was simulated.
    pub(super) title: String,
    pub(super) columns: Vec<Column>,
    pub(super) lines: Vec<Line>,
    /// How to read it: sentences below it.
    pub(super) legend: Vec<String>,
}

/// Head of a column.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(super) struct Column {
    /// What was measured; the same in neighbouring columns joins them.
    pub(super) title: String,
    /// Statistic and unit.
    pub(super) detail: String,
    /// Which way is better, or nothing.
    pub(super) arrow: &'static str,
}

/// A row.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Line {
    pub(super) label: String,
    /// Rows of one kind stand together.
    pub(super) kind: Kind,
    /// One a column.
    pub(super) cells: Vec<Shown>,
}

/// A number as it is printed; empty where there is none.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(super) struct Shown {
    pub(super) value: String,
    /// The deviation, or nothing.
    pub(super) deviation: String,
    /// Ends of the interval, or nothing.
    pub(super) interval: Option<(String, String)>,
    pub(super) mark: Mark,
}

/// What is said of a number by its looks, never by colour alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Mark {
    #[default]
    None,
    /// Best of its column.
    Best,
    /// Second best of its column.
    Second,
    /// The interval leaves 0 out.
    Clear,
}

/// A title that says where the data are simulated.
fn title(words: &str, setting: &Setting) -> String {
    format!(
        "{words}{}",
        if setting.simulated { format!(" (simulated {})", setting.task().counted[1]) } else { String::new() }
    )
}

impl Line {
    /// Label with what it is: floors are named so, bounds carry a dagger, the ceiling is named so already, and a variant
    /// names the first one with the same models.
    fn new(row: &Row<'_>, cells: Vec<Shown>) -> Self {
        let Row { label, kind, .. } = *row;
        let label = match (kind, row.twin) {
            (_, Some(twin)) => format!("{label} ≡ {twin}"),
            (Kind::Variant | Kind::Ceiling, None) => label.to_owned(),
            (Kind::Floor, None) => format!("{label} (floor)"),
            (Kind::Bound, None) => format!("{label} †"),
        };
        Self { label, kind, cells }
    }
}

impl Table {
    /// Whether some number is the best of its column.
    pub(super) fn is_marked(&self) -> bool {
        self.lines.iter().flat_map(|line| &line.cells).any(|cell| cell.mark == Mark::Best)
    }

    fn has(&self, kind: Kind) -> bool {
        self.lines.iter().any(|line| line.kind == kind)
    }
}

/// Score and rank of each way at each number of Gaussians, best mean rank first; nothing where there is no race.
pub(super) fn ranks(setting: &Setting) -> Option<Table> {
    let race = Race::of(setting)?;
    let headline = setting.headline();
    let arrow = if headline.higher { "↑" } else { "↓" };
    let column = |n: &usize| Column {
        title: format!("N = {}", grouped(*n as i64)),
        detail: format!("{} (rank)", headline.name),
        arrow,
    };
    let mut columns: Vec<Column> = race.numbers.iter().map(column).collect();
    columns.push(Column { title: "mean rank".into(), detail: String::new(), arrow: "↓" });
    let lines = race.ways.iter().map(|way| {
        let cell = |place: &Option<_>| {
            place.map_or_else(Shown::default, |(score, rank): (Spread, usize)| Shown {
                value: format!("{} ({rank})", number(score.mean)),
                deviation: score.deviation.map_or_else(String::new, number),
                mark: match rank {
                    1 => Mark::Best,
                    2 => Mark::Second,
                    _ => Mark::None,
                },
                ..Shown::default()
            })
        };
        let mut cells: Vec<Shown> = way.places.iter().map(cell).collect();
        let mean = way.mean_rank();
        let value = if mean.is_finite() { format!("{mean:.1}") } else { String::new() };
        cells.push(Shown { value, ..Shown::default() });
        Line { label: way.name.clone(), kind: Kind::Variant, cells }
    });
    let lines: Vec<Line> = lines.collect();
    let mut table =
        Table { name: "ranks", title: title("Ranks at equal N", setting), columns, lines, legend: Vec::new() };
    let (least, most) = setting.seeds();
    table.legend = sentences("legend.txt", context! { name => "ranks", ways => race.ways.len(), least, most });
    Some(table)
}
