use super::super::comparison::Comparison;
use super::super::reference::Reference;
use super::panels::spectra_columns;
use super::shown::one_variant_per_method;
use super::tradeoff::method_lines;
use super::{Figure, FigureSet, differences, draw_figures, gaussians};
use crate::canvas::outside;
use crate::draw::charts::LineName;
use crate::page;
use pwrfgs_experiment::{
    NoopObserver, PageBuilder, ParetoComparison, RunOutcome, Session, Study, StudyVariant, read_pipeline, run,
};
use std::path::{Path, PathBuf};

const PIPELINE: &str = "Pipeline(
    name: \"small\",
    data: Teacher(gaussians: 4, samples: 24, width: 24, height: 8),
    split: Official(validation: 0.2),
    initializer: Grid(count: 8),
    deformation: Mlp(depth: 2, width: 8, skip: None),
    baselines: [MeanSpectrum(), NearestNeighbours(k: 1)],
    pruners: [],
    training: (
        steps: 6, batch: 2, densify_until: 2, prune_until: 4, prune_every: 1, validate_every: 2, checkpoint_every: 6,
        densify: (every: 5, from: 1),
    ),
)";

/// Trains a run with some initial Gaussians; the run `Grid 8` has a page.
fn trained(folder: &Path, name: &str, count: usize) -> PathBuf {
    trained_for(folder, name, count, 6)
}

/// Trains as [`trained`], for this number of steps.
fn trained_for(folder: &Path, name: &str, count: usize, steps: usize) -> PathBuf {
    let (file, out) = (folder.join("p.ron"), folder.join(name));
    std::fs::write(&file, PIPELINE).unwrap();
    let set = [format!("initializer=Grid(count: {count})"), format!("training.steps={steps}")];
    let mut observer = NoopObserver;
    let mut session = Session { page: (count == 8).then_some(page as PageBuilder), ..Session::new(&mut observer) };
    let pipeline = read_pipeline(&file, &set).unwrap();
    let outcome = run(&pipeline, Path::new(""), &out, &mut session).unwrap();
    assert!(matches!(outcome, RunOutcome::Finished { .. }));
    out
}

#[test]
fn text_stays_on_its_canvas_and_each_strategy_is_one_curve() {
    let folder = tempfile::tempdir().unwrap();
    let names =
        ["Grid 8", "Grid 12", "a strategy with a long name 8", "a strategy with a long name 12", "mask", "none"];
    let counts = [8, 12, 9, 13, 6, 5];
    let runs: Vec<PathBuf> = names.iter().zip(counts).map(|(name, n)| trained(folder.path(), name, n)).collect();
    let html = std::fs::read_to_string(runs[0].join("report.html")).unwrap();
    assert!(html.contains("Error by position") && html.contains(">1 − SSIM = 0<"), "maps of the errors of spectra");
    let (pages, texts) = outside::take();
    assert!(pages > 6 && texts.is_empty(), "{pages} drawings on the pages of runs: {texts:#?}");
    for (count, curves) in [(1, 1), (2, 1), (6, 4)] {
        let mut study = Study::read(&runs[..count]).unwrap();
        for (variant, name) in study.settings[0].variants.iter_mut().zip(names) {
            variant.label = name.into();
            variant.runs[0].scores.table.notes.clear(); // on times, which other load of this machine may cause
        }
        assert_eq!(study.settings[0].variants.len(), count);
        let lines = method_lines(&study.settings[0], "ssim");
        let points = lines.iter().map(|line| line.points.len()).sum::<usize>();
        assert_eq!((lines.len(), points), (curves, count), "one curve per strategy");
        if count == 6 {
            let setting = &study.settings[0];
            let shown: Vec<&str> =
                one_variant_per_method(setting).into_iter().map(|variant| variant.label.as_str()).collect();
            assert_eq!(shown, ["Grid 8", "a strategy with a long name 8", "mask", "none"], "each method once");
            let data = setting.variants[0].runs[0].load_data(&mut NoopObserver).unwrap();
            let columns = spectra_columns(setting, &one_variant_per_method(setting), &data).unwrap();
            let names: Vec<&str> = columns.iter().map(|column| column.label.as_str()).collect();
            assert!(names[..2].iter().all(|name| setting.baselines().contains(name)), "{names:?}");
            assert_eq!(names[2..], shown, "baselines first");
            let over_steps = gaussians::variant_lines(setting, 6.0);
            let named = |name_of: fn(&LineName) -> Option<&String>| -> Vec<&str> {
                over_steps.iter().filter_map(|line| name_of(&line.name)).map(String::as_str).collect()
            };
            let legend = named(|name| if let LineName::Legend(name) = name { Some(name) } else { None });
            assert_eq!(legend, ["Grid", "a strategy with a long name", "mask", "none"], "each method once");
            let at_ends = named(|name| if let LineName::AtEnd(name) = name { Some(name) } else { None });
            assert_eq!(at_ends, ["8", "12", "8", "12"], "variants by their numbers");
        }
        let drawn = draw_figures(&study.settings[0], &[], &[], &|_, _| {});
        assert_eq!(drawn.left_out, None);
        let (written, texts) = outside::take();
        assert!(written == drawn.figures.len() && texts.is_empty(), "{count} variants: {texts:#?}");
        for stem in ["gaussians", "ssim-n", "eta-n", "latency", "distance", "room", "spectra", "eta-snr"] {
            assert!(drawn.figures.iter().any(|Figure { name, .. }| name == stem), "{stem} of {count} variants");
        }
        let room = |drawn: &FigureSet| drawn.figures.iter().find(|figure| figure.name == "room").unwrap().clone();
        let is_best = " Of each method, the variant with the best SSIM is shown. Variants that are not shown: 2;";
        assert_eq!(room(&drawn).caption.contains(is_best), count == 6, "{}", room(&drawn).caption);
        let mut svg_of = |simulated: bool, chosen: &[String]| {
            study.settings[0].simulated = simulated;
            room(&draw_figures(&study.settings[0], chosen, &[], &|_, _| {})).svg
        };
        assert_ne!(svg_of(true, &[]), svg_of(false, &[]), "a mark on simulated data");
        if count == 6 {
            assert_ne!(svg_of(false, &["Grid".into(), "mask".into()]), svg_of(false, &[]), "all chosen variants");
        }
        outside::take();
    }
}

#[test]
fn trainings_of_other_length_are_other_strategies() {
    let folder = tempfile::tempdir().unwrap();
    let legend = |second: &str, steps: usize| -> Vec<LineName> {
        let runs = [trained(folder.path(), "first", 8), trained_for(folder.path(), second, 12, steps)];
        let mut setting = Study::read(&runs).unwrap().settings.remove(0);
        for (variant, label) in setting.variants.iter_mut().zip(["Grid 8", "Grid 12"]) {
            variant.label = label.into();
        }
        method_lines(&setting, "ssim").into_iter().map(|line| line.name).collect()
    };
    assert_eq!(legend("same", 6), [LineName::Legend("Grid".into())]);
    assert_eq!(legend("longer", 9), ["Grid 8, 6 steps", "Grid 12, 9 steps"].map(|name| LineName::Legend(name.into())));
}

#[test]
fn best_of_several_variants_at_one_number_is_ranked() {
    let folder = tempfile::tempdir().unwrap();
    let runs = [8, 12].map(|n| trained(folder.path(), &n.to_string(), n));
    let mut setting = Study::read(&runs).unwrap().settings.remove(0);
    let [few, many] = [0, 1].map(|k| setting.variants[k].clone());
    let named = |variant: &StudyVariant, label: String| StudyVariant { label, ..variant.clone() };
    setting.variants = ["a", "b", "c", "d"]
        .iter()
        .flat_map(|m| [named(&few, format!("{m} 8")), named(&many, format!("{m} 12"))])
        .collect();
    assert!(!ParetoComparison::of(&setting).unwrap().has_several_at_one);
    let mut other = named(&many, "b 9".into());
    other.runs[0].facts.gaussians = 8;
    setting.variants.push(other);
    let pareto = ParetoComparison::of(&setting).unwrap();
    let scores = [&few, &many].map(|variant| variant.score("ssim").unwrap().mean);
    let b = pareto.families.iter().find(|family| family.name == "b").unwrap();
    assert_eq!(b.results[0].unwrap().0.mean, scores[0].max(scores[1]));
    assert!(pareto.has_several_at_one && pareto.numbers == [8, 12]);
}

#[test]
fn reference_is_one_row_or_one_per_setting_of_the_other_axes() {
    let folder = tempfile::tempdir().unwrap();
    let counts = [6, 7, 8, 9];
    let runs: Vec<PathBuf> = counts.map(|n| trained(folder.path(), &format!("Grid {n}"), n)).into();
    let mut study = Study::read(&runs).unwrap();
    let labels = ["pruner A, N 6", "pruner B, N 6", "pruner A, N 8", "pruner B, N 8"];
    for (variant, label) in study.settings[0].variants.iter_mut().zip(labels) {
        let axes = label.split(", ").map(|part| part.split_once(' ').unwrap());
        variant.axes = axes.map(|(axis, value)| (axis.to_owned(), value.to_owned())).collect();
        variant.label = label.into();
    }
    let comparison = Comparison::new(&study.settings[0]);
    let pairs = |label| -> Vec<[&str; 2]> {
        let reference = Reference::find(&comparison, label).unwrap();
        reference.differences(&comparison).iter().map(|d| [d.row.label, d.reference.label]).collect()
    };
    assert_eq!(pairs("A"), [[labels[1], labels[0]], [labels[3], labels[2]]], "baselines have no N");
    assert_eq!(pairs("pruner B"), [[labels[0], labels[1]], [labels[2], labels[3]]]);
    let others = [labels[0], labels[1], labels[3], "mean spectrum", "1-NN"];
    assert_eq!(pairs(labels[2]), others.map(|label| [label, labels[2]]));
    assert_eq!(pairs("A, N 8"), pairs(labels[2]), "without its first axis");
    assert!(Reference::find(&comparison, "C").is_none());
    let reference = Reference::find(&comparison, "A").unwrap();
    let figure =
        differences::figure(&study.settings[0], ("ssim", "SSIM"), &reference, &reference.differences(&comparison));
    let figure = figure.unwrap();
    assert!(figure.caption.contains("minus A at equal other settings"), "{}", figure.caption);
    assert!(outside::take().1.is_empty());
}

#[test]
fn notes_name_their_variant_and_leave_out_widths_that_differ_by_model() {
    let folder = tempfile::tempdir().unwrap();
    let mut study = Study::read(&[trained(folder.path(), "Grid 6", 6)]).unwrap();
    let kriging = "90 % intervals of Kriging: mean width 0.22 (0.23 at the coverage of model); 84 %";
    let unsteady = "latency_total_ms of model: not steady: half of the predictions take 1 to 9 ms";
    let notes = ["90 % intervals of model: mean width 0.2", kriging, "validation SSIM was best at step 2", unsteady];
    study.settings[0].variants[0].label = "mask".into();
    study.settings[0].variants[0].runs[0].scores.table.notes = notes.map(str::to_owned).into();
    let expected = [
        "90 % intervals of mask: mean width 0.2",
        "90 % intervals of Kriging: mean width 0.22; 84 %",
        "mask: validation SSIM was best at step 2",
    ];
    let comparison = Comparison::new(&study.settings[0]);
    assert_eq!(comparison.notes(), expected);
    assert!(comparison.unsteady_times_warning().unwrap().contains("other load in 1 of 1 runs"));
    let drawn = draw_figures(&study.settings[0], &[], &[], &|_, _| {});
    assert!(drawn.figures.iter().all(|figure| figure.name != "latency"), "times that mislead are not drawn");
    outside::take();
}
