//! `Race`: variants of a setting that come to the same numbers of Gaussians in different ways, and the table of their ranks.

use super::comparison::Kind;
use super::tables::{Column, Line, Mark, Shown, Table, title};
use super::{Setting, Variant};
use crate::templates::sentences;
use minijinja::context;
use pwrfgs_experiment::statistics::Spread;
use pwrfgs_experiment::text::{grouped, number};

/// At least so many ways, at so many numbers of Gaussians, are a race.
const LEAST: [usize; 2] = [4, 2];

/// Ways to the same numbers of Gaussians.
#[derive(Clone, Debug)]
pub(super) struct Race<'a> {
    /// Numbers of Gaussians that most ways come to, ascending.
    pub(super) numbers: Vec<usize>,
    /// Best mean rank first, of equals in the order of the plan.
    pub(super) ways: Vec<Way<'a>>,
}

/// One way: variants whose labels differ in numbers alone.
#[derive(Clone, Debug)]
pub(super) struct Way<'a> {
    /// What its labels share.
    pub(super) name: String,
    /// In the order of the plan.
    pub(super) variants: Vec<&'a Variant>,
    /// Of each number of the race the score and the rank, from 1; nothing where it does not come to it.
    pub(super) places: Vec<Option<(Spread, usize)>>,
}

impl Way<'_> {
    /// Over the numbers that it comes to; infinite where it comes to none.
    pub(super) fn mean_rank(&self) -> f64 {
        let ranks: Vec<f64> = self.places.iter().flatten().map(|(_, rank)| *rank as f64).collect();
        if ranks.is_empty() { f64::INFINITY } else { ranks.iter().sum::<f64>() / ranks.len() as f64 }
    }
}

/// The label without its numbers.
pub(super) fn family(label: &str) -> String {
    let is_number = |word: &&str| word.trim_end_matches(',').parse::<f64>().is_err();
    label.split_whitespace().filter(is_number).collect::<Vec<_>>().join(" ")
}

/// N of a variant, where its seeds agree.
fn count(variant: &Variant) -> Option<usize> {
    let first = variant.runs.first()?.facts.gaussians;
    variant.runs.iter().all(|run| run.facts.gaussians == first).then_some(first)
}

impl<'a> Race<'a> {
    /// Nothing where the variants are none.
    pub(super) fn of(setting: &'a Setting) -> Option<Self> {
        let headline = setting.headline();
        let mut ways: Vec<Way<'a>> = Vec::new();
        for variant in &setting.variants {
            let name = family(&variant.label);
            match ways.iter_mut().find(|way| way.name == name) {
                Some(way) => way.variants.push(variant),
                None => ways.push(Way { name, variants: vec![variant], places: Vec::new() }),
            }
        }
        let mut numbers: Vec<usize> = setting.variants.iter().filter_map(count).collect();
        numbers.sort_unstable();
        numbers.dedup();
        let comes_to = |way: &Way<'_>, n: usize| way.variants.iter().any(|v| count(v) == Some(n));
        numbers.retain(|&n| ways.iter().filter(|way| comes_to(way, n)).count() * 2 > ways.len());
        if ways.len() < LEAST[0] || numbers.len() < LEAST[1] {
            return None;
        }
        let score = |variant: &Variant| variant.score(headline.key);
        for &n in &numbers {
            let at = |way: &Way<'_>| way.variants.iter().find(|v| count(v) == Some(n)).and_then(|v| score(v));
            let scores: Vec<Option<Spread>> = ways.iter().map(at).collect();
            let better = |a: f64, b: f64| if headline.higher { a > b } else { a < b };
            for (way, own) in ways.iter_mut().zip(&scores) {
                let rank = |own: &Spread| 1 + scores.iter().flatten().filter(|s| better(s.mean, own.mean)).count();
                way.places.push(own.map(|own| (own, rank(&own))));
            }
        }
        ways.sort_by(|a, b| a.mean_rank().total_cmp(&b.mean_rank()));
        shorten(&mut ways);
        Some(Self { numbers, ways })
    }
}

/// Takes words away that all names begin or end with.
fn shorten(ways: &mut [Way<'_>]) {
    let words = |way: &Way<'_>| way.name.split(' ').map(str::to_owned).collect::<Vec<_>>();
    let all: Vec<Vec<String>> = ways.iter().map(words).collect();
    let least = all.iter().map(Vec::len).min().unwrap_or(0);
    let same = |at: &dyn Fn(&Vec<String>) -> String| all.iter().all(|own| at(own) == at(&all[0]));
    let first = (0..least).take_while(|&k| same(&|own| own[k].clone())).count();
    let last =
        (0..least.saturating_sub(first + 1)).take_while(|&k| same(&|own| own[own.len() - 1 - k].clone())).count();
    for (way, own) in ways.iter_mut().zip(&all).filter(|(_, own)| own.len() > first + last) {
        own[first..own.len() - last].join(" ").trim_end_matches(',').clone_into(&mut way.name);
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

#[cfg(test)]
mod tests {
    use super::family;

    #[test]
    fn families_differ_in_more_than_numbers() {
        assert_eq!(family("lambda 0.02, cloud"), family("lambda 0.4, cloud"));
        assert_ne!(family("lambda 0.02, cloud"), family("lambda 0.02, random"));
        assert_ne!(family("method Pup3dgs, target 24"), family("method Pup2dgs, target 24"));
        assert_eq!(family("method Pup3dgs, target 24"), "method Pup3dgs, target");
    }
}
