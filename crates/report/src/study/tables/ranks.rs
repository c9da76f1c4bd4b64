//! Ranks of ways to the same numbers of Gaussians.

use super::super::comparison::Kind;
use super::super::race::Race;
use super::{Column, Line, Mark, Shown, Table, title};
use crate::study::Setting;
use crate::templates::sentences;
use minijinja::context;
use pwrfgs_experiment::text::{grouped, number};

/// Score and rank of each way at each number of Gaussians, best mean rank first; nothing where there is no race.
pub(in super::super) fn ranks(setting: &Setting) -> Option<Table> {
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
            place.map_or_else(Shown::default, |(score, rank): (pwrfgs_experiment::statistics::Spread, usize)| Shown {
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
