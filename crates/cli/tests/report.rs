//! `pwrfgs report` of small runs: files, numbers against those of the runs, and errors.
use crate::common::{SMALL, files, refuse, stdout, succeed, write};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const RUNS: [&str; 6] =
    ["runs/whole-0", "runs/whole-1", "runs/half_grid-0", "runs/half_grid-1", "runs/other-0", "runs/other-1"];

/// Two variants of two seeds, one of them on another split too, and a run that has not finished.
fn runs(here: &Path) {
    write(&here.join("small.ron"), SMALL.replace("steps: 60", "steps: 40"));
    for run in RUNS {
        let seed = format!("seed={}", run.chars().last().unwrap());
        let mut arguments = vec!["run", "small.ron", "-q", "--out", run, "--set", &seed];
        if run.contains("half_grid") {
            arguments.extend(["--set", "initializer=Grid(count: 4)"]);
        }
        if run.contains("other") {
            arguments.extend(["--set", "split=Random(test: 0.3)"]);
        }
        succeed(here, &arguments);
    }
    let begun = std::fs::read(here.join(RUNS[0]).join("pipeline.ron")).unwrap();
    write(&here.join("runs/begun/pipeline.ron"), begun);
}

/// The rows of a CSV file, by the names of their columns.
fn rows(text: &str) -> Vec<BTreeMap<String, String>> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    reader.deserialize().map(|row| row.unwrap()).collect()
}

/// SSIM of a predictor in `scores.csv`, by test id.
fn ssim(run: &Path, predictor: &str) -> BTreeMap<String, f64> {
    rows(&std::fs::read_to_string(run.join("scores.csv")).unwrap())
        .iter()
        .filter(|row| row["predictor"] == predictor && row["metric"] == "ssim")
        .map(|row| (row["sample"].clone(), row["value"].parse().unwrap()))
        .collect()
}

/// Arithmetic mean.
fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let n = values.len() as f64;
    values.sum::<f64>() / n
}

#[test]
fn report_compares_runs() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    runs(here);
    let arguments: Vec<&str> = ["report", "-q"].into_iter().chain(RUNS).chain(["runs/begun", RUNS[0]]).collect();
    let message = stdout(&succeed(here, &arguments));
    for words in
        ["simulated", "whole", "half_grid", "3-NN (baseline)", "±", "Δ SSIM", "left out: runs/begun: not finished"]
    {
        assert!(message.contains(words), "`{words}` is not in: {message}");
    }
    assert!(message.ends_with("report: runs/whole-0/report/report.html\n"), "{message}");

    let out = here.join(RUNS[0]).join("report");
    let first = files(&out);
    let text = |name: &str| String::from_utf8(first[&out.join(name)].clone()).unwrap();
    numbers_are_those_of_the_runs(here, &text("report.csv"));
    let html = text("report.html");
    for outside in ["src=\"http", "href=\"http", "<link", "<script", "url("] {
        assert!(!html.contains(outside), "the page needs {outside}");
    }
    assert!(html.contains("simulated") && html.contains("<b>") && html.contains("half_grid-1</td>"));
    let latex = text("report.tex");
    for table in ["scores", "differences", "latency"] {
        assert!(latex.contains(&format!("\\input{{tables/1-{table}}}")), "{latex}");
        assert!(text(&format!("tables/1-{table}.tex")).contains("\\bottomrule"));
    }
    assert!(text("tables/1-scores.tex").contains("half\\_grid & "));
    latex_has_the_chosen_columns(here);

    replaced(here, &arguments, &out, &first);
    wrong_input_is_refused(here);
}

/// `--columns` selects the columns of the table of scores, and `--variants` the curves of the figures.
fn latex_has_the_chosen_columns(here: &Path) {
    let report = |options: &[&'static str]| [&["report", "-q", RUNS[0], RUNS[2], "--out", "chosen"], options].concat();
    succeed(here, &report(&["--columns", "gaussians,ssim.median", "--variants", "half_grid-0"]));
    let text = |name: &str| std::fs::read_to_string(here.join("chosen").join(name)).unwrap();
    let table = text("tables/1-scores.tex");
    assert!(table.contains("\\begin{tabular}{lrr}") && table.contains(" & median"), "{table}");
    assert!(table.find("{N ").unwrap() < table.find("{SSIM ").unwrap(), "in this order: {table}");
    assert!(text("report.html").contains("10th percentile"), "the page has all columns");
    let hidden = "Variants that are not shown: 1; `pwrfgs report --variants` selects them.";
    assert!(text("report.html").contains(hidden), "captions say what is left out");
    assert!(text("figures/1-distance.svg").len() > 500);
    refuse(here, &report(&["--columns", "ssin"]), 2, &["--columns: no column `ssin`; did you mean `ssim`?", ".median"]);
    refuse(here, &report(&["--columns", "gaussians.median"]), 2, &["no column `gaussians.median`"]);
    refuse(here, &report(&["--variants", "half_grid"]), 2, &["no variant or method `half_grid`", "`half_grid-0`"]);
}

/// Means, deviations and differences again, from the runs' own files.
fn numbers_are_those_of_the_runs(here: &Path, report: &str) {
    let rows = rows(report);
    let find = |variant: &str, statistic: &str| {
        let is = |row: &&BTreeMap<String, String>| {
            row["variant"] == variant && row["metric"] == "ssim" && row["statistic"] == statistic
        };
        let found = rows.iter().find(is).unwrap_or_else(|| panic!("{variant} {statistic}"));
        let number = |name: &str| found[name].parse::<f64>().unwrap_or(f64::NAN);
        ["value", "std", "n", "low", "high"].map(number)
    };
    let near = |a: f64, b: f64| (a - b).abs() < 1e-12;
    let of = |variant: &str, predictor: &str| {
        [0, 1].map(|seed| ssim(&here.join(format!("runs/{variant}-{seed}")), predictor))
    };
    let (whole, half_grid, floor) = (of("whole", "model"), of("half_grid", "model"), of("whole", "3-NN"));
    let means = |seeds: &[BTreeMap<String, f64>; 2]| [0, 1].map(|s| mean(seeds[s].values().copied()));
    let [a, b] = means(&whole);
    let [value, std, n, ..] = find("whole", "mean");
    assert!(near(value, f64::midpoint(a, b)) && near(std, (a - b).abs() / 2f64.sqrt()) && n == 2.0, "{value} {std}");
    // The split is the same for both seeds, so a floor has the same numbers twice, and no deviation.
    let [value, std, n, ..] = find("3-NN", "mean");
    assert!(near(value, means(&floor)[0]) && std.is_nan() && n == 2.0, "{value} {std}");
    for (variant, scores) in [("half_grid", &half_grid), ("3-NN", &floor)] {
        let [value, _, n, low, high] = find(variant, "difference");
        let paired = [0, 1].map(|s| mean(scores[s].iter().map(|(id, v)| v - whole[s][id])));
        assert!(near(value, f64::midpoint(paired[0], paired[1])) && n == 2.0, "{variant}: {value}");
        assert!(low <= value && value <= high && low < high, "{variant}: {low} {value} {high}");
    }
    assert!(!rows.iter().any(|row| row["variant"] == "whole" && row["statistic"] == "difference"));
    // In the other setting the split depends on the seed, and so do the floors.
    let other = |row: &&BTreeMap<String, String>| row["setting"].contains("Random") && row["kind"] == "baseline";
    let floor = rows.iter().filter(other).find(|row| row["variant"] == "3-NN" && row["metric"] == "ssim").unwrap();
    let [a, b] = [0, 1].map(|s| mean(ssim(&here.join(format!("runs/other-{s}")), "3-NN").into_values()));
    let number = |name: &str| floor[name].parse::<f64>().unwrap();
    assert!(a != b && near(number("value"), f64::midpoint(a, b)) && near(number("std"), (a - b).abs() / 2f64.sqrt()));
}

/// The same bytes again; what was there before and is no more goes, what the report has not made stays.
fn replaced(here: &Path, arguments: &[&str], out: &Path, first: &BTreeMap<PathBuf, Vec<u8>>) {
    succeed(here, arguments);
    assert!(files(out) == *first, "the same runs give the same bytes");
    write(&out.join("report.aux"), "of LaTeX");
    let one = ["report", "runs/whole-0", "-q"];
    let message = stdout(&succeed(here, &one));
    let after = files(out);
    assert!(
        after.contains_key(&out.join("report.aux"))
            && after[&out.join("report.html")] != first[&out.join("report.html")],
        "{message}"
    );
    // Another reference, somewhere else.
    let other = ["report", "runs/whole-0", "runs/half_grid-0", "--reference", "3-NN", "--out", "elsewhere/deep"];
    assert!(stdout(&succeed(here, &other)).contains("Paired differences from 3-NN"));
    assert!(here.join("elsewhere/deep/report.html").is_file());
}

fn wrong_input_is_refused(here: &Path) {
    refuse(here, &["report", "runs/whole-0", "--reference", "3-nm"], 2, &["`3-nm`", "did you mean `3-NN`?"]);
    refuse(here, &["report", "runs"], 2, &["runs holds neither a run", "pwrfgs sweep"]);
    refuse(here, &["report", "nowhere"], 2, &["nowhere holds neither a run"]);
    refuse(here, &["report", "small.ron"], 2, &["small.ron holds neither a run"]);
    refuse(here, &["report", "runs/begun"], 2, &["none of these 1 runs has finished"]);
    refuse(here, &["report"], 2, &["RUNS"]);
    write(&here.join("thesis/chapter.tex"), "mine");
    refuse(here, &["report", "runs/whole-0", "--out", "thesis"], 2, &["`chapter.tex`", "--out"]);
    refuse(here, &["report", "runs/whole-0", "--out", "small.ron"], 2, &["not a folder"]);
    assert_eq!(std::fs::read(here.join("thesis/chapter.tex")).unwrap(), b"mine");
    damaged_runs_are_told(here);
    // A folder that does not know its files, as those of earlier versions: what can be told without is told.
    let facts = std::fs::read_to_string(here.join("runs/half_grid-1/run.json")).unwrap();
    let mut facts: serde_json::Value = serde_json::from_str(&facts).unwrap();
    facts["files"] = serde_json::json!({});
    write(&here.join("runs/half_grid-1/run.json"), facts.to_string());
    write(&here.join("runs/half_grid-1/scores.csv"), "predictor,metric,sample,value\nmodel,ssim,x,1\n");
    refuse(here, &["report", "runs/half_grid-1"], 2, &["scores.csv:2:", "`x` is not a number"]);
}

/// Whatever has happened to a file of a finished run, `report` says to which, and makes none without its numbers.
fn damaged_runs_are_told(here: &Path) {
    type Damage<'a> = &'a dyn Fn(&str) -> String;
    let run = here.join("runs/whole-1");
    let last = |text: &str| text.trim_end().rsplit_once('\n').unwrap().0.to_owned() + "\n";
    let header = |text: &str| text.lines().next().unwrap().to_owned() + "\n";
    let changed = |text: &str| text.replacen("model,ssim,", "model,ssim,9", 1);
    let floors =
        |text: &str| text.lines().filter(|line| !line.starts_with("3-NN")).map(|l| l.to_owned() + "\n").collect();
    let empty = |_: &str| String::new();
    let half = |text: &str| text[..text.len() / 2].to_owned();
    let digit = |text: &str| text.trim_end().to_owned();
    let damages: [(&str, &[Damage<'_>]); 5] = [
        ("scores.csv", &[&empty, &header, &half, &last, &digit, &changed, &floors]),
        ("samples.csv", &[&empty, &header, &half, &last, &digit]),
        ("curve.csv", &[&empty, &header, &half, &last, &digit]),
        ("run.json", &[&empty, &half]),
        ("model.safetensors", &[&empty]),
    ];
    for (name, damages) in damages {
        let whole = std::fs::read(run.join(name)).unwrap();
        for damage in damages {
            write(&run.join(name), damage(&String::from_utf8_lossy(&whole)));
            refuse(here, &["report", "runs/whole-1", "-q"], 2, &[name]);
        }
        write(&run.join(name), &whole);
    }
    succeed(here, &["report", "runs/whole-1", "-q", "--out", "again"]);
    // A link in the report's folder would lead out of it.
    #[cfg(unix)]
    {
        std::fs::remove_dir_all(here.join("again/figures")).unwrap();
        write(&here.join("mine/1-room.svg"), "mine");
        std::os::unix::fs::symlink(here.join("mine"), here.join("again/figures")).unwrap();
        refuse(here, &["report", "runs/whole-1", "-q", "--out", "again"], 2, &["again/figures: symbolic link"]);
        assert_eq!(std::fs::read(here.join("mine/1-room.svg")).unwrap(), b"mine");
    }
}

#[test]
fn runs_with_different_validation_sets_share_table() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("small.ron"), SMALL.replace("steps: 60", "steps: 40"));
    for (run, split) in [
        ("runs/all", "split.validation=0.0"),
        ("runs/held", "split.validation=0.4"),
        ("runs/other", "split=Random(test: 0.3)"),
        ("runs/links", "split=RandomLinks(test: 0.3)"), // fields of the same names, and another split
    ] {
        let neighbours = if run == "runs/held" { 4 } else { 48 };
        let floors = format!("baselines=[MeanSpectrum(), Kriging(neighbours: {neighbours})]");
        let message =
            stdout(&succeed(here, &["run", "small.ron", "-q", "--out", run, "--set", split, "--set", &floors]));
        let heading = message.lines().nth(1).unwrap(); // below the verdict
        let expected = match run {
            "runs/all" => "8 test spectra; model and baselines are trained on the same 32",
            "runs/held" => {
                "8 test spectra; the model is trained on 19; the baselines are trained on 32 (training and validation)"
            }
            _ => {
                "12 test spectra; the model is trained on 25; the baselines are trained on 28 (training and validation)"
            }
        };
        assert_eq!(heading, expected, "{message}");
        let page = std::fs::read_to_string(here.join(run).join("report.html")).unwrap();
        assert!(page.contains(expected), "the page of {run} does not say what was trained on what");
    }
    let message = stdout(&succeed(here, &["report", "-q", "runs/all", "runs/held", "runs/other", "runs/links"]));
    assert_eq!(message.matches("\nScores").count(), 3, "{message}");
    let report = std::fs::read_to_string(here.join("runs/all/report/report.csv")).unwrap();
    let trained: Vec<[String; 4]> = rows(&report)
        .into_iter()
        .filter(|row| row["metric"] == "trained_on")
        .map(|row| ["setting", "variant", "unit", "value"].map(|column| row[column].clone()))
        .collect();
    let data = "40 simulated spectra of 4 Gaussians (Teacher, seed 0)";
    let setting = |split: &str, rows: [&[(&str, &str)]; 2]| {
        let row = |(row, n): &(&str, &str)| [&format!("{data}; {split}"), *row, "spectra", *n].map(str::to_owned);
        rows.concat().iter().map(row).collect::<Vec<_>>()
    };
    let floors = |n| [("mean spectrum", n), ("Kriging", n)];
    let expected = [
        setting(
            "Official(validation: 0.0) and Official(validation: 0.4) of the simulation",
            [&[("all", "32"), ("held", "19")], &floors("32")],
        ),
        setting("Random(test: 0.3, validation: 0.1)", [&[("other", "25")], &floors("28")]),
        setting("RandomLinks(test: 0.3, validation: 0.1)", [&[("links", "25")], &floors("28")]),
    ];
    assert_eq!(trained, expected.concat());
    assert!(message.contains("warning: Kriging differs between the runs of seed 0"), "{message}");
}

/// The end of a run, its page and `run.json` say what `report` says of the same pairs.
#[test]
fn run_reports_differences_from_baselines() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("small.ron"), SMALL.replace("steps: 60", "steps: 40"));
    let floors = "baselines=[MeanSpectrum(), NearestNeighbours(k: 1)]";
    let message = stdout(&succeed(here, &["run", "small.ron", "-q", "--out", "run", "--set", floors]));
    let facts = std::fs::read_to_string(here.join("run/run.json")).unwrap();
    let facts: serde_json::Value = serde_json::from_str(&facts).unwrap();
    let pairs = facts["scores"]["paired"]["rows"].as_array().unwrap();
    let page = std::fs::read_to_string(here.join("run/report.html")).unwrap();
    let own = ssim(&here.join("run"), "model");
    for floor in ["mean spectrum", "1-NN"] {
        let pair = pairs.iter().find(|pair| pair["baseline"] == floor && pair["metric"] == "ssim").unwrap();
        let number = |value: &serde_json::Value| value.as_f64().unwrap();
        let (mean_of_pairs, low, high) =
            (number(&pair["mean"]), number(&pair["interval"][0]), number(&pair["interval"][1]));
        let expected = mean(ssim(&here.join("run"), floor).iter().map(|(id, value)| own[id] - value));
        assert!((mean_of_pairs - expected).abs() < 1e-12 && low <= mean_of_pairs && mean_of_pairs <= high);
        // The same interval in the report of this run alone.
        succeed(here, &["report", "-q", "run", "--reference", floor]);
        let report = rows(&std::fs::read_to_string(here.join("run/report/report.csv")).unwrap());
        let is = |row: &&BTreeMap<String, String>| {
            row["kind"] == "variant" && row["metric"] == "ssim" && row["statistic"] == "difference"
        };
        let found = report.iter().find(is).unwrap();
        let near = |column: &str, value: f64| (found[column].parse::<f64>().unwrap() - value).abs() < 1e-12;
        assert!(near("value", mean_of_pairs) && near("low", low) && near("high", high), "{pair} {found:?}");
        let verdict = if low <= 0.0 && 0.0 <= high {
            "level"
        } else if mean_of_pairs > 0.0 {
            "better"
        } else {
            "worse"
        };
        let line = message.lines().find(|line| line.starts_with(floor)).unwrap_or_else(|| panic!("{message}"));
        assert!(line.contains(verdict) && page.contains(&format!("<td>{verdict}</td>")), "{line}");
    }
    // Elsewhere tested, it is still trained on what its run says.
    let other = "data=Teacher(seed: 3, width: 48, height: 12, samples: 20)";
    let message = stdout(&succeed(here, &["evaluate", "-q", "run/model.safetensors", "--set", other]));
    let heading =
        "4 test spectra; the model is trained on 26; the baselines are trained on 16 (training and validation)";
    assert!(message.lines().take(2).any(|line| line == heading), "{message}");
}
