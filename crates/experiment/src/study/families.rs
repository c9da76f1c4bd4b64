//! `VariantFamily`: variants of one strategy, which differ in numbers only. `ParetoComparison`: strategies at the same
//! numbers of Gaussians.

use super::setting::{Setting, StudyVariant, distinct};
use crate::statistics::Spread;
use crate::text::grouped;

/// Smallest number of strategies for a comparison.
const LEAST_FAMILIES: usize = 4;
/// Smallest number of common numbers of Gaussians for a comparison.
const LEAST_NUMBERS: usize = 2;

/// Strategies compared at the same numbers of Gaussians.
#[derive(Clone, Debug)]
pub struct ParetoComparison<'a> {
    /// Numbers of Gaussians that most strategies reach, ascending.
    pub numbers: Vec<usize>,
    /// Strategies by mean rank, best first, in the order of the plan for ties.
    pub families: Vec<VariantFamily<'a>>,
    /// Whether a strategy has several variants at one of the numbers; the best of them is ranked.
    pub has_several_at_one: bool,
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
    /// Score and rank, from 1, at each of [`ParetoComparison::numbers`]; `None` if the strategy does not reach it.
    pub results: Vec<Option<(Spread, usize)>>,
}

impl<'a> VariantFamily<'a> {
    /// Groups the variants of a setting into strategies, in the order of the plan, without results. A strategy that two sweeps
    /// train for different numbers of steps is one per number, which all names then state.
    pub fn group(setting: &'a Setting) -> Vec<Self> {
        let has_lengths = has_sweeps_of_other_length(setting);
        let mut families: Vec<Self> = Vec::new();
        for variant in &setting.variants {
            let name = family_name(&variant.label);
            let value = family_value(&variant.label, &name);
            let is_same_length = |other: &Self| !has_lengths || other.variants[0].steps() == variant.steps();
            match families.iter_mut().find(|family| family.name == name && is_same_length(family)) {
                Some(family) => {
                    family.variants.push(variant);
                    family.values.push(value);
                }
                None => families.push(Self {
                    name,
                    title: String::new(),
                    variants: vec![variant],
                    values: vec![value],
                    results: Vec::new(),
                }),
            }
        }
        let name_count = distinct(families.iter().map(|family| &family.name)).len();
        let states_length = name_count < families.len();
        let prefix = if name_count > 1 { shorten_names(&mut families) } else { String::new() };
        for family in &mut families {
            family.title = match family.variants[..] {
                [only] => only.label.strip_prefix(&prefix).unwrap_or(&only.label).to_owned(),
                _ => family.name.clone(),
            };
            if let Some(steps) = family.variants[0].steps().filter(|_| states_length) {
                let steps = format!(", {} steps", grouped(steps as i64));
                family.name += &steps;
                family.title += &steps;
            }
        }
        families
    }

    /// Computes the mean rank over the numbers of Gaussians that the strategy reaches; infinite without any.
    pub fn mean_rank(&self) -> f64 {
        let ranks: Vec<f64> = self.results.iter().flatten().map(|(_, rank)| *rank as f64).collect();
        if ranks.is_empty() { f64::INFINITY } else { ranks.iter().sum::<f64>() / ranks.len() as f64 }
    }
}

/// Returns whether the variants are of several sweeps, which the axis without a name distinguishes, and of several training
/// lengths.
fn has_sweeps_of_other_length(setting: &Setting) -> bool {
    let sweep = |variant: &StudyVariant| variant.axes.iter().find(|(axis, _)| axis.is_empty()).cloned();
    let variants = || setting.variants.iter();
    distinct(variants().map(sweep)).len() > 1 && distinct(variants().map(StudyVariant::steps)).len() > 1
}

/// Returns the label without numbers and their symbols, and without axes that are a word and a number: `masks` for
/// `masks, target 24` and for `masks λ = 0.02`. If nothing remains, `by` and the first word; empty if that is a number.
fn family_name(label: &str) -> String {
    let is_number = |word: &str| word.rsplit(['=', ':']).next().is_some_and(|value| value.parse::<f64>().is_ok());
    let is_symbol = |word: &str| word.chars().count() == 1;
    let mut parts: Vec<Vec<&str>> = Vec::new();
    for part in label.split(',').map(|part| part.split_whitespace().collect::<Vec<_>>()) {
        let mut words: Vec<&str> = Vec::new();
        for &word in &part {
            match word {
                number if is_number(number) => {
                    // Removes the symbols before the number, such as `λ =`.
                    let count = words.iter().rposition(|word| !is_symbol(word)).map_or(0, |last| last + 1);
                    words.truncate(count);
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

/// Returns what distinguishes a variant in its family: its label without the words of the name of the `family`.
fn family_value(label: &str, family: &str) -> String {
    let common: Vec<&str> = family.split_whitespace().map(|word| word.trim_matches(',')).collect();
    let words: Vec<&str> = label.split_whitespace().filter(|word| !common.contains(&word.trim_matches(','))).collect();
    words.join(" ").trim_matches([',', ' ']).to_owned()
}

/// Returns the number of Gaussians of a variant; `None` if its runs differ.
fn common_gaussians(variant: &StudyVariant) -> Option<usize> {
    let first = variant.runs.first()?.facts.gaussians;
    variant.runs.iter().all(|run| run.facts.gaussians == first).then_some(first)
}

impl<'a> ParetoComparison<'a> {
    /// Compares the strategies of a setting; `None` if there are too few strategies, or too few numbers of Gaussians that
    /// most of them reach.
    pub fn of(setting: &'a Setting) -> Option<Self> {
        let headline = setting.headline();
        let mut families = VariantFamily::group(setting);
        let mut numbers: Vec<usize> = setting.variants.iter().filter_map(common_gaussians).collect();
        numbers.sort_unstable();
        numbers.dedup();
        let reaches =
            |family: &VariantFamily<'_>, n: usize| family.variants.iter().any(|v| common_gaussians(v) == Some(n));
        numbers.retain(|&n| families.iter().filter(|family| reaches(family, n)).count() * 2 > families.len());
        if families.len() < LEAST_FAMILIES || numbers.len() < LEAST_NUMBERS {
            return None;
        }
        let mut has_several_at_one = false;
        for &n in &numbers {
            let at_n = |family: &VariantFamily<'_>| -> Vec<Spread> {
                let variants = family.variants.iter().filter(|v| common_gaussians(v) == Some(n));
                variants.filter_map(|variant| variant.score(headline.key)).collect()
            };
            let scores: Vec<Vec<Spread>> = families.iter().map(at_n).collect();
            has_several_at_one |= scores.iter().any(|scores| scores.len() > 1);
            let cost = |score: &Spread| headline.cost(score.mean);
            let best = |scores: Vec<Spread>| scores.into_iter().min_by(|a, b| cost(a).total_cmp(&cost(b)));
            let scores: Vec<Option<Spread>> = scores.into_iter().map(best).collect();
            let better = |a: f64, b: f64| if headline.higher { a > b } else { a < b };
            for (family, score) in families.iter_mut().zip(&scores) {
                let rank = |score: Spread| 1 + scores.iter().flatten().filter(|s| better(s.mean, score.mean)).count();
                family.results.push(score.map(|score| (score, rank(score))));
            }
        }
        families.sort_by(|a, b| a.mean_rank().total_cmp(&b.mean_rank()));
        Some(Self { numbers, families, has_several_at_one })
    }
}

/// Removes the words that the names of all `families` begin or end with; a name without other words is unchanged. Returns the
/// common first words, each with a blank after it.
fn shorten_names(families: &mut [VariantFamily<'_>]) -> String {
    let split_name = |family: &VariantFamily<'_>| family.name.split(' ').map(str::to_owned).collect::<Vec<_>>();
    let names: Vec<Vec<String>> = families.iter().map(split_name).collect();
    let least = names.iter().map(Vec::len).min().unwrap_or(0);
    let same = |at: &dyn Fn(&Vec<String>) -> String| names.iter().all(|words| at(words) == at(&names[0]));
    let same_first = (0..least).take_while(|&k| same(&|words| words[k].clone())).count();
    let ends = 0..least.saturating_sub(same_first + 1);
    let same_last = ends.take_while(|&k| same(&|words| words[words.len() - 1 - k].clone())).count();
    for (family, words) in families.iter_mut().zip(&names).filter(|(_, words)| words.len() > same_first + same_last) {
        words[same_first..words.len() - same_last].join(" ").trim_end_matches(',').clone_into(&mut family.name);
    }
    names[0][..same_first].iter().flat_map(|word| [word.as_str(), " "]).collect()
}

#[cfg(test)]
mod tests {
    use super::{family_name, family_value};

    #[test]
    fn family_ignores_numeric_settings() {
        assert_eq!(family_name("lambda 0.02, cloud"), family_name("lambda 0.4, cloud"));
        assert_ne!(family_name("lambda 0.02, cloud"), family_name("lambda 0.02, random"));
        assert_ne!(family_name("method Pup3dgs, target 24"), family_name("method Pup2dgs, target 24"));
        assert_eq!(family_name("method Pup3dgs, target 24"), "method Pup3dgs");
        for label in ["masks λ 0.02", "masks λ=0.02", "masks λ = 0.02", "masks, λ 0.02", "masks 0.02", "λ 0.02, masks"]
        {
            assert_eq!(family_name(label), "masks", "{label}");
        }
        let single = ["λ 0.02", "a long name 8", "WRF-GS", "blending, N 250, equal time", "0.02"].map(family_name);
        let values = ["row masks on walls λ 0.02", "method Mlp, N 24", "λ 0.02, masks"]
            .map(|label| family_value(label, &family_name(label)));
        assert_eq!(values, ["λ 0.02", "N 24", "λ 0.02"]);
        assert_eq!(single, ["by λ", "a long name", "WRF-GS", "blending, equal time", ""]);
    }
}
