//! The figures that compare runs, drawn from small runs.

use crate::common::pipeline;
use pwrfgs::experiment::sweep::{ListedRun, Listing};
use pwrfgs::prelude::*;
use pwrfgs::report::{ReportOptions, Study, figures};
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// What would be a picture from elsewhere and a program, if anything took a label for more than text.
const HOSTILE: &str = "\"/><image href=\"file:///etc/passwd\"/><script>alert('1')</script>\u{1b}[2J|`\\%\n&x;";

/// Two weights of the mask loss, one with a hostile label, two seeds each, in a sweep folder.
fn sweep(folder: &Path) {
    let mut runs = Vec::new();
    for (lambda, label) in [("0.0", "0"), ("0.1", HOSTILE)] {
        for seed in 0..2 {
            let pipeline = pipeline(&format!(
                "seed: {seed}, data: Teacher(gaussians: 6, samples: 60, width: 90, height: 24),
                 split: Random(test: 0.5), initializer: Grid(count: 30),
                 deformation: Mlp(depth: 2, width: 8, skip: None, tx_hidden: 8, tx_features: 4),
                 pruners: [LearnableMask(lambda: {lambda}, learning_rate: 0.6)],
                 training: (steps: 20, batch: 2, densify_until: 5, prune_until: 15, prune_every: 5, validate_every: 0),
                 baselines: [MeanSpectrum(), NearestNeighbours(k: 1)]",
            ));
            let name = format!("{lambda}-{seed}");
            let stop = AtomicBool::new(false);
            pwrfgs::run(&pipeline, Path::new("."), &folder.join(&name), &mut NoopObserver, &stop).unwrap();
            runs.push(ListedRun { folder: name, labels: vec![("lambda".into(), label.into())], seed });
        }
    }
    Listing { name: "lambda".into(), runs }.write(folder).unwrap();
}

#[test]
fn figures_are_self_contained() {
    let folder = tempfile::tempdir().unwrap();
    sweep(folder.path());
    let mut study = Study::read(&[folder.path().into()]).unwrap();
    assert_eq!((study.settings.len(), study.settings[0].variants.len()), (1, 2));
    // Notes on times, which other load of this machine may cause.
    for run in study.settings[0].variants.iter_mut().flat_map(|variant| &mut variant.runs) {
        run.scores.table.notes.clear();
    }
    let figures = figures::draw_figures(&study.settings[0], &[], &[], &|_, _| {}).figures;
    let names: Vec<&str> = figures.iter().map(|f| f.name.as_str()).collect();
    assert_eq!(names, ["gaussians", "ssim-n", "eta-n", "latency", "distance", "room", "spectra", "eta-snr"]);
    for figure in &figures {
        let name = &figure.name;
        assert!(figure.svg.contains("mm\"") && !figure.svg.contains("<text"), "{name}");
        let drawn = without_pictures(&figure.svg);
        assert!(!drawn.contains("NaN") && !drawn.contains("inf"), "{name}");
        well_formed(&figure.svg);
        assert!(figure.png.starts_with(b"\x89PNG"), "{name}");
        assert!(figure.pdf.starts_with(b"%PDF-1.4\n") && figure.pdf.ends_with(b"%%EOF\n"), "{name}");
        assert!(figure.caption.ends_with('.') && !figure.title.is_empty(), "{name}: {}", figure.caption);
        figure.write(folder.path()).unwrap();
        assert_eq!(std::fs::read(folder.path().join(format!("{name}.png"))).unwrap(), figure.png);
        assert_eq!(std::fs::read(folder.path().join(format!("{name}.pdf"))).unwrap(), figure.pdf);
    }
    published_numbers_belong_to_s23(study);
    labels_stay_text(folder.path());
}

/// The text of an SVG without the pictures embedded in it, whose letters may spell anything.
fn without_pictures(svg: &str) -> String {
    let mut parts = svg.split("base64,");
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |text, part| text + part.split_once('"').expect("a picture ends with a quote").1)
}

/// Whether every element ends, every attribute is quoted, and nothing comes from outside.
fn well_formed(svg: &str) {
    let mut open: Vec<&str> = Vec::new();
    for part in svg.split('<').skip(1) {
        let (tag, text) = part.split_once('>').expect("a tag ends");
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop(), Some(name));
        } else {
            assert!(tag.matches('"').count().is_multiple_of(2), "{tag}");
            let name = tag.split([' ', '/']).next().unwrap_or_default();
            assert!(["svg", "g", "path", "circle", "image", "text"].contains(&name), "<{tag}>");
            assert!(tag.matches("href").count() == tag.matches(" href=\"data:image/png;base64,").count(), "{tag}");
            open.extend((!tag.ends_with('/')).then_some(name));
        }
        assert!(text.is_empty() || open.last() == Some(&"text"), "text in {open:?}: {text}");
        assert!(!text.contains(['"', '\'']), "{text}");
    }
    assert!(open.is_empty(), "{open:?}");
}

/// Stars stand where measured data call themselves s23, and nowhere else.
fn published_numbers_belong_to_s23(mut study: Study) {
    let mut has_stars = |simulated: bool, name: &str| {
        let setting = &mut study.settings[0];
        setting.simulated = simulated;
        setting.variants.iter_mut().flat_map(|v| &mut v.runs).for_each(|run| run.facts.data = name.into());
        let drawn = figures::draw_figures(setting, &[], &[], &|_, _| {});
        assert!(drawn.left_out.unwrap().ends_with("the data have changed since this run; run it again."));
        drawn.figures.iter().find(|f| f.name == "ssim-n").unwrap().caption.contains("stars")
    };
    assert!(has_stars(false, "s23 (measured, NeRF2 layout)"));
    for (simulated, name) in [(true, "s23 (NeRF2 layout)"), (false, "s230 (measured)")] {
        assert!(!has_stars(simulated, name), "{name}");
    }
}

/// Whatever a label holds, pages and documents show it and nothing obeys it.
fn labels_stay_text(folder: &Path) {
    let (study, out) = (Study::read(&[folder.into()]).unwrap(), folder.join("report"));
    let message = pwrfgs::report::write(&study, &ReportOptions::default(), &out, &mut NoopObserver).unwrap();
    assert!(!message.contains('\u{1b}') && message.contains("<script>"), "a terminal gets the words alone: {message}");
    let read = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
    let html = read("report.html");
    assert!(
        html.contains("&quot;/&gt;&lt;image href=&quot;file:///etc/passwd&quot;/&gt;&lt;script&gt;alert(&#39;1&#39;)")
    );
    for (name, raw) in [("report.html", "<script"), ("report.html", "<image"), ("report.html", "\u{1b}")] {
        assert!(!read(name).contains(raw), "{name} holds {raw}");
    }
    let latex = read("tables/1-scores.tex");
    assert!(latex.contains("{[}U+001B{]}{[}2J\\textbar{}\\textasciigrave{}\\textbackslash{}\\% \\&x;"), "{latex}");
    for run in ["0.0-0", "0.1-1"] {
        let page = std::fs::read_to_string(folder.join(run).join("report.html")).unwrap();
        page.split("<svg ")
            .skip(1)
            .for_each(|svg| well_formed(&format!("<svg {}</svg>", svg.split_once("</svg>").unwrap().0)));
    }
}
