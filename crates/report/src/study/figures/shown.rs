//! `ShownVariants`: variants in the figures, with at most six curves each.

use pwrfgs_core::{Error, Result, did_you_mean, evenly};
use pwrfgs_experiment::{Setting, StudyVariant, VariantFamily, distinct};
use std::fmt::Write as _;

/// Maximum number of curves of variants or methods in a figure, and of grey curves of baselines; the help of `--variants` and
/// `figures.txt` print them.
pub(super) const CURVES: usize = 6;
const GREY_CURVES: usize = 3;

/// Variants in figures.
pub(super) struct ShownVariants {
    /// All variants, or the chosen ones.
    pub(super) all: Selection,
    /// Variants of at most [`CURVES`] methods, the best by the first metric.
    pub(super) methods: Selection,
    /// At most [`CURVES`] variants of `methods`: all if there are no more, otherwise one per method at similar numbers of Gaussians,
    /// or of a single method evenly. Their labels lack common parts.
    pub(super) curves: Selection,
    /// As `curves`, but without chosen names the best of each method: similar numbers would compare the starts of figure 3 of the
    /// paper after the hardest pruning.
    pub(super) panels: Selection,
    /// At most [`CURVES`] variants of two or three `methods`, as many of each, from the first to the last of the plan; `None` for
    /// other numbers of methods, and if `curves` has all variants.
    pub(super) spread: Option<Selection>,
}

/// Variants of one figure.
pub(super) struct Selection {
    pub(super) setting: Setting,
    /// Sentences for the caption, each after a space: parts that the labels lack, and how the variants were selected.
    pub(super) remarks: String,
}

impl From<Setting> for Selection {
    fn from(setting: Setting) -> Self {
        Self { setting, remarks: String::new() }
    }
}

impl Selection {
    /// Removes common parts from the labels, and remarks them.
    fn with_short_labels(mut setting: Setting) -> Self {
        let common = remove_common_parts(&mut setting.variants);
        let remarks = if common.is_empty() { common } else { format!(" All variants: {common}.") };
        Self { setting, remarks }
    }
}

impl ShownVariants {
    /// Selects variants of the `chosen` labels and methods; without them, of the best methods and those of `references`.
    pub(super) fn of(setting: &Setting, chosen: &[String], references: &[&str]) -> Self {
        let all = if chosen.is_empty() { setting.clone() } else { keep(setting, &chosen_variants(setting, chosen)) };
        let methods = keep(&all, &best_methods(&all, references));
        let variants: Vec<&StudyVariant> = methods.variants.iter().collect();
        let curves = match one_variant_per_method(&methods) {
            _ if variants.len() <= CURVES => keep(&methods, &variants),
            one_each => keep(&methods, &evenly(&one_each, CURVES)),
        };
        let families = VariantFamily::group(&methods);
        let panels = if chosen.is_empty() && families.len() > 1 && variants.len() > families.len() {
            let mut panels = Selection::with_short_labels(keep(&methods, &best_variants(&methods)));
            let short = methods.headline().short;
            _ = write!(panels.remarks, " Of each method, the variant with the best {short} is shown.");
            panels
        } else {
            Selection::with_short_labels(curves.clone())
        };
        let each = CURVES / families.len();
        let extremes: Vec<&StudyVariant> =
            families.iter().flat_map(|family| evenly_with_ends(&family.variants, each)).collect();
        let spread =
            (families.len() > 1 && each > 1 && variants.len() > CURVES).then(|| keep(&methods, &extremes).into());
        let mut curves = Selection::with_short_labels(curves);
        if variants.len() > CURVES && families.len() > 1 {
            curves.remarks += " Of each method, a variant is shown whose N is close to those of the others.";
        }
        Self { curves, panels, spread, all: all.into(), methods: methods.into() }
    }
}

/// Returns at most `count` of the `items`, evenly spaced from the first to the last.
fn evenly_with_ends<T: Copy>(items: &[T], count: usize) -> Vec<T> {
    if items.len() <= count || count < 2 {
        return evenly(items, count);
    }
    (0..count).map(|k| items[k * (items.len() - 1) / (count - 1)]).collect()
}

/// Removes the parts between commas that the labels of all `variants` have, and returns these; none if a label has no other
/// part, or for a single variant. Also removes the axis that all labels begin with, such as `method` of `method masks`,
/// but not before a number.
fn remove_common_parts(variants: &mut [StudyVariant]) -> String {
    let labels: Vec<Vec<String>> =
        variants.iter().map(|variant| variant.label.split(", ").map(str::to_owned).collect()).collect();
    let is_common = |part: &&String| labels.iter().all(|parts| parts.contains(part));
    let other_parts =
        |parts: &[String]| parts.iter().filter(|part| !is_common(part)).cloned().collect::<Vec<_>>().join(", ");
    let mut names: Vec<String> = labels.iter().map(|parts| other_parts(parts)).collect();
    let mut common = labels[0].iter().filter(is_common).cloned().collect::<Vec<_>>().join(", ");
    if labels.len() < 2 {
        return String::new();
    }
    if names.iter().any(String::is_empty) {
        (names, common) = (labels.iter().map(|parts| parts.join(", ")).collect(), String::new());
    }
    let without_axis = |name: &String| {
        let (axis, value) = name.split_once(' ')?;
        let is_word = value.starts_with(char::is_alphabetic);
        (is_word && names.iter().all(|other| other.split(' ').next() == Some(axis))).then(|| value.to_owned())
    };
    let shorter: Option<Vec<String>> = names.iter().map(without_axis).collect();
    variants.iter_mut().zip(shorter.unwrap_or(names)).for_each(|(variant, name)| variant.label = name);
    common
}

/// Returns one variant per method: the variants that are nearest to a common number of Gaussians, by ratio. For a single method,
/// returns all its variants.
pub(super) fn one_variant_per_method<'a>(setting: &'a Setting) -> Vec<&'a StudyVariant> {
    let families = VariantFamily::group(setting);
    if families.len() == 1 {
        return setting.variants.iter().collect();
    }
    let count = |variant: &StudyVariant| variant.runs[0].facts.gaussians;
    let ratio = |variant: &StudyVariant, n: usize| (count(variant).max(1) as f64 / n.max(1) as f64).ln().abs();
    let nearest = |family: &VariantFamily<'a>, n: usize| {
        family.variants.iter().copied().min_by(|a, b| ratio(a, n).total_cmp(&ratio(b, n)))
    };
    let variants_near = |n: usize| families.iter().filter_map(|family| nearest(family, n)).collect::<Vec<_>>();
    // A method without Gaussians has no number.
    let has_gaussians = |variant: &&StudyVariant| count(variant) > 0;
    let spread =
        |n: usize| variants_near(n).into_iter().filter(has_gaussians).map(|variant| ratio(variant, n)).sum::<f64>();
    let mut counts: Vec<usize> = setting.variants.iter().map(count).filter(|&n| n > 0).collect();
    counts.sort_unstable();
    let common = counts.into_iter().min_by(|&a, &b| spread(a).total_cmp(&spread(b)));
    variants_near(common.unwrap_or(1))
}

/// Returns the setting with these variants only, in its order.
fn keep(setting: &Setting, variants: &[&StudyVariant]) -> Setting {
    let is_kept = |variant: &&StudyVariant| variants.iter().any(|kept| kept.label == variant.label);
    let variants = setting.variants.iter().filter(is_kept).cloned().collect();
    Setting { title: setting.title.clone(), simulated: setting.simulated, variants }
}

/// Returns the variants whose label, or whose method, is one of the `chosen` names; all if no name fits this setting.
fn chosen_variants<'a>(setting: &'a Setting, chosen: &[String]) -> Vec<&'a StudyVariant> {
    let families = VariantFamily::group(setting);
    let variants = |family: &VariantFamily<'a>| {
        let is_chosen = |variant: &&StudyVariant| chosen.iter().any(|name| is_name(name, family, variant));
        family.variants.iter().copied().filter(is_chosen).collect::<Vec<_>>()
    };
    let selected: Vec<&StudyVariant> = families.iter().flat_map(variants).collect();
    if selected.is_empty() { setting.variants.iter().collect() } else { selected }
}

/// Returns whether `name` is the label of `variant`, with or without the axis that figures omit, or its method.
fn is_name(name: &str, family: &VariantFamily<'_>, variant: &StudyVariant) -> bool {
    let without_axis = variant.label.split_once(' ').map(|(_, value)| value);
    [variant.label.as_str(), &family.name, &family.title].contains(&name) || without_axis == Some(name)
}

/// Returns the variants of at most [`CURVES`] methods, those whose best variant is best by the first metric.
/// Methods of `references` come first.
fn best_methods<'a>(setting: &'a Setting, references: &[&str]) -> Vec<&'a StudyVariant> {
    let best = |family: &VariantFamily<'_>| {
        family.variants.iter().map(|variant| cost(setting, variant)).fold(f64::INFINITY, f64::min)
    };
    let mut families = VariantFamily::group(setting);
    families.sort_by(|a, b| best(a).total_cmp(&best(b)));
    families.sort_by_key(|family| !has_label(family, references));
    families.into_iter().take(CURVES).flat_map(|family| family.variants).collect()
}

/// Returns whether a variant of the method has one of the `labels`.
pub(super) fn has_label(family: &VariantFamily<'_>, labels: &[&str]) -> bool {
    family.variants.iter().any(|variant| labels.contains(&variant.label.as_str()))
}

/// Returns the variant of each method that is best by the first metric.
fn best_variants(setting: &Setting) -> Vec<&StudyVariant> {
    let by_cost = |a: &&StudyVariant, b: &&StudyVariant| cost(setting, a).total_cmp(&cost(setting, b));
    let families = VariantFamily::group(setting);
    families.iter().filter_map(|family| family.variants.iter().copied().min_by(by_cost)).collect()
}

/// Returns the mean of the first metric as a cost: smaller is better, infinite without scores.
fn cost(setting: &Setting, variant: &StudyVariant) -> f64 {
    let headline = setting.headline();
    variant.score(headline.key).map_or(f64::INFINITY, |score| headline.cost(score.mean))
}

/// Returns whether a baseline is an oracle baseline in any run.
pub(super) fn is_oracle(setting: &Setting, name: &str) -> bool {
    setting.runs().any(|run| run.scores.table.oracles.iter().any(|oracle| oracle == name))
}

/// Lists the baselines with a curve, each as its index in [`Setting::baselines`] and its name, by index: predictions of other
/// programs, and the [`GREY_CURVES`] best others by the first metric. Oracle baselines rank last.
pub(super) fn grey_baselines(setting: &Setting) -> Vec<(usize, &str)> {
    let headline = setting.headline();
    let indexed = setting.baselines().into_iter().enumerate();
    let (mut shown, others): (Vec<_>, Vec<_>) = indexed.partition(|(_, name)| setting.is_external(name));
    let rank = |(k, name)| {
        let cost = headline.cost(setting.baseline_score(name, headline.key).unwrap_or(f64::NAN));
        (is_oracle(setting, name), cost, (k, name))
    };
    let mut ranked: Vec<_> = others.into_iter().map(rank).collect();
    ranked.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    shown.extend(ranked.into_iter().take(GREY_CURVES).map(|(.., baseline)| baseline));
    shown.sort_unstable();
    shown
}

/// Checks the names that `--variants` gives: each is a variant or a method of a setting, and they are few enough.
///
/// # Errors
/// An unknown name, with the nearest one; more names than curves.
pub(in super::super) fn check_variants(settings: &[Setting], chosen: &[String]) -> Result<()> {
    if chosen.len() > CURVES {
        return Err(Error::Config(format!("--variants: {} names; a figure has at most {CURVES} curves", chosen.len())));
    }
    let families: Vec<VariantFamily<'_>> = settings.iter().flat_map(VariantFamily::group).collect();
    let labels = families.iter().flat_map(|family| family.variants.iter().map(|variant| variant.label.as_str()));
    let names = distinct(labels.chain(families.iter().map(|family| family.title.as_str())));
    let is_known = |name: &&String| {
        families.iter().any(|family| family.variants.iter().any(|variant| is_name(name, family, variant)))
    };
    match chosen.iter().find(|name| !is_known(name)) {
        None => Ok(()),
        Some(name) => {
            let hint = did_you_mean(name, names.iter().copied());
            Err(Error::Config(format!(
                "--variants: no variant or method `{name}`{hint} (found `{}`)",
                names.join("`, `")
            )))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a setting of variants with these labels, without runs.
    fn setting(labels: &[&str]) -> Setting {
        let variant = |label: &&str| StudyVariant { label: (*label).into(), axes: Vec::new(), runs: Vec::new() };
        Setting { title: "t".into(), simulated: false, variants: labels.iter().map(variant).collect() }
    }

    #[test]
    fn names_of_variants_and_methods_are_checked() {
        let setting = [setting(&["masks λ 1", "masks λ 2", "WRF-GS"])];
        let check = |names: &[&str]| {
            let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
            check_variants(&setting, &names).map_err(|e| e.to_string())
        };
        assert_eq!(check(&["masks", "WRF-GS"]), Ok(()));
        assert_eq!(check(&["masks λ 2"]), Ok(()));
        assert_eq!(check(&["λ 2"]), Ok(()), "as in figures, without the axis");
        assert!(check(&["mask"]).unwrap_err().contains("no variant or method `mask`; did you mean `masks`?"));
        assert!(check(&["masks"; 7]).unwrap_err().contains("7 names; a figure has at most 6 curves"));
    }

    #[test]
    fn extremes_begin_with_the_first_and_end_with_the_last() {
        let numbers = [1, 2, 3, 4];
        assert_eq!(
            [1, 2, 3, 4, 9].map(|count| evenly_with_ends(&numbers, count)),
            [vec![1], vec![1, 4], vec![1, 2, 4], numbers.into(), numbers.into()]
        );
        assert!(evenly_with_ends(&numbers[..0], 2).is_empty());
    }

    #[test]
    fn labels_of_curves_lack_common_parts() {
        let relabel = |labels: &[&str]| {
            let mut variants = setting(labels).variants;
            let common = remove_common_parts(&mut variants);
            (variants.into_iter().map(|variant| variant.label).collect::<Vec<_>>(), common)
        };
        let (labels, common) = relabel(&["method A, N 24, seed x", "method B, N 24, seed x"]);
        assert_eq!((labels, common.as_str()), (vec!["A".into(), "B".into()], "N 24, seed x"));
        assert_eq!(relabel(&["λ 0.1, row a", "λ 0.2, row a"]).0, ["λ 0.1", "λ 0.2"], "a number keeps its name");
        assert_eq!(relabel(&["method A, N 8", "method A, N 24", "method B, N 8"]).0, ["A, N 8", "A, N 24", "B, N 8"]);
        assert_eq!(relabel(&["a, N 24"]), (vec!["a, N 24".to_owned()], String::new()), "one has nothing in common");
        assert_eq!(relabel(&["a", "a, b"]).1, "", "none without a name");
    }

    #[test]
    fn chosen_names_select_variants_and_whole_methods() {
        let setting = setting(&["masks λ 1", "masks λ 2", "WRF-GS", "blending 8"]);
        let labels = |names: &[&str]| -> Vec<String> {
            let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
            chosen_variants(&setting, &names).into_iter().map(|variant| variant.label.clone()).collect()
        };
        assert_eq!(labels(&["masks"]), ["masks λ 1", "masks λ 2"]);
        assert_eq!(labels(&["masks λ 2", "WRF-GS"]), ["masks λ 2", "WRF-GS"]);
        assert_eq!(labels(&["of another setting"]).len(), 4);
    }
}
