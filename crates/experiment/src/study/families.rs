//! `VariantFamily`: variants of one strategy, which differ in numbers only. `ParetoComparison`: strategies at the same
//! numbers of Gaussians.

use super::setting::{Setting, StudyVariant};
use crate::statistics::Spread;

/// Smallest numbers of strategies and of Gaussian counts for a race.
const LEAST: [usize; 2] = [4, 2];

/// Strategies compared at the same numbers of Gaussians.
#[derive(Clone, Debug)]
pub struct ParetoComparison<'a> {
    /// Numbers of Gaussians that most strategies reach, ascending.
    pub numbers: Vec<usize>,
    /// Strategies by mean rank, best first, in the order of the plan for ties.
    pub families: Vec<VariantFamily<'a>>,
}

/// Strategy: variants whose labels differ only in numbers.
#[derive(Clone, Debug)]
pub struct VariantFamily<'a> {
    /// Common part of its labels.
    pub name: String,
    /// Name in a legend: `name`, or the label of a single variant without words that all names begin with.
    pub title: String,
    /// Variants in the order of the plan.
    pub variants: Vec<&'a StudyVariant>,
    /// What distinguishes each variant in its strategy, such as `λ 0.02`.
    pub values: Vec<String>,
    /// Score and rank, from 1, at each number of the race; `None` if the strategy does not reach it.
    pub places: Vec<Option<(Spread, usize)>>,
}

impl<'a> VariantFamily<'a> {
    /// Strategies of a setting, in the order of the plan, without places.
    pub fn all(setting: &'a Setting) -> Vec<Self> {
        let mut families: Vec<Self> = Vec::new();
        for variant in &setting.variants {
            let name = family(&variant.label);
            let value = value(&variant.label, &name);
            match families.iter_mut().find(|way| way.name == name) {
                Some(way) => {
                    way.variants.push(variant);
                    way.values.push(value);
                }
                None => families.push(Self {
                    name,
                    title: String::new(),
                    variants: vec![variant],
                    values: vec![value],
                    places: Vec::new(),
                }),
            }
        }
        let prefix = if families.len() > 1 { shorten(&mut families) } else { String::new() };
        for way in &mut families {
            way.title = match way.variants[..] {
                [only] => only.label.strip_prefix(&prefix).unwrap_or(&only.label).to_owned(),
                _ => way.name.clone(),
            };
        }
        families
    }

    /// Mean rank over the numbers that it reaches; infinite without any.
    pub fn mean_rank(&self) -> f64 {
        let ranks: Vec<f64> = self.places.iter().flatten().map(|(_, rank)| *rank as f64).collect();
        if ranks.is_empty() { f64::INFINITY } else { ranks.iter().sum::<f64>() / ranks.len() as f64 }
    }
}

/// Label without its numbers and what they number: `masks` for `masks, target 24` and for `masks λ = 0.02`.
fn family(label: &str) -> String {
    let is_number = |word: &str| word.rsplit(['=', ':']).next().is_some_and(|value| value.parse::<f64>().is_ok());
    let is_symbol = |word: &str| word.chars().count() == 1;
    let mut parts: Vec<Vec<&str>> = Vec::new();
    for part in label.split(',').map(|part| part.split_whitespace().collect::<Vec<_>>()) {
        let mut words: Vec<&str> = Vec::new();
        for &word in &part {
            match word {
                number if is_number(number) => {
                    let kept = words.iter().rposition(|word| !is_symbol(word)).map_or(0, |last| last + 1);
                    words.truncate(kept);
                }
                word => words.push(word),
            }
        }
        let is_axis = matches!(part[..], [_, number] if is_number(number));
        if !words.is_empty() && (!is_axis || !label.contains(',')) {
            parts.push(words);
        }
    }
    let name = parts.iter().map(|words| words.join(" ")).collect::<Vec<_>>().join(", ");
    match label.split_whitespace().next() {
        Some(axis) if name.is_empty() && !is_number(axis) => format!("by {}", axis.trim_end_matches(',')),
        _ => name,
    }
}

/// Label without the words of its family.
fn value(label: &str, family: &str) -> String {
    let is_common = |word: &&str| family.split_whitespace().any(|own| own.trim_matches(',') == word.trim_matches(','));
    let words: Vec<&str> = label.split_whitespace().filter(|word| !is_common(word)).collect();
    words.join(" ").trim_matches([',', ' ']).to_owned()
}

/// N of a variant, if its seeds agree.
fn count(variant: &StudyVariant) -> Option<usize> {
    let first = variant.runs.first()?.facts.gaussians;
    variant.runs.iter().all(|run| run.facts.gaussians == first).then_some(first)
}

impl<'a> ParetoComparison<'a> {
    /// Creates the race of a setting; `None` if there are too few strategies.
    pub fn of(setting: &'a Setting) -> Option<Self> {
        let headline = setting.headline();
        let mut families = VariantFamily::all(setting);
        let mut numbers: Vec<usize> = setting.variants.iter().filter_map(count).collect();
        numbers.sort_unstable();
        numbers.dedup();
        let comes_to = |way: &VariantFamily<'_>, n: usize| way.variants.iter().any(|v| count(v) == Some(n));
        numbers.retain(|&n| families.iter().filter(|way| comes_to(way, n)).count() * 2 > families.len());
        if families.len() < LEAST[0] || numbers.len() < LEAST[1] {
            return None;
        }
        let score = |variant: &StudyVariant| variant.score(headline.key);
        for &n in &numbers {
            let at = |way: &VariantFamily<'_>| way.variants.iter().find(|v| count(v) == Some(n)).and_then(|v| score(v));
            let scores: Vec<Option<Spread>> = families.iter().map(at).collect();
            let better = |a: f64, b: f64| if headline.higher { a > b } else { a < b };
            for (way, own) in families.iter_mut().zip(&scores) {
                let rank = |own: &Spread| 1 + scores.iter().flatten().filter(|s| better(s.mean, own.mean)).count();
                way.places.push(own.map(|own| (own, rank(&own))));
            }
        }
        families.sort_by(|a, b| a.mean_rank().total_cmp(&b.mean_rank()));
        Some(Self { numbers, families })
    }
}

/// Removes words that all names begin or end with. Returns what all names begin with.
fn shorten(families: &mut [VariantFamily<'_>]) -> String {
    let words = |way: &VariantFamily<'_>| way.name.split(' ').map(str::to_owned).collect::<Vec<_>>();
    let all: Vec<Vec<String>> = families.iter().map(words).collect();
    let least = all.iter().map(Vec::len).min().unwrap_or(0);
    let same = |at: &dyn Fn(&Vec<String>) -> String| all.iter().all(|own| at(own) == at(&all[0]));
    let first = (0..least).take_while(|&k| same(&|own| own[k].clone())).count();
    let last =
        (0..least.saturating_sub(first + 1)).take_while(|&k| same(&|own| own[own.len() - 1 - k].clone())).count();
    for (way, own) in families.iter_mut().zip(&all).filter(|(_, own)| own.len() > first + last) {
        own[first..own.len() - last].join(" ").trim_end_matches(',').clone_into(&mut way.name);
    }
    all[0][..first].iter().flat_map(|word| [word.as_str(), " "]).collect()
}

#[cfg(test)]
mod tests {
    use super::{family, value};

    #[test]
    fn family_ignores_numeric_settings() {
        assert_eq!(family("lambda 0.02, cloud"), family("lambda 0.4, cloud"));
        assert_ne!(family("lambda 0.02, cloud"), family("lambda 0.02, random"));
        assert_ne!(family("method Pup3dgs, target 24"), family("method Pup2dgs, target 24"));
        assert_eq!(family("method Pup3dgs, target 24"), "method Pup3dgs");
        for label in ["masks λ 0.02", "masks λ=0.02", "masks λ = 0.02", "masks, λ 0.02", "masks 0.02", "λ 0.02, masks"]
        {
            assert_eq!(family(label), "masks", "{label}");
        }
        let single = ["λ 0.02", "a long name 8", "WRF-GS", "blending, N 250, equal time", "0.02"].map(family);
        let values = ["row masks on walls λ 0.02", "method Mlp, N 24", "λ 0.02, masks"]
            .map(|label| value(label, &family(label)));
        assert_eq!(values, ["λ 0.02", "N 24", "λ 0.02"]);
        assert_eq!(single, ["by λ", "a long name", "WRF-GS", "blending, equal time", ""]);
    }
}
