//! Sweeps: runs, runs left out, and errors that stop a sweep or a run.
use crate::common::{SMALL, call, files, pwrfgs, refuse, stderr, stdout, succeed, wait_for_step, write};
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::Stdio;

/// Two axes of two variants, one seed.
const EXPERIMENT: &str = "Experiment(
    name: \"tiny\",
    base: \"base/p.ron\",
    seeds: [4],
    set: {\"training.batch\": 1},
    axes: [
        Axis(name: \"lambda\", variants: [
            (label: \"0\", set: {\"pruners\": [OpacityThreshold()]}),
            (label: \"0.02\", set: {\"pruners\": [LearnableMask(lambda: 0.02, learning_rate: 0.2), OpacityThreshold()]}),
        ]),
        Axis(name: \"start\", variants: [
            (label: \"few\", set: {\"initializer\": Grid(count: 6)}),
            (label: \"more (8)\"),
        ]),
    ],
)";

const RUNS: [&str; 4] = [
    "lambda=0,start=few,seed=4",
    "lambda=0,start=more-8,seed=4",
    "lambda=0.02,start=few,seed=4",
    "lambda=0.02,start=more-8,seed=4",
];

/// A folder with the experiment in `e.ron`.
fn folder(experiment: &str, base: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("base/p.ron"), base);
    write(&folder.path().join("e.ron"), experiment);
    folder
}

fn model(sweep: &Path, run: &str) -> Vec<u8> {
    std::fs::read(sweep.join(run).join("model.safetensors")).unwrap()
}

/// When a file was last written, to see that it was left alone.
fn written(path: &Path) -> std::time::SystemTime {
    path.metadata().unwrap().modified().unwrap()
}

#[test]
fn sweep_runs_each_combination_once_with_its_settings() {
    let folder = folder(EXPERIMENT, SMALL);
    let here = folder.path();
    let plan = stdout(&succeed(here, &["sweep", "e.ron", "--dry-run"]));
    assert!(RUNS.iter().all(|run| plan.contains(run)) && plan.contains("4 runs of 4 combinations"), "{plan}");
    assert!(!here.join("runs").exists(), "a dry run writes nothing");
    let table = stdout(&succeed(here, &["sweep", "e.ron", "--jobs", "2", "--threads", "2"]));
    assert!(table.contains("4 of 4 runs finished"), "{table}");
    let sweep = here.join("runs/tiny");
    let pipeline = |run: &str| std::fs::read_to_string(sweep.join(run).join("pipeline.ron")).unwrap();
    let (first, last) = (pipeline(RUNS[0]), pipeline(RUNS[3]));
    assert!(first.contains("batch: 1") && first.contains("steps: 60") && first.contains("seed: 4"), "{first}");
    assert!(first.contains("count: 6") && !first.contains("LearnableMask"), "{first}");
    assert!(last.contains("count: 8") && last.contains("LearnableMask"), "{last}");
    // Each run is what `pwrfgs run` makes of the same pipeline, at any number of jobs and threads.
    let path = sweep.join(RUNS[3]).join("pipeline.ron");
    succeed(here, &["run", path.to_str().unwrap(), "--out", "alone", "--threads", "1"]);
    assert!(model(&sweep, RUNS[3]) == std::fs::read(here.join("alone/model.safetensors")).unwrap());
    // The same command finds all of it done.
    let before: Vec<_> = RUNS.map(|run| written(&sweep.join(run).join("run.json"))).into();
    let again = succeed(here, &["sweep", "e.ron"]);
    assert_eq!(stderr(&again).matches("already finished").count(), 4, "{}", stderr(&again));
    assert_eq!(RUNS.map(|run| written(&sweep.join(run).join("run.json"))).to_vec(), before);
    // An experiment that grows keeps what it has.
    write(&here.join("e.ron"), EXPERIMENT.replace("seeds: [4]", "seeds: [4, 5]"));
    let status = stdout(&succeed(here, &["sweep", "e.ron", "--status"]));
    assert!(status.contains("4 of 8 runs finished") && status.matches("waiting").count() == 4, "{status}");
}

#[test]
fn killed_sweep_resumes_to_identical_result() {
    let base = SMALL.replace("steps: 60", "steps: 500").replace("prune_until: 40", "prune_until: 300");
    let folder = folder(&EXPERIMENT.replace("(label: \"more (8)\"),", ""), &base);
    let here = folder.path();
    let runs = [RUNS[0], RUNS[2]];
    succeed(here, &["sweep", "e.ron", "--out", "whole", "-q"]);
    // In the first run, and twice in the second.
    for (run, step) in [(runs[0], 250), (runs[1], 150), (runs[1], 350)] {
        let mut child =
            pwrfgs(here).args(["sweep", "e.ron", "--out", "killed", "-q"]).stdout(Stdio::null()).spawn().unwrap();
        wait_for_step(&mut child, &here.join("killed").join(run), step);
        child.kill().unwrap(); // SIGKILL
        assert!(!child.wait().unwrap().success(), "killed in {run} after step {step}");
    }
    let status = stdout(&succeed(here, &["sweep", "e.ron", "--out", "killed", "--status"]));
    assert!(status.contains("finished") && !status.contains("2 of 2"), "{status}");
    succeed(here, &["sweep", "e.ron", "--out", "killed", "-q"]);
    for run in runs {
        assert!(model(&here.join("whole"), run) == model(&here.join("killed"), run), "{run} differs");
    }
}

#[test]
fn sweep_prints_its_total_time_before_the_first_run() {
    let with_steps = |steps: &str| folder(EXPERIMENT, &SMALL.replace("steps: 60", &format!("steps: {steps}")));
    let total = "in total on this machine with --jobs 1";
    let long = with_steps("1_700");
    let text = stderr(&succeed(long.path(), &["sweep", "e.ron", "--only", RUNS[2]]));
    assert!(text.find(total).unwrap() < text.find("training 1,700 steps").unwrap(), "{text}");
    assert!(!text.contains("slowest runs"), "{text}");
    // Quiet, and with few steps, whose timing takes longer than the runs.
    let short = with_steps("60");
    for (here, quiet) in [(&long, &["-q"][..]), (&short, &[])] {
        let text = stderr(&succeed(here.path(), &[&["sweep", "e.ron", "--only", RUNS[3]], quiet].concat()));
        assert!(!text.contains(total), "{text}");
    }

    // Days: also the slowest combinations, each by the run that comes next.
    let days = with_steps("4_000_000_000");
    let mut child = pwrfgs(days.path()).args(["sweep", "e.ron"]).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
    let before: Vec<String> = lines.by_ref().take_while(|line| !line.contains("training 4,000,000,000")).collect();
    child.kill().unwrap();
    child.wait().unwrap();
    let named = before.iter().skip_while(|line| !line.starts_with("slowest runs; --only RUN")).skip(1);
    let named: Vec<&str> = named.filter_map(|line| line.split("  ").next()).collect();
    assert!(named.len() == 3 && named.iter().all(|name| RUNS.contains(name)), "{before:#?}");
}

#[test]
fn failed_run_does_not_stop_other_runs() {
    // Far too fast: its numbers leave the finite range.
    let wild = "(label: \"few\", set: {\"training.optimizer\": (network: Constant(1e30), log_scales: Constant(1e30))})";
    let folder = folder(&EXPERIMENT.replace("(label: \"few\", set: {\"initializer\": Grid(count: 6)})", wild), SMALL);
    let here = folder.path();
    for _ in 0..2 {
        let output = call(here, &["sweep", "e.ron"]);
        assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
        assert!(stderr(&output).contains("2 of 4 runs failed") && stderr(&output).contains("is not finite at step"));
        let report = std::fs::read_to_string(here.join("runs/tiny/report/report.csv")).unwrap();
        assert!(report.contains("lambda 0.02") && !report.contains("start few"), "finished runs only: {report}");
        let status = stdout(&succeed(here, &["sweep", "e.ron", "--status"]));
        assert!(status.contains("2 of 4 runs finished") && status.matches("failed: ").count() == 2, "{status}");
    }
    // Mended, they run; the others are not run again.
    let sweep = here.join("runs/tiny");
    let before = written(&sweep.join(RUNS[1]).join("run.json"));
    for run in [RUNS[0], RUNS[2]] {
        std::fs::remove_dir_all(sweep.join(run)).unwrap();
    }
    write(&here.join("e.ron"), EXPERIMENT);
    succeed(here, &["sweep", "e.ron"]);
    assert_eq!(written(&sweep.join(RUNS[1]).join("run.json")), before);
    assert!(!sweep.join("failures").exists(), "no failure is left");
}

#[test]
fn shards_divide_runs() {
    let folder = folder(EXPERIMENT, SMALL);
    let here = folder.path();
    succeed(here, &["sweep", "e.ron", "--shard", "2/3"]);
    let sweep = here.join("runs/tiny");
    let there = |run: &str| sweep.join(run).join("model.safetensors").exists();
    assert_eq!(RUNS.map(there), [false, true, false, false]);
    succeed(here, &["sweep", "e.ron", "--only", RUNS[2]]);
    succeed(here, &["sweep", "e.ron", "--shard", "1/3"]);
    assert_eq!(RUNS.map(there), [true; 4]);
    refuse(here, &["sweep", "e.ron", "--only", "lambda=0.02,start=fw,seed=4"], 2, &["did you mean", RUNS[2]]);
    refuse(here, &["sweep", "runs/tiny", "--status"], 2, &["runs/tiny", "is a folder; name a file"]);
    let parts = RUNS[2].rsplit_once(',').unwrap();
    for name in [parts.0, parts.1] {
        let listed = stdout(&succeed(here, &["sweep", "e.ron", "--status", "--only", name]));
        for run in RUNS {
            let has_part = run.starts_with(name) || run.ends_with(name);
            assert_eq!(listed.contains(run), has_part, "{name}: {listed}");
        }
    }
    refuse(here, &["sweep", "e.ron", "--jobs", "9", "--threads", "2"], 2, &["set at most 2"]);
}

#[test]
fn concurrent_sweeps_share_runs_of_folder() {
    let base = SMALL.replace("steps: 60", "steps: 100");
    let folder = folder(EXPERIMENT, &base);
    let here = folder.path();
    let start = || pwrfgs(here).args(["sweep", "e.ron"]).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let mut both = [start(), start()];
    let ends = both.each_mut().map(|child| child.wait().unwrap().success());
    // One of them may have met the other at the same run, and says so; nothing is harmed.
    assert!(ends.contains(&true));
    succeed(here, &["sweep", "e.ron", "-q"]);
    succeed(here, &["sweep", "e.ron", "--out", "alone", "-q"]);
    for run in RUNS {
        assert!(model(&here.join("runs/tiny"), run) == model(&here.join("alone"), run), "{run} differs");
    }
}

#[test]
fn reports_position_of_experiment_errors_before_first_run() {
    let folder = folder(EXPERIMENT, SMALL);
    let here = folder.path();
    let cases: [(&str, &str, &[&str]); 15] = [
        ("lambda: 0.02", "lamda: 0.02", &["e.ron:9:", "did you mean `lambda`"]),
        ("LearnableMask", "LearnedMask", &["e.ron:9:", "did you mean `LearnableMask`"]),
        (
            "(label: \"more (8)\")",
            "(label: \"more\", set: {\"training.prune_until\": 5})",
            &["e.ron:13:35: axis `start`, variant `more`: ", "densify_until"],
        ),
        ("(label: \"more (8)\")", "(label: \"Few\")", &["e.ron:14:", "two labels", "`few`"]),
        ("(label: \"more (8)\")", "(label: \"()\")", &["e.ron:13:", "cannot name a folder"]),
        ("(label: \"more (8)\")", "()", &["e.ron:13:", "the field `label` is missing"]),
        ("(label: \"more (8)\")", "(label: \"b\", set: {\"seed\": 3})", &["e.ron:13:", "`seeds`"]),
        (
            "(label: \"more (8)\")",
            "(label: \"b\", set: {\"initializer\": Grid(count: 6)})",
            &["e.ron: axis `start`, variant `b`: ", "the same pipeline as"],
        ),
        (
            "(label: \"more (8)\")",
            "(label: \"b\", set: {\"data\": Nerf2Spectrum(root: \"nowhere\")})",
            &["e.ron:13:32: axis `start`, variant `b`: ", "start=b", "nowhere", "no such folder"],
        ),
        ("seeds: [4]", "seeds: []", &["e.ron:", "`seeds` is empty"]),
        ("seeds: [4]", "seeds: [4, 4]", &["the seed 4 comes twice"]),
        ("name: \"lambda\"", "name: \"seed\"", &["e.ron:", "cannot name a folder"]),
        ("name: \"lambda\"", "name: \"start\"", &["two axes are called `start`"]),
        ("base/p.ron", "base/q.ron", &["cannot read base/q.ron"]),
        ("{\"training.", "{\"traning.", &["e.ron:5:11: set: ", "did you mean `training`"]),
    ];
    for (from, to, words) in cases {
        write(&here.join("e.ron"), EXPERIMENT.replacen(from, to, 1));
        refuse(here, &["sweep", "e.ron"], 2, words);
        assert!(!here.join("runs").exists(), "{to}");
    }
    // Forty axes of two variants are a million million runs.
    let axis = |k| format!("Axis(name: \"a{k}\", variants: [(label: \"x\"), (label: \"y\")])");
    let axes: Vec<String> = (0..40).map(axis).collect();
    let text = format!("Experiment(name: \"e\", base: \"base/p.ron\", axes: [{}])", axes.join(", "));
    write(&here.join("e.ron"), text);
    refuse(here, &["sweep", "e.ron"], 2, &["e.ron: the axes and seeds make 1099511627776 runs", "10000"]);
    // A folder that holds the run of another pipeline is not taken, and none of the others begun.
    write(&here.join("e.ron"), EXPERIMENT);
    succeed(here, &["run", "base/p.ron", "--out", &format!("runs/tiny/{}", RUNS[2])]);
    refuse(here, &["sweep", "e.ron"], 2, &["another pipeline", RUNS[2]]);
    assert!(!here.join("runs/tiny").join(RUNS[0]).exists());
}

#[test]
fn checks_common_settings_together_with_axis_settings() {
    let of_target = |last: &str| {
        format!(
            "Experiment(name: \"t\", base: \"base/p.ron\",\nset: {{\"pruners\": [TopK()]}},\naxes: [Axis(name: \"n\", variants: [
            (label: \"3\", set: {{\"training.target_count\": 3}}), {last}])])"
        )
    };
    let folder = folder(&of_target("(label: \"4\", set: {\"training.target_count\": 4})"), SMALL);
    let here = folder.path();
    succeed(here, &["sweep", "e.ron", "--dry-run"]);
    write(&here.join("e.ron"), of_target("(label: \"none\")"));
    refuse(here, &["sweep", "e.ron", "--dry-run"], 2, &["e.ron:2:7: set: pruners: `TopK` needs training.target_count"]);
    let set = ["--set", "pruners=[TopK(score: Opacity)]"];
    refuse(
        here,
        &[&["sweep", "e.ron", "--dry-run"][..], &set].concat(),
        2,
        &["error: --set pruners=", "training.target_count"],
    );
}

#[test]
fn refuses_folder_of_other_experiment_unchanged() {
    let folder = folder(EXPERIMENT, SMALL);
    let here = folder.path();
    let foreign: [(&str, &[u8], &[&str]); 4] = [
        (
            "sweep.json",
            b"{\"layers\": 3}",
            &["runs/tiny/sweep.json:1:", "not the listing of a sweep", "choose another --out"],
        ),
        ("sweep.json", b"{\"name\": \"lr\", \"runs\": []}", &["lists the runs of `lr`, not of `tiny`"]),
        ("thesis.tex", b"mine", &["runs/tiny is not a sweep folder", "it holds `thesis.tex`"]),
        ("report/figure.png", b"mine", &["runs/tiny is not a sweep folder", "it holds `report`"]),
    ];
    for (name, content, words) in foreign {
        write(&here.join("runs/tiny").join(name), content);
        let before = files(&here.join("runs"));
        for further in [&["--dry-run"][..], &["--only", RUNS[0]], &["--launcher", "slurm"], &[]] {
            refuse(here, &[&["sweep", "e.ron"], further].concat(), 2, words);
            assert_eq!(files(&here.join("runs")), before, "{name} {further:?}");
        }
        std::fs::remove_dir_all(here.join("runs")).unwrap();
    }
}

#[test]
fn other_experiment_of_same_name_keeps_first_listing() {
    let folder = folder(EXPERIMENT, SMALL);
    let here = folder.path();
    let listing = || std::fs::read_to_string(here.join("runs/tiny/sweep.json")).unwrap();
    succeed(here, &["sweep", "e.ron", "-q", "--only", RUNS[0]]);
    let first = listing();
    // Other runs, in part or altogether; and the same names of another base, asked for a run that has not begun.
    let others = [
        EXPERIMENT.replace("(label: \"0\",", "(label: \"none\","),
        EXPERIMENT.replace("seeds: [4]", "seeds: [5]"),
        EXPERIMENT.replace("batch\": 1", "batch\": 1, \"training.steps\": 50"),
    ];
    for (other, words) in
        others.iter().zip([["lambda=0,", "`lambda=none,"], ["seed=4`", "seed=5`"], ["another pipeline", RUNS[0]]])
    {
        write(&here.join("e.ron"), other);
        let before = files(&here.join("runs"));
        for further in [&["--only", "lambda=0.02,start=few,seed=4"][..], &["--shard", "2/2"], &["--dry-run"], &[]] {
            if !(other.contains("[5]") && further.contains(&"--only")) {
                refuse(here, &[&["sweep", "e.ron"], further].concat(), 2, &words);
            }
        }
        assert_eq!(files(&here.join("runs")), before, "{words:?}");
    }
    // One that has shrunk leaves the listing, one that has grown extends it.
    write(&here.join("e.ron"), EXPERIMENT.replace("(label: \"more (8)\"),", ""));
    succeed(here, &["sweep", "e.ron", "-q", "--only", RUNS[0]]);
    assert_eq!(listing(), first);
    write(&here.join("e.ron"), EXPERIMENT.replace("seeds: [4]", "seeds: [4, 5]"));
    succeed(here, &["sweep", "e.ron", "-q", "--only", RUNS[0]]);
    assert!(listing().matches("\"seed\": ").count() == 8 && listing().contains("\"seed\": 5"), "{}", listing());
}

/// Mean of a metric by variant, in `report.csv` whose labels have no commas.
fn means(report: &str, metric: &str) -> BTreeMap<String, f64> {
    let rows = report.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let own = rows.filter(|row| row[3] == "variant" && row[4] == metric && ["mean", "value"].contains(&row[6]));
    own.map(|row| (row[2].to_owned(), row[7].parse().unwrap())).collect()
}

#[test]
fn small_twin_of_the_paper_has_its_figures_and_table() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let few = [
        "data.samples=40",
        "data.points=60",
        "initializer=Random(count: 60, std: 3.0)",
        "baselines=[MeanSpectrum(), NearestNeighbours(k: 1)]",
        "training.densify.max_gaussians=100",
        "training.batch=1",
        "training.validate_every=0",
    ];
    let set: Vec<&str> = few.iter().flat_map(|change| ["--set", change]).collect();
    // Every third run: seed 0 of each row.
    let command = ["sweep", "paper-office", "--scale", "0.15", "--jobs", "2", "--threads", "2", "--shard", "1/3"];
    let table = stdout(&succeed(here, &[&command[..], &set].concat()));
    assert!(table.contains("12 of 12 runs finished"), "{table}");
    succeed(here, &["report", "runs/paper-office"]);
    let report = here.join("runs/paper-office/report");
    for figure in ["gaussians", "ssim-n", "room", "spectra"] {
        assert!(report.join(format!("figures/1-{figure}.pdf")).is_file(), "{figure}");
    }
    let text = std::fs::read_to_string(report.join("report.csv")).unwrap();
    for metric in ["ssim", "latency_total_ms", "model_bytes", "gaussian_bytes"] {
        assert_eq!(means(&text, metric).len(), 12, "{metric}");
    }
    let n = means(&text, "gaussians");
    for start in ["masks", "masks on point cloud"] {
        let falling = ["0.01", "0.03", "0.06", "0.075"].map(|lambda| n[&format!("{start} λ {lambda}")]);
        assert!(falling.is_sorted_by(|more, less| more > less), "{start}: {falling:?}");
    }
}
